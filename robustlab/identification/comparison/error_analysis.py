"""Sizes, places and tests of free-run and windowed errors, and the equivalent disturbance at an input or a joint.

A disturbance is the random walk at one place with which the model reproduces the record best. Plotted over the speed, a
friction that the model lacks appears as a friction curve with the opposite sign.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import Array, Indices, Mask
from robustlab.display import Each
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.ports.port_model import Port, linear_plant_of, port_model
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.greybox.disturbance_smoother import SmoothedRecord, smooth_disturbance
from robustlab.identification.response.response import (
    LinearResponse,
    MotionResponse,
    Stretch,
    Windowed,
    WindowedSimulation,
    fit_windows,
)
from robustlab.record import Record
from robustlab.result import Evidence
from robustlab.statespace import Signal, StateSpaceModel

SPEED_UNITS = ("m/s", "rad/s", "mm/s", "deg/s", "rpm", "1/min")
POSITION_UNITS = ("m", "rad", "mm", "deg")
POLYNOMIAL = 3  # order of the Savitzky-Golay polynomial
SEGMENTS = 8  # Welch segments that fit into the record side by side
LONGEST_SEGMENT = 8192
CONFIDENCE = 0.99
LINEAR_SHARE = 0.1  # of the error; a larger difference from the nonlinear plant gives a warning
REST = 0.02  # speeds below this share of the largest count as standstill
PER_DIRECTION, POSITION_BINS = 5, 10  # numbers of bins
BAND_99 = 2.5758293035489004  # the 99.5 % point of the normal distribution: 99 % of white samples are within
# Directions of the lagged input below this share of its largest eigenvalue are not excited.
NOT_EXCITED = 1e-10
SURE = 3.0  # standard errors from zero, from which a mean is significant
LEAST_NOISE = 1e-7  # of a sensor, as a share of its range
SHORTEST = 8  # samples to estimate the noise of a sensor


@dataclass(frozen=True)
class Motion(Evidence):
    """Measured speed and position along the record, against which errors are sorted."""

    speed: Array | None  # samples (n,), or None where the record has no such signal
    position: Array | None
    speed_unit: str
    position_unit: str
    speed_source: str  # ``"v"``, or ``"derivative of q (Savitzky-Golay, order 3, 49 samples)"``
    position_name: str  # name of the position signal

    def named(self) -> dict[str, str]:
        """Return the signals and their units without their samples."""
        return {key: text for key, text in vars(self).items() if isinstance(text, str)}


@dataclass(frozen=True)
class Bin(Evidence):
    """Error of one output over the samples whose speed (or position) is in ``[low, high)``."""

    low: float
    high: float
    samples: int  # number of samples within
    mean: float  # of the error in units of the output; 0 where there is no sample
    rms: float
    share: float  # of the record's squared error, 0..1; the shares of all bins sum to 1


@dataclass(frozen=True)
class Spectrum(Evidence):
    r"""Power spectral densities by Welch's method, and the coherence of the inputs with the error.

    Hann window, half overlap, mean kept (a constant error is an error at frequency 0).
    """

    frequency: Array  # Hz, (n_f,)
    # One-sided densities in unit²/Hz, (n_f,): measured output, free run, and its error. The windowed error has none: it
    # restarts in every window, which sets its frequencies.
    measured: Array
    simulated: Array
    error: Array
    coherence: Mapping[str, Array]  # input -> share of the error at a frequency that is linear in it, (n_f,)
    coherence_level: float  # 99 % of the coherences of independent signals are below this
    bands: Array  # edges of the bands in Hz, (n_bands + 1,)
    error_share: Array  # share of the squared error per band, (n_bands,), sum 1


def motion_of(record: Record, window: int) -> Motion:
    """Return speed and position of a record: the first outputs in such units, else the derivative of the position."""
    position, speed = _first_in(record, POSITION_UNITS), _first_in(record, SPEED_UNITS)
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


def bin_index(value: Array, edges: Array) -> NDArray[np.int_]:
    """Return the bin of each value; values outside all edges belong to the outermost bins."""
    return np.clip(np.searchsorted(edges, value, side="right") - 1, 0, len(edges) - 2)


def bins(value: Array, error: Array, edges: Array) -> tuple[Bin, ...]:
    """Sort an error (n,) by ``value`` (n,) into bins."""
    index, n = bin_index(value, edges), len(edges) - 1
    samples, total, squares = (np.bincount(index, weights, n) for weights in (None, error, error**2))
    mean, rms = total / np.maximum(samples, 1), np.sqrt(squares / np.maximum(samples, 1))
    columns = (edges[:-1], edges[1:], samples, mean, rms, squares / (squares.sum() or 1.0))
    return tuple(Bin(*row) for row in zip(*(column.tolist() for column in columns), strict=True))


def directions(speed: Array, error: Array) -> dict[str, Bin]:
    """Sort an error (n,) by the direction of the speed (n,): ``"backward"``, ``"rest"``, ``"forward"``."""
    edges = float(np.abs(speed).max()) * np.array([-1.0, -REST, REST, 1.0])
    return dict(zip(("backward", "rest", "forward"), bins(speed, error, edges), strict=True))


def spectrum(t: Array, inputs: Mapping[str, Array], measured: Array, simulated: Array) -> Spectrum:
    """Compute the spectra of one output; see `Spectrum`."""
    from scipy.signal import coherence, welch

    n, dt, grid = len(t), float(t[-1] - t[0]) / (len(t) - 1), np.linspace(t[0], t[-1], len(t))
    if np.abs(t - grid).max() > 1e-3 * dt:  # a nonuniform time base is interpolated to its mean step
        measured, simulated = (np.interp(grid, t, x) for x in (measured, simulated))
        inputs = {name: np.interp(grid, t, x) for name, x in inputs.items()}
    segment = min(n, max(16, min(2 * n // (SEGMENTS + 1), LONGEST_SEGMENT)))
    count = 1 + (n - segment) // (segment - segment // 2)
    # Periodograms of half-overlapping Hann windows are correlated by 1/36: as good as so many independent ones.
    averages = count / (1.0 + (count - 1) / count / 18.0)
    options: dict[str, Any] = {"fs": 1.0 / dt, "window": "hann", "nperseg": segment, "noverlap": segment // 2}
    error = measured - simulated
    densities = [welch(x, detrend=cast("Any", False), **options) for x in (measured, simulated, error)]
    f, (p_measured, p_simulated, p_error) = densities[0][0], (density for _, density in densities)
    with np.errstate(invalid="ignore", divide="ignore"):  # 0 / 0 where a signal has no power: coherence 0
        found = {name: coherence(x, error, detrend="constant", **options)[1] for name, x in inputs.items()}
        shared = {name: np.nan_to_num(x, posinf=0.0) for name, x in found.items()}
    level = 1.0 - (1.0 - CONFIDENCE) ** (1.0 / (averages - 1.0)) if averages > 1 else 1.0
    # Two bands a decade on round numbers (1, 3, 10, 30, ...).
    decades = 10.0 ** np.arange(np.floor(np.log10(f[1])) - 1, np.ceil(np.log10(f[-1])) + 1)
    rounded = np.sort(np.concatenate([decades, 3.0 * decades]))
    edges = np.array([0.0, *rounded[(rounded > 1.5 * f[1]) & (rounded < 0.9 * f[-1])], f[-1]])
    of_error = np.bincount(bin_index(f, edges), weights=p_error, minlength=len(edges) - 1)
    return Spectrum(f, p_measured, p_simulated, p_error, shared, level, edges, of_error / (of_error.sum() or 1.0))


@dataclass(frozen=True)
class OutputGap(Evidence):
    """Disagreement at one output, in its unit and in percent of its measured range (max - min).

    The fit is 100 (1 - |y - y_model| / |y - mean(y)|) percent: 100 is perfect, 0 as good as the mean.
    """

    name: str
    unit: str
    range: float
    # of the free run, peak_time in s; NaN where it does not reach the end of the record
    peak: float
    rms: float
    peak_percent: float
    rms_percent: float
    fit: float
    peak_time: float
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

    start: Array  # first and last time of each window in s
    stop: Array
    windowed_rms: Array
    worst: int  # index of the window with the largest windowed RMS


@dataclass(frozen=True)
class ResidualTests(Evidence):
    """Tests of one output's recursive residual (see `robustlab.identification.response.response`)."""

    rms: float  # RMS of the residual in the unit of the output
    whiteness: Correlation
    inputs: Mapping[str, Correlation]


