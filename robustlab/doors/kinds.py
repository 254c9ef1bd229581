"""Kinds of values that a door takes: how a command reads them from words, and what a key of a recipe may hold.

A parameter of a door is annotated ``Annotated[type, kind, "help"]``; `robustlab.doors.declaration` reads that. Nothing
heavy is imported here: ``--help`` and TAB must not wait for numerical libraries.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

from robustlab.errors import InputError, UsageError, did_you_mean
from robustlab.units import amount, share

UPDATED_PLANT = "updated-plant.h5"  # in the folder of ``data discover --out``

Given = list[str] | None  # of an option that may be repeated


@dataclass(frozen=True)
class Kind:
    """Base: a text as it is given."""

    def annotation(self) -> Any:
        return str

    @property
    def metavar(self) -> str | None:
        return None

    def read(self, option: str, given: Any) -> Any:
        return given

    def field(self) -> Any:
        from robustlab.doors.vocabulary import Text

        return Text

    def of_field(self, given: Any) -> Any:
        return given


@dataclass(frozen=True)
class Number(Kind):
    """A number; a command takes it with another unit, too, where it has one."""

    unit: str = ""
    above: float | None = None
    least: float | None = None
    below: float | None = None
    most: float | None = None

    def annotation(self) -> Any:
        return str if self.unit else float

    @property
    def metavar(self) -> str | None:
        return "FLOAT" if self.unit else None

    def read(self, option: str, given: Any) -> Any:
        return amount(option, given, self.unit) if isinstance(given, str) else given

    def field(self) -> Any:
        from pydantic import Field

        return Annotated[float, Field(gt=self.above, ge=self.least, lt=self.below, le=self.most)]


@dataclass(frozen=True)
class Quantity(Kind):
    """A number; a command takes its unit with it, as a text that the function reads (`in_units`)."""

    ends: Literal["", "may", "must"] = ""
    least: float | None = None

    def of_text(self, where: str, text: str) -> Any:
        """The text, or the texts of both ends."""
        parts = text.split(":") if self.ends else [text]
        if len(parts) > 2 or (self.ends == "must" and len(parts) == 1):
            raise UsageError(where, "no name and two numbers", "NAME=LOW:HIGH")
        return text if len(parts) == 1 else tuple(parts)

    def field(self) -> Any:
        """A number, or two."""
        from pydantic import Field

        number: Any = Annotated[float, Field(ge=self.least)]
        two: Any = Annotated[list[number], Field(min_length=2, max_length=2)]
        return {"": number, "may": number | two, "must": two}[self.ends]

    def of_field(self, given: Any) -> Any:
        return tuple(given) if isinstance(given, list) else given


def in_units(where: str, given: Mapping[str, Any] | None, units: Mapping[str, str]) -> dict[str, Any]:
    """Values by name, texts among them read as numbers in the unit of their name.

    Examples
    --------
    >>> in_units("input", {"u": "2 mV", "w": ("1", "2"), "v": 3.0}, {"u": "V"})
    {'u': 0.002, 'w': (1.0, 2.0), 'v': 3.0}
    """

    def read(name: str, value: Any) -> Any:
        unit = units.get(name, "")
        if isinstance(value, tuple):
            return tuple(amount(f"{where} {name}", one, unit) for one in value)
        return amount(f"{where} {name}", value, unit)

    try:
        return {name: read(name, value) for name, value in (given or {}).items()}
    except InputError as error:
        raise UsageError(error.where, error.found, error.expected) from None


@dataclass(frozen=True)
class Share(Number):
    """A relative tolerance: ``0.05`` or ``5%``."""

    def field(self) -> Any:
        from robustlab.doors.vocabulary import PriorTolerance, RelativeTolerance

        return PriorTolerance if self.below is None else RelativeTolerance


@dataclass(frozen=True)
class TextFile(Kind):
    """A file that the function reads."""

    @property
    def metavar(self) -> str | None:
        return "FILE"


@dataclass(frozen=True)
class Whole(Kind):
    """A whole number."""

    least: int = 0
    most: int = 1_000_000

    def annotation(self) -> Any:
        return int

    def field(self) -> Any:
        from pydantic import Field

        return Annotated[int, Field(ge=self.least, le=self.most)]


@dataclass(frozen=True)
class Flag(Kind):
    """Yes or no."""

    def annotation(self) -> Any:
        return bool

    def field(self) -> Any:
        return bool


@dataclass(frozen=True)
class Choice(Kind):
    """One of several words."""

    words: tuple[str, ...]

    def read(self, option: str, given: Any) -> Any:
        if given is not None and given not in self.words:
            expected = " or ".join(self.words) if len(self.words) == 2 else f"one of {', '.join(self.words)}"
            raise UsageError(option, repr(given), expected, did_you_mean(given, self.words))
        return given

    @property
    def metavar(self) -> str | None:
        return "WORD"

    def field(self) -> Any:
        return Literal[self.words]


@dataclass(frozen=True)
class Feedback(Kind):
    """The sign of feedback: ``negative`` and ``positive`` of a command, -1 and 1 of a recipe."""

    def read(self, option: str, given: Any) -> Any:
        if given is None:
            return None
        return -1 if Choice(("negative", "positive")).read(option, given) == "negative" else 1

    @property
    def metavar(self) -> str | None:
        return "WORD"

    def field(self) -> Any:
        return Literal[-1, 1]


@dataclass(frozen=True)
class Names(Kind):
    """Names with commas between them; of signals or parameters of what ``of`` refers to, where a side is said."""

    side: Literal["inputs", "outputs", "signals", "parameters", ""] = ""
    of: str = "of"
    one: bool = False  # a single name
    repeated: bool = False  # the option of a command may be repeated

    def annotation(self) -> Any:
        return list[str] if self.repeated else str

    @property
    def metavar(self) -> str | None:
        return "NAME" if self.one else "NAME,..."

    def read(self, option: str, given: Any) -> Any:
        if not given or self.one:
            return given or None
        texts = given if self.repeated else [given]
        return [part.strip() for text in texts for part in text.split(",") if part.strip()]

    def field(self) -> Any:
        from robustlab.doors import vocabulary

        taken: Any = vocabulary.Text if self.one else list[vocabulary.Text]
        return Annotated[taken, vocabulary.Names(self.side, self.of)] if self.side else taken


@dataclass(frozen=True)
class Numbers(Kind):
    """Numbers with commas between them; each may carry another unit."""

    unit: str = ""
    count: int | None = None
    words: str = "NUMBER,..."

    @property
    def metavar(self) -> str | None:
        return self.words

    def read(self, option: str, given: Any) -> Any:
        """``1,10`` or ``2Hz`` as a list; as a tuple where their count is known."""
        if given is None:
            return None
        parts = given.split(",")
        try:
            found = [amount(option, part, self.unit) for part in parts]
        except InputError as error:
            example = "1,10 or 2Hz" if self.unit == "rad/s" else "1,2.5"
            raise UsageError(
                option, repr(given), f"numbers{f' in {self.unit}, or with a unit' if self.unit else ''}: {example}"
            ) from error
        if self.count is None:
            return found
        if len(found) != self.count:
            raise UsageError(option, repr(given), f"{self.count} numbers, {self.words}")
        return tuple(found)

    def field(self) -> Any:
        """A list of numbers."""
        from pydantic import Field

        number = Annotated[float, Field(ge=0)] if self.unit == "rad/s" else float
        if self.count is None:
            return list[number]
        return Annotated[list[number], Field(min_length=self.count, max_length=self.count)]

    def of_field(self, given: Any) -> Any:
        return given if given is None or self.count is None else tuple(given)


@dataclass(frozen=True)
class Table(Kind):
    """Names with a value each: ``NAME=VALUE``, repeatable; a table in a recipe."""

    value: Kind = Number()
    side: Literal["inputs", "outputs", "signals", "parameters", ""] = ""
    of: str = "of"
    words: str = "NAME=VALUE"

    def annotation(self) -> Any:
        return list[str]

    @property
    def metavar(self) -> str | None:
        return self.words

    def read(self, option: str, given: Given, units: Mapping[str, str] | None = None) -> Any:
        """The table; None where nothing was given. ``units``: of a name, in which its value may be given too."""
        if not given:
            return None
        found: dict[str, Any] = {}
        for text in given:
            name, equals, value = (
                text.partition("=")
                if isinstance(self.value, Kind) and type(self.value) is Kind
                else text.rpartition("=")
            )
            if not (name and equals) or (not value and not isinstance(self.value, Share)):  # a share says what it is
                raise UsageError(f"{option} {text}", "no name and value", self.words)
            if name in found:
                raise UsageError(f"{option} {text}", f"{name!r} is given twice", "each name once")
            try:
                found[name] = self._value(f"{option} {text}", value, (units or {}).get(name, ""))
            except InputError as error:
                raise UsageError(error.where, f"no number after =: {error.found}", error.expected) from None
        return found

    def _value(self, where: str, text: str, unit: str) -> Any:
        if type(self.value) is Kind:
            return text
        if isinstance(self.value, Quantity):
            return self.value.of_text(where, text)
        if isinstance(self.value, Share):
            return _as_usage(share, where, text)
        unit = getattr(self.value, "unit", "") or unit
        if isinstance(self.value, Numbers):
            parts = text.split(":")
            if len(parts) != 2:
                raise UsageError(where, "no name and two numbers", self.words)
            return tuple(amount(where, part, unit) for part in parts)
        number = amount(where, text, unit)
        if isinstance(self.value, Whole):
            if not float(number).is_integer():  # nan and inf are none
                raise UsageError(where, "no whole number", self.words)
            return int(number)
        return number

    def field(self) -> Any:
        from robustlab.doors import vocabulary

        taken = dict[str, self.value.field()]
        return Annotated[taken, vocabulary.Names(self.side, self.of)] if self.side else taken

    def of_field(self, given: Any) -> Any:
        return {name: self.value.of_field(value) for name, value in given.items()} if given else None


def _as_usage(read: Callable[[str, str], Any], where: str, text: str) -> Any:
    try:
        return read(where, text)
    except InputError as error:
        raise UsageError(error.where, error.found, error.expected) from None


class Pair(NamedTuple):
    """The two models of one file."""

    nominal: Any
    perturbed: Any


@dataclass(frozen=True)
class Thing(Kind):
    """An object: a file of a command, an earlier step of a recipe."""

    gives: tuple[str, ...] = ("any",)
    model: bool = False
    many: bool = False
    number: bool = False
    settings: bool = False
    positional: bool = False
    pair: bool = False
    discovery: bool = False
    words: tuple[str, ...] = ()

    reading: ClassVar[str] = "model"  # which of a command's options say how the file is read

    def annotation(self) -> Any:
        return list[str] if self.many else str

    @property
    def metavar(self) -> str | None:
        return "PLANT" if self.gives == ("plant",) else "FILE"

    def field(self) -> Any:
        """The name of an earlier step."""
        from robustlab.doors.vocabulary import RefersTo

        name = Annotated[str, RefersTo(self.gives)]
        taken: Any = list[name] if self.many else name
        return float | taken if self.number else taken

    def load(self, file: str, remark: Callable[[str], None], settings: Sequence[str] = (), **reading: Any) -> Any:
        """What stands in a file; ``remark`` hears what is odd about it. Of a file with two models a `Pair`.

        Where a plant is taken, its name will do, too.
        """
        from robustlab.storage import read

        if file in self.words:
            return file
        if self.number:
            with suppress(ValueError):
                return float(file)
        if self.discovery and Path(file).is_dir():
            file = str(Path(file) / UPDATED_PLANT)
        if "plant" in self.gives:
            from robustlab.doors.reading import named_plant

            plant = named_plant(file, settings)
            if plant is not None:
                return self.as_wanted(plant, file)
        loaded = read(file, **reading)
        for text in loaded.warnings:
            remark(f"warning: {file}: {text}")
        if loaded.kind == "pair":
            return Pair(*(self.as_wanted(model, file) for model in loaded.object))
        return self.as_wanted(loaded.object, file)

    def as_wanted(self, found: Any, where: str) -> Any:
        """The object as its function takes it."""
        import robustlab as rl
        from robustlab.dynamics.plant_contract import Plant
        from robustlab.statespace import as_model

        if isinstance(found, rl.Controller) and "controller" not in self.gives:
            found = found.K
        if self.model:
            return rl.linearise(found) if isinstance(found, Plant) else as_model(found, where)
        if self.gives[0] == "plant" and set(self.gives) <= {"plant", "any"} and not isinstance(found, Plant):
            wanted = "a discovery, or a plant" if self.discovery else "a plant"
            raise InputError(where, f"holds a {type(found).__name__}", wanted, "robustlab plant list")
        if isinstance(found, rl.Record) and "record" not in self.gives:
            raise InputError(where, "holds a Record", "a model or a plant")
        of_sets = set(self.gives) <= {"uncertain", "any"} and "uncertain" in self.gives
        if of_sets and not isinstance(found, (rl.UncertainModel, rl.UncertainFrequencyData)):
            held = f"holds a {type(found).__name__}"
            raise InputError(where, held, "an uncertain model", "robustlab uncertain build --help")
        return found


@dataclass(frozen=True)
class Machine(Thing):
    """A plant by its name or file, or a model in a file; the option ``--set`` of a command changes the plant."""

    gives: tuple[str, ...] = ("plant", "model", "any")

    reading: ClassVar[str] = "plant"

    @property
    def metavar(self) -> str | None:
        return "MODEL"


@dataclass(frozen=True)
class RecordFile(Thing):
    """A record; its columns are those of the `Machine` beside it. A command says ``FILE#GROUP`` for a group."""

    gives: tuple[str, ...] = ("record", "any")
    remarks: bool = True

    reading: ClassVar[str] = "record"

    def as_wanted(self, found: Any, where: str) -> Any:
        """The record."""
        import robustlab as rl

        if not isinstance(found, rl.Record):
            raise InputError(where, f"a {type(found).__name__}", "a record")
        return found
