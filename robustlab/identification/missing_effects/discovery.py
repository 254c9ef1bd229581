"""`discover`: identify the effects that a model lacks, from measured records."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from robustlab.budget import one_thread
from robustlab.checks import number
from robustlab.dynamics.effects.catalogue import effect
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.plant_base import NonlinearPlant, SteppedPlant
from robustlab.dynamics.ports.port_model import AnyPlant, PortModel, linear_plant_of, parameter_groups
from robustlab.errors import InputError, error_context
from robustlab.identification import constants
from robustlab.identification.data_checks.resampling import clock_step, counted_from, position_datum, uniform
from robustlab.identification.data_checks.suitability import Finding, suitability
from robustlab.identification.greybox.candidates import (
    FEWEST_PERIODS,
    candidates,
    nuisance_parameters,
    periods_seen,
    stated_tolerances,
    with_absolute_tolerances,
)
from robustlab.identification.greybox.effect_fit import Candidate, Clock, Fit, Hypothesis, Nuisance, Problem
from robustlab.identification.greybox.prepared_record import PreparedRecord, alike, ports_of, prepare, window_length
from robustlab.identification.missing_effects.build_result import answer
from robustlab.identification.missing_effects.discovery_result import Discovery
from robustlab.identification.missing_effects.effect_search import Search, clock_nuisances
from robustlab.identification.missing_effects.posterior import weigh
from robustlab.identification.response.response import converted, with_units
from robustlab.record import Record
from robustlab.statespace import StateSpaceModel, as_model

MOST_WINDOWS = 24  # fitted by the search: more would show weaker effects and take more time
MOST_SAMPLES = 2400  # of a nonlinear plant, in the fitted windows
MOST_HELD = 12  # held-out windows of the search
HELD_OUT_EVERY = 4  # without a held-out record, one window in this many is held out
LONGEST_LAG = 0.1  # of a window


def admissible(
    plant: AnyPlant, stated: Mapping[str, tuple[float, bool]], fitted: Problem, held: Problem
) -> Callable[[Problem, Fit], bool]:
    """Return the test of a set: its parameter effects exceed their tolerances, its ripples have enough periods."""
    limits = {label: max(stated[n][0] for n in names) for _, label, names in parameter_groups(plant)}
    model = fitted.simulators(Hypothesis(()))[0].model({}, [])
    shown = model.C.reshape(-1, *model.C.shape[-2:])[0]
    # Rows over the states of the outputs and of the joints' positions.
    positions = {s.name: row for s, row in zip(plant.outputs, shown, strict=True)}
    positions |= {name: port.position for name, port in model.ports.items() if port.position is not None}
    longest = LONGEST_LAG * (fitted.records[0].windows.length * fitted.records[0].record.dt)

    def beyond(candidate: Candidate, factors: Mapping[str, float], values: Mapping[str, float]) -> bool:
        own, parameters = candidate.effect.factors(plant, candidate.site, values), plant.parameters
        if not candidate.effect.scale:  # shifts: the tolerance of a coordinate of value 0 is in its unit
            each = ((parameters[n], factor) for n, factor in own.items())
            return any(abs(p.reference * factor - p.value) > p.radius for p, factor in each)
        name = next(iter(own))
        return bool(abs(np.log(factors.get(name, 1.0) * own[name])) > np.log1p(limits[candidate.site.name]))

    def enough_periods(candidate: Candidate, values: Mapping[str, float]) -> bool:
        if not (candidate.effect.spatial and "k" in values):
            return True
        position = positions[candidate.site.name]
        return min(periods_seen(values["k"], position, p.records) for p in (fitted, held)) >= FEWEST_PERIODS

    def allowed(problem: Problem, fit: Fit) -> bool:
        factors, values = problem.split(fit.hypothesis, fit.z)
        seen = problem.setting(fit.hypothesis, fit.z).values  # a delay common to all sensors is one of the inputs
        return all(
            (c.site.kind != "parameter" or beyond(c, factors, own))
            and c.effect.visited(own, c.scales)
            and c.effect.lag(simulated) <= longest
            and enough_periods(c, own)
            for c, own, simulated in zip(fit.hypothesis.candidates, values, seen, strict=True)
        )

    return allowed


def _reporter(progress: Callable[[str], None] | None) -> Callable[[float, float, str], None]:
    """Return a reporter to the listener's ``part(done, expected, text)``, else of each new text to the listener."""
    if (part := getattr(progress, "part", None)) is not None:
        return part
    texts = [""]

    def report(_done: float, _expected: float, text: str) -> None:
        if progress is not None and text != texts[-1]:
            texts.append(text)
            progress(text)

    return report


