"""Build the result of `discover` from the posterior: verdict, effects, intervals, residual force, and errors of the
models on held-out records, in windows and in free run.

An effect is relevant if the RMS error without it is larger by the share `MATERIAL` and by the sensor's resolution, if
its force is such a share of the force at its joint, or if only parameters beyond tolerances could replace it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from scipy.special import gammaincinv

from robustlab.arrays import Array
from robustlab.dynamics.extended.simulator import Windows
from robustlab.dynamics.plant_base import NonlinearPlant
from robustlab.errors import RobustlabError
from robustlab.identification import constants
from robustlab.identification.data_checks.suitability import Finding
from robustlab.identification.greybox import noise as noises
from robustlab.identification.greybox.effect_fit import (
    Candidate,
    Fit,
    FitPlan,
    Hypothesis,
    Prior,
    Problem,
    simulated_outputs,
)
from robustlab.identification.greybox.prepared_record import PreparedRecord
from robustlab.identification.greybox.residual_force import ResidualForce, remaining_lines, residual_force
from robustlab.identification.missing_effects import discovery_result as result
from robustlab.identification.missing_effects.discovery_result import Discovery, Gap, overall
from robustlab.identification.missing_effects.effect_search import Found, without
from robustlab.identification.missing_effects.posterior import Kinds, Posterior, Weighted, force_share, weight_of
from robustlab.identification.missing_effects.updated_plant import updated_plant
from robustlab.result import Status

if TYPE_CHECKING:
    from robustlab.identification.experiment_design import NextExperiment

T = TypeVar("T")
MOST_OF_EXCESS = 0.5  # share of the nominal model's excess cost that sure effects must explain if a misfit remains
EXPLAINED = 0.9  # share of it below which the named effects are not the missing ones
WIDER = 1.25  # times the fitted value: a larger value that is tested against the records
HELD = 1e8  # prior precision that fixes a standardised parameter
MOST_CLOCK = 3.0  # standard deviations of an input's clock
LIKELY = 0.999  # joint probability of the parameters beyond which they are improbable
TOGETHER = "all parameters together"


def answer(
    found: Found, posterior: Posterior, held: Problem, names: tuple[str, ...], tried: tuple[str, ...],
    stated: Mapping[str, tuple[float, bool]], known: Sequence[Finding], held_text: str,
) -> Discovery:  # fmt: skip
    """Return the result of `discover` for the records ``names``, with errors on all held-out windows."""
    problem, findings = found.problem, list(known)
    kept_out = HeldOut(held.under(problem.clock), problem.records)

    def stage(what: str, work: Callable[[], T], instead: T) -> T:
        # A failure after the search must not lose the named effects.
        try:
            with np.errstate(all="ignore"):
                return work()
        except (RobustlabError, np.linalg.LinAlgError, ValueError, ArithmeticError) as fault:
            text = f"not computed: {fault}"
            findings.append(Finding("stage", what, text, "a number", "the names stand without it", False, {}))
            return instead

    best = posterior.best.fit
    whole = noises.settled(problem, best, found.noise)
    remains = _remains(problem, posterior, whole)
    if remains and best.hypothesis.candidates:
        whole = noises.settled(problem, whole, found.noise, 1)
    negligible = stage("what matters", lambda: _negligible(problem, kept_out, whole), frozenset[str]())
    kinds = Kinds(problem, posterior, negligible)
    fit = whole
    if negligible:
        less = without_effects(problem, whole, negligible)
        fit = noises.settled(problem, less, found.noise, 1 if remains else constants.AR_ORDER)
    verdict = _verdict(found, kinds, fit, remains)
    named = fit.hypothesis.candidates
    bare = noises.settled(problem, found.empty.fit, found.noise, 1 if named else constants.AR_ORDER)
    as_given = Fit(Hypothesis(()), np.zeros(len(held.nuisances)), (), 0.0, np.eye(0), found.noise)
    own = {n: kept_out.simulated(f) for n, f in (("nominal", as_given), ("refitted", bare), ("updated", fit))}
    windows, free_run = kept_out.gaps(0, own), kept_out.gaps(1, own)
    before, refitted, after = (overall(windows, model) for model in result.MODELS)
    in_run = {model: overall(free_run, model) for model in result.MODELS}
    complete = not remains and bool(np.isfinite(posterior.noise_ratio)) and verdict != "unknown"
    worse_than_given = in_run["updated"] > in_run["nominal"]
    if found.interrupted or not found.settled:
        kind, hint = ("interrupted", "run it again") if found.interrupted else ("search", "")
        text = f"{'stopped by the user' if hint else 'not settled'} after {found.expanded} expanded sets"
        findings.append(Finding(kind, "search", text, "a search that ends by itself", hint, False, {}))
    worse = noises.clearly_larger(*(own[name].window_errors() for name in ("updated", "refitted")))
    if named:
        # A refit beyond its tolerances imitates the effects by its parameters: it refutes them only if its error is
        # smaller by the share `MATERIAL`.
        imitated = bool(at_limits(problem, bare)) and after <= (1.0 + constants.MATERIAL) * refitted
        if worse_than_given or (worse and not imitated):
            verdict, complete = "unknown", False
        elif verdict == "named" and after > (1.0 + constants.AS_LARGE) * refitted and not imitated:
            verdict = "ambiguous"
    if refuted := bool(named) and worse_than_given:
        text = f"free run on held-out data {in_run['updated']:.3g} % of the range, worse than as given"
        text += f" ({in_run['nominal']:.3g} %): not named"
        hint = "the records lack what would show the effect, or the catalogue lacks it"
        findings.append(Finding("refuted", ", ".join(_keys(fit)), text, "", hint, False, {}))
        fit = bare  # the refuted effects are not reported
    rivals = [a for a in posterior.alternatives() if a[0].key not in negligible]
    if verdict == "unknown" and not named:
        rivals = []  # rivals of "no missing effect", which is no longer the verdict
    # The share of the given model's mean-square error above noise that the updated model removes.
    noise = (after / posterior.noise_ratio) ** 2 if posterior.noise_ratio > 1.0 else 0.0
    explained = float(np.clip((before**2 - after**2) / (before**2 - noise), 0.0, 1.0)) if before**2 > noise else 1.0
    experiment = stage("next experiment", lambda: _next_experiment(problem, best, [w for *_, w in rivals]), None)
    curves = stage("residual force", lambda: _force(found, fit), None)
    missing = stage("missing force", lambda: _force(found, bare), None) if named else None
    sure = stage("kinds", lambda: kinds.named(remains), ()) if verdict != "unknown" else ()
    source = f"fitted to {', '.join(names)}"
    model = None if refuted else stage("updated plant", lambda: updated_plant(problem, fit, source, sure), None)
    # A name is not trustworthy alone if more error remains than the names explain.
    trusted = verdict == "no missing effect" or (verdict == "named" and (complete or explained >= 0.5))
    return Discovery(
        status=Status.CONVERGED if trusted else Status.INCONCLUSIVE,
        verdict=verdict,
        complete=complete,
        effects=tuple(_named(found, posterior, fit, c) for c in fit.hypothesis.candidates),
        kinds=sure,
        also_detectable=tuple(
            _named(found, posterior, whole, c) for c in whole.hypothesis.candidates if c.key in negligible
        ),
        rivals=tuple(_rival(problem, posterior, *a) for a in rivals),
        nominal=_nominal(problem, fit, stated),
        gap_before=before,
        gap_refitted=refitted,
        gap_after=after,
        gaps=windows,
        free_run=free_run,
        free_run_on=kept_out.description,
        held_out=held_text,
        plant=problem.plant.name,
        records=names,
        window=problem.records[0].windows.length * problem.records[0].record.dt,
        posterior=_probabilities(posterior),
        search=tuple((_keys(v.fit), v.evidence - found.sets[0].evidence) for v in found.sets),
        clocks=_clocks(problem, fit),
        candidates=tried,
        structure={"noise_ratio": posterior.noise_ratio, "explained": explained},
        residual_force=curves,
        missing_force=missing,
        remaining_lines=remaining_lines(posterior.weight.places, posterior.weight.left) if posterior.weight else (),
        findings=tuple(findings),
        series=kept_out.series(0, own) | {"free_run": kept_out.series(1, own)},
        model=model,
        next_experiment=experiment,
    )


# --- the verdict -----------------------------------------------------------------------------------------------------


def _remains(problem: Problem, posterior: Posterior, fit: Fit) -> bool:
    """Return whether more than noise and a small random force remains, or a clock imitates a delay."""
    clocks = {n.label for n in problem.nuisances if n.input}
    return (
        posterior.noise_ratio > constants.MOST_NOISE
        or max((u.random_share for u in posterior.left), default=np.nan) > constants.MOST_RANDOM
        or posterior.best.unnamed is not None
        or not posterior.generalises
        or bool(at_limits(problem, fit) & clocks)
    )


def _negligible(problem: Problem, held: HeldOut, fit: Fit) -> frozenset[str]:
    """Return the effects of the set without relevance on held-out data."""
    whole, already = held.simulated(fit), at_limits(problem, fit)
    negligible = set[str]()
    for k, key in enumerate(_keys(fit)):
        less = without_effects(problem, fit, {key})
        needed = force_share(problem, fit, k) >= constants.MATERIAL or bool(at_limits(problem, less) - already)
        if not needed and not held.is_relevant(whole, held.simulated(less)):
            negligible.add(key)
    return frozenset(negligible)


def _verdict(found: Found, kinds: Kinds, fit: Fit, remains: bool) -> result.Verdict:
    """Return "named" if the class of every relevant effect is sure; ``fit`` holds the named effects."""
    named = fit.hypothesis.candidates
    if not named:
        return "unknown" if remains else "no missing effect"
    sure = all(kinds.sure_kind(c) for c in named)
    coarse = kinds.posterior.coarse
    explained = _explained(found, kinds.posterior.best.fit) if remains or coarse else 1.0
    if coarse and sure and explained >= MOST_OF_EXCESS:
        return "named"  # despite a misfit; undecided effects are part of the residual
    if remains and explained < EXPLAINED:
        return "unknown"
    return "named" if sure and found.settled and not kinds.open else "ambiguous"


def _explained(found: Found, fit: Fit) -> float:
    """Return the share of the nominal model's excess cost over noise that the effects explain."""
    bare, now = found.empty.fit.cost, fit.cost
    points = float(sum(np.isfinite(e).sum() for e in found.problem.errors(fit.hypothesis, fit.z, fit.starts)))
    points /= fit.noise.excess  # cost of noise alone: its modelled variance exceeds that of the errors
    return 1.0 if bare <= points else (bare - now) / (bare - points)


