"""Integral quadratic constraints: tight bounds, and multipliers outside of their class."""

import numpy as np
import pytest
import verify_cases as cases

import robustlab as rl
from robustlab.evidence import claims_of
from robustlab.verification import Claim, Outcome, check

ONE = np.ones((1, 1))


def claim(kind, model, block_types, ranges, P, multipliers, **more):
    """Scalar real blocks of these kinds ``(kind, odd, steady)``, without slope and rate where none is given."""
    k = len(block_types)
    numbers = dict(zip("ABCD", (np.array(X, float) for X in model), strict=True)) | {
        "dt": np.array(0.0), "blocks": np.array([[0, 1, 1]] * k), "nature": np.array(block_types),
        "ranges": np.array(ranges, float), "slope": np.zeros((k, 2)), "rate": np.full(k, np.inf),
        "pole": np.array(1.0), "order": np.array(0), "P": np.array(P, float),
        "multipliers": np.array(multipliers, float),
    }  # fmt: skip
    return Claim(kind, numbers | {name: np.asarray(value) for name, value in more.items()})


def outcome(made, **changed):
    return check(Claim(made.kind, {**made.numbers, **{k: np.asarray(v) for k, v in changed.items()}})).outcome


VARYING = (1, 0, 0)
LAG = ([[-1.0]], ONE, ONE, 0 * ONE)


def test_a_lag_whose_rate_varies_is_stable_up_to_the_rate_itself():
    # x' = -x + delta x is stable for all |delta| < 1: 2 P x^2 - X (x^2 - w^2) - 2 s P x w > 0 with P = X = 1 iff s < 1.
    made = claim("iqc-size", LAG, [VARYING], [(-1, 1)], ONE, [1.0], size=1 - 1e-9)
    assert outcome(made) is Outcome.PROVED
    assert check(made).bound == 1 - 1e-9
    assert outcome(made, size=1.0) is Outcome.NOT_PROVED
    assert outcome(made, multipliers=[-1.0]) is Outcome.NOT_PROVED
    assert outcome(made, P=-ONE) is Outcome.NOT_PROVED
    assert outcome(made, A=ONE, P=-ONE) is Outcome.REFUTED  # the middle itself is unstable


def test_the_worst_gain_of_that_lag():
    # y = x, x' = -x + delta x + u, |delta| <= 1/2: the gain of delta = 1/2 is 2; P = 2 and X = 1 prove it.
    model = [[-1.0]], [[1.0, 1.0]], [[1.0], [1.0]], np.zeros((2, 2))
    made = claim("iqc-gain", model, [VARYING], [(-0.5, 0.5)], [[2.0]], [1.0], gamma=2 * (1 + 1e-9))
    assert outcome(made) is Outcome.PROVED
    assert outcome(made, gamma=2 * (1 - 1e-9)) is Outcome.NOT_PROVED
    # The same about a middle that is not zero: x' = -1.25 x + (1/4 + delta) x + u.
    moved = outcome(made, A=[[-1.25]], ranges=[[-0.25, 0.75]])
    assert moved is Outcome.PROVED


def lure(num, den):
    n = len(den) - 1
    A = np.vstack([np.hstack([np.zeros((n - 1, 1)), np.eye(n - 1)]), -np.array(den[:0:-1]) / den[0]])
    b, c = np.eye(n)[:, -1:], np.zeros((1, n))
    c[0, : len(num)] = num[::-1]
    return rl.StateSpaceModel(A, np.hstack([-b, b]), c, np.zeros((1, 2)), 0.0, ["u", "d"], ["y"])


CUBE = lure([1.0], [1.0, 3.0, 3.0, 1.0])  # 1 / (s + 1)^3
O_SHEA = lure([1.0, -0.2, -0.1], [1.0, 2.0, 1.0, 1.0])


def test_the_circle_criterion_of_the_largest_sector():
    """A law that changes in time in [c - s h, c + s h]: Re (1 + b G) conj(1 + a G) > 0 at all frequencies."""
    w = np.linspace(0, 50, 200_001)
    G = 1 / (1 + 1j * w) ** 3
    low, high = 1.0, 1.2
    for _ in range(50):
        s = 0.5 * (low + high)
        a, b = 1.95 * (1 - s), 1.95 * (1 + s)
        low, high = (s, high) if ((1 + b * G) * np.conj(1 + a * G)).real.min() > 0 else (low, s)
    found = rl.robust_stability(CUBE, block_types={("y", "u"): rl.Nonlinearity((0.0, 3.9), steady=False)})
    assert 0.998 * low < found.lower < low
    (made,) = claims_of(found)
    assert check(made).outcome is Outcome.PROVED
    assert outcome(made, size=1.0001 * low) is Outcome.NOT_PROVED
    assert outcome(made, ranges=made.numbers["ranges"] * 1.01) is Outcome.NOT_PROVED


def popov():
    # Popov: stable up to the sector [0, 8), where the circle criterion ends at 4.
    return claims_of(rl.robust_stability(CUBE, block_types={("y", "u"): rl.Nonlinearity((0.0, 7.9))}))[0]


