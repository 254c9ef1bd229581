"""The exception tree is the list of exit codes; messages are one clear line, safe on a terminal."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping, Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustlab import errors
from robustlab.errors import InputError, RobustlabError


@pytest.mark.parametrize(
    ("name", "code", "base"),
    [
        ("UsageError", 2, RobustlabError),
        ("InputError", 3, ValueError),
        ("UnitMismatch", 3, InputError),
        ("NoTrustworthyNumber", 4, ArithmeticError),
        ("NativeTimeout", 4, errors.NoTrustworthyNumber),
        ("EnvironmentFault", 5, OSError),
        ("DependencyMissing", 5, errors.EnvironmentFault),
    ],
)
def test_exit_codes(name, code, base):
    kind = getattr(errors, name)
    assert kind.exit_code == code
    assert issubclass(kind, base)
    assert issubclass(kind, RobustlabError)


def test_errors_cross_process_boundaries():
    error = InputError("a", "b", "c", "d", ("e",))
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is InputError
    assert str(copy) == str(error)


@settings(max_examples=50, deadline=None, derandomize=True)
@given(st.text(max_size=40))
def test_no_control_character_reaches_the_terminal(text):
    shown = str(RobustlabError(text, text, text, text, (text,)))
    assert all(ch.isprintable() for line in shown.split("\n") for ch in line)
    assert not set("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069\u200e\u200f\x1b") & set(shown)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("one",), "level: 'one', expected a number"),
        ((1.0, -1), "seed: -1, expected a whole number"),
        ((1.0, 0, [1]), "named: \\[1\\], expected names with their values"),
        ((1.0, 0, None, "say"), "say: 'say', expected a function, or None"),
        ((1.0, 0, None, None, 3.0), "some: 3.0, expected a list"),
    ],
)
def test_arguments_of_another_kind_are_refused_by_the_signature(arguments, text):
    @errors.told_as("outer")
    def outer(
        level: float = 1.0, seed: int = 0, named: Mapping[str, float] | None = None,
        say: Callable[[], None] | None = None, some: Sequence[str] = (), free: Mapping[str, int] | list[int] = (),
    ) -> float:  # fmt: skip
        return level

    assert outer(2.0, 1, {}, print, ["a"], [1]) == 2.0
    with pytest.raises(InputError, match="outer: " + text):
        outer(*arguments)
