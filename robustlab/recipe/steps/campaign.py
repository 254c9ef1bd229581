"""Step that runs a campaign: many samples or searches in worker processes."""

from __future__ import annotations

import contextlib
import math
from pathlib import Path
from typing import Any

from robustlab.recipe.outcome import Fact, Outcome, Workspace, quantity
from robustlab.recipe.schema import CampaignStep
from robustlab.recipe.steps.analysis import metric_options

__all__ = ["campaign"]


def campaign(step: CampaignStep, work: Workspace) -> Outcome:
    """A metric of many members, each stored as it comes; a recipe that was interrupted goes on where it was."""
    from robustlab.campaign import CampaignSettings, Crew, run_campaign
    from robustlab.campaign.settings import Identity

    model = work.uncertain(step.of)
    seed = work.seed if step.seed is None else step.seed
    options = metric_options(step, work)
    u = dict(step.input) or None
    if step.sine:  # not a constant: sample by sample
        u = {name: column.tolist() for (name, _), column in zip(model.inputs, options["u"].T, strict=True)}
    settings = CampaignSettings(
        step.metric,
        step.n,
        step.draw,
        seed,
        step.output,
        step.from_input,
        u,
        step.t_end,
        step.points,
        options.get("hold", "zoh"),
        band=step.band,
    )
    # The name holds the campaign's hash: what was begun with another recipe is neither used nor spoilt.
    store = work.unfinished / f"{work.step}-{Identity.of(model, settings).hash[:12]}.sqlite"
    store.parent.mkdir(parents=True, exist_ok=True)
    result = run_campaign(
        model, settings, store, crew=Crew(step.workers, None, step.time_limit_per_sample), limit=step.limit
    )
    _draw(store, step, work, result)
    _publish(store, work)
    return Outcome(
        None,
        f"{step.metric} of {result.done} {_members(step)} of {step.of}, seed {seed}; {result.label}.",
        _numbers(result),
        _facts(result),
        result.status,
        _notes(result),
    )


def _members(step: CampaignStep) -> str:
    return {"samples": "random members", "vertices": "vertices of Δ", "search": "searches over Δ"}[step.draw]


def _numbers(result: Any) -> dict[str, Any]:
    numbers: dict[str, Any] = {
        "worst": result.worst,
        "worst_index": result.worst_index,
        "nominal": result.nominal,
        "done": result.done,
        "lost": result.lost,
        "unbounded": result.unbounded,
        "unseen": result.unseen,
        "delta": result.delta,
        "digest": result.digest,
        "quantiles": {f"q{q.share * 100:g}".replace(".", "_"): q.value for q in result.quantiles},
    }
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
