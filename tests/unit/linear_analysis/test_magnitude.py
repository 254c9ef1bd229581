"""Models of extreme magnitude: the right number, or an error that blames the right thing and names who was called."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal, getcontext
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import robustlab as rl
from robustlab.linear_analysis.magnitude import moderated
from robustlab.norms import h2_norm

Model = rl.StateSpaceModel
EXTREME = (5e-324, 1e-310, 1e150, 1e300)


def plant(dt: float, name: str, size: float, whole: bool) -> Model:
    """Two stable states of order one, with one entry of A, B, C or D, or all of that matrix, of another size."""
    parts = {
        "A": [[0.5, 0.2], [-0.2, 0.3]] if dt else [[-1.0, 0.5], [-0.5, -2.0]],
        "B": [[1.0], [0.5]],
        "C": [[1.0, -0.5]],
        "D": [[0.25]],
    }
    parts = {key: np.array(value) for key, value in parts.items()}
    if whole:
        parts[name] = parts[name] * size
    else:
        parts[name][0, 0] = np.copysign(size, parts[name][0, 0])
    return Model(*parts.values(), dt)


ALL = [(dt, name, size, whole) for dt in (0.0, 0.1) for name in "ABCD" for size in EXTREME for whole in (False, True)]
SOME = [(0.0, "A", 1e-310, True), (0.0, "B", 1e150, False), (0.1, "C", 5e-324, True), (0.1, "D", 1e300, True)]


def uncertain(m: Model, block: Any) -> rl.UncertainModel:
    """A tenth of the input and of the direct term is moved by the block, which sees the output."""
    B, C = np.hstack([0.1 * m.B, m.B]), np.vstack([m.C, m.C])
    return rl.UncertainModel(Model(m.A, B, C, np.tile([[0.1, 1.0]], (2, 1)) * m.D, m.dt), [block])


def generalised(m: Model) -> Model:
    """w1 at the input, w2 at the measurement; z is the output and the control."""
    zero = np.zeros_like(m.B)
    D = np.array([[0, 0, 0], [0, 0, 1], [0, 1, m.D[0, 0]]])
    return Model(m.A, np.hstack([m.B, zero, m.B]), np.vstack([m.C, 0 * m.C, m.C]), D, m.dt)


K = Model([], [], [], [[0.1]])
PAIR = np.eye(2), np.eye(1)


def real(m: Model) -> rl.UncertainModel:
    return uncertain(m, rl.RealScalar("k"))


def simulated(m: Model) -> rl.Record:
    t = (m.dt or 0.1) * np.arange(11)
    return rl.simulate(m, t, np.ones((11, 1)))


# What is called, under which name its errors are told, and whether it is quick enough for all of the models.
CALLS: dict[str, tuple[Callable[[Model], Any], str, bool]] = {
    "peak_gain": (rl.peak_gain, "peak_gain", True),
    "h2_norm": (h2_norm, "h2_norm", True),
    "h2": (lambda m: rl.h2(generalised(m), 1, 1), "synth h2", True),
    "hinf": (lambda m: rl.hinf(generalised(m), 1, 1, effort=0.05), "synth hinf", False),
    "dk": (lambda m: rl.dk(generalised(m), [rl.FullBlock("k", 1, 1)], 1, 1, effort=0.05), "synth dk", False),
    "mixsyn": (lambda m: rl.mixsyn(m, W1=0.5, W2=0.1, effort=0.05), "synth mixsyn", False),
    "ncf": (rl.ncf, "synth ncf", True),
    "mu": (lambda m: rl.mu(rl.frequency_response(m, [1.0])[0], [rl.RealScalar("k")]), "", False),
    "robust_stability": (lambda m: rl.robust_stability(real(m)), "robust_stability", False),
    "robust_performance": (lambda m: rl.robust_performance(real(m)), "robust_performance", False),
    "worst_case_gain": (lambda m: rl.peak_gain(real(m)), "peak_gain", False),
    "worst_case": (lambda m: rl.worst_case(real(m), "hinf"), "worst_case", False),
    "disk_margin": (lambda m: rl.disk_margin(m, K), "disk_margin", True),
    "disk_margin of a set": (lambda m: rl.disk_margin(real(m), K), "disk_margin", False),
    "small_gain": (lambda m: rl.small_gain(uncertain(m, rl.FullBlock("k", 1, 1))), "small_gain", True),
    "nu_gap": (lambda m: rl.nu_gap(m, Model(m.A, m.B, 1.1 * m.C, m.D, m.dt)), "nu_gap", True),
    "coprime_margin": (lambda m: rl.coprime_margin(m, K), "coprime_margin", True),
    "controllability": (rl.controllability, "controllability", True),
    "observability": (rl.observability, "observability", True),
    "frequency_response": (lambda m: rl.frequency_response(m, [0.0, 1.0]), "frequency_response", True),
    "hankel_singular_values": (rl.hankel_singular_values, "hankel_singular_values", True),
    "truncated": (lambda m: rl.reduce_model(m, 1), "reduce_model", True),
    "reduce_model": (lambda m: rl.reduce_model(m, 1, method="residualisation"), "reduce_model", True),
    "simulate": (simulated, "simul", True),
    "discretise": (lambda m: m if m.dt else rl.discretise(m, 0.1), "discretise", True),
    "elementwise": (lambda m: rl.elementwise(m, Model(1.1 * m.A, m.B, m.C, m.D, m.dt)), "elementwise", True),
}
CASES = [(name, case) for name, (_, _, quick) in CALLS.items() for case in (ALL if quick else SOME)]


def test_every_end_is_a_result_or_an_error_that_names_the_call_and_no_nan_in_finite_input():
    wrong = []
    for name, case in CASES:
        call, told, _ = CALLS[name]
        try:
            call(plant(*case))
        except rl.RobustlabError as error:
            text = str(error)
            if not error.where.startswith(told) or any(word in text for word in ("NaN", "infs", " is infinite (")):
                wrong.append(f"{name} {case}: {text}")
        except Exception as error:  # noqa: BLE001 - a bare LinAlgError, ValueError, RuntimeWarning, ...
            wrong.append(f"{name} {case}: {type(error).__name__}: {error}")
    assert not wrong, "\n".join(wrong)


# --- against exact arithmetic ----------------------------------------------------------------------------------------


def exact(m: Model, omega: float) -> tuple[Fraction, Fraction]:
    """Real and imaginary part of the response of a model with two states, in rational arithmetic."""
    A, B, C, D = ([[Fraction(float(x)) for x in row] for row in part] for part in (m.A, m.B, m.C, m.D))
    at = np.exp(1j * omega * m.dt) if m.dt else 1j * omega
    re, im = Fraction(float(np.real(at))), Fraction(float(np.imag(at)))

    def times(x: tuple[Fraction, Fraction], y: tuple[Fraction, Fraction]) -> tuple[Fraction, Fraction]:
        return x[0] * y[0] - x[1] * y[1], x[0] * y[1] + x[1] * y[0]

    p, q = (re - A[0][0], im), (re - A[1][1], im)
    det = times(p, q)
    det = det[0] - A[0][1] * A[1][0], det[1]
    (b1,), (b2,) = B
    (c1, c2), d = C[0], D[0][0]
    top = c1 * (q[0] * b1 + A[0][1] * b2) + c2 * (A[1][0] * b1 + p[0] * b2), im * (c1 * b1 + c2 * b2)
    size = det[0] ** 2 + det[1] ** 2
    return (top[0] * det[0] + top[1] * det[1]) / size + d, (top[1] * det[0] - top[0] * det[1]) / size


def length(g: tuple[Fraction, Fraction]) -> float:
    square = g[0] ** 2 + g[1] ** 2
    if not square:
        return 0.0
    half = (square.numerator.bit_length() - square.denominator.bit_length()) // 2
    return float(np.ldexp(float(square / Fraction(2) ** (2 * half)) ** 0.5, half))


def test_norms_and_responses_are_right_wherever_they_are_given():
    given = 0
    for case in ALL:
        m = plant(*case)
        try:
            norm = rl.peak_gain(m)
        except rl.NoTrustworthyNumber as error:
            assert "overflows" in str(error)
            assert case[:2] == (0.0, "A"), case
            assert case[2] < 1, case  # poles at 1e-310 rad/s: the gain is 1e310
            continue
        if np.isinf(norm.value):
            assert case[1] == "A", case
            continue
        given += 1
        at = abs(m.D[0, 0]) if np.isinf(norm.frequency) else length(exact(m, norm.frequency))
        assert norm.lower == pytest.approx(at, rel=1e-9, abs=1e-322), case
        top = max(length(exact(m, omega)) for omega in (0.0, 0.1, 0.7, 1.0, 2.0, 5.0, 20.0))
        assert top <= norm.upper * (1 + 1e-9), case
        for omega in (0.0, 1.0):
            g = [float(x) for x in exact(m, omega)]
            found = complex(rl.frequency_response(m, [omega])[0, 0, 0])
            assert abs(found - complex(*g)) <= 1e-12 * norm.upper + 1e-322, case
    assert given >= 54


@pytest.mark.parametrize("size", [1e-300, 1e-154, 1e-80, 1e-10, 1e80, 1e154, 1e300])
@pytest.mark.parametrize("name", ["a", "b1", "b2", "c1", "c2", "d", "e"])
def test_h2_of_the_textbook_scalar_at_any_magnitude(name, size):
    """x' = a x + b1 w1 + b2 u, z = (c1 x, d u), y = c2 x + e w2; X, Y solve two quadratic equations, F = -b2 X/d^2."""
    getcontext().prec = 50
    v = dict.fromkeys(("a", "b1", "b2", "c1", "c2", "d", "e"), 1.0) | {name: size}
    a, b1, b2, c1, c2, d, e = (Decimal(x) for x in v.values())
    G, H = (b2 / d) ** 2, (c2 / e) ** 2
    X, Y = (a + (a * a + G * c1 * c1).sqrt()) / G, (a + (a * a + H * b1 * b1).sqrt()) / H
    best = (b1 * b1 * X + (b2 * X / d) ** 2 * Y).sqrt()
    D = [[0, 0, 0], [0, 0, v["d"]], [0, v["e"], 0]]
    P = Model([[v["a"]]], [[v["b1"], 0, v["b2"]]], [[v["c1"]], [0], [v["c2"]]], D)
    if best > Decimal("1e308"):
        with pytest.raises(rl.NoTrustworthyNumber, match="overflows"):
            rl.h2(P, 1, 1)
        return
    design = rl.h2(P, 1, 1)
    assert design.status.trustworthy
    # Both Gramians agree to 1e-6; where a penalty or a noise is next to nothing the infimum is approached only.
    assert 1 - 1e-6 <= design.gamma / float(best) <= (1 + 1e-6 if not design.regularisation else 1.01)


