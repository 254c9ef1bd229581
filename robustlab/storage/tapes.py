"""Equations of nonlinear plants of somebody's own in a file: rows of numbers, in which there is no code."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from robustlab.dynamics.plant_contract import PortPlace
from robustlab.errors import InputError
from robustlab.files.tree import Tree, Unread, type_name
from robustlab.storage.matrices import Problems, entries, find_children

if TYPE_CHECKING:
    from robustlab.dynamics.symbolic.symbolic_plant import Equations
    from robustlab.dynamics.symbolic.tape import Tape

TAPES = ("rates", "outputs", "models")
ROWS = ("operations", "left", "right", "constants", "outputs")
KINDS = ("joint", "current")
PLACE = ("name", "kind", "unit", "position")


def encode_equations(tree: Tree, equations: Equations) -> None:
    """Groups ``rates``, ``outputs``, ``models`` and ``places``."""
    for name in TAPES:
        tape: Tape = getattr(equations, name)
        for row in ROWS:
            tree.group(name).put(row, getattr(tape, row))
    for field in PLACE:
        tree.group("places").put(field, np.array([getattr(p, field) for p in equations.places], np.str_))


def decode_equations(tree: Tree, n_moving: int, n_parameters: int, problems: Problems) -> Equations:
    """Inverse of `encode_equations`, for as many states and inputs, and parameters.

    Raises
    ------
    InputError
        All that is missing or of no such type; a tape that is none.
    """
    from robustlab.dynamics.symbolic.symbolic_plant import Equations
    from robustlab.dynamics.symbolic.tape import Tape

    find_children(tree, (*TAPES, "places"), problems, kind="group")
    problems.raise_any()
    for name in TAPES:
        find_children(tree.groups[name], ROWS, problems, kind="dataset")
    find_children(tree.groups["places"], PLACE, problems, kind="dataset")
    problems.raise_any()
    places = _places(tree.groups["places"], problems)
    tapes: list[Tape] = []
    for name in TAPES:
        group = tree.groups[name]
        rows = {row: group.datasets[row].values for row in ROWS}
        for row, values in rows.items():
            kinds = "fi" if row == "constants" else "i"
            wrong = isinstance(values, Unread) or (values.dtype.kind not in kinds and values.size)
            if isinstance(values, Unread) or wrong or values.ndim != 1:
                shape = "" if wrong else f" of shape {values.shape}"
                expected = "a row of numbers" if row == "constants" else "a row of integers"
                problems.add(f"{group.child_path(row)} is {type_name(values)}{shape}, expected {expected}")
        problems.raise_any()
        numbers: Any = {row: np.asarray(v, float if row == "constants" else int) for row, v in rows.items()}
        try:
            tapes.append(Tape(n_moving + n_parameters, **numbers, n_still=n_parameters))
        except InputError as error:
            where = error.where.removeprefix("tape").removeprefix(": ")
            path = group.child_path(where) if where in ROWS else group.path
            raise InputError(problems.file, f"{path}: {error.found}", error.expected) from None
    rates, outputs, models = tapes
    return Equations(rates, outputs, models, places)


def _places(group: Tree, problems: Problems) -> tuple[PortPlace, ...]:
    columns = [entries(group, field, "U", problems) for field in PLACE]
    problems.raise_any()
    lengths = {len(column or []) for column in columns}
    if len(lengths) > 1:
        problems.add(f"{group.path}: columns of {', '.join(map(str, sorted(lengths)))} entries, expected one length")
        problems.raise_any()
    places = tuple(PortPlace(*row) for row in zip(*(column or [] for column in columns), strict=True))
    for place in places:
        if place.kind not in KINDS:
            problems.add(f"{group.child_path('kind')}: {place.kind!r}, expected one of {', '.join(KINDS)}")
    if len({place.name for place in places}) < len(places):
        problems.add(f"{group.child_path('name')}: a place is there twice")
    problems.raise_any()
    return places
