"""Tapes: functions of real numbers as lists of elementary operations for storage and compiled evaluation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.dynamics.integrator.compilation import compiled
from robustlab.errors import InputError

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
    """Load the compiled kernels, which are common to all plants."""
    from robustlab.dynamics.integrator.steps import TABLE

    here = Path(__file__).parent
    leaves = (here.parent / "integrator" / "steps.py", TABLE)
    text = "compiling the evaluation of plants (once on this machine, some seconds) ..."
    return compiled(here / "tape_kernels.py", "robustlab.dynamics.symbolic.tape_kernels", leaves, text)


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
    """Return the label of the first expression with a wrong instruction (function, number)."""
    import casadi as ca

    for k in range(outputs.numel()):
        function = ca.Function("f", [ca.vertcat(*ca.symvar(outputs[k]))], [outputs[k]])
        if any(wrong(function, i) for i in range(function.n_instructions())):
            return label(k)
    return "the equations"
