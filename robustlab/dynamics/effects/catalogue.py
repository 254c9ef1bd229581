"""The catalogue: what the modules of this folder hold as ``EFFECTS``, or one alone as ``EFFECT``. A new file is found
without being named.
"""

from __future__ import annotations

import pkgutil
from functools import cache
from importlib import import_module

from robustlab.dynamics import effects
from robustlab.dynamics.effects.contract import Effect
from robustlab.errors import InputError, unknown_name

_ADDED: dict[str, Effect] = {}


def catalogue() -> dict[str, Effect]:
    """Id -> effect, in the order of their ids."""
    return dict(sorted({**_own(), **_ADDED}.items()))


def add_effect(added: Effect) -> None:
    """Put an effect of your own into the catalogue of this process; one of the same id that was added before goes."""
    if not isinstance(added, Effect):
        raise InputError("add_effect", f"{added!r}", "an instance of a class derived from Effect")
    for attribute in ("id", "title", "equation", "site_kind"):
        if not isinstance(getattr(added, attribute, None), str):
            raise InputError(f"add_effect: {type(added).__name__}", f"no {attribute}", f"a text as its {attribute}")
    if added.id in _own():
        raise InputError("add_effect", f"the id {added.id!r}, which robustlab's own catalogue has", "an id of its own")
    _ADDED[added.id] = added


@cache
def _own() -> dict[str, Effect]:
    """The effects of this folder."""
    found: dict[str, Effect] = {}
    for module in pkgutil.iter_modules(effects.__path__):
        held = vars(import_module(f"{effects.__name__}.{module.name}"))
        for candidate in (*held.get("EFFECTS", ()), *([held["EFFECT"]] if "EFFECT" in held else ())):
            if candidate.id in found:
                where = f"effects/{module.name}.py"
                raise InputError(where, f"the id {candidate.id!r}, which another effect has", "its own id")
            found[candidate.id] = candidate
    return found


def effect(name: str) -> Effect:
    """The effect with this id."""
    known = catalogue()
    if name not in known:
        raise unknown_name(f"effect {name!r}", "no such effect", name, known)
    return known[name]


def effect_names() -> tuple[str, ...]:
    """Ids of all effects of the catalogue."""
    return tuple(catalogue())
