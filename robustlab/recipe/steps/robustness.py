"""Steps that prove: norms, passivity, stability of a set, gains with nonlinear blocks; and anti-windup gains."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

import robustlab as rl
from robustlab.closing import closing, fed_back
from robustlab.iqc import IqcStability
from robustlab.mu_analysis.axis.margin import StabilityMargin
from robustlab.mu_analysis.axis.robust_gain import RobustGain
from robustlab.mu_analysis.margins.classical import ClassicalMargins
from robustlab.norms import HinfNorm
from robustlab.recipe.steps.contract import Fact, Outcome, Step, Workspace, picked, quantity, step, told
from robustlab.recipe.steps.vocabulary import (
    GUARD,
    Band,
    Effort,
    Feedback,
    Names,
    Positive,
    Text,
    TimeLimit,
    ToController,
    ToModel,
    ToPlantOrFile,
    ToUncertain,
    as_pair,
)

if TYPE_CHECKING:
    from robustlab.iqc import IqcGain, Nature

NORM = {"value": float, "frequency": "rad/s", "lower": float, "upper": float}
BOUNDS = {"lower": float, "upper": float}


@step
class HinfNormStep(Step):
    """H-infinity norm of a model."""

    leaves: ClassVar[Any] = NORM
    do: Literal["hinf-norm"]
    of: ToModel

    def run(self, work: Workspace) -> Outcome:
        return _peak(rl.hinf_norm(work.values[self.of]), "H-infinity norm", self.of)


@step
class LinfNormStep(Step):
    """L-infinity norm of a model, which may be unstable: its peak gain over the frequency axis, or in a band."""

    leaves: ClassVar[Any] = NORM
    do: Literal["linf-norm"]
    of: ToModel
    band: Band | None = Field(None, description="[low, high] in rad/s; all frequencies where left out.")

    def run(self, work: Workspace) -> Outcome:
        title = "L-infinity norm" if self.band is None else f"Peak gain from {self.band[0]:g} to {self.band[1]:g} rad/s"
        return _peak(rl.linf_norm(work.values[self.of], band=as_pair(self.band)), title, self.of)


def _peak(norm: HinfNorm, title: str, of: str) -> Outcome:
    numbers = picked(norm, *NORM)
    facts = (
        Fact(title, f"{quantity(norm.value, digits=8)} (at most {quantity(norm.upper, digits=8)})"),
        Fact("attained at", quantity(norm.frequency, "rad/s")),
    )
    return Outcome(None, f"{title} of {of}.", numbers, facts, norm.status)


@step
class H2NormStep(Step):
    """H2 norm of a model."""

    leaves: ClassVar[Any] = {"value": float, "integral": float}
    do: Literal["h2-norm"]
    of: ToModel

    def run(self, work: Workspace) -> Outcome:
        norm = rl.h2_norm(work.values[self.of])
        facts = [Fact("H2 norm, by the Gramians", quantity(norm.value, digits=8))]
        if norm.integral is not None:
            facts.append(Fact("by the integral over frequency", quantity(norm.integral, digits=8)))
        numbers = picked(norm, *self.leaves)
        return Outcome(None, f"H2 norm of {self.of}.", numbers, tuple(facts), norm.status)


@step
class PassivityStep(Step):
    """Relative passivity index of a square model, and its input and output index."""

    leaves: ClassVar[Any] = {
        "lower": "1", "upper": "1", "frequency": "rad/s", "passive": bool, "input_index": float, "output_index": float,
    }  # fmt: skip
    do: Literal["passivity"]
    of: ToModel = Field(description="A square model, input k belonging to output k.")

    def run(self, work: Workspace) -> Outcome:
        found = rl.passivity(work.values[self.of])
        numbers = picked(found, "lower", "upper", "frequency") | {"passive": found.passive}
        facts = [
            Fact("Relative index", f"{quantity(found.lower, digits=8)} (at most {quantity(found.upper, digits=8)})"),
            Fact("attained at", quantity(found.frequency, "rad/s")),
        ]
        for side, index in (("input", found.input_index), ("output", found.output_index)):
            numbers[f"{side}_index"] = None if index is None else index.lower
            if index is not None:
                facts.append(Fact(f"{side.capitalize()} index, at least", quantity(index.lower, digits=8)))
        word = {True: "passive", False: "not passive", None: "on the boundary of passivity, or not decided"}
        return Outcome(None, f"{self.of} is {word[found.passive]}.", numbers, tuple(facts), found.status)


@step
class RobustStabilityStep(Step):
    """Robust stability margin over the whole frequency axis, with its mu bounds."""

    leaves: ClassVar[Any] = StabilityMargin.quantities
    do: Literal["robust-stability"]
    of: ToUncertain
    effort: Effort = Field(1.0, description="Multiple of the usual work of the proof.")
    time_limit: TimeLimit | None = Field(None, description=GUARD)

    def run(self, work: Workspace) -> Outcome:
        from robustlab.linear_analysis.frequency import default_grid
        from robustlab.report.robustness_figures import mu_figure, shares_figure

        uncertain = work.uncertain(self.of)
        grid = default_grid(uncertain.M, 60) if uncertain.M.n_states else None
        margin: Any = rl.robust_stability(
            uncertain, omega=grid, effort=self.effort, time_limit=self.time_limit, seed=work.seed
        )
        work.draw(
            mu_figure(margin),
            "mu",
            "Bounds of μ over frequency. The proved margin is the inverse of the highest shaded level.",
        )
        if margin.shares:
            caption = "What each block weighs in the margin: the one on top is to be tightened first."
            work.draw(shares_figure(margin.shares), "shares", caption)
        return told(margin, None, f"{self.of}: {margin.headline()}.", margin.numbers(), work)


@step
class RobustnessAtStep(Step):
    """Margin, or worst-case gain, at given frequencies; nothing is claimed between them."""

    leaves: ClassVar[Any] = {**BOUNDS, "frequency": "rad/s"}
    do: Literal["robustness-at"]
    of: ToUncertain = Field(description="An uncertain model, or a file with frequency-response data.")
    controller: ToController | None = Field(None, description="Closes the loop, u = sign K y.")
    sign: Feedback = None
    frequency: list[Annotated[float, Field(ge=0)]] | None = Field(None, description="rad/s; data have their own.")
    what: Literal["margin", "gain"] = Field("margin", description="Stability margin, or largest gain.")

    def run(self, work: Workspace) -> Outcome:
        system = work.values[self.of]
        said = ""
        if self.controller is not None:
            around, sign, said = fed_back(system, work.values[self.controller], self.sign, self.of, None)
            system = system.feedback(around, sign)
        if self.what == "margin":
            margin = rl.robust_stability(system, frequency=self.frequency, seed=work.seed)
            text = f"{self.of}: {margin.headline()}."
            outcome = told(margin, None, text, picked(margin, *self.leaves), work)
            return replace(outcome, facts=(Fact("Loop", said), *outcome.facts)) if said else outcome
        found = rl.worst_case_gain_at(system, self.frequency, seed=work.seed)
        work.keep(found)
        k = int(np.argmax(found.upper))
        numbers = {"lower": float(found.lower[k]), "upper": float(found.upper[k]), "frequency": float(found.omega[k])}
        facts = tuple(Fact(label, text) for label, text in [("loop", said), *found.facts()] if text)
        text = f"{self.what} of {self.of} at {len(found.omega)} frequencies; nothing is claimed between them."
        return Outcome(None, text[0].upper() + text[1:], numbers, facts, found.status, (found.assumed,))


@step
class RobustGainStep(Step):
    """How much of the set keeps every member's gain below a level."""

    leaves: ClassVar[Any] = RobustGain.quantities
    do: Literal["robust-gain"]
    of: ToUncertain
    level: float = Field(gt=0, description="The gain, in the unit of the outputs over that of the inputs.")
    effort: Effort = Field(1.0, description="Multiple of the usual work of the proof.")
    time_limit: TimeLimit | None = Field(None, description=GUARD)

    def run(self, work: Workspace) -> Outcome:
        uncertain = work.uncertain(self.of)
        found = rl.robust_gain(uncertain, self.level, effort=self.effort, time_limit=self.time_limit, seed=work.seed)
        return told(found, None, f"{self.of}: {found.headline()}.", found.numbers(), work)


