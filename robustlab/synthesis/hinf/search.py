"""Search for controllers of small gamma over regularisations of one plant, in two scalings side by side.

Most practical plants are singular for the two Riccati equations: D12 or D21 has no full rank, or there are zeros on
the imaginary axis. Each trial adds small penalties on u and x and small noises on y and x, solves that regular
problem, and judges its controller by the gain of the loop on the plant without them. Each scaling alone fails
somewhere; where two agree trust grows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from robustlab.arrays import AnyArray, Array
from robustlab.budget import Budget, dense
from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis.matrix_equations import balanced_eigenvalues
from robustlab.synthesis.hinf.constants import PROBES
from robustlab.synthesis.hinf.two_riccati import TwoRiccatiProblem
from robustlab.synthesis.problem.partition import PlantMatrices, Realisation
from robustlab.synthesis.problem.rebuilt_loop import well_posed_neighbours
from robustlab.synthesis.problem.scaling import Scaling, by_magnitude

# Sizes of added penalties and noises, scaled. Longer: singular plants get closer to their infimum.
LADDER = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
# A central controller at gamma itself is ill-conditioned: gamma is backed off until the gain of the loop agrees.
# Coarse while gamma falls fast, fine where it counts. Smaller: less is lost, more controllers are numerically void.
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
# Singular values of D12 or D21, scaled, above which that side needs no help. Smaller: digits are lost.
REGULAR = 1e-6
# Scaled gains below it are zero for every purpose.
NEGLIGIBLE = 1e-7
# Relative difference of two scalings above which both are searched once more with care. Smaller: more often.
DISAGREEMENT = 5e-4
# Relative accuracy, and most steps towards it. Finer: better ranking, slower trials.
GAIN_ACCURACY = 1e-5
GAIN_LEVELS = 12
# Frequencies per decade of the first look, and most of them.
GRID_PER_DECADE = 4
LARGEST_GRID = 60
# Rounds of bisection that follow the loop found last; steps in the first and in the later ones. More: slower poles.
SOFTEN_ROUNDS = 3
SOFTEN_STEPS = 5
SOFTEN_LATER_STEPS = 3
# Share of the loop's gain from which the second softening starts.
SOFTEN_SHARE = 0.05


@dataclass(frozen=True, eq=False)
class Regularisation:
    """Weights of the added channels in scaled units: on u (per control), noise on y (per measurement), on x, into x."""

    u: AnyArray | float = 0.0
    y: AnyArray | float = 0.0
    x_out: float = 0.0
    x_in: float = 0.0

    def apply(self, plant: PlantMatrices) -> PlantMatrices:
        """The regularised plant."""
        if not any(np.any(part) for part in (self.u, self.y, self.x_out, self.x_in)):
            return plant
        return plant.with_channels(self.u, self.y, self.x_out, self.x_in)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A controller whose loop is stable, as far as the search can tell."""

    K: Realisation  # for the continuous plant without D22, in its units
    gamma: float  # gain of its loop, attained at a frequency
    pace: float  # largest modulus of its poles in rad/s: what makes it hard to build
    decay: float  # decay rate of the loop's slowest mode in 1/s

    @property
    def stiffness(self) -> float:
        """Fastest controller pole over slowest mode of the loop: the span of time scales that K brings in."""
        return self.pace / max(self.decay, 1e-300)


