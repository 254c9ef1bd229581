"""The public docstrings, and the page that explains the packages."""

import enum
import inspect
import re

import pytest

import robustlab as rl


def sections(doc: str) -> set[str]:
    return set(re.findall(r"(?m)^(\w+(?: \w+)?)\n-{3,}$", doc))


def lacking(obj: object) -> list[str]:
    """What the docstring of a public name does not have."""
    doc = inspect.cleandoc(obj.__doc__ or "")
    found = sections(doc)
    if inspect.isclass(obj):
        exempt = issubclass(obj, (enum.Enum, BaseException))
        return [] if exempt or found & {"Parameters", "Attributes"} else ["Parameters or Attributes"]
    arguments = list(inspect.signature(obj).parameters)
    described = doc.split("Parameters\n----------")[-1] if "Parameters" in found else ""
    lack = [
        name for name in arguments if not re.search(rf"(?m)^[\w*, ]*\b{re.escape(name)}\b[\w*, ]*( :.*)?$", described)
    ]
    return lack + [s for s in ("Returns", "Raises") if s not in found]


@pytest.mark.parametrize("name", rl._PUBLIC)
def test_public_docstrings_describe_parameters_returns_and_errors(name):
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
