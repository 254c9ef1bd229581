"""Sizes, places and tests of free-run and windowed errors, common to linear and nonlinear plants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.errors import InputError
from robustlab.identification.comparison.repeats import Excess
from robustlab.identification.comparison.residual_tests import (
    InputCorrelation,
    Whiteness,
    input_correlation,
    whiteness,
)
from robustlab.identification.response.response import Stretch
from robustlab.identification.response.windowed_simulation import WindowedSimulation
from robustlab.record import Record
from robustlab.result import Evidence
from robustlab.statespace import Signal

SPEED_UNITS = ("m/s", "rad/s", "mm/s", "deg/s", "rpm", "1/min")
POSITION_UNITS = ("m", "rad", "mm", "deg")
POLYNOMIAL = 3  # order of the Savitzky-Golay polynomial
SEGMENTS = 8  # Welch segments that fit into the record side by side
LONGEST_SEGMENT = 8192
CONFIDENCE = 0.99
LINEAR_SHARE = 0.1  # of the error; a larger difference from the nonlinear plant gives a warning
REST = 0.02  # speeds below this share of the largest count as standstill
PER_DIRECTION, POSITION_BINS, AMPLITUDE_BINS = 5, 10, 6  # numbers of bins


@dataclass(frozen=True)
class Motion(Evidence):
    """Measured speed and position along the record, against which errors are sorted."""

    # speed, position: samples (n,), or None where the record has no such signal
    speed: Array | None
    position: Array | None
    speed_unit: str
    position_unit: str
    speed_source: str  # ``"v"``, or ``"derivative of q (Savitzky-Golay, order 3, 49 samples)"``
    position_name: str  # name of the position signal


@dataclass(frozen=True)
class Bin(Evidence):
    """Error of one output over the samples whose speed (or position) is in ``[low, high)``."""

    low: float
    high: float
    samples: int  # number of samples within
    # mean, rms: mean and RMS of the error in units of the output (0 where there is no sample)
    mean: float
    rms: float
    share: float  # of the record's squared error, 0..1; the shares of all bins sum to 1


@dataclass(frozen=True)
class Spectrum(Evidence):
    r"""Power spectral densities by Welch's method, and the coherence of the inputs with the error.

    Hann window, half overlap, mean kept (a constant error is an error at frequency 0).
    """

    frequency: Array  # frequencies in Hz, shape (n_f,)
    # measured, simulated, error: one-sided densities of the measured output, the free run, and its error in unit²/Hz,
    # shape (n_f,). The windowed error has none: it restarts in every window, which sets its frequencies.
    measured: Array
    simulated: Array
    error: Array
    # input name -> magnitude-squared coherence with the error, shape (n_f,): the share of the error at that frequency
    # that is linear in this input
    coherence: Mapping[str, Array]
    coherence_level: float  # 99 % of the coherences of independent signals are below this
    bands: Array  # edges of the bands in Hz, shape (n_bands + 1,)
    error_share: Array  # share of the squared error per band, shape (n_bands,), sum 1
    # RMS of the free run's error over RMS of the measured output within each band, shape (n_bands,); 0 where nothing
    # was measured
    relative_error: Array

    def band_table(self) -> dict[str, object]:
        return {"bands": self.bands, "error_share": self.error_share, "relative_error": self.relative_error}


def motion_of(record: Record, speed: str | None, position: str | None, window: int) -> Motion:
    """Return speed and position of a record: the named outputs, else the first ones in such units.

    Without a speed it is the derivative of the position by a Savitzky-Golay filter over a tenth of the window.
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


def speed_edges(speed: Array) -> Array:
    """Return edges of speed bins, symmetric about a bin of standstill."""
    top = float(np.abs(speed).max()) or 1.0
    forward = np.linspace(REST * top, top, PER_DIRECTION + 1)
    return np.concatenate([-forward[::-1], forward])