class Search:
    """Trials on one scaled plant; every controller that stabilises is kept.

    ``plant``: continuous plant without D22.
    ``scaling``: its scaling.
    ``budget``: trials and gamma tests are counted there, and it is asked between them.
    ``floor``: proved lower bound of gamma in the plant's units: a candidate close to it ends the search.
    ``D22``: the direct term that was left out of the plant: what is found must be able to take it back in.
    """

    def __init__(
        self,
        plant: PlantMatrices,
        scaling: Scaling,
        budget: Budget,
        floor: float = 0.0,
        D22: AnyArray | None = None,
    ) -> None:
        self.D22 = None if D22 is None or not D22.any() else scaling.y[:, None] * D22 * scaling.u
        self.scaling, self.plant = scaling, scaling.apply(plant)
        self.budget, self.floor, self.careful, self.probes = budget, floor, False, PROBES[:1]
        self.candidates: list[Candidate] = []
        # Set where the plant needs no regularisation: the smallest gamma that passes its own Riccati test.
        self.regular_gamma: float | None = None
        # Optima of the regularised problems scaled by the best loop, as (share, gamma).
        self.optima: list[tuple[float, float]] = []
        # Channel gains of the loop they were last asked for.
        self._gains: tuple[Candidate, tuple[AnyArray, AnyArray, AnyArray, AnyArray] | None] | None = None

    @property
    def best(self) -> Candidate | None:
        """The candidate of smallest gamma."""
        return smallest(self.candidates)

    @property
    def settled(self) -> bool:
        """True where the best controller is at the plant's own Riccati optimum, or at a proved lower bound."""
        best = self.best
        if best is None:
            return False
        return best.gamma <= 1.0005 * (self.regular_gamma or 0.0) or self.proved(best)

    def proved(self, candidate: Candidate) -> bool:
        """True where no controller can be better by more than a few parts in ten thousand."""
        return candidate.gamma <= (1 + PROVED) * self.floor

    def take_care(self) -> None:
        """From now on solve in two ways, and probe far below every gamma found."""
        self.careful, self.probes = True, PROBES

    def negligible(self, candidate: Candidate) -> bool:
        """True for a gain that is zero for every purpose, in the plant scaled to order one."""
        return candidate.gamma * self.scaling.gain <= NEGLIGIBLE

    def ladder(self) -> None:
        """Regularisations of fixed size, from large to small, until gamma falls no more."""
        s_u = np.linalg.svd(self.plant.D12, compute_uv=False)
        s_y = np.linalg.svd(self.plant.D21, compute_uv=False)
        _, n_w, n_u, n_z, n_y = self.plant.sizes
        regular, coarse = REGULAR, COARSE_BACKOFFS
        size_u = float(s_u.min()) if n_z >= n_u else 0.0
        size_y = float(s_y.min()) if n_w >= n_y else 0.0
        if size_u > regular and size_y > regular:
            self.regular_gamma, _ = self._trial(Regularisation(), 1.0, 1e-4, FINE_BACKOFFS)
            if self.settled:
                return
        worse, best, start = 0, np.inf, 1.0
        for eps in LADDER:
            if self.budget.over:
                return
            u = 0.0 if size_u > max(regular, eps) else eps
            y = 0.0 if size_y > max(regular, eps) else eps
            gamma, found = self._trial(Regularisation(u, y, eps / 10, eps / 10), start, 2e-2, coarse)
            if gamma is not None:
                start = gamma * self.scaling.gain
            if found is None:
                continue
            worse = worse + 1 if found.gamma > 0.9 * best else 0
            best = min(best, found.gamma)
            if worse == 2:
                return

    def polish(self, best: Candidate | None, shares: tuple[float, ...] | None = None) -> None:
        """Regularisations scaled by the best loop so far, smaller and smaller, until gamma falls no more."""
        k, shares = 0, SHARES if shares is None else shares
        for _ in range(SELF_SCALED_STEPS):
            if best is None or k == len(shares) or self.budget.over:
                return
            if self.negligible(best) or self.proved(best):
                return
            regularisation = self.relative(best, shares[k], 0.3)
            if regularisation is None:
                return
            rtol = float(np.clip(0.2 * shares[k] ** 2, 5e-5, 5e-3))
            gamma, found = self._trial(regularisation, best.gamma * self.scaling.gain, rtol, FINE_BACKOFFS)
            if gamma is not None:
                self.optima.append((shares[k], gamma))
            if found is None or found.gamma >= best.gamma * (1 - max(IMPROVEMENT, rtol)):
                k += 1
            if found is not None and found.gamma < best.gamma:
                best = found

    def found_within(self, weights: Regularisation, gamma: float) -> Candidate | None:
        """The central controller of this regularisation at gamma, where it exists and its loop stays below gamma."""
        try:
            problem = TwoRiccatiProblem(weights.apply(self.plant), self.careful, self.budget)
        except NoTrustworthyNumber:
            return None
        return self._central(problem, gamma * self.scaling.gain * (1 - 1e-5), gamma)

    def relative(self, loop: Candidate, share: float, state_share: float, cap: float = 1.0) -> Regularisation | None:
        """Added channels that each carry about ``share`` of the gain of this loop."""
        if self._gains is None or self._gains[0] is not loop:
            self._gains = (loop, self._channel_gains(loop))
        gains, gamma = self._gains[1], loop.gamma * self.scaling.gain
        if gains is None or gamma <= 0:  # a loop without gain (T with K = 0) sets no scale
            return None
        u, y, x_out, x_in = (gamma / np.maximum(g, gamma * share / cap) for g in gains)
        return Regularisation(
            share * u / np.sqrt(len(u)),
            share * y / np.sqrt(len(y)),
            float(state_share * share * x_out),
            float(state_share * share * x_in),
        )

    def _channel_gains(self, candidate: Candidate) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray] | None:
        """Peak gains in scaled units on a grid: w to each u, noise on each y to z, w to x, x disturbance to z."""
        n, n_w, n_u, n_z, n_y = self.plant.sizes
        self.budget.spend(dense(n + len(candidate.K.A), 2))
        loop = trial_loop(self.plant.with_channels(1.0, 1.0, 1.0, 1.0), self.scaling.controller_from_plant(candidate.K))
        if not all(np.isfinite(part).all() for part in loop):
            return None
        omega = trial_frequencies(np.linalg.eigvals(loop.A) if loop.A.size else np.zeros(0))
        response = trial_responses(loop, omega)
        if not np.isfinite(response).all():
            return None
        size_of = np.linalg.norm
        u = size_of(response[:, n_z : n_z + n_u, :n_w], axis=2).max(axis=0)
        y = size_of(response[:, :n_z, n_w : n_w + n_y], axis=1).max(axis=0)
        x_out = size_of(response[:, n_z + n_u :, :n_w], 2, axis=(1, 2)).max(initial=0.0) if n and n_w else 0.0
        x_in = size_of(response[:, :n_z, n_w + n_y :], 2, axis=(1, 2)).max(initial=0.0) if n and n_z else 0.0
        return u, y, np.asarray(x_out), np.asarray(x_in)

    def _trial(
        self, regularisation: Regularisation, start: float, rtol: float, backoffs: tuple[float, ...]
    ) -> tuple[float | None, Candidate | None]:
        """Smallest gamma of the regularised problem in the plant's units, and the best controller found for it."""
        try:
            problem = TwoRiccatiProblem(regularisation.apply(self.plant), self.careful, self.budget)
        except NoTrustworthyNumber:
            return None, None
        gamma = problem.smallest_gamma(start, rtol, self.probes)
        if gamma is None:
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

    def _central(self, problem: TwoRiccatiProblem, gamma: float, limit: float = np.inf) -> Candidate | None:
        """The central controller at gamma (scaled units), where its loop's gain is at most limit (plant's units)."""
        pair = problem.solve(gamma)
        if pair is None:
            return None
        try:
            K = problem.central_controller(pair)
        except NoTrustworthyNumber:
            return None
        return self._kept(K, limit)

    def adopt(self, K: Realisation) -> Candidate | None:
        """A controller from elsewhere, in the plant's units, as a candidate; None where its loop is not stable."""
        return self._kept(self.scaling.controller_from_plant(K), np.inf)

    def _kept(self, K: Realisation, limit: float) -> Candidate | None:
        """A scaled controller as a candidate, where its loop is stable with a gain of at most limit (plant's units).

        One that cannot take D22 back in gives way to the best of its neighbours that can.
        """
        if self.D22 is None:
            return self._entered(K, limit)
        found = [self._entered(near, limit) for near in well_posed_neighbours(K, self.D22)]
        return smallest([candidate for candidate in found if candidate is not None])

    def _entered(self, K: Realisation, limit: float) -> Candidate | None:
        """The same for a controller that can take D22 back in."""
        scale = self.scaling
        loop = trial_loop(self.plant, K)
        self.budget.spend(dense(len(loop.A), 3))  # its poles, responses on a grid, a few Hamiltonians of twice its size
        gain = trial_norm(loop, limit * scale.gain)
        if not np.isfinite(gain):
            return None
        poles, modes = (np.linalg.eigvals(a) if a.size else np.zeros(0) for a in (K.A, loop.A))
        candidate = Candidate(
            scale.controller_to_plant(K),
            gain / scale.gain,
            scale.rate * float(np.abs(poles).max(initial=0.0)),
            -scale.rate * float(modes.real.max(initial=-1e300)),
        )
        if not all(np.isfinite(part).all() for part in candidate.K):
            return None
        self.candidates.append(candidate)
        return candidate


