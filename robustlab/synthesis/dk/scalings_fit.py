"""Optimal scalings of a closed loop at single frequencies, and fits of them by rational ones of low order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import Budget, dense
from robustlab.linear_analysis.frequency import default_grid, frequency_response
from robustlab.mu_analysis.matrix.upper import UpperBound, points_work, upper_bounds
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.dk.dynamic_scalings import (
    BlockScaling,
    DynamicScalings,
    Factor,
    reference_block,
    unit_scalings,
)
from robustlab.uncertainty.blocks import Block, block_slices

FIRST_POINTS = 40  # frequencies of the first grid
ROUNDS = 3  # rounds of refinement ...
ADDED = 24  # ... and frequencies added in each; more: fewer peaks missed, more work
CHUNK = 8  # frequencies between two checks of the budget
MU_TOLERANCE = 1e-4  # of the upper bounds
MAX_FACTOR_ORDER = 5  # of one factor of D
SHARPNESS = 24  # exponent of the power mean that approximates the peak; smaller: other peaks count more
LOG_ERROR = 0.1  # error of log d at the peak that counts as one where mu is lower by e; larger: even weights
TRIED = 6  # worst-fitted factors tried in a round
COUNTED = 0.04  # zeros and poles are placed where the weight is above this share of the largest ...
REACH = 2.3  # ... and up to this logarithmic distance beyond: others cost the synthesis digits without gain
FIT_EVALUATIONS = 60  # of one least-squares fit

FIT_WORK = 6000  # measured, of a fit of first order; it rises with the square of the order


@dataclass(frozen=True, eq=False)
class MuCurve:
    """Upper bounds of mu with their D, G at frequencies in rad/s."""

    omega: AnyArray  # ascending frequencies, shape (n_omega,)
    response: AnyArray  # frequency response of the loop, shape (n_omega, p, q)
    bounds: tuple[UpperBound, ...]

    @property
    def levels(self) -> AnyArray:
        """The upper bounds, shape (n_omega,)."""
        return np.array([bound.beta for bound in self.bounds])

    @property
    def peak(self) -> float:
        """The largest upper bound; not a bound between the frequencies."""
        return float(self.levels.max(initial=0.0))


def as_complex(blocks: Sequence[Block]) -> tuple[Block, ...]:
    """Return the structure with complex instead of real scalars, as for scalings without G."""
    return tuple(b.as_complex() for b in blocks)


def mu_curve(loop: StateSpaceModel, blocks: Sequence[Block], budget: Budget, first: AnyArray | None = None) -> MuCurve:
    """Return the curve of a stable continuous loop on adaptive frequencies."""
    # Each round adds the middles of the intervals in which mu is close to its peak or D changes most.
    grid = default_grid(loop, FIRST_POINTS, 1.0) if first is None else first
    # Interleaved, so that a small budget covers the whole axis.
    stride = max(1, len(grid) // CHUNK)
    order = np.concatenate([np.arange(start, len(grid), stride) for start in range(stride)])
    curve = _extended(None, loop, blocks, grid[order], budget)
    for _ in range(ROUNDS):
        if budget.over:
            break
        levels, omega, top = curve.levels, curve.omega, max(curve.peak, 1e-300)
        d = np.log(np.array([np.einsum("ii->i", b.Dw).real for b in curve.bounds]))
        d -= d.mean(axis=1, keepdims=True)
        height = np.maximum(levels[1:], levels[:-1]) / top
        change = np.abs(np.diff(d, axis=0)).max(axis=1) + np.abs(np.diff(levels)) / top
        urgency = height**4 * change * (np.diff(np.log(omega)) > 1e-3)
        chosen = np.argsort(-urgency)[:ADDED]
        chosen = chosen[urgency[chosen] > 0.02]
        if not len(chosen):
            break
        curve = _extended(curve, loop, blocks, np.sqrt(omega[chosen]) * np.sqrt(omega[chosen + 1]), budget)
    return curve


def _extended(
    curve: MuCurve | None, loop: StateSpaceModel, blocks: Sequence[Block], omega: AnyArray, budget: Budget
) -> MuCurve:
    """Return the curve extended by these frequencies as far as the budget allows, at least by the first ones."""
    responses, bounds = ([], []) if curve is None else ([curve.response], list(curve.bounds))
    known = np.zeros(0) if curve is None else curve.omega
    done = 0
    while done < len(omega) and (not done or not budget.over):
        chunk = omega[done : done + CHUNK]
        budget.spend(points_work(blocks, len(chunk)) + dense(loop.n_states))
        responses.append(frequency_response(loop, chunk))
        bounds += upper_bounds(responses[-1], blocks, MU_TOLERANCE)
        done += len(chunk)
    known = np.concatenate([known, omega[:done]])
    order = np.argsort(known, kind="stable")
    return MuCurve(known[order], np.concatenate(responses)[order], tuple(bounds[i] for i in order))


def fitted_scalings(
    curve: MuCurve, blocks: Sequence[Block], loss: float, max_states: int, budget: Budget
) -> DynamicScalings:
    """Return D(s) with a scaled peak on the curve of at most ``1 + loss`` times the largest mu, if possible."""
    # The allowed logarithmic error of a factor grows with the distance of mu from its peak.
    weights = LOG_ERROR / (LOG_ERROR + np.log(max(curve.peak, 1e-300) / np.maximum(curve.levels, 1e-300)))
    targets, mixings = _targets(curve, blocks)
    unit, slots = unit_scalings(blocks), [(i, k) for i, some in enumerate(targets) for k in range(len(some))]

    @cache
    def factor(slot: tuple[int, int], order: int) -> Factor:
        before = factor(slot, order - 1) if order else None
        budget.spend(FIT_WORK * order**2)
        return _fit_factor(curve.omega, targets[slot[0]][slot[1]], weights, before)

    def made(orders: tuple[int, ...]) -> DynamicScalings:
        factors = [factor(slot, order) for slot, order in zip(slots, orders, strict=True)]
        own = [tuple(f for f, (j, _) in zip(factors, slots, strict=True) if j == i) for i in range(len(blocks))]
        parts = [BlockScaling(f, m, part.g) for f, m, part in zip(own, mixings, unit.parts, strict=True)]
        return DynamicScalings(unit.blocks, tuple(parts))

    def error(j: int) -> float:
        (i, k), fitted = slots[j], factor(slots[j], orders[j]).log_modulus(curve.omega)
        return float(np.abs(weights * (targets[i][k] - fitted)).max())

    orders = (0,) * len(slots)
    scalings = made(orders)
    score, peak = _score(curve, scalings)
    while peak > curve.peak * (1 + loss) and not budget.over:
        worst = sorted(range(len(slots)), key=error, reverse=True)[:TRIED]
        single = [tuple(order + (j == k) for k, order in enumerate(orders)) for j in worst]
        # Raise the order where this lowers the peaks most per state; if no factor does, raise all orders.
        for trials in (single, [tuple(order + 1 for order in orders)]):
            best: tuple[float, float, float, tuple[int, ...], DynamicScalings] | None = None
            for more in trials:
                trial = made(more) if max(more, default=0) <= MAX_FACTOR_ORDER else None
                if trial is None or trial.n_states > max_states or trial.n_states == scalings.n_states:
                    continue
                budget.spend(300 + len(curve.omega) * (10 + trial.n_states**2 // 10 + len(curve.response[0]) ** 3 // 5))
                reached, top = _score(curve, trial)
                gain = (score - reached) / (trial.n_states - scalings.n_states)
                if gain > (0.0 if best is None else best[0]):
                    best = gain, reached, top, more, trial
            if best is not None:
                break
        else:
            break
        _, score, peak, orders, scalings = best
    return scalings


def _score(curve: MuCurve, scalings: DynamicScalings) -> tuple[float, float]:
    """Return the log power mean of the peaks ``sigma_max(D_z M D_w^{-1})`` over frequency, and the largest peak."""
    left = frequency_response(StateSpaceModel(*scalings.on_outputs()), curve.omega)
    right = frequency_response(StateSpaceModel(*scalings.on_inputs()), curve.omega)
    peaks = np.linalg.svd(left @ curve.response @ right, compute_uv=False)[:, 0]
    top = max(float(peaks.max(initial=0.0)), 1e-300)
    return float(np.log(top) + np.log(max(np.mean((peaks / top) ** SHARPNESS), 1e-300)) / SHARPNESS), top


def _fit_factor(omega: AnyArray, log_d: AnyArray, weights: AnyArray, before: Factor | None) -> Factor:
    """Fit a factor to ``log |d(j omega)|`` by weighted least squares."""
    from scipy.optimize import least_squares

    if before is None:
        return Factor(float(np.average(log_d, weights=weights)))
    log_omega = np.log(omega)
    relevant = log_omega[weights > COUNTED * weights.max()]
    low, high = relevant[0] - REACH, relevant[-1] + REACH
    error = weights * (log_d - before.log_modulus(omega))
    best: tuple[float, Factor] | None = None
    for at in (float(log_omega[np.argmax(np.abs(error))]), float(log_omega.mean())):
        start = before.with_section(at - 0.1, at + 0.1)
        bottom, top = _bounds(start, low, high)
        values = np.clip(start.parameters(), bottom + 1e-6, top - 1e-6)

        def residual(x: AnyArray, form: Factor = start) -> AnyArray:
            return weights * (form.with_parameters(iter(x)).log_modulus(omega) - log_d)

        found = least_squares(residual, values, bounds=(bottom, top), max_nfev=FIT_EVALUATIONS)
        if best is None or found.cost < best[0]:
            best = (float(found.cost), start.with_parameters(iter(found.x)))
    assert best is not None
    return best[1]


def _bounds(factor: Factor, low: float, high: float) -> tuple[AnyArray, AnyArray]:
    """Return bounds of a factor's parameters: frequencies near the data, damping between 0.02 and 50."""
    bottom, top = [-60.0], [60.0]
    for section in factor.sections:
        half = [low, -3.2][: len(section) // 2], [high, 4.6][: len(section) // 2]
        bottom += half[0] * 2
        top += half[1] * 2
    return np.array(bottom), np.array(top)


def _targets(curve: MuCurve, blocks: Sequence[Block]) -> tuple[list[list[AnyArray]], list[tuple[float, ...]]]:
    """Return ``log d(omega)`` of each block's factors, and the constant mixing of a repeated scalar."""
    one = reference_block(blocks)
    slices = block_slices(blocks)
    D = np.stack([bound.Dw for bound in curve.bounds])
    base = np.zeros(len(D)) if one is None else np.log(D[:, slices[one][0].start, slices[one][0].start].real)
    top = int(np.argmax(curve.levels))
    targets, mixings = list[list[AnyArray]](), list[tuple[float, ...]]()
    for i, (block, (w, _)) in enumerate(zip(blocks, slices, strict=True)):
        own, T = D[:, w, w], np.eye(block.rows)
        if block.d_order > 1:
            lower = np.linalg.cholesky(own[top].real)
            T = (lower / np.diag(lower)).T
            back = np.linalg.inv(T)
            own = back.T @ own @ back
        mixings.append(tuple(T[np.triu_indices(block.rows, 1)]) if block.d_order > 1 else ())
        count = 0 if i == one else block.d_order
        targets.append([0.5 * (np.log(np.maximum(own[:, k, k].real, 1e-300)) - base) for k in range(count)])
    return targets, mixings
