"""Smaller destabilising members, found by moving one mode after the other to the axis in a box of real parameters."""

# max Re lambda_k(A + B Delta (I - D Delta)^-1 C) over |delta_i| <= s, by quasi-Newton steps with the exact
# derivative. Where modes are lightly damped, two that meet inside the box may exchange their damping there, and paths
# from the nominal poles, as in pole_migration, miss it: on chains of 24 masses (benchmarks/mu.py) gaps are 11 and 55 %
# without this search and 5 % with it. The result for one mode is a local maximum among many, so the search restarts
# from the best of each with a few parameters redrawn, more often for less damped modes (iterated local search,
# Lourenço, Martin, Stützle 2003). A mode is identified by its frequency, because the one of largest real part is nearly
# always the slowest. Branch and bound makes the same ascent from the centres of regions.

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from robustlab.arrays import Array, ComplexArray
from robustlab.budget import Budget, dense
from robustlab.mu_analysis.axis.pole_migration import (
    Destabilising,
    descended,
    first_crossing,
    perturbed_state_matrix,
)
from robustlab.mu_analysis.matrix.box import block_entries, centre_matrix, gauge, lowest
from robustlab.mu_analysis.matrix.delta_layout import delta_layout
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block, block_slices

REACH = 0.99  # size of the box of the search, relative to the smallest known member
FAILED = 5  # unsuccessful ascents in a box, for each mode, that end a chain of them
CHAINS = 3  # consecutive unsuccessful chains that end the search
LEAST_DAMPED = 5  # modes that are restarted more often than the others
REDRAWN = 3  # most parameters redrawn for a restart
FIRST = 0.3  # share of the way to its own corner at which a nominal mode begins
SHRINKING = (0.05, 0.01)  # shares by which the box shrinks around a mode that has crossed the axis
STEPS = 30  # quasi-Newton steps of one ascent


class Ascent(NamedTuple):
    """Entries (n_blocks,) of the member at the end of an ascent, its pole, and the number of members evaluated."""

    values: Array
    pole: complex
    looks: int


def _mode_next_to(
    model: StateSpaceModel, blocks: Sequence[Block], values: Array, aim: complex
) -> tuple[complex, Array] | None:
    """Return the pole next to ``aim`` of the member with these entries, and the derivatives of its real part."""
    delta = centre_matrix(blocks, values)
    a = np.real(perturbed_state_matrix(model, delta.astype(complex)))
    if not np.isfinite(a).all():
        return None
    poles, right = np.linalg.eig(a)
    k = int(np.argmin(np.abs(poles - aim)))
    left = np.linalg.solve(right.T + 1e-13 * np.eye(len(poles)), np.eye(len(poles))[k])
    z, w = model.C @ right[:, k], model.B.T @ left
    if model.D.any():
        z = np.linalg.solve(np.eye(model.n_outputs) - model.D @ delta, z)
        w = np.linalg.solve(np.eye(model.n_inputs) - (delta @ model.D).T, w)
    slopes = [
        (w[sw] * z[sz]).sum().real if b.interval else 0.0
        for b, (sw, sz) in zip(blocks, block_slices(blocks), strict=True)
    ]
    return complex(poles[k]), np.array(slopes)


def member_poles(model: StateSpaceModel, blocks: Sequence[Block], values: Array) -> ComplexArray:
    """Return the poles of the member with these entries (n_blocks,); one at infinity where it is ill-posed."""
    a = np.real(perturbed_state_matrix(model, centre_matrix(blocks, values).astype(complex)))
    return np.linalg.eigvals(a).astype(complex) if np.isfinite(a).all() else np.array([complex(np.inf)])


def member_work(model: StateSpaceModel, members: int) -> int:
    """Return the measured work of this number of members: eigenvalues with the vectors of one of them."""
    return members * dense(model.n_states) // 4


