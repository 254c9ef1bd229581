"""Steps on measurements: reading records and frequency responses, joining, comparing, naming what a model lacks."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

import robustlab as rl
from robustlab.errors import InputError
from robustlab.recipe.steps.contract import Ahead, Fact, Foretold, Outcome, Step, Workspace, quantity, step
from robustlab.recipe.steps.leaves import leaves_of
from robustlab.recipe.steps.vocabulary import Names, Positive, PriorTolerance, Text, ToModel, ToOneModel, ToRecord

RECORD = {"samples": "1", "duration": "s", "dt": "s"}

if TYPE_CHECKING:
    from collections.abc import Mapping

    from robustlab.identification.comparison.comparison_result import Comparison
    from robustlab.identification.naming.discovery_result import Discovery

# Fields of a comparison that its JSON has under other names, or not without the time series.
NOT_LEFT = ("measured", "simulated", "recursive", "motions", "noise_reason", "against_noise", "linear_reason")

POSE = ("tx", "ty", "tz", "ax", "ay", "az")

_CAPTIONS = {
    "where": "Where {} is missed: rms of the error over time, direction, speed, position, input, frequency; orange is "
    "the largest of each.",
    "response": "The linear part of the record and of the model: frequency response from the inputs to {}.",
    "harmonics": "What a linear model cannot explain: lines of the record's spectrum beyond the excited ones.",
    "time": "{}: record and simulation, and the error over time; shaded: the window with the largest error.",
    "speed": "Where the error of {} lives over speed: dry friction shows as a step at zero speed.",
    "spectrum": "Where the error of {} lives over frequency.",
    "outputs": "The windowed error of all outputs beside each other.",
    "residual": "What is left of {}: correlation of the residual with itself and with the input, and the 99 % band.",
}


@step
class RecordStep(Step):
    """A record from HDF5, MATLAB or CSV; its file may lie anywhere: measured data are not ours to ship."""

    gives: ClassVar[str] = "record"
    leaves: ClassVar[Any] = RECORD
    do: Literal["record"]
    path: Text
    group: str | None = None
    inputs: list[str] | None = None
    outputs: list[str] | None = None
    dt: Positive | None = None
    clock: str | None = Field(None, description="Signal with the times, where it is not called t or time.")
    units: dict[str, str] = Field(
        {}, description='Unit that the numbers in the file are in: { phi = "deg" }; they are converted to SI.'
    )
    simulated: bool = Field(False, description="The record is simulated, not measured; report and figures say so.")
    about: Text = Field(
        "", description="What the record is, who published it, how to get it; shown where the file is absent."
    )

    def foretell(self, ahead: Ahead) -> Foretold:
        options: dict[str, Any] = {"units": self.units} if self.units else {}
        if self.clock is not None:
            options["clock"] = self.clock
        path = ahead.sources[ahead.step]
        return Foretold.of(
            rl.Record.read(path, group=self.group, inputs=self.inputs, outputs=self.outputs, dt=self.dt, **options)
        )

    def run(self, work: Workspace) -> Outcome:
        path, found = work.sources[work.step], work.ahead[work.step].value
        notes = (" ".join(self.about.split()),) if self.about else ()
        if self.simulated:
            work.simulated.add(work.step)
        return _as_record(found, f"Record {path.name} read ({work.origin(work.step)}).", notes)


@step
class FrequencyResponseStep(Step):
    """Frequency-response data: measured, from a table in a text file, or a model at frequencies.

    The table has the frequency first, "f [Hz]" or "omega [rad/s]"; then for each channel "y from u real" and "y from u
    imag", or "... magnitude" and "... phase [deg]", and "... radius" where the error is known to be below it.
    """

    gives: ClassVar[str] = "any"
    leaves: ClassVar[Any] = {"omega": ["rad/s"], "gain": [float], "peak": float, "peak_frequency": "rad/s"}
    do: Literal["frequency-response"]
    path: Text | None = Field(None, description="The table; its file may lie anywhere.")
    units: dict[str, str] = Field({}, description='Units that its header leaves out: { f = "Hz" }.')
    about: Text = Field("", description="What was measured; shown where the file is absent.")
    of: ToModel | None = Field(None, description="In place of path: a model, or an uncertain one.")
    frequency: Annotated[list[Annotated[float, Field(ge=0)]], Field(min_length=1)] | None = Field(
        None, description="rad/s, increasing; with of."
    )

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.path is None) == (self.of is None) or (self.of is None) != (self.frequency is None):
            raise PydanticCustomError("one_source", "expected either path, or of with frequency")
        return self

    def run(self, work: Workspace) -> Outcome:
        import numpy as np

        from robustlab.report.result_figures import measured_response_figure

        if self.of is not None and self.frequency is not None:
            found = rl.frequency_data(work.values[self.of], self.frequency)
        else:
            found = rl.UncertainFrequencyData.read(work.sources[work.step], units=self.units)
        gain = np.linalg.svd(found.nominal, compute_uv=False)[:, 0]
        at = int(np.argmax(gain))
        numbers = {
            "omega": found.omega,
            "gain": gain,
            "peak": float(gain[at]),
            "peak_frequency": float(found.omega[at]),
        }
        work.draw(measured_response_figure(found), "response", "Nominal response, of the first input.")
        facts = tuple(Fact(label, text) for label, text in found.facts() if text)
        notes = (" ".join(self.about.split()),) if self.about else ()
        return Outcome(found, f"Frequency response at {len(gain)} frequencies.", numbers, facts, notes=notes)


@step
class JoinStep(Step):
    """One record from two loggers with sample times of their own; a shift between their clocks is not looked for."""

    gives: ClassVar[str] = "record"
    leaves: ClassVar[Any] = RECORD
    do: Literal["join"]
    first: ToRecord
    second: ToRecord
    dt: Positive | None = Field(None, description="s; the coarser of the two where left out.")

    def foretell(self, ahead: Ahead) -> Foretold:
        first, second = ahead[self.first], ahead[self.second]
        if None in (first.inputs, second.inputs):
            return Foretold()
        return Foretold(
            None, {**(first.inputs or {}), **(second.inputs or {})}, {**(first.outputs or {}), **(second.outputs or {})}
        )

    def run(self, work: Workspace) -> Outcome:
        from robustlab.identification.record_check.resampling import join_clocks

        if work.simulated & {self.first, self.second}:
            work.simulated.add(work.step)
        found = join_clocks(work.record(self.first), work.record(self.second), self.dt)
        return _as_record(found, f"{self.first} and {self.second} on one clock.", ())


@step
class CompareStep(Step):
    """Simulate a model with the inputs of a record and report the disagreement."""

    do: Literal["compare"]
    of: ToModel
    record: ToRecord
    window: Positive | None = Field(
        None, description="Length of the windows in s; chosen from the model where left out."
    )
    start: Positive | None = Field(
        None, description="Longest opening stretch in s to which the initial state is fitted."
    )
    lags: Annotated[int, Field(ge=1, le=1000)] | None = None
    speed: Annotated[str, Names("outputs", "record")] | None = Field(
        None, description="Output over which the error is sorted by speed."
    )
    position: Annotated[str, Names("outputs", "record")] | None = Field(
        None, description="Output over which the error is sorted by position."
    )

    def foretell(self, ahead: Ahead) -> Foretold:
        from robustlab.identification.comparison.additions import Addition
        from robustlab.identification.comparison.comparison_result import Comparison, OutputGap

        inputs, outputs = _compared(ahead, self.of, self.record)
        left = leaves_of(Comparison, *NOT_LEFT)
        for name in ("windows", "residual", "direction", "amplitude"):
            left[name] = dict.fromkeys(outputs, left[name]["*"])
        percent = {f"{run}{name}": "%" for run in ("", "windowed_") for name in ("peak_percent", "rms_percent", "fit")}
        sizes = ("range", "peak", "rms", "windowed_peak", "windowed_rms")
        left["outputs"] = {
            name: leaves_of(OutputGap, **dict.fromkeys(sizes, unit), **percent, peak_time="s")
            for name, unit in outputs.items()
        }
        added = leaves_of(Addition, seconds="s", shares=dict.fromkeys(outputs, float), explained_share=float)
        of_input = ("forward", "backward", "forward_std", "backward_std")
        left["disturbance"] = {name: added | dict.fromkeys(of_input, unit) for name, unit in inputs.items()}
        left["disturbance"] |= dict.fromkeys(("torque at *", "force at *", "*, together"), added)
        left["worst"] = {"output": str, "start": "s", "stop": "s", "pose": dict.fromkeys(POSE, float)}
        left |= {"worst_window": dict.fromkeys(outputs, ("s", "s")), "window": "s"}
        left |= dict.fromkeys(("percent_of", "residual_reference"), str)
        return Foretold(leaves=left | dict.fromkeys(("speed", "position", "frequency", "noise", "linear"), ...))

    def in_free_run(self, path: str) -> str | None:
        return path.replace(".windowed_", ".") if ".outputs." in path and ".windowed_" in path else None

    def run(self, work: Workspace) -> Outcome:
        """Disagreement of a model with a record: how much, and where in time, speed and frequency it lives.

        Numbers: all of the comparison, and ``worst.output``, the output with the largest windowed error of its range,
        ``worst.start`` and ``.stop`` of its worst window in s, of a machine with poses ``worst.pose`` in its middle.
        """
        from robustlab.identification.comparison.comparison_result import Comparison
        from robustlab.report.comparison_figures import comparison_figures

        options = {name: getattr(self, name) for name in ("window", "start", "lags", "speed", "position")}
        model, measured = work.values[self.of], work.record(self.record)
        found = rl.compare(model, measured, **{name: value for name, value in options.items() if value is not None})
        if not isinstance(found, Comparison):
            raise InputError(f"step {work.step!r}", "a co-simulation unit", "a model, or a unit for model exchange")
        work.keep(found)
        facts: list[Fact] = []
        for name, gap in found.outputs.items():
            free = (gap.peak, gap.peak_percent, gap.rms, gap.rms_percent, gap.fit)
            windowed = (
                gap.windowed_peak,
                gap.windowed_peak_percent,
                gap.windowed_rms,
                gap.windowed_rms_percent,
                gap.windowed_fit,
            )
            ends = f"ends at {quantity(found.free_run.end, 's', 3)}: {found.free_run.reason}"
            facts.append(Fact(f"{name}: free run", _errors(gap.unit, free) if found.free_run.whole else ends))
            facts.append(Fact(f"{name}: restarted every {quantity(found.window, 's', 3)}", _errors(gap.unit, windowed)))
            facts.append(Fact(f"{name}: where", _where(found, name)))
        worst = _worst(model, found)
        facts.append(Fact("Worst of all", *worst.pop("words")))
        for name, figure in comparison_figures(found).items():
            kind, _, output = name.partition("-")
            work.draw(figure, name, _CAPTIONS[kind].format(output))
        head = f"{self.of} against {self.record}, a {work.origin(self.record)} record:"
        if found.free_run.whole:
            most = max(found.outputs.values(), key=lambda gap: gap.rms_percent)
            summary = (
                f"{head} in free run {most.name} is off by {most.rms_percent:.3g} % of its range (rms), most at "
                f"{quantity(most.peak_time, 's', 3)}."
            )
        else:
            most = max(found.outputs.values(), key=lambda gap: gap.windowed_rms_percent)
            summary = (
                f"{head} in windows of {quantity(found.window, 's', 3)} {most.name} is off by "
                f"{most.windowed_rms_percent:.3g} % of its range (rms); the free run ends at "
                f"{quantity(found.free_run.end, 's', 3)}."
            )
        numbers = {**found.to_json(series=False), "worst": worst}
        return Outcome(found, summary, numbers, tuple(facts), found.status, text=found.summary())


def _compared(ahead: Ahead, model: str, record: str) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """Inputs of a model, and the outputs that a record shares with it, with their units as far as they are known.

    Raises InputError: an input is not recorded, or no output is; UnitMismatch: their units differ.
    """
    from robustlab.identification.response.response import matched

    ours, recorded = ahead[model], ahead[record]
    if ours.inputs is None or ours.outputs is None or recorded.outputs is None:
        return {"*": float}, {"*": float}
    if isinstance(recorded.value, rl.Record):
        inputs, outputs = ([rl.Signal(*s) for s in side.items()] for side in (ours.inputs, ours.outputs))
        return ours.inputs, {s.name: s.unit for s in matched(inputs, outputs, recorded.value)[0]}
    return ours.inputs, {name: unit for name, unit in ours.outputs.items() if name in recorded.outputs}


def _as_record(found: rl.Record, summary: str, notes: tuple[str, ...]) -> Outcome:
    signals = [f"{name} [{found.unit(name) or 'unit not stated'}]" for name in (*found.inputs, *found.outputs)]
    numbers = {"samples": found.n, "duration": found.duration, "dt": found.dt}
    facts = (
        Fact("Samples", f"{found.n}, {quantity(found.duration, 's')} in steps of {quantity(found.dt, 's')}"),
        Fact("Signals", ", ".join(signals)),
    )
    return Outcome(found, summary, numbers, facts, notes=notes)


def _where(found: Comparison, name: str) -> str:
    """When, at what speed and at what position the windowed error of an output is largest."""
    w, motion = found.windows[name], found.motions[name]
    told = [f"{w.start[w.worst]:.3g} to {w.stop[w.worst]:.3g} s"]
    for bins, over, unit in (
        (found.speed.get(name), "of speed", motion.speed_unit),
        (found.position.get(name), "of position", motion.position_unit),
    ):
        if bins:
            worst = max(bins, key=lambda b: b.rms)
            told.append(f"{worst.low:.3g} to {worst.high:.3g} {unit} {over}")
    return f"windowed error largest at {'; at '.join(told)}"


def _worst(model: Any, found: Comparison) -> dict[str, Any]:
    """The output that is furthest off, its worst window, and the pose of a Stewart platform in the middle of that."""
    import numpy as np

    from robustlab.dynamics.extended.extended_plant import ExtendedNonlinearPlant
    from robustlab.dynamics.stewart.stewart_platform import StewartPlatform

    gap = max(found.outputs.values(), key=lambda gap: gap.windowed_rms_percent)
    w = found.windows[gap.name]
    start, stop = float(w.start[w.worst]), float(w.stop[w.worst])
    words = f"{gap.name}, {start:.3g} to {stop:.3g} s"
    worst: dict[str, Any] = {"output": gap.name, "start": start, "stop": stop}
    machine = model.plant if isinstance(model, ExtendedNonlinearPlant) else model
    angles = [s.name for s in machine.outputs[:6]]
    if isinstance(machine, StewartPlatform) and all(name in found.measured.outputs for name in angles):
        k = int(np.argmin(np.abs(found.measured.t - 0.5 * (start + stop))))
        pose = machine.poses(np.array([found.measured[name][k] for name in angles]))
        worst["pose"] = dict(zip(POSE, pose.tolist(), strict=True))
        shown = [f"{axis} {1e3 * v:.3g} {'mm' if axis[0] == 't' else 'mrad'}" for axis, v in worst["pose"].items()]
        words += f", at the pose {', '.join(shown)}"
    return {**worst, "words": (words, "largest windowed error of its range; its worst window, the middle of it")}


def _errors(unit: str, sizes: tuple[float, float, float, float, float]) -> str:
    peak, peak_percent, rms, rms_percent, fit = sizes
    peak_text = f"peak {quantity(peak, unit, 3)} ({peak_percent:.3g} % of the range)"
    return f"{peak_text}, rms {quantity(rms, unit, 3)} ({rms_percent:.3g} %), fit {fit:.4g} %"


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
    tolerances: Annotated[dict[str, PriorTolerance], Names("parameters")] = Field(
        {}, description="Relative tolerance of a parameter, over the one that the plant states."
    )
    exclude: list[str] = Field([], description="Ids of effects that are not tried.")
    window: Positive | None = Field(None, description="Length of the windows in s.")
    period: Positive | None = Field(None, description="Period of the excitation in s.")
    accept: Annotated[list[Literal["no missing effect", "named", "ambiguous", "unknown"]], Field(min_length=1)] = Field(
        ["no missing effect", "named"],
        description="Verdicts that this recipe takes for an answer; any other is no trustworthy number (exit code 4).",
    )

    def foretell(self, ahead: Ahead) -> Foretold:
        from robustlab.dynamics.effects.catalogue import catalogue, effect
        from robustlab.dynamics.effects.contract import Scales
        from robustlab.dynamics.effects.parameter_effects import GroundedEffect
        from robustlab.identification.naming.named_effects import Gap, wave_amplitude

        left_out = {effect(name).id for name in self.exclude}
        compared = [_compared(ahead, self.of, name)[1] for name in (*self.records, *self.held_out, *self.repeats)]
        gaps = {
            name: leaves_of(Gap, **dict.fromkeys(("range", "nominal", "refitted", "updated"), unit))
            for name, unit in compared[0].items()
        }
        effects: dict[str, Any] = {}
        for name, kind in catalogue().items():  # a unit that depends on the place is left out there
            units: dict[str, Any] = {p.name: p.unit for p in kind.parameters(Scales())}
            if wave_amplitude(dict.fromkeys(units, 0.0)) is not None:
                units["amplitude"] = float
            if isinstance(kind, GroundedEffect):  # at a joint that has no such parameter
                units[kind.symbol] = float
            if name not in left_out:
                effects |= {name: units, f"{name}@*": units}
        parameters = getattr(ahead[self.of].value, "parameters", None)
        nominal = {"*": float} if parameters is None else {name: p.unit for name, p in parameters.items()}
        line = {over: {"period": unit, "amplitude": float} for over, unit in (("position", float), ("time", "s"))}
        percent = ("gap_before", "gap_refitted", "gap_after")
        free_run = {**dict.fromkeys(("before", "refitted", "after"), "%"), "outputs": gaps}
        leaves = {
            "verdict": str, "complete": bool, **{key: [str] for key in ("names", "places", "answer")}, "count": "1",
            **dict.fromkeys(percent, "%"), **dict.fromkeys(("gap_ratio", "refitted_ratio"), "1"), "gaps": gaps,
            "free_run": free_run, "effects": effects, "lower": effects, "upper": effects,
            "confidence": dict.fromkeys(effects, "1"), "nominal": nominal,
            "next_experiment": {"name": str, "separation": float}, "structure": {"*": ...}, "remaining_lines": [...],
            "line": line, "seconds": "s",
        }  # fmt: skip
        return Foretold(None, ahead[self.of].inputs, ahead[self.of].outputs, leaves)

    def in_free_run(self, path: str) -> str | None:
        step, _, name = path.partition(".")
        if name.startswith("gaps."):
            return f"{step}.free_run.outputs.{name.removeprefix('gaps.')}"
        whole = {"gap_before": "before", "gap_refitted": "refitted", "gap_after": "after"}
        return f"{step}.free_run.{whole[name]}" if name in whole else None

    def run(self, work: Workspace) -> Outcome:
        from robustlab.dynamics.effects.catalogue import effect
        from robustlab.identification.naming.discovery_result import headline
        from robustlab.report.discovery import caption, discovery_figures, facts, story

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
    from robustlab.identification.naming.discovery_result import overall
    from robustlab.identification.naming.named_effects import wave_amplitude

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
    from robustlab.identification.naming.named_effects import wave_amplitude

    known = catalogue()
    tried = [known[name] for name in d.candidates if name in known]
    found = {effect.id: {p.name: math.nan for p in effect.parameters(Scales())} for effect in tried}
    for values in found.values():
        if wave_amplitude(values) is not None:
            values["amplitude"] = 0.0
    return found
