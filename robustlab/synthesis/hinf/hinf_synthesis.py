"""H-infinity synthesis: the controller of smallest verified closed-loop norm, or a slower one close to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import islice
from typing import NamedTuple

import numpy as np

from robustlab.arrays import AnyArray, Array
from robustlab.budget import NOT_REPEATABLE, Budget, dense, one_thread
from robustlab.checks import number
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.linear_analysis.matrices import refuse_extremes
from robustlab.norms import HinfNorm, bilinear_to_discrete, hinf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.hinf.two_riccati import TwoRiccatiProblem
from robustlab.synthesis.problem.certify import (
    EFFORT,
    certified,
    moderate_states,
    named_controller,
    well_posed_neighbours,
    with_direct_term,
)
from robustlab.synthesis.problem.design import HinfSynthesis, final_status, limiting_channels
from robustlab.synthesis.problem.gamma_lower_bound import broken_assumptions, pointwise_bound, require_stabilisable
from robustlab.synthesis.problem.generalized_plant import (
    GeneralizedPlant,
    PlantMatrices,
    Realisation,
    Scaling,
    equilibrated,
    paths_first,
)
from robustlab.synthesis.structures.loops import ModalLoop, largest_gain

# Ratio of gamma allowed for a certified norm where the best loop is so stiff that its norm loses digits.
LESS_STIFF = 1.001
# Candidates of finite norm that are considered, and how many of them are given to the checker, best first.
TRIES = 8
PROOFS = 3
MOST_TRIES = 40  # candidates that are closed before the search counts as failed
# Ratio of verified to searched gamma above which the next candidate is tried. Larger: quicker, a little worse.
LOSS = 1.0005
# Largest ratio of a certified gamma to a smaller one without certificate. Larger: worse gammas, more certificates.
CERTIFICATE_WORTH = 2.0
# Sizes of added penalties and noises, scaled. Longer: singular plants get closer to their infimum.
LADDER = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
# A central controller at gamma itself is ill-conditioned: gamma is increased until the gain of the loop agrees.
COARSE_BACKOFFS = (1e-2, 0.1)
FINE_BACKOFFS = (1e-4, 1e-3, 1e-2, 3e-2, 0.1)
# Shares of the loop's gain that the self-scaled regularisation may cost; the optimum rises by their squares.
SHARES = (0.2, 0.1, 0.05, 0.02, 0.01)
SELF_SCALED_STEPS = 14  # most trials of that kind; more: a little lower on plants that keep falling
IMPROVEMENT = 5e-4  # relative gain of a trial that counts as one. Smaller: more trials for less
PROVED = 3e-4  # a gamma this near (relative) to a proved bound ends the search. Larger: sooner
# Singular values of D12 or D21, scaled, above which that side is not regularised. Smaller: digits are lost.
REGULAR = 1e-6
NEGLIGIBLE = 1e-7  # scaled gains below it are zero for every purpose
# Rounds of bisection in `relax`; steps in the first and in the later ones. More: slower poles.
RELAX_ROUNDS = 3
RELAX_STEPS = 5
RELAX_LATER_STEPS = 3
RELAX_SHARE = 0.05  # share of the loop's gain from which the second relaxation starts


class Regularisation(NamedTuple):
    """Weights of the added channels in scaled units: on u (per control), noise on y (per measurement), on x, into x."""

    u: AnyArray | float
    y: AnyArray | float
    x_out: float
    x_in: float


@dataclass(frozen=True, eq=False)
class Candidate:
    """A controller whose loop is stable in floating point."""

    K: Realisation  # for the continuous plant without D22, in its units
    gamma: float  # gain of its loop, attained at a frequency
    pace: float  # largest modulus of its poles in rad/s
    decay: float  # decay rate of the loop's slowest mode in 1/s

    @property
    def stiffness(self) -> float:
        return self.pace / max(self.decay, 1e-300)


class Search:
    """Trials on one scaled continuous plant without D22; every stabilising controller is stored."""

    def __init__(self, plant: PlantMatrices, scaling: Scaling, budget: Budget, floor: float, D22: Array) -> None:
        # What is found must be able to take D22 back in.
        self.D22 = scaling.y[:, None] * D22 * scaling.u
        self.scaling, self.plant = scaling, scaling.apply(plant)
        self.budget, self.floor = budget, floor  # floor: a proved lower bound of gamma in the plant's units
        self.candidates: list[Candidate] = []
        # Smallest gamma that passes the plant's own Riccati test; 0 if the plant needs regularisation.
        self.regular_gamma = 0.0
        # The last loop given to `relative`, and its channel gains.
        self._gains: tuple[Candidate, Regularisation | None] | None = None

    @property
    def best(self) -> Candidate | None:
        return smallest(self.candidates)

    @property
    def settled(self) -> bool:
        """Return whether the best controller is at the plant's own Riccati optimum, or at a proved lower bound."""
        best = self.best
        return best is not None and (best.gamma <= 1.0005 * self.regular_gamma or self.proved(best))

    def proved(self, candidate: Candidate | None) -> bool:
        """Return whether no controller can be better by more than PROVED."""
        return candidate is not None and candidate.gamma <= (1 + PROVED) * self.floor

    def ladder(self) -> None:
        """Try regularisations of fixed size, from large to small, until gamma falls no more."""
        sizes = self.plant.direct_sizes
        if min(sizes) > REGULAR:
            self.regular_gamma = self._trial(None, 1.0, 1e-4, FINE_BACKOFFS)[0] or 0.0
            if self.settled:
                return
        worse, best, start = 0, np.inf, 1.0
        for eps in LADDER:
            if self.budget.over:
                return
            u, y = (0.0 if size > max(REGULAR, eps) else eps for size in sizes)
            gamma, found = self._trial(Regularisation(u, y, eps / 10, eps / 10), start, 2e-2, COARSE_BACKOFFS)
            if gamma is not None:
                start = gamma * self.scaling.gain
            if found is None:
                continue
            worse = worse + 1 if found.gamma > 0.9 * best else 0
            best = min(best, found.gamma)
            if worse == 2:
                return

    def refine(self, best: Candidate | None, shares: Sequence[float] = SHARES) -> None:
        """Try ever smaller regularisations scaled by the best loop so far, until gamma falls no more."""
        k = 0
        for _ in range(SELF_SCALED_STEPS):
            if best is None or k == len(shares) or self.budget.over or self.proved(best):
                return
            if best.gamma * self.scaling.gain <= NEGLIGIBLE:
                return
            regularisation = self.relative(best, shares[k], 0.3)
            if regularisation is None:
                return
            rtol = float(np.clip(0.2 * shares[k] ** 2, 5e-5, 5e-3))
            _, found = self._trial(regularisation, best.gamma * self.scaling.gain, rtol, FINE_BACKOFFS)
            if found is None or found.gamma >= best.gamma * (1 - max(IMPROVEMENT, rtol)):
                k += 1
            if found is not None and found.gamma < best.gamma:
                best = found

    def relative(self, loop: Candidate, share: float, state_share: float, cap: float = 1.0) -> Regularisation | None:
        """Return added channels that each carry about ``share`` of the gain of this loop."""
        if self._gains is None or self._gains[0] is not loop:
            self.budget.spend(dense(len(self.plant.A) + len(loop.K.A), 2))
            K = self.scaling.controller_from_plant(loop.K)
            self._gains = (loop, channel_gains(trial_loop(self.plant.with_channels(1, 1, 1, 1), K), self.plant.sizes))
        gains, gamma = self._gains[1], loop.gamma * self.scaling.gain
        if gains is None or gamma <= 0:  # a loop without gain (T with K = 0) gives no scale
            return None
        u, y, x_out, x_in = (gamma / np.maximum(g, gamma * share / cap) for g in gains)
        of_states = state_share * share
        u, y = share * u / np.sqrt(len(u)), share * y / np.sqrt(len(y))
        return Regularisation(u, y, float(of_states * x_out), float(of_states * x_in))

    def found_within(self, weights: Regularisation, gamma: float) -> Candidate | None:
        """Return the central controller of this regularisation at gamma if its loop stays below gamma."""
        problem = self._problem(weights)
        return problem and self._central(problem, gamma * self.scaling.gain * (1 - 1e-5), gamma)

    def _trial(
        self, weights: Regularisation | None, start: float, rtol: float, backoffs: tuple[float, ...]
    ) -> tuple[float | None, Candidate | None]:
        """Return the smallest gamma of the regularised problem in the plant's units, and the best controller for it."""
        problem = self._problem(weights)
        gamma = problem and problem.smallest_gamma(start, rtol)
        if problem is None or gamma is None:
            return None, None
        found: list[Candidate] = []
        for backoff in backoffs:
            candidate = self._central(problem, gamma * (1 + backoff))
            if candidate is None:
                continue
            found.append(candidate)
            if candidate.gamma <= gamma / self.scaling.gain * (1 + backoff) * 1.001:
                break
        return gamma / self.scaling.gain, smallest(found)

    def _problem(self, weights: Regularisation | None) -> TwoRiccatiProblem | None:
        """Return the problem with these added channels; None if D12 or D21 is rank deficient."""
        plant = self.plant if weights is None else self.plant.with_channels(*weights)
        with suppress(NoTrustworthyNumber):
            return TwoRiccatiProblem(plant, self.budget)
        return None

    def _central(self, problem: TwoRiccatiProblem, gamma: float, limit: float = np.inf) -> Candidate | None:
        """Add the central controller at gamma (scaled) if its loop's gain is at most limit (plant's units)."""
        pair = problem.solve(gamma)
        if pair is None:
            return None
        try:
            K = problem.central_controller(pair)
        except NoTrustworthyNumber:
            return None
        # If K cannot include D22, the best of its neighbours that can is taken.
        near = well_posed_neighbours(K, self.D22) if self.D22.any() else [K]
        return smallest([candidate for each in near if (candidate := self._entered(each, limit)) is not None])

    def _entered(self, K: Realisation, limit: float) -> Candidate | None:
        scale, loop = self.scaling, trial_loop(self.plant, K)
        self.budget.spend(dense(len(loop.A), 3))  # its poles, responses on a grid, a few Hamiltonians of twice its size
        back = scale.controller_to_plant(K)
        if not all(np.isfinite(part).all() for part in (*loop, *back)):
            return None
        gain, _ = largest_gain(loop)
        if not np.isfinite(gain) or gain > limit * scale.gain:
            return None
        poles, modes = (np.linalg.eigvals(a) if a.size else np.zeros(0) for a in (K.A, loop.A))
        pace = scale.rate * float(np.abs(poles).max(initial=0.0))
        decay = -scale.rate * float(modes.real.max(initial=-1e300))
        candidate = Candidate(back, gain / scale.gain, pace, decay)
        self.candidates.append(candidate)
        return candidate


