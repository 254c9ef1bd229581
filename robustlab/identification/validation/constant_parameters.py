r"""Smallest constant real parameters that explain a record: descent from above, branch and bound from below.

For fixed :math:`\delta` the noise is affine in the free states, so whether :math:`\delta` explains the record is a
Chebyshev (or least-squares) fit. Its dual gives weights :math:`\lambda` of a few samples, orthogonal to what free
states can do, with :math:`\lambda^T e(\delta) > \|\lambda\|_*`: a witness against :math:`\delta`. Projected anew,
the same weights are a witness at other :math:`\delta` as long as

.. math:: F(\delta) = \lambda^T P(\delta) e(\delta) / \|P(\delta) \lambda\|_* > 1 .

A box is closed where one witness holds at all points of a grid of 3 in each direction, with a quarter of its variation
to spare (a parabola dips by at most an eighth of its variation between three such points). Between the points nothing
is proved: the lower bound is labelled so.
"""

from __future__ import annotations

import heapq
import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robustlab.errors import NoTrustworthyNumber
from robustlab.identification.validation.sampled_problem import Recorded, sampled, with_delta_of
from robustlab.uncertainty.blocks import RealScalar

__all__ = ["Parameters", "smallest_parameters"]

Array = NDArray[np.float64]

SPARE = 0.25
WIDEST = 1e3  # parameters beyond this many times their range are not tried
SLACK = 1e-9
MOVES = 40


@dataclass(frozen=True)
class Parameters:
    """What `smallest_parameters` found: bounds of the largest ``|delta|``, the best delta, and its noise.

    Attributes
    ----------
    lower, upper
        Bounds; the lower one from boxes that were tested at points.
    delta
        Normalised values of the real blocks, in order.
    noise
        Noise that is left (n, n_y), over its bound.
    boxes
        How many boxes were examined.
    finished
        Whether the search ended before the time did.
    least_excess
        Smallest noise over its bound that was found anywhere.
    """

    lower: float
    upper: float
    delta: Array
    noise: Array
    boxes: int
    finished: bool
    least_excess: float


class _Fit:
    """Noise of the record for values of the real blocks, with the free states fitted."""

    def __init__(self, recorded: Recorded, blocks: Sequence[RealScalar], scaled: NDArray[np.bool_]) -> None:
        self.recorded, self.blocks, self.scaled = recorded, blocks, scaled
        self.count = 0

    def terms(self, delta: Array) -> tuple[Array, Array]:
        """E and the free responses at the used samples, output after output; +inf where delta is ill-posed."""
        self.count += 1
        values = {b.name: float(d) for b, d in zip(self.blocks, delta, strict=True)}
        try:
            M, rest = with_delta_of(self.recorded.uncertain, values)
            problem = sampled(self.recorded, M, rest)
            _, free = problem.free_response()
        except NoTrustworthyNumber:
            return np.full(int(self.recorded.used.sum()), np.inf), np.zeros((int(self.recorded.used.sum()), 0))
        used = self.recorded.used.T
        return problem.e.T[used], free.transpose(1, 0, 2)[used]

    def excess(self, e: Array, free: Array) -> tuple[float, Array, Array]:
        """Least noise over its bound, the noise, and the dual weights."""
        if not np.isfinite(e).all():
            return np.inf, e, np.zeros_like(e)
        if self.recorded.norm == "rms":
            return self._rms(e, free)
        return _chebyshev(e, free)

    def _rms(self, e: Array, free: Array) -> tuple[float, Array, Array]:
        left = e - free @ np.linalg.lstsq(free, e, rcond=None)[0] if free.shape[1] else e
        sizes = self.sizes(left)
        weights = np.zeros_like(e)
        worst = int(np.argmax(sizes))
        part = self.parts()[worst]
        weights[part] = left[part]
        return float(sizes.max()), left, weights

    def whole(self, noise: Array) -> Array:
        """Noise at the used samples as (n, n_y), zero elsewhere."""
        full = np.zeros(self.recorded.used.shape)
        full.T[self.recorded.used.T] = noise
        return full

    def parts(self) -> list[slice]:
        """Samples of each output."""
        ends = np.cumsum([0, *self.recorded.used.sum(axis=0)])
        return [slice(a, b) for a, b in itertools.pairwise(ends)]

    def sizes(self, noise: Array) -> Array:
        """Noise of each output over its bound."""
        if self.recorded.norm == "peak":
            return np.array([np.abs(noise[p]).max(initial=0.0) for p in self.parts()])
        return np.array([np.linalg.norm(noise[p]) / np.sqrt(max(p.stop - p.start, 1)) for p in self.parts()])

    def witness(self, weights: Array, delta: Array) -> float:
        """F(delta): above 1, no noise within the bound explains the record at delta."""
        e, free = self.terms(delta)
        if not np.isfinite(e).all():
            return np.inf
        if free.shape[1]:
            weights = weights - free @ np.linalg.lstsq(free, weights, rcond=None)[0]
        if self.recorded.norm == "peak":
            norm = float(np.abs(weights).sum())
        else:
            norm = sum(float(np.linalg.norm(weights[p])) * np.sqrt(p.stop - p.start) for p in self.parts())
        return float(weights @ e) / norm if norm > 0 else 0.0


