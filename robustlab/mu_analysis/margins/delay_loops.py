"""Margins of loops with exact delays: classical ones with all crossings, and disk margins."""

# With S = 1 / (1 + L) of the loop that is opened, the others closed: |L| = 1 where Re S = 1/2, L < 0 where Im S = 0
# and S is not in [0, 1]; S has no pole on the axis. Frequencies are cut into intervals until each is decided by the
# bounds of `DelayAxis`: no zero, or a derivative of one sign. Beyond the last one L is negligible. So no crossing is
# missed.

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from robustlab.arrays import Array, ComplexArray, Mask
from robustlab.budget import one_thread
from robustlab.delays.model import DelayedModel, as_delayed
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.feedback import closing
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.mu_analysis.margins.classical import (
    ClassicalMargin,
    ClassicalMargins,
    GainCrossing,
    PhaseCrossing,
    least_changes,
)
from robustlab.mu_analysis.margins.delay_margins import (
    FINEST,
    TINY,
    DelayStability,
    delay_stability,
    highest,
    proved_level,
)
from robustlab.mu_analysis.margins.disk_margin import (
    DiskMargin,
    DiskMargins,
    Place,
    channel_names,
    check_disk,
    disk_channels,
    with_factors,
)
from robustlab.mu_analysis.matrix.bounds import mu
from robustlab.mu_analysis.matrix.upper import upper_bounds
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import ComplexScalar, delta_values

__all__ = ["DelayAxis", "delay_classical_margins", "delay_disk_margins"]

# Largest number of intervals, and their smallest width relative to the frequency.
MOST, NARROW = 400_000, 1e-10
# Factors of gain beyond these are not computed: S that near to 0 or 1 is no crossing.
LEAST, LARGEST = 1e-6, 1e3
ROUNDING = 1e-12
MU_POINTS = 200  # points of each of the two first grids in the search for the largest mu


@error_context("delay_classical_margins")
@one_thread()
def delay_classical_margins(
    plant: Any, K: Any = None, *, at: Place = "output", sign: Literal[-1, 1] | None = None, highest_order: int = 16
) -> ClassicalMargins:
    """`robustlab.classical_margins` of a loop with exact delays."""
    S, names, law = _closed(plant, K, at, 1.0, sign, "delay_classical_margins")
    stable = _stability(delay_stability(S, highest_order), highest_order, "delay_classical_margins")
    channels = {name: _classical(DelayAxis(S, [i], [i]), stable, name) for i, name in enumerate(names)}
    good = all(m.status is Status.CERTIFIED for m in channels.values())
    return ClassicalMargins(channels, at, Status.CERTIFIED if good else Status.INACCURATE, law)


@error_context("delay_disk_margins")
@one_thread()
def delay_disk_margins(
    plant: Any,
    K: Any = None,
    *,
    at: Place = "output",
    skew: float = 0.0,
    sign: Literal[-1, 1] | None = None,
    tolerance: float = 0.01,
    highest_order: int = 16,
    seed: int = 0,
    effort: float = 1.0,
) -> DiskMargins:
    """`robustlab.disk_margin` of a loop with exact delays."""
    where = "delay_disk_margins"
    if not FINEST <= tolerance < 1:
        raise InputError(f"{where}: tolerance", f"{tolerance!r}", f"a number from {FINEST:g} to 1")
    system, names, law = _closed(plant, K, at, skew, sign, where)
    known = delay_stability(system, highest_order, effort)
    if not _stability(known, highest_order, where):
        raise NoTrustworthyNumber(where, "the closed loop is unstable", "a stable one")
    options = skew, tolerance, known, highest_order, seed, effort
    channels = {name: _margin(system[i, i], [name], *options) for i, name in enumerate(names)}
    whole = channels[names[0]] if len(names) == 1 else _margin(system, names, *options)
    return DiskMargins.of(whole, channels, at, law)


