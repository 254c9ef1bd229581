"""The step that names what a model lacks."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from robustlab.recipe.outcome import Fact, Outcome, Workspace
from robustlab.recipe.schema import DiscoverStep
from robustlab.result import Status

if TYPE_CHECKING:
    from robustlab.identification.naming.discovery_result import Discovery

__all__ = ["discover", "numbers"]


def discover(step: DiscoverStep, work: Workspace) -> Outcome:
    """The effects that the records show beyond the model, with their evidence; gives the updated plant."""
    import robustlab as rl
    from robustlab.dynamics.effects.catalogue import effect
    from robustlab.identification.naming.discovery_result import headline
    from robustlab.report.discovery_figures import caption, discovery_figures, facts

    found = rl.discover(
        work.values[step.of],
        [work.record(name) for name in step.records],
        [work.record(name) for name in step.held_out] or None,
        tolerances=step.tolerances,
        window=step.window,
        period=step.period,
        repeats=[work.record(name) for name in step.repeats],
        exclude=[effect(name).id for name in step.exclude],
    )
    work.keep(found)
    work.discoveries[work.step] = found
    for name, figure in discovery_figures(found).items():
        work.draw(figure, name, caption(name))
    notes = [f.message for f in found.findings]
    notes += [f"Record {name} is simulated, not measured." for name in step.records if name in work.simulated]
    status = found.status
    if not status.trustworthy and found.verdict in step.accept:
        status = Status.CONVERGED
        notes.append(f"The verdict {found.verdict!r} is one that this recipe takes for an answer.")
    if found.model is not None:
        file = f"{work.step}-plant.h5"
        _save(found, work, file)
        notes.append(f"The updated plant is in {file}.")
    if found.next_experiment is not None:
        file = f"{work.step}-next-experiment.csv"
        found.next_experiment.save(work.folder / file)
        work.files.append(file)
        notes.append(f"The signal of the next experiment is in {file}.")
    lines = tuple(Fact(*line) for line in facts(found))
    return Outcome(found.model, headline(found), numbers(found), lines, status, tuple(notes), found.summary())


def _save(found: Discovery, work: Workspace, file: str) -> None:
    import robustlab as rl
    from robustlab.provenance import Provenance

    rl.save(work.folder / file, found.model, Provenance.now(f"recipe step {work.step}", work.inputs, work.seed))
    work.files.append(file)


def numbers(d: Discovery) -> dict[str, Any]:
    """What requirements may address.

    ``verdict``, ``complete``, ``names``, ``answer`` (names and rivals), ``count``, ``gap_before``, ``gap_refitted``,
    ``gap_after`` in percent of the range, ``gap_ratio`` (before over after), ``gaps.OUTPUT.updated`` in its unit;
    ``effects.ID.PARAMETER`` with ``lower`` and ``upper`` alike (95 %), ``confidence.ID``, ``nominal.PARAMETER``,
    ``next_experiment.name`` ("none" where no rival is left) and ``.separation``; ``line.position.period`` and
    ``.amplitude`` of the strongest line that remains over the position, and ``line.time`` alike.

    An effect that was tried but not named has confidence 0 and parameters that are no number, so a requirement on it
    is not met, while a misspelt one is refused.
    """
    effects, lower, upper, confidence = (_absent(d) for _ in range(4))
    confidence = dict.fromkeys(confidence, 0.0)
    for e in d.effects:
        # A second effect of the same kind, at another place, is told by that place.
        key = e.name if e.name not in d.names[: d.effects.index(e)] else f"{e.name}@{e.site}"
        effects[key] = {p.name: p.value for p in e.parameters}
        lower[key] = {p.name: p.lower for p in e.parameters}
        upper[key] = {p.name: p.upper for p in e.parameters}
        confidence[key] = e.confidence
    return {
        "verdict": d.verdict,
        "complete": d.complete,
        "names": list(d.names),
        "answer": list(d.answer),
        "count": len(d.effects),
        "gap_before": d.gap_before,
        "gap_refitted": d.gap_refitted,
        "gap_after": d.gap_after,
        "gap_ratio": d.gap_before / d.gap_after if d.gap_after > 0 else math.inf,
        "gaps": {name: gap.to_json() for name, gap in d.gaps.items()},
        "effects": effects,
        "lower": lower,
        "upper": upper,
        "confidence": confidence,
        "nominal": {p.name: p.value for p in d.nominal},
        "next_experiment": {
            "name": d.next_experiment.name if d.next_experiment else "none",
            "separation": d.next_experiment.separation if d.next_experiment else math.nan,
        },
        "structure": dict(d.structure),
        "remaining_lines": [dict(line) for line in d.remaining_lines],
        "line": {over: _strongest_line(d, over) for over in ("position", "time")},
        "seconds": d.seconds,
    }


def _strongest_line(d: Discovery, over: str) -> dict[str, float]:
    """Period and amplitude of the strongest line that remains over a coordinate; no numbers where there is none."""
    line = next((line for line in d.remaining_lines if line["over"] == over), None)
    return {name: math.nan if line is None else float(line[name]) for name in ("period", "amplitude")}


def _absent(d: Discovery) -> dict[str, dict[str, float]]:
    """Every effect that was tried, with parameters that are no number."""
    from robustlab.dynamics.effects.catalogue import catalogue
    from robustlab.dynamics.effects.contract import Scales

    known = catalogue()
    tried = [known[name] for name in d.candidates if name in known]
    return {effect.id: {p.name: math.nan for p in effect.parameters(Scales())} for effect in tried}
