"""Input maps in closed form, and delays against shifted responses."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import robustlab as rl
from robustlab.dynamics import Simulator, Site, Windows, effect

signals = hnp.arrays(np.float64, st.integers(2, 60), elements=st.floats(-12, 12))
sizes = st.floats(0.01, 12)


def mapped(name, u, values, h=1e-3):
    return effect(name).input(u, values, h)


@given(signals, sizes)
def test_dead_zone_and_saturation_of_one_width_make_up_the_input(u, d):
    parts = mapped("input-dead-zone", u, {"d": d}) + mapped("input-saturation", u, {"u_max": d})
    np.testing.assert_allclose(parts, u, rtol=1e-15, atol=1e-15)


@given(signals, sizes, st.sampled_from(["input-dead-zone", "input-saturation", "input-gain"]))
def test_the_footprint_is_a_sector_that_holds(u, size, name):
    values = {{"input-dead-zone": "d", "input-saturation": "u_max", "input-gain": "s"}[name]: size}
    amplitude = float(np.abs(u).max()) or 1.0
    sector = effect(name).footprint(Site("input", "u"), values, amplitude)
    seen = mapped(name, u, values)
    bounds = np.sort(np.stack([sector.gain_lower * u, sector.gain_upper * u]), axis=0)
    assert (seen >= bounds[0] - 1e-12).all()
    assert (seen <= bounds[1] + 1e-12).all()


def test_the_speed_of_a_free_mass_under_a_delayed_step_is_exact():
    plant = rl.plant("mass-spring-damper", m=2.0, c=0.0, k=0.0)
    n, dt, d = 100, 1e-2, 0.0537
    u = np.zeros((n, 1))
    u[20:] = 6.0
    simulator = Simulator(plant, [(effect("input-delay"), Site("input", "f"))], u, dt)
    found = simulator.run({}, [{"d": d}], np.zeros((1, 2)), Windows(np.array([0]), n)).outputs[0, :, 1]
    t = dt * np.arange(n)
    after = t >= 0.2 + d
    np.testing.assert_allclose(found[after], 3.0 * (t[after] - 0.2 - d), atol=1e-12)
    assert np.abs(found[t <= 0.2]).max() == 0.0
