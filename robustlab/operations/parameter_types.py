"""Kinds of parameters of operations: how a command parses them, and the type of a recipe's key.

No numerical library is imported here, so that ``--help`` and TAB are fast.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import robustlab as rl
from robustlab.errors import InputError, RobustlabError, UsageError, did_you_mean
from robustlab.units import amount, share

UPDATED_PLANT = "updated-plant.h5"  # in the folder of ``data discover --out``
Side = Literal["inputs", "outputs", "signals", "parameters", ""]


@contextmanager
def _as_usage(found: str = "") -> Any:
    try:
        yield
    except InputError as error:
        raise UsageError(error.where, f"{found}{error.found}", error.expected) from None


def bounded(taken: Any, **bounds: Any) -> Any:
    """Return the type of a recipe's key with bounds of its value or length."""
    from pydantic import Field

    return Annotated[taken, Field(**bounds)]


@dataclass(frozen=True)
class Kind:
    """A text; base of the other kinds, with the names of the parameter where they differ from that in the function."""

    _: KW_ONLY
    argument: str = ""  # in Python
    option: str = ""  # ``--filter-order``, or ``-k,--controller``
    key: str = ""  # of a recipe; "of" for the first object of an operation where left out
    only: str = ""  # "command" or "step", where only that one has the parameter
    in_step: Any = None  # default of a recipe's key, where it differs from the command's; ``...``: required
    taken: ClassVar[Any] = str  # type that the command's parser gives
    metavar: ClassVar[str | None] = None

    def read(self, option: str, given: Any) -> Any:
        """Return the value of a command's option."""
        return given

    def field(self) -> Any:
        """Return the type of a recipe's key."""
        return bounded(str, max_length=2000)

    def of_field(self, given: Any) -> Any:
        """Return the value of a recipe's key."""
        return given


@dataclass(frozen=True)
class TextFile(Kind):
    """A file that the function reads."""

    metavar = "FILE"


@dataclass(frozen=True)
class Number(Kind):
    """A number; a command also accepts another unit where it has one."""

    unit: str = ""
    above: float | None = None
    least: float | None = None
    below: float | None = None
    most: float | None = None

    @property
    def taken(self) -> Any:  # pyright: ignore[reportIncompatibleVariableOverride]
        return str if self.unit else float

    @property
    def metavar(self) -> str | None:  # pyright: ignore[reportIncompatibleVariableOverride]
        return "FLOAT" if self.unit else None

    def read(self, option: str, given: Any) -> Any:
        return amount(option, given, self.unit) if isinstance(given, str) else given

    def of_text(self, where: str, text: str, unit: str) -> Any:
        with _as_usage("no number after =: "):
            return amount(where, text, unit)

    def field(self) -> Any:
        return bounded(float, gt=self.above, ge=self.least, lt=self.below, le=self.most)


@dataclass(frozen=True)
class Share(Number):
    """A relative tolerance: ``0.05`` or ``5%``."""

    def of_text(self, where: str, text: str, unit: str) -> Any:
        with _as_usage():
            return share(where, text)

    def field(self) -> Any:
        from pydantic import BeforeValidator, WithJsonSchema
        from pydantic_core import PydanticCustomError

        def read(value: Any) -> Any:
            try:
                number = share("", value)
            except InputError as error:
                raise PydanticCustomError("share", "expected {expected}", {"expected": error.expected}) from None
            if self.below is not None and type(number) in (int, float) and self.below <= number < float("inf"):
                text = "a share of the value should be less than 1; did you mean {meant}?"
                raise PydanticCustomError("share", text, {"meant": f"{number:g}% = {number / 100:g}"})
            return number

        limits = {"exclusiveMinimum": 0} | ({} if self.below is None else {"exclusiveMaximum": self.below})
        schema = WithJsonSchema({"anyOf": [{"type": "number", **limits}, {"type": "string", "pattern": "%$"}]})
        return Annotated[super().field(), BeforeValidator(read), schema]


