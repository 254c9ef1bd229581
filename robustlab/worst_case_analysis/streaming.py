"""Responses of any number of samples in constant memory: envelope, mean, quantiles, and the worst sample are kept."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.budget import one_thread
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.result import Status
from robustlab.shown import Facts, Shown, listed, number, with_units
from robustlab.statespace import Signal
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.draws import Deltas, RealSet, is_count
from robustlab.worst_case_analysis.ensemble import (
    Ensemble,
    Excitation,
    Hold,
    Lanes,
    in_lanes,
    is_compiled,
    responses,
    time_responses,
)
from robustlab.worst_case_analysis.tuning import TUNING

T = TypeVar("T")

LABEL = "sampled: the true envelope may be wider"


@dataclass(frozen=True)
class StreamedResponses(Shown):
    """Statistics of time responses over samples; the responses themselves are not kept.

    Attributes
    ----------
    t, u
        Times in s (n_t,), input samples (n_t, n_u).
    nominal, lower, upper, mean, deviation
        Nominal response; smallest, largest, mean value and standard deviation over the samples (the envelope holds the
        nominal response too), each (n_t, n_y).
    quantiles
        Share of samples -> value below which that share lies, (n_t, n_y): middle of a bin of width ``resolution``.
    resolution
        Width of the bins behind the quantiles, (n_t, n_y). In the outermost bins the quantile is the envelope.
    worst
        For each output the sample with the largest ``|y - nominal|`` at any time.
    worst_deltas, worst_y
        Their Deltas, and their responses of that output (n_y, n_t), computed once more by `simulate`.
    peak_deviation
        Their largest deviations, (n_y,).
    n, vertices, seed
        Random samples, vertices after them, seed.
    unstable
        Number of samples with a pole beyond the stability boundary (an integrator is none).
    inputs, outputs
        Signals of u and y.
    status
        CONVERGED; INACCURATE where responses outgrew double precision or the worst ones did not repeat.
    label
        What the envelope is, and is not.
    """

    t: Array
    u: Array
    nominal: Array
    lower: Array
    upper: Array
    mean: Array
    deviation: Array
    quantiles: Mapping[float, Array]
    resolution: Array
    worst: tuple[int, ...]
    worst_deltas: tuple[Mapping[str, Any], ...]
    worst_y: Array
    peak_deviation: Array
    n: int
    vertices: int
    seed: int
    unstable: int
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    status: Status
    label: str = LABEL

    def facts(self) -> Facts:
        """Size, outputs with units, largest deviations."""
        deviations = zip(self.outputs, self.peak_deviation, strict=True)
        return [
            ("members", f"{self.n} and {self.vertices} vertices, seed {self.seed}"),
            ("times", f"{len(self.t)} to {number(float(self.t[-1]), 's')}"),
            ("outputs", with_units(self.outputs)),
            ("largest deviation", listed(f"{s.name} {number(float(value), s.unit)}" for s, value in deviations)),
            ("unstable", f"{self.unstable} members" if self.unstable else ""),
            ("said", self.label),
        ]

    def to_json(self) -> dict[str, object]:
        """All fields."""
        data = vars(self).copy()
        data["inputs"], data["outputs"] = [list(s) for s in self.inputs], [list(s) for s in self.outputs]
        return data


# --- blocks of samples, in order -------------------------------------------------------------------------------------


def blocks_of(count: int, size: int) -> list[slice]:
    """The blocks of ``range(count)``."""
    return [slice(first, min(first + size, count)) for first in range(0, count, size)]


def in_order(function: Callable[[slice], T], parts: Sequence[slice], workers: int) -> Iterator[T]:
    """``function`` of each part in their order, computed by ``workers`` threads that keep a few parts ahead."""
    if not is_count(workers, 1):
        raise InputError("workers", f"{workers!r}", "a whole number, at least 1")
    if workers == 1:
        yield from map(function, parts)
        return
    with ThreadPoolExecutor(workers) as pool:
        ahead: deque[Future[T]] = deque()
        for part in parts:
            ahead.append(pool.submit(function, part))
            if len(ahead) > 2 * workers:
                yield ahead.popleft().result()
        while ahead:
            yield ahead.popleft().result()


# --- statistics ------------------------------------------------------------------------------------------------------


class Bins(NamedTuple):
    """What responses are held against, each (n_t, n_y)."""

    nominal: Array  # nominal response
    # low, per_bin: bins of width `1 / per_bin` from `low` on; the first and the last take all beyond
    low: Array
    per_bin: Array


class Sums(NamedTuple):
    """Running statistics per time and output, each (n_t, n_y); arrays that are added to in place."""

    # lower, upper: smallest and largest value
    lower: Array
    upper: Array
    # total, squares: sums of the deviation from nominal, and of its squares
    total: Array
    squares: Array
    lost: NDArray[np.int64]  # how many values are not finite

    @classmethod
    def empty(cls, shape: tuple[int, int]) -> Sums:
        """Statistics of no samples."""
        lower, upper = np.full(shape, np.inf), np.full(shape, -np.inf)
        return cls(lower, upper, np.zeros(shape), np.zeros(shape), np.zeros(shape, dtype=np.int64))


class _Counts:
    """How many values fall into each bin, (n_t, n_y, n_bins), in as many arrays as threads add to them at a time.

    Whole numbers may be added in any order.
    """

    def __init__(self, shape: tuple[int, int], n_bins: int, samples: int) -> None:
        self._shape, self._dtype = (*shape, n_bins), np.int32 if samples < 2**31 else np.int64
        self._idle: list[NDArray[Any]] = []

    @contextmanager
    def lent(self) -> Iterator[NDArray[Any]]:
        """An array that nobody else adds to meanwhile."""
        try:
            counts = self._idle.pop()
        except IndexError:
            counts = np.zeros(self._shape, dtype=self._dtype)
        yield counts
        self._idle.append(counts)

    def total(self) -> NDArray[Any]:
        """The sum of all of them."""
        return sum(self._idle[1:], start=self._idle[0])


@dataclass
class _Tally:
    """What is known of one block, or of all blocks so far: the worst sample of each output with its deviation, too."""

    sums: Sums
    peak: Array
    worst: NDArray[np.int64]
    unstable: int = 0

    def add(self, other: _Tally) -> None:
        """The samples of ``other`` come after those of this one."""
        np.minimum(self.sums.lower, other.sums.lower, out=self.sums.lower)
        np.maximum(self.sums.upper, other.sums.upper, out=self.sums.upper)
        for mine, theirs in zip(self.sums[2:], other.sums[2:], strict=True):
            mine += theirs
        self.unstable += other.unstable
        higher = other.peak > self.peak
        self.peak, self.worst = np.where(higher, other.peak, self.peak), np.where(higher, other.worst, self.worst)


@dataclass(frozen=True)
class _Stream:
    """Everything that a block needs; a block's result depends on this and on its indices alone."""

    members: RealSet
    deltas: Deltas
    drive: Excitation
    x0: Array
    hold: Hold
    bins: Bins
    counts: _Counts
    first: tuple[Ensemble, Lanes]  # the members of the first block

    def block(self, part: slice) -> _Tally:
        """Statistics of one block."""
        from robustlab.worst_case_analysis.response_kernels import accumulate

        ensemble, lanes = self._members(part)
        n_t, n_y = self.bins.nominal.shape
        sums, peak = Sums.empty((n_t, n_y)), np.empty((part.stop - part.start, n_y))
        with self.counts.lent() as counts:
            accumulate(lanes, self.bins, sums, counts, peak)
        unstable = int(ensemble.is_unstable(TUNING.marginal).sum())
        return _Tally(sums, peak.max(axis=0), part.start + peak.argmax(axis=0), unstable)

    def _members(self, part: slice) -> tuple[Ensemble, Lanes]:
        if not part.start:
            return self.first
        ensemble = self.members.drawn(self.deltas, part, "stream")
        return ensemble, in_lanes(ensemble, self.drive, self.x0, self.hold)


