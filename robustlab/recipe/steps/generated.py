"""Steps made of doors: their keys from the declaration, what they leave from the face of the result's class."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar, Literal

from pydantic import Field, create_model

from robustlab.doors.declaration import STEPS, Door, load_family
from robustlab.doors.kinds import Thing
from robustlab.errors import InputError, UsageError
from robustlab.recipe.steps.contract import Ahead, Fact, Foretold, Outcome, Step, Workspace, facts_of, step
from robustlab.report.drawings import pictures_of


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
        """What the declaration says of the signals."""
        known = self.declared.foretell
        if known is None:
            return Foretold()
        if not isinstance(known, str):
            return known(self, ahead)
        kept = getattr(self, "outputs", None)
        told = ahead[getattr(self, known)].select(kept if isinstance(kept, list) else None)
        sides = {"inputs": told.inputs, "outputs": told.outputs}
        lists = {side: (str,) * len(s) for side, s in sides.items() if s is not None and self.leaves.get(side) == [str]}
        return replace(told, leaves={**self.leaves, **lists})

    def run(self, work: Workspace) -> Outcome:
        """Call the function, and let the result say itself."""
        values: dict[str, Any] = {}
        for p in self.declared.parameters:
            if p.name == "seed":
                own = vars(self)["seed"]
                values["seed"] = work.seed if own is None else own
            elif p.called.only != "command":
                given = p.kind.of_field(getattr(self, p.key))
                if given is not None or p.needed:
                    values[p.name] = _thing(p.kind, given, work) if isinstance(p.kind, Thing) else given
        try:
            found, loop, notes = self.declared(**values)
        except UsageError as error:  # what is off is the recipe, not a command
            raise InputError(error.where, error.found, error.expected, error.hint) from None
        if self.declared.made or self.gives == "nothing":
            work.keep(found)  # a model alone is no evidence, and the step that asks something of it draws
            for name, picture in pictures_of(found):
                work.draw(picture.figure, name, picture.caption)
        of = getattr(self, _first(self.declared), "")
        what = found.headline() or self.declared.title.rstrip(".")
        summary = f"{of if isinstance(of, str) else ', '.join(of)}: {what}.".removeprefix(": ")
        value = self.declared.made_of(found) if self.gives != "nothing" else None
        notes = (*notes, *getattr(found, "notes", ()))
        facts = (*([Fact("Loop", loop)] if loop else []), *facts_of(found))
        status, text = getattr(found, "status", None), found.tables()
        return Outcome(value, summary, found.numbers(), facts, status, notes, text)


def add_steps(*families: str) -> None:
    """Make the steps that the families of doors declare."""
    for family in families:
        load_family(family)
    for word, declared in STEPS.items():
        step(step_of(word, declared))


def step_of(word: str, declared: Door) -> type[DoorStep]:
    """The class of the steps of a door."""
    keys: dict[str, Any] = {"do": (Literal[word], ...)}
    first = _first(declared)
    for p in declared.parameters:
        if p.called.only == "command":
            continue
        if p.name == "seed":
            keys["seed"] = (p.kind.field() | None, Field(None, description="The recipe's seed where left out."))
            continue
        kind = p.kind.field()
        default = ... if p.needed else p.default if p.called.in_step is None else p.called.in_step
        taken = kind | None if default is None else kind
        keys[p.key] = (taken, Field(default, description=None if p.key == first else p.help))
    made: Any = create_model(_class_name(word), __base__=DoorStep, __doc__=_doc(declared), **keys)
    made.gives, made.leaves, made.declared = declared.gives, Quantities(declared), declared
    return made


def _first(declared: Door) -> str:
    """The key of the object that the question is about."""
    return next((p.key for p in declared.parameters if isinstance(p.kind, Thing)), "")


def _thing(kind: Thing, given: Any, work: Workspace) -> Any:
    if isinstance(given, list):
        return [kind.as_wanted(work.values[name], f"step {name!r}") for name in given]
    if kind.discovery and given in work.discoveries:
        return work.discoveries[given]
    return kind.as_wanted(work.values[given], f"step {given!r}") if isinstance(given, str) else given


def _class_name(word: str) -> str:
    return "".join(part.capitalize() for part in word.split("-")) + "Step"


def _doc(declared: Door) -> str:
    return "\n\n".join(filter(None, (declared.title, declared.more)))
