"""The exception tree is the list of exit codes; messages are one clear line, safe on a terminal."""

from __future__ import annotations

import pickle

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


@settings(max_examples=50)
@given(st.text(max_size=40))
def test_no_control_character_reaches_the_terminal(text):
    shown = str(RobustlabError(text, text, text, text, (text,)))
    assert all(ch.isprintable() for line in shown.split("\n") for ch in line)
    assert not set("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069\u200e\u200f\x1b") & set(shown)
