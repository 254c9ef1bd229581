"""The greedy search: one effect after the other, each judged on data the fit did not see, then checked backwards."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from robustlab.arrays import Array
from robustlab.identification.hypotheses.effect_fit import (
    Candidate,
    Fit,
    FitPlan,
    Hypothesis,
    NoiseModel,
    Problem,
    refit_distance,
)
from robustlab.identification.hypotheses.prepared_record import PreparedRecord
from robustlab.identification.naming.ranking import Ranked, Ranking, bootstrap_wins, first_noise, rank, whitening
from robustlab.identification.tuning import TUNING, NamingTuning

__all__ = [
    "Alternative",
    "Naming",
    "Step",
    "alternatives",
    "held_out_fit",
    "in_doubt",
    "name_effects",
    "overtaken",
    "rms_percent",
    "settled",
    "spans",
    "white",
]


@dataclass(frozen=True, eq=False)
class Step:
    """One step of the search: its base, its ranking, the effect that was taken (None: stop) and why.

    ``before`` and ``held_out`` are the held-out errors without and with the effect in percent of the range; ``refused``
    is the most probable effect that did not help there.
    """

    base: Hypothesis
    ranking: Ranking
    taken: Ranked | None
    decision: str
    held_out: float
    before: float = np.nan
    refused: Ranked | None = None

    def entry(self, candidate: Candidate) -> Ranked | None:
        """The candidate's place in the ranking."""
        return next((r for r in self.ranking.ranked if r.candidate and r.candidate.key == candidate.key), None)


@dataclass(frozen=True, eq=False)
class Naming:
    """Result of the search.

    Attributes
    ----------
    fit
        The hypothesis, fitted under the noise model it is judged with.
    settled, bare
        Its parameters, and those of the bare nominal model, as they are reported, with the robust covariance.
    steps, noise
        The steps, and the noise model of the last.
    bare_cost, points
        V of the bare model under that noise model, and the number of residuals.
    """

    fit: Fit
    settled: Fit
    bare: Fit
    steps: tuple[Step, ...]
    noise: NoiseModel
    bare_cost: float
    points: int


@dataclass(frozen=True, eq=False)
class Alternative:
    """A hypothesis with another effect in the place of ``instead_of`` (None: of nothing), judged against the named one.

    Of an effect in the place of nothing the distance is that of the bare model to what the effect predicts.
    """

    candidate: Candidate
    instead_of: Candidate | None
    fit: Fit
    evidence: float
    wins: float
    distance: float
    tuning: NamingTuning = TUNING

    @property
    def cannot_be_told(self) -> bool:
        """True for a rival.

        Of two wrong gains the records tell nothing but what the tolerances do, which the evidence has weighed.
        """
        gains = self.instead_of is not None and _both_gains(self.candidate, self.instead_of)
        close = self.distance < self.tuning.cannot_tell and not gains
        return self.evidence > -self.tuning.evidence_tie or self.wins >= self.tuning.win_share or close


def name_effects(
    problem: Problem,
    held: Problem,
    candidates: Sequence[Candidate],
    allowed: Callable[[Problem, Fit, Candidate], bool],
    progress: Callable[[str], None] | None = None,
) -> Naming:
    """Add effects while they are convincing on the fitted data and help on the held-out data.

    Parameters
    ----------
    problem, held
        The windows to fit and the windows to judge on.
    allowed
        Says whether a fitted candidate may be named (a parameter within its tolerance is nothing missing).
    """
    noise = first_noise(problem)
    base, z = Hypothesis(()), np.zeros(len(problem.nuisances))
    steps: list[Step] = []
    bare = fit = None
    while True:
        open_ones = [c for c in candidates if _may_follow(c, base)]
        ranking = rank(problem, base, z, open_ones, noise, progress)
        fit = ranking.base.fit
        if bare is None:
            bare = fit
        step = _decided(problem, held, base, ranking, len({c.key for c in open_ones}), allowed)
        found = [step]
        if step.refused is not None and not base.candidates:
            found = _two_at_once(problem, held, candidates, step, allowed, progress) or found
        steps.extend(found)
        if progress:
            progress(" ".join(s.decision for s in found))
        step = found[-1]
        noise = step.ranking.noise
        if step.taken is None:
            break
        fit = step.taken.fit
        base, z = fit.hypothesis, fit.z
        if len(base.candidates) >= problem.tuning.most_effects:
            break
    checked = _checked_backwards(problem, fit, noise)
    reported = settled(problem, checked, noise)
    again = problem.fit(bare.hypothesis, noise, bare.z, bare.starts, FitPlan(8))
    points = sum(r.size for r in problem.whitened(problem.errors(bare.hypothesis, again.z, again.starts), noise))
    return Naming(
        checked,
        reported,
        settled(problem, bare, noise, 1 if checked.hypothesis.candidates else None),
        tuple(steps),
        noise,
        again.cost,
        points,
    )


