"""`compare`: how well a plant or model reproduces a measured record, and where it does not.

Two simulations of the recorded input are judged. The *free run* starts from the measured state at the start of the
record and runs to its end. The *windowed* simulation starts anew in every window from the state that suits the window
best, so that a model with an integrator is judged by its faults and not by the drift they add up to.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.budget import one_thread
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.comparison.best_linear_approximation import (
    BestLinearApproximation,
    arbitrary_bla,
    periodic_bla,
)
from robustlab.identification.comparison.comparison_result import Comparison, OutputGap, ResidualTests, WindowErrors
from robustlab.identification.comparison.gap_scales import (
    input_disturbance,
    noise_gaps,
)
from robustlab.identification.comparison.localisation import (
    Motion,
    amplitude_edges,
    bins,
    directions,
    motion_of,
    position_edges,
    spectrum,
    speed_edges,
    time_shares,
)
from robustlab.identification.comparison.noise_floor import NoiseFloor, noise_floor
from robustlab.identification.comparison.nonlinearity import EvenOdd, even_odd, judged_lines
from robustlab.identification.comparison.residual_tests import input_correlation, whiteness
from robustlab.identification.record_check.suitability import channel_warnings
from robustlab.identification.response.response import Response, Stretch, response_of
from robustlab.identification.response.windowed_simulation import (
    InitialState,
    WindowedSimulation,
    starting_state,
    windowed_simulation,
)
from robustlab.record import Record
from robustlab.result import Status
from robustlab.statespace import Signal

__all__ = ["compare"]


LAGS = 25
SHORTEST_WINDOW = 20  # samples
WINDOWS_AT_LEAST = 4  # that a window chosen by us leaves in the record
WINDOWS_WITHOUT_TIME_CONSTANT = 50
PIECES_PER_WINDOW = 4
LARGEST_OUTPUT = 1e100  # squares of larger numbers overflow


@one_thread()
def compare(
    plant: Any,
    record: Record,
    *,
    window: float | None = None,
    start: float | None = None,
    lags: int = LAGS,
    speed: str | None = None,
    position: str | None = None,
    period: float | None = None,
    repeats: Sequence[Record] = (),
) -> Comparison:
    """Compare a plant or model with a measured record at all outputs they share.

    Parameters
    ----------
    plant
        A linear `Plant`, a `StateSpaceModel` or a ``control.StateSpace``; all its inputs must be in the record.
        Inputs are held between samples.
    record
        The measurement; it may hold any subset of the outputs, and signals that the model does not know.
    window
        Length of the windows in s. Left out: the model's slowest time constant, but at most a quarter of the record; a
        fiftieth of the record for a model of integrators only.
    start
        Longest opening stretch in s to which the initial state of the free run is fitted; ``window`` where left out
        (see `robustlab.identification.response.windowed_simulation.starting_state`).
    lags
        Number of lags of the residual tests.
    speed, position
        Recorded outputs over which the error is sorted; chosen by their units where left out.
    period
        Period of the record in s. Left out: found where an input, or a recorded signal that the model does not know
        (the controller's reference), repeats exactly; in closed loop without a recorded reference it must be stated.
    repeats
        Further records with the same input, for the noise floor.

    Returns
    -------
    Comparison
        A large gap is a result, not an error.

    Raises
    ------
    InputError
        An input of the model or every output is missing, a wrong sample time, a window that does not fit; a stated
        period or repeat that the inputs contradict.
    UnitMismatch
        Model and record state different units of a signal.
    NoTrustworthyNumber
        The free run of an unstable model overflows.

    Examples
    --------
    >>> import numpy as np
    >>> from robustlab.statespace import StateSpaceModel
    >>> lag = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=["y"])
    >>> t = np.linspace(0, 10, 501)
    >>> gap = compare(lag, Record(t, {"u": np.ones(501)}, {"y": 1.1 * (1 - np.exp(-t))})).outputs["y"]
    >>> round(gap.peak, 3), round(gap.peak_percent, 2)
    (0.1, 9.09)
    """
    response = response_of(plant, record)
    record = response.with_units(record)
    whole = response.stretch(record)
    length = _window_length(response, record, window)
    initial = starting_state(response, whole, length if start is None else _samples("start", start, record))
    free = response.simulate(whole.t, whole.u, initial.x0)
    if np.abs(free).max() > LARGEST_OUTPUT:
        raise NoTrustworthyNumber(
            f"compare {record.name}",
            "the free run overflows",
            "a stable model",
            "compare a shorter stretch (Record.between)",
        )
    windows = windowed_simulation(response, whole, length)
    motion = motion_of(record, speed, position, length)
    piece = max(length // PIECES_PER_WINDOW, min(length, SHORTEST_WINDOW))
    localised = _localised(whole, response, free, windows, motion, lags=min(lags, record.n // 4))
    others = tuple(response_of(plant, other).with_units(other) for other in repeats)
    noise, noise_reason = _noise(record, others, response, period)
    rms = {name: (gap.rms, gap.windowed_rms) for name, gap in localised["outputs"].items()}
    linear, linear_reason = _linear(record, response, whole, noise)
    return Comparison(
        status=Status.CONVERGED,
        model=_name(plant),
        record=record.name,
        motion=motion,
        initial_state=initial,
        window=length * record.dt,
        measured=_kept(record, response, whole.y, record.name),
        simulated=_kept(record, response, free, f"{record.name} (free run)"),
        windowed=_kept(record, response, windows.y, f"{record.name} (windowed simulation)"),
        recursive={name: windows.residual[:, k] for k, name in enumerate(response.output_names)},
        disturbance={name: input_disturbance(response, name, whole, piece, motion) for name in whole.u},
        warnings=_warnings(response, record, initial, motion),
        noise=noise,
        noise_reason=noise_reason,
        against_noise=noise_gaps(response, whole, others, noise, length, rms) if noise else {},
        linear=linear,
        linear_reason=linear_reason,
        nonlinearity=_even_odd(record, response, noise),
        **localised,
    )


def _noise(
    record: Record, repeats: tuple[Record, ...], response: Response, period: float | None
) -> tuple[NoiseFloor | None, str]:
    """Noise floor, or why there is none."""
    try:
        return noise_floor(record, period=period, repeats=repeats, outputs=response.output_names), ""
    except NoTrustworthyNumber as none:
        return None, f"{none.found}; {none.hint}" if none.hint else none.found


def _linear(
    record: Record, response: Response, whole: Stretch, noise: NoiseFloor | None
) -> tuple[dict[str, dict[str, BestLinearApproximation]], str]:
    """Best linear approximation of every output from every input that moves, or why there is none."""
    moving = [name for name, u in whole.u.items() if np.ptp(u)]
    if not moving:
        return {}, "no input moves"
    source = _excitation(response, noise)
    result: dict[str, dict[str, BestLinearApproximation]] = {}
    for k, name in enumerate(response.output_names):
        model = response.model.select(inputs=list(whole.u), outputs=[name])
        if noise is None or source is None or len(moving) > 1:
            result[name] = arbitrary_bla(whole.t, whole.u, whole.y[:, k], model)
            continue
        lines, kind = judged_lines(noise.periodic(record[source]))
        u, y = noise.periodic(whole.u[moving[0]]), noise.periodic(whole.y[:, k])
        line = periodic_bla(u, y, record.dt, model.select(inputs=moving), lines[kind == 0])
        result[name] = {moving[0]: line} if line else {}
    return result, "" if all(result.values()) else "too few samples, or no line excited above the noise"


def _excitation(response: Response, noise: NoiseFloor | None) -> str | None:
    """The one signal whose periods excite the system: the reference that repeats, else the model's input."""
    if noise is None or noise.source != "periods":
        return None
    sources = noise.signal.split(", ") if noise.signal else list(response.model.input_names)
    return sources[0] if len(sources) == 1 else None


