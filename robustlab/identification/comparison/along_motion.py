"""`compare` for a nonlinear plant: windows linear about the motion that the sensors tell, a free run as far as it is.

What the linearisation is worth is told by the plant itself, simulated from the same starts. By place the errors are
sorted along the motion of the joint that each output belongs to.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.plant_contract import LocalModels, NonlinearPlant, input_signal
from robustlab.dynamics.ports.motion_model import Course
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.comparison.comparison_result import POSE, Comparison
from robustlab.identification.comparison.error_analysis import (
    FreeRun,
    Linearisation,
    Motion,
    even_odd_test,
    kept,
    localised,
    motion_of,
    noise_gaps,
    noise_of,
    repeated,
    samples_of,
    title,
)
from robustlab.identification.comparison.input_disturbance import joint_disturbances
from robustlab.identification.hypotheses.disturbance_smoother import SmoothedRecord
from robustlab.identification.hypotheses.motion_smoother import smooth_motion
from robustlab.identification.hypotheses.prepared_record import window_length
from robustlab.identification.record_check.resampling import clock_step, uniform
from robustlab.identification.record_check.suitability import channel_warnings
from robustlab.identification.response.motion_response import (
    MotionResponse,
    fit_windows,
    start_along,
    windows_along,
)
from robustlab.identification.response.response import Stretch, matched, stretch_of, with_units
from robustlab.identification.response.windowed_simulation import WindowedSimulation, window_edges
from robustlab.record import Record
from robustlab.result import Status
from robustlab.statespace import Signal

MOSTLY = 10.0  # times what ties it to any other joint: then it belongs to this one
POINTS = 60  # of the motion: they tell the ties between signals and joints, and how unstable the plant is
NO_MOTION = Motion(None, None, "", "", "", "")


def motions_of_outputs(
    plant: NonlinearPlant, x: Array, u: Array, record: Record, columns: Sequence[int]
) -> dict[str, Motion]:
    """Output name -> motion of its joint along the states x (n, n_x); a `Motion` of nothing where it has no one joint.

    A current belongs to the joint whose speed acts on it most.
    """
    local = _about(plant, x, u)
    return {plant.outputs[k].name: _motion(plant, _joint_of_output(plant, local, x, k), x, record) for k in columns}


def motions_of_joints(plant: NonlinearPlant, x: Array, record: Record) -> list[Motion]:
    """Motion of each joint; nothing for each input of a plant without joints."""
    return [_motion(plant, j, x, record) for j in range(len(_joints(plant)))] or [NO_MOTION] * len(plant.inputs)


def _about(plant: NonlinearPlant, x: Array, u: Array) -> LocalModels:
    at = np.unique(np.linspace(0, len(x) - 1, POINTS).astype(int))
    return plant.local_models(x[at], u[at])


def _joints(plant: NonlinearPlant) -> list[tuple[int, int]]:
    """Index of position (-1 without one) and velocity of each joint."""
    names = [s.name for s in plant.states]
    return [
        (names.index(p.position) if p.position else -1, names.index(p.name))
        for p in plant.port_places
        if p.kind == "joint"
    ]


def _joint_of_output(plant: NonlinearPlant, local: LocalModels, x: Array, output: int) -> int | None:
    """Number of the joint of an output that shows one state."""
    state = int(np.abs(local.C[:, output]).mean(axis=0).argmax())
    joints = _joints(plant)
    own = next((j for j, pair in enumerate(joints) if state in pair), None)
    return own if own is not None or not joints else _foremost(_ties_of_state(local, joints, x, state))


def _ties_of_state(local: LocalModels, joints: Sequence[tuple[int, int]], x: Array, state: int) -> Array:
    """What the speeds of the joints do to the rate of a state, (n_joints,)."""
    speeds = [v for _, v in joints]
    return np.abs(local.A[:, state, speeds]).mean(axis=0) * np.sqrt((x[:, speeds] ** 2).mean(axis=0))


def _foremost(ties: Array) -> int | None:
    order = np.argsort(ties)[::-1]
    if not len(ties) or not ties[order[0]]:
        return None
    return int(order[0]) if len(ties) == 1 or ties[order[0]] >= MOSTLY * ties[order[1]] else None


def _motion(plant: NonlinearPlant, joint: int | None, x: Array, record: Record) -> Motion:
    if joint is None:
        return NO_MOTION
    q, v = _joints(plant)[joint]
    speed, unit = plant.states[v].name, plant.states[v].unit
    if q < 0:
        return Motion(x[:, v], None, unit, "", f"{speed} (smoothed)", "")
    name = plant.states[q].name
    if name in record.outputs:
        return Motion(x[:, v], record[name], unit, record.unit(name), f"{speed} (smoothed)", name)
    return Motion(x[:, v], x[:, q], unit, plant.states[q].unit, f"{speed} (smoothed)", f"{name} (smoothed)")


def without_a_joint(motions: Mapping[str, Motion]) -> list[str]:
    """The signals that belong to no one joint."""
    return [name for name, motion in motions.items() if motion.speed is None]


SHORTEST_RECORD = 40  # samples
CHECKED = 6  # windows that the nonlinear plant goes through, too
LINEAR_SHARE = 0.1  # of the error; a larger difference from the nonlinear plant is warned of
LEAST_NOISE = 1e-6  # of an output's range: a record without noise is not weighed by its rounding
DIVERGED = 10.0  # times the recorded range from the record: the free run says nothing beyond
SECTION = 100  # samples that the free run goes at once
RTOL = 1e-9
GROWN = 20.0  # times: an error of the start that grows more is warned of


def compare_along(
    plant: NonlinearPlant,
    record: Record,
    *,
    window: float | None,
    start: float | None,
    lags: int,
    speed: str | None,
    position: str | None,
    period: float | None,
    repeats: Sequence[Record],
) -> Comparison:
    """`robustlab.identification.comparison.comparison.compare` for a nonlinear plant."""
    response, outputs, record, noted, smoothed = _response(plant, record)
    names, inputs = [s.name for s in outputs], [s.name for s in plant.inputs]
    whole, x, u = response.whole, response.course.x, response.course.u
    length = window_length(plant, [record]) if window is None else samples_of("window", window, record)
    initial = start_along(response, length if start is None else samples_of("start", start, record))
    windows = windows_along(response, length)
    run, ran = _free_run(response, initial.x0, names)
    stated = motion_of(record, speed, position, length) if speed or position else None
    motions = motions_of_outputs(plant, x, u, record, response.columns)
    of_joints = motions_of_joints(plant, x, record)
    if stated is not None:
        motions, of_joints = dict.fromkeys(names, stated), [stated] * len(of_joints)
    size = {name: np.abs(v) for name, v in whole.u.items() if np.ptp(v)} if len(inputs) == 1 else {}
    found = localised(whole, outputs, ran if run.whole else None, windows, motions, size, min(lags, record.n // 4))
    others = [_response(plant, other) for other in repeats]
    noise, noise_reason = noise_of(record, tuple(taken for _, _, taken, *_ in others), names, period)
    rms = {name: (gap.rms, gap.windowed_rms) for name, gap in found["outputs"].items()}
    errors = []
    if noise:
        stretches = repeated(noise, whole, [other.whole for other, *_ in others])
        owners = [response, *(other for other, *_ in others)]
        owners = [response] * len(stretches) if noise.source == "periods" else owners
        errors = [_windowed_error(r, s, length) for r, s in zip(owners, stretches, strict=True)]
    linearisation = _linearisation(response, windows, names)
    noise_std = 1.0 / whole.weight
    compared = Comparison(
        status=Status.CONVERGED,
        model=title(plant),
        record=record.name,
        motions=motions,
        initial_state=initial,
        window=length * record.dt,
        measured=kept(record, inputs, names, whole.y, record.name),
        simulated=kept(record, inputs, names, ran, f"{record.name} (free run)") if len(ran) > 1 else None,
        windowed=kept(record, inputs, names, windows.y, f"{record.name} (windowed simulation)"),
        recursive={name: windows.residual[:, k] for k, name in enumerate(names)},
        disturbance=joint_disturbances(response, smoothed, whole.y - windows.y, windows.edges, of_joints),
        warnings=(
            *noted,
            *channel_warnings(record, tuple(inputs), tuple(names)),
            *_unseen(plant, initial.rank),
            *_nonlinear(linearisation),
            *_growing(response, run),
        ),
        noise=noise,
        noise_reason=noise_reason,
        against_noise=noise_gaps(names, np.stack(errors), noise, rms) if noise else {},
        linear={},
        linear_reason="a nonlinear plant has no one frequency response",
        nonlinearity=even_odd_test(record, inputs, names, noise),
        free_run=run,
        linearisation=linearisation,
        sensor_noise={name: float(std) for name, std in zip(names, noise_std, strict=True)},
        left_out=_left_out(run, motions, inputs),
        **found,
    )
    return replace(compared, pose=pose_of(plant, compared))


def pose_of(plant: NonlinearPlant, found: Comparison) -> dict[str, float]:
    """Of a machine with poses the one in the middle of the worst window; empty where none can be proved."""
    machine = getattr(plant, "plant", plant)  # beneath its effects
    angles = [s.name for s in machine.outputs[:6]]
    poses: Any = getattr(machine, "poses", None)
    if poses is None or not all(name in found.measured.outputs for name in angles):
        return {}
    k = int(np.argmin(np.abs(found.measured.t - 0.5 * (found.worst["start"] + found.worst["stop"]))))
    try:
        pose = poses(np.array([found.measured[name][k] for name in angles]))
    except NoTrustworthyNumber:  # the comparison does not rest on it
        return {}
    return dict(zip(POSE, pose.tolist(), strict=True))


# --- plant and record ------------------------------------------------------------------------------------------------


def _response(
    plant: NonlinearPlant, record: Record
) -> tuple[MotionResponse, tuple[Signal, ...], Record, tuple[str, ...], SmoothedRecord]:
    """The plant about the record's motion, the compared outputs, the record as it was taken, warnings, the motion."""
    outputs, warnings = matched(plant.inputs, plant.outputs, record)
    where = f"compare {record.name}"
    if record.n < SHORTEST_RECORD:
        raise InputError(where, f"{record.n} samples", f"at least {SHORTEST_RECORD}")
    if not record.is_uniform:
        level = uniform(record, clock_step(record.t))
        if level.gaps:
            gap = level.gaps[0]
            raise InputError(
                where,
                f"{gap.missing} samples missing from {gap.start:.9g} s to {gap.stop:.9g} s",
                "a clock without gaps",
                "compare the stretches between the gaps: record.between(start, stop)",
            )
        record = level.record
        warnings = (*warnings, f"the clock is not uniform: resampled in steps of {record.dt:.6g} s")
    record = with_units(record, (*plant.inputs, *outputs))
    names = [s.name for s in outputs]
    for name in names:
        if not np.ptp(record[name]):
            found = f"{name} stands at {record[name][0]:.6g} {record.unit(name)}".rstrip() + " throughout"
            raise InputError(where, found, "outputs that move: they tell where the plant is", "leave out a dead sensor")
    columns = tuple(k for k, s in enumerate(plant.outputs) if s.name in names)
    u = np.column_stack([record.inputs[s.name] for s in plant.inputs])
    whole = stretch_of(record, [s.name for s in plant.inputs], names)
    try:
        smoothed = smooth_motion(plant, record.t, u, whole.y, columns).smoothed
    except InputError as wrong:  # it speaks of naming
        raise InputError(where, wrong.found, wrong.expected, wrong.hint) from None
    noise = np.maximum(smoothed.noise_std, LEAST_NOISE / whole.weight)
    whole = Stretch(whole.t, whole.u, whole.y, 1.0 / noise)
    return MotionResponse(Course(plant, smoothed.x, u, record.dt), columns, whole), outputs, record, warnings, smoothed


