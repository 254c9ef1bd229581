"""The registry of operations, from which commands, steps of recipes and their help are generated.

`public` registers a public function: its row has the names of command and step, and the kinds of the parameters whose
type does not determine them (files, bounds). Types, defaults and help are those of the function's signature and
numpydoc docstring, read from its source, so that no numerical library is loaded.

`operation` registers a function that prepares arguments of a public one, and passes on the parameters named in its row
and those in `COMMON`. Its own are annotated ``Annotated[type, kind, "help"]``; without a kind, the type gives it. The
fields of a dataclass parameter are options of their own. Numerical modules are imported inside the functions.
"""

from __future__ import annotations

import ast
import inspect
import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, replace
from functools import cache, cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

import robustlab
from robustlab.errors import rewritten
from robustlab.operations.common_parameters import COMMON
from robustlab.operations.parameter_types import (
    Choice,
    Feedback,
    Flag,
    Kind,
    Names,
    Number,
    RecordFile,
    Table,
    Thing,
    Whole,
)

F = TypeVar("F", bound=Callable[..., Any])

REQUIRED = inspect.Parameter.empty
# Kind of step, and words of a command -> the operation.
STEPS: dict[str, Operation] = {}
COMMANDS: dict[str, Operation] = {}
# Type of a parameter -> its kind.
OF_TYPE: Mapping[str, Kind] = {
    "bool": Flag(), "int": Whole(), "float": Number(), "Record": RecordFile(), "Sequence[str]": Names(),
    "Mapping[str, float]": Table(Number()),
}  # fmt: skip


class InLoop(NamedTuple):
    """A result with its loop, notes, and additional results, returned by an operation instead of a result alone."""

    result: Any
    loop: str = ""  # description of the loop
    notes: tuple[str, ...] = ()
    extras: Mapping[str, Any] = {}  # name -> a text, or a further result, whose status is checked, too
    parts: tuple[Any, ...] = ()  # requested tables, each a `robustlab.display.Part`
    numbers: Mapping[str, Any] = {}  # further ones, for the requirements of a recipe


@dataclass(frozen=True)
class Parameter:
    """One parameter of an operation."""

    name: str
    kind: Kind
    default: Any
    help: str

    @property
    def needed(self) -> bool:
        return self.default is REQUIRED

    @property
    def options(self) -> tuple[str, ...]:
        return tuple(self.kind.option.split(",")) if self.kind.option else (f"--{self.name.replace('_', '-')}",)

    @property
    def key(self) -> str:
        return self.kind.key or self.name