@dataclass(frozen=True)
class Ends(Number):
    """The ends of a range, ``LOW:HIGH``; where ``single``, also one number."""

    single: bool = False

    def of_text(self, where: str, text: str, unit: str) -> Any:
        parts = text.split(":")
        if len(parts) > 2 or (len(parts) == 1 and not self.single):
            raise UsageError(where, "no name and two numbers", "NAME=LOW:HIGH")
        found = tuple(Number.of_text(self, where, part, unit) for part in parts)
        return found if len(found) == 2 else found[0]

    def field(self) -> Any:
        number: Any = super().field()
        two: Any = bounded(list[number], min_length=2, max_length=2)
        return number | two if self.single else two

    def of_field(self, given: Any) -> Any:
        return tuple(given) if isinstance(given, list) else given


@dataclass(frozen=True)
class Whole(Kind):
    """A whole number."""

    least: int = 0
    most: int = 1_000_000
    taken = int

    def field(self) -> Any:
        return bounded(int, ge=self.least, le=self.most)


@dataclass(frozen=True)
class Flag(Kind):
    """Yes or no."""

    taken = bool

    def field(self) -> Any:
        return bool


@dataclass(frozen=True)
class Choice(Kind):
    """One of several words."""

    words: tuple[str, ...]
    metavar = "WORD"

    def read(self, option: str, given: Any) -> Any:
        if given is not None and given not in self.words:
            expected = " or ".join(self.words) if len(self.words) == 2 else f"one of {', '.join(self.words)}"
            raise UsageError(option, repr(given), expected, did_you_mean(given, self.words))
        return given

    def field(self) -> Any:
        return Literal[self.words]


@dataclass(frozen=True)
class Feedback(Kind):
    """The sign of feedback: ``negative`` and ``positive`` of a command, -1 and 1 of a recipe."""

    metavar = "WORD"

    def read(self, option: str, given: Any) -> Any:
        given = Choice(("negative", "positive")).read(option, given)
        return None if given is None else -1 if given == "negative" else 1

    def field(self) -> Any:
        return Literal[-1, 1]


