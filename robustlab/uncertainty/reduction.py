"""LFTs of low order: Kalman reduction in n variables, and tree decomposition of matrices of polynomials.

Beck, Doyle, IEEE TAC 44 (1999); D'Andrea, Khatri, "Kalman decomposition of linear fractional transformation
representations" (1997). Cockburn, Morton, Automatica 33 (1997); Varga, Looye, "Symbolic and numerical software tools
for LFT-based low order uncertainty modeling" (1999).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.checks import number as checked_number
from robustlab.display import Displayable, Facts, listed, number
from robustlab.linear_analysis.matrices import balancing_factors, of_system_matrix, system_matrix
from robustlab.result import Status
from robustlab.statespace import Signal, StateSpaceModel
from robustlab.uncertainty.blocks import Block, block_slices, structure_size

# All scalar blocks together give F(Delta) = D + C Delta (I - A Delta)^-1 B, the form of a transfer function in 1/s. The
# smallest subspaces V_i with B_i in V_i and A_ij V_j in V_i contain all reachable directions; by duality, their
# complements in the transposed system are unobservable. Removing both does not change F, for any Delta. The reduction
# of each block alone (`reduce_each`) does not change the other blocks, but misses a channel fed only by another
# unreachable channel.

TOLERANCE = 1e-12  # relative singular values below this are zero
UNCHANGED = 1e-10  # allowed change of F(delta) by a reduction, relative to the largest entry
CANCELLED = 1e-3  # or, where the summands of F cancel, relative to this share of them
POINTS = 6  # deltas at which a step is compared
PROVED = 1e-9  # allowed relative coupling through dropped channels

Step = tuple[StateSpaceModel, tuple[Block, ...], Array]  # a smaller set; invariance and difference of `Reduction`


@dataclass(frozen=True, eq=False)
class Reduction(Displayable):
    """A reduced set, with the evidence of unchanged input-output behaviour."""

    model: Any  #: The reduced UncertainModel, without scalar blocks that have no effect
    before: dict[str, int]  #: Block name -> size (repetitions, or the larger side of a full block)
    after: dict[str, int]
    #: Largest coupling of the kept channels through the dropped ones, relative to the largest singular value of the
    #: (scaled) channel matrices, for every Delta: zero for an exact reduction
    invariance: float
    #: Largest difference of the maps through the blocks, from all other inputs and states to all other outputs and
    #: rates, at random complex Delta inside the set, relative to each map's largest entry (or to a thousandth of the
    #: largest summand, where the summands cancel). A step that misses 1e-10 is not taken.
    difference: float
    status: Status  #: CONVERGED where both are below 1e-9, INACCURATE otherwise (then ``model`` is the given one)

    def facts(self) -> Facts:
        sizes = listed(f"{name} {size} -> {self.after.get(name, 0)}" for name, size in self.before.items())
        evidence = [(name, number(getattr(self, name))) for name in ("invariance", "difference")]
        return [("sizes", sizes), ("set", repr(self.model)), *evidence]

    def to_json(self) -> dict[str, object]:
        return {**vars(self), "model": self.model.to_json()}


def reduction(uncertain: Any, tolerance: float = TOLERANCE) -> Reduction:
    """Reduce all scalar blocks of a set jointly until nothing is removed."""
    checked_number("reduce_model: tolerance", tolerance, above=0, below=1)
    M, blocks, worst = uncertain.M, uncertain.blocks, np.zeros(2)
    while step := _step(M, blocks, {b.name for b in blocks if b.is_scalar}, tolerance):
        M, blocks, missed = step
        worst = np.maximum(worst, missed)
    before, model, status = {b.name: max(b.rows, b.cols) for b in uncertain.blocks}, uncertain, Status.CONVERGED
    if worst.max() > PROVED:
        status = Status.INACCURATE
    elif blocks != uncertain.blocks:
        model = type(uncertain)(M, blocks, uncertain.operating_point)
    after = {b.name: max(b.rows, b.cols) for b in model.blocks}
    return Reduction(model, before, after, float(worst[0]), float(worst[1]), status)


def reduce_each(
    M: StateSpaceModel, blocks: tuple[Block, ...], names: Sequence[str]
) -> tuple[StateSpaceModel, tuple[Block, ...]]:
    """Return M and blocks with minimal repetitions of each of these scalar blocks by its own channels, one at least."""
    for name in names:
        step = _step(M, blocks, {name}, TOLERANCE, keep=True)
        M, blocks = step[:2] if step else (M, blocks)
    return M, blocks


def _step(
    M: StateSpaceModel, blocks: Sequence[Block], names: Collection[str], tolerance: float, keep: bool = False
) -> Step | None:
    """Reduce the scalar blocks of these names jointly; None where nothing is removed."""
    n, (q, p) = M.n_states, structure_size(blocks)
    whole = system_matrix(M)
    slices = [s for b, s in zip(blocks, block_slices(blocks), strict=True) if b.name in names]
    if not slices:
        return None
    cols, rows = (np.concatenate([n + np.arange(part[i].start, part[i].stop) for part in slices]) for i in (0, 1))
    other_cols, other_rows = np.delete(np.arange(whole.shape[1]), cols), np.delete(np.arange(whole.shape[0]), rows)
    a, b, c = whole[rows[:, None], cols], whole[rows[:, None], other_cols], whole[other_rows[:, None], cols]
    b_sizes, c_sizes = np.abs(b).max(axis=0, initial=0.0), np.abs(c).max(axis=1, initial=0.0)
    by_b, by_c = (np.exp2(np.rint(np.log2(np.where(size > 0, size, 1.0)))) for size in (b_sizes, c_sizes))
    b, c = b / by_b, c / by_c[:, None]
    # The external signals balance the channels as one more channel.
    bordered = np.block([[np.abs(a), np.abs(b).sum(axis=1)[:, None]], [np.abs(c).sum(axis=0), np.zeros((1, 1))]])
    scale = balancing_factors(bordered)
    scale = scale[:-1] / scale[-1]
    a, b, c = a / scale[:, None] * scale, b / scale[:, None], c * scale
    sizes = [w.stop - w.start for w, _ in slices]
    # The second step may act on rounding of the first, so it uses the sizes of b and c before.
    b_size, c_size = _norm(b), _norm(c)
    reach, miss_1 = _invariant(a, b, sizes, tolerance, b_size)
    v = _block_diag(reach)
    show, miss_2 = _invariant((v.T @ a @ v).T, (c @ v).T, [part.shape[1] for part in reach], tolerance, c_size)
    turns = [first @ then for first, then in zip(reach, show, strict=True)]
    if keep and not turns[0].size:  # of one block
        turns = [np.zeros((sizes[0], 1))]
    left, t = [turn.shape[1] for turn in turns], _block_diag(turns)
    if left == sizes:
        return None
    difference = _difference((a, b, c), sizes, (t.T @ a @ t, t.T @ b, c @ t), left)
    if not difference <= UNCHANGED:
        return None
    into, out, kept, inputs, outputs = [np.eye(n)], [np.eye(n)], list[Block](), list[Signal](), list[Signal]()
    found = iter(zip(turns, np.split(scale, np.cumsum(sizes)[:-1]), strict=True))
    for block, (w, z) in zip(blocks, block_slices(blocks), strict=True):
        left_turn, right_turn = np.eye(block.rows), np.eye(block.cols)
        if block.name in names:
            turn, own = next(found)
            left_turn, right_turn = own[:, None] * turn, (turn / own[:, None]).T
        into.append(left_turn)
        out.append(right_turn)
        size = left_turn.shape[1]
        kept += [block.resized(size) if block.name in names else block] if size else []
        inputs, outputs = [*inputs, *M.inputs[w][:size]], [*outputs, *M.outputs[z][: len(right_turn)]]
    into.append(np.eye(M.n_inputs - q))
    out.append(np.eye(M.n_outputs - p))
    whole = _block_diag(out) @ whole @ _block_diag(into)
    signals = [*inputs, *M.inputs[q:]], [*outputs, *M.outputs[p:]], M.states
    model = of_system_matrix(whole, n, M.dt, *signals, "reduction")
    return model, tuple(kept), np.array([max(miss_1, miss_2), difference])


def _invariant(a: Array, b: Array, sizes: Sequence[int], tolerance: float, b_size: float) -> tuple[list[Array], float]:
    """Return orthonormal bases V_i of the smallest subspaces with ``B_i, A_ij V_j in V_i``, and their residual."""
    ends = np.cumsum([0, *sizes])
    parts = [slice(int(first), int(last)) for first, last in itertools.pairwise(ends)]
    bases: list[Array] = [np.zeros((size, 0)) for size in sizes]
    fresh, size = b, b_size
    while True:
        found = []
        for i, part in enumerate(parts):
            new = _fresh_directions(fresh[part], bases[i], tolerance * size)
            found.append(new)
            bases[i] = np.hstack([bases[i], new])
        if not any(new.shape[1] for new in found):
            break
        fresh, size = a @ _block_diag(found), _norm(a)
    whole = _block_diag(bases)
    norm = max(b_size, _norm(a)) or 1.0
    missed = max(_norm(inside - whole @ (whole.T @ inside)) / norm for inside in (b, a @ whole))
    return bases, missed


def _fresh_directions(fresh: Array, basis: Array, limit: float) -> Array:
    """Return an orthonormal complement of ``basis`` for ``fresh``, singular values above the limit."""
    rest = fresh - basis @ (basis.T @ fresh)
    if not rest.size or basis.shape[1] == len(basis):
        return np.zeros((len(basis), 0))
    u, s, _ = np.linalg.svd(rest, full_matrices=False)
    new = u[:, s > limit]
    # Orthogonalised twice: the small directions of an SVD have rounding of the large ones.
    return np.linalg.qr(new - basis @ (basis.T @ new))[0] if new.shape[1] else new


def _block_diag(parts: Sequence[Array]) -> Array:
    from scipy.linalg import block_diag

    return np.asarray(block_diag(*parts))


def _norm(matrix: Array) -> float:
    return float(np.linalg.norm(matrix, 2)) if matrix.size else 0.0


def _difference(
    first: tuple[Array, Array, Array],
    first_sizes: Sequence[int],
    second: tuple[Array, Array, Array],
    sizes: Sequence[int],
) -> float:
    """Return the largest relative difference of both ``C Delta (I - A Delta)^-1 B`` at random complex deltas."""
    rng = np.random.default_rng(0)
    worst = 0.0
    for _ in range(POINTS):
        deltas = np.sqrt(rng.random(len(sizes))) * np.exp(2j * np.pi * rng.random(len(sizes)))
        maps, summands = [], 0.0
        for (a, b, c), repeats in ((first, first_sizes), (second, sizes)):
            d = np.repeat(deltas, repeats)
            loop = np.eye(len(a)) - a * d
            if loop.size and np.linalg.cond(loop) > 1 / UNCHANGED:
                return np.inf
            inside = d[:, None] * np.linalg.solve(loop, b) if loop.size else np.zeros((0, b.shape[1]))
            maps.append(c @ inside)
            summands = max(summands, float((np.abs(c) @ np.abs(inside)).max(initial=0.0)))
        size = max(float(np.abs(maps[0]).max(initial=0.0)), CANCELLED * summands) or 1.0
        worst = max(worst, float(np.abs(maps[0] - maps[1]).max(initial=0.0)) / size)
    return worst


# One step factors a variable out of every term that contains it: M = M0 + v L R = [I, v L] [M0; R] or [M0, L] [I; v R]
# with a constant L or R of the smallest inner size r, so v is repeated r times. The stacked matrix goes through the
# same step until it is constant, so that equal sub-expressions of different entries are realised once. The number of
# repetitions depends on the order of the variables; several orders are tried. Ranks are exact for rational numbers
# (arrays of objects), numerical for floats. Where M is affine in v, no LFT has fewer repetitions.


@dataclass(frozen=True)
class ConstantLft:
    """A constant matrix with Delta channels: ``z = d11 w + d12 u``, ``y = d21 w + d22 u``, ``w = Delta z``."""

    names: tuple[Any, ...]
    d11: Array
    d12: Array
    d21: Array
    d22: Array

    def inverse(self) -> ConstantLft:
        """Return the LFT of the inverse of a 1 x 1 matrix, not zero at Delta = 0."""
        gain = 1.0 / self.d22
        out = -gain @ self.d21
        return ConstantLft(self.names, self.d11 + self.d12 @ out, self.d12 @ gain, out, gain)

    def closed(self, gains: Mapping[Any, ConstantLft]) -> ConstantLft:
        """Substitute a 1 x 1 LFT for each channel; d11 is that of a tree, so it is nilpotent."""
        from scipy.linalg import block_diag

        parts = [gains[name] for name in self.names]
        n, r = len(parts), sum(len(part.names) for part in parts)
        sides = {"d11": (r, r), "d12": (r, n), "d21": (n, r), "d22": (n, n)}
        t11, t12, t21, t22 = (
            np.asarray(block_diag(*(getattr(part, name) for part in parts))).reshape(size)
            for name, size in sides.items()
        )
        around, loop = self.d11 @ t22, np.eye(len(parts))
        power = around
        while power.any():
            loop, power = loop + power, around @ power
        z_w, z_u = loop @ self.d11 @ t21, loop @ self.d12
        return ConstantLft(
            tuple(name for part in parts for name in part.names),
            t11 + t12 @ z_w, t12 @ z_u,
            self.d21 @ (t21 + t22 @ z_w), self.d22 + self.d21 @ t22 @ z_u,
        )  # fmt: skip


Exponents = tuple[int, ...]  # the power of each variable, in the order of the polynomial's names
Terms = Mapping[Exponents, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class MatrixPolynomial:
    """A matrix polynomial."""

    names: tuple[Hashable, ...]  # the variables
    terms: Terms  # exponents -> coefficient (m, n); the constant one is always there

    @property
    def is_affine(self) -> bool:
        return all(sum(exponents) <= 1 for exponents in self.terms)

    def __call__(self, t: Array) -> Array:
        """Evaluate the matrix (..., m, n) at t, shape (..., number of names)."""
        powers = np.stack([np.prod(t**exponents, axis=-1) for exponents in self.terms], axis=-1)
        coefficients: Any = np.stack(list(self.terms.values()))
        return np.tensordot(powers, coefficients, 1)


def polynomial_lft(polynomial: MatrixPolynomial, scale: Array, tolerance: float) -> ConstantLft:
    """Return the smallest LFT ``w = diag(t_k I) z`` of a polynomial among several orders of the variables."""
    rows, cols = scale[:, 0], scale[0] / scale[0, 0]
    plain = MatrixPolynomial(polynomial.names, {e: part / scale for e, part in polynomial.terms.items()})
    lft = decomposition(plain, tolerance)
    return ConstantLft(lft.names, lft.d11, lft.d12 * cols, rows[:, None] * lft.d21, lft.d22 * scale)


def decomposition(
    polynomial: MatrixPolynomial, tolerance: float = 0.0, weight: Callable[[Any], int] = lambda _: 1
) -> ConstantLft:
    """Return the LFT of a polynomial of least weight among several orders of the variables."""
    names, terms = polynomial.names, polynomial.terms
    least = sum(weight(name) for k, name in enumerate(names) if any(e[k] for e in terms))
    every = list(range(len(names)))
    orders = [every, every[::-1]]  # forwards, backwards, and with each one put first and last
    for k in every:
        rest = [j for j in every if j != k]
        orders += [[k, *rest], [*rest, k]]
    found: list[tuple[int, list[int], list[NDArray[Any]]]] = []
    for order in orders[:1] if polynomial.is_affine else orders:
        channels, *parts = _expanded(terms, order, tolerance)
        found.append((sum(weight(names[k]) for k in channels), channels, parts))
        if found[-1][0] == least:
            break
    _, channels, parts = min(found, key=lambda one: one[0])
    return ConstantLft(tuple(names[k] for k in channels), *(np.asarray(part, dtype=np.float64) for part in parts))


def _expanded(
    terms: Terms, order: Sequence[int], tolerance: float
) -> tuple[list[int], NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return the variable of each channel, and d11 .. d22; the first variable of the order is factored out."""
    occurring = {k for exponents in terms for k, e in enumerate(exponents) if e}
    some = next(iter(terms.values()))
    (m, n), zero = some.shape, (0,) * len(order)

    def zeros(rows: int, cols: int) -> NDArray[Any]:
        return np.zeros_like(some, shape=(rows, cols))

    if not occurring:
        return [], zeros(0, 0), zeros(0, n), zeros(m, 0), terms.get(zero, zeros(m, n))
    k = next(v for v in order if v in occurring)
    quotient = {(*e[:k], e[k] - 1, *e[k + 1 :]): part for e, part in terms.items() if e[k]}
    parts = list(quotient.values())
    left, below = rank_factors(np.hstack(parts), tolerance)
    if left.shape[1] > len(rank_factors(np.vstack(parts), tolerance)[1]):  # a constant R: as L of the transposed
        names, d11, d12, d21, d22 = _expanded({e: part.T for e, part in terms.items()}, order, tolerance)
        return names, d11.T, d21.T, d12.T, d22.T
    r, rest = left.shape[1], {zero: zeros(m, n)} | {e: part for e, part in terms.items() if not e[k]}
    low = dict(zip(quotient, np.hsplit(below, len(parts)), strict=True))
    stacked = {e: np.vstack([rest.get(e, zeros(m, n)), low.get(e, zeros(r, n))]) for e in {**rest, **low}}
    names, d11, d12, d21, d22 = _expanded(stacked, order, tolerance)
    # z = the last r outputs, y += left w
    inner = np.block([[zeros(r, r), d21[m:]], [zeros(len(names), r), d11]])
    return [k] * r + names, inner, np.vstack([d22[m:], d12]), np.hstack([left, d21[:m]]), d22[:m]


