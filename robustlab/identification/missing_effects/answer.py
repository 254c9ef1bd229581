"""Build the result of `discover` from the posterior: verdict, effects, intervals, errors, residual force."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.errors import RobustlabError
from robustlab.identification import tuning
from robustlab.identification.data_checks.suitability import Finding
from robustlab.identification.greybox.effect_fit import Candidate, Fit, FitPlan, Hypothesis, Prior, Problem
from robustlab.identification.greybox.noise import settled
from robustlab.identification.missing_effects.discovery_result import (
    MODELS,
    Discovery,
    EffectValue,
    InputClock,
    NamedEffect,
    NominalValue,
    Rival,
    SetProbability,
    Verdict,
    overall,
)
from robustlab.identification.missing_effects.held_out import (
    at_limits,
    held_out_gaps,
    is_relevant,
    simulated,
    without_effects,
)
from robustlab.identification.missing_effects.named_kinds import Kinds, force_share
from robustlab.identification.missing_effects.posterior import Posterior, Weighted, place_of, weight_of
from robustlab.identification.missing_effects.residual_force import ResidualForce, remaining_lines, residual_force
from robustlab.identification.missing_effects.set_search import Found
from robustlab.identification.missing_effects.updated_plant import updated_plant
from robustlab.result import Status

if TYPE_CHECKING:
    from robustlab.identification.experiment import NextExperiment


MOST_OF_EXCESS = 0.5  # share of the nominal model's excess cost that sure effects must explain if a misfit remains
EXPLAINED = 0.9  # share of it below which the named effects are not the missing ones
T = TypeVar("T")
WIDER = 1.25  # times the fitted value: a larger value that is tested against the records
HELD = 1e8  # prior precision that fixes a standardised parameter


def answer(
    found: Found, posterior: Posterior, held: Problem, names: tuple[str, ...], tried: tuple[str, ...],
    stated: Mapping[str, tuple[float, bool]], known: Sequence[Finding], held_text: str,
) -> Discovery:  # fmt: skip
    """Return the result of `discover` for the records ``names``, with errors on all held-out windows."""
    problem, held, findings = found.problem, held.under(found.problem.clock), list(known)

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
    whole = settled(problem, best, found.noise)
    remains = _remains(problem, posterior, whole)
    if remains and best.hypothesis.candidates:
        whole = settled(problem, whole, found.noise, 1)
    negligible = stage("what matters", lambda: _negligible(found, held, whole), frozenset[str]())
    kinds = Kinds(problem, posterior, negligible)
    fit = whole
    if negligible:
        fit = settled(problem, without_effects(problem, whole, negligible), found.noise, 1 if remains else None)
    verdict = _verdict(found, kinds, fit, remains)
    named = fit.hypothesis.candidates
    bare = settled(problem, found.empty.fit, found.noise, 1 if named else None)
    as_given = Fit(Hypothesis(()), np.zeros(len(held.nuisances)), (), 0.0, np.eye(0), found.noise)
    gaps = held_out_gaps(held, {"nominal": as_given, "refitted": bare, "updated": fit}, problem.records)
    before, refitted, after = (overall(gaps.windows, model) for model in MODELS)
    in_run = {model: overall(gaps.free_run, model) for model in MODELS}
    complete = not remains and bool(np.isfinite(posterior.noise_ratio)) and verdict != "unknown"
    worse_than_given = in_run["updated"] > in_run["nominal"]
    if found.interrupted or not found.settled:
        kind, hint = ("interrupted", "run it again") if found.interrupted else ("search", "")
        text = f"{'stopped by the user' if hint else 'not settled'} after {found.expanded} sets were looked beyond"
        findings.append(Finding(kind, "search", text, "a search that ends by itself", hint, False, {}))
    if named:
        # A refit beyond its tolerances imitates the effects by its parameters: it refutes them only if its error is
        # smaller by the share `MATERIAL`.
        imitated = bool(at_limits(problem, bare)) and after <= (1.0 + tuning.MATERIAL) * refitted
        if worse_than_given or (gaps.worse and not imitated):
            verdict, complete = "unknown", False
        elif verdict == "named" and after > (1.0 + tuning.AS_LARGE) * refitted and not imitated:
            verdict = "ambiguous"
    if refuted := bool(named) and worse_than_given:
        text = f"free run on held-out data {in_run['updated']:.3g} % of the range, worse than as given"
        text += f" ({in_run['nominal']:.3g} %): not named"
        hint = "the records lack what would show the effect, or the catalogue lacks it"
        findings.append(Finding("refuted", ", ".join(map(place_of, named)), text, "", hint, False, {}))
        fit = bare  # the refuted effects are not reported
    rivals = [a for a in posterior.alternatives() if a[0].key not in kinds.ignored]
    if verdict == "unknown" and not named:
        rivals = []  # rivals of "no missing effect", which is no longer the verdict
    # The share of the given model's mean-square error above noise that the updated model removes.
    noise = (after / posterior.noise_ratio) ** 2 if posterior.noise_ratio > 1.0 else 0.0
    explained = float(np.clip((before**2 - after**2) / (before**2 - noise), 0.0, 1.0)) if before**2 > noise else 1.0
    experiment = stage("next experiment", lambda: _next_experiment(problem, best, [w for *_, w in rivals]), None)
    curves = stage("residual force", lambda: _force(found, fit), None)
    missing = stage("missing force", lambda: _force(found, bare), None) if named else None
    sure = stage("kinds", lambda: kinds.named(problem, remains), ()) if verdict != "unknown" else ()
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
        gaps=gaps.windows,
        free_run=gaps.free_run,
        free_run_on=gaps.free_run_on,
        held_out=held_text,
        plant=problem.plant.name,
        records=names,
        window=problem.records[0].windows.length * problem.records[0].record.dt,
        posterior=_probabilities(posterior),
        search=tuple((_places(v.fit), v.evidence - found.best.evidence) for v in found.sets),
        clocks=_clocks(problem, fit),
        candidates=tried,
        structure={"noise_ratio": posterior.noise_ratio, "explained": explained},
        residual_force=curves,
        missing_force=missing,
        remaining_lines=remaining_lines(posterior.weight.places, posterior.weight.left) if posterior.weight else (),
        findings=tuple(findings),
        series=gaps.series,
        model=model,
        next_experiment=experiment,
    )


# --- the verdict -----------------------------------------------------------------------------------------------------


def _remains(problem: Problem, posterior: Posterior, fit: Fit) -> bool:
    """Return whether more than noise and a small random force remains, or a clock imitates a delay."""
    clocks = {n.label for n in problem.nuisances if n.input}
    return (
        posterior.noise_ratio > tuning.MOST_NOISE
        or max((u.random_share for u in posterior.left), default=np.nan) > tuning.MOST_RANDOM
        or posterior.best.unnamed is not None
        or not posterior.generalises
        or bool(at_limits(problem, fit) & clocks)
    )


def _negligible(found: Found, held: Problem, fit: Fit) -> frozenset[str]:
    """Return the effects of the set without relevance on held-out data."""
    problem, known = found.problem, found.problem.records
    whole, already = simulated(held, fit, known), at_limits(problem, fit)
    negligible = set[str]()
    for k, key in enumerate(c.key for c in fit.hypothesis.candidates):
        less = without_effects(problem, fit, {key})
        needed = force_share(problem, fit, k) >= tuning.MATERIAL or bool(at_limits(problem, less) - already)
        if not needed and not is_relevant(held, whole, simulated(held, less, known)):
            negligible.add(key)
    return frozenset(negligible)


def _verdict(found: Found, kinds: Kinds, fit: Fit, remains: bool) -> Verdict:
    """Return "named" if the class of every relevant effect is sure; ``fit`` holds the named effects."""
    named = fit.hypothesis.candidates
    if not named:
        return "unknown" if remains else "no missing effect"
    sure = all(kinds.sure_kind(c) for c in named)
    explained = _explained(found, kinds.posterior.best.fit) if remains or kinds.posterior.coarse else 1.0
    if kinds.posterior.coarse and sure and explained >= MOST_OF_EXCESS:
        return "named"  # despite a misfit; undecided effects are part of the residual
    if remains and explained < EXPLAINED:
        return "unknown"
    return "named" if sure and found.settled and not kinds.open() else "ambiguous"


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
    from robustlab.identification.experiment import propose_experiment

    return propose_experiment(problem, best, list({w.key: w.fit for w in rivals}.values()))


# --- the parts of the result -----------------------------------------------------------------------------------------


def _parts(problem: Problem, fit: Fit, candidate: Candidate) -> tuple[str, str, str, tuple[EffectValue, ...]]:
    """Return id, title, site and fitted parameters of one effect of a set."""
    own = next(own for c, own in problem.slices(fit.hypothesis) if c.key == candidate.key)
    values = []
    for p, centre, spread in zip(candidate.parameters, fit.z[own], fit.std[own], strict=True):
        ends = sorted(p.prior.value(float(centre + side * tuning.INTERVAL * spread)) for side in (-1.0, 1.0))
        values.append(EffectValue(p.name, p.prior.value(float(centre)), p.unit, *ends))
    return candidate.effect.id, candidate.effect.title, candidate.site.name, tuple(values)


def _named(found: Found, posterior: Posterior, fit: Fit, candidate: Candidate) -> NamedEffect:
    less = next((v for v in found.sets if v.key == posterior.best.key - {candidate.key}), found.empty)
    return NamedEffect(
        *_parts(found.problem, fit, candidate)[:3],
        _opened_above(found.problem, fit, candidate),
        float(min(1.0, sum(w.probability for w in posterior.sets if candidate.key in w.key))),
        posterior.best.visited.evidence - less.evidence,
    )


def _opened_above(problem: Problem, fit: Fit, candidate: Candidate) -> tuple[EffectValue, ...]:
    """Return the effect's parameters; an interval extends to that of its prior if a larger value fits as well."""
    # If the load never reaches the other flank of a gap, the curvature has no information on its width: a clearly
    # larger value is fixed, and everything else refitted.
    values, name = _parts(problem, fit, candidate)[3], candidate.effect.told_from_below
    if not name:
        return values
    own = [p.name for p in candidate.parameters].index(name)
    at = next(place.start for c, place in problem.slices(fit.hypothesis) if c.key == candidate.key) + own
    prior = candidate.parameters[own].prior
    z = fit.z.copy()
    z[at] = prior.standardised(WIDER * values[own].value)
    mean, precision = np.zeros(len(z)), np.eye(len(z))
    mean[at], precision[at, at] = z[at], HELD
    there = problem.fit(fit.hypothesis, fit.noise, z, fit.starts, FitPlan(tuning.LAST), prior=Prior(mean, precision))
    if there.cost + there.z[at] ** 2 - fit.cost >= tuning.CANNOT_TELL**2:
        return values
    upper = max(values[own].upper, prior.value(tuning.INTERVAL))
    return tuple(replace(v, upper=upper) if v.name == name else v for v in values)