# --- simulations of the nonlinear plant ------------------------------------------------------------------------------


def _free_run(response: MotionResponse, x0: Array, names: Sequence[str]) -> tuple[FreeRun, Array]:
    """The nonlinear plant from the start of the record, (m, n_y), as far as it goes."""
    t, y, plant = response.whole.t, response.whole.y, response.plant
    spread = np.ptp(y, axis=0)
    limit = np.where(spread > 0, DIVERGED * spread, np.inf)
    u, states, reason = response.course.u, x0[None], ""
    while len(states) < len(t) and not reason:
        first = len(states) - 1
        more, reason = _onward(plant, t, u, states[-1], first, min(first + SECTION, len(t) - 1))
        states = np.vstack([states, more])
        made = plant.outputs_along(states[first:], u[first : len(states)])[:, list(response.columns)]
        beyond = np.abs(made - y[first : len(states)]) > limit
        if beyond.any():
            k = int(beyond.any(axis=1).argmax())
            worst = names[int(beyond[k].argmax())]
            reason = f"{worst} is {DIVERGED:g} times its recorded range off"
            states = states[: first + max(k, 1)]
    made = plant.outputs_along(states, u[: len(states)])[:, list(response.columns)]
    return FreeRun(float(t[len(states) - 1]), reason), made


