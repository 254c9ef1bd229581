"""The registry of operations: `operation` declares a function; its command, its step and their help are generated.

Each parameter is annotated ``Annotated[type, kind, "help"]``; without a kind, the type gives it. The fields of a
dataclass parameter are options of their own. Numerical modules are imported inside the functions.
"""

from __future__ import annotations

import ast
import inspect
import json
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from functools import cache
from importlib import import_module
from typing import Any, Literal, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

from robustlab.errors import rewritten
from robustlab.operations.kinds import Choice, Feedback, Flag, Kind, Number, Thing, Whole

F = TypeVar("F", bound=Callable[..., Any])

REQUIRED = inspect.Parameter.empty
# Kind of step, and words of a command -> the operation.
STEPS: dict[str, Operation] = {}
COMMANDS: dict[str, Operation] = {}


@dataclass(frozen=True)
class Named:
    """In an annotation: names of the parameter in Python, as option and as key, where they differ from its own.

    The key of the first object is "of", where nothing else is given.
    """

    argument: str = ""
    option: str = ""  # ``--filter-order``, or ``-k,--controller``
    key: str = ""
    only: str = ""  # "command" or "step", where only that one has the parameter
    in_step: Any = None  # default of a recipe's key, where it differs from the command's; ``...``: required


class InLoop(NamedTuple):
    """A result with its loop, notes, and additional results, returned by an operation instead of a result alone."""

    result: Any
    loop: str = ""  # description of the loop
    notes: tuple[str, ...] = ()
    beside: Mapping[str, Any] = {}  # name -> a text, or a further result, whose status is checked, too
    parts: tuple[Any, ...] = ()  # requested tables, each a `robustlab.display.Part`
    numbers: Mapping[str, Any] = {}  # further ones, for the requirements of a recipe


@dataclass(frozen=True)
class Parameter:
    """One parameter of an operation."""

    name: str
    kind: Kind
    default: Any
    help: str
    called: Named = Named()

    @property
    def needed(self) -> bool:
        return self.default is REQUIRED

    @property
    def options(self) -> tuple[str, ...]:
        return tuple(self.called.option.split(",")) if self.called.option else (f"--{self.name.replace('_', '-')}",)

    @property
    def key(self) -> str:
        return self.called.key or self.name


@dataclass(frozen=True)
class Operation:
    """A function that is a command, a kind of step, or both."""

    function: Callable[..., Any]
    command: str  # words after ``robustlab``; empty where there is none
    step: str  # value of ``do`` in a recipe; empty where there is none
    title: str  # first paragraph of the docstring
    more: str  # its further paragraphs
    example: str
    result: str  # ``module.Class`` of the result, below ``robustlab``; several with commas between them
    gives: str = "nothing"  # kind of the value passed to later steps
    made: str = ""  # attribute of the result to save with ``--out`` and pass to later steps; "": the result
    # Inference before a recipe runs: the key of a step whose signals the result keeps (those of ``outputs`` where that
    # is a key), or a function of the step and the inference of earlier steps; None: nothing.
    infer: str | Callable[[Any, Any], Any] | None = None
    own: bool = False  # the command is defined by hand in its group
    calls: str = (
        ""  # ``module.function`` below ``robustlab`` that takes the values as they are; "": the function's body
    )
    progress: str = ""  # "lines": each text is a line where stderr is no terminal; "parts", "steps": work is counted

    @property
    def parameters(self) -> list[Parameter]:
        """Return the parameters that a user gives: all but ``progress`` and ``drawn``."""
        return _parameters(self.function)

    def takes(self, name: str) -> bool:
        return name in inspect.signature(self.function).parameters

    @property
    def result_classes(self) -> list[Any]:
        """Return the possible classes of the result."""
        paths = [path.strip().rpartition(".") for path in self.result.split(",")]
        return [getattr(import_module(f"robustlab.{module}"), name) for module, _, name in paths]

    @property
    def quantities(self) -> Mapping[str, Any]:
        """Return the names that requirements may refer to, of all classes of the result."""
        found = [kind.quantities for kind in self.result_classes]
        return found[0] if len(found) == 1 else {name: leaf for each in reversed(found) for name, leaf in each.items()}

    def made_of(self, result: Any) -> Any:
        """Return the part of a result that is saved and passed to later steps."""
        return getattr(result, self.made) if self.made else result

    def hint(self, text: str, of_command: bool) -> str:
        """Return a hint in Python syntax as the command line or a recipe writes it."""
        known = {name: p for p in self.parameters for name in (p.called.argument or p.name, p.key)}

        def written(name: str, value: str) -> str | None:
            p = known.get(name)
            if p is None:
                return reading_option(name, value) if of_command else f"{name} = {in_toml(value)}"
            if not of_command:
                return f"{p.key} = {in_toml(value)}"
            signs = {"-1": "negative", "1": "positive"} if isinstance(p.kind, Feedback) else {}
            return as_option(p.options[0], signs.get(value, value))

        return rewritten(text, written)

    def __call__(self, **values: Any) -> InLoop:
        """Call the function; values of a dataclass' fields are passed as that dataclass."""
        if self.calls:
            module, _, name = self.calls.rpartition(".")
            return InLoop(getattr(import_module(f"robustlab.{module}"), name)(**values))
        for name, group in _groups(self.function).items():
            own = [f.name for f in fields(group) if f.name in values]
            values[name] = group(**{field: values.pop(field) for field in own})
        found = self.function(**values)
        return found if isinstance(found, InLoop) else InLoop(found)