@pytest.mark.parametrize("size", [1e-300, 1e-154, 1e154, 1e300])
@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_h2_of_every_disturbance_at_any_magnitude(dt, size):
    """All of w in another unit changes the norm by that factor and K not at all; its second voice squares nothing."""
    A, w = [[0.5, 1.0], [0.0, -2.0]], np.array([[1.0, 0.0], [2.0, 0.0]])
    into, out, u, noise = (
        np.array([[1.0], [1.0]]),
        [[1.0, 0.0], [0.0, 0.0], [1.0, 0.5]],
        [[0.0], [1.0], [0.0]],
        [0, 1.0],
    )

    def designed(unit):
        D = np.hstack([unit * np.array([[0, 0], [0, 0], noise]), u])
        return rl.h2(rl.StateSpaceModel(A, np.hstack([unit * w, into]), out, D, dt), 1, 1)

    design, plain = designed(size), designed(1.0)
    assert design.status is plain.status is rl.Status.CONVERGED
    assert design.gamma == pytest.approx(size * plain.gamma, rel=1e-9)


@pytest.mark.parametrize("b1", [1.0, 1e10, 1e100, 1e154, 1e200])
def test_hinf_of_any_disturbance_gain(b1):
    """P12 = s/(s - 1) has a zero at 0, so that no gain is below |P11(0)| = b1; K = -1 - eps comes close to it."""
    design = rl.hinf(Model([[1.0]], [[b1, 1]], [[1], [1]], [[0, 1], [1, 0]]), 1, 1)
    assert design.status is rl.Status.CERTIFIED
    assert b1 * (1 - 1e-9) <= design.gamma <= 1.05 * b1


