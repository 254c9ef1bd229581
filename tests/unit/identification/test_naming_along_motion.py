"""Naming on nonlinear plants: simulation about a measured motion, states from the sensors, effects at their joints."""

from __future__ import annotations

import runpy
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from arm_machine import NOMINAL, arm_record
from closed_loop import closed_loop
from scipy.linalg import solve_continuous_are

import robustlab as rl
from robustlab import InputError
from robustlab.dynamics.effects.catalogue import catalogue, effect
from robustlab.dynamics.effects.contract import Scales, Site
from robustlab.dynamics.extended.simulator import Simulator, Windows
from robustlab.dynamics.plant_contract import input_signal
from robustlab.identification import tuning
from robustlab.identification.hypotheses.candidates import candidates, nuisance_parameters, stated_tolerances
from robustlab.identification.hypotheses.effect_fit import FitPlan, Hypothesis, Problem
from robustlab.identification.hypotheses.motion_smoother import smooth_motion
from robustlab.identification.hypotheses.noise import first_noise
from robustlab.identification.hypotheses.prepared_record import ports_of, prepare, window_length

MODELS = Path(__file__).parents[3] / "models" / "plants"
FEW = {"coulomb-friction", "viscous-friction", "constant-load", "input-gain", "inertia", "sensor-bias"}


@cache
def arm(**given):
    return runpy.run_path(str(MODELS / "two_link_arm.py"))["two_link_arm"](**given)


@cache
def swing():
    """Torques and states of the arm under a controller, exact."""
    plant = arm()

    def control(t, x):
        wanted = 0.4 * np.sin(np.array([3.0, 4.0]) * t)
        return np.array([150.0, 40.0]) * (wanted - x[::2]) - np.array([15.0, 4.0]) * x[1::2] + [20.0, 3.7]

    return closed_loop(plant, control, np.zeros(4), 300, 2e-3, ["q_1", "q_2"], 0.0)


def simulated(plant, motion, x0=None, effects=(), values=()):
    record, x = swing()
    u = np.column_stack(list(record.inputs.values()))
    windows = Windows(np.array([0, 60, 120, 180]), 60)
    start = x[windows.starts] if x0 is None else x0
    return Simulator(plant, effects, u, record.dt, sub=2, motion=motion).run({}, values, start, windows).states


@pytest.mark.parametrize("name", ["presliding", "backlash", "input-delay", "sensor-bias"])
def test_runs_beside_each_other_are_those_of_each_alone(name):
    """Several starts of every window in one simulation: to the last bit, whatever an effect remembers."""
    record, x = swing()
    plant, found = arm(), effect(name)
    place = {"input": "", "output": "q_1"}.get(found.site_kind, "w_1")
    if found.site_kind == "input":
        place = plant.inputs[0].name
    values = found.starts(Scales(force=5.0, speed=1.0, position=0.4, dt=2e-3))[0]
    u = np.column_stack(list(record.inputs.values()))
    one = Simulator(plant, [(found, Site(found.site_kind, place))], u, record.dt, sub=2, motion=x)
    windows = Windows(np.array([0, 60, 120, 180]), 60)
    starts = [x[windows.starts] + off for off in (0.0, 0.01, -0.02)]
    alone = [one.run({}, [values], x0, windows) for x0 in starts]
    both = one.run({}, [values], np.concatenate(starts), windows)
    for field in ("states", "outputs", "forces"):
        assert np.array_equal(getattr(both, field), np.concatenate([getattr(run, field) for run in alone])), field


def true_windows(x):
    return x[np.array([0, 60, 120, 180])[:, None] + np.arange(60)]


# --- simulation about a motion ---------------------------------------------------------------------------------------


def test_about_its_own_motion_the_simulation_is_the_plants():
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


def test_an_effect_at_a_joint_is_what_the_same_parameter_makes():
    _, x = swing()
    more = arm(b_2=(0.3 + 0.5, 0.3))
    as_parameter = simulated(more, x)
    site = Site("joint", "w_2")
    as_effect = simulated(arm(), x, effects=[(effect("viscous-friction"), site)], values=[{"b": 0.5}])
    # Both leave the motion by 0.04 rad: they agree but for what that is of second order.
    assert np.abs(as_effect - as_parameter).max() < 5e-3 * np.abs(as_parameter - simulated(arm(), x)).max()


def test_dry_friction_holds_a_joint_still_to_rounding():
    rest = arm().equilibrium(q_1=0.3, q_2=-0.2)
    n = 200
    u = np.tile(rest.u, (n, 1))
    u[:, 0] += 0.5  # less than the friction holds
    x = np.tile(rest.x, (n, 1))
    run = Simulator(arm(), [(effect("coulomb-friction"), Site("joint", "w_1"))], u, 1e-3, sub=1, motion=x)
    states = run.run({}, [{"Fc": 2.0}], rest.x[None], Windows(np.array([0]), n)).states[0]
    assert np.abs(states[:, 1]).max() < 1e-13
    assert np.abs(states[:, 0] - 0.3).max() < 1e-13


