"""Where an error lives: in time, in speed and position, in frequency; and the gap in multiples of the noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.identification.comparison.repeats import Excess, NoiseFloor
from robustlab.identification.response.response import Response, Stretch
from robustlab.identification.response.windowed_simulation import fit_state, window_edges
from robustlab.record import Record
from robustlab.result import Evidence

SPEED_UNITS = ("m/s", "rad/s", "mm/s", "deg/s", "rpm", "1/min")
POSITION_UNITS = ("m", "rad", "mm", "deg")
POLYNOMIAL = 3  # order of the Savitzky-Golay polynomial
SEGMENTS = 8  # Welch segments that fit into the record side by side
LONGEST_SEGMENT = 8192
CONFIDENCE = 0.99
REST = 0.02  # speeds below this share of the largest count as rest


@dataclass(frozen=True)
class Motion(Evidence):
    """Measured speed and position along the record, against which errors are sorted."""

    # speed, position: samples (n,), or None where the record has no such signal
    speed: Array | None
    position: Array | None
    # speed_unit, position_unit: their units
    speed_unit: str
    position_unit: str
    speed_source: str  # ``"v"``, or ``"derivative of q (Savitzky-Golay, order 3, 49 samples)"``
    position_name: str  # name of the position signal


@dataclass(frozen=True)
class Bin(Evidence):
    """Error of one output over the samples whose speed (or position) lies in ``[low, high)``."""

    # low, high: Edges
    low: float
    high: float
    samples: int  # how many samples lie within
    # mean, rms: mean and RMS of the error in units of the output (0 where there is no sample)
    mean: float
    rms: float
    share: float  # share of the record's squared error, 0..1; the shares of all bins sum to 1


@dataclass(frozen=True)
class DirectionError(Evidence):
    """Error of one output over the samples that move in one direction, or rest."""

    samples: int  # how many samples lie within
    # mean, rms: mean and RMS of the error in units of the output; None where there is no sample
    mean: float | None
    rms: float | None
    share: float  # share of the record's squared error, 0..1


@dataclass(frozen=True)
class Spectrum(Evidence):
    r"""Power spectral densities by Welch's method, and the coherence of the inputs with the error.

    Hann window, half overlap, mean kept (a constant error is an error at frequency 0).
    """

    frequency: Array  # frequencies in Hz, shape (n_f,)
    # measured, simulated, error: One-sided densities of the measured output, the free run, and its error in unit²/Hz,
    # shape (n_f,). The windowed error has none: it starts anew in every window, so its frequencies are those of the
    # windows.
    measured: Array
    simulated: Array
    error: Array
    # input name -> magnitude-squared coherence with the error, shape (n_f,): the share of the error at that frequency
    # that is linear in this input
    coherence: Mapping[str, Array]
    coherence_level: float  # 99 % of the coherences of independent signals lie below this
    bands: Array  # edges of the bands in Hz, shape (n_bands + 1,)
    error_share: Array  # share of the squared error per band, shape (n_bands,), sum 1
    # RMS of the free run's error over RMS of the measured output within each band, shape (n_bands,); 0 where nothing
    # was measured
    relative_error: Array

    def band_table(self) -> dict[str, object]:
        """The bands only."""
        return {"bands": self.bands, "error_share": self.error_share, "relative_error": self.relative_error}


def time_shares(error: ArrayLike, edges: ArrayLike) -> Array:
    """Share of the squared error in each window, shape (n_windows,); sum 1, or all 0 for an error of zeros."""
    squared = np.add.reduceat(np.asarray(error, dtype=float) ** 2, np.asarray(edges, dtype=int)[:-1])
    total = squared.sum()
    return squared / total if total else squared


def motion_of(record: Record, speed: str | None, position: str | None, window: int) -> Motion:
    """Speed and position of a record: as named, else the first outputs in such units.

    Failing that the speed is the derivative of the position by a Savitzky-Golay filter over a tenth of the window.
    """
    position = position or _first_in(record, POSITION_UNITS)
    speed = speed or _first_in(record, SPEED_UNITS)
    q = record[position] if position else None
    q_unit = record.unit(position) if position else ""
    if speed:
        return Motion(record[speed], q, record.unit(speed), q_unit, speed, position or "")
    if q is None or record.n < 5:
        return Motion(None, q, "", q_unit, "", position or "")
    from scipy.signal import savgol_filter

    length = min(max(5, window // 10), record.n)
    length -= 1 - length % 2
    slope = np.asarray(savgol_filter(q, length, POLYNOMIAL, deriv=1, delta=record.dt), dtype=np.float64)
    source = f"derivative of {position} (Savitzky-Golay, order {POLYNOMIAL}, {length} samples)"
    return Motion(slope, q, f"{q_unit}/s" if q_unit else "1/s", q_unit, source, position or "")


def _first_in(record: Record, units: tuple[str, ...]) -> str | None:
    return next((name for name in record.outputs if record.unit(name) in units), None)


def speed_edges(speed: Array, per_direction: int = 5) -> Array:
    """Edges of speed bins, symmetric about a bin of rest, shape (2 per_direction + 2,).

    Rest is below 2 % of the largest speed.
    """
    top = float(np.abs(speed).max()) or 1.0
    forward = np.linspace(REST * top, top, per_direction + 1)
    return np.concatenate([-forward[::-1], forward])


def position_edges(position: Array, count: int = 10) -> Array:
    """Edges of ``count`` bins of equal width over the measured range."""
    low, high = float(position.min()), float(position.max())
    return np.linspace(low, high if high > low else low + 1.0, count + 1)


def bins(value: Array, error: Array, edges: Array) -> tuple[Bin, ...]:
    """Sort an error (n,) by ``value`` (n,) into bins; values outside all edges go to the outermost bins."""
    index = np.clip(np.searchsorted(edges, value, side="right") - 1, 0, len(edges) - 2)
    total = float((error**2).sum()) or 1.0
    result: list[Bin] = []
    for k in range(len(edges) - 1):
        inside = error[index == k]
        squared = float((inside**2).sum())
        mean, rms = (float(inside.mean()), float(np.sqrt(squared / len(inside)))) if len(inside) else (0.0, 0.0)
        result.append(Bin(float(edges[k]), float(edges[k + 1]), len(inside), mean, rms, squared / total))
    return tuple(result)


def amplitude_edges(value: Array, count: int = 6) -> Array:
    """Edges of ``count`` bins of equal width from 0 to the largest magnitude."""
    return np.linspace(0.0, float(np.abs(value).max()) or 1.0, count + 1)


def directions(speed: Array, error: Array) -> dict[str, DirectionError]:
    """Sort an error (n,) by the direction of the speed (n,): ``"backward"``, ``"rest"`` (below 2 % of the largest
    speed), ``"forward"``.
    """
    limit = REST * float(np.abs(speed).max())
    total = float((error**2).sum()) or 1.0
    sides = {"backward": speed < -limit, "rest": np.abs(speed) <= limit, "forward": speed > limit}
    result: dict[str, DirectionError] = {}
    for name, side in sides.items():
        inside = error[side]
        squared = float((inside**2).sum())
        mean, rms = (float(inside.mean()), float(np.sqrt(squared / len(inside)))) if len(inside) else (None, None)
        result[name] = DirectionError(len(inside), mean, rms, squared / total)
    return result


def uniform_samples(t: Array, *signals: Array) -> tuple[float, list[Array]]:
    """Mean sample time and the signals (n,); on an uneven clock they are interpolated linearly to its mean step."""
    dt = float(t[-1] - t[0]) / (len(t) - 1)
    grid = t[0] + dt * np.arange(len(t))
    if np.abs(t - grid).max() <= 1e-3 * dt:
        return dt, list(signals)
    return dt, [np.interp(grid, t, x) for x in signals]


def welch_segments(n: int) -> tuple[int, float]:
    """Length of the half-overlapping segments of Welch's method for n samples, and their effective number."""
    segment = min(n, max(16, min(2 * n // (SEGMENTS + 1), LONGEST_SEGMENT)))
    count = 1 + (n - segment) // (segment - segment // 2)
    # Periodograms of half-overlapping Hann windows are correlated by 1/36: as good as so many independent ones.
    return segment, count / (1.0 + (count - 1) / count / 18.0)


def spectrum(t: Array, inputs: Mapping[str, Array], measured: Array, simulated: Array) -> Spectrum:
    """Spectra of one output; see `Spectrum`. A clock that is not uniform is interpolated linearly to its mean step."""
    from scipy.signal import coherence, welch

    dt, (measured, simulated, *columns) = uniform_samples(t, measured, simulated, *inputs.values())
    inputs = dict(zip(inputs, columns, strict=True))
    segment, averages = welch_segments(len(t))
    options: dict[str, Any] = {"fs": 1.0 / dt, "window": "hann", "nperseg": segment, "noverlap": segment // 2}
    error = measured - simulated
    densities = [welch(x, detrend=cast("Any", False), **options) for x in (measured, simulated, error)]
    f, (p_measured, p_simulated, p_error) = densities[0][0], (density for _, density in densities)
    with np.errstate(invalid="ignore", divide="ignore"):  # 0 / 0 where a signal has no power: coherence 0
        shared = {
            name: np.nan_to_num(coherence(x, error, detrend="constant", **options)[1], posinf=0.0)
            for name, x in inputs.items()
        }
    level = 1.0 - (1.0 - CONFIDENCE) ** (1.0 / (averages - 1.0)) if averages > 1 else 1.0
    edges = np.array([0.0, *log_bands(1.5 * f[1], f[-1])[1:-1], f[-1]])
    of_measured, of_error = (_band_power(f, p, edges) for p in (p_measured, p_error))
    relative = np.sqrt(np.divide(of_error, of_measured, out=np.zeros_like(of_error), where=of_measured > 0))
    return Spectrum(f, p_measured, p_simulated, p_error, shared, level, edges, _shares(of_error), relative)


def log_bands(lowest: float, highest: float) -> Array:
    """Edges from ``lowest`` to ``highest``, between them two bands a decade on round numbers (1, 3, 10, 30, ...)."""
    if not highest > lowest:
        return np.array([lowest, lowest * (1.0 + 1e-9)])
    decades = 10.0 ** np.arange(np.floor(np.log10(lowest)) - 1, np.ceil(np.log10(highest)) + 1)
    rounded = np.sort(np.concatenate([decades, 3.0 * decades]))
    inner = rounded[(rounded > lowest) & (rounded < 0.9 * highest)]
    return np.concatenate([[lowest], inner, [highest]])


def _band_power(f: Array, density: Array, edges: Array) -> Array:
    index = np.clip(np.searchsorted(edges, f, side="right") - 1, 0, len(edges) - 2)
    return np.bincount(index, weights=density, minlength=len(edges) - 1) * (f[1] - f[0])


def _shares(power: Array) -> Array:
    total = power.sum()
    return power / total if total else power


@dataclass(frozen=True)
class NoiseGap(Evidence):
    """Gap of one output in multiples of its noise."""

    std: float  # noise of a single sample of the output, in its unit (`NoiseFloor.std`)
    # rms_percent, windowed_rms_percent: RMS of the free run's and of the windowed error in percent of ``std``: 100 is a
    # model as good as the noise allows. None where the repeats are equal to the last bit.
    rms_percent: float | None
    windowed_rms_percent: float | None
    # `Excess` of the windowed error, with windows at the same phases of every repeat. Its ``noise`` is the floor of the
    # windowed error itself: in closed loop it is larger than ``std``, as the noise enters at the input too.
    excess: Excess


def repeated(floor: NoiseFloor, whole: Stretch, others: Sequence[Stretch]) -> list[Stretch]:
    """The repeats that a floor is of, at equal phases: periods of the record, or the record and the others."""
    if floor.source == "periods":
        starts = floor.first + floor.samples * np.arange(floor.count)
        return [whole.cut(int(a), int(a) + floor.samples) for a in starts]
    return [replace(s.cut(0, floor.samples), weight=whole.weight) for s in (whole, *others)]


def noise_gaps(
    outputs: Sequence[str], errors: Array, floor: NoiseFloor, rms: Mapping[str, tuple[float, float]]
) -> dict[str, NoiseGap]:
    """Gap against the floor for every output.

    ``errors``: measured minus windowed simulation of every repeat, cut at the same phases, (count, samples, n_y).
    ``rms``: output name -> RMS of the free run's error (NaN where there is none) and of the windowed error.
    """
    result: dict[str, NoiseGap] = {}
    for k, name in enumerate(outputs):
        std = floor.std[name]
        free, windowed = (100.0 * value / std if std else None for value in rms[name])
        result[name] = NoiseGap(std, free, windowed, floor.excess(errors[:, :, k]))
    return result


def windowed_error(response: Response, part: Stretch, length: int) -> Array:
    """Measured minus windowed simulation of one repeat, shape (samples, n_y)."""
    edges = window_edges(len(part.t), length)
    free = response.free_response(part.t[: int(np.diff(edges).max())])
    error = np.empty_like(part.y)
    for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        window = part.cut(a, b)
        error[a:b] = window.y - fit_state(response, window, free[: b - a]).y
    return error
