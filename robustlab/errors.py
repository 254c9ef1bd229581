"""The exception tree, which is also the list of exit codes.

::

    RobustlabError                          exit code
    ├── UsageError                          2    the call itself is off (unknown option, unknown name)
    ├── InputError          (ValueError)    3    a file, a model, a record or a recipe is not what it must be
    │   └── UnitMismatch                    3    units given, and they disagree
    ├── NoTrustworthyNumber (ArithmeticError) 4  the computation ended without a number that can be vouched for
    │   └── NativeTimeout                   4    a native routine did not answer in its time limit
    └── EnvironmentFault    (OSError)       5    disk, permissions, a missing package
        └── DependencyMissing               5    an optional package is not installed

Exit code 0 means done and all requirements met, 1 done but a stated requirement is not met, 70 a bug of ours,
130 Ctrl-C or SIGTERM, 141 the reader of stdout went away before the result was told (``| head -1``).

Every message says WHERE, what was FOUND and what was EXPECTED on one line; the hint says what to do next.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import wraps
from inspect import signature, unwrap
from operator import index
from os import PathLike
from typing import Literal, ParamSpec, TypeVar, get_origin

__all__ = [
    "EXIT_BUG",
    "EXIT_INTERRUPTED",
    "EXIT_OK",
    "EXIT_REQUIREMENT_NOT_MET",
    "DependencyMissing",
    "EnvironmentFault",
    "InputError",
    "NativeTimeout",
    "NoTrustworthyNumber",
    "RobustlabError",
    "UnitMismatch",
    "UsageError",
    "did_you_mean",
    "is_function",
    "keywords_of",
    "named_arguments",
    "plain_text",
    "refuse_unknown",
    "rewritten",
    "told_as",
    "unknown_name",
]

P = ParamSpec("P")
R = TypeVar("R")
# A call, which is left alone, or an argument of a hint with its value.
_ARGUMENT = re.compile(
    r"""[\w.]+\((?:[^()]|\([^()]*\))*\)|(?<![\w-])([a-z]\w*)=(\{[^{}]*\}|\[[^\[\]]*\]|'[^']*'|"[^"]*"|\.\.\.|-?\w[\w.]*)"""
)
MAX_LINE = 1800  # characters of a message that are shown

EXIT_OK = 0
EXIT_REQUIREMENT_NOT_MET = 1
EXIT_BUG = 70
EXIT_INTERRUPTED = 130


class RobustlabError(Exception):
    """Base of all errors that robustlab raises on purpose.

    Parameters
    ----------
    where
        File, dataset, argument or step that is concerned.
    found
        What was found there.
    expected
        What would have been right; left out where ``found`` says it all.
    hint
        What the user can do next; arguments in Python syntax, ``name=value``, see `rewritten`.
    more
        Further findings of the same kind, one line each (all faults of a file are listed, not the first one only).
    """

    exit_code = EXIT_BUG

    def __init__(
        self, where: str, found: str, expected: str | None = None, hint: str | None = None, more: tuple[str, ...] = ()
    ) -> None:
        self.where = where
        self.found = found
        self.expected = expected
        self.hint = hint
        self.more = tuple(more)
        super().__init__(self.line)

    @property
    def line(self) -> str:
        """The one line ``WHERE: FOUND, expected EXPECTED``, safe to print on a terminal."""
        where = self.where.removeprefix(": ")
        text = f"{where}: {self.found}"
        if self.expected:
            text += f", expected {self.expected}"
        return _shown(text)

    def retold(self, name: str) -> None:
        """Put the called function's name before an argument, or in the place of a step's; see `told_as`."""
        head, colon, rest = self.where.partition(":")
        if (not head or head in _STEPS) and head != name:
            self.where = f"{name}{colon}{rest}"
            self.args = (self.line,)

    def __str__(self) -> str:
        lines = [self.line, *(_shown(line) for line in self.more)]
        if self.hint:
            lines.append(f"hint: {_shown(self.hint)}")
        return "\n".join(lines)

    def __reduce__(self) -> tuple[type, tuple[object, ...]]:
        # Errors cross process boundaries (the file reader is a child process).
        return type(self), (self.where, self.found, self.expected, self.hint, self.more)


