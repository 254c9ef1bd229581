"""The step that names what a model lacks."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import Field

import robustlab as rl
from robustlab.recipe.steps.contract import Fact, Outcome, Step, Workspace, step
from robustlab.recipe.steps.vocabulary import (
    Positive,
    PriorTolerance,
    ToOneModel,
    ToRecord,
)

if TYPE_CHECKING:
    from robustlab.identification.naming.discovery_result import Discovery


@step
class DiscoverStep(Step):
    """Name the effect that a model lacks; gives the updated plant, which is kept as STEP-plant.h5, too."""

    gives: ClassVar[str] = "plant"
    do: Literal["discover"]
    of: ToOneModel
    records: Annotated[list[ToRecord], Field(min_length=1, max_length=50, description="Records of one machine.")]
    held_out: list[ToRecord] = Field(
        [], description="Records that no fit sees; every fourth window of the others where left out."
    )
    repeats: list[ToRecord] = Field([], description="Further records with the same input, for the noise floor.")
    tolerances: dict[str, PriorTolerance] = Field(
        {}, description="Relative tolerance of a parameter, over the one that the plant states."
    )
    exclude: list[str] = Field([], description="Ids of effects that are not tried.")
    window: Positive | None = Field(None, description="Length of the windows in s.")
    period: Positive | None = Field(None, description="Period of the excitation in s.")
    accept: Annotated[list[Literal["no missing effect", "named", "ambiguous", "unknown"]], Field(min_length=1)] = Field(
        ["no missing effect", "named"],
        description="Verdicts that this recipe takes for an answer; any other is no trustworthy number (exit code 4).",
    )

    def run(self, work: Workspace) -> Outcome:
        """The effects that the records show beyond the model, with their evidence; gives the updated plant."""
        from robustlab.dynamics.effects.catalogue import effect
        from robustlab.identification.naming.discovery_result import headline
        from robustlab.report.discovery_figures import discovery_figures
        from robustlab.report.discovery_page import caption, facts, story

        found = rl.discover(
            work.values[self.of],
            [work.record(name) for name in self.records],
            [work.record(name) for name in self.held_out] or None,
            tolerances=self.tolerances,
            window=self.window,
            period=self.period,
            repeats=[work.record(name) for name in self.repeats],
            exclude=[effect(name).id for name in self.exclude],
        )
        if found.interrupted:
            raise KeyboardInterrupt  # a recipe that is stopped stays stopped: later steps would take the part for all
        work.keep(found)
        work.discoveries[work.step] = found
        for name, figure in discovery_figures(found).items():
            work.draw(figure, name, caption(name))
        notes = [f.message for f in found.findings]
        notes += [f"Record {name} is simulated, not measured." for name in self.records if name in work.simulated]
        status = found.status
        if not status.trustworthy and found.verdict in self.accept:
            status = rl.Status.CONVERGED
            notes.append(f"The verdict {found.verdict!r} is one that this recipe takes for an answer.")
        if found.model is not None:
            file = f"{work.step}-plant.h5"
            rl.save(work.folder / file, found.model, work.provenance())
            work.files.append(file)
            notes.append(f"The updated plant is in {file}.")
        if found.next_experiment is not None:
            file = f"{work.step}-next-experiment.csv"
            found.next_experiment.save(work.folder / file)
            work.files.append(file)
            notes.append(f"The signal of the next experiment is in {file}.")
        lines = tuple(Fact(*line) for line in facts(found))
        return Outcome(
            found.model,
            headline(found),
            numbers(found),
            lines,
            status,
            tuple(notes),
            found.summary(details=True),
            tuple(Fact(*part) for part in story(found)),
        )


def numbers(d: Discovery) -> dict[str, Any]:
    """What requirements may address.

    ``verdict``, ``complete``, ``names``, ``places`` (names with where they sit, ``ID@PLACE``), ``answer`` (names and
    rivals), ``count``, ``gap_before``, ``gap_refitted``, ``gap_after`` in percent of the range, ``gap_ratio`` (before
    over after), ``refitted_ratio``, ``gaps.OUTPUT.updated`` in its unit; ``free_run.before``, ``.refitted``, ``.after``
    in percent of the range and ``free_run.outputs.OUTPUT.updated``; ``effects.ID.PARAMETER`` (and ``.amplitude`` of
    what is periodic in the position) with ``lower`` and ``upper`` alike (95 %), ``confidence.ID`` (its probability),
    ``nominal.PARAMETER``, ``next_experiment.name`` ("none" where no rival is left) and ``.separation``;
    ``line.position.period`` and ``.amplitude`` of the strongest line that remains over the position, and ``line.time``
    alike.

    An effect that was tried but not named has confidence 0 and parameters that are no number, so a requirement on it
    is not met, while a misspelt one is refused; of what is periodic its amplitude is 0.
    """
    from robustlab.identification.naming.discovery_parts import wave_amplitude
    from robustlab.identification.naming.discovery_result import overall

    effects, lower, upper, confidence = (_absent(d) for _ in range(4))
    confidence = dict.fromkeys(confidence, 0.0)
    for e in d.effects:
        # A second effect of the same kind, at another place, is told by that place.
        key = e.name if e.name not in d.names[: d.effects.index(e)] else f"{e.name}@{e.site}"
        effects[key] = {p.name: p.value for p in e.parameters}
        if (amplitude := wave_amplitude(effects[key])) is not None:
            effects[key]["amplitude"] = amplitude
        lower[key] = {p.name: p.lower for p in e.parameters}
        upper[key] = {p.name: p.upper for p in e.parameters}
        confidence[key] = e.confidence
    return {
        "verdict": d.verdict,
        "complete": d.complete,
        "names": list(d.names),
        "places": [f"{e.name}@{e.site}" for e in d.effects],
        "answer": list(d.answer),
        "count": len(d.effects),
        "gap_before": d.gap_before,
        "gap_refitted": d.gap_refitted,
        "gap_after": d.gap_after,
        "gap_ratio": d.gap_before / d.gap_after if d.gap_after > 0 else math.inf,
        "refitted_ratio": d.gap_refitted / d.gap_after if d.gap_after > 0 else math.inf,
        "gaps": {name: gap.to_json() for name, gap in d.gaps.items()},
        "free_run": {
            "before": overall(d.free_run, "nominal"),
            "refitted": overall(d.free_run, "refitted"),
            "after": overall(d.free_run, "updated"),
            "outputs": {name: gap.to_json() for name, gap in d.free_run.items()},
        },
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
    from robustlab.identification.naming.discovery_parts import wave_amplitude

    known = catalogue()
    tried = [known[name] for name in d.candidates if name in known]
    found = {effect.id: {p.name: math.nan for p in effect.parameters(Scales())} for effect in tried}
    for values in found.values():
        if wave_amplitude(values) is not None:
            values["amplitude"] = 0.0
    return found
