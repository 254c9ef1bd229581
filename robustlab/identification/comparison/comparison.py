"""`compare`: errors of a plant or model against a record, in free run and in windows.

A nonlinear plant is linear about the measured motion, and nonlinear in free run; simulated from the same initial states
it measures the linearisation error. Errors are sorted along the motion of the joint that each output belongs to.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import one_thread
from robustlab.dynamics.plant_contract import LocalModels, NonlinearPlant, SteppedPlant, input_signal
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.identification.comparison.comparison_result import Comparison
from robustlab.identification.comparison.error_analysis import (
    FreeRun,
    InputDisturbance,
    Linearisation,
    Motion,
    input_disturbances,
    joint_disturbances,
    kept,
    localised,
    motion_of,
)
from robustlab.identification.comparison.repeats import Excess, NoiseFloor, noise_floor
from robustlab.identification.data_checks.channel_identity import along_motion
from robustlab.identification.data_checks.resampling import clock_step, refuse_gaps, uniform
from robustlab.identification.data_checks.suitability import channel_warnings
from robustlab.identification.greybox.disturbance_smoother import SmoothedRecord
from robustlab.identification.greybox.prepared_record import window_length
from robustlab.identification.response.response import (
    matched,
    response_of,
    slowest_time_constant,
    stretch_of,
    with_units,
)
from robustlab.identification.response.windowed_simulation import (
    InitialState,
    LinearResponse,
    MotionResponse,
    WindowedSimulation,
    starting_state,
    window_edges,
    windowed_simulation,
)
from robustlab.record import Record
from robustlab.result import Status
from robustlab.statespace import Signal

LAGS = 25
SHORTEST_WINDOW = 20  # samples
WINDOWS_AT_LEAST = 4  # in the record, for a default window
WINDOWS_WITHOUT_TIME_CONSTANT = 50
LARGEST_OUTPUT = 1e100  # squares of larger numbers overflow
MOSTLY = 10.0  # times the coupling to any other joint: then an output belongs to this one
POINTS = 60  # of the motion, at which the couplings of signals and joints and the instability are evaluated
NO_MOTION = Motion(None, None, "", "", "", "")
SHORTEST_RECORD = 40  # samples
CHECKED = 6  # windows that are also simulated with the nonlinear plant
DIVERGED = 10.0  # times the recorded range from the record: the free run ends there
SECTION = 100  # samples that the free run simulates at once
RTOL = 1e-9
GROWN = 20.0  # times: a larger growth of an initial error gives a warning


class Matching(NamedTuple):
    """A plant or model matched with a record, at the signals that both have."""

    model: LinearResponse | MotionResponse
    record: Record  # as used: resampled, in the model's units
    inputs: list[str]
    outputs: tuple[Signal, ...]
    warnings: tuple[str, ...]
    smoothed: SmoothedRecord | None = None  # the motion of a nonlinear plant


@one_thread()
@error_context("compare")
def compare(
    plant: Any,
    record: Record,
    *,
    window: float | None = None,
) -> Comparison:
    """Compare a plant or model with a measured record at all outputs they share.

    Parameters
    ----------
    plant
        A `Plant`, a `StateSpaceModel` or a ``control.StateSpace``; all its inputs must be in the record. Inputs are
        held between samples. A nonlinear plant, whose positions must all be recorded, is linear in each window about
        the recorded motion; its free run is nonlinear and may end early (``free_run``).
    record
        The measurement; it may hold any subset of the outputs, and further signals.
    window
        Length of the windows in s. Default: the model's slowest time constant, but at most a quarter of the record; a
        fiftieth of the record for a model of integrators only. For an unstable nonlinear plant, at most the time in
        which a deviation grows twentyfold.

    Returns
    -------
    Comparison
        A large model error is a result, not an exception.

    Raises
    ------
    InputError
        An input of the model or every output is missing, a wrong sample time, a window that does not fit; a plant with
        effects or a co-simulation unit; a position of a nonlinear plant that is not recorded.
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
    matching = _matching(plant, record)
    model, record, inputs = matching.model, matching.record, matching.inputs
    outputs, whole = [s.name for s in matching.outputs], model.whole
    length = _window_length(plant, matching, window)
    initial = starting_state(model, length)
    windows = windowed_simulation(model, window_edges(record.n, length))
    error, checked, disturbance = whole.y - windows.y, None, dict[str, InputDisturbance]()
    if isinstance(model, MotionResponse):
        run, free = free_run(model, initial.x0, outputs)
        motions, of_joints = motions_of_outputs(model, record), motions_of_joints(model, record)
        checked = linearisation(model, windows, outputs)
        if matching.smoothed:
            disturbance = joint_disturbances(model, matching.smoothed, error, windows.edges, of_joints)
    else:
        run, free = FreeRun(float(record.t[-1]), ""), model.response.simulate(whole.t, whole.u, initial.x0)
        if np.abs(free).max() > LARGEST_OUTPUT:
            hint = "compare a shorter stretch (Record.between)"
            raise NoTrustworthyNumber(f"compare {record.name}", "the free run overflows", "a stable model", hint)
        motion = motion_of(record, length)
        motions = dict.fromkeys(outputs, motion)
        disturbance = input_disturbances(plant, model, error, windows.edges, motion)
    found = localised(whole, matching.outputs, free if run.whole else None, windows, motions, min(LAGS, record.n // 4))
    noise, noise_reason = None, ""
    try:
        noise = noise_floor(record, outputs=outputs)
    except NoTrustworthyNumber as none:
        noise_reason = f"{none.found}; {none.hint}" if none.hint else none.found
    warnings = channel_warnings(record, tuple(inputs), tuple(outputs))
    return Comparison(
        status=Status.CONVERGED,
        model=str(getattr(plant, "name", None) or repr(plant)),
        record=record.name,
        motions=motions,
        initial_state=initial,
        window=length * record.dt,
        measured=kept(record, inputs, outputs, whole.y, record.name),
        simulated=kept(record, inputs, outputs, free, f"{record.name} (free run)") if len(free) > 1 else None,
        windowed=kept(record, inputs, outputs, windows.y, f"{record.name} (windowed simulation)"),
        disturbance=disturbance,
        warnings=(*matching.warnings, *warnings, *_warnings(matching, initial, motions, checked, run)),
        noise=noise,
        noise_reason=noise_reason,
        against_noise=_against_noise(noise, model, length, outputs) if noise else {},
        free_run=run,
        linearisation=checked,
        sensor_noise=dict(zip(outputs, (1.0 / whole.weight).tolist(), strict=True)) if checked else {},
        **found,
    )


def _matching(plant: Any, record: Record) -> Matching:
    """Match a plant or model with a record: linear, or linear about the recorded motion."""
    if isinstance(plant, NonlinearPlant) and not isinstance(plant, SteppedPlant):
        return matching_along(plant, record)
    response = response_of(plant, record)
    record = response.with_units(record)
    model = LinearResponse(response, response.stretch(record))
    return Matching(model, record, list(response.model.input_names), response.outputs, response.warnings)


def _against_noise(
    floor: NoiseFloor, model: LinearResponse | MotionResponse, length: int, names: Sequence[str]
) -> dict[str, Excess]:
    """Compare the errors of every output with the noise floor, with windows at the same phases of every period."""
    n, error = floor.samples, model.whole.y.copy()
    for first in floor.first + n * np.arange(floor.count):
        error[first : first + n] -= windowed_simulation(model, first + window_edges(n, length)).y[first : first + n]
    return {name: floor.excess(error[:, k]) for k, name in enumerate(names)}


def _window_length(plant: Any, matching: Matching, window: float | None) -> int:
    record, model = matching.record, matching.model
    if window is not None:
        if not np.isfinite(window) or not 2 * record.dt <= window <= record.duration + record.dt:
            expected = f"{2 * record.dt:g} s to {record.duration:g} s"
            raise InputError(f"compare {record.name}: window", f"{window:g} s", expected)
        return round(window / record.dt)
    if isinstance(model, MotionResponse):
        return window_length(plant, [record])
    seconds = slowest_time_constant(model.response.model) or record.duration / WINDOWS_WITHOUT_TIME_CONSTANT
    shortest = max(SHORTEST_WINDOW, 10 * len(model.state_names))
    return min(record.n, max(shortest, min(round(seconds / record.dt), record.n // WINDOWS_AT_LEAST)))


def _warnings(
    matching: Matching, initial: InitialState, motions: dict[str, Motion], checked: Linearisation | None, run: FreeRun
) -> list[str]:
    record, model, texts = matching.record, matching.model, []
    along, n_x = isinstance(model, MotionResponse), len(model.state_names)
    if initial.rank < n_x:
        rest = "the others are those of the smoothed motion" if along else "the others are the smallest that fit"
        texts.append(f"the recorded outputs determine {initial.rank} of {n_x} states at the start; {rest}")
    if along:
        return [*texts, *(checked.warnings() if checked else []), *unstable(model, run)]
    slowest = slowest_time_constant(model.response.model)
    if record.duration < slowest:
        size = f"lasts {record.duration:.3g} s, the slowest time constant of the model is {slowest:.3g} s"
        texts.append(f"the record {size}: slow behaviour is not tested")
    if not record.is_uniform:
        texts.append("the clock is not uniform: spectra are of interpolated signals, lags count samples")
    if next(iter(motions.values())).speed is None:
        texts.append("no output in a unit of speed, length or angle: the error is not sorted by speed")
    return texts


# --- nonlinear plants -------------------------------------------------------------------------------------------------


def matching_along(plant: NonlinearPlant, record: Record) -> Matching:
    """Match a nonlinear plant with a record, linear about the record's motion."""
    outputs, warnings = matched(plant.inputs, plant.outputs, record)
    where = f"compare {record.name}"
    if record.n < SHORTEST_RECORD:
        raise InputError(where, f"{record.n} samples", f"at least {SHORTEST_RECORD}")
    if not record.is_uniform:
        level = uniform(record, clock_step(record.t))
        refuse_gaps(where, level.gaps, "compare")
        record = level.record
        warnings = (*warnings, f"the clock is not uniform: resampled in steps of {record.dt:.6g} s")
    record = with_units(record, (*plant.inputs, *outputs))
    inputs, names = [s.name for s in plant.inputs], [s.name for s in outputs]
    if dead := [name for name in names if not np.ptp(record[name])]:
        found = f"{dead[0]} stands at {record[dead[0]][0]:.6g} {record.unit(dead[0])}".rstrip() + " throughout"
        raise InputError(where, found, "outputs that move", "remove a dead sensor from the record")
    try:
        model, smoothed = along_motion(plant, stretch_of(record, inputs, names), names)
    except InputError as wrong:  # its message refers to effect identification
        raise InputError(where, wrong.found, wrong.expected, wrong.hint) from None
    return Matching(model, record, inputs, outputs, warnings, smoothed)


# --- the motion of joints ---------------------------------------------------------------------------------------------


def motions_of_outputs(model: MotionResponse, record: Record) -> dict[str, Motion]:
    """Return output name -> motion of its joint, or `NO_MOTION` for an output without a unique joint.

    An output that measures no position or speed (a current) belongs to the joint whose speed acts on it most.
    """
    plant, x, local = model.plant, model.course.x, _about(model)
    joints = _joints(plant)
    speeds = [v for _, v in joints]
    found = {}
    for k in model.columns:
        state = int(np.abs(local.C[:, k]).mean(axis=0).argmax())
        joint = next((j for j, pair in enumerate(joints) if state in pair), None)
        if joint is None and joints:
            ties = np.abs(local.A[:, state, speeds]).mean(axis=0) * np.sqrt((x[:, speeds] ** 2).mean(axis=0))
            second, first = np.sort([0.0, *ties])[-2:]
            joint = int(ties.argmax()) if first > 0 and first >= MOSTLY * second else None
        found[plant.outputs[k].name] = NO_MOTION if joint is None else _motion(plant, joints[joint], x, record)
    return found


def motions_of_joints(model: MotionResponse, record: Record) -> list[Motion]:
    """Return the motion of each joint, or `NO_MOTION` for each input of a plant without joints."""
    found = [_motion(model.plant, joint, model.course.x, record) for joint in _joints(model.plant)]
    return found or [NO_MOTION] * len(model.plant.inputs)


def _about(model: MotionResponse) -> LocalModels:
    x, u = model.course.x, model.course.u
    at = np.unique(np.linspace(0, len(x) - 1, POINTS).astype(int))
    return model.plant.local_models(x[at], u[at])


def _joints(plant: NonlinearPlant) -> list[tuple[int, int]]:
    """Return the indices of position (-1 without one) and velocity of each joint."""
    names = [s.name for s in plant.states]
    joints = [p for p in plant.port_places if p.kind == "joint"]
    return [(names.index(p.position) if p.position else -1, names.index(p.name)) for p in joints]


def _motion(plant: NonlinearPlant, joint: tuple[int, int], x: Array, record: Record) -> Motion:
    q, v = joint
    speed, unit = f"{plant.states[v].name} (smoothed)", plant.states[v].unit
    if q < 0:
        return Motion(x[:, v], None, unit, "", speed, "")
    name = plant.states[q].name
    if name in record.outputs:
        return Motion(x[:, v], record[name], unit, record.unit(name), speed, name)
    return Motion(x[:, v], x[:, q], unit, plant.states[q].unit, speed, f"{name} (smoothed)")


# --- simulations of the nonlinear plant ------------------------------------------------------------------------------


def free_run(model: MotionResponse, x0: Array, names: Sequence[str]) -> tuple[FreeRun, Array]:
    """Simulate the nonlinear plant from the start of the record, (m, n_y), until it diverges."""
    t, y, plant = model.whole.t, model.whole.y, model.plant
    spread = np.ptp(y, axis=0)
    limit = np.where(spread > 0, DIVERGED * spread, np.inf)
    u, states, reason = model.course.u, x0[None], ""
    while len(states) < len(t) and not reason:
        first = len(states) - 1
        more, reason = _onward(model, states[-1], first, min(first + SECTION, len(t) - 1))
        states = np.vstack([states, more])
        made = plant.outputs_along(states[first:], u[first : len(states)])[:, list(model.columns)]
        beyond = np.abs(made - y[first : len(states)]) > limit
        if beyond.any():
            k = int(beyond.any(axis=1).argmax())
            worst = names[int(beyond[k].argmax())]
            reason = f"{worst} is {DIVERGED:g} times its recorded range off"
            states = states[: first + max(k, 1)]
    made = plant.outputs_along(states, u[: len(states)])[:, list(model.columns)]
    return FreeRun(float(t[len(states) - 1]), reason), made


def _onward(model: MotionResponse, x: Array, first: int, last: int) -> tuple[Array, str]:
    """Return the states after sample ``first`` up to ``last``, or none with the reason."""
    t, u, plant = model.whole.t, model.course.u, model.plant
    middle = np.concatenate([t[first:last], [0.5 * (t[last - 1] + t[last]), t[last]]])  # three times at least
    held = np.vstack([u[first:last], u[last - 1 : last], u[last : last + 1]])
    try:
        found = np.delete(plant.trajectory(input_signal(middle, held, "zoh"), x, RTOL), -2, axis=0)[1:]
    except NoTrustworthyNumber as end:
        return np.zeros((0, len(x))), end.found
    return (found, "") if np.isfinite(found).all() else (found[:0], "the free run overflows")


def linearisation(model: MotionResponse, windows: WindowedSimulation, names: Sequence[str]) -> Linearisation:
    """Simulate some windows and the worst one with the nonlinear plant from the fitted initial states."""
    whole, plant, edges, u = model.whole, model.plant, windows.edges, model.course.u
    error = whole.y - windows.y
    squares = ((error * whole.weight) ** 2).sum(axis=1)
    worst = int((np.add.reduceat(squares, edges[:-1]) / np.diff(edges)).argmax())
    different, missed, checked, broken = [], [], [], []
    for k in np.unique([worst, *np.linspace(0, len(edges) - 2, CHECKED).astype(int)]):
        a, b = int(edges[k]), int(edges[k + 1])
        more, reason = _onward(model, windows.x0[k], a, b - 1)
        if reason:
            broken.append(whole.t[a])
            continue
        made = plant.outputs_along(np.vstack([windows.x0[k], more]), u[a:b])[:, list(model.columns)]
        different.append(made - windows.y[a:b])
        missed.append(error[a:b])
        checked.append(whole.t[a])
    if not checked:
        return Linearisation(np.zeros(0), {}, {}, np.array(broken))
    rms, error_rms = (np.sqrt((np.vstack(x) ** 2).mean(axis=0)) for x in (different, missed))
    share = np.divide(rms, error_rms, out=np.zeros_like(rms), where=error_rms > 0)
    difference, part = (dict(zip(names, values.tolist(), strict=True)) for values in (rms, share))
    return Linearisation(np.array(checked), difference, part, np.array(broken))


def unstable(model: MotionResponse, run: FreeRun) -> list[str]:
    """Return a warning if the free run is complete but dominated by the growth of its initial error."""
    t, rates = model.whole.t, np.linalg.eigvals(_about(model).A).real.max(axis=1)
    growth = float(np.maximum(rates, 0.0).mean() * (t[-1] - t[0]))
    if not run.whole or growth < np.log(GROWN):
        return []
    size = f"an error of its start grows about {np.exp(min(growth, 700.0)):.2g} times over the free run"
    return [f"the plant is unstable along the record: {size}, so the windows are more informative"]
