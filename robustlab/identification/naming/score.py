r"""What each effect could gain on top of a set, from one or a few simulations and no fit.

At the fit of a set the residuals r and their derivatives J over its parameters and X over the windows' starts are
known. An effect at the place where a fit of it would begin changes the residuals by :math:`\Delta`, and its linear
parameters (the two parts of a wave, a load) by their own derivatives; with these as columns G the fall of V that
linearity promises is

.. math:: g^T h^{-1} g, \qquad h = G^T P G, \quad g = G^T P r,

P the projection off everything that the set refits, under its priors. The strength of the effect is free in it, its
other parameters stay. Of six legs with thirty effects each, those few that come near the best are worth a fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from robustlab.arrays import Array
from robustlab.identification.hypotheses.effect_fit import Candidate, Fit, Hypothesis, Problem
from robustlab.identification.hypotheses.normal_equations import Linearised

__all__ = ["Start", "best_scored"]

NEGLIGIBLE = 1e-9  # of a column's own square: what the set refits makes all of it


@dataclass(frozen=True, eq=False)
class Start:
    """An effect on top of a set, and the standardised parameters from which a fit of both begins."""

    candidate: Candidate
    hypothesis: Hypothesis
    z: Array


def best_scored(
    problem: Problem, base: Fit, starts: Sequence[Start], most: int, workers: Executor, said: Callable[[int, int], None]
) -> list[Start]:
    """The starts of at most so many effects, those that promise most; all where there are no more.

    Parameters
    ----------
    base
        The fit of the set in these windows.
    said
        Called with the number of starts scored and to score.
    """
    if len({s.candidate.key for s in starts}) <= most:
        return list(starts)
    residual = problem.whitened(problem.errors(base.hypothesis, base.z, base.starts), base.noise)
    own = _derivatives(problem, base, residual)
    gains: list[float] = []
    for done, gain in enumerate(workers.map(lambda s: _gain(problem, base, residual, own, s), starts), start=1):
        gains.append(gain)
        said(done, len(starts))
    order = sorted(range(len(starts)), key=lambda k: -gains[k])
    kept = list(dict.fromkeys(starts[k].candidate.key for k in order))[:most]
    return [s for s in starts if s.candidate.key in set(kept)]


def _derivatives(problem: Problem, base: Fit, residual: Sequence[Array]) -> list[tuple[Array, Array]]:
    """Derivatives of the residuals over all parameters of the set and over the starts, a pair a record."""
    step, start_step = problem.tuning.step, problem.tuning.start_step
    simulators = problem.simulators(base.hypothesis)

    def moved(z: Array, starts: Sequence[Array], by: float) -> list[Array]:
        there = problem.whitened(problem.errors(base.hypothesis, z, starts, simulators), base.noise)
        return [(t - r) / by for t, r in zip(there, residual, strict=True)]

    n_x = base.starts[0].shape[1]
    over_z = [moved(base.z + step * e, base.starts, step) for e in np.eye(len(base.z))]
    over_x = [moved(base.z, [x + start_step * e for x in base.starts], start_step) for e in np.eye(n_x)]
    return [(_columns(over_z, k, residual[k]), _columns(over_x, k, residual[k])) for k in range(len(residual))]


def _columns(parts: Sequence[Sequence[Array]], k: int, like: Array) -> Array:
    return np.stack([p[k] for p in parts], axis=2) if parts else np.zeros((*like.shape, 0))


def _gain(
    problem: Problem, base: Fit, residual: Sequence[Array], own: Sequence[tuple[Array, Array]], start: Start
) -> float:
    """Fall of V that the effect promises; 0 where it would have to be of negative strength."""
    simulators = problem.simulators(start.hypothesis)

    def there(z: Array) -> list[Array]:
        return problem.whitened(problem.errors(start.hypothesis, z, base.starts, simulators), base.noise)

    with np.errstate(all="ignore"):
        at = there(start.z)
        first = len(start.z) - len(start.candidate.parameters)
        step = problem.tuning.step
        linear = [first + i for i, p in enumerate(start.candidate.parameters) if p.prior.kind == "linear"]
        changes = [[a - r for a, r in zip(at, residual, strict=True)]]
        for i in linear:
            moved = there(start.z + step * np.eye(len(start.z))[i])
            changes.append([(m - a) / step for m, a in zip(moved, at, strict=True)])
        n = len(base.z)
        hessian, gradient = np.zeros((n + len(changes),) * 2), np.zeros(n + len(changes))
        for k, (over_z, over_x) in enumerate(own):
            columns = np.concatenate([over_z, _columns(changes, k, residual[k])], axis=2)
            part = Linearised.of(residual[k], columns, over_x, base.starts[k]).reduced(0.0)
            hessian, gradient = hessian + part.hessian, gradient + part.gradient
    if not (np.isfinite(hessian).all() and np.isfinite(gradient).all()):
        return 0.0
    hessian[:n, :n] += np.eye(n)
    gradient[:n] += base.z
    size = np.diag(hessian)[n:].copy()
    solved = np.linalg.solve(hessian[:n, :n], hessian[:n, n:])
    h = hessian[n:, n:] - hessian[n:, :n] @ solved + np.diag(NEGLIGIBLE * size + np.finfo(float).tiny)
    g = gradient[n:] - solved.T @ gradient[:n]
    strength = np.linalg.solve(h, g)
    return 0.0 if not linear and strength[0] > 0.0 else float(g @ strength)
