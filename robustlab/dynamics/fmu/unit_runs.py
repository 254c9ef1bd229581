r"""What a unit is asked for in the child. Model exchange: rates, outputs and derivatives at points, and integration
with events; co-simulation: it steps itself from one communication point to the next.

Integration is by DOP853 with the local error held; a step that carries an event indicator through zero is cut there by
bisection of its dense output. Events in time, in state, and those that the unit asks for after a step are handled;
an input that jumps between samples is an event, too.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from robustlab.arrays import Array, Mask
from robustlab.dynamics.fmu.native_unit import NativeUnit
from robustlab.errors import NoTrustworthyNumber

# Steps of the differences as shares of a state's or input's size: the first is the most exact for smooth equations, the
# others stay in the domain of stiff ones. Richardson's two central differences leave an error of the fourth order.
DIFFERENCE_STEPS = (1e-3, 1e-5, 1e-7)
# Directional derivatives must lie between the one-sided differences, widened by this share of the row.
DIRECTIONAL_AGREES = 1e-3
ONE_SIDED = 1e-6
LATER = math.sqrt(2)  # s: rates of a unit that depends on time itself differ by then
MOST_EVALUATIONS = 5_000_000
MOST_EVENTS = 100_000
BISECTIONS = 60


def started(unit: NativeUnit, values: Mapping[str, float]) -> list[Array]:
    """The unit's own initial states and inputs."""
    unit.begin(values, 0.0)
    return [unit.get_states(), unit.get_inputs()]


# --- points ----------------------------------------------------------------------------------------------------------


def evaluated(
    unit: NativeUnit, values: Mapping[str, float], x: Array, u: Array, derivatives: str
) -> tuple[dict[str, Any], list[Array]]:
    """Rates (n, n_x), outputs (n, n_y), and [[A, B], [C, D]] (n, n_x + n_y, n_x + n_u) unless ``derivatives`` is empty.

    ``derivatives`` is "directional" or "differences". A unit with events is begun anew at every point and takes there
    the mode that its event iteration finds, so that no point depends on another.
    """
    n, n_x, n_u, n_y = len(x), unit.states.n, unit.inputs.n, unit.outputs.n
    rates, outputs = np.empty((n, n_x)), np.empty((n, n_y))
    slopes = np.empty((n if derivatives else 0, n_x + n_y, n_x + n_u))
    smooth = not len(unit.z.values) and unit.begin(values, 0.0) == math.inf
    error = 0.0
    for k in range(n):
        if not smooth:
            unit.begin(values, 0.0)
        unit.set_point(0.0, x[k], u[k])
        if not smooth:
            unit.event(u[k])
            if not np.array_equal(unit.get_states(), x[k]):
                raise NoTrustworthyNumber(unit.name, f"point {k}: an event there moves the states", None)
        rates[k], outputs[k] = unit.get_rates(), unit.get_outputs()
        _require_finite(unit, rates[k], outputs[k], f"at point {k}")
        if k == 0:
            _require_autonomous(unit, x[k], u[k], rates[k])
        if derivatives == "directional":
            slopes[k] = unit.directional(n_x + n_u)
            if not np.isfinite(slopes[k]).all():
                raise NoTrustworthyNumber(unit.name, f"directional derivatives at point {k} are not finite", None)
            if k == 0:
                _check_directional(unit, x[k], u[k], slopes[k])
        elif derivatives:
            slopes[k], off = _differences(unit, x[k], u[k], k)
            error = max(error, off)
    return {"truncation": error} if derivatives == "differences" else {}, [rates, outputs, slopes]


def _require_finite(unit: NativeUnit, rates: Array, outputs: Array, where: str) -> None:
    names = [*(f"the rate of {v['name']}" for v in unit.description["states"])]
    names += [v["name"] for v in unit.description["outputs"]]
    values = np.concatenate([rates, outputs])
    if not np.isfinite(values).all():
        k = int(np.argmin(np.isfinite(values)))
        raise unit.failed(f"{names[k]} is {values[k]:g} {where}")