def comma_separated(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


@dataclass(frozen=True)
class Names(Kind):
    """Names separated by commas; of signals or parameters of the step in key ``of``, where ``side`` is given."""

    side: Side = ""
    of: str = "of"
    one: bool = False  # a single name
    repeated: bool = False  # the option of a command may be repeated

    @property
    def taken(self) -> Any:  # pyright: ignore[reportIncompatibleVariableOverride]
        return list[str] if self.repeated else str

    @property
    def metavar(self) -> str | None:  # pyright: ignore[reportIncompatibleVariableOverride]
        return "NAME" if self.one else "NAME,..."

    def read(self, option: str, given: Any) -> Any:
        if not given or self.one:
            return given or None
        return [name for text in (given if self.repeated else [given]) for name in comma_separated(text)]

    def field(self) -> Any:
        taken: Any = super().field() if self.one else list[super().field()]
        return Annotated[taken, self] if self.side else taken


@dataclass(frozen=True)
class ByNumber(Kind):
    """Signals by name, or the number of last ones: ``a,b`` or ``2``."""

    metavar = "NAME,...|NUMBER"

    def read(self, option: str, given: Any) -> Any:
        return None if given is None else int(given) if given.isdecimal() else comma_separated(given)

    def field(self) -> Any:
        return bounded(int, ge=1) | bounded(list[super().field()], min_length=1, max_length=100)


@dataclass(frozen=True)
class Numbers(Kind):
    """Numbers separated by commas, each in any unit."""

    unit: str = ""
    count: int | None = None
    metavar: str = field(default="NUMBER,...", kw_only=True)  # pyright: ignore[reportIncompatibleVariableOverride]

    def read(self, option: str, given: Any) -> Any:
        if given is None:
            return None
        try:
            found = [amount(option, part, self.unit) for part in given.split(",")]
        except InputError as error:
            example = "1,10 or 2Hz" if self.unit == "rad/s" else "1,2.5"
            words = f"numbers{f' in {self.unit}, or with a unit' if self.unit else ''}: {example}"
            raise UsageError(option, repr(given), words) from error
        if self.count is not None and len(found) != self.count:
            raise UsageError(option, repr(given), f"{self.count} numbers, {self.metavar}")
        return self.of_field(found)

    def field(self) -> Any:
        number: Any = bounded(float, ge=0) if self.unit == "rad/s" else float
        return bounded(list[number], min_length=self.count, max_length=self.count)

    def of_field(self, given: Any) -> Any:
        return given if given is None or self.count is None else tuple(given)


@dataclass(frozen=True)
class Table(Kind):
    """Names with a value each: ``NAME=VALUE``, repeatable; a table in a recipe."""

    value: Number = Number()
    side: Side = ""
    of: str = "of"
    metavar: str = field(default="NAME=VALUE", kw_only=True)  # pyright: ignore[reportIncompatibleVariableOverride]
    taken = list[str]

    def read(self, option: str, given: list[str] | None, units: Mapping[str, str] | None = None) -> Any:
        """Return the table, None if empty. ``units``: name -> unit that its value is converted to."""
        found: dict[str, Any] = {}
        for text in given or []:
            where, (name, equals, value) = f"{option} {text}", text.rpartition("=")
            # `share` reports an empty value itself.
            if not (name and equals) or not (value or isinstance(self.value, Share)):
                raise UsageError(where, "no name and value", self.metavar)
            if name in found:
                raise UsageError(where, f"{name!r} is given twice", "each name once")
            found[name] = self.value.of_text(where, value, (units or {}).get(name, ""))
        return found or None

    def field(self) -> Any:
        taken = dict[str, self.value.field()]
        return Annotated[taken, self] if self.side else taken

    def of_field(self, given: Any) -> Any:
        return {name: self.value.of_field(value) for name, value in given.items()} if given else None


@dataclass(frozen=True)
class Weight(Kind):
    """A weight: a number, or arguments of one of robustlab's functions of weights, ``bandwidth=10,error=0.01``."""

    makers: tuple[str, ...]
    metavar = "WEIGHT"

    def read(self, option: str, given: Any) -> Any:
        if given is None:
            return None
        if "=" not in given:
            try:
                return float(given)
            except ValueError:
                raise UsageError(option, f"{given.strip()!r}", "a number") from None
        parts = Table().read(option, given.split(","), {"bandwidth": "rad/s"})
        return self.made(option, {key.strip().replace("-", "_"): value for key, value in parts.items()})

    def made(self, where: str, given: Mapping[str, Any]) -> Any:
        """Return the weight of the first function that has all the words; of the first one where none has."""
        from inspect import signature

        from robustlab.synthesis.specifications import weight_design

        makers = [getattr(weight_design, name) for name in self.makers]
        maker = next((m for m in makers if given.keys() <= signature(m).parameters.keys()), makers[0])
        known = list(signature(maker).parameters)
        for key in given:
            if key not in known:
                expected = f"one of {', '.join(known)}"
                raise UsageError(where, f"unknown word {key!r}", expected, did_you_mean(key, known))
        if known[0] not in given:
            raise UsageError(where, f"{known[0]} is missing", f"at least {known[0]}=NUMBER")
        order = {"order": int(given["order"])} if float(given.get("order", 0.5)).is_integer() else {}
        return maker(**{**given, **order})

    def field(self) -> Any:
        from pydantic import AfterValidator
        from pydantic_core import PydanticCustomError

        def check(given: dict[str, float]) -> dict[str, float]:
            try:
                self.made("weight", given)
            except RobustlabError as error:
                raise PydanticCustomError("weight", "{fault}", {"fault": str(error)}) from None
            return given

        return bounded(float, gt=0) | Annotated[dict[str, float], AfterValidator(check)]

    def of_field(self, given: Any) -> Any:
        return self.made("weight", given) if isinstance(given, dict) else given


@dataclass(frozen=True)
class Keyed(Kind):
    """A value of its own type in a recipe; the text of a command as it is."""

    type: Any

    def field(self) -> Any:
        return self.type


class Sizes(Kind):
    """A positive number for all signals, or one for each by its name; of a recipe alone."""

    def field(self) -> Any:
        return bounded(float, gt=0) | dict[str, bounded(float, gt=0)]


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
    named: bool = False  # in a recipe several by the names of their steps
    number: bool = False
    settings: bool = False
    positional: bool = False
    pair: bool = False
    discovery: bool = False
    reading: ClassVar[str] = "model"  # the command's options for reading the file, see `robustlab.cli.generated.READ`

    @property
    def taken(self) -> Any:  # pyright: ignore[reportIncompatibleVariableOverride]
        return list[str] if self.many else str

    @property
    def metavar(self) -> str | None:  # pyright: ignore[reportIncompatibleVariableOverride]
        return "PLANT" if self.gives == ("plant",) else "FILE"

    def field(self) -> Any:
        name = Annotated[str, self]
        taken: Any = list[name] if self.many or self.named else name
        return float | taken if self.number else taken

    def __get_pydantic_json_schema__(self, core_schema: Any, handler: Any) -> dict[str, Any]:
        """Return the schema of a reference with a description, which a field's own replaces."""
        kinds = " or ".join(", ".join(k for k in self.gives if k != "any").rsplit(", ", 1))
        return {
            "description": f"Name of an earlier step{f' that gives: {kinds}' if kinds else ''}.",
            **handler(core_schema),
        }

    def load(self, file: str, remark: Callable[[str], None], settings: Sequence[str] = (), **reading: Any) -> Any:
        """Return the object of a file, a `Pair` of two models, or a plant by its name; pass warnings to ``remark``."""
        from robustlab.storage import read

        if self.number:
            with suppress(ValueError):
                return float(file)
        if self.discovery and Path(file).is_dir():
            file = str(Path(file) / UPDATED_PLANT)
        if "plant" in self.gives or self.reading == "plant":
            plant = named_plant(file, settings)
            if plant is not None:
                return self.as_wanted(plant, file)
        loaded = read(file, **reading)
        for text in loaded.warnings:
            remark(f"warning: {file}: {text}")
        if loaded.kind == "pair":
            if not self.pair:
                hint = "group='nominal', or group='perturbed'"
                raise UsageError(file, "two models, nominal and perturbed", "one", hint)
            return Pair(*(self.as_wanted(model, file) for model in loaded.object))
        return self.as_wanted(loaded.object, file)

    def as_wanted(self, found: Any, where: str) -> Any:
        """Return the object converted for its function; raise where it has the wrong type."""
        from robustlab.dynamics.plant_base import Plant
        from robustlab.statespace import as_model

        if isinstance(found, rl.Controller) and "controller" not in self.gives:
            found = found.K
        if self.model:
            return rl.linearise(found) if isinstance(found, Plant) else as_model(found, where)
        held = f"holds a {type(found).__name__}"
        if self.gives[0] == "plant" and set(self.gives) <= {"plant", "any"} and not isinstance(found, Plant):
            wanted = "a discovery, or a plant" if self.discovery else "a plant"
            raise InputError(where, held, wanted, "robustlab plant list")
        if isinstance(found, rl.Record) and "record" not in self.gives:
            raise InputError(where, held, "a model or a plant")
        of_sets = set(self.gives) <= {"uncertain", "any"} and "uncertain" in self.gives
        if of_sets and not isinstance(found, (rl.UncertainModel, rl.UncertainFrequencyData)):
            raise InputError(where, held, "an uncertain model", "robustlab uncertain --help")
        return found


@dataclass(frozen=True)
class Machine(Thing):
    """A plant by its name or file, or a model in a file; the option ``--set`` of a command changes the plant."""

    gives: tuple[str, ...] = ("plant", "model", "any")
    reading: ClassVar[str] = "plant"

    @property
    def metavar(self) -> str | None:
        return "MODEL"

    def as_wanted(self, found: Any, where: str) -> Any:
        """Return the object, or the set of a plant where an uncertain model is required."""
        from robustlab.dynamics.plant_base import Plant
        from robustlab.provenance import code_of

        if self.gives[0] != "uncertain" or not isinstance(found, Plant):
            return super().as_wanted(found, where)
        uncertain = getattr(found, "uncertain", None)
        if uncertain is None:
            raise InputError(where, f"{found.name} is not linear", "a linear plant, with or without effects")
        if not any(p.tolerance for p in found.parameters.values()):
            raise InputError(where, "no parameter has a tolerance", "a plant whose parameters may vary")
        made = uncertain()
        if code_of(found):
            made.traced(found.provenance)
        return made


@dataclass(frozen=True)
class RecordFile(Thing):
    """A record, with the columns of the operation's `Machine`; ``FILE#GROUP`` in a command selects a group."""

    gives: tuple[str, ...] = ("record", "any")
    remarks: bool = True
    reading: ClassVar[str] = "record"

    def as_wanted(self, found: Any, where: str) -> Any:
        if not isinstance(found, rl.Record):
            raise InputError(where, f"a {type(found).__name__}", "a record")
        return found


# --- plants named on the command line ---------------------------------------------------------------------------------


def runs_code(name: str) -> bool:
    """Return whether reading the plant runs a user's code: ``file.py:name``, or a unit of FMI."""
    from robustlab.dynamics.plant_file import plant_reference, unit_reference

    return bool(plant_reference(name) or unit_reference(name))


def read_plant(name: str, parameters: Mapping[str, Any]) -> Any:
    """Return the shipped plant, or the plant in a Python file (``file.py:name``, which is run) or an HDF5 file."""
    from robustlab.storage.interchange import is_plant_file, load_plant

    if is_plant_file(name) and not runs_code(name):
        made = load_plant(name)
        return made.with_parameters(**parameters) if parameters else made
    if not runs_code(name):
        _require_known(name)
    return rl.plant(name, **parameters)


def named_plant(name: str, settings: Sequence[str]) -> Any:
    """Return the plant of a name or a user's code; None where the name is that of another file."""
    from robustlab.dynamics import plant_names
    from robustlab.storage.interchange import is_plant_file

    if name in plant_names() or runs_code(name) or (settings and is_plant_file(name)):
        return read_plant(name, plant_settings(settings))
    if settings:
        known = f"one of {', '.join(plant_names())}, or path/to/file.py:name"
        raise UsageError(f"--set {settings[0]}", f"{name} is no plant", known, did_you_mean(name, plant_names()))
    if not Path(name).suffix:
        _require_known(name)
    return None


def plant_settings(texts: Sequence[str] | None) -> dict[str, Any]:
    """Return ``["R=2.1", "preset=physical", "motors=true"]`` as keyword arguments of a plant."""
    values: dict[str, Any] = {}
    for text in texts or []:
        name, equals, value = text.partition("=")
        if not (name and equals and value):
            raise UsageError(f"--set {text}", "no parameter and value", "NAME=VALUE")
        words: dict[str, Any] = {"true": True, "false": False}
        try:
            values[name] = words[value] if value in words else float(value)
        except ValueError:
            values[name] = value  # a choice, such as a preset, which the plant checks
    return values


def made_of(name: str, thing: Any) -> dict[str, str]:
    """Return file -> SHA-256 of the files read for a plant or model; empty for a shipped plant."""
    from robustlab.provenance import code_of, file_sha256

    return code_of(thing) or ({name: file_sha256(name)} if Path(name).is_file() else {})


def _require_known(name: str) -> None:
    """Raise on a name of neither a plant nor a file, with the nearest name of a plant or of a file in its folder."""
    from robustlab.dynamics import plant_names

    path = Path(name)
    try:
        if name in plant_names() or path.exists():
            return
        files = [str(file) for file in path.parent.iterdir()] if path.parent.is_dir() else []
    except (OSError, ValueError):  # a name too long, a NUL in it, a folder that may not be read
        files = []
    known = f"one of {', '.join(plant_names())}, a file, path/to/file.py:name or path/to/machine.fmu"
    hint = did_you_mean(name, [*plant_names(), *files]) or "robustlab plant list"
    raise InputError(name, "no such plant, and no such file", known, hint)
