"""Lower bounds of mu: the smallest Delta found that makes ``I - M Delta`` singular, verified by singular values.

Minimum-norm steps from many directions: of complex structures from power iterations, of others also from the end points
of gain ascent. All starts of all matrices of a stack use the same stacked linear algebra.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array, ComplexArray
from robustlab.mu_analysis.constants import SINGULAR
from robustlab.mu_analysis.matrix.certificate import EPS, delta_norm, project, singularity
from robustlab.mu_analysis.matrix.decomposition import Component, components, entries, expand
from robustlab.mu_analysis.matrix.delta_layout import DeltaLayout, delta_layout, positive
from robustlab.uncertainty.blocks import Block, structure_size

# Relative distance of a Delta from an exactly singular one, to first order; half of it near a double root.
NEARBY = 5e-9
CHOSEN = 6  # candidates per matrix that are refined to rounding and verified
WIDER = 3  # ratio of first starts to paths where blocks are real; the best starts are kept
DESCENDING = 2  # candidates per matrix that descend along the singular set
ROUNDS = 12  # of this descent
FEW = 5  # largest number of real blocks alone for which scattered starts are added
SCATTERED = 48  # number of these starts
FARTHEST = 2.0**500  # largest scaling of rows and columns; two such factors must not overflow
SWEEPS = 2  # of coordinate ascent over the real blocks
STACK = 4_000_000  # numbers that one stack of paths may hold: memory, not the answer

# A candidate of a block of a new kind that changes by more than this share is led back to the structure, in so many
# rounds.
OUTSIDE = 1e-9
SHRINKING, LEAST_SHRINK, NEWTON_STEPS = 40, 1e-6, 12

Found = tuple[float, ComplexArray | None]


def lower_bound(M: ComplexArray, blocks: Sequence[Block], seed: int = 0, restarts: int = 12, steps: int = 40) -> Found:
    """Return ``(1 / ||Delta||, Delta)`` for the smallest Delta (q, p) found, or ``(0, None)``."""
    return lower_bounds(np.asarray(M)[None], blocks, seed, restarts, steps)[0]


def lower_bounds(
    stack: ComplexArray, blocks: Sequence[Block], seed: int = 0, restarts: int = 12, steps: int = 40
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
        chunk = max(1, STACK // (max(restarts, 1) * layout.p * max(layout.q, layout.p)))
        for first in range(0, len(group), chunk):
            some = group[first : first + chunk]
            matrices = np.stack([component.matrix / size for _, component, size in some])
            # A path that does not converge may overflow; its end is not verified.
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                candidates = _candidates(matrices, layout, seed, max(restarts, 1), steps)
            for (k, component, size), found in zip(some, candidates, strict=True):
                with np.errstate(over="ignore", invalid="ignore"):  # a Delta that overflows is not verified
                    back = [c for c in (c / size for c in found) if np.isfinite(c).all()]
                best[k] = _verified(stack[k], blocks, component, back, best[k])
    return best


def _verified(
    M: ComplexArray, blocks: Sequence[Block], component: Component, candidates: list[ComplexArray], best: Found
) -> Found:
    """Return the smallest candidate that is better than ``best`` and singular to rounding, for the whole M."""
    part = [blocks[i] for i in component.members]
    exact = [d for c in candidates for d in _of_the_structure(component.matrix, part, c)]
    for norm, candidate in sorted(((delta_norm(part, c), c) for c in exact), key=lambda pair: pair[0]):
        if not 0 < norm < np.inf:
            continue
        if 1 / norm <= best[0]:
            break
        delta = _embed(candidate, blocks, component)
        close = singularity(component.matrix, candidate) <= SINGULAR
        close = close and singularity(M, delta) <= 1e3 * SINGULAR
        if close and _singular_nearby(component.matrix, part, candidate):
            return 1 / delta_norm(blocks, delta), delta
    return best


def _of_the_structure(M: ComplexArray, blocks: Sequence[Block], candidate: ComplexArray) -> list[ComplexArray]:
    """The candidate without what the structure has no room for."""
    delta = project(blocks, candidate)
    if np.abs(delta - candidate).max() <= OUTSIDE * np.abs(candidate).max():
        return [delta]
    met: list[ComplexArray] = []
    shrink = 0.0
    for _ in range(SHRINKING):
        found = _led_back(M, blocks, (1 - shrink) * delta)
        if found is not None and (not met or delta_norm(blocks, found) < delta_norm(blocks, met[-1]) * (1 - 1e-9)):
            met.append(found)
            delta, shrink = found, min(max(2 * shrink, 0.1), 0.5)
        elif not met or shrink < LEAST_SHRINK:
            break
        else:
            shrink /= 4
    return met


def _led_back(M: ComplexArray, blocks: Sequence[Block], delta: ComplexArray) -> ComplexArray | None:
    """A Delta of the structure that makes ``I - M Delta`` singular, by Newton steps of least change, or None."""
    for _ in range(NEWTON_STEPS):
        u, sigma, vh = np.linalg.svd(np.eye(len(M)) - M @ delta)
        if sigma[-1] <= EPS * sigma[0]:
            break
        row, x = np.conj(u[:, -1]) @ M, np.conj(vh[-1])
        along = np.outer(np.conj(row), np.conj(x))
        moves = [project(blocks, along), project(blocks, 1j * along)]
        gains = np.array([row @ move @ x for move in moves])
        parts = np.linalg.lstsq(np.stack([np.real(gains), np.imag(gains)]), np.array([sigma[-1], 0.0]), rcond=1e-8)[0]
        delta = delta + parts[0] * moves[0] + parts[1] * moves[1]
        if not np.isfinite(delta).all():
            return None
    return delta if singularity(M, delta) <= SINGULAR else None


def _singular_nearby(M: ComplexArray, blocks: Sequence[Block], delta: ComplexArray) -> bool:
    """Return whether a Delta of the structure within NEARBY makes ``I - M Delta`` singular to first order."""
    # A small singular value alone is no proof: for a nilpotent M that of I - M Delta falls like 1 / |Delta|, but no
    # Delta makes it zero.
    loop = np.eye(len(M)) - M @ delta
    # Scale the largest entries of rows and columns to one, so that singular values keep their digits.
    scale_rows, scale_cols = np.ones(len(loop)), np.ones(len(loop))
    for _ in range(3):
        scale_rows /= _power_of_two(np.abs(loop * scale_rows[:, None] * scale_cols).max(axis=1))
        scale_rows = np.clip(scale_rows, 1 / FARTHEST, FARTHEST)
        scale_cols /= _power_of_two(np.abs(loop * scale_rows[:, None] * scale_cols).max(axis=0))
        scale_cols = np.clip(scale_cols, 1 / FARTHEST, FARTHEST)
    u, sigma, vh = np.linalg.svd(loop * scale_rows[:, None] * scale_cols)
    y, x, smallest = scale_rows * u[:, -1], scale_cols * np.conj(vh[-1]), sigma[-1]
    rounding = 4 * len(M) * EPS * np.abs(y) @ (np.eye(len(M)) + np.abs(M) @ np.abs(delta)) @ np.abs(x)
    layout = delta_layout(blocks)
    if smallest <= rounding:
        return _exactly_singular_nearby(M, layout, delta, x, y)
    row = (np.conj(y) @ M)[None] / smallest
    gains = layout.gains(row, x[None])
    real = layout.real
    with np.errstate(over="ignore", invalid="ignore"):
        step = smallest_step(gains, real)
        reached = (np.where(real, gains * step, np.abs(gains * step))).sum()
    return bool(abs(reached - 1) < 0.1 and np.abs(step).max() <= NEARBY * delta_norm(blocks, delta))


def _exactly_singular_nearby(
    M: ComplexArray, layout: DeltaLayout, delta: ComplexArray, x: ComplexArray, y: ComplexArray | Array
) -> bool:
    """Return whether a loop singular to rounding is singular for a Delta nearby, or for M with other last bits."""
    # With real blocks alone and nearly real M the residual moves along a line: a component off it remains, and real mu
    # jumps. If an eigenvalue of M is nearly defective, the residual hardly moves. Exact arithmetic distinguishes both
    # from rounding, which is a change of every entry of M in its last place.
    if not layout.real.all():
        return True
    gains = layout.gains((np.conj(y) @ M)[None], x[None])[0]
    size = float(np.abs(gains).sum())
    along = np.exp(-0.5j * np.angle(((gains / size) ** 2).sum())) if size else complex(1.0)
    off = float(np.abs((gains * along).imag).sum())
    if off > 1e-6 * size:
        return True
    reach = NEARBY * float(layout.sizes(delta[None]).max())
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


def _power_of_two(size: Array) -> Array:
    return np.exp2(np.rint(np.log2(np.where(size > 0, size, 1.0))))


# --- candidates ------------------------------------------------------------------------------------------------------


def _candidates(
    M: ComplexArray,
    layout: DeltaLayout,
    seed: int,
    restarts: int,
    steps: int,
) -> list[list[ComplexArray]]:
    """Return for each balanced matrix (k, p, q) Deltas near its structure, most of them singular to rounding."""
    if layout.real.any():
        x, y, near = _best_starts(M, layout, *_starts(M, layout, seed, WIDER * restarts, steps), restarts)
        x_more, y_more = _ascended(M, layout, near, seed, max(restarts // 3, 1))
        x, y = np.concatenate([x, x_more], axis=1), np.concatenate([y, y_more], axis=1)
    else:
        x, y = _starts(M, layout, seed, restarts, steps)
    delta, norm = _path_ends(M, layout, x, y, steps=10 + steps // 3)
    few = layout.real.all() and layout.n <= FEW
    if few:
        more, more_norm = _scattered(M, layout, norm.min(axis=1), seed, SCATTERED)
        delta, norm = np.concatenate([delta, more], axis=1), np.concatenate([norm, more_norm], axis=1)
    of, chosen = _chosen(norm, CHOSEN)
    sharp = sharpened(M[of], layout, delta[of, chosen])
    if layout.real.any():
        # The best of each matrix descend to a local minimum.
        sizes = np.where(_residuals(M[of], sharp) <= 1e-10, layout.sizes(sharp).max(axis=1), np.inf)
        count = 2 * DESCENDING if few else DESCENDING
        best = np.array([j for k in range(len(M)) for j in _smallest(np.flatnonzero(of == k), sizes, count)], dtype=int)
        lower = sharpened(M[of[best]], layout, descended(M[of[best]], layout, sharp[best], ROUNDS))
        sharp, of = np.concatenate([sharp, lower]), np.concatenate([of, of[best]])
    return [list(sharp[of == k]) for k in range(len(M))]


def _chosen(norm: Array, count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return row and column of the ``count`` smallest norms (k, r) of each row, without most that agree to 1e-6."""
    of, chosen = [], []
    for k, row in enumerate(norm):
        order = np.argsort(row)
        order = order[np.isfinite(row[order])]
        twin = np.zeros(len(order), dtype=bool)
        # Two of those that agree are kept: one may fail to become exact.
        twin[2:] = row[order[2:]] <= row[order[:-2]] * (1 + 1e-6)
        order = order[~twin][:count]
        of.extend([k] * len(order))
        chosen.extend(order)
    return np.array(of, dtype=np.intp), np.array(chosen, dtype=np.intp)


