"""Search for controllers of small gamma over regularisations of one plant, in two scalings.

Most practical plants are singular for the two Riccati equations: each trial adds small penalties and noises, solves
that regular problem, and evaluates its controller on the plant without them.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from robustlab.arrays import AnyArray, Array
from robustlab.budget import Budget, dense
from robustlab.errors import NoTrustworthyNumber
from robustlab.synthesis.hinf.two_riccati import PROBES, TwoRiccatiProblem
from robustlab.synthesis.problem.partition import PlantMatrices, Realisation
from robustlab.synthesis.problem.rebuilt_loop import well_posed_neighbours
from robustlab.synthesis.problem.scaling import Scaling
from robustlab.synthesis.structures.loops import ModalLoop, largest_gain

# Sizes of added penalties and noises, scaled. Longer: singular plants get closer to their infimum.
LADDER = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
# A central controller at gamma itself is ill-conditioned: gamma is increased until the gain of the loop agrees.
# Smaller: less is lost, more controllers are numerically void.
COARSE_BACKOFFS = (1e-2, 0.1)
FINE_BACKOFFS = (1e-4, 1e-3, 1e-2, 3e-2, 0.1)
# Shares of the loop's gain that the self-scaled regularisation may cost; the optimum rises by their squares.
SHARES = (0.2, 0.1, 0.05, 0.02, 0.01)
# Most trials of that kind. More: slower, and a little lower on plants that keep falling.
SELF_SCALED_STEPS = 14
# Relative gain of a trial that counts as one. Smaller: more trials for less.
IMPROVEMENT = 5e-4
# A gamma this near (relative) to a proved bound ends the search. Larger: sooner.
PROVED = 3e-4
# Singular values of D12 or D21, scaled, above which that side is not regularised. Smaller: digits are lost.
REGULAR = 1e-6
# Scaled gains below it are zero for every purpose.
NEGLIGIBLE = 1e-7
# Relative difference of two scalings above which both are searched again carefully. Smaller: more often.
DISAGREEMENT = 5e-4
# Rounds of bisection in `relax`; steps in the first and in the later ones. More: slower poles.
RELAX_ROUNDS = 3
RELAX_STEPS = 5
RELAX_LATER_STEPS = 3
# Share of the loop's gain from which the second relaxation starts.
RELAX_SHARE = 0.05


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
        """Fastest controller pole over slowest mode of the loop."""
        return self.pace / max(self.decay, 1e-300)


class Search:
    """Trials on one scaled continuous plant without D22; every stabilising controller is stored."""

    def __init__(self, plant: PlantMatrices, scaling: Scaling, budget: Budget, floor: float, D22: Array) -> None:
        # What is found must be able to take D22 back in.
        self.D22 = scaling.y[:, None] * D22 * scaling.u
        self.scaling, self.plant = scaling, scaling.apply(plant)
        self.budget, self.floor = budget, floor  # floor: a proved lower bound of gamma in the plant's units
        self.careful = False  # both Riccati solvers and all probes
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
        """Whether the best controller is at the plant's own Riccati optimum, or at a proved lower bound."""
        best = self.best
        return best is not None and (best.gamma <= 1.0005 * self.regular_gamma or self.proved(best))

    def proved(self, candidate: Candidate | None) -> bool:
        """Return whether no controller can be better by more than PROVED."""
        return candidate is not None and candidate.gamma <= (1 + PROVED) * self.floor

    def negligible(self, candidate: Candidate) -> bool:
        """Return whether the gain is negligible in the plant scaled to order one."""
        return candidate.gamma * self.scaling.gain <= NEGLIGIBLE

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
            if best is None or k == len(shares) or self.budget.over or self.negligible(best) or self.proved(best):
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
        return Regularisation(
            share * u / np.sqrt(len(u)), share * y / np.sqrt(len(y)), float(of_states * x_out), float(of_states * x_in)
        )

    def found_within(self, weights: Regularisation, gamma: float) -> Candidate | None:
        """Return the central controller of this regularisation at gamma if its loop stays below gamma."""
        problem = self._problem(weights)
        return problem and self._central(problem, gamma * self.scaling.gain * (1 - 1e-5), gamma)

    def _trial(
        self, weights: Regularisation | None, start: float, rtol: float, backoffs: tuple[float, ...]
    ) -> tuple[float | None, Candidate | None]:
        """Return the smallest gamma of the regularised problem in the plant's units, and the best controller for it."""
        problem = self._problem(weights)
        gamma = problem and problem.smallest_gamma(start, rtol, PROBES if self.careful else PROBES[:1])
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
            return TwoRiccatiProblem(plant, self.careful, self.budget)
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
    """Return the candidate of smallest gamma."""
    return min(candidates, key=lambda c: c.gamma, default=None)