def bin_index(value: Array, edges: Array) -> NDArray[np.int_]:
    """Return the bin of each value; values outside all edges belong to the outermost bins."""
    return np.clip(np.searchsorted(edges, value, side="right") - 1, 0, len(edges) - 2)


def bins(value: Array, error: Array, edges: Array) -> tuple[Bin, ...]:
    """Sort an error (n,) by ``value`` (n,) into bins."""
    index = bin_index(value, edges)
    total = float((error**2).sum()) or 1.0
    result: list[Bin] = []
    for k in range(len(edges) - 1):
        inside = error[index == k]
        squared = float((inside**2).sum())
        mean, rms = (float(inside.mean()), float(np.sqrt(squared / len(inside)))) if len(inside) else (0.0, 0.0)
        result.append(Bin(float(edges[k]), float(edges[k + 1]), len(inside), mean, rms, squared / total))
    return tuple(result)


def directions(speed: Array, error: Array) -> dict[str, Bin]:
    """Sort an error (n,) by the direction of the speed (n,): ``"backward"``, ``"rest"``, ``"forward"``."""
    edges = float(np.abs(speed).max()) * np.array([-1.0, -REST, REST, 1.0])
    return dict(zip(("backward", "rest", "forward"), bins(speed, error, edges), strict=True))


def uniform_samples(t: Array, *signals: Array) -> tuple[float, list[Array]]:
    """Return the mean sample time and the signals (n,), from a nonuniform time base interpolated to its mean step."""
    dt = float(t[-1] - t[0]) / (len(t) - 1)
    grid = t[0] + dt * np.arange(len(t))
    if np.abs(t - grid).max() <= 1e-3 * dt:
        return dt, list(signals)
    return dt, [np.interp(grid, t, x) for x in signals]


