"""Nonlinear plants x' = f(x, u, p), y = h(x, u, p) as tapes: lists of operations for storage and compilation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array, Indices
from robustlab.dynamics.equilibrium import PASSES, RANK, STILL, evaluated, newton, trim_conditions
from robustlab.dynamics.integrator import compiled
from robustlab.dynamics.plant_base import InputSignal, LocalModels, NonlinearPlant, PlantAlong, PortPlace, Trim
from robustlab.errors import InputError, NoTrustworthyNumber, unknown_name
from robustlab.result import Status
from robustlab.statespace import Signal, real_array

# Name of each operation (CasADi's without OP_); the index is its number on tapes and in files: append new ones.
OPERATIONS = (
    *("ADD", "SUB", "MUL", "DIV", "NEG", "SQ", "TWICE", "INV", "SQRT", "SIN", "COS", "TAN", "ASIN", "ACOS", "ATAN"),
    *("ATAN2", "EXP", "LOG", "POW", "SINH", "COSH", "TANH", "ASINH", "ACOSH", "ATANH", "EXPM1", "LOG1P", "HYPOT"),
    *("FABS", "SIGN", "FMIN", "FMAX", "LT", "LE", "EQ", "NE", "NOT", "AND", "OR", "IF_ELSE_ZERO", "ERF", "COPYSIGN"),
)
# Largest size of a tape.
MAX_OPERATIONS = 2_000_000

Places = NDArray[np.int64]
Source = tuple[str, int]  # "input", "constant" or "result", and its number


@dataclass(frozen=True, eq=False)
class Tape:
    """A function from n_in numbers to n_out numbers."""

    n_in: int  # number of inputs
    # Number in `OPERATIONS` and places of both arguments (twice the same for one) of each operation, shape (n,). Places
    # count inputs, then constants, then results.
    operations: Places
    left: Places
    right: Places
    constants: Array  # finite numbers, shape (n_c,)
    outputs: Places  # places of the outputs, shape (n_out,)
    # number of last inputs that are constant over all points (parameters); leading operations on these are done once
    n_still: int = 0

    def __post_init__(self) -> None:
        for name in ("operations", "left", "right", "outputs"):
            places = getattr(self, name)
            if places.ndim != 1 or places.dtype.kind not in "iu":
                raise InputError(f"tape: {name}", f"{places.dtype} of shape {places.shape}", "a row of integers")
            object.__setattr__(self, name, np.ascontiguousarray(places, dtype=np.int64))
        if self.constants.ndim != 1 or self.constants.dtype.kind not in "fiu":
            raise InputError("tape: constants", f"shape {self.constants.shape}", "a row of real numbers")
        object.__setattr__(self, "constants", np.ascontiguousarray(self.constants, dtype=np.float64))
        n = len(self.operations)
        if n > MAX_OPERATIONS:
            raise InputError("tape: operations", f"{n}", f"at most {MAX_OPERATIONS}")
        if not len(self.left) == len(self.right) == n:
            raise InputError("tape", f"{len(self.left)} and {len(self.right)} arguments", f"{n}, one for an operation")
        bad = ~np.isfinite(self.constants)
        if bad.any():
            raise InputError("tape: constants", f"entry {int(np.argmax(bad))} is no finite number", "finite numbers")
        first = self.n_in + len(self.constants)
        _within("operations", self.operations, len(OPERATIONS))
        for name in ("left", "right"):
            _within(name, getattr(self, name), first + np.arange(n))
        _within("outputs", self.outputs, first + n)

    @property
    def n_out(self) -> int:
        return len(self.outputs)

    @cached_property
    def code(self) -> Any:
        """The tape for the kernels."""
        rows = (self.operations, self.left, self.right, self.outputs)
        operations, left, right, outputs = (row.astype(np.uint32) for row in rows)
        moving = np.minimum(self.left, self.right) < self.n_in - self.n_still
        still = int(np.argmax(moving)) if moving.any() else len(moving)
        constants = np.array(self.constants)  # writable, as required by the kernels
        return tape_kernels().Code(operations, left, right, constants, outputs, self.n_in - self.n_still, still)

    def __call__(self, points: Array) -> Array:
        """Evaluate outputs (n, n_out) at the points (n, n_in); NaN or infinite where undefined."""
        results = np.empty((len(points), self.n_out))
        tape_kernels().evaluate(self.code, np.array(points, dtype=np.float64, order="C"), results)
        return results


def _within(name: str, places: Places, limit: Any) -> None:
    bad = (places < 0) | (places >= limit)
    if bad.any():
        k = int(np.argmax(bad))
        raise InputError(f"tape: {name}", f"entry {k} is {places[k]}", "a known number that comes before its use")


@cache
def tape_kernels() -> ModuleType:
    return compiled(
        "symbolic.expression_kernels", "compiling the evaluation of plants (once on this machine, some seconds) ..."
    )


@cache
def _codes() -> dict[int, int]:
    """Return CasADi's number of an operation -> number on tapes."""
    import casadi as ca

    known = {getattr(ca, f"OP_{name}"): k for k, name in enumerate(OPERATIONS)}
    return {**known, ca.OP_CONSTPOW: known[ca.OP_POW]}