def smallest(candidates: list[Candidate]) -> Candidate | None:
    return min(candidates, key=lambda c: c.gamma, default=None)


def portfolio(
    matrices: PlantMatrices, scalings: tuple[Scaling, Scaling], budget: Budget, floor: float, D22: Array
) -> list[Search]:
    """Search both scalings coarsely, refine the better one, and try its best loop in the other; the better first."""

    def gamma(search: Search) -> float:
        return np.inf if search.best is None else search.best.gamma

    searches = [Search(matrices, scaling, budget, floor, D22) for scaling in scalings]
    for search in searches:
        search.ladder()
        if search.proved(search.best):
            break
    leader, other = sorted(searches, key=gamma)
    if not leader.settled:
        leader.refine(leader.best)
    if not leader.proved(leader.best):
        other.refine(leader.best, SHARES[3:4])
    return sorted((leader, other), key=gamma)


def relax(search: Search, start: Candidate, gamma: float) -> None:
    """Add candidates up to this gamma with slower controller poles and without needlessly slow modes of the loop."""
    _slowest_poles(search, start, gamma, 0.0)
    # Repeat with half of the slack spent on penalties of states: a mode that w does not excite (an integrator of the
    # plant, behind a reference) otherwise stays in the loop as slow as it is.
    half, base = 0.5 * (start.gamma + gamma), search.relative(start, RELAX_SHARE, 0.0)
    low, high, size = 1e-4, 1e2, 0.0
    for _ in range(RELAX_STEPS):
        if base is None or search.budget.over:
            return
        middle = float(np.sqrt(low * high))
        if search.found_within(base._replace(x_out=middle, x_in=middle), half) is not None:
            low = size = middle
        else:
            high = middle
    if size > 0:
        _slowest_poles(search, start, gamma, size)


