"""The contract of a step: its keys in a recipe, the workspace it runs in, and its outcome."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, Field

import robustlab as rl
from robustlab.display import Each
from robustlab.errors import InputError, did_you_mean
from robustlab.operations.parameter_types import Thing
from robustlab.result import Evidence

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from robustlab.identification.missing_effects.discovery_result import Discovery
    from robustlab.provenance import Provenance
    from robustlab.report.drawings import Picture

# Value of ``do`` -> the class of such steps; filled by `step`.
KINDS: dict[str, type[Step]] = {}
Kind = TypeVar("Kind", bound="type[Step]")

# "any": the object of a loaded file is known only at run time.
ToModel = Annotated[str, Thing(("plant", "model", "uncertain", "any"))]
Text = Annotated[str, Field(max_length=2000)]
Positive = Annotated[float, Field(gt=0)]


class Strict(BaseModel):
    """Reject unknown keys, silent conversion (TOML has types), NaN and infinity."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, populate_by_name=True)


@dataclass(frozen=True)
class Inferred:
    """Inferred properties of a step before it runs; None: not known."""

    value: Any = None  # its value, where that needs no computation: a shipped plant, a file's object
    # Signals of its value: name -> unit.
    inputs: Mapping[str, str] | None = None
    outputs: Mapping[str, str] | None = None
    leaves: Any = ...  # names that requirements may refer to, where they depend on more than the kind of step

    @classmethod
    def of(cls, value: Any, leaves: Any = ...) -> Inferred:
        if isinstance(value, rl.Record):
            inputs, outputs = ({n: value.unit(n) for n in side} for side in (value.inputs, value.outputs))
            return cls(value, inputs, outputs, leaves)
        model = getattr(value, "K", value)  # of a controller
        return cls(value, _units(getattr(model, "inputs", None)), _units(getattr(model, "outputs", None)), leaves)

    def select(self, outputs: Sequence[str] | None) -> Inferred:
        """Return the same signals, with the outputs that are kept, for a value not yet computed."""
        known = self.outputs
        kept = known if outputs is None or known is None else {name: known.get(name, "") for name in outputs}
        return Inferred(None, self.inputs, kept)


def _units(signals: Any) -> dict[str, str] | None:
    known = isinstance(signals, tuple) and all(isinstance(s, rl.Signal) for s in signals)
    return {s.name: s.unit for s in signals} if known else None


@dataclass
class Ahead:
    """Knowledge before anything runs: the files that steps read, and the inferred properties of earlier steps."""

    # Step name -> the file it reads, or the code of a plant; see `robustlab.recipe.load.find_file`.
    sources: Mapping[str, Path]
    steps: dict[str, Inferred] = field(default_factory=dict)
    step: str = ""  # name of the current step

    def __getitem__(self, name: str | None) -> Inferred:
        return self.steps.get(name or "", Inferred())


class Step(Strict):
    """Base of the steps; a kind of step adds its keys, among them ``do``, and `run`."""

    model_config = ConfigDict(defer_build=True)  # only the union of all kinds needs a validator, see `recipe_model`

    gives: ClassVar[str] = "nothing"
    leaves: ClassVar[Any] = ...  # names that requirements may refer to, see `with_signals`

    title: Text = Field("", description="Title of this step in the report; the step's name where left out.")
    verify: bool = Field(False, description="Verify the results of this step again, from the files it writes.")

    @property
    def kind(self) -> str:
        return str(vars(self)["do"])

    @property
    def reads(self) -> tuple[str, str | None]:
        """Return the key that names a file, and the file or None."""
        return "path", getattr(self, "path", None)

    def infer(self, ahead: Ahead) -> Inferred:
        """Infer cheaply what the step will give, before anything runs."""
        return Inferred()

    def run(self, work: Workspace) -> Outcome:
        raise NotImplementedError(self.kind)

    def in_free_run(self, path: str) -> str | None:
        """Return the path in free run of a number that holds in windows, None of any other number."""
        return None


def step(cls: Kind) -> Kind:
    """Register a kind of step (class decorator)."""
    KINDS[get_args(cls.model_fields["do"].annotation)[0]] = cls
    return cls


@dataclass(frozen=True)
class Fact:
    """A line of the report: label, value with unit, and source."""

    label: str
    value: str
    source: str = ""


@dataclass(frozen=True)
class Outcome:
    """The outcome of a step."""

    value: Any  # passed to later steps that refer to this one
    summary: str  # one sentence
    numbers: Mapping[str, Any] = field(default_factory=dict)  # for requirements (`step.key.key`); plain types
    facts: tuple[Fact, ...] = ()  # the key numbers as text
    status: rl.Status | None = None  # None for a step that only builds, reads, writes or draws
    notes: tuple[str, ...] = ()  # needed to judge the numbers
    text: str = ""  # details, line by line