def _onward(plant: NonlinearPlant, t: Array, u: Array, x: Array, first: int, last: int) -> tuple[Array, str]:
    """States after sample ``first`` up to ``last``, or as far as the plant goes and why no further."""

    def run(x: Array, a: int, b: int) -> Array:
        middle = np.concatenate([t[a:b], [0.5 * (t[b - 1] + t[b]), t[b]]])  # three times at least
        held = np.vstack([u[a:b], u[b - 1 : b], u[b : b + 1]])
        found = np.delete(plant.trajectory(input_signal(middle, held, "zoh"), x, RTOL), -2, axis=0)[1:]
        if not np.isfinite(found).all():
            raise NoTrustworthyNumber(plant.name, "the free run overflows")
        return found

    try:
        return run(x, first, last), ""
    except NoTrustworthyNumber:
        pass  # where in it, and why, is found sample by sample
    states: list[Array] = []
    for k in range(first, last):
        try:
            states.append(run(states[-1] if states else x, k, k + 1)[0])
        except NoTrustworthyNumber as end:
            return np.array(states).reshape(len(states), len(x)), end.found
    return np.array(states), ""


def _linearisation(response: MotionResponse, windows: WindowedSimulation, names: Sequence[str]) -> Linearisation:
    """Some windows and the worst one, by the nonlinear plant from the fitted starts."""
    whole, plant, edges = response.whole, response.plant, windows.edges
    error = ((whole.y - windows.y) * whole.weight) ** 2
    worst = int((np.add.reduceat(error.sum(axis=1), edges[:-1]) / np.diff(edges)).argmax())
    chosen = np.unique([worst, *np.linspace(0, len(edges) - 2, CHECKED).astype(int)])
    different, missed, checked, broken = [], [], [], []
    for k in chosen:
        a, b = int(edges[k]), int(edges[k + 1])
        more, reason = _onward(plant, whole.t, response.course.u, windows.x0[k], a, b - 1)
        if reason:
            broken.append(whole.t[a])
            continue
        states = np.vstack([windows.x0[k], more])
        made = plant.outputs_along(states, response.course.u[a:b])[:, list(response.columns)]
        different.append(made - windows.y[a:b])
        missed.append(whole.y[a:b] - windows.y[a:b])
        checked.append(whole.t[a])
    if not checked:
        return Linearisation(np.zeros(0), {}, {}, np.array(broken))
    rms, error_rms = (np.sqrt((np.vstack(x) ** 2).mean(axis=0)) for x in (different, missed))
    share = np.divide(rms, error_rms, out=np.zeros_like(rms), where=error_rms > 0)
    return Linearisation(
        np.array(checked),
        dict(zip(names, rms.tolist(), strict=True)),
        dict(zip(names, share.tolist(), strict=True)),
        np.array(broken),
    )


