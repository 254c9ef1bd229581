"""Steps on a machine that is read off its records: its map, what is fed forward, and how it follows with it."""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from robustlab.doors.vocabulary import Positive, RefersTo, Text, ToController, ToPlantOrFile, ToRecord
from robustlab.recipe.steps.contract import (
    Ahead,
    Fact,
    Foretold,
    Outcome,
    Step,
    Workspace,
    facts_of,
    quantity,
    step,
    told,
)

ToMachine = Annotated[str, RefersTo(("machine",))]
ToFeedForward = Annotated[str, RefersTo(("feed-forward",))]
ToRecordedRun = Annotated[str, RefersTo(("runs",))]
Records = Annotated[list[ToRecord], Field(min_length=1, max_length=100)]
Period = Annotated[Positive, Field(description="After which the machine repeats, in the position's unit; a turn.")]


@step
class MeasuredMachineStep(Step):
    """A machine of one axis read off its records place by place: inertia, friction, and a map over the position.

    No model, no named effect and no prior is in it: controllers that were designed on a named model are judged on it.
    Give it records that the naming did not see.
    """

    gives: ClassVar[str] = "machine"
    leaves: ClassVar[Any] = {
        "inertia": float, "viscous": float, "friction": float, "map": float, "left": float, "samples": "1",
        "waves": [float], "counts": ["1"],
    }  # fmt: skip
    do: Literal["measured-machine"]
    records: Records
    input: Text
    position: Text
    slowest: Positive = Field(description="Speed above which it surely moves.")
    fastest: Positive = Field(description="Speed above which samples are too far apart for the map.")
    period: Period = 2.0 * math.pi

    def run(self, work: Workspace) -> Outcome:
        """Numbers in units of the input: ``inertia``, ``viscous``, ``friction``, ``map`` (rms over a period), ``left``
        (rms of what the equation leaves), ``waves`` (the eight largest of the map) and ``counts`` (waves a period).
        """
        from robustlab.identification.validation.measured_machine import measured_machine
        from robustlab.report.machine_figures import map_figure

        records, speeds = [work.record(name) for name in self.records], (self.slowest, self.fastest)
        found = measured_machine(records, self.input, self.position, speeds, self.period)
        waves, unit, turn = found.waves(8), found.input.unit, self.period / (2.0 * math.pi)
        sizes, counts = [math.hypot(w.c, w.s) for w in waves], [round(w.k * turn) for w in waves]
        numbers = {
            "inertia": found.inertia, "viscous": found.viscous, "friction": found.friction,
            "map": float(found.table.std()), "left": found.left, "samples": found.samples, "waves": sizes,
            "counts": counts,
        }  # fmt: skip
        listed = ", ".join(f"{n}: {quantity(size, unit, 3)}" for n, size in zip(counts, sizes, strict=True))
        facts = (
            Fact("Inertia", quantity(found.inertia, f"{unit}/({found.position.unit}/s2)")),
            Fact("Dry friction", quantity(found.friction, unit)),
            Fact("Viscous friction", quantity(found.viscous, f"{unit}/({found.position.unit}/s)")),
            Fact("Map, rms", quantity(float(found.table.std()), unit)),
            Fact("Its largest waves, by their number a period", listed),
            Fact("Left over, rms", f"{quantity(found.left, unit)} of {found.samples} samples"),
        )
        work.draw(map_figure(found, {}), "map", "Input that each place needs, both ways alike.")
        kind = "simulated" if work.simulated.intersection(self.records) else "measured"
        return Outcome(found, f"A machine read off {len(records)} {kind} records.", numbers, facts)


@step
class FeedForwardStep(Step):
    """The input that a motion needs, told from its reference: of named effects, or of a machine's map and friction."""

    gives: ClassVar[str] = "feed-forward"
    leaves: ClassVar[Any] = {"largest": float, "waves": [float], "counts": ["1"], "dry": float, "left": float}
    do: Literal["feed-forward"]
    of: ToPlantOrFile | None = Field(None, description="A discover step, or a plant with effects.")
    machine: ToMachine | None = Field(None, description="In place of of: a measured-machine step.")
    waves: Annotated[int, Field(ge=1, le=60)] = Field(6, description="Of the machine's map: so many, the largest.")
    records: list[ToRecord] = Field([], description="With of and period: the records that the naming saw.")
    period: Positive | None = Field(
        None, description="With of: its waves are made whole numbers in this period, in phase with the records."
    )

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.of is None) == (self.machine is None):
            raise PydanticCustomError("one_source", "expected either of or machine")
        if (self.period is None) != (not self.records) or (self.period is not None and self.of is None):
            raise PydanticCustomError("together", "period and records belong together, and to of")
        return self

    def run(self, work: Workspace) -> Outcome:
        """Numbers in units of the input: ``largest``, a bound; ``waves`` (amplitudes) with ``counts`` in 2 pi of the
        position, ``dry``, the level of the dry friction, ``left``, what fitted intervals leave open of the largest.
        """
        import numpy as np

        from robustlab.dynamics.extended.feed_forward import feed_forward

        if self.machine is not None:
            found = work.values[self.machine].feed_forward(self.waves)
        else:
            found = feed_forward(work.values[str(self.of)])
        if self.period is not None:
            seen = np.concatenate([work.record(name).outputs[found.position.name] for name in self.records])
            found = found.periodic(self.period, float(seen.mean()))
        numbers = {
            "largest": found.largest, "waves": [math.hypot(w.c, w.s) for w in found.waves],
            "counts": [w.k for w in found.waves], "dry": sum(d.level for d in found.dry), "left": found.left,
        }  # fmt: skip
        source = self.of or self.machine
        return Outcome(found, f"Feed-forward of {source}.", numbers, facts_of(found))