def test_popovs_multiplier_is_for_steady_laws_of_a_signal_without_direct_term():
    made = popov()
    assert check(made).outcome is Outcome.PROVED
    assert made.numbers["multipliers"].shape == (2,)
    assert "multipliers" in check(Claim(made.kind, made.numbers | {"nature": np.array([[2, 0, 0]])})).where
    direct = made.numbers | {"D": np.full((1, 1), 1e-9)}
    assert "at once" in check(Claim(made.kind, direct)).where


def zames_falb(odd):
    law = rl.Nonlinearity((0.0, 4.4), (0.0, 4.4), odd=odd)
    return claims_of(rl.robust_stability(O_SHEA, block_types={("y", "u"): law}, order=3))[0]


@pytest.mark.slow
def test_zames_falb_up_to_kalmans_limit():
    """Kalman's conjecture holds for three states: the limit of all slopes is that of linear gains, 4.5894."""
    made = zames_falb(odd=True)
    assert check(made).outcome is Outcome.PROVED
    assert 2.2 * (1 + made.numbers["size"]) < 4.5895
    assert outcome(made, nature=[[3, 0, 1]]) is Outcome.NOT_PROVED  # as if it were not odd
    assert outcome(made, slope=[[0.0, 4.3]]) is Outcome.NOT_PROVED  # the sector is not within it
    assert outcome(made, size=1.01 * made.numbers["size"]) is Outcome.NOT_PROVED


def test_a_kernel_above_its_norm_is_rejected():
    """h of the order 3: q00 + 2 q01 t + q11 t^2 and q t, times e^-t; integrals q00 + 2 q01 + 2 q11 and q."""
    made = zames_falb(odd=True)
    x = made.numbers["multipliers"]
    mass = sum(q00 + 2 * q01 + 2 * q11 + q for q00, q01, q11, q in x[3:].reshape(4, 4))
    for direct, refused in ((mass * (1 - 1e-9), True), (mass * (1 + 1e-9), False)):
        changed = made.numbers | {"multipliers": np.r_[x[:2], direct, x[3:]]}
        assert ("class" in check(Claim(made.kind, changed)).where) == refused
    assert "class" in check(Claim(made.kind, made.numbers | {"multipliers": np.r_[x[:-1], -1e-300]})).where


SPRING = rl.parametric([[0, 1], ["-k", "-c"]], [[0], [1]], [[1, 0]], [[0]], {"k": (2.0, 0.1), "c": (0.3, 0.1)})


def test_a_bound_of_the_rate():
    (made,) = claims_of(rl.peak_gain(SPRING, block_types={"k": rl.Varying(0.2)}))
    assert check(made).outcome is Outcome.PROVED
    rate = made.numbers["rate"]
    assert outcome(made, rate=rate * np.array([2.0, 1.0])) is Outcome.NOT_PROVED
    assert outcome(made, rate=np.full(2, np.inf)) is Outcome.NOT_PROVED  # it would take static multipliers
    assert outcome(made, gamma=0.99 * made.numbers["gamma"]) is Outcome.NOT_PROVED
    skew = made.numbers["multipliers"].copy()
    skew[0] = -skew[0]
    assert outcome(made, multipliers=skew) is Outcome.NOT_PROVED


@pytest.mark.parametrize("seed", [0, 1, 2, 4, 5])
def test_linear_members_never_exceed_the_proved_gain(seed):
    """Random members of a set of repeated, full and complex blocks: none has a larger gain."""
    rng = np.random.default_rng(seed)
    blocks = [rl.RealScalar("a", 2), rl.ComplexScalar("b", 1), rl.FullBlock("c", 1, 2)]
    A = rng.normal(size=(3, 3))
    A -= (np.linalg.eigvals(A).real.max() + 0.5) * np.eye(3)
    G = rl.StateSpaceModel(
        A, 0.3 * rng.normal(size=(3, 5)), 0.3 * rng.normal(size=(6, 3)), 0.05 * rng.normal(size=(6, 5))
    )
    (made,) = claims_of(rl.peak_gain(rl.UncertainModel(G, blocks), block_types={"b": rl.Varying()}, order=1))
    assert check(made).outcome is Outcome.PROVED
    assert outcome(made, multipliers=-made.numbers["multipliers"]) is Outcome.NOT_PROVED
    gamma, w = float(made.numbers["gamma"]), np.linspace(0, 5, 60)
    for _ in range(40):
        delta = np.zeros((4, 5), complex)
        delta[:2, :2] = rng.choice([-1, 1]) * np.eye(2)
        delta[2, 2] = np.exp(2j * np.pi * rng.random())
        row = rng.normal(size=2) + 1j * rng.normal(size=2)
        delta[3, 3:] = row / np.linalg.norm(row)
        for x in w:
            M = cases.response(made.numbers, x)
            inner = delta @ np.linalg.solve(np.eye(5) - M[:5, :4] @ delta, M[:5, 4:])
            assert np.linalg.norm(M[5:, 4:] + M[5:, :4] @ inner, 2) <= gamma


def test_effects_of_a_plant():
    rough = rl.with_effects(rl.plant("servo-axis"), {"input-saturation": {"u_max": 10.0}})
    K = rl.StateSpaceModel([[-300.0]], [[1.0]], [[-90000.0]], [[320.0]])
    found = rl.verify(rl.peak_gain(rough, K, outputs=["q"], amplitude={"u": 40.0}, order=1))
    assert found.proved, found.summary()