D11, D12, D21 = np.array([[1, 0.5], [0.3, 1]]), np.array([[1.0], [2.0]]), np.array([[1, 0.5]])


@pytest.mark.parametrize("size", [0.0, 1.0, 1e155, 1e300])
@pytest.mark.parametrize("n", [0, 1])
def test_synthesis_with_direct_terms_of_any_magnitude(size, n):
    """No K is better than Parrott's bound: the part of D11 past D12, and the part of it past D21."""
    x = np.ones((n, 1))
    P = Model(-np.eye(n), np.hstack([x] * 3), np.vstack([x.T] * 3), np.block([[size * D11, D12], [D21, 0.0]]))
    bound = max(np.linalg.norm([-2, 1] @ D11), np.linalg.norm(D11 @ [-1, 2])) / np.sqrt(5) * size
    design = rl.hinf(P, 1, 1)
    assert bound * (1 - 1e-9) <= design.gamma < np.inf
    assert n or size != 1.0 or design.gamma <= bound * (1 + 1e-3)
    try:
        robust = rl.dk(P, [rl.FullBlock("k", 1, 1)], 1, 1, effort=0.05)
    except rl.NoTrustworthyNumber as error:
        assert (size > 1, error.where) == (True, "synth dk")
    else:
        assert robust.gamma <= design.gamma * (1 + 1e-3)