def _force(found: Found, fit: Fit) -> ResidualForce | None:
    weight = weight_of(found, fit)
    return weight and residual_force(found.problem.plant, weight.places)


def _next_experiment(problem: Problem, best: Fit, rivals: Sequence[Weighted]) -> NextExperiment | None:
    """Return the experiment that would separate the named effects from their rivals."""
    if not rivals or isinstance(problem.plant, NonlinearPlant):  # its controller determines the motion
        return None
    from robustlab.identification.experiment_design import propose_experiment

    return propose_experiment(problem, best, list({w.key: w.fit for w in rivals}.values()))


def without_effects(problem: Problem, fit: Fit, keys: Collection[str]) -> Fit:
    """Refit the set without these effects, from the parameters of the whole set."""
    while (k := next((k for k, key in enumerate(_keys(fit)) if key in keys), None)) is not None:
        hypothesis, z = without(problem, fit, k)
        fit = problem.fit(hypothesis, fit.noise, z, fit.starts, FitPlan(constants.FULL))
    return fit


def at_limits(problem: Problem, fit: Fit) -> frozenset[str]:
    """Return labels of the nuisances that a fit moved beyond their limits, and `TOGETHER` if all are improbable."""
    own = [
        (n, float(z), (-MOST_CLOCK, MOST_CLOCK) if n.input else n.ends)
        for n, moves, z in zip(problem.nuisances, problem.moving(fit.hypothesis), fit.z, strict=False) if moves
    ]  # fmt: skip
    found = {n.label for n, z, (low, high) in own if not low <= z <= high}
    if sum(z**2 for _, z, _ in own) > 2.0 * gammaincinv(max(1, len(own)) / 2, LIKELY):
        found.add(TOGETHER)
    return frozenset(found)