@step
class ClassicalMarginsStep(Step):
    """Gain, phase and delay margin of each loop alone."""

    leaves: ClassVar[Any] = ClassicalMargins.quantities
    do: Literal["classical-margins"]
    of: ToModel = Field(description="The open loop, square.")
    sign: Feedback = None

    def run(self, work: Workspace) -> Outcome:
        found = rl.classical_margins(work.values[self.of], sign=self.sign)
        return told(found, None, f"{self.of}: {found.headline()}.", found.numbers(), work)


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

    leaves: ClassVar[Any] = BOUNDS
    do: Literal["iqc-gain"]
    inputs: Annotated[list[Text], Names("inputs")] | None = Field(
        None, description="Inputs to keep; all where left out."
    )
    outputs: Annotated[list[Text], Names("outputs")] | None = Field(
        None, description="Outputs to keep; all where left out."
    )

    def run(self, work: Workspace) -> Outcome:
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

    leaves: ClassVar[Any] = IqcStability.quantities
    do: Literal["iqc-stability"]

    def run(self, work: Workspace) -> Outcome:
        options = {"order": self.order, "time_limit": self.time_limit, "effort": self.effort}
        found = rl.robust_stability(work.values[self.of], natures=self.natures(work), **options)
        return told(found, None, f"{self.of}: {found.headline()}.", found.numbers(), work)


