"""Residual forces with known structure: curves and shares; and the figure."""

import numpy as np
import pytest
from scipy.signal import lfilter

from robustlab.errors import InputError
from robustlab.identification.unnamed.block_regression import held_out
from robustlab.identification.unnamed.unnamed_effect import residual_force
from robustlab.report.discovery import residual_force_figure
from robustlab.report.figures import save_figure

H = 1e-3
UNITS = {"speed": "rad/s", "position": "rad", "time": "s", "input u": "V"}


def slow_noise(rng, n, bandwidth=5.0):
    """Noise of unit variance behind a first-order low pass."""
    pole = np.exp(-2 * np.pi * bandwidth * H)
    x = lfilter([1.0], [1.0, -pole], rng.standard_normal(n + 3000))[3000:]
    return x / x.std()


def motion(seed, n=5000):
    rng = np.random.default_rng([seed, 1])
    t = H * np.arange(n)
    v = sum(rng.uniform(6, 20) * np.sin(2 * np.pi * rng.uniform(0.2, 4) * t + rng.uniform(0, 6.3)) for _ in range(8))
    u = 0.05 * v + 0.01 * np.gradient(v, H)
    return {"speed": v, "position": H * np.cumsum(v), "time": t, "input u": u}


def friction(x):
    return np.sign(x["speed"]) * (2.0 + np.exp(-np.abs(x["speed"]) / 5.0)) + 0.02 * x["speed"]


def test_curve_over_speed_has_the_friction_in_its_band_and_other_coordinates_no_share():
    inside = []
    for seed in range(5):
        x = motion(seed, 20000)
        rng = np.random.default_rng(seed)
        d = friction(x) + 0.5 * slow_noise(rng, 20000)
        found = residual_force(d, np.full(20000, 0.2), x, UNITS, unit="N m", seed=seed)
        curve = found.curves["speed"]
        truth = friction({"speed": curve.x})
        inside.append((curve.low <= truth) & (truth <= curve.high))
        assert curve.share > 0.93
        assert curve.p_value < 0.01
        assert found.curves["time"].share < 0.05
        assert found.curves["position"].share < 0.1
        assert found.joint_share >= curve.share - 0.02
        assert max(found.dry_share.values()) < 0.02
        assert found.noise_share == pytest.approx(0.2**2 / np.var(d), rel=0.1)
    assert np.mean(inside) > 0.85


def test_shares_are_of_blocks_never_seen():
    # A spline follows noise in the samples it is fitted to; held-out, it explains nothing.
    x, rng = motion(3), np.random.default_rng(0)
    for name, curve in residual_force(slow_noise(rng, 5000), np.ones(5000), x).curves.items():
        assert curve.share < 0.1, name


def test_units_do_not_matter():
    x = motion(5)
    d = friction(x) + slow_noise(np.random.default_rng(5), 5000)
    one = residual_force(d, np.full(5000, 0.3), x)
    tiny = residual_force(1e-9 * d, np.full(5000, 3e-10), {k: 1e6 * v for k, v in x.items()})
    for name in one.curves:
        assert tiny.curves[name].share == pytest.approx(one.curves[name].share, abs=1e-6)


def test_folds_hold_out_every_block_once():
    assert (held_out(25).sum(axis=0) == 1).all()


def test_figure(tmp_path):
    x = motion(1)
    d = friction(x) + 0.3 * slow_noise(np.random.default_rng(1), 5000)
    residual = residual_force(d, np.full(5000, 0.1), x, UNITS, unit="N m")
    figure, again = (residual_force_figure(residual, "torque") for _ in range(2))
    titles = [axes.get_title(loc="left") for axes in figure.axes if axes.get_visible()]
    assert len(titles) == 5
    assert titles[0].startswith("speed: explains")
    one, two = (save_figure(f, tmp_path / name, "force")[0].read_bytes() for f, name in ((figure, "a"), (again, "b")))
    assert one == two


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"d": np.zeros(99)}, "100 samples"),
        ({"d": np.full(100, np.nan)}, "NaN"),
        ({"d_std": np.zeros(100)}, "positive"),
        ({"coordinates": {}}, "no coordinates"),
        ({"coordinates": {"speed": np.zeros(7)}}, "speed"),
        ({"blocks": 3}, "blocks"),
        ({"blocks": 50}, "blocks"),
        ({"blocks": np.zeros(99)}, "blocks"),
        ({"blocks": np.arange(100) // 50}, "2 blocks"),
    ],
)
def test_bad_input_is_named(change, message):
    usual = {"d": np.ones(100), "d_std": np.ones(100), "coordinates": {"speed": np.arange(100.0)}, "blocks": 10}
    with pytest.raises(InputError, match=message):
        residual_force(**(usual | change))
