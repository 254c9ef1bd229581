"""Upper bounds of mu with the D and G that prove them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from robustlab.arrays import Array, ComplexArray, Indices
from robustlab.mu_analysis.matrix.certificate import certified_level, certified_levels
from robustlab.mu_analysis.matrix.decomposition import Component, balancing_exponents, components, entries, expand
from robustlab.mu_analysis.matrix.scalings import ScalingSpace, scaling_space
from robustlab.shown import Shown
from robustlab.uncertainty.blocks import Block, FullBlock, RealScalar, structure_size

# Of D between one component and the next, tried in turn; smaller: their coupling costs less, digits are lost.
RATIOS = (2.0**-10, 2.0**-20, 2.0**-40, 2.0**-80)
START = 1.3  # t at which a path of the primal-dual method begins, for M of norm 1: D = I, G = 0 is feasible there
MOST_STEPS = 150  # of it


@dataclass(frozen=True)
class UpperBound(Shown):
    r"""``mu(M) <= beta``, proved by :math:`M^* D_z M + j (G M - M^* G^*) - \beta^2 D_w \preceq 0`."""

    beta: float
    Dw: ComplexArray
    Dz: ComplexArray
    G: ComplexArray


@cache
def compile_kernels() -> None:
    """Compile what the bounds need, some seconds once in an installation; called before a limit's clock starts."""
    blocks = (RealScalar("real"), FullBlock("full", 2, 2))
    upper_bounds(np.array([[[1.0, 2.0, 1j], [0.5, 1j, 1.0], [3.0, 1.0, 0.2]]]), blocks)


def upper_bounds(M: ComplexArray, blocks: Sequence[Block], tol: float = 1e-6) -> list[UpperBound]:
    """The D-G upper bound of each matrix of the stack M (k, p, q), certified."""
    split = [components(m, blocks) for m in M]
    parts: list[dict[int, UpperBound]] = [{} for _ in split]
    # Matrices with the same zero pattern go through the solver together.
    batches: dict[tuple[int, ...], list[tuple[int, int]]] = {}
    for k, found in enumerate(split):
        for j, component in enumerate(found):
            batches.setdefault(component.members, []).append((k, j))
    for members, places in batches.items():
        stack = np.stack([split[k][j].matrix for k, j in places])
        solved = _component_bounds(stack, [blocks[i] for i in members], tol)
        for (k, j), bound in zip(places, solved, strict=True):
            parts[k][j] = bound
    done = [[part[j] for j in sorted(part)] for part in parts]
    whole = [k for k, found in enumerate(split) if len(found) == 1]
    placed = [_placed(blocks, split[k], done[k], 1.0) for k in whole]
    bounds: dict[int, UpperBound] = {}
    if whole:
        Dw, Dz, G = (np.stack(parts) for parts in zip(*placed, strict=True))
        bounds = dict(zip(whole, _certified(M[whole], Dw, Dz, G), strict=True))
    return [bounds[k] if k in bounds else _assemble(M[k], blocks, split[k], done[k]) for k in range(len(M))]


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
    """The largest singular value (D = I, G = 0); of one real number G takes all of a value that is not real."""
    q, p = structure_size(blocks)
    Dw, Dz, G = np.eye(q, dtype=complex), np.eye(p, dtype=complex), np.zeros((q, p), dtype=complex)
    if m.size == 1 and blocks[0].g_basis() and abs(m[0, 0].imag) > 1e-12 * abs(m[0, 0]):
        # |m|^2 - 2 g Im m < 0
        G[0, 0] = abs(m[0, 0]) * (abs(m[0, 0]) / m[0, 0].imag)
    return UpperBound(certified_level(m, Dw, Dz, G), Dw, Dz, G)


def _assemble(M: ComplexArray, blocks: Sequence[Block], found: list[Component], parts: list[UpperBound]) -> UpperBound:
    """D and G of the whole matrix from those of its components, certified once more on M itself."""
    # Couplings run from a lower to a higher depth only: with a D much smaller than that of the depth before they cost
    # nothing.
    floor = max((b.beta for b in parts), default=0.0)
    best: UpperBound | None = None
    for ratio in RATIOS if max((c.depth for c in found), default=0) else (1.0,):
        Dw, Dz, G = _placed(blocks, found, parts, ratio)
        beta = certified_level(M, Dw, Dz, G)
        if best is None or beta < best.beta:
            best = UpperBound(beta, Dw, Dz, G)
        if best.beta <= floor * (1 + 1e-9):
            break
    assert best is not None
    if floor == 0.0 and all(not component.matrix.any() for component in found):
        # Strictly block triangular: det(I - M Delta) = 1 for every Delta. D shows it in the limit of the ratio only.
        return UpperBound(0.0, best.Dw, best.Dz, best.G)
    return best


