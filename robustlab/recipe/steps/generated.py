"""Steps generated from operations: keys from the declaration, numbers and facts from the result's class."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, create_model

from robustlab.display import Displayable
from robustlab.operations.declaration import STEPS, InLoop, Operation, every_operation
from robustlab.operations.parameter_types import RecordFile, Thing
from robustlab.recipe.steps.step import Ahead, Fact, Inferred, Outcome, Step, Workspace, facts_of, step, with_signals
from robustlab.record import Record
from robustlab.signals import Signal


class Quantities:
    """The names that requirements may refer to, from the result's class, imported on access."""

    def __get__(self, instance: Any, owner: Any) -> Any:
        return owner.declared.quantities


class OperationStep(Step):
    """A step that is an operation: one function, one result."""

    declared: ClassVar[Operation]
    leaves: ClassVar[Any] = Quantities()

    def infer(self, ahead: Ahead) -> Inferred:
        """Infer the names for requirements and the signals for later steps; check that a record fits its model."""
        known, kept = self.declared.infer, getattr(self, "outputs", None)
        if isinstance(known, tuple):
            inputs, outputs = (ahead[self._reference(keys)] for keys in known)
            return Inferred(None, inputs.inputs, outputs.select(kept).outputs)
        if known is not None:
            return known(self, ahead)
        first = _first(self.declared)
        given = getattr(self, first) if first else None
        of = given if isinstance(given, str) else None
        fits = [compared(ahead, of, name) for name in self._records() if name != of]
        inputs, outputs = fits[0] if fits else (ahead[of].inputs, ahead[of].select(kept).outputs)
        leaves = with_signals(self.pattern(ahead), inputs, outputs)
        for p in self.declared.parameters:
            if isinstance(p.kind, Thing) and p.kind.named and p.key in leaves:
                leaves[p.key] = dict.fromkeys(getattr(self, p.key), leaves[p.key]["*"])
        return Inferred(leaves=leaves)

    def _reference(self, keys: str) -> str | None:
        """Return the step that the first given one of some keys names."""
        given = next(filter(None, (getattr(self, key) for key in keys.split())), None)
        return given[0] if isinstance(given, list) else given

    def pattern(self, ahead: Ahead) -> Any:
        return self.leaves

    def _records(self) -> list[str]:
        given = [getattr(self, p.key) for p in self.declared.parameters if isinstance(p.kind, RecordFile)]
        return [name for one in given if one for name in (one if isinstance(one, list) else [one])]

    def run(self, work: Workspace) -> Outcome:
        return self.outcome(self.declared(**self._values(work)), work)

    def _values(self, work: Workspace) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for p in self.declared.parameters:
            if p.name == "seed":
                own = vars(self)["seed"]
                values["seed"] = work.seed if own is None else own
            elif p.kind.only != "command":
                given = p.kind.of_field(getattr(self, p.key))
                if given is not None or p.needed:
                    values[p.name] = _thing(p.kind, given, work) if isinstance(p.kind, Thing) else given
        if self.declared.takes("drawn"):
            values["drawn"] = True
        return values

    def outcome(self, found: InLoop, work: Workspace) -> Outcome:
        result = found.result
        if self.declared.made or self.gives == "nothing":  # a model alone is no evidence
            for part, one in (("", result), *found.extras.items()):
                judged = getattr(one, "status", None) is not None
                if judged:
                    work.keep(one, part)
                for name, picture in work.pictures(one) if not (part and judged) else ():
                    if part or name not in found.extras:  # an additional result replaces the picture
                        work.draw(picture.figure, name, picture.caption)
        if self.gives == "record" and work.simulated.intersection(self._records()):
            work.simulated.add(work.step)
        first = _first(self.declared)
        of = (getattr(self, first) if first else None) or ""
        what = result.headline() or self.declared.paragraphs[0].rstrip(".")
        summary = f"{of if isinstance(of, str) else ', '.join(of)}: {what}.".removeprefix(": ")
        value = self.declared.made_of(result) if self.gives != "nothing" else None
        simulated = [f"Record {name} is simulated, not measured." for name in self._records() if name in work.simulated]
        notes = (*found.notes, *getattr(result, "notes", ()), *simulated)
        words = {"loop": found.loop, **{name: one for name, one in found.extras.items() if isinstance(one, str)}}
        facts = (*(Fact(name.capitalize(), word) for name, word in words.items() if word), *facts_of(result))
        # A class without its own summary has its facts in the report already.
        text = result.tables() if type(result).summary is Displayable.summary else result.report()
        numbers = {name: value for name, value in result.numbers().items() if value is not None} | dict(found.numbers)
        return Outcome(value, summary, numbers, facts, getattr(result, "status", None), notes, text)


def compared(ahead: Ahead, model: str | None, record: str) -> tuple[Mapping[str, str] | None, Mapping[str, str] | None]:
    """Return the inputs of a model and the outputs it shares with a record, with known units."""
    from robustlab.identification.response.response import matched

    ours, recorded = ahead[model], ahead[record]
    if ours.inputs is None or ours.outputs is None or recorded.outputs is None:
        return None, None
    if isinstance(recorded.value, Record):
        inputs, outputs = ([Signal(*s) for s in side.items()] for side in (ours.inputs, ours.outputs))
        return ours.inputs, {s.name: s.unit for s in matched(inputs, outputs, recorded.value)[0]}
    return ours.inputs, {name: unit for name, unit in ours.outputs.items() if name in recorded.outputs}


def add_steps(bases: Mapping[str, type[OperationStep]]) -> None:
    """Register the steps of operations; ``bases``: kind of step -> its base, where it does more than the operation."""
    every_operation()
    for word, declared in STEPS.items():
        step(_step_of(word, declared, bases.get(word, OperationStep)))


def _step_of(word: str, declared: Operation, base: type[OperationStep]) -> type[OperationStep]:
    keys: dict[str, Any] = {"do": (Literal[word], ...)}
    for p in declared.parameters:
        if p.kind.only == "command":
            continue
        if p.name == "seed":
            keys["seed"] = (p.kind.field() | None, Field(None, description="The recipe's seed where left out."))
            continue
        kind: Any = p.kind.field()
        default = ... if p.needed else p.default if p.kind.in_step is None else p.kind.in_step
        if p.needed and isinstance(p.kind, Thing) and (p.kind.many or p.kind.named):
            kind = Annotated[kind, Field(min_length=1)]
        taken = kind | None if default is None else kind
        keys[p.key] = (taken, Field(default, description=None if isinstance(p.kind, Thing) and p.needed else p.help))
    name = "".join(part.capitalize() for part in word.split("-")) + "Step"
    doc = "\n\n".join(part for part in declared.paragraphs if not part.startswith(("Exit code", "Example: ")))
    made: Any = create_model(name, __base__=base, __doc__=doc, **keys)
    made.gives, made.declared = declared.gives, declared
    return made


def _first(declared: Operation) -> str:
    return next((p.key for p in declared.parameters if isinstance(p.kind, Thing)), "")


def _thing(kind: Thing, given: Any, work: Workspace) -> Any:
    if isinstance(given, list):
        found = {name: kind.as_wanted(work.values[name], f"step {name!r}") for name in given}
        return found if kind.named else list(found.values())
    if kind.discovery and given in work.discoveries:
        return work.discoveries[given]
    if isinstance(given, str):
        return kind.as_wanted(work.values[given], f"step {given!r}")
    return given
