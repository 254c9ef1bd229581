"""Sequential minimum-norm steps towards a singular ``I - M Delta``, for many matrices and starts at once."""

# With x, y the right and left null directions of I - M Delta, singularity is linear to first order, y^* M Delta x =
# y^* x; the Delta of smallest norm that fulfils it is known in closed form. Repeating this converges fast where all
# blocks but one end at the bound, and may cycle where more of them lie inside: there the steps are damped, and the
# last ones only restore singularity near the Delta reached.

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array, ComplexArray
from robustlab.mu_analysis.matrix.delta_layout import DeltaLayout

FREE = 6  # undamped steps at the beginning of a path; more: faster where few blocks lie inside, or cycles
RESTORING = 5  # steps at its end that restore singularity
PATH_RESIDUAL = 1e-7  # below which a Delta of a path is kept; it is taken to rounding later
LEAST_ROOM = 0.02  # share of the norm by which every real block may move where singularity is restored
LEAST_DESCENT = 1e-4  # relative fall of the norm that descent goes on for
HUGE = 1e9  # entries of Delta beyond this lead nowhere; M is of order one

# Shares of the way to the smallest step that descent tries.
FRACTIONS = 0.5 ** np.arange(7)


def minimum_norm_paths(
    M: ComplexArray, layout: DeltaLayout, x: ComplexArray, y: ComplexArray, steps: int, per_matrix: int
) -> tuple[ComplexArray, Array]:
    """The smallest Delta (k, q, p), singular to about 1e-7, on each of k paths, and its norm (inf where none)."""
    k = len(M)
    best, best_norm = np.zeros((k, layout.q, layout.p), dtype=complex), np.full(k, np.inf)
    delta: ComplexArray | None = None
    # Damping differs from path to path and from step to step, without chance: undamped steps can cycle. Every other
    # path averages, which ends between the corners that steps jump to.
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
    """Directions x, y (k, p) after a few undamped steps, and the norm (k,) of the smallest of the last two."""
    norms = []
    for _ in range(steps):
        row = rows(M, x, y)
        values = smallest_step(layout.gains(row, x), layout.real)
        norms.append(np.abs(values).max(axis=1))
        x, y, _ = null_directions(M, _limited(layout.deltas(values, row, x)), x, y)
    return x, y, np.minimum(norms[-1], norms[-2])


def sharpened(M: ComplexArray, layout: DeltaLayout, delta: ComplexArray, steps: int = 4) -> ComplexArray:
    """Deltas (k, q, p) close to singular ones, moved to them up to rounding; M is (k, p, q)."""
    if not len(delta):
        return delta
    x, y = _singular_directions(M, delta)
    for _ in range(steps):
        delta = _limited(restored(layout, delta, rows(M, x, y), x))
        x, y, _ = null_directions(M, delta, x, y)
    return delta


def descended(M: ComplexArray, layout: DeltaLayout, delta: ComplexArray, rounds: int) -> ComplexArray:
    """Deltas (k, q, p), singular to rounding, moved to smaller ones along the singular set; M is (k, p, q)."""
    # The step of smallest norm is a direction of descent: part of the way towards it, then back to singularity, as far
    # as the norm falls.
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
    """``y^* M / y^* x`` (k, q)."""
    inner = (np.conj(y) * x).sum(axis=1)
    inner = np.where(np.abs(inner) < 1e-8, 1e-8, inner)
    return (np.conj(y)[:, None, :] @ M)[:, 0] / inner[:, None]


def null_directions(
    M: ComplexArray, delta: ComplexArray, x: ComplexArray, y: ComplexArray
) -> tuple[ComplexArray, ComplexArray, Array]:
    """One step of inverse iteration on ``I - M Delta`` from x, y (k, p), and ``|(I - M Delta) x|`` after it (k,)."""
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
    """Delta moved as little as can be so that ``row Delta x = 1``."""
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
    """Rows of unit length; rows of zeros (or not finite ones) stay, or become those of ``instead``."""
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
    """The d (k, n) of smallest maximum modulus with ``sum a_i d_i = 1``, d_i real where ``real``."""
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
