"""Steps that prove: norms, passivity, stability of a set, gains with nonlinear blocks; and anti-windup gains."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import Field

import robustlab as rl
from robustlab.closing import closing, fed_back
from robustlab.doors.vocabulary import (
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
from robustlab.iqc import IqcStability
from robustlab.mu_analysis.axis.margin import StabilityMargin
from robustlab.mu_analysis.axis.robust_gain import RobustGain
from robustlab.mu_analysis.margins.classical import ClassicalMargins
from robustlab.norms import HinfNorm, PeakGain
from robustlab.recipe.steps.contract import Fact, Outcome, Step, Workspace, facts_of, picked, quantity, step, told

if TYPE_CHECKING:
    from robustlab.iqc import Nature

BOUNDS = PeakGain.quantities


@step
class HinfNormStep(Step):
    """H-infinity norm of a model."""

    leaves: ClassVar[Any] = HinfNorm.quantities
    do: Literal["hinf-norm"]
    of: ToModel

    def run(self, work: Workspace) -> Outcome:
        return _gain(rl.peak_gain(work.values[self.of], norm="hinf"), f"H-infinity norm of {self.of}.")


@step
class LinfNormStep(Step):
    """L-infinity norm of a model, which may be unstable: its peak gain over the frequency axis, or in a band."""

    leaves: ClassVar[Any] = HinfNorm.quantities
    do: Literal["linf-norm"]
    of: ToModel
    band: Band | None = Field(None, description="[low, high] in rad/s; all frequencies where left out.")

    def run(self, work: Workspace) -> Outcome:
        title = "L-infinity norm" if self.band is None else f"Peak gain from {self.band[0]:g} to {self.band[1]:g} rad/s"
        found = rl.peak_gain(work.values[self.of], norm="linf", band=as_pair(self.band))
        return _gain(found, f"{title} of {self.of}.")


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
        loop = [Fact("Loop", said)] if said else []
        if self.what == "gain":
            gain: Any = rl.peak_gain(system, frequency=self.frequency, seed=work.seed)
            work.keep(gain)
            text = f"Gain of {self.of} at {len(gain.omega)} frequencies; nothing is claimed between them."
            return _gain(gain, text, loop)
        margin = rl.robust_stability(system, frequency=self.frequency, seed=work.seed)
        outcome = told(margin, None, f"{self.of}: {margin.headline()}.", picked(margin, *self.leaves), work)
        return replace(outcome, facts=(*loop, *outcome.facts))


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
        found = rl.peak_gain(
            work.values[self.of], natures=self.natures(work), inputs=self.inputs, outputs=self.outputs,
            order=self.order, time_limit=self.time_limit, effort=self.effort,
        )  # fmt: skip
        work.keep(found)
        return _gain(found, f"Worst L2 gain of {self.of} over all blocks of their classes.")


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
        found = rl.peak_gain(
            plant, k, outputs=self.outputs, amplitude=self.amplitude, stick_speed=self.stick_speed, sign=sign,
            order=self.order, time_limit=self.time_limit, effort=self.effort,
        )  # fmt: skip
        work.keep(found)
        return _gain(found, f"Worst L2 gain of {self.of} with {self.controller}, its effects taken for what they are.")


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
        gains = {"Worst L2 gain": found.proved, "Without anti-windup": found.without, "Back-calculation": found.back}
        facts = (Fact("Loop", loop), *(Fact(label, gain.bounds()) for label, gain in gains.items()),
                 Fact("Never saturating", quantity(found.linear)))  # fmt: skip
        numbers = {"upper": found.proved.upper, "lower": found.proved.lower, "without": found.without.upper,
                   "back": found.back.upper, "linear": found.linear, "L": found.L.tolist()}  # fmt: skip
        text = f"Static anti-windup for {self.controller} at {self.of}."
        return Outcome(None, text, numbers, facts, found.status, found.proved.conditions)


def _gain(found: PeakGain, summary: str, loop: Sequence[Fact] = ()) -> Outcome:
    """A gain as it shows itself; what its bounds take for granted stands once, among the notes."""
    facts = tuple(fact for fact in facts_of(found) if fact.label not in ("Holds", "Note"))
    return Outcome(None, summary, found.numbers(), (*loop, *facts), found.status, (*found.conditions, *found.notes))
