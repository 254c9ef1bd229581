"""The parts of a comparison that linear and nonlinear plants share: sizes, places and tests of the two errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.comparison.localisation import (
    Motion,
    amplitude_edges,
    bins,
    directions,
    position_edges,
    spectrum,
    speed_edges,
    time_shares,
)
from robustlab.identification.comparison.repeats import NoiseFloor, noise_floor
from robustlab.identification.comparison.residual_tests import (
    EvenOdd,
    InputCorrelation,
    Whiteness,
    even_odd,
    input_correlation,
    whiteness,
)
from robustlab.identification.response.response import Stretch
from robustlab.identification.response.windowed_simulation import WindowedSimulation
from robustlab.record import Record
from robustlab.result import Evidence
from robustlab.statespace import Signal


@dataclass(frozen=True)
class OutputGap(Evidence):
    r"""Disagreement at one output, in its unit and in percent.

    Percent is of the measured range :math:`\max y - \min y` of this record. The fit is
    :math:`100 (1 - \|y - \hat y\| / \|y - \bar y\|)` percent: 100 is perfect, 0 as good as the mean, negative worse.
    """

    # name, unit, range: the output and its measured range
    name: str
    unit: str
    range: float
    # peak, rms, peak_percent, rms_percent, fit: free run; NaN where it does not reach the end of the record.
    # ``peak_time`` is when its peak error occurs [s].
    peak: float
    rms: float
    peak_percent: float
    rms_percent: float
    fit: float
    peak_time: float
    # windowed_peak, windowed_rms, windowed_peak_percent, windowed_rms_percent, windowed_fit: the same of the windowed
    # simulation
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
    # rms, share: RMS of the free run's error, and its share of the record's squared error (sum 1); NaN where it does
    # not reach the end of the record
    rms: Array
    share: Array
    # windowed_rms, windowed_share: the same of the windowed simulation
    windowed_rms: Array
    windowed_share: Array
    # worst, worst_free: index of the window with the largest windowed RMS, and with the largest free-run RMS (None
    # without)
    worst: int
    worst_free: int | None


@dataclass(frozen=True)
class ResidualTests(Evidence):
    """Tests of one output's recursive residual (see `robustlab.identification.response.windowed_simulation`)."""

    rms: float  # RMS of the residual in the unit of the output
    whiteness: Whiteness  # autocorrelation and Ljung-Box test
    inputs: Mapping[str, InputCorrelation]  # input name -> correlation with the residual


@dataclass(frozen=True)
class FreeRun(Evidence):
    """How far the free run goes."""

    end: float  # time of its last sample in s
    reason: str  # why it ends there; empty where it reaches the end of the record

    @property
    def whole(self) -> bool:
        """Whether it reaches the end of the record."""
        return not self.reason


@dataclass(frozen=True)
class Linearisation(Evidence):
    """Windows that are linear about the recorded motion, against the nonlinear plant from the same starts."""

    windows: Array  # times in s at which the checked windows start
    # output name -> RMS of nonlinear minus linear simulation over these windows, in its unit
    difference: Mapping[str, float]
    # output name -> the same over the RMS of the error in these windows: far below 1, the error is the model's and not
    # of the linearisation
    share: Mapping[str, float]
    # times at which those windows start whose nonlinear simulation does not reach their end; they count nowhere
    broken: Array


def noise_of(
    record: Record, others: tuple[Record, ...], outputs: Sequence[str], period: float | None
) -> tuple[NoiseFloor | None, str]:
    """Noise floor, or why there is none."""
    try:
        return noise_floor(record, period=period, repeats=others, outputs=outputs), ""
    except NoTrustworthyNumber as none:
        return None, f"{none.found}; {none.hint}" if none.hint else none.found


def excitation(inputs: Sequence[str], noise: NoiseFloor | None) -> str | None:
    """The one signal whose periods excite the system: the reference that repeats, else the model's input."""
    if noise is None or noise.source != "periods":
        return None
    sources = noise.signal.split(", ") if noise.signal else list(inputs)
    return sources[0] if len(sources) == 1 else None


