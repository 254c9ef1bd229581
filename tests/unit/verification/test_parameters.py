"""Models with time-varying parameters: known gains, and failures between the points of a grid."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.evidence import claims_of
from robustlab.verification import Claim, Outcome, check


def lag(a):
    return [[-a, a], [1.0, 0.0]]


def lags(P, gamma, points=(1.0, 4.0), rate=np.inf, **more):
    """x' = a (u - x), y = x: every frozen one has the gain 1; where a jumps between 1 and 4, the least gain is 5/4."""
    numbers = {
        "points0": np.array(points), "M": np.array([lag(a) for a in points]), "n": np.array(1),
        "rate": np.array([rate]), "P": np.array(P, float).reshape(-1, 1, 1), "gamma": np.array(gamma),
    }  # fmt: skip
    return Claim("lpv-gain", numbers | more)


def outcome(made, **changed):
    return check(Claim(made.kind, {**made.numbers, **{k: np.asarray(v) for k, v in changed.items()}})).outcome


def test_the_gain_of_a_lag_that_is_switched():
    assert check(lags([0.5], 1.25 * (1 + 1e-9))).outcome is Outcome.PROVED
    assert check(lags([0.5], 1.25 * (1 - 1e-9))).outcome is Outcome.NOT_PROVED
    for p in np.linspace(0.3, 0.8, 51):
        assert check(lags([p], 1.2499)).outcome is Outcome.NOT_PROVED
    assert check(lags([-0.5], 1.3)).outcome is Outcome.NOT_PROVED


def test_products_of_varying_parameters_are_tested_between_grid_points():
    # P = 1/a proves a gain of one for each frozen lag; between a = 1 and 4 the straight line is far from it.
    assert check(lags([1.0, 0.25], 1.01, rate=0.0)).outcome is Outcome.NOT_PROVED
    points = np.geomspace(1.0, 4.0, 9)
    assert check(lags(1 / points, 1.02, points, rate=0.0)).outcome is Outcome.PROVED


def test_a_rate_counts_with_either_sign():
    points = np.geomspace(1.0, 4.0, 9)
    for rate, expected in ((0.01, Outcome.PROVED), (3.0, Outcome.NOT_PROVED)):
        assert check(lags(1 / points, 1.05, points, rate)).outcome is expected
        assert (
            check(lags(1 / points[::-1], 1.05, -points[::-1], rate, M=np.array([lag(a) for a in points[::-1]]))).outcome
            is expected
        )
    assert "rate" in check(lags(1 / points, 1.1, points, np.inf)).where


def test_a_deviation_is_allowed_for():
    # a in 1 +- e at both ends is a in [1 - e, 4 + e]; with E in the row of x alone, u and x by the same sign or not.
    made = lags([0.5], 1.5)
    assert outcome(made) is Outcome.PROVED
    few, many = np.zeros((1, 2, 2)), np.full((1, 2, 2), 0.02)
    few[0, 0, 0] = 0.02
    assert outcome(made, deviation=few) is Outcome.PROVED
    assert outcome(made, deviation=many) is Outcome.PROVED
    assert outcome(made, deviation=40 * few) is Outcome.NOT_PROVED
    assert outcome(made, deviation=40 * many) is Outcome.NOT_PROVED
    assert outcome(made, deviation=-few) is Outcome.NOT_PROVED


@pytest.mark.parametrize("rate", [0.1, 1.0, np.inf])
def test_results_about_lags(rate):
    model = rl.LPVModel({"a": [1.0, 4.0]}, [rl.StateSpaceModel([[-a]], [[a]], [[1.0]], [[0.0]]) for a in (1.0, 4.0)])
    found = rl.peak_gain(model.refined(4).with_rates(a=rate))
    (made,) = claims_of(found)
    assert check(made).outcome is Outcome.PROVED
    assert check(made).bound == pytest.approx(found.upper, rel=2e-6)
    assert outcome(made, gamma=0.999 * found.upper) is Outcome.NOT_PROVED
    if np.isfinite(rate):
        assert outcome(made, rate=[5 * rate]) is Outcome.NOT_PROVED


def test_two_parameters_with_a_proved_deviation():
    spring = rl.parametric(
        [[0, 1], ["-k/m", "-c"]], [[0], ["1/m"]], [[1, 0]], [[0]], {"k": (2.0, 0.1), "c": 1.0, "m": (1.0, 0.05)}
    )
    found = rl.peak_gain(rl.lpv_model(spring, {"k": 2, "m": 2}))
    (made,) = claims_of(found)
    assert made.numbers["deviation"].any()
    assert check(made).outcome is Outcome.PROVED
    assert outcome(made, deviation=20 * made.numbers["deviation"]) is Outcome.NOT_PROVED


def vertex(a, b=1.0):
    """x' = a x + w1 + b u, z = (x, u), y = x + w2: at a = 0 no controller gets below the root of two."""
    return rl.StateSpaceModel([[a]], [[1, 0, b]], [[1], [0], [1]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])


def test_a_scheduled_loop_is_that_of_plant_and_controller():
    design = rl.hinf(rl.LPVModel({"a": [-2.0, 0.0]}, [vertex(-2.0), vertex(0.0)]), n_meas=1, n_con=1)
    (made,) = claims_of(design)
    assert check(made).outcome is Outcome.PROVED
    assert outcome(made, gamma=np.sqrt(2) * (1 - 1e-9)) is Outcome.NOT_PROVED
    assert outcome(made, K=-made.numbers["K"]) is Outcome.NOT_PROVED
    M = made.numbers["M"].copy()
    M[0, 0, 3] *= 1 + 1e-12  # B2 of one point: the loop bends between the points
    assert "B2" in check(Claim(made.kind, made.numbers | {"M": M})).where
    M = made.numbers["M"].copy()
    M[:, 3, 3] = 1e-12
    assert "D22" in check(Claim(made.kind, made.numbers | {"M": M})).where


@pytest.mark.slow
def test_no_claim_without_a_proof_between_the_points():
    model = rl.lpv_model(lambda a: rl.StateSpaceModel([[-(a**2)]], [[1.0]], [[1.0]], [[0.0]]), {"a": [1.0, 1.5, 2.0]})
    assert model.known == "sampled"
    assert claims_of(rl.peak_gain(model)) == []
    bending = rl.LPVModel({"a": [-2.0, 0.0]}, [vertex(-2.0, 1.1), vertex(0.0)])
    assert claims_of(rl.hinf(bending, n_meas=1, n_con=1)) == []
