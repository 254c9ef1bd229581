"""Optimal scalings of a closed loop at single frequencies, and rational ones of low order that come close to them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

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
from robustlab.uncertainty.blocks import Block, block_slices, structure_size

FIRST_POINTS = 40  # frequencies before any is added
ROUNDS = 3  # rounds of refinement ...
ADDED = 24  # ... and frequencies added in each; more: fewer peaks missed, more work
CHUNK = 8  # frequencies between two looks at the budget
MU_TOLERANCE = 1e-4  # of the upper bounds
MAX_FACTOR_ORDER = 5  # of one factor of D
SHARPNESS = 24  # exponent of the mean that stands for the peak: smaller rewards lowering other peaks too
ROOM = 0.1  # error of log d at the peak that counts as one where mu is lower by e; larger: even weights
TRIED = 6  # factors tried in a round, those whose fit is worst
COUNTED = 0.04  # zeros and poles lie where the weight is above this share of the largest one ...
REACH = 2.3  # ... and so far (logarithm) beyond: farther ones cost the synthesis digits, bring nothing
FIT_EVALUATIONS = 60  # of one least-squares fit

FIT_WORK = 6000  # of a fit of first order, as measured; it rises with the square of the order


@dataclass(frozen=True, eq=False)
class MuCurve:
    """Upper bounds of mu with their D, G at frequencies in rad/s."""

    omega: AnyArray  # frequencies, shape (n_omega,), rising
    response: AnyArray  # the loop there, shape (n_omega, p, q)
    bounds: tuple[UpperBound, ...]  # the bounds there

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
    """The curve of a stable continuous loop on frequencies that follow it."""
    # Round by round the middles of the intervals in which mu is close to its peak or D changes most.
    grid = default_grid(loop, FIRST_POINTS, 1.0) if first is None else first
    # Every so-many-th frequency first, as far as the budget goes.
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
    """With the first of these frequencies, as far as the budget goes; some of them always."""
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
    """D(s) whose scaled peak on the curve's frequencies is at most ``1 + loss`` times the largest mu, if it can be."""
    fit = _Fit(curve, blocks, budget)
    scalings = fit.constants()
    score = fit.score(scalings)
    while score[1] > curve.peak * (1 + loss) and not budget.over:
        best: tuple[float, tuple[float, float], DynamicScalings] | None = None
        for trial in fit.larger(scalings):
            if max(_orders(trial)) > MAX_FACTOR_ORDER or trial.n_states > max_states:
                continue
            budget.spend(_peaks_work(curve, trial))
            reached = fit.score(trial)
            gain = (score[0] - reached[0]) / (trial.n_states - scalings.n_states)
            if best is None or gain > best[0]:
                best = (gain, reached, trial)
        if best is None or best[0] <= 0:
            trial = fit.all_larger(scalings)
            if trial.n_states > max_states or max(_orders(trial), default=0) > MAX_FACTOR_ORDER:
                break
            reached = fit.score(trial)
            if reached[0] >= score[0]:
                break
            best = (0.0, reached, trial)
        _, score, scalings = best
    return scalings