@dataclass(frozen=True, eq=False)
class Operation:
    """A function that is a command, a kind of step, or both."""

    function: Callable[..., Any] | None  # that prepares arguments; None: the public function takes them as they are
    command: str  # words after ``robustlab``; empty where there is none
    step: str  # value of ``do`` in a recipe; empty where there is none
    result: str  # ``module.Class`` of the result, below ``robustlab``; several with commas between them
    gives: str = "nothing"  # kind of the value passed to later steps
    made: str = ""  # attribute of the result to save with ``--out`` and pass to later steps; "": the result
    # Before a recipe runs: the keys of steps whose inputs and whose outputs the result has ("of models": the first that
    # is given), or a function of the step and the inference of earlier steps; None: it has none.
    infer: tuple[str, str] | Callable[[Any, Any], Any] | None = None
    numbers: Mapping[str, Any] = field(default_factory=dict[str, Any])  # `InLoop.numbers`: name -> unit
    progress: str = ""  # "lines": each text is a line where stderr is no terminal; "parts", "steps": work is counted
    public: str = ""  # path ``module.function`` below ``robustlab`` of the public function
    text: str = ""  # further paragraphs of help, below the first one of a public function
    # Of the public function: parameter -> its kind, its help, or both; None: it is not offered.
    kinds: Mapping[str, Any] = field(default_factory=dict[str, Any])

    @property
    def name(self) -> str:
        return self.function.__name__ if self.function else self.public.rpartition(".")[2]

    @cached_property
    def paragraphs(self) -> list[str]:
        """Return the help of the command: the first paragraph of a public function's docstring and ``text``."""
        if self.function:
            return inspect.cleandoc(self.function.__doc__ or "").split("\n\n")
        doc = ast.get_docstring(source_of(self.public)) or ""
        return [_plain(doc.partition("\n\n")[0]), *filter(None, self.text.split("\n\n"))]

    @cached_property
    def _every(self) -> list[Parameter]:
        own = _of_function(self.function) if self.function else []
        passed = _of_public(self.public, self.kinds, self.function is None) if self.public else []
        found = [*own, *passed]
        first = next((i for i, p in enumerate(found) if isinstance(p.kind, Thing)), None)
        if first is not None and not found[first].kind.key:
            found[first] = replace(found[first], kind=replace(found[first].kind, key="of"))
        return found

    @property
    def parameters(self) -> list[Parameter]:
        """Return the parameters that a user gives: all but ``progress`` and ``drawn``."""
        return [p for p in self._every if p.name not in ("progress", "drawn")]

    def takes(self, name: str) -> bool:
        return any(p.name == name for p in self._every)

    @property
    def result_classes(self) -> list[Any]:
        paths = [path.strip().rpartition(".") for path in self.result.split(",")]
        return [getattr(import_module(f"robustlab.{module}"), name) for module, _, name in paths]

    @property
    def quantities(self) -> Mapping[str, Any]:
        """Return the names that requirements may refer to, of all classes of the result."""
        found = [kind.quantities for kind in self.result_classes]
        return {name: leaf for each in (*reversed(found), self.numbers) for name, leaf in each.items()}

    def made_of(self, result: Any) -> Any:
        return getattr(result, self.made) if self.made else result

    def hint(self, text: str, of_command: bool) -> str:
        """Return a hint in Python syntax as the command line or a recipe writes it."""
        known = {name: p for p in self.parameters for name in (p.kind.argument or p.name, p.key)}

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
        if self.function is None:
            module, _, name = self.public.rpartition(".")
            return InLoop(getattr(import_module(f"robustlab.{module}"), name)(**values))
        for name, group in _groups(self.function).items():
            own = [f.name for f in fields(group) if f.name in values]
            values[name] = group(**{part: values.pop(part) for part in own})
        found = self.function(**values)
        return found if isinstance(found, InLoop) else InLoop(found)


# Arguments of reading a file, which every command has as options.
READING = ("transpose", "group", "clock", "dt", "decimal", "delimiter", "allow_gaps", "no_verify", "inputs", "outputs")


def reading_option(name: str, value: str) -> str | None:
    """Return an argument of reading a file as an option; None of another."""
    option = "--unit" if name == "units" else f"--{name.replace('_', '-')}" if name in READING else ""
    return as_option(option, value) if option else None


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


def public(path: str, command: str = "", step: str = "", **more: Any) -> None:
    """Register a public function by its path; ``more`` are further fields of `Operation`."""
    _register(Operation(None, command, step, public=path, **more))


def operation(command: str = "", step: str = "", **more: Any) -> Callable[[F], F]:
    """Register a function as a command and a kind of step (decorator); ``more`` are further fields of `Operation`."""

    def declared(function: F) -> F:
        _register(Operation(function, command, step, **more))
        return function

    return declared


def _register(found: Operation) -> None:
    if found.command:
        COMMANDS[found.command] = found
    if found.step:
        STEPS[found.step] = found


# --- public functions ------------------------------------------------------------------------------------------------


@cache
def _tree(path: str) -> ast.Module:
    file = Path(robustlab.__file__).parent.joinpath(*path.split(".")[:-1]).with_suffix(".py")
    return ast.parse(file.read_text(encoding="utf-8"))


def source_of(path: str) -> ast.FunctionDef:
    """Return the syntax tree of a function ``module.function`` below ``robustlab``; overloads come before it."""
    functions = [node for node in _tree(path).body if isinstance(node, ast.FunctionDef)]
    return next(node for node in reversed(functions) if node.name == path.rpartition(".")[2])


def _signature(path: str) -> Iterator[tuple[str, str, ast.expr | None]]:
    given = source_of(path).args
    needed: list[Any] = [None] * (len(given.args) - len(given.defaults))
    defaults = [*needed, *given.defaults, *given.kw_defaults]
    for one, default in zip([*given.args, *given.kwonlyargs], defaults, strict=True):
        yield one.arg, ast.unparse(one.annotation).removesuffix(" | None") if one.annotation else "", default


