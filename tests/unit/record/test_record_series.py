"""Record: accepted and refused times and channels, and the messages."""

import numpy as np
import pytest

from robustlab.errors import InputError
from robustlab.record import Record
from robustlab.result import plain

T = np.linspace(0.0, 1.0, 11)


def make(**changed):
    given = {"inputs": {"u": np.ones(11)}, "outputs": {"q": T, "v": 2 * T}, "units": {"u": "V", "q": "m"}, **changed}
    return Record(given.pop("t", T), **given)


@pytest.mark.parametrize(
    ("t", "text"),
    [
        ([0.0, 0.1, 0.1, 0.2], r"t\[2\] = 0.1 s repeats the stamp before it \(1 such samples\)"),
        ([0.0, 0.2, 0.1, 0.3], r"t\[2\] = 0.1 s runs backwards"),
        ([0.0, np.nan, 0.2, 0.3], r"t\[1\] is NaN"),
        ([0.0], "at least 2"),
        ([[0.0, 1.0]], "1 dimensions"),
    ],
)
def test_times_that_do_not_increase_are_refused(t, text):
    with pytest.raises(InputError, match=text):
        Record(t, outputs={"q": np.zeros(np.size(t))})


def test_a_gap_makes_it_non_uniform_but_is_kept():
    t = np.delete(T, 4)
    assert not Record(t, outputs={"q": t}).is_uniform
    jitter = T + 1e-5 * np.sin(np.arange(11))
    assert Record(jitter, outputs={"q": T}).is_uniform


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({"outputs": {"q": T[:-1]}, "units": {}}, "10 samples, expected 11 to match t"),
        ({"outputs": {"u": T}, "units": {}}, "both an input and an output"),
        ({"outputs": {"q": np.where(T == 0.5, np.inf, T)}}, r"q\[5\] is infinite"),
        ({"outputs": {"": T}, "units": {}}, "0 characters"),
        ({"outputs": {"q": ["a"] * 11}}, "real numbers"),
    ],
)
def test_channels_that_do_not_fit_are_refused(changed, text):
    with pytest.raises(InputError, match=text):
        make(**changed)


def test_samples_cannot_be_written_and_become_json():
    record = make()
    with pytest.raises(ValueError, match="read-only"):
        record["q"][0] = 1.0
    assert plain(record)["outputs"]["v"][-1] == 2.0