@one_thread()
def stream(
    uncertain: UncertainModel,
    deltas: Deltas,
    drive: Excitation,
    x0: Array,
    hold: Hold,
    quantiles: Sequence[float],
    workers: int,
) -> StreamedResponses:
    """See `robustlab.worst_case_analysis.sampling.Samples.stream`."""
    for q in quantiles:
        if not 0 < q < 1:
            raise InputError("stream", f"quantile {q!r}", "numbers between 0 and 1")
    members = RealSet(uncertain)
    nominal = responses(members.members(np.zeros((1, len(members)))), drive, x0, hold)[0]
    if nominal.size * TUNING.fewest_bins > TUNING.most_counts:
        limit = TUNING.most_counts // TUNING.fewest_bins
        raise InputError("stream", f"{nominal.size} times x outputs", f"at most {limit}", "fewer times or outputs")
    first = members.drawn(deltas, slice(0, min(members.block, len(deltas))), "stream")
    lanes = in_lanes(first, drive, x0, hold)
    n_bins = int(np.clip(TUNING.most_counts // max(1, nominal.size), TUNING.fewest_bins, TUNING.bins))
    bins = _bins(*_envelope(first, lanes, drive, x0, hold, nominal), np.ascontiguousarray(nominal), n_bins)
    n_t, n_y = nominal.shape
    counts = _Counts((n_t, n_y), n_bins, len(deltas))
    job = _Stream(members, deltas, drive, x0, hold, bins, counts, (first, lanes))
    tally = _Tally(Sums.empty((n_t, n_y)), np.full(n_y, -1.0), np.zeros(n_y, dtype=np.int64))
    for found in in_order(job.block, blocks_of(len(deltas), members.block), workers):
        tally.add(found)
    return _result(uncertain, job, tally, quantiles)


def _envelope(
    first: Ensemble, lanes: Lanes, drive: Excitation, x0: Array, hold: Hold, nominal: Array
) -> tuple[Array, Array]:
    """Smallest and largest finite value of some members and the nominal model; infinite where there is none."""
    if is_compiled(len(drive.u), len(x0)):
        from robustlab.worst_case_analysis.response_kernels import accumulate

        nothing, shape = np.zeros(nominal.shape), nominal.shape
        sums, peak = Sums.empty(shape), np.empty((len(first), shape[1]))
        accumulate(lanes, Bins(nothing, nothing, nothing), sums, np.zeros((*shape, 1), dtype=np.int32), peak)
        low, high = sums.lower, sums.upper
    else:
        y = time_responses(first, drive.h, drive.u, x0, hold)
        finite = np.isfinite(y)
        low = np.where(finite, y, np.inf).min(axis=0)
        high = np.where(finite, y, -np.inf).max(axis=0)
    finite = np.isfinite(nominal)
    return np.minimum(low, np.where(finite, nominal, np.inf)), np.maximum(high, np.where(finite, nominal, -np.inf))


def _bins(low: Array, high: Array, nominal: Array, n_bins: int) -> Bins:
    """Bins from the envelope of the first block's responses, widened by half of it on both sides."""
    low, high = np.where(np.isfinite(low), low, 0.0), np.where(np.isfinite(high), high, 0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        width = 2.0 * (high - low) / n_bins
    # Where all samples agree, one bin of any width takes them.
    size = np.maximum(np.abs(low), np.abs(high))
    width = np.where(width > 1e-12 * size, width, np.maximum(1e-12 * size, 1e-300))
    width = np.where(np.isfinite(width), width, np.finfo(float).max)
    middle = 0.5 * low + 0.5 * high
    start = np.ascontiguousarray(middle - 0.5 * n_bins * width)
    return Bins(nominal, start, np.ascontiguousarray(1.0 / width))


def _result(uncertain: UncertainModel, job: _Stream, tally: _Tally, quantiles: Sequence[float]) -> StreamedResponses:
    count, drive, nominal, sums = len(job.deltas), job.drive, job.bins.nominal, tally.sums
    below = np.cumsum(job.counts.total(), axis=2, dtype=np.int64)
    valid = np.maximum(count - sums.lost, 1)
    mean_gap = sums.total / valid
    with np.errstate(over="ignore", invalid="ignore"):
        variance = np.maximum(sums.squares / valid - mean_gap**2, 0.0)
    lower, upper = np.minimum(sums.lower, nominal), np.maximum(sums.upper, nominal)
    gone = sums.lost > 0
    worst = tuple(int(i) for i in tally.worst)
    deltas = tuple(job.deltas[i] for i in worst)
    worst_y, repeats = _worst_again(uncertain, job, deltas, tally.peak)
    return StreamedResponses(
        drive.t,
        drive.u,
        nominal,
        np.where(gone, -np.inf, lower),
        np.where(gone, np.inf, upper),
        np.where(gone, np.nan, nominal + mean_gap),
        np.where(gone, np.nan, np.sqrt(variance)),
        {float(q): np.where(gone, np.nan, _quantile(job.bins, below, q, lower, upper)) for q in quantiles},
        1.0 / job.bins.per_bin,
        worst,
        deltas,
        worst_y,
        tally.peak,
        job.deltas.n,
        len(job.deltas.signs),
        job.deltas.seed,
        tally.unstable,
        uncertain.inputs,
        uncertain.outputs,
        Status.CONVERGED if repeats and not gone.any() else Status.INACCURATE,
    )


def _quantile(bins: Bins, below: NDArray[np.int64], q: float, lower: Array, upper: Array) -> Array:
    """Value of the sample with rank ``ceil(q n)``, to half a bin; the envelope in the outermost bins.

    ``below`` tells how many values fall into each bin and those before it.
    """
    wanted = np.ceil(q * below[:, :, -1:])
    place = (below < wanted).sum(axis=2)
    value = bins.low + (place + 0.5) / bins.per_bin
    value = np.where(place == 0, lower, np.where(place == below.shape[2] - 1, upper, value))
    return np.clip(value, lower, upper)


def _worst_again(
    uncertain: UncertainModel, job: _Stream, deltas: Sequence[Mapping[str, Any]], peak: Array
) -> tuple[Array, bool]:
    """Responses of the worst samples through `simulate`, and whether their deviations are those found."""
    from robustlab.dynamics.simulation import simulate

    drive, repeats = job.drive, True
    y = np.full((len(deltas), len(drive.t)), np.inf)
    for k, (delta, signal) in enumerate(zip(deltas, uncertain.outputs, strict=True)):
        try:
            record = simulate(uncertain.evaluate(delta), drive.t, drive.u, job.x0, hold=job.hold)
        except NoTrustworthyNumber:  # outgrown double precision, as the kernel has seen
            repeats = repeats and not np.isfinite(peak[k])
            continue
        y[k] = record[signal.name]
        again = float(np.abs(y[k] - job.bins.nominal[:, k]).max())
        size = max(float(peak[k]), float(np.abs(y[k]).max()))
        repeats = repeats and abs(again - peak[k]) <= TUNING.agreement * size
    return y, repeats
