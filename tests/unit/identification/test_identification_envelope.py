"""Coverage of a record by the envelope of an uncertain model's members: closed forms of a first-order lag."""

import numpy as np
import pytest

import robustlab as rl
from robustlab import ComplexScalar, RealScalar, UncertainModel
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification import cover
from robustlab.result import Status

T = np.linspace(0.0, 5.0, 1001)
STEP = (T >= 0.5).astype(float)  # rest first: the initial state is then known
RISE = np.where(T >= 0.5, 1 - np.exp(-(T - 0.5)), 0.0)
END = 1 - np.exp(-4.5)


def gain(radius: float) -> UncertainModel:
    """y' = -y + (1 + radius delta) u: the step response is 1 + radius delta times RISE."""
    M = rl.StateSpaceModel(
        [[-1.0]], [[radius, 1.0]], [[0.0], [1.0]], [[0.0, 1.0], [0.0, 0.0]], 0.0, ["w", "u"], ["z", "y"]
    )
    return UncertainModel(M, [RealScalar("gain")])


def record(size: float) -> rl.Record:
    return rl.Record(T, {"u": STEP}, {"y": size * RISE}, {"u": "V", "y": "m"}, "lag")


def test_a_member_is_covered_and_its_error_is_known():
    found = cover(gain(0.2), record(1.15), n=0, vertices=2)
    y = found.signals["y"]
    assert found.status is Status.CONVERGED
    assert found.covered
    assert (y.share, y.miss, y.miss_side) == (1.0, 0.0, "")
    assert np.isnan(y.miss_time)
    assert y.gap == pytest.approx(0.15 * END)
    assert y.reach == pytest.approx(0.2 * END)
    assert y.gap_percent == pytest.approx(100 * 0.15 / 1.15)


@pytest.mark.parametrize(("size", "side"), [(1.3, "above"), (0.7, "below")])
def test_a_miss_has_size_side_and_time(size, side):
    found = cover(gain(0.2), record(size), n=0, vertices=2)
    y = found.signals["y"]
    assert not found.covered
    assert y.miss == pytest.approx(0.1 * END)
    assert (y.miss_side, y.miss_time) == (side, pytest.approx(5.0))
    assert y.share == pytest.approx(101 / 1001)  # the rest at the start, where nothing has moved yet
    assert f"{side} at 5 s" in found.summary()


def test_the_allowance_is_the_error_bound_of_the_sensor():
    bare, allowed = (cover(gain(0.2), record(1.3), n=0, vertices=2, allowance=a) for a in (None, {"y": 0.0501}))
    assert allowed.signals["y"].miss == pytest.approx(bare.signals["y"].miss - 0.0501, abs=1e-9)
    # inside while 0.1 (1 - exp(-(t - 0.5))) <= 0.0501
    assert allowed.signals["y"].share == pytest.approx((0.5 - np.log(1 - 0.501)) / 5.0, abs=2e-3)
    assert cover(gain(0.2), record(1.3), n=0, vertices=2, allowance={"y": 0.101}).covered


def test_the_rate_is_the_mean_rate():
    """From the step on, the mean rate over 0.5 s is (1 - exp(-0.5)) / 0.5 exp(-(t - 0.5)), t the window's start."""
    found = cover(gain(0.2), record(1.3), n=0, vertices=2, rate=0.5, allowance={"y": 0.01})
    rate = found.signals["y-rate"]
    moving = rate.t >= 0.75 - 1e-9
    factor = (1 - np.exp(-0.5)) / 0.5 * np.exp(-(rate.t[moving] - 0.75))
    np.testing.assert_allclose(rate.measured[moving], 1.3 * factor, rtol=1e-9)
    np.testing.assert_allclose(rate.upper[moving], 1.2 * factor, rtol=1e-9)
    assert rate.unit == "m/s"
    assert rate.allowance == pytest.approx(0.04)
    assert rate.miss == pytest.approx(0.1 * factor[0] - 0.04)
    assert rate.miss_time == pytest.approx(0.75)


# --- bad input -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"allowance": {"Y": 0.1}}, "no such compared output"),
        ({"allowance": {"y": -0.1}}, "not negative"),
        ({"allowance": {"y": float("nan")}}, "not negative"),
        ({"rate": 1e-9}, "rate over"),
        ({"rate": 4.0}, "rate over"),
        ({"rate": float("inf")}, "rate over"),
        ({"n": 0}, "no samples and no vertices"),
    ],
)
def test_bad_options(options, message):
    with pytest.raises(InputError, match=message):
        cover(gain(0.2), record(1.0), **options)


def test_a_plant_and_a_complex_set_are_refused():
    with pytest.raises(InputError, match="expected an UncertainModel"):
        cover(rl.plant("dc-motor"), record(1.0))
    complex_set = UncertainModel(gain(0.2).M, [ComplexScalar("gain")])
    with pytest.raises(InputError, match="is complex"):
        cover(complex_set, record(1.0))


def test_a_member_that_exceeds_double_precision():
    M = rl.StateSpaceModel(
        [[400.0]], [[0.2, 1.0]], [[0.0], [1.0]], [[0.0, 1.0], [0.0, 0.0]], 0.0, ["w", "u"], ["z", "y"]
    )
    with pytest.raises(NoTrustworthyNumber, match="exceeds double precision"):
        cover(UncertainModel(M, [RealScalar("gain")]), record(1.0), n=2)


def test_signals_and_clock_that_do_not_fit():
    with pytest.raises(InputError, match="no input 'u'"):
        cover(gain(0.2), rl.Record(T, {"v": T}, {"y": T}))
    with pytest.raises(InputError, match="no output in common"):
        cover(gain(0.2), rl.Record(T, {"u": T}, {"q": T}))
    with pytest.raises(InputError, match="not uniform"):
        cover(gain(0.2), rl.Record(T**2, {"u": T}, {"y": T}))
