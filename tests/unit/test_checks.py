"""The checks of arguments: accepted values are returned in their type, others are refused by name."""

from fractions import Fraction
from math import inf, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robustlab import checks
from robustlab.errors import InputError


@given(st.floats(), st.floats(allow_nan=False), st.floats(allow_nan=False))
def test_finite_numbers_of_the_range_are_accepted(value: float, least: float, most: float) -> None:
    inside = least < value <= most and abs(value) < inf
    try:
        found = checks.number("f: x", value, above=least, at_most=most)
    except InputError as error:
        assert not inside
        assert error.where == "f: x"
        assert error.found == repr(value)
    else:
        assert inside
        assert found == value


@pytest.mark.parametrize("value", [True, "1", b"1", None, [1.0], np.ones(2), 1j, nan, inf, -inf, 10**400])
def test_other_than_finite_numbers_are_refused(value: object) -> None:
    with pytest.raises(InputError, match="expected a finite number"):
        checks.number("f: x", value)


@pytest.mark.parametrize("value", [2, 2.0, np.float32(2.0), np.int64(2), np.array(2.0), Fraction(2)])
def test_numbers_of_any_type_are_returned_as_floats(value: object) -> None:
    found = checks.number("f: x", value)
    assert type(found) is float
    assert found == 2.0


@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        ({"above": 0}, "a positive number"),
        ({"at_least": 0}, "a number of 0 or more"),
        ({"above": 1}, "a number above 1"),
        ({"at_least": 1}, "a number of at least 1"),
        ({"below": 1}, "a number below 1"),
        ({"at_most": 1}, "a number up to 1"),
        ({"above": 0, "below": 1}, "a number between 0 and 1"),
        ({"at_least": 0, "at_most": 1}, "a number from 0 to 1"),
    ],
)
def test_the_expectation_is_the_range_in_words(limits: dict[str, float], expected: str) -> None:
    with pytest.raises(InputError) as refused:
        checks.number("f: x", nan, **limits)
    assert refused.value.expected == expected


@pytest.mark.parametrize("value", [True, 2.0, "2", None, np.array([2, 3]), -1, 5])
def test_other_than_whole_numbers_of_the_range_are_refused(value: object) -> None:
    with pytest.raises(InputError, match="expected a whole number from 0 to 4"):
        checks.whole("f: n", value, 0, 4)


@pytest.mark.parametrize("value", [0, 4, np.int32(3), np.uint8(4)])
def test_whole_numbers_are_returned_as_ints(value: object) -> None:
    found = checks.whole("f: n", value, 0, 4)
    assert type(found) is int
    assert found == value


@pytest.mark.parametrize("value", ["c", "", None, 1, ["a"]])
def test_a_choice_is_one_of_the_words(value: object) -> None:
    assert checks.choice("f: how", "a", ("a", "b")) == "a"
    with pytest.raises(InputError, match="expected one of a, b"):
        checks.choice("f: how", value, ("a", "b"))