@dataclass(frozen=True)
class FreeRun(Evidence):
    """Extent of the free run."""

    end: float  # time of its last sample in s
    reason: str  # why it ends there; empty at the end of the record

    @property
    def whole(self) -> bool:
        """Return whether the free run reaches the end of the record."""
        return not self.reason


@dataclass(frozen=True)
class Linearisation(Evidence):
    """Windows that are linear about the recorded motion, against the nonlinear plant from the same starts."""

    windows: Array  # times in s at which the checked windows start
    difference: Mapping[str, float]  # output -> RMS of nonlinear minus linear simulation over these, in its unit
    # output -> the same over the RMS of the error there: if far below 1, the error is due to the model, not to the
    # linearisation
    share: Mapping[str, float]
    broken: Array  # start times of the windows whose nonlinear simulation does not reach their end; not counted

    def warnings(self) -> list[str]:
        texts = []
        worst = max(self.share, key=lambda name: self.share[name], default="")
        if worst and self.share[worst] > LINEAR_SHARE:
            size = f"{100 * self.share[worst]:.0f} % of the error of {worst}"
            texts.append(f"the windows are linear about the recorded motion: that makes {size}, take shorter windows")
        if len(self.broken):
            end = f"the end of the window at {self.broken[0]:.4g} s"
            texts.append(f"from the fitted start the nonlinear plant does not reach {end}")
        return texts