def test_derivatives_from_near_by_matrices_are_those_of_the_plant():
    record, x = swing()
    u = np.column_stack(list(record.inputs.values()))
    run = Simulator(arm(), [], u, record.dt, sub=1, motion=x)
    windows = Windows(np.array([0, 60, 120, 180]), 60)
    start, step = x[windows.starts], {"m_2": 1.002}
    here = run.run({}, [], start, windows).outputs
    exact = run.run(step, [], start, windows).outputs - here
    near = run.run(step, [], start, windows, None, ({}, [])).outputs - here
    assert np.abs(near - exact).max() < 0.02 * np.abs(exact).max()


@pytest.mark.parametrize("name", ["viscous-friction", "inertia", "sensor-bias"])
def test_a_fit_that_keeps_its_matrices_ends_where_one_does_that_makes_them_anew(name, monkeypatch):
    """To the tolerance at which a fit ends; with an effect that changes nothing of the plant, its matrices, or the
    motion that its sensors tell.
    """
    plant = arm()
    record = arm_record(5, seconds=2.0, b_2=NOMINAL["b_2"] + 0.4, I_r2=1.1 * NOMINAL["I_r2"])
    ready = prepare(plant, ports_of(plant, record), record, 80)
    pool = candidates(plant, ports_of(plant, record), [ready])
    chosen = next(c for c in pool if c.effect.id == name and c.site.name in ("w_2", "I_r2", "q_2"))
    nuisances = nuisance_parameters(plant, stated_tolerances(plant, {}))

    def fitted():
        problem = Problem(plant, [ready], nuisances)
        z = np.append(np.zeros(len(nuisances)), chosen.standardised(chosen.starts[0]))
        return problem.fit(Hypothesis((chosen,)), first_noise(problem), z, plan=FitPlan(30, 1e-3))

    kept = fitted()
    monkeypatch.setattr(tuning, "NEAR", 0.0)
    anew = fitted()
    assert kept.cost == pytest.approx(anew.cost, abs=0.1)
    assert kept.evidence == pytest.approx(anew.evidence, abs=0.2)


# --- states from the sensors -----------------------------------------------------------------------------------------


def test_states_and_the_lacking_force_come_from_the_sensors():
    record = arm_record(5, seconds=2.0)
    u, y = np.column_stack(list(record.inputs.values())), np.column_stack(list(record.outputs.values()))
    heavier = arm_record(5, seconds=2.0, b_2=NOMINAL["b_2"] + 1.0)
    moved = smooth_motion(arm(), record.t, u, y, (0, 1)).smoothed
    inner = slice(50, -50)
    speed = np.gradient(
        np.column_stack([arm_record(5, seconds=2.0, noise=0.0)[f"q_{j}"] for j in (1, 2)]), 2e-3, axis=0
    )
    assert np.sqrt(np.mean((moved.x[inner, 1::2] - speed[inner]) ** 2)) < 0.01
    u, y = np.column_stack(list(heavier.inputs.values())), np.column_stack(list(heavier.outputs.values()))
    pushed = smooth_motion(arm(), heavier.t, u, y, (0, 1)).smoothed
    slope = np.polyfit(pushed.x[inner, 3], pushed.d[inner, 1], 1)[0]
    assert slope == pytest.approx(-1.0, rel=0.05)  # the force of a damper that the plant lacks


def test_a_state_without_a_sensor_follows_its_own_equations_though_the_plant_has_no_slopes_at_zero():
    tank = runpy.run_path(str(MODELS / "water_tank.py"))["water_tank"]()
    t = np.arange(0.0, 600.0)
    u = np.repeat(np.random.default_rng(1).uniform(2.5, 6.0, 12), 50)[:, None]
    run = rl.simulate(tank, t, u, [0.08, 0.08], hold="zoh")
    noisy = run["level"] + 0.01 * np.random.default_rng(2).standard_normal(len(t))
    moved = smooth_motion(tank, t, u, noisy[:, None], (0,)).smoothed
    levels = tank.trajectory(input_signal(t, u, "zoh"), np.array([0.08, 0.08]), 1e-9)
    # The upper tank's level at the start is a guess, forgotten with A/a sqrt(2 h/g) = 80 s.
    settled = slice(450, None)
    assert np.abs(moved.x[settled] - levels[settled]).max() < 0.01 * np.ptp(levels)
    found = rl.compare(tank, rl.Record(t, {"u": u[:, 0]}, {"level": noisy}, {"u": "V", "level": "V"}))
    assert found.outputs["level"].windowed_rms < 0.02


def test_a_joint_without_a_position_sensor_is_refused():
    record = arm_record(5, seconds=1.0)
    lame = rl.Record(record.t, record.inputs, {"q_1": record["q_1"]}, {"q_1": "rad"}, "lame")
    with pytest.raises(InputError, match=r"no measured output shows q_2"):
        rl.discover(arm(), lame)


