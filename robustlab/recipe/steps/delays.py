"""The step that covers a model with delays and neglected lags."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

import robustlab as rl
from robustlab.delays.neglected import PROOFS
from robustlab.errors import InputError
from robustlab.recipe.steps.contract import Fact, Outcome, Step, Workspace, step
from robustlab.recipe.steps.models import UNCERTAIN, same_signals, uncertain_numbers
from robustlab.recipe.steps.vocabulary import Names, Positive, ToModel

Delay = (
    Annotated[float, Field(ge=0)] | Annotated[list[Annotated[float, Field(ge=0)]], Field(min_length=2, max_length=2)]
)
Delays = dict[str, Delay]
Longest = dict[str, Positive]


@step
class DelaysStep(Step):
    """Delays at the signals of a model, exact, in a range, or left out of it: a set that holds it with all of them.

    What is proved of the set is proved of the model with its exact delays, at all frequencies.
    """

    gives: ClassVar[str] = "uncertain"
    leaves: ClassVar[Any] = UNCERTAIN
    do: Literal["delays"]
    of: ToModel
    inputs: Annotated[Delays, Names("inputs")] = Field(
        {}, description="Input -> its delay in s, or [shortest, longest]."
    )
    outputs: Annotated[Delays, Names("outputs")] = Field(
        {}, description="Output -> its delay in s, or [shortest, longest]."
    )
    neglected_delays: Annotated[Longest, Names("inputs")] = Field(
        {}, description="Input -> the longest delay in s that its model leaves out; a weight covers all up to it."
    )
    neglected_lags: Annotated[Longest, Names("inputs")] = Field(
        {}, description="Input -> the longest time constant in s of a lag that its model leaves out; likewise."
    )
    order: Annotated[int, Field(ge=0, le=40)] = Field(3, description="Of the Padé approximations.")
    weight_order: Annotated[int, Field(ge=1, le=81)] = Field(3, description="Of the weight of their error.")

    foretell = same_signals

    def run(self, work: Workspace) -> Outcome:
        from robustlab.delays import uncertain_delays

        given = work.values[self.of]
        found = uncertain_delays(
            rl.linearise(given) if hasattr(given, "parameters") else given,
            self.inputs,
            self.outputs,
            self.order,
            self.weight_order,
        )
        facts = [Fact(b.name, f"{b.rows} channels", b.origin) for b in found.blocks if b.origin]
        for kind, longest in (("delay", self.neglected_delays), ("lag", self.neglected_lags)):
            for name, length in longest.items():
                weight = rl.neglected_dynamics(**{kind: length})
                found = _neglecting(found, name, weight, f"{name}: neglected {kind}")
                facts.append(Fact(f"{name}: neglected {kind}", f"up to {length:g} s", PROOFS[kind]))
        note = "The errors are bounded for all frequencies: what is proved holds for the exact delays and lags."
        numbers = uncertain_numbers(found)
        return Outcome(found, f"{self.of} with delays, covered.", numbers, tuple(facts), rl.Status.CERTIFIED, (note,))


def _neglecting(found: rl.UncertainModel, name: str, weight: rl.StateSpaceModel, block: str) -> rl.UncertainModel:
    """The set behind ``1 + W Delta`` at one of its inputs."""
    known = [s.name for s in found.inputs]
    if name not in known:
        raise InputError(f"delays: input {name!r}", "no such signal", f"one of {', '.join(known)}")
    column = np.eye(len(known))[:, [known.index(name)]]
    through = rl.StateSpaceModel([], [], [], np.eye(len(known)), 0.0, found.inputs, found.inputs)
    return found @ rl.unstructured(through, weight @ column.T, "input-multiplicative", W1=column, name=block)