@step
class EffectGainStep(Step):
    """Worst L2 gain of a loop with the plant's effects as nonlinearities, beside that of constant gains."""

    leaves: ClassVar[Any] = {**BOUNDS, "as_constants": float}
    do: Literal["effect-gain"]
    of: ToPlantOrFile = Field(description="A plant with effects, a discover step, or the file of an updated plant.")
    controller: ToController
    outputs: Annotated[list[Text], Names("outputs")] | None = Field(
        None, description="Outputs that the controller sees; all where left out."
    )
    amplitude: dict[str, Positive] = Field({}, description="Place of an effect -> bound of its signal.")
    stick_speed: dict[str, Positive] = Field({}, description="Joint -> speed below which dry friction is creep.")
    sign: Feedback = None
    order: FilterOrder = Field(2, description="Order of the multipliers' filters.")
    effort: Effort = Field(1.0, description="Multiple of the usual work of the proof.")
    time_limit: TimeLimit | None = Field(None, description=GUARD)

    def run(self, work: Workspace) -> Outcome:
        plant, k = work.values[self.of], work.values[self.controller]
        base = getattr(getattr(plant, "plant", None), "state_space", None)
        sign = self.sign
        if base is not None:
            sign = closing(base().select(None, self.outputs), k, sign, self.of, None).sign
        found = rl.effect_gain(
            plant, k, self.outputs, self.amplitude, self.stick_speed, sign, self.order, self.time_limit, self.effort,
        )  # fmt: skip
        work.keep(found)
        facts = [Fact("Loop", found.loop), _gain("Worst L2 gain", found.proved),
                 Fact("As constant gains", quantity(found.as_constants.upper)),
                 *(Fact(name, text) for name, text in found.proved.nature.items())]  # fmt: skip
        numbers = {"lower": found.proved.lower, "upper": found.proved.upper, "as_constants": found.as_constants.upper}
        left = tuple(f"{name}: {why}" for name, why in found.left_out.items())
        text = f"Worst L2 gain of {self.of} with {self.controller}, its effects taken for what they are."
        return Outcome(None, text, numbers, tuple(facts), found.status, (*found.proved.conditions, *left))


@step
class AntiWindupStep(Step):
    """Static anti-windup gain of least proved L2 gain."""

    leaves: ClassVar[Any] = {**BOUNDS, "without": float, "back": float, "linear": float, "L": [[float]]}
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
        from robustlab.signals import law
        from robustlab.statespace import as_model

        K = as_model(work.values[self.controller], self.controller)
        if set(self.limits) != set(K.output_names):
            raise rl.InputError(f"step {work.step!r}: limits", ", ".join(self.limits), ", ".join(K.output_names))
        found = rl.anti_windup(
            work.values[self.of], K, [tuple(self.limits[name]) for name in K.output_names], self.reach or math.inf,
            order=self.order, effort=self.effort, time_limit=self.time_limit,
        )  # fmt: skip
        work.keep(found)
        loop = f"{law(K.inputs)}, as {self.controller} says" if law(K.inputs) else "u = K y; nothing else is said of it"
        facts = (Fact("Loop", loop), _gain("Worst L2 gain", found.proved), _gain("Without anti-windup", found.without),
                 _gain("Back-calculation", found.back), Fact("Never saturating", quantity(found.linear)))  # fmt: skip
        numbers = {"upper": found.proved.upper, "lower": found.proved.lower, "without": found.without.upper,
                   "back": found.back.upper, "linear": found.linear, "L": found.L.tolist()}  # fmt: skip
        text = f"Static anti-windup for {self.controller} at {self.of}."
        return Outcome(None, text, numbers, facts, found.status, found.proved.conditions)


def _gain(label: str, found: IqcGain) -> Fact:
    if math.isfinite(found.upper):
        return Fact(label, f"{quantity(found.upper)} (proved), {quantity(found.lower)} attained")
    return Fact(label, "a linear member is unstable" if math.isinf(found.lower) else "nothing proved")
