r"""Smallest causal time-invariant systems that explain a record, in terms of their pulse responses.

With :math:`w = H * z` for each block, the noise is affine in the pulse responses H where z is known, and

.. math:: \min \gamma \quad \text{s.t.} \quad \bar\sigma(T(H_i)) \le \gamma, \quad n = e - J (H, x_0)

with n within its bound is convex. It is followed along its central path by Newton steps (`contraction_kernel` has the
barrier). At each point of the path the slope of the noise barrier is a dual point: for any lambda orthogonal to what
free states do,

.. math:: \gamma \ge \frac{\lambda^T e - \|\lambda\|_*}{\sum_i \|X_i\|_{tr}}, \qquad
          X_i \text{ any matrix whose diagonal sums are } J_i^T \lambda

which is evaluated exactly: a lower bound whatever the solver did. Where z depends on w or on a free state the problem
is not convex: it is linearised again and again (Gauss-Newton), and the result is an upper bound by an explicit Delta.

References
----------
Poolla et al. (1994), theorem 3.1; Smith and Doyle (1992) for the role of the structure.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from robustlab.arrays import Array, Mask
from robustlab.identification.validation.contraction_kernel import (
    Barrier,
    barrier,
    barrier_value,
    gain,
    pull_after,
    trace_norm_bound,
)
from robustlab.identification.validation.sampled_problem import SampledProblem
from robustlab.identification.validation.tuning import Search
from robustlab.linear_analysis.matrix_equations import lapack

# Rounding in the noise of an explanation, over its bound.
SLACK = 1e-9
# Sizes below and above these count as zero and as infinite.
SMALLEST, HUGE = 1e-6, 1e100


@dataclass(frozen=True)
class PulseResponses:
    """What `smallest_pulse_responses` found, in the scaled signals of the problem."""

    lower: float  # bound that was derived from ``dual`` outside of the search; 0 where the problem is not convex
    upper: float  # largest gain of the scaled blocks, from the pulse responses; inf where none explain the record
    h: tuple[Array, ...]  # for each block (n, r, c); of one channel where it is a repeated scalar
    states: Array  # free states (k,), one start after the other
    # w, z, noise: signals of the replay
    w: Array
    z: Array
    noise: Array
    sizes: Array  # gain of each block
    dual: Array  # multipliers of the noise (n, n_y)
    recheck: Callable[[], float] | None = None  # derives the lower bound again from the dual point


class _Maps:
    """Pulse responses and free responses of a problem, and what Delta does in them."""

    def __init__(self, problem: SampledProblem) -> None:
        self.problem = problem
        self.to_z, self.to_y = problem.markov()
        self.free_z, self.free_y = problem.free_response()
        self.shapes = [
            (problem.n, 1, 1) if repeated else (problem.n, rows.stop - rows.start, cols.stop - cols.start)
            for rows, cols, repeated in problem.blocks
        ]
        self.counts = [int(np.prod(shape)) for shape in self.shapes]
        self.n_free = self.free_y.shape[2]

    def split(self, theta: Array) -> tuple[list[Array], Array]:
        """Pulse responses of the blocks, and free states."""
        ends = np.cumsum(self.counts)
        parts = np.split(theta[: ends[-1]], ends[:-1])
        return [part.reshape(shape) for part, shape in zip(parts, self.shapes, strict=True)], theta[ends[-1] :]

    def whole(self, h: Sequence[Array]) -> Array:
        """Pulse response (n, q, p) of Delta."""
        p = self.problem
        full = np.zeros((p.n, p.B.shape[1], len(p.C1)))
        for part, (rows, cols, repeated) in zip(h, p.blocks, strict=True):
            size = rows.stop - rows.start
            full[:, rows, cols] = part * np.eye(size) if repeated else part
        return full

    def loop(self, full: Array) -> Array:
        """Pulse response (n, q, q) of (I - Delta M11)^-1."""
        n, q = full.shape[0], full.shape[1]
        found = np.zeros((n, q, q))
        around = _convolved(full, self.to_z)
        found[0] = np.linalg.inv(np.eye(q) - around[0])
        if not np.abs(around).max(initial=0.0):
            return found
        for k in range(1, n):
            found[k] = found[0] @ np.einsum("jab,jbc->ac", around[1 : k + 1], found[k - 1 :: -1][:k])
        return found

    def replay(self, theta: Array, loop: Array | None = None) -> tuple[Array, Array, Array]:
        """w, z and noise for pulse responses and free states."""
        p = self.problem
        h, free = self.split(theta)
        full = self.whole(h)
        loop = self.loop(full) if loop is None else loop
        drive = p.z0 + self.free_z @ free
        w = _convolved(loop, _convolved(full, drive[:, :, None]))[:, :, 0]
        z = drive + _convolved(self.to_z, w[:, :, None])[:, :, 0]
        noise = p.e - _convolved(self.to_y, w[:, :, None])[:, :, 0] - self.free_y @ free
        return w, z, noise

    def jacobian(self, theta: Array | None, z: Array) -> Array:
        """Derivative of -noise at the used samples; ``theta`` None: with z as it is, and no loop."""
        p = self.problem
        to_y, free = self.to_y, self.free_y
        if theta is not None:
            h, _ = self.split(theta)
            full = self.whole(h)
            loop = self.loop(full)
            to_y = _convolved(self.to_y, loop)
            if self.n_free:
                free = free + _convolved(to_y, _convolved(full, self.free_z))
        n, n_y = p.e.shape
        lag = np.arange(n)[:, None] - np.arange(n)
        columns = []
        for (_, r, c), (rows, cols, repeated) in zip(self.shapes, p.blocks, strict=True):
            size = rows.stop - rows.start
            response = _convolved(to_y[:, :, rows].reshape(n, -1, 1), z[:, None, cols]).reshape(
                n, n_y, size, cols.stop - cols.start
            )
            if repeated:
                response = np.trace(response, axis1=2, axis2=3)[:, :, None, None]
            padded = np.concatenate([np.zeros_like(response), response])
            slid = padded[lag + n]  # (t, k, y, a, b)
            columns.append(slid.transpose(0, 2, 1, 3, 4).reshape(n, n_y, n * r * c))
        columns.append(free)
        return np.concatenate(columns, axis=2)[p.used]


def _convolved(a: Array, b: Array) -> Array:
    """Product of two pulse responses (n, i, j), (n, j, k)."""
    from scipy import fft

    n = len(a)
    size = fft.next_fast_len(2 * n - 1, real=True)
    product = np.asarray(fft.rfft(a, size, axis=0)) @ np.asarray(fft.rfft(b, size, axis=0))
    return np.asarray(fft.irfft(product, size, axis=0))[:n]


def smallest_pulse_responses(
    problem: SampledProblem, search: Search, guess: float, z_guess: Array | None = None
) -> PulseResponses | None:
    """Bounds over the blocks that are scaled, the others at most 1; None where nothing was found.

    ``guess``: size to start from. ``z_guess``: z of another explanation, where z is not known.
    """
    maps, scaled = _Maps(problem), search.scaled
    rest = np.zeros(sum(maps.counts) + maps.n_free)
    if problem.z_is_known():
        path = _Path(maps, maps.jacobian(None, problem.z0), problem.e[problem.used], search, 1.0)
        theta = path.follow(rest, guess)
        if theta is None:
            return None
        return replace(_answer(maps, theta, scaled, path.lower, path.dual), recheck=path.recheck)
    # First as if the z of the other explanation were given; then Gauss-Newton.
    z = problem.z0 if z_guess is None else z_guess
    inside = 1 - search.tuning.reserve
    first = _Path(maps, maps.jacobian(None, z), problem.e[problem.used], replace(search, precision=0.1), inside)
    theta = first.follow(rest, guess, dual=False)
    best: PulseResponses | None = None
    for _ in range(search.tuning.gauss_newton_rounds):
        if theta is None or search.budget.over:
            break
        answer = _answer(maps, theta, scaled, 0.0, np.zeros(problem.e.shape))
        if problem.excess(answer.noise) <= 1 + SLACK and (best is None or answer.upper < best.upper):
            done = best is not None and answer.upper > best.upper * (1 - 0.2 * search.precision)
            best = answer
            if done:
                break
        J = maps.jacobian(theta, answer.z)
        path = _Path(maps, J, answer.noise[problem.used] + J @ theta, search, inside)
        theta = path.follow(theta, float(answer.sizes[scaled].max(initial=0.0)), dual=False)
    return best


def _answer(maps: _Maps, theta: Array, scaled: Mask, lower: float, dual: Array) -> PulseResponses:
    h, free = maps.split(theta)
    w, z, noise = maps.replay(theta)
    sizes = np.array([gain(part) for part in h])
    beyond = (sizes[~scaled] > 1 + 1e-6).any() or maps.problem.excess(noise) > 1 + SLACK
    upper = np.inf if beyond else float(sizes[scaled].max(initial=0.0))
    return PulseResponses(lower, upper, tuple(h), free, w, z, noise, sizes, dual)


class _Path:
    """Central path of the convex problem ``n = e - J theta``."""

    def __init__(self, maps: _Maps, J: Array, e: Array, search: Search, share: float) -> None:
        p = maps.problem
        self.maps, self.J, self.e, self.search, self.scaled = maps, J, e, search, search.scaled
        output = np.broadcast_to(np.arange(p.e.shape[1]), p.e.shape)[p.used]
        # Peak bounds: each sample for itself; rms: the samples of an output together.
        self.groups = None if p.norm == "peak" else [output == j for j in range(p.e.shape[1])]
        self.radius = share * (np.ones(len(e)) if self.groups is None else p.radius)
        # The barrier of a group counts as often as it has samples: else it is far stiffer than those of the blocks.
        self.weight = np.ones(len(e)) if self.groups is None else np.array([float(g.sum()) for g in self.groups])
        self.count = sum(n * (r + c) for n, r, c in maps.shapes) + 2 * float(self.weight.sum())
        self.lower, self.dual = 0.0, np.zeros(p.e.shape)
        m, size = J.shape
        # Of a Newton step: its system and the barriers.
        self.work = (
            500 + size**3 / 30_000 + m * size**2 / 5000 + sum(n**3 * min(r, c) / 1000 for n, r, c in maps.shapes)
        )
        self.last = np.zeros(0), 1.0, np.zeros(0)
        self.recheck: Callable[[], float] | None = None

    def follow(self, theta: Array, guess: float, dual: bool = True) -> Array | None:
        """A point near the optimum; None where no point within the noise bound was reached."""
        tuning, precision, budget = self.search.tuning, self.search.precision, self.search.budget
        if not theta.any():
            theta = self._regularised()
        h, _ = self.maps.split(theta)
        sizes = np.array([gain(part) for part in h])
        if (sizes[~self.scaled] >= 1).any() or sizes[self.scaled].max(initial=0.0) > tuning.far * guess:
            theta = np.concatenate([np.zeros(sum(self.maps.counts)), theta[sum(self.maps.counts) :]])
            sizes = np.full(len(h), max(guess, SMALLEST) if self.scaled.all() else 1.0)
        gamma = max(1.3 * float(sizes[self.scaled].max(initial=0.0)), 1.5 * guess, 1e-12)
        unit = gamma
        sigma = 1.1 * self._excess(self.e - self.J @ theta)
        inside = sigma < 1.1 * 0.995
        sigma = 1.0 if inside else sigma
        t, penalty, steps, before, fastest = 8.0 * self.count, 0, 0, np.inf, tuning.faster
        centred = theta, gamma, t
        for _ in range(tuning.path_steps):
            if budget.over and not inside:
                return None
            weight = None if inside else max(t, self.count / sigma) * tuning.penalties[penalty]
            theta, gamma, sigma, decrement = self._newton(theta, gamma, sigma, t / unit, weight)
            budget.spend(self.work)
            steps += 1
            if not inside and sigma < 0.995:
                inside, sigma, steps = True, 1.0, 0
                continue
            left = self.count / t * unit
            wanted = precision * max(gamma, SMALLEST)
            falls, before = decrement < tuning.falls * before, decrement
            rough = (
                inside
                and falls
                and steps <= tuning.usual_steps
                and decrement < tuning.roughly * self.count
                and left > 8 * wanted
            )
            if decrement > tuning.centred and not rough:
                if inside and steps > tuning.long_steps and t > tuning.slowest * centred[2]:
                    fastest, steps, before = max(np.sqrt(t / centred[2]), tuning.slowest), 0, np.inf
                    theta, gamma, t = centred[0], centred[1], fastest * centred[2]
                continue
            if not inside:
                penalty += 1
                if penalty == len(tuning.penalties):
                    return None
                continue
            late = budget.over
            if dual and (left < 8 * wanted or late):
                self._bound()
                if gamma - self.lower < 0.7 * wanted or left < 1e-3 * wanted or late:
                    return theta
            elif left < 0.3 * wanted or late:
                return theta
            aim = left / (0.4 * wanted if dual else 0.25 * wanted)
            faster = fastest if steps <= tuning.usual_steps else min(fastest, tuning.slower)
            centred = theta, gamma, t
            t, steps = t * (min(faster, aim) if aim > 1 else faster), 0
            before = np.inf
        return theta if inside else None

    def _regularised(self) -> Array:
        """Least squares, held back as far as the noise bound allows: a start within it where there is one."""
        from scipy.linalg import cho_factor, cho_solve

        n_h = sum(self.maps.counts)
        scale = np.ones(self.J.shape[1])
        scale[n_h:] = 1e3 * np.sqrt(
            (self.J[:, :n_h] ** 2).sum(axis=0).max() / np.maximum((self.J[:, n_h:] ** 2).sum(axis=0), 1e-300)
        )
        scaled = self.J * scale
        gram = scaled @ scaled.T
        size = float(np.trace(gram)) / len(gram) + 1e-300
        theta = np.zeros(self.J.shape[1])
        for held in 10.0 ** -np.arange(0.0, 11.0):
            factor = cho_factor(gram + held * size * np.eye(len(gram)), check_finite=False)
            theta = scale * (scaled.T @ cho_solve(factor, self.e, check_finite=False))
            if self._excess(self.e - self.J @ theta) < 0.9:
                break
        return theta

    def _excess(self, noise: Array) -> float:
        if self.groups is None:
            return float((np.abs(noise) / self.radius).max(initial=0.0))
        return max(float(np.linalg.norm(noise[g])) / r for g, r in zip(self.groups, self.radius, strict=True))

    def _noise_value(self, noise: Array, sigma: float) -> float:
        room = self._room(noise, sigma)
        return np.inf if (room <= 0).any() else -float(self.weight @ np.log(room))

    def _room(self, noise: Array, sigma: float) -> Array:
        squares = noise**2 if self.groups is None else np.array([noise[g] @ noise[g] for g in self.groups])
        return (sigma * self.radius) ** 2 - squares

    def _slope(self, noise: Array, sigma: float) -> Array:
        """Slope of the noise barrier in the noise."""
        room = self._room(noise, sigma)
        if self.groups is None:
            return 2 * noise / room
        slope = np.zeros_like(noise)
        for g, r, k in zip(self.groups, room, self.weight, strict=True):
            slope[g] = 2 * k * noise[g] / r
        return slope

    def _value(self, theta: Array, gamma: float, sigma: float, t: float, penalty: float | None) -> float:
        noise = self._noise_value(self.e - self.J @ theta, sigma)
        if not np.isfinite(noise) or not 0 < gamma < HUGE:
            return np.inf
        value = t * gamma + (0.0 if penalty is None else penalty * sigma) + noise
        for part, free in zip(self.maps.split(theta)[0], self.scaled, strict=True):
            value += barrier_value(part, gamma if free else 1.0)
        return value

    def _newton(
        self, theta: Array, gamma: float, sigma: float, t: float, penalty: float | None
    ) -> tuple[Array, float, float, float]:
        """One damped Newton step on (theta, gamma, and sigma where it has a penalty), and the decrement before it."""
        h, _ = self.maps.split(theta)
        size = len(theta)
        total = size + 1 + (penalty is not None)
        noise = self.e - self.J @ theta
        slope, curve = np.zeros(total), np.zeros((total, total))
        slope[size] = t
        self._add_noise(slope, curve, noise, sigma, penalty)
        at, value = 0, t * gamma + (penalty or 0.0) * sigma + self._noise_value(noise, sigma)
        for part, count, free in zip(h, self.maps.counts, self.scaled, strict=True):
            b: Barrier = barrier(part, gamma if free else 1.0)
            here = slice(at, at + count)
            value += b.value
            slope[here] += b.slope
            curve[here, here] += b.curve
            if free:
                slope[size] += b.slope_gamma
                curve[size, size] += b.curve_gamma
                curve[here, size] += b.cross
                curve[size, here] += b.cross
            at += count
        found = _newton_move(curve, slope)
        if found is None:
            return theta, gamma, sigma, 0.0
        move = found
        decrement = float(-slope @ move)
        self.last = theta, gamma, move
        length = 1.0

        def along(share: float) -> tuple[Array, float, float]:
            width = sigma + share * float(move[size + 1]) if penalty is not None else sigma
            return theta + share * move[:size], float(gamma + share * move[size]), width

        while length > 1e-8:
            new = along(length)
            if new[2] > 0 and self._value(*new, t, penalty) <= value - 1e-2 * length * decrement:
                # Not up against the boundary: from there the way back takes a step for each factor of two.
                ahead = along(length / self.search.tuning.kept)
                if decrement < 0.3 or (ahead[2] > 0 and np.isfinite(self._value(*ahead, t, penalty))):
                    return *new, decrement
            length *= 0.7
        return theta, gamma, sigma, 0.0

    def _add_noise(self, slope: Array, curve: Array, noise: Array, sigma: float, penalty: float | None) -> None:
        """Barrier of the noise: slope and curvature in theta and, where it moves, in sigma."""
        size = self.J.shape[1]
        room = self._room(noise, sigma)
        down = self._slope(noise, sigma)
        slope[:size] -= self.J.T @ down
        wide = (sigma * self.radius) ** 2
        if self.groups is None:
            root = np.sqrt(2 * (wide + noise**2)) / room
            leaned = self.J * root[:, None]
            curve[:size, :size] = leaned.T @ leaned
            across = 4 * sigma * self.radius**2 * noise / room**2
            mixed = self.J.T @ across
        else:
            each = np.zeros_like(noise)
            mixed = np.zeros(size)
            for g, r, k in zip(self.groups, room, self.weight, strict=True):
                each[g] = np.sqrt(2 * k / r)
            leaned = self.J * each[:, None]
            curve[:size, :size] = leaned.T @ leaned
            for g, r, w, k in zip(self.groups, room, wide, self.weight, strict=True):
                pull = self.J[g].T @ noise[g]
                curve[:size, :size] += (4 * k / r**2) * np.outer(pull, pull)
                mixed += (4 * k * w / sigma / r**2) * pull
        if penalty is not None:
            if self.groups is None:
                second = float((2 * self.radius**2 * (wide + noise**2) / room**2).sum())
            else:
                squares = wide - room
                second = float((self.weight * 2 * self.radius**2 * (wide + squares) / room**2).sum())
            slope[size + 1] = penalty - float((self.weight * 2 * wide / sigma / room).sum())
            curve[size + 1, size + 1] = second
            curve[:size, size + 1] = mixed
            curve[size + 1, :size] = mixed

    def _bound(self) -> None:
        """Lower bound from the last Newton step; kept where it is the best so far.

        The slopes of the barriers after the step, to first order, balance each other exactly: the diagonal sums of X
        are J' lambda without any correction.
        """
        theta, gamma, move = self.last
        maps = self.maps
        n_h = sum(maps.counts)
        noise, change = self.e - self.J @ theta, -self.J @ move[: len(theta)]
        room = self._room(noise, 1.0)
        multipliers = self._slope(noise, 1.0)
        if self.groups is None:
            multipliers = multipliers + 2 * (self.radius**2 + noise**2) / room**2 * change
        else:
            for g, r, k in zip(self.groups, room, self.weight, strict=True):
                multipliers[g] += k * (2 / r * change[g] + 4 / r**2 * noise[g] * (noise[g] @ change[g]))
        if maps.n_free:
            free = self.J[:, n_h:]
            multipliers = multipliers - free @ np.linalg.lstsq(free, multipliers, rcond=None)[0]
        pulls = []
        for part, step, s in zip(*(maps.split(x)[0] for x in (theta, move[: len(theta)])), self.scaled, strict=True):
            pulls.append(pull_after(part, step, gamma if s else 1.0, float(move[len(theta)]) if s else 0.0))
        pairs = self.J[:, :n_h]

        def value() -> float:
            return dual_bound(maps.shapes, pairs, self.e, multipliers, pulls, self.scaled, self.radius, self.groups)

        found = value()
        if found > self.lower:
            self.lower, self.recheck = found, value
            self.dual = np.zeros(maps.problem.e.shape)
            self.dual[maps.problem.used] = multipliers


def _newton_move(curve: Array, slope: Array) -> Array | None:
    """``-curve^-1 slope``, lifted as far as it takes for the curvature to be positive; None where that is too far."""
    weight = 1.0 / np.sqrt(np.maximum(np.diag(curve), 1e-300))
    lift = 1e-13
    while lift < 1e-2:
        scaled = curve * weight
        scaled *= weight[:, None]
        scaled.flat[:: len(slope) + 1] += lift
        factor, info = lapack().dpotrf(scaled.T, lower=1, overwrite_a=1)
        if not info:
            solved, _ = lapack().dpotrs(factor, weight * slope, lower=1)
            return -weight * solved
        lift *= 100
    return None


def dual_bound(
    shapes: Sequence[tuple[int, int, int]],
    J: Array,
    e: Array,
    multipliers: Array,
    pulls: Sequence[Array],
    scaled: Mask,
    radius: Array,
    groups: Sequence[Mask] | None,
) -> float:
    """Lower bound of gamma that any multipliers of the noise prove, once they are orthogonal to the free states."""
    if groups is None:
        noise = float(radius @ np.abs(multipliers))
    else:
        noise = sum(r * float(np.linalg.norm(multipliers[g])) for g, r in zip(groups, radius, strict=True))
    left = float(multipliers @ e) - noise
    pairs = multipliers @ J
    norm, at = 0.0, 0
    for shape, X, free in zip(shapes, pulls, scaled, strict=True):
        count = int(np.prod(shape))
        size = trace_norm_bound(X, pairs[at : at + count].reshape(shape))
        at += count
        if free:
            norm += size
        else:
            left -= size
    return max(left / norm, 0.0) if norm > 0 else 0.0
