"""Every metric: closed forms, a second method, independence of batches."""

from __future__ import annotations

import numpy as np
import pytest

from robustlab import (
    ComplexScalar,
    InputError,
    NoTrustworthyNumber,
    ParameterRange,
    RealScalar,
    StateSpaceModel,
    UncertainModel,
    elementwise,
)
from robustlab.errors import UsageError
from robustlab.result import plain
from robustlab.worst_case_analysis import METRICS, make_metric, sample, violation_probability, worst_case

T = np.linspace(0.0, 12.0, 601)


def random_set(seed, dt=0.0):
    """Four stable states, two inputs and outputs, three real parameters with ranges to all sides, D11 not zero."""
    rng = np.random.default_rng(seed)
    a = rng.standard_normal((4, 4))
    a -= (np.linalg.eigvals(a).real.max() + 0.5) * np.eye(4)
    if dt:
        a = np.linalg.inv(np.eye(4) - a * dt / 2) @ (np.eye(4) + a * dt / 2)
    d = 0.1 * rng.standard_normal((7, 7))
    d[5:] = 0.0  # no direct feedthrough: the H2 norm is finite
    m = StateSpaceModel(a, 0.3 * rng.standard_normal((4, 7)), 0.5 * rng.standard_normal((7, 4)), d, dt)
    wide_below, wide_above = ParameterRange(1.0, 0.2, below=0.36), ParameterRange(1.0, 0.5, below=0.2)
    return UncertainModel(m, [RealScalar("a", 2, wide_below), RealScalar("b", 1, wide_above), RealScalar("c", 2)])


def request(metric, model, hold="zoh"):
    t = 0.1 * np.arange(120)
    u = np.random.default_rng(5).standard_normal((120, 2))
    if metric in ("overshoot", "settling-time"):
        t, u = 0.1 * np.arange(1500), {model.inputs[0].name: 1.0}
    return {"metric": metric, "output": model.outputs[0].name, "t": t, "u": u, "hold": hold}


@pytest.mark.parametrize(("dt", "hold"), [(0.0, "zoh"), (0.0, "foh"), (0.1, "zoh")])
@pytest.mark.parametrize("metric", METRICS)
def test_both_methods_agree(metric, dt, hold):
    model = random_set(2, dt)
    arguments = request(metric, model, hold)
    values = violation_probability(model, limit=1.0, n=8, seed=1, **arguments).values
    assert np.isfinite(values).sum() > 2
    judge = make_metric(model, **arguments)
    for value, delta in zip(values, sample(model, 8, seed=1).deltas, strict=True):
        assert judge.agrees(value, judge.evaluate(delta).value)


# --- closed forms ----------------------------------------------------------------------------------------------------


def lag(radius=0.2):
    """1 / (s + 1 + radius delta)."""
    m = StateSpaceModel([[-1.0]], [[-radius, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)), outputs=["z", ("y", "m")])
    return UncertainModel(m, [RealScalar("pole")])


def oscillator(zeta=0.3, change=0.1):
    """w^2 / (s^2 + 2 zeta s + 1) with w = 1 and the damping ratio in zeta +- change."""

    def model(z):
        return StateSpaceModel([[0.0, 1.0], [-1.0, -2 * z]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], outputs=["q"])

    return elementwise(model(zeta), model(zeta + change))


def test_peak_of_a_lag():
    found = worst_case(lag(), "peak", t=T)
    assert found.value == pytest.approx((1 - np.exp(-0.8 * 12)) / 0.8, rel=1e-9)
    assert (found.unit, found.at, found.delta) == ("m", 12.0, {"pole": -1.0})


def test_settling_time_of_a_lag():
    assert worst_case(lag(), "settling-time", t=T).value == pytest.approx(np.log(50) / 0.8, abs=2e-4)
    assert worst_case(lag(), "settling-time", t=T, band=0.05).value == pytest.approx(np.log(20) / 0.8, abs=2e-4)


