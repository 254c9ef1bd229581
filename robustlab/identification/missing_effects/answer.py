"""Build the result of `discover` from the posterior: verdict, effects, intervals, errors, residual force."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.errors import RobustlabError
from robustlab.identification import tuning
from robustlab.identification.data_checks.suitability import Finding
from robustlab.identification.greybox.effect_fit import (
    Fit,
    FitPlan,
    Hypothesis,
    Prior,
    Problem,
)
from robustlab.identification.greybox.noise import settled
from robustlab.identification.missing_effects.discovery_parts import (
    INTERVAL,
    EffectValue,
    InputClock,
    NamedEffect,
    NominalValue,
    Rival,
    SetProbability,
    Verdict,
    overall,
)
from robustlab.identification.missing_effects.discovery_result import Discovery
from robustlab.identification.missing_effects.held_out import (
    Gaps,
    Relevance,
    at_limits,
    held_out_gaps,
    relevance_of,
    simulated,
    without_effects,
)
from robustlab.identification.missing_effects.named_kinds import Kinds, force_share
from robustlab.identification.missing_effects.posterior import Alternative, Posterior, weight_of
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


class _Stages(list[Finding]):
    """Findings on failed stages after the search: a failure must not lose the named effects."""

    def run(self, what: str, work: Callable[[], T], instead: T) -> T:
        try:
            with np.errstate(all="ignore"):
                return work()
        except (RobustlabError, np.linalg.LinAlgError, ValueError, ArithmeticError) as fault:
            self.append(
                Finding("stage", what, f"not computed: {fault}", "a number", "the names stand without it", False, {})
            )
            return instead


def answer(
    found: Found, posterior: Posterior, held: Problem, names: tuple[str, ...], tried: tuple[str, ...],
    stated: Mapping[str, tuple[float, bool]], known: Sequence[Finding], held_text: str,
) -> Discovery:  # fmt: skip
    """Return the result of `discover` for the records ``names``, with errors on all held-out windows."""
    problem, held, stages = found.problem, held.under(found.problem.clock), _Stages()
    best = posterior.best.fit
    whole = settled(problem, best, found.noise)
    remains = _remains(problem, posterior, whole)
    if remains and best.hypothesis.candidates:
        whole = settled(problem, whole, found.noise, 1)
    relevance = stages.run("what matters", lambda: _relevances(found, held, whole), {})
    negligible = frozenset(key for key, m in relevance.items() if not m.material)
    kinds = Kinds(problem, posterior, negligible)
    fit = whole
    if negligible:
        fit = settled(problem, without_effects(problem, whole, negligible), found.noise, 1 if remains else None)
        # The errors without each effect refer to the smaller set.
        relevance |= stages.run("what matters", lambda: _relevances(found, held, fit), {})
    verdict = _verdict(found, kinds, fit, remains)
    named = fit.hypothesis.candidates
    bare = settled(problem, found.empty.fit, found.noise, 1 if named else None)
    as_given = Fit(Hypothesis(()), np.zeros(len(held.nuisances)), (), 0.0, np.eye(0), found.noise)
    gaps = held_out_gaps(held, {"nominal": as_given, "refitted": bare, "updated": fit}, problem.records)
    complete = not remains and bool(np.isfinite(posterior.noise_ratio)) and verdict != "unknown"
    findings = [*known, *_search_findings(found)]
    if named:
        verdict, complete = _on_held_out(verdict, complete, gaps, bool(at_limits(problem, bare)))
    if refuted := bool(named) and gaps.worse_than_given:
        findings.append(_refuted(fit, gaps))
        fit = bare  # the refuted effects are not reported
    rivals = [a for a in posterior.alternatives() if a.candidate.key not in kinds.ignored]
    if verdict == "unknown" and not named:
        rivals = []  # rivals of "no missing effect", which is no longer the verdict
    explained = _explained_on_held_out(gaps, posterior.noise_ratio)
    structure = {"noise_ratio": posterior.noise_ratio, "explained": explained}
    experiment = stages.run("next experiment", lambda: _next_experiment(problem, best, rivals), None)
    curves = stages.run("residual force", lambda: _force(found, fit), None)
    missing = stages.run("missing force", lambda: _force(found, bare), None) if named else None
    sure = stages.run("kinds", lambda: kinds.named(problem, remains), ()) if verdict != "unknown" else ()
    source = f"fitted to {', '.join(names)}"
    model = None if refuted else stages.run("updated plant", lambda: updated_plant(problem, fit, source, sure), None)

    def effects(fit: Fit, keys: Collection[str]) -> tuple[NamedEffect, ...]:
        own = [k for k, c in enumerate(fit.hypothesis.candidates) if c.key in keys]
        return tuple(_named(found, posterior, fit, k, rivals, relevance) for k in own)

    # A name is not trustworthy alone if more error remains than the names explain.
    trusted = verdict == "no missing effect" or (verdict == "named" and (complete or explained >= 0.5))
    return Discovery(
        status=Status.CONVERGED if trusted else Status.INCONCLUSIVE,
        verdict=verdict,
        complete=complete,
        effects=effects(fit, [c.key for c in fit.hypothesis.candidates]),
        kinds=sure,
        also_detectable=effects(whole, negligible),
        rivals=tuple(_rival(problem, a) for a in rivals),
        nominal=_nominal(problem, fit, stated),
        gap_before=overall(gaps.windows, "nominal"),
        gap_refitted=overall(gaps.windows, "refitted"),
        gap_after=overall(gaps.windows, "updated"),
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
        structure=structure,
        residual_force=curves,
        missing_force=missing,
        remaining_lines=remaining_lines(posterior.weight.places, posterior.weight.left) if posterior.weight else (),
        findings=(*findings, *stages),
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
        or posterior.random_share > tuning.MOST_RANDOM
        or posterior.best.unnamed is not None
        or not posterior.generalises
        or bool(at_limits(problem, fit) & clocks)
    )


def _relevances(found: Found, held: Problem, fit: Fit) -> dict[str, Relevance]:
    """Return the relevance on held-out data of each effect of the set."""
    problem, known = found.problem, found.problem.records
    if not fit.hypothesis.candidates:
        return {}
    whole, already = simulated(held, fit, known), at_limits(problem, fit)
    relevance = {}
    for k, key in enumerate(c.key for c in fit.hypothesis.candidates):
        less = without_effects(problem, fit, {key})
        needed = force_share(problem, fit, k) >= tuning.MATERIAL or bool(at_limits(problem, less) - already)
        relevance[key] = relevance_of(held, whole, simulated(held, less, known), needed)
    return relevance


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


def _on_held_out(verdict: Verdict, complete: bool, gaps: Gaps, beyond: bool) -> tuple[Verdict, bool]:
    """Return verdict and completeness after the held-out data, which may refute the named effects."""
    # A refit ``beyond`` its tolerances imitates the effects by its parameters: it refutes them only if its error
    # is smaller by the share `MATERIAL`.
    updated, refitted = (overall(gaps.windows, model) for model in ("updated", "refitted"))
    imitated = beyond and updated <= (1.0 + tuning.MATERIAL) * refitted
    if gaps.worse_than_given or (gaps.worse and not imitated):
        return "unknown", False
    further = updated > (1.0 + tuning.AS_LARGE) * refitted and not imitated
    return "ambiguous" if further and verdict == "named" else verdict, complete


def _explained(found: Found, fit: Fit) -> float:
    """Return the share of the nominal model's excess cost over noise that the effects explain."""
    bare, now = found.empty.fit.cost, fit.cost
    points = float(sum(np.isfinite(e).sum() for e in found.problem.errors(fit.hypothesis, fit.z, fit.starts)))
    points /= fit.noise.excess  # cost of noise alone: its modelled variance exceeds that of the errors
    return 1.0 if bare <= points else (bare - now) / (bare - points)