# --- errors on held-out records --------------------------------------------------------------------------------------


class Simulated(NamedTuple):
    """A fit on held-out data with re-estimated initial states: outputs of the windows and of the whole runs."""

    problem: Problem
    fit: Fit
    outputs: tuple[list[Array], list[Array]]

    def window_errors(self) -> Array:
        return noises.window_errors(self.problem, self.fit)


class HeldOut:
    """Held-out data in two views: 0, the windows of each record; 1, each record as one run.

    A run is the longest stretch of windows without a gap.
    """

    def __init__(self, problem: Problem, known: Sequence[PreparedRecord]) -> None:
        self.problem, self.known = problem, known  # known: the fitted records
        runs = [unbroken(record) for record in problem.records]
        pairs = list(zip(problem.records, problem.chosen, strict=True))
        self.samples = [r.samples[chosen] for r, chosen in pairs], [r.samples for r in runs]
        self.measured = [r.measured[chosen] for r, chosen in pairs], [r.measured for r in runs]

    @property
    def description(self) -> str:
        """Return the names of the records, and whether the fit saw a part of them."""
        names = ", ".join(r.record.name for r in self.problem.records)
        if isinstance(self.problem.plant, NonlinearPlant):
            names += f" ({result.LINEAR})"
        each = zip(self.problem.records, self.problem.chosen, strict=True)
        partly = any(len(chosen) < r.count for r, chosen in each)
        return f"all of {names}, which the fit saw in part" if partly else names

    def simulated(self, fit: Fit) -> Simulated:
        """Simulate a fit on the windows and over each record."""
        # Initial states are re-estimated, and in records not ``known`` the phases of effects over time.
        own = noises.in_phase(self.problem, fit, self.known)[0]
        placed, runs = noises.restarted(own, fit), [unbroken(record) for record in own.records]
        lengths = [r.windows.length for r in own.records]
        beginnings = [replace(r, windows=Windows(r.windows.starts, n)) for r, n in zip(runs, lengths, strict=True)]
        start = noises.restarted(own.on(beginnings), fit)
        with np.errstate(all="ignore"):
            outputs = simulated_outputs(own, placed), simulated_outputs(own.on(runs), start)
        return Simulated(own, placed, outputs)

    def gaps(self, view: int, own: Mapping[str, Simulated]) -> dict[str, Gap]:
        """Return the errors of the models by output."""
        measured, plant, records = self.measured[view], self.problem.plant, self.problem.records
        rms = {name: _rms(measured, measured, s.outputs[view]) for name, s in own.items()}
        ranges, found = noises.spans(records), dict[str, Gap]()
        for j, column in enumerate(records[0].columns):
            if any(np.isfinite(y[:, :, j]).any() for y in measured):
                name, unit = plant.outputs[column].name, plant.outputs[column].unit
                found[name] = Gap(name, unit, float(ranges[j]), **{key: float(v[j]) for key, v in rms.items()})
        return found

    def series(self, view: int, own: Mapping[str, Simulated]) -> dict[str, Any]:
        """Return time, inputs and outputs of the record with most sensors; NaN for diverged outputs."""
        records, plant = self.problem.records, self.problem.plant
        k = int(np.argmax([np.isfinite(r.y).any(axis=0).sum() for r in records]))
        record, samples, measured = records[k].record, self.samples[view][k].ravel(), self.measured[view][k]
        signals = {}
        for j, column in enumerate(records[k].columns):
            if np.isfinite(measured[:, :, j]).any():
                each = {name: s.outputs[view][k] for name, s in own.items()}
                each = {name: np.where(np.isfinite(y), y, np.nan)[:, :, j].ravel() for name, y in each.items()}
                signals[plant.outputs[column].name] = {"measured": measured[:, :, j].ravel(), **each}
        inputs = {s.name: record.inputs[s.name][samples] for s in plant.inputs}
        return {"t": record.t[samples], "record": record.name, "inputs": inputs, "outputs": signals}

    def is_relevant(self, whole: Simulated, less: Simulated) -> bool:
        """Return whether the errors are larger with the set ``less`` an effect than with the whole one."""
        resolution = np.max([r.resolution for r in self.problem.records], axis=0)
        for measured, ours, theirs in zip(self.measured, whole.outputs, less.outputs, strict=True):
            own, other = _rms(measured, measured, ours), _rms(measured, measured, theirs)
            with np.errstate(all="ignore"):
                worse = ~(other - own < constants.MATERIAL * own)  # true for a diverged model
                apart = _rms(measured, ours, theirs)
                if np.any(worse & (own < np.inf) & ~(apart < 0.5 * resolution) & ~(other <= own)):
                    return True
        return False


