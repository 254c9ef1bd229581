"""Every force law on a DC motor with current, against an event-driven integration by scipy of the same physics."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import robustlab as rl
from robustlab.dynamics import Simulator, Site, Windows, effect

R, L, K, KF, J = 2.07, 6.2e-4, 0.052, 4.8e-5, 7.2e-6
DT, N = 1e-3, 250
TIME = np.arange(N) * DT
PHASES = np.random.default_rng(0).uniform(0, 2 * np.pi, 5)
# Jumps, reversals, slow passages through zero.
U = 4.0 * np.where(np.sin(2 * np.pi * 8 * TIME + 0.1) > 0, 1.0, -1.0) + sum(
    1.2 * np.sin(2 * np.pi * f * TIME + p) for f, p in zip((4, 9, 17, 25, 41), PHASES, strict=True)
)


def smooth_motor(force=lambda t, q, v, i: 0.0, drop=lambda t, i: 0.0):
    """States at the samples for a torque and a voltage that are functions of the motion."""

    def rate(t, x, volt):
        q, v, i = x
        return [v, (K * i - KF * v + force(t, q, v, i)) / J, (volt - R * i - K * v + drop(t, i)) / L]

    x, states = np.zeros(3), []
    for k, volt in enumerate(U):
        states.append(x)
        x = solve_ivp(rate, (k * DT, (k + 1) * DT), x, args=(volt,), rtol=1e-9, atol=1e-11).y[:, -1]
    return np.array(states)


def dry_motor(level, holding):
    """The same with dry friction of the size level(q, v, drive) against the motion, and holding(q) at rest."""

    def rate(_, x, volt, way):
        q, v, i = x
        drive = K * i - KF * v
        torque = 0.0 if way == 0 else drive - way * level(q, v, drive)
        return [v if way else 0.0, torque / J, (volt - R * i - K * v) / L]

    def stops(_, x, volt, way):
        return x[1] if way else K * abs(x[2]) - holding(x[0])

    stops.terminal = True
    x, way, states = np.zeros(3), 0, []
    for volt in U:
        states.append(x)
        t, pieces = 0.0, 0
        while t < DT:
            if way == 0 and holding(x[0]) == 0.0:
                way = int(np.sign(x[2] or volt))
            stops.direction = float(-way) if way else 1.0
            found = solve_ivp(rate, (t, DT), x, args=(volt, way), rtol=1e-9, atol=1e-11, events=stops)
            t, x = found.t[-1], found.y[:, -1].copy()
            if t < DT or (way and x[1] * way <= 0):
                x[1] = 0.0
                way = int(np.sign(x[2])) if K * abs(x[2]) >= holding(x[0]) * (1 - 1e-9) else 0
                x[1] = way * 1e-12
            pieces += 1
            assert pieces < 1000
    return np.array(states)


def simulated(name, site, values, finer):
    """The same by the effect, ``finer`` steps of the simulation per sample beyond its own."""
    plant = rl.plant("dc-motor")
    assert [plant.values[k] for k in ("R", "L", "Km", "Kf", "J")] == [R, L, K, KF, J]
    simulator = Simulator(plant, [(effect(name), site)], np.repeat(U, finer)[:, None], DT / finer)
    windows = Windows(np.array([0]), N * finer)
    return simulator.run({}, [values], np.zeros((1, 3)), windows).states[0][::finer]


JOINT, CURRENT = Site("joint", "omega"), Site("current", "i")

DRY = {
    "coulomb-friction": ({"Fc": 0.01}, lambda q, v, T: 0.01, lambda q: 0.01),
    "stribeck-friction": (
        {"Fc": 0.006, "dF": 0.008, "vs": 8.0},
        lambda q, v, T: 0.006 + 0.008 * np.exp(-((v / 8.0) ** 2)),
        lambda q: 0.014,
    ),
    "position-dependent-friction": (
        {"Fc": 0.01, "Pc": 0.004, "Ps": -0.003, "k": 4.0},
        lambda q, v, T: 0.01 + 0.004 * np.cos(4 * q) - 0.003 * np.sin(4 * q),
        lambda q: 0.01 + 0.004 * np.cos(4 * q) - 0.003 * np.sin(4 * q),
    ),
    "gear-efficiency": ({"eta": 0.8}, lambda q, v, T: 0.2 * abs(T), lambda q: 0.0),
    "load-dependent-friction": (
        {"kd": 0.1, "kb": 0.5},
        lambda q, v, T: np.where(T * v > 0, 0.1, 0.5) * abs(T),
        lambda q: 0.0,
    ),
}
SMOOTH = {
    "asymmetric-viscous-friction": (JOINT, {"dFv": 3e-5}, {"force": lambda t, q, v, i: -3e-5 * abs(v)}),
    "constant-load": (JOINT, {"T0": 0.01}, {"force": lambda t, q, v, i: -0.01}),
    "quadratic-drag": (JOINT, {"c": 1e-6}, {"force": lambda t, q, v, i: -1e-6 * v * abs(v)}),
    "cogging": (
        JOINT,
        {"Ac": 0.004, "As": 0.003, "k": 4.0},
        {"force": lambda t, q, v, i: 0.004 * np.cos(4 * q) + 0.003 * np.sin(4 * q)},
    ),
    "cubic-stiffness": (JOINT, {"k3": 1e-4}, {"force": lambda t, q, v, i: -1e-4 * q**3}),
    "end-stop": (
        JOINT,
        {"q_min": -3.0, "q_max": 4.0, "kc": 0.5, "dc": 5e-4},
        {
            "force": lambda t, q, v, i: (
                -max(0.0, 0.5 * (q - 4) + 5e-4 * v) * (q > 4) + max(0.0, -0.5 * (q + 3) - 5e-4 * v) * (q < -3)
            )
        },
    ),
    "one-sided-spring": (
        JOINT,
        {"k": 0.3, "q0": 4.0, "d": 5e-4},
        {"force": lambda t, q, v, i: -max(0.0, 0.3 * (q - 4) + 5e-4 * v) * (q > 4)},
    ),
    "pendulum-gravity": (
        JOINT,
        {"G": 0.004, "H": -0.003},
        {"force": lambda t, q, v, i: -0.004 * np.sin(q) + 0.003 * np.cos(q)},
    ),
    "torque-ripple": (
        JOINT,
        {"Ac": 0.004, "As": 0.003, "f": 50.0},
        {"force": lambda t, q, v, i: 0.004 * np.cos(100 * np.pi * t) + 0.003 * np.sin(100 * np.pi * t)},
    ),
}


@pytest.fixture(scope="module")
def without():
    return smooth_motor()


def errors(name, site, values, truth, without, finer):
    """Largest error of angle and speed over the largest that the effect brings about, with dt and finer steps."""
    size = np.abs(without - truth).max(axis=0)[:2]
    found = (simulated(name, site, values, k) for k in (1, finer))
    return [float(np.max(np.abs(states - truth).max(axis=0)[:2] / size)) for states in found]


@pytest.mark.parametrize("name", DRY)
def test_dry_laws(name, without):
    values, level, holding = DRY[name]
    coarse, fine = errors(name, JOINT, values, dry_motor(level, holding), without, 16)
    assert coarse < 0.02
    assert fine < 0.2 * coarse


@pytest.mark.slow
@pytest.mark.parametrize("name", SMOOTH)
def test_smooth_laws(name, without):
    site, values, physics = SMOOTH[name]
    coarse, fine = errors(name, site, values, smooth_motor(**physics), without, 4)
    assert coarse < 0.02
    assert fine < 0.3 * coarse or fine < 1e-6