def _require_autonomous(unit: NativeUnit, x: Array, u: Array, rates: Array) -> None:
    unit.set_point(LATER, x, u)
    later = unit.get_rates()
    unit.set_point(0.0, x, u)
    if not np.array_equal(later, rates):
        raise NoTrustworthyNumber(
            unit.name,
            f"its rates depend on time itself: they differ between t = 0 and {LATER:.3g} s at one point",
            None,
            "rl.simulate runs it",
        )


def _at(unit: NativeUnit, s: Array) -> Array:
    """Rates and outputs at (x, u) = s, in the mode that the unit is in."""
    n = unit.states.n
    unit.set_point(0.0, s[:n], s[n:])
    return np.concatenate([unit.get_rates(), unit.get_outputs()])


def _sizes(unit: NativeUnit, s: Array) -> Array:
    """How far a state or input moves the equations: its own size, at least its nominal value."""
    nominal = [v["nominal"] for v in unit.description["states"]] + [1.0] * unit.inputs.n
    return np.maximum(np.abs(s), nominal)


def _differences(unit: NativeUnit, x: Array, u: Array, point: int) -> tuple[Array, float]:
    """Richardson's central differences, and how far they are from the plain ones relative to their row."""
    s = np.concatenate([x, u])
    size = _sizes(unit, s)
    found, off = np.zeros((unit.states.n + unit.outputs.n, len(s))), 0.0
    for j in range(len(s)):
        for share in DIFFERENCE_STEPS:
            h = share * size[j]
            near, far = (_central(unit, s, j, step) for step in (h, 2 * h))
            if np.isfinite(near).all() and np.isfinite(far).all():
                break
        else:
            raise NoTrustworthyNumber(unit.name, f"no finite values around point {point}", None)
        found[:, j] = (4 * near - far) / 3
        scale = np.abs(found[:, j]).max(initial=0.0)
        off = max(off, float(np.abs(found[:, j] - near).max(initial=0.0) / scale) if scale else 0.0)
    unit.set_point(0.0, x, u)
    return found, off


def _central(unit: NativeUnit, s: Array, j: int, h: float) -> Array:
    step = np.zeros(len(s))
    step[j] = h
    return (_at(unit, s + step) - _at(unit, s - step)) / (2 * h)


def _check_directional(unit: NativeUnit, x: Array, u: Array, slopes: Array) -> None:
    """A unit's own derivatives must be those of its own equations; a kink may lie at the point."""
    s = np.concatenate([x, u])
    middle, size = _at(unit, s), _sizes(unit, s)
    for j in range(len(s)):
        step = np.zeros(len(s))
        step[j] = ONE_SIDED * size[j]
        ahead, behind = (_at(unit, s + step) - middle) / step[j], (middle - _at(unit, s - step)) / step[j]
        low, high = np.minimum(ahead, behind), np.maximum(ahead, behind)
        rounding = 1e-15 * np.abs(middle) / step[j]
        room = DIRECTIONAL_AGREES * (np.abs(slopes[:, j]) + np.abs(slopes[:, j]).max(initial=0.0)) + 10 * rounding
        wrong = np.isfinite(low + high) & ((slopes[:, j] < low - room) | (slopes[:, j] > high + room))
        if wrong.any():
            k = int(np.argmax(wrong))
            rows = [f"rate of {v['name']}" for v in unit.description["states"]]
            rows += [v["name"] for v in unit.description["outputs"]]
            knowns = [v["name"] for v in (*unit.description["states"], *unit.description["inputs"])]
            raise NoTrustworthyNumber(
                unit.name,
                f"its directional derivative of the {rows[k]} by {knowns[j]} is {slopes[k, j]:.6g}, differences of its"
                f" values give {low[k]:.6g}",
                None,
                'derivatives="differences" leaves the unit\'s own aside',
            )
    unit.set_point(0.0, x, u)