def _rival(
    problem: Problem, posterior: Posterior, candidate: Candidate, instead_of: Candidate | None, there: Weighted
) -> Rival:
    parts, behind = _parts(problem, there.fit, candidate), there.evidence - posterior.best.evidence
    other = instead_of.effect.id if instead_of else "none"
    return Rival(*parts, there.probability, behind, other, there.distance)


def _nominal(problem: Problem, fit: Fit, stated: Mapping[str, tuple[float, bool]]) -> tuple[NominalValue, ...]:
    factors, _ = problem.split(fit.hypothesis, fit.z)
    moved: dict[str, list[float]] = {}
    for nuisance, z, std in zip(problem.nuisances, fit.z, fit.std, strict=False):
        for name in nuisance.names:
            centre = z if name in factors else 0.0  # a parameter with a named shift has it there
            factor = [nuisance.factor(float(centre + side * tuning.INTERVAL * std)) for side in (-1.0, 0.0, 1.0)]
            moved[name] = [problem.plant.parameters[name].reference * f for f in factor]
    for candidate in fit.hypothesis.candidates:
        if candidate.site.kind == "parameter" and candidate.effect.scale:  # value of a parameter named as misjudged
            s = _parts(problem, fit, candidate)[3][0]
            for name in candidate.effect.factors(problem.plant, candidate.site, {s.name: s.value}):
                moved[name] = [problem.plant.parameters[name].reference * f for f in (s.lower, s.value, s.upper)]
    values = []
    for name, p in problem.plant.parameters.items():
        low, value, high = moved.get(name, [p.value] * 3)
        tolerance = stated[name][0]
        beyond = name in moved and abs(value - p.value) > tolerance * abs(p.value or 1.0)
        ends = min(low, high), max(low, high)
        values.append(NominalValue(name, value, p.unit, *ends, p.value, *stated[name], beyond))
    return tuple(values)


def _clocks(problem: Problem, fit: Fit) -> tuple[InputClock, ...]:
    hold = problem.clock.hold or ("zoh",) * len(problem.plant.inputs)
    shift = problem.shift(fit.z) or (0.0,) * len(hold)
    std = {n.input: n.spread * s for n, s in zip(problem.nuisances, fit.std, strict=False) if n.input}
    return tuple(
        InputClock(s.name, "held" if h == "zoh" else h, t, std.get(s.name, 0.0))
        for s, h, t in zip(problem.plant.inputs, hold, shift, strict=True)
    )


def _places(fit: Fit) -> tuple[str, ...]:
    return tuple(map(place_of, fit.hypothesis.candidates))


def _probabilities(posterior: Posterior) -> tuple[SetProbability, ...]:
    best, found = posterior.best.evidence, []
    for w in posterior.sets:
        f = w.unnamed
        unnamed = f"{'dry ' if f.dry else ''}force over {f.over} at {f.port}" if f else ""
        found.append(SetProbability(_places(w.fit), w.probability, w.evidence - best, w.distance, unnamed))
    return tuple(found)