@dataclass
class Workspace:
    """The values of earlier steps, the files found for them, the seed, and a folder to write to."""

    folder: Path  # the output folder; `files` lists the files written, relative to it
    seed: int  # seed of the recipe
    values: dict[str, Any] = field(default_factory=dict)  # step name -> value of each finished step
    files: list[str] = field(default_factory=list)
    inputs: dict[str, str] = field(default_factory=dict)
    # Step name -> its figures as (file stem, caption).
    figures: dict[str, list[tuple[str, str]]] = field(default_factory=dict)
    # Step name -> the whole discovery; the value of the step is the updated plant.
    discoveries: dict[str, Discovery] = field(default_factory=dict)
    simulated: set[str] = field(default_factory=set)  # names of the steps whose records are simulated, not measured
    # Step name -> the files that hold its results with their evidence.
    kept: dict[str, list[Path]] = field(default_factory=dict)
    step: str = ""  # name of the step that runs now
    ahead: Ahead = field(default_factory=lambda: Ahead({}))  # known before the first step
    png: bool = False  # draw figures as PNG, too
    drawn: frozenset[str] | None = None  # names of the steps whose figures are drawn; None: of all

    def provenance(self) -> Provenance:
        from robustlab.provenance import Provenance

        return Provenance.now(f"recipe step {self.step}", self.inputs, self.seed)

    def pictures(self, found: Any) -> Iterator[tuple[str, Picture]]:
        """Return the pictures of a result, where those of the current step are drawn."""
        from robustlab.report.drawings import pictures_of

        return pictures_of(found) if self.drawn is None or self.step in self.drawn else iter(())

    def draw(self, figure: Figure, name: str, caption: str) -> None:
        """Save a figure of the current step, where those are drawn."""
        from robustlab.report.style import save_figure

        if self.drawn is not None and self.step not in self.drawn:
            return
        # A signal's name is untrusted; the name of a file must not be.
        stem = re.sub(r"[^A-Za-z0-9_-]", "_", f"{self.step}-{name}")[:80]
        taken = [known for known, _ in self.figures.get(self.step, [])]
        stem = f"{stem}-{len(taken) + 1}" if stem in taken else stem
        for path in save_figure(figure, self.folder / "figures", stem, self.png):
            self.files.append(f"figures/{path.name}")
        self.figures.setdefault(self.step, []).append((stem, caption))

    def keep(self, result: Any, part: str = "") -> None:
        """Save a result with its evidence as ``evidence/STEP.h5``, or ``evidence/STEP-PART.h5`` of several."""
        path = self.folder / "evidence" / f"{self.step}{'-' * bool(part)}{part}.h5"
        path.parent.mkdir(exist_ok=True)
        rl.save(path, result, self.provenance())
        self.files.append(f"evidence/{path.name}")
        self.kept.setdefault(self.step, []).append(path)


def facts_of(found: Any) -> tuple[Fact, ...]:
    """Return a result's facts for the report, labels capitalised but for names, "q: ..." or "k (...)"."""
    return tuple(
        Fact(label if ": " in label or " (" in label else f"{label[:1].upper()}{label[1:]}", text)
        for label, text in found.facts()
        if text
    )


# --- names that requirements may refer to ---------------------------------------------------------------------------
# Nested tables of units: a text is the unit of a number, "1" of a pure one; ``{name: ...}`` a table, where ``*`` in a
# name matches any text; `Each` a table by signals; a class its fields; anything else is not checked.


def with_signals(
    names: Any, inputs: Mapping[str, str] | None, outputs: Mapping[str, str] | None, unit: str | None = None
) -> Any:
    """Replace each `Each` by the names of its signals, "*" where they are not known; ``unit``: of "*"."""
    if isinstance(names, Each):
        known = inputs if names.side == "inputs" else outputs
        every = {**({"*": ""} if known is None else known), **dict.fromkeys(names.more, "")}
        return {name: with_signals(names.leaf, inputs, outputs, of) for name, of in every.items()}
    if isinstance(names, type) and is_dataclass(names):
        stated = getattr(names, "quantities", {})
        as_fields = stated or getattr(names, "to_json", None) is Evidence.to_json
        names = {**{f.name: ... for f in fields(names)}, **stated} if as_fields else ...
    if isinstance(names, Mapping):
        return {name: with_signals(below, inputs, outputs, unit) for name, below in names.items()}
    if isinstance(names, (list, tuple)):
        return [with_signals(below, inputs, outputs, unit) for below in names]
    if isinstance(names, str):
        return unit if names == "*" and unit is not None else names
    return ...


def look_ahead(path: str, leaves: Any) -> Any:
    """Return the unit at a dotted path below a step's name, "" or ``...`` where it is not known."""
    step, *parts = path.split(".")
    here, done = with_signals(leaves, None, None), [step]
    for part in parts:
        if isinstance(here, list) and part.isdecimal():
            here = here[min(int(part), len(here) - 1)]
            continue
        if not isinstance(here, dict):
            return ...
        name = part if part in here else next((name for name in here if "*" in name and fnmatchcase(part, name)), None)
        if name is None:
            raise nothing_there("that", done, part, [name for name in here if name != "*"])
        here = here[name]
        done.append(part)
    return here


def nothing_there(where: str, done: Sequence[str], part: str, known: Sequence[str]) -> InputError:
    """Return the error for a path whose part after ``done`` does not exist."""
    expected = f"one of {', '.join(known)}" if known else f"nothing below {'.'.join(done)}"
    return InputError(where, f"{'.'.join(done)} has no {part!r}", expected, did_you_mean(part, list(known)))