def localised(
    whole: Stretch, outputs: Sequence[Signal], free: Array | None, windows: WindowedSimulation,
    motions: Mapping[str, Motion], lags: int,
) -> dict[str, Any]:  # fmt: skip
    """Compute errors over windows, speed, direction, position and frequency, and residual tests."""
    # ``free``: the free run (n, n_y); None where it does not reach the end of the record.
    keys = ("outputs", "windows", "speed", "direction", "position", "frequency", "residual")
    result: dict[str, dict[str, Any]] = {key: {} for key in keys}
    t, u, y, edges = whole.t, whole.u, whole.y, windows.edges
    for k, (name, unit) in enumerate(outputs):
        local, motion = y[:, k] - windows.y[:, k], motions[name]
        error = None if free is None else y[:, k] - free[:, k]
        result["outputs"][name] = _gap(Signal(name, unit), t, y[:, k], error, local)
        rms = np.sqrt(np.add.reduceat(local**2, edges[:-1]) / np.diff(edges))
        result["windows"][name] = WindowErrors(t[edges[:-1]], t[edges[1:] - 1], rms, int(rms.argmax()))
        if motion.speed is not None:
            top = float(np.abs(motion.speed).max()) or 1.0
            forward = np.linspace(REST * top, top, PER_DIRECTION + 1)  # beyond a bin of standstill
            result["speed"][name] = bins(motion.speed, local, np.concatenate([-forward[::-1], forward]))
            result["direction"][name] = directions(motion.speed, local)
        if motion.position is not None:
            low, high = float(motion.position.min()), float(motion.position.max())
            places = np.linspace(low, high if high > low else low + 1.0, POSITION_BINS + 1)
            result["position"][name] = bins(motion.position, local, places)
        if free is not None:
            result["frequency"][name] = spectrum(t, u, y[:, k], free[:, k])
        residual = windows.residual[:, k]
        known = residual[np.isfinite(residual)]
        size = float(np.sqrt(np.mean(known**2))) if len(known) else 0.0
        against = {key: input_correlation(samples, residual, lags) for key, samples in u.items()}
        result["residual"][name] = ResidualTests(size, whiteness(residual, lags), against)
    return result


def _gap(signal: Signal, t: Array, y: Array, error: Array | None, local: Array) -> OutputGap:
    spread, spread_rms = float(np.ptp(y)), float(np.sqrt(np.mean((y - y.mean()) ** 2)))
    # Percentages are undefined if the spread or its square vanishes in floating point.
    percent = 100.0 / spread if spread_rms else np.nan

    def sizes(e: Array) -> tuple[float, float, float, float, float]:
        peak, rms = float(np.abs(e).max()), float(np.sqrt(np.mean(e**2)))
        return peak, rms, peak * percent, rms * percent, 100.0 * (1.0 - rms / spread_rms) if spread_rms else np.nan

    whole, windowed = sizes(np.array([np.nan]) if error is None else error), sizes(local)
    at = np.nan if error is None else float(t[np.abs(error).argmax()])
    return OutputGap(signal.name, signal.unit, spread, *whole, at, *windowed)


