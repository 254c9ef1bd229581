"""Which entries of two models differ, told by the names of their signals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustlab.statespace import StateSpaceModel
from robustlab.storage.pairs import check_pair

__all__ = ["Change", "difference"]


@dataclass(frozen=True)
class Change:
    """One entry of A, B, C or D that differs.

    Attributes
    ----------
    matrix
        ``"A"``, ``"B"``, ``"C"`` or ``"D"``.
    row, column
        Names of the signals: the entry says how ``column`` acts on ``row`` (on its derivative, in A and B).
    first, second
        The two values.
    """

    matrix: str
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
        """All attributes and the relative change."""
        return {**vars(self), "relative": self.relative}


def difference(first: StateSpaceModel, second: StateSpaceModel, rtol: float = 0.0) -> tuple[Change, ...]:
    """Entries with ``|second - first| > rtol * max(|first|, |second|)``.

    Raises
    ------
    InputError
        The models have other sizes, signals, units or sample times; see `check_pair`.
    """
    check_pair(first, second, "difference of two models")
    rows = {"A": first.state_names, "B": first.state_names, "C": first.output_names, "D": first.output_names}
    columns = {"A": first.state_names, "B": first.input_names, "C": first.state_names, "D": first.input_names}
    changes = []
    for name in "ABCD":
        a, b = getattr(first, name), getattr(second, name)
        for i, j in np.argwhere(np.abs(b - a) > rtol * np.maximum(np.abs(a), np.abs(b))):
            changes.append(Change(name, rows[name][i], columns[name][j], float(a[i, j]), float(b[i, j])))
    return tuple(changes)