def smallest(candidates: list[Candidate]) -> Candidate | None:
    """The candidate of smallest gamma."""
    return min(candidates, key=lambda c: c.gamma, default=None)


@dataclass(frozen=True, eq=False)
class Portfolio:
    """The searches over two scalings."""

    leader: Search  # the search that found the smallest gamma
    other: Search  # the other one
    disagree: float  # relative difference of the gammas they reached; NaN where one found none or was not asked

    def estimated_optimum(self) -> float:
        """The infimum of gamma over all controllers as the search sees it; NaN where it cannot tell.

        Of a regular plant the smallest gamma that passes its own Riccati test; else extrapolated over the size of the
        regularisation, with whose square the regularised optimum rises.
        """
        best, regular = self.leader.best, self.leader.regular_gamma
        if best is not None and regular is not None and regular <= best.gamma * (1 + 1e-9) <= 1.0006 * regular:
            return regular
        by_share = dict(self.leader.optima[-2:])
        if len(by_share) < 2:
            return float("nan")
        (small, low), (large, high) = sorted(by_share.items())
        return max(low - max(high - low, 0.0) * small**2 / (large**2 - small**2), self.leader.floor)

    @property
    def candidates(self) -> list[Candidate]:
        """Of both."""
        return self.leader.candidates + self.other.candidates