def kept(record: Record, inputs: Sequence[str], outputs: Sequence[str], y: Array, title: str) -> Record:
    """Return a record of the compared signals with ``y`` (m, n_y) as outputs, over the first m samples."""
    n = len(y)
    seen = {name: record.inputs[name][:n] for name in inputs}
    made = {name: y[:, k] for k, name in enumerate(outputs)}
    return Record(record.t[:n], seen, made, {name: record.unit(name) for name in (*seen, *made)}, title)


# --- tests of a residual ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Correlation(Evidence):
    """Correlations of a residual with its own past or with an input, and the test that there are none."""

    lags: NDArray[np.int_]  # in samples; positive: the residual after the input
    correlation: Array  # at these lags; at negative ones it shows that the input was computed from the output
    band: float  # 99 % of the correlations are within ± this if the test's hypothesis is true
    statistic: float  # chi-square distributed with dof if there are none; p_value: probability of a larger one
    dof: int
    p_value: float
    explained_share: float  # share of the residual's variance that is linear in its past or in the input, 0..1


def autocorrelation(residual: ArrayLike, lags: int) -> tuple[Array, NDArray[np.int_]]:
    """Compute r_0..r_lags of a residual (n,), not centred, without NaN samples, and the number of pairs at each lag."""
    e = np.asarray(residual, dtype=float)
    there, filled, n = np.isfinite(e), np.nan_to_num(e), len(e)
    r = np.array([filled[k:] @ filled[: n - k] for k in range(lags + 1)]) / (float(filled @ filled) or 1.0)
    r[0] = 1.0
    return r, np.array([int((there[k:] & there[: n - k]).sum()) for k in range(lags + 1)])


def whiteness(residual: ArrayLike, lags: int) -> Correlation:
    """Apply the Ljung-Box test to the first ``lags`` autocorrelations of a residual (n,) without its NaN samples."""
    # Q = N (N + 2) sum r_k^2 / N_k with N_k pairs at lag k, not centred: no parameter was fitted.
    from scipy.linalg import toeplitz
    from scipy.special import chdtrc

    r, pairs = autocorrelation(residual, lags)
    n = int(pairs[0])
    used = pairs[1:] > 0
    statistic = float(n * (n + 2) * (r[1:][used] ** 2 / pairs[1:][used]).sum())
    dof = int(used.sum())
    predictor = np.linalg.lstsq(toeplitz(r[:-1]), r[1:])[0] if lags else np.zeros(0)
    share = float(np.clip(predictor @ r[1:], 0.0, 1.0))
    p_value = float(chdtrc(dof, statistic)) if dof else 1.0
    return Correlation(np.arange(lags + 1), r, float(BAND_99 / np.sqrt(max(n, 1))), statistic, dof, p_value, share)


def input_correlation(u: ArrayLike, residual: ArrayLike, lags: int) -> Correlation:
    """Compute the cross-correlation of an input (n,) with a residual (n,) over lags -``lags``..``lags``."""
    # Q = N R^2 of the regression of the residual on lags 0.. of the input, without NaN samples.
    from scipy.special import chdtrc

    e, v = (np.asarray(x, dtype=np.float64) for x in (residual, u))
    v, filled = v - float(v.mean()), np.nan_to_num(e)
    n, total = int(np.isfinite(e).sum()), len(e)
    size = float(np.sqrt((filled @ filled) * (v @ v)))
    ahead = [filled[k:] @ v[: total - k] for k in range(lags + 1)]
    behind = [filled[: total - k] @ v[k:] for k in range(lags, 0, -1)]
    correlation = np.array([*behind, *ahead], dtype=np.float64) / (size or 1.0)
    r_e, r_u = autocorrelation(e, lags)[0], autocorrelation(v, lags)[0]
    # Variance of r_k for a coloured residual that is independent of a coloured input (Ljung 1999, eq. 16.64).
    spread = max(1.0, float(1.0 + 2.0 * (r_e[1:] @ r_u[1:])))
    share, dof, rows = _explained(v, e, lags)
    p_value = float(chdtrc(dof, rows * share)) if dof else 1.0
    band = float(BAND_99 * np.sqrt(spread / max(n, 1)))
    return Correlation(np.arange(-lags, lags + 1), correlation, band, rows * share, dof, p_value, share)


