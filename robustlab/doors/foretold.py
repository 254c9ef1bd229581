"""What is known of a recipe's steps before anything runs: names and units of signals, and what requirements may ask."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import robustlab as rl


@dataclass(frozen=True)
class Foretold:
    """What is known of a step before it runs; None: nothing."""

    value: Any = None  # what later steps get, where it is there without a computation: a plant of ours, a file's object
    # Signals of what later steps get: name -> unit.
    inputs: Mapping[str, str] | None = None
    outputs: Mapping[str, str] | None = None
    leaves: Any = ...  # what requirements may refer to, where that depends on more than the kind of step

    @classmethod
    def of(cls, value: Any, leaves: Any = ...) -> Foretold:
        """What is known of a step whose value is there."""
        if isinstance(value, rl.Record):
            inputs, outputs = ({n: value.unit(n) for n in side} for side in (value.inputs, value.outputs))
            return cls(value, inputs, outputs, leaves)
        model = getattr(value, "K", value)  # a controller is kept with what it was designed for
        return cls(value, _units(getattr(model, "inputs", None)), _units(getattr(model, "outputs", None)), leaves)

    def select(self, outputs: Sequence[str] | None) -> Foretold:
        """The same signals for a value that has yet to be made, with the outputs that are kept."""
        if outputs is None or self.outputs is None:
            return Foretold(None, self.inputs, self.outputs)
        return Foretold(None, self.inputs, {name: self.outputs.get(name, "") for name in outputs})


def _units(signals: Any) -> dict[str, str] | None:
    known = isinstance(signals, tuple) and all(isinstance(s, rl.Signal) for s in signals)
    return {s.name: s.unit for s in signals} if known else None


@dataclass
class Ahead:
    """What is known before anything runs: the files that steps read, and what each step before this one foretells."""

    sources: Mapping[str, Path]  # as in `Workspace`
    steps: dict[str, Foretold] = field(default_factory=dict)
    step: str = ""  # name of the step that is asked now

    def __getitem__(self, name: str | None) -> Foretold:
        return self.steps.get(name or "", Foretold())
