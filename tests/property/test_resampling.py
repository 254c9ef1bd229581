"""Resampling against what it must keep: samples, levels, straight lines, and the account of what is lost."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustlab.errors import InputError
from robustlab.identification import join_clocks
from robustlab.identification.data_checks import uniform
from robustlab.record import Record

DT = 0.01
SAME = 1e-6 * DT  # a time this close to a stamp takes over its sample
clocks = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def lossy(rng, n=200, lost=0.15):
    """A uniform clock without some of its samples (the first and the last stay), and the indices of the others."""
    keep = rng.random(n) > lost
    keep[[0, 1, -1]] = True
    return DT * np.arange(n), np.flatnonzero(keep)


def signals(rng, n):
    return rng.choice([-2.0, 0.0, 5.0], n), rng.standard_normal(n)


@settings(max_examples=40)
@given(clocks)
def test_missing_samples_are_found_one_by_one(rng):
    t, kept = lossy(rng)
    u, y = signals(rng, len(t))
    found = uniform(Record(t[kept], {"u": u[kept]}, {"y": y[kept]}))
    assert found.record.n == len(t)
    np.testing.assert_allclose(found.record.t, t, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(np.flatnonzero(found.valid["y"]), kept)
    np.testing.assert_array_equal(found.record["y"][kept], y[kept])
    assert sum(gap.missing for gap in found.gaps) == len(t) - len(kept)
    held = np.searchsorted(kept, np.arange(len(t)), side="right") - 1
    np.testing.assert_array_equal(found.record["u"], u[kept][held])


@settings(max_examples=40)
@given(clocks, st.floats(0.0, 0.2))
def test_a_jittering_clock_keeps_lines_and_levels(rng, jitter):
    n = 150
    t = DT * (np.arange(n) + jitter * rng.uniform(-1, 1, n))
    u, slope = rng.choice([-2.0, 0.0, 5.0], n), rng.uniform(-3, 3)
    found = uniform(Record(t, {"u": u}, {"y": 1.5 + slope * t}))
    assert found.gaps == ()
    assert found.valid["y"].all()
    assert found.record.is_uniform
    assert found.record.dt == pytest.approx(DT, rel=0.01)
    np.testing.assert_allclose(found.record["y"], 1.5 + slope * found.record.t, rtol=0, atol=3 * SAME)
    assert set(found.record["u"]) <= set(u)
    inside = np.searchsorted(t, found.record.t + SAME, side="right") - 1
    np.testing.assert_array_equal(found.record["u"][1:], u[inside][1:])


@settings(max_examples=40)
@given(clocks, st.sampled_from([0.5e-3, 2e-3 / 3, 1.7e-3]), st.floats(-0.05, 0.05))
def test_two_clocks_on_one(rng, other, shift):
    first = Record(1e-3 * np.arange(300), outputs={"speed": rng.standard_normal(300)})
    t = shift + other * np.arange(400)
    second = Record(t, {"force": rng.standard_normal(400)}, {"line": 2.0 - 3.0 * t})
    joint = join_clocks(first, second)
    assert joint.t[0] >= max(0.0, shift) - 1e-8
    assert joint.t[-1] <= min(first.t[-1], t[-1]) + 1e-8
    assert joint.dt == pytest.approx(max(1e-3, other))
    np.testing.assert_allclose(joint["line"], 2.0 - 3.0 * joint.t, rtol=0, atol=3 * SAME)
    assert set(joint["force"]) <= set(second["force"])
    if other <= 1e-3:  # the coarser clock's own samples stay as they are
        np.testing.assert_array_equal(joint["speed"], first["speed"][np.searchsorted(first.t, joint.t)])
    again = join_clocks(second, first)
    for name in ("speed", "force", "line"):
        np.testing.assert_array_equal(again[name], joint[name])


def test_another_sample_time():
    t = DT * np.arange(101)
    found = uniform(Record(t, {"u": t}, {"y": 2 * t}), dt=0.004)
    assert found.record.n == 251
    np.testing.assert_allclose(found.record["y"], 2 * found.record.t, atol=1e-14)
    np.testing.assert_allclose(found.record["u"][:6], [0, 0, 0, 0.01, 0.01, 0.02], atol=1e-14)
    assert found.valid["y"].all()


def test_join_clocks_rejects_wrong_records():
    one = Record([0.0, 1.0, 2.0], outputs={"y": [0, 1, 2]}, name="drive")
    with pytest.raises(InputError, match=r"'y' is in both"):
        join_clocks(one, one)
    with pytest.raises(InputError, match=r"drive and force: the clocks run from 0 s to 2 s and 2 s to 4 s.*overlap"):
        join_clocks(one, Record([2.0, 3.0, 4.0], inputs={"f": [0, 1, 2]}, name="force"))
    holed = Record([0.0, 0.5, 1.0, 1.5, 9.0], inputs={"f": [0, 1, 2, 3, 4]}, name="force")
    with pytest.raises(InputError, match=r"force: 14 samples missing from 1\.5 s to 9 s"):
        join_clocks(one, holed)