def ascended(model: StateSpaceModel, blocks: Sequence[Block], start: Array, size: float, aim: complex) -> Ascent | None:
    """Maximise the real part of the pole next to the aim by quasi-Newton steps from ``start`` in a box of this size."""
    from scipy.optimize import minimize

    first = _mode_next_to(model, blocks, start, aim)
    if first is None:
        return None
    unit = max(abs(first[0].real), 1e-9 * abs(first[0]))
    place = aim

    def damping(point: Array) -> tuple[float, Array]:
        nonlocal place
        now = _mode_next_to(model, blocks, point * size, place)
        if now is None:  # worst value: the line search turns back
            return 1e3, np.zeros(len(point))
        place = 1j * now[0].imag
        return -now[0].real / unit, -now[1] * size / unit

    bounds = [(float(low), 1.0) for low in lowest(blocks)]
    found = minimize(damping, start / size, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": STEPS})
    return Ascent(found.x * size, complex(-found.fun * unit, abs(place.imag)), 1 + found.nfev)


def shrunk(
    model: StateSpaceModel, blocks: Sequence[Block], values: Array, worst: Destabilising, budget: Budget
) -> Destabilising:
    """Shrink an unstable member along its mode and move it onto the axis; return it, or ``worst`` if not smaller."""
    low = lowest(blocks)
    for step in SHRINKING:
        while _work_left(budget):
            poles, smaller = member_poles(model, blocks, values), gauge(blocks, values) * (1 - step)
            aim = 1j * abs(float(poles[poles.real.argmax()].imag))
            found = ascended(model, blocks, np.clip(values, smaller * low, smaller), smaller, aim)
            budget.spend(member_work(model, 2 if found is None else 1 + found.looks))
            if found is None or found.pole.real <= 0:
                break
            values = found.values
    delta = centre_matrix(blocks, values).astype(complex)
    lower = [descended(model, delta_layout(blocks), delta[None])[0]] if all(b.interval for b in blocks) else []
    for candidate in (*lower, delta):
        crossing = first_crossing(model, blocks, candidate)
        if crossing is not None and member_size(blocks, crossing) < member_size(blocks, worst):
            return crossing
    return worst


def member_size(blocks: Sequence[Block], member: Destabilising) -> float:
    """Return the size of the smallest set that holds this member."""
    return gauge(blocks, block_entries(blocks, member.delta))


def _work_left(budget: Budget) -> bool:
    """Return whether work is left; record only the end by a time limit."""
    return budget.left > 0 and not (budget.seconds_left <= 0 and budget.over)


def smaller_destabilising(
    model: StateSpaceModel, blocks: Sequence[Block], worst: Destabilising, budget: Budget, seed: int = 0
) -> Destabilising:
    """Return a destabilising Delta of real blocks that is smaller than ``worst``, or ``worst`` where none was found."""
    rng, low, in_vain = np.random.default_rng(seed), lowest(blocks), 0
    nominal = model.poles()
    frequencies = np.sort(nominal.imag[nominal.imag > 0])
    slopes = [_mode_next_to(model, blocks, np.zeros(len(blocks)), 1j * w) for w in frequencies]
    corners = [FIRST * np.where(s is not None and s[1] < 0, low, 1.0) for s in slopes]
    if np.isfinite(worst.pole):
        worst = shrunk(model, blocks, block_entries(blocks, worst.delta) * (1 + 1e-9), worst, budget)
    while in_vain < CHAINS and _work_left(budget):
        size = member_size(blocks, worst)
        box = size * REACH
        best: dict[int, tuple[float, Array]] = {}  # of each mode its least damping in this box, and where
        for k in range((1 + FAILED) * len(corners)):
            if not _work_left(budget) or (k >= len(corners) and not best):
                break
            if k < len(corners):
                mode, point = k, corners[k]
            else:
                order = sorted(best, key=lambda mode: best[mode][0])
                mode = order[min(int(rng.exponential(LEAST_DAMPED)), len(order) - 1)]
                point = best[mode][1].copy()
                redrawn = rng.permutation(len(point))[: rng.integers(1, REDRAWN + 1)]
                point[redrawn] = rng.uniform(low[redrawn], 1.0)
            poles = member_poles(model, blocks, box * point)
            upper = np.sort(poles.imag[poles.imag > 0])
            found = ascended(model, blocks, box * point, box, 1j * upper[mode]) if mode < len(upper) else None
            budget.spend(member_work(model, 2 if found is None else 1 + found.looks))
            if found is None:
                continue
            damping = -found.pole.real / max(abs(found.pole), 1e-300)
            if mode not in best or damping < best[mode][0]:
                best[mode] = damping, found.values / box
            if found.pole.real > 0:
                worst = shrunk(model, blocks, found.values, worst, budget)
                break
        in_vain = 0 if member_size(blocks, worst) < size else in_vain + 1
    return worst