def unbroken(record: PreparedRecord) -> PreparedRecord:
    """Return the longest stretch of windows without a gap, as one window."""
    starts, length = record.windows.starts, record.windows.length
    groups = np.split(np.arange(len(starts)), np.flatnonzero(np.diff(starts) != length) + 1)
    longest = max(groups, key=len)
    a, b = longest[0], longest[-1]
    windows = Windows(starts[a : a + 1], int(starts[b] + length - starts[a]))
    return replace(record, windows=windows, x0=record.x0[a : a + 1], x0_std=record.x0_std[a : a + 1])


def _rms(measured: Sequence[Array], ours: Sequence[Array], theirs: Sequence[Array]) -> Array:
    """Return the RMS difference of each output where it was measured, (n_measured,); infinite if a model diverges."""
    y, a, b = (np.concatenate([p.reshape(-1, p.shape[-1]) for p in parts]) for parts in (measured, ours, theirs))
    known = np.isfinite(y)
    with np.errstate(all="ignore"):
        difference = np.where(known, b - a, 0.0)
        difference[~np.isfinite(difference)] = np.inf
        return np.asarray(np.sqrt((difference**2).sum(axis=0) / np.maximum(known.sum(axis=0), 1)))


# --- the parts of the result -----------------------------------------------------------------------------------------