class UsageError(RobustlabError):
    """The call itself is off; exit code 2."""

    exit_code = 2


class InputError(RobustlabError, ValueError):
    """A file, a model, a record or a recipe is not what it must be; exit code 3."""

    exit_code = 3


class UnitMismatch(InputError):
    """Two signals that are to be connected or compared carry different units; exit code 3."""


class NoTrustworthyNumber(RobustlabError, ArithmeticError):
    """The computation ended without a number that can be vouched for; exit code 4."""

    exit_code = 4


class NativeTimeout(NoTrustworthyNumber):
    """A native routine did not answer in its time limit; exit code 4."""


class EnvironmentFault(RobustlabError, OSError):
    """Disk full, no permission, something of the machine is missing; exit code 5."""

    exit_code = 5


class DependencyMissing(EnvironmentFault):
    """An optional package is not installed; exit code 5."""


def rewritten(hint: str, written: Callable[[str, str], str | None]) -> str:
    """Return a hint with its arguments ``name=value`` as ``written`` gives them; None leaves one, and calls stay.

    Hints are stored in Python syntax; the command line and recipes show them in their own.

    Examples
    --------
    >>> rewritten("u={'force': 1.0}, or f(sign=1)", lambda name, value: f"<{name} {value}>")
    "<u {'force': 1.0}>, or f(sign=1)"
    """

    def one(match: re.Match[str]) -> str:
        return match[0] if match[1] is None else written(match[1], match[2]) or match[0]

    return _ARGUMENT.sub(one, hint)


def did_you_mean(name: str, known: list[str] | tuple[str, ...]) -> str | None:
    """``"did you mean X?"`` for the closest of the known names, or None.

    Examples
    --------
    >>> did_you_mean("nomnal", ["nominal", "perturbed"])
    'did you mean nominal?'
    """
    import difflib

    if not isinstance(name, str):
        return None
    # Names come from files: comparing takes the square of their length, and nobody mistypes thousands of characters.
    near = [other for other in known[:2000] if len(other) <= 200] if len(name) <= 200 else []
    close = difflib.get_close_matches(name, near, n=1)
    return f"did you mean {close[0]}?" if close else None


def unknown_name(where: str, found: str, name: str, known: Iterable[str]) -> InputError:
    """The error for a name that is none of those known, which it lists; the closest of them is its hint."""
    names = tuple(known)
    return InputError(where, found, f"one of {', '.join(names) or 'none'}", did_you_mean(name, names))


def _shown(text: str) -> str:
    """``text`` for a terminal; a name of thousands of characters in a file must not fill the screen."""
    half = MAX_LINE // 2
    return plain_text(text if len(text) <= MAX_LINE else f"{text[:half]} ... {text[-half:]}")


def plain_text(text: str) -> str:
    r"""``text`` without control and bidirectional-override characters, each shown as an escape.

    Names in files are data from outside: an escape sequence in one must not reach the terminal.

    Examples
    --------
    >>> plain_text("omega\x1b[31m")
    'omega\\x1b[31m'
    """
    bidi = "\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069\u200e\u200f"
    return "".join(
        ch if (ch.isprintable() and ch not in bidi) or ch == " " else ch.encode("unicode_escape").decode()
        for ch in text
    )


# What WHERE may begin with and is no function that a user called; `told_as` adds the functions themselves.
_STEPS = {
    *("bilinear map", "care", "central controller", "controller", "coprime factors", "dare", "evaluate"),
    *("frequency axis", "gramians", "H-infinity Riccati test", "lifting", "lower_lft", "lyapunov", "lyapunov_factors"),
    *("residualisation", "scaling", "stable part", "upper_lft"),
}


