"""Steps made of doors: their keys from the declaration, what they leave from the face of the result's class."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, create_model

from robustlab.doors.declaration import STEPS, Door, load_family, objects
from robustlab.doors.kinds import RecordFile, Thing
from robustlab.recipe.steps.contract import Ahead, Fact, Foretold, Outcome, Step, Workspace, facts_of, step
from robustlab.recipe.steps.leaves import with_signals
from robustlab.record import Record
from robustlab.report.drawings import pictures_of
from robustlab.shown import Shown
from robustlab.signals import Signal

# Word of a step -> its base, where a recipe says or does more than call the function.
BASES: dict[str, type[DoorStep]] = {}


class Quantities:
    """What requirements may refer to: that of the result's class, which is imported when it is asked for."""

    def __init__(self, declared: Door) -> None:
        self.declared = declared

    def __get__(self, instance: Any, owner: Any) -> Any:
        """The pattern of the class."""
        return self.declared.result_class.quantities


class DoorStep(Step):
    """A step that is a door: one function, one result."""

    declared: ClassVar[Door]

    def foretell(self, ahead: Ahead) -> Foretold:
        """What requirements may refer to, with the names and units of the signals; a record has to fit its model."""
        given = getattr(self, _first(self.declared))
        of = given if isinstance(given, str) else None
        fits = [compared(ahead, of, name) for name in self._records() if name != of]
        inputs, outputs = fits[0] if fits else (ahead[of].inputs, ahead[of].outputs)
        return Foretold(leaves=with_signals(self.pattern(ahead), inputs, outputs))

    def pattern(self, ahead: Ahead) -> Any:
        """What requirements may refer to; a kind of step may know more than its result's class."""
        return self.leaves

    def _records(self) -> list[str]:
        """Steps that give the records."""
        given = [getattr(self, p.key) for p in objects(self.declared) if isinstance(p.kind, RecordFile)]
        return [name for one in given if one for name in (one if isinstance(one, list) else [one])]

    def run(self, work: Workspace) -> Outcome:
        """Call the function, and let the result say itself."""
        found, loop = self.declared(**self._values(work))
        return self.outcome(found, loop, work)

    def _values(self, work: Workspace) -> dict[str, Any]:
        """What the function is given."""
        values: dict[str, Any] = {}
        for p in self.declared.parameters:
            if p.name == "seed" and getattr(self, "seed", None) is None:
                values["seed"] = work.seed
            elif p.called.only != "command":
                given = p.kind.of_field(getattr(self, p.key))
                if given is not None or p.needed:
                    values[p.name] = _thing(p.kind, given, work) if isinstance(p.kind, Thing) else given
        return values

    def outcome(self, found: Any, loop: str, work: Workspace) -> Outcome:
        """What the result leaves: its evidence, pictures, numbers and words."""
        work.keep(found)
        for name, picture in pictures_of(found):
            work.draw(picture.figure, name, picture.caption)
        of = getattr(self, _first(self.declared))
        summary = (
            f"{of if isinstance(of, str) else ', '.join(of)}: {found.headline() or self.declared.title.rstrip('.')}."
        )
        value = self.declared.made_of(found) if self.gives != "nothing" else None
        simulated = [f"Record {name} is simulated, not measured." for name in self._records() if name in work.simulated]
        notes = (*getattr(found, "notes", ()), *simulated)
        facts = (*([Fact("Loop", loop)] if loop else []), *facts_of(found))
        # A text of the class's own says all; else the facts are said already.
        text = found.tables() if type(found).summary is Shown.summary else found.report()
        return Outcome(value, summary, found.numbers(), facts, getattr(found, "status", None), notes, text)


def compared(ahead: Ahead, model: str | None, record: str) -> tuple[Mapping[str, str] | None, Mapping[str, str] | None]:
    """Inputs of a model, and the outputs that a record shares with it, with their units as far as they are known.

    Raises InputError: an input is not recorded, or no output is; UnitMismatch: their units differ.
    """
    from robustlab.identification.response.response import matched

    ours, recorded = ahead[model], ahead[record]
    if ours.inputs is None or ours.outputs is None or recorded.outputs is None:
        return None, None
    if isinstance(recorded.value, Record):
        inputs, outputs = ([Signal(*s) for s in side.items()] for side in (ours.inputs, ours.outputs))
        return ours.inputs, {s.name: s.unit for s in matched(inputs, outputs, recorded.value)[0]}
    return ours.inputs, {name: unit for name, unit in ours.outputs.items() if name in recorded.outputs}


def add_steps(*families: str) -> None:
    """Make the steps that the families of doors declare."""
    for family in families:
        load_family(family)
    for word, declared in STEPS.items():
        step(step_of(word, declared))


def step_of(word: str, declared: Door) -> type[DoorStep]:
    """The class of the steps of a door."""
    keys: dict[str, Any] = {"do": (Literal[word], ...)}
    for p in declared.parameters:
        if (p.name == "seed" and p.default is not None) or p.called.only == "command":
            continue
        kind = p.kind.field()
        default = ... if p.needed else p.default
        if p.needed and isinstance(p.kind, Thing) and p.kind.many:
            kind = Annotated[kind, Field(min_length=1)]
        taken = kind | None if default is None else kind
        keys[p.key] = (taken, Field(default, description=None if isinstance(p.kind, Thing) and p.needed else p.help))
    made: Any = create_model(_class_name(word), __base__=BASES.get(word, DoorStep), __doc__=_doc(declared), **keys)
    made.gives, made.leaves, made.declared = declared.gives, Quantities(declared), declared
    return made


def _first(declared: Door) -> str:
    """The key of the object that the question is about."""
    return next(p.key for p in declared.parameters if isinstance(p.kind, Thing))


def _thing(kind: Thing, given: Any, work: Workspace) -> Any:
    if isinstance(given, list):
        return [kind.as_wanted(work.values[name], f"step {name!r}") for name in given]
    return kind.as_wanted(work.values[given], f"step {given!r}") if isinstance(given, str) else given


def _class_name(word: str) -> str:
    return "".join(part.capitalize() for part in word.split("-")) + "Step"


def _doc(declared: Door) -> str:
    more = [part for part in declared.more.split("\n\n") if not part.startswith("Exit code")]  # that of the command
    return "\n\n".join(filter(None, (declared.title, *more)))
