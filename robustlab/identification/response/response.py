r"""A linear model and a record matched by names and units, and the responses, whole or in windows.

Each window starts from its own least-squares initial state. The recursive residual predicts each sample from the state
fitted to those before it in its window; for a right model it is white with the variance of the noise (Brown, Durbin,
Evans 1975).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array, Indices
from robustlab.dynamics.plant_base import NonlinearPlant
from robustlab.dynamics.ports.port_model import Course, exponentials, motion_model
from robustlab.errors import InputError, NoTrustworthyNumber, UnitMismatch, did_you_mean
from robustlab.record import Record
from robustlab.result import Evidence
from robustlab.statespace import Signal, StateSpaceModel, as_model
from robustlab.time_base import is_uniform
from robustlab.units import factor_between, same_unit

# A pole slower than this share of the fastest one counts as an integrator.
INTEGRATOR = 1e-9


@dataclass(frozen=True)
class Stretch:
    """A stretch of a record at the compared signals."""

    t: Array  # time in s, shape (n,)
    u: Mapping[str, Array]  # input name -> samples (n,)
    y: Array  # measured outputs, shape (n, n_y)
    # factor of each output's error in least squares, shape (n_y,): one over the measured range of the whole record
    weight: Array

    @property
    def is_uniform(self) -> bool:
        return is_uniform(self.t)

    def cut(self, first: int, last: int) -> Stretch:
        """Return samples ``first .. last - 1``."""
        part = slice(first, last)
        return Stretch(self.t[part], {name: v[part] for name, v in self.u.items()}, self.y[part], self.weight)


@dataclass(frozen=True)
class Response:
    """Response of one linear model at the recorded outputs."""

    model: StateSpaceModel  # only its recorded outputs are compared
    outputs: tuple[Signal, ...]  # the compared outputs, with their unit as recorded or else as in the model
    warnings: tuple[str, ...]  # from matching model and record

    @property
    def n_states(self) -> int:
        return self.model.n_states

    @property
    def output_names(self) -> tuple[str, ...]:
        return tuple(s.name for s in self.outputs)

    def with_units(self, record: Record) -> Record:
        return with_units(record, (*self.model.inputs, *self.outputs))

    def stretch(self, record: Record) -> Stretch:
        return stretch_of(record, self.model.input_names, self.output_names)

    def simulate(self, t: Array, u: Mapping[str, Array], x0: Array) -> Array:
        """Simulate outputs (n, n_y), as measured, for held inputs ``u`` from the deviation ``x0`` (n_x,)."""
        point = self.model.operating_point
        if point is None:
            return self._run(t, u, x0)
        offset = dict(zip(self.model.output_names, point.y, strict=True))
        deviation = {name: u[name] - at for name, at in zip(self.model.input_names, point.u, strict=True)}
        return self._run(t, deviation, x0) + np.array([offset[name] for name in self.output_names])

    def free_response(self, t: Array) -> Array:
        """Compute ``C e^{A (t - t_0)}``: response to a unit of each initial state without input, (n, n_y, n_x)."""
        zero = {name: np.zeros(len(t)) for name in self.model.input_names}
        columns = [self._run(t, zero, unit) for unit in np.eye(self.n_states)]
        return np.stack(columns, axis=2) if columns else np.zeros((len(t), len(self.outputs), 0))

    def _run(self, t: Array, u: Mapping[str, Array], x0: Array) -> Array:
        from robustlab.dynamics import simulate

        # A discrete model counts samples; a recorded time base has rounding and jitter.
        clock = self.model.dt * np.arange(len(t)) if self.model.is_discrete else t
        record = simulate(self.model, clock, dict(u), x0)
        return np.column_stack([record.outputs[name] for name in self.output_names])


def rates(model: StateSpaceModel) -> NDArray[np.complex128]:
    """Return the poles in 1/s, also of a discrete model."""
    poles: Any = model.poles()
    return np.log(poles[np.abs(poles) > 0]) / model.dt if model.is_discrete else poles


def longest_period(model: StateSpaceModel) -> float:
    """Return the period in s of the slowest oscillation, 0 without one: poles damped beyond 1/sqrt(2) are none.

    Examples
    --------
    >>> from robustlab.dynamics import plant
    >>> round(longest_period(plant("mass-spring-damper", m=1.0, c=0.1, k=4.0).state_space()), 3)
    3.143
    """
    poles = rates(model)
    omega = np.abs(poles.imag[np.abs(poles.imag) > np.abs(poles.real)])
    # Rounding moves a double integrator's poles by the root of its size.
    omega = omega[omega > math.sqrt(INTEGRATOR) * max(np.abs(poles).max(initial=0.0), 1e-300)]
    return float(2 * np.pi / omega.min()) if len(omega) else 0.0


def slowest_time_constant(model: StateSpaceModel) -> float:
    """Return the slowest time constant in s over the poles that are no integrators; 0 without any."""
    poles = rates(model)
    rate = np.abs(poles.real)
    rate = rate[rate > INTEGRATOR * max(np.abs(poles).max(initial=0.0), 1e-300)]
    return float(1.0 / rate.min()) if len(rate) else 0.0


def response_of(plant_or_model: Any, record: Record) -> Response:
    """Match a linear plant or model with a record by signal names, and check units and sample time."""
    where = f"compare {record.name}"
    if isinstance(plant_or_model, NonlinearPlant):  # its linear model would be compared silently, without its effects
        hint = "discover compares a plant with effects; rl.simulate simulates it"
        raise InputError(where, f"the nonlinear plant {plant_or_model.name}", "a linear plant or model", hint)
    model = as_model(plant_or_model, "compare")
    outputs, warnings = matched(model.inputs, model.outputs, record)
    if model.is_discrete and abs(model.dt - record.dt) > 1e-3 * record.dt:
        found = f"the model has dt = {model.dt:g} s, the record {record.dt:g} s"
        raise InputError(where, found, "equal sample times", "use the continuous model")
    return Response(model, outputs, warnings)


def matched(
    inputs: Sequence[Signal], outputs: Sequence[Signal], record: Record
) -> tuple[tuple[Signal, ...], tuple[str, ...]]:
    """Return the outputs common to a record and a model, with units as recorded or in the model, and warnings."""
    where = f"compare {record.name}"
    own_inputs, own_outputs = (", ".join(side) or "none" for side in (record.inputs, record.outputs))
    for name in (s.name for s in inputs if s.name not in record.inputs):
        hint = did_you_mean(name, list(record.inputs))
        if name in record.outputs:
            hint = f"{name} is stored as an output: read the record with {name} among its inputs"
        found = f"the record has no input {name!r} (its inputs: {own_inputs})"
        raise InputError(where, found, "every input of the model", hint)
    compared = tuple(s for s in outputs if s.name in record.outputs)
    if not compared:
        known = ", ".join(s.name for s in outputs)
        found = f"no output in common (record: {own_outputs}; model: {known})"
        raise InputError(where, found, "at least one common output")
    warnings = _check_units(where, (*inputs, *compared), record)
    factors = _conversions(record, compared)
    shared = (Signal(s.name, s.unit if s.name in factors else record.unit(s.name) or s.unit) for s in compared)
    return tuple(shared), tuple(warnings)


def with_units(record: Record, signals: Sequence[Signal]) -> Record:
    """Convert a record to the units of the signals, where it states none or another one of the same measure."""
    signals = [s for s in signals if s.name in record.inputs or s.name in record.outputs]
    units = {name: unit for name, unit in signals if not record.unit(name)}
    factors = _conversions(record, signals)
    units |= {name: unit for name, unit in signals if name in factors}
    inputs, outputs = (
        {name: values * factors[name] if name in factors else values for name, values in side.items()}
        for side in (record.inputs, record.outputs)
    )
    return replace(record, inputs=inputs, outputs=outputs, units={**record.units, **units})


def converted(record: Record, signals: Sequence[Signal]) -> dict[str, str]:
    """Return signal -> conversion by `with_units`, in words."""
    factors, units = _conversions(record, signals), dict(signals)
    text = "recorded in {}, converted to {} (times {:.6g})"
    return {name: text.format(record.unit(name), units[name], factor) for name, factor in factors.items()}


def _conversions(record: Record, signals: Sequence[Signal]) -> dict[str, float]:
    """Return signal -> factor, where the record states another unit of the same measure."""
    found: dict[str, float] = {}
    for name, unit in signals:
        stated = record.units.get(name, "")
        factor = factor_between(stated, unit) if stated and unit and not same_unit(stated, unit) else None
        if factor is not None:
            found[name] = factor
    return found


def stretch_of(record: Record, inputs: Sequence[str], outputs: Sequence[str]) -> Stretch:
    """Select signals of a whole record; errors are weighted by the ranges of the outputs."""
    y = np.column_stack([record.outputs[name] for name in outputs])
    spread = np.ptp(y, axis=0)
    return Stretch(record.t, {name: record.inputs[name] for name in inputs}, y, 1.0 / np.where(spread > 0, spread, 1.0))


def _check_units(where: str, model_signals: tuple[Signal, ...], record: Record) -> list[str]:
    warnings, conversions = list[str](), converted(record, model_signals)
    for name, unit in model_signals:
        measured = record.unit(name)
        if name in conversions:
            warnings.append(f"{name}: {conversions[name]}")
        elif unit and measured and not same_unit(unit, measured):
            expected, hint = f"{unit} as in the model", "convert the record, or correct its unit"
            raise UnitMismatch(f"{where}: {name}", f"recorded in {measured}", expected, hint)
        if not measured and not unit:
            warnings.append(f"{name}: neither the record nor the model states a unit; taken as equal")
        elif not measured or not unit:
            silent = "model" if measured else "record"
            warnings.append(f"{name}: the {silent} does not state a unit; taken as {measured or unit}")
    return warnings


SHORTEST_START = 20  # samples
STEPS = 2  # per sample: a motion's curvature within a sample is then far below the deviations from it
AT_ONCE = 4_000_000  # numbers in the responses of a batch of windows: bounds the memory
# Singular values of the column-scaled sensitivity below this share of the largest are not observed.
RANK_TOLERANCE = 1e-10
# Entries of the free response below this share of its largest column carry no information on the state.
NO_INFORMATION = 1e-10


@dataclass(frozen=True, eq=False)
class WindowResponses:
    """Responses in windows of one length that start at the samples ``starts`` (n_windows,)."""

    starts: Indices
    y: Array  # outputs from ``x0``, (n_windows, length, n_y)
    x0: Array  # states at the starts, (n_windows, n_x)
    free: Array  # outputs per unit more of each state at the start, (n_windows, length, n_y, n_x)
    pushed: Array  # outputs by each of the added forces alone, (n_windows, length, n_y, n_forces)

    @property
    def samples(self) -> Indices:
        """Index of each sample in the record, (n_windows, length)."""
        return self.starts[:, None] + np.arange(self.y.shape[1])


@dataclass(frozen=True, eq=False)
class LinearResponse:
    """A linear model matched with one record; its weight is one over the range of each output."""

    response: Response
    whole: Stretch
    # rate of the states per unit of each added force, (n_x, n_forces)
    pushes: Array = field(default_factory=lambda: np.zeros((0, 0)))
    together: ClassVar[bool] = False  # True if the weight is that of the noise: all outputs predict one's residual

    @property
    def state_names(self) -> tuple[str, ...]:
        return self.response.model.state_names

    def responses(
        self, starts: Sequence[int] | Indices, length: int, added: Array | None = None
    ) -> Iterator[WindowResponses]:
        """Simulate windows of ``length`` samples in batches; ``added``: the forces of ``pushes``, (n, n_forces)."""
        whole, response, n_x = self.whole, self.response, self.response.n_states
        # The free response is the same in all windows of a uniform time base.
        shared = response.free_response(whole.t[:length]) if whole.is_uniform else None
        count = max(1, AT_ONCE // (length * whole.y.shape[1] * (1 + n_x)))
        for k in range(0, len(starts), count):
            chosen = np.asarray(starts[k : k + count], dtype=np.int64)
            parts = [whole.cut(int(a), int(a) + length) for a in chosen]
            y = np.stack([response.simulate(part.t, part.u, np.zeros(n_x)) for part in parts])
            free = np.stack([response.free_response(part.t) if shared is None else shared for part in parts])
            pushed = np.zeros((*y.shape, 0))
            if added is not None:
                pushed = np.stack(
                    [self._pushed(p.t, added[a : a + length]) for a, p in zip(chosen, parts, strict=True)]
                )
            yield WindowResponses(chosen, y, np.zeros((len(chosen), n_x)), free, pushed)

    def _pushed(self, t: Array, forces: Array) -> Array:
        """Simulate the response to each force alone, (n, n_y, n_forces)."""
        model, found = self.response.model.select(outputs=self.response.output_names), []
        for push, d in zip(self.pushes.T, forces.T, strict=True):
            through = np.zeros((model.n_outputs, 1))
            alone = StateSpaceModel(model.A, push[:, None], model.C, through, 0.0, ["d"], model.outputs)
            found.append(Response(alone, self.response.outputs, ()).simulate(t, {"d": d}, np.zeros(model.n_states)))
        return np.stack(found, axis=2)


@dataclass(frozen=True, eq=False)
class MotionResponse:
    """A nonlinear plant about the motion of one record."""

    course: Course  # the motion
    columns: tuple[int, ...]  # index of each compared output among the plant's
    whole: Stretch  # the compared signals; its weight is one over the noise of each sensor

    together: ClassVar[bool] = True

    @property
    def plant(self) -> NonlinearPlant:
        return self.course.plant

    @property
    def state_names(self) -> tuple[str, ...]:
        return tuple(s.name for s in self.plant.states)

    def responses(
        self, starts: Sequence[int] | Indices, length: int, added: Array | None = None
    ) -> Iterator[WindowResponses]:
        """Simulate windows in batches; ``added``: forces at the joints, or at the inputs without any, (n, n_forces)."""
        n_x, n_d = len(self.plant.states), 0 if added is None else added.shape[1]
        size = length * (len(self.columns) * (1 + n_x + n_d) + STEPS * n_x * (2 * n_x + n_d))
        count = max(1, AT_ONCE // size)
        for k in range(0, len(starts), count):
            yield self._responses(np.asarray(starts[k : k + count], dtype=np.int64), length, added)

    def _responses(self, starts: Indices, length: int, added: Array | None) -> WindowResponses:
        dt, n_x, n_u = self.course.dt, len(self.plant.states), self.course.u.shape[1]
        added = np.zeros((len(self.course.u), 0)) if added is None else added
        n_d = added.shape[1]
        about = motion_model(self.course, {}, starts, length, STEPS)
        phi, psi, _ = exponentials(np.ascontiguousarray(about.model.A), dt / STEPS)
        b, columns = about.model.B[..., :n_u], list(self.columns)
        joints = [p.force for p in about.model.ports.values() if p.kind == "joint"]
        driven, forced = psi @ b, psi @ (np.stack(joints, axis=-1) if joints else b)[..., :n_d]
        steps = about.steps.reshape(len(starts), -1)
        rates = about.rates.reshape(*steps.shape, n_x)
        points = about.points.reshape(len(starts), -1)
        c, d = about.model.C[:, columns], about.model.D[:, columns]
        offsets = about.offsets[:, columns].reshape(len(starts), length, len(columns))
        found = np.empty((len(starts), length, len(columns), 1 + n_x + n_d))
        # Columns: the window itself, a unit of each state at the start, each force.
        x = np.zeros((len(starts), n_x, 1 + n_x + n_d))
        x[:, :, 0], x[:, :, 1 : 1 + n_x] = self.course.x[starts], np.eye(n_x)
        for k in range(length):
            u, force = self.course.u[starts + k], added[starts + k]
            at = points[:, k]
            found[:, k] = c[at] @ x
            found[:, k, :, 0] += offsets[:, k] + (d[at] @ u[..., None])[..., 0]
            for step in range(k * STEPS, (k + 1) * STEPS):
                own = steps[:, step]
                x = phi[own] @ x
                x[:, :, 0] += (driven[own] @ u[..., None] + psi[own] @ rates[:, step, :, None])[..., 0]
                x[:, :, 1 + n_x :] += forced[own] * force[:, None]
        if not np.isfinite(found).all():
            name = self.plant.name
            raise NoTrustworthyNumber(f"compare {name}", "a window's simulation overflows", None, "shorter windows")
        return WindowResponses(
            starts, found[..., 0], self.course.x[starts], found[..., 1 : 1 + n_x], found[..., 1 + n_x :]
        )


Windowed = LinearResponse | MotionResponse


@dataclass(frozen=True)
class InitialState(Evidence):
    """Initial state of the free run."""

    x0: Array  # (n_x,)
    std: Array  # its standard deviation
    names: tuple[str, ...]  # of the states
    samples: int  # length of the fitted stretch
    seconds: float
    rank: int  # number of state directions that the recorded outputs determine, at most n_x

    def to_json(self) -> dict[str, object]:
        return {"states" if key == "names" else key: value for key, value in vars(self).items()}


def starting_state(model: Windowed, longest: int) -> InitialState:
    """Estimate the state at the start of a record from the longest opening stretch with a consistent estimate."""
    # A short stretch suffers from noise, a long one from model errors. It is doubled while the 3-sigma intervals of all
    # estimates so far have a common point.
    t, names = model.whole.t, model.state_names
    longest = min(longest, len(t))
    n = min(len(t), max(SHORTEST_START, 4 * len(names) // model.whole.y.shape[1]))
    low, high = np.full(len(names), -np.inf), np.full(len(names), np.inf)
    best: InitialState | None = None
    while True:
        windows = next(iter(model.responses([0], n)))
        fit = fit_windows(model, windows)
        x0, std = fit.x0[0], fit.std[0]
        low, high = np.maximum(low, x0 - 3.0 * std), np.minimum(high, x0 + 3.0 * std)
        if best is not None and (low > high).any():
            return best
        best = InitialState(x0, std, names, n, float(t[n - 1] - t[0]), int(fit.rank[0]))
        if 2 * n > longest or not names:
            return best
        n *= 2


@dataclass(frozen=True, eq=False)
class FitOfWindows:
    """Least-squares fits of the states at the starts of windows."""

    x0: Array  # (n_windows, n_x)
    std: Array  # their standard deviations for white errors
    rank: Indices  # number of determined directions, (n_windows,)
    left: Array  # remaining weighted errors, (n_windows, length, n_y)


def fit_windows(model: Windowed, windows: WindowResponses, error: Array | None = None) -> FitOfWindows:
    """Fit initial states by least squares to ``error`` (n_windows, length, n_y), default measured minus simulated."""
    weight = model.whole.weight
    error = model.whole.y[windows.samples] - windows.y if error is None else error
    lhs = (windows.free * weight[:, None]).reshape(len(error), error[0].size, -1)
    rhs = (error * weight).reshape(len(error), -1)
    scale = np.linalg.norm(lhs, axis=1)
    scale[scale == 0] = 1.0
    left, sigma, right = np.linalg.svd(lhs / scale[:, None], full_matrices=False)
    known = sigma > RANK_TOLERANCE * sigma[:, :1]
    basis = left * known[:, None]
    inverse = np.divide(1.0, sigma, out=np.zeros_like(sigma), where=known)
    coordinates = np.einsum("wmk,wm->wk", basis, rhs)
    x0 = np.einsum("wkn,wk->wn", right, coordinates * inverse) / scale
    rest = rhs - np.einsum("wmk,wk->wm", basis, coordinates)
    rank = known.sum(axis=1)
    variance = (rest**2).sum(axis=1) / np.maximum(1, rhs.shape[1] - rank)
    std = np.sqrt(variance[:, None] * ((right * inverse[:, :, None]) ** 2).sum(axis=1)) / scale
    return FitOfWindows(windows.x0 + x0, std, rank, rest.reshape(error.shape))


@dataclass(frozen=True)
class WindowedSimulation:
    """Windowed simulation of a record."""

    edges: NDArray[np.int_]  # first sample of each window, and the end of the last one, shape (n_windows + 1,)
    y: Array  # simulated outputs, shape (n, n_y)
    x0: Array  # fitted initial states, shape (n_windows, n_x)
    residual: Array  # recursive residual in units of the outputs, (n, n_y); NaN where a sample only fixes the state


def window_edges(n: int, length: int) -> NDArray[np.int_]:
    """Return edges of windows of ``length`` samples; a remainder shorter than half a window joins the last one.

    Examples
    --------
    >>> window_edges(99, 40).tolist(), window_edges(110, 40).tolist()
    ([0, 40, 99], [0, 40, 80, 110])
    """
    edges = list(range(0, n, length))
    if len(edges) > 1 and n - edges[-1] < length / 2:
        edges.pop()
    return np.array([*edges, n])


def windowed_simulation(model: Windowed, edges: NDArray[np.int_]) -> WindowedSimulation:
    """Simulate every window between the edges from its own least-squares initial state; NaN outside."""
    # Without ``together`` each sample of the residual is predicted from samples of the same output only.
    from robustlab.identification.response.recursion_kernel import predict

    y, weight, n_x = model.whole.y, model.whole.weight, len(model.state_names)
    simulated, residual = np.full((2, *y.shape), np.nan)
    sizes, states = np.diff(edges), np.empty((len(edges) - 1, n_x))
    groups = [slice(None)] if model.together else [slice(j, j + 1) for j in range(y.shape[1])]
    for size in np.unique(sizes):
        for windows in model.responses(edges[:-1][sizes == size], int(size)):
            fit, at = fit_windows(model, windows), windows.samples
            simulated[at] = y[at] - fit.left / weight
            states[np.searchsorted(edges, windows.starts)] = fit.x0
            for free, left, place in zip(windows.free * weight[:, None], fit.left, at, strict=True):
                for group in groups:
                    value = left[:, group].reshape(-1, 1).copy()
                    rows = free[:, group].reshape(len(value), n_x).copy()
                    norm = np.linalg.norm(rows, axis=0)
                    predict(rows, value, NO_INFORMATION * np.where(norm > 0, norm, 1.0))  # in place
                    residual[place, group] = value.reshape(size, -1) / weight[group]
    return WindowedSimulation(edges, simulated, states, residual)
