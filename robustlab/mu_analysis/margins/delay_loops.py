"""Margins of loops with exact delays: classical ones with all crossings, and disk margins."""

# With S = 1 / (1 + L) of the loop that is opened, the others closed: |L| = 1 where Re S = 1/2, L < 0 where Im S = 0
# and S is not in [0, 1]; S has no pole on the axis. Frequencies are cut into intervals until each is decided by the
# bounds of delay_axis: no zero there, or a derivative of one sign. Beyond the last one L is too small to count. So no
# crossing is overlooked between points.

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np

from robustlab.arrays import Array, ComplexArray, Mask
from robustlab.budget import one_thread
from robustlab.closing import closing
from robustlab.delays.model import DelayedModel, as_delayed
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.mu_analysis.margins.classical import (
    ClassicalMargin,
    ClassicalMargins,
    GainCrossing,
    PhaseCrossing,
    least_changes,
)
from robustlab.mu_analysis.margins.delay_axis import DelayAxis
from robustlab.mu_analysis.margins.delay_margins import (
    FINEST,
    DelayGain,
    DelayProof,
    DelayStability,
    delay_gain,
    delay_stability,
    highest,
    proved_level,
)
from robustlab.mu_analysis.margins.disk_margin import (
    PLACES,
    DiskMargin,
    DiskMargins,
    Place,
    channel_names,
    with_factors,
)
from robustlab.mu_analysis.matrix.bounds import mu
from robustlab.mu_analysis.matrix.upper import upper_bounds
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import ComplexScalar, delta_values

__all__ = ["DelayDiskMargins", "delay_classical_margins", "delay_disk_margins"]

# Intervals that are looked at, at most, and their smallest width relative to the frequency.
MOST, NARROW = 400_000, 1e-10
# Factors of gain beyond these are not looked for: S that near to 0 or 1 is no crossing.
LEAST, LARGEST = 1e-6, 1e3
ROUNDING = 1e-12
LOOKS = 200  # frequencies at which the largest mu is looked for first, twice


class _Loop(NamedTuple):
    """The sensitivity from what enters at each channel to what goes on there, and the channels' names."""

    S: DelayedModel
    names: tuple[str, ...]
    said: str


@dataclass(frozen=True, eq=False)
class DelayDiskMargins(DiskMargins):
    """Disk margins of a loop with exact delays, with the attributes of `DiskMargins`; there is no ``pole``.

    Attributes
    ----------
    lower, upper
        Proved on the whole axis; attained at ``frequency`` by the exact response.
    status
        CERTIFIED: the bounds are within the tolerance. INACCURATE: they are not.
    gains
        Of each channel the gain whose inverse its margin is.
    system, proof
        What the deltas of all factors see, and the scalings that prove their margin, for `robustlab.verify`.
    """

    gains: Mapping[str, DelayGain] = field(default_factory=dict)
    system: DelayedModel | None = None
    proof: DelayProof | None = None


@told_as("delay_classical_margins")
@one_thread()
def delay_classical_margins(
    plant: Any, K: Any = None, *, at: Place = "output", sign: Literal[-1, 1] | None = None, highest_order: int = 16
) -> ClassicalMargins:
    """Of a loop with exact delays: `robustlab.classical_margins`."""
    loop = _closed(plant, K, at, sign, "delay_classical_margins")
    stable = _stability(delay_stability(loop.S, highest_order), highest_order, "delay_classical_margins")
    channels = {}
    for i, name in enumerate(loop.names):
        channels[name] = _classical(DelayAxis(loop.S, [i], [i]), stable, name)
    good = all(m.status is Status.CERTIFIED for m in channels.values())
    return ClassicalMargins(channels, at, Status.CERTIFIED if good else Status.INACCURATE, loop.said)


@told_as("delay_disk_margins")
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
) -> DelayDiskMargins:
    """Of a loop with exact delays: `robustlab.disk_margin`."""
    if not abs(skew) <= 1e6 or not FINEST <= tolerance < 1:
        found = f"skew {skew!r}, tolerance {tolerance!r}"
        raise InputError("delay_disk_margins", found, f"a finite skew, {FINEST:g} <= tolerance < 1")
    loop = _closed(plant, K, at, sign, "delay_disk_margins")
    known = delay_stability(loop.S, highest_order, effort)
    if not _stability(known, highest_order, "delay_disk_margins"):
        raise NoTrustworthyNumber("delay_disk_margins", "the closed loop is unstable", "a stable one")
    seen = loop.S + 0.5 * (skew - 1.0) * np.eye(len(loop.names))
    gains, channels = {}, {}
    for i, name in enumerate(loop.names):
        gains[name] = delay_gain(seen[i, i], tolerance, highest_order, effort, known)
        channels[name] = _of_gain(seen[i, i], gains[name], name, skew)
    every, proof = next(iter(channels.values())), None
    if len(channels) > 1:
        every, proof = _at_once(seen, loop.names, skew, tolerance, known, highest_order, seed, effort)
    return DelayDiskMargins.of(every, channels, at, loop.said, gains=gains, system=seen, proof=proof)


def _stability(known: DelayStability, highest_order: int, where: str) -> bool:
    """Whether the closed loop is stable, which has to be known."""
    if known.stable is None:
        found = f"no set up to order {highest_order} shows whether the closed loop is stable"
        raise NoTrustworthyNumber(where, found, None, "rl.robust_stability(loop, effort=...) may")
    return known.stable


