"""Noise, prior and normal equations of a fit in which each window's start is eliminated (Björck, *Numerical Methods for
Least Squares Problems*, 1996, section 9.3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from robustlab.arrays import Array

WILD = 1e6  # errors beyond this many standard deviations count as this


class Reduced(NamedTuple):
    """Normal equations over z after the starts are eliminated, and the step of the starts: -(offset + slope dz)."""

    hessian: Array
    gradient: Array
    offset: Array  # (n_windows, n_x)
    slope: Array  # (n_windows, n_x, n_z)


@dataclass(frozen=True, eq=False)
class Linearised:
    """Products of the derivatives J over z and X over the starts of one record, window by window."""

    jj: Array  # J^T J summed, (n_z, n_z)
    jr: Array  # J^T r summed, (n_z,)
    xx: Array  # X^T X + 1, (n_windows, n_x, n_x)
    xj: Array  # X^T J, (n_windows, n_x, n_z)
    xr: Array  # X^T r + xi, (n_windows, n_x)
    scores: Array  # J^T r of each window, (n_windows, n_z)
    j: Array  # (n_windows, n_points, n_z)
    x: Array  # (n_windows, n_points, n_x)

    @classmethod
    def of(cls, residual: Array, j: Array, x: Array, xi: Array) -> Linearised:
        """From the residuals (n_windows, n_points) and their derivatives; xi (n_windows, n_x)."""
        xt = np.swapaxes(x, 1, 2)
        flat = j.reshape(residual.size, j.shape[2])  # a size of its own: there may be no parameter at all
        return cls(
            flat.T @ flat, flat.T @ residual.ravel(), xt @ x + np.eye(x.shape[2]), xt @ j,
            (xt @ residual[:, :, None])[:, :, 0] + xi, np.einsum("wmz,wm->wz", j, residual), j, x,
        )  # fmt: skip

    def along(self, dz: Array, dxi: Array) -> Array:
        """Change of the residuals along a step, were they linear."""
        return self.j @ dz + (self.x @ dxi[:, :, None])[:, :, 0]

    def with_residual(self, residual: Array, xi: Array | None = None) -> Linearised:
        """The same derivatives with other residuals, at the starts xi; without any, of a change of the residuals."""
        scores = np.einsum("wmz,wm->wz", self.j, residual)
        xr = (np.swapaxes(self.x, 1, 2) @ residual[:, :, None])[:, :, 0]
        return replace(self, jr=scores.sum(axis=0), xr=xr if xi is None else xr + xi, scores=scores)

    @property
    def diagonal(self) -> Array:
        """Of J^T J."""
        return np.diag(self.jj)

    def reduced(self, damping: float) -> Reduced:
        """The starts eliminated, their own equations damped by ``damping`` times their diagonal."""
        n_x = self.xx.shape[1]
        inner = self.xx + damping * self.xx * np.eye(n_x)
        right = np.concatenate([self.xr[:, :, None], self.xj], axis=2)
        try:
            both = np.asarray(np.linalg.solve(inner, right), dtype=float)
        except np.linalg.LinAlgError:  # a part of the start that no sample of its window shows: it stays as it is
            both = np.linalg.pinv(inner, hermitian=True) @ right
        offset, slope = both[:, :, 0], both[:, :, 1:]
        hessian = self.jj - np.einsum("wxi,wxj->ij", self.xj, slope)
        gradient = self.jr - np.einsum("wxi,wx->i", self.xj, offset)
        return Reduced(0.5 * (hessian + hessian.T), gradient, offset, slope)


def damped(reduced: Sequence[Reduced], parts: Sequence[Linearised], damping: float, precision: Array) -> Array:
    """Hessian of V / 2 over z with the precision of the prior and the damping."""
    hessian = precision + sum(r.hessian for r in reduced)
    own = np.diag(precision) + sum(p.diagonal for p in parts)
    hessian[np.diag_indices(len(hessian))] += damping * own
    return hessian


def sandwich(parts: Sequence[Linearised], hessian: Array) -> Array:
    """Covariance of z from the scatter of the windows' gradients, starts eliminated: it holds under any noise."""
    scores = np.concatenate([p.scores - np.einsum("wxz,wx->wz", p.xj, p.reduced(0.0).offset) for p in parts])
    inverse = np.linalg.pinv(hessian)
    count = len(scores)
    return inverse @ (scores.T @ scores) @ inverse * (count / max(1, count - 1))


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Noise of the averaged errors: standard deviation (n_y,) and autoregression (order, n_y) of each output."""

    # excess: factor of the variance above that of the errors themselves, which hang together (`noise.careful`).

    std: Array
    ar: Array
    excess: float = 1.0

    def whitened(self, errors: Array) -> Array:
        """Residuals (n_windows, n_points * n_y) of unit variance from averaged errors; missing points are zero."""
        order = len(self.ar)
        e = errors[:, order:].copy()
        for lag in range(order):
            e -= self.ar[lag] * errors[:, order - lag - 1 : errors.shape[1] - lag - 1]
        with np.errstate(over="ignore", invalid="ignore"):
            scaled = np.nan_to_num(e / self.std, copy=False, nan=0.0, posinf=WILD, neginf=-WILD)
        return np.clip(scaled, -WILD, WILD).reshape(len(e), e.shape[1] * e.shape[2])  # there may be no window at all


@dataclass(frozen=True, eq=False)
class Prior:
    """Normal prior of the standardised parameters: mean (n,) and precision, the inverse of the covariance, (n, n)."""

    mean: Array
    precision: Array

    def cost(self, z: Array) -> float:
        """Its share of V."""
        return float((z - self.mean) @ self.precision @ (z - self.mean))

    def gradient(self, z: Array) -> Array:
        """Of its share of V / 2."""
        return self.precision @ (z - self.mean)
