"""Exact delays against closed forms: responses, rational approximations, weights; and responses over time."""

from fractions import Fraction
from itertools import pairwise
from math import comb, factorial

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from scipy.integrate import solve_ivp

import robustlab as rl
from robustlab.delays import DelayedModel, error_weight, pade, phase_bound
from robustlab.errors import InputError, NoTrustworthyNumber

OMEGA = np.geomspace(1e-3, 1e3, 301)
TIMES, ONES = np.linspace(0, 1, 11), np.ones(11)
LAG = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])


def response(model, omega=OMEGA):
    return rl.frequency_response(model, omega)[:, 0, 0]


# --- the model --------------------------------------------------------------------------------------------------------


def test_a_delay_changes_only_the_phase():
    assert np.abs(response(rl.delay(0.7)) - np.exp(-0.7j * OMEGA)).max() < 1e-14


def test_a_smith_predictor_has_the_delay_outside_its_loop():
    plant, pi = LAG @ rl.delay(2.0), rl.StateSpaceModel([[0.0]], [[1.0]], [[0.5]], [[1.0]])
    predictor = LAG - LAG @ rl.delay(2.0)
    controller = rl.with_delays(pi).feedback(predictor)
    loop = (plant @ controller).feedback()
    s = 1j * OMEGA
    inner = (1 + 0.5 / s) / (s + 1)
    assert np.abs(response(loop) - np.exp(-2.0 * s) * inner / (1 + inner)).max() < 1e-10


def test_delays_at_inputs_and_outputs_by_name_and_number():
    plant = rl.StateSpaceModel(
        -np.eye(2), np.eye(2), [[1.0, 2.0], [3.0, 4.0]], np.zeros((2, 2)), inputs=["u", "v"], outputs=["y", "z"]
    )
    model = rl.with_delays(plant, inputs={"u": 0.1, 1: 0.2}, outputs={"z": 0.3})
    assert (model.input_names, model.output_names) == (("u", "v"), ("y", "z"))
    turn = [[0.1, 0.2], [0.4, 0.5]]
    expected = rl.frequency_response(plant, OMEGA) * np.exp(-1j * OMEGA[:, None, None] * np.array(turn))
    assert np.abs(rl.frequency_response(model, OMEGA) - expected).max() < 1e-13


def test_a_model_with_a_delay_and_a_direct_term_has_an_inverse():
    model = rl.with_delays(rl.StateSpaceModel([], [], [], [[1.0]])) + 0.5 * rl.delay(0.3)
    assert np.abs(response(model.inverse()) * response(model) - 1).max() < 1e-13
    with pytest.raises(NoTrustworthyNumber, match="inverse"):
        rl.delay(0.3).inverse()


def test_a_discrete_delay_is_a_chain_of_states():
    plant = rl.StateSpaceModel([[0.5]], [[1.0]], [[1.0]], [[0.0]], dt=0.1, inputs=["u"])
    late = rl.with_delays(plant, inputs={"u": 0.3}, outputs={0: 0.1})
    assert late.n_states == 5
    w = np.linspace(0.1, 30, 50)
    expected = rl.frequency_response(plant, w)[:, 0, 0] * np.exp(-0.4j * w)
    assert np.abs(response(late, w) - expected).max() < 1e-13
    with pytest.raises(InputError, match="whole number of samples"):
        rl.with_delays(plant, inputs={"u": 0.25})


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: rl.delay(-1.0), "0 s or more"),
        (lambda: rl.delay(np.inf), "finite"),
        (lambda: rl.delay(1.0, n=0), "delay: n: 0, expected a whole number of at least 1"),
        (lambda: rl.delay(True), "real numbers"),
        (lambda: rl.delay("1 s"), "real numbers"),
        (lambda: rl.with_delays(LAG, inputs={"none": 1.0}), "one of u1"),
        (lambda: rl.DelayedModel(LAG, [1.0, 2.0]), "at least 2"),
        (lambda: rl.h2_norm(rl.delay(1.0)), r"pade\(order\)"),
        (lambda: rl.delay(1.0) @ rl.delay(1.0).uncertain(2), "cover the delays first"),
        (lambda: rl.delay(1.0).pade(-1), "from 0 to 40"),
        (lambda: rl.frequency_response(rl.delay(1.0), [np.inf]), "finite"),
        (lambda: rl.simulate(rl.delay(0.1) @ LAG, TIMES, ONES, [0.0, 0.0]), "x0 has 2 entries"),
        (lambda: rl.simulate(rl.delay(0.1), TIMES, ONES, step=0.1), "step for a model with delays"),
        (lambda: rl.simulate(rl.delay(0.1), TIMES, ONES, rtol=2.0), "rtol"),
    ],
)
def test_invalid_requests_are_rejected(wrong, message):
    with pytest.raises(InputError, match=message):
        wrong()