@pytest.mark.parametrize("size", [1e155, 1e300])
def test_dk_where_all_direct_terms_are_large_ends_in_one_line(size):
    P = Model(-np.eye(1), np.ones((1, 3)), np.ones((3, 1)), size * np.block([[D11, D12], [D21, 0.0]]))
    with pytest.raises(rl.NoTrustworthyNumber, match=r"^synth dk: .*1e(310|600)"):
        rl.dk(P, [rl.FullBlock("k", 1, 1)], 1, 1, effort=0.05)


def test_h2_where_the_control_acts_1e20_times_weaker_than_the_disturbance():
    """D12, D21 are square: A - B2 C1 and A - B1 C2 are unstable, X = 2 (a - b)/b^2, Y = 2 (a - 1), F = -(b X + 1)."""
    a, b = 1e10, 1e-10
    X, Y = 2 * (a - b) / b**2, 2 * (a - 1)
    design = rl.h2(Model([[a]], [[1, b]], [[1], [1]], [[0, 1], [1, 0]]), 1, 1)
    assert design.gamma == pytest.approx(np.sqrt(X + (b * X + 1) ** 2 * Y), rel=1e-8)


def test_the_norm_of_minus_one_with_a_huge_unseen_input():
    norm = rl.peak_gain(Model([[-1.0]], [[1e300]], [[0.0]], [[-1.0]]))
    assert norm.status is rl.Status.CERTIFIED
    assert norm.lower == 1.0
    assert norm.upper == pytest.approx(1.0, rel=1e-5)


def test_a_norm_beyond_floating_point_is_called_so():
    with pytest.raises(rl.NoTrustworthyNumber, match="peak_gain: the answer is about 1e600: it overflows"):
        rl.peak_gain(Model([[-1.0]], [[1e300]], [[1e300]], [[0.0]]))


