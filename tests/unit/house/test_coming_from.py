"""Names of other programs and mistyped ones, and unknown arguments, are answered with existing names."""

import re

import pytest

import robustlab as rl
from robustlab.name_hints import NAMES


@pytest.mark.parametrize(
    ("name", "answer"),
    [("wcgain", "no 'wcgain'; here it is rl.peak_gain"), ("robust_stabilty", "did you mean robust_stability?")],
)
def test_an_unknown_name_is_answered(name, answer):
    with pytest.raises(AttributeError, match=re.escape(answer)):
        getattr(rl, name)
    assert {word for text in NAMES for word in re.findall(r"\brl\.(\w+)", text)} <= set(rl.__all__)
