"""`compare`: errors of a plant or model against a record, in free run and in windows.

A nonlinear plant is linear about the measured motion, and nonlinear in free run; simulated from the same initial states
it measures the linearisation error. Errors are sorted along the motion of the joint that each output belongs to.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import one_thread
from robustlab.display import Each, Facts, listed, number
from robustlab.dynamics.plant_base import LocalModels, NonlinearPlant, SteppedPlant, input_signal
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.identification.comparison.error_analysis import (
    Bin,
    FreeRun,
    InputDisturbance,
    Linearisation,
    Motion,
    OutputGap,
    ResidualTests,
    Spectrum,
    WindowErrors,
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
    InitialState,
    LinearResponse,
    MotionResponse,
    WindowedSimulation,
    matched,
    response_of,
    slowest_time_constant,
    starting_state,
    stretch_of,
    window_edges,
    windowed_simulation,
    with_units,
)
from robustlab.record import Record
from robustlab.result import Evidence, Status, Table, Tabular
from robustlab.statespace import Signal

# Fields that become JSON in another form, or not at all.
NOT_AS_IT_IS = ("measured", "simulated", "windowed", "noise_reason", "against_noise")
EXPLAINS = 0.5  # share of the squared error that a located disturbance removes at least
TIE = 2.0  # times the best: squared error that remains with another place that is as good
ROUNDING = 1e-9  # a residual below this share of the range is rounding and is not tested


@dataclass(frozen=True)
class Comparison(Tabular, Evidence):
    """Result of `compare`; mappings are by the name of the output unless stated otherwise."""

    status: Status  # CONVERGED: both simulations are finite and every number follows from the series kept here
    model: str
    record: str
    outputs: Mapping[str, OutputGap]
    windows: Mapping[str, WindowErrors]
    # bins of the windowed error over the measured speed and position; empty where neither is recorded
    speed: Mapping[str, tuple[Bin, ...]]
    position: Mapping[str, tuple[Bin, ...]]
    motions: Mapping[str, Motion]  # signals used for that: one for all, or one per joint
    frequency: Mapping[str, Spectrum]  # empty where the free run does not reach the end of the record
    residual: Mapping[str, ResidualTests]
    initial_state: InitialState  # of the free run
    window: float  # length of the windows, s
    # the compared signals: measured, free run (None if it ends at once), windowed simulation
    measured: Record
    simulated: Record | None
    windowed: Record
    # input, or a joint as ``torque at omega`` -> the single disturbance there with which the model reproduces the
    # record best; joints only for a nonlinear plant; empty for a discrete model and a nonuniform time base
    disturbance: Mapping[str, InputDisturbance]
    warnings: tuple[str, ...]  # limits of the numbers
    direction: Mapping[str, Mapping[str, Bin]]  # windowed error moving backward, at standstill, moving forward
    noise: NoiseFloor | None  # None where the record does not repeat, with the reason
    noise_reason: str
    # Of the windowed error, with windows at the same phases of every period. Its ``noise`` is larger than the sensor's
    # in closed loop, where noise also enters at the input. Empty without a noise floor.
    against_noise: Mapping[str, Excess]
    free_run: FreeRun
    # for a nonlinear plant: linearisation error of the windows, and standard deviation of the samples about the
    # smoothed motion
    linearisation: Linearisation | None = None
    sensor_noise: Mapping[str, float] = field(default_factory=dict)

    quantities: ClassVar[Mapping[str, Any]] = {
        **dict.fromkeys(("model", "record"), str),
        "outputs": Each("outputs", OutputGap),
        "windows": Each("outputs", WindowErrors),
        "worst_window": Each("outputs", ("s", "s")),
        "worst": {"output": str, "start": "s", "stop": "s"},
        "residual": Each("outputs", ResidualTests),
        "direction": Each("outputs", {"*": Bin}),
        "disturbance": Each("inputs", InputDisturbance, ("torque at *", "force at *")),
        "initial_state": InitialState,
        "free_run": FreeRun,
        "linearisation": Linearisation,
        "sensor_noise": Each("outputs", "*"),
        "window": "s",
        "warnings": [str],
        **dict.fromkeys(("speed", "position", "frequency", "noise"), ...),
    }

    @property
    def worst_window(self) -> dict[str, tuple[float, float]]:
        """Return output name -> first and last time in s of the window with its largest error."""
        return {name: (float(w.start[w.worst]), float(w.stop[w.worst])) for name, w in self.windows.items()}

    @property
    def worst(self) -> dict[str, Any]:
        """Return the output with the largest windowed error over its range, its and its worst window in s."""
        name = max(self.outputs.values(), key=lambda gap: gap.windowed_rms_percent).name
        start, stop = self.worst_window[name]
        return {"output": name, "start": start, "stop": stop}

    @property
    def located(self) -> tuple[InputDisturbance, ...]:
        """Return the best disturbances that explain half of the error, and equally good ones; inputs first."""
        found = self.disturbance.values()
        left = min((1.0 - d.explained_share for d in found), default=1.0)
        good = [d for d in found if d.explained_share >= EXPLAINS and 1.0 - d.explained_share <= TIE * left]
        return tuple(sorted(good, key=lambda d: (not d.place.startswith("input "), -d.explained_share)))

    def headline(self) -> str:
        """Report the output with the largest error, in free run where that is complete, else in windows."""
        free, gaps = self.free_run, self.outputs.values()
        most = max(gaps, key=lambda gap: gap.rms_percent if free.whole else gap.windowed_rms_percent)
        if free.whole:
            size, how, when = most.rms_percent, "in free run", f"most at {number(most.peak_time, 's', 3)}"
        else:
            size, how = most.windowed_rms_percent, f"in windows of {number(self.window, 's', 3)}"
            when = f"the free run ends at {number(free.end, 's', 3)}"
        return f"against {self.record}: {how} {most.name} is off by {size:.3g} % of its range (rms); {when}"

    def facts(self) -> Facts:
        gaps = [(f"{name}: in windows", _errors(g, "windowed_")) for name, g in self.outputs.items()]
        end = "" if self.free_run.whole else f"ends at {number(self.free_run.end, 's')}: {self.free_run.reason}"
        return [
            ("model", self.model),
            ("record", f"{self.record}: {self.measured.n} samples, {number(self.measured.duration, 's')}"),
            *gaps,
            ("windows", f"of {number(self.window, 's')}, each with fitted initial states"),
            ("free run", end),
            ("windows linear about the motion", self._linear_in_words()),
            *(fact for name in self.outputs for fact in self._more(name)),
            ("worst of all", "{output}, {start:.3g} to {stop:.3g} s".format(**self.worst)),
            *self._missing(),
            ("noise floor", self._floor_in_words()),
            *(("warning", text) for text in self.warnings),
        ]

    def _more(self, name: str) -> Facts:
        g, motion = self.outputs[name], self.motions[name]
        free = _errors(g, "") if self.free_run.whole else ""
        places = ["{:.3g} to {:.3g} s".format(*self.worst_window[name])]
        for found, unit, over in (
            (self.speed, motion.speed_unit, "speed"),
            (self.position, motion.position_unit, "position"),
        ):
            if name in found:
                worst = max(found[name], key=lambda b: b.rms)
                places.append(f"{worst.low:.3g} to {worst.high:.3g} {unit} of {over}")
        return [
            (f"{name}: free run", free),
            (f"{name}: where", f"windowed error largest at {'; at '.join(places)}"),
            (f"{name}: noise", self._noise_in_words(name)),
            (f"{name}: residual", self._residual_in_words(name)),
        ]

    def _noise_in_words(self, name: str) -> str:
        """Report the windowed error in multiples of the noise: of the repeats, else of the sensor's scatter."""
        g, e = self.outputs[name], self.against_noise.get(name)
        std = self.noise.std[name] if self.noise else self.sensor_noise.get(name)
        if e is not None and (not std or e.F is None or e.p_value is None):
            return "none: the repeats are equal to the last bit"
        size = f"{number(std, g.unit, 3)}; the windowed error is {g.windowed_rms / std:.3g} times that" if std else ""
        if e is None:
            return size
        assert e.p_value is not None
        verdict = "the model leaves something to explain" if e.p_value < 0.01 else "nothing is left to explain"
        return f"{size}; {verdict} (F {e.F:.4g}, p {_p(e.p_value)})"

    def _residual_in_words(self, name: str) -> str:
        r, unit = self.residual[name], self.outputs[name].unit
        if r.rms <= ROUNDING * self.outputs[name].range:
            return f"zero to rounding (rms {number(r.rms, unit, 1)})"
        left = sorted((u for u, test in r.inputs.items() if test.p_value < 0.01), key=lambda u: r.inputs[u].p_value)
        white = "white" if r.whiteness.p_value >= 0.01 else "not white"
        share = f"{100 * r.whiteness.explained_share:.1f} % of its variance is predictable from its past"
        rest = f"correlated with {listed(left)}" if left else "not correlated with the inputs"
        return f"{white} (p {_p(r.whiteness.p_value)}), {share}; {rest}"

    def _linear_in_words(self) -> str:
        found = self.linearisation
        if found is None or not len(found.windows):
            return ""
        name = max(found.share, key=lambda key: found.share[key])
        size = number(found.difference[name], self.outputs[name].unit, 2)
        return f"within {100 * found.share[name]:.2g} % of the error ({name}, {size}) in {len(found.windows)} windows"

    def _floor_in_words(self) -> str:
        n = self.noise
        if n is None:
            return f"none ({self.noise_reason})"
        spread = ", ".join(number(v, self.measured.units.get(u, ""), 3) + f" at {u}" for u, v in n.input_std.items())
        fed_back = [f"fed back by a controller: {spread}"] if spread else []
        return "; ".join([f"from {n.count} periods of {n.period:.6g} s ({n.signal})", *fed_back, *n.notes])

    def _missing(self) -> Facts:
        if not self.disturbance:
            return []
        if not self.located:
            best = max(self.disturbance.values(), key=lambda d: d.explained_share)
            text = f"no disturbance at one place explains half of the error (best {best.place}, "
            return [("missing", f"{text}{100 * best.explained_share:.0f} %)")]
        found: Facts = []
        for d in self.located:
            means = [f"{mean:+.3g} +- {number(std, d.unit, 2)} {way}" for way, (mean, std) in d.sure_means.items()]
            size = f"rms {number(d.rms, d.unit, 3)}; {', '.join(means) or 'no mean that differs from zero'}"
            share = f"{100 * d.explained_share:.0f} % of the squared error explained"
            found.append((f"missing: {d.place}", f"{size}; {share}"))
        return found

    def numbers(self) -> dict[str, Any]:
        """Return all but the time series, and the `worst`."""
        return {**self.to_json(series=False), "worst": self.worst}

    def table(self) -> Table:
        """Return a row for each output: sizes of its error in its unit."""
        names = ("range", "rms", "peak", "fit", "windowed_rms", "windowed_peak", "windowed_fit", "unit")
        columns = {key: [getattr(gap, key) for gap in self.outputs.values()] for key in names}
        return Table(("output", list(self.outputs)), columns, {"fit": "%", "windowed_fit": "%"})

    def to_json(self, series: bool = True) -> dict[str, object]:
        """Return all fields; without ``series`` no time series and no densities over frequency."""
        bands = {name: {"bands": f.bands, "error_share": f.error_share} for name, f in self.frequency.items()}
        data: dict[str, object] = {
            **{key: value for key, value in vars(self).items() if key not in NOT_AS_IT_IS},
            "worst_window": self.worst_window,
            "motions": {name: m.named() for name, m in self.motions.items()},
            "frequency": self.frequency if series else bands,
            "noise": {"floor": self.noise, "reason": self.noise_reason, "outputs": self.against_noise},
        }
        if series:
            data |= {
                "t": self.measured.t,
                "input": self.measured.inputs,
                "measured": self.measured.outputs,
                "simulated": self.simulated.outputs if self.simulated else {},
                "windowed": self.windowed.outputs,
            }
        return data


