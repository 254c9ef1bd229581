"""The catalogue: every module of this folder that holds an ``EFFECT``. A new file is found without being named."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from pathlib import Path

from robustlab.dynamics.effects.effect_contract import Effect
from robustlab.errors import InputError, did_you_mean

__all__ = ["catalogue", "effect"]

# Modules of this folder that hold no effect.
MACHINERY = ("__init__", "catalogue", "effect_contract", "law_kernel", "port_model", "simulator", "extended_plant")


@cache
def catalogue() -> dict[str, Effect]:
    """Id -> effect, in the order of their ids.

    Raises
    ------
    InputError
        Two files with one id.
    """
    found: dict[str, Effect] = {}
    for file in sorted(Path(__file__).parent.glob("*.py")):
        if file.stem in MACHINERY:
            continue
        candidate = getattr(import_module(f"robustlab.dynamics.effects.{file.stem}"), "EFFECT", None)
        if candidate is None:
            continue
        if candidate.id in found:
            raise InputError(f"effects/{file.name}", f"the id {candidate.id!r}, which another file has", "its own id")
        found[candidate.id] = candidate
    return dict(sorted(found.items()))


def effect(name: str) -> Effect:
    """The effect with this id.

    Raises
    ------
    InputError
        No such effect (with the closest known id).
    """
    known = catalogue()
    if name not in known:
        raise InputError(
            f"effect {name!r}", "no such effect", f"one of {', '.join(known)}", did_you_mean(name, tuple(known))
        )
    return known[name]
