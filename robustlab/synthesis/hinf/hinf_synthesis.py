"""H-infinity synthesis: the controller of smallest verified closed-loop norm, or a sane one close to it.

Two Riccati equations on the plant in two scalings give the candidates of one search, which are verified and softened.
LMIs and a nonsmooth search behind them decided none of 55 COMPleib plants.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import islice, takewhile
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import NOT_REPEATABLE, Budget, dense, one_thread
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.norms import HinfNorm, bilinear_to_discrete, hinf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.hinf.constants import WORK
from robustlab.synthesis.hinf.search import Candidate, Portfolio, portfolio, soften
from robustlab.synthesis.problem.assumptions import broken_assumptions, require_stabilisable
from robustlab.synthesis.problem.certify import EFFORT, certified
from robustlab.synthesis.problem.design import HinfSynthesis, design_budget, limiting_channels, told
from robustlab.synthesis.problem.gamma_bounds import GammaBound, pointwise_bound
from robustlab.synthesis.problem.partition import (
    GeneralizedPlant,
    as_generalized_plant,
    require_performance,
)
from robustlab.synthesis.problem.rebuilt_loop import moderate_states, named_controller, with_direct_term
from robustlab.synthesis.problem.scaling import equilibrated, paths_first

# What a certified norm may cost where the best loop is so stiff that its norm loses digits. Larger: calmer loops.
CALMER = 1.001
# Candidates of finite norm that are looked at, and how many of them the checker is asked about, best first.
TRIES = 8
PROOFS = 3
# Candidates that are closed before the search counts as failed.
MOST_TRIES = 40
# Verified over searched gamma above which the next candidate is tried, too. Larger: quicker, a little worse.
LOSS = 1.0005
# How much more a certified norm may be than another one. Larger: worse gammas for the sake of certificates.
CERTIFICATE_WORTH = 2.0


@dataclass(frozen=True, eq=False)
class Rebuilt:
    """A controller in the units and the time domain of the plant as given, D22 included, with its loop and norm."""

    candidate: Candidate
    K: StateSpaceModel
    loop: StateSpaceModel
    norm: HinfNorm


@dataclass(frozen=True, eq=False)
class Verified(Rebuilt):
    """The same with what was proved of P and K: their loop has at most the norm ``gamma``, where ``doubt`` is empty."""

    gamma: float = np.inf
    doubt: str = ""

    @property
    def certified(self) -> bool:
        """Whether the norm is proved."""
        return not self.doubt


class Verifier:
    """Verifies candidates on one plant, each at most once.

    ``plant``: the plant as given.
    ``D22``: the direct term that was left out of the continuous plant that the candidates are for.
    ``budget``: verifications are counted there; once it is over no second candidate is verified.
    """

    def __init__(
        self,
        plant: GeneralizedPlant,
        D22: Array,
        budget: Budget,
    ) -> None:
        self.plant, self.D22, self.budget = plant, D22, budget
        self._closed: dict[int, Rebuilt | None] = {}
        self._known: dict[int, Verified] = {}

    def smallest(self, candidates: list[Candidate]) -> Verified | None:
        """The candidate of smallest norm that is proved; of none the smallest norm."""
        found: list[Rebuilt] = []
        near = 0
        for candidate in sorted(candidates, key=lambda c: c.gamma)[:MOST_TRIES]:
            closed = self.closed(candidate)
            if closed is None:
                continue
            found.append(closed)
            near += closed.norm.upper <= LOSS * candidate.gamma
            if near == PROOFS or len(found) == TRIES or self.budget.over:
                break
        tried: list[Verified] = []
        for closed in sorted(found, key=lambda c: c.norm.upper)[:PROOFS]:
            tried.append(self.verified(closed, 1 if tried else EFFORT))
            if tried[-1].certified:
                break
        best = min(tried, key=lambda v: (not v.certified, v.gamma), default=None)
        if not tried:
            return None
        best, least = min(tried, key=lambda v: (not v.certified, v.gamma)), min(tried, key=lambda v: v.gamma)
        # A certificate is worth a larger gamma, but not any.
        return best if best.gamma <= CERTIFICATE_WORTH * least.gamma else least

    def _first(self, candidates: Iterable[Candidate], limit: float, certified: bool) -> Verified | None:
        """The first of few candidates that verifies with a gamma of at most the limit, and with a certificate."""
        closed = (self.closed(candidate) for candidate in islice(candidates, TRIES))
        within = (found for found in closed if found is not None and found.norm.upper <= limit)
        for verified in map(self.verified, islice(within, PROOFS)):
            if verified.gamma <= limit and verified.certified >= certified:
                return verified
        return None

    def sanest(self, candidates: list[Candidate], best: Verified, gamma_rel: float) -> Verified:
        """Of those within the ratio of the best gamma, the one of least stiffness that verifies; else the best."""
        limit = gamma_rel * best.gamma
        allowed = sorted((c for c in candidates if c.gamma <= limit), key=lambda c: (c.stiffness, c.gamma))
        return self._first(takewhile(lambda _: not self.budget.over, allowed), limit, certified=True) or best

    def accurate(self, candidates: list[Candidate], best: Verified, ratio: float) -> Verified:
        """The sanest candidate within the ratio of the best gamma whose norm is certified; else the best."""
        limit = ratio * best.gamma
        allowed = sorted((c for c in candidates if c.gamma <= limit), key=lambda c: c.stiffness)
        return self._first(allowed, limit, certified=True) or best

    def within(self, candidates: list[Candidate], best: Verified, gamma_rel: float, bandwidth: float) -> Verified:
        """The smallest gamma of those within the ratio of the best whose poles all lie below the bandwidth."""
        limit = gamma_rel * best.gamma
        allowed = [c for c in candidates if c.gamma <= limit]
        slow = sorted((c for c in allowed if c.pace <= bandwidth), key=lambda c: c.gamma)
        found = self._first(slow, limit, best.certified)
        if found is not None:
            return found
        pace = min((c.pace for c in [*allowed, best.candidate]), default=np.inf)
        raise NoTrustworthyNumber(
            "bandwidth",
            f"no controller with all poles below {bandwidth:g} rad/s was found within {gamma_rel:g} times the smallest "
            f"gamma {best.gamma:.6g}; the slowest there has its fastest pole at {pace:.4g} rad/s",
            hint="a larger gamma_rel, a larger bandwidth, or weights that ask for less",
        )

    def closed(self, candidate: Candidate) -> Rebuilt | None:
        """The candidate with the norm of its loop, or None where that is not stable."""
        key = id(candidate)
        if key not in self._closed:
            plant = self.plant
            try:
                model = with_direct_term(StateSpaceModel(*candidate.K), self.D22)
                if plant.model.dt:
                    model = bilinear_to_discrete(model, plant.model.dt)
            except (InputError, NoTrustworthyNumber):  # entries overflow, or the loop is not well posed
                self._closed[key] = None
                return None
            # Large entries hide slow modes: in coordinates of its modes the same controller is the sounder one.
            self._closed[key] = self._rebuilt(candidate, moderate_states(model))
        return self._closed[key]

    def verified(self, closed: Rebuilt, effort: int = 1) -> Verified:
        """What the checker says of it; without much ``effort`` what a matrix proves."""
        key = id(closed.candidate)
        if key not in self._known:
            self.budget.spend(dense(closed.loop.n_states, 200))
            proof = certified(self.plant, closed.K, closed.norm, effort=effort)
            self._known[key] = Verified(**vars(closed), **proof._asdict())
        return self._known[key]

    def _rebuilt(self, candidate: Candidate, model: StateSpaceModel) -> Rebuilt | None:
        plant = self.plant
        try:
            named = named_controller(model, plant.measurements, plant.controls, model.dt)
            loop = plant.close(named)
            self.budget.spend(dense(loop.n_states, 10))
            norm = hinf_norm(loop)
        except (InputError, NoTrustworthyNumber):
            return None
        return Rebuilt(candidate, named, loop, norm) if np.isfinite(norm.upper) else None


@told_as("synth hinf")
def hinf(
    P: Any,
    n_meas: int | None = None,
    n_con: int | None = None,
    *,
    gamma_rel: float = 1.05,
    bandwidth: float | None = None,
    time_limit: float | None = None,
    effort: float = 1.0,
    progress: Callable[[str], None] | None = None,
) -> HinfSynthesis:
    """`robustlab.hinf` of a rational plant, which see."""
    plant = as_generalized_plant(P, n_meas, n_con, "synth hinf")
    require_performance(plant, "synth hinf")
    budget = design_budget("synth hinf", WORK, effort, time_limit)
    return synthesize(plant, "hinf", gamma_rel, budget, bandwidth=bandwidth, progress=progress)


def synthesize(
    plant: GeneralizedPlant,
    method: str,
    gamma_rel: float,
    budget: Budget,
    weights: Mapping[str, StateSpaceModel] | None = None,
    bandwidth: float | None = None,
    progress: Callable[[str], None] | None = None,
) -> HinfSynthesis:
    """The search behind `hinf` and `mixsyn`; see there."""
    where = f"synth {method}"
    if not 1 <= gamma_rel <= 1e6:
        raise InputError(where, f"gamma_rel is {gamma_rel}", "a number from 1 to 1e6")
    if bandwidth is not None and not bandwidth > 0:
        raise InputError(where, f"bandwidth is {bandwidth}", "a positive frequency in rad/s")
    with one_thread(), np.errstate(over="ignore", invalid="ignore"):  # what is found is verified on its own
        say = progress or (lambda _: None)
        return _Task(plant, method, gamma_rel, bandwidth, weights or {}, budget, say).result()


@dataclass(frozen=True, eq=False)
class _Task:
    """One design: what is asked for, and what it may cost."""

    plant: GeneralizedPlant
    method: str
    gamma_rel: float
    bandwidth: float | None
    weights: Mapping[str, StateSpaceModel]
    budget: Budget
    say: Callable[[str], None]

    def result(self) -> HinfSynthesis:
        plant, budget, calmer = self.plant, self.budget, CALMER
        continuous = plant.continuous()
        matrices = continuous.matrices()
        scalings = (paths_first(matrices), equilibrated(matrices))
        scaled, rate = scalings[0].apply(matrices), scalings[0].rate
        require_stabilisable(scaled, plant.model.state_names, f"synth {self.method}", rate)
        lower = pointwise_bound(matrices, scalings, plant.model.dt)
        verifier = Verifier(plant, continuous.D22, budget)
        found = portfolio(matrices, scalings, budget, lower.value, continuous.D22)
        best = verifier.smallest(found.candidates)
        if best is None:
            raise NoTrustworthyNumber(
                f"synth {self.method}",
                f"no controller could be verified{_ended(budget)} ({len(found.candidates)} were found by two Riccati "
                "equations in two scalings)",
                hint="look at the plant's scaling, at poles and zeros on the imaginary axis, and at D12 and D21",
                more=broken_assumptions(scaled, plant, rate),
            )
        self.say(f"two Riccati equations: gamma {best.gamma:.6g}")
        if not best.certified:  # so fast a controller that digits are lost: a little more gamma buys a calmer one
            soften(found.leader, best.candidate, (0.2 + 0.8 * calmer) * best.gamma)
            best = verifier.accurate(found.candidates, best, calmer)
        chosen = best
        if self.gamma_rel > 1:
            soften(found.leader, best.candidate, self.gamma_rel * best.gamma)
            chosen = verifier.sanest(found.candidates, best, self.gamma_rel)
            self.say(f"softened: gamma {chosen.gamma:.6g}, fastest pole {chosen.candidate.pace:.4g} rad/s")
        if self.bandwidth is not None and chosen.candidate.pace > self.bandwidth:
            chosen = verifier.within(found.candidates, best, self.gamma_rel, self.bandwidth)
        if chosen.gamma < best.gamma:  # on the way to a softer one a smaller one was found
            best = chosen
        return self._finished(chosen, best, found, lower, broken_assumptions(scaled, plant, rate))

    def _finished(
        self,
        chosen: Verified,
        best: Verified,
        found: Portfolio,
        lower: GammaBound,
        assumptions: tuple[str, ...],
    ) -> HinfSynthesis:
        status = Status.CERTIFIED if chosen.certified else Status.INACCURATE
        text = "loop of P and K is stable, its norm proved in ball arithmetic"
        parts = [text if status.trustworthy else chosen.doubt, "by two Riccati equations"]
        if chosen is not best:
            allowed = f"allowed {self.gamma_rel - 1:.0%} above the smallest gamma {best.gamma:.6g}"
            parts.append(f"the softest controller within the {allowed}")
        status, reason = told(status, parts, self.budget)
        return HinfSynthesis(
            K=chosen.K,
            gamma=chosen.gamma,
            closed_loop=chosen.loop,
            status=status,
            peak_frequency=chosen.norm.frequency,
            reason=reason,
            limit=limiting_channels(chosen.loop, chosen.norm.frequency),
            smallest_gamma=best.gamma,
            scalings_disagree=found.disagree,
            lower_bound=lower,
            estimated_optimum=min(found.estimated_optimum(), best.gamma),
            assumptions=assumptions,
            norm=chosen.norm,
            plant=self.plant,
            method=self.method,
            weights=dict(self.weights),
        )


def _ended(budget: Budget) -> str:
    """Words for an error about what ended the search, where that was the budget."""
    return f": {NOT_REPEATABLE}" if budget.struck else " within the work budget" if budget.over else ""
