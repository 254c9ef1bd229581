"""Signals: names with units, their arrays, and their selection."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array, not_finite
from robustlab.errors import InputError, UnitMismatch, unknown_name

MAX_NAME = 200
# Hint for complex entries.
COMPLEX = (
    "margins, norms and designs take frequencies from 0 up, which is enough for real models alone; write a complex one "
    "as a real one of twice the size, [[Re, -Im], [Im, Re]] in the place of each matrix; .real where Im is rounding"
)


class Signal(NamedTuple):
    """A named signal with its unit, for example ``Signal("omega", "rad/s")``.

    Attributes
    ----------
    name
        1 to 200 characters, unique among the signals of its side.
    unit
        Empty where it is not stated.
    """

    name: str
    unit: str = ""


# What an input of a controller takes of a signal y with the reference r -> the sign of y.
TAKES = {"y": 1, "-y": -1, "r - y": -1, "y - r": 1, "r": 0}


class Taken(Signal):
    """An input of a controller with a record of what it takes, and thus of the sign of the feedback."""

    takes: str  # ``"y"`` the signal itself, ``"-y"``, ``"r - y"`` the error, ``"y - r"``, or ``"r"``, a reference alone
    of: str  # name of the plant's signal; that of the input where left out

    def __new__(cls, name: str, unit: str = "", takes: str = "y", of: str = "") -> Taken:
        if takes not in TAKES:
            raise InputError(f"input {name!r}", f"takes {takes!r}", f"one of {', '.join(TAKES)}")
        made = super().__new__(cls, name, unit)
        made.takes, made.of = takes, of or name
        return made

    def __repr__(self) -> str:
        return f"Taken(name={self.name!r}, unit={self.unit!r}, takes={self.takes!r}, of={self.of!r})"

    @property
    def sign(self) -> int:
        """The sign of the plant's signal: 1, -1, or 0 for a reference."""
        return TAKES[self.takes]

    def negated(self) -> Taken:
        """Return the input of ``-K`` for that of K."""
        other = {"y": "-y", "-y": "y", "r - y": "y - r", "y - r": "r - y", "r": "r"}
        return Taken(self.name, self.unit, other[self.takes], self.of)

    @property
    def text(self) -> str:
        """The signal taken, by name: ``r - omega``."""
        return self.takes.replace("y", self.of) if "y" in self.takes else f"r of {self.of}"


def law(inputs: Sequence[Signal]) -> str:
    """Return the law of a controller with these inputs, ``u = K (r - y)``; empty if one has no record of it."""
    taken = [s for s in inputs if isinstance(s, Taken)]
    if not taken or len(taken) < len(inputs):
        return ""
    words = {"y": "u = K y", "-y": "u = -K y", "r - y": "u = K (r - y)", "y - r": "u = K (y - r)"}
    kinds = {s.takes for s in taken}
    if len(kinds) == 1 and kinds <= set(words):
        return words[kinds.pop()]
    return f"u = K [{'; '.join(s.text for s in taken)}]"


def taken_through(second: Sequence[Signal], first: Sequence[Signal]) -> Sequence[Signal]:
    """Return the inputs of a product, those of ``first``, with what the controller ``second`` takes."""
    signs = {s.sign for s in second if isinstance(s, Taken)}
    if not signs or any(isinstance(s, Taken) for s in first) or not all(isinstance(s, Taken) for s in second):
        return first
    if len(first) == len(second):
        both = zip(first, second, strict=True)
        return [Taken(s.name, s.unit, k.takes, k.of) for s, k in both if isinstance(k, Taken)]
    if len(signs) > 1 or 0 in signs:
        return first
    return [Taken(s.name, s.unit, "y" if signs == {1} else "-y") for s in first]


def scaled(inputs: Sequence[Signal], factor: ArrayLike) -> Sequence[Signal]:
    """Return the inputs of a controller times a constant: a negative one negates them, mixed signs drop the record."""
    entries = np.asarray(factor)
    if (entries >= 0).all() or not any(isinstance(s, Taken) for s in inputs):
        return inputs
    if (entries <= 0).all():
        return [s.negated() if isinstance(s, Taken) else s for s in inputs]
    return [Signal(*s) for s in inputs]


SignalLike = str | Signal | tuple[str, str]


def real_array(name: str, value: ArrayLike, ndim: int, where: str = "StateSpaceModel") -> Array:
    """Return ``value`` as a read-only, finite float64 array with ``ndim`` dimensions, or refuse it."""
    try:
        raw = np.asarray(value)
    except ValueError as error:
        raise InputError(where, f"{name} is ragged ({error})", "a rectangular array of real numbers") from None
    if raw.dtype.kind not in "fiu":
        hint = COMPLEX if raw.dtype.kind == "c" else None
        raise InputError(where, f"{name} has dtype {raw.dtype}", "real numbers", hint)
    array = np.array(raw, dtype=np.float64, order="C")
    if ndim == 2 and array.ndim == 0:
        array = array.reshape(1, 1)
    if array.ndim != ndim:
        hint = f"write [[...]] for a row, or {name}.reshape(-1, 1) for a column" if ndim == 2 else None
        raise InputError(where, f"{name} has shape {array.shape}", f"{ndim} dimensions", hint)
    bad = not_finite(array)
    if bad is not None:
        raise InputError(where, f"{name}[{bad[0]}] {bad[1]}", "finite numbers")
    array.setflags(write=False)
    return array


