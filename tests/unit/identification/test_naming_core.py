"""Naming on small simulated records whose missing effect is known: distance, what is left, noise, and `discover`."""

from functools import cache

import numpy as np
import pytest
from oracle.stick_slip import stick_slip

import robustlab as rl
from robustlab.dynamics import ExtendedPlant, catalogue, port_model
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.hypotheses.candidates import candidates, nuisance_parameters, stated_tolerances
from robustlab.identification.hypotheses.effect_fit import (
    Candidate,
    FitPlan,
    Hypothesis,
    Problem,
)
from robustlab.identification.hypotheses.normal_equations import NoiseModel
from robustlab.identification.hypotheses.prepared_record import prepare
from robustlab.identification.naming.residual_after_naming import left_over
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel

AXIS = rl.plant("servo-axis")
N, DT = 1000, 2e-3
T = np.arange(N) * DT
U = 1.5 * np.sin(2 * np.pi * 1.3 * T) + np.repeat(np.random.default_rng(1).choice([-1.0, 1.0], 20), 50)
NONE = Hypothesis(())


def noisy(record, outputs=("q", "v"), seed=0, name="run 7"):
    """With white noise of a thousandth of the range on the named outputs."""
    rng = np.random.default_rng(seed)
    noise = {k: 1e-3 * np.ptp(record[k]) * rng.normal(size=record.n) for k in outputs}
    units = {k: record.unit(k) for k in ("u", *outputs)}
    return rl.Record(record.t, record.inputs, {k: record[k] + noise[k] for k in outputs}, units, name)


def plain(**kwargs):
    return noisy(rl.simulate(AXIS, T, U), **kwargs)


@cache
def rubbing(seed=0, u_sign=1.0):
    """The axis with 20 N of Coulomb friction, by an event-driven integrator."""
    return noisy(stick_slip(AXIS, "v", 20.0, T, u_sign * U).record, seed=seed)


def problem_of(record, length=100) -> tuple[Problem, dict[str, Candidate]]:
    model = port_model(AXIS)
    ready = prepare(AXIS, model, record, length)
    nuisances = nuisance_parameters(AXIS, stated_tolerances(AXIS, None))
    return Problem(AXIS, [ready], nuisances), {c.key: c for c in candidates(AXIS, model, [ready])}


def noise_of(problem: Problem) -> NoiseModel:
    """The noise that the record was given, averaged as the errors are."""
    ready = problem.records[0]
    std = 1e-3 * (np.nanmax(ready.y, axis=0) - np.nanmin(ready.y, axis=0)) / np.sqrt(ready.thin)
    return NoiseModel(std, np.zeros((0, len(std))))


# --- what is left ----------------------------------------------------------------------------------------------------


def test_what_is_left_without_friction_is_the_friction():
    problem, _ = problem_of(rubbing())
    as_built = problem.fit(NONE, noise_of(problem), np.zeros(2), plan=FitPlan(fixed=True))
    left = left_over(problem, as_built, noise_of(problem))
    assert left is not None
    v = left.coordinates["speed"]
    fast = np.abs(v) > 0.3 * np.abs(v).max()
    assert np.mean(-left.force[fast] * np.sign(v[fast])) == pytest.approx(20.0, rel=0.05)


# --- discover --------------------------------------------------------------------------------------------------------

FEW = tuple(set(catalogue()) - {"coulomb-friction", "constant-load", "sensor-gain", "inertia"})


def discovered(records, plant=AXIS, **options):
    return rl.discover(plant, records, exclude=FEW, **options)


@cache
def named_friction():
    return discovered(rubbing())


def test_discover_names_the_friction_and_gives_a_plant_that_has_it():
    found = named_friction()
    assert found.verdict == "named"
    assert found.status is Status.CONVERGED
    assert found.complete
    assert found.names == ("coulomb-friction",)
    (force,) = found.effects[0].parameters
    assert force.lower < 20.0 < force.upper
    assert found.gap_after < 0.25 * found.gap_before
    assert isinstance(found.model, ExtendedPlant)
    assert found.model.effects[0].values["Fc"] == force.value
    assert found.held_out == "every 4th window of the records, kept from the fit"
    assert set(found.candidates) == set(catalogue()) - set(FEW)


def test_discover_names_nothing_where_nothing_is_missing():
    found = discovered(plain(seed=5))
    assert found.verdict == "no missing effect"
    assert found.complete
    assert found.effects == found.rivals == ()
    assert found.gap_after == pytest.approx(0.1, rel=0.25)  # the noise, in percent of the range


@pytest.mark.slow
def test_held_out_records_are_judged_and_named():
    found = discovered(rubbing(), held_out=rubbing(seed=9, u_sign=-1.0))
    assert found.names == ("coulomb-friction",)
    assert found.held_out == "run 7"
    other = rubbing(seed=9, u_sign=-1.0)
    assert found.gaps["q"].range == pytest.approx(np.ptp(other["q"]))