def _keys(fit: Fit) -> tuple[str, ...]:
    return tuple(c.key for c in fit.hypothesis.candidates)


def _values(problem: Problem, fit: Fit, candidate: Candidate) -> tuple[result.EffectValue, ...]:
    """Return the fitted parameters of one effect of a set."""
    own = next(own for c, own in problem.slices(fit.hypothesis) if c.key == candidate.key)
    values = []
    for p, centre, spread in zip(candidate.parameters, fit.z[own], fit.std[own], strict=True):
        ends = sorted(p.prior.value(float(centre + side * constants.INTERVAL * spread)) for side in (-1.0, 1.0))
        values.append(result.EffectValue(p.name, p.prior.value(float(centre)), p.unit, *ends))
    return tuple(values)


def _named(found: Found, posterior: Posterior, fit: Fit, candidate: Candidate) -> result.NamedEffect:
    less = next((v for v in found.sets if v.key == posterior.best.key - {candidate.key}), found.empty)
    return result.NamedEffect(
        candidate.effect.id, candidate.effect.title, candidate.site.name, _opened_above(found.problem, fit, candidate),
        float(min(1.0, sum(w.probability for w in posterior.sets if candidate.key in w.key))),
        posterior.best.scored.evidence - less.evidence,
    )  # fmt: skip