def tape_of(inputs: Any, outputs: Any, n_still: int, where: str, label: Callable[[int], str] = str) -> Tape:
    """Return the tape of CasADi expressions."""
    import casadi as ca

    function = ca.Function("f", [inputs], [ca.densify(outputs)])
    codes = _codes()
    n_in = inputs.numel()
    constants: dict[float, int] = {}
    steps: list[tuple[int, Source, Source]] = []
    # Entry of the work vector, which is reused -> its content: (kind, number).
    held: dict[int, Source] = {}
    ends: list[Source] = [("", 0)] * outputs.numel()
    for k in range(function.n_instructions()):
        op, to = function.instruction_id(k), function.instruction_output(k)
        if op == ca.OP_OUTPUT:
            ends[to[1]] = held[function.instruction_input(k)[0]]
        elif op == ca.OP_INPUT:
            held[to[0]] = ("input", function.instruction_input(k)[1])
        elif op == ca.OP_CONST:
            value = float(function.instruction_constant(k))
            if not np.isfinite(value):
                title = _concerned(
                    outputs,
                    label,
                    lambda f, i: f.instruction_id(i) == ca.OP_CONST and not np.isfinite(f.instruction_constant(i)),
                )
                raise InputError(f"{where}: {title}", f"the number {value} in it", "finite numbers")
            held[to[0]] = ("constant", constants.setdefault(value, len(constants)))
        elif op == ca.OP_ASSIGN:
            held[to[0]] = held[function.instruction_input(k)[0]]
        elif op in codes:
            arguments = [held[i] for i in function.instruction_input(k)]
            steps.append((codes[op], arguments[0], arguments[-1]))
            held[to[0]] = ("result", len(steps) - 1)
        else:
            name = next((n for n in dir(ca) if n.startswith("OP_") and getattr(ca, n) == op), str(op))
            title = _concerned(outputs, label, lambda f, i, op=op: f.instruction_id(i) == op)
            known = ", ".join(OPERATIONS).lower()
            raise InputError(f"{where}: {title}", f"operation {name.removeprefix('OP_').lower()}", f"one of {known}")
    order = _grouped(steps, n_in - n_still)
    rank = {k: r for r, k in enumerate(order)}
    base = {"input": 0, "constant": n_in}

    def place(source: Source) -> int:
        kind, number = source
        return n_in + len(constants) + rank[number] if kind == "result" else base[kind] + number

    rows = np.array([(steps[k][0], place(steps[k][1]), place(steps[k][2])) for k in order], np.int64).reshape(-1, 3)
    values, outs = np.array([*constants], float), np.array([*map(place, ends)], np.int64)
    return Tape(n_in, rows[:, 0], rows[:, 1], rows[:, 2], values, outs, n_still)


def _grouped(steps: list[tuple[int, Source, Source]], n_moving: int) -> list[int]:
    """Order the operations: those of constant inputs first, equal ones in long runs."""
    waits, users = [0] * len(steps), [list[int]() for _ in steps]
    moving = [False] * len(steps)
    for k, (_, *arguments) in enumerate(steps):
        for kind, number in set(arguments):
            if kind == "result":
                waits[k] += 1
                users[number].append(k)
                moving[k] |= moving[number]
            moving[k] |= kind == "input" and number < n_moving
    order: list[int] = []
    for part in (False, True):
        ready: dict[int, list[int]] = {}
        for k in range(len(steps)):
            if not waits[k] and moving[k] == part:
                ready.setdefault(steps[k][0], []).append(k)
        while ready:
            run = ready.pop(max(ready, key=lambda op: (len(ready[op]), op)))
            order += run
            for k in run:
                for user in users[k]:
                    waits[user] -= 1
                    if not waits[user] and moving[user] == part:
                        ready.setdefault(steps[user][0], []).append(user)
    return order


def _concerned(outputs: Any, label: Callable[[int], str], wrong: Callable[[Any, int], bool]) -> str:
    import casadi as ca

    for k in range(outputs.numel()):
        function = ca.Function("f", [ca.vertcat(*ca.symvar(outputs[k]))], [outputs[k]])
        if any(wrong(function, i) for i in range(function.n_instructions())):
            return label(k)
    return "the equations"


