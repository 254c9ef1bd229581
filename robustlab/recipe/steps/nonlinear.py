"""Steps that prove gains of loops with nonlinear and time-varying blocks, and find anti-windup gains."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field

import robustlab as rl
from robustlab.recipe.steps.contract import Fact, Outcome, Step, Workspace, quantity, step
from robustlab.recipe.steps.vocabulary import (
    GUARD,
    Effort,
    Positive,
    Text,
    TimeLimit,
    ToController,
    ToModel,
    ToPlantOrFile,
)

if TYPE_CHECKING:
    from robustlab.iqc import IqcGain, Nature

NATURE = (
    "Block, or OUTPUT:INPUT between two signals -> what is there: varying[:RATE], saturation, dead-zone[:SIZE:REACH], "
    "friction:LEVEL:SPEED, sector:LOW:HIGH, slope:LOW:HIGH, odd-slope:LOW:HIGH."
)
FilterOrder = Annotated[int, Field(ge=0, le=8)]


class NonlinearStep(Step):
    """What steps with such blocks share."""

    of: ToModel
    nature: dict[str, Text] = Field({}, description=NATURE)
    order: FilterOrder = Field(2, description="Order of the multipliers' filters.")
    effort: Effort = Field(1.0, description="Multiple of the usual work of the proof.")
    time_limit: TimeLimit | None = Field(None, description=GUARD)

    def natures(self, work: Workspace) -> dict[Any, Nature]:
        """The natures of the step's blocks."""
        from robustlab.iqc.nature import natures_in_words

        blocks = [b.name for b in getattr(work.values[self.of], "blocks", ())]
        return natures_in_words(self.nature, f"step {work.step!r}: nature", blocks)


@step
class IqcGainStep(NonlinearStep):
    """Worst L2 gain, proved for blocks that are nonlinear, vary with time, or are uncertain."""

    do: Literal["iqc-gain"]
    inputs: list[Text] | None = Field(None, description="Inputs to keep; all where left out.")
    outputs: list[Text] | None = Field(None, description="Outputs to keep; all where left out.")

    def run(self, work: Workspace) -> Outcome:
        """Worst L2 gain by integral quadratic constraints, with both bounds."""
        found = rl.iqc_gain(
            work.values[self.of], self.natures(work), self.inputs, self.outputs, self.order, None, self.time_limit,
            self.effort,
        )  # fmt: skip
        work.keep(found)
        facts = [_gain("Worst L2 gain", found), *(Fact(name, text) for name, text in found.nature.items())]
        numbers = {"lower": found.lower, "upper": found.upper}
        text = f"Worst L2 gain of {self.of} over all blocks of their classes."
        return Outcome(None, text, numbers, tuple(facts), found.status, found.conditions)


@step
class IqcStabilityStep(NonlinearStep):
    """Stability, proved for blocks that are nonlinear, vary with time, or are uncertain."""

    do: Literal["iqc-stability"]

    def run(self, work: Workspace) -> Outcome:
        """Margin of stability by integral quadratic constraints."""
        found = rl.iqc_stability(
            work.values[self.of], self.natures(work), self.order, None, self.time_limit, self.effort
        )
        work.keep(found)
        facts = [Fact("Margin, proved", f"{quantity(found.margin)} of the set"),
                 *(Fact(name, text) for name, text in found.nature.items())]  # fmt: skip
        word = "proved stable" if found.stable else "not proved stable"
        numbers = {"margin": found.margin, "stable": found.stable}
        return Outcome(None, f"{self.of}: {word}.", numbers, tuple(facts), found.status, found.conditions)