@pytest.mark.slow
def test_two_records_are_named_together():
    one = named_friction()
    both = discovered([rubbing(), rubbing(seed=9, u_sign=-1.0)])
    assert both.names == ("coulomb-friction",)
    assert both.records == ("run 7", "run 7")
    width = [np.subtract(*(getattr(f.effects[0].parameters[0], e) for e in ("upper", "lower"))) for f in (one, both)]
    assert width[1] < width[0]


@pytest.mark.slow
def test_a_bare_model_serves_as_plant():
    m = AXIS.state_space()
    model = StateSpaceModel(m.A, m.B, m.C, m.D, inputs=AXIS.inputs, outputs=AXIS.outputs, states=AXIS.states)
    found = discovered(rubbing(), plant=model)
    assert found.names == ("coulomb-friction",)
    value = found.effects[0].parameters[0]
    assert value.unit == "N/kg"
    assert value.value == pytest.approx(20.0 / AXIS.values["M"], rel=0.02)


@pytest.mark.slow
def test_a_record_with_gaps_is_named():
    run = rubbing()
    keep = np.ones(N, dtype=bool)
    keep[330:350] = keep[700:703] = False
    gappy = rl.Record(
        run.t[keep], {"u": run["u"][keep]}, {k: run[k][keep] for k in ("q", "v")}, dict(run.units), "gappy"
    )
    found = discovered(gappy, window=0.16)
    assert found.names == ("coulomb-friction",)
    assert found.effects[0].parameters[0].value == pytest.approx(20.0, rel=0.03)


@pytest.mark.slow
def test_a_record_with_a_jittering_clock_is_named():
    t = T + 0.2 * DT * np.random.default_rng(6).uniform(-1, 1, N)
    run = noisy(stick_slip(AXIS, "v", 20.0, t, U).record, name="jitter")
    assert not run.is_uniform
    found = discovered(run)
    assert found.names[:1] == ("coulomb-friction",)
    assert found.effects[0].parameters[0].value == pytest.approx(20.0, rel=0.03)


@pytest.mark.slow
def test_one_output_is_enough():
    run = rubbing()
    only = rl.Record(run.t, run.inputs, {"q": run["q"]}, {"u": "V", "q": "m"}, "one sensor")
    found = discovered(only)
    assert found.names == ("coulomb-friction",)
    assert set(found.gaps) == {"q"}


# --- what is refused -------------------------------------------------------------------------------------------------


def with_holes():
    """Ten samples lost of every eighty."""
    run, kept = rubbing(), np.arange(N) % 80 < 70
    return rl.Record(run.t[kept], {"u": run["u"][kept]}, {"q": run["q"][kept]}, {"u": "V", "q": "m"}, "holes")


def only(inputs, outputs, n=N):
    return rl.Record(T[:n], {k: x[:n] for k, x in inputs.items()}, {k: x[:n] for k, x in outputs.items()}, name="run 8")


@pytest.mark.parametrize(
    ("plant", "records", "options", "said"),
    [
        (AXIS, list, {}, r"discover.*no record.*at least one"),
        (AXIS, with_holes, {}, r"holes.*windows of \d+ samples without gaps.*at least 4"),
        (rl.with_effects(rl.plant("dc-motor"), {"coulomb-friction": {"Fc": 5e-3}}), plain, {},
         r"discover.*dc-motor with effects(?s:.*)give its plant"),
        (StateSpaceModel([[0.5]], [[1.0]], [[1.0]], [[0.0]], dt=DT), plain, {}, r"discover.*discrete"),
        ("servo-axis", plain, {}, None),
        (AXIS, lambda: only({"voltage": U}, {"q": T}), {}, r"run 8.*'u'"),
        (AXIS, lambda: only({"u": U}, {"x": T}), {}, "run 8"),
        (AXIS, lambda: only({"u": U}, {"q": plain()["q"]}, 30), {}, "run 8"),
        (AXIS, plain, {"window": 0.6}, r"run 7.*1000 samples.*at least 1200 \(4 windows\)"),
        *((AXIS, plain, {"window": w}, r"discover: window.*length in s above 0") for w in (0.0, -1.0, np.nan, np.inf)),
        (AXIS, plain, {"tolerances": {"Mx": 0.1}}, r"'Mx'.*no such parameter of servo-axis"),
        (AXIS, plain, {"exclude": ["coulom-friction"]}, r"coulom-friction.*coulomb-friction"),
    ],
)  # fmt: skip
def test_what_cannot_be_named_is_refused(plant, records, options, said):
    with pytest.raises((InputError, NoTrustworthyNumber), match=said):
        rl.discover(plant, records(), **options)


def test_an_unexcited_record_says_nothing():
    rng = np.random.default_rng(1)
    idle = rl.Record(
        T, {"u": np.zeros(N)}, {"q": 1e-6 * rng.normal(size=N), "v": 1e-5 * rng.normal(size=N)}, name="idle"
    )
    with pytest.raises(NoTrustworthyNumber, match="idle"):
        rl.discover(AXIS, idle)
