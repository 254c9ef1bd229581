"""Nonlinear plants with effects, against other integrators and closed forms."""

import runpy
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import robustlab as rl
from robustlab.dynamics import AttachedEffect, Scales, catalogue, extended_model

PLANTS = Path(__file__).parents[3] / "models" / "plants"


@cache
def maker(name):
    return runpy.run_path(str(PLANTS / f"{name}.py"))[name]


@cache
def arm():
    return maker("two_link_arm")()


@cache
def platform(motors=False):
    return rl.plant("stewart-platform", motors=motors)


def coupling():
    return {"f": 25.0, "zeta": 0.05, "share": 0.3}


# --- the arm, by hand ------------------------------------------------------------------------------------------------


def arm_terms(q, w, p):
    """Mass matrix, and the torques against the drive, of the two-link arm."""
    a2 = p["m_2"] * p["l_1"] * p["c_2"]
    a3 = p["I_2"] + p["m_2"] * p["c_2"] ** 2
    a1 = p["I_1"] + p["I_2"] + p["m_1"] * p["c_1"] ** 2 + p["m_2"] * (p["l_1"] ** 2 + p["c_2"] ** 2) + p["I_r1"]
    mass = np.array([[a1 + 2 * a2 * np.cos(q[1]), a3 + a2 * np.cos(q[1])], [a3 + a2 * np.cos(q[1]), a3 + p["I_r2"]]])
    swing = a2 * np.sin(q[1]) * np.array([-(2 * w[0] * w[1] + w[1] ** 2), w[0] ** 2])
    fall = p["m_2"] * p["g"] * p["c_2"] * np.cos(q[0] + q[1])
    weight = np.array([(p["m_1"] * p["c_1"] + p["m_2"] * p["l_1"]) * p["g"] * np.cos(q[0]) + fall, fall])
    return mass, swing + weight + np.array([p["b_1"] * w[0], p["b_2"] * w[1]])


def unwrapped(x):
    """Angles and speeds (n, 4) of the states q_1, w_1, q_2, w_2 (n, 4)."""
    return x[:, [0, 2, 1, 3]]


def arm_energy(x, p):
    still = {**p, "b_1": 0.0, "b_2": 0.0}
    mass, _ = arm_terms(x[:2], x[2:], still)
    height = (p["m_1"] * p["c_1"] + p["m_2"] * p["l_1"]) * np.sin(x[0]) + p["m_2"] * p["c_2"] * np.sin(x[0] + x[1])
    return 0.5 * x[2:] @ mass @ x[2:] + p["g"] * height


def arm_with_events(times, torques, friction, p):
    """States at the times, torques held in between: each joint slides or sticks, and changes at located events."""
    x, mode, found = np.zeros(4), [0, 0], [np.zeros(4)]

    def motion(x, torque, mode):
        """Accelerations, and the torques that hold the joints that stick."""
        mass, against = arm_terms(x[:2], x[2:], p)
        push = torque - against - np.array(mode) * friction
        free = [j for j in (0, 1) if mode[j]]
        acceleration = np.zeros(2)
        if free:
            acceleration[free] = np.linalg.solve(mass[np.ix_(free, free)], push[free])
        return acceleration, push - mass @ acceleration

    for start, end, torque in zip(times[:-1], times[1:], torques, strict=False):
        t = start
        while t < end:
            for _ in range(4):  # joints that break away, or would turn at once against their friction
                acceleration, hold = motion(x, torque, mode)
                before = list(mode)
                for j in (0, 1):
                    if mode[j] == 0 and abs(hold[j]) > friction[j] * (1 + 1e-12):
                        mode[j] = int(np.sign(hold[j]))
                    elif mode[j] and x[2 + j] == 0.0 and acceleration[j] * mode[j] < 0:
                        mode[j] = 0
                if mode == before:
                    break

            def rates(_, s, mode=tuple(mode), torque=torque):
                return np.concatenate([s[2:], motion(s, torque, mode)[0]])

            def stops(_, s, mode=tuple(mode)):
                return min((s[2 + j] * mode[j] for j in (0, 1) if mode[j]), default=1.0)

            def breaks(_, s, mode=tuple(mode), torque=torque):
                hold = motion(s, torque, mode)[1]
                return min((friction[j] - abs(hold[j]) for j in (0, 1) if not mode[j]), default=1.0)

            stops.terminal, stops.direction = True, -1
            breaks.terminal, breaks.direction = True, -1
            run = solve_ivp(rates, (t, end), x, "DOP853", rtol=1e-11, atol=1e-13, events=[stops, breaks], max_step=0.02)
            t, x = run.t[-1], run.y[:, -1].copy()
            if run.status == 1 and len(run.t_events[0]):
                j = min((j for j in (0, 1) if mode[j]), key=lambda j: x[2 + j] * mode[j])
                x[2 + j], mode[j] = 0.0, 0
            elif run.status == 1:
                j = min(
                    (j for j in (0, 1) if not mode[j]), key=lambda j: friction[j] - abs(motion(x, torque, mode)[1][j])
                )
                mode[j] = int(np.sign(motion(x, torque, mode)[1][j]))
        found.append(x.copy())
    return np.array(found)