def signals(given: Iterable[SignalLike] | None, count: int, prefix: str, where: str) -> tuple[Signal, ...]:
    """Return ``count`` uniquely named signals; ``prefix1, prefix2, ...`` where none are given."""
    if given is None:
        return _numbered(prefix, count)
    if isinstance(given, str):
        given = [given]
    if not isinstance(given, Iterable):
        raise InputError(where, f"signals {given!r}", "a list of names or (name, unit) pairs")
    result: list[Signal] = []
    for item in given:
        if not isinstance(item, str) and not (isinstance(item, (tuple, list)) and len(item) == 2):
            raise InputError(where, f"signal {item!r}", "a name or a (name, unit) pair")
        parts = (item,) if isinstance(item, str) else map(str, item)
        made = item if isinstance(item, Taken) else Signal(*parts)
        if not 0 < len(made.name) <= MAX_NAME:
            raise InputError(where, f"signal name of {len(made.name)} characters", f"1 to {MAX_NAME} characters")
        result.append(made)
    if len(result) != count:
        raise InputError(where, f"{len(result)} signal names", f"{count}")
    names = [s.name for s in result]
    if len(set(names)) < len(names):
        twice = min(n for n in names if names.count(n) > 1)
        raise InputError(where, f"signal name {twice!r} is used twice", "unique names")
    return tuple(result)


@cache
def _numbered(prefix: str, count: int) -> tuple[Signal, ...]:
    return tuple(Signal(f"{prefix}{i + 1}") for i in range(count))


def signal_positions(names: str | Sequence[str] | None, known: Sequence[str], where: str) -> list[int]:
    """Return the positions of the named signals among the known ones; all of them for None."""
    names = known if names is None else [names] if isinstance(names, str) else list(names)
    for name in names:
        if name not in known:
            raise unknown_name(f"{where} {name!r}", "no such signal", name, known)
    return [list(known).index(name) for name in names]


def picked(key: Any, outputs: tuple[str, ...], inputs: tuple[str, ...]) -> tuple[list[str], list[str]]:
    """Return the names of outputs and inputs of ``G[outputs, inputs]``: numbers, slices, names, lists of these."""
    if not isinstance(key, tuple) or len(key) != 2:
        hint = "write G[0, :] for the first output"
        raise InputError("indexing", f"[{key!r}]", "two indices: G[outputs, inputs]", hint)
    return _chosen(key[0], outputs, "output"), _chosen(key[1], inputs, "input")


def _chosen(key: Any, known: tuple[str, ...], kind: str) -> list[str]:
    if isinstance(key, slice):
        return list(known[key])
    chosen = []
    for item in [key] if isinstance(key, (str, int, np.integer)) else list(key):
        if isinstance(item, str):
            chosen.append(known[signal_positions(item, known, f"select: {kind}")[0]])
            continue
        if isinstance(item, bool) or not isinstance(item, (int, np.integer)) or not -len(known) <= item < len(known):
            expected = f"a name, or a number from 0 to {len(known) - 1}"
            raise InputError(f"indexing: {kind} {item!r}", "no such signal", expected)
        chosen.append(known[item])
    return chosen


def is_number(operand: Any) -> bool:
    return isinstance(operand, (int, float, np.number)) and not isinstance(operand, bool)


def is_constant(operand: Any) -> bool:
    """Return whether an operand is a number or a matrix: its signals have no names."""
    return isinstance(operand, (int, float, list, tuple, np.ndarray, np.number)) and not isinstance(operand, bool)


def names_of(other: Any, owner: Any, own: Sequence[Signal], others: Sequence[Signal]) -> Sequence[Signal]:
    """Return the signals of ``owner``; those of the other operand if the owner is a constant of equal size."""
    return others if is_constant(owner) and not is_constant(other) and len(others) == len(own) else own


def inputs_of_product(second: Any, first: Any, into: Sequence[Signal], own: Sequence[Signal]) -> Sequence[Signal]:
    """Return the inputs of ``second @ first``, whose own inputs are ``into`` and ``own``, with what they take."""
    if is_constant(second):
        return scaled(own, second)
    if is_constant(first):
        return scaled(names_of(second, first, own, into), first)
    return taken_through(into, own)


def same_units(where: str, pairs: Iterable[tuple[Signal, Signal]]) -> None:
    """Refuse connected signals with different units. Raises UnitMismatch: both have a unit, and the units differ."""
    for one, other in pairs:
        if one.unit and other.unit and one.unit != other.unit:
            found = f"{one.name} [{one.unit}] meets {other.name} [{other.unit}]"
            raise UnitMismatch(where, found, "equal units")