def _opened_above(problem: Problem, fit: Fit, candidate: Candidate) -> tuple[result.EffectValue, ...]:
    """Return the effect's parameters; an interval extends to that of its prior if a larger value fits as well."""
    # If the load never reaches the other flank of a gap, the curvature has no information on its width: a clearly
    # larger value is fixed, and everything else refitted.
    values, name = _values(problem, fit, candidate), candidate.effect.told_from_below
    if not name:
        return values
    own = [p.name for p in candidate.parameters].index(name)
    at = next(place.start for c, place in problem.slices(fit.hypothesis) if c.key == candidate.key) + own
    prior = candidate.parameters[own].prior
    z = fit.z.copy()
    z[at] = prior.standardised(WIDER * values[own].value)
    mean, precision = np.zeros(len(z)), np.eye(len(z))
    mean[at], precision[at, at] = z[at], HELD
    there = problem.fit(fit.hypothesis, fit.noise, z, fit.starts, FitPlan(constants.LAST), prior=Prior(mean, precision))
    if there.cost + there.z[at] ** 2 - fit.cost >= constants.CANNOT_TELL**2:
        return values
    upper = max(values[own].upper, prior.value(constants.INTERVAL))
    return tuple(replace(v, upper=upper) if v.name == name else v for v in values)


def _rival(
    problem: Problem, posterior: Posterior, candidate: Candidate, instead_of: Candidate | None, there: Weighted
) -> result.Rival:
    return result.Rival(
        candidate.effect.id, candidate.effect.title, candidate.site.name, _values(problem, there.fit, candidate),
        there.probability, there.evidence - posterior.best.evidence, instead_of.effect.id if instead_of else "none",
        there.distance,
    )  # fmt: skip


def _nominal(problem: Problem, fit: Fit, stated: Mapping[str, tuple[float, bool]]) -> tuple[result.NominalValue, ...]:
    factors, _ = problem.split(fit.hypothesis, fit.z)
    moved: dict[str, list[float]] = {}
    for nuisance, z, std in zip(problem.nuisances, fit.z, fit.std, strict=False):
        for name in nuisance.names:
            centre = z if name in factors else 0.0  # a parameter with a named shift has it there
            factor = [nuisance.factor(float(centre + side * constants.INTERVAL * std)) for side in (-1.0, 0.0, 1.0)]
            moved[name] = [problem.plant.parameters[name].reference * f for f in factor]
    for candidate in fit.hypothesis.candidates:
        if candidate.site.kind == "parameter" and candidate.effect.scale:  # value of a parameter named as misjudged
            s = _values(problem, fit, candidate)[0]
            for name in candidate.effect.factors(problem.plant, candidate.site, {s.name: s.value}):
                moved[name] = [problem.plant.parameters[name].reference * f for f in (s.lower, s.value, s.upper)]
    values = []
    for name, p in problem.plant.parameters.items():
        low, value, high = moved.get(name, [p.value] * 3)
        tolerance = stated[name][0]
        beyond = name in moved and abs(value - p.value) > tolerance * abs(p.value or 1.0)
        ends = min(low, high), max(low, high)
        values.append(result.NominalValue(name, value, p.unit, *ends, p.value, *stated[name], beyond))
    return tuple(values)


def _clocks(problem: Problem, fit: Fit) -> tuple[result.InputClock, ...]:
    hold = problem.clock.hold or ("zoh",) * len(problem.plant.inputs)
    shift = problem.shift(fit.z) or (0.0,) * len(hold)
    std = {n.input: n.spread * s for n, s in zip(problem.nuisances, fit.std, strict=False) if n.input}
    return tuple(
        result.InputClock(s.name, "held" if h == "zoh" else h, t, std.get(s.name, 0.0))
        for s, h, t in zip(problem.plant.inputs, hold, shift, strict=True)
    )


def _probabilities(posterior: Posterior) -> tuple[result.SetProbability, ...]:
    best, found = posterior.best.evidence, []
    for w in posterior.sets:
        f = w.unnamed
        unnamed = f"{'dry ' if f.dry else ''}force over {f.over} at {f.port}" if f else ""
        found.append(result.SetProbability(_keys(w.fit), w.probability, w.evidence - best, w.distance, unnamed))
    return tuple(found)
