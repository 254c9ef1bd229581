"""Tests of a residual: whiteness, and independence of the inputs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import Array
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