def _two_at_once(
    problem: Problem,
    held: Problem,
    candidates: Sequence[Candidate],
    step: Step,
    allowed: Callable[[Problem, Fit, Candidate], bool],
    progress: Callable[[str], None] | None,
) -> list[Step] | None:
    """The refused effect and one more, where both together help: of two that are missing neither need help alone."""
    first = step.refused
    assert first is not None
    base = first.fit.hypothesis
    open_ones = [c for c in candidates if _may_follow(c, base)]
    ranking = rank(problem, base, first.fit.z, open_ones, step.ranking.noise, progress)
    second = _decided(problem, held, base, ranking, len({c.key for c in open_ones}), allowed)
    if second.taken is None or not second.held_out < (1.0 - problem.tuning.held_out_fall) * step.before:
        return None
    text = f"{first.id}: does not help on held-out data by itself, but together with the next"
    return [Step(step.base, step.ranking, first, text, np.nan), second]


def _may_follow(candidate: Candidate, base: Hypothesis) -> bool:
    """An effect already named, or the parent of a named refinement, or a second coupling, is not looked for again."""
    for there in base.candidates:
        same = candidate.site == there.site
        if candidate.effect.id == there.effect.id and same:
            return False
        if there.effect.refines == candidate.effect.id and same:
            return False
        if there.effect.refines and there.effect.refines == candidate.effect.refines and same:
            return False
        if candidate.effect.structural and there.effect.structural:
            return False
    return True


def _decided(
    problem: Problem,
    held: Problem,
    base: Hypothesis,
    ranking: Ranking,
    tried: int,
    allowed: Callable[[Problem, Fit, Candidate], bool],
) -> Step:
    names = {c.effect.id for c in base.candidates}
    threshold = problem.tuning.convincing + np.log(max(tried, 1))
    failed: list[Step] = []
    for entry in ranking.ranked:
        if entry.candidate is None or len(failed) == problem.tuning.most_failures:
            if failed:
                return failed[0]
            return Step(base, ranking, None, "stop: nothing is more probable than what is named", np.nan)
        if entry.evidence - ranking.base.evidence < (problem.tuning.wrong_parameter if _is_gain(entry) else threshold):
            if any(_is_gain(later) for later in ranking.ranked[ranking.ranked.index(entry) + 1 :]):
                continue
            if failed:
                return failed[0]
            return Step(base, ranking, None, "stop: no further effect is convincing", np.nan)
        if not allowed(problem, entry.fit, entry.candidate):
            continue
        chosen = entry
        parent_id = entry.candidate.effect.refines
        if parent_id and parent_id not in names:
            parent = _parent(entry, ranking)
            if parent is None or parent.evidence - ranking.base.evidence < threshold:
                continue
            chosen = parent  # the refinement has to earn its place in the next step
        judged = _judged_on_held_out(held, base, ranking, chosen)
        if judged.taken is not None:
            return judged
        failed.append(judged)
    return failed[0] if failed else Step(base, ranking, None, "stop: no effect is left", np.nan)


def _is_gain(entry: Ranked) -> bool:
    return entry.candidate is not None and entry.candidate.effect.gain_like


def _parent(entry: Ranked, ranking: Ranking) -> Ranked | None:
    assert entry.candidate is not None
    for other in ranking.ranked:
        if (
            other.candidate is not None
            and other.candidate.effect.id == entry.candidate.effect.refines
            and other.candidate.site == entry.candidate.site
        ):
            return other
    return None


def _judged_on_held_out(held: Problem, base: Hypothesis, ranking: Ranking, chosen: Ranked) -> Step:
    assert chosen.candidate is not None
    before = held_out_fit(held, ranking.base.fit, ranking.noise)
    after = held_out_fit(held, chosen.fit, ranking.noise)
    gain = 0.5 * (before.cost - after.cost) - 0.5 * float(
        ranking.base.fit.z @ ranking.base.fit.z - chosen.fit.z @ chosen.fit.z
    )
    fall_before, fall_after = (
        rms_percent(held, held_out_fit(held, fit, white(ranking.noise))) for fit in (ranking.base.fit, chosen.fit)
    )
    # The refit may have stretched a tolerance to fit a wrong parameter; naming it then explains, but gains nothing.
    tuning = held.tuning
    rough = len(ranking.noise.ar) < tuning.ar_order
    fall = tuning.rough_fall if rough else tuning.held_out_fall
    helps = gain > tuning.held_out_gain and fall_after < (1.0 - fall) * fall_before
    harmless = gain > -tuning.held_out_loss and fall_after < (1.0 + tuning.held_out_rise) * fall_before
    if not helps and not (_is_gain(chosen) and _relieves(chosen.fit, ranking.base.fit) and harmless and not rough):
        text = (
            f"stop: {chosen.id} does not help on held-out data "
            f"({fall_before:.4g} % -> {fall_after:.4g} % of the range, log-likelihood {gain:+.1f})"
        )
        return Step(base, ranking, None, text, fall_after, fall_before, chosen)
    text = f"{chosen.id}: held-out error {fall_before:.4g} % -> {fall_after:.4g} % of the range"
    return Step(base, ranking, chosen, text, fall_after, fall_before)


