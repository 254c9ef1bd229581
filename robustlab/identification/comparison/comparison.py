"""`compare`: errors of a plant or model against a record, in free run and in windows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from robustlab import checks
from robustlab.arrays import Array
from robustlab.budget import one_thread
from robustlab.dynamics.fmu import FmuPlant
from robustlab.dynamics.fmu import FreeRun as RunOfUnit
from robustlab.dynamics.plant_contract import NonlinearPlant, SteppedPlant
from robustlab.errors import NoTrustworthyNumber, UsageError, error_context
from robustlab.identification.comparison.along_motion import (
    Matching,
    free_run,
    linearisation,
    matching_along,
    motions_of_joints,
    motions_of_outputs,
    pose_of,
    unstable,
)
from robustlab.identification.comparison.comparison_result import Comparison
from robustlab.identification.comparison.error_analysis import (
    FreeRun,
    Linearisation,
    Motion,
    NoiseGap,
    OutputGap,
    kept,
    localised,
    motion_of,
    samples_of,
)
from robustlab.identification.comparison.input_disturbance import (
    InputDisturbance,
    input_disturbances,
    joint_disturbances,
)
from robustlab.identification.comparison.repeats import NoiseFloor, noise_floor
from robustlab.identification.data_checks.suitability import channel_warnings
from robustlab.identification.greybox.prepared_record import window_length
from robustlab.identification.response.response import response_of
from robustlab.identification.response.windowed_simulation import (
    InitialState,
    LinearResponse,
    MotionResponse,
    starting_state,
    window_edges,
    windowed_simulation,
)
from robustlab.record import Record
from robustlab.result import Status

LAGS = 25
SHORTEST_WINDOW = 20  # samples
WINDOWS_AT_LEAST = 4  # in the record, for a default window
WINDOWS_WITHOUT_TIME_CONSTANT = 50
LARGEST_OUTPUT = 1e100  # squares of larger numbers overflow


@one_thread()
@error_context("compare")
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
        the recorded motion; its free run is nonlinear and may end early (``free_run``). A co-simulation unit runs from
        its own initial state only, and takes none of the options.
    record
        The measurement; it may hold any subset of the outputs, and further signals.
    window
        Length of the windows in s. Default: the model's slowest time constant, but at most a quarter of the record; a
        fiftieth of the record for a model of integrators only. For an unstable nonlinear plant, at most the time in
        which a deviation grows twentyfold.
    start
        Longest opening stretch in s to which the initial state of the free run is fitted; default ``window``
        (see `robustlab.identification.response.windowed_simulation.starting_state`).
    lags
        Number of lags of the residual tests.
    speed, position
        Recorded outputs over which the error is sorted; by default chosen by their units. For a nonlinear plant the
        error of each output is sorted over the motion of its own joint.
    period
        Period of the record in s. Default: that with which an input, or a recorded signal that is not in the model
        (the controller's reference), repeats exactly; required in closed loop without a recorded reference.
    repeats
        Further records with the same input, for the noise floor.

    Returns
    -------
    Comparison
        A large model error is a result, not an exception. For a co-simulation unit the result of `FmuPlant.compare`.

    Raises
    ------
    UsageError
        Options for windows, period or repeats with a co-simulation unit.
    InputError
        An input of the model or every output is missing, a wrong sample time, a window that does not fit; a stated
        period or repeat that the inputs contradict; a plant with effects; a position of a nonlinear plant that is not
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
    matching = _matching(plant, record)
    model, record, inputs = matching.model, matching.record, matching.inputs
    outputs = [s.name for s in matching.outputs]
    whole, along = model.whole, model if isinstance(model, MotionResponse) else None
    length = _window_length(plant, matching, window)
    initial = starting_state(model, length if start is None else samples_of("start", start, record))
    windows = windowed_simulation(model, window_edges(record.n, length))
    if isinstance(model, MotionResponse):
        run, free = free_run(model, initial.x0, outputs)
    else:
        run, free = FreeRun(float(record.t[-1]), ""), model.response.simulate(whole.t, whole.u, initial.x0)
        if np.abs(free).max() > LARGEST_OUTPUT:
            hint = "compare a shorter stretch (Record.between)"
            raise NoTrustworthyNumber(f"compare {record.name}", "the free run overflows", "a stable model", hint)
    if isinstance(model, MotionResponse) and not (speed or position):
        motions, of_joints = motions_of_outputs(model, record), motions_of_joints(model, record)
    else:
        of_joints = [motion_of(record, speed, position, length)]
        motions = dict.fromkeys(outputs, of_joints[0])
    whole_run, lags = free if run.whole else None, min(lags, record.n // 4)
    found = localised(whole, matching.outputs, whole_run, windows, motions, _sizes(matching), lags)
    others = [_matching(plant, other) for other in repeats]
    noise, noise_reason = None, ""
    try:
        noise = noise_floor(record, period=period, repeats=tuple(other.record for other in others), outputs=outputs)
    except NoTrustworthyNumber as none:
        noise_reason = f"{none.found}; {none.hint}" if none.hint else none.found
    error = whole.y - windows.y
    disturbance: dict[str, InputDisturbance] = {}
    if isinstance(model, LinearResponse):
        disturbance = input_disturbances(plant, model, error, windows.edges, of_joints[0])
    elif matching.smoothed:
        disturbance = joint_disturbances(model, matching.smoothed, error, windows.edges, of_joints)
    checked = linearisation(along, windows, outputs) if along else None
    compared = Comparison(
        status=Status.CONVERGED,
        model=str(getattr(plant, "name", None) or repr(plant)),
        record=record.name,
        motions=motions,
        initial_state=initial,
        window=length * record.dt,
        measured=kept(record, inputs, outputs, whole.y, record.name),
        simulated=kept(record, inputs, outputs, free, f"{record.name} (free run)") if len(free) > 1 else None,
        windowed=kept(record, inputs, outputs, windows.y, f"{record.name} (windowed simulation)"),
        recursive={name: windows.residual[:, k] for k, name in enumerate(outputs)},
        disturbance=disturbance,
        warnings=(
            *matching.warnings,
            *channel_warnings(record, tuple(inputs), tuple(outputs)),
            *_warnings(matching, initial, motions, checked, run),
        ),
        noise=noise,
        noise_reason=noise_reason,
        against_noise=_against_noise(noise, matching, others, length, found["outputs"]) if noise else {},
        free_run=run,
        linearisation=checked,
        sensor_noise=dict(zip(outputs, (1.0 / whole.weight).tolist(), strict=True)) if along else {},
        left_out=_left_out(run, motions, inputs) if along else (),
        **found,
    )
    return replace(compared, pose=pose_of(plant, compared)) if along else compared


def _matching(plant: Any, record: Record) -> Matching:
    """Match a plant or model with a record: linear, or linear about the recorded motion."""
    if isinstance(plant, NonlinearPlant) and not isinstance(plant, SteppedPlant):
        return matching_along(plant, record)
    response = response_of(plant, record)
    record = response.with_units(record)
    model = LinearResponse(response, response.stretch(record))
    return Matching(model, record, list(response.model.input_names), response.outputs, response.warnings)


def _sizes(matching: Matching) -> dict[str, Array]:
    """Return |deviation from the operating point| (n,) of each moving input; for a nonlinear plant of a single one."""
    moving = {name: x for name, x in matching.model.whole.u.items() if np.ptp(x)}
    if isinstance(matching.model, MotionResponse):
        return {name: np.abs(x) for name, x in moving.items()} if len(matching.inputs) == 1 else {}
    point = matching.model.response.model.operating_point
    offset = dict(zip(matching.inputs, point.u, strict=True)) if point else {}
    return {name: np.abs(x - offset.get(name, 0.0)) for name, x in moving.items()}


def _against_noise(
    floor: NoiseFloor, matching: Matching, others: Sequence[Matching], length: int, gaps: Mapping[str, OutputGap]
) -> dict[str, NoiseGap]:
    """Compare the errors of every output with the noise floor, with windows at the same phases of every repeat."""
    n, errors = floor.samples, []
    parts = [(one, 0) for one in (matching, *others)]
    if floor.source == "periods":
        parts = [(matching, floor.first + k * n) for k in range(floor.count)]
    for one, first in parts:
        windows = windowed_simulation(one.model, first + window_edges(n, length))
        errors.append((one.model.whole.y - windows.y)[first : first + n])
    found: dict[str, NoiseGap] = {}
    for k, (name, gap) in enumerate(gaps.items()):
        std = floor.std[name]
        free, windowed = (100.0 * rms / std if std else None for rms in (gap.rms, gap.windowed_rms))
        found[name] = NoiseGap(std, free, windowed, floor.excess(np.stack([e[:, k] for e in errors])))
    return found


def _window_length(plant: Any, matching: Matching, window: float | None) -> int:
    record, model = matching.record, matching.model
    if window is not None:
        return samples_of("window", window, record)
    if isinstance(model, MotionResponse):
        return window_length(plant, [record])
    seconds = model.response.slowest_time_constant() or record.duration / WINDOWS_WITHOUT_TIME_CONSTANT
    shortest = max(SHORTEST_WINDOW, 10 * len(model.state_names))
    return min(record.n, max(shortest, min(round(seconds / record.dt), record.n // WINDOWS_AT_LEAST)))


def _warnings(
    matching: Matching, initial: InitialState, motions: dict[str, Motion], checked: Linearisation | None, run: FreeRun
) -> list[str]:
    record, model, texts = matching.record, matching.model, []
    along = isinstance(model, MotionResponse)
    if initial.rank < len(model.state_names):
        rest = "the others are those of the smoothed motion" if along else "the others are the smallest that fit"
        texts.append(
            f"the recorded outputs determine {initial.rank} of {len(model.state_names)} states at the start; {rest}"
        )
    if along:
        return [*texts, *(checked.warnings() if checked else []), *unstable(model, run)]
    slowest = model.response.slowest_time_constant()
    if record.duration < slowest:
        texts.append(
            f"the record lasts {record.duration:.3g} s, the slowest time constant of the model is {slowest:.3g} s: "
            "slow behaviour is not tested"
        )
    if not record.is_uniform:
        texts.append("the clock is not uniform: spectra are of interpolated signals, lags count samples")
    if next(iter(motions.values())).speed is None:
        texts.append(
            "no output in a unit of speed, length or angle: the error is not sorted by speed (name one with speed=)"
        )
    return texts


def _left_out(run: FreeRun, motions: dict[str, Motion], inputs: Sequence[str]) -> tuple[str, ...]:
    texts = []
    if not run.whole:
        texts.append("places in frequency: the free run does not reach the end of the record")
    if len(inputs) > 1:
        texts.append("error over the size of an input: several inputs")
    if loose := [name for name, motion in motions.items() if motion.speed is None]:
        texts.append(f"speed, direction and position of {', '.join(loose)}: not the motion of one joint")
    return tuple(texts)
