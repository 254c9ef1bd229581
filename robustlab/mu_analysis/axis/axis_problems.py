"""Real parameters over the whole axis: smaller destabilising members by ascents of modes, and branch and bound."""

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
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.mu_analysis.axis.axis_model import typical_speed
from robustlab.mu_analysis.axis.intervals import Piece, extend, extend_work, next_points, remaining
from robustlab.mu_analysis.axis.pole_migration import (
    Destabilising,
    descended,
    first_crossing,
    perturbed_state_matrix,
)
from robustlab.mu_analysis.matrix.branch_and_bound import (
    Box,
    Improved,
    Region,
    block_entries,
    block_weights,
    box_model,
    centre_matrix,
    gauge,
    lowest,
    root_box,
)
from robustlab.mu_analysis.matrix.skew import ascend
from robustlab.mu_analysis.matrix.structure import delta_layout
from robustlab.mu_analysis.matrix.upper import points_below, points_work
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


# --- branch and bound over the axis --------------------------------------------------------------------------------

# A region is proved where intervals with constant D, G cover its open frequencies; a proof for an ancestor also holds
# in it.
INSIDE = 0.98  # level aimed at in a region; smaller: wider intervals, more cuts
PROVED = 0.9999  # a level below this proves the point
MISSES = 3  # consecutive unproved frequencies after which a region is cut; more: fewer repeated, more useless proofs
ASCENT_WORK = 200  # measured work of a step of an ascent without its eigenvalues
CORNERS = 4  # steps of the ascent of a gain from the centre of a region
NEAR_MISS = 0.01  # log width around a missed frequency in which no other is tried before the cut


class _AxisProblem:
    """Regions of a stable continuous model's Delta channels over [0, inf]."""

    def __init__(self, model: StateSpaceModel, blocks: Sequence[Block], hot: float | None) -> None:
        self.model, self.blocks, self.hot = model, tuple(blocks), hot
        self.scale = typical_speed(model)
        # Each box with an interval proved in it: the evidence of the whole proof.
        self.proved: list[tuple[Box, Piece]] = []

    def work(self, count: int) -> int:
        """Return the work of a D-G bound and an interval of each region, and the eigenvalues of a few members."""
        each = dense(self.model.n_states) // 2 + extend_work(self.model)
        return points_work(self.blocks, count) // 4 + count * each

    def examine(self, regions: list[Region]) -> list[Array | None]:
        """Try to prove an interval around one frequency of each region."""
        for region in regions:
            region.model = region.model or box_model(self.model, self.blocks, region.box)
        models = [r.model for r in regions]
        places = [self._frequency(r) for r in regions]
        sound = {k: m for k, m in enumerate(models) if m is not None}
        result: list[Array | None] = [np.ones(len(self.blocks)) for _ in regions]
        if not sound:
            return result
        responses = np.concatenate([frequency_response(m, np.array([places[k]])) for k, m in sound.items()])
        bounds = points_below(responses, self.blocks, INSIDE, thorough=False)
        for (k, model), M, bound in zip(sound.items(), responses, bounds, strict=True):
            region, result[k] = regions[k], None
            piece = extend(model, bound, 1.0, places[k]) if bound.beta < PROVED else None
            if piece is not None and piece.low <= places[k] <= piece.high:
                self.proved.append((region.box, piece))
                region.open, region.in_a_row = remaining(region.open, piece.low, piece.high), 0
            else:
                region.missed.append((bound.beta, places[k], block_weights(M, bound, self.blocks)))
                region.in_a_row += 1
            if region.open and (region.in_a_row == MISSES or not self._open_parts(region)):
                _, region.hot, result[k] = max(region.missed, key=lambda miss: miss[0])
        return result

    def _open_parts(self, region: Region) -> list[tuple[float, float]]:
        """Return the open frequencies that are not next to a missed one."""
        near, left = np.exp(NEAR_MISS), region.open
        for _, omega, _ in region.missed:
            left = remaining(left, omega / near, omega * near)
        return left

    def _frequency(self, region: Region) -> float:
        """Return the frequency missed in the parent first, then the middle of the widest part."""
        if not region.missed and region.hot is not None and any(a <= region.hot <= b for a, b in region.open):
            return region.hot
        return float(next_points(self._open_parts(region), self.scale, 1)[0])


class MarginProblem(_AxisProblem):
    """The largest mu over the axis: levels are mu, the set has size ``1 / level``."""

    def root(self, level: float) -> Region:
        """All Delta of size ``1 / level`` on the whole axis."""
        return Region(root_box(self.blocks, 1 / level), [(0.0, float("inf"))], self.hot)

    def attack(self, region: Region, level: float, budget: Budget) -> Improved | None:
        """Ascend from the centre along the mode next to the missed frequency, in a smaller box."""
        values, blocks, aim = region.box.centre, self.blocks, 1j * (region.hot or 0.0)
        if (member_poles(self.model, blocks, values).real < 0).all():
            found = ascended(self.model, blocks, values, REACH / level, aim)
            looks = 1 if found is None else found.looks
            budget.spend(looks * ASCENT_WORK + member_work(self.model, looks))
            if found is None or found.pole.real <= 0:
                return None
            values = found.values
        whole = Destabilising(np.inf, centre_matrix(blocks, values).astype(complex), complex(np.inf))
        found = shrunk(self.model, blocks, values, whole, budget)
        size = member_size(blocks, found)
        return Improved(1 / size, block_entries(blocks, found.delta)) if size > 0 else None


class GainProblem(_AxisProblem):
    """The largest gain over the axis and the unit set: levels are gains; the last block is the performance block."""

    def root(self, level: float) -> Region:
        """The unit set, and a performance block of size ``1 / level``."""
        whole = root_box(self.blocks)
        half = whole.half.copy()
        half[-1] = 1 / level
        return Region(Box(whole.centre, half), [(0.0, float("inf"))], self.hot)

    def attack(self, region: Region, level: float, budget: Budget) -> Improved | None:
        """Ascend from the centre to a larger gain at the missed frequency; return the Delta and that frequency."""
        omega = region.hot if region.hot is not None else self.scale
        M, centre = frequency_response(self.model, np.array([omega]))[0], region.box.centre[:-1]
        best = ascend(M, self.blocks, centre_matrix(self.blocks[:-1], centre) + 0j, region.box, CORNERS)
        return None if best is None else Improved(best.value, (best.delta, omega))