def portfolio(
    matrices: PlantMatrices, scalings: tuple[Scaling, Scaling], budget: Budget, floor: float, D22: Array
) -> tuple[Search, Search, float]:
    """Search both scalings coarsely, refine the better one, and confirm its gamma in the other one.

    Return the search that found the smallest gamma, the other one, and the relative difference of their gammas.
    """
    one, two = (Search(matrices, scaling, budget, floor, D22) for scaling in scalings)
    for search, other in ((one, two), (two, one)):
        search.ladder()
        if search.proved(search.best):
            return search, other, float("nan")
    if one.best is None and two.best is None:
        for search in (one, two):
            search.careful = True
            search.ladder()
    leader, other = (one, two) if _gamma(one.best) <= _gamma(two.best) else (two, one)
    if not leader.settled:
        leader.refine(leader.best)
    reached, best = _gamma(other.best), leader.best
    if best is not None and not leader.proved(best):
        # One regularisation has to confirm it in any case: the Riccati test may have failed by rounding alone.
        reached = min(reached, _confirmed(leader, other, SHARES[3:4]))
        if not leader.negligible(best) and not abs(reached - best.gamma) <= DISAGREEMENT * best.gamma:
            # One search is stuck: repeat both from the better loop, with both solvers and all probes.
            leader.careful = other.careful = True
            leader.refine(best)
            reached = min(reached, _confirmed(leader, other, SHARES[1:]))
            if reached < _gamma(leader.best) * (1 - IMPROVEMENT):
                leader, other, reached = other, leader, _gamma(leader.best)
    smaller, larger = sorted((_gamma(leader.best), reached))
    return leader, other, larger / smaller - 1 if smaller > 0 and larger < np.inf else float("nan")


def _confirmed(leader: Search, other: Search, shares: tuple[float, ...]) -> float:
    """Return the gamma that the other search reaches from the leader's best loop."""
    before = len(other.candidates)
    other.refine(leader.best, shares)
    return _gamma(smallest(other.candidates[before:]))


def _gamma(candidate: Candidate | None) -> float:
    return float("inf") if candidate is None else candidate.gamma


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
    """Return peak gains on a grid: w to each u, noise on y to z, w to x, disturbance of x to z; None if unstable.

    ``sizes``: those of the plant, whose channels come before [u; x] and [noise on y; x].
    """
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
    x_out, x_in = response[:, n_z + n_u :, :n_w], response[:, :n_z, n_w + n_y :]
    return Regularisation(
        u, y, *(float(np.linalg.norm(x, 2, axis=(1, 2)).max(initial=0.0)) if x.size else 0.0 for x in (x_out, x_in))
    )


def trial_loop(p: PlantMatrices, K: Realisation) -> Realisation:
    """Return the loop from w to z for ``u = K y`` on a plant without D22."""
    by_y, by_w = p.B2 @ K.D, p.D12 @ K.D
    return Realisation(
        np.block([[p.A + by_y @ p.C2, p.B2 @ K.C], [K.B @ p.C2, K.A]]),
        np.vstack([p.B1 + by_y @ p.D21, K.B @ p.D21]),
        np.hstack([p.C1 + by_w @ p.C2, p.D12 @ K.C]),
        p.D11 + by_w @ p.D21,
    )