# --- windows ----------------------------------------------------------------------------------------------------------


def _windowed_error(response: MotionResponse, part: Stretch, length: int) -> Array:
    """Measured minus windowed simulation of a stretch of the response's record, (samples, n_y)."""
    first = int(np.searchsorted(response.whole.t, part.t[0]))
    edges = first + window_edges(len(part.t), length)
    error = np.empty_like(part.y)
    for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        windows = next(response.responses([a], b - a))
        left = fit_windows(windows, response.errors(windows), part.weight).left
        error[a - first : b - first] = left.reshape(b - a, -1) / part.weight
    return error


# --- words -----------------------------------------------------------------------------------------------------------


def _unseen(plant: NonlinearPlant, rank: int) -> list[str]:
    if rank == len(plant.states):
        return []
    seen = f"the recorded outputs determine {rank} of {len(plant.states)} states at the start"
    return [f"{seen}; the rest was taken from the motion"]


def _growing(response: MotionResponse, run: FreeRun) -> list[str]:
    """A word where the free run is whole, and yet shows the error of its start rather than the plant's."""
    course, t = response.course, response.whole.t
    at = np.unique(np.linspace(0, len(t) - 1, POINTS).astype(int))
    rates = np.linalg.eigvals(response.plant.local_models(course.x[at], course.u[at]).A).real.max(axis=1)
    growth = float(np.maximum(rates, 0.0).mean() * (t[-1] - t[0]))
    if not run.whole or growth < np.log(GROWN):
        return []
    told = f"an error of its start grows about {np.exp(min(growth, 700.0)):.2g} times over the free run"
    return [f"the plant is unstable along the record: {told}, so the windows tell more"]


def _nonlinear(found: Linearisation) -> list[str]:
    told = []
    large = {name: share for name, share in found.share.items() if share > LINEAR_SHARE}
    if large:
        worst = max(large, key=lambda name: large[name])
        told.append(
            f"the windows are linear about the recorded motion, and that makes {100 * large[worst]:.0f} % of the error "
            f"of {worst}: take shorter windows"
        )
    if len(found.broken):
        told.append(
            f"from the fitted start the nonlinear plant does not reach the end of the window at {found.broken[0]:.4g} s"
        )
    return told


def _left_out(run: FreeRun, motions: dict[str, Motion], inputs: Sequence[str]) -> tuple[str, ...]:
    told = ["frequency response: a nonlinear plant has no one"]
    if not run.whole:
        told.append("places in frequency: they are told of the free run")
    if len(inputs) > 1:
        told.append("error over the size of an input: it is told of a plant with one input")
    if loose := without_a_joint(motions):
        told.append(f"speed, direction and position of {', '.join(loose)}: no one joint is behind it")
    return tuple(told)