@step
class EffectGainStep(Step):
    """Worst L2 gain of a loop with the plant's effects as nonlinearities, beside that of constant gains."""

    do: Literal["effect-gain"]
    of: ToPlantOrFile = Field(description="A plant with effects, a discover step, or the file of an updated plant.")
    controller: ToController
    outputs: list[Text] | None = Field(None, description="Outputs that the controller sees; all where left out.")
    amplitude: dict[str, Positive] = Field({}, description="Place of an effect -> bound of its signal.")
    stick_speed: dict[str, Positive] = Field({}, description="Joint -> speed below which dry friction is creep.")
    sign: Literal[-1, 1] = Field(-1, description="-1 for negative feedback, 1 for positive.")
    order: FilterOrder = Field(2, description="Order of the multipliers' filters.")
    effort: Effort = Field(1.0, description="Multiple of the usual work of the proof.")
    time_limit: TimeLimit | None = Field(None, description=GUARD)

    def run(self, work: Workspace) -> Outcome:
        """Proved gain with the effects as what they are, and the gain of the same ranges as constants."""
        found = rl.effect_gain(
            work.values[self.of], work.values[self.controller], self.outputs, self.amplitude, self.stick_speed,
            self.sign, self.order, self.time_limit, self.effort,
        )  # fmt: skip
        work.keep(found)
        facts = [_gain("Worst L2 gain", found.proved), Fact("As constant gains", quantity(found.as_constants.upper)),
                 *(Fact(name, text) for name, text in found.proved.nature.items())]  # fmt: skip
        numbers = {"lower": found.proved.lower, "upper": found.proved.upper, "as_constants": found.as_constants.upper}
        left = tuple(f"{name}: {why}" for name, why in found.left_out.items())
        text = f"Worst L2 gain of {self.of} with {self.controller}, its effects taken for what they are."
        return Outcome(None, text, numbers, tuple(facts), found.status, (*found.proved.conditions, *left))


@step
class AntiWindupStep(Step):
    """Static anti-windup gain of least proved L2 gain."""

    do: Literal["anti-windup"]
    of: ToModel = Field(description="The plant; u and y are its last inputs and outputs.")
    controller: ToController
    limits: dict[str, Annotated[list[float], Field(min_length=2, max_length=2)]] = Field(
        description="Limits [low, high] of each control signal."
    )
    reach: Annotated[float, Field(gt=1)] | None = Field(
        None, description="Bound of the demanded signal as a multiple of its limit; all signals where left out."
    )
    order: FilterOrder = Field(2, description="Order of the multipliers' filters.")
    effort: Effort = Field(1.0, description="Multiple of the usual work of the proof.")
    time_limit: TimeLimit | None = Field(None, description=GUARD)

    def run(self, work: Workspace) -> Outcome:
        """The gain, its proved L2 gain, and those without anti-windup and with back-calculation."""
        from robustlab.errors import InputError
        from robustlab.statespace import as_model

        K = as_model(work.values[self.controller], self.controller)
        if set(self.limits) != set(K.output_names):
            raise InputError(f"step {work.step!r}: limits", ", ".join(self.limits), ", ".join(K.output_names))
        found = rl.anti_windup(
            work.values[self.of], K, [tuple(self.limits[name]) for name in K.output_names], self.reach or math.inf,
            order=self.order, effort=self.effort, time_limit=self.time_limit,
        )  # fmt: skip
        work.keep(found)
        facts = (_gain("Worst L2 gain", found.proved), _gain("Without anti-windup", found.without),
                 _gain("Back-calculation", found.back), Fact("Never saturating", quantity(found.linear)))  # fmt: skip
        numbers = {"upper": found.proved.upper, "lower": found.proved.lower, "without": found.without.upper,
                   "back": found.back.upper, "linear": found.linear, "L": found.L.tolist()}  # fmt: skip
        text = f"Static anti-windup for {self.controller} at {self.of}."
        return Outcome(None, text, numbers, facts, found.status, found.proved.conditions)


def _gain(label: str, found: IqcGain) -> Fact:
    if math.isfinite(found.upper):
        return Fact(label, f"{quantity(found.upper)} (proved), {quantity(found.lower)} attained")
    return Fact(label, "a linear member is unstable" if math.isinf(found.lower) else "nothing proved")
