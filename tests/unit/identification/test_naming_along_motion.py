"""Naming on nonlinear plants: simulation about a measured motion, states from the sensors, effects at their joints."""

import runpy
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from arm_machine import NOMINAL, arm_record
from closed_loop import closed_loop
from naming_cases import all_but
from scipy.integrate import solve_ivp

import robustlab as rl
from robustlab.identification import Simulator, Windows, smooth_motion

MODELS = Path(__file__).parents[3] / "models" / "plants"
FEW = {"coulomb-friction", "viscous-friction", "constant-load", "input-gain", "inertia", "sensor-bias"}


@cache
def arm(**given):
    return runpy.run_path(str(MODELS / "two_link_arm.py"))["two_link_arm"](**given)


@cache
def swing():
    """Simulate torques and states of the arm under a controller."""
    plant = arm()

    def control(t, x):
        wanted = 0.4 * np.sin(np.array([3.0, 4.0]) * t)
        return np.array([150.0, 40.0]) * (wanted - x[::2]) - np.array([15.0, 4.0]) * x[1::2] + [20.0, 3.7]

    return closed_loop(plant, control, np.zeros(4), 300, 2e-3, ["q_1", "q_2"], 0.0)


def simulated(plant, motion, x0=None):
    record, x = swing()
    u = np.column_stack(list(record.inputs.values()))
    windows = Windows(np.array([0, 60, 120, 180]), 60)
    start = x[windows.starts] if x0 is None else x0
    return Simulator(plant, (), u, record.dt, sub=2, motion=motion).run({}, (), start, windows).states


def true_windows(x):
    return x[np.array([0, 60, 120, 180])[:, None] + np.arange(60)]


# --- simulation about a motion ---------------------------------------------------------------------------------------


def test_the_simulation_about_the_plants_motion_is_that_motion():
    _, x = swing()
    assert np.abs(simulated(arm(), x) - true_windows(x)).max() < 2e-6 * np.ptp(x)


def test_the_error_of_a_simulation_that_leaves_the_motion_is_of_second_order():
    record, x = swing()
    off = np.array([0.04, 0.2, -0.03, 0.1])
    errors = []
    for share in (1.0, 0.5):
        start = x[[0, 60, 120, 180]] + share * off
        truth = []
        for k, x0 in zip((0, 60, 120, 180), start, strict=True):
            u = np.column_stack(list(record.inputs.values()))[k : k + 60]
            truth.append(rl.simulate(arm(), record.t[:60], u, x0))
        q = np.array([[t["q_1"], t["q_2"]] for t in truth]).transpose(0, 2, 1)
        errors.append(np.abs(simulated(arm(), x, start)[:, :, ::2] - q).max())
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.25)
    assert errors[0] < 0.02


# --- states from the sensors -----------------------------------------------------------------------------------------


def test_states_and_residual_force_are_estimated_from_the_sensors():
    record = arm_record(5, seconds=2.0)
    u, y = np.column_stack(list(record.inputs.values())), np.column_stack(list(record.outputs.values()))
    heavier = arm_record(5, seconds=2.0, b_2=NOMINAL["b_2"] + 1.0)
    moved = smooth_motion(arm(), record.t, u, y, (0, 1))[0]
    inner = slice(50, -50)
    speed = np.gradient(
        np.column_stack([arm_record(5, seconds=2.0, noise=0.0)[f"q_{j}"] for j in (1, 2)]), 2e-3, axis=0
    )
    assert np.sqrt(np.mean((moved.x[inner, 1::2] - speed[inner]) ** 2)) < 0.01
    u, y = np.column_stack(list(heavier.inputs.values())), np.column_stack(list(heavier.outputs.values()))
    pushed = smooth_motion(arm(), heavier.t, u, y, (0, 1))[0]
    slope = np.polyfit(pushed.x[inner, 3], pushed.d[inner, 1], 1)[0]
    assert slope == pytest.approx(-1.0, rel=0.05)  # the force of a damper that the plant lacks


def test_an_unmeasured_state_follows_its_equations_without_derivatives_at_zero():
    tank = runpy.run_path(str(MODELS / "water_tank.py"))["water_tank"]()
    t = np.arange(0.0, 600.0)
    u = np.repeat(np.random.default_rng(1).uniform(2.5, 6.0, 12), 50)[:, None]
    run = rl.simulate(tank, t, u, [0.08, 0.08], hold="zoh")
    noisy = run["level"] + 0.01 * np.random.default_rng(2).standard_normal(len(t))
    moved = smooth_motion(tank, t, u, noisy[:, None], (0,))[0]
    levels = np.full((len(t), 2), 0.08)
    for k in range(len(t) - 1):
        rate = lambda _, x, k=k: tank.rates_along(x[None], u[k : k + 1])[0]  # noqa: E731
        levels[k + 1] = solve_ivp(rate, (0.0, 1.0), levels[k], rtol=1e-8, atol=1e-12).y[:, -1]
    # The initial level of the upper tank is a guess whose effect decays with A/a sqrt(2 h/g) = 80 s.
    settled = slice(450, None)
    assert np.abs(moved.x[settled] - levels[settled]).max() < 0.01 * np.ptp(levels)
    found = rl.compare(tank, rl.Record(t, {"u": u[:, 0]}, {"level": noisy}, {"u": "V", "level": "V"}))
    assert found.outputs["level"].windowed_rms < 0.02


# --- discover --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_friction_of_one_joint_is_named_at_that_joint():
    perturbed = {"m_2": 1.02 * NOMINAL["m_2"], "b_1": 1.2 * NOMINAL["b_1"], "I_r2": 0.95 * NOMINAL["I_r2"]}
    runs = [arm_record(seed, coulomb=(0.0, 0.5), **perturbed) for seed in (11, 12)]
    found = rl.discover(arm(), runs[0], held_out=runs[1], exclude=all_but(*FEW))
    assert (found.verdict, found.complete) == ("named", True)
    (one,) = found.effects
    assert (one.name, one.site) == ("coulomb-friction", "w_2")
    assert one.parameters[0].value == pytest.approx(0.5, rel=0.02)
    assert found.gap_after < 0.2 * found.gap_refitted
    again = rl.simulate(found.model, runs[1].t[:100], np.column_stack(list(runs[1].inputs.values()))[:100])
    assert np.isfinite(again["q_1"]).all()


@pytest.mark.slow
def test_no_effect_is_named_for_an_arm_within_its_tolerances():
    perturbed = {"m_1": 0.98 * NOMINAL["m_1"], "b_2": 0.8 * NOMINAL["b_2"]}
    runs = [arm_record(seed, **perturbed) for seed in (21, 22)]
    found = rl.discover(arm(), runs[0], held_out=runs[1], exclude=all_but(*FEW))
    assert found.verdict == "no missing effect"
    assert not found.effects