# Arguments of reading a file -> options of commands.
READING = {
    **{name: f"--{name.replace('_', '-')}" for name in ("transpose", "group", "clock", "dt", "decimal", "delimiter")},
    **{name: f"--{name.replace('_', '-')}" for name in ("allow_gaps", "no_verify", "inputs", "outputs")},
    "units": "--unit",
}


def reading_option(name: str, value: str) -> str | None:
    """Return an argument of reading a file as the option that every command has for it; None of another."""
    return as_option(READING[name], value) if name in READING else None


def as_option(option: str, value: str) -> str:
    """Return an option of a command with a value in Python syntax: a flag, a word, a list, or a table in pairs."""
    given = _literal(value)
    if given is True:
        return option
    if isinstance(given, dict):
        return " ".join(f"{option} {key}={one}" for key, one in given.items())
    text = ",".join(map(str, given)) if isinstance(given, (list, tuple)) else str(given)
    return f"{option} {text}"


def in_toml(value: str) -> str:
    """Return a value in Python syntax as a recipe writes it."""
    given = _literal(value)
    if isinstance(given, dict):
        return f"{{ {', '.join(f'{key} = {json.dumps(one)}' for key, one in given.items())} }}"
    return value if given == value else json.dumps(given)


def _literal(value: str) -> Any:
    """Return the value of a Python literal; ``...`` and other text unchanged."""
    try:
        return ast.literal_eval(value.replace("...", "'...'"))
    except (SyntaxError, ValueError):
        return value


def operation(command: str = "", step: str = "", **more: Any) -> Callable[[F], F]:
    """Register a function as a command and a kind of step (decorator); ``more`` are further fields of `Operation`."""

    def declared(function: F) -> F:
        paragraphs = inspect.cleandoc(function.__doc__ or "").split("\n\n")
        example = next((p.removeprefix("Example: ") for p in paragraphs if p.startswith("Example: ")), "")
        rest = "\n\n".join(p for p in paragraphs[1:] if not p.startswith("Example: "))
        found = Operation(function, command, step, paragraphs[0], rest, example, **more)
        if command:
            COMMANDS[command] = found
        if step:
            STEPS[step] = found
        return function

    return declared


@cache
def _parameters(function: Callable[..., Any]) -> list[Parameter]:
    hints = get_type_hints(function, include_extras=True)
    found: list[Parameter] = []
    for name, given in inspect.signature(function).parameters.items():
        if is_dataclass(hints[name]):
            of_field = get_type_hints(hints[name], include_extras=True)
            found += [
                _parameter(f.name, of_field[f.name], REQUIRED if f.default is MISSING else f.default)
                for f in fields(hints[name])
            ]
        elif name not in ("progress", "drawn"):
            found.append(_parameter(name, hints[name], given.default))
    first = next((i for i, p in enumerate(found) if isinstance(p.kind, Thing)), None)
    if first is not None and not found[first].called.key:
        found[first] = replace(found[first], called=replace(found[first].called, key="of"))
    return found


def _parameter(name: str, hint: Any, default: Any) -> Parameter:
    """Return a parameter with the outermost kind, help and names in its annotation."""
    marks: dict[Any, Any] = {}
    for mark in _marks(hint):
        marks[Kind if isinstance(mark, Kind) else type(mark)] = mark
    kind = marks[Kind] if Kind in marks else _kind_of(hint)
    return Parameter(name, kind, default, marks.get(str, ""), marks.get(Named, Named()))


def _kind_of(hint: Any) -> Kind:
    """Return the kind of a parameter from its type: words, yes or no, a whole number, a number, or a text."""
    inner = [part for part in get_args(hint) if part is not type(None)] if get_origin(hint) is not Literal else []
    if inner:
        return _kind_of(inner[0])
    return Choice(get_args(hint)) if get_args(hint) else {bool: Flag(), int: Whole(), float: Number()}.get(hint, Kind())


@cache
def _groups(function: Callable[..., Any]) -> dict[str, Any]:
    return {name: hint for name, hint in get_type_hints(function).items() if is_dataclass(hint)}


def _marks(hint: Any) -> list[Any]:
    """Return the metadata of an annotation, also of alternatives in a union; the outermost comes last."""
    inner = [mark for part in get_args(hint) for mark in _marks(part)] if get_origin(hint) is not Literal else []
    return [*inner, *getattr(hint, "__metadata__", ())]


def load_family(family: str) -> None:
    """Import a module of operations."""
    import_module(f"robustlab.operations.{family}")


def every_operation() -> list[Operation]:
    """Return all operations, each once."""
    for family in ALL:
        load_family(family)
    return list(dict.fromkeys([*COMMANDS.values(), *STEPS.values()]))


# The modules of operations.
ALL = ("data", "designs", "members", "models", "robustness")
