"""`discover`: name the effect that a model lacks, from measured records.

The way: the records are checked and cut into windows; every effect of the catalogue is fitted by simulation, always
together with the nominal parameters within their tolerances; the most probable one is named if it also helps on data
that no fit has seen; the search goes on on top of it until nothing helps any more. What could stand in its place for
these very records is named with it, and what no effect explains is called unknown.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import one_thread
from robustlab.dynamics.effects.catalogue import effect
from robustlab.dynamics.extended.simulator import Windows
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.ports.port_model import linear_plant_of, parameter_groups, port_model
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.hypotheses.candidates import (
    candidates,
    nuisance_parameters,
    stated_tolerances,
    with_absolute_tolerances,
)
from robustlab.identification.hypotheses.effect_fit import Candidate, Fit, Hypothesis, Problem, simulated_outputs
from robustlab.identification.hypotheses.prepared_record import alike, prepare, start_std, window_length
from robustlab.identification.naming.discovery_result import (
    Discovery,
    EffectValue,
    Gap,
    NamedEffect,
    NamingStep,
    NominalValue,
    Rival,
    StepEntry,
    Verdict,
)
from robustlab.identification.naming.greedy_naming import (
    Alternative,
    Naming,
    held_out_fit,
    in_doubt,
    name_effects,
    overtaken,
    rms_percent,
    settled,
    spans,
    white,
)
from robustlab.identification.naming.ranking import noise_ratio
from robustlab.identification.naming.residual_after_naming import LeftOver, left_over, remaining_lines
from robustlab.identification.naming.updated_plant import updated_plant
from robustlab.identification.tuning import TUNING, NamingTuning
from robustlab.record import Record
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, as_model

if TYPE_CHECKING:
    from robustlab.identification.comparison.noise_floor import NoiseFloor
    from robustlab.identification.experiment.next_experiment import NextExperiment
    from robustlab.identification.record_check.suitability import Finding

__all__ = ["discover"]


INTERVAL = 1.96  # standard deviations of a 95 % interval


@dataclass(frozen=True, eq=False)
class _Data:
    """Prepared records and which of their windows are fitted and which are held out."""

    problem: Problem
    held: Problem
    held_text: str

    def everything(self) -> Problem:
        """All records, those held out as well."""
        known = [*self.problem.records, *(r for r in self.held.records if r not in self.problem.records)]
        return self.problem.on(known)


@dataclass(frozen=True, eq=False)
class _Case:
    """One call of `discover`: what was given, checked and prepared."""

    plant: LinearPlant
    records: Sequence[Record]
    repeats: Sequence[Record]
    period: float | None
    stated: Mapping[str, tuple[float, bool]]
    findings: tuple[Finding, ...]
    data: _Data
    pool: Sequence[Candidate]


class _Judgement(NamedTuple):
    """The verdict and what it rests on: residual force, error over the sensors' noise, noise floor and F against it."""

    verdict: Verdict
    complete: bool
    left: LeftOver | None
    noise_ratio: float
    floor: NoiseFloor | None
    excess: Mapping[str, float]


