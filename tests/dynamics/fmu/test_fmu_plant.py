"""Model exchange: against the linear plant of the same machine, closed forms, and what units do wrong."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from fmu_units import needs_compiler

import robustlab as rl
from robustlab.dynamics.fmu import FmuPlant
from robustlab.errors import NativeTimeout
from robustlab.provenance import BY_DIFFERENCES

pytestmark = needs_compiler
T = np.linspace(0.0, 2.0, 101)
U = np.sin(3 * T)


def same_machine(m=2.0, c=0.4, k=8.0):
    return rl.plant("mass-spring-damper", m=m, c=c, k=k)


def children():
    return {int(p.name) for p in Path("/proc").iterdir() if p.name.isdigit() and parent(p) == os.getpid()}


def parent(process):
    try:
        return int((process / "stat").read_text().rpartition(")")[2].split()[1])
    except OSError:
        return 0


@pytest.mark.parametrize("version", [2, 3])
def test_a_unit_is_the_linear_plant_of_the_same_machine(plant_of, version):
    plant, truth = plant_of(version), same_machine()
    assert isinstance(plant, FmuPlant)
    assert [tuple(s) for s in (*plant.inputs, *plant.outputs, *plant.states)] == [
        *[("F", "N"), ("q", "m"), ("a", "m/s2"), ("q", "m"), ("v", "m/s")]
    ]
    assert plant.start.tolist() == [0.5, 0.0]
    assert plant.unused_signals == (("on",) if version == 2 else ())
    model, wanted = rl.linearise(plant), truth.to_model()
    np.testing.assert_allclose(model.A, wanted.A, atol=1e-14)
    np.testing.assert_allclose(model.B, wanted.B, atol=1e-14)
    np.testing.assert_allclose(model.D, [[0.0], [0.5]], atol=1e-14)
    assert next(iter(model.provenance.inputs.values())) == plant.process.sha256
    for hold, close in (("zoh", 1e-13), ("foh", 1e-9)):
        record, exact = rl.simulate(plant, T, U, hold=hold), rl.simulate(truth, T, U, [0.5, 0.0], hold=hold)
        np.testing.assert_allclose(record["q"], exact["q"], atol=close)
        a = np.gradient(exact["v"], T, edge_order=2)
        assert np.abs(record["a"] - a)[5:-5].max() < 0.3  # it jumps with the force held
    smooth = rl.simulate(plant, T, U, [0.1, 0.2], hold="spline")["q"]
    fine = np.linspace(0, 2, 2001)
    exact = rl.simulate(truth, fine, np.sin(3 * fine), [0.1, 0.2], hold="foh")["q"][::20]
    np.testing.assert_allclose(smooth, exact, atol=2e-7)
    with pytest.raises(rl.InputError, match="its steps are chosen"):
        rl.simulate(plant, T, U, step=1e-3)


def test_parameters_have_units_signs_and_tolerances_of_the_users(unit):
    plant = rl.plant(unit(2), m=(2.5, 0.1), k=4.0)
    assert (plant.parameters["m"].unit, plant.parameters["c"].unit) == ("kg", "N s/m")
    assert (plant.parameters["m"].sign, plant.parameters["c"].sign) == ("positive", "nonnegative")
    assert plant.parameters["m"].tolerance == 0.1
    np.testing.assert_allclose(rl.linearise(plant).A[1], [-4 / 2.5, -0.4 / 2.5])
    np.testing.assert_allclose(plant.with_parameters(c=1.0).derivative([0.0, 1.0], [0.0])[1], -1 / 2.5)
    np.testing.assert_allclose(plant.derivative([0.0, 1.0], [0.0])[1], -0.4 / 2.5)
    with pytest.raises(rl.InputError, match="no such parameter"):
        rl.plant(unit(2), mass=1.0)
    with pytest.raises(rl.InputError, match="positive value"):
        rl.plant(unit(2), m=-1.0)


@pytest.mark.parametrize("version", [2, 3])
def test_derivatives_are_the_units_own_or_labelled_differences(unit, plant_of, version, tmp_path):
    own, numeric = (plant_of(version, directional=own).with_parameters(k3=4.0) for own in (True, False))
    assert (own.derivatives, numeric.derivatives) == ("directional", "differences")
    x, u = [0.3, 0.1], [1.0]
    slope = -(8 + 12 * 0.3**2) / 2
    for plant, close in ((own, 1e-15), (numeric, 1e-11)):
        A, B, C, D = plant.jacobians(x, u)
        np.testing.assert_allclose(A, [[0, 1], [slope, -0.2]], atol=close)
        np.testing.assert_allclose(B, [[0], [0.5]], atol=close)
        np.testing.assert_allclose(C, [[1, 0], [slope, -0.2]], atol=close)
        np.testing.assert_allclose(D, [[0], [0.5]], atol=close)
    assert own.difference_error(x, u) == 0.0
    assert 0 < numeric.difference_error(x, u) < 1e-5
    model = rl.linearise(numeric, at=(x, u))
    assert BY_DIFFERENCES in model.provenance.note
    assert BY_DIFFERENCES not in rl.linearise(own, at=(x, u)).provenance.note
    loaded = rl.load(rl.save(tmp_path / "model.h5", model))
    assert BY_DIFFERENCES in loaded.provenance.note
    with pytest.raises(rl.InputError, match=r"a program, which a file cannot hold"):
        rl.save(tmp_path / "plant.h5", own)
    with pytest.raises(rl.InputError, match="has no directional ones"):
        rl.plant(unit(version, directional=False), derivatives="directional")


def test_a_plant_comes_to_rest_where_it_is_asked_to(plant_of):
    plant = plant_of().with_parameters(k3=4.0)
    at_zero = rl.trim(plant)
    np.testing.assert_allclose(at_zero.x, [0, 0], atol=1e-9)
    held = rl.trim(plant, q=0.5)
    np.testing.assert_allclose(held.u, [8 * 0.5 + 4 * 0.5**3], rtol=1e-9)
    pushed = rl.trim(plant, F=4.5)
    np.testing.assert_allclose(pushed.x, [0.5, 0], atol=1e-8)
    with pytest.raises(rl.InputError, match="no state, input or output"):
        rl.trim(plant, force=1.0)


@pytest.mark.parametrize("version", [2, 3])
def test_events_of_state_and_time_are_where_they_happen(plant_of, version):
    plant = plant_of(version, events=True)
    free = {"c": 0.0, "k": 1e-3, "m": 1e9}  # it flies at constant speed
    flying = plant.with_parameters(**free, wall=1.0)
    q = rl.simulate(flying, T, np.zeros(101), [0.5, 0.8])["q"]
    np.testing.assert_allclose(q, 0.5 + np.where(T < 0.625, 0.8 * T, 1.0 - 0.8 * T), atol=1e-10)
    kicked = plant.with_parameters(**free, kick_time=0.7391)
    q = rl.simulate(kicked, T, np.zeros(101), [0.0, 0.0])["q"]
    np.testing.assert_allclose(q, np.maximum(T - 0.7391, 0.0), atol=1e-10)
    # A point has the mode that the unit takes there, whatever was asked before.
    A = plant.jacobians([0.3, 0.1], [0.0])[0]
    np.testing.assert_allclose(A, [[0, 1], [-4, -0.2]], atol=1e-12)
    with pytest.raises(rl.NoTrustworthyNumber, match="an event there moves the states"):
        flying.derivative([1.5, 1.0], [0.0])


@pytest.mark.parametrize("version", [2, 3])
def test_local_models_and_joints(unit, plant_of, version):
    rng = np.random.default_rng(1)
    x, u = rng.normal(size=(50, 2)), rng.normal(size=(50, 1))
    plant = plant_of(version, joint=True).with_parameters(k3=4.0)
    local = plant.local_models(x, u)
    for k in (0, 49):
        for name, wanted in zip("ABCD", plant.jacobians(x[k], u[k]), strict=True):
            np.testing.assert_array_equal(getattr(local, name)[k], wanted)
        np.testing.assert_array_equal(local.rates[k], plant.derivative(x[k], u[k]))
    (place,) = plant.port_places
    assert (place.name, place.kind, place.unit, place.position) == ("v", "joint", "N", "q")
    assert plant.joints_source == "its description"
    np.testing.assert_array_equal(local.push[:, :, 0], np.tile([0.0, 0.5], (50, 1)))
    stated = rl.plant(unit(version), joints={"v": {"position": "q", "inertia": "m"}})
    assert (stated.joints_source, stated.port_places[0].unit) == ("stated by the user", "N")
    push = stated.local_models(x, u, {**stated.values, "m": 4.0}).push
    np.testing.assert_array_equal(push[:, :, 0], np.tile([0.0, 0.25], (50, 1)))
    assert plant_of(version).port_places == ()


def test_joints_that_there_are_not(unit):
    for wrong in ({"w": {"input": "F"}}, {"v": {"input": "G"}}, {"v": {}}, {"v": {"input": "F", "gear": "2"}}, 3):
        with pytest.raises(rl.InputError):
            rl.plant(unit(2), joints=wrong)


def test_samples_over_parameters_are_the_linear_plant_at_the_same_values(plant_of):
    plant = plant_of().with_parameters(m=(2.0, 0.2), k=(8.0, 0.1))
    found = rl.sample(plant, 2, seed=3, vertices="all")
    answer = found.respond(T, 1.0, [0.0, 0.0])
    assert answer.y.shape == (6, 101, 2)
    for y, member in zip(answer.y, found.plants(), strict=True):
        truth = same_machine(m=member.values["m"], k=member.values["k"])
        np.testing.assert_allclose(y[:, 0], rl.simulate(truth, T, np.ones(101))["q"], atol=1e-12)
    assert (answer.lower <= answer.nominal).all()
    assert found.deltas[2] == {"m": -1.0, "k": -1.0}
    with pytest.raises(rl.InputError, match="has a tolerance"):
        rl.sample(plant_of(), 3)
    with pytest.raises(rl.InputError, match=r"plant\.uncertain"):
        rl.sample(same_machine(), 3)


def test_a_plant_goes_to_another_process(plant_of):
    plain = plant_of()
    again = pickle.loads(pickle.dumps(plain))
    np.testing.assert_array_equal(again.derivative([0.1, 0.2], [0.3]), plain.derivative([0.1, 0.2], [0.3]))


# --- what units do wrong ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", [2, 3])
def test_a_crash_is_one_line_and_the_next_call_is_answered(plant_of, version):
    plant = plant_of(version)
    with pytest.raises(rl.NoTrustworthyNumber, match=r"the unit crashed \(signal 11\)") as caught:
        plant.with_parameters(fault=1).derivative([0.0, 0.0], [0.0])
    assert caught.value.exit_code == 4
    np.testing.assert_allclose(plant.derivative([0.0, 1.0], [0.0]), [1.0, -0.2])


def test_a_hang_ends_at_the_time_limit_and_leaves_no_process(unit):
    before = children()
    plant = rl.plant(unit(2), fault=2, time_limit=0.5)
    with pytest.raises(NativeTimeout, match=r"no answer in its 0\.5 s") as caught:
        plant.derivative([0.0, 0.0], [0.0])
    assert "not repeatable" in caught.value.hint
    assert children() <= before
    for wrong in (0, -1.0, "1", float("inf")):
        with pytest.raises(rl.InputError, match="time_limit"):
            rl.plant(unit(2), time_limit=wrong)


FAULTS = [
    (3, "the rate of v is nan at t = 0 s"),
    (5, "the unit ended the simulation"),
    (9, "does not settle"),
]


@pytest.mark.parametrize("version", [2, 3])
def test_faults_while_it_runs(plant_of, version):
    plant = plant_of(version)
    for fault, message in FAULTS:
        with pytest.raises(rl.NoTrustworthyNumber, match=message):
            rl.simulate(plant.with_parameters(fault=fault), T, U)
    with pytest.raises(rl.NoTrustworthyNumber, match='"the spring is broken"'):
        plant.with_parameters(fault=6).derivative([0, 0], [0])
    with pytest.raises(rl.NoTrustworthyNumber, match="depend on time itself"):
        plant.with_parameters(fault=7).derivative([0, 0], [0])
    with pytest.raises(rl.NoTrustworthyNumber, match=r"derivative of the rate of v by q is -6, .* give -4"):
        plant.with_parameters(fault=8).jacobians([0, 0], [0])
    with pytest.raises(rl.NoTrustworthyNumber, match="the rate of v is nan at point 1"):
        plant.with_parameters(fault=3).local_models(np.array([[-1.0, 0], [1.0, 0]]), np.zeros((2, 1)))


def test_a_file_that_has_changed_is_not_run_again(unit, tmp_path):
    path = tmp_path / "copy.fmu"
    path.write_bytes(Path(unit(2)).read_bytes())
    plant = rl.plant(str(path))
    plant.process.close()
    path.write_bytes(Path(unit(3)).read_bytes())
    with pytest.raises(rl.InputError, match="is not the file that it was"):
        plant.derivative([0, 0], [0])


def test_another_integrator_finds_the_same_motion(unit, plant_of):
    """FMPy's own simulation, by CVODE, in a process of its own: a hardening spring that hits a wall."""
    values = {"k3": 40.0, "wall": 0.6, "kick_time": 0.31}
    program = (
        "import json, sys, fmpy\n"
        "found = fmpy.simulate_fmu(sys.argv[1], start_values=json.loads(sys.argv[2]),\n"
        "    fmi_type='ModelExchange', relative_tolerance=1e-8, output_interval=0.02, output=['q'], stop_time=2.0)\n"
        "print(json.dumps([found['time'].tolist(), found['q'].tolist()]))\n"
    )
    command = [sys.executable, "-c", program, unit(2, events=True), json.dumps({**values, "F": 1.5})]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    time, theirs = json.loads(done.stdout.splitlines()[-1])
    ours = rl.simulate(plant_of(events=True).with_parameters(**values), T, np.full(101, 1.5))["q"]
    assert np.abs(ours).max() < 0.601
    np.testing.assert_allclose(ours, np.interp(T, time, theirs), atol=2e-6)