# --- integration -----------------------------------------------------------------------------------------------------


def integrated(
    unit: NativeUnit,
    values: Mapping[str, float],
    rtol: float,
    t: Array,
    coefficients: Array,
    broken: Array,
    x0: Array | None,
) -> list[Array]:
    """States (n, n_x) and outputs (n, n_y) at the times t; the input as `robustlab.dynamics.plant_contract.InputSignal`
    holds it, the unit's own initial states where none are given.
    """
    run = _Run(unit, rtol, t, coefficients)
    run.next_event = unit.begin(values, float(t[0]), coefficients[0, 0])
    run.x = unit.get_states()
    if x0 is not None and not np.array_equal(x0, run.x):
        unit.set_point(float(t[0]), x0, coefficients[0, 0])
        run.event(float(t[0]), x0, 0)
    states, outputs = np.empty((len(t), unit.states.n)), np.empty((len(t), unit.outputs.n))
    for k, time in enumerate(t.tolist()):
        piece = min(k, len(coefficients) - 1)
        if k < len(coefficients) and broken[k]:
            run.event(time, run.x, piece)
        unit.set_point(time, run.x, run.input(time, piece))
        states[k], outputs[k] = run.x, unit.get_outputs()
        _require_finite(unit, states[k], outputs[k], f"at t = {time:.9g} s")
        if k < len(coefficients):
            run.advance(time, float(t[k + 1]), k)
    return [states, outputs]


class _Run:
    """An integration under way."""

    def __init__(self, unit: NativeUnit, rtol: float, t: Array, coefficients: Array) -> None:
        self.unit, self.rtol, self.t, self.coefficients = unit, max(rtol, 3e-14), t, coefficients
        self.constant: Mask = np.asarray(~coefficients[:, 1:].any(axis=(1, 2)))
        nominal = np.array([v["nominal"] for v in unit.description["states"]])
        self.atol = 1e-2 * rtol * np.minimum(nominal, 1.0)
        self.next_event, self.x, self.length = math.inf, np.zeros(0), 0.0
        self.evaluations = self.events = 0

    def input(self, time: float, k: int) -> Array:
        """Inputs at a time of interval k."""
        if self.constant[k]:
            return self.coefficients[k, 0]
        h = time - self.t[k]
        value = self.coefficients[k, 5]
        for j in range(4, -1, -1):
            value = value * h + self.coefficients[k, j]
        return value

    def rates(self, time: float, x: Array, k: int) -> Array:
        """Rates of the states; counts."""
        self.evaluations += 1
        if self.evaluations > MOST_EVALUATIONS:
            found = f"{MOST_EVALUATIONS} evaluations used up at t = {time:.9g} s"
            hint = "stiff equations need an implicit method: export the unit for co-simulation with its own solver"
            raise NoTrustworthyNumber(self.unit.name, found, None, hint)
        self.unit.set_point(time, x, self.input(time, k))
        return self.unit.get_rates()

    def event(self, time: float, x: Array, k: int) -> None:
        """An event at a time and state."""
        self.events += 1
        if self.events > MOST_EVENTS:
            raise NoTrustworthyNumber(self.unit.name, f"{MOST_EVENTS} events by t = {time:.9g} s", None)
        u = self.input(time, k)
        self.unit.set_point(time, x, u)
        self.next_event = self.unit.event(u)
        self.x = self.unit.get_states()

    def advance(self, time: float, end: float, k: int) -> None:
        """Integrate from one sample to the next."""
        while time < end:
            if self.next_event <= time:
                self.event(time, self.x, k)
                if self.next_event <= time:
                    raise NoTrustworthyNumber(self.unit.name, f"time events that repeat at t = {time:.9g} s", None)
            time = self._smooth_stretch(time, min(end, self.next_event), k)

    def _smooth_stretch(self, time: float, end: float, k: int) -> float:
        """Integrate to an event or to the end; the time that was reached."""
        from scipy.integrate import DOP853

        if not self.unit.states.n:  # a unit of events in time and gains only
            self.unit.set_point(end, self.x, self.input(end, k))
            if self.next_event <= end or self.unit.step_done():
                self.event(end, self.x, k)
            return end
        first = min(self.length or 1e-2 * (end - time), end - time)
        options: dict[str, Any] = {"rtol": self.rtol, "atol": self.atol, "first_step": first}
        solver: Any = DOP853(lambda at, x: self.rates(at, x, k), time, self.x, end, **options)
        if not np.isfinite(solver.f).all():
            _require_finite(self.unit, solver.f, np.zeros(self.unit.outputs.n), f"at t = {time:.9g} s")
        before = self._indicators(time, self.x, k)
        while solver.status == "running":
            failure = solver.step()
            if failure:
                f = self.rates(solver.t, solver.y, k)
                bad = "" if np.isfinite(f).all() else "; its rates are not finite there"
                raise self.unit.failed(f"no solution beyond t = {solver.t:.9g} s{bad}")
            self.length = solver.h_abs  # what the error asks for next, which the end of a sample does not shorten
            after = self._indicators(solver.t, solver.y, k)
            if ((before > 0) != (after > 0)).any():
                at, x = self._crossing(solver, before, k)
                self.event(at, x, k)
                return at
            if self.unit.step_done():
                self.event(solver.t, solver.y, k)
                return float(solver.t)
            before = after
        self.x = solver.y
        if self.next_event <= end:
            self.event(end, self.x, k)
        return end

    def _indicators(self, time: float, x: Array, k: int) -> Array:
        if not len(self.unit.z.values):
            return self.unit.z.values
        self.unit.set_point(time, x, self.input(time, k))
        return self.unit.get_indicators()

    def _crossing(self, solver: Any, before: Array, k: int) -> tuple[float, Array]:
        """The first instant after an indicator's change of sign within the last step."""
        between = solver.dense_output()
        low, high = float(solver.t_old), float(solver.t)
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            if not low < middle < high:
                break
            if ((before > 0) != (self._indicators(middle, between(middle), k) > 0)).any():
                high = middle
            else:
                low = middle
        return high, between(high)