def _even_odd(record: Record, response: Response, noise: NoiseFloor | None) -> EvenOdd:
    """Even/odd test of the outputs, and of the inputs that a controller corrects."""
    source = _excitation(response, noise)
    if noise is None or source is None:
        several = noise is not None and noise.source == "periods"
        reason = "several signals excite at once" if several else "the record holds no repeated periods"
        return EvenOdd({}, "", f"the excitation does not allow it: {reason}")
    judged = [*response.output_names, *(name for name in noise.input_std if name != source)]
    return even_odd(noise, record[source], {name: record[name] for name in judged}, record.dt)


def _localised(
    whole: Stretch, response: Response, free: Array, windows: WindowedSimulation, motion: Motion, *, lags: int
) -> dict[str, Any]:
    """Gap, windows, speed, direction, position, amplitude, frequency and residual tests of every output."""
    result: dict[str, dict[str, Any]] = {
        key: {}
        for key in ("outputs", "windows", "speed", "direction", "position", "amplitude", "frequency", "residual")
    }
    t, u, y = whole.t, whole.u, whole.y
    point = response.model.operating_point
    offset = dict(zip(response.model.input_names, point.u, strict=True)) if point else {}
    size = {name: np.abs(x - offset.get(name, 0.0)) for name, x in u.items() if np.ptp(x)}
    for k, (name, unit) in enumerate(response.outputs):
        error, local = y[:, k] - free[:, k], y[:, k] - windows.y[:, k]
        result["outputs"][name] = _gap(Signal(name, unit), t, y[:, k], error, local)
        result["windows"][name] = _window_errors(t, error, local, windows.edges)
        if motion.speed is not None:
            result["speed"][name] = bins(motion.speed, local, speed_edges(motion.speed))
            result["direction"][name] = directions(motion.speed, local)
        if motion.position is not None:
            result["position"][name] = bins(motion.position, local, position_edges(motion.position))
        result["amplitude"][name] = {key: bins(value, local, amplitude_edges(value)) for key, value in size.items()}
        result["frequency"][name] = spectrum(t, u, y[:, k], free[:, k])
        residual = windows.residual[:, k]
        known = residual[np.isfinite(residual)]
        rms = float(np.sqrt(np.mean(known**2))) if len(known) else 0.0
        against = {name_u: input_correlation(samples, residual, lags) for name_u, samples in u.items()}
        result["residual"][name] = ResidualTests(rms, whiteness(residual, lags), against)
    return result


