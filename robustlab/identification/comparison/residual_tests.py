"""Tests of a residual for whiteness and independence of the input; even and odd nonlinearity of an output.

The odd share is a lower bound, line 0 is excluded, and in closed loop the harmonics of the reference count (Pintelon,
Schoukens, *System Identification*, 2012, section 4.3).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import Array
from robustlab.identification.comparison.repeats import NoiseFloor
from robustlab.result import Evidence

BAND_99 = 2.5758293035489004  # the 99.5 % point of the normal distribution: 99 % of white samples are within
# Directions of the lagged input below this share of its largest eigenvalue are not excited.
NOT_EXCITED = 1e-10


@dataclass(frozen=True)
class Whiteness(Evidence):
    """Autocorrelation of a residual, not centred, and the Ljung-Box test Q = N (N + 2) sum r_k^2 / N_k of m lags.

    N_k is the number of pairs at lag k. Q of a white residual has m degrees of freedom, as no parameter was fitted.
    """

    # lags, autocorrelation: lags 0..m in samples, and r_k with r_0 = 1, shape (m + 1,)
    lags: NDArray[np.int_]
    autocorrelation: Array
    band: float  # 99 % of the r_k of a white residual are within ± this
    # statistic, dof, p_value: Q, m, and the probability of a larger Q for a white residual
    statistic: float
    dof: int
    p_value: float
    predictable_share: float  # share of the variance that a linear predictor over the last m samples explains, 0..1
    samples: int  # N


@dataclass(frozen=True)
class InputCorrelation(Evidence):
    """Cross-correlation of one input, without its mean, with a residual, and the test of their independence.

    Q = N_m R^2 with the R^2 of the regression of the residual on lags 0..m of the input at the N_m samples that have
    all of them.
    """

    # lags, correlation: lags -m..m in samples (positive: the residual after the input), and r_k, shape (2 m + 1,).
    # Correlation at negative lags means that the input was computed from the output (closed loop).
    lags: NDArray[np.int_]
    correlation: Array
    # 99 % band of r_k, corrected for the colour of the residual and the input; 2.58 / sqrt(N) for white ones
    band: float
    # Q, the number of excited directions among the m + 1 lags, and the probability of a larger Q
    statistic: float
    dof: int
    p_value: float
    explained_share: float  # R²: share of the residual's variance that the input explains over lags 0..m, 0..1
    samples: int  # N


def autocorrelation(residual: ArrayLike, lags: int) -> tuple[Array, NDArray[np.int_]]:
    """Compute r_0..r_lags of a residual (n,), not centred, without NaN samples, and the number of pairs at each lag."""
    e = np.asarray(residual, dtype=float)
    there = np.isfinite(e)
    filled = np.where(there, e, 0.0)
    n = len(e)
    power = float(filled @ filled)
    r = np.array([filled[k:] @ filled[: n - k] for k in range(lags + 1)]) / (power or 1.0)
    r[0] = 1.0
    pairs = np.array([int((there[k:] & there[: n - k]).sum()) for k in range(lags + 1)])
    return r, pairs


def whiteness(residual: ArrayLike, lags: int) -> Whiteness:
    """Apply the Ljung-Box test to the first ``lags`` autocorrelations of a residual (n,) without its NaN samples."""
    from scipy.linalg import toeplitz
    from scipy.stats import chi2

    r, pairs = autocorrelation(residual, lags)
    n = int(pairs[0])
    used = pairs[1:] > 0
    statistic = float(n * (n + 2) * (r[1:][used] ** 2 / pairs[1:][used]).sum())
    dof = int(used.sum())
    predictor = np.linalg.lstsq(toeplitz(r[:-1]), r[1:])[0] if lags else np.zeros(0)
    share = float(np.clip(predictor @ r[1:], 0.0, 1.0))
    p_value = float(chi2.sf(statistic, dof)) if dof else 1.0
    return Whiteness(np.arange(lags + 1), r, float(BAND_99 / np.sqrt(max(n, 1))), statistic, dof, p_value, share, n)


def input_correlation(u: ArrayLike, residual: ArrayLike, lags: int) -> InputCorrelation:
    """Compute the cross-correlation of an input (n,) with a residual (n,) over lags -``lags``..``lags``.

    NaN samples of the residual are excluded.
    """
    from scipy.stats import chi2

    e: Array = np.asarray(residual, dtype=np.float64)
    v: Array = np.asarray(u, dtype=np.float64)
    v = v - float(v.mean())
    filled = np.nan_to_num(e)
    n, total = int(np.isfinite(e).sum()), len(e)
    size = float(np.sqrt((filled @ filled) * (v @ v)))
    ahead = [filled[k:] @ v[: total - k] for k in range(lags + 1)]
    behind = [filled[: total - k] @ v[k:] for k in range(lags, 0, -1)]
    correlation: Array = np.array([*behind, *ahead], dtype=np.float64)
    correlation /= size or 1.0
    r_e, r_u = autocorrelation(e, lags)[0], autocorrelation(v, lags)[0]
    # Variance of r_k for a coloured residual that is independent of a coloured input (Ljung 1999, eq. 16.64).
    spread = max(1.0, float(1.0 + 2.0 * (r_e[1:] @ r_u[1:])))
    share, dof, rows = _explained(v, e, lags)
    statistic = rows * share
    p_value = float(chi2.sf(statistic, dof)) if dof else 1.0
    band = float(BAND_99 * np.sqrt(spread / max(n, 1)))
    return InputCorrelation(np.arange(-lags, lags + 1), correlation, band, statistic, dof, p_value, share, n)


def _explained(v: Array, e: Array, lags: int) -> tuple[float, int, int]:
    """Return R² of the regression of ``e`` on ``v`` at lags 0..``lags``, excited directions, and samples used."""
    rows = np.flatnonzero(np.isfinite(e))
    rows = rows[rows >= lags]
    target = e[rows]
    power = float(target @ target)
    if not power:
        return 0.0, 0, len(rows)
    lagged = np.column_stack([v[rows - k] for k in range(lags + 1)])
    values, vectors = np.linalg.eigh(lagged.T @ lagged)
    keep = values > NOT_EXCITED * max(values[-1], 0.0) if values[-1] > 0 else np.zeros(lags + 1, bool)
    coordinates = vectors[:, keep].T @ (lagged.T @ target)
    share = float(np.clip((coordinates**2 / values[keep]).sum() / power, 0.0, 1.0))
    return share, int(keep.sum()), len(rows)


EXCITED = 1e-6  # of the strongest line's power: excited
QUIET_BETWEEN = 1e-9  # not excited, among excited lines
QUIET_BEYOND = 1e-22  # not excited, above the highest excited line: a controller may amplify there by 1e4 and more
NOTHING = 1e-6  # smaller shares are negligible
DETECTED = 0.01  # p-value below which a share exceeds the noise


@dataclass(frozen=True)
class HarmonicShares(Evidence):
    """Distribution of the repeating part of one signal over the harmonics."""

    rms: float  # RMS of the signal's repeating part at all judged lines, in its unit
    # even, odd: share of its power at even and at odd lines that are not excited, 0..1, noise removed; None without
    # such lines
    even: float | None
    odd: float | None
    # even_p, odd_p: probability of that power from noise alone; None without such lines or without noise
    even_p: float | None
    odd_p: float | None
    # frequency, amplitude: the lines in Hz, and the amplitude of each (peak of the sine), shape (n_lines,)
    frequency: Array
    amplitude: Array
    kind: NDArray[np.int_]  # 0 excited, 1 even and not excited, 2 odd and not excited, for each line, shape (n_lines,)
    noise: Array  # amplitude of the noise at each line, shape (n_lines,)

    def words(self) -> str:
        """Return for example ``even 0.13 %, odd not beyond noise`` (of the power)."""
        parts: list[str] = []
        for name, share, p in (("even", self.even, self.even_p), ("odd", self.odd, self.odd_p)):
            if share is None:
                continue
            size = "below 0.0001 %" if share < NOTHING else f"{'at least ' if name == 'odd' else ''}{100 * share:.2g} %"
            parts.append(f"{name} {size if p is None or p < DETECTED else 'not beyond noise'}")
        return ", ".join(parts)

    def to_json(self) -> dict[str, object]:
        """Return the shares without the lines."""
        return {"rms": self.rms, "even": self.even, "odd": self.odd, "even_p": self.even_p, "odd_p": self.odd_p}


@dataclass(frozen=True)
class EvenOdd(Evidence):
    """Even/odd test of all signals."""

    # output (and, in closed loop, input) name -> `HarmonicShares`; empty if the excitation allows no test
    signals: Mapping[str, HarmonicShares]
    excitation: str  # the excited lines, in words; empty if nothing repeats
    reason: str  # why the test, or one half of it, is missing; empty otherwise


def even_odd(floor: NoiseFloor, excitation: Array, signals: Mapping[str, Array], dt: float) -> EvenOdd:
    """Apply the even/odd test to ``signals`` (n,) by name for a periodic ``excitation`` (n,) on the same time base.

    ``floor`` defines the periods. ``excitation``: the reference, or in open loop the input. ``dt``: sample time in s.
    """
    lines, kind = judged_lines(floor.periodic(excitation))
    if not len(lines):
        return EvenOdd({}, "", "nothing is excited")
    excited = lines[kind == 0]
    words = f"{len(excited)} harmonics of {1.0 / (floor.samples * dt):.4g} Hz, the highest is number {excited[-1]}"
    if (excited % 2 == 0).any():
        which = "only even" if (excited % 2 == 0).all() else "both even and odd"
        return EvenOdd({}, words, f"the excitation does not allow it: {which} harmonics are excited")
    if not (kind > 0).any():
        return EvenOdd({}, words, "the excitation does not allow it: no line of it is quiet enough")
    reason = ""
    if not (kind == 1).any():
        reason = "the excitation does not allow a test of even nonlinearity: no even line of it is quiet enough"
    elif not (kind == 2).any():
        reason = "the excitation does not allow a test of odd nonlinearity: no odd harmonic is left out"
    shares = {name: harmonic_shares(floor.periodic(x), lines, kind, dt) for name, x in signals.items()}
    return EvenOdd(shares, words, reason)


def harmonic_shares(periods: ArrayLike, lines: NDArray[np.int_], kind: NDArray[np.int_], dt: float) -> HarmonicShares:
    """Compute the shares of the power of ``periods`` (count, n) over lines of kind 0 excited, 1 even, 2 odd."""
    from scipy.stats import f as fisher

    x = np.asarray(periods, dtype=np.float64)
    count, n = x.shape
    spectra = np.fft.rfft(x, axis=1)[:, lines] * np.where(2 * lines == n, 1.0, 2.0) / n
    mean = spectra.mean(axis=0)
    noise = (np.abs(spectra - mean) ** 2).sum(axis=0) / (count - 1) / count
    power = np.abs(mean) ** 2
    # Of a transform, everything below this is rounding.
    rounding = (1e-15 * float(np.abs(x).max())) ** 2
    total = float(np.maximum(0.0, power - noise).sum())

    def judged(chosen: NDArray[np.bool_]) -> tuple[float | None, float | None]:
        if not chosen.any():
            return None, None
        signal, chance = float(power[chosen].sum()), float(noise[chosen].sum())
        share = max(0.0, signal - chance) / total if total else 0.0
        if chance <= chosen.sum() * rounding:
            return share, None
        # A line's noise estimate has the scatter of 2 (count - 1) degrees: corrected as in `effective_dof`.
        weight = float((noise[chosen] ** 2).sum()) * (count - 1) / count
        dof = max(2.0, min(2.0 * float(chosen.sum()), 2.0 * chance**2 / weight))
        return share, float(fisher.sf(signal / chance, dof, dof * (count - 1)))

    (even, even_p), (odd, odd_p) = judged(kind == 1), judged(kind == 2)
    rms = float(np.sqrt(total / 2.0))
    return HarmonicShares(rms, even, odd, even_p, odd_p, lines / (n * dt), np.abs(mean), kind, np.sqrt(noise))


def judged_lines(excitation: ArrayLike) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Return the excited and the quiet lines of a periodic excitation (count, n), and their kind (`HarmonicShares`).

    Excited: within 60 dB of the strongest line. Quiet: 90 dB below it, above the highest excited line 220 dB.
    """
    power = np.abs(np.fft.rfft(np.asarray(excitation, dtype=np.float64).mean(axis=0))) ** 2
    lines = np.arange(1, len(power) - 1)
    p = power[1:-1]
    top = float(p.max(initial=0.0))
    if not top:
        return lines[:0], lines[:0]
    excited = p > EXCITED * top
    highest = int(lines[excited].max())
    quiet = p < np.where(lines <= highest, QUIET_BETWEEN, QUIET_BEYOND) * top
    kind = np.where(excited, 0, np.where(lines % 2 == 0, 1, 2))
    keep = excited | quiet
    return lines[keep], kind[keep]
