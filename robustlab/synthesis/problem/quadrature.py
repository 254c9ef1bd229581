"""Integrals over frequency of what spans many decades and has narrow peaks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from robustlab.arrays import AnyArray

__all__ = ["integral_over_decades"]


# Points of a panel, rounds of bisection, change of a panel (share of the whole) that ends it, most points.
NODES, ROUNDS, QUADRATURE, MOST_NODES = 8, 30, 1e-6, 20_000


def integral_over_decades(
    squares: Callable[[AnyArray], tuple[AnyArray, AnyArray]], edges: AnyArray
) -> tuple[float, float, float, int]:
    """Integrals over omega between the edges (logarithms) of both functions, what is open of the first, evaluations.

    Gauss-Legendre on panels of ln omega, each bisected until its halves change next to nothing.
    """
    nodes, weights = np.polynomial.legendre.leggauss(NODES)

    def panels(left: AnyArray, right: AnyArray) -> tuple[AnyArray, AnyArray]:
        half = 0.5 * (right - left)[:, None]
        omega = np.exp(left[:, None] + half * (1 + nodes))
        value, error = squares(omega.ravel())
        factor = half * weights * omega
        return (factor * value.reshape(omega.shape)).sum(axis=1), (factor * error.reshape(omega.shape)).sum(axis=1)

    left, right = edges[:-1], edges[1:]
    coarse, _ = panels(left, right)
    value, error, left_open, count = 0.0, 0.0, 0.0, NODES * len(left)
    for _ in range(ROUNDS):
        middle = 0.5 * (left + right)
        # Interleaved, so that frequencies go up.
        starts, stops = np.stack([left, middle], axis=1).ravel(), np.stack([middle, right], axis=1).ravel()
        fine, fine_error = panels(starts, stops)
        count += NODES * len(starts)
        both, both_error = fine.reshape(-1, 2).sum(axis=1), fine_error.reshape(-1, 2).sum(axis=1)
        if not (np.isfinite(both).all() and np.isfinite(coarse).all()):
            return float("nan"), float("inf"), float("inf"), count
        change = np.abs(both - coarse)
        done = change <= QUADRATURE * (value + both.sum())
        last = count > MOST_NODES
        done |= last
        value, error = value + float(both[done].sum()), error + float(both_error[done].sum())
        left_open += float(change[done].sum())
        again = np.repeat(~done, 2)
        left, right, coarse = starts[again], stops[again], fine[again]
        if not len(left):
            break
    return value + float(coarse.sum()), error, left_open + float(coarse.sum()), count