def _stability(known: DelayStability, highest_order: int, where: str) -> bool:
    """Return whether the closed loop is stable; fail if that is not known."""
    if known.stable is None:
        found = f"no set up to order {highest_order} shows whether the closed loop is stable"
        raise NoTrustworthyNumber(where, found, None, "rl.robust_stability(loop, effort=...) may")
    return known.stable


def _closed(
    plant: Any, K: Any, at: Place, skew: float, sign: Literal[-1, 1] | None, where: str
) -> tuple[DelayedModel, list[str], str]:
    """Return the closed loop at the channels of its disks, their names, and the law in words."""
    check_disk(at, skew, where)
    found = closing(as_delayed(plant, f"{where}: plant"), K, sign, where)
    p, m = found.plant, found.plant.n_inputs
    if not m * p.n_outputs:
        raise InputError(where, f"an open loop of {p.n_outputs} x {m}", "a square one, or a K")
    k = as_delayed(StateSpaceModel([], [], [], np.eye(m)) if found.K is None else found.K, f"{where}: K")
    H = disk_channels(p.H, k.H, at, skew, found.sign, (len(p.delays), len(k.delays)))
    names = channel_names(p.input_names, p.output_names, at)
    return DelayedModel(H, np.append(p.delays, k.delays)), names, found.said


# --- classical margins ------------------------------------------------------------------------------------------------


Zeros = tuple[list[float], bool]  # rising zeros of a real function of frequency, and whether all are decided


def _classical(axis: DelayAxis, stable: bool, name: str) -> ClassicalMargin:
    """Compute both types of crossings of one loop, and its margins."""
    one = np.eye(1)
    end = axis.end(one, 1.0 / 3.0)  # |L| <= 1/2 where |S - 1| <= 1/3
    if end is None:
        found = f"loop {name}: its gain at high frequencies is not proved to be below one half"
        hint = "a loop with a direct path through a delay: take rl.disk_margin of it"
        raise NoTrustworthyNumber("delay_classical_margins", found, "a loop whose gain falls", hint)
    gains, gains_decided = _zeros(axis, lambda s: s.real - 0.5, lambda d: d.real, None, (0.0, end))
    places, decided = _zeros(axis, np.imag, np.imag, _no_crossing, (0.0, end))
    decided, last = decided and gains_decided, 2.0
    crossings = _phase_crossings(axis, [0.0, *places])
    while (high := min((c.factor for c in crossings if c.factor >= 1), default=LARGEST)) > last and last < LARGEST:
        last = min(2.0 * last, high, LARGEST)
        further = axis.end(one, 1.0 / (1.0 + last)) or np.inf
        if not np.isfinite(further):
            found = f"loop {name}: its gain is not proved to fall below {1 / last:g}"
            raise NoTrustworthyNumber("delay_classical_margins", found)
        if further > end:
            more, more_decided = _zeros(axis, np.imag, np.imag, _no_crossing, (end, further))
            end, decided, places = further, decided and more_decided, places + more
        crossings = _phase_crossings(axis, [0.0, *places])
    met = tuple(_gain_crossing(axis, w) for w in gains)
    status, reason = Status.CERTIFIED, ""
    if not decided:
        status, reason = Status.INACCURATE, "at a frequency it is not decided whether a crossing is only touched"
    kept = tuple(c for c in crossings if c.factor <= max(high, 1.0) * (1 + 1e-9))
    if not stable:
        return ClassicalMargin(False, None, None, None, met, kept, status, reason)
    ends, lag, delay = least_changes(met, crossings, LARGEST)
    return ClassicalMargin(True, ends, lag, delay, met, kept, status, reason)


def _no_crossing(value: ComplexArray, spread: Array) -> Mask:
    """Return where the loop is certainly not negative, or of negligible size, for all S within the spread."""
    inside = (value.real - spread > 0) & (value.real + spread < 1)
    small = (np.abs(value - 1.0) + spread < 1.0 / (1.0 + LARGEST)) | (np.abs(value) + spread < LEAST)
    return inside | small