def _value(path: str, default: ast.expr | None) -> Any:
    if isinstance(default, ast.Name):
        assigned = (node for node in _tree(path).body if isinstance(node, ast.Assign))
        default = next(node.value for node in assigned if ast.unparse(node.targets[0]) == default.id)
    return REQUIRED if default is None else ast.literal_eval(default)


def _of_public(path: str, kinds: Mapping[str, Any], whole: bool) -> Iterator[Parameter]:
    """Yield the parameters of a public function; only those in ``kinds`` and `COMMON` unless ``whole``."""
    helps = _helps(ast.get_docstring(source_of(path)) or "")
    for name, hint, default in _signature(path):
        given = kinds.get(name, COMMON.get(name, () if whole else None))
        if given is not None:
            of_type = Choice(tuple(ast.literal_eval(hint[7:]))) if hint.startswith("Literal[") else OF_TYPE.get(hint)
            marks = [mark for one in (given if isinstance(given, tuple) else (given,)) for mark in _marks(one) or [one]]
            yield _marked(name, [helps.get(name, ""), of_type or Kind(), *marks], _value(path, default))


def _helps(doc: str) -> dict[str, str]:
    """Return the text on each parameter in a numpydoc docstring."""
    section = re.split(r"\n\n\S.*\n-{3,}\n", doc.partition("\nParameters\n----------\n")[2])[0]
    found: dict[str, str] = {}
    for part in re.split(r"\n(?=\S)", section):
        names, _, text = part.partition("\n")
        found |= dict.fromkeys(names.split(", "), _plain(text))
    return found


def _plain(text: str) -> str:
    """Return the text of a docstring on one line, without marks."""
    return " ".join(re.sub(r":math:|`", "", text).split())


# --- functions that prepare arguments --------------------------------------------------------------------------------


def _of_function(function: Callable[..., Any]) -> Iterator[Parameter]:
    hints = get_type_hints(function, include_extras=True)
    for name, given in inspect.signature(function).parameters.items():
        if given.kind is given.VAR_KEYWORD:
            continue
        if not is_dataclass(hints[name]):
            yield _parameter(name, hints[name], given.default)
            continue
        of_field = get_type_hints(hints[name], include_extras=True)
        for f in fields(hints[name]):
            yield _parameter(f.name, of_field[f.name], REQUIRED if f.default is MISSING else f.default)


def _parameter(name: str, hint: Any, default: Any) -> Parameter:
    return _marked(name, ["", _kind_of(hint), *_marks(hint)], default)


def _marked(name: str, marks: list[Any], default: Any) -> Parameter:
    """Return a parameter with the outermost kind and help, which come last."""
    kind = next(mark for mark in reversed(marks) if isinstance(mark, Kind))
    text = next(mark for mark in reversed(marks) if isinstance(mark, str))
    return Parameter(name, kind, default, text)


def _kind_of(hint: Any) -> Kind:
    if get_origin(hint) is Literal:
        return Choice(get_args(hint))
    inner = [part for part in get_args(hint) if part is not type(None)]
    return _kind_of(inner[0]) if inner else OF_TYPE.get(getattr(hint, "__name__", ""), Kind())


@cache
def _groups(function: Callable[..., Any]) -> dict[str, Any]:
    return {name: hint for name, hint in get_type_hints(function).items() if is_dataclass(hint)}


def _marks(hint: Any) -> list[Any]:
    """Return the metadata of an annotation, also of alternatives in a union; the outermost comes last."""
    inner = [mark for part in get_args(hint) for mark in _marks(part)] if get_origin(hint) is not Literal else []
    return [*inner, *getattr(hint, "__metadata__", ())]


def load_family(family: str) -> None:
    import_module(f"robustlab.operations.{family}")


def every_operation() -> list[Operation]:
    for family in ALL:
        load_family(family)
    return list(dict.fromkeys([*COMMANDS.values(), *STEPS.values()]))


# The modules of operations.
ALL = ("data", "designs", "models", "robustness", "worst_cases")
