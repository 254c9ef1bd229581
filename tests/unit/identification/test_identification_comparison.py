"""`compare` on records with a known gap: closed forms, and an integrator of our own with dry friction."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.identification import compare
from robustlab.identification.comparison import directions
from robustlab.statespace import OperatingPoint, StateSpaceModel

UNITS = {"u": "V", "q": "m", "v": "m/s"}
M, FV, GAIN = 95.1089, 203.5034, 35.15065


def axis():
    return rl.plant("servo-axis", M=M, Fv=FV, gain=GAIN)


def lag(gain=1.0):
    return StateSpaceModel([[-2.0]], [[2.0 * gain]], [[1.0]], [[0.0]], inputs=[("u", "V")], outputs=[("w", "rad/s")])


def excitation(n, seed=0, hold=50):
    return np.repeat(np.random.default_rng(seed).uniform(-4, 4, n // hold + 1), hold)[:n]


def with_coulomb_friction(u, h, friction, offset=0.0, substeps=20):
    """M dv/dt = g u - Fv v - friction sgn(v) - offset, stick at rest; semi-implicit Euler, independent of robustlab."""
    q, v, out = 0.0, 0.0, []
    step = h / substeps
    for value in u:
        out.append((q, v))
        for _ in range(substeps):
            impulse = M * v + step * (GAIN * value - FV * v - offset)
            v = np.sign(impulse) * max(0.0, abs(impulse) - step * friction) / M
            q += step * v
    return np.array(out)


def test_a_gain_error_of_ten_percent_has_the_closed_form_gap():
    t = np.arange(2000) * 0.01
    u = excitation(len(t))
    y = rl.simulate(lag(1.1), t, u, [0.0])["w"]
    found = compare(lag(), rl.Record(t, {"u": u}, {"w": y}, {"u": "V", "w": "rad/s"}))
    gap = found.outputs["w"]
    start = found.initial_state.x0
    error = y - (y / 1.1 + np.exp(-2 * t) * start)
    assert found.status is rl.Status.CONVERGED
    assert gap.peak == pytest.approx(np.abs(error).max(), rel=1e-9)
    assert gap.rms == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-9)
    assert gap.fit == pytest.approx(100 * (1 - np.linalg.norm(error) / np.linalg.norm(y - y.mean())), rel=1e-9)
    assert gap.peak_percent == pytest.approx(100 * gap.peak / (y.max() - y.min()))
    assert gap.rms_percent == pytest.approx(100 * gap.rms / (y.max() - y.min()))
    assert t[np.abs(error).argmax()] == gap.peak_time
    # All of the error is linear in the input.
    assert found.disturbance["u"].explained_share > 0.5
    spectrum = found.frequency["w"]
    assert np.median(spectrum.coherence["u"][spectrum.frequency < 5]) > 0.95


def test_the_right_model_reproduces_its_own_record():
    t = np.arange(1500) * 1e-2
    u = excitation(len(t))
    truth = rl.simulate(axis(), t, u, [0.3, -0.2])
    found = compare(axis(), truth, window=0.5)
    np.testing.assert_allclose(found.initial_state.x0, [0.3, -0.2], atol=1e-10)
    for name in ("q", "v"):
        assert found.outputs[name].peak_percent < 1e-8
        assert found.outputs[name].fit > 100 - 1e-8
    assert "zero to rounding" in found.summary()


def test_a_subset_of_the_outputs_is_enough():
    t = np.arange(1500) * 1e-2
    truth = rl.simulate(axis(), t, excitation(len(t)), [0.3, -0.2])
    for name in ("q", "v"):
        part = rl.Record(t, truth.inputs, {name: truth[name], "other": t}, {"u": "V", name: UNITS[name]})
        found = compare(axis(), part)
        assert list(found.outputs) == [name]
        assert found.outputs[name].peak_percent < 1e-6
    # The position is not observable from v alone.
    assert any("determine 1 of 2 states" in text for text in found.warnings)


@pytest.mark.slow
def test_the_start_is_estimated_from_noise_with_the_stated_spread():
    t = np.arange(1000) * 1e-2
    u = excitation(len(t))
    clean = rl.simulate(axis(), t, u, [0.1, 0.5])
    errors, stds, lengths = [], [], []
    for seed in range(40):
        noise = 1e-3 * np.random.default_rng(seed).standard_normal(len(t))
        record = rl.Record(t, {"u": u}, {"q": clean["q"] + noise}, {"u": "V", "q": "m"})
        found = compare(axis(), record, window=2.0).initial_state
        errors.append(found.x0 - [0.1, 0.5])
        stds.append(found.std)
        lengths.append(found.samples)
    assert np.median(lengths) == 160  # a right model lets the stretch grow to its limit
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(errors), axis=0)), np.mean(stds, axis=0), rtol=0.4)


def test_dry_friction_has_its_own_size_at_the_input():
    h, friction, offset = 2e-3, 20.0, -3.0
    t = np.arange(6000) * h
    u = 3.0 * np.sign(np.sin(2 * np.pi * t / 3.0)) + 0.5 * np.sin(2 * np.pi * t / 0.7)
    states = with_coulomb_friction(u, h, friction, offset)
    record = rl.Record(t, {"u": u}, {"q": states[:, 0], "v": states[:, 1]}, UNITS)
    found = compare(axis(), record, window=0.4)
    d = found.disturbance["u"]
    assert d.forward == pytest.approx(-(friction + offset) / GAIN, rel=0.03)
    assert d.backward == pytest.approx((friction - offset) / GAIN, rel=0.03)
    assert d.explained_share > 0.9
    assert found.motions["q"].speed_source == "v"
    assert found.residual["q"].whiteness.p_value < 1e-6
    assert "moving forward" in found.summary()


def test_an_unstable_model_is_compared_in_windows():
    unstable = StateSpaceModel([[3.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=["y"])
    t = np.arange(1000) * 0.01
    rng = np.random.default_rng(0)
    y = np.empty(1000)
    x, u = 0.1, np.empty(1000)
    for k in range(1000):  # kept at rest by a controller, with a little noise
        y[k] = x + 1e-3 * rng.standard_normal()
        u[k] = -8.0 * y[k] + 0.1 * rng.standard_normal()
        x = np.exp(0.03) * x + (np.exp(0.03) - 1) / 3.0 * u[k]
    gap = compare(unstable, rl.Record(t, {"u": u}, {"y": y}), window=0.3).outputs["y"]
    assert gap.fit < -1000
    assert gap.windowed_rms == pytest.approx(1e-3, rel=0.1)


def test_static_gain_and_discrete_model():
    t = np.arange(100) * 0.1
    u = excitation(100, hold=7)
    gain = StateSpaceModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[2.0]], inputs=["u"], outputs=["y"])
    gap = compare(gain, rl.Record(t, {"u": u}, {"y": 2.2 * u})).outputs["y"]
    assert gap.peak == pytest.approx(0.2 * np.abs(u).max())
    discrete = StateSpaceModel([[0.5]], [[1.0]], [[1.0]], [[0.0]], dt=0.1, inputs=["u"], outputs=["y"])
    truth = rl.simulate(discrete, t, u, [0.3])
    jitter = t + 1e-5 * np.random.default_rng(0).uniform(-1, 1, 100)
    gap = compare(discrete, rl.Record(jitter, truth.inputs, {"y": truth["y"]})).outputs["y"]
    assert gap.peak_percent < 1e-8


def test_operating_point_is_subtracted_and_added_back():
    point = OperatingPoint(np.array([5.0]), np.array([2.0]), np.array([10.0]))
    model = StateSpaceModel([[-1.0]], [[1.0]], [[2.0]], [[0.0]], inputs=["u"], outputs=["y"], operating_point=point)
    t = np.arange(300) * 0.02
    deviation = excitation(300)
    y = rl.simulate(StateSpaceModel([[-1.0]], [[1.0]], [[2.0]], [[0.0]]), t, deviation, [0.4])["y1"]
    found = compare(model, rl.Record(t, {"u": 2.0 + deviation}, {"y": 10.0 + y}))
    assert found.outputs["y"].peak_percent < 1e-8
    assert found.initial_state.x0 == pytest.approx([0.4])


def test_direction_bins_are_direct_sums():
    speed = np.array([-1.0, -0.5, 0.0, 0.01, 0.4, 1.0])
    error = np.array([1.0, 1.0, 5.0, 5.0, 2.0, 4.0])
    found = directions(speed, error)
    assert [d.samples for d in found.values()] == [2, 2, 2]
    assert found["backward"].rms == pytest.approx(1.0)
    assert found["forward"].mean == pytest.approx(3.0)
    assert sum(d.share for d in found.values()) == pytest.approx(1.0)
    one_way = directions(np.abs(speed) + 1, error)["backward"]
    assert (one_way.samples, one_way.mean, one_way.rms, one_way.share) == (0, 0.0, 0.0, 0.0)
    model = rl.StateSpaceModel([[-3.0]], [[3.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=["y"])
    t = np.arange(600) * 0.01
    u = np.repeat([0.0, 1.0, -2.0, 3.0], 150)
    y = rl.simulate(model, t, u, [0.0])["y"] * 1.1
    c = rl.compare(model, rl.Record(t, {"u": u}, {"y": y}))
    assert c.noise is None
    assert "repeats" in c.noise_reason
    assert c.against_noise == {}