def _smallest(indices: NDArray[np.intp], sizes: Array, count: int) -> NDArray[np.intp]:
    order = indices[np.argsort(sizes[indices])]
    return order[np.isfinite(sizes[order])][:count]


def _residuals(M: ComplexArray, delta: ComplexArray) -> Array:
    return np.linalg.svd(np.eye(M.shape[1]) - M @ delta, compute_uv=False)[:, -1]


def _scattered(M: ComplexArray, layout: DeltaLayout, norm: Array, seed: int, count: int) -> tuple[ComplexArray, Array]:
    """Return singular Deltas (k, count, q, p) near random points of the box of the best norm, and their norms."""
    # With few real parameters, steps to the corners miss narrow minima.
    rng = np.random.default_rng([seed, 3])
    k = len(M)
    radius = np.where(np.isfinite(norm), norm, 3.0)
    values = rng.uniform(-1, 1, (1, count, layout.n)) * radius[:, None, None]
    ones = np.ones((k * count, layout.q), dtype=complex)
    start = layout.deltas(values.reshape(-1, layout.n).astype(complex), ones, ones)
    repeated = _repeated(M, count)
    found = sharpened(repeated, layout, start, steps=8)
    sizes = np.where(_residuals(repeated, found) <= 1e-8, layout.sizes(found).max(axis=1), np.inf)
    return found.reshape(k, count, layout.q, layout.p), sizes.reshape(k, count)


