"""The public docstrings, and the page that explains the rooms."""

from __future__ import annotations

import enum
import inspect
import re
from pathlib import Path

import pytest

import robustlab as rl

ROOT = Path(__file__).resolve().parents[3]


def test_every_room_stands_on_the_page():
    page = (ROOT / "docs" / "architecture.md").read_text()
    rooms = [d for d in (ROOT / "robustlab").rglob("*") if (d / "__init__.py").exists()]
    missing = [str(d.relative_to(ROOT)) for d in rooms if not re.search(rf"`[\w/]*\b{d.name}\b[\w/.]*`", page)]
    assert missing == []


def test_paths_on_the_page_exist():
    page = (ROOT / "docs" / "architecture.md").read_text()
    named = re.findall(r"`((?:\w+/)+\w*(?:\.\w+)?)`", page)
    assert len(named) > 20
    missing = [
        n
        for n in named
        if not any(
            (ROOT / top / f"{n}{end}").exists()
            for top in ("", "robustlab", "robustlab/identification", "robustlab/synthesis")
            for end in ("", ".py")
        )
    ]
    assert missing == []


def sections(doc: str) -> set[str]:
    return set(re.findall(r"(?m)^(\w+(?: \w+)?)\n-{3,}$", doc))


def lacking(obj: object) -> list[str]:
    """What the docstring of a public name does not have."""
    doc = inspect.cleandoc(obj.__doc__ or "")
    said = sections(doc)
    if inspect.isclass(obj):
        exempt = issubclass(obj, (enum.Enum, BaseException))
        return [] if exempt or said & {"Parameters", "Attributes"} else ["Parameters or Attributes"]
    arguments = list(inspect.signature(obj).parameters)
    described = doc.split("Parameters\n----------")[-1] if "Parameters" in said else ""
    lack = [
        name for name in arguments if not re.search(rf"(?m)^[\w*, ]*\b{re.escape(name)}\b[\w*, ]*( :.*)?$", described)
    ]
    return lack + [s for s in ("Returns", "Raises") if s not in said]


@pytest.mark.parametrize("name", rl._PUBLIC)
def test_public_docstrings_say_what_goes_in_what_comes_out_and_what_is_raised(name):
    assert lacking(getattr(rl, name)) == []


def test_the_test_of_docstrings_can_fail():
    def undocumented(first: int, second: int) -> int:
        """Add.

        Parameters
        ----------
        first
            A number.
        """
        return first + second

    assert lacking(undocumented) == ["second", "Returns", "Raises"]
