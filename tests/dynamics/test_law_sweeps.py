"""The sweeps by which several laws at one joint agree on their forces."""

import numpy as np
import pytest

from robustlab.dynamics.ports.law_kernel import RELAXED_FROM, SWEEPS, _relaxed


def swept(contraction, sweeps):
    """Forces of two laws after so many sweeps that each leave this share of the way to (2, -3)."""
    end, f, moved, relaxed = np.array([2.0, -3.0]), np.zeros(2), np.zeros(2), 1.0
    for sweep in range(sweeps):
        before = f.copy()
        f[:] = end + contraction * (f - end)
        relaxed = _relaxed(f, before, moved, relaxed, sweep)
    return f


@pytest.mark.parametrize(("contraction", "sweeps"), [(0.9, 8), (0.98, 8), (0.995, 24)])
def test_laws_that_give_way_to_each_other_by_little_agree_in_a_few_sweeps(contraction, sweeps):
    """Plainly swept these leave 43, 85 and 89 % of the way; along one line two sweeps say where it ends."""
    np.testing.assert_allclose(swept(contraction, sweeps), [2.0, -3.0], rtol=1e-6)
    np.testing.assert_allclose(swept(contraction, SWEEPS), [2.0, -3.0], rtol=1e-6)


def test_the_first_sweeps_and_those_that_agree_fast_stay_as_they_are():
    for sweeps in range(1, RELAXED_FROM + 1):
        np.testing.assert_array_equal(swept(0.995, sweeps), plain(0.995, sweeps))
    np.testing.assert_array_equal(swept(0.1, 12), plain(0.1, 12))


def plain(contraction, sweeps):
    end, f = np.array([2.0, -3.0]), np.zeros(2)
    for _ in range(sweeps):
        f = end + contraction * (f - end)
    return f
