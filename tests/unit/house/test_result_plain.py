"""Results as plain JSON."""

from __future__ import annotations

import json

import numpy as np
import pytest

from robustlab.result import Result, Status, plain


@pytest.mark.parametrize(
    ("value", "wanted"),
    [
        (None, None),
        (True, True),
        (np.True_, True),
        (Status.FAILED, "failed"),
        (3, 3),
        (np.int64(3), 3),
        (np.float32(0.5), 0.5),
        (float("inf"), "inf"),
        (-np.inf, "-inf"),
        (np.nan, "nan"),
        (1 + 2j, {"re": 1.0, "im": 2.0}),
        (np.array([[1.0, np.nan]]), [[1.0, "nan"]]),
        (np.array([1j]), [{"re": 0.0, "im": 1.0}]),
        ((1, [2.0]), [1, [2.0]]),
        ({1: {"a": np.zeros(0)}}, {"1": {"a": []}}),
        (Result("Margin", Status.CERTIFIED, {"lower": 2.0}), {"type": "Margin", "lower": 2.0, "status": "certified"}),
    ],
)
def test_plain_forms(value, wanted):
    found = plain(value)
    assert found == wanted
    json.dumps(found, allow_nan=False)


def test_what_has_no_plain_form_is_an_error():
    with pytest.raises(TypeError, match="no plain form"):
        plain(object())
