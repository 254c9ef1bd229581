"""A test a recorded case; nothing of a subject is imported before its first case is run."""

import warnings
from typing import Any

import pytest

from . import cases as c


def recorded(*subjects: str) -> Any:
    """A parametrisation over all recorded cases of some subjects."""
    rows = []
    for subject in subjects:
        for name, entry in c.stored(subject).items():
            marks = [getattr(pytest.mark, mark) for mark in ("slow", "shared") if entry[mark]]
            rows.append(pytest.param(subject, name, marks=marks, id=f"{subject}: {name}"))
    return pytest.mark.parametrize(("subject", "name"), rows)


def check(subject: str, name: str) -> None:
    """The case answers as it did."""
    entry = c.stored(subject)[name]
    if entry["shared"] and not c.SHARED.exists():
        pytest.skip("needs the data in ../shared")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found, _ = c.answer(c.cases_of(subject)[name])
    wrong = c.differences(subject, entry, found)
    assert not wrong, "\n".join(f"{path}: {old} -> {new}" for path, (old, new) in wrong.items())
