"""Common parts of results: the status, the conversion to plain JSON, and tables for pandas."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum, StrEnum
from typing import TYPE_CHECKING, Any, ClassVar

from robustlab.display import AllFields, Displayable, Facts, in_words
from robustlab.errors import require_package
from robustlab.provenance import Traced

if TYPE_CHECKING:
    import numpy as np
    import pandas


class Status(StrEnum):
    """How far a number can be trusted; only CERTIFIED and CONVERGED may end in exit code 0.

    CERTIFIED
        The value was re-derived from its evidence outside the solver: it is proved up to stated rounding.
    CONVERGED
        The method ended as intended and its value was re-evaluated; optimality is not proved.
    INACCURATE
        There is a value, but digits were lost; see the evidence.
    INFEASIBLE
        No solution exists, as the evidence shows.
    INCONCLUSIVE
        Neither a value nor an impossibility could be shown, or the work budget ended the search; a larger effort may
        succeed.
    TIMEOUT
        The user's time limit ended the search; the bounds proved by then are kept. The result depends on the machine
        and its load.
    FAILED
        The method broke down; there is no value.
    """

    CERTIFIED = "certified"
    CONVERGED = "converged"
    INACCURATE = "inaccurate"
    INFEASIBLE = "infeasible"
    INCONCLUSIVE = "inconclusive"
    TIMEOUT = "timeout"
    FAILED = "failed"

    @property
    def trustworthy(self) -> bool:
        """Return whether CERTIFIED or CONVERGED."""
        return self in (Status.CERTIFIED, Status.CONVERGED)


def least_trusted(statuses: Sequence[Status]) -> Status:
    """Return the least trusted status, which is that of several results together."""
    return max(statuses, key=list(Status).index)


def plain(value: Any) -> Any:
    """Convert ``value`` to JSON types: arrays become nested lists, complex numbers ``{"re": .., "im": ..}``."""
    if isinstance(value, Enum):
        return value.value
    if value is None or isinstance(value, (bool, str, int)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    if isinstance(value, complex):
        return {"re": plain(value.real), "im": plain(value.imag)}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(item) for item in value]
    if hasattr(value, "to_json"):
        return plain(value.to_json())
    if hasattr(value, "tolist"):  # numpy arrays and scalars, without importing numpy
        return plain(value.tolist())
    raise TypeError(f"{type(value).__name__} has no plain form")


@dataclass(frozen=True)
class Result(Displayable, Traced):
    """A result read from a file: its type, its status, and its data."""

    type: str  # class of the result that was saved, for example ``"Margin"``
    status: Status
    data: Mapping[str, Any]  # the result of its ``to_json``; arrays are numpy arrays

    def facts(self) -> Facts:
        rows = [(name, in_words(value)) for name, value in self.data.items() if name not in ("status", "type")]
        return [("type", self.type), *rows]

    def to_json(self) -> dict[str, Any]:
        return {"type": self.type, **self.data, "status": self.status}


@dataclass(frozen=True)
class Evidence(Displayable, AllFields):
    """Base of the parts of a result: its arrays, also those in tables, are read-only."""

    def __post_init__(self) -> None:
        import numpy as np  # not at the top: the command line needs a status without it

        for value in vars(self).values():
            for item in value.values() if isinstance(value, Mapping) else (value,):
                if isinstance(item, np.ndarray):
                    item.setflags(write=False)


class Typed:
    """Base of results whose JSON has their type and their fields."""

    unsaved: ClassVar[tuple[str, ...]] = ()  # fields that `to_json` leaves out
    derived: ClassVar[tuple[str, ...]] = ()  # properties that it adds

    def to_json(self) -> dict[str, Any]:
        names = (*(name for name in vars(self) if name not in self.unsaved), *self.derived)
        return {"type": type(self).__name__, **{name: getattr(self, name) for name in names}}


@dataclass(frozen=True, eq=False)
class Bracket(Typed, Displayable):
    """Two bounds of one number, where it is attained, and how far both can be trusted."""

    # ``lower <= number <= upper``; a class defines which of them is proved, and which attained
    lower: float
    upper: float
    frequency: float | None  # where it is attained, rad/s; None where unknown or without meaning
    status: Status  # CERTIFIED where both were re-derived from their evidence


@dataclass(frozen=True)
class Table:
    """Columns over one index."""

    index: tuple[str, Sequence[Any] | np.ndarray]  # its name, and its values or names, (n,)
    columns: Mapping[str, Sequence[Any] | np.ndarray]  # name -> values, (n,)
    units: Mapping[str, str] = field(default_factory=dict)  # name of the index or of a column -> unit, if any


class Tabular:
    """Base of results that are tables."""

    def table(self) -> Table:
        """Return the result as columns with units over one index."""
        raise NotImplementedError

    def to_pandas(self) -> pandas.DataFrame:
        """Return the result as a data frame of pandas (extra ``frames``), with units in ``attrs["units"]``."""
        require_package(f"{type(self).__name__}.to_pandas", "pandas", "frames")
        import pandas

        table = self.table()
        name, values = table.index
        frame = pandas.DataFrame(dict(table.columns), index=pandas.Index(values, name=name))
        frame.attrs = {"units": dict(table.units)}
        return frame