def _refuted(fit: Fit, gaps: Gaps) -> Finding:
    """Return the finding that the best set worsens the held-out free run of the given model."""
    given, updated = (overall(gaps.free_run, model) for model in ("nominal", "updated"))
    text = f"free run on held-out data {updated:.3g} % of the range, worse than as given ({given:.3g} %): not named"
    hint = "the records lack what would show the effect, or the catalogue lacks it"
    evidence: dict[str, object] = {"given": given, "updated": updated}
    return Finding("refuted", ", ".join(_places(fit)), text, "", hint, False, evidence)


def _explained_on_held_out(gaps: Gaps, noise_ratio: float) -> float:
    """Return the share of the given model's mean-square error above noise that the updated model removes."""
    given, updated = (overall(gaps.windows, model) ** 2 for model in ("nominal", "updated"))
    noise = updated / noise_ratio**2 if noise_ratio > 1.0 else 0.0
    return float(np.clip((given - updated) / (given - noise), 0.0, 1.0)) if given > noise else 1.0


def _force(found: Found, fit: Fit) -> ResidualForce | None:
    weight = weight_of(found, fit)
    return weight and residual_force(found.problem.plant, weight.places)


def _search_findings(found: Found) -> list[Finding]:
    if found.interrupted:
        text = f"stopped by the user after {found.expanded} sets were looked beyond"
        return [Finding("interrupted", "search", text, "a search that ends by itself", "run it again", False, {})]
    if not found.settled:
        text = f"not settled after {found.expanded} sets were looked beyond"
        return [Finding("search", "search", text, "a set that nothing makes more probable", "", False, {})]
    return []