def portfolio(
    matrices: PlantMatrices,
    scalings: tuple[Scaling, Scaling],
    budget: Budget,
    floor: float = 0.0,
    D22: Array | None = None,
) -> Portfolio:
    """Search both scalings coarsely, refine the better one, and let the other one confirm its gamma.

    ``floor`` is a proved lower bound of gamma: a search that meets it is done. ``D22`` is the direct term that was left
    out of the plant.
    """
    one, two = (Search(matrices, scaling, budget, floor, D22) for scaling in scalings)
    for search in (one, two):
        search.ladder()
        if search.best is not None and search.proved(search.best):
            return Portfolio(search, two if search is one else one, float("nan"))
    if one.best is None and two.best is None:
        for search in (one, two):
            search.take_care()
            search.ladder()
    if one.best is None and two.best is None:  # a control or a measurement of quite another size than its cost
        one = Search(matrices, by_magnitude(matrices), budget, floor, D22)
        one.ladder()
    leader, other = (one, two) if _gamma(one.best) <= _gamma(two.best) else (two, one)
    if not leader.settled:
        leader.polish(leader.best)
    if leader.best is not None and leader.proved(leader.best):
        return Portfolio(leader, other, _difference(leader, _gamma(other.best)))
    # Settled or not (the Riccati test may have failed by rounding alone), one regularisation has to confirm it.
    reached = min(_gamma(other.best), _confirmed(leader, other, SHARES[3:4]))
    if leader.best is not None and not _agree(leader.best, leader, reached):
        # One of them is stuck: go over both once more from the better loop, with every solver and all probes.
        for search in (leader, other):
            search.take_care()
        leader.polish(leader.best)
        reached = min(reached, _confirmed(leader, other, SHARES[1:]))
        if reached < _gamma(leader.best) * (1 - IMPROVEMENT):
            leader, other = other, leader
            reached = _gamma(other.best)
    return Portfolio(leader, other, _difference(leader, reached))


