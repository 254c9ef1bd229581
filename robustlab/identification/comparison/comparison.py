"""`compare`: how well a plant or model reproduces a record in free run and in windows, and where it does not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from robustlab import checks
from robustlab.arrays import Array
from robustlab.budget import one_thread
from robustlab.dynamics.fmu import FmuPlant
from robustlab.dynamics.fmu import FreeRun as RunOfUnit
from robustlab.dynamics.plant_contract import NonlinearPlant, SteppedPlant
from robustlab.errors import NoTrustworthyNumber, UsageError, told_as
from robustlab.identification.comparison.along_motion import compare_along
from robustlab.identification.comparison.best_linear_approximation import (
    BestLinearApproximation,
    arbitrary_bla,
    periodic_bla,
)
from robustlab.identification.comparison.comparison_result import Comparison
from robustlab.identification.comparison.error_analysis import (
    FreeRun,
    Motion,
    even_odd_test,
    excitation,
    kept,
    localised,
    motion_of,
    noise_gaps,
    noise_of,
    repeated,
    samples_of,
    title,
)
from robustlab.identification.comparison.input_disturbance import input_disturbances
from robustlab.identification.comparison.repeats import NoiseFloor
from robustlab.identification.comparison.residual_tests import judged_lines
from robustlab.identification.record_check.suitability import channel_warnings
from robustlab.identification.response.response import Response, Stretch, response_of
from robustlab.identification.response.windowed_simulation import InitialState, starting_state, windowed_simulation
from robustlab.record import Record
from robustlab.result import Status

LAGS = 25
SHORTEST_WINDOW = 20  # samples
WINDOWS_AT_LEAST = 4  # that a window chosen by us leaves in the record
WINDOWS_WITHOUT_TIME_CONSTANT = 50
LARGEST_OUTPUT = 1e100  # squares of larger numbers overflow


@one_thread()
@told_as("compare")
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
) -> Comparison | RunOfUnit:
    """Compare a plant or model with a measured record at all outputs they share.

    Parameters
    ----------
    plant
        A `Plant`, a `StateSpaceModel` or a ``control.StateSpace``; all its inputs must be in the record. Inputs are
        held between samples. A nonlinear plant, whose positions must all be recorded, is linear in each window about
        the recorded motion; its free run is its own, and may end early (``free_run``). A co-simulation unit runs from
        its own initial state only, and takes none of the options.
    record
        The measurement; it may hold any subset of the outputs, and signals that the model does not know.
    window
        Length of the windows in s. Left out: the model's slowest time constant, but at most a quarter of the record; a
        fiftieth of the record for a model of integrators only. Of a nonlinear plant that is unstable, no longer than
        what it deviates by grows twentyfold.
    start
        Longest opening stretch in s to which the initial state of the free run is fitted; ``window`` where left out
        (see `robustlab.identification.response.windowed_simulation.starting_state`).
    lags
        Number of lags of the residual tests.
    speed, position
        Recorded outputs over which the error is sorted; chosen by their units where left out. Of a nonlinear plant
        each output's error is sorted over the motion of its own joint.
    period
        Period of the record in s. Left out: found where an input, or a recorded signal that the model does not know
        (the controller's reference), repeats exactly; in closed loop without a recorded reference it must be stated.
    repeats
        Further records with the same input, for the noise floor.

    Returns
    -------
    Comparison
        A large gap is a result, not an error. Of a co-simulation unit what `FmuPlant.compare` gives.

    Raises
    ------
    UsageError
        Options for windows, period or repeats with a co-simulation unit.
    InputError
        An input of the model or every output is missing, a wrong sample time, a window that does not fit; a stated
        period or repeat that the inputs contradict; a plant with effects; of a nonlinear plant a position that is not
        recorded.
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
    checks.whole("compare: lags", lags, 1)
    if isinstance(plant, FmuPlant):
        if repeats or (window, start, lags, speed, position, period) != (None, None, LAGS, None, None, None):
            found = f"options for the windows of {plant.name}"
            expected = "none: a co-simulation unit runs from its own initial state"
            raise UsageError(f"compare {record.name}", found, expected)
        return plant.compare(record)
    if isinstance(plant, NonlinearPlant) and not isinstance(plant, SteppedPlant):
        return compare_along(
            plant, record, window=window, start=start, lags=lags, speed=speed, position=position, period=period,
            repeats=repeats,
        )  # fmt: skip
    response = response_of(plant, record)
    inputs, outputs = response.model.input_names, response.output_names
    record = response.with_units(record)
    whole = response.stretch(record)
    length = _window_length(response, record, window)
    initial = starting_state(response, whole, length if start is None else samples_of("start", start, record))
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
    motions, lags = dict.fromkeys(outputs, motion), min(lags, record.n // 4)
    found = localised(whole, response.outputs, free, windows, motions, _sizes(response, whole), lags)
    others = tuple(response_of(plant, other).with_units(other) for other in repeats)
    noise, noise_reason = noise_of(record, others, outputs, period)
    rms = {name: (gap.rms, gap.windowed_rms) for name, gap in found["outputs"].items()}
    stretches = repeated(noise, whole, [response.stretch(r) for r in others]) if noise else []
    errors = [s.y - windowed_simulation(response, s, length).y for s in stretches]
    linear, linear_reason = _linear(record, response, whole, noise)
    return Comparison(
        status=Status.CONVERGED,
        model=title(plant),
        record=record.name,
        motions=motions,
        initial_state=initial,
        window=length * record.dt,
        measured=kept(record, inputs, outputs, whole.y, record.name),
        simulated=kept(record, inputs, outputs, free, f"{record.name} (free run)"),
        windowed=kept(record, inputs, outputs, windows.y, f"{record.name} (windowed simulation)"),
        recursive={name: windows.residual[:, k] for k, name in enumerate(outputs)},
        disturbance=input_disturbances(plant, response, whole, whole.y - windows.y, length, motion),
        warnings=_warnings(response, record, initial, motion),
        noise=noise,
        noise_reason=noise_reason,
        against_noise=noise_gaps(outputs, np.stack(errors), noise, rms) if noise else {},
        linear=linear,
        linear_reason=linear_reason,
        nonlinearity=even_odd_test(record, inputs, outputs, noise),
        free_run=FreeRun(float(record.t[-1]), ""),
        **found,
    )


def _sizes(response: Response, whole: Stretch) -> dict[str, Array]:
    """Input name -> its deviation (n,) from the operating point, of those that move."""
    point = response.model.operating_point
    offset = dict(zip(response.model.input_names, point.u, strict=True)) if point else {}
    return {name: np.abs(x - offset.get(name, 0.0)) for name, x in whole.u.items() if np.ptp(x)}


def _linear(
    record: Record, response: Response, whole: Stretch, noise: NoiseFloor | None
) -> tuple[dict[str, dict[str, BestLinearApproximation]], str]:
    """Best linear approximation of every output from every input that moves, or why there is none."""
    moving = [name for name, u in whole.u.items() if np.ptp(u)]
    if not moving:
        return {}, "no input moves"
    source = excitation(response.model.input_names, noise)
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


def _window_length(response: Response, record: Record, window: float | None) -> int:
    """Samples per window."""
    if window is not None:
        return samples_of("window", window, record)
    seconds = response.slowest_time_constant() or record.duration / WINDOWS_WITHOUT_TIME_CONSTANT
    shortest = max(SHORTEST_WINDOW, 10 * response.n_states)
    return min(record.n, max(shortest, min(round(seconds / record.dt), record.n // WINDOWS_AT_LEAST)))


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