def _starts(
    M: ComplexArray, layout: DeltaLayout, seed: int, restarts: int, steps: int
) -> tuple[ComplexArray, ComplexArray]:
    """Return directions x, y (k, restarts, p); the same random ones for every matrix."""
    k = len(M)
    rng = np.random.default_rng(seed)
    u, _, vh = np.linalg.svd(M)
    if not layout.real.any():
        b, w = rng.standard_normal((2, 1, restarts, layout.q, 2)) @ np.array([1, 1j]) * np.ones((1, k, 1, 1))
        b[:, 0] = w[:, 0] = np.conj(vh[:, 0])
        x, y = _power_directions(_repeated(M, restarts), layout, _flat(b), _flat(w), 15 + steps // 2)
        return x.reshape(k, restarts, -1), y.reshape(k, restarts, -1)
    x, y = rng.standard_normal((2, 1, restarts, layout.p, 2)) @ np.array([1, 1j]) * np.ones((1, k, 1, 1))
    x[:, 0] = y[:, 0] = u[:, :, 0]
    if restarts > 1 and layout.p == layout.q:
        x[:, 1], y[:, 1] = np.conj(vh[:, 0]), u[:, :, 0]
    return x, y


def _best_starts(
    M: ComplexArray, layout: DeltaLayout, x: ComplexArray, y: ComplexArray, count: int
) -> tuple[ComplexArray, ComplexArray, Array]:
    """Return the ``count`` directions of (k, r, p) with the smallest steps after the first few, and that norm."""
    k, r = x.shape[:2]
    x, y, norm = first_steps(_repeated(M, r), layout, _flat(x), _flat(y))
    norm = norm.reshape(k, r)
    keep = np.argsort(norm, axis=1)[:, :count, None]
    x, y = np.take_along_axis(x.reshape(k, r, -1), keep, 1), np.take_along_axis(y.reshape(k, r, -1), keep, 1)
    return x, y, norm.min(axis=1)


def _path_ends(
    M: ComplexArray, layout: DeltaLayout, x: ComplexArray, y: ComplexArray, steps: int
) -> tuple[ComplexArray, Array]:
    """Return Deltas (k, r, q, p) at the ends of minimum-norm paths from x, y (k, r, p), and norms (inf: none)."""
    k, r = x.shape[:2]
    delta, norm = minimum_norm_paths(_repeated(M, r), layout, _flat(x), _flat(y), steps, r)
    return delta.reshape(k, r, layout.q, layout.p), norm.reshape(k, r)


def _ascended(M: ComplexArray, layout: DeltaLayout, norm: Array, seed: int, count: int) -> tuple[ComplexArray, ...]:
    """Return directions (k, count, p) at the ends of gain ascent in a box of the expected norm (k,)."""
    rng = np.random.default_rng([seed, 1])
    k = len(M)
    known = np.where(np.isfinite(norm), norm, 1.0)
    radius = known[:, None] * np.linspace(1.0, 0.8, count)
    values = np.where(layout.real, rng.choice([-1.0, 1.0], (count, layout.n)), 0.0).astype(complex)
    values = (values * radius[..., None]).reshape(k * count, layout.n)
    ones = np.ones((k * count, max(layout.q, layout.p)), dtype=complex)
    start = layout.deltas(values, ones[:, : layout.q], ones[:, : layout.p])
    x, y = _gain_ascent(_repeated(M, count), layout, start, radius.ravel())
    return x.reshape(k, count, -1), y.reshape(k, count, -1)


# --- starts ---
#
# Power iteration (Packard, Fan, Doyle 1988; Young, Doyle 1990): at a fixed point beta a = M b, beta w = M^* z with b =
# Q a, z = Q^* w and Q of the structure and norm one, I - M Q / beta is singular, a is its right null direction and z
# its left one. It converges nearly always for complex blocks; with real ones its vectors are still good starts.
# Gain ascent (Seiler, Packard, Balas, Automatica 46, 2010): the gain of M (I - Delta M)^-1 as a function of one real
# delta_i peaks at the real number next to the pole delta_i + 1 / g_i with g_i = (M (I - Delta M)^-1)_ii; a cycle over
# all i ascends to a box point next to singularity. (A search over the vertices of real M raised no median on 2 to 24
# blocks.)


def _power_directions(
    M: ComplexArray, layout: DeltaLayout, b: ComplexArray, w: ComplexArray, steps: int
) -> tuple[ComplexArray, ComplexArray]:
    """Return null directions x = a and y = z, each (k, p), after some steps from b and w, each (k, q)."""
    back = np.conj(np.swapaxes(M, 1, 2))
    scalar_w, scalar_z = ~layout.full[layout.of_w], ~layout.full[layout.of_z]
    b, w = unit_rows(b), unit_rows(w)
    a = unit_rows((M @ b[..., None])[..., 0])
    z = a
    for _ in range(steps):
        # z_i = q_i^* w_i and b_i = q_i a_i for scalar blocks; for full ones along a_i, w_i with the size of the other.
        phase, ratio = _alignment(layout, a, w)
        z = a / ratio[:, layout.of_z]
        z[:, scalar_z] = np.conj(phase[:, layout.of_w[scalar_w]]) * w[:, scalar_w]
        w = unit_rows((back @ z[..., None])[..., 0], w)
        phase, ratio = _alignment(layout, a, w)
        b = w * ratio[:, layout.of_w]
        b[:, scalar_w] = phase[:, layout.of_z[scalar_z]] * a[:, scalar_z]
        b = unit_rows(b, b)
        a = unit_rows((M @ b[..., None])[..., 0], a)
    return a, z


def _alignment(layout: DeltaLayout, a: ComplexArray, w: ComplexArray) -> tuple[ComplexArray, Array]:
    """Return the phase of each block's ``w^* a``, and ``|a| / |w|``, (k, n_blocks)."""
    inner = layout.gains(w, np.conj(a))
    ratio = positive(layout.vector_sizes(a, layout.of_z)) / positive(layout.vector_sizes(w, layout.of_w))
    return inner / positive(np.abs(inner)), ratio


def _gain_ascent(
    M: ComplexArray, layout: DeltaLayout, delta: ComplexArray, radius: Array
) -> tuple[ComplexArray, ComplexArray]:
    """Ascend from Delta (k, q, p); return directions x, y of the smallest singular value of ``I - M Delta``."""
    for _ in range(SWEEPS):
        for i in np.flatnonzero(layout.real):
            w, z = np.flatnonzero(layout.of_w == i), np.flatnonzero(layout.of_z == i)
            now = delta[:, w[0], z[0]].real
            loop = np.eye(M.shape[1]) - M @ delta
            try:
                part = np.linalg.solve(loop, M[:, :, w])[:, z]
            except np.linalg.LinAlgError:
                continue
            move = _step_to_pole(part)
            value = np.clip(now + move, -radius, radius)
            delta[:, w, z] = value[:, None]
    u, _, vh = np.linalg.svd(np.eye(M.shape[1]) - M @ delta)
    return np.conj(vh[:, -1]), u[:, :, -1]


def _step_to_pole(g: ComplexArray) -> Array:
    """Return the real step to the pole of ``(I - step g)^-1`` nearest to the real axis, for g (k, m, m)."""
    poles = g[:, :, 0] if g.shape[1] == 1 else np.linalg.eigvals(g)
    poles = 1 / np.where(np.abs(poles) > 1e-12, poles, 1e-12)
    # The one whose imaginary part is the smallest share of it.
    best = (np.abs(poles.imag) / np.abs(poles)).argmin(axis=1)
    return poles.real[np.arange(len(poles)), best]


def _repeated(M: ComplexArray, count: int) -> ComplexArray:
    return np.repeat(M, count, axis=0)


def _flat(v: ComplexArray) -> ComplexArray:
    return v.reshape(-1, v.shape[-1])


def _embed(delta: ComplexArray, blocks: Sequence[Block], component: Component) -> ComplexArray:
    """Return a component's Delta in the coordinates of the whole M, zero elsewhere."""
    q, p = structure_size(blocks)
    part = [blocks[i] for i in component.members]
    e_w, e_z = expand(part, component.exponents)
    # M_balanced = 2^z M 2^-w, so Delta = 2^-w Delta_balanced 2^z, exactly.
    scaled = delta * np.exp2(-e_w)[:, None] * np.exp2(e_z)[None, :]
    result = np.zeros((q, p), dtype=complex)
    w, z = entries(blocks, component.members)
    result[w[:, None], z] = scaled
    return result


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
LEAST_DESCENT = 1e-4  # relative fall of the norm below which descent ends
HUGE = 1e9  # limit of the entries of Delta; M is of order one

# Shares of the way to the smallest step that descent tries.
FRACTIONS = 0.5 ** np.arange(7)


def minimum_norm_paths(
    M: ComplexArray, layout: DeltaLayout, x: ComplexArray, y: ComplexArray, steps: int, per_matrix: int
) -> tuple[ComplexArray, Array]:
    """Return the smallest Delta (k, q, p), singular to about 1e-7, on each of k paths, and its norm (inf: none)."""
    k = len(M)
    best, best_norm = np.zeros((k, layout.q, layout.p), dtype=complex), np.full(k, np.inf)
    delta: ComplexArray | None = None
    # Undamped steps can cycle: damping varies over paths and steps, deterministically. Every other path averages, which
    # converges between the corners.
    index = np.arange(k) % per_matrix
    phase, averaging = index * 0.754877666 % 1.0, index % 2 == 1
    for step in range(steps):
        row = rows(M, x, y)
        if step >= steps - RESTORING and delta is not None:
            delta = restored(layout, delta, row, x)
        else:
            new = layout.deltas(smallest_step(layout.gains(row, x), layout.real), row, x)
            if delta is None or step < FREE:
                delta = new
            else:
                gain = 0.5 + 0.5 * ((phase + step * 0.569840291) % 1.0)
                gain = np.where(averaging, 2.0 / (step - FREE + 3.0), gain)
                delta = delta + gain[:, None, None] * (new - delta)
        delta = _limited(delta)
        x, y, residual = null_directions(M, delta, x, y)
        if step >= min(FREE, steps - RESTORING) - 1:
            norm = layout.sizes(delta).max(axis=1)
            lower = norm < best_norm * (1 - 1e-6 * (residual > 1e-12))
            better = (residual <= PATH_RESIDUAL) & lower & (norm > 0)
            best[better], best_norm[better] = delta[better], norm[better]
    return best, best_norm


def first_steps(
    M: ComplexArray, layout: DeltaLayout, x: ComplexArray, y: ComplexArray, steps: int = 5
) -> tuple[ComplexArray, ComplexArray, Array]:
    """Return directions x, y (k, p) after a few undamped steps, and the smaller norm (k,) of the last two."""
    norms = []
    for _ in range(steps):
        row = rows(M, x, y)
        values = smallest_step(layout.gains(row, x), layout.real)
        norms.append(np.abs(values).max(axis=1))
        x, y, _ = null_directions(M, _limited(layout.deltas(values, row, x)), x, y)
    return x, y, np.minimum(norms[-1], norms[-2])


def sharpened(M: ComplexArray, layout: DeltaLayout, delta: ComplexArray, steps: int = 4) -> ComplexArray:
    """Move nearly singular Deltas (k, q, p) to singular ones up to rounding; M is (k, p, q)."""
    if not len(delta):
        return delta
    x, y = _singular_directions(M, delta)
    for _ in range(steps):
        delta = _limited(restored(layout, delta, rows(M, x, y), x))
        x, y, _ = null_directions(M, delta, x, y)
    return delta


def descended(M: ComplexArray, layout: DeltaLayout, delta: ComplexArray, rounds: int) -> ComplexArray:
    """Move Deltas (k, q, p), singular to rounding, to smaller ones along the singular set; M is (k, p, q)."""
    # The step of smallest norm is a direction of descent: take part of it, then restore singularity, while the norm
    # falls.
    delta = delta.copy()
    norm = layout.sizes(delta).max(axis=1)
    going = np.arange(len(delta))
    for _ in range(rounds):
        if not len(going):
            break
        m, now, trials = M[going], delta[going], len(FRACTIONS)
        x, y = _singular_directions(m, now)
        row = rows(m, x, y)
        values = smallest_step(layout.gains(row, x), layout.real)
        aim = _limited(layout.deltas(values, row, x))
        tried = now[:, None] + FRACTIONS[None, :, None, None] * (aim - now)[:, None]
        tried = tried.reshape(-1, layout.q, layout.p)
        m, x, y = (np.repeat(v, trials, axis=0) for v in (m, x, y))
        for _ in range(3):
            x, y, _ = null_directions(m, tried, x, y)
            tried = _limited(restored(layout, tried, rows(m, x, y), x))
        x, y, residual = null_directions(m, tried, x, y)
        reached = np.where(residual <= PATH_RESIDUAL, layout.sizes(tried).max(axis=1), np.inf)
        reached = reached.reshape(-1, trials)
        best = reached.argmin(axis=1)
        reached = reached[np.arange(len(going)), best]
        better = reached < norm[going] * (1 - LEAST_DESCENT)
        chosen = tried.reshape(-1, trials, layout.q, layout.p)[np.arange(len(going)), best]
        delta[going[better]], norm[going[better]] = chosen[better], reached[better]
        going = going[better]
    return delta


def _singular_directions(M: ComplexArray, delta: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    u, _, vh = np.linalg.svd(np.eye(M.shape[1]) - M @ delta)
    return np.conj(vh[:, -1]), u[:, :, -1]


def rows(M: ComplexArray, x: ComplexArray, y: ComplexArray) -> ComplexArray:
    """Return ``y^* M / y^* x`` (k, q)."""
    inner = (np.conj(y) * x).sum(axis=1)
    inner = np.where(np.abs(inner) < 1e-8, 1e-8, inner)
    return (np.conj(y)[:, None, :] @ M)[:, 0] / inner[:, None]


def null_directions(
    M: ComplexArray, delta: ComplexArray, x: ComplexArray, y: ComplexArray
) -> tuple[ComplexArray, ComplexArray, Array]:
    """Make a step of inverse iteration on ``I - M Delta`` from x, y (k, p); also return ``|(I - M Delta) x|`` (k,)."""
    loop = np.eye(M.shape[1]) - M @ delta
    # The shift keeps an exactly singular loop solvable.
    shift = 1e-14 * (1 + np.abs(loop).max(axis=(1, 2)))
    shifted = loop + shift[:, None, None] * np.eye(M.shape[1])
    try:
        inverse = np.linalg.inv(shifted)
    except np.linalg.LinAlgError:
        inverse = np.linalg.pinv(shifted)
    x = unit_rows((inverse @ x[..., None])[..., 0], x)
    y = unit_rows((np.conj(y)[:, None, :] @ inverse)[:, 0].conj(), y)
    return x, y, np.linalg.norm((loop @ x[..., None])[..., 0], axis=1)


def restored(layout: DeltaLayout, delta: ComplexArray, row: ComplexArray, x: ComplexArray) -> ComplexArray:
    """Move Delta by the smallest change so that ``row Delta x = 1``."""
    parts = layout.contributions(delta, row, x)
    sizes = layout.sizes(delta)
    norm = np.maximum(sizes.max(axis=1, keepdims=True), 1e-300)
    room = np.where(layout.real, np.maximum(norm - sizes, LEAST_ROOM * norm), 0.0)
    gains = layout.gains(row, x)
    total = parts.sum(axis=1)
    columns: ComplexArray = np.concatenate([total[:, None], np.where(layout.real, gains * room, 1j * parts)], axis=1)
    a, b, c = (columns.real**2).sum(axis=1), (columns.real * columns.imag).sum(axis=1), (columns.imag**2).sum(axis=1)
    ridge = 1e-13 * (a + c) + 1e-300
    a, c = a + ridge, c + ridge
    missing = 1 - total
    determinant = a * c - b * b
    u = (c * missing.real - b * missing.imag) / determinant
    v = (a * missing.imag - b * missing.real) / determinant
    move = np.clip(columns.real * u[:, None] + columns.imag * v[:, None], -0.5, 0.5)
    values = delta[:, layout.entry_w, layout.entry_z] * np.where(
        layout.real, 1.0, np.exp(1j * np.where(layout.real, 0.0, move[:, 1:]))
    ).take(layout.entry_block, axis=1)
    values = values + np.where(layout.real, room * move[:, 1:], 0.0).take(layout.entry_block, axis=1)
    result = np.zeros_like(delta)
    result[:, layout.entry_w, layout.entry_z] = values * (1 + move[:, :1])
    return result


def unit_rows(v: ComplexArray, instead: ComplexArray | None = None) -> ComplexArray:
    """Normalise rows; zero or not finite ones are kept, or replaced by those of ``instead``."""
    norm = np.sqrt((v.real**2 + v.imag**2).sum(axis=1, keepdims=True))
    good = (norm > 0) & (norm < np.inf)
    if good.all():
        return v / norm
    return np.where(good, v / np.where(good, norm, 1.0), v if instead is None else instead)


def _limited(delta: ComplexArray) -> ComplexArray:
    size = np.abs(delta).max(axis=(1, 2))
    wild = ~(size <= HUGE)
    if not wild.any():
        return delta
    delta = np.where(np.isfinite(delta), delta, 0.0)
    return np.clip(delta.real, -HUGE, HUGE) + 1j * np.clip(delta.imag, -HUGE, HUGE)


def smallest_step(a: ComplexArray, real: NDArray[np.bool_]) -> ComplexArray:
    """Return d (k, n) of smallest maximum modulus with ``sum a_i d_i = 1``, d_i real where ``real``."""
    # The dual is a convex function of one number alpha, sum_R |Re a_i + alpha Im a_i| + sqrt(1 + alpha^2) sum_C |a_i|,
    # whose minimum is 1 / max |d_i|: at a kink, where that one real d_i is inside its range, or between two.
    if not real.any():
        size = np.abs(a)
        return np.conj(a) / np.maximum(size * size.sum(axis=1, keepdims=True), 1e-300)
    k = len(a)
    rows = np.arange(k)
    re, im = a.real[:, real], a.imag[:, real]
    total = np.abs(a[:, ~real]).sum(axis=1)
    alpha, kink = np.zeros(k), np.full(k, -1)
    if re.shape[1]:
        alpha, kink = dual_minimum(re, im, total)
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


def dual_minimum(re: Array, im: Array, total: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return the minimiser alpha of the dual of `smallest_step`, and the index of its kink (-1: none)."""
    rows = np.arange(len(re))
    size = np.abs(re) + np.abs(im)
    straight = np.abs(im) <= 1e-13 * np.maximum(size.max(axis=1, keepdims=True), 1e-300)
    im = np.where(straight, 0.0, im)
    # A real direction without a kink never changes sign; alpha = 0 replaces it without effect.
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
    # Elsewhere the minimum is where flat +- own + total * sin = 0, on the descending side.
    side = flat - np.sign(flat + curve) * own
    sine = np.clip(-side / np.maximum(total, 1e-300), -1 + 1e-12, 1 - 1e-12)
    smooth = np.where(total > 0, sine / np.sqrt(1 - sine**2), alpha)
    return np.where(kink >= 0, alpha, smooth), kink
