"""One piece of a log: prepared, its windows placed, and what it tells about the parameters as equations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from robustlab.arrays import Array
from robustlab.identification import tuning
from robustlab.identification.hypotheses.effect_fit import Fit, FitPlan, Hypothesis, Problem
from robustlab.identification.hypotheses.normal_equations import NoiseModel
from robustlab.identification.monitoring.change_test import PieceEquations
from robustlab.identification.naming.first_look import own_derivatives

MOST_BENT = 1.0  # square of the change of a window's residuals, over the noise of one point
MOST_STEPS, FEW = 16, 0.02  # steps a sample; share of the windows that may still change
SLOW = 6  # cosines in a window, over which unnamed errors are looked for


def placed(problem: Problem, hypothesis: Hypothesis, noise: NoiseModel, z: Array) -> Fit:
    """The model with these parameters in the windows of a piece, each from its best start."""
    return problem.fit(hypothesis, noise, z, plan=FitPlan(tuning.LAST, 0.5, fixed=True))


def faithful_windows(problem: Problem, fit: Fit, spread: Array) -> tuple[Problem, Fit]:
    """The piece, and the model in it, without the windows in which the simulation is not to be trusted that far.

    Where a force is about that at which a contact breaks away, what is known of the parameters changes the motion
    otherwise than linear, and a breakaway within a step is told no better than the step. ``spread`` (k, m): steps of
    the standardised parameters, each tried to both sides. A window stays where neither what is even in such a step,
    nor steps of half the length, change its residuals, starts free, by more than `MOST_BENT`.
    """
    (residual,) = problem.whitened(problem.errors(fit.hypothesis, fit.z, fit.starts), fit.noise)
    free = _free(problem, fit, residual)
    simulators = problem.simulators(fit.hypothesis)

    def moved(z: Array) -> Array:
        return problem.whitened(problem.errors(fit.hypothesis, z, fit.starts, simulators), fit.noise)[0] - residual

    bent = _stepped(problem, fit, residual, free)
    for step in spread.T:
        bent = np.maximum(bent, _beyond_starts(0.5 * (moved(fit.z + step) + moved(fit.z - step)), free))
    kept = np.flatnonzero(bent < MOST_BENT)
    (record,), (chosen,), (starts,) = problem.records, problem.chosen, fit.starts
    return problem.on([record], [chosen[kept]]), replace(fit, starts=(starts[kept],))


def fine_steps(problem: Problem, fit: Fit) -> Problem:
    """The problem with steps so short that half of them change few windows; shorter ones than `MOST_STEPS` are not."""
    while (problem.clock.sub or 1) < MOST_STEPS:
        (residual,) = problem.whitened(problem.errors(fit.hypothesis, fit.z, fit.starts), fit.noise)
        if (_stepped(problem, fit, residual, _free(problem, fit, residual)) > MOST_BENT).mean() <= FEW:
            break
        problem = problem.under(replace(problem.clock, sub=2 * (problem.clock.sub or 1)))
    return problem


def _free(problem: Problem, fit: Fit, residual: Array) -> Array:
    """Orthonormal basis of what the starts do to the residuals, (n_windows, points, n_x)."""
    ((_, over_x),) = own_derivatives(problem, fit, [residual])
    return np.linalg.qr(over_x)[0]


def _beyond_starts(change: Array, free: Array) -> Array:
    """Square of a change of the residuals in each window, starts projected out, (n_windows,)."""
    left = change - (free @ (np.swapaxes(free, 1, 2) @ change[:, :, None]))[:, :, 0]
    return np.asarray((left**2).sum(axis=1))


def _stepped(problem: Problem, fit: Fit, residual: Array, free: Array) -> Array:
    """The same of steps of half the length."""
    halved = problem.under(replace(problem.clock, sub=2 * (problem.clock.sub or 1)))
    (there,) = problem.whitened(halved.errors(fit.hypothesis, fit.z, fit.starts), fit.noise)
    return _beyond_starts(there - residual, free)


def equations(problem: Problem, fit: Fit) -> PieceEquations:
    """The piece's equations for the parameters, at the model ``fit`` that was placed in it."""
    if not len(problem.chosen[0]):  # no window can be trusted
        zero = np.zeros((len(fit.z) + 1,) * 2)
        return PieceEquations(zero, zero, 0, 0)
    residual = problem.whitened(problem.errors(fit.hypothesis, fit.z, fit.starts), fit.noise)
    own = own_derivatives(problem, fit, residual)
    n_y = len(fit.noise.std)
    parts = []
    for r, (over_z, over_x) in zip(residual, own, strict=True):
        columns = np.concatenate([over_z, r[:, :, None]], axis=2)
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