def even_odd_test(record: Record, inputs: Sequence[str], outputs: Sequence[str], noise: NoiseFloor | None) -> EvenOdd:
    """Even/odd test of the outputs, and of the inputs that a controller corrects."""
    source = excitation(inputs, noise)
    if noise is None or source is None:
        several = noise is not None and noise.source == "periods"
        reason = "several signals excite at once" if several else "the record holds no repeated periods"
        return EvenOdd({}, "", f"the excitation does not allow it: {reason}")
    judged = [*outputs, *(name for name in noise.input_std if name != source)]
    return even_odd(noise, record[source], {name: record[name] for name in judged}, record.dt)


def localised(
    whole: Stretch,
    outputs: Sequence[Signal],
    free: Array | None,
    windows: WindowedSimulation,
    motions: Mapping[str, Motion],
    size: Mapping[str, Array],
    lags: int,
) -> dict[str, Any]:
    """Gap, windows, speed, direction, position, amplitude, frequency and residual tests of every output.

    ``free``: the free run (n, n_y); None where it does not reach the end of the record. ``size``: input name ->
    magnitude (n,) over which the error is sorted.
    """
    result: dict[str, dict[str, Any]] = {
        key: {}
        for key in ("outputs", "windows", "speed", "direction", "position", "amplitude", "frequency", "residual")
    }
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
            result["position"][name] = bins(motion.position, local, position_edges(motion.position))
        result["amplitude"][name] = {key: bins(value, local, amplitude_edges(value)) for key, value in size.items()}
        if free is not None:
            result["frequency"][name] = spectrum(t, u, y[:, k], free[:, k])
        residual = windows.residual[:, k]
        known = residual[np.isfinite(residual)]
        rms = float(np.sqrt(np.mean(known**2))) if len(known) else 0.0
        against = {name_u: input_correlation(samples, residual, lags) for name_u, samples in u.items()}
        result["residual"][name] = ResidualTests(rms, whiteness(residual, lags), against)
    return result


def _gap(signal: Signal, t: Array, y: Array, error: Array | None, local: Array) -> OutputGap:
    spread, spread_rms = float(np.ptp(y)), float(np.sqrt(np.mean((y - y.mean()) ** 2)))

    def judged(e: Array) -> tuple[float, float, float, float, float]:
        peak, rms = float(np.abs(e).max()), float(np.sqrt(np.mean(e**2)))
        # A signal whose spread or its square vanishes in floating point has nothing to be compared with.
        percent = 100.0 / spread if spread_rms else np.nan
        fit = 100.0 * (1.0 - rms / spread_rms) if spread_rms else np.nan
        return peak, rms, peak * percent, rms * percent, fit

    none = (np.nan, np.nan, np.nan, np.nan, np.nan)
    free = none if error is None else judged(error)
    at = np.nan if error is None else float(t[np.abs(error).argmax()])
    return OutputGap(signal.name, signal.unit, spread, *free, at, *judged(local))


def _window_errors(t: Array, error: Array | None, local: Array, edges: NDArray[np.int_]) -> WindowErrors:
    def rms(e: Array) -> Array:
        return np.sqrt(np.add.reduceat(e**2, edges[:-1]) / np.diff(edges))

    none, local_rms = np.full(len(edges) - 1, np.nan), rms(local)
    free = none if error is None else rms(error)
    return WindowErrors(
        t[edges[:-1]],
        t[edges[1:] - 1],
        free,
        none if error is None else time_shares(error, edges),
        local_rms,
        time_shares(local, edges),
        int(local_rms.argmax()),
        None if error is None else int(free.argmax()),
    )


def samples_of(what: str, seconds: float, record: Record) -> int:
    """Samples of a stated length of time."""
    if not np.isfinite(seconds) or not 2 * record.dt <= seconds <= record.duration + record.dt:
        raise InputError(
            f"compare {record.name}: {what}", f"{seconds:g} s", f"{2 * record.dt:g} s to {record.duration:g} s"
        )
    return round(seconds / record.dt)


def kept(record: Record, inputs: Sequence[str], outputs: Sequence[str], y: Array, title: str) -> Record:
    """The compared signals alone, with ``y`` (m, n_y) as outputs; of m samples, where it has fewer than the record."""
    n = len(y)
    seen = {name: record.inputs[name][:n] for name in inputs}
    made = {name: y[:, k] for k, name in enumerate(outputs)}
    return Record(record.t[:n], seen, made, {name: record.unit(name) for name in (*seen, *made)}, title)


def title(plant_or_model: Any) -> str:
    """What a plant or model is called."""
    return str(getattr(plant_or_model, "name", None) or repr(plant_or_model))
