r"""Tests of a residual: is it white, and is it independent of the input?

Both tests have the same reference (null hypothesis): the output-error model :math:`y = G(u) + e` with the given G and
white noise e that is independent of u. A long record makes every deviation significant, however small; so each test
also gives the *size* of the effect: the share of the residual's variance that its own past, or the input, explains
linearly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import Array
from robustlab.result import Evidence

__all__ = ["InputCorrelation", "Whiteness", "autocorrelation", "input_correlation", "whiteness"]


BAND_99 = 2.5758293035489004  # the 99.5 % point of the normal distribution: 99 % of white samples lie within
# Directions of the lagged input below this share of its largest eigenvalue are not excited.
NOT_EXCITED = 1e-10


@dataclass(frozen=True)
class Whiteness(Evidence):
    r"""Autocorrelation of a residual and the Ljung-Box test.

    .. math:: Q = N (N + 2) \sum_{k=1}^{m} \frac{r_k^2}{N_k}, \qquad Q \sim \chi^2_m \text{ for a white residual}

    with :math:`N_k` the number of pairs at lag k (N - k without gaps). The residual is not centred: a constant offset
    is an error. No degree of freedom is taken off, as no parameter was fitted.

    Attributes
    ----------
    lags, autocorrelation
        Lags 0..m in samples, and r_k with r_0 = 1, shape (m + 1,).
    band
        99 % of the r_k of a white residual lie within ± this.
    statistic, dof, p_value
        Q, m, and the probability of a larger Q for a white residual.
    predictable_share
        Share of the variance that a linear predictor over the last m samples explains, 0..1.
    samples
        N.
    """

    lags: NDArray[np.int_]
    autocorrelation: Array
    band: float
    statistic: float
    dof: int
    p_value: float
    predictable_share: float
    samples: int


@dataclass(frozen=True)
class InputCorrelation(Evidence):
    r"""Cross-correlation of one input with a residual, and the test of their independence.

    .. math:: r_k = \frac{\sum_t e_{t+k} \tilde u_t}{\sqrt{\sum e^2 \sum \tilde u^2}}, \qquad
              Q = N_m R^2 \sim \chi^2_{rank} \text{ for a white residual independent of } u

    with :math:`\tilde u` the input without its mean, and R² of the regression of e on :math:`\tilde u_t, ..., \tilde
    u_{t-m}` at the :math:`N_m` samples that have all of these.

    Attributes
    ----------
    lags, correlation
        Lags -m..m in samples (positive: the residual after the input), and r_k, shape (2 m + 1,). Correlation at
        negative lags means that the input was computed from the output: the record was taken in closed loop.
    band
        99 % band of r_k, corrected for the residual's and the input's own correlation; as wide as 2.58 / sqrt(N) for
        white ones.
    statistic, dof, p_value
        Q, the number of excited directions among the m + 1 lags, and the probability of a larger Q.
    explained_share
        R²: share of the residual's variance that the input explains over lags 0..m, 0..1.
    samples
        N.

    References
    ----------
    Ljung, *System Identification* (1999), section 16.6.
    """

    lags: NDArray[np.int_]
    correlation: Array
    band: float
    statistic: float
    dof: int
    p_value: float
    explained_share: float
    samples: int


def autocorrelation(residual: ArrayLike, lags: int) -> tuple[Array, NDArray[np.int_]]:
    """Autocorrelation r_0..r_lags of a residual (n,) that is not centred, and the number of pairs at each lag.

    Samples that are NaN are left out. A residual of zeros has r_k = 0 for k > 0.
    """
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
    """Ljung-Box test over the first ``lags`` autocorrelations of a residual (n,); NaN samples are left out."""
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
    """Cross-correlation of an input (n,) with a residual (n,) over lags -``lags``..``lags``.

    NaN samples of the residual are left out.
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
    """R² of the regression of ``e`` on ``v`` at lags 0..``lags``, excited directions, and samples that went in."""
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
