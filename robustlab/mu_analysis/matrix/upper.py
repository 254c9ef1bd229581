"""Upper bounds of mu with the D and G that prove them, and the proof from these alone.

Fan, Tits, Doyle (1991); Rump, "Verification of positive definiteness", BIT 46 (2006).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from robustlab.arrays import Array, ComplexArray, Indices, Mask
from robustlab.budget import MILLION
from robustlab.display import Displayable
from robustlab.mu_analysis.matrix.block_structure import (
    Component,
    ScalingSpace,
    balancing_exponents,
    components,
    entries,
    expand,
    hermitian,
    relative,
    scaling_space,
    supply,
)
from robustlab.uncertainty.blocks import Block, FullBlock, RealScalar, structure_size

EPS = float(np.finfo(float).eps)
WORK = 60 * MILLION  # the usual work of a proof at effort 1
# Ratios of D between successive components; smaller: less effect of their coupling, fewer digits.
RATIOS = (2.0**-10, 2.0**-20, 2.0**-40, 2.0**-80)
NEAR = 1 + 1e-9  # a bound within this factor of that of the components is kept
START = 1.3  # first t of the primal-dual method, for M of norm 1: D = I, G = 0 is feasible there
MOST_STEPS = 150  # of the primal-dual method


@dataclass(frozen=True)
class UpperBound(Displayable):
    r"""``mu(M) <= beta``, proved by :math:`M^* D_z M + j (G M - M^* G^*) - \beta^2 D_w \preceq 0`."""

    beta: float
    Dw: ComplexArray
    Dz: ComplexArray
    G: ComplexArray


@cache
def compile_kernels() -> None:
    """Compile the kernels, some seconds once per installation; call it before a time limit starts."""
    blocks = (RealScalar("real"), FullBlock("full", 2, 2))
    upper_bounds(np.array([[[1.0, 2.0, 1j], [0.5, 1j, 1.0], [3.0, 1.0, 0.2]]]), blocks)


def upper_bounds(M: ComplexArray, blocks: Sequence[Block], tol: float = 1e-6) -> list[UpperBound]:
    """Return the certified D-G upper bound of each matrix of the stack M (k, p, q)."""
    split = [components(m, blocks) for m in M]
    # Components with the same blocks are solved together.
    batches: dict[tuple[int, ...], list[tuple[int, Component]]] = {}
    for k, found in enumerate(split):
        for component in found:
            batches.setdefault(component.members, []).append((k, component))
    solved: dict[tuple[int, tuple[int, ...]], UpperBound] = {}
    for members, places in batches.items():
        stack = np.stack([component.matrix for _, component in places])
        bounds = _component_bounds(stack, [blocks[i] for i in members], tol)
        solved |= {(k, members): bound for (k, _), bound in zip(places, bounds, strict=True)}
    parts = [[solved[k, component.members] for component in found] for k, found in enumerate(split)]
    floor = [max((b.beta for b in part), default=0.0) for part in parts]
    best: dict[int, UpperBound] = {}
    # Couplings run from a lower to a higher depth only: a much smaller D at each depth makes them negligible.
    for ratio in RATIOS:
        todo = [k for k in range(len(M)) if k not in best or (len(parts[k]) > 1 and best[k].beta > floor[k] * NEAR)]
        if not todo:
            break
        placed = zip(*(_placed(blocks, split[k], parts[k], ratio) for k in todo), strict=True)
        for k, bound in zip(todo, _certified(M[todo], *map(np.stack, placed)), strict=True):
            best[k] = bound if k not in best or bound.beta < best[k].beta else best[k]
    for k, found in enumerate(split):
        if not any(component.matrix.any() for component in found):
            # Strictly block triangular: det(I - M Delta) = 1 for every Delta; D proves it in the limit only.
            best[k] = replace(best[k], beta=0.0)
    return [best[k] for k in range(len(M))]


def _component_bounds(M: ComplexArray, blocks: list[Block], tol: float) -> list[UpperBound]:
    if len(blocks) == 1 and (structure_size(blocks) == (1, 1) or (blocks[0].d_order == 1 and not blocks[0].g_basis())):
        return [_single(m, blocks) for m in M]
    # The methods are sized for matrices of order one; powers of two scale exactly, and G like M.
    size = np.exp2(np.rint(np.log2(np.maximum(np.abs(M).max(axis=(1, 2)), 1e-300))))
    space = scaling_space(tuple(blocks))
    M_one = M / size[:, None, None]
    bounds = _certified(M_one, *space.matrices(primal_dual(M_one, space, tol)))
    result = []
    for m, s, bound in zip(M, size, bounds, strict=True):
        best = UpperBound(bound.beta * s, bound.Dw, bound.Dz, bound.G * s)
        plain = _single(m, blocks) if best.beta >= 0.99 * np.linalg.norm(m, 2) else best
        result.append(plain if plain.beta < best.beta else best)
    return result


def _certified(M: ComplexArray, Dw: ComplexArray, Dz: ComplexArray, G: ComplexArray) -> list[UpperBound]:
    levels = certified_levels(M, Dw, Dz, G)
    return [UpperBound(float(beta), *parts) for beta, *parts in zip(levels, Dw, Dz, G, strict=True)]


def _single(m: ComplexArray, blocks: Sequence[Block]) -> UpperBound:
    """Return the bound by the largest singular value (D = I, G = 0); with G for one real number and complex M."""
    q, p = structure_size(blocks)
    Dw, Dz, G = np.eye(q, dtype=complex), np.eye(p, dtype=complex), np.zeros((q, p), dtype=complex)
    if m.size == 1 and blocks[0].g_basis() and abs(m[0, 0].imag) > 1e-12 * abs(m[0, 0]):
        # |m|^2 - 2 g Im m < 0
        G[0, 0] = abs(m[0, 0]) * (abs(m[0, 0]) / m[0, 0].imag)
    return UpperBound(certified_level(m, Dw, Dz, G), Dw, Dz, G)


def _placed(
    blocks: Sequence[Block], found: list[Component], parts: list[UpperBound], ratio: float
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return D and G of all components in the coordinates of M."""
    q, p = structure_size(blocks)
    Dw, Dz = np.zeros((q, q), dtype=complex), np.zeros((p, p), dtype=complex)
    G = np.zeros((q, p), dtype=complex)
    for component, bound in zip(found, parts, strict=True):
        part = [blocks[i] for i in component.members]
        e_w, e_z = (np.exp2(e) for e in expand(part, component.exponents))
        w, z = entries(blocks, component.members)
        weight = ratio**component.depth
        Dw[w[:, None], w] = weight * bound.Dw * e_w[:, None] * e_w[None, :]
        Dz[z[:, None], z] = weight * bound.Dz * e_z[:, None] * e_z[None, :]
        G[w[:, None], z] = weight * bound.G * e_w[:, None] * e_z[None, :]
    return Dw, Dz, G