@dataclass(frozen=True, eq=False)
class Equations:
    """Equations of a plant as tapes of (x, u, p): states, inputs, parameters, each in the plant's order."""

    # f (n_x,) and h (n_y,)
    rates: Tape
    outputs: Tape
    models: Tape  # f, h, A, B, C, D and push of `robustlab.dynamics.plant_base.LocalModels`, each row by row
    places: tuple[PortPlace, ...]  # where forces act, in the order of push


@dataclass(frozen=True, eq=False, repr=False)
class SymbolicPlant(PlantAlong):
    """A user-defined plant; made by `robustlab.dynamics.symbolic.equations.PlantEquations`."""

    equations: Equations

    def __post_init__(self) -> None:
        super().__post_init__()
        n_x, n_u, n_y = len(self.states), len(self.inputs), len(self.outputs)
        n_in, n_ports = n_x + n_u + len(self.parameters), len(self.equations.places)
        models = n_x + n_y + (n_x + n_y) * (n_x + n_u) + n_x * n_ports
        for name, n_out in (("rates", n_x), ("outputs", n_y), ("models", models)):
            tape: Tape = getattr(self.equations, name)
            if (tape.n_in, tape.n_out) != (n_in, n_out):
                found = f"{tape.n_in} inputs and {tape.n_out} outputs"
                raise InputError(f"{self.name}: tape of {name}", found, f"{n_in} and {n_out}")
        names = {s.name for s in self.states}
        for place in self.equations.places:
            unknown = {place.name, place.position or place.name} - names
            if unknown:
                raise InputError(f"{self.name}: place of a force", f"{min(unknown)!r}", "a state")

    @property
    def port_places(self) -> tuple[PortPlace, ...]:
        return self.equations.places

    def outputs_along(self, x: Array, u: Array, values: Mapping[str, Any] | None = None) -> Array:
        return self._evaluated(self.equations.outputs, x, u, values, first=len(self.states))

    def rates_along(self, x: Array, u: Array, values: Mapping[str, Any] | None = None) -> Array:
        return self._evaluated(self.equations.rates, x, u, values)

    def local_models(self, x: Array, u: Array, values: Mapping[str, Any] | None = None) -> LocalModels:
        n, n_x, n_u, n_y, n_p = (len(x), *map(len, (self.states, self.inputs, self.outputs, self.equations.places)))
        found = self._evaluated(self.equations.models, x, u, values)
        shapes = ((n_x,), (n_y,), (n_x, n_x), (n_x, n_u), (n_y, n_x), (n_y, n_u), (n_x, n_p))
        ends = np.cumsum([int(np.prod(shape)) for shape in shapes])
        parts = np.split(found, ends[:-1], axis=1)
        return LocalModels(*(part.reshape(n, *shape) for part, shape in zip(parts, shapes, strict=True)))

    def equilibrium(self, **where: Any) -> Trim:
        return rest(self, where)

    def trajectory(self, signal: InputSignal, x0: Array, rtol: float) -> Array:
        code = tape_kernels()
        states = np.empty((len(signal.t), len(x0)))
        inputs = code.Inputs(np.array(signal.t), np.ascontiguousarray(signal.coefficients), np.array(signal.broken))
        values = np.array(list(self.values.values()), dtype=np.float64)
        outcome, time, _, culprit = code.integrate(
            self.equations.rates.code, np.array(x0, dtype=np.float64), values, inputs, float(rtol), states
        )
        if outcome == code.DONE:
            return states
        words, hint = "too many steps", "a force that jumps with a velocity is dry friction: add it by with_effects"
        if outcome == code.NOT_FINITE:
            words, hint = "the step became too small", None
            if culprit >= 0:
                words = f"the rate of {self.states[culprit].name} has no finite value there"
        raise NoTrustworthyNumber(self.name, f"no solution beyond t = {time:.9g} s: {words}", None, hint)

    def _evaluated(
        self, tape: Tape, x: Array, u: Array, values: Mapping[str, Any] | None = None, first: int = 0
    ) -> Array:
        """Return finite outputs (n, n_out) of a tape; ``first``: index of its first one in `labels`."""
        n, n_x, n_u = len(x), len(self.states), len(self.inputs)
        for name, array, width in (("x", x, n_x), ("u", u, n_u)):
            if np.shape(array) != (n, width):
                raise InputError(f"{self.name}: {name}", f"shape {np.shape(array)}", f"({n}, {width})")
        points = np.empty((n, tape.n_in))
        points[:, :n_x], points[:, n_x : n_x + n_u] = x, u
        points[:, n_x + n_u :] = list(self.values.values())
        for name, value in (values or {}).items():
            place = f"{self.name}: {name}"
            if name not in self.parameters:
                raise unknown_name(place, "no such parameter", name, self.parameters)
            array = real_array(name, value, np.ndim(value), self.name)
            if array.shape not in ((), (n,)):
                raise InputError(place, f"shape {array.shape}", f"one value, or {n}: one for each point")
            points[:, n_x + n_u + list(self.parameters).index(name)] = array
        found = tape(points)
        if not np.isfinite(found).all():
            row, column = (int(k) for k in np.argwhere(~np.isfinite(found))[0])
            label = labels(self.states, self.inputs, self.outputs, self.equations.places)[first + column]
            signals = (*self.states, *self.inputs)
            point = ", ".join(f"{s.name} = {v:.4g}" for s, v in zip(signals, points[row], strict=False))
            point = f"point {row} of {n} ({point})" if n > 1 else point
            raise NoTrustworthyNumber(self.name, f"{label} is {found[row, column]} at {point}")
        return found


