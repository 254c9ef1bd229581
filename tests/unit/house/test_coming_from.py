"""Names of other programs and mistyped ones, and unknown arguments, are answered with what there is."""

import inspect
import re

import pytest

import robustlab as rl
from robustlab.coming_from import NAMES


@pytest.mark.parametrize(
    ("name", "answer"),
    [("wcgain", "no 'wcgain'; here it is rl.peak_gain"), ("robust_stabilty", "did you mean robust_stability?")],
)
def test_an_unknown_name_is_answered(name, answer):
    with pytest.raises(AttributeError, match=re.escape(answer)):
        getattr(rl, name)
    assert {word for text in NAMES for word in re.findall(r"\brl\.(\w+)", text)} <= set(rl.__all__)


@pytest.mark.parametrize("name", [name for name in rl.__all__ if inspect.isfunction(getattr(rl, name))])
def test_every_public_function_answers_an_unknown_argument(name):
    function = getattr(rl, name)
    parameters = inspect.signature(function).parameters.values()
    if any(p.kind is p.VAR_KEYWORD for p in parameters) or not parameters:
        return  # names of its own: parameters of plants
    needed = [None for p in parameters if p.default is p.empty and p.kind is p.POSITIONAL_OR_KEYWORD]
    with pytest.raises(TypeError, match=r"has no argument 'no_such_argument'"):
        function(*needed, no_such_argument=1)