def test_an_arm_with_dry_friction_matches_an_event_driven_solution():
    """Both joints slide, reverse, stick and break away."""
    held, friction = 0.1, np.array([1.5, 0.8])
    times = held * np.arange(21)
    rng = np.random.default_rng(5)
    torques = np.array([10.0, 3.0]) + rng.uniform(-1, 1, (21, 2)) * [8.0, 3.0]
    torques[6:10] = [8.0, 2.5]
    true = arm_with_events(times, torques, friction, arm().values)
    rough = rl.with_effects(arm(), {"coulomb-friction@w_1": {"Fc": 1.5}, "coulomb-friction@w_2": {"Fc": 0.8}})
    t = 1e-3 * np.arange(2001)
    x, _ = rough.stepped(t, np.repeat(torques, 100, axis=0)[:2001], np.zeros(4), 1e-3)
    x = unwrapped(x)
    assert (true[1:, 2:] == 0).any()
    assert np.abs(x[::100] - true).max() < 2e-5 * np.abs(true).max()
    assert (np.abs(x[::100, 2:][true[:, 2:] == 0]) < 1e-15).all()


def test_energy_goes_into_dry_friction_and_nowhere_else():
    free = arm().with_parameters(b_1=0.0, b_2=0.0)
    rough = rl.with_effects(free, {"coulomb-friction@w_1": {"Fc": 0.6}})
    t = 1e-3 * np.arange(1501)
    x, _ = rough.stepped(t, np.zeros((1501, 2)), np.array([0.5, 0.0, 0.3, 0.0]), 1e-3)
    x = unwrapped(x)
    path = np.abs(np.diff(x[:, 0])).sum()
    lost = arm_energy(x[0], free.values) - arm_energy(x[-1], free.values)
    assert path > 1.0
    assert lost == pytest.approx(0.6 * path, rel=1e-4)


@pytest.mark.parametrize(
    "effects", [{"flexible-coupling@w_2": coupling()}, {"backlash@w_2": {"gap": 0.05, "share": 0.4, "f": 15.0}}]
)
def test_a_load_behind_a_joint_matches_its_rates(effects):
    rough = rl.with_effects(arm(), effects)
    t = 1e-3 * np.arange(601)
    u = np.array([4.0, 2.0])
    x, _ = rough.stepped(t, np.tile(u, (601, 1)), np.zeros(6), 2.5e-4)
    true = solve_ivp(
        lambda _, x: rough.derivative(x, u), (0.0, 0.6), np.zeros(6), "LSODA", rtol=1e-8, atol=1e-10, t_eval=t[::50]
    ).y.T
    assert np.abs(true[:, 4]).max() > 1e-4
    assert np.abs(x[::50] - true).max() < 1e-4 * np.abs(true).max()


@pytest.mark.parametrize("effects", [{"cubic-stiffness@w_2": {"k3": 30.0}}, {"viscous-friction@b_1": {"s": 1.3}}])
def test_smooth_effects_are_fourth_order_in_the_step(effects):
    rough = rl.with_effects(arm(), effects)
    t = 0.016 * np.arange(60)
    u = np.column_stack([5 + 3 * np.sin(4 * t), 2 * np.cos(3 * t)])
    runs = [rough.stepped(t, u, np.zeros(4), 0.016 / parts)[0] for parts in (1, 2, 4, 32)]
    errors = [np.abs(run - runs[-1]).max() for run in runs[:-1]]
    assert errors[0] > 11 * errors[1] > 121 * errors[2]


@pytest.mark.parametrize("name", ["arm", "platform"])
def test_every_effect_that_has_a_place_can_be_simulated_and_has_a_linear_model(name):
    plant = arm() if name == "arm" else platform(motors=True)
    home, t = rl.trim(plant), 1e-3 * np.arange(20)
    u = home.u + 0.2 * np.abs(home.u).max() * np.sin(40 * t)[:, None]
    model, tried = extended_model(plant, []), 0
    for kind in catalogue().values():
        for site in kind.sites(plant, model)[:1]:
            force_unit = "N m" if site.kind in ("joint", "current") else ""
            seen = Scales(force_unit=force_unit, lowest=-1.0, highest=1.0, orders=(5.0,), lines=(10.0,), side=1)
            rough = rl.with_effects(plant, AttachedEffect(kind, site, kind.starts(seen)[0]))
            x, y = rough.stepped(t, u, home.x, 1e-3)
            assert np.isfinite(x).all()
            assert np.isfinite(y).all()
            assert rl.linearise(rough, (rough.whole_state(home.x), home.u)).n_states == len(rough.states)
            tried += 1
    assert tried > 30


# --- inputs, outputs, parameters -------------------------------------------------------------------------------------


def drive(n=400):
    t = 2e-3 * np.arange(n)
    return t, np.column_stack([8 + 4 * np.sin(5 * t), 2 + np.sign(np.sin(11 * t))])