def _difference(leader: Search, reached: float) -> float:
    smaller, larger = sorted((_gamma(leader.best), reached))
    return larger / smaller - 1 if smaller > 0 and larger < float("inf") else float("nan")


def _confirmed(leader: Search, other: Search, shares: tuple[float, ...]) -> float:
    """What the other search reaches from the leader's best loop."""
    before = len(other.candidates)
    other.polish(leader.best, shares)
    return _gamma(smallest(other.candidates[before:]))


def _agree(best: Candidate, leader: Search, reached: float) -> bool:
    return leader.negligible(best) or abs(reached - best.gamma) <= DISAGREEMENT * best.gamma


def _gamma(candidate: Candidate | None) -> float:
    return float("inf") if candidate is None else candidate.gamma


def soften(search: Search, start: Candidate, gamma: float) -> None:
    """Add saner candidates up to this gamma to the search: slower poles, no needlessly slow modes of the loop.

    The controller of the smallest gamma itself is often absurdly fast. A few per cent more allow large penalties and
    noises on u, y and x, and with them poles that are slower by orders of magnitude.

    The added channels are made as large as the test at this gamma allows. Once with all of them relative to the gains
    of the loop; and once after half of the slack has gone into an x disturbance and penalty of fixed size, because a
    mode that w does not excite (an integrator of the plant, behind a reference) otherwise stays in the loop as slow as
    it is.
    """
    _slowest_poles(search, start, gamma, 0.0)
    half = 0.5 * (start.gamma + gamma)
    base = search.relative(start, SOFTEN_SHARE, 0.0)
    low, high, size = 1e-4, 1e2, 0.0
    for _ in range(SOFTEN_STEPS):
        if base is None or search.budget.over:
            return
        middle = float(np.sqrt(low * high))
        if search.found_within(replace(base, x_out=middle, x_in=middle), half) is not None:
            low = size = middle
        else:
            high = middle
    if size > 0:
        _slowest_poles(search, start, gamma, size)


def _slowest_poles(search: Search, start: Candidate, gamma: float, x: float) -> None:
    """Largest relative weights by bisection, repeated because their scale follows the loop found last."""
    low, high, steps = 1e-2, 10.0, SOFTEN_STEPS
    for _ in range(SOFTEN_ROUNDS):
        softest: Candidate | None = None
        for _ in range(steps):
            if search.budget.over:
                return
            middle = float(np.sqrt(low * high))
            weights = search.relative(start, middle, 0.0 if x else 0.1, 3.0)
            if weights is not None and x:
                weights = replace(weights, x_out=x, x_in=x)
            found = None if weights is None else search.found_within(weights, gamma)
            if found is not None:
                low, softest = middle, found
            else:
                high = middle
        if softest is None or softest.pace > 0.7 * start.pace:
            return
        start, low, high, steps = softest, low / 2, 3 * low, SOFTEN_LATER_STEPS


# --- the loop of a trial and its gain ---------------------------------------------------------------------------------


def trial_loop(p: PlantMatrices, K: Realisation) -> Realisation:
    """The loop from w to z for ``u = K y`` on a plant without D22."""
    by_y, by_w = p.B2 @ K.D, p.D12 @ K.D
    return Realisation(
        np.block([[p.A + by_y @ p.C2, p.B2 @ K.C], [K.B @ p.C2, K.A]]),
        np.vstack([p.B1 + by_y @ p.D21, K.B @ p.D21]),
        np.hstack([p.C1 + by_w @ p.C2, p.D12 @ K.C]),
        p.D11 + by_w @ p.D21,
    )


def trial_norm(
    loop: Realisation,
    limit: float = np.inf,
) -> float:
    """H-infinity norm of a loop to about 1e-5, from below; infinite for an unstable loop and above ``limit``.

    Quick, attained at a frequency, not proved: what leaves a search is verified by `robustlab.norms.hinf_norm`.
    """
    if not all(np.isfinite(part).all() for part in loop):
        return np.inf
    if not loop.D.size:
        return 0.0
    gain = float(np.linalg.norm(loop.D, 2))
    if not loop.A.size:
        return gain
    poles = np.linalg.eigvals(loop.A)
    if poles.real.max() >= 0 or gain > limit:
        return np.inf
    gain = max(gain, _largest(loop, trial_frequencies(poles)))
    for _ in range(GAIN_LEVELS):
        if gain > limit or not np.isfinite(gain):
            return np.inf
        level = gain * (1 + GAIN_ACCURACY)
        omega = _trial_crossings(loop, level)
        if not len(omega):
            break
        found = _largest(loop, omega)
        if found <= level:
            break
        gain = found
    return gain if gain <= limit else np.inf


