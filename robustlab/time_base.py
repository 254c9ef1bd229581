"""Time bases of records: sample time, jitter, and signals of several time bases resampled to one.

Inputs are held, as by a D/A converter, outputs interpolated linearly; at a stamp the sample is unchanged.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from robustlab.arrays import Array, Mask
from robustlab.checks import number
from robustlab.errors import InputError

# Steps of more than this many sample times have a missing sample.
NEAR = 1.5
# Times this close to a stamp (in sample times) are that stamp, up to rounding.
SAME_TIME = 1e-6
# Jitter, as a share of the sample time, up to which a time base counts as uniform.
UNIFORM_TOLERANCE = 1e-3
# Largest ratio of resampled to recorded samples.
MOST_SAMPLES = 100


def is_uniform(t: Array) -> bool:
    """Return whether every step is within 0.1 % of the mean sample time."""
    dt = float(t[-1] - t[0]) / (len(t) - 1)
    return bool(np.abs(np.diff(t) - dt).max() <= UNIFORM_TOLERANCE * dt)


def clock_step(t: Array) -> float:
    """Return the sample time in s: the mean of all steps that are no gaps; jitter averages out."""
    steps = np.diff(t)
    return float(steps[steps <= NEAR * np.median(steps)].mean())


@dataclass(frozen=True)
class ClockSummary:
    """Rate, jitter and largest gap of a time base."""

    n: int  # number of samples
    step: float  # sample time in s (`clock_step`)
    jitter: float  # standard deviation in s of the steps that are no gaps
    longest: float  # longest step in s
    at: float  # the stamp before it

    def text(self) -> str:
        words = f"{self.n} samples at {1 / self.step:.6g} Hz"
        if self.jitter > UNIFORM_TOLERANCE * self.step or self.longest > (1 + UNIFORM_TOLERANCE) * self.step:
            words += f", jitter {self.jitter:.3g} s rms, largest gap {self.longest:.4g} s after t = {self.at:.6g} s"
        return words


def summarise_clock(t: Array) -> ClockSummary:
    """Summarise the time stamps t in s, shape (n,), n >= 2."""
    steps = np.diff(t)
    k = int(np.argmax(steps))
    near = steps[steps <= NEAR * np.median(steps)]
    return ClockSummary(len(t), float(near.mean()), float(near.std()), float(steps[k]), float(t[k]))


def common_clock(where: str, clocks: Mapping[str, Array], dt: float | None = None) -> tuple[Array, str]:
    """Return one time base for signals of several, over their common time, and the name of the coarsest one."""
    steps = {name: clock_step(t) for name, t in clocks.items()}
    coarse = next(name for name, step in steps.items() if step >= (1 - SAME_TIME) * max(steps.values()))
    start, stop = max(float(t[0]) for t in clocks.values()), min(float(t[-1]) for t in clocks.values())
    t, step = clocks[coarse], steps[coarse]
    if dt is not None:
        step = checked_step(where, dt, t)
    slack = SAME_TIME * step
    if dt is None and is_uniform(t):
        clock = t[(t >= start - slack) & (t <= stop + slack)]
    else:
        clock = start + step * np.arange(max(0, int(np.floor((stop - start) / step + SAME_TIME)) + 1))
    if len(clock) < 2:
        spans = " and ".join(f"{t[0]:.6g} s to {t[-1]:.6g} s" for t in clocks.values())
        raise InputError(where, f"the clocks run from {spans}", "times that overlap by two samples at least")
    return clock, coarse


def checked_step(where: str, dt: float, t: Array) -> float:
    """Return ``dt`` if a record with the stamps ``t`` can be resampled to it."""
    duration = float(t[-1] - t[0])
    least = duration / (MOST_SAMPLES * len(t))
    expected = f"a sample time from {least:.3g} s, a hundredth of the record's own, to its duration, {duration:.6g} s"
    return number(f"{where}: dt", dt, expected, at_least=least, at_most=duration)


def held(clock: Array, t: Array, samples: Array, step: float) -> Array:
    """Return the last sample at or before each time of ``clock``; ``step`` (s) is its sample time."""
    last = np.searchsorted(t, clock + SAME_TIME * step, side="right") - 1
    return samples[np.maximum(last, 0)]


def interpolated(clock: Array, t: Array, samples: Array, step: float) -> tuple[Array, Mask, Array]:
    """Return samples at ``clock``, whether each is at a stamp, and the distance in s of the stamps around it."""
    after = np.clip(np.searchsorted(t, clock, side="left"), 1, len(t) - 1)
    before, slack = after - 1, SAME_TIME * step
    share = (clock - t[before]) / (t[after] - t[before])
    y = samples[before] + share * (samples[after] - samples[before])
    on_before, on_after = np.abs(clock - t[before]) <= slack, np.abs(clock - t[after]) <= slack
    y = np.where(on_before, samples[before], np.where(on_after, samples[after], y))
    return y, on_before | on_after, t[after] - t[before]
