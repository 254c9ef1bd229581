r"""Smallest causal time-varying contractions that explain a record (Poolla et al., IEEE TAC 39, 1994, theorem 3.3).

Cone programmes bound gamma from above, convex-concave where z depends on w; multipliers D, lambda >= 0 from below: the
maximum of L = sum D (gamma^2 |z|^2 - |w|^2) + Lambda(n) over w and starts is one backward sweep, and negative a proof.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from robustlab.arrays import Array, Mask
from robustlab.errors import NoTrustworthyNumber
from robustlab.identification.validation.cone_programme import ConeSolution, Rows, Search, solved_cones, sparse_matrices
from robustlab.identification.validation.sampled_problem import SampledProblem
from robustlab.result import Evidence

NOISE_MARGIN = 1e-7  # by which the solver aims inside the noise bound: larger replays surely, costs gamma
VARYING_ROUNDS = 25  # convex-concave steps at most
SWEEP_WORK = 250.0  # a sample, of finding what multipliers disprove: some 15 sweeps over the record
SWEEP_STEPS = 30  # sweeps at most on the way down to a gamma that is disproved
AHEAD = 3.0  # energy of z that the first guess has in advance: larger, and no early sample decides
# Shares of the record at whose beginning a weaker problem leaves out the conditions on the energies; more of them
# are tried only while the lower bound is not there.
LATE = (0.004, 0.02, 0.1)

# A multiplier of this share of the largest, everywhere, keeps every sweep strictly concave and is as valid.
FLOOR = 1e-7
# Curvatures below this share of the largest are rounding: they count as zero, and what is linear there must vanish.
FLAT = 1e-11
# Rounding in the noise of an explanation, over its bound.
SLACK = 1e-9
# Multiplier of a signal that is zero anyhow, over those of the noise.
UNBOUNDED = 1e9
# An energy of z below this share of its final one forces w to zero: no finite gain would let it move.
NO_ENERGY = 1e-18


# --- the certificate -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Multipliers(Evidence):
    """Multipliers of a certificate: D (n, blocks), not increasing along a column; noise (n, n_y), both not negative."""

    D: Array
    noise: Array

    @classmethod
    def cleaned(cls, D: Array, noise: Array) -> Multipliers:
        """Any numbers made valid multipliers, scaled to a largest noise multiplier of one."""
        scale = float(np.abs(noise).max(initial=0.0)) or 1.0
        noise = np.maximum(noise, 0.0) / scale
        D = np.maximum(D, 0.0) / scale
        D = np.maximum.accumulate(D[::-1], axis=0)[::-1]
        return cls(D + FLOOR * np.maximum(D.max(axis=0, initial=0.0), 1e-12), noise)


def lagrangian_maximum(problem: SampledProblem, multipliers: Multipliers, gammas: Array) -> float:
    """Largest value of L over all w and free states; +inf where L is not bounded above. Negative is a proof."""
    n_x, q = problem.B.shape
    D, noise = multipliers.D, np.where(problem.used, multipliers.noise, 0.0)
    if problem.norm == "rms":  # one multiplier for an output
        noise = np.where(problem.used, noise.max(axis=0), 0.0)
    constant = float(noise.sum()) if problem.norm == "peak" else float(noise.max(axis=0) @ problem.radius**2)
    p, n_y = len(problem.C1), len(problem.C2)
    # Rows of (x, w, 1) to z, w and n; their last columns change with t.
    to_z = np.hstack([problem.C1, problem.D11, np.zeros((p, 1))])
    to_n = np.hstack([-problem.C2, -problem.D21, np.zeros((n_y, 1))])
    to_w = np.hstack([np.zeros((q, n_x)), np.eye(q), np.zeros((q, 1))])
    step = np.zeros((n_x + 1, n_x + q + 1))
    step[:n_x, :n_x], step[:n_x, n_x : n_x + q], step[n_x, -1] = problem.A, problem.B, 1.0
    weight_z, weight_w = np.zeros((problem.n, p)), np.zeros((problem.n, q))
    for k, (rows, cols, _) in enumerate(problem.blocks):
        weight_z[:, cols] = (gammas[k] ** 2 * D[:, k])[:, None]
        weight_w[:, rows] = D[:, k][:, None]
    value = np.zeros((n_x + 1, n_x + 1))
    keep, move = [*range(n_x), n_x + q], list(range(n_x, n_x + q))
    for t in range(problem.n - 1, -1, -1):
        to_z[:, -1], to_n[:, -1] = problem.z0[t], problem.e[t]
        H = step.T @ value @ step + to_z.T @ (weight_z[t][:, None] * to_z)
        H -= to_w.T @ (weight_w[t][:, None] * to_w) + to_n.T @ (noise[t][:, None] * to_n)
        reduced = _maximised(H, keep, move)
        if reduced is None:
            return np.inf
        value = reduced
        if t in problem.free_starts:  # x + free xi for the best xi
            jump = np.zeros((n_x + 1, n_x + 1 + problem.free.shape[1]))
            jump[:n_x, :n_x], jump[n_x, n_x], jump[:n_x, n_x + 1 :] = np.eye(n_x), 1.0, problem.free
            reduced = _maximised(jump.T @ value @ jump, [*range(n_x + 1)], list(range(n_x + 1, jump.shape[1])))
            if reduced is None:
                return np.inf
            value = reduced
    return float(value[n_x, n_x] + constant)


def _maximised(H: Array, keep: list[int], move: list[int]) -> Array | None:
    """The quadratic form left when the variables ``move`` are chosen for its maximum; None where there is none."""
    if not move:
        return H[np.ix_(keep, keep)]
    inner, cross = H[np.ix_(move, move)], H[np.ix_(move, keep)]
    values, vectors = np.linalg.eigh(0.5 * (inner + inner.T))
    size = float(np.abs(values).max(initial=0.0))
    turned = vectors.T @ cross
    flat = values > -FLAT * max(size, 1e-300)
    if (values[flat] > FLAT * size).any():
        return None
    if flat.any() and np.abs(turned[flat]).max() > 1e-7 * np.abs(H).max():
        return None
    gain = turned[~flat] / np.sqrt(-values[~flat])[:, None]
    outer = H[np.ix_(keep, keep)] + gain.T @ gain
    return 0.5 * (outer + outer.T)


def largest_disproved(problem: SampledProblem, multipliers: Multipliers, search: Search, start: float) -> float:
    """Largest gamma, not above ``start``, that the multipliers disprove; 0 where they disprove none.

    L grows with gamma, so halving is enough.
    """

    def disproved(gamma: float) -> bool:
        return lagrangian_maximum(problem, multipliers, search.gammas(gamma)) < 0

    finest = search.precision / 10
    share, good = finest, 0.0
    for _ in range(SWEEP_STEPS):  # first close to the start, then further away
        trial = start * (1 - share)
        if share >= 1:
            break
        if disproved(trial):
            good = trial
            break
        share *= 2
    if good == 0.0:
        return 0.0
    high = start * (1 - share / 2) if share > finest else start
    while high - good > 0.1 * search.precision * high:
        middle = 0.5 * (high + good)
        good, high = (middle, high) if disproved(middle) else (good, middle)
    return good


# --- the search ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Contractions:
    """What `smallest_contractions` found; signals in the scaled units of the problem."""

    # lower, upper: bounds of gamma; the upper one is that of w and z below, recomputed by simulation (inf where none
    # was found)
    lower: float
    upper: float
    # w, z, noise: shapes (n, q), (n, p), (n, n_y); empty where nothing explains the record
    w: Array
    z: Array
    noise: Array
    states: Mapping[int, Array]  # start of window -> jump of its state
    sizes: Array  # gain of each block in this explanation
    multipliers: Multipliers  # those of the lower bound
    least_noise: float  # where no Delta explains the record: by what factor the noise bound would have to grow, else 1
    convex: bool  # whether z is known


def smallest_contractions(problem: SampledProblem, search: Search) -> Contractions:
    """Bounds of the smallest gamma over the blocks that are scaled; the others keep the size 1."""
    first = _Programme(problem, search)
    convex = first.convex
    z = problem.z0
    if not convex:
        # As if the nominal z acted, with some energy ahead so that no early sample decides.
        guess = first.smallest(z, known=True, ahead=AHEAD)
        start = first.least_effort() if guess is None else guess.x
        if start is None:
            return _unexplained(first)
        z = problem.respond(*first.signals(start))[0]
    best, solution = _descend(first, z, 0, VARYING_ROUNDS)
    if solution is None:
        if first.least_effort() is None:
            return _unexplained(first)
        silent = _unexplained_while_silent(first) if convex and search.scaled.all() else None
        return silent or _bounded_only(first)

    def disproved(by: ConeSolution, at: float) -> tuple[float, Multipliers]:
        multipliers = first.multipliers(by)
        search.budget.spend(SWEEP_WORK * problem.n)
        return largest_disproved(problem, multipliers, search, at) if at > 0 else 0.0, multipliers

    top = best.gamma if best is not None else first.gamma(solution)
    lower, multipliers = disproved(solution, top)
    # With a free state the first samples of z may have either sign: two valleys, and no concave Lagrangian over both.
    # Without the conditions at the first samples there is a weaker problem whose bound holds all the same.
    for share in () if convex else LATE:
        if lower >= (1 - search.precision) * top or search.budget.over:
            break
        _, weaker = _descend(first, z, 1 + int(share * problem.n), 4)
        if weaker is not None:
            found, others = disproved(weaker, min(top, first.gamma(weaker)))
            lower, multipliers = (found, others) if found > lower else (lower, multipliers)
    if best is None:
        return _bounded_only(first, lower, multipliers)
    z, noise = problem.respond(best.w, best.states)
    sizes = problem.sizes(best.w, z)
    return Contractions(lower, best.gamma, best.w, z, noise, best.states, sizes, multipliers, 1.0, convex)


@dataclass(frozen=True)
class _Point:
    gamma: float
    w: Array
    states: Mapping[int, Array]


def _descend(programme: _Programme, z: Array, late: int, rounds: int) -> tuple[_Point | None, ConeSolution | None]:
    """Best point that its replay confirms, and the last solution; no conditions before the sample ``late``."""
    problem, search = programme.problem, programme.search
    best: _Point | None = None
    solution: ConeSolution | None = None
    before = np.inf
    for _ in range(1 if programme.convex else rounds):
        found = programme.smallest(z, known=programme.convex, late=late)
        if found is None:
            break
        solution = found
        w, states = programme.signals(found.x)
        for rows, cols, _ in problem.blocks:  # the solver's zeros are small numbers, for which no gain is enough
            w[_silent(problem, z, cols), rows] = 0.0
        z, noise = problem.respond(w, states)
        if problem.excess(noise) > 1 + SLACK:
            break
        gamma = _gamma(problem.sizes(w, z), search.scaled)
        reached = programme.gamma(found)
        if best is None or gamma < best.gamma:
            best = _Point(gamma, w, states)
        if reached > before * (1 - 0.02 * search.precision) or search.budget.over:
            break
        before = reached
    return best, solution


def _silent(problem: SampledProblem, z: Array, cols: slice) -> Mask:
    """First samples at which z has had no energy: there w must be zero, no finite gain would let it move.

    From rest that is so until the nominal z moves, although a w of its own could make z move.
    """
    energy = np.cumsum((z[:, cols] ** 2).sum(axis=1))
    silent = energy <= NO_ENERGY * max(energy[-1], 1e-300)
    if problem.at_rest:
        nominal = np.cumsum((problem.z0[:, cols] ** 2).sum(axis=1))
        silent |= nominal <= NO_ENERGY * nominal[-1]
    return silent


def _gamma(sizes: Array, scaled: Mask) -> float:
    """Largest of the scaled blocks; inf where a block that keeps its size would have to be larger."""
    if (sizes[~scaled] > 1 + 1e-6).any():
        return np.inf
    return float(sizes[scaled].max(initial=0.0))


def _bounded_only(programme: _Programme, lower: float = 0.0, multipliers: Multipliers | None = None) -> Contractions:
    problem, empty = programme.problem, np.zeros((0, 0))
    multipliers = multipliers or Multipliers(np.zeros((problem.n, len(problem.blocks))), np.zeros(problem.e.shape))
    return Contractions(lower, np.inf, empty, empty, empty, {}, np.zeros(0), multipliers, 1.0, programme.convex)


def _impossible(programme: _Programme, solved: ConeSolution, multipliers: Multipliers) -> Contractions | None:
    """No Delta of any size, with the least noise that any w leaves; None where the multipliers do not prove it."""
    problem, empty = programme.problem, np.zeros((0, 0))
    # Where D is zero w is free, and where it is not z is zero: the same L for every gamma.
    if not lagrangian_maximum(problem, multipliers, np.ones(len(problem.blocks))) < 0:
        return None
    noise, least = problem.respond(*programme.signals(solved.x))[1], programme.g(solved)
    return Contractions(np.inf, np.inf, empty, empty, noise, {}, np.zeros(0), multipliers, least, programme.convex)


def _unexplained(programme: _Programme) -> Contractions:
    """No w brings the noise below its bound: shown by multipliers of the noise alone."""
    solved = programme.least_noise()
    if solved is None:
        raise NoTrustworthyNumber("validate", "the solver gave no answer (infeasible)")
    multipliers = programme.multipliers(solved)
    D = np.zeros_like(multipliers.D)
    found = _impossible(programme, solved, Multipliers(D, Multipliers.cleaned(D, multipliers.noise).noise))
    least = programme.g(solved)
    if found is None or least <= 1:
        raise NoTrustworthyNumber(
            "validate", f"the noise bound is met or missed by {abs(least - 1):.1e} of itself: too close to tell"
        )
    return found


def _unexplained_while_silent(programme: _Programme) -> Contractions | None:
    """No Delta of any size answers before z has moved: multipliers as large as one likes on w while z is zero."""
    problem = programme.problem
    silent = np.column_stack([_silent(problem, problem.z0, cols) for _, cols, _ in problem.blocks])
    solved = programme.least_noise(silent)
    if solved is None:
        return None
    D = np.where(np.cumsum(~silent, axis=0) == 0, UNBOUNDED, 0.0)
    noise = Multipliers.cleaned(np.zeros_like(D), programme.multipliers(solved).noise).noise
    return _impossible(programme, solved, Multipliers(D, noise))


# --- the programme ---------------------------------------------------------------------------------------------------


class _Programme:
    """The cone programme in the sparse variables (x_t, w_t, cumulative energies, g)."""

    def __init__(self, problem: SampledProblem, search: Search) -> None:
        self.problem, self.search = problem, search
        n, (n_x, q), m = problem.n, problem.B.shape, len(problem.blocks)
        self.at_w, self.at_c = n * n_x, n * (n_x + q)
        self.at_e = self.at_c + n * m
        self.at_g = self.at_e + n * m
        self.size = self.at_g + 1
        self.convex = problem.z_is_known()
        self._dynamics = self._motion()

    # --- rows --------------------------------------------------------------------------------------------------------

    def _empty(self, rows: int) -> Any:
        return sparse_matrices().csr_matrix((rows, self.size))

    def _picked(self, columns: Array) -> Any:
        """Rows that are one variable each."""
        n = len(columns)
        return sparse_matrices().csr_matrix((np.ones(n), (np.arange(n), columns)), (n, self.size))

    def _affine(self, on_x: Any, on_w: Any) -> Any:
        """Rows of matrices on all x_t and on all w_t."""
        sparse = sparse_matrices()
        rest = sparse.csr_matrix((on_x.shape[0], self.size - self.at_c))
        return sparse.hstack([on_x, on_w, rest]).tocsr()

    def _motion(self) -> Rows:
        """Equations of motion; at free starts only across the directions in which the state may jump."""
        from scipy import linalg

        sparse, p = sparse_matrices(), self.problem
        n_x, n = len(p.A), p.n
        if not n_x:
            return Rows(sparse.csc_matrix((0, self.size)), np.zeros(0), "zero")
        eye, before = sparse.identity(n, format="csr"), sparse.eye(n, k=-1, format="csr")
        x = sparse.kron(eye, sparse.identity(n_x)) - sparse.kron(before, sparse.csr_matrix(p.A))
        rows = self._affine(x, -sparse.kron(before, sparse.csr_matrix(p.B)))
        across: Any = linalg.null_space(p.free.T) if p.free.size else np.eye(n_x)
        bound = [t for t in range(n) if t not in p.free_starts]
        kept = [rows[(np.array(bound, dtype=int)[:, None] * n_x + np.arange(n_x)).ravel()]]
        kept += [sparse.csr_matrix(across.T) @ rows[t * n_x : (t + 1) * n_x] for t in p.free_starts]
        motion = sparse.vstack(kept).tocsc()
        return Rows(motion, np.zeros(motion.shape[0]), "zero")

    def _outputs(self) -> list[Any]:
        """Rows that give C2 x + D21 w at the used samples, output after output."""
        p = self.problem
        every = self._affine(_repeated(p.C2, p.n), _repeated(p.D21, p.n))
        n_y = p.e.shape[1]
        return [every[np.flatnonzero(p.used[:, j]) * n_y + j] for j in range(n_y)]

    def _noise(self, radius: float | None) -> list[Rows]:
        """Noise within ``radius`` times its bound; None: within the variable g times its bound."""
        sparse, p = sparse_matrices(), self.problem
        found, free = [], radius is None
        g = sparse.csr_matrix(([1.0], ([0], [self.at_g])), (1, self.size))
        for j, rows in enumerate(self._outputs()):
            e = p.e[p.used[:, j], j]
            if p.norm == "peak":
                both = sparse.vstack([rows, -rows])
                if free:
                    both = both - sparse.csr_matrix(np.ones((2 * len(e), 1))) @ g
                bound = np.full(2 * len(e), radius or 0.0)
                found.append(Rows(both, np.concatenate([e, -e]) + bound, "positive", label=("noise", j)))
                continue
            head = -p.radius[j] * g if free else self._empty(1)
            offset = np.concatenate([[p.radius[j] * (radius or 0.0)], e])
            found.append(Rows(sparse.vstack([head, rows]), offset, "second-order", 1 + len(e), ("noise", j)))
        return found

    def _energies(self, z: Array, known: bool, ahead: float, late: int) -> list[Rows]:
        """Cumulative energies of w / g below those of z (or below their tangents at z, where z is not known).

        With ``ahead`` that many mean samples of energy are there before the first one: for a first guess.
        """
        sparse, p = sparse_matrices(), self.problem
        n, q = p.n, p.B.shape[1]
        every = np.arange(n)
        lower_sum = sparse.csr_matrix(sparse.identity(n) - sparse.eye(n, k=-1))
        found: list[Rows] = []
        zero_rows, zero_off = [], []
        for k, (rows, cols, _) in enumerate(p.blocks):
            each = (z[:, cols] ** 2).sum(axis=1)
            each[0] += ahead * each.mean()
            silent = _silent(p, z, cols) if ahead == 0 else np.zeros(n, dtype=bool)
            take, bound = self._picked(self.at_c + k * n + every), self._picked(self.at_e + k * n + every)
            pick = [self._picked(self.at_w + every * q + i) for i in range(rows.start, rows.stop)]
            # e_T - e_{T-1} = 2 z'z(w, x) - z'z, which is the energy itself where z is known.
            if known:
                zero_rows.append(lower_sum @ bound)
                zero_off.append(each)
            else:
                to_z = self._affine(_placed(2 * z[:, cols] @ p.C1[cols]), _placed(2 * z[:, cols] @ p.D11[cols]))
                zero_rows.append(lower_sum @ bound - to_z)
                zero_off.append((z[:, cols] * (2 * p.z0[:, cols] - z[:, cols])).sum(axis=1))
            if silent.any():
                still = np.flatnonzero(silent)
                for part in (*pick, take):
                    zero_rows.append(part[still])
                    zero_off.append(np.zeros(len(still)))
            moving = np.flatnonzero(~silent)
            judged = moving[moving >= min(late, n - 1)]
            found.append(Rows((take - bound)[judged], np.zeros(len(judged)), "positive", label=("energy", k)))
            # (s + g, s - g, 2 w) in the cone: s g >= |w|^2, with g = 1 for blocks that keep their size
            more, count = (lower_sum @ take)[moving], len(moving)
            free = self.search.scaled[k]
            g = self._picked(np.full(count, self.at_g)) if free else self._empty(count)
            unit = np.zeros(count) if free else np.ones(count)
            stacked = sparse.vstack([-(more + g), -(more - g), *(-2 * part[moving] for part in pick)]).tocsr()
            height = 2 + len(pick)
            turn = np.arange(height * count).reshape(height, count).T.ravel()
            offset = np.concatenate([unit, -unit, np.zeros(count * len(pick))])[turn]
            found.append(Rows(stacked[turn], offset, "second-order", height))
        return [Rows(sparse.vstack(zero_rows), np.concatenate(zero_off), "zero"), *found]

    def _held_still(self, silent: Mask) -> Rows:
        """W of a block is zero where it is silent (n, blocks)."""
        q = self.problem.B.shape[1]
        columns = np.concatenate(
            [
                (self.at_w + np.flatnonzero(silent[:, k])[:, None] * q + np.arange(rows.start, rows.stop)).ravel()
                for k, (rows, _, _) in enumerate(self.problem.blocks)
            ]
        )
        return Rows(self._picked(columns), np.zeros(len(columns)), "zero")

    # --- problems ----------------------------------------------------------------------------------------------------

    def smallest(self, z: Array, known: bool, ahead: float = 0.0, late: int = 0) -> ConeSolution | None:
        """Smallest g = gamma^2 with the energies of z, or their tangents at z; None where there is none."""
        noise = self._noise(1 - NOISE_MARGIN)
        return self._solved([*noise, *self._energies(z, known, ahead, late)])

    def least_effort(self) -> Array | None:
        """Least energy of w that explains the record; None where no w does."""
        squares = np.zeros(self.size)
        squares[self.at_w : self.at_c] = 1.0
        solved = self._solved(self._noise(1 - NOISE_MARGIN), squares)
        return None if solved is None else solved.x

    def least_noise(self, silent: Mask | None = None) -> ConeSolution | None:
        """Smallest factor on the noise bound with which any w explains the record; w is zero where it is ``silent``."""
        still = [self._held_still(silent)] if silent is not None and silent.any() else []
        return self._solved([*self._noise(None), *still])

    def _solved(self, rows: list[Rows], squares: Array | None = None) -> ConeSolution | None:
        """The answer under the equations of motion: of least g, or of the least squares."""
        cost = np.zeros(self.size)
        cost[self.at_g] = 1.0 if squares is None else 0.0
        return solved_cones(cost, [self._dynamics, *rows], self.search.budget, squares)

    # --- answers -----------------------------------------------------------------------------------------------------

    def g(self, solved: ConeSolution) -> float:
        """The variable g: gamma squared, or the factor on the noise bound."""
        return float(solved.x[self.at_g])

    def gamma(self, solved: ConeSolution) -> float:
        """Root of g."""
        return float(np.sqrt(max(self.g(solved), 0.0)))

    def signals(self, x: Array) -> tuple[Array, dict[int, Array]]:
        """W (n, q), and the jumps at the free starts."""
        p = self.problem
        n_x, q = p.B.shape
        w = x[self.at_w : self.at_c].reshape(p.n, q).copy()
        state = x[: self.at_w].reshape(p.n, n_x)
        jumps = {}
        for t in p.free_starts:
            came = p.A @ state[t - 1] + p.B @ w[t - 1] if t else np.zeros(n_x)
            jumps[t] = p.free.T @ (state[t] - came)
        return w, jumps

    def multipliers(self, solved: ConeSolution) -> Multipliers:
        """Multipliers of the quadratic certificate from those of the cone programme."""
        p = self.problem
        noise, D = np.zeros(p.e.shape), np.zeros((p.n, len(p.blocks)))
        g = max(self.g(solved), 1e-300)
        for (kind, k), part in solved.dual:
            if kind == "energy":
                D[p.n - len(part) :, k] = np.cumsum(part[::-1])[::-1] / (g if self.search.scaled[k] else 1.0)
                D[: p.n - len(part), k] = D[p.n - len(part), k] if len(part) else 0.0
            elif p.norm == "peak":  # at n = +-1 the slope of 1 - n^2 is twice that of 1 -+ n
                half = len(part) // 2
                noise[p.used[:, k], k] = 0.5 * np.abs(part[:half] - part[half:])
            else:
                noise[p.used[:, k], k] = 0.5 * abs(part[0]) / p.radius[k]
        return Multipliers.cleaned(D, noise)


def _repeated(X: Array, n: int) -> Any:
    """Block-diagonal matrix of n times X."""
    sparse = sparse_matrices()
    if not X.size:
        return sparse.csr_matrix((n * X.shape[0], n * X.shape[1]))
    return sparse.kron(sparse.identity(n), sparse.csr_matrix(X))


def _placed(rows: Array) -> Any:
    """Row t of (n, k) in columns t k .. of row t."""
    n, k = rows.shape
    at = np.repeat(np.arange(n), k), np.arange(n * k)
    return sparse_matrices().csr_matrix((rows.ravel(), at), (n, n * k))