def _explained(v: Array, e: Array, lags: int) -> tuple[float, int, int]:
    """Return R² of the regression of ``e`` on ``v`` at lags 0..``lags``, excited directions, and samples used."""
    rows = np.flatnonzero(np.isfinite(e))
    rows = rows[rows >= lags]
    target = e[rows]
    power = float(target @ target)
    if not power:
        return 0.0, 0, len(rows)
    lagged = np.column_stack([v[rows - k] for k in range(lags + 1)])
    values, vectors = np.linalg.eigh(lagged.T @ lagged)
    keep = values > NOT_EXCITED * max(values[-1], 0.0) if values[-1] > 0 else np.zeros(lags + 1, bool)
    coordinates = vectors[:, keep].T @ (lagged.T @ target)
    share = float(np.clip((coordinates**2 / values[keep]).sum() / power, 0.0, 1.0))
    return share, int(keep.sum()), len(rows)


# --- disturbance at an input or a joint -------------------------------------------------------------------------------


@dataclass(frozen=True)
class InputDisturbance(Evidence):
    """Disturbance at a single place with which the model reproduces the record best."""

    place: str  # ``input u``, or ``torque at omega``
    unit: str
    value: Array  # at each sample, (n,)
    std: Array  # its standard deviation, (n,)
    speed: Array | None  # measured speed at each sample, (n,), or None without one
    speed_source: str
    rms: float
    # over all samples and over those that move in one direction (NaN without any), with standard errors
    mean: float
    mean_std: float
    forward: float
    forward_std: float
    backward: float
    backward_std: float
    shares: Mapping[str, float]  # output -> removed share of its squared windowed error; negative where it grows
    explained_share: float  # the same over all outputs, 0..1, each in multiples of its noise

    quantities: ClassVar[Mapping[str, Any]] = {
        **dict.fromkeys(("rms", "mean", "mean_std", "forward", "forward_std", "backward", "backward_std"), "*"),
        "shares": Each("outputs", float),
        "explained_share": float,
    }

    @property
    def sure_means(self) -> dict[str, tuple[float, float]]:
        """Return the means, by direction or of all, that differ significantly from zero, with standard errors."""
        ways = {"moving forward": (self.forward, self.forward_std), "backward": (self.backward, self.backward_std)}
        if not np.isfinite([self.forward, self.backward]).any():
            ways = {"over all": (self.mean, self.mean_std)}
        return {way: (mean, std) for way, (mean, std) in ways.items() if abs(mean) > SURE * std}

    def to_json(self) -> dict[str, object]:
        return {key: v for key, v in vars(self).items() if key not in ("value", "std", "speed")}


def input_disturbances(
    plant: Any, response: LinearResponse, error: Array, edges: Indices, motion: Motion
) -> dict[str, InputDisturbance]:
    """Estimate a disturbance at each input (by name) and each joint without a direct input (``torque at omega``)."""
    # ``error``: of the windows between ``edges``, (n, n_y). Empty for a discrete model and a nonuniform time base.
    whole, names = response.whole, response.response.output_names
    model = response.response.model.select(outputs=names)
    if model.is_discrete or not whole.is_uniform or len(whole.t) < SHORTEST:
        return {}
    u = np.column_stack([whole.u[name] for name in model.input_names])
    spread, level = np.ptp(whole.y, axis=0), np.abs(whole.y).max(axis=0)
    spread = np.where(spread > 0, spread, np.where(level > 0, level, 1.0))
    # The variance of third differences is 20 times that of white noise.
    third = np.median(np.abs(np.diff(whole.y, 3, axis=0)), axis=0) / 0.6745 / np.sqrt(20.0)
    noise = np.maximum(third, LEAST_NOISE * spread)
    found: dict[str, InputDisturbance] = {}
    for key, place, unit, push in _places(plant, model):
        try:
            smoothed = smooth_disturbance(model, push[:, None], whole.t, u, whole.y, noise)
        except (InputError, NoTrustworthyNumber):  # no output responds to it, or the record is too short
            continue
        left = _remaining(replace(response, pushes=push[:, None]), smoothed.d, error, edges)[0] / whole.weight
        errors = [e / smoothed.noise_std for e in (error, left)]
        found[key] = _disturbance(place, unit, smoothed, 0, motion, names, *errors)
    return found