def stepped(unit: NativeUnit, values: Mapping[str, float], t: Array, u: Array, longest: float) -> list[Array]:
    """Outputs (n, n_y) at the times t for inputs (n, n_u) held between them; steps of at most ``longest`` s."""
    unit.begin(values, float(t[0]), u[0])
    found = np.empty((len(t), unit.outputs.n))
    for k, time in enumerate(t.tolist()):
        unit.set_inputs(u[k])
        found[k] = unit.get_outputs()
        if not np.isfinite(found[k]).all():
            j = int(np.argmin(np.isfinite(found[k])))
            raise unit.failed(f"{unit.description['outputs'][j]['name']} is {found[k, j]:g} at t = {time:.9g} s")
        if k + 1 < len(t):
            length = t[k + 1] - time
            pieces = max(int(np.ceil(length / longest - 1e-9)), 1)
            for piece in range(pieces):
                unit.step(time + piece * length / pieces, length / pieces)
    return [found]


def linear_matrices(unit: NativeUnit, values: Mapping[str, float], u: Array) -> list[Array]:
    """``[[A, B], [C, D]]`` at the unit's initial state, by its directional derivatives; and the outputs there."""
    unit.begin(values, 0.0, u)
    slopes = unit.directional(unit.states.n + unit.inputs.n)
    if not np.isfinite(slopes).all():
        raise NoTrustworthyNumber(unit.name, "its directional derivatives are not finite", None)
    states = np.array([unit.value(v["reference"]) for v in unit.description["states"]])
    return [slopes, states, unit.get_outputs()]