def _relieves(gain: Fit, base: Fit) -> bool:
    """Whether a wrong gain needs less stretched parameters than the base: only then it may stand in for a stretch."""
    return float(gain.z @ gain.z) < float(base.z @ base.z)


def held_out_fit(held: Problem, fit: Fit, noise: NoiseModel) -> Fit:
    """The hypothesis on other windows: parameters as fitted, only the window starts are found anew."""
    return held.fit(fit.hypothesis, noise, fit.z, plan=FitPlan(8, 0.5, fixed=True))


def white(noise: NoiseModel) -> NoiseModel:
    """White noise of the same innovations: with it the window starts are those of least squares."""
    return NoiseModel(noise.std, noise.ar[:0])


def rms_percent(problem: Problem, fit: Fit) -> float:
    """Windowed RMS error over all outputs in percent of their measured ranges."""
    errors = problem.errors(fit.hypothesis, fit.z, fit.starts)
    ranges = spans(problem.records)
    squares = np.concatenate([(e / np.where(ranges > 0, ranges, 1.0)).reshape(-1, len(ranges)) ** 2 for e in errors])
    return float(100.0 * np.sqrt(np.nanmean(squares)))


def spans(records: Sequence[PreparedRecord]) -> Array:
    """Largest measured range of each output, (n_measured,); 0 of one that no record has."""
    known = [[y[np.isfinite(y)] for y in r.y.T] for r in records]
    return np.max([[np.ptp(y) if y.size else 0.0 for y in row] for row in known], axis=0)


def settled(problem: Problem, fit: Fit, noise: NoiseModel, order: int | None = None) -> Fit:
    """The parameters to report: the hypothesis' own errors made white, covariance from the scatter of the windows.

    Full whitening is right where the errors are noise. Where something is still missing it is not: then the first
    order, from a start by least squares, trusts differences between neighbouring points less, in which what is not
    modelled (a small ripple) shows first.
    """
    found, settling = fit, problem.tuning.settling
    if order == 1:
        errors = problem.errors(fit.hypothesis, fit.z, fit.starts)
        flat = np.concatenate([e.reshape(-1, e.shape[2]) for e in errors])
        size = np.maximum(np.sqrt(np.nanmean(flat**2, axis=0)), noise.std)
        plain = NoiseModel(size, noise.ar[:0])
        found = problem.fit(fit.hypothesis, plain, fit.z, fit.starts, FitPlan(settling, 1e-3))
    for _ in range(2):
        own = whitening(problem, found, order)
        found = problem.fit(fit.hypothesis, own, found.z, found.starts, FitPlan(settling, 1e-3, robust=True))
    return found


def _without(problem: Problem, fit: Fit, k: int) -> tuple[Hypothesis, Array]:
    """The hypothesis without its k-th effect, and its standardised parameters."""
    z = list(fit.z[: len(problem.nuisances)])
    at, kept = len(problem.nuisances), []
    for j, candidate in enumerate(fit.hypothesis.candidates):
        own = fit.z[at : at + len(candidate.parameters)]
        at += len(candidate.parameters)
        if j != k:
            kept.append(candidate)
            z.extend(own)
    return Hypothesis(tuple(kept)), np.array(z)


def _checked_backwards(problem: Problem, fit: Fit, noise: NoiseModel) -> Fit:
    """Drop effects that later ones have made needless."""
    fit = problem.fit(fit.hypothesis, noise, fit.z, fit.starts, FitPlan(4))
    while len(fit.hypothesis.candidates) > 1:
        less = []
        for k in range(len(fit.hypothesis.candidates)):
            hypothesis, z = _without(problem, fit, k)
            less.append(problem.fit(hypothesis, noise, z, fit.starts, FitPlan(8)))
        best = max(less, key=lambda f: f.evidence)
        if fit.evidence - best.evidence > problem.tuning.convincing:
            return fit
        fit = best
    return fit


