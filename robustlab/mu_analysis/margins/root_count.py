r"""How many characteristic roots a model with exact delays has right of the axis: the argument principle, cell by cell.

With the states x and what leaves the delays w as unknowns,

.. math:: F(s) = \begin{bmatrix} sI - A & -B_1 \\ -C_1 & \mathrm{diag}(e^{s \tau_i}) - D_{11} \end{bmatrix}, \qquad
   f(s) = e^{-s \sum \tau_i} \det F(s) = \det(sI - A) \det(I - X(s)), \quad
   X(s) = \mathrm{diag}(e^{-s \tau_i}) (D_{11} + C_1 (sI - A)^{-1} B_1) .

f has no poles in the right half plane. The axis up to R is covered by cells about points c with
:math:`\|T (F(jc)^{-1} F(j\omega) - I) T^{-1}\| < 1` for a diagonal T: F is regular there, the eigenvalues of
:math:`F(jc)^{-1} F(j\omega)` stay in the unit disk about one, and the sum of their principal arguments is how far
:math:`\arg \det F` turns. From R on, in the whole half plane, :math:`\|(sI - A)^{-1}\| \le 1 / (|s| - \|A\|)` bounds X
entry by entry; where that bound has a spectral radius below one, f has no root there, and along the arc it turns as
:math:`s^n` does but for what the factors at its ends say. The roots are then

.. math:: N = \frac{1}{\pi} \Big( \tfrac{n \pi}{2} + \varphi(R) - \Delta_{0 \to R} \arg f(j \omega) \Big), \qquad
   \varphi = \arg \det(I - A / jR) + \arg \det(I - X(jR)) ,

both arguments as sums of principal ones. All of this is evaluated in floating point.

References
----------
Michiels, Niculescu, *Stability, Control, and Computation for Time-Delay Systems* (2014), chapters 1 and 2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robustlab.arrays import Array, ComplexArray
from robustlab.delays.model import DelayedModel
from robustlab.errors import NoTrustworthyNumber
from robustlab.mu_analysis.margins.delay_axis import DelayAxis

# How much of the distance to a singular F a cell may use up; the rest is for rounding.
NEAR = 0.9
# Cells that are looked at, at most, and their smallest width relative to R.
MOST, NARROW = 40_000, 1e-13
# The count may miss a whole number by this much.
WHOLE = 1e-3


class RootCount(NamedTuple):
    """Roots right of the axis, the cells that were looked at, and the frequency R in rad/s from which on none lies."""

    roots: int
    cells: int
    end: float


def count_roots(model: DelayedModel, effort: float = 1.0) -> RootCount | None:
    """The roots in the open right half plane; None where one lies on the axis, next to it, or the far end is open."""
    axis = DelayAxis(model, [], [])
    end = _end(axis)
    if end is None:
        return None
    try:
        turned = _turned(axis, end, int(MOST * effort))
    except NoTrustworthyNumber:
        return None
    if turned is None:
        return None
    angle, cells = turned
    n = axis.n
    count = (0.5 * n * np.pi + _at_end(axis, end) - (angle - end * float(axis.delays.sum()))) / np.pi
    roots = round(count)
    return RootCount(roots, cells, end) if abs(count - roots) < WHOLE and roots >= 0 else None


def _end(axis: DelayAxis) -> float | None:
    """R; None where no frequency serves."""
    size = axis.speed()
    for _ in range(60):
        size *= 2.0
        if np.isfinite(axis.far(size, np.zeros((0, 0)))):
            return size
    return None


def _turned(axis: DelayAxis, end: float, most: int) -> tuple[float, int] | None:
    """How far ``arg det F`` turns from 0 to R, and the cells; None where a cell gets too narrow."""
    first = np.concatenate([[0.0], np.geomspace(1e-6 * end, end, 81)])
    begin, stop, angle, looked = first[:-1], first[1:], 0.0, 0
    while len(begin):
        looked += len(begin)
        half, middle = 0.5 * (stop - begin), 0.5 * (begin + stop)
        cut = ~(half * axis.seen(middle).m < NEAR)
        angle += float(_angles(axis, middle[~cut], stop[~cut]).sum() - _angles(axis, middle[~cut], begin[~cut]).sum())
        if looked > most or (half[cut] <= NARROW * end).any():
            return None
        begin, stop = np.concatenate([begin[cut], middle[cut]]), np.concatenate([middle[cut], stop[cut]])
    return angle, looked


def _angles(axis: DelayAxis, origin: Array, there: Array) -> Array:
    """How far ``arg det F`` turns from one frequency of a cell to another, for each."""
    turn = np.linalg.solve(axis.characteristic(origin), axis.characteristic(there))
    return np.angle(np.linalg.eigvals(turn)).sum(axis=1)


def _at_end(axis: DelayAxis, end: float) -> float:
    """The angle phi of the module's formula."""
    n = axis.n
    A, B1 = axis.inner[:n, :n], axis.inner[:n, n:]
    C1, D11 = axis.inner[n:, :n], axis.inner[n:, n:]
    eye = np.eye(n)
    X: ComplexArray = np.exp(-1j * end * axis.delays)[:, None] * (D11 + C1 @ np.linalg.solve(1j * end * eye - A, B1))
    factors = np.concatenate([np.linalg.eigvals(eye - A / (1j * end)), np.linalg.eigvals(np.eye(len(X)) - X)])
    return float(np.angle(factors).sum())
