"""Ranges that are wider on one side of nominal: search, samples, statistics and campaigns by closed forms.

The lag 1 / (s + a), a in [0.25, 1.5] around 1: a negative delta counts one and a half times in Delta.
"""

from __future__ import annotations

import numpy as np
import pytest

from robustlab import ComplexScalar, ParameterRange, RealScalar, StateSpaceModel, UncertainModel
from robustlab.campaign import CampaignSettings, WorkerOptions, run_campaign
from robustlab.worst_case_analysis import sample, violation_probability, worst_case

POLE = RealScalar("pole", parameter=ParameterRange.between(0.25, 1.5, 1.0, "1/s"))
T = np.linspace(0.0, 12.0, 601)


def lag():
    m = StateSpaceModel([[-1.0]], [[-0.5, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)), outputs=["z", ("y", "m")])
    return UncertainModel(m, [POLE])


@pytest.mark.parametrize(
    ("metric", "value"),
    [
        ("hinf", 4.0),
        ("h2", np.sqrt(2.0)),
        ("spectral-abscissa", -0.25),
        ("peak", (1 - np.exp(-3.0)) / 0.25),
        # |y - nominal| grows with time on this side, and is below 1 / 3 on the other one.
        ("peak-deviation", (1 - np.exp(-3.0)) / 0.25 - (1 - np.exp(-12.0))),
    ],
)
def test_worst_of_a_lag_is_at_its_true_end(metric, value):
    timed = {"t": T} if metric.startswith("peak") else {}
    found = worst_case(lag(), metric, n=16, **timed)
    assert found.value == pytest.approx(value, rel=1e-9)
    assert found.delta == {"pole": -1.0}
    assert found.physical == {"pole": (0.25, "1/s")}


@pytest.mark.slow
def test_with_a_complex_block_the_entry_keeps_its_sign():
    """(1 + 0.2 d) / (s + a), |d| <= 1: 4 * 1.2."""
    d = np.zeros((3, 3))
    d[2, 1] = 0.2
    m = StateSpaceModel([[-1.0]], [[-0.5, 0.0, 1.0]], [[1.0], [1.0], [1.0]], d)
    found = worst_case(UncertainModel(m, [POLE, ComplexScalar("d")]), "hinf", n=64)
    assert found.value == pytest.approx(4.8, rel=1e-6)
    assert found.physical["pole"][0] == pytest.approx(0.25, abs=1e-6)


# --- samples ---------------------------------------------------------------------------------------------------------


def poles(samples):
    return np.array([-model.A[0, 0] for model in samples.models()])


def test_vertices_are_the_ends():
    np.testing.assert_array_equal(poles(sample(lag(), 0, vertices="all")), [0.25, 1.5])


def test_all_methods_give_the_same_member(tmp_path):
    model = lag()
    samples = sample(model, 40, seed=2)
    wanted = poles(samples)
    assert wanted == pytest.approx([POLE.parameter.value(delta["pole"]) for delta in samples.deltas], rel=1e-14)
    np.testing.assert_allclose(violation_probability(model, "hinf", 2.0, n=40, seed=2).values, 1 / wanted, rtol=1e-9)
    table = run_campaign(
        model, CampaignSettings("hinf", 40, seed=2), tmp_path / "s.sqlite", workers=WorkerOptions(1)
    ).table()
    np.testing.assert_allclose(table.columns["hinf"], 1 / wanted, rtol=1e-9)
    np.testing.assert_array_equal(table.columns["pole"], [delta["pole"] for delta in samples.deltas])


def test_probability_is_that_of_the_range():
    """1 / a > 2 for a < 0.5: a fifth of [0.25, 1.5] (a sixth of the deltas, were they uniform in [-1, 1])."""
    found = violation_probability(lag(), "hinf", 2.0, n=4000, seed=1)
    assert found.lower < 0.2 < found.upper
    assert not found.lower < 1 / 6 < found.upper
    assert found.worst_value == pytest.approx(1 / POLE.parameter.value(found.worst_delta["pole"]), rel=1e-9)