def test_a_delayed_input_is_the_shifted_input():
    t, u = drive()
    late = u.copy()
    late[5:, 0], late[:5, 0] = u[:-5, 0], u[0, 0]
    record = rl.simulate(rl.with_effects(arm(), {"input-delay@torque_1": {"d": 0.01}}), t, u)
    own = rl.simulate(arm(), t, late, rtol=1e-10)
    assert np.array_equal(record["torque_1"], u[:, 0])
    for name in ("q_1", "q_2"):
        assert np.abs(record[name] - own[name]).max() < 1e-7


# --- rest and linear models ------------------------------------------------------------------------------------------


def test_friction_holds_an_arm_and_the_trim_has_the_forces():
    rough = rl.with_effects(arm(), {"coulomb-friction@w_1": {"Fc": 1.0}})
    free = rl.trim(arm(), q_1=0.4, q_2=0.2)
    held = rl.trim(rough, q_1=0.4, q_2=0.2, torque_1=free.u[0] - 0.7)
    (holding,) = held.holding
    assert holding.force == pytest.approx(0.7, rel=1e-9)
    assert held.u[1] == pytest.approx(free.u[1], rel=1e-9)
    assert rl.trim(rough, q_1=0.4, q_2=0.2).holding[0].force == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(rl.NoTrustworthyNumber, match="no rest"):
        rl.trim(rough, q_1=0.4, q_2=0.2, torque_1=free.u[0] - 1.3)


def test_a_platform_with_a_constant_load_is_trimmed_at_its_pose():
    plant, pose = platform(motors=True), [0.004, 0.0, 0.128, 0.02, 0.0, 0.0]
    load = rl.with_effects(plant, {"constant-load@phidot_2": {"T0": 0.03}})
    free, held = rl.trim(plant, pose=pose), rl.trim(load, pose=pose)
    p = plant.values
    assert np.allclose(held.x[:12], free.x[:12], rtol=0, atol=1e-12)
    assert np.array_equal(rl.linearise(load, pose).A, rl.linearise(load, held).A)
    change = np.abs(held.u - free.u)
    assert change[1] == pytest.approx(0.03 / p["ratio"] / p["Km"] * p["R"], rel=1e-8)
    assert np.delete(change, 1).max() < 1e-9


def test_the_linear_model_has_the_slopes_of_the_rates():
    rough = rl.with_effects(
        arm(),
        {
            "flexible-coupling@w_2": coupling(),
            "cubic-stiffness@w_1": {"k3": 4.0},
            "sensor-gain@q_1": {"s": 1.1},
        },
    )
    x, u = np.array([0.3, 0.5, -0.2, -0.4, 0.01, 0.2]), np.array([3.0, 1.0])
    model = rl.linearise(rough, (x, u))
    h = 1e-6
    a = np.column_stack([(rough.derivative(x + d, u) - rough.derivative(x - d, u)) / (2 * h) for d in h * np.eye(6)])
    assert np.allclose(model.A, a, rtol=1e-6, atol=1e-5 * np.abs(a).max())
    assert model.C[0, 0] == pytest.approx(1.1)


# --- files, json, updated plants -------------------------------------------------------------------------------------


def test_a_platform_with_effects_comes_back_from_its_file(tmp_path):
    rough = rl.with_effects(
        platform(motors=True).with_parameters(platform_mass=(3.3, 0.02)),
        {"coulomb-friction@phidot_3": {"Fc": (0.02, 1e-3)}, "torque-constant@Km+Kb": {"s": 1.1}},
    )
    rl.save(tmp_path / "platform.h5", rough)
    back = rl.load(tmp_path / "platform.h5")
    assert repr(back) == repr(rough)
    assert back.to_json() == rough.to_json()
    home = rl.trim(rough)
    u = np.tile(home.u + 0.5, (50, 1))
    one, other = (rl.simulate(p, 1e-3 * np.arange(50), u, home.x, step=1e-3) for p in (rough, back))
    assert all(np.array_equal(one[name], other[name]) for name in one.outputs)


@pytest.mark.parametrize(
    "effects",
    [
        {"presliding@w_1": {"Fc": 1.0, "sigma0": 300.0}},
        {"torque-ripple@w_1": {"Ac": 0.5, "As": 0.2, "f": 7.0}},
        {"backlash@w_2": {"gap": 0.05, "share": 0.4, "f": 15.0}},
    ],
)
def test_memory_time_and_further_states_go_on_from_block_to_block(effects, monkeypatch):
    rough = rl.with_effects(arm(), effects)
    t, u = drive(200)
    long, _ = rough.stepped(t, u, np.zeros(4 + 2 * ("backlash@w_2" in effects)), 1e-3)
    monkeypatch.setattr("robustlab.dynamics.extended.simulator.FIRST", 7)
    monkeypatch.setattr("robustlab.dynamics.extended.simulator.MOST", 7)
    short, _ = rough.stepped(t, u, np.zeros(4 + 2 * ("backlash@w_2" in effects)), 1e-3)
    assert np.abs(long - short).max() < 1e-6 * np.abs(long).max()
