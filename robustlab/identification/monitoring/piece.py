"""One piece of a log: prepared, its windows placed, and what it tells about parameters and changes as equations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robustlab.arrays import Array
from robustlab.identification.hypotheses.effect_fit import Fit, FitPlan, Hypothesis, NoiseModel, Problem
from robustlab.identification.monitoring.change_test import PieceEquations
from robustlab.identification.monitoring.changes import Change
from robustlab.identification.naming.first_look import effect_columns, own_derivatives

SLOW = 6  # cosines in a window, over which unnamed errors are looked for


def placed(problem: Problem, hypothesis: Hypothesis, noise: NoiseModel, z: Array) -> Fit:
    """The model with these parameters in the windows of a piece, each from its best start."""
    return problem.fit(hypothesis, noise, z, plan=FitPlan(problem.tuning.last, 0.5, fixed=True))


def equations(problem: Problem, fit: Fit, changes: Sequence[Change]) -> PieceEquations:
    """What the piece tells about the parameters and the changes, at the model ``fit`` that was placed in it."""
    residual = problem.whitened(problem.errors(fit.hypothesis, fit.z, fit.starts), fit.noise)
    own = own_derivatives(problem, fit, residual)
    coming: list[list[Array]] = []
    with np.errstate(all="ignore"):
        for start in (s for c in changes for s in c.starts):
            change, slopes = effect_columns(problem, fit, residual, start)
            coming.extend(slopes or [change])
    n_y = len(fit.noise.std)
    parts = []
    for k, (r, (over_z, over_x)) in enumerate(zip(residual, own, strict=True)):
        columns = np.concatenate([over_z, *(c[k][:, :, None] for c in coming), r[:, :, None]], axis=2)
        parts.append(_sums(np.nan_to_num(columns, posinf=0.0, neginf=0.0), over_x, r != 0.0, n_y))
    whole, slow = (np.sum([p[i] for p in parts], axis=0) for i in (0, 1))
    return PieceEquations(whole, slow, sum(p[2] for p in parts), sum(p[3] for p in parts))


def _sums(columns: Array, over_x: Array, known: Array, n_y: int) -> tuple[Array, Array, int, int]:
    """Products of the columns (n_windows, points, n), starts projected out: whole, in slow directions; their numbers.

    ``known``: points that were measured, (n_windows, points).
    """
    count, points, n_x = over_x.shape
    most = max(1, min(SLOW, (points - n_x) // (2 * n_y)))
    waves = np.cos(np.pi * np.outer(np.arange(points // n_y) + 0.5, np.arange(most)) / (points // n_y))
    slow = np.kron(waves, np.eye(n_y))[None] * known[:, :, None]
    basis = np.linalg.qr(np.concatenate([over_x, slow], axis=2))[0]
    starts, slow = basis[:, :, :n_x], basis[:, :, n_x:]
    left = columns - starts @ (np.swapaxes(starts, 1, 2) @ columns)
    within = np.swapaxes(slow, 1, 2) @ left
    whole = np.einsum("wpi,wpj->ij", left, left, optimize=True)
    inside = np.einsum("wpi,wpj->ij", within, within, optimize=True)
    return whole, inside, int(known.sum()) - count * n_x, count * slow.shape[2]