def test_without_the_package_the_extra_is_named(unit, monkeypatch):
    from robustlab.dynamics.fmu import unit_process
    from robustlab.errors import DependencyMissing

    monkeypatch.setattr(unit_process, "find_spec", lambda _: None)
    with pytest.raises(DependencyMissing, match="fmpy") as caught:
        rl.plant(unit(2))
    assert "robustlab[fmi]" in caught.value.hint


def test_a_record_is_compared_with_a_unit_as_with_any_nonlinear_plant(plant_of):
    t = np.arange(0, 3, 0.01)
    u = 3 * np.sin(2 * np.pi * (0.2 + 0.3 * t) * t)
    truth = rl.simulate(same_machine(), t, u, [0.5, 0.0])
    noise = 1e-5 * np.random.default_rng(1).normal(size=len(t))
    record = rl.Record(t, {"F": u}, {"q": truth["q"] + noise}, {"F": "N", "q": "m"}, "run")
    found = rl.compare(plant_of(2, joint=True), record)
    assert found.outputs["q"].rms < 2e-5
    heavier = rl.compare(plant_of(2, joint=True).with_parameters(m=2.2), record)
    assert heavier.outputs["q"].rms > 1e-3


@pytest.mark.slow
def test_a_hidden_friction_is_named_at_the_joint(plant_of):
    t = np.arange(0, 4, 0.005)
    u = 6 * np.sin(2 * np.pi * (0.2 + 0.3 * t) * t)
    truth = rl.simulate(rl.with_effects(same_machine(), {"coulomb-friction": {"Fc": 0.5}}), t, u, [0.5, 0.0])
    noise = 1e-6 * np.random.default_rng(0).normal(size=len(t))
    record = rl.Record(t, {"F": u}, {"q": truth["q"] + noise}, {"F": "N", "q": "m"}, "run")
    found = rl.discover(plant_of(2, joint=True), [record])
    assert found.verdict == "named"
    assert "coulomb-friction at v" in found.summary()
