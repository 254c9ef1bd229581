"""The blind platform: its machine against the plant and against known motions, its cases, and how answers count."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import robustlab as rl

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


def test_what_is_held_stays_and_what_is_not_moves():
    plant, of = machine(False)
    hold = rl.trim(plant, pose=POSE).u
    of = replace(of, drives=of.drives.at(1, coulomb=0.02, breakaway=0.01, stribeck=0.1))
    extra = np.zeros((50, 6))
    extra[:, 1] = 0.029 / pc.GEAR
    held, gone = run(of, hold + extra), run(of, hold + 1.1 * extra)
    assert np.ptp(held.phi[:, 1]) == 0.0
    assert held.stuck[:, 1].all()
    assert gone.rates[-1, 1] > 1.0
    # once it slides, the difference of drive and sliding friction accelerates it
    assert 0.0 < gone.stuck[:, 1].mean() < 0.1


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


def test_the_rotor_stays_within_the_gap():
    plant, of = machine(True)
    _, u = inputs(plant, 80, 25.0)
    of = replace(of, drives=of.drives.at(3, gap=0.03))
    found = run(of, u)
    apart = found.clean[:, 3] - found.phi[:, 3]
    assert found.flights[:, 3].sum() > 3
    assert np.abs(apart).max() < 0.025  # the flanks give way, a little
    assert apart.min() < -0.0149  # both are met
    assert apart.max() > 0.0149
    np.testing.assert_array_equal(found.clean[:, :3], found.phi[:, :3])


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


# --- the cases -------------------------------------------------------------------------------------------------------

EVERY = [
    pytest.param(name, motors, marks=[] if motors or name == "input-gain" else pytest.mark.slow)
    for motors in (True, False)
    for name in pc.names(motors)
]


@pytest.mark.parametrize(("name", "motors"), EVERY)
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


def test_a_seed_is_a_case_and_files_keep_it(tmp_path):
    a, b = (pc.make_case("cogging", seed, duration=0.4) for seed in (5, 6))
    first, again = (pc.cached_case(tmp_path, "cogging", 5, duration=0.4) for _ in range(2))
    assert first.machine is not None
    assert again.machine is None
    assert again.truth() == a.truth() != b.truth()
    for name in (*a.record.inputs, *a.record.outputs):
        np.testing.assert_array_equal(again.record[name], a.record[name])
        np.testing.assert_array_equal(again.held_out[name], a.held_out[name])


def test_the_path_is_rich_and_within_reach():
    poses, phi = pc.reference(2, 0, 4000)
    lengths = pm.oracle().PinocchioStewart().lengths(poses[1234])
    assert np.abs(lengths - pc.MIDDLE).max() < 0.0125
    rates = np.diff(phi, axis=0) / DT
    assert np.abs(rates).max() * 0.052 * pc.GEAR < 0.7 * pc.U_MAX
    reversals = np.sum(np.diff(np.sign(rates), axis=0) != 0, axis=0)
    assert reversals.min() > 10
    assert (np.abs(rates) < 0.01).mean() > 0.03  # rests
    assert np.ptp(phi, axis=0).min() > 6.0  # a whole turn of every nut


def test_unknown_names_are_refused():
    with pytest.raises(ValueError, match="one of none"):
        pc.make_case("resistance", 1, motors=False)
    with pytest.raises(ValueError, match="noise"):
        pc.make_case("none", 1, noise="loud")


# --- how answers count -----------------------------------------------------------------------------------------------


def hidden(name, *legs):
    effect = name.removeprefix("2x ").removesuffix("-all")
    return SimpleNamespace(name=name, effect=effect, legs=legs)


def counts(case, verdict, named, complete=True, sets=(), kinds=()):
    said = pd.said_of(named)
    line = pd.verdict_of(case, verdict, complete, said, [pd.said_of(s) for s in sets], pd.said_of(kinds))
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


def test_a_kind_at_its_leg_counts_as_the_effect():
    late, here = hidden("input-delay", 4), [("lateness", "torque_4 to phi_4")]
    either = [[("input-delay", "torque_4")], [("sensor-delay", "phi_4")]]
    assert counts(late, "named", [("sensor-delay", "phi_4")], kinds=here) == (True, True, False)
    assert counts(late, "named", either[0], kinds=here) == (True, True, False)
    assert counts(late, "ambiguous", [], sets=either, kinds=here) == (False, True, False)
    assert counts(late, "named", either[1], kinds=[("lateness", "torque_3 to phi_3")]) == (False, False, True)
    assert counts(late, "named", either[1], kinds=[*here, ("load", "phidot_1")]) == (False, False, True)
    line = pd.verdict_of(late, "named", True, pd.said_of(either[1]), [], pd.said_of(here))
    assert (line["right"], line["by_name"]) == (True, False)
    assert counts(hidden("none"), "named", either[0], kinds=here) == (False, False, True)


def test_what_is_nowhere_and_what_is_nothing():
    assert counts(hidden("platform-mass"), "named", [("inertia", "platform_mass")]) == (True, True, False)
    assert counts(hidden("none"), "no missing effect", []) == (True, True, False)
    assert counts(hidden("none"), "named", [("cogging", "phidot_1")]) == (False, False, True)
    assert counts(hidden("cable"), "unknown", []) == (True, True, False)
    assert counts(hidden("cable"), "named", [("cogging", "phidot_1")], complete=False) == (True, True, False)
    assert counts(hidden("cable"), "named", [("cogging", "phidot_1")]) == (False, False, True)
    everywhere = hidden("resistance-all", 1, 2, 3, 4, 5, 6)
    assert counts(everywhere, "named", [("resistance", "")]) == (True, True, False)
    assert counts(everywhere, "named", [("resistance", "i_1")]) == (False, False, True)


def test_the_report_counts_what_was_lost(tmp_path):
    ok = {"status": "ok", "right": True, "in_answer": True, "sure_wrong": False, "cpu_s": 12.0, "verdict": "named",
          "gap_before": 5.0, "gap_after": 1.0}  # fmt: skip
    lines = [
        {"key": "a", "name": "cogging", **ok},
        {"key": "b", "name": "cogging", "status": "timed out"},
        {"key": "c", "name": "none", **ok, "verdict": "named", "right": False},
    ]
    text = pd.report(lines)
    assert "ALL one effect               2      1" in text
    assert "nothing missing -> a name: 1 of 1 (100 %)" in text
    assert "shrinks by (median of what is right): 5.0" in text
    store = tmp_path / "store.jsonl"
    store.write_text("\n".join(json.dumps(line) for line in lines) + '\n{"key": "d", "na')
    assert set(pd.stored(store)) == {"a", "b", "c"}
