"""What every result has: a status, and a way to become plain JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import Any

from robustlab.provenance import Traced
from robustlab.shown import Facts, Shown, in_words


class Status(StrEnum):
    """How much a number can be trusted; only CERTIFIED and CONVERGED may end in exit code 0.

    CERTIFIED
        The value was re-derived from its evidence outside the solver: it is a proof up to stated rounding.
    CONVERGED
        The method ended as intended and its value was re-evaluated; it is not a proof of optimality.
    INACCURATE
        There is a value, but digits were lost; the evidence says how many.
    INFEASIBLE
        It was shown that no solution exists; the evidence says why.
    INCONCLUSIVE
        Neither a value nor an impossibility could be shown, or the work budget ended a search before its end; a larger
        effort may do.
    TIMEOUT
        The user's time limit ended the search; what was proved by then is kept. It depends on the machine and its load:
        not repeatable.
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
        """True for CERTIFIED and CONVERGED."""
        return self in (Status.CERTIFIED, Status.CONVERGED)


def least_trusted(statuses: Sequence[Status]) -> Status:
    """The status that says least; it is that of several results together."""
    return max(statuses, key=list(Status).index)


def plain(value: Any) -> Any:
    """``value`` as JSON types: arrays become nested lists, complex numbers ``{"re": .., "im": ..}``.

    Infinities and NaN become the strings ``"inf"``, ``"-inf"``, ``"nan"``: JSON has no such numbers, and null would
    hide them.
    """
    if value is None or isinstance(value, (bool, str)):
        return value.value if isinstance(value, Enum) else value
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, int):
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
class Result(Shown, Traced):
    """A result as it comes back from a file: what kind of result it was, its status, and its data.

    Attributes
    ----------
    type
        Class of the result that was saved, for example ``"Margin"``.
    status
        Its status.
    data
        What its ``to_json`` gave; arrays are numpy arrays.
    """

    type: str
    status: Status
    data: Mapping[str, Any]

    def facts(self) -> Facts:
        """The type that it was saved from, and its data in a few words each."""
        told = [(name, in_words(value)) for name, value in self.data.items() if name not in ("status", "type")]
        return [("type", self.type), *told]

    def to_json(self) -> dict[str, Any]:
        """The data with type and status."""
        return {"type": self.type, **self.data, "status": self.status}


@dataclass(frozen=True)
class Evidence(Shown):
    """Base of the parts of a result: arrays, also those in tables, become read-only when it is made."""

    def __post_init__(self) -> None:
        import numpy as np  # not at the top: the command line asks for a status without it

        for value in vars(self).values():
            for item in value.values() if isinstance(value, Mapping) else (value,):
                if isinstance(item, np.ndarray):
                    item.setflags(write=False)

    def to_json(self) -> dict[str, object]:
        """All fields."""
        return dict(vars(self))


@dataclass(frozen=True, eq=False)
class Bracket(Shown):
    """Two bounds of one number, where it is attained, and how far both can be trusted: base of a question's results.

    Attributes
    ----------
    lower, upper
        ``lower <= number <= upper``; a class says which of them is proved, and which attained.
    frequency
        Where it is attained, rad/s; None where that is unknown or has no meaning.
    status
        CERTIFIED where both were re-derived from their evidence.
    """

    lower: float
    upper: float
    frequency: float | None
    status: Status