@one_thread()
def discover(
    plant: Any,
    records: Record | Sequence[Record],
    held_out: Record | Sequence[Record] | None = None,
    *,
    tolerances: Mapping[str, float] | None = None,
    window: float | None = None,
    period: float | None = None,
    repeats: Sequence[Record] = (),
    exclude: Sequence[str] = (),
    progress: Callable[[str], None] | None = None,
    tuning: NamingTuning = TUNING,
) -> Discovery:
    """Name what a model lacks.

    Parameters
    ----------
    plant
        A linear `Plant`, a continuous `StateSpaceModel` or ``control.StateSpace`` whose velocity, position and current
        states carry their units (rad/s, m/s, A).
    records
        One record or several of the same machine; any subset of the plant's outputs.
    held_out
        Records that the fit never sees and the gap is judged on; without them every fourth window is held out.
    tolerances
        Parameter -> relative tolerance, over those that the plant states. A parameter without any is given a usual one
        (5 %; friction 100 %), which the result says.
    window
        Length of the windows in s (a twelfth of the shortest record where left out).
    period, repeats
        Period of the excitation in s, or further records with the same input: for a noise floor without a model.
    exclude
        Effect ids that are not to be tried.
    progress
        Called with a line of text now and then.
    tuning
        Numbers that choose speed and accuracy, and how much evidence a name needs.

    Returns
    -------
    Discovery
        ``.verdict``, ``.effects``, ``.rivals``, ``.gap_before``, ``.gap_after``, ``.model``, ``.next_experiment``.

    Raises
    ------
    InputError
        Records that do not fit the plant, have other outputs than the first, or are too short; a wrong sign, unit or
        swapped channel; an unknown effect in ``exclude``.
    NoTrustworthyNumber
        Records that say nothing: no excitation, dead sensors.
    """
    began = time.perf_counter()
    linear = _linear(plant)
    left_out = {effect(name).id for name in exclude}
    if window is not None and not 0.0 < window < np.inf:
        raise InputError("discover: window", f"{window}", "a length in s above 0")
    measured = [records] if isinstance(records, Record) else list(records)
    kept_out = [] if held_out is None else [held_out] if isinstance(held_out, Record) else list(held_out)
    if not measured:
        raise InputError("discover", "no record", "at least one")
    findings = _checked(linear, [*measured, *kept_out])
    measured, kept_out, told = _from_near(linear, measured, kept_out)
    findings += told
    stated = stated_tolerances(linear, tolerances)
    linear = with_absolute_tolerances(linear, stated)
    model = port_model(linear)
    data = _data(linear, model, measured, kept_out, nuisance_parameters(linear, stated), window, tuning)
    pool = [c for c in candidates(linear, model, data.problem.records, tuning) if c.effect.id not in left_out]
    case = _Case(linear, measured, repeats, period, stated, findings, data, pool)
    limits = {label: max(stated[n][0] for n in names) for _, label, names in parameter_groups(linear)}

    def allowed(problem: Problem, fit: Fit, candidate: Candidate) -> bool:
        return beyond_tolerance(problem, fit, candidate, limits)

    naming = name_effects(data.problem, data.held, pool, allowed, progress)
    naming, others = overtaken(data.problem, naming, allowed)
    rivals = [a for a in others if a.cannot_be_told and allowed(data.problem, a.fit, a.candidate)]
    rivals += in_doubt(data.problem, naming, allowed)
    return replace(_result(case, naming, rivals), seconds=time.perf_counter() - began)


def beyond_tolerance(problem: Problem, fit: Fit, candidate: Candidate, limits: Mapping[str, float]) -> bool:
    """False for a parameter effect whose factor lies within the parameter's tolerance: nothing is missing then."""
    if candidate.site.kind != "parameter":
        return True
    factors, values = problem.split(fit.hypothesis, fit.z)
    k = next(i for i, c in enumerate(fit.hypothesis.candidates) if c.key == candidate.key)
    own = candidate.effect.factors(problem.plant, candidate.site, values[k])
    name = next(iter(own))
    total = np.log(factors.get(name, 1.0) * own[name])
    return bool(abs(total) > np.log1p(limits[candidate.site.name]))


def _linear(plant: Any) -> LinearPlant:
    if isinstance(plant, (LinearPlant, StateSpaceModel)):
        return linear_plant_of(plant, "discover")
    from robustlab.dynamics.plant_contract import Plant

    if isinstance(plant, Plant):
        raise InputError(
            "discover",
            f"the nonlinear plant {plant.name}",
            "a linear one",
            "linearise it first: rl.linearise(plant, at=...)",
        )
    return linear_plant_of(as_model(plant, "discover"), "discover")


def _checked(plant: LinearPlant, records: Sequence[Record]) -> tuple[Finding, ...]:
    """Findings on the records; raises where one forbids a naming."""
    from robustlab.identification.record_check.suitability import suitability

    findings: list[Finding] = []
    for record in records:
        found = suitability(plant, record)
        found.require()
        findings.extend(found.findings)
    return tuple(findings)


def _from_near(
    plant: LinearPlant, measured: list[Record], kept_out: list[Record]
) -> tuple[list[Record], list[Record], tuple[Finding, ...]]:
    """The records with positions that are far from zero counted from within the strokes, and a word on it."""
    from robustlab.identification.record_check.position_datum import counted_from, position_datum
    from robustlab.identification.record_check.suitability import Finding

    datum = position_datum(plant, [*measured, *kept_out])
    told = tuple(
        Finding(
            "datum", name, f"far from zero: counted from {at:.9g} here, in the updated plant as well", "",
            f"take {at:.9g} off {name} where the updated plant is compared with records", False, {"datum": at},
        )
        for name, at in datum.items()
    )  # fmt: skip
    if not datum:
        return measured, kept_out, ()
    return [counted_from(r, datum) for r in measured], [counted_from(r, datum) for r in kept_out], told