def _zeros(
    axis: DelayAxis,
    height: Callable[[ComplexArray], Array],
    rate: Callable[[ComplexArray], Array],
    ignored: Callable[[ComplexArray, Array], Mask] | None,
    ends: tuple[float, float],
) -> Zeros:
    """Return all zeros in (low, high] of a function of S: each interval is decided, or cut."""
    low, high = ends
    first = np.concatenate([[0.0], np.geomspace(1e-6 * high, high, 41)]) if not low else np.linspace(low, high, 41)
    begin, stop = first[:-1], first[1:]
    found: list[float] = []
    decided, count = True, 0
    while len(begin):
        count += len(begin)
        if count > MOST:
            text = f"more than {MOST} intervals of frequency, the next from {begin[0]:.3g} rad/s"
            raise NoTrustworthyNumber("delay_classical_margins", text, None, "rl.disk_margin")
        half, middle = 0.5 * (stop - begin), 0.5 * (begin + stop)
        local = axis.local_response(middle)
        value, slope = height(local.value[:, 0, 0]), rate(local.slope[:, 0, 0])
        curve = axis.curvature(local, half)
        with np.errstate(invalid="ignore", over="ignore"):
            reach = half * (np.abs(slope) + 0.5 * half * curve)
            none = np.abs(value) > reach + ROUNDING * (1.0 + np.abs(local.value[:, 0, 0]))
            if ignored is not None:
                spread = half * (np.abs(local.slope[:, 0, 0]) + 0.5 * half * curve)
                none |= ignored(local.value[:, 0, 0], np.minimum(local.spread(half), spread))
            single = ~none & (np.abs(slope) > half * curve)
        for a, b in zip(begin[single].tolist(), stop[single].tolist(), strict=True):
            found += _root(axis, height, a, b)
        open_ = ~none & ~single
        narrow = open_ & (half <= NARROW * (middle + 1e-6 * high))
        found += middle[narrow].tolist()
        decided = decided and not narrow.any()
        cut = open_ & ~narrow
        begin, stop = np.concatenate([begin[cut], middle[cut]]), np.concatenate([middle[cut], stop[cut]])
    found.sort()
    apart = [w for k, w in enumerate(found) if not k or w - found[k - 1] > 10 * NARROW * (w + 1e-6 * high)]
    return apart, decided


def _root(axis: DelayAxis, height: Callable[[ComplexArray], Array], low: float, high: float) -> list[float]:
    """Return the zero of a monotonic function in the interval, if its ends have different signs."""
    from scipy.optimize import brentq

    def at(w: float) -> float:
        return float(height(axis.response(np.array([w]))[:, 0, 0])[0])

    a, b = at(low), at(high)
    if low == 0.0 and abs(a) <= ROUNDING:  # at zero every response is real
        return []
    if b == 0.0 or a * b < 0:
        solve: Any = brentq
        return [high if b == 0.0 else float(solve(at, low, high, xtol=1e-14 * high, rtol=1e-14))]
    return []


def _gain_crossing(axis: DelayAxis, omega: float) -> GainCrossing:
    s = complex(axis.response(np.array([omega]))[0, 0, 0])
    lag = (float(np.angle((1.0 - s) / s)) + math.pi) % (2 * math.pi)
    return GainCrossing(omega, lag, lag / omega)


def _phase_crossings(axis: DelayAxis, places: list[float]) -> tuple[PhaseCrossing, ...]:
    """Return the crossings where L is negative."""
    made = []
    for omega in sorted(places):
        s = complex(axis.response(np.array([omega]))[0, 0, 0]).real
        if s < -LEAST or s > 1.0 + 1.0 / LARGEST / 2.0:
            made.append(PhaseCrossing(omega, s / (s - 1.0)))
    return tuple(made)


# --- disk margins -----------------------------------------------------------------------------------------------------


