"""What an error would be as an addition at an input or a joint: the truth is a hidden force that the test knows.

The machines are the textbook equations written out here, integrated by Runge-Kutta steps; nothing of robustlab makes
the records. The hidden force is dry friction, smooth over a narrow range of speed.
"""

from __future__ import annotations

import numpy as np
import pytest

import robustlab as rl

RESOLUTION = 2 * np.pi / 2000


def integrated(rates, x0, u, dt, parts=10):
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


def dry(level, speed, width):
    return level * np.tanh(speed / width)


def steps(t, size, period=0.6):
    return size * np.sign(np.sin(2 * np.pi * t / period)) * (0.7 + 0.3 * np.sin(2 * np.pi * t / (3.7 * period)))


def encoder(angle, step=RESOLUTION):
    return np.floor(angle / step) * step


# --- machines: plant, what is hidden in it, and how large that is -----------------------------------------------------

LEVEL = 12e-3  # N m: 0.48 V at the input


def motor(rng, off=0.005, bias=0.0, drop=0.0, level=LEVEL):
    """Maxon RE 35 with dry friction, parameters off by up to ``off``."""
    R, L, K, J, Kf = np.array([2.07, 0.62e-3, 0.052, 7.2e-6, 4.8e-5]) * (1 + rng.uniform(-off, off, 5))
    t = np.arange(2500) * 1e-3
    u = steps(t, 10.0)

    def rates(x, v):
        lost = drop * np.sign(v)
        return np.array(
            [x[1], (K * x[2] - Kf * x[1] - dry(level, x[1], 0.5)) / J, (v - lost - R * x[2] - K * x[1]) / L]
        )

    x = integrated(rates, np.zeros(3), u, 1e-3, 20)
    current = x[:, 2] + 0.02 * rng.normal(size=len(t)) + bias
    outputs = {"phi": encoder(x[:, 0]), "i": current, "omega": x[:, 1] + 0.2 * rng.normal(size=len(t))}
    return rl.plant("dc-motor"), t, {"u": u}, outputs


def axis(rng, off=0.03):
    M, Fv, gain = np.array([95.1089, 203.5034, 35.15065]) * (1 + rng.uniform(-off, off, 3))
    t = np.arange(4000) * 1e-3
    u = steps(t, 4.0, 1.0)
    x = integrated(lambda x, v: np.array([x[1], (gain * v - Fv * x[1] - dry(20.0, x[1], 1e-3)) / M]), [0, 0], u, 1e-3)
    return (
        rl.plant("servo-axis"),
        t,
        {"u": u},
        {"q": encoder(x[:, 0], 1e-6), "v": x[:, 1] + 1e-4 * rng.normal(size=4000)},
    )


def shaft(rng, off=0.02):
    """Friction at the load, not where the motor pushes."""
    J1, J2, c, k = np.array([1e-3, 2e-3, 2e-3, 10.0]) * (1 + rng.uniform(-off, off, 4))
    t = np.arange(4000) * 1e-3
    u = steps(t, 0.3, 1.0)

    def rates(x, v):
        twist = c * (x[2] - x[3]) + k * (x[0] - x[1])
        return np.array([x[2], x[3], (v - twist) / J1, (twist - dry(0.08, x[3], 0.2)) / J2])

    x = integrated(rates, np.zeros(4), u, 1e-3)
    noise = 2e-5 * rng.normal(size=(4000, 2))
    return rl.plant("two-mass"), t, {"torque": u}, {"phi1": x[:, 0] + noise[:, 0], "phi2": x[:, 1] + noise[:, 1]}


def masses(rng, off=0.02):
    """Two masses on springs; friction at the second."""
    m, c, k = 1.0 + rng.uniform(-off, off, 2), 1.0 + rng.uniform(-off, off, 2), 100 * (1 + rng.uniform(-off, off, 2))
    t = np.arange(4000) * 2e-3
    f = np.column_stack([steps(t, 40.0, 1.5), steps(t, 30.0, 2.1)])

    def rates(x, v):
        q, w = x[:2], x[2:]
        first = v[0] - k[0] * q[0] - c[0] * w[0] + k[1] * (q[1] - q[0]) + c[1] * (w[1] - w[0])
        second = v[1] - k[1] * (q[1] - q[0]) - c[1] * (w[1] - w[0]) - dry(5.0, w[1], 5e-3)
        return np.array([w[0], w[1], first / m[0], second / m[1]])

    x = integrated(rates, np.zeros(4), f, 2e-3)
    seen = x + np.array([1e-5, 1e-5, 1e-3, 1e-3]) * rng.normal(size=x.shape)
    outputs = dict(zip(("q1", "q2", "v1", "v2"), seen.T, strict=True))
    return (
        rl.plant("mass-spring-damper", m=[1.0, 1.0], c=[1.0, 1.0], k=[100.0, 100.0]),
        t,
        {"f1": f[:, 0], "f2": f[:, 1]},
        outputs,
    )


def compared(machine, names, seed=1, **options):
    plant, t, inputs, outputs = machine(np.random.default_rng(seed), **options)
    record = rl.Record(t, inputs, {name: outputs[name] for name in names}, {}, "outside")
    return rl.compare(plant, record)


