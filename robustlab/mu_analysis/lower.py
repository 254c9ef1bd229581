r"""Lower bounds of mu: the smallest Delta found that makes ``I - M Delta`` singular.

Complex structures: power iteration (Packard, Fan, Doyle). Any structure: sequential minimum-norm steps. With x, y the
right and left null directions of ``I - M Delta``, singularity is linear to first order, ``y^* M Delta x = y^* x``;
the Delta of smallest norm that fulfils it is known in closed form. Every Delta is projected to the structure and
checked by its singular values.

References
----------
Packard, Fan, Doyle, "A power method for the structured singular value" (1988). Young, Doyle, "Computation of mu with
real and complex uncertainties" (1990).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.mu_analysis.certificate import EPS, delta_norm, project, singularity
from robustlab.mu_analysis.decomposition import Component, components, expand
from robustlab.uncertainty.blocks import Block, FullBlock, RealScalar, block_slices, structure_size

__all__ = ["SINGULAR", "block_gains", "lower_bound", "smallest_step", "step_delta"]

Array = NDArray[np.floating[Any]]
ComplexArray = NDArray[np.complexfloating[Any, Any]]

# Relative smallest singular value below which I - M Delta counts as singular.
SINGULAR = 1e-11
# A Delta counts as attaining its bound where an exactly singular one lies within this share of its norm.
NEARBY = 1e-8


def lower_bound(
    M: ComplexArray, blocks: Sequence[Block], seed: int = 0, restarts: int = 12, steps: int = 40
) -> tuple[float, ComplexArray | None]:
    """``(1 / ||Delta||, Delta)`` for the smallest Delta (q, p) found, or ``(0, None)``.

    Parameters
    ----------
    M
        Complex matrix (p, q).
    seed
        Seed of the starting directions; the same seed gives the same Delta.
    """
    best: tuple[float, ComplexArray | None] = (0.0, None)
    for component in components(M, blocks):
        if not component.matrix.any():
            continue
        part = [blocks[i] for i in component.members]
        # The steps below are sized for a matrix of order one.
        size = float(np.exp2(np.rint(np.log2(np.abs(component.matrix).max()))))
        found = [c / size for c in _candidates(component.matrix / size, part, seed, restarts, steps)]
        candidates = [(delta_norm(part, c), c) for c in found]
        for norm, candidate in sorted(candidates, key=lambda pair: pair[0]):
            if not 0 < norm < np.inf:
                continue
            if 1 / norm <= best[0]:
                break
            delta = _embed(candidate, blocks, component)
            close = singularity(component.matrix, candidate) <= SINGULAR and singularity(M, delta) <= 1e3 * SINGULAR
            if close and _singular_nearby(component.matrix, part, candidate):
                best = (1 / delta_norm(blocks, delta), delta)
    return best


def _singular_nearby(M: ComplexArray, blocks: Sequence[Block], delta: ComplexArray) -> bool:
    r"""Whether a Delta of the structure within ``NEARBY`` of this one makes ``I - M Delta`` singular to first order.

    A small singular value alone does not say so: that of ``I - M Delta`` for a nilpotent M falls like
    ``1 / ||Delta||``, and no Delta at all makes it zero.
    """
    loop = np.eye(len(M)) - M @ delta
    # Rows and columns may carry any scaling; with the largest entries at one, singular values keep their digits.
    rows, cols = np.ones(len(loop)), np.ones(len(loop))
    for _ in range(3):
        rows /= _power_of_two(np.abs(loop * rows[:, None] * cols).max(axis=1))
        cols /= _power_of_two(np.abs(loop * rows[:, None] * cols).max(axis=0))
    u, sigma, vh = np.linalg.svd(loop * rows[:, None] * cols)
    y, x, smallest = rows * u[:, -1], cols * np.conj(vh[-1]), sigma[-1]
    rounding = 4 * len(M) * EPS * np.abs(y) @ (np.eye(len(M)) + np.abs(M) @ np.abs(delta)) @ np.abs(x)
    if smallest <= rounding:
        return True
    row = (np.conj(y) @ M)[None] / smallest
    gains = block_gains(blocks, row, x[None])
    real = np.array([isinstance(b, RealScalar) for b in blocks])
    with np.errstate(over="ignore", invalid="ignore"):
        step = smallest_step(gains, real)
        reached = (np.where(real, gains * step, np.abs(gains * step))).sum()
    return bool(abs(reached - 1) < 0.1 and np.abs(step).max() <= NEARBY * delta_norm(blocks, delta))


def _power_of_two(size: Array) -> Array:
    return np.exp2(np.rint(np.log2(np.where(size > 0, size, 1.0))))


def _candidates(M: ComplexArray, blocks: list[Block], seed: int, restarts: int, steps: int) -> list[ComplexArray]:
    """Delta of exactly the structure, most of them close to singular; M is balanced."""
    q, p = structure_size(blocks)
    rng = np.random.default_rng(seed)
    x, y = rng.standard_normal((2, restarts, p, 2)) @ np.array([1, 1j])
    u, _, vh = np.linalg.svd(M)
    x[0], y[0] = u[:, 0], u[:, 0]
    if restarts > 1 and p == q:
        x[1], y[1] = np.conj(vh[0]), u[:, 0]
    found = _minimum_norm_steps(M, blocks, x, y, steps=steps, rng=rng)
    if not any(isinstance(b, RealScalar) for b in blocks):
        found.extend(_power_iteration(M, blocks, rng, restarts, 2 * steps))
    if all(isinstance(b, RealScalar) for b in blocks):
        found.extend(_vertex_rays(M, blocks, rng, 2 * restarts))
    return found


# --- sequential minimum-norm steps -----------------------------------------------------------------------------------


def _minimum_norm_steps(
    M: ComplexArray, blocks: list[Block], x: ComplexArray, y: ComplexArray, *, steps: int, rng: np.random.Generator
) -> list[ComplexArray]:
    """Iterate from each pair of directions x, y (k, p) at once."""
    k, p = x.shape
    real = np.array([isinstance(b, RealScalar) for b in blocks])
    eye = np.eye(p)
    delta: ComplexArray | None = None
    found: list[ComplexArray] = []
    for step in range(steps):
        inner = (np.conj(y) * x).sum(axis=1)
        inner = np.where(np.abs(inner) < 1e-8, 1e-8, inner)
        row = (np.conj(y) @ M) / inner[:, None]
        new = step_delta(blocks, smallest_step(block_gains(blocks, row, x), real), row, x)
        # The first steps may be damped at random: undamped ones can cycle. The last ones converge like Newton's.
        damped = 8 < step < steps - 12
        gain = 0.6 + 0.4 * rng.random((k, 1, 1)) if damped else 1.0
        delta = new if delta is None else delta + gain * (new - delta)
        delta = np.clip(delta.real, -1e9, 1e9) + 1j * np.clip(delta.imag, -1e9, 1e9)
        loop = eye - M @ delta
        # Inverse iteration for the null directions; the shift keeps an exactly singular loop solvable.
        shift = 1e-13 * (1 + np.abs(loop).max(axis=(1, 2)))
        try:
            inverse = np.linalg.inv(loop + shift[:, None, None] * eye)
        except np.linalg.LinAlgError:
            break
        x = _unit(np.einsum("kij,kj->ki", inverse, x), x)
        y = _unit(np.einsum("kji,kj->ki", np.conj(inverse), y), y)
        if step >= steps - 2:
            found.extend(_completed(M, blocks, d) for d in delta)
    return found


def _vertex_rays(M: ComplexArray, blocks: list[Block], rng: np.random.Generator, count: int) -> list[ComplexArray]:
    """Along the ray through a vertex V of the box, ``I - t M V`` is singular where 1 / t is an eigenvalue of M V."""
    found = []
    for k in range(count):
        signs = np.ones(len(blocks)) if k == 0 else rng.choice([-1.0, 1.0], len(blocks))
        vertex = np.diag(np.repeat(signs, [b.rows for b in blocks])).astype(complex)
        eigenvalues = np.linalg.eigvals(M @ vertex)
        real = eigenvalues.real[np.abs(eigenvalues.imag) <= 1e-9 * np.abs(eigenvalues)]
        if len(real) and np.abs(real).max() > 0:
            found.append(vertex / real[np.abs(real).argmax()])
    return found


def block_gains(blocks: Sequence[Block], row: ComplexArray, x: ComplexArray) -> ComplexArray:
    """Factors a (k, n_blocks) in ``row Delta x = sum a_i delta_i``; ``|row_i| |x_i|`` for a full block."""
    gains = np.empty((len(x), len(blocks)), dtype=complex)
    for i, (block, (w, z)) in enumerate(zip(blocks, block_slices(blocks), strict=True)):
        if isinstance(block, FullBlock):
            gains[:, i] = np.linalg.norm(row[:, w], axis=1) * np.linalg.norm(x[:, z], axis=1)
        else:
            gains[:, i] = (row[:, w] * x[:, z]).sum(axis=1)
    return gains


def step_delta(blocks: Sequence[Block], values: ComplexArray, row: ComplexArray, x: ComplexArray) -> ComplexArray:
    """Delta (k, q, p) from one number per block (k, n_blocks); full blocks point along row and x."""
    q, p = structure_size(blocks)
    delta = np.zeros((len(values), q, p), dtype=complex)
    for i, (block, (w, z)) in enumerate(zip(blocks, block_slices(blocks), strict=True)):
        if isinstance(block, FullBlock):
            left, right = _unit(np.conj(row[:, w])), _unit(np.conj(x[:, z]))
            delta[:, w, z] = values[:, i, None, None] * left[:, :, None] * right[:, None, :]
        else:
            delta[:, w, z] = values[:, i, None, None] * np.eye(block.repeats)
    return delta


def smallest_step(a: ComplexArray, real: NDArray[np.bool_]) -> ComplexArray:
    r"""The d (k, n) of smallest maximum modulus with ``sum a_i d_i = 1``, d_i real where ``real``.

    The dual is a convex function of one number alpha,
    ``f = sum_R |Re a_i + alpha Im a_i| + sqrt(1 + alpha^2) sum_C |a_i|``, whose minimum is ``1 / max |d_i|``: either
    at a kink, where that one real d_i is inside its range, or at a smooth point between two.
    """
    k = len(a)
    rows = np.arange(k)
    re, im = a.real[:, real], a.imag[:, real]
    total = np.abs(a[:, ~real]).sum(axis=1)
    alpha, kink = np.zeros(k), np.full(k, -1)
    if re.shape[1]:
        alpha, kink = _dual_minimum(re, im, total)
    value = np.abs(re + alpha[:, None] * im).sum(axis=1) + np.sqrt(1 + alpha**2) * total
    tau = 1 / np.maximum(value, 1e-300)
    inside = np.zeros(k)
    sign = np.sign(re + alpha[:, None] * im)
    phase = np.exp(1j * np.arctan(alpha))
    has = kink >= 0
    if has.any():
        # At a kink the two real equations of sum a d = 1 fix tau and the one free d.
        sign[rows[has], kink[has]] = 0
        sum_others = (sign * (re + 1j * im)).sum(axis=1) + phase * total
        free = (re + 1j * im)[rows, np.maximum(kink, 0)]
        determinant = sum_others.real * free.imag - sum_others.imag * free.real
        safe = np.where(determinant == 0, 1.0, determinant)
        tau = np.where(has & (determinant != 0), free.imag / safe, tau)
        inside = np.where(has & (determinant != 0), -sum_others.imag / safe, 0.0)
    d = np.empty(a.shape, dtype=complex)
    reals = tau[:, None] * sign
    if has.any():
        reals[rows[has], kink[has]] = inside[has]
    d[:, real] = reals
    unit = np.conj(a[:, ~real]) / np.maximum(np.abs(a[:, ~real]), 1e-300)
    d[:, ~real] = tau[:, None] * unit * phase[:, None]
    return np.where(np.isfinite(d), d, 0.0)


def _dual_minimum(re: Array, im: Array, total: Array) -> tuple[Array, NDArray[np.intp]]:
    """Minimiser alpha of the dual of `smallest_step`, and the index of the kink it sits at (-1: none)."""
    rows = np.arange(len(re))
    size = np.abs(re) + np.abs(im)
    straight = np.abs(im) <= 1e-13 * np.maximum(size.max(axis=1, keepdims=True), 1e-300)
    im = np.where(straight, 0.0, im)
    # A real direction without a kink never changes sign; alpha = 0 stands in for it and changes nothing.
    kinks = np.where(straight, 0.0, -re / np.where(straight, 1.0, im))
    values = np.abs(re[:, None, :] + kinks[:, :, None] * im[:, None, :])
    f = values.sum(axis=2) + np.sqrt(1 + kinks**2) * total[:, None]
    best = f.argmin(axis=1)
    alpha = kinks[rows, best]
    own = np.where(straight[rows, best], 0.0, np.abs(im[rows, best]))
    slopes = im * np.sign(re + alpha[:, None] * im)
    slopes[rows, best] = 0.0
    flat = slopes.sum(axis=1)
    curve = total * alpha / np.sqrt(1 + alpha**2)
    kink = np.where((np.abs(flat + curve) <= own) & (own > 0), best, -1)
    # Elsewhere the minimum is where flat +- own + total * sin = 0, on the side that goes down.
    side = flat - np.sign(flat + curve) * own
    sine = np.clip(-side / np.maximum(total, 1e-300), -1 + 1e-12, 1 - 1e-12)
    smooth = np.where(total > 0, sine / np.sqrt(1 - sine**2), alpha)
    return np.where(kink >= 0, alpha, smooth), kink


def _completed(M: ComplexArray, blocks: list[Block], delta: ComplexArray) -> ComplexArray:
    """The same Delta, its complex part (where it has one) scaled so that ``I - M Delta`` is singular to rounding."""
    delta = project(blocks, delta)
    fixed, free = np.zeros_like(delta), delta.copy()
    for block, (w, z) in zip(blocks, block_slices(blocks), strict=True):
        if isinstance(block, RealScalar):
            fixed[w, z] = delta[w, z]
            free[w, z] = 0
    if not free.any():
        return delta
    try:
        eigenvalues = np.linalg.eigvals(np.linalg.solve(np.eye(len(M)) - M @ fixed, M @ free))
    except np.linalg.LinAlgError:
        return delta
    # I - M fixed - M free / lambda is singular.
    largest = eigenvalues[np.abs(eigenvalues).argmax()]
    return fixed + free / largest if np.abs(largest) > 1e-12 else delta


# --- power iteration -------------------------------------------------------------------------------------------------


def _power_iteration(
    M: ComplexArray, blocks: list[Block], rng: np.random.Generator, restarts: int, steps: int
) -> list[ComplexArray]:
    """Fixed points of ``beta a = M b, z = Q^* w-alignment, beta w = M^* z, b = Q a`` for complex blocks."""
    q, _ = structure_size(blocks)
    slices = block_slices(blocks)
    b, w = rng.standard_normal((2, restarts, q, 2)) @ np.array([1, 1j])
    b[0] = w[0] = np.conj(np.linalg.svd(M)[2][0])
    b, w = _unit(b), _unit(w)
    a = np.zeros((restarts, M.shape[0]), dtype=complex)
    for _ in range(steps):
        a = _unit(b @ M.T)
        z = np.empty_like(a)
        for block, (sw, sz) in zip(blocks, slices, strict=True):
            z[:, sz] = _align(block, w[:, sw], a[:, sz])
        w = _unit(z @ np.conj(M))
        for block, (sw, sz) in zip(blocks, slices, strict=True):
            b[:, sw] = _align_back(block, w[:, sw], a[:, sz])
        b = _unit(b)
    found = []
    for i in range(restarts):
        delta = np.zeros((q, M.shape[0]), dtype=complex)
        for block, (sw, sz) in zip(blocks, slices, strict=True):
            if isinstance(block, FullBlock):
                delta[sw, sz] = np.outer(_unit(w[i : i + 1, sw])[0], np.conj(_unit(a[i : i + 1, sz])[0]))
            else:
                inner = np.vdot(a[i, sz], w[i, sw])
                delta[sw, sz] = np.exp(1j * np.angle(inner)) * np.eye(block.repeats)
        found.append(_completed(M, blocks, delta))
    return found


def _align(block: Block, w: ComplexArray, a: ComplexArray) -> ComplexArray:
    """Vector z of one block from w and a."""
    if isinstance(block, FullBlock):
        return np.linalg.norm(w, axis=1, keepdims=True) * _unit(a)
    return np.exp(-1j * np.angle((np.conj(a) * w).sum(axis=1)))[:, None] * w


def _align_back(block: Block, w: ComplexArray, a: ComplexArray) -> ComplexArray:
    """Vector b of one block from w and a."""
    if isinstance(block, FullBlock):
        return np.linalg.norm(a, axis=1, keepdims=True) * _unit(w)
    return np.exp(1j * np.angle((np.conj(a) * w).sum(axis=1)))[:, None] * a


def _unit(v: ComplexArray, instead: ComplexArray | None = None) -> ComplexArray:
    """Rows of unit length; rows of zeros (or not finite ones) stay, or become those of ``instead``."""
    norm = np.linalg.norm(v, axis=1, keepdims=True)
    good = np.isfinite(norm) & (norm > 0)
    return np.where(good, v / np.where(good, norm, 1.0), v if instead is None else instead)


def _embed(delta: ComplexArray, blocks: Sequence[Block], component: Component) -> ComplexArray:
    """A component's Delta in the coordinates of the whole M, zero elsewhere."""
    q, p = structure_size(blocks)
    slices = block_slices(blocks)
    part = [blocks[i] for i in component.members]
    e_w, e_z = expand(part, component.exponents)
    # M_balanced = 2^z M 2^-w, so Delta = 2^-w Delta_balanced 2^z: the same numbers block by block, by exact powers of
    # two.
    scaled = delta * np.exp2(-e_w)[:, None] * np.exp2(e_z)[None, :]
    result = np.zeros((q, p), dtype=complex)
    w = np.concatenate([np.arange(slices[i][0].start, slices[i][0].stop) for i in component.members])
    z = np.concatenate([np.arange(slices[i][1].start, slices[i][1].stop) for i in component.members])
    result[w[:, None], z] = scaled
    return result