def _next_experiment(problem: Problem, best: Fit, rivals: Sequence[Alternative]) -> NextExperiment | None:
    """Return the experiment that would separate the named effects from their rivals."""
    if not rivals or isinstance(problem.plant, NonlinearPlant):  # its controller determines the motion
        return None
    from robustlab.identification.experiment import propose_experiment

    others = {a.weighed.key: a.weighed.fit for a in rivals}
    return propose_experiment(problem, best, list(others.values()))


# --- the parts of the result -----------------------------------------------------------------------------------------


def _effect_values(problem: Problem, fit: Fit, k: int) -> tuple[EffectValue, ...]:
    candidate, own = problem.slices(fit.hypothesis)[k]
    values = []
    for p, centre, spread in zip(candidate.parameters, fit.z[own], fit.std[own], strict=True):
        ends = sorted(p.prior.value(float(centre + side * INTERVAL * spread)) for side in (-1.0, 1.0))
        values.append(EffectValue(p.name, p.prior.value(float(centre)), p.unit, ends[0], ends[1], p.meaning))
    return tuple(values)


def _named(
    found: Found, posterior: Posterior, fit: Fit, k: int, rivals: Sequence[Alternative], tested: Mapping[str, Relevance]
) -> NamedEffect:
    candidate = fit.hypothesis.candidates[k]
    own = [a for a in rivals if a.instead_of is not None and a.instead_of.key == candidate.key]
    less = next((v for v in found.sets if v.key == posterior.best.key - {candidate.key}), found.empty)
    effect = candidate.effect
    return NamedEffect(
        effect.id, effect.title, effect.equation, candidate.site.name,
        _opened_above(found.problem, fit, k, _effect_values(found.problem, fit, k)),
        float(min(1.0, sum(w.probability for w in posterior.sets if candidate.key in w.key))),
        posterior.best.visited.evidence - less.evidence,
        tuple(dict.fromkeys(a.candidate.effect.id for a in own)),
        tested[candidate.key].error_without if candidate.key in tested else np.nan,
    )  # fmt: skip


