"""Steps that confront a model with what was measured: data sheet, envelope, smallest Delta that explains a record."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

import robustlab as rl
from robustlab.recipe.steps.contract import Fact, Outcome, Step, Workspace, quantity, step
from robustlab.recipe.steps.vocabulary import (
    GUARD,
    Count,
    Effort,
    Positive,
    StepName,
    Strict,
    Text,
    TimeLimit,
    ToPlant,
    ToRecord,
    ToUncertain,
)

if TYPE_CHECKING:
    from robustlab.identification.validation import Validation


_CAPTION = (
    "{}: the record, the nominal model, and the member that explains it with the smallest Delta; below, what each of "
    "them leaves, in the noise bound."
)

_LINES = "How large each block of Delta is at each frequency in the explanation."

_NOTE = "Not invalidated is not proved: another record may still invalidate the set."


class SheetPointEntry(Strict):
    """One operating point of a data sheet; quantities that it does not print are left out."""

    name: StepName
    voltage: float | None = Field(None, description="V")
    speed: float | None = Field(None, description="rad/s; m/s for a linear axis.")
    current: float | None = Field(None, description="A")
    torque: float | None = Field(None, description="N m (N) of the load, positive against a positive speed.")
    tolerance: Annotated[float, Field(ge=0, lt=1)] = Field(0.01, description="What the printed numbers may be off.")
    source: Text = ""


@step
class DataSheetStep(Step):
    """Check printed operating points against the equilibrium of a plant; contradictions are named."""

    do: Literal["data-sheet"]
    of: ToPlant
    points: Annotated[list[SheetPointEntry], Field(min_length=1, max_length=100)]

    def run(self, work: Workspace) -> Outcome:
        """Printed operating points against a plant's equilibrium: what contradicts it, and which effect would not."""
        from robustlab.identification.record_check.steady_state import SheetPoint, compare_steady_state

        points = [SheetPoint(**vars(p)) for p in self.points]
        found = compare_steady_state(work.values[self.of], points)
        work.keep(found)
        facts = [Fact(p.name, ", ".join(f"{k} {quantity(v)}" for k, v in p.stated.items()), p.source) for p in points]
        for c in found.checks:
            told = "contradicted" if c.contradicted else "agrees within the tolerances"
            if c.contradicted:
                named = [f"{c.effect} ({quantity(c.factor, digits=3)} times off)"] if c.effect else []
                told += f"; explained by {' or '.join([*named, *c.rivals]) or 'no effect alone'}"
            facts.append(Fact(f"{c.point}: {c.balance} balance", told))
        count = len(found.contradictions)
        summary = f"{len(found.checks)} balances of {self.of} checked at {len(points)} points; {count} contradicted."
        return Outcome(found, summary, found.to_json(), tuple(facts), found.status, text=found.summary())


@step
class CoverStep(Step):
    """Does the envelope of an uncertain model's members hold a record?"""

    do: Literal["cover"]
    of: ToUncertain
    record: ToRecord
    n: Count = 20
    vertices: Count = 0
    rate: Positive | None = Field(None, description="s, over which mean rates of the outputs are judged as well.")
    allowance: dict[str, Annotated[float, Field(ge=0)]] = Field(
        {}, description="What the sensor of an output may be off, in its unit."
    )
    seed: Annotated[int, Field(ge=0)] | None = Field(None, description="The recipe's seed where left out.")

    def run(self, work: Workspace) -> Outcome:
        """Whether a record lies in the envelope of an uncertain model's members, and by how much it does not."""
        from robustlab.identification.comparison.envelope import cover as cover_record
        from robustlab.report.set_figures import envelope_figure

        seed = work.seed if self.seed is None else self.seed
        found = cover_record(
            work.uncertain(self.of),
            work.record(self.record),
            n=self.n,
            vertices=self.vertices,
            seed=seed,
            rate=self.rate,
            allowance=self.allowance,
        )
        work.keep(found)
        facts: list[Fact] = []
        for name, s in found.signals.items():
            miss = "" if not s.miss else f"; misses by {quantity(s.miss, s.unit, 3)} ({s.miss_percent:.3g} %)"
            facts.append(Fact(f"{name}: inside the envelope", f"{100 * s.share:.3g} % of the time{miss}"))
            facts.append(
                Fact(f"{name}: gap of the nominal model", f"{quantity(s.gap, s.unit, 3)} ({s.gap_percent:.3g} %)")
            )
            reach = f"{quantity(s.reach, s.unit, 3)} ({s.reach_percent:.3g} %)"
            facts.append(Fact(f"{name}: how far the set reaches", reach))
            caption = (
                f"{name}: the record, and below it the record minus the nominal model, in the envelope of all members."
            )
            work.draw(envelope_figure(s), name, caption)
        verdict = "lies in the envelope" if found.covered else "is not covered"
        kind = work.origin(self.record)
        summary = f"{self.record} ({kind}) {verdict} of {found.members} members of {self.of} (seed {seed})."
        notes = (
            "Sampled, not proved: members that were not drawn may reach further.",
            "Covered is not explained: a set that is wide enough covers anything.",
        )
        return Outcome(found, summary, found.to_json(series=False), tuple(facts), found.status, notes, found.summary())