@step
class TryMachineStep(Step):
    """A measured machine goes there and back under one digital controller, with each feed-forward and without."""

    gives: ClassVar[str] = "runs"
    do: Literal["try-machine"]
    machine: ToMachine
    controller: ToController
    feed_forward: Annotated[list[ToFeedForward], Field(max_length=8)] = Field([])
    speed: Positive = Field(description="Of the reference.")
    way: Positive = Field(description="At that speed, each way.")
    ramp: Positive = Field(description="s of each change of the speed.")
    start: float = Field(0.0, description="Position at which it begins.")
    lsb: Annotated[float, Field(ge=0)] = Field(0.0, description="Step of the encoder in the position's unit; 0: none.")
    limit: Positive | None = Field(None, description="Of the input; compared, not clipped.")

    def foretell(self, ahead: Ahead) -> Foretold:
        row = {
            "order": "1", "rms_error": float, "largest_error": float, "ripple": float, "largest_input": float,
            "rms_counts": "1", "within_limits": bool, "error_ratio": "1", "ripple_ratio": "1",
        }  # fmt: skip
        return Foretold(leaves={"controllers": dict.fromkeys((ALONE, *self.feed_forward), row)})

    def run(self, work: Workspace) -> Outcome:
        from robustlab.identification.validation.machine_trial import ThereAndBack, try_machine
        from robustlab.report.machine_figures import map_figure

        machine, aheads = work.values[self.machine], {name: work.values[name] for name in self.feed_forward}
        motion = ThereAndBack(self.speed, self.way, self.ramp)
        limit = math.inf if self.limit is None else self.limit
        K = work.values[self.controller]
        found = try_machine(machine, K, {ALONE: None, **aheads}, motion, self.start, self.lsb, limit)
        if aheads:
            work.draw(map_figure(machine, aheads), "map", "What each place needs, and what is fed forward there.")
        return told(found, found, f"{self.machine} under {self.controller}, with {len(aheads)} feed-forwards.", work)


@step
class RecordedRunStep(Step):
    """A run of the machine under a controller of this recipe, judged from its record.

    The record has what the controller saw (references as OUTPUT_ref) and asked for. What of that this controller with
    its feed-forward does not explain is a number: a requirement can ask that the run was made with what stands here.
    """

    gives: ClassVar[str] = "runs"
    do: Literal["recorded-run"]
    record: ToRecord
    controller: ToController = Field(
        description="That ran: a digital one, or a continuous one by Tustin's formula on the record's clock."
    )
    feed_forward: Annotated[list[ToFeedForward], Field(max_length=8)] = Field([], description="Added to its outputs.")
    output: Text = Field(description="Whose error counts.")
    name: Text = Field("", description="Of the run; that of its controller where left out.")
    beside: ToRecordedRun | None = Field(None, description="Recorded run of the same motion, which is compared.")
    after: Annotated[float, Field(ge=0)] = Field(0.0, description="s from which on the error counts.")
    lsb: Annotated[float, Field(ge=0)] = Field(0.0, description="Step of the sensor in the output's unit; 0: none.")
    limit: Positive | None = Field(None, description="Of the inputs; compared, not clipped.")

    def foretell(self, ahead: Ahead) -> Foretold:
        row = {
            "order": "1", "rms_error": float, "worst_error": float, "others": float, "largest_input": float,
            "command_gap": "1", "within_limits": bool, "rms_counts": "1", "worst_counts": "1", "error_ratio": "1",
            "worst_ratio": "1",
        }  # fmt: skip
        before = ahead[self.beside].leaves if self.beside else {"controllers": {}}
        known = before["controllers"] if before is not ... else {}
        return Foretold(leaves={"controllers": {**known, self.name or self.controller: row}})

    def run(self, work: Workspace) -> Outcome:
        from robustlab.identification.validation.recorded_run import Judgement, recorded_run

        judged = Judgement(self.output, self.after, self.lsb, math.inf if self.limit is None else self.limit)
        found = recorded_run(
            self.name or self.controller, work.record(self.record), work.values[self.controller],
            [work.values[name] for name in self.feed_forward], judged,
            work.values[self.beside] if self.beside else None,
        )  # fmt: skip
        kind = "simulated" if self.record in work.simulated else "measured"
        return told(found, found, f"A {kind} run under {self.controller}, with {len(self.feed_forward)} laws.", work)


ALONE = "feedback_alone"  # the run without any feed-forward