def _slowest_poles(search: Search, start: Candidate, gamma: float, x: float) -> None:
    """Find the largest relative weights by bisection, repeated because their scale depends on the last loop found."""
    low, high, steps = 1e-2, 10.0, RELAX_STEPS
    for _ in range(RELAX_ROUNDS):
        slowest: Candidate | None = None
        for _ in range(steps):
            if search.budget.over:
                return
            middle = float(np.sqrt(low * high))
            weights = search.relative(start, middle, 0.0 if x else 0.1, 3.0)
            if weights is not None and x:
                weights = weights._replace(x_out=x, x_in=x)
            found = None if weights is None else search.found_within(weights, gamma)
            if found is not None:
                low, slowest = middle, found
            else:
                high = middle
        if slowest is None or slowest.pace > 0.7 * start.pace:
            return
        start, low, high, steps = slowest, low / 2, 3 * low, RELAX_LATER_STEPS


def channel_gains(loop: Realisation, sizes: tuple[int, int, int, int, int]) -> Regularisation | None:
    """Return peak gains on a grid: w to each u, noise on y to z, w to x, disturbance of x to z; None if unstable."""
    if not all(np.isfinite(part).all() for part in loop):
        return None
    _, n_w, n_u, n_z, n_y = sizes
    response = loop.D[None]
    if len(loop.A):
        modal = ModalLoop(loop)
        if not modal.stable:
            return None
        response = modal.response(modal.frequencies())
    if not np.isfinite(response).all():
        return None
    u = np.linalg.norm(response[:, n_z : n_z + n_u, :n_w], axis=2).max(axis=0)
    y = np.linalg.norm(response[:, :n_z, n_w : n_w + n_y], axis=1).max(axis=0)
    of_x = response[:, n_z + n_u :, :n_w], response[:, :n_z, n_w + n_y :]
    x_out, x_in = (float(np.linalg.norm(x, 2, axis=(1, 2)).max(initial=0.0)) if x.size else 0.0 for x in of_x)
    return Regularisation(u, y, x_out, x_in)


