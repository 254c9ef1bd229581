"""The exception tree, which is also the list of exit codes.

::

    RobustlabError                          exit code
    ├── UsageError                          2    the call itself is off (unknown option, unknown name)
    ├── InputError          (ValueError)    3    a file, a model, a record or a recipe is not what it must be
    │   └── UnitMismatch                    3    units given, and they disagree
    ├── NoTrustworthyNumber (ArithmeticError) 4  the computation ended without a trustworthy number
    │   └── NativeTimeout                   4    a native routine did not answer in its time limit
    └── EnvironmentFault    (OSError)       5    disk, permissions, a missing package
        └── DependencyMissing               5    an optional package is not installed

Exit code 0 means done and all requirements met, 1 done but a stated requirement is not met, 70 an internal error,
130 Ctrl-C or SIGTERM, 141 the reader of stdout closed it before the end of the result (``| head -1``).

Every message has WHERE, FOUND and EXPECTED on one line; the hint is the next step.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from functools import wraps
from importlib.util import find_spec
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")
# A call, which is left alone, or an argument of a hint with its value.
_ARGUMENT = re.compile(
    r"""[\w.]+\((?:[^()]|\([^()]*\))*\)|(?<![\w-])([a-z]\w*)=(\{[^{}]*\}|\[[^\[\]]*\]|'[^']*'|"[^"]*"|\.\.\.|-?\w[\w.]*)"""
)
MAX_LINE = 1800  # characters of a message on the terminal

EXIT_OK = 0
EXIT_REQUIREMENT_NOT_MET = 1
EXIT_BUG = 70
EXIT_INTERRUPTED = 130


class RobustlabError(Exception):
    """Base of all errors that robustlab raises on purpose.

    Parameters
    ----------
    where
        File, dataset, argument or step with the error.
    found
        The fault.
    expected
        The expectation; left out where ``found`` is clear without it.
    hint
        The next step of the user; arguments in Python syntax, ``name=value``, see `rewritten`.
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

    def in_context(self, name: str) -> None:
        """Put the called function's name before an argument, or in place of a step's; see `error_context`."""
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
        # for pickling: errors cross process boundaries (the file reader is a child process)
        return type(self), (self.where, self.found, self.expected, self.hint, self.more)


class UsageError(RobustlabError):
    """The call itself is wrong; exit code 2."""

    exit_code = 2


class InputError(RobustlabError, ValueError):
    """A file, a model, a record or a recipe is invalid; exit code 3."""

    exit_code = 3


class UnitMismatch(InputError):
    """Two signals to be connected or compared have different units; exit code 3."""


class NoTrustworthyNumber(RobustlabError, ArithmeticError):
    """The computation ended without a trustworthy number; exit code 4."""

    exit_code = 4


class NativeTimeout(NoTrustworthyNumber):
    """A native routine exceeded its time limit; exit code 4."""


class EnvironmentFault(RobustlabError, OSError):
    """Disk full, no permission, something of the machine is missing; exit code 5."""

    exit_code = 5


class DependencyMissing(EnvironmentFault):
    """An optional package is not installed; exit code 5."""


def require_package(where: str, package: str, extra: str) -> None:
    if find_spec(package) is None:
        raise DependencyMissing(where, f"needs the package {package}", None, f"pip install 'robustlab[{extra}]'")


def rewritten(hint: str, written: Callable[[str, str], str | None]) -> str:
    """Return a hint with its arguments ``name=value`` rewritten; None leaves one, and calls are unchanged."""

    def one(match: re.Match[str]) -> str:
        return match[0] if match[1] is None else written(match[1], match[2]) or match[0]

    return _ARGUMENT.sub(one, hint)


def did_you_mean(name: str, known: list[str] | tuple[str, ...]) -> str | None:
    """Return ``"did you mean X?"`` for the closest of the known names, or None."""
    import difflib

    if not isinstance(name, str):
        return None
    # Names come from files, and the work is the square of their length.
    near = [other for other in known[:2000] if len(other) <= 200] if len(name) <= 200 else []
    close = difflib.get_close_matches(name, near, n=1)
    return f"did you mean {close[0]}?" if close else None


def unknown_name(where: str, found: str, name: str, known: Iterable[str]) -> InputError:
    """Return the error for an unknown name, with the known ones and the closest of them as hint."""
    names = tuple(known)
    return InputError(where, found, f"one of {', '.join(names) or 'none'}", did_you_mean(name, names))


def _shown(text: str) -> str:
    half = MAX_LINE // 2
    return plain_text(text if len(text) <= MAX_LINE else f"{text[:half]} ... {text[-half:]}")


def plain_text(text: str) -> str:
    """Return ``text`` with control and bidirectional-override characters as escapes."""
    # Names in files are external data: their escape sequences must not reach the terminal.
    bidi = "\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069\u200e\u200f"
    return "".join(
        ch if (ch.isprintable() and ch not in bidi) or ch == " " else ch.encode("unicode_escape").decode()
        for ch in text
    )


# Inner steps with which WHERE may begin; `error_context` adds the functions.
_STEPS = {
    *("bilinear map", "care", "central controller", "controller", "coprime factors", "dare", "evaluate"),
    *("frequency axis", "gramians", "H-infinity Riccati test", "lifting", "lower_lft", "lyapunov", "lyapunov_factors"),
    *("residualisation", "scaling", "stable part", "upper_lft"),
}


def error_context(name: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate a function so that errors raised in it begin with its own name.

    WHERE of an inner step, such as the `robust_stability` of a ``disk_margin``, is replaced by the name. Shared
    functions write ``": K"`` for an argument K, before which the name is put. Other texts, such as a file or a signal,
    are unchanged.
    """
    _STEPS.add(name)

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        @wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            try:
                return function(*args, **kwargs)
            except RobustlabError as error:
                error.in_context(name)
                raise

        return call

    return decorate


def is_function(value: object) -> bool:
    """Return whether a value is a function, and not a model, which can be called as ``G(s)``."""
    return callable(value) and not hasattr(value, "operator_rank")
