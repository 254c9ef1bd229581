"""Records through pandas and format 1 come back bit for bit; several clocks against closed forms."""

import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab.files import Channel, Source, choose
from robustlab.time_base import summarise_clock

NUMBERS = st.floats(-1e300, 1e300, allow_nan=False)
CHARACTERS = st.characters(codec="utf-8", exclude_characters="\x00", exclude_categories=("Cc", "Cs"))
NAMES = st.text(CHARACTERS, min_size=1, max_size=200)
TEXTS = st.text(CHARACTERS, max_size=9)


@st.composite
def records(draw):
    n = draw(st.integers(2, 6))
    start, steps = draw(st.floats(-1e3, 1e3)), draw(st.lists(st.floats(1e-3, 10.0), min_size=n - 1, max_size=n - 1))
    t = np.concatenate([[start], start + np.cumsum(steps)])
    taken = {"t", "time", "Time", "TIME", "T", "timestamp", "tout", "zeit", "Zeit"}
    names = draw(st.lists(NAMES.filter(lambda name: name not in taken), min_size=1, max_size=4, unique=True))
    sides = draw(st.lists(st.booleans(), min_size=len(names), max_size=len(names)))
    samples = {name: draw(st.lists(NUMBERS, min_size=n, max_size=n)) for name in names}
    inputs, outputs = (
        {k: samples[k] for k, s in zip(names, sides, strict=True) if s is side} for side in (True, False)
    )
    units = {name: draw(st.sampled_from(["", "V", "rad/s", "weird unit"])) for name in names}
    meaning = {name: text for name in ("t", *names) if (text := draw(TEXTS))}
    return rl.Record(t, inputs, outputs, units, draw(NAMES), meaning)


def same(one, two):
    np.testing.assert_array_equal(one.t, two.t)
    for side in ("inputs", "outputs"):
        assert list(getattr(one, side)) == list(getattr(two, side))
    for name in (*one.inputs, *one.outputs):
        np.testing.assert_array_equal(one[name].view(np.int64), two[name].view(np.int64))
    assert (one.units, one.name, one.meaning) == (two.units, two.name, two.meaning)


@settings(max_examples=60)
@given(records())
def test_pandas_and_back(record):
    same(record, rl.Record.from_pandas(record.to_pandas()))


@settings(max_examples=30)
@given(records())
def test_format_1_and_back(record):
    with tempfile.TemporaryDirectory() as folder:
        rl.save(path := Path(folder) / "r.h5", record)
        same(record, rl.Record.read(path, isolate=False))


@settings(max_examples=60)
@given(
    st.lists(st.integers(1, 10**6), min_size=1, max_size=20), st.sampled_from(["s", "ms", "us", "ns"]), st.booleans()
)
def test_durations_and_dates_are_seconds(steps, unit, dates):
    stamps = np.concatenate([[0], np.cumsum(steps)])
    base = np.datetime64("2026-11-22", "s") if dates else np.timedelta64(0, unit)
    frame = pd.DataFrame({"q": stamps * 1.0}, index=base + stamps.astype(f"m8[{unit}]"))
    record = rl.Record.from_pandas(frame)
    np.testing.assert_array_equal(record.t, stamps / {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[unit])
    assert ("t" in record.meaning) == dates


# --- several clocks --------------------------------------------------------------------------------------------------

seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def clock(rng, step, n, jitter):
    return rng.uniform(-0.01, 0.01) + step * (np.arange(n) + jitter * rng.uniform(-1, 1, n))


@settings(max_examples=60)
@given(seeds, st.floats(0, 0.2), st.floats(0, 0.2), st.sampled_from([None, 2e-3, 7e-3]))
def test_lines_stay_lines_and_levels_stay_levels(rng, one, two, dt):
    """A straight line is interpolated exactly wherever the stamps are; a held input has the last sample before."""
    a, b = clock(rng, 4e-3, 300, one), clock(rng, 1e-2, 120, two)
    channels = {"u": Channel(rng.choice([0.0, 3.0], 300), clock="a"), "y": Channel(1 - 2 * a, clock="a"),
                "z": Channel(3 + b, clock="b")}  # fmt: skip
    level = channels["u"].values
    source = Source("bench", "bench", "", channels, clocks={"a": a, "b": b})
    record = rl.Record(**choose(source, ["u"], ["y", "z"], dt, allow_gaps=True))
    assert record.is_uniform
    assert record.t[0] >= max(a[0], b[0]) - 1e-8
    assert record.t[-1] <= min(a[-1], b[-1]) + 1e-7
    np.testing.assert_allclose(record["y"], 1 - 2 * record.t, rtol=0, atol=1e-7)
    np.testing.assert_allclose(record["z"], 3 + record.t, rtol=0, atol=1e-7)
    near = np.searchsorted(a, record.t + 1e-6 * record.dt, side="right") - 1
    assert (record["u"] == level[np.maximum(near, 0)]).mean() > 0.98  # rounding decides at the stamps themselves
    assert record.dt == pytest.approx(dt or np.diff(b).mean(), rel=0.05)
    lines = record.meaning["t"].splitlines()
    assert lines[0].startswith("2 clocks brought on one of ")
    assert {line.partition(":")[0] for line in lines[1:]} == {"a", "b"}


@settings(max_examples=40)
@given(seeds, st.floats(1e-4, 0.1))
def test_jitter_rate_and_gap_of_a_clock(rng, jitter):
    t = 1e-3 * (np.arange(4000) + jitter * rng.standard_normal(4000).clip(-2, 2))
    t = np.delete(t, slice(1000, 1003))
    found = summarise_clock(t)
    assert found.step == pytest.approx(1e-3, rel=1e-3)
    assert found.jitter == pytest.approx(np.sqrt(2) * jitter * 1e-3 * 0.88, rel=0.15)
    assert found.longest == pytest.approx(4e-3, rel=0.15)
    assert found.at == t[999]