def direct(rows, delay):
    return rl.DelayedModel(rl.StateSpaceModel([], [], [], rows), [delay])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: direct([[0.0, 1.0], [1.0, -1.0]], 0.3).feedback(), "without delay"),
        (lambda: direct([[1.0, 1.0], [1.0, 0.0]], 0.0), "delay of zero"),
        (lambda: rl.simulate((LAG @ rl.delay(1e-6)).feedback(), TIMES, ONES), "cells"),
        (
            lambda: rl.simulate((-1e9 * LAG @ rl.delay(0.05)).feedback(), 0.05 * np.arange(201), np.ones(201)),
            "outgrows",
        ),
    ],
)
def test_loops_without_an_answer_are_rejected(call, message):
    with pytest.raises(NoTrustworthyNumber, match=message):
        call()


# --- Padé -------------------------------------------------------------------------------------------------------------


def exact_phase_error(x: float, n: int) -> tuple[float, float]:
    """Real and imaginary part of R_n(jx) from the textbook sum, in rational numbers."""
    v = Fraction(x)
    terms = [Fraction(factorial(2 * n - k) * comb(n, k), factorial(2 * n)) for k in range(n + 1)]
    re = sum(c * v**k * (-1) ** (k // 2) for k, c in enumerate(terms) if k % 2 == 0)
    im = sum(c * v**k * (-1) ** (k // 2) for k, c in enumerate(terms) if k % 2)
    size = re * re + im * im
    return float((re * re - im * im) / size), float(-2 * re * im / size)


@pytest.mark.parametrize("order", [1, 2, 3, 5, 8, 13, 20, 40])
def test_the_realisation_is_the_textbook_fraction_and_an_all_pass(order):
    x = np.array([0.01, 0.3, 1.0, 4.0, 20.0, 100.0])
    model = pade(0.5, order)
    found = response(model, x / 0.5)
    expected = np.array([complex(*exact_phase_error(v, order)) for v in x])
    assert np.abs(found - expected).max() < 2e-14 * order
    assert np.abs(np.abs(response(model)) - 1).max() < 1e-13
    assert model.is_stable()
    # balanced: both Gramians are the identity
    assert np.abs(model.A + model.A.T + model.B @ model.B.T).max() < 1e-12 * np.abs(model.A).max()


@pytest.mark.parametrize("order", [0, 1, 2, 3, 4, 6, 9, 15, 25, 40])
def test_the_bound_and_the_weight_exceed_the_true_error(order):
    x = np.sort(np.concatenate([np.geomspace(1e-3, 1e3, 1500), np.linspace(0.1, 80, 3000)]))
    turn = np.exp(-1j * x)
    error = np.abs(turn - response(pade(1.0, order), x))
    assert (error <= np.minimum(2.0, phase_bound(order) * x ** (2 * order + 1)) + 1e-13).all()
    for k in {1, min(3, 2 * order + 1), 2 * order + 1 if order < 5 else 3}:
        weight = error_weight(order, k)
        size = np.abs(response(weight.scaled(1.0), x))
        assert (error <= size + 1e-13).all()
        formula = weight.gain * x**k / np.sqrt(x ** (2 * k) + weight.corner ** (2 * k))
        assert size == pytest.approx(formula, rel=1e-6)
    # tight: somewhere the default weight is within 1 % of it, except where slopes are equal
    if order > 1:
        near = error > 1e-6
        size = np.abs(response(error_weight(order, 3).scaled(1.0), x))
        assert (size[near] / error[near]).min() < 1.01


@pytest.mark.parametrize("order", [4, 5, 6, 9])
def test_a_range_from_zero_to_twice_the_delay_is_covered_in_every_order(order):
    cover = rl.with_delays(LAG, inputs={0: (0.0, 0.8)}, order=order)
    (block,) = cover.blocks
    weight = error_weight(order, 3, 1.0).scaled(0.4)
    # Padé's coefficients from the textbook, (2n - k)! / (2n)! times n over k
    den = [factorial(2 * order - k) * comb(order, k) / factorial(2 * order) for k in range(order + 1)]
    for w in np.geomspace(0.01, 300.0, 60):
        q = np.polyval(den[::-1], 0.4j * w)
        missed = np.exp(-1j * w * np.linspace(0.0, 0.8, 41)) - q.conjugate() / q
        size = abs(response(weight, [w])[0])
        assert np.abs(missed).max() <= size
        member = cover.response([w], {block.name: complex(missed[-1] / response(weight, [w])[0])})[0, 0, 0]
        assert member == pytest.approx(np.exp(-0.8j * w) / (1 + 1j * w), abs=1e-9)


def test_an_uncertain_model_with_a_delay_in_a_range():
    plant = rl.parametric([["-1/T"]], [["1/T"]], [[1]], [[0]], {"T": (1.0, 0.2)})
    late = rl.with_delays(plant, inputs={"u1": (0.1, 0.3)}, outputs={0: 0.2})
    known, ranged = "delay of 0.2 s (order 3, slope 3)", "u1: spread 1 of 0.2 s +- 0.1 s"
    assert {b.name for b in late.blocks} == {"T", known, ranged}
    w, rational = 3.0, response(pade(0.2, 3), [3.0])[0]
    turn, true = np.exp(-0.2j * w), np.exp(-0.14j * w)
    delta = {
        "T": 0.5,
        known: complex((turn - rational) / response(error_weight(3, 3).scaled(0.2), [w])[0]),
        ranged: complex((true - rational) / response(error_weight(3, 3, 0.1 / 0.2).scaled(0.2), [w])[0]),
    }
    assert all(abs(d) <= 1 for d in delta.values())
    expected = turn * true / (1 + 1j * w * plant.physical({"T": 0.5})["T"][0])
    assert late.response([w], delta)[0, 0, 0] == pytest.approx(expected, abs=1e-12)
    with pytest.raises(InputError, match="range of such"):
        rl.with_delays(plant, inputs={0: (0.3, 0.1)})


# --- over time: the method of steps by hand, superposition, and shifts ------------------------------------------------


INTEGRATOR = rl.StateSpaceModel([[0.0]], [[1.0]], [[1.0]], [[0.0]])


def test_delays_of_input_and_output_are_exact_for_any_sampling():
    t = np.sort(np.random.default_rng(1).uniform(0, 5, 60))
    t[0] = 0.0
    model = rl.with_delays(LAG, inputs={0: 0.31}, outputs={0: 0.47})
    y = rl.simulate(model, t, np.ones(60))["y1"]
    assert np.abs(y - np.where(t > 0.78, 1 - np.exp(-(t - 0.78)), 0.0)).max() < 1e-14


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_a_delay_of_whole_samples_is_a_shift(hold):
    t, rng = np.linspace(0, 4, 81), np.random.default_rng(2)
    u = rng.normal(size=81)
    u[0] = 0.0
    plain = rl.simulate(LAG, t, u, hold=hold)["y1"]
    model = rl.with_delays(LAG, inputs={0: 0.2}, outputs={0: 0.1})
    late = rl.simulate(model, t, u, hold=hold)["y1"]
    assert np.abs(late[6:] - plain[:-6]).max() < 1e-13
    assert np.abs(late[:6]).max() < 1e-13


def by_hand(k: float, tau: float, steps: int) -> list[Polynomial]:
    """x' = k (1 - x(t - tau)), x = 0 before 0: a polynomial on each interval of length tau, in the time since it."""
    pieces = [Polynomial([0.0, k])]  # x' = k on [0, tau]
    for _ in range(steps - 1):
        pieces.append(pieces[-1](tau) + (Polynomial([k]) - k * pieces[-1]).integ())
    return pieces


@pytest.mark.parametrize(("k", "tau"), [(1.0, 1.0), (2.0, 0.5), (1.2, 1.7)])
def test_the_method_of_steps_equals_the_solution_by_hand(k, tau):
    # from r to the error e = r - x(t - tau), with x' = k e
    loop = rl.with_delays(rl.StateSpaceModel([], [], [], [[1.0]])).feedback(rl.delay(tau) @ (k * INTEGRATOR))
    t = np.linspace(0, 6 * tau, 151)
    piece = np.minimum((t / tau + 1e-9).astype(int), 5)
    x = by_hand(k, tau, 6)
    late = [x[p - 1](s - p * tau) if p else 0.0 for p, s in zip(piece, t, strict=True)]
    assert np.abs(rl.simulate(loop, t, np.ones(151))["y1"] - (1.0 - np.array(late))).max() < 1e-10


def test_a_loop_of_a_lag_and_a_delay_against_its_series():
    # y = sum over reflections of (-1)^m (k e^(-s tau) / (s + 1))^(m+1) / s, each a delayed polynomial times e^-t
    from math import factorial

    k, tau, t = 2.5, 0.7, np.linspace(0, 5, 101)
    expected = np.zeros_like(t)
    for m in range(1, 9):
        s = np.maximum(t - m * tau, 0.0)
        step = 1.0 - np.exp(-s) * sum(s**i / factorial(i) for i in range(m))
        expected += (-1) ** (m - 1) * k**m * np.where(t > m * tau, step, 0.0)
    y = rl.simulate((k * LAG @ rl.delay(tau)).feedback(), t, np.ones(101))["y1"]
    assert np.abs(y - expected).max() < 1e-9


def test_a_neutral_loop_repeats_its_jumps():
    # y = e, e(t) = r - 0.5 e(t - 1): a staircase, jumps on every echo
    loop = rl.StateSpaceModel([], [], [], [[1.0]])
    model = rl.with_delays(loop).feedback(0.5 * rl.delay(1.0))
    t = np.linspace(
        0, 14.7, 50
    )  # few echoes coincide with samples, and there are more of them than orders of smoothness
    y = rl.simulate(model, t, np.ones(50))["y1"]
    steps = np.floor(t + 1e-9)
    assert np.abs(y - (1 - (-0.5) ** (steps + 1)) / 1.5).max() < 1e-12


def integrated(A, B, C, d, delays, t):
    """x' = A x + B [w, 1], z = C x + d, w_i = z_i(t - tau_i), by Runge-Kutta from one kink to the next."""
    n, ends = len(delays), {0.0, float(t[-1])}
    for counts in np.ndindex(*(40,) * n):
        ends.add(float(np.dot(counts, delays)))
    ends = sorted(e for e in ends if e <= t[-1])
    pieces: list = []

    def z(i, s):
        if s < 0:
            return 0.0
        k = min(max(int(np.searchsorted(ends, s, side="right")) - 1, 0), len(pieces) - 1)
        return float(C[i] @ pieces[k](s) + d[i])

    x = np.zeros(len(A))
    for a, b in pairwise(ends):
        middle = 0.5 * (a + b)

        def rate(s, x, middle=middle):
            inner = s + 1e-12 * (middle - s)  # the limit of a jump from inside this piece
            w = [z(i, inner - tau) for i, tau in enumerate(delays)]
            return A @ x + B @ np.array([*w, 1.0])

        found = solve_ivp(rate, (a, b), x, method="DOP853", rtol=1e-12, atol=1e-12, dense_output=True)
        pieces.append(found.sol)
        x = found.y[:, -1]
    return np.array([pieces[min(max(int(np.searchsorted(ends, s)) - 1, 0), len(pieces) - 1)](s) for s in t])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_two_delays_in_loops_against_runge_kutta(seed):
    rng = np.random.default_rng(seed)
    A, B, C = rng.normal(size=(3, 3)) - 2 * np.eye(3), rng.normal(size=(3, 3)), rng.normal(size=(2, 3))
    d, delays, t = rng.normal(size=2), np.array([0.31, 0.47]), np.linspace(0, 3, 31)
    D = np.zeros((5, 3))
    D[:2, 2] = d
    model = DelayedModel(rl.StateSpaceModel(A, B, np.vstack([C, np.eye(3)]), D), delays)
    record = rl.simulate(model, t, np.ones(31))
    y = np.column_stack(list(record.outputs.values()))
    expected = integrated(A, B, C, d, delays, t)
    assert np.abs(y - expected).max() < 1e-9 * max(1.0, np.abs(expected).max())


@pytest.mark.parametrize("late", [0.025, 0.001, 0.0999])
def test_a_delay_shorter_than_the_sample_time_is_exact(late):
    """Compare with the sum of exponentials by hand: such a delay refers to the current cell."""
    t = np.arange(6) * 0.1
    u = np.array([1.0, -0.5, 0.0, 2.0, 0.0, 1.0])
    late_lag = rl.with_delays(LAG, inputs={0: late})
    steps = np.diff(u, prepend=0.0)
    exact = sum(
        d * np.where(t > s, 1 - np.exp(-np.maximum(t - s, 0.0)), 0.0) for d, s in zip(steps, t + late, strict=True)
    )
    assert np.abs(rl.simulate(late_lag, t, u)["y1"] - exact).max() < 1e-14