def _largest(loop: Realisation, omega: AnyArray) -> float:
    response = trial_responses(loop, omega)
    if not np.isfinite(response).all():
        return np.inf
    if 1 in response.shape[1:]:
        return float(np.linalg.norm(response, axis=(1, 2)).max())
    return float(np.linalg.svd(response, compute_uv=False)[:, 0].max())


def trial_frequencies(
    poles: AnyArray,
) -> AnyArray:
    """Zero, the poles' frequencies and resonances, and a coarse grid around them."""
    size = np.abs(poles)
    size = size[size > 0]
    if not len(size):
        return np.array([0.0, 1.0])
    low, high = size.min() / 10, size.max() * 10
    points = int(np.clip(GRID_PER_DECADE * np.log10(high / low), 8, LARGEST_GRID))
    upper: AnyArray = poles[np.imag(poles) >= 0]
    resonance = np.sqrt(np.maximum(np.imag(upper) ** 2 - np.real(upper) ** 2, 0.0))
    omega = np.sort(np.concatenate([np.abs(upper), np.imag(upper), resonance, np.geomspace(low, high, points)]))
    omega = omega[omega > 0]
    # Frequencies closer than a share of the nearest pole's damping tell nothing new; keep all that are apart.
    return np.concatenate([[0.0], omega[np.append(True, np.diff(omega) > 1e-6 * omega[1:])]])


def trial_responses(loop: Realisation, omega: AnyArray) -> AnyArray:
    """``C (jw - A)^-1 B + D`` at each frequency, shape (n_omega, n_z, n_w); infinite where w hits a pole."""
    n = loop.A.shape[0]
    if n == 0:
        return np.broadcast_to(loop.D.astype(complex), (len(omega), *loop.D.shape))
    try:
        shifted = 1j * omega[:, None, None] * np.eye(n) - loop.A
        if loop.B.shape[1] <= loop.C.shape[0]:
            return loop.C @ np.linalg.solve(shifted, loop.B[None].astype(complex)) + loop.D
        left = np.linalg.solve(shifted.transpose(0, 2, 1), loop.C.T[None].astype(complex))
        return left.transpose(0, 2, 1) @ loop.B + loop.D
    except np.linalg.LinAlgError:
        return np.full((len(omega), *loop.D.shape), np.inf + 0j)


def _trial_crossings(loop: Realisation, level: float) -> AnyArray:
    """Frequencies at which a singular value may cross the level, and points between them."""
    if level <= 0:
        return np.zeros(0)
    root = np.sqrt(level)
    b, c, d = loop.B / root, loop.C / root, loop.D / level
    try:
        r = np.linalg.solve(np.eye(d.shape[1]) - d.T @ d, np.hstack([d.T @ c, b.T]))
        s = np.linalg.solve(np.eye(d.shape[0]) - d @ d.T, c)
    except np.linalg.LinAlgError:
        return np.zeros(0)
    n = loop.A.shape[0]
    a1 = loop.A + b @ r[:, :n]
    hamiltonian = np.block([[a1, b @ r[:, n:]], [-c.T @ s, -a1.T]])
    values = balanced_eigenvalues(hamiltonian)
    if values is None:
        return np.zeros(0)
    size = np.abs(values)
    near = np.abs(np.real(values)) < np.maximum(1e-4 * size, 1e-10 * size.max())
    crossing = np.unique(np.abs(np.imag(values)[near]))
    if not len(crossing):
        return crossing
    return np.concatenate([crossing, 0.5 * (crossing[:-1] + crossing[1:]), [0.5 * crossing[0], 1.5 * crossing[-1]]])