def _gap(signal: Signal, t: Array, y: Array, error: Array, local: Array) -> OutputGap:
    spread, spread_rms = float(np.ptp(y)), float(np.sqrt(np.mean((y - y.mean()) ** 2)))

    def judged(e: Array) -> tuple[float, float, float, float, float]:
        peak, rms = float(np.abs(e).max()), float(np.sqrt(np.mean(e**2)))
        # A signal whose spread or its square vanishes in floating point has nothing to be compared with.
        percent = 100.0 / spread if spread_rms else np.nan
        fit = 100.0 * (1.0 - rms / spread_rms) if spread_rms else np.nan
        return peak, rms, peak * percent, rms * percent, fit

    return OutputGap(signal.name, signal.unit, spread, *judged(error), float(t[np.abs(error).argmax()]), *judged(local))


def _window_errors(t: Array, error: Array, local: Array, edges: NDArray[np.int_]) -> WindowErrors:
    size = np.diff(edges)
    rms, local_rms = (np.sqrt(np.add.reduceat(e**2, edges[:-1]) / size) for e in (error, local))
    return WindowErrors(
        t[edges[:-1]],
        t[edges[1:] - 1],
        rms,
        time_shares(error, edges),
        local_rms,
        time_shares(local, edges),
        int(local_rms.argmax()),
        int(rms.argmax()),
    )


def _window_length(response: Response, record: Record, window: float | None) -> int:
    """Samples per window."""
    if window is not None:
        return _samples("window", window, record)
    seconds = response.slowest_time_constant() or record.duration / WINDOWS_WITHOUT_TIME_CONSTANT
    shortest = max(SHORTEST_WINDOW, 10 * response.n_states)
    return min(record.n, max(shortest, min(round(seconds / record.dt), record.n // WINDOWS_AT_LEAST)))


def _samples(what: str, seconds: float, record: Record) -> int:
    if not np.isfinite(seconds) or not 2 * record.dt <= seconds <= record.duration + record.dt:
        raise InputError(
            f"compare {record.name}: {what}", f"{seconds:g} s", f"{2 * record.dt:g} s to {record.duration:g} s"
        )
    return round(seconds / record.dt)


def _kept(record: Record, response: Response, y: Array, title: str) -> Record:
    """The compared signals alone, with ``y`` as outputs."""
    inputs = {name: record.inputs[name] for name in response.model.input_names}
    outputs = {name: y[:, k] for k, name in enumerate(response.output_names)}
    return Record(record.t, inputs, outputs, {name: record.unit(name) for name in (*inputs, *outputs)}, title)


def _name(plant_or_model: Any) -> str:
    return str(getattr(plant_or_model, "name", None) or repr(plant_or_model))


def _warnings(response: Response, record: Record, initial: InitialState, motion: Motion) -> tuple[str, ...]:
    warnings = [*response.warnings, *channel_warnings(record, response.model.input_names, response.output_names)]
    slowest = response.slowest_time_constant()
    if record.duration < slowest:
        warnings.append(
            f"the record lasts {record.duration:.3g} s, the slowest time constant of the model is {slowest:.3g} s: "
            "slow behaviour is not tested"
        )
    if initial.rank < response.n_states:
        warnings.append(
            f"the recorded outputs determine {initial.rank} of {response.n_states} states at the start; "
            "the rest was taken as the smallest that fits"
        )
    if not record.is_uniform:
        warnings.append("the clock is not uniform: spectra are of interpolated signals, lags count samples")
    if motion.speed is None:
        warnings.append(
            "no output in a unit of speed, length or angle: the error is not sorted by speed (name one with speed=)"
        )
    return tuple(warnings)