def _chebyshev(e: Array, free: Array) -> tuple[float, Array, Array]:
    """Least largest ``|e - free x|``, the rest, and the dual weights."""
    from scipy.optimize import linprog

    if not free.shape[1]:
        worst = int(np.abs(e).argmax())
        weights = np.zeros_like(e)
        weights[worst] = np.sign(e[worst])
        return float(np.abs(e[worst])), e, weights
    left, sigma, _ = np.linalg.svd(free, full_matrices=False)
    basis = left[:, sigma > 1e-11 * sigma[0]] * np.sqrt(len(e)) if sigma[0] > 0 else left[:, :0]
    # Least squares first: the programme then works on numbers of one size.
    rest = e - basis @ (basis.T @ e) / len(e)
    size = float(np.abs(rest).max()) or 1.0
    rest = rest / size
    one = np.ones((len(e), 1))
    rows = np.vstack([np.hstack([-basis, -one]), np.hstack([basis, -one])])
    cost = np.append(np.zeros(basis.shape[1]), 1.0)
    found = linprog(cost, rows, np.concatenate([-rest, rest]), bounds=[(None, None)] * len(cost), method="highs")
    if found.x is None or not np.isfinite(found.x).all():
        raise NoTrustworthyNumber("validate", f"the fit of the free states gave no answer ({found.message})")
    noise = (rest - basis @ found.x[:-1]) * size
    dual = -found.ineqlin.marginals
    return float(np.abs(noise).max()), noise, dual[: len(e)] - dual[len(e) :]


def smallest_parameters(
    recorded: Recorded, blocks: Sequence[RealScalar], scaled: NDArray[np.bool_], precision: float, deadline: float
) -> Parameters:
    """Bounds of the largest ``|delta|`` over the blocks that ``scaled`` names; the others stay within [-1, 1]."""
    fit = _Fit(recorded, blocks, scaled)
    m = len(blocks)
    zero = fit.excess(*fit.terms(np.zeros(m)))
    if zero[0] <= 1 + SLACK:
        return Parameters(0.0, 0.0, np.zeros(m), fit.whole(zero[1]), 1, True, zero[0])
    starts = [np.zeros(m)]
    rng = np.random.default_rng(0)
    starts += [rng.uniform(-1, 1, m) for _ in range(3 if m > 1 else 1)]
    best: tuple[float, Array] = (np.inf, np.zeros(m))
    least = zero[0]
    for start in starts:
        found, excess = _descend(fit, start, precision, deadline)
        least = min(least, excess)
        size = _size(found, scaled) if excess <= 1 + SLACK else np.inf
        if size < best[0]:
            best = size, found
    return _branch(fit, best, least, precision, deadline)


def _size(delta: Array, scaled: NDArray[np.bool_]) -> float:
    if (np.abs(delta[~scaled]) > 1 + 1e-9).any():
        return np.inf
    return float(np.abs(delta[scaled]).max(initial=0.0))


