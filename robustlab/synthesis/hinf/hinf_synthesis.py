"""H-infinity synthesis: the controller of smallest verified closed-loop norm, or a slower one close to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import MILLION, NOT_REPEATABLE, Budget, dense, one_thread
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.linear_analysis.matrices import refuse_extremes
from robustlab.norms import HinfNorm, bilinear_to_discrete, hinf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.hinf.search import Candidate, portfolio, relax
from robustlab.synthesis.problem.assumptions import broken_assumptions, require_stabilisable
from robustlab.synthesis.problem.certify import EFFORT, certified
from robustlab.synthesis.problem.design import HinfSynthesis, design_budget, final_status, limiting_channels
from robustlab.synthesis.problem.gamma_bounds import pointwise_bound
from robustlab.synthesis.problem.partition import GeneralizedPlant, as_generalized_plant, require_performance
from robustlab.synthesis.problem.rebuilt_loop import moderate_states, named_controller, with_direct_term
from robustlab.synthesis.problem.scaling import equilibrated, paths_first

# Work of a design at effort 1; most plants need less than a tenth. More: longer searches on hard plants.
WORK = 60 * MILLION
# Ratio of gamma allowed for a certified norm where the best loop is so stiff that its norm loses digits.
LESS_STIFF = 1.001
# Candidates of finite norm that are considered, and how many of them are given to the checker, best first.
TRIES = 8
PROOFS = 3
# Candidates that are closed before the search counts as failed.
MOST_TRIES = 40
# Ratio of verified to searched gamma above which the next candidate is tried. Larger: quicker, a little worse.
LOSS = 1.0005
# Largest ratio of a certified gamma to a smaller one without certificate. Larger: worse gammas, more certificates.
CERTIFICATE_WORTH = 2.0


class Closed(NamedTuple):
    """A controller in the units and the time domain of the plant as given, D22 included, and its loop."""

    candidate: Candidate
    K: StateSpaceModel
    loop: StateSpaceModel
    norm: HinfNorm


class Verified(NamedTuple):
    """The result of the checker: the loop of P and K has at most the norm ``gamma``, proved if ``doubt`` is empty."""

    closed: Closed
    gamma: float
    doubt: str

    @property
    def pace(self) -> float:
        """Largest modulus of the controller's poles in rad/s."""
        return self.closed.candidate.pace


class Verifier:
    """Close and verify candidates for a plant without D22 on the plant as given, each at most once."""

    def __init__(self, plant: GeneralizedPlant, D22: Array, budget: Budget) -> None:
        self.plant, self.D22, self.budget = plant, D22, budget
        self.closed, self.proofs = cache(self._closed), dict[Candidate, Verified]()

    def smallest(self, candidates: list[Candidate]) -> Verified | None:
        """Return the proved candidate of smallest norm; if none is proved, that of smallest norm."""
        found, near = list[Closed](), 0
        # One at least, even without work left: a time limit returns what was found by then.
        for closed in filter(None, map(self.closed, sorted(candidates, key=lambda c: c.gamma)[:MOST_TRIES])):
            found.append(closed)
            near += closed.norm.upper <= LOSS * closed.candidate.gamma
            if near == PROOFS or len(found) == TRIES or self.budget.over:
                break
        tried: list[Verified] = []
        for closed in sorted(found, key=lambda c: c.norm.upper)[:PROOFS]:
            tried.append(self.verified(closed, 1 if tried else EFFORT))
            if not tried[-1].doubt:
                break
        best = min(tried, key=lambda v: (bool(v.doubt), v.gamma), default=None)
        least = min(tried, key=lambda v: v.gamma, default=None)
        return best if best is None or least is None or best.gamma <= CERTIFICATE_WORTH * least.gamma else least

    def least_stiff(self, candidates: list[Candidate], best: Verified, ratio: float) -> Verified:
        """Return the proved candidate of least stiffness within the ratio of the best gamma; else the best."""
        limit = ratio * best.gamma
        allowed = sorted((c for c in candidates if c.gamma <= limit), key=lambda c: (c.stiffness, c.gamma))
        stable = filter(None, (self.closed(c) for c in allowed[:TRIES] if not self.budget.over))
        proofs = map(self.verified, islice((c for c in stable if c.norm.upper <= limit), PROOFS))
        return next((v for v in proofs if v.gamma <= limit and not v.doubt), best)

    def _closed(self, candidate: Candidate) -> Closed | None:
        """Return the candidate with the norm of its loop; None if that is not stable or not well posed."""
        plant, dt = self.plant, self.plant.model.dt
        with suppress(InputError, NoTrustworthyNumber):
            model = with_direct_term(StateSpaceModel(*candidate.K), self.D22)
            # Large entries hide slow modes: in modal coordinates the same controller keeps more digits.
            model = moderate_states(bilinear_to_discrete(model, dt) if dt else model)
            K = named_controller(model, plant.measurements, plant.controls, dt)
            loop = plant.close(K)
            self.budget.spend(dense(loop.n_states, 10))
            norm = hinf_norm(loop)
            if np.isfinite(norm.upper):
                return Closed(candidate, K, loop, norm)
        return None

    def verified(self, closed: Closed, effort: int = 1) -> Verified:
        """Return the candidate with the result of the checker; at little ``effort`` only matrix proofs are tried."""
        if closed.candidate not in self.proofs:
            self.budget.spend(dense(closed.loop.n_states, 200))
            proof = certified(self.plant, closed.K, closed.norm, effort=effort)
            self.proofs[closed.candidate] = Verified(closed, *proof)
        return self.proofs[closed.candidate]


