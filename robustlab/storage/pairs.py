"""Pairs of models with the same signals: nominal and perturbed in one file, and their difference."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from robustlab.display import AllFields, Displayable, Facts, Part
from robustlab.errors import InputError, UnitMismatch
from robustlab.files.tree import Tree
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel
from robustlab.storage.matrices import Problems, decode_model, find_children, sample_time

GROUPS = ("nominal", "perturbed")


def looks_like_a_pair(tree: Tree) -> bool:
    """Return whether the root has no matrices, but groups with names close to ``nominal`` or ``perturbed``."""
    import difflib

    if any(name in tree.datasets for name in "ABCD"):
        return False
    return any(difflib.get_close_matches(name.lower(), GROUPS, n=1, cutoff=0.7) for name in tree.groups)


def decode_pair(tree: Tree, problems: Problems, transpose: bool = False) -> tuple[StateSpaceModel, StateSpaceModel]:
    """Return the models in groups ``nominal`` and ``perturbed``."""
    find_children(tree, GROUPS, problems, kind="group")
    dt = sample_time(tree, problems)
    models: dict[str, Any] = {}
    for name in GROUPS:
        if name in tree.groups and "E" in tree.groups[name].datasets:
            hint = "group='nominal', or group='perturbed', reads one model"
            problems.add(f"/{name}/E: a pair in descriptor form: its entries are no entries of A, B, C, D", hint)
        elif name in tree.groups:
            models[name] = decode_model(tree.groups[name], problems, transpose, models.get("nominal"), dt)
    problems.raise_any()
    check_pair(models["nominal"], models["perturbed"], tree.file)
    return models["nominal"], models["perturbed"]


def check_pair(nominal: StateSpaceModel, perturbed: StateSpaceModel, where: str = "nominal and perturbed") -> None:
    """Raise where two models differ in size, sample time, names or units; a missing unit agrees with every unit."""
    sizes = [(m.n_states, m.n_inputs, m.n_outputs) for m in (nominal, perturbed)]
    if sizes[0] != sizes[1]:
        found = "perturbed has {} states, {} inputs, {} outputs".format(*sizes[1])
        raise InputError(where, found, "{}, {}, {} as nominal".format(*sizes[0]))
    if nominal.dt != perturbed.dt:
        found = f"nominal has dt = {nominal.dt:g} s, perturbed dt = {perturbed.dt:g} s"
        raise InputError(where, found, "equal sample times")
    names, units = list[str](), list[str]()
    for side in ("states", "inputs", "outputs"):
        for a, b in zip(getattr(nominal, side), getattr(perturbed, side), strict=True):
            if a.name != b.name:
                names.append(f"{side[:-1]} {a.name!r} of nominal is {b.name!r} in perturbed")
            elif a.unit and b.unit and a.unit != b.unit:
                units.append(f"{side[:-1]} {a.name}: nominal [{a.unit}], perturbed [{b.unit}]")
    error, expected = (InputError, "the same signals in the same order") if names else (UnitMismatch, "equal units")
    if lines := names or units:
        raise error(where, lines[0], expected, None, tuple(f"{where}: {line}" for line in lines[1:]))


@dataclass(frozen=True)
class Change:
    """One entry of A, B, C or D that differs."""

    matrix: str  # `"A"`, `"B"`, `"C"` or `"D"`
    # row, column: names of the signals; the entry is the gain from `column` to `row` (to its derivative, in A and B)
    row: str
    column: str
    first: float
    second: float

    @property
    def relative(self) -> float:
        """``(second - first) / |first|``; infinite where the first value is zero."""
        step = self.second - self.first
        return step / abs(self.first) if self.first else np.copysign(np.inf, step)

    def to_json(self) -> dict[str, object]:
        return {**vars(self), "relative": self.relative}


@dataclass(frozen=True)
class Difference(AllFields, Displayable):
    """The entries in which two models differ."""

    changes: tuple[Change, ...]  # one for each entry that differs
    entries: int  # number of entries of A, B, C and D
    status: Status = Status.CONVERGED  # all entries were compared

    quantities: ClassVar[Mapping[str, Any]] = {"count": "1", "entries": "1", "largest": "1"}

    @property
    def count(self) -> int:
        """Number of entries that differ."""
        return len(self.changes)

    @property
    def largest(self) -> float:
        """Largest relative change."""
        return max((abs(c.relative) for c in self.changes), default=0.0)

    def headline(self) -> str:
        return f"{self.count} of {self.entries} entries differ"

    def facts(self) -> Facts:
        change = f"{100 * self.largest:.4g} %" if self.changes else ""
        return [("differ", f"{self.count} of {self.entries} entries"), ("largest change", change)]

    def details(self) -> list[Part]:
        """Every entry that differs."""
        rows = [
            (f"{c.matrix}[{c.row}, {c.column}]", f"{c.first:.9g}", f"{c.second:.9g}", f"{100 * c.relative:+.4g} %")
            for c in self.changes
        ]
        return [Part("", ("entry", "first", "second", "change"), rows)]


def difference(first: StateSpaceModel, second: StateSpaceModel) -> Difference:
    """Return the entries that differ."""
    check_pair(first, second, "difference of two models")
    changes = []
    for name, rows, columns in (
        ("A", first.state_names, first.state_names),
        ("B", first.state_names, first.input_names),
        ("C", first.output_names, first.state_names),
        ("D", first.output_names, first.input_names),
    ):
        a, b = getattr(first, name), getattr(second, name)
        for i, j in np.argwhere(a != b):
            changes.append(Change(name, rows[i], columns[j], float(a[i, j]), float(b[i, j])))
    return Difference(tuple(changes), sum(getattr(first, name).size for name in "ABCD"))
