"""The kinds of systems, and the call of a kind's own method with the options that it has.

A table of a question has a row for each kind: the method, in its own package and imported on first use, and its
options, each ``name`` or ``name=own name``.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

from robustlab.delays.model import DelayedModel
from robustlab.display import listed
from robustlab.errors import InputError
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.frequency_responses import UncertainFrequencyData
from robustlab.uncertainty.lft import UncertainModel

MODEL, SET, DELAYED = "a model", "an uncertain model", "a model with exact delays"
NATURES, FREQUENCIES, LPV, EFFECTS = "blocks with natures", "given frequencies", "an LPV model", "a plant with effects"


def kind_of(*systems: Any, natures: Any = None, frequency: Any = None) -> str:
    """Return the kind of a problem about these systems."""
    if natures is not None:
        return NATURES
    if frequency is not None or any(isinstance(one, UncertainFrequencyData) for one in systems):
        return FREQUENCIES
    if any(isinstance(one, DelayedModel) for one in systems):
        return DELAYED
    if any(isinstance(one, UncertainModel) for one in systems):
        return SET
    if not isinstance(systems[0], StateSpaceModel):
        # These packages load slowly and are rarely needed.
        from robustlab.dynamics.extended.extended_plant import ExtendedPlant
        from robustlab.synthesis.scheduling.parameter_varying import LPVModel

        return LPV if isinstance(systems[0], LPVModel) else EFFECTS if isinstance(systems[0], ExtendedPlant) else MODEL
    return MODEL


def ask(
    question: str, kinds: Mapping[str, tuple[str, str]], kind: str, systems: tuple[Any, ...], given: Mapping[str, Any],
    hints: Mapping[str, str], **common: Any,
) -> Any:  # fmt: skip
    """Call the method of a kind with the options that were given (not None); reject those that it does not have.

    ``common``: passed where the method has them. ``hints``: of an option, or of a kind.
    """
    method, options = kinds.get(kind, kinds[MODEL])  # which says what it expects
    own = dict((word.split("=") * 2)[:2] for word in options.split())
    chosen = {own[name]: value for name, value in common.items() if name in own}
    for name, value in given.items():
        if value is None:
            continue
        if name not in own:
            having = listed((k for k, (_, text) in kinds.items() if name in text.replace("=", " ").split()), len(kinds))
            hint = hints.get(name) or hints.get(kind)
            raise InputError(f"{question}: {name}", f"given for {kind}", f"it for {having}", hint)
        chosen[own[name]] = value
    module, _, function = method.rpartition(".")
    return getattr(import_module(f"robustlab.{module}"), function)(*systems, **chosen)