def test_hankel_values_and_gaps_at_any_magnitude():
    for b, c in ((1e300, 1e-300), (1e-200, 1e200), (1e-310, 1.0), (1e300, 1.0)):
        values = rl.hankel_singular_values(Model([[-0.5]], [[b]], [[c]], [[0.0]]))
        np.testing.assert_allclose(values, [float(Fraction(b) * Fraction(c))], rtol=1e-12)
    # The gap of b/(s + 1) and -b/(s + 1) goes to 1 with b; states of another size do not change it.
    one = rl.nu_gap(Model([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), Model([[-1.0]], [[1.0]], [[-1.0]], [[0.0]]))
    two = rl.nu_gap(Model([[-1.0]], [[1e300]], [[1e-300]], [[0.0]]), Model([[-1.0]], [[1e300]], [[-1e-300]], [[0.0]]))
    assert two.upper == pytest.approx(one.upper, rel=1e-6)


@pytest.mark.parametrize("case", ALL[::7])
def test_a_moderated_model_is_the_same_transfer_function(case):
    m = plant(*case)
    ordinary = moderated(m, "test")
    scaled = ordinary.model
    assert max(np.abs(part).max() for part in (scaled.A, scaled.B, scaled.C, scaled.D)) < 1e60 or case[1] == "A"
    for omega in (0.0, 0.3):
        there = exact(scaled, float(np.ldexp(omega, -ordinary.rate)))
        here = exact(m, omega)
        factor = Fraction(2) ** ordinary.gain
        # Dynamics that are nothing beside D may be made larger, up to 2^-300 of it.
        for x, y in zip(there, here, strict=True):
            assert abs(x - factor * y) <= abs(x) / 10**12 + Fraction(1, 2**290), case


# --- the name of who was called --------------------------------------------------------------------------------------


UNSTABLE = Model([[1.0]], [[1.0]], [[0.5]], [[0.0]])
SET = rl.UncertainModel(Model([[1.0]], [[0.1, 1.0]], [[1.0], [0.5]], np.zeros((2, 2))), [rl.RealScalar("k")])
ENTANGLED = Model(np.diag([1.0, -1.0]), [[0.0], [1.0]], [[1.0, 1.0]], [[0.0]])


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: rl.disk_margin(UNSTABLE), "disk_margin"),
        (lambda: rl.disk_margin(SET), "disk_margin"),
        (lambda: rl.robust_performance(SET), "robust_performance"),
        (lambda: rl.peak_gain(SET), "peak_gain"),
        (lambda: rl.coprime_margin(ENTANGLED, K), "coprime_margin"),
        (lambda: rl.nu_gap(ENTANGLED, UNSTABLE), "nu_gap"),
        (lambda: rl.ncf(ENTANGLED), "synth ncf"),
        (lambda: rl.reduce_model(UNSTABLE, 0), "reduce_model"),
        (lambda: rl.reduce_model(ENTANGLED, 1, method="coprime"), "reduce_model"),
    ],
)
def test_an_error_begins_with_the_function_that_was_called(call, name):
    with pytest.raises(rl.RobustlabError) as caught:
        call()
    assert caught.value.where.partition(":")[0] == name
    assert str(caught.value).startswith(f"{name}: ")


@pytest.mark.parametrize("b", [1e200, 1e300])
@pytest.mark.parametrize("design", ["hinf", "h2", "ncf"])
def test_gains_beyond_floating_point_end_in_one_line(design, b):
    """All of B and C that large: products of them are no floating-point numbers, and scalings of them are zero."""
    P = Model([[1.0, 1.0], [0.0, -1.0]], b * np.ones((2, 2)), b * np.array([[1.0, 2.0], [1.0, 1.0]]), np.zeros((2, 2)))
    calls: dict[str, Callable[[], Any]] = {
        "hinf": lambda: rl.hinf(P, 1, 1, effort=0.01),
        "h2": lambda: rl.h2(P, 1, 1, effort=0.1),
        "ncf": lambda: rl.ncf(P.select(P.input_names[:1], P.output_names[:1])),
    }
    try:
        assert calls[design]().gamma > 0
    except rl.NoTrustworthyNumber as error:
        assert "\n" not in error.line