def test_windows_are_shorter_than_an_instability_allows():
    record, _ = swing()
    falling = runpy.run_path(str(MODELS / "cart_pole.py"))["cart_pole"]()

    upright = rl.linearise(falling)
    a, b = upright.A, upright.B
    gain = b.T @ solve_continuous_are(a, b, np.eye(4), 0.1 * np.eye(1)) / 0.1
    start = np.array([0.1, 0.1, 0.0, 0.0])
    run, _ = closed_loop(falling, lambda _, x: -gain @ x, start, 1000, 2e-3, ["x", "theta"], 0.0)
    growth = np.linalg.eigvals(ports_of(falling, run).A).real.max()
    assert growth > 1.0
    assert 20 <= window_length(falling, [run]) <= np.log(20.0) / (growth * run.dt) + 1
    assert window_length(arm(), [record]) <= record.n // 4


# --- effects of machines with several joints and motors --------------------------------------------------------------


def test_a_motors_torque_constant_and_resistance_may_be_wrong_alone():
    plant = rl.plant("stewart-platform", preset="physical", motors=True)
    rest = plant.equilibrium()
    n = 8
    run = Simulator(plant, [], np.tile(rest.u, (n, 1)), 1e-3, sub=1, motion=np.tile(rest.x, (n, 1)))
    model = run.model({}, [])
    for name, names in (("torque-constant", ("Km", "Kb")), ("resistance", ("R",))):
        one = effect(name)
        assert [s.name for s in one.sites(plant, model)] == ["+".join(names), *(f"i_{k}" for k in range(1, 7))]
        whole = run.model(dict.fromkeys(names, 1.2), [])
        changed = model
        for k in range(1, 7):
            changed = one.extend(changed, Site("current", f"i_{k}"), {"s": 1.2})
        # (The currents' torque also stiffens the mechanism, which to a deviation from the motion is of second order.)
        for entries in ((slice(None), slice(None), slice(12, 18)), (slice(None), slice(12, 18), slice(None))):
            assert np.allclose(changed.A[entries], whole.A[entries], rtol=1e-9, atol=1e-9 * np.abs(whole.A).max())


def test_a_shifted_centre_and_a_tilted_base_are_parameters_of_the_platform():
    plant = rl.plant("stewart-platform", preset="physical", platform_cx=(0.002, 0.0))
    rest = plant.equilibrium()
    n = 8
    run = Simulator(plant, [], np.tile(rest.u, (n, 1)), 1e-3, sub=1, motion=np.tile(rest.x, (n, 1)))
    (site,) = effect("centre-of-mass").sites(plant, run.model({}, []))
    made = effect("centre-of-mass").factors(plant, site, {"x": 0.01, "y": -0.02, "z": 0.0})
    values = {name: plant.parameters[name].reference * f for name, f in made.items()}
    assert values == pytest.approx({"platform_cx": 0.012, "platform_cy": -0.02, "platform_cz": 0.0})
    (site,) = effect("gravity-direction").sites(plant, run.model({}, []))
    assert site.name == "tilt_x+tilt_y"
    motor = rl.plant("dc-motor")
    assert not effect("centre-of-mass").sites(motor, run.model({}, []))
    assert {p.name for p in effect("gravity-direction").parameters(Scales())} == {"x", "y"}


# --- whole ----------------------------------------------------------------------------------------------------------


def only(*names):
    return sorted(set(catalogue()) - set(names))


def test_friction_of_one_joint_is_named_at_that_joint():
    perturbed = {"m_2": 1.02 * NOMINAL["m_2"], "b_1": 1.2 * NOMINAL["b_1"], "I_r2": 0.95 * NOMINAL["I_r2"]}
    runs = [arm_record(seed, coulomb=(0.0, 0.5), **perturbed) for seed in (11, 12)]
    found = rl.discover(arm(), runs[0], held_out=runs[1], exclude=only(*FEW))
    assert (found.verdict, found.complete) == ("named", True)
    (one,) = found.effects
    assert (one.name, one.site) == ("coulomb-friction", "w_2")
    assert one.parameters[0].value == pytest.approx(0.5, rel=0.02)
    assert found.gap_after < 0.2 * found.gap_refitted
    again = rl.simulate(found.model, runs[1].t[:100], np.column_stack(list(runs[1].inputs.values()))[:100])
    assert np.isfinite(again["q_1"]).all()


def test_nothing_missing_is_said_of_an_arm_within_its_tolerances():
    perturbed = {"m_1": 0.98 * NOMINAL["m_1"], "b_2": 0.8 * NOMINAL["b_2"]}
    runs = [arm_record(seed, **perturbed) for seed in (21, 22)]
    found = rl.discover(arm(), runs[0], held_out=runs[1], exclude=only(*FEW))
    assert found.verdict == "no missing effect"
    assert not found.effects