def _data(
    plant: LinearPlant, model: Any, records: Sequence[Record], held_out: Sequence[Record], nuisances: Any,
    window: float | None, tuning: NamingTuning,
) -> _Data:  # fmt: skip
    from robustlab.identification.record_check.resampling import clock_step, uniform

    dt = clock_step(records[0].t)  # the mean step of a record with gaps is no sample time
    uniformed = [uniform(r, None if r.is_uniform else dt) for r in (*records, *held_out)]
    everything = [u.record for u in uniformed]
    length = window_length(plant, everything, tuning) if window is None else max(8, round(window / dt))
    # A record may lack a sensor that another has, as the proposed experiments do which add one.
    seen = {name for r in records for name in r.outputs}
    prepared = alike([prepare(plant, model, u.record, length, dict(u.valid), seen, tuning) for u in uniformed])
    fitted, judged = prepared[: len(records)], prepared[len(records) :]
    if judged:
        problem = Problem(plant, fitted, nuisances, tuning=tuning)
        return _Data(problem, problem.on(judged), ", ".join(r.name for r in held_out))
    every = tuning.held_out_every
    apart = [np.arange(r.count) % every == every // 2 for r in fitted]
    problem = Problem(plant, fitted, nuisances, [np.flatnonzero(~a) for a in apart], tuning)
    held = problem.on(fitted, [np.flatnonzero(a) for a in apart])
    return _Data(problem, held, f"every {every}th window of the records, kept from the fit")


# --- the result ------------------------------------------------------------------------------------------------------


def _result(case: _Case, naming: Naming, rivals: Sequence[Alternative]) -> Discovery:
    problem, held = case.data.problem, case.data.held
    judged = _judged(case, naming, bool(rivals))
    verdict, complete = judged.verdict, judged.complete
    if not complete and naming.fit.hypothesis.candidates:
        naming = replace(naming, settled=settled(problem, naming.fit, naming.noise, 1))
        judged = _judged(case, naming, bool(rivals))
    if verdict == "unknown" and not naming.fit.hypothesis.candidates:
        rivals = ()  # nothing was named, and nothing is missing no longer stands beside them
    fit, left = naming.settled, judged.left
    gaps, series = _gaps(held, naming)
    names = tuple(r.name for r in case.records)
    structure = {"noise_ratio": judged.noise_ratio}
    return Discovery(
        status=Status.CONVERGED if verdict in ("named", "no missing effect") else Status.INCONCLUSIVE,
        verdict=verdict,
        complete=complete,
        effects=tuple(_named(problem, naming, k, rivals) for k in range(len(fit.hypothesis.candidates))),
        rivals=tuple(_rival(problem, a) for a in rivals),
        nominal=_nominal(problem, fit, case.stated),
        gap_before=_overall(gaps, "nominal"),
        gap_refitted=_overall(gaps, "refitted"),
        gap_after=_overall(gaps, "updated"),
        gaps=gaps,
        held_out=case.data.held_text,
        plant=case.plant.name,
        records=names,
        window=problem.records[0].windows.length * problem.records[0].record.dt,
        steps=tuple(_step(s) for s in naming.steps),
        candidates=tuple(dict.fromkeys(c.effect.id for c in case.pool)),
        structure=structure | (vars(left.structure) | {"found": left.structure.found} if left else {}),
        residual_force=left.curves() if left and not complete else None,
        unnamed=left.unnamed() if left and not complete else None,
        noise_floor=judged.floor,
        floor_excess=judged.excess,
        remaining_lines=remaining_lines(left, problem.tuning) if left else (),
        findings=case.findings,
        series=series,
        model=updated_plant(problem, fit, f"fitted to {', '.join(names)}"),
        next_experiment=_next_experiment(problem, naming, rivals),
    )


def _next_experiment(problem: Problem, naming: Naming, rivals: Sequence[Alternative]) -> NextExperiment | None:
    """What would separate the named effects from their rivals."""
    if not rivals:
        return None
    from robustlab.identification.experiment.next_experiment import propose_experiment

    return propose_experiment(problem, naming.fit, [a.fit for a in rivals])


def _floor_excess(case: _Case, naming: Naming) -> tuple[NoiseFloor | None, dict[str, float]]:
    """Model-free noise floor of the first record, where it repeats, and F of the updated model's errors against it."""
    from robustlab.identification.comparison.noise_floor import noise_floor

    problem, record = case.data.problem, case.records[0]
    first = problem.records[0]
    names = [problem.plant.outputs[k].name for k in first.columns]
    own = [name for name in names if name in first.record.outputs]
    try:
        floor = noise_floor(record, period=case.period, repeats=case.repeats, outputs=own)
    except NoTrustworthyNumber:
        return None, {}
    if floor.source != "periods" or first.record.n != record.n:
        return floor, {}
    # Windows at the same phases of every period.
    per_period = max(1, round(floor.samples / first.windows.length))
    length = floor.samples // per_period
    starts = floor.first + (np.arange(floor.count)[:, None] * floor.samples + np.arange(per_period) * length).ravel()
    windows = Windows(starts.astype(np.int64), length)
    s = first.smoothed
    cut = replace(first, windows=windows, x0=s.x[starts].copy(), x0_std=start_std(s, windows, problem.tuning))
    there = problem.on([cut])
    fit = held_out_fit(there, naming.settled, white(naming.noise))
    errors = cut.measured - simulated_outputs(there, fit)[0]
    excess = {}
    for name in own:
        j = names.index(name)
        residual = np.full((floor.count, floor.samples), np.nan)
        residual[:, : per_period * length] = errors[:, :, j].reshape(floor.count, per_period * length)
        found = floor.excess(residual)
        if found.F is not None:
            excess[name] = found.F
    return floor, excess


def _gaps(held: Problem, naming: Naming) -> tuple[dict[str, Gap], dict[str, Any]]:
    """Windowed errors on held-out data of the three models, and their signals."""
    as_given = Fit(Hypothesis(()), np.zeros(len(held.nuisances)), (), 0.0, np.zeros(0), np.eye(0), naming.noise, 0)
    plain = white(naming.noise)
    models = {
        key: held_out_fit(held, fit, plain)
        for key, fit in (("nominal", as_given), ("refitted", naming.bare), ("updated", naming.settled))
    }
    outputs = {key: simulated_outputs(held, fit) for key, fit in models.items()}
    measured = [r.measured[chosen] for r, chosen in zip(held.records, held.chosen, strict=True)]
    gaps: dict[str, Gap] = {}
    richest = int(np.argmax([np.isfinite(r.y).any(axis=0).sum() for r in held.records]))
    first = held.records[richest]
    order = (first.windows.starts[held.chosen[richest]][:, None] + np.arange(first.windows.length)).ravel()
    series: dict[str, Any] = {"t": first.record.t[order], "outputs": {}}
    series["inputs"] = {s.name: first.record.inputs[s.name][order] for s in held.plant.inputs}
    for j, column in enumerate(first.columns):
        signal = held.plant.outputs[column]
        if not np.isfinite(first.y[:, j]).any():
            continue
        rms = {
            key: _rms([(m - y)[:, :, j] for m, y in zip(measured, values, strict=True)])
            for key, values in outputs.items()
        }
        span = float(spans(held.records)[j])
        gaps[signal.name] = Gap(signal.name, signal.unit, span, rms["nominal"], rms["refitted"], rms["updated"])
        series["outputs"][signal.name] = {
            "measured": measured[richest][:, :, j].ravel(),
            **{key: values[richest][:, :, j].ravel() for key, values in outputs.items()},
        }
    return gaps, series


def _rms(errors: Sequence[Array]) -> float:
    return float(np.sqrt(np.nanmean(np.concatenate([e.ravel() for e in errors]) ** 2)))


def _overall(gaps: Mapping[str, Gap], key: str) -> float:
    """RMS over the outputs of the error in percent of the range."""
    shares = [getattr(g, key) / (g.range or 1.0) for g in gaps.values()]
    return float(100.0 * np.sqrt(np.mean(np.square(shares))))


def _judged(case: _Case, naming: Naming, has_rivals: bool) -> _Judgement:
    data, tuning = case.data, case.data.problem.tuning
    left = left_over(data.everything(), naming.settled, naming.noise)
    floor, excess = _floor_excess(case, naming)
    ratio = noise_ratio(data.problem, naming.settled)
    gap = rms_percent(data.held, held_out_fit(data.held, naming.settled, white(naming.noise)))
    large = ratio > tuning.beyond_noise or (gap > tuning.coarse and ratio > tuning.above_noise)
    structure = left is not None and left.structure.found
    remains = structure or large or any(f > tuning.repeatable for f in excess.values())
    verdict: Verdict
    if not naming.fit.hypothesis.candidates:
        verdict, complete = ("unknown", False) if remains else ("no missing effect", True)
    elif remains and _explained(naming) < tuning.explained:
        verdict, complete = "unknown", False
    else:
        verdict, complete = "ambiguous" if has_rivals else "named", not remains
    return _Judgement(verdict, complete, left, ratio, floor, excess)


def _explained(naming: Naming) -> float:
    """Share of the fall in V from the bare model to noise that the named effects brought about."""
    bare, now = naming.bare_cost, naming.fit.cost
    points = float(naming.points)
    return 1.0 if bare <= points else (bare - now) / (bare - points)


def _effect_values(problem: Problem, fit: Fit, k: int) -> tuple[EffectValue, ...]:
    """Parameters of the k-th effect with posterior intervals."""
    candidate = fit.hypothesis.candidates[k]
    at = len(problem.nuisances) + sum(len(c.parameters) for c in fit.hypothesis.candidates[:k])
    z, std = fit.z[at : at + len(candidate.parameters)], fit.std[at : at + len(candidate.parameters)]
    found = []
    for p, centre, spread in zip(candidate.parameters, z, std, strict=True):
        ends = sorted(p.prior.value(float(centre + side * INTERVAL * spread)) for side in (-1.0, 1.0))
        found.append(EffectValue(p.name, p.prior.value(float(centre)), p.unit, ends[0], ends[1], p.meaning))
    return tuple(found)


def _named(problem: Problem, naming: Naming, k: int, rivals: Sequence[Alternative]) -> NamedEffect:
    candidate = naming.fit.hypothesis.candidates[k]
    own = [a for a in rivals if a.instead_of is not None and a.instead_of.key == candidate.key]
    confidence = max(0.0, 1.0 - sum(a.wins for a in own))
    step = next((s for s in naming.steps if s.taken is not None and s.entry(candidate) is not None), None)
    place = step.entry(candidate) if step else None
    evidence = place.evidence - step.ranking.base.evidence if step and place else 0.0
    effect = candidate.effect
    return NamedEffect(
        effect.id, effect.title, effect.equation, candidate.site.name, _effect_values(problem, naming.settled, k),
        confidence, evidence, tuple(dict.fromkeys(a.candidate.effect.id for a in own)),
    )  # fmt: skip


def _rival(problem: Problem, a: Alternative) -> Rival:
    k = len(a.fit.hypothesis.candidates) - 1
    effect = a.candidate.effect
    return Rival(
        effect.id, effect.title, a.candidate.site.name, a.instead_of.effect.id if a.instead_of else "none", a.distance,
        a.evidence, float(a.wins),
        _effect_values(problem, a.fit, k),
    )  # fmt: skip


def _nominal(problem: Problem, fit: Fit, stated: Mapping[str, tuple[float, bool]]) -> tuple[NominalValue, ...]:
    factors, _ = problem.split(fit.hypothesis, fit.z)
    moved: dict[str, list[float]] = {}
    for nuisance, z, std in zip(problem.nuisances, fit.z, fit.std, strict=False):
        for name in nuisance.names:
            centre = z if name in factors else 0.0  # an effect that scales the group has its factor instead
            factor = [nuisance.factor(float(centre + side * INTERVAL * std)) for side in (-1.0, 0.0, 1.0)]
            moved[name] = [problem.plant.parameters[name].reference * f for f in factor]
    found = []
    for name, p in problem.plant.parameters.items():
        low, value, high = moved.get(name, [p.value] * 3)
        found.append(NominalValue(name, p.value, value, p.unit, min(low, high), max(low, high), *stated[name]))
    return tuple(found)


def _step(step: Any) -> NamingStep:
    entries = tuple(
        StepEntry(r.id, r.candidate.site.name if r.candidate else "", r.evidence, r.wins) for r in step.ranking.ranked
    )
    return NamingStep(tuple(c.effect.id for c in step.base.candidates), entries, step.decision, float(step.held_out))