class _Fit:
    """Factors of every order fitted to a curve, each of them once."""

    def __init__(self, curve: MuCurve, blocks: Sequence[Block], budget: Budget) -> None:
        self.curve, self.blocks, self.budget = curve, blocks, budget
        # A factor may be off by as much (in logarithms) as mu lies below its peak.
        self.weights = ROOM / (ROOM + np.log(max(curve.peak, 1e-300) / np.maximum(curve.levels, 1e-300)))
        self.targets, self.mixings = _targets(curve, blocks)
        self.known: dict[tuple[int, int, int], Factor] = {}

    def factor(self, i: int, k: int, order: int) -> Factor:
        """Factor k of block i in this order."""
        if (i, k, order) not in self.known:
            before = self.factor(i, k, order - 1) if order else None
            self.budget.spend(FIT_WORK * order**2)
            target, omega = self.targets[i][k], self.curve.omega
            self.known[i, k, order] = _fit_factor(omega, target, self.weights, before)
        return self.known[i, k, order]

    def constants(self) -> DynamicScalings:
        """All factors constant."""
        scalings = unit_scalings(self.blocks)
        for i, part in enumerate(scalings.parts):
            factors = tuple(self.factor(i, k, 0) for k in range(len(part.factors)))
            scalings = scalings.with_part(i, BlockScaling(factors, self.mixings[i], part.g))
        return scalings

    def larger(self, scalings: DynamicScalings) -> Iterator[DynamicScalings]:
        """With one order more of one of the factors that fit worst."""
        errors = [
            (float(np.abs(self.weights * (self.targets[i][k] - factor.log_modulus(self.curve.omega))).max()), i, k)
            for i, part in enumerate(scalings.parts)
            for k, factor in enumerate(part.factors)
        ]
        for _, i, k in sorted(errors, reverse=True)[:TRIED]:
            part = scalings.parts[i]
            one = self.factor(i, k, part.factors[k].order + 1)
            yield scalings.with_part(i, part.with_factor(k, one))

    def all_larger(self, scalings: DynamicScalings) -> DynamicScalings:
        """Every factor with one order more."""
        for i, part in enumerate(scalings.parts):
            factors = tuple(self.factor(i, k, f.order + 1) for k, f in enumerate(part.factors))
            scalings = scalings.with_part(i, BlockScaling(factors, part.mixing, part.g))
        return scalings

    def score(self, scalings: DynamicScalings) -> tuple[float, float]:
        """Logarithm of a power mean of the peaks ``sigma_max(D_z M D_w^{-1})`` over frequency, and the largest peak."""
        left = frequency_response(StateSpaceModel(*scalings.on_outputs()), self.curve.omega)
        right = frequency_response(StateSpaceModel(*scalings.on_inputs()), self.curve.omega)
        peaks = np.linalg.svd(left @ self.curve.response @ right, compute_uv=False)[:, 0]
        top, power = max(float(peaks.max(initial=0.0)), 1e-300), SHARPNESS
        return float(np.log(top) + np.log(max(np.mean((peaks / top) ** power), 1e-300)) / power), top


def _peaks_work(curve: MuCurve, scalings: DynamicScalings) -> float:
    """Work of `_Fit.score`: responses of D on both sides, and the singular values."""
    n, size = scalings.n_states, structure_size(scalings.blocks)[1]
    return 300 + len(curve.omega) * (10 + n**2 // 10 + size**3 // 5)


def _orders(scalings: DynamicScalings) -> list[int]:
    return [f.order for part in scalings.parts for f in part.factors]


def _fit_factor(omega: AnyArray, log_d: AnyArray, weights: AnyArray, before: Factor | None) -> Factor:
    """Factor with ``log |d(j omega)|`` close to the given values, by weighted least squares."""
    from scipy.optimize import least_squares

    if before is None:
        return Factor(float(np.average(log_d, weights=weights)))
    log_omega = np.log(omega)
    heard = log_omega[weights > COUNTED * weights.max()]
    low, high = heard[0] - REACH, heard[-1] + REACH
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
    """Frequencies within reach of the data, damping between 0.02 and 50."""
    bottom, top = [-60.0], [60.0]
    for section in factor.sections:
        half = [low, -3.2][: len(section) // 2], [high, 4.6][: len(section) // 2]
        bottom += half[0] * 2
        top += half[1] * 2
    return np.array(bottom), np.array(top)


def _targets(curve: MuCurve, blocks: Sequence[Block]) -> tuple[list[list[AnyArray]], list[tuple[float, ...]]]:
    """For each block its ``log d(omega)`` a factor, and the constant mixing of a repeated scalar."""
    one = reference_block(blocks)
    slices = block_slices(blocks)
    D = np.stack([bound.Dw for bound in curve.bounds])
    base = np.zeros(len(D)) if one is None else np.log(D[:, slices[one][0].start, slices[one][0].start].real)
    top = int(np.argmax(curve.levels))
    targets: list[list[AnyArray]] = []
    mixings: list[tuple[float, ...]] = []
    for i, (block, (w, _)) in enumerate(zip(blocks, slices, strict=True)):
        r = block.rows
        if i == one:
            targets.append([])
            mixings.append(())
            continue
        if block.d_order == 1:
            targets.append([0.5 * (np.log(D[:, w.start, w.start].real) - base)])
            mixings.append(())
            continue
        lower = np.linalg.cholesky(D[top, w, w].real)
        T = (lower / np.diag(lower)).T
        back = np.linalg.inv(T)
        left = np.einsum("kii->ki", back.T @ D[:, w, w] @ back).real
        targets.append([0.5 * (np.log(np.maximum(left[:, k], 1e-300)) - base) for k in range(r)])
        mixings.append(tuple(T[np.triu_indices(r, 1)]))
    return targets, mixings