def _margin(
    system: DelayedModel, names: Sequence[str], skew: float, tolerance: float, known: DelayStability, order: int,
    seed: int, effort: float,
) -> DiskMargin:  # fmt: skip
    """Return the margin of these channels at once: the peak of mu with its Delta, and a proof."""
    blocks = [ComplexScalar(name) for name in names]
    if len(names) == 1:
        _, frequency = highest(system, lambda M: np.abs(M[:, 0, 0]))
    else:
        _, frequency = highest(system, lambda M: np.array([b.beta for b in upper_bounds(M, blocks, 1e-3)]), MU_POINTS)
    found = mu(frequency_response(system, [frequency]), blocks, seed)
    value = float(found.lower[0])
    upper, proof = proved_level(system, blocks, value or TINY, tolerance, order, effort, known.order)
    delta = delta_values(blocks, found.delta[0]) if value else {}
    status = Status.CERTIFIED if upper <= value * (1.0 + tolerance) else Status.INACCURATE
    bounds = 1.0 / upper, 1.0 / value if value else np.inf
    return with_factors(bounds, frequency, status, blocks, delta, skew, system=system, proof=proof)


# --- variation of a response about a point of the axis ---------------------------------------------------------------
#
# With states and outputs of delays as unknowns G(s) = D + C F(s)^-1 B, and |F(j w) - F(j c)| <= h N entry by
# entry for |w - c| <= h, N = diag(I, tau): only the diagonal changes. With m = |T F(jc)^-1 N T^-1| for any diagonal T,
# l = |C F(jc)^-1 N T^-1|, r = |T F(jc)^-1 B| and h m < 1, Neumann's series gives |G(jw) - G(jc)| <= h l r / (1 - h m)
# and |G''| <= l r / (1 - h m)^2 (2 m / (1 - h m) + tau_max). Beyond the bandwidth |(jwI - A)^-1| <= 1 / (w - |A|)
# bounds every entry of the rest, and a nonnegative matrix of spectral radius below one the echoes. Horn, Johnson,
# *Matrix Analysis* (2013), section 5.8; Michiels, Niculescu (2014), chapter 1.

SWEEPS = 6  # of the balancing by T
FASTEST = 60  # doublings of the frequency in the search for the end
CHUNK = 2_000_000  # complex numbers of one batch


class LocalResponse(NamedTuple):
    """At the middles of intervals, (k,): the response (k, n_y, n_u), its derivative, and m, l, r as above."""

    value: ComplexArray
    slope: ComplexArray
    m: Array
    left: Array
    right: Array

    def spread(self, half: Array) -> Array:
        """Bound the distance of the response from ``value`` within ``half`` of the middle; inf where there is none."""
        near = half * self.m
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(near < 1.0, half * self.left * self.right / (1.0 - near), np.inf)


