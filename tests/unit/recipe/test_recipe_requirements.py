"""Judging requirements."""

import pytest

from robustlab.errors import InputError
from robustlab.recipe import Requirement, judge, look_up

NUMBERS = {
    "gap": {
        "outputs": {"q": {"fit": 93.2}},
        "poles": [-1.0, -2.0],
        "ok": True,
        "kind": "x",
        "names": ["x", "y"],
        "norm": "inf",
        "bad": "nan",
    }
}


def verdict(**condition):
    that = condition.pop("that", "gap.outputs.q.fit")
    return judge(Requirement(that=that, text="t", **condition), NUMBERS, {})


@pytest.mark.parametrize(
    ("condition", "met"),
    [
        ({"at_least": 93.2}, True),
        ({"at_least": 93.3}, False),
        ({"at_most": 93.2}, True),
        ({"at_most": 93.1}, False),
        ({"within": [93.0, 93.2]}, True),
        ({"within": [93.21, 94.0]}, False),
        ({"equals": 93.0, "tolerance": 0.25}, True),
        ({"equals": 93.0, "tolerance": 0.15}, False),
        ({"equals": 93.2}, True),
        ({"that": "gap.poles.1", "at_most": -2.0}, True),
        ({"that": "gap.ok", "equals": True}, True),
        ({"that": "gap.ok", "equals": False}, False),
        ({"that": "gap.kind", "equals": "x"}, True),
        ({"that": "gap.kind", "equals": "y"}, False),
        ({"that": "gap.names", "contains": "y"}, True),
        ({"that": "gap.names", "contains": "z"}, False),
        ({"that": "gap.names.1", "equals": "y"}, True),
        ({"that": "gap.norm", "at_most": 1e300}, False),
        ({"that": "gap.norm", "at_least": 1.0}, True),
        ({"that": "gap.bad", "at_most": 1.0}, False),
        ({"that": "gap.bad", "at_least": 1.0}, False),
        ({"that": "gap.bad", "equals": 1.0, "tolerance": 1.0}, False),
    ],
)
def test_conditions(condition, met):
    assert verdict(**condition).met is met


@pytest.mark.parametrize(
    ("condition", "why"),
    [
        ({"that": "gap.kind", "contains": "x"}, "'x', expected a list, because the condition is contains"),
        ({"that": "gap.names", "equals": "x"}, "names a table, expected a single number, text, or yes/no"),
        ({"that": "gap.outputs", "contains": "q"}, "names a table, expected a single number, text, or yes/no"),
        ({"that": "gap.ok", "at_least": 1.0}, "True, expected a number, because the condition compares numbers"),
        ({"that": "gap.kind", "at_least": 1.0}, "'x', expected a number, because the condition compares numbers"),
        ({"that": "gap.outputs.q.fitt", "at_least": 1.0}, "gap.outputs.q has no 'fitt', expected one of fit (did you"),
    ],
)
def test_what_is_of_another_kind_cannot_be_judged(condition, why):
    judgement = verdict(**condition)
    assert not judgement.met
    assert judgement.misstated
    assert judgement.why_not.startswith(why)


def test_nan_is_not_met_and_is_reported_as_no_number():
    judgement = verdict(that="gap.bad", at_most=1.0)
    assert (judgement.met, judgement.misstated) == (False, False)
    assert judgement.why_not == "there is no number to judge (NaN)"
    assert verdict(that="gap.norm", at_most=1.0).why_not == ""


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("gap.outputs.q.fitt", "did you mean fit?"),
        ("gap.outputs.p.fit", "one of q"),
        ("gap.poles.2", "one of 0, 1"),
        ("gap.poles.-1", "one of 0, 1"),
        ("gap.kind.x", "nothing below gap.kind"),
        ("gap.outputs.q", "names a table"),
        ("gap.poles", "names a table"),
    ],
)
def test_a_wrong_path_is_rejected_with_the_existing_names(path, expected):
    with pytest.raises(InputError) as caught:
        look_up(path, NUMBERS)
    assert expected in str(caught.value)