def told_as(name: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorator of a function that is built on others: its errors begin with its own name, whoever raised them.

    The user called ``disk_margin``; that it takes a `small_gain` test on its way is nothing that they could look up.
    What such functions share says ``": K"`` of an argument K, whoever called: the name is put before it.
    What is no step of ours, a file or a signal for example, stays as it is. Arguments that are no numbers, mappings,
    functions or names where the signature says so are refused, whatever the function would make of them.

    Examples
    --------
    >>> @told_as("outer")
    ... def outer(level: float = 1.0):
    ...     raise InputError("care: R" if level else ": level", "singular", "an invertible R")
    >>> for level in (1.0, 0.0, "one"):
    ...     try:
    ...         outer(level)
    ...     except InputError as error:
    ...         print(error)
    outer: R: singular, expected an invertible R
    outer: level: singular, expected an invertible R
    outer: level: 'one', expected a number
    """
    _STEPS.add(name)

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        given, kinds = _arguments(function)
        known = keywords_of(function)

        @wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            refuse_unknown(getattr(function, "__name__", name), kwargs, known)
            for key, value in (*zip(given, args, strict=False), *kwargs.items()):
                expected, fits = kinds.get(key, ("", None))
                if fits is not None and not fits(value):
                    raise InputError(f"{name}: {key}", repr(value), expected)
            try:
                return function(*args, **kwargs)
            except RobustlabError as error:
                error.retold(name)
                raise

        return call

    return decorate


def keywords_of(function: Callable[..., object]) -> tuple[str, ...] | None:
    """Names of the arguments that may be given by name; None where any may."""
    parameters = signature(function).parameters.values()
    if any(p.kind is p.VAR_KEYWORD for p in parameters):
        return None
    return tuple(p.name for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY))


def refuse_unknown(where: str, given: Iterable[str], known: Sequence[str] | None) -> None:
    """Raise a TypeError, as Python does, for an argument that a function does not have; it names those that there are.

    Examples
    --------
    >>> refuse_unknown("hinf", {"gama_rel": 1.0}, ("P", "gamma_rel"))
    Traceback (most recent call last):
        ...
    TypeError: hinf has no argument 'gama_rel': did you mean gamma_rel? It takes P, gamma_rel
    """
    unknown = None if known is None else next((key for key in given if key not in known), None)
    if unknown is not None:
        hint = did_you_mean(unknown, tuple(known or ()))
        told = f"{where} has no argument {unknown!r}{f': {hint}' if hint else ';'} It takes {', '.join(known or ())}"
        raise TypeError(told.replace("; It", "; it"))


def named_arguments(function: Callable[P, R]) -> Callable[P, R]:
    """Decorator of an ``__init__`` that is called often: the same for it, looked at only once Python has refused."""
    known = tuple(name for name in keywords_of(function) or () if name != "self")

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return function(*args, **kwargs)
        except TypeError:
            refuse_unknown(type(args[0]).__name__, kwargs, known)
            raise

    return call


def _arguments(function: Callable[..., object]) -> tuple[list[str], dict[str, tuple[str, Callable[[object], bool]]]]:
    """Names of what is given by position, and what arguments must be that the signature says more of than a shape."""
    parameters = signature(function).parameters
    kinds: dict[str, tuple[str, Callable[[object], bool]]] = {}
    for key, parameter in parameters.items():
        said = str(parameter.annotation)
        bare = _meant(said.removesuffix(" | None"), function)
        kind = next((k for word, k in _KINDS.items() if bare.startswith(word)), None) if "] | " not in bare else None
        if bare.endswith("Tuning") and bare.isidentifier():
            kind = f"a {bare}", _is_named(bare)
        kind = _BY_NAME.get(key, _WHOLE_KINDS.get(bare, kind))
        if kind is not None:
            expected, fits = kind
            kinds[key] = (f"{expected}, or None", _or_none(fits)) if said.endswith(" | None") else kind
    return [key for key, p in parameters.items() if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)], kinds


def _meant(annotation: str, function: Callable[..., object]) -> str:
    """What a name of the module stands for, and ``str`` for one of several words; another annotation as it is."""
    alias = getattr(unwrap(function), "__globals__", {}).get(annotation)
    if get_origin(alias) in (Literal, get_origin(Callable[[], None]), Sequence):
        annotation = str(alias).removeprefix("typing.").removeprefix("collections.abc.")
    return "str" if annotation.startswith("Literal['") else annotation


def _or_none(fits: Callable[[object], bool]) -> Callable[[object], bool]:
    return lambda value: value is None or fits(value)


def is_function(thing: object) -> bool:
    """Whether a thing is a function: a model can be called, ``G(s)``, and is none."""
    return callable(thing) and not hasattr(thing, "operator_rank")


def _is_number(value: object) -> bool:
    if isinstance(value, (str, bytes)) or getattr(value, "ndim", 0):
        return False
    try:
        float(value)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError, OverflowError):
        return False
    return not isinstance(value, int) or value.bit_length() < 64  # arrays hold no longer ones


def _is_row(value: object) -> bool:
    import numpy as np  # not for whoever only wants the errors

    try:
        array = np.asarray(value)
    except (TypeError, ValueError):
        return False
    return array.dtype.kind in "biuf" and array.ndim <= 1


def _looked_at(values: Iterable[object]) -> Iterable[object]:
    """What may be looked at; of an iterator nothing, for the function would find it used up."""
    return () if isinstance(values, Iterator) else values


def _is_named(name: str) -> Callable[[object], bool]:
    """Whether a value is of the class of that name, which this module, below all others, cannot import.

    Plants, which have an uncertain model, are for the function to speak of.
    """
    return lambda value: any(kind.__name__ == name for kind in type(value).__mro__) or hasattr(value, "uncertain")


def _is_measured(value: object) -> bool:
    return type(value).__name__ in ("Record", "FrequencyData")


def _is_seed(value: object) -> bool:
    try:
        return index(value) >= 0  # pyright: ignore[reportArgumentType]
    except TypeError:
        return False


# What an argument of that name is wherever it stands.
_BY_NAME = {
    "seed": ("a whole number, 0 or more", _is_seed),
    "omega": ("frequencies, real numbers in one row", _or_none(_is_row)),
    "frequency": ("frequencies, real numbers in one row", _or_none(_is_row)),
}
# An annotation -> what is expected, and whether a value is that.
_WHOLE_KINDS: dict[str, tuple[str, Callable[[object], bool]]] = {
    "Literal[-1, 1]": ("-1 or 1", _is_number),
    "Place": ("a word", lambda value: isinstance(value, str)),
    "int": ("a number", _is_number),
    "float": ("a number", _is_number),
    "bool": ("True or False", lambda value: type(value).__name__ in ("bool", "bool_", "int")),
    "str": ("a word", lambda value: isinstance(value, str)),
    "UncertainModel": ("an UncertainModel", _is_named("UncertainModel")),
    "Record": ("a Record", _is_named("Record")),
    "Record | FrequencyData": ("a Record or a FrequencyData", _is_measured),
    "Synthesis": ("a finished design", _is_named("Synthesis")),
    # A model in the place of the file is for the function to speak of.
    "str | Path": ("a path", lambda value: isinstance(value, str | PathLike) or hasattr(value, "operator_rank")),
}
# Beginning of an annotation -> what is expected, and whether a value is that.
_KINDS: dict[str, tuple[str, Callable[[object], bool]]] = {
    "Sequence[str]": (
        "a list of names",
        lambda value: isinstance(value, Iterable) and all(isinstance(name, str) for name in _looked_at(value)),
    ),
    "Mapping[": ("names with their values, {...}", lambda value: isinstance(value, Mapping)),
    "Callable[": ("a function", is_function),
    "Sequence[Block]": (
        "a list of blocks",
        lambda value: isinstance(value, Iterable) and all(hasattr(block, "rows") for block in _looked_at(value)),
    ),
    "Sequence[Record]": (
        "a list of records",
        lambda value: isinstance(value, Iterable) and all(_is_measured(one) for one in _looked_at(value)),
    ),
    "Sequence[": ("a list", lambda value: isinstance(value, Iterable) and not isinstance(value, bytes)),
    "Iterable[Any]": ("a list", lambda value: isinstance(value, Iterable)),
}