@error_context("synth hinf")
def hinf(
    P: Any,
    n_meas: int | None = None,
    n_con: int | None = None,
    *,
    gamma_rel: float = 1.05,
    time_limit: float | None = None,
    effort: float = 1.0,
    progress: Callable[[str], None] | None = None,
) -> HinfSynthesis:
    """Design a controller of a rational plant; see `robustlab.hinf`."""
    plant = as_generalized_plant(P, n_meas, n_con, "synth hinf")
    require_performance(plant, "synth hinf")
    budget = design_budget("synth hinf", WORK, effort, time_limit)
    return synthesize(plant, "hinf", gamma_rel, budget, progress=progress)


@one_thread()
@np.errstate(over="ignore", invalid="ignore")  # results are verified afterwards
def synthesize(
    plant: GeneralizedPlant,
    method: str,
    gamma_rel: float,
    budget: Budget,
    weights: Mapping[str, StateSpaceModel] | None = None,
    progress: Callable[[str], None] | None = None,
) -> HinfSynthesis:
    """Search a controller for `hinf` or `mixsyn`."""
    where = f"synth {method}"
    if not 1 <= gamma_rel <= 1e6:
        raise InputError(where, f"gamma_rel is {gamma_rel}", "a number from 1 to 1e6")
    refuse_extremes(plant.model, where)
    report = progress or (lambda _: None)
    continuous = plant.continuous()
    matrices = continuous.matrices()
    scalings = (paths_first(matrices), equilibrated(matrices))
    scaled, rate = scalings[0].apply(matrices), scalings[0].rate
    require_stabilisable(scaled, plant.model.state_names, where, rate)
    lower, assumptions = pointwise_bound(matrices, scalings, plant.model.dt), broken_assumptions(scaled, plant, rate)
    verifier = Verifier(plant, continuous.D22, budget)
    leader, other, disagree = portfolio(matrices, scalings, budget, lower.value, continuous.D22)
    best = verifier.smallest(leader.candidates + other.candidates)
    if best is None:
        ended = f": {NOT_REPEATABLE}" if budget.struck else " within the work budget" if budget.over else ""
        raise NoTrustworthyNumber(
            where,
            f"no controller could be verified{ended} ({len(leader.candidates) + len(other.candidates)} were found by "
            "two Riccati equations in two scalings)",
            hint="look at the plant's scaling, at poles and zeros on the imaginary axis, and at D12 and D21",
            more=assumptions,
        )
    report(f"two Riccati equations: gamma {best.gamma:.6g}")
    if best.doubt:  # the controller is so fast that digits are lost
        relax(leader, best.closed.candidate, (0.2 + 0.8 * LESS_STIFF) * best.gamma)
        best = verifier.least_stiff(leader.candidates + other.candidates, best, LESS_STIFF)
    chosen = best
    if gamma_rel > 1:
        relax(leader, best.closed.candidate, gamma_rel * best.gamma)
        chosen = verifier.least_stiff(leader.candidates + other.candidates, best, gamma_rel)
        report(f"softened: gamma {chosen.gamma:.6g}, fastest pole {chosen.pace:.4g} rad/s")
    if chosen.gamma < best.gamma:  # the relaxation found a smaller gamma
        best = chosen
    parts = [
        chosen.doubt or "loop of P and K is stable, its norm proved in ball arithmetic",
        "by two Riccati equations",
    ]
    if chosen is not best:
        allowed = f"allowed {gamma_rel - 1:.0%} above the smallest gamma {best.gamma:.6g}"
        parts.append(f"the softest controller within the {allowed}")
    status, reason = final_status(Status.INACCURATE if chosen.doubt else Status.CERTIFIED, parts, budget)
    _, K, loop, norm = chosen.closed
    return HinfSynthesis(
        K=K, gamma=chosen.gamma, closed_loop=loop, status=status, peak_frequency=norm.frequency, reason=reason,
        limit=limiting_channels(loop, norm.frequency), smallest_gamma=best.gamma, scalings_disagree=disagree,
        lower_bound=lower, assumptions=assumptions, norm=norm, plant=plant, method=method, weights=dict(weights or {}),
    )  # fmt: skip