def _closed(plant: Any, K: Any, at: Place, sign: Literal[-1, 1] | None, where: str) -> _Loop:
    """The loop as its channels see it."""
    p = as_delayed(plant, f"{where}: plant")
    if at not in PLACES:
        raise InputError(where, f"at {at!r}", "input, output or both")
    found = closing(p, K, sign, where)
    p, sign = found.plant, found.sign
    if not p.n_inputs * p.n_outputs:
        raise InputError(where, f"an open loop of {p.n_outputs} x {p.n_inputs}", "a square one, or a K")
    k = _renamed(as_delayed(found.K, f"{where}: K") if found.K is not None else as_delayed(_gain(p.n_inputs)), "k")
    q, m, n = _renamed(p, "p"), p.n_inputs, p.n_outputs
    around: Any
    if at == "both":  # [u; y] = [0, sign K; P, 0] [u; y]
        first, last = np.eye(m + n)[:m], np.eye(m + n)[m:]
        around = first.T @ (sign * k) @ last + last.T @ q @ first
    else:
        around = sign * (q @ k if at == "output" else k @ q)
    S = _renamed(as_delayed(_gain(around.n_inputs)), "s").feedback(_renamed(around, "l"), 1)
    names = channel_names(p.input_names, p.output_names, at)
    return _Loop(S, tuple(names), found.said)


def _gain(n: int) -> StateSpaceModel:
    return StateSpaceModel([], [], [], np.eye(n))


def _renamed(model: DelayedModel, prefix: str) -> DelayedModel:
    """With plain names and no units: the parts of a loop may name their signals alike."""
    H, k = model.H, len(model.delays)
    ins = [f"{prefix}z{i}" for i in range(k)] + [f"{prefix}u{i}" for i in range(model.n_inputs)]
    outs = [f"{prefix}w{i}" for i in range(k)] + [f"{prefix}y{i}" for i in range(model.n_outputs)]
    return DelayedModel(StateSpaceModel(H.A, H.B, H.C, H.D, 0.0, ins, outs), model.delays)


# --- classical margins ------------------------------------------------------------------------------------------------


Zeros = tuple[list[float], bool]  # of a real function of frequency, rising, and whether each was decided


def _classical(axis: DelayAxis, stable: bool, name: str) -> ClassicalMargin:
    """Both kinds of crossings of one loop, and what they leave."""
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
    """Where the loop is not negative and of a size that counts, whatever S is within its spread."""
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
    """All zeros in (low, high] of a function of S: each interval is decided, or cut."""
    low, high = ends
    first = np.concatenate([[0.0], np.geomspace(1e-6 * high, high, 41)]) if not low else np.linspace(low, high, 41)
    begin, stop = first[:-1], first[1:]
    found: list[float] = []
    decided, looked = True, 0
    while len(begin):
        looked += len(begin)
        if looked > MOST:
            text = f"more than {MOST} intervals of frequency, the next from {begin[0]:.3g} rad/s"
            raise NoTrustworthyNumber("delay_classical_margins", text, None, "rl.disk_margin")
        half, middle = 0.5 * (stop - begin), 0.5 * (begin + stop)
        seen = axis.seen(middle)
        value, slope = height(seen.value[:, 0, 0]), rate(seen.slope[:, 0, 0])
        curve = axis.curvature(seen, half)
        with np.errstate(invalid="ignore", over="ignore"):
            reach = half * (np.abs(slope) + 0.5 * half * curve)
            none = np.abs(value) > reach + ROUNDING * (1.0 + np.abs(seen.value[:, 0, 0]))
            if ignored is not None:
                spread = half * (np.abs(seen.slope[:, 0, 0]) + 0.5 * half * curve)
                none |= ignored(seen.value[:, 0, 0], np.minimum(seen.spread(half), spread))
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
    """The one zero of a function that rises or falls over the interval, where its ends have different signs."""
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
    """Those where L is negative."""
    made = []
    for omega in sorted(places):
        s = complex(axis.response(np.array([omega]))[0, 0, 0]).real
        if s < -LEAST or s > 1.0 + 1.0 / LARGEST / 2.0:
            made.append(PhaseCrossing(omega, s / (s - 1.0)))
    return tuple(made)


# --- disk margins -----------------------------------------------------------------------------------------------------


def _at_once(
    seen: DelayedModel, names: Sequence[str], skew: float, tolerance: float, known: DelayStability, *options: Any
) -> tuple[DiskMargin, DelayProof | None]:
    """The margin of all channels at once: the peak of mu, found with its Delta, and proved."""
    blocks, (highest_order, seed, effort) = [ComplexScalar(name) for name in names], options
    value, frequency = highest(seen, lambda M: np.array([b.beta for b in upper_bounds(M, blocks, 1e-3)]), LOOKS)
    found = mu(frequency_response(seen, [frequency]), blocks, seed)
    value = float(found.lower[0])
    upper, proof = np.inf, None
    if value:
        upper, proof = proved_level(seen, blocks, value, 0.5 * tolerance, highest_order, effort, known.order)
    delta = delta_values(blocks, found.delta[0]) if found.delta[0] is not None else {}
    status = Status.CERTIFIED if upper <= value * (1.0 + tolerance) else Status.INACCURATE
    bounds = 1.0 / upper, 1.0 / value if value else np.inf
    return with_factors(bounds, frequency, status, blocks, delta, skew), proof


def _of_gain(seen: DelayedModel, gain: DelayGain, name: str, skew: float) -> DiskMargin:
    """The margin of one channel: the inverse of the largest gain of what its disk sees."""
    lower, upper = (1.0 / value if value else np.inf for value in (gain.upper, gain.lower))
    delta = {}
    if gain.lower:
        delta[name] = 1.0 / complex(frequency_response(seen, [gain.frequency])[0, 0, 0])
    return with_factors((lower, upper), gain.frequency, gain.status, [ComplexScalar(name)], delta, skew)