def _descend(fit: _Fit, delta: Array, precision: float, deadline: float) -> tuple[Array, float]:
    """Successive linear programmes: first into the noise bound, then to the smallest delta."""
    from scipy.optimize import linprog

    e, free = fit.terms(delta)
    excess, noise, _ = fit.excess(e, free)
    radius, m = 0.5, len(delta)
    best = (np.inf, delta, excess)
    for _ in range(MOVES):
        if time.monotonic() > deadline:
            break
        step = 1e-5 * max(1.0, float(np.abs(delta).max(initial=0.0)))
        slopes = []
        for k in range(m):
            ahead, back = (fit.terms(delta + s * step * np.eye(m)[k])[0] for s in (1, -1))
            slopes.append((ahead - back) / (2 * step))
        lean = np.column_stack(slopes)
        basis = _spanned(free)
        # Variables: change of delta, free states, size of delta, excess of the noise.
        n, k = len(e), basis.shape[1]
        turn = np.hstack([lean, -basis * np.sqrt(n), np.zeros((n, 1)), -np.ones((n, 1))])
        rows = [turn, np.hstack([-lean, basis * np.sqrt(n), np.zeros((n, 1)), -np.ones((n, 1))])]
        one = (1 - 1e-7) * np.ones(n) if fit.recorded.norm == "peak" else 0.999 * _share(fit, noise)
        right = [one - noise, one + noise]
        box = np.hstack([np.eye(m), np.zeros((m, k)), np.where(fit.scaled, -1.0, 0.0)[:, None], np.zeros((m, 1))])
        limit = np.where(fit.scaled, 0.0, 1.0)
        other = np.hstack([-np.eye(m), np.zeros((m, k)), np.where(fit.scaled, -1.0, 0.0)[:, None], np.zeros((m, 1))])
        rows += [box, other]
        right += [limit - delta, limit + delta]
        cost = np.concatenate([np.zeros(m + k), [1.0, 1e4]])
        bounds = [(-radius, radius)] * m + [(None, None)] * k + [(0, WIDEST), (0, None)]
        found = linprog(cost, np.vstack(rows), np.concatenate(right), bounds=bounds, method="highs")
        if found.x is None or not np.isfinite(found.x).all():
            break
        new = delta + found.x[:m]
        new_e, new_free = fit.terms(new)
        new_excess, new_noise, _ = fit.excess(new_e, new_free)
        was, now = max(excess - 1, 0.0) * 1e4, max(new_excess - 1, 0.0) * 1e4
        gain = was + _size(delta, fit.scaled) - now - _size(new, fit.scaled)
        if new_excess <= 1 + SLACK and _size(new, fit.scaled) < best[0]:
            best = _size(new, fit.scaled), new, new_excess
        if gain > 0:
            moved = float(np.abs(new - delta).max())
            delta, e, free, excess, noise = new, new_e, new_free, new_excess, new_noise
            radius = min(2 * radius, max(4 * moved, 1e-3), WIDEST)
            if excess <= 1 + SLACK and moved < 0.02 * precision * max(_size(delta, fit.scaled), 1e-9):
                break
        else:
            radius /= 4
            if radius < 1e-9:
                break
    return (best[1], best[2]) if np.isfinite(best[0]) else (delta, excess)


def _share(fit: _Fit, noise: Array) -> Array:
    """Peaks that an rms bound leaves to the samples: those of the present noise, scaled into the bound."""
    allowed = np.empty_like(noise)
    for part, size in zip(fit.parts(), fit.sizes(noise), strict=True):
        allowed[part] = np.abs(noise[part]) / max(size, 1e-12) + 1e-9
    return allowed


def _spanned(free: Array) -> Array:
    if not free.shape[1]:
        return free
    left, sigma, _ = np.linalg.svd(free, full_matrices=False)
    return left[:, sigma > 1e-11 * sigma[0]] if sigma[0] > 0 else left[:, :0]


def _branch(fit: _Fit, best: tuple[float, Array], least: float, precision: float, deadline: float) -> Parameters:
    """Branch and bound over delta, boxes nearest to nominal first."""
    m, scaled = len(fit.blocks), fit.scaled
    points = np.array([q for q in itertools.product((-1.0, 1.0, 0.0), repeat=m) if any(q)])
    counter = itertools.count()
    outer = np.where(scaled, WIDEST if not np.isfinite(best[0]) else best[0], 1.0)
    outer = np.where(scaled & (outer > 4.0) & (not np.isfinite(best[0])), 4.0, outer)
    heap: list[tuple[float, int, Array, Array]] = [(0.0, next(counter), np.zeros(m), outer)]
    reach = float(outer[scaled].max(initial=0.0))
    boxes, lower, finished = 0, 0.0, True
    while heap:
        nearest, _, centre, half = heapq.heappop(heap)
        lower = max(lower, nearest)
        if nearest >= best[0] * (1 - precision):
            lower = min(nearest, best[0])
            break
        if time.monotonic() > deadline:
            finished = False
            break
        boxes += 1
        e, free = fit.terms(centre)
        excess, _, weights = fit.excess(e, free)
        least = min(least, excess)
        if excess <= 1 + SLACK:
            size = _size(centre, scaled)
            best = min(best, (size, centre), key=lambda pair: pair[0])
        else:
            values = [fit.witness(weights, centre)]
            for q in points:  # a box that holds a point without witness is not worth the others
                values.append(fit.witness(weights, centre + half * q))
                if values[-1] <= 1:
                    break
            if min(values) - SPARE * (max(values) - min(values)) > 1:
                continue
        k = int(np.argmax(half))
        for side in (-0.5, 0.5):
            part, middle = half.copy(), centre.copy()
            part[k] *= 0.5
            middle[k] += side * half[k]
            inner = np.maximum(np.abs(middle) - part, 0.0)
            near = float(inner[scaled].max(initial=0.0))
            if near < best[0]:
                heapq.heappush(heap, (near, next(counter), middle, part))
    else:
        lower = best[0] if np.isfinite(best[0]) else reach
    _, noise, _ = fit.excess(*fit.terms(best[1]))
    return Parameters(float(lower), float(best[0]), best[1], fit.whole(noise), boxes, finished, float(least))
