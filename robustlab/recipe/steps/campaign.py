"""Step that runs a campaign: many samples or searches in worker processes."""

from __future__ import annotations

import contextlib
import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from robustlab.recipe.steps.contract import Fact, Outcome, Workspace, picked, quantity, step
from robustlab.recipe.steps.vocabulary import Positive
from robustlab.recipe.steps.worst_case import MetricStep


@step
class CampaignStep(MetricStep):
    """A metric of many members, computed in worker processes and stored one by one; an interrupted run goes on."""

    do: Literal["campaign"]
    draw: Literal["samples", "vertices", "search"] = Field(
        "samples", description="Random members, vertices of Delta, or whole worst-case searches from own starts."
    )
    n: Annotated[int, Field(ge=1, le=1_000_000_000)] = 1000
    limit: float | None = Field(None, description="Count how often the metric is worse than it.")
    workers: Annotated[int, Field(ge=1, le=1024)] | None = Field(None, description="One per processor where left out.")
    time_limit_per_sample: Positive = Field(60.0, description="s; a sample that takes longer is lost.")

    def run(self, work: Workspace) -> Outcome:
        """A metric of many members, each stored as it comes; a recipe that was interrupted goes on where it was."""
        from robustlab.campaign import CampaignSettings, run_campaign
        from robustlab.campaign.settings import Identity

        model = work.uncertain(self.of)
        seed = work.seed if self.seed is None else self.seed
        options = self.options(work)
        u = dict(self.input) or None
        if self.sine:  # not a constant: sample by sample
            u = {name: column.tolist() for (name, _), column in zip(model.inputs, options["u"].T, strict=True)}
        settings = CampaignSettings(
            self.metric,
            self.n,
            self.draw,
            seed,
            self.output,
            self.from_input,
            u,
            self.t_end,
            self.points,
            options.get("hold", "zoh"),
            band=self.band,
        )
        # The name holds the campaign's hash: what was begun with another recipe is neither used nor spoilt.
        store = work.unfinished / f"{work.step}-{Identity.of(model, settings).hash[:12]}.sqlite"
        store.parent.mkdir(parents=True, exist_ok=True)
        result = run_campaign(
            model, settings, store, workers=self.workers, time_limit=self.time_limit_per_sample, limit=self.limit
        )
        _draw(store, self, work, result)
        _publish(store, work)
        return Outcome(
            None,
            f"{self.metric} of {result.done} {_members(self)} of {self.of}, seed {seed}; {result.label}.",
            _numbers(result),
            _facts(result),
            result.status,
            _notes(result),
        )


def _members(step: CampaignStep) -> str:
    return {"samples": "random members", "vertices": "vertices of Δ", "search": "searches over Δ"}[step.draw]


def _numbers(result: Any) -> dict[str, Any]:
    told = ("worst", "worst_index", "nominal", "done", "lost", "unbounded", "unseen", "delta", "digest")
    numbers = picked(result, *told)
    numbers["quantiles"] = {f"q{q.share * 100:g}".replace(".", "_"): q.value for q in result.quantiles}
    if result.violation is not None:
        v = result.violation
        numbers["violation"] = {"count": v.count, "of": v.of, "lower": v.lower, "upper": v.upper}
    return numbers


def _facts(result: Any) -> tuple[Fact, ...]:
    place = f" at {result.location} = {quantity(result.at)}" if math.isfinite(result.at) else ""
    facts = [
        Fact(f"Worst {result.metric}", f"{quantity(result.worst, result.unit)}{place} (number {result.worst_index})"),
        Fact("The same through a second path", quantity(result.again, result.unit)),
        Fact("The same at Δ = 0", quantity(result.nominal, result.unit)),
        *(Fact(f"Its {name}", quantity(value, unit)) for name, (value, unit) in result.physical.items()),
    ]
    for q in result.quantiles:
        bound = f" ({quantity(q.bound, result.unit)} with 95 % confidence)" if math.isfinite(q.bound) else ""
        facts.append(
            Fact(f"{100 * q.share:g} % of the members are not worse than", f"{quantity(q.value, result.unit)}{bound}")
        )
    if math.isfinite(result.unseen):
        facts.append(
            Fact("Members worse than all of these", f"at most {100 * result.unseen:.3g} % with 95 % confidence")
        )
    if result.violation is not None:
        v = result.violation
        share = f"{v.count} of {v.of}; probability {v.lower:.3g} … {v.upper:.3g} (95 % on each side)"
        facts.append(Fact(f"Worse than {quantity(v.limit, result.unit)}", share))
    facts.append(Fact("Digest of all results", result.digest))
    return tuple(facts)


def _notes(result: Any) -> tuple[str, ...]:
    notes = ["Sampled, not proved: members that were not drawn may be worse."]
    if result.unbounded:
        notes.insert(0, f"{result.unbounded} of the members have no bounded value.")
    if result.lost:
        first = result.lost_samples[0]
        text = (
            f"{result.lost} were lost, the first one number {first.index}: {first.reason}. Bounds count them as worst."
        )
        notes.insert(0, text)
    return tuple(notes)


def _draw(store: Path, step: CampaignStep, work: Workspace, result: Any) -> None:
    from robustlab.campaign.result import exceedance_curve
    from robustlab.campaign.store import Store
    from robustlab.report.worst_case_figures import exceedance_figure

    if result.kind != "samples":
        return
    opened = Store.open(store)
    try:
        values, share, upper = exceedance_curve(opened, result.sense, result.done, result.lost)
    finally:
        opened.close()
    figure = exceedance_figure(values, share, upper, metric=(step.metric, result.unit), limit=step.limit)
    work.draw(figure, step.metric, f"{step.metric}: how often a member is worse than a value ({result.done} samples).")


def _publish(store: Path, work: Workspace) -> None:
    """Move the finished store to the evidence of this run."""
    target = work.folder / "evidence" / f"{work.step}.sqlite"
    target.parent.mkdir(exist_ok=True)
    store.replace(target)
    work.files.append(f"evidence/{target.name}")
    store.with_name(f"{store.name}.lock").unlink(missing_ok=True)
    with contextlib.suppress(OSError):
        store.parent.rmdir()  # stays where another campaign is unfinished