def points_work(blocks: Sequence[Block], count: int) -> int:
    """Return the measured work of `points_below` for this number of matrices: 10 Newton systems each."""
    n, size = max(structure_size(blocks)), scaling_space(tuple(blocks)).size
    return 800 + count * (200 + n**3 // 14 + size**2 // 3 + size**3 // 500)


def points_below(M: ComplexArray, blocks: Sequence[Block], target: float, *, thorough: bool = True) -> list[UpperBound]:
    """Return for each matrix D, G well inside those that prove ``target``, or the best ones where none does."""
    # Unlike upper_bounds it stops early, and does not split: the scalings must be good at neighbouring frequencies.
    # Not thorough: estimates decide whether the target is infeasible.
    exponents = balancing_exponents(M, blocks)
    w, z = (np.exp2(np.stack(e)) for e in zip(*(expand(blocks, e) for e in exponents), strict=True))
    balanced = M * z[:, :, None] / w[:, None, :]
    space = scaling_space(tuple(blocks))
    x = primal_dual(balanced, space, 1e-4, target if target > 0 else None, thorough)
    Dw, Dz, G = space.matrices(x)
    w_in, z_out = w[:, :, None], z[:, :, None]
    return _certified(M, Dw * w_in * w[:, None, :], Dz * z_out * z[:, None, :], G * w_in * z[:, None, :])


# --- proof --------------------------------------------------------------------------------------------------------
#
# Any D > 0 and G of the structure prove mu(M) <= beta where beta^2 D_w - M^* D_z M - j (G M - M^* G^*) >= 0; a bound of
# all rounding errors is included.


def proves(M: ComplexArray, Dw: ComplexArray, Dz: ComplexArray, G: ComplexArray, beta: float) -> bool:
    """Return whether D > 0 and N(beta) >= 0 hold for all rounding errors of this evaluation."""
    # Scaling by powers of two is exact; the rounding error of N is bounded entry by entry, and a Cholesky
    # factorisation of N minus that bound has to succeed.
    inequality = _Inequality(M[None], Dw[None], Dz[None], G[None])
    return bool(inequality.proves(np.array([beta]) / inequality.unit, np.array([0]))[0])


def certified_level(M: ComplexArray, Dw: ComplexArray, Dz: ComplexArray, G: ComplexArray) -> float:
    """Return the level of D and G, raised until `proves` holds; inf where it never does."""
    return float(certified_levels(M[None], Dw[None], Dz[None], G[None])[0])


def certified_levels(M: ComplexArray, Dw: ComplexArray, Dz: ComplexArray, G: ComplexArray) -> Array:
    """Return `certified_level` of each matrix of a stack, shape (k,)."""
    if not M.size:
        return np.zeros(len(M))
    inequality = _Inequality(M, Dw, Dz, G)
    squares = inequality.squares()
    raised = inequality.allowance(np.sqrt(np.maximum(squares, 0.0)))
    zero = ~M.any(axis=(1, 2))
    result = np.where(zero, 0.0, np.inf)
    # beta^2 is raised by the allowance for rounding errors, then in steps of a factor of four.
    todo = np.flatnonzero(~zero & np.isfinite(squares) & np.isfinite(raised))
    for _ in range(40):
        if not len(todo):
            break
        beta = np.sqrt(np.maximum(squares[todo] + raised[todo], 0.0))
        proved = inequality.proves(beta, todo)
        result[todo[proved]] = beta[proved] * inequality.unit[todo[proved]]
        todo = todo[~proved]
        raised[todo] *= 4
    return result


class _Inequality:
    """``N(beta) = beta^2 D_w - supply`` of a stack, with the bounds of its rounding errors."""

    def __init__(self, M: ComplexArray, Dw: ComplexArray, Dz: ComplexArray, G: ComplexArray) -> None:
        with np.errstate(over="ignore", invalid="ignore"):
            # D's diagonals are scaled to 1/2 .. 2 by a congruence with powers of two, free of rounding.
            diagonals = (np.maximum(np.einsum("kii->ki", d).real, 1e-300) for d in (Dw, Dz))
            w, z = (np.exp2(np.round(-0.5 * np.log2(d))) for d in diagonals)
            M, G = M * w[:, None, :] / z[:, :, None], G * w[:, :, None] * z[:, None, :]
            Dw, Dz = Dw * w[:, :, None] * w[:, None, :], Dz * z[:, :, None] * z[:, None, :]
            largest = np.abs(M).max(axis=(1, 2), initial=0.0)
            usual = (largest > 0) & np.isfinite(largest)
            self.unit = np.exp2(np.rint(np.log2(np.where(usual, largest, 1.0))))
            M, G = M / self.unit[:, None, None], G / self.unit[:, None, None]
            value, size = supply(M, Dz, G), np.abs(M)
            cross = np.abs(G) @ size
            bound = np.swapaxes(size, 1, 2) @ np.abs(Dz) @ size + cross + np.swapaxes(cross, 1, 2)
        self.supply, self.Dw = (value + hermitian(value)) / 2, Dw
        # Complex products of two factors, summed over p and q terms.
        self.gamma = 4 * (sum(M.shape[1:]) + 4) * EPS
        self.bound, self.d_bound = bound.sum(axis=2), np.abs(Dw).sum(axis=2)
        sums = self.supply.sum(axis=(1, 2)) + Dz.sum(axis=(1, 2)) + self.bound.sum(axis=1) + self.d_bound.sum(axis=1)
        self.finite = np.isfinite(sums)
        self.supply[~self.finite] = self.Dw[~self.finite] = np.eye(self.Dw.shape[1])

    def squares(self) -> Array:
        """Return the smallest t of ``t D_w - supply >= 0``; inf where D is not positive definite."""
        result = np.full(len(self.Dw), np.inf)
        good = np.flatnonzero(self.finite & _positive_definite(self.Dw, np.zeros(len(self.Dw))))
        if len(good):
            result[good] = np.linalg.eigvalsh(relative(self.Dw[good], self.supply[good]))[:, -1]
        return result

    def error(self, beta: Array, which: Any = slice(None)) -> Array:
        """Bound the rounding error of N(beta) in the 2-norm."""
        rows = self.bound[which] + beta[:, None] ** 2 * self.d_bound[which]
        return self.gamma * rows.max(axis=1, initial=0.0)

    def allowance(self, beta: Array) -> Array:
        """Estimate the increase of beta^2 above its level that a proof needs."""
        smallest = np.linalg.eigvalsh(self.Dw)[:, 0]
        with np.errstate(over="ignore", invalid="ignore"):  # NaN proves nothing
            traces = np.einsum("kii->k", beta[:, None, None] ** 2 * self.Dw - self.supply).real
            needed = self.error(beta) + 4 * (self.Dw.shape[1] + 2) * EPS * np.maximum(traces, 0.0)
            return 2 * needed / np.where(smallest > 0, smallest, np.nan) + 1e-300

    def proves(self, beta: Array, which: Indices) -> Mask:
        """Return whether D > 0 and N(beta) >= 0 hold for all rounding errors, for each of these matrices."""
        sure = self.finite[which] & np.isfinite(beta)
        beta = np.where(sure, beta, 0.0)
        n = beta[:, None, None] ** 2 * self.Dw[which] - self.supply[which]
        sure &= _positive_definite(n, self.error(beta, which))
        return sure & _positive_definite(self.Dw[which], np.zeros(len(beta)))


def _positive_definite(X: ComplexArray, error: Array) -> Mask:
    n = X.shape[1]
    if n == 0:
        return np.ones(len(X), dtype=bool)
    diagonal = np.einsum("kii->ki", X).real
    finite = np.isfinite(X).all(axis=(1, 2)) & np.isfinite(error)
    result = finite & (diagonal.min(axis=1) > 0)
    shift = error + 4 * (n + 2) * EPS * diagonal.sum(axis=1)
    shifted = X[result] - shift[result][:, None, None] * np.eye(n)
    result[result] = _factorises(shifted)
    return result


def _factorises(X: ComplexArray) -> Mask:
    """Return whether the Cholesky factorisation succeeds, for each matrix of the stack."""
    try:
        np.linalg.cholesky(X)
    except np.linalg.LinAlgError:
        if len(X) == 1:
            return np.array([False])
        return np.concatenate([_factorises(X[i : i + 1]) for i in range(len(X))])
    return np.ones(len(X), dtype=bool)


# --- primal-dual method (compiled): min t with F = t D_w ---
#
# Optimality: <Z, D_w> = 1, <Z, F_i> + <Y, D_i> = eta tr D_i, F Z = 0, D Y = 0 with Z, Y >= 0. The zeros of the last
# two are replaced by nu I, which Mehrotra's Newton steps reduce from the analytic centre of a large t; the only product
# of unknowns is t D, and the problem is quasiconvex, so a stationary point is the optimum. About ten Newton systems
# suffice where nu falls with t. Where M is nearly real, or damping is light, nu may rise for smaller t: there the path
# is followed in t, along its tangent, with centring after each step, about fifty systems. The gap counts where the dual
# proves it. Every x is feasible for its t: an early end loses tightness, never soundness. After an early end, a second
# method (path following) lowered no bound by more than 2e-4. Helmberg, Rendl, Vanderbei, Wolkowicz, "An interior-point
# method for semidefinite programming", SIAM J. Optim. 6 (1996); Mehrotra, SIAM J. Optim. 2 (1992); Boyd, El Ghaoui,
# Linear Algebra and its Applications 188 (1993).


def primal_dual(
    M: ComplexArray, space: ScalingSpace, tol: float = 1e-6, target: float | None = None, sure: bool = True
) -> Array:
    """Return parameters x (k, size) of the best D, G found for each balanced matrix of the stack M (k, p, q)."""
    # The search ends where t is known to tol, or the target is reached or infeasible: by a dual proof, if sure, else by
    # estimates, in a third of the steps.
    from robustlab.mu_analysis.matrix import primal_dual_kernels as kernels

    scale = np.maximum(np.linalg.norm(M, 2, axis=(1, 2)), 1e-300)
    goal = np.full(len(M), -np.inf) if target is None else (np.minimum(target, 1e3 * scale) / scale) ** 2
    entries, trace, low = _sparse_map(space)
    n, size = space.q + space.p, space.size
    W, J = np.empty((kernels.MATRICES, 2, space.q, space.q), dtype=complex), np.empty((3, n, n), dtype=complex)
    H, V = np.empty((size, size)), np.empty((kernels.VECTORS, max(size, n)))
    c = np.stack([space.coefficients, space.coefficients])
    x = np.empty((len(M), size))
    for k in range(len(M)):
        W[:], V[:] = 0.0, 0.0
        V[kernels.AT, :size], V[kernels.TRACE, :size] = space.identity, trace
        V[kernels.SHORT, :size] = kernels.SHORT_G * space.scales_with_m
        kernels.descend(W, J, H, V, M[k] / scale[k], c, entries, low, START, tol, goal[k], MOST_STEPS, sure)
        x[k] = V[kernels.BEST, :size]
    return np.where(space.scales_with_m, x * scale[:, None], x)  # G scales with M


def _sparse_map(space: ScalingSpace) -> tuple[Indices, Array, Indices]:
    """Return the entries of the sparse E(x) for the compiled code, the gradient of tr D_w, and first rows of blocks."""
    # D_w of a full block is a multiple of the identity: diagonal blocks of order one.
    orders = np.concatenate([[1] * b.rows if b.d_order == 1 else [b.rows] for b in space.blocks])
    low = np.repeat(np.cumsum(orders) - orders, orders)  # first row of the block of each row of D_w
    parameter = np.repeat(np.arange(space.size), np.diff(space.first, append=len(space.rows)))
    in_w, begin = np.flatnonzero(space.in_w), np.full(len(parameter), -1)
    _, first, block = np.unique(low[space.rows[in_w]], return_index=True, return_inverse=True)
    begin[in_w] = in_w[first][block]
    trace = np.bincount(parameter, (space.in_w > 0) & (space.rows == space.cols)).astype(float)
    return np.stack([space.rows, space.cols, parameter, begin]), trace, np.stack([0 * low, low])
