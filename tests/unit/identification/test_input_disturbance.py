"""Errors as an equivalent disturbance at an input or a joint: the truth is a known hidden force.

The machines are the textbook equations written out here, integrated by Runge-Kutta steps; nothing of robustlab makes
the records. The hidden force is dry friction, smooth over a narrow range of speed.
"""

import numpy as np
import pytest

import robustlab as rl

LEVEL = 12e-3  # N m: 0.48 V at the input
T = np.arange(2500) * 1e-3


def integrated(rates, x0, u, dt, parts=20):
    """States (n, n_x) at the samples, the input held between them."""
    x, h = np.array(x0, dtype=float), dt / parts
    found = np.empty((len(u), len(x)))
    for k, held in enumerate(u):
        found[k] = x
        for _ in range(parts):
            k1 = rates(x, held)
            k2 = rates(x + h / 2 * k1, held)
            k3 = rates(x + h / 2 * k2, held)
            k4 = rates(x + h * k3, held)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return found


def steps(t, size, period=0.6):
    return size * np.sign(np.sin(2 * np.pi * t / period)) * (0.7 + 0.3 * np.sin(2 * np.pi * t / (3.7 * period)))


def motor(names, level=0.0, drop=0.0, gain=1.0, off=0.005):
    """A comparison of a Maxon RE 35, parameters off by up to ``off``, with dry friction and a drop of its voltage."""
    rng = np.random.default_rng(1)
    R, L, K, J, Kf = np.array([2.07, 0.62e-3, 0.052, 7.2e-6, 4.8e-5]) * (1 + rng.uniform(-off, off, 5))
    u = steps(T, 10.0)

    def rates(x, v):
        torque = K * x[2] - Kf * x[1] - level * np.tanh(x[1] / 0.5)
        return np.array([x[1], torque / J, (gain * v - drop * np.sign(v) - R * x[2] - K * x[1]) / L])

    x = integrated(rates, np.zeros(3), u, 1e-3)
    step = 2 * np.pi / 2000
    seen = {
        "phi": np.floor(x[:, 0] / step) * step,
        "omega": x[:, 1] + 0.2 * rng.normal(size=len(T)),
        "i": x[:, 2] + 0.02 * rng.normal(size=len(T)),
    }
    return rl.compare(rl.plant("dc-motor"), rl.Record(T, {"u": u}, {name: seen[name] for name in names}, {}, "outside"))


@pytest.mark.parametrize(("names", "places"), [
    (["phi"], ["input u", "torque at omega"]),  # without a current a voltage explains it as well
    (["phi", "i"], ["torque at omega"]),
    (["phi", "omega", "i"], ["torque at omega"]),
])  # fmt: skip
def test_dry_friction_of_a_motor_is_a_torque_at_its_shaft(names, places):
    found = motor(names, level=LEVEL)
    assert [d.place for d in found.located] == places
    d = found.disturbance["torque at omega"]
    assert d.forward == pytest.approx(-LEVEL, rel=0.1)
    assert d.backward == pytest.approx(LEVEL, rel=0.1)
    assert all(share > 0.9 for share in d.shares.values())
    assert f"missing: {places[0]}" in dict(found.facts())


@pytest.mark.slow
def test_a_drop_and_a_wrong_gain_of_the_voltage_are_at_the_input():
    for options in ({"drop": 0.5}, {"gain": 0.9}):
        found = motor(["phi", "i"], off=0.0, **options)
        assert [d.place for d in found.located] == ["input u"]
        d = found.disturbance["u"]
        lost = options.get("drop", 0.0) + (1 - options.get("gain", 1.0)) * 10.0 * 0.7
        assert d.forward == pytest.approx(-lost, rel=0.15)


def test_without_a_missing_effect_nothing_is_located():
    found = motor(["phi", "i"], off=0.0)
    assert found.located == ()
    assert not any(d.sure_means for d in found.disturbance.values())
    assert "no disturbance at one place explains half of the error" in found.summary()


def test_friction_at_a_load_is_located_at_the_load():
    rng, t = np.random.default_rng(1), np.arange(4000) * 1e-3
    J1, J2, c, k = np.array([1e-3, 2e-3, 2e-3, 10.0]) * (1 + rng.uniform(-0.02, 0.02, 4))
    u = steps(t, 0.3, 1.0)

    def rates(x, v):
        twist = c * (x[2] - x[3]) + k * (x[0] - x[1])
        return np.array([x[2], x[3], (v - twist) / J1, (twist - 0.08 * np.tanh(x[3] / 0.2)) / J2])

    x = integrated(rates, np.zeros(4), u, 1e-3, 10) + 2e-5 * rng.normal(size=(4000, 4))
    record = rl.Record(t, {"torque": u}, {"phi1": x[:, 0], "phi2": x[:, 1]}, {}, "outside")
    (d,) = rl.compare(rl.plant("two-mass"), record).located
    assert d.place == "torque at omega2"
    assert (d.forward, d.backward) == pytest.approx((-0.08, 0.08), rel=0.1)


@pytest.mark.slow
def test_the_stated_errors_of_a_constant_force_hold_the_truth():
    misses, force, t = 0, 0.5, np.arange(3000) * 1e-3
    f = steps(t, 3.0, 1.0)
    x = integrated(lambda x, v: np.array([x[1], v - 2.0 * x[1] - force]), [0.0, 0.0], f, 1e-3, 2)
    plant = rl.StateSpaceModel(
        [[0, 1], [0, -2.0]], [[0], [1]], [[1, 0]], [[0]], inputs=[("f", "N")], outputs=[("q", "m")],
        states=[("q", "m"), ("v", "m/s")],
    )  # fmt: skip
    for seed in range(30):
        noise = 1e-3 * np.random.default_rng([2, seed]).normal(size=len(t))
        d = rl.compare(plant, rl.Record(t, {"f": f}, {"q": x[:, 0] + noise}, {"q": "m", "f": "N"})).disturbance["f"]
        for mean, std in ((d.forward, d.forward_std), (d.backward, d.backward_std), (d.mean, d.mean_std)):
            assert std < 0.1
            misses += abs(mean + force) > 3 * std
    assert misses <= 4  # of 90; a normal error would give 0.3
