r"""Noise floor of a record that repeats, without a model: the scatter of the repeats, and an F test of a residual.

Noise is coloured and changes along the period: Satterthwaite's rule gives the effective number of samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import lcm

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.errors import NoTrustworthyNumber
from robustlab.identification.data_checks.suitability import quantisation_step
from robustlab.record import Record
from robustlab.result import Evidence

SHORTEST_PERIOD = 8  # samples
EXACT = 1e-9  # of the range: smaller differences are rounding
FINEST_LEVELS = 200  # a signal with fewer levels over its range must repeat exactly
ROUGHLY = 0.1  # of its standard deviation, by which the repeats of an input may differ
LEVEL = 3.0  # standard deviations of a sample: a larger change of the level is drift
TRANSIENT_P, TRANSIENT_F = 1e-3, 2.0  # a first period beyond both is a transient
BLOCKS = 20  # of the period, over which the local variance is taken


@dataclass(frozen=True)
class Excess(Evidence):
    """Repeating part of a residual against the noise in the average of the repeats."""

    # mean square of the averaged residual over that of the noise in it: 1 if noise explains it. None where the repeats
    # are equal to the last bit (no noise).
    F: float | None
    # probability of a larger F if the residual were (Gaussian, coloured) noise alone; None as for F
    p_value: float | None
    dof: tuple[float, float]  # effective degrees of freedom of numerator and denominator for coloured noise
    # RMS of the repeating part in the unit of the output, noise removed (0 where noise explains all of it)
    repeatable: float
    noise: float  # standard deviation of the residual's noise in a single sample: the limit of any model


@dataclass(frozen=True)
class NoiseFloor(Evidence):
    """Noise of the outputs of a record that repeats; see `noise_floor`."""

    signal: str  # the signals that repeat
    period: float  # in s
    samples: int  # of one repeat
    count: int  # number of repeats
    first: int  # sample at which the first period used starts: the last whole periods, without a start-up transient
    # Output -> standard deviation of the noise in a single sample, in its unit; where a drift (an integrator in open
    # loop) was removed, it contains no noise slower than a period.
    std: Mapping[str, float]
    input_std: Mapping[str, float]  # the same of inputs that do not repeat exactly: noise that a controller feeds back
    notes: tuple[str, ...]  # limits of the estimate

    def repeats(self, samples: Array) -> Array:
        """Cut samples (n,) of the record into repeats, shape (count, samples)."""
        return samples[self.first : self.first + self.count * self.samples].reshape(self.count, self.samples)

    def excess(self, residual: Array) -> Excess:
        """Test whether anything repeats in a residual (n,), with windows at the same phases of every period."""
        from scipy.special import fdtrc

        r = self.repeats(residual)
        mean = r.mean(axis=0)
        deviation = r - mean
        power, variance = float(np.mean(mean**2)), float((deviation**2).sum() / ((self.count - 1) * r.shape[1]))
        # Residuals are differences of larger numbers: a spread at their rounding is no noise.
        if variance <= (1e-14 * float(np.abs(r).max())) ** 2:
            return Excess(None, None, (0.0, 0.0), float(np.sqrt(power)), 0.0)
        above, ratio = effective_dof(deviation), power * self.count / variance
        dof = above, above * (self.count - 1)
        repeatable, noise = np.sqrt([max(0.0, power - variance / self.count), variance]).tolist()
        return Excess(ratio, float(fdtrc(*dof, ratio)), dof, repeatable, noise)


def noise_floor(record: Record, *, outputs: Sequence[str] | None = None) -> NoiseFloor:
    """Estimate the noise of the outputs of a record from its periods."""
    where, names = f"noise floor of {record.name}", list(record.outputs) if outputs is None else list(outputs)
    if not record.is_uniform:
        raise NoTrustworthyNumber(where, "the clock is not uniform", "a uniform clock")
    samples, signal = _found_period(record, names)
    count = record.n // samples
    first = record.n - count * samples
    stacked = {name: x[first:].reshape(count, samples) for name, x in {**record.inputs, **record.outputs}.items()}
    for name in record.inputs:
        x = stacked[name]
        if np.sqrt(np.mean((x - x.mean(axis=0)) ** 2)) > ROUGHLY * x.std():
            found = f"does not repeat with a period of {samples * record.dt:.6g} s"
            expected = "the same input in every repeat (to 10 % in closed loop)"
            raise NoTrustworthyNumber(f"{where}: {name}", found, expected)
    skipped = _transient([stacked[name] for name in names])
    notes = []
    if skipped:
        notes.append(f"{skipped} period(s) left out at the start: transient")
    elif count == 2 and first < samples // 2:
        notes.append("two periods only: a transient at the start would count as noise")
    stacked = {name: x[skipped:] for name, x in stacked.items()}
    if drifting := ", ".join(name for name in names if _drifts(stacked[name])):
        removed = "its level was removed, noise slower than a repeat is not in the floor"
        notes.append(f"{drifting} drifts from repeat to repeat: {removed}")
    std = {name: _noise(stacked[name]) for name in (*names, *record.inputs)}
    return NoiseFloor(
        signal=signal,
        period=samples * record.dt,
        samples=samples,
        count=count - skipped,
        first=first + skipped * samples,
        std={name: std[name] for name in names},
        input_std={name: std[name] for name in record.inputs if std[name] > EXACT * float(np.ptp(stacked[name]))},
        notes=tuple(notes),
    )


def period_of(samples: ArrayLike, tolerance: float | None = None) -> int | None:
    """Return the shortest period in samples with which a signal (n,) repeats throughout, or None.

    ``tolerance``: largest difference between repeats of one phase; default: a fine quantisation step, or rounding.

    Examples
    --------
    >>> period_of(np.tile(np.arange(10.0), 3))
    10
    """
    x = np.asarray(samples, dtype=np.float64)
    spread = float(np.ptp(x))
    if not spread or len(x) < 2 * SHORTEST_PERIOD:
        return None
    if tolerance is None:  # a fine quantisation
        step = quantisation_step(x) or 0.0
        tolerance = 1.01 * step if spread >= FINEST_LEVELS * step else 0.0
    tolerance = max(EXACT * spread, tolerance)
    difference = _lag_differences(x)
    # The sums are exact to about 1e-12 of the energy; the check below is exact.
    bound = tolerance**2 + 1e-9 * spread**2
    lags = np.arange(SHORTEST_PERIOD, len(difference) - 1)
    hollow = (difference[lags] <= difference[lags - 1]) & (difference[lags] <= difference[lags + 1])
    last = len(difference) - 1  # half the record: it has only one neighbour
    candidates = [*lags[hollow & (difference[lags] <= bound)].tolist(), *([last] if difference[last] <= bound else [])]
    return next((p for p in candidates if p >= SHORTEST_PERIOD and _repeats(x, p, tolerance)), None)


def effective_dof(deviation: Array) -> float:
    """Estimate the effective number of independent samples in the mean square of one repeat from deviations (P, N)."""
    # (sum S)^2 / sum S^2 of their spectrum, with P / (P - 1) for its own scatter, and the variances of 20 blocks.
    count, n = deviation.shape
    power = (np.abs(np.fft.fft(deviation, axis=1)) ** 2).sum(axis=0)
    colour = min(float(n), float(power.sum() ** 2 / (power**2).sum()) * count / (count - 1))
    blocks = np.array_split((deviation**2).sum(axis=0), max(1, min(BLOCKS, n // SHORTEST_PERIOD)))
    v = np.array([block.mean() for block in blocks])
    return max(1.0, colour * float(v.mean() ** 2 / np.mean(v**2)))


def _lag_differences(x: Array) -> Array:
    """Compute the mean square of x[k + p] - x[k] for the lags p = 0..n // 2."""
    from scipy.signal import correlate

    x, n = x - x.mean(), len(x)
    lags = np.arange(n // 2 + 1)
    product = correlate(x, x, method="fft")[n - 1 + lags]
    energy = np.concatenate([[0.0], np.cumsum(x**2)])
    return np.maximum(0.0, energy[n - lags] + (energy[n] - energy[lags]) - 2.0 * product) / (n - lags)


def _repeats(x: Array, period: int, tolerance: float) -> bool:
    """Check that all repeats of every phase are within the tolerance."""
    count = len(x) // period
    first = len(x) - count * period
    whole = x[first:].reshape(count, period)
    low, high = whole.min(axis=0), whole.max(axis=0)
    if first:
        low, high = low.copy(), high.copy()
        low[-first:], high[-first:] = np.minimum(low[-first:], x[:first]), np.maximum(high[-first:], x[:first])
    return bool((high - low).max() <= tolerance) and bool(np.ptp(whole[0]) > tolerance)


def _found_period(record: Record, names: list[str]) -> tuple[int, str]:
    """Return the common period of all signals that repeat, and their names."""
    where = f"noise floor of {record.name}"
    periods = {name: period_of(x) for name, x in record.inputs.items()}
    periods |= {name: period_of(x, 0.0) for name, x in record.outputs.items() if name not in names}
    found = {name: p for name, p in periods.items() if p}
    if not found:
        raise NoTrustworthyNumber(where, "no recorded input or reference repeats")
    common = lcm(*found.values())
    if record.n < 2 * common:
        each = ", ".join(f"{name} {p * record.dt:.4g} s" for name, p in found.items())
        text = f"the common period of {each} is {common * record.dt:.4g} s"
        raise NoTrustworthyNumber(where, text, "two common periods in the record")
    return common, ", ".join(found)


def _transient(outputs: Sequence[Array]) -> int:
    """Count the first periods that differ from the later ones by more than these differ among themselves."""
    from scipy.special import fdtrc

    skipped = 0
    count = min((len(x) for x in outputs), default=0)
    while count - skipped >= 3:
        for x in (x[skipped:] for x in outputs):
            if _drifts(x):  # the level of a drift is no transient
                x = x - x.mean(axis=1, keepdims=True)
            later = x[1:]
            deviation = later - later.mean(axis=0)
            noise = float((deviation**2).sum() / ((len(later) - 1) * x.shape[1]))
            if not noise:
                continue
            ratio = float(np.mean((x[0] - later.mean(axis=0)) ** 2)) / (noise * (1.0 + 1.0 / len(later)))
            dof = effective_dof(deviation)
            if ratio > TRANSIENT_F and fdtrc(dof, dof * (len(later) - 1), ratio) < TRANSIENT_P:
                skipped += 1
                break
        else:
            break
    return skipped


def _drifts(x: Array) -> bool:
    level = x.mean(axis=1)
    rest = x - x.mean(axis=0) - (level - level.mean())[:, None]
    sigma = float(np.sqrt((rest**2).sum() / ((x.shape[0] - 1) * (x.shape[1] - 1))))
    return bool(np.abs(level - level.mean()).max() > max(LEVEL * sigma, EXACT * float(np.ptp(x))))


def _noise(x: Array) -> float:
    """Estimate the standard deviation of the noise in a sample; the level of a drifting output is removed."""
    (count, n), deviation, drifts = x.shape, x - x.mean(axis=0), _drifts(x)
    if drifts:
        deviation = deviation - deviation.mean(axis=1, keepdims=True)
    return float(np.sqrt((deviation**2).sum() / ((count - 1) * (n - drifts))))
