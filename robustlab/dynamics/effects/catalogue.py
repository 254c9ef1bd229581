"""The catalogue of effects, which `add_effect` extends for this process, and classes of effects of no exact form."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from robustlab.dynamics.effects import friction_effects, parameter_effects, spring_effects
from robustlab.dynamics.effects.effect import OWN, Effect
from robustlab.errors import InputError, unknown_name

__all__ = ["friction_effects", "parameter_effects", "spring_effects"]  # they fill OWN
_ADDED: dict[str, Effect] = {}


def catalogue() -> dict[str, Effect]:
    """Return id -> effect, sorted by id."""
    return dict(sorted({**OWN, **_ADDED}.items()))


def add_effect(added: Effect) -> None:
    """Add an effect of your own to the catalogue of this process; replace an added one of the same id."""
    if not isinstance(added, Effect):
        raise InputError("add_effect", f"{added!r}", "an instance of a class derived from Effect")
    for attribute in ("id", "title", "equation", "site_kind"):
        if not isinstance(getattr(added, attribute, None), str):
            raise InputError(f"add_effect: {type(added).__name__}", f"no {attribute}", f"a text as its {attribute}")
    if added.id in OWN:
        raise InputError("add_effect", f"the id {added.id!r}, which robustlab's own catalogue has", "an id of its own")
    _ADDED[added.id] = added


def effect(name: str) -> Effect:
    """Return the effect with this id."""
    known = catalogue()
    if name not in known:
        raise unknown_name(f"effect {name!r}", "no such effect", name, known)
    return known[name]


Quantity = Literal["level", "viscous", "stiffness", "force", "amplitude", "period", "delay", "factor"]

MEANINGS: Mapping[Quantity, str] = {
    "level": "work against the motion over the way, the level of a dry friction",
    "viscous": "work against the motion over the squared speed, the equivalent viscous coefficient",
    "stiffness": "slope of the force over the stroke",
    "force": "mean force against the positive direction, as of a load",
    "amplitude": "amplitude",
    "period": "period",
    "delay": "total time delay at low frequency",
    "factor": "factor of the path from input to sensor",
}


@dataclass(frozen=True)
class Kind:
    """A class of effects."""

    id: str
    title: str
    where: Literal["joint", "path", "sensor"]
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
