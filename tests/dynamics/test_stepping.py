"""Accuracy of the shared steps: laws on a lightly damped resonance with few samples a period, against scipy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import robustlab as rl
from robustlab.dynamics import Simulator, Site, Windows, effect, stepping

DT, N = 1e-3, 150
JOINT = Site("joint", "v")


def oscillator(samples_a_period, ratio=0.01):
    omega = 2 * np.pi / (samples_a_period * DT)
    return rl.plant("mass-spring-damper", m=1.0, k=omega**2, c=2 * ratio * omega), omega


def drive(omega):
    """Samples of a force at and about the resonance; it moves the mass by up to one and a half or so."""
    t = np.arange(N) * DT
    return (
        0.05 * omega**2 * (np.sin(omega * t) + 0.5 * np.sin(1.1 * omega * t + 1) + 0.5 * np.sin(0.85 * omega * t + 2))
    )


def truth(plant, u, force, extra=0):
    """States at the samples for a force of position, velocity and further states, the input held."""
    k, c = plant.values["k"], plant.values["c"]
    x, states = np.zeros(2 + extra), []

    def rate(_, x, push):
        f, more = force(x)
        return [x[1], push - c * x[1] - k * x[0] + f, *more]

    for push in u:
        states.append(x)
        x = solve_ivp(rate, (0, DT), x, args=(push,), rtol=1e-9, atol=1e-10, method="DOP853").y[:, -1]
    return np.array(states)


def error(plant, name, values, u, x, sub):
    run = Simulator(plant, [(effect(name), JOINT)], u[:, None], DT, sub=sub)
    found = run.run({}, [values], np.zeros((1, 2)), Windows(np.array([0]), N)).states[0]
    return float(np.abs(found[:, 0] - x[:, 0]).max() / np.abs(x[:, 0]).max())


def dahl(level, stiffness):
    def force(x):
        return -stiffness * x[2], [x[1] - abs(x[1]) * x[2] * stiffness / level]

    return force


# The force of each law is a good part of the spring's, or a fiftieth of it where it damps. After twenty periods: the
# largest error at the steps of `stepping`, and its reduction when they are halved.
LAWS = {
    "cubic-stiffness": (lambda k, w: {"k3": 0.1 * k}, lambda p: lambda x: (-p["k3"] * x[0] ** 3, []), 5e-4, 10),
    "cogging": (
        lambda k, w: {"Ac": 0.03 * k, "As": 0.02 * k, "k": 4.0},
        lambda p: lambda x: (p["Ac"] * np.cos(4 * x[0]) + p["As"] * np.sin(4 * x[0]), []),
        5e-4,
        10,
    ),
    "quadratic-drag": (lambda k, w: {"c": 0.02}, lambda p: lambda x: (-p["c"] * x[1] * abs(x[1]), []), 5e-5, 4),
    "asymmetric-viscous-friction": (
        lambda k, w: {"dFv": 0.02 * w},
        lambda p: lambda x: (-p["dFv"] * abs(x[1]), []),
        5e-5,
        2,
    ),
    "presliding": (
        lambda k, w: {"Fc": 0.02 * k, "sigma0": 0.4 * k},
        lambda p: dahl(p["Fc"], p["sigma0"]),
        3e-3,
        2.5,
    ),
}


@pytest.mark.parametrize("samples_a_period", [8, 9, 12])
@pytest.mark.parametrize("name", LAWS)
def test_a_law_on_a_resonance(name, samples_a_period):
    plant, omega = oscillator(samples_a_period)
    numbers, physics, most, falls = LAWS[name]
    values, u = numbers(plant.values["k"], omega), drive(omega)
    x = truth(plant, u, physics(values), extra=name == "presliding")
    sub = stepping(plant, DT)
    shared = error(plant, name, values, u, x, sub)
    assert shared < most
    assert error(plant, name, values, u, x, 2 * sub) < max(shared / falls, 1e-7)


def test_dry_friction_brings_a_swing_to_rest_by_the_same_amount_each_half_period():
    # without viscous damping each half period of k q = -F sgn v takes 2 F / k from the amplitude, exactly
    omega, level = 2 * np.pi / (9 * DT), 0.02
    plant = rl.plant("mass-spring-damper", m=1.0, k=omega**2, c=0.0)
    run = Simulator(plant, [(effect("coulomb-friction"), JOINT)], np.zeros((160, 1)), DT, sub=stepping(plant, DT))
    start = np.array([[1.01, 0.0]])
    q, v = run.run({}, [{"Fc": level * omega**2}], start, Windows(np.array([0]), 160)).states[0].T
    t = np.arange(160) * DT
    half = np.floor(omega * t / np.pi).astype(int)
    amplitude = np.maximum(1.01 - level - 2 * level * half, 0.0)
    middle = np.where(half % 2 == 0, level, -level)
    moving = amplitude > 0
    expected = middle + amplitude * np.cos(omega * t - np.pi * half) * np.where(half % 2 == 0, 1, -1)
    assert np.abs(q - expected)[moving].max() < 3e-3
    assert np.abs(v[-20:]).max() < 1e-14
    assert np.ptp(q[-20:]) < 1e-14