class DelayAxis:
    """The response of a model with exact delays on the axis, of some of its outputs and inputs."""

    def __init__(self, model: DelayedModel, outputs: Sequence[int], inputs: Sequence[int]) -> None:
        self.model, self.delays, self.n = model, model.delays, model.H.n_states
        self.inner, B, C, D = model.balanced_unknowns()
        self.B, self.C, self.D = B[:, list(inputs)], C[list(outputs)], D[np.ix_(outputs, inputs)]
        self.weight = np.concatenate([np.ones(self.n), self.delays])

    def response(self, omega: Array) -> ComplexArray:
        """Return the response, (k, n_y, n_u)."""
        held = np.broadcast_to(self.B, (len(omega), *self.B.shape))
        return self.D + self.C @ np.linalg.solve(self.characteristic(omega), held)

    def local_response(self, middle: Array) -> LocalResponse:
        """Return the data of the bounds about these frequencies."""
        size = max(1, CHUNK // max(len(self.weight) ** 2, 1))
        parts = [self._local_response(middle[k : k + size]) for k in range(0, len(middle), size)]
        return LocalResponse(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def _local_response(self, omega: Array) -> LocalResponse:
        try:
            inverse = np.linalg.inv(self.characteristic(omega))
        except np.linalg.LinAlgError:
            raise NoTrustworthyNumber("delayed loop", "a root of its characteristic equation on the axis") from None
        weighted = inverse * self.weight
        T = _balancing(np.abs(weighted))
        right, left = inverse @ self.B, self.C @ weighted
        turn = np.ones((len(omega), len(self.weight)), dtype=complex)
        turn[:, self.n :] = np.exp(1j * omega[:, None] * self.delays)
        value = self.D + self.C @ right
        slope = -1j * (left * turn[:, None, :]) @ right

        def norm(stack: ComplexArray) -> Array:
            return np.linalg.norm(stack, axis=(1, 2)) if 0 in stack.shape[1:] else np.linalg.norm(stack, 2, axis=(1, 2))

        m = norm(weighted * T[:, :, None] / T[:, None, :])
        return LocalResponse(value, slope, m, norm(left / T[:, None, :]), norm(right * T[:, :, None]))

    def curvature(self, local: LocalResponse, half: Array) -> Array:
        """Bound the second derivative within ``half`` of the middles; inf where there is no bound."""
        near = half * local.m
        with np.errstate(divide="ignore", invalid="ignore"):
            bound = local.left * local.right / (1.0 - near) ** 2
            bound = bound * (2.0 * local.m / (1.0 - near) + self.delays.max(initial=0.0))
        return np.where(near < 1.0, bound, np.inf)

    def far(self, omega: float, about: Array) -> float:
        """Bound ``||G - about||`` at all frequencies from ``omega`` on; inf where there is no bound."""
        n = self.n
        size = float(np.linalg.norm(self.inner[:n, :n], 2)) if n else 0.0
        if n and omega <= size:
            return np.inf
        small = 1.0 / (omega - size) if n else 0.0

        def size_of(direct: Array, out: Array, into: Array) -> Array:
            """Bound each entry: the dynamics between ``into`` and ``out`` have at most the gain ``small``."""
            return np.abs(direct) + small * np.outer(np.linalg.norm(out, axis=1), np.linalg.norm(into, axis=0))

        c1, b1, c2, b2 = self.inner[n:, :n], self.inner[:n, n:], self.C[:, :n], self.B[:n]
        around = size_of(self.inner[n:, n:], c1, b1)
        if len(around) and np.abs(np.linalg.eigvals(around)).max() >= 1.0:
            return np.inf
        echo = np.linalg.solve(np.eye(len(around)) - around, size_of(self.B[n:], c1, b2))
        whole = size_of(self.D - about, c2, b2) + size_of(self.C[:, n:], c2, b1) @ echo
        return float(np.linalg.norm(whole, 2)) if whole.size else 0.0  # numpy 2.0 has no norm of an empty matrix

    def end(self, about: Array, level: float) -> float | None:
        """Return a frequency from which on ``||G - about|| <= level``; None where none is found."""
        omega = max(2.0 * float(np.linalg.norm(self.inner[: self.n, : self.n], 2)) if self.n else 0.0, 1e-6)
        for _ in range(FASTEST):
            if self.far(omega, about) <= level:
                return omega
            omega *= 2.0
        return None

    def characteristic(self, omega: Array) -> ComplexArray:
        """Return F on the axis, (k, n, n), in balanced unknowns."""
        return self.model.with_diagonal(-self.inner, 1j * omega)


def _balancing(size: Array) -> Array:
    """Return diagonal T, (k, n), that balances rows and columns of ``T X T^-1`` (Osborne)."""
    k, n = size.shape[:2]
    T = np.ones((k, n))
    off = size * (1.0 - np.eye(n))
    for _ in range(SWEEPS):
        for i in range(n):
            row = np.einsum("kj,kj->k", off[:, i], 1.0 / T) * T[:, i]
            column = np.einsum("kj,kj->k", off[:, :, i], T) / T[:, i]
            known = (row > 0) & (column > 0)
            T[:, i] *= np.sqrt(np.where(known, column / np.where(known, row, 1.0), 1.0))
    return T