def labels(
    states: Sequence[Signal], inputs: Sequence[Signal], outputs: Sequence[Signal], places: Sequence[PortPlace]
) -> list[str]:
    """Return a text for each output of the tape of f, h, A, B, C, D and push, row by row."""
    rates = [f"the rate of {s.name}" for s in states]
    outs = [f"output {s.name}" for s in outputs]

    def slopes(rows: list[str], columns: Sequence[Signal] | Sequence[PortPlace], kind: str = "") -> list[str]:
        return [f"the slope of {row} by {kind}{column.name}" for row in rows for column in columns]

    by_states = [*slopes(rates, states), *slopes(rates, inputs), *slopes(outs, states), *slopes(outs, inputs)]
    return [*rates, *outs, *by_states, *slopes(rates, places, "the force at ")]


# Relative residual below which an equilibrium is INACCURATE, above which there is none.
NEAR = 1e-6
# Relative accuracy of the equilibrium nearest to the start.
AGREED = 1e-9
# Further starts if Newton's method stalls at zero (a force quadratic in a speed).
STARTS = (1.0, 0.1, 10.0, -1.0)


def rest(plant: NonlinearPlant, where: Mapping[str, Any]) -> Trim:
    """Find the equilibrium nearest to zero, or to ``where["start"]``, with the other entries of ``where`` held."""
    n_x, n_u = len(plant.states), len(plant.inputs)
    given = dict(where)
    x, u = plant.point(*given.pop("start")) if "start" in given else (np.zeros(n_x), np.zeros(n_u))
    began = np.concatenate([x, u])
    held, wanted = trim_conditions(plant, given)
    began[list(held)] = list(held.values())
    free = np.array([k for k in range(n_x + n_u) if k not in held], dtype=np.intp)
    shift = np.isin(np.arange(n_x + n_u), free)
    starts = [began] + ([] if "start" in where else [began + level * shift for level in STARTS])
    best = np.inf, began, 0
    for start in starts:
        z, excess, row = newton(plant, start, free, wanted)[:3]
        if excess < best[0]:
            best = excess, z, row
        if excess <= 1.0:
            break
    excess, z, row = best
    if not excess <= NEAR / STILL:
        names = [f"the rate of {s.name}" for s in plant.states] + [f"output {plant.outputs[k].name}" for k in wanted]
        words = ", ".join(f"{k} = {v:g}" for k, v in given.items()) or "zero inputs"
        hint = "hold other states, inputs or outputs, or give start=(x, u) near to it"
        raise NoTrustworthyNumber(plant.name, f"no rest was found with {words}: {names[row]} stays off", None, hint)
    z, excess = _nearest(plant, began, (z, excess), free, wanted)
    x, u = z[:n_x], z[n_x:]
    residual = float(np.abs(plant.derivative(x, u)).max(initial=0.0))
    status = Status.CONVERGED if excess <= 1.0 else Status.INACCURATE
    return Trim(plant.name, x.copy(), u.copy(), plant.output(x, u), residual, None, status)


def _nearest(
    plant: NonlinearPlant, began: Array, found: tuple[Array, float], free: Indices, wanted: Mapping[int, float]
) -> tuple[Array, float]:
    """Move the equilibrium towards the start along a continuum of equilibria."""
    for _ in range(PASSES):
        z, excess = found
        local = evaluated(plant, z, wanted)
        if local is None:
            break
        way = (began - z)[free]
        part = local.slopes[:, free]
        size = np.abs(part).max(axis=1, initial=0.0)
        size[size == 0.0] = 1.0
        way = way - np.linalg.lstsq(part / size[:, None], part @ way / size, rcond=RANK)[0]
        trial = z.copy()
        trial[free] += way
        if np.linalg.norm(way) <= AGREED * (1.0 + np.linalg.norm(z)):
            break
        after = newton(plant, trial, free, wanted)
        if after[1] > max(1.0, excess) or np.linalg.norm(after[0] - began) >= np.linalg.norm(z - began):
            break
        found = after[:2]
    return found
