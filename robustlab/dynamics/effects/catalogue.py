"""The catalogue of effects; `add_effect` extends it for the duration of the process."""

from __future__ import annotations

from robustlab.dynamics.effects import friction_effects, load_effects, parameter_effects, signal_effects, spring_effects
from robustlab.dynamics.effects.contract import OWN, Effect
from robustlab.errors import InputError, unknown_name

__all__ = ["friction_effects", "load_effects", "parameter_effects", "signal_effects", "spring_effects"]  # they fill OWN
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