def alternatives(problem: Problem, naming: Naming) -> list[Alternative]:
    """For each named effect, the effects that could stand in its place, with their refit distance for these records.

    The distance is that of EFFECTS.md section 4: the named model predicts the records without noise, the alternative is
    refitted to that prediction under the priors, and d is the root of what remains in noise sigmas.
    """
    found = []
    taken = [step for step in naming.steps if step.taken is not None]
    least = problem.tuning.wrong_parameter
    for k, named in enumerate(naming.fit.hypothesis.candidates):
        step = next((s for s in taken if s.entry(named) is not None), None)
        if step is None:
            continue
        last = step is taken[-1]
        rest, z = _without(problem, naming.fit, k)
        entries = [
            (entry.candidate, entry.fit)
            for entry in step.ranking.ranked
            if entry.candidate is not None
            and entry.candidate.key != named.key
            and (entry.evidence - step.ranking.base.evidence > least or _both_gains(entry.candidate, named))
            and (not last or entry.evidence > -problem.tuning.far_behind)
            and _may_follow(entry.candidate, rest)
            and not (entry.candidate.effect.refines == named.effect.id and entry.candidate.site == named.site)
        ]
        found.extend(_judged(problem, naming, named, rest, z, entries[: problem.tuning.most_rivals]))
    return found


def in_doubt(problem: Problem, naming: Naming, allowed: Callable[[Problem, Fit, Candidate], bool]) -> list[Alternative]:
    """Where nothing was named: wrong gains that would have been named, but for a tie in evidence.

    Tolerances of other parameters explain the records as well; but what they hide may be beyond its own tolerance. A
    gain that has no tolerance of its own contradicts nothing: it is in doubt only where it is more probable than none.
    """
    ranking, tuning = naming.steps[-1].ranking, problem.tuning
    if naming.fit.hypothesis.candidates or ranking.base.fit.hypothesis.candidates:
        return []
    found = []
    for entry in ranking.ranked:
        more = entry.evidence - ranking.base.evidence
        if entry.candidate is None or not _is_gain(entry) or not _relieves(entry.fit, ranking.base.fit):
            continue
        least = tuning.wrong_parameter - tuning.evidence_tie if entry.candidate.site.kind == "parameter" else 0.0
        if more > least and allowed(problem, entry.fit, entry.candidate):
            distance = refit_distance(problem, entry.fit, ranking.base.fit)
            found.append(Alternative(entry.candidate, None, entry.fit, more, entry.wins, distance, problem.tuning))
    return found


def _both_gains(first: Candidate, second: Candidate) -> bool:
    return first.effect.gain_like and second.effect.gain_like


def overtaken(
    problem: Problem, naming: Naming, allowed: Callable[[Problem, Fit, Candidate], bool]
) -> tuple[Naming, list[Alternative]]:
    """The naming with an effect exchanged where, refitted, another turns out more probable; and the alternatives."""
    found = alternatives(problem, naming)
    for _ in range(len(naming.fit.hypothesis.candidates)):
        stronger = [a for a in found if allowed(problem, a.fit, a.candidate)]
        best = max(stronger, key=lambda a: a.evidence, default=None)
        if best is None or best.evidence <= problem.tuning.overtaking:
            break
        naming = replace(naming, fit=best.fit, settled=settled(problem, best.fit, naming.noise))
        found = alternatives(problem, naming)
    return naming, found


def _judged(
    problem: Problem,
    naming: Naming,
    named: Candidate,
    rest: Hypothesis,
    z: Array,
    entries: Sequence[tuple[Candidate, Fit]],
) -> list[Alternative]:
    rivals = [candidate for candidate, _ in entries]
    fits = []
    for candidate, fit in entries:
        hypothesis = Hypothesis((*rest.candidates, candidate))
        points = [(np.concatenate([z, fit.z[len(fit.z) - len(candidate.parameters) :]]), naming.fit.starts)]
        if fit.hypothesis.key == hypothesis.key:
            points.append((fit.z, fit.starts))
        point = min(points, key=lambda p: problem.cost(hypothesis, naming.noise, *p))
        fits.append(problem.fit(hypothesis, naming.noise, *point, FitPlan(problem.tuning.settling)))
    wins = bootstrap_wins([naming.fit, *fits], problem.tuning)
    found = []
    for candidate, fit, share in zip(rivals, fits, wins[1:], strict=True):
        behind = fit.evidence - naming.fit.evidence
        if behind < -problem.tuning.far_behind:
            continue
        distance = refit_distance(problem, naming.fit, fit)
        found.append(Alternative(candidate, named, fit, behind, share, distance, problem.tuning))
    return found
