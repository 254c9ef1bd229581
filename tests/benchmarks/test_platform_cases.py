"""The blind platform: its machine against the plant and against known motions, its cases, and how answers count."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics import DAMPING, shares_behind

pytest.importorskip("pinocchio")

import platform_cases as pc
import platform_discover as pd
import platform_machine as pm

TOOL = {"platform_mass": 10.0, "platform_x": 0.09, "platform_y": 0.08, "platform_z": 0.11}
POSE = np.array([0.002, 0.001, 0.127, 0.01, -0.01, 0.02])
DT = 2e-3


def machine(motors, **values):
    known = {**TOOL, **values}
    plant = rl.plant("stewart-platform", preset="physical", motors=motors, **known)
    return plant, pm.Machine(pm.bodies(known), pm.Drives(), motors)


def inputs(plant, n, size):
    t = np.arange(n) * DT
    return t, rl.trim(plant, pose=POSE).u + size * np.sin(2 * np.pi * np.outer(t, np.arange(5, 11)) + np.arange(6))


def run(of, u, **more):
    return pm.simulate(of, POSE, len(u), DT, lambda k, _: u[k], **more)


# --- the machine -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("motors", "size"), [(True, 8.0), (False, 0.02)])
@pytest.mark.parametrize("crooked", [{}, {"platform_cx": 0.03, "platform_cz": -0.01, "tilt_x": 0.05, "tilt_y": -0.08}])
def test_without_effects_it_moves_as_the_plant(motors, size, crooked):
    plant, of = machine(motors, **crooked)
    t, u = inputs(plant, 120, size)
    start = rl.trim(plant, pose=POSE)
    expected = rl.simulate(plant, t, u, x0=start, hold="zoh")
    found = run(of, u, currents=start.x[12:] if motors else None)
    for i in range(6):
        assert np.ptp(found.phi[:, i]) > 0.05
        np.testing.assert_allclose(found.phi[:, i], expected[f"phi_{i + 1}"], rtol=0, atol=1e-7)
        np.testing.assert_allclose(found.rates[:, i], expected[f"phidot_{i + 1}"], rtol=0, atol=2e-6)


@pytest.mark.slow
def test_dry_friction_agrees_with_the_package():
    plant, of = machine(False)
    t, u = inputs(plant, 80, 0.01)
    of = replace(of, drives=of.drives.at(2, coulomb=0.03).at(4, coulomb=0.07))
    found = run(of, u)
    assert found.stuck[:, 4].mean() > 0.1, found.stuck.mean(axis=0)
    rubbing = rl.with_effects(
        plant, {"coulomb-friction@phidot_3": {"Fc": 0.03}, "coulomb-friction@phidot_5": {"Fc": 0.07}}
    )
    other = rl.simulate(rubbing, t, u, x0=rl.trim(plant, pose=POSE), step=1e-4)
    for i in range(6):
        np.testing.assert_allclose(found.phi[:, i], other[f"phi_{i + 1}"], rtol=0, atol=2e-3 * np.ptp(found.phi[:, 2]))


@pytest.mark.slow
@pytest.mark.parametrize(
    "fault",
    [{"coulomb": 0.05}, {"coulomb": 0.03, "breakaway": 0.03, "stribeck": 1.0}, {"gap": 0.2}, {"ripple": 0.02}],
)
def test_half_the_step_changes_nothing(fault):
    plant, of = machine(True)
    _, u = inputs(plant, 100, 20.0)
    of = replace(of, drives=of.drives.at(3, **fault))
    fine, coarse = run(of, u, step=2.5e-5), run(of, u)
    ideal = run(replace(of, drives=pm.Drives()), u)
    effect = np.abs(fine.clean - ideal.clean).max()
    assert effect > 5e-4
    assert np.abs(fine.clean - coarse.clean).max() < 0.1 * effect


@pytest.mark.slow
def test_delays_and_offsets_are_what_they_say():
    plant, of = machine(True)
    _, u = inputs(plant, 80, 8.0)
    plain = run(of, u)
    late = run(replace(of, drives=of.drives.at(0, delay_out=4e-3).at(5, offset=2.5)), u)
    np.testing.assert_allclose(late.phi, plain.phi, rtol=0, atol=1e-12)
    np.testing.assert_allclose(late.clean[2:, 0], plain.clean[:-2, 0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(late.clean[:, 5], plain.clean[:, 5] + 2.5, rtol=0, atol=1e-12)
    moved = u.copy()
    moved[3:, 2], moved[:3, 2] = u[:-3, 2], u[0, 2]
    expected = run(of, moved)
    found = run(replace(of, drives=of.drives.at(2, delay_in=6e-3)), u)
    np.testing.assert_allclose(found.phi, expected.phi, rtol=0, atol=1e-12)


# --- a gap at a leg: robustlab's law against the machine that knows nothing of it -------------------------------------

LEG = 2


def with_gap(motors, gap):
    plant = pc.nominal_plant(motors)
    drives = pm.Drives(**{key: plant.values[key] for key in pc.MOTOR}) if motors else pm.Drives()
    of = pm.Machine(pm.bodies(plant.values), drives, motors)
    return plant, replace(of, drives=of.drives.at(LEG, gap=gap))


def flank(of, reduced, monkeypatch):
    """Frequency in Hz of the machine's flank with the reduced inertia of rotor and load; its damping made the law's.

    The machine's own is a quarter less: what a rebound gives back decides on all that follows.
    """
    numbers = pm._numbers(of)
    omega = float(np.sqrt(numbers[LEG, pm.FLANK] / reduced))
    assert numbers[LEG, pm.DAMP] == pytest.approx(2 * DAMPING * omega * reduced, rel=0.3)
    numbers[LEG, pm.DAMP] = 2 * DAMPING * omega * reduced
    monkeypatch.setattr(pm, "_numbers", lambda _: numbers)
    return omega / (2 * np.pi)


@pytest.mark.slow
@pytest.mark.parametrize(("motors", "size"), [(False, 0.06), (True, 16.0)])
def test_the_law_moves_as_the_machine(motors, size, monkeypatch):
    gap = 0.15
    plant, of = with_gap(motors, gap)
    n, start = 150, rl.trim(plant, pose=POSE)
    t = np.arange(n) * DT
    u = np.tile(start.u, (n, 1))
    u[:, LEG] += size * np.sin(2 * np.pi * 11 * t)
    (share,) = shares_behind(plant, "phidot_3")
    rotor = plant.values["rotor_J"] * pc.GEAR**2
    values = {"gap": gap, "share": share, "f": flank(of, share * rotor, monkeypatch)}
    found = pm.simulate(of, POSE, n, DT, lambda k, _: u[k], currents=start.x[12:] if motors else None, step=1e-5)
    assert 0.1 < found.flights[:, LEG].mean() < 0.9
    rough = rl.with_effects(plant, {"backlash@phidot_3": values})
    x, _ = rough.stepped(t, u, np.append(start.x, [0.0, 0.0]), 1e-4)
    stiff, _ = rl.with_effects(plant, {"viscous-friction@phidot_1": {"b": 0.0}}).stepped(t, u, start.x, 1e-3)
    without = np.abs(stiff[:, :6] - found.clean).max(axis=0)
    others = [k for k in range(6) if k != LEG]
    assert np.abs(x[:, LEG] - found.clean[:, LEG]).max() < 0.02 * without[LEG]
    assert np.abs(x[:, len(start.x)] - (found.clean - found.phi)[:, LEG]).max() < 0.02 * gap
    assert (np.abs(x[:, others] - found.phi[:, others]).max(axis=0) < 0.05 * without[others]).all()


# --- the cases -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("name", "motors"), [(name, motors) for motors in (True, False) for name in pc.names(motors)])
def test_a_case_of_every_class(name, motors):
    case = pc.make_case(name, 3, motors=motors, duration=0.2)
    plant = pc.nominal_plant(motors)
    assert set(case.record.inputs) == {s.name for s in plant.inputs}
    assert case.record.n == case.held_out.n == 100
    assert not np.array_equal(case.record["phi_1"], case.held_out["phi_1"])
    assert len(case.legs) == (2 if name[:3] == "2x " else {"leg": 1, "all": 6, "common": 0}[pc.CLASSES[name].where])
    for key, factor in case.perturbed.items():
        assert abs(factor - 1.0) <= plant.parameters[key].tolerance
    if name != "none":
        assert all(case.values)
        assert repr(case.machine) != repr(case.bare)


# --- how answers count -----------------------------------------------------------------------------------------------


def hidden(name, *legs):
    effect = name.removeprefix("2x ").removesuffix("-all")
    return SimpleNamespace(name=name, effect=effect, legs=legs)


def counts(case, verdict, named, complete=True, sets=(), kinds=()):
    legs = pd.legs_of
    line = pd.verdict_of(case, verdict, complete, legs(named), [legs(s) for s in sets], legs(kinds))
    return line["right"], line["in_answer"], line["sure_wrong"]


def test_name_and_leg_count_together():
    case, true = hidden("coulomb-friction", 3), [("coulomb-friction", "phidot_3")]
    other = [("coulomb-friction", "phidot_2")]
    assert counts(case, "named", true) == (True, True, False)
    assert counts(case, "named", other) == (False, False, True)
    assert counts(case, "named", true + other) == (False, False, True)
    assert counts(case, "ambiguous", other, sets=[other, true]) == (False, True, False)
    assert counts(case, "no missing effect", []) == (False, False, False)
    two = hidden("2x coulomb-friction", 2, 3)
    assert counts(two, "named", true + other) == (True, True, False)
    assert counts(two, "named", true) == (False, False, True)
