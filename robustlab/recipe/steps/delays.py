"""A step with delays: a set that holds a model, or an uncertain one, with delays at its inputs and outputs."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

import robustlab as rl
from robustlab.recipe.steps.contract import Fact, Outcome, Step, Workspace, step
from robustlab.recipe.steps.models import uncertain_numbers
from robustlab.recipe.steps.vocabulary import ToModel

Delay = (
    Annotated[float, Field(ge=0)] | Annotated[list[Annotated[float, Field(ge=0)]], Field(min_length=2, max_length=2)]
)
Delays = dict[str, Delay]


@step
class DelaysStep(Step):
    """Delays at the signals of a model, exact or in a range: a set that holds it with all of them.

    What is proved of the set is proved of the model with its exact delays, at all frequencies.
    """

    gives: ClassVar[str] = "uncertain"
    do: Literal["delays"]
    of: ToModel
    inputs: Delays = Field({}, description="Input -> its delay in s, or [shortest, longest].")
    outputs: Delays = Field({}, description="Output -> its delay in s, or [shortest, longest].")
    order: Annotated[int, Field(ge=0, le=40)] = Field(3, description="Of the Padé approximations.")
    weight_order: Annotated[int, Field(ge=1, le=81)] = Field(3, description="Of the weight of their error.")

    def run(self, work: Workspace) -> Outcome:
        """A set with a block for what each approximation misses, proved to hold the exact delay."""
        given = work.values[self.of]
        found = rl.uncertain_delays(
            rl.linearise(given) if hasattr(given, "parameters") else given,
            self.inputs,
            self.outputs,
            self.order,
            self.weight_order,
        )
        facts = tuple(Fact(block.name, f"{block.rows} channels", block.origin) for block in found.blocks)
        note = "The error of each approximation is bounded for all frequencies: what is proved holds for exact delays."
        numbers = uncertain_numbers(found)
        return Outcome(found, f"{self.of} with delays, covered.", numbers, facts, rl.Status.CERTIFIED, (note,))