def _placed(
    blocks: Sequence[Block], found: list[Component], parts: list[UpperBound], ratio: float
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """D and G of all components, in the coordinates of M, as those of the whole."""
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
    """Work of `points_below` for so many matrices, as measured: 10 Newton systems each, where D, G are not easy."""
    n, size = max(structure_size(blocks)), scaling_space(tuple(blocks)).size
    return 800 + count * (200 + n**3 // 14 + size**2 // 3 + size**3 // 500)


def points_below(M: ComplexArray, blocks: Sequence[Block], target: float, *, thorough: bool = True) -> list[UpperBound]:
    """For each matrix of the stack D, G well inside those that prove ``target``, or the best ones where none does."""
    # Unlike upper_bounds it stops early, and does not split: the scalings shall stay good at neighbouring frequencies.
    # Not thorough: what estimates tell is out of reach is believed.
    exponents = np.stack([balancing_exponents(m, blocks) for m in M])
    w, z = (np.exp2(np.stack(e)) for e in zip(*(expand(blocks, e) for e in exponents), strict=True))
    balanced = M * z[:, :, None] / w[:, None, :]
    space = scaling_space(tuple(blocks))
    x = primal_dual(balanced, space, 1e-4, target if target > 0 else None, thorough)
    Dw, Dz, G = space.matrices(x)
    w_in, z_out = w[:, :, None], z[:, :, None]
    return _certified(M, Dw * w_in * w[:, None, :], Dz * z_out * z[:, None, :], G * w_in * z[:, None, :])


# --- the primal-dual method (compiled): min t where F = t D_w - M^* D_z M - j (G M - M^* G^*) >= 0, D >= 0, tr D = n
# ---
#
# Optimality: <Z, D_w> = 1, <Z, F_i> + <Y, D_i> = eta tr D_i, F Z = 0, D Y = 0 with Z, Y >= 0. The zeros of the last
# two are moved to nu I and followed down by Newton steps in Mehrotra's way from the analytic centre of a large t; the
# only product of unknowns is t D, and the problem is quasiconvex, so a stationary point is the optimum. About ten
# Newton systems do where nu falls all the way with t. Where M is nearly real, or modes are light, the centres of
# smaller t have a larger nu for a while: there the path is followed by t, along its tangent, each step centred again,
# about fifty systems. The gap is believed where the dual proves it. Every x met is feasible for its t: stopping early
# costs tightness, never soundness. Where it ends early, a second method (path following) lowered no bound by more than
# 2e-4. Helmberg, Rendl, Vanderbei, Wolkowicz, "An interior-point method for semidefinite programming", SIAM J. Optim.
# 6 (1996); Mehrotra, SIAM J. Optim. 2 (1992); Boyd, El Ghaoui, Linear Algebra and its Applications 188 (1993).


def primal_dual(
    M: ComplexArray, space: ScalingSpace, tol: float = 1e-6, target: float | None = None, sure: bool = True
) -> Array:
    """Parameters x (k, size) of the best D, G found for each balanced matrix of the stack M (k, p, q)."""
    # The search ends where t is known to tol, or where target is reached or out of reach: shown by a dual, if sure,
    # else by estimates, in a third of the steps.
    from robustlab.mu_analysis.matrix import primal_dual_kernels as kernels

    scale = np.maximum(np.linalg.norm(M, 2, axis=(1, 2)), 1e-300)
    goal = np.full(len(M), -np.inf) if target is None else (np.minimum(target, 1e3 * scale) / scale) ** 2
    entries, trace, orders = _sparse_map(space)
    n, size = space.q + space.p, space.size
    W, J = np.empty((kernels.MATRICES, 2 * space.q, space.q), dtype=complex), np.empty((3, n, n), dtype=complex)
    H, V = np.empty((size, size)), np.empty((kernels.VECTORS, max(size, n)))
    c = np.stack([space.coefficients, space.coefficients])
    x = np.empty((len(M), size))
    for k in range(len(M)):
        W[:], V[:] = 0.0, 0.0
        V[kernels.AT, :size], V[kernels.TRACE, :size] = space.identity, trace
        V[kernels.SHORT, :size] = kernels.SHORT_G * space.scales_with_m
        kernels.descend(W, J, H, V, M[k] / scale[k], c, entries, orders, START, tol, goal[k], MOST_STEPS, sure)
        x[k] = V[kernels.BEST, :size]
    return np.where(space.scales_with_m, x * scale[:, None], x)  # G carries the unit of M


def _sparse_map(space: ScalingSpace) -> tuple[Indices, Array, Indices]:
    """The entries of the sparse E(x) as the compiled code reads them, the gradient of tr D_w, and orders of blocks."""
    # D_w of a full block is a multiple of the identity: diagonal blocks of order one.
    orders = np.concatenate([[1] * b.rows if b.d_order == 1 else [b.rows] for b in space.blocks])
    low = np.repeat(np.cumsum(orders) - orders, orders)  # where the block begins that a row of D_w lies in
    parameter = np.repeat(np.arange(space.size), np.diff(space.first, append=len(space.rows)))
    in_w = np.flatnonzero(space.in_w)
    of_block = low[space.rows[in_w]]
    place, begin = np.full((2, len(parameter)), -1)
    place[in_w] = space.cols[in_w] - of_block
    _, first, block = np.unique(of_block, return_index=True, return_inverse=True)
    begin[in_w] = in_w[first][block]
    trace = np.bincount(parameter, (space.in_w > 0) & (space.rows == space.cols)).astype(float)
    return np.stack([space.rows, space.cols, parameter, place, begin]), trace, np.append(space.q, orders)