def trial_loop(p: PlantMatrices, K: Realisation) -> Realisation:
    """Return the loop from w to z for ``u = K y`` on a plant without D22."""
    by_y, by_w = p.B2 @ K.D, p.D12 @ K.D
    return Realisation(
        np.block([[p.A + by_y @ p.C2, p.B2 @ K.C], [K.B @ p.C2, K.A]]),
        np.vstack([p.B1 + by_y @ p.D21, K.B @ p.D21]),
        np.hstack([p.C1 + by_w @ p.C2, p.D12 @ K.C]),
        p.D11 + by_w @ p.D21,
    )


class Closed(NamedTuple):
    """A controller in the units and the time domain of the plant as given, D22 included, and its loop."""

    candidate: Candidate
    K: StateSpaceModel
    loop: StateSpaceModel
    norm: HinfNorm
    gamma: float = np.inf
    doubt: str = "not checked"


class Verifier:
    """Close and verify candidates for a plant without D22 on the plant as given, each at most once."""

    def __init__(self, plant: GeneralizedPlant, D22: Array, budget: Budget) -> None:
        self.plant, self.D22, self.budget = plant, D22, budget
        self.closed, self.proofs = cache(self._closed), dict[Candidate, Closed]()

    def smallest(self, candidates: list[Candidate]) -> Closed | None:
        """Return the proved candidate of smallest norm; if none is proved, that of smallest norm."""
        found, near = list[Closed](), 0
        # One at least, even without work left: a time limit returns what was found by then.
        for closed in filter(None, map(self.closed, sorted(candidates, key=lambda c: c.gamma)[:MOST_TRIES])):
            found.append(closed)
            near += closed.norm.upper <= LOSS * closed.candidate.gamma
            if near == PROOFS or len(found) == TRIES or self.budget.over:
                break
        tried: list[Closed] = []
        for closed in sorted(found, key=lambda c: c.norm.upper)[:PROOFS]:
            tried.append(self.verified(closed, 1 if tried else EFFORT))
            if not tried[-1].doubt:
                break
        best = min(tried, key=lambda v: (bool(v.doubt), v.gamma), default=None)
        least = min(tried, key=lambda v: v.gamma, default=None)
        return best if best is None or least is None or best.gamma <= CERTIFICATE_WORTH * least.gamma else least

    def least_stiff(self, candidates: list[Candidate], best: Closed, ratio: float) -> Closed:
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

    def verified(self, closed: Closed, effort: int = 1) -> Closed:
        """Return the candidate with the result of the checker; at little ``effort`` only matrix proofs are tried."""
        if closed.candidate not in self.proofs:
            self.budget.spend(dense(closed.loop.n_states, 200))
            gamma, doubt = certified(self.plant, closed.K, closed.norm, effort=effort)
            self.proofs[closed.candidate] = closed._replace(gamma=gamma, doubt=doubt)
        return self.proofs[closed.candidate]