def joint_disturbances(
    response: MotionResponse, smoothed: SmoothedRecord, error: Array, edges: Indices, motions: Sequence[Motion]
) -> dict[str, InputDisturbance]:
    """Estimate a disturbance at each joint of a nonlinear plant, or at each input of one without joints."""
    plant = response.plant
    units = {s.name: s.unit for s in plant.states}
    joints = [(_force_at(p.name, units[p.name]), p.unit) for p in plant.port_places if p.kind == "joint"]
    places = joints or [(f"input {s.name}", s.unit) for s in plant.inputs]
    left, before = _remaining(response, smoothed.d, error, edges), error * response.whole.weight
    names = [plant.outputs[k].name for k in response.columns]
    return {
        place.removeprefix("input "): _disturbance(place, unit, smoothed, j, motions[j], names, before, left[j])
        for j, (place, unit) in enumerate(places)
    }


def _remaining(model: Windowed, d: Array, error: Array, edges: Indices) -> Array:
    """Return the weighted error with each force of d (n, n_forces), starts refitted: (n_forces, n, n_y)."""
    left, sizes = np.empty((d.shape[1], *error.shape)), np.diff(edges)
    for size in np.unique(sizes):
        for windows in model.responses(edges[:-1][sizes == size], int(size), d):
            at = windows.samples
            for j in range(len(left)):
                left[j][at] = fit_windows(model, windows, error[at] - windows.pushed[..., j]).left
    return left


def _places(plant: Any, model: StateSpaceModel) -> Iterable[tuple[str, str, str, Array]]:
    """Yield key, text, unit and direction of each place, without inputs that have a direct feedthrough."""
    inputs = [k for k in range(model.n_inputs) if not model.D[:, k].any()]
    for k in inputs:
        yield model.input_names[k], f"input {model.input_names[k]}", model.inputs[k].unit, model.B[:, k]
    if not isinstance(plant, (LinearPlant, StateSpaceModel)):
        return
    try:
        ports: Iterable[Port] = port_model(linear_plant_of(plant)).ports.values()
    except (InputError, np.linalg.LinAlgError):
        return
    for port in (port for port in ports if port.kind == "joint" and port.force.shape == (model.n_states,)):
        if all(np.linalg.matrix_rank(np.stack([port.force, model.B[:, k]])) == 2 for k in inputs):
            text = _force_at(port.name, port.speed_unit)
            yield text, text, port.unit, port.force


def _force_at(joint: str, speed_unit: str) -> str:
    return f"{'torque' if speed_unit == 'rad/s' else 'force'} at {joint}"


def _disturbance(
    place: str, unit: str, smoothed: SmoothedRecord, j: int, motion: Motion, names: Sequence[str], error: Array,
    left: Array,
) -> InputDisturbance:  # fmt: skip
    """Summarise a disturbance; ``error``, ``left``: without and with it, in multiples of each sensor's noise."""
    d, std, dt = smoothed.d[:, j], smoothed.d_std[:, j], float(smoothed.t[1] - smoothed.t[0])
    # Samples closer than half a period of the bandwidth are dependent.
    independent = min(1.0, 2.0 * float(smoothed.bandwidth.min()) * dt)

    def mean(chosen: Mask) -> tuple[float, float]:
        n = int(chosen.sum())
        if not n:
            return np.nan, np.nan
        spread = max(float(d[chosen].std()), float(np.sqrt((std[chosen] ** 2).mean())))
        return float(d[chosen].mean()), spread / float(np.sqrt(max(1.0, independent * n)))

    speed = np.zeros(len(d)) if motion.speed is None else motion.speed
    rest = REST * float(np.abs(speed).max())
    ways = [np.ones(len(d), dtype=bool), speed > rest, speed < -rest]
    before, after = (error**2).sum(axis=0), (left**2).sum(axis=0)
    shares = np.divide(before - after, before, out=np.zeros_like(before), where=before > 0)
    total = float(before.sum())
    (m, m_std), (forward, forward_std), (backward, backward_std) = (mean(way) for way in ways)
    return InputDisturbance(
        place, unit, d, std, motion.speed, motion.speed_source, float(np.sqrt((d**2).mean())),
        m, m_std, forward, forward_std, backward, backward_std, dict(zip(names, shares.tolist(), strict=True)),
        max(0.0, 1.0 - float(after.sum()) / total) if total else 0.0,
    )  # fmt: skip
