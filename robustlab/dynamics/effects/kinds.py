"""Effect classes: names of effects whose exact form is not determined."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

Where = Literal["joint", "path", "sensor"]
Quantity = Literal["level", "viscous", "stiffness", "force", "amplitude", "period", "delay", "factor"]

MEANINGS: Mapping[Quantity, str] = {
    "level": "work against the motion over the way, the level of a dry friction",
    "viscous": "work against the motion over the squared speed, the equivalent viscous coefficient",
    "stiffness": "slope of the force over the stroke",
    "force": "mean force against the positive direction, as of a load",
    "amplitude": "amplitude",
    "period": "period",
    "delay": "total lateness at low frequency",
    "factor": "factor of the path from input to sensor",
}


@dataclass(frozen=True)
class Kind:
    """A class of effects."""

    id: str
    title: str
    where: Where
    wider: str | None = None
    quantities: tuple[Quantity, ...] = ()
    form: str = ""


_TABLE = tomllib.loads(Path(__file__).with_name("kinds.toml").read_text(encoding="utf-8"))
# Effect -> its class.
KIND_OF: Mapping[str, str] = {effect: kind for kind, row in _TABLE.items() for effect in row.pop("effects", ())}
KINDS: Mapping[str, Kind] = {
    kind: Kind(kind, quantities=tuple(row.pop("quantities", ())), **row) for kind, row in _TABLE.items()
}


def upwards(kind: str) -> Iterator[Kind]:
    """Yield a class and its parents, narrowest first."""
    at: str | None = kind
    while at is not None:
        yield KINDS[at]
        at = KINDS[at].wider
