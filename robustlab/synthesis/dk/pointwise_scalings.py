"""Optimal D, G of a closed loop at single frequencies, more of them where mu is high or the scalings change fast."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import Budget, dense
from robustlab.frequency import default_grid, frequency_response
from robustlab.mu_analysis.matrix.upper import UpperBound, points_work, upper_bounds
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block

__all__ = ["MuCurve", "as_complex", "mu_curve"]


FIRST, ROUNDS, ADDED = 40, 3, 24
CHUNK = 8  # frequencies between two looks at the budget
TOLERANCE = 1e-4


@dataclass(frozen=True, eq=False)
class MuCurve:
    """Upper bounds of mu with their D, G at frequencies in rad/s.

    Attributes
    ----------
    omega
        Frequencies, shape (n_omega,), rising.
    response
        The loop there, shape (n_omega, p, q).
    bounds
        The bounds there.
    """

    omega: AnyArray
    response: AnyArray
    bounds: tuple[UpperBound, ...]

    @property
    def levels(self) -> AnyArray:
        """The upper bounds, shape (n_omega,)."""
        return np.array([bound.beta for bound in self.bounds])

    @property
    def peak(self) -> float:
        """The largest of them: not a bound between the frequencies."""
        return float(self.levels.max(initial=0.0))


def as_complex(blocks: Sequence[Block]) -> tuple[Block, ...]:
    """The same structure with complex instead of real scalars: what D alone can prove."""
    return tuple(b.as_complex() for b in blocks)


def mu_curve(loop: StateSpaceModel, blocks: Sequence[Block], budget: Budget, first: AnyArray | None = None) -> MuCurve:
    """The curve of a stable continuous loop on frequencies that follow it.

    The rising frequencies ``first`` (those of `default_grid` where left out); then, round by round, the middles of the
    intervals in which mu is close to its peak or the entries of D change most, the most urgent ones first. Where
    the budget is over after some of them, it is left at those (the first ones are spread over all).
    """
    omega, response, bounds = _spread(loop, blocks, default_grid(loop, FIRST, 1.0) if first is None else first, budget)
    for _ in range(ROUNDS):
        if budget.over:
            break
        levels = np.array([b.beta for b in bounds])
        d = np.log(np.array([np.einsum("ii->i", b.Dw).real for b in bounds]))
        d -= d.mean(axis=1, keepdims=True)
        height = np.maximum(levels[1:], levels[:-1]) / levels.max()
        change = np.abs(np.diff(d, axis=0)).max(axis=1) + np.abs(np.diff(levels)) / levels.max()
        urgency = height**4 * change * (np.diff(np.log(omega)) > 1e-3)
        chosen = np.argsort(-urgency)[:ADDED]
        chosen = chosen[urgency[chosen] > 0.02]
        if not len(chosen):
            break
        new = np.sqrt(omega[chosen] * omega[chosen + 1])
        more, found = _until(loop, blocks, new, budget)
        new = new[: len(found)]
        order = np.argsort(np.concatenate([omega, new]), kind="stable")
        omega = np.concatenate([omega, new])[order]
        response = np.concatenate([response, more])[order]
        bounds = [[*bounds, *found][i] for i in order]
    return MuCurve(omega, response, tuple(bounds))


def _spread(
    loop: StateSpaceModel, blocks: Sequence[Block], omega: AnyArray, budget: Budget
) -> tuple[AnyArray, AnyArray, list[UpperBound]]:
    """The bounds at every so-many-th frequency first, as far as the budget goes; frequencies rise again."""
    stride = max(1, len(omega) // CHUNK)
    order = np.concatenate([np.arange(start, len(omega), stride) for start in range(stride)])
    response, bounds = _until(loop, blocks, omega[order], budget)
    done = order[: len(bounds)]
    back = np.argsort(done)
    return omega[done[back]], response[back], [bounds[i] for i in back]


def _until(
    loop: StateSpaceModel, blocks: Sequence[Block], omega: AnyArray, budget: Budget
) -> tuple[AnyArray, list[UpperBound]]:
    """Responses and bounds at the first of the frequencies, as far as the budget goes, and at some of them always."""
    responses: list[AnyArray] = []
    bounds: list[UpperBound] = []
    for begin in range(0, len(omega), CHUNK):
        if bounds and budget.over:
            break
        chunk = omega[begin : begin + CHUNK]
        budget.spend(points_work(blocks, len(chunk)) + dense(loop.n_states))
        response, found = _at(loop, blocks, chunk)
        responses.append(response)
        bounds += found
    return np.concatenate(responses), bounds


def _at(loop: StateSpaceModel, blocks: Sequence[Block], omega: AnyArray) -> tuple[AnyArray, list[UpperBound]]:
    response = frequency_response(loop, omega)
    return response, upper_bounds(response, blocks, TOLERANCE)