def _errors(gap: OutputGap, of: str) -> str:
    peak, peak_percent, rms, rms_percent, fit = (
        float(getattr(gap, of + key)) for key in ("peak", "peak_percent", "rms", "rms_percent", "fit")
    )
    peak_text = f"peak {number(peak, gap.unit, 3)} ({peak_percent:.3g} % of the range)"
    return f"{peak_text}, rms {number(rms, gap.unit, 3)} ({rms_percent:.3g} %), fit {fit:.4g} %"


def _p(p_value: float) -> str:
    return f"{p_value:.2g}" if p_value > 1e-6 else "< 1e-6"


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
def compare(plant: Any, record: Record, *, window: float | None = None) -> Comparison:
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
    n_x = len(model.state_names)
    if initial.rank < n_x:
        along = isinstance(model, MotionResponse)
        rest = "the others are those of the smoothed motion" if along else "the others are the smallest that fit"
        texts.append(f"the recorded outputs determine {initial.rank} of {n_x} states at the start; {rest}")
    if isinstance(model, MotionResponse):
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
        found = f"{dead[0]} is {record[dead[0]][0]:.6g} {record.unit(dead[0])}".rstrip() + " throughout"
        raise InputError(where, found, "outputs that move", "remove a dead sensor from the record")
    try:
        model, smoothed = along_motion(plant, stretch_of(record, inputs, names), names)
    except InputError as wrong:  # its message refers to effect identification
        raise InputError(where, wrong.found, wrong.expected, wrong.hint) from None
    return Matching(model, record, inputs, outputs, warnings, smoothed)


# --- the motion of joints ---------------------------------------------------------------------------------------------


def motions_of_outputs(model: MotionResponse, record: Record) -> dict[str, Motion]:
    """Return output name -> motion of its joint, or `NO_MOTION` for an output without a unique joint."""
    # An output that measures no position or speed (a current) belongs to the joint whose speed acts on it most.
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