def welch_segments(n: int) -> tuple[int, float]:
    """Return the length of half-overlapping Welch segments for n samples, and their effective number."""
    segment = min(n, max(16, min(2 * n // (SEGMENTS + 1), LONGEST_SEGMENT)))
    count = 1 + (n - segment) // (segment - segment // 2)
    # Periodograms of half-overlapping Hann windows are correlated by 1/36: as good as so many independent ones.
    return segment, count / (1.0 + (count - 1) / count / 18.0)


def spectrum(t: Array, inputs: Mapping[str, Array], measured: Array, simulated: Array) -> Spectrum:
    """Compute the spectra of one output; see `Spectrum`."""
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
    of_measured, of_error = (
        np.bincount(bin_index(f, edges), weights=p, minlength=len(edges) - 1) * (f[1] - f[0])
        for p in (p_measured, p_error)
    )
    relative = np.sqrt(np.divide(of_error, of_measured, out=np.zeros_like(of_error), where=of_measured > 0))
    share = of_error / (of_error.sum() or 1.0)
    return Spectrum(f, p_measured, p_simulated, p_error, shared, level, edges, share, relative)


def log_bands(lowest: float, highest: float) -> Array:
    """Return edges from ``lowest`` to ``highest`` with two bands a decade on round numbers (1, 3, 10, 30, ...)."""
    if not highest > lowest:
        return np.array([lowest, lowest * (1.0 + 1e-9)])
    decades = 10.0 ** np.arange(np.floor(np.log10(lowest)) - 1, np.ceil(np.log10(highest)) + 1)
    rounded = np.sort(np.concatenate([decades, 3.0 * decades]))
    inner = rounded[(rounded > lowest) & (rounded < 0.9 * highest)]
    return np.concatenate([[lowest], inner, [highest]])


@dataclass(frozen=True)
class NoiseGap(Evidence):
    """Model error of one output in multiples of its noise."""

    std: float  # noise of a single sample of the output, in its unit (`NoiseFloor.std`)
    # rms_percent, windowed_rms_percent: RMS of the free run's and of the windowed error in percent of ``std``: 100 is
    # the best that the noise allows. None where the repeats are equal to the last bit.
    rms_percent: float | None
    windowed_rms_percent: float | None
    # `Excess` of the windowed error, with windows at the same phases of every repeat. Its ``noise`` is the floor of the
    # windowed error itself: larger than ``std`` in closed loop, where the noise also enters at the input.
    excess: Excess


@dataclass(frozen=True)
class OutputGap(Evidence):
    """Disagreement at one output, in its unit and in percent of its measured range (max - min).

    The fit is 100 (1 - |y - y_model| / |y - mean(y)|) percent: 100 is perfect, 0 as good as the mean.
    """

    name: str
    unit: str
    range: float
    # peak, ..., peak_time: of the free run, peak_time in s; NaN where it does not reach the end of the record
    peak: float
    rms: float
    peak_percent: float
    rms_percent: float
    fit: float
    peak_time: float
    # windowed_*: of the windowed simulation
    windowed_peak: float
    windowed_rms: float
    windowed_peak_percent: float
    windowed_rms_percent: float
    windowed_fit: float

    quantities: ClassVar[Mapping[str, Any]] = {
        **dict.fromkeys(("range", "peak", "rms", "windowed_peak", "windowed_rms"), "*"),
        **dict.fromkeys(("peak_percent", "rms_percent", "fit"), "%"),
        **dict.fromkeys(("windowed_peak_percent", "windowed_rms_percent", "windowed_fit"), "%"),
        "peak_time": "s",
    }


@dataclass(frozen=True)
class WindowErrors(Evidence):
    """Error of one output window by window; all arrays have shape (n_windows,)."""

    # start, stop: first and last time of each window in s
    start: Array
    stop: Array
    # rms, windowed_rms: of the free run's error (NaN where it does not reach the end of the record), and in windows
    rms: Array
    windowed_rms: Array
    worst: int  # index of the window with the largest windowed RMS


@dataclass(frozen=True)
class ResidualTests(Evidence):
    """Tests of one output's recursive residual (see `robustlab.identification.response.windowed_simulation`)."""

    rms: float  # RMS of the residual in the unit of the output
    whiteness: Whiteness
    inputs: Mapping[str, InputCorrelation]


@dataclass(frozen=True)
class FreeRun(Evidence):
    """Extent of the free run."""

    end: float  # time of its last sample in s
    reason: str  # why it ends there; empty at the end of the record

    @property
    def whole(self) -> bool:
        """Whether the free run reaches the end of the record."""
        return not self.reason


@dataclass(frozen=True)
class Linearisation(Evidence):
    """Windows that are linear about the recorded motion, against the nonlinear plant from the same starts."""

    windows: Array  # times in s at which the checked windows start
    # output name -> RMS of nonlinear minus linear simulation over these windows, in its unit
    difference: Mapping[str, float]
    # output name -> the same over the RMS of the error in these windows: if far below 1, the error is due to the model,
    # not to the linearisation
    share: Mapping[str, float]
    # start times of the windows whose nonlinear simulation does not reach their end; these are not counted
    broken: Array

    def warnings(self) -> list[str]:
        """Return warnings about the accuracy of the windows."""
        texts = []
        worst = max(self.share, key=lambda name: self.share[name], default="")
        if worst and self.share[worst] > LINEAR_SHARE:
            texts.append(
                f"the windows are linear about the recorded motion, and that makes {100 * self.share[worst]:.0f} % of "
                f"the error of {worst}: take shorter windows"
            )
        if len(self.broken):
            texts.append(
                "from the fitted start the nonlinear plant does not reach the end of the window at "
                f"{self.broken[0]:.4g} s"
            )
        return texts


def localised(
    whole: Stretch,
    outputs: Sequence[Signal],
    free: Array | None,
    windows: WindowedSimulation,
    motions: Mapping[str, Motion],
    size: Mapping[str, Array],
    lags: int,
) -> dict[str, Any]:
    """Compute errors over windows, speed, direction, position, amplitude and frequency, and residual tests.

    ``free``: the free run (n, n_y); None where it does not reach the end of the record. ``size``: input name ->
    magnitude (n,) over which the error is sorted.
    """
    keys = ("outputs", "windows", "speed", "direction", "position", "amplitude", "frequency", "residual")
    result: dict[str, dict[str, Any]] = {key: {} for key in keys}
    t, u, y = whole.t, whole.u, whole.y
    for k, (name, unit) in enumerate(outputs):
        local, motion = y[:, k] - windows.y[:, k], motions[name]
        error = None if free is None else y[:, k] - free[:, k]
        result["outputs"][name] = _gap(Signal(name, unit), t, y[:, k], error, local)
        result["windows"][name] = _window_errors(t, error, local, windows.edges)
        if motion.speed is not None:
            result["speed"][name] = bins(motion.speed, local, speed_edges(motion.speed))
            result["direction"][name] = directions(motion.speed, local)
        if motion.position is not None:
            low, high = float(motion.position.min()), float(motion.position.max())
            edges = np.linspace(low, high if high > low else low + 1.0, POSITION_BINS + 1)
            result["position"][name] = bins(motion.position, local, edges)
        result["amplitude"][name] = {
            key: bins(value, local, np.linspace(0.0, float(np.abs(value).max()) or 1.0, AMPLITUDE_BINS + 1))
            for key, value in size.items()
        }
        if free is not None:
            result["frequency"][name] = spectrum(t, u, y[:, k], free[:, k])
        residual = windows.residual[:, k]
        known = residual[np.isfinite(residual)]
        rms = float(np.sqrt(np.mean(known**2))) if len(known) else 0.0
        against = {key: input_correlation(samples, residual, lags) for key, samples in u.items()}
        result["residual"][name] = ResidualTests(rms, whiteness(residual, lags), against)
    return result


def _gap(signal: Signal, t: Array, y: Array, error: Array | None, local: Array) -> OutputGap:
    spread, spread_rms = float(np.ptp(y)), float(np.sqrt(np.mean((y - y.mean()) ** 2)))

    # Percentages are undefined if the spread or its square vanishes in floating point.
    percent = 100.0 / spread if spread_rms else np.nan

    def sizes(e: Array) -> tuple[float, float, float, float, float]:
        peak, rms = float(np.abs(e).max()), float(np.sqrt(np.mean(e**2)))
        return peak, rms, peak * percent, rms * percent, 100.0 * (1.0 - rms / spread_rms) if spread_rms else np.nan

    none = (np.nan, np.nan, np.nan, np.nan, np.nan)
    free = none if error is None else sizes(error)
    at = np.nan if error is None else float(t[np.abs(error).argmax()])
    return OutputGap(signal.name, signal.unit, spread, *free, at, *sizes(local))


def _window_errors(t: Array, error: Array | None, local: Array, edges: NDArray[np.int_]) -> WindowErrors:
    rms, local_rms = (
        np.full(len(edges) - 1, np.nan) if e is None else np.sqrt(np.add.reduceat(e**2, edges[:-1]) / np.diff(edges))
        for e in (error, local)
    )
    return WindowErrors(t[edges[:-1]], t[edges[1:] - 1], rms, local_rms, int(local_rms.argmax()))


def samples_of(what: str, seconds: float, record: Record) -> int:
    """Convert a stated length of time to samples."""
    if not np.isfinite(seconds) or not 2 * record.dt <= seconds <= record.duration + record.dt:
        expected = f"{2 * record.dt:g} s to {record.duration:g} s"
        raise InputError(f"compare {record.name}: {what}", f"{seconds:g} s", expected)
    return round(seconds / record.dt)


def kept(record: Record, inputs: Sequence[str], outputs: Sequence[str], y: Array, title: str) -> Record:
    """Return a record of the compared signals with ``y`` (m, n_y) as outputs, over the first m samples."""
    n = len(y)
    seen = {name: record.inputs[name][:n] for name in inputs}
    made = {name: y[:, k] for k, name in enumerate(outputs)}
    return Record(record.t[:n], seen, made, {name: record.unit(name) for name in (*seen, *made)}, title)