def rank_factors(matrix: NDArray[Any], tolerance: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return ``matrix = left @ right`` with as few columns of left as its entries above the tolerance require."""
    if matrix.dtype == object:
        return _exact_rank_factors(matrix)
    # Elimination with full pivoting keeps zeros of rows and columns exact, unlike an SVD.
    rest = matrix.copy()
    columns, rows = [rest[:, :0]], [rest[:0]]
    while np.abs(rest).max(initial=0.0) > tolerance:
        i, j = np.unravel_index(np.argmax(np.abs(rest)), rest.shape)
        root, sign = np.sqrt(abs(rest[i, j])), np.sign(rest[i, j])
        column, row = rest[:, [j]] / root, rest[[i], :] * (sign / root)
        columns.append(column)
        rows.append(row)
        rest = rest - column @ row
        rest[i, :], rest[:, j] = 0.0, 0.0
    return np.hstack(columns), np.vstack(rows)


def _exact_rank_factors(matrix: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Do the same for rational numbers (flint); right consists of rows of the matrix, the sparsest possible."""
    from flint import fmpq_mat

    order = np.argsort((matrix != 0).sum(axis=1), kind="stable")
    echelon, rank = fmpq_mat(matrix.shape[1], len(matrix), matrix[order].T.ravel().tolist()).rref()
    entries = np.array(echelon.tolist(), dtype=object).reshape(matrix.shape[1], len(matrix))[:rank]
    left = np.zeros_like(matrix, shape=(len(matrix), rank))
    left[order] = entries.T
    return left, matrix[order[(entries != 0).argmax(axis=1)]] if rank else matrix[:0]