@step
class ValidateStep(Step):
    """The smallest scaling gamma of Delta for which an uncertain model could have produced a record."""

    do: Literal["validate"]
    of: ToUncertain
    record: ToRecord
    noise: dict[str, Annotated[float, Field(ge=0)]] = Field(
        {}, description="Noise bound of an output, in its unit; from the record's own repeats where all are left out."
    )
    domain: Literal["time", "frequency"] = Field(
        "time", description="frequency: whole periods of a record in steady state, line by line."
    )
    period: Positive | None = Field(None, description="s, frequency domain: where no recorded signal tells it.")
    noise_norm: Literal["peak", "rms"] | None = Field(
        None, description="peak where left out; in the frequency domain rms."
    )
    delta: Literal["time-invariant", "time-varying"] = Field(
        "time-invariant", description="What complex and full blocks are; real ones are constants."
    )
    at_rest: bool = Field(False, description="The record starts at rest; otherwise its initial state is free.")
    window: Positive | None = Field(None, description="s; windows with a free start each, for long records.")
    per_block: bool = Field(False, description="Also the smallest scaling of each block alone.")
    precision: Annotated[float, Field(ge=1e-4, le=0.2)] = 0.01
    effort: Effort = Field(1.0, description="Multiple of the usual work.")
    time_limit: TimeLimit | None = Field(None, description=GUARD)

    def run(self, work: Workspace) -> Outcome:
        """Bounds of the smallest scaling of Delta that explains a record; ``gamma`` is the one that was shown to."""
        from robustlab.report.set_figures import validation_figures

        found = rl.validate(
            work.uncertain(self.of),
            work.record(self.record),
            self.noise or None,
            domain=self.domain,
            noise_norm=self.noise_norm,
            delta=self.delta,
            at_rest=self.at_rest,
            window=self.window,
            period=self.period,
            per_block=self.per_block,
            precision=self.precision,
            effort=self.effort,
            time_limit=self.time_limit,
        )
        work.keep(found)
        for name, figure in validation_figures(found).items():
            caption = _LINES if name == "delta" and found.domain == "frequency" else _CAPTION.format(name)
            work.draw(figure, name, caption)
        numbers = {**found.to_json(series=False), "gamma": found.upper}
        summary = f"{self.record} as a record of {self.of}: {found.verdict}."
        return Outcome(found, summary, numbers, _facts(found), found.status, (_NOTE, *found.notes), found.summary())


def _facts(found: Validation) -> tuple[Fact, ...]:
    shown = quantity(found.upper) if math.isfinite(found.upper) else "none was found"
    facts = [
        Fact("Smallest gamma that explains the record", shown, found.label),
        Fact("No smaller gamma than", quantity(found.lower)),
    ]
    units = dict(found.outputs)
    for name, bound in found.noise_bound.items():
        facts.append(Fact(f"{name}: noise bound ({found.noise_norm})", quantity(bound, units[name], 3)))
    for name, block in found.blocks.items():
        told = [f"size {quantity(block.size, digits=4)} in the explanation"] if math.isfinite(block.size) else []
        if block.physical is not None:
            told.append(quantity(*block.physical))
        if block.impossible:
            told.append(f"physically impossible: {block.impossible}")
        if not math.isnan(block.lower):
            told.append(f"alone, the others within 1: {block.lower:.4g} to {block.upper:.4g}")
        if told:
            facts.append(Fact(f"{name} ({block.kind})", "; ".join(told)))
    return tuple(facts)