def test_overshoot_of_an_oscillator():
    found = worst_case(oscillator(), "overshoot", t=np.linspace(0, 20, 2001))
    zeta = 0.2
    assert found.value == pytest.approx(100 * np.exp(-np.pi * zeta / np.sqrt(1 - zeta**2)), rel=1e-4)
    assert found.unit == "%"
    assert worst_case(lag(), "overshoot", t=T).value == 0.0


def test_damping_is_smallest_where_it_is_worst():
    found = worst_case(oscillator(), "damping")
    assert found.value == pytest.approx(0.2, rel=1e-9)
    assert found.nominal_value == pytest.approx(0.3)
    assert found.label.startswith("sampled: an upper bound")


def test_a_function_of_the_model():
    def static_gain(model):
        return float(model.dc_gain()[0, 0])

    found = worst_case(lag(), static_gain)
    assert (found.metric, found.value) == ("static_gain", pytest.approx(1.25))


# --- unbounded values ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("metric", ["settling-time", "overshoot", "h2", "hinf"])
def test_unstable_members_are_reported(metric):
    found = worst_case(lag(1.5), metric, t=T)
    assert plain(found)["value"] == "inf"
    assert found.spectral_abscissa > 0
    assert "no bounded value" in found.label
    if metric == "settling-time":
        assert "unstable and never settles" in found.label


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda: worst_case(lag(), "settlingtime"), UsageError, "did you mean settling-time"),
        (lambda: worst_case(lag(), 3), UsageError, "the name of a metric, or a function"),
        (lambda: worst_case(lag(), "settling-time", t=T, band=2.0), InputError, "band: 2.0"),
        (lambda: worst_case(lag(), "overshoot", t=T, u=np.sin(T)), InputError, "an input that changes"),
        (lambda: worst_case(lag(), "overshoot", t=T, u=0 * T), NoTrustworthyNumber, "settles at 0"),
    ],
)
def test_invalid_requests_are_rejected(call, error, text):
    with pytest.raises(error) as caught:
        call()
    assert text in str(caught.value)


def test_metrics_without_their_requirements_are_rejected():
    free = StateSpaceModel([[0.0, 1.0], [0.0, -1.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    direct = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[1.0]])
    gain = StateSpaceModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[1.0]])
    for model, metric, text in [
        (free, "overshoot", "not asymptotically stable"),
        (direct, "h2", "direct term"),
    ]:
        with pytest.raises(NoTrustworthyNumber, match=text):
            worst_case(elementwise(model, model), metric, t=T)
    with pytest.raises(InputError, match="states"):
        worst_case(elementwise(gain, gain), "damping", t=T)
    m = StateSpaceModel([[-1.0]], [[0.5, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
    for metric in ("h2", "rms"):
        with pytest.raises(InputError, match="complex"):
            worst_case(UncertainModel(m, [ComplexScalar("d")]), metric, t=T)


# --- the search against brute force ----------------------------------------------------------------------------------


def test_search_against_brute_force_in_two_parameters():
    """A resonance whose stiffness and damping vary: a fine grid over the square is the truth."""

    def model(k, c):
        return StateSpaceModel([[0.0, 1.0], [-k, -c]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])

    u, t = np.sin(2.1 * np.linspace(0, 10, 201)), np.linspace(0, 10, 201)
    family = elementwise(model(4.0, 0.4), model(5.5, 0.6))
    grid = np.linspace(-1, 1, 61)
    points = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    for metric in ("peak-deviation", "rms"):
        judge = make_metric(family, metric, t=t, u=u)
        brute = judge.of(judge.set.members(points)).max()
        found = worst_case(family, metric, t=t, u=u, n=32)
        assert found.value >= brute * (1 - 1e-9)


# --- independence of the number of samples ---------------------------------------------------------------------------


@pytest.mark.parametrize("metric", METRICS)
def test_a_sample_has_one_value_whatever_their_number(metric):
    model = random_set(2)

    def values(n, seed=3):
        return violation_probability(model, limit=1.0, n=n, seed=seed, **request(metric, model)).values

    whole = values(530)
    for n in (1, 7, 516):
        np.testing.assert_array_equal(values(n), whole[:n])
    if metric != "overshoot":  # which is zero in this set
        assert not np.array_equal(values(5, seed=4), whole[:5])