CASES = [
    (motor, ["phi"], "torque at omega", LEVEL),
    (motor, ["phi", "i"], "torque at omega", LEVEL),
    (motor, ["phi", "omega", "i"], "torque at omega", LEVEL),
    (axis, ["q"], "input u", 20.0 / 35.15065),
    (axis, ["q", "v"], "input u", 20.0 / 35.15065),
    (shaft, ["phi1", "phi2"], "torque at omega2", 0.08),
    (masses, ["q1", "q2"], "input f2", 5.0),
]


@pytest.mark.parametrize(
    ("machine", "names", "place", "level"), CASES, ids=[f"{m.__name__} {'+'.join(n)}" for m, n, *_ in CASES]
)
def test_hidden_dry_friction_is_located_with_its_sign_and_size(machine, names, place, level):
    found = compared(machine, names)
    told = {d.place: d for d in found.located}
    assert place in told
    d = told[place]
    assert not d.together
    if place != "input f2":  # whose speed is not the one that the error is sorted by
        assert d.forward == pytest.approx(-level, rel=0.25)
        assert d.backward == pytest.approx(level, rel=0.25)
    assert all(share > 0.5 for share in d.shares.values())
    if "i" in names:  # the current tells a torque from a voltage
        assert "input u" not in told


def test_without_a_current_a_voltage_would_do_as_well_and_both_are_told():
    found = compared(motor, ["phi"])
    told = {d.place: d for d in found.located}
    assert list(told) == ["input u", "torque at omega"]
    assert told["input u"].forward == pytest.approx(-LEVEL * 2.07 / 0.052, rel=0.25)
    assert "as an addition at input u" in found.summary()
    assert "or as one at torque at omega" in found.summary()


def test_where_nothing_is_missing_nothing_is_told():
    for machine, names in ((motor, ["phi", "i"]), (motor, ["phi"])):
        found = compared(machine, names, off=0.0, level=0.0)
        assert found.located == ()
        assert "explains half of the error" in found.summary()
        assert "mean" not in found.summary().splitlines()[-1]


def test_the_stated_errors_hold_the_truth():
    """Nominal parameters, noise alone: the force that hides is within three standard errors in nearly all records."""
    misses = 0
    for seed in range(30):
        rng = np.random.default_rng([2, seed])
        t = np.arange(3000) * 1e-3
        f = steps(t, 3.0, 1.0)
        force = 0.5

        def rates(x, v, force=force):
            return np.array([x[1], v - 2.0 * x[1] - force])

        x = integrated(rates, [0.0, 0.0], f, 1e-3, 2)
        plant = rl.StateSpaceModel(
            [[0, 1], [0, -2.0]], [[0], [1]], [[1, 0]], [[0]], inputs=[("f", "N")], outputs=[("q", "m")],
            states=[("q", "m"), ("v", "m/s")],
        )  # fmt: skip
        record = rl.Record(t, {"f": f}, {"q": x[:, 0] + 1e-5 * rng.normal(size=len(t))}, {"q": "m", "f": "N"})
        d = rl.compare(plant, record, window=0.4).disturbance["f"]
        for mean, std in ((d.forward, d.forward_std), (d.backward, d.backward_std)):
            assert std < 0.05
            misses += abs(mean + force) > 3 * std
    assert misses <= 3  # of 60; a normal error would give 0.2


def pushed(plant, force, noise, *, off=0.0, seed=0):
    """Record of 4 s of a machine with a hidden constant force, and that force in units of the input."""
    rng, t = np.random.default_rng([5, seed]), np.arange(4000) * 1e-3
    factor = 1 + rng.uniform(-off, off, 2)
    if plant == "servo-axis":
        (M, Fv), gain, size, name = np.array([95.1089, 203.5034]) * factor, 35.15065, 4.0, "u"
        outputs, period, hidden = ("q", "v"), 1.0, force / gain
    else:
        (M, gain), Fv, size, name = np.array([2.5e-4, 0.06]) * factor, 0.0, 1.0, "i"
        outputs, period, hidden = ("phi", "omega"), 0.5, force / gain
    u = steps(t, size, period)
    x = integrated(lambda x, v: np.array([x[1], (gain * v - Fv * x[1] + force) / M]), [0.0, 0.0], u, 1e-3, 2)
    signals = {k: y + s * rng.normal(size=len(t)) for k, y, s in zip(outputs, x.T, noise, strict=False)}
    return rl.Record(t, {name: u}, signals, {}, "outside"), hidden


@pytest.mark.parametrize(
    ("plant", "force", "noise"),
    [
        ("servo-axis", 20.0, (1e-3, 1e-2)),
        ("servo-axis", -20.0, (1e-3, 1e-2)),
        ("servo-axis", 20.0, (1e-3,)),
        ("brushless-motor", -0.01, (1e-3, 0.5)),
        ("brushless-motor", 0.01, (1e-2,)),
    ],
)
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_a_constant_force_that_noise_hides_in_short_pieces_is_told_in_longer_ones(plant, force, noise, seed):
    """Nothing was told: the pieces of a window chosen by ourselves were too short."""
    record, hidden = pushed(plant, force, noise, seed=seed)
    found = rl.compare(rl.plant(plant), record)
    (d,) = found.located
    mean, std = d.mean
    assert d.place.startswith("input")
    assert abs(mean - hidden) < 4 * std < 0.25 * abs(hidden)
    assert d.seconds > found.window / 4 + 1e-9  # longer than it was
