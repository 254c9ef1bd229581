"""Candidates of a search, rebuilt on the plant as it was given, and their norm proved there."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice, takewhile

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import Budget, dense
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.norms import HinfNorm, bilinear_to_discrete, hinf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.hinf.search import Candidate
from robustlab.synthesis.hinf.tuning import TUNING, HinfTuning
from robustlab.synthesis.problem.independent_check import SecondVoice, hinf_voice
from robustlab.synthesis.problem.partition import GeneralizedPlant
from robustlab.synthesis.problem.rebuilt_loop import moderate_states, named_controller, with_direct_term


@dataclass(frozen=True, eq=False)
class Verified:
    """A controller in the units and the time domain of the plant as given, D22 included, with its loop and norm.

    ``voice`` is what P and K give when they are evaluated separately; it speaks of stability, too.
    """

    candidate: Candidate
    K: StateSpaceModel
    loop: StateSpaceModel
    norm: HinfNorm
    voice: SecondVoice
    tuning: HinfTuning = TUNING

    @property
    def gamma(self) -> float:
        """Proved upper bound of the closed loop's norm, or the larger number of the second voice."""
        return self.voice.larger(self.norm.upper)

    @property
    def certified(self) -> bool:
        """Whether no digits were lost, in the norm and in the proof of stability, and the second voice agrees."""
        return not self.doubt

    @property
    def doubt(self) -> str:
        """Why it is not certified; empty where it is."""
        if self.norm.status is not Status.CERTIFIED:
            return self.norm.reason
        return self.voice.doubt(self.norm.lower, self.norm.upper)

    @property
    def credible(self) -> bool:
        """Whether both voices give about the same norm: certified or not, it is not far from the truth."""
        return self.drift <= self.tuning.credible and not self.voice.disagreement(0.0, np.inf)

    @property
    def drift(self) -> float:
        """How far the rebuilt loop's norm lies from what the second voice finds, relative."""
        return abs(self.voice.value / self.norm.lower - 1) if self.norm.lower > 0 else self.voice.value


class Verifier:
    """Verifies candidates on one plant, each at most once.

    Parameters
    ----------
    plant
        The plant as given.
    D22
        The direct term that was left out of the continuous plant that the candidates are for.
    budget
        Verifications are counted there; once it is over no second candidate is verified.
    """

    def __init__(self, plant: GeneralizedPlant, D22: Array, budget: Budget, tuning: HinfTuning = TUNING) -> None:
        self.plant, self.D22, self.budget, self.tuning = plant, D22, budget, tuning
        self._known: dict[int, Verified | None] = {}

    def __call__(self, candidate: Candidate) -> Verified | None:
        """The candidate with its proved norm, or None where its loop is not stable."""
        key = id(candidate)
        if key not in self._known:
            self._known[key] = self._verified(candidate)
        return self._known[key]

    def smallest(self, candidates: list[Candidate]) -> Verified | None:
        """The candidate of smallest verified norm; one without lost digits goes before others not much better."""
        found: list[Verified] = []
        tuning = self.tuning
        for tried, candidate in enumerate(sorted(candidates, key=lambda c: c.gamma)[: tuning.most_tries]):
            if tried >= tuning.tries and any(verified.credible for verified in found):
                break
            verified = self(candidate)
            if verified is None:
                continue
            found.append(verified)
            if (verified.certified and verified.gamma <= tuning.loss * candidate.gamma) or self.budget.over:
                break
        best = min(found, key=lambda v: (not v.certified, not v.credible, v.gamma), default=None)
        # A certificate is worth a larger gamma, but not any.
        near = min((v for v in found if v.credible), key=lambda v: v.gamma, default=best)
        return (
            near
            if best is not None and near is not None and best.gamma > tuning.certificate_worth * near.gamma
            else best
        )

    def _first(self, candidates: Iterable[Candidate], limit: float, certified: bool) -> Verified | None:
        """The first of few candidates that verifies with a gamma of at most the limit, and with a certificate."""
        for candidate in islice(candidates, self.tuning.tries):
            verified = self(candidate)
            if verified is not None and verified.gamma <= limit and verified.certified >= certified:
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
        """The smallest gamma of those within the ratio of the best whose poles all lie below the bandwidth.

        Raises
        ------
        NoTrustworthyNumber
            There is none; the message says how slow the slowest is.
        """
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

    def _verified(self, candidate: Candidate) -> Verified | None:
        plant = self.plant
        try:
            model = with_direct_term(StateSpaceModel(*candidate.K), self.D22)
            if plant.model.dt:
                model = bilinear_to_discrete(model, plant.model.dt)
        except (InputError, NoTrustworthyNumber):  # entries overflow, or the loop is not well posed
            return None
        # Large entries hide slow modes: in coordinates of its modes the same controller is the sounder one.
        states, other = moderate_states(model)
        found = self._judged(candidate, states)
        if (found is not None and found.certified and found.drift <= self.tuning.drift) or other is None:
            return found
        again = self._judged(candidate, other)
        both = [verified for verified in (found, again) if verified is not None]
        return min(both, key=lambda v: (not v.certified, v.drift), default=None)

    def _judged(self, candidate: Candidate, model: StateSpaceModel) -> Verified | None:
        plant = self.plant
        try:
            named = named_controller(model, plant.measurements, plant.controls, model.dt)
            loop = plant.close(named)
            self.budget.spend(dense(loop.n_states, 10))
            norm = hinf_norm(loop)
        except (InputError, NoTrustworthyNumber):
            return None
        if not np.isfinite(norm.upper):
            return None
        return Verified(candidate, named, loop, norm, hinf_voice(plant, named, loop, [norm.frequency]), self.tuning)
