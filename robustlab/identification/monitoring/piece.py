"""One piece of a log: prepared, its windows placed, and what it tells about parameters and changes as equations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from robustlab.arrays import Array
from robustlab.identification.hypotheses.effect_fit import Fit, FitPlan, Hypothesis, NoiseModel, Problem
from robustlab.identification.monitoring.change_test import PieceEquations
from robustlab.identification.monitoring.changes import Change
from robustlab.identification.naming.first_look import effect_columns, own_derivatives

MOST_BENT = 4.0  # square of residuals that are not linear in the parameters, over the noise of one point
SLOW = 6  # cosines in a window, over which unnamed errors are looked for


def placed(problem: Problem, hypothesis: Hypothesis, noise: NoiseModel, z: Array) -> Fit:
    """The model with these parameters in the windows of a piece, each from its best start."""
    return problem.fit(hypothesis, noise, z, plan=FitPlan(problem.tuning.last, 0.5, fixed=True))


def linear_windows(problem: Problem, fit: Fit, spread: Array) -> tuple[Problem, Fit]:
    """The piece, and the model in it, without the windows in which the model is not linear in what may move it.

    Where a force is about that at which a contact breaks away, its motion says little of parameters and all of chance.
    ``spread`` (k, m): steps of the standardised parameters, each tried to both sides; a window counts as linear where
    what is not linear of its residuals, its start free, is less than the noise makes of them.
    """
    (residual,) = problem.whitened(problem.errors(fit.hypothesis, fit.z, fit.starts), fit.noise)
    ((_, over_x),) = own_derivatives(problem, fit, [residual])
    free = np.linalg.qr(over_x)[0]
    simulators = problem.simulators(fit.hypothesis)

    def moved(z: Array) -> Array:
        return problem.whitened(problem.errors(fit.hypothesis, z, fit.starts, simulators), fit.noise)[0] - residual

    bent = np.zeros(len(residual))
    for step in spread.T:
        both = 0.5 * (moved(fit.z + step) + moved(fit.z - step))  # what is even in a step is not linear in it
        left = both - (free @ (np.swapaxes(free, 1, 2) @ both[:, :, None]))[:, :, 0]
        bent = np.maximum(bent, (left**2).sum(axis=1))
    kept = np.flatnonzero(bent < MOST_BENT)
    (record,), (chosen,), (starts,) = problem.records, problem.chosen, fit.starts
    return problem.on([record], [chosen[kept]]), replace(fit, starts=(starts[kept],))


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