@one_thread()
@error_context("discover")
def discover(
    plant: Any,
    records: Record | Sequence[Record],
    held_out: Record | Sequence[Record] | None = None,
    *,
    tolerances: Mapping[str, float] | None = None,
    window: float | None = None,
    exclude: Sequence[str] = (),
    progress: Callable[[str], None] | None = None,
) -> Discovery:
    """Identify the effects that a model lacks from measured records, and update the model with them.

    Parameters
    ----------
    plant
        A linear `Plant`, a continuous `StateSpaceModel` or ``control.StateSpace`` whose velocity, position and current
        states carry their units (rad/s, m/s, A); or a `NonlinearPlant`, of which the position of every joint has to be
        measured: it is simulated linear about the measured motion.
    records
        One record or several of the same machine; any subset of the plant's outputs.
    held_out
        Records for the error alone, never fitted; without them every fourth window is held out.
    tolerances
        Parameter -> relative tolerance, over those of the plant. A parameter without one gets a usual one (5 %;
        friction 100 %), which the result reports.
    window
        Length of the windows in s (default: a twelfth of the shortest record).
    exclude
        Effect ids to exclude.
    progress
        Called with a line of text about the progress.

    Returns
    -------
    Discovery
        ``.verdict``, ``.effects``, ``.rivals``, ``.gap_before``, ``.gap_after``, ``.model``, ``.next_experiment``.

    Raises
    ------
    InputError
        Records that do not fit the plant, have other outputs than the first, or are too short; a wrong sign or
        unit; an unknown effect in ``exclude``.
    NoTrustworthyNumber
        Records without information: no excitation, dead sensors.
    """
    began = time.perf_counter()
    known = known_plant(plant, "discover")
    left_out = {effect(name).id for name in exclude}
    if window is not None:
        number("discover: window", window, "a length in s above 0", above=0.0)
    measured = [records] if isinstance(records, Record) else list(records)
    kept_out = [held_out] if isinstance(held_out, Record) else list(held_out or ())
    if not measured:
        raise InputError("discover", "no record", "at least one")
    everything, findings = _checked(known, [*measured, *kept_out])
    measured, kept_out = everything[: len(measured)], everything[len(measured) :]
    stated = stated_tolerances(known, tolerances)
    known = with_absolute_tolerances(known, stated)
    problem, held, model, held_text = _problems(known, measured, kept_out, stated, window)
    pool = [c for c in candidates(known, model, problem.records) if c.effect.id not in left_out]
    report = _reporter(progress)
    most, held_most = MOST_WINDOWS, MOST_HELD
    if not isinstance(known, LinearPlant):  # expensive
        length = problem.records[0].windows.length
        most = min(MOST_WINDOWS, max(2 * constants.FEWEST_WINDOWS, MOST_SAMPLES // length))
        held_most = min(MOST_HELD, max(constants.FEWEST_WINDOWS, most // 2))
    allowed = admissible(known, stated, problem, held)
    found = Search(_spread(problem, most), _spread(held, held_most), pool, allowed, report).run()
    report(0.0, 0.0, "what remains")
    tried = tuple(dict.fromkeys(c.effect.id for c in pool))
    names = tuple(r.name for r in measured)
    result = answer(found, weigh(found), held, names, tried, stated, findings, held_text)
    return replace(result, seconds=time.perf_counter() - began)


def _checked(plant: AnyPlant, records: Sequence[Record]) -> tuple[list[Record], list[Finding]]:
    """Check the records; return them in the plant's units, positions counted from a datum within the stroke."""
    findings, signals = list[Finding](), (*plant.inputs, *plant.outputs)
    for record in records:
        checked = suitability(plant, record)
        checked.require()
        findings.extend(checked.findings)
    for record in records:
        for name, text in converted(record, signals).items():
            findings.append(Finding("unit", name, text, "", f"in {record.name}", False, {}))
    records = [with_units(r, signals) for r in records]
    datum = position_datum(plant, records) if isinstance(plant, LinearPlant) else {}
    for name, at in datum.items():
        text = f"far from zero: counted from {at:.9g} here, in the updated plant as well"
        hint = f"take {at:.9g} off {name} where the updated plant is compared with records"
        findings.append(Finding("datum", name, text, "", hint, False, {"datum": at}))
    return [counted_from(r, datum) for r in records] if datum else records, findings


def known_plant(plant: Any, where: str) -> AnyPlant:
    """Return the plant in a form to which effects can be attached."""
    if isinstance(plant, (LinearPlant, StateSpaceModel)):
        return linear_plant_of(plant, where)
    if isinstance(plant, SteppedPlant):
        hint = "give its plant: the effects are found anew, and their parameters with them"
        raise InputError(where, f"{plant.name} with effects", "a plant without", hint)
    return plant if isinstance(plant, NonlinearPlant) else linear_plant_of(as_model(plant, where), where)


def _problems(
    plant: AnyPlant, records: Sequence[Record], held_out: Sequence[Record], stated: Mapping[str, tuple[float, bool]],
    window: float | None,
) -> tuple[Problem, Problem, PortModel, str]:  # fmt: skip
    """Return the windows to fit, those held out, the plant's ports, and a description of the held-out windows."""
    step = clock_step(records[0].t)  # the mean step of a record with gaps is no sample time
    uniformed = [uniform(r, None if r.is_uniform else step) for r in (*records, *held_out)]
    everything, dt = [u.record for u in uniformed], uniformed[0].record.dt
    model = ports_of(plant, everything[0])
    length = window_length(plant, everything, model) if window is None else max(8, round(window / dt))
    # A record may lack a sensor of another one: proposed experiments may add a sensor.
    seen = {name for r in records for name in r.outputs}

    def cut(length: int) -> list[PreparedRecord]:
        return alike([prepare(plant, model, u.record, length, dict(u.valid), seen) for u in uniformed])

    prepared, clock = cut(length), Clock(constants.LEAST_STEPS)
    while isinstance(plant, NonlinearPlant) and window is None and length > constants.SHORTEST_WINDOW:
        if _deviation(Problem(plant, prepared[: len(records)], (), clock=clock)) < constants.MOST_DEVIATION:
            break
        length = max(length // 2, constants.SHORTEST_WINDOW)
        prepared = cut(length)
    fitted, judged = prepared[: len(records)], prepared[len(records) :]
    nuisances: tuple[Nuisance, ...] = nuisance_parameters(plant, stated)
    nuisances += clock_nuisances(tuple(s.name for s in plant.inputs), dt)
    if judged:
        problem = Problem(plant, fitted, nuisances, clock=clock)
        return problem, problem.on(judged), model, ", ".join(r.name for r in held_out)
    every = HELD_OUT_EVERY
    apart = [np.arange(r.count) % every == every // 2 for r in fitted]
    problem = Problem(plant, fitted, nuisances, [np.flatnonzero(~a) for a in apart], clock)
    held = problem.on(fitted, [np.flatnonzero(a) for a in apart])
    return problem, held, model, f"every {every}th window of the records, kept from the fit"


def _deviation(problem: Problem) -> float:
    """Return the largest RMS error over the output's range of the given plant, from the smoothed window starts."""
    alone, found = Hypothesis(()), 0.0
    z, starts = np.zeros(len(problem.nuisances)), [np.zeros_like(r.x0) for r in problem.records]
    errors = problem.errors(alone, z, starts)
    for record, error in zip(problem.records, errors, strict=True):
        ranges = np.nanmax(record.y, axis=0) - np.nanmin(record.y, axis=0)
        with np.errstate(over="ignore", invalid="ignore"):
            rms = np.sqrt(np.nanmean(error**2, axis=(0, 1))) / np.where(ranges > 0.0, ranges, np.inf)
        found = max(found, float(np.nanmax(rms, initial=0.0)))
    return found


def _spread(problem: Problem, most: int) -> Problem:
    """Choose at most ``most`` windows, evenly over all records."""
    count = sum(len(c) for c in problem.chosen)
    if count <= most:
        return problem
    taken = np.zeros(count, dtype=bool)
    taken[np.linspace(0, count - 1, most).round().astype(int)] = True
    masks = np.split(taken, np.cumsum([len(c) for c in problem.chosen])[:-1])
    left = [(r, c[m]) for r, c, m in zip(problem.records, problem.chosen, masks, strict=True) if m.any()]
    return problem.on([r for r, _ in left], [c for _, c in left])