def _opened_above(problem: Problem, fit: Fit, k: int, values: Sequence[EffectValue]) -> tuple[EffectValue, ...]:
    """Extend the upper end of the k-th effect's interval to that of its prior if a larger value fits as well."""
    # If the load never reaches the other flank of a gap, the curvature has no information on its width: a clearly
    # larger value is fixed, and everything else refitted.
    candidate, place = problem.slices(fit.hypothesis)[k]
    name = candidate.effect.told_from_below
    if not name:
        return tuple(values)
    own = [p.name for p in candidate.parameters].index(name)
    at = place.start + own
    prior = candidate.parameters[own].prior
    z = fit.z.copy()
    z[at] = prior.standardised(WIDER * values[own].value)
    mean, precision = np.zeros(len(z)), np.eye(len(z))
    mean[at], precision[at, at] = z[at], HELD
    there = problem.fit(fit.hypothesis, fit.noise, z, fit.starts, FitPlan(tuning.LAST), prior=Prior(mean, precision))
    if there.cost + there.z[at] ** 2 - fit.cost >= tuning.CANNOT_TELL**2:
        return tuple(values)
    upper = max(values[own].upper, prior.value(INTERVAL))
    return tuple(replace(v, upper=upper) if v.name == name else v for v in values)


def _rival(problem: Problem, a: Alternative) -> Rival:
    fit = a.weighed.fit
    k = next(k for k, c in enumerate(fit.hypothesis.candidates) if c.key == a.candidate.key)
    effect = a.candidate.effect
    return Rival(
        effect.id, effect.title, a.candidate.site.name, a.instead_of.effect.id if a.instead_of else "none",
        a.weighed.distance, a.evidence, a.weighed.probability, _effect_values(problem, fit, k),
    )  # fmt: skip


def _nominal(problem: Problem, fit: Fit, stated: Mapping[str, tuple[float, bool]]) -> tuple[NominalValue, ...]:
    factors, _ = problem.split(fit.hypothesis, fit.z)
    moved: dict[str, list[float]] = {}
    for nuisance, z, std in zip(problem.nuisances, fit.z, fit.std, strict=False):
        for name in nuisance.names:
            centre = z if name in factors else 0.0  # a parameter with a named shift has it there
            factor = [nuisance.factor(float(centre + side * INTERVAL * std)) for side in (-1.0, 0.0, 1.0)]
            moved[name] = [problem.plant.parameters[name].reference * f for f in factor]
    for k, candidate in enumerate(fit.hypothesis.candidates):
        if candidate.site.kind == "parameter" and candidate.effect.scale:  # value of a parameter named as misjudged
            s = _effect_values(problem, fit, k)[0]
            for name in candidate.effect.factors(problem.plant, candidate.site, {s.name: s.value}):
                moved[name] = [problem.plant.parameters[name].reference * f for f in (s.lower, s.value, s.upper)]
    values = []
    for name, p in problem.plant.parameters.items():
        low, value, high = moved.get(name, [p.value] * 3)
        tolerance = stated[name][0]
        beyond = name in moved and abs(value - p.value) > tolerance * abs(p.value or 1.0)
        ends = min(low, high), max(low, high)
        values.append(NominalValue(name, p.value, value, p.unit, *ends, *stated[name], beyond))
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
    return tuple(f"{c.effect.id}@{c.site.name}" for c in fit.hypothesis.candidates)


def _probabilities(posterior: Posterior) -> tuple[SetProbability, ...]:
    best = posterior.best.evidence
    return tuple(
        SetProbability(
            _places(w.fit), tuple(c.effect.id for c in w.fit.hypothesis.candidates), w.probability,
            w.evidence - best, w.distance,
            f"{'dry ' if w.unnamed.dry else ''}force over {w.unnamed.over} at {w.unnamed.port}" if w.unnamed else "",
        )
        for w in posterior.sets
    )  # fmt: skip
