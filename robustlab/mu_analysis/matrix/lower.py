"""Lower bounds of mu: the smallest Delta found that makes ``I - M Delta`` singular, verified by singular values.

Minimum-norm steps from many directions; all starts of all matrices of a stack use the same stacked linear algebra.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from robustlab.arrays import Array, ComplexArray, Indices, Mask
from robustlab.mu_analysis.matrix.block_structure import (
    Component,
    DeltaLayout,
    components,
    delta_layout,
    delta_norm,
    entries,
    expand,
    project,
)
from robustlab.uncertainty.blocks import Block, structure_size

EPS = float(np.finfo(float).eps)
SINGULAR = 1e-11  # relative smallest singular value below which I - M Delta counts as singular
# Relative distance of a Delta from an exactly singular one, to first order; half of it near a double root.
NEARBY = 5e-9
CHOSEN = 6  # candidates per matrix that are refined to rounding and verified
WIDER = 3  # ratio of first starts to paths; the best starts are kept
SMOOTH = 16  # largest number of paths where no block is real
DESCENDING = 2  # candidates per matrix that descend along the singular set
ROUNDS = 24  # of this descent
FEW, FEWEST = 5, 24  # largest number of real blocks alone with at least so many starts, and scattered ones
SCATTERED = 96  # number of these: without them 2 of 16 random matrices lose more than a quarter
FARTHEST = 2.0**500  # largest scaling of rows and columns; two such factors must not overflow
STACK = 4_000_000  # numbers that one stack of paths may hold: memory, not the answer

Found = tuple[float, ComplexArray | None]


def lower_bound(M: ComplexArray, blocks: Sequence[Block], seed: int = 0, restarts: int = 24, steps: int = 40) -> Found:
    """Return ``(1 / ||Delta||, Delta)`` for the smallest Delta (q, p) found, or ``(0, None)``."""
    return lower_bounds(np.asarray(M)[None], blocks, seed, restarts, steps)[0]


def lower_bounds(
    stack: ComplexArray, blocks: Sequence[Block], seed: int = 0, restarts: int = 24, steps: int = 40
) -> list[Found]:
    """Return `lower_bound` of each matrix of a stack (k, p, q)."""
    best: list[Found] = [(0.0, None)] * len(stack)
    jobs: dict[tuple[int, ...], list[tuple[int, Component, float]]] = {}
    for k, m in enumerate(stack):
        for component in components(m, blocks):
            if component.matrix.any():
                # The steps are sized for a matrix of order one.
                size = float(np.exp2(max(np.rint(np.log2(np.abs(component.matrix).max())), -1000.0)))
                jobs.setdefault(component.members, []).append((k, component, size))
    for members, group in jobs.items():
        part = [blocks[i] for i in members]
        layout = delta_layout(part)
        chunk = max(1, STACK // (restarts * WIDER * layout.p * max(layout.q, layout.p)))
        for first in range(0, len(group), chunk):
            some = group[first : first + chunk]
            # A path that does not converge may overflow, and a Delta; its end is not verified.
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                matrices = np.stack([component.matrix / size for _, component, size in some])
                of, candidates = _candidates(matrices, layout, seed, restarts, steps)
                for i, (k, component, size) in enumerate(some):
                    back = [c for c in candidates[of == i] / size if np.isfinite(c).all()]
                    best[k] = _verified(stack[k], blocks, component, back, best[k])
    return best


def _verified(
    M: ComplexArray, blocks: Sequence[Block], component: Component, candidates: list[ComplexArray], best: Found
) -> Found:
    """Return the smallest candidate that is better than ``best`` and singular to rounding, for the whole M."""
    part = [blocks[i] for i in component.members]
    exact = [project(part, candidate) for candidate in candidates]
    for norm, candidate in sorted(((delta_norm(part, c), c) for c in exact), key=lambda pair: pair[0]):
        if not 0 < norm < np.inf:
            continue
        if 1 / norm <= best[0]:
            break
        # M_balanced = 2^z M 2^-w, so Delta = 2^-w Delta_balanced 2^z, exactly.
        (e_w, e_z), (w, z) = expand(part, component.exponents), entries(blocks, component.members)
        delta = np.zeros(structure_size(blocks), dtype=complex)
        delta[w[:, None], z] = candidate * np.exp2(-e_w)[:, None] * np.exp2(e_z)
        close = singularity(component.matrix, candidate) <= SINGULAR
        close = close and singularity(M, delta) <= 1e3 * SINGULAR
        if close and _singular_nearby(component.matrix, delta_layout(part), candidate):
            return 1 / delta_norm(blocks, delta), delta
    return best


def singularity(M: ComplexArray, delta: ComplexArray) -> float:
    """Return the smallest singular value of ``I - M Delta`` over ``1 + ||M Delta||``."""
    loop = M @ delta
    if not np.isfinite(loop).all():
        return float("inf")
    values = np.linalg.svd(np.eye(len(loop)) - loop, compute_uv=False)
    return float(values[-1] / (1 + np.linalg.norm(loop, 2)))


def _singular_nearby(M: ComplexArray, layout: DeltaLayout, delta: ComplexArray) -> bool:
    """Return whether a Delta of the structure within NEARBY makes ``I - M Delta`` singular to first order."""
    # A small singular value alone is no proof: for a nilpotent M that of I - M Delta falls like 1 / |Delta|, but no
    # Delta makes it zero. The largest entries of rows and columns are scaled to one, so that singular values keep their
    # digits.
    loop, reach = np.eye(len(M)) - M @ delta, NEARBY * float(layout.sizes(delta[None]).max())
    rows, cols = np.ones(len(loop)), np.ones(len(loop))
    for _ in range(3):
        for scale, axis in ((rows, 1), (cols, 0)):
            size = np.abs(loop * rows[:, None] * cols).max(axis=axis)
            scale /= np.exp2(np.rint(np.log2(np.where(size > 0, size, 1.0))))
            np.clip(scale, 1 / FARTHEST, FARTHEST, out=scale)
    u, sigma, vh = np.linalg.svd(loop * rows[:, None] * cols)
    y, x, smallest = rows * u[:, -1], cols * np.conj(vh[-1]), sigma[-1]
    gains = layout.gains((np.conj(y) @ M)[None], x[None])
    rounding = 4 * len(M) * EPS * np.abs(y) @ (np.eye(len(M)) + np.abs(M) @ np.abs(delta)) @ np.abs(x)
    if smallest > rounding:
        gains = gains / smallest
        step = smallest_step(gains, layout.real)
        reached = (np.where(layout.real, gains * step, np.abs(gains * step))).sum()
        return bool(abs(reached - 1) < 0.1 and np.abs(step).max() <= reach)
    # With real blocks alone and nearly real M the residual moves along a line: a component off it remains, and real mu
    # jumps. If an eigenvalue of M is nearly defective, the residual hardly moves. Exact arithmetic distinguishes both
    # from rounding, which is a change of every entry of M in its last place.
    size = float(np.abs(gains).sum())
    along = np.exp(-0.5j * np.angle(((gains / size) ** 2).sum())) if size else complex(1.0)
    off = float(np.abs((gains * along).imag).sum())
    if not layout.real.all() or off > 1e-6 * size:
        return True
    residual = _exact_residual(M, delta, x, y) * along
    last_places = EPS * float(np.abs(y) @ np.abs(M) @ np.abs(delta) @ np.abs(x))
    return abs(residual.imag) <= max(off * reach, last_places) and abs(residual.real) <= max(size * reach, last_places)


def _exact_residual(M: ComplexArray, delta: ComplexArray, x: ComplexArray, y: ComplexArray | Array) -> complex:
    """Return ``y^* (I - M Delta) x`` in exact arithmetic, rounded once; for a diagonal Delta."""
    exact: Any = np.frompyfunc(Fraction, 1, 1)
    given: tuple[Any, ...] = (M, np.diagonal(delta), x, np.conj(y))
    m, d, x_, y_ = ((exact(v.real), exact(v.imag)) for v in given)
    moved = d[0] * x_[0] - d[1] * x_[1], d[0] * x_[1] + d[1] * x_[0]
    re, im = x_[0] - m[0] @ moved[0] + m[1] @ moved[1], x_[1] - m[0] @ moved[1] - m[1] @ moved[0]
    return complex(float(y_[0] @ re - y_[1] @ im), float(y_[0] @ im + y_[1] @ re))


# --- candidates ------------------------------------------------------------------------------------------------------
#
# (Power iteration for complex blocks, gain ascent for real ones and a search over the vertices of real M raised no
# median of 33 classes of random matrices by 1e-3.)


def _candidates(
    M: ComplexArray, layout: DeltaLayout, seed: int, restarts: int, steps: int
) -> tuple[Indices, ComplexArray]:
    """Return Deltas near the structure, most of them singular to rounding, and the matrix (k, p, q) of each."""
    few, smooth = bool(layout.real.all()) and layout.n <= FEW, not layout.real.any()
    restarts = max(restarts, FEWEST) if few else min(restarts, SMOOTH) if smooth else restarts
    k, first = len(M), restarts if smooth else WIDER * restarts
    u, _, vh = np.linalg.svd(M)
    random = np.random.default_rng(seed).standard_normal((2, 1, first, layout.p, 2)) @ np.array([1, 1j])
    x, y = random * np.ones((1, k, 1, 1))
    x[:, 0] = y[:, 0] = u[:, :, 0]
    if layout.p == layout.q:
        x[:, 1], y[:, 1] = np.conj(vh[:, 0]), u[:, :, 0]
    x, y = x.reshape(-1, layout.p), y.reshape(-1, layout.p)
    x, y, norm = _first_steps(np.repeat(M, first, axis=0), layout, x, y)
    best = (np.argsort(norm.reshape(k, -1), axis=1)[:, :restarts] + first * np.arange(k)[:, None]).ravel()
    of = np.repeat(np.arange(k), restarts)
    delta, norm = _minimum_norm_paths(M[of], layout, x[best], y[best], 10 + steps // 3, restarts)
    if few:  # steps to the corners miss narrow minima
        size = norm.reshape(k, -1).min(axis=1)
        rng = np.random.default_rng([seed, 3])
        values = rng.uniform(-1, 1, (1, SCATTERED, layout.n)) * 10 ** rng.uniform(-1, 0, (1, SCATTERED, 1))
        values = (values * np.where(np.isfinite(size), size, 9.0)[:, None, None]).reshape(-1, layout.n) + 0j
        ones, owner = np.ones((len(values), layout.q), dtype=complex), np.repeat(np.arange(k), SCATTERED)
        more = sharpened(M[owner], layout, layout.deltas(values, ones, ones), steps=8)
        of, delta = np.concatenate([of, owner]), np.concatenate([delta, more])
        norm = np.concatenate([norm, _singular_sizes(M[owner], layout, more, 1e-8)])
    chosen = smallest(of, norm, CHOSEN)
    of, sharp = of[chosen], sharpened(M[of[chosen]], layout, delta[chosen])
    best = smallest(of, _singular_sizes(M[of], layout, sharp, 1e-10), DESCENDING)
    lower = sharpened(M[of[best]], layout, _descended(M[of[best]], layout, sharp[best]))
    return np.concatenate([of, of[best]]), np.concatenate([sharp, lower])


def smallest(of: Indices, norm: Array, count: int) -> Indices:
    """Return the indices of the ``count`` smallest finite norms of each matrix, without most that agree to 1e-6."""
    chosen: list[int] = []
    for k in np.unique(of):
        own = np.flatnonzero((of == k) & np.isfinite(norm))
        own = own[np.argsort(norm[own])]
        twin = np.zeros(len(own), dtype=bool)
        # Two of those that agree are kept: one may fail to become exact.
        twin[2:] = norm[own[2:]] <= norm[own[:-2]] * (1 + 1e-6)
        chosen.extend(own[~twin][:count])
    return np.array(chosen, dtype=np.intp)


def _singular_sizes(M: ComplexArray, layout: DeltaLayout, delta: ComplexArray, most: float) -> Array:
    """Return the norms of those Deltas whose loop has a singular value of at most ``most``, inf for the others."""
    smallest = np.linalg.svd(np.eye(M.shape[1]) - M @ delta, compute_uv=False)[:, -1]
    return np.where(smallest <= most, layout.sizes(delta).max(axis=1), np.inf)


# --- minimum-norm steps, for many matrices and starts at once ---------------------------------------------------------
#
# With x, y the right and left null directions of I - M Delta, singularity is linear to first order, y^* M Delta x =
# y^* x; the Delta of smallest norm that fulfils it is known in closed form. Repeating this converges fast where all
# blocks but one end at the bound, and may cycle where more of them are inside: there the steps are damped, and the
# last ones only restore singularity.

FREE = 6  # undamped steps at the beginning of a path; more: faster where few blocks are inside, or cycles
RESTORING = 5  # steps at its end that restore singularity
PATH_RESIDUAL = 1e-7  # below which a Delta of a path is kept for refinement
LEAST_ROOM = 0.02  # share of the norm by which every real block may move where singularity is restored
LEAST_DESCENT = 1e-5  # relative fall of the norm below which descent ends
HUGE = 1e9  # limit of the entries of Delta; M is of order one

# Shares of the way to the smallest step that descent tries.
FRACTIONS = 0.25 ** np.arange(4)


def _minimum_norm_paths(
    M: ComplexArray, layout: DeltaLayout, x: ComplexArray, y: ComplexArray, steps: int, per_matrix: int
) -> tuple[ComplexArray, Array]:
    """Return the smallest Delta (k, q, p), singular to about 1e-7, on each of k paths, and its norm (inf: none)."""
    k = len(M)
    best, best_norm = np.zeros((k, layout.q, layout.p), dtype=complex), np.full(k, np.inf)
    delta = best
    # Undamped steps can cycle: damping varies over paths and steps, deterministically. Every other path averages, which
    # converges between the corners.
    index = np.arange(k) % per_matrix
    phase, averaging = index * 0.754877666 % 1.0, index % 2 == 1
    for step in range(steps):
        row = _rows(M, x, y)
        if step >= steps - RESTORING:
            delta = _restored(layout, delta, row, x)
        else:
            gain = 0.5 + 0.5 * ((phase + step * 0.569840291) % 1.0)
            gain = np.where(averaging, 2.0 / (step - FREE + 3.0), gain) if step >= FREE else np.ones(k)
            new = layout.deltas(smallest_step(layout.gains(row, x), layout.real), row, x)
            delta = delta + gain[:, None, None] * (new - delta)
        delta = _limited(delta)
        x, y, residual = _null_directions(M, delta, x, y)
        norm = layout.sizes(delta).max(axis=1) * (1 + 10 * residual)  # of two that agree the more exact one
        better = (residual <= PATH_RESIDUAL) & (norm < best_norm) & (norm > 0)
        best[better], best_norm[better] = delta[better], norm[better]
    return best, best_norm


def _first_steps(
    M: ComplexArray, layout: DeltaLayout, x: ComplexArray, y: ComplexArray, steps: int = 5
) -> tuple[ComplexArray, ComplexArray, Array]:
    """Return directions x, y (k, p) after a few undamped steps, and the smaller norm (k,) of the last two."""
    norms = []
    for _ in range(steps):
        row = _rows(M, x, y)
        values = smallest_step(layout.gains(row, x), layout.real)
        norms.append(np.abs(values).max(axis=1))
        x, y, _ = _null_directions(M, _limited(layout.deltas(values, row, x)), x, y)
    return x, y, np.minimum(norms[-1], norms[-2])


def sharpened(M: ComplexArray, layout: DeltaLayout, delta: ComplexArray, steps: int = 4) -> ComplexArray:
    """Move nearly singular Deltas (k, q, p) to singular ones up to rounding; M is (k, p, q)."""
    if not len(delta):
        return delta
    x, y = _singular_directions(M, delta)
    for _ in range(steps):
        delta = _limited(_restored(layout, delta, _rows(M, x, y), x))
        x, y, _ = _null_directions(M, delta, x, y)
    return delta


def _descended(M: ComplexArray, layout: DeltaLayout, delta: ComplexArray) -> ComplexArray:
    """Move Deltas (k, q, p), singular to rounding, to smaller ones along the singular set; M is (k, p, q)."""
    # The step of smallest norm is a direction of descent: take part of it, then restore singularity, while the norm
    # falls.
    delta, norm = delta.copy(), layout.sizes(delta).max(axis=1)
    going, trials = np.arange(len(delta)), len(FRACTIONS)
    for _ in range(ROUNDS):
        if not len(going):
            break
        m, now = M[going], delta[going]
        x, y = _singular_directions(m, now)
        row = _rows(m, x, y)
        aim = _limited(layout.deltas(smallest_step(layout.gains(row, x), layout.real), row, x))
        tried = (now[:, None] + FRACTIONS[:, None, None] * (aim - now)[:, None]).reshape(-1, layout.q, layout.p)
        m, x, y = (np.repeat(v, trials, axis=0) for v in (m, x, y))
        for _ in range(3):
            x, y, _ = _null_directions(m, tried, x, y)
            tried = _limited(_restored(layout, tried, _rows(m, x, y), x))
        residual = _null_directions(m, tried, x, y)[2]
        reached = np.where(residual <= PATH_RESIDUAL, layout.sizes(tried).max(axis=1), np.inf)
        best = reached.reshape(-1, trials).argmin(axis=1) + trials * np.arange(len(going))
        better = reached[best] < norm[going] * (1 - LEAST_DESCENT)
        best, going = best[better], going[better]
        delta[going], norm[going] = tried[best], reached[best]
    return delta


def _singular_directions(M: ComplexArray, delta: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    u, _, vh = np.linalg.svd(np.eye(M.shape[1]) - M @ delta)
    return np.conj(vh[:, -1]), u[:, :, -1]


def _rows(M: ComplexArray, x: ComplexArray, y: ComplexArray) -> ComplexArray:
    """Return ``y^* M / y^* x`` (k, q)."""
    inner = (np.conj(y) * x).sum(axis=1)
    inner = np.where(np.abs(inner) < 1e-8, 1e-8, inner)
    return (np.conj(y)[:, None, :] @ M)[:, 0] / inner[:, None]


def _null_directions(
    M: ComplexArray, delta: ComplexArray, x: ComplexArray, y: ComplexArray
) -> tuple[ComplexArray, ComplexArray, Array]:
    """Make a step of inverse iteration on ``I - M Delta`` from unit x, y (k, p); also return ``|(I - M Delta) x|``."""
    loop = np.eye(M.shape[1]) - M @ delta
    try:
        inverse = np.linalg.inv(loop)
    except np.linalg.LinAlgError:  # one is exactly singular; unequal shifts leave no structure in which it stays so
        size = 1 + np.abs(loop).max(axis=(1, 2), keepdims=True)
        inverse = np.linalg.inv(loop + 1e-14 * size * np.diag(1 + 0.1 * np.arange(M.shape[1])))
    x, grown = unit_rows((inverse @ x[..., None])[..., 0], x)
    y, _ = unit_rows((np.conj(y)[:, None, :] @ inverse)[:, 0].conj(), y)
    return x, y, 1 / grown


def _restored(layout: DeltaLayout, delta: ComplexArray, row: ComplexArray, x: ComplexArray) -> ComplexArray:
    """Move Delta by the smallest change so that ``row Delta x = 1``: its size, real entries, and phases of others."""
    parts, sizes = layout.contributions(delta, row, x), layout.sizes(delta)
    norm = np.maximum(sizes.max(axis=1, keepdims=True), 1e-300)
    room = np.where(layout.real, np.maximum(norm - sizes, LEAST_ROOM * norm), 0.0)
    total = parts.sum(axis=1, keepdims=True)
    moves = np.where(layout.real, layout.gains(row, x) * room, 1j * parts)
    columns: ComplexArray = np.concatenate([total, moves], axis=1)
    a, b, c = (columns.real**2).sum(axis=1), (columns.real * columns.imag).sum(axis=1), (columns.imag**2).sum(axis=1)
    ridge = 1e-13 * (a + c) + 1e-300
    a, c, missing = a + ridge, c + ridge, 1 - total[:, 0]
    u, v = c * missing.real - b * missing.imag, a * missing.imag - b * missing.real
    move = np.clip((columns.real * u[:, None] + columns.imag * v[:, None]) / (a * c - b * b)[:, None], -0.5, 0.5)
    turn = np.exp(1j * np.where(layout.real, 0.0, move[:, 1:])).take(layout.entry_block, axis=1)
    shift = np.where(layout.real, room * move[:, 1:], 0.0).take(layout.entry_block, axis=1)
    result = np.zeros_like(delta)
    values = delta[:, layout.entry_w, layout.entry_z] * turn + shift
    result[:, layout.entry_w, layout.entry_z] = values * (1 + move[:, :1])
    return result


def unit_rows(v: ComplexArray, instead: ComplexArray) -> tuple[ComplexArray, Array]:
    """Normalise rows and return their norms; zero or not finite ones are replaced by those of ``instead``, norm one."""
    norm = np.sqrt((v.real**2 + v.imag**2).sum(axis=1, keepdims=True))
    good = (norm > 0) & (norm < np.inf)
    if not good.all():
        norm = np.where(good, norm, 1.0)
        v = np.where(good, v, instead)
    return v / norm, norm[:, 0]


def _limited(delta: ComplexArray) -> ComplexArray:
    if (np.abs(delta) <= HUGE).all():
        return delta
    delta = np.where(np.isfinite(delta), delta, 0.0)
    return np.clip(delta.real, -HUGE, HUGE) + 1j * np.clip(delta.imag, -HUGE, HUGE)


def smallest_step(a: ComplexArray, real: Mask) -> ComplexArray:
    """Return d (k, n) of smallest maximum modulus with ``sum a_i d_i = 1``, d_i real where ``real``."""
    # The dual is a convex function of one number alpha, f = sum_R |Re a_i + alpha Im a_i| + sqrt(1 + alpha^2) sum_C
    # |a_i|, whose minimum is 1 / max |d_i|: at a kink, where that one real d_i is inside its range, or between two.
    rows, tiny = np.arange(len(a)), 1e-300
    if not real.any():
        size = np.maximum(np.abs(a), tiny)
        return np.conj(a) / (size * size.sum(axis=1, keepdims=True))
    total = np.abs(a[:, ~real]).sum(axis=1)
    # A real direction without a kink never changes sign; alpha = 0 replaces it without effect.
    straight = ~real | (np.abs(a.imag) <= 1e-13 * np.maximum(np.abs(a).max(axis=1, keepdims=True), tiny))
    re, im = np.where(real, a.real, 0.0), np.where(straight, 0.0, a.imag)
    kinks = np.where(straight, 0.0, -re / np.where(straight, 1.0, im))
    f = np.abs(re[:, None, :] + kinks[:, :, None] * im[:, None, :]).sum(axis=2) + np.hypot(1, kinks) * total[:, None]
    best = f.argmin(axis=1)
    alpha = kinks[rows, best]
    slopes = im * np.sign(re + alpha[:, None] * im)
    slopes[rows, best] = 0.0
    flat, own = slopes.sum(axis=1), np.abs(im[rows, best])
    slope = flat + total * alpha / np.hypot(1, alpha)
    inside = (np.abs(slope) <= own) & (own > 0)
    # Elsewhere the minimum is where flat +- own + total * sine = 0, on the descending side.
    sine = (np.sign(slope) * own - flat) / np.maximum(total, tiny)
    sine = np.clip(sine, -1 + 1e-12, 1 - 1e-12)
    alpha = np.where(inside | (total == 0), alpha, sine / np.sqrt(1 - sine**2))
    value = np.abs(re + alpha[:, None] * im).sum(axis=1) + np.hypot(1, alpha) * total
    unit = np.conj(a) / np.maximum(np.abs(a), tiny) * np.exp(1j * np.arctan(alpha))[:, None]
    unit = np.where(real, np.sign(re + alpha[:, None] * im), unit)
    unit[rows[inside], best[inside]] = 0.0
    # At a kink the two real equations of sum a d = 1 fix the common size and the one free d.
    others, free = (a * unit).sum(axis=1), a[rows, best]
    determinant = others.real * free.imag - others.imag * free.real
    inside &= determinant != 0
    safe = np.where(inside, determinant, 1.0)
    d = np.where(inside, free.imag / safe, 1 / np.maximum(value, tiny))[:, None] * unit
    d[rows[inside], best[inside]] = (-others.imag / safe)[inside]
    return np.where(np.isfinite(d), d, 0.0)