@one_thread()
@np.errstate(over="ignore", invalid="ignore")  # results are verified afterwards
def synthesize(
    plant: GeneralizedPlant, method: str, gamma_rel: float, budget: Budget,
    weights: Mapping[str, StateSpaceModel] | None = None, progress: Callable[[str], None] | None = None,
) -> HinfSynthesis:  # fmt: skip
    """Search a controller of a rational plant for `hinf` or `mixsyn`."""
    where = f"synth {method}"
    number(f"{where}: gamma_rel", gamma_rel, at_least=1, at_most=1e6)
    refuse_extremes(plant.model, where)
    report = progress or (lambda _: None)
    continuous = plant.continuous()
    matrices = continuous.matrices()
    scalings = (paths_first(matrices), equilibrated(matrices))
    scaled, rate = scalings[0].apply(matrices), scalings[0].rate
    require_stabilisable(scaled, plant.model.state_names, where, rate)
    lower, assumptions = pointwise_bound(matrices, scalings, plant.model.dt), broken_assumptions(scaled, plant, rate)
    verifier = Verifier(plant, continuous.D22, budget)
    leader, other = portfolio(matrices, scalings, budget, lower.value, continuous.D22)
    best = verifier.smallest(leader.candidates + other.candidates)
    if best is None:
        ended = f": {NOT_REPEATABLE}" if budget.struck else " within the work budget" if budget.over else ""
        many = f"{len(leader.candidates) + len(other.candidates)} were found by two Riccati equations in two scalings"
        hint = "look at the plant's scaling, at poles and zeros on the imaginary axis, and at D12 and D21"
        raise NoTrustworthyNumber(where, f"no controller could be verified{ended} ({many})", None, hint, assumptions)
    report(f"two Riccati equations: gamma {best.gamma:.6g}")
    if best.doubt:  # the controller is so fast that digits are lost
        relax(leader, best.candidate, (0.2 + 0.8 * LESS_STIFF) * best.gamma)
        best = verifier.least_stiff(leader.candidates + other.candidates, best, LESS_STIFF)
    chosen = best
    if gamma_rel > 1:
        relax(leader, best.candidate, gamma_rel * best.gamma)
        chosen = verifier.least_stiff(leader.candidates + other.candidates, best, gamma_rel)
        report(f"softened: gamma {chosen.gamma:.6g}, fastest pole {chosen.candidate.pace:.4g} rad/s")
    if chosen.gamma < best.gamma:  # the relaxation found a smaller gamma
        best = chosen
    proved = "loop of P and K is stable, its norm proved in ball arithmetic"
    parts = [chosen.doubt or proved, "by two Riccati equations"]
    if chosen is not best:
        allowed = f"within {gamma_rel - 1:.0%} of the smallest gamma {best.gamma:.6g}"
        parts.append(f"the controller with the slowest poles {allowed}")
    status, reason = final_status(Status.INACCURATE if chosen.doubt else Status.CERTIFIED, parts, budget)
    loop, norm = chosen.loop, chosen.norm
    return HinfSynthesis(
        K=chosen.K, gamma=chosen.gamma, closed_loop=loop, status=status, peak_frequency=norm.frequency, reason=reason,
        limit=limiting_channels(loop, norm.frequency), smallest_gamma=best.gamma,
        lower_bound=lower, assumptions=assumptions, norm=norm, plant=plant, method=method, weights=dict(weights or {}),
    )  # fmt: skip
