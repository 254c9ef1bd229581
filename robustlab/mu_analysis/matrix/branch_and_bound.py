"""Boxes of perturbations, and branch and bound over the real parameters.

Of one matrix here, over the frequency axis in `axis.robustness`. Newlin, Young, "Mixed mu problems and branch and
bound techniques" (1997).
"""

# With centre c and half width h of each block Delta = C + H Delta', |Delta'| <= 1, and M' = (I - M C)^-1 M H is the
# model for Delta'. Asymmetric ranges and branch and bound are boxes whose centre is not the nominal point.

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

from robustlab.arrays import Array, ComplexArray, Mask
from robustlab.budget import Budget
from robustlab.display import Displayable
from robustlab.mu_analysis.matrix.block_structure import delta_norm, relative, supply
from robustlab.mu_analysis.matrix.lower import SINGULAR, lower_bound, singularity
from robustlab.mu_analysis.matrix.upper import UpperBound, points_below, points_work
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block, block_slices, structure_size


@dataclass(frozen=True)
class Box:
    """Centre and half width of each block, shape (n_blocks,); the centre of a complex block is zero."""

    centre: Array
    half: Array

    def halves(self, index: int) -> tuple[Box, Box]:
        """Cut the interval of one real block in its middle; return both boxes."""
        half = self.half.copy()
        half[index] /= 2
        low, high = self.centre.copy(), self.centre.copy()
        low[index] -= half[index]
        high[index] += half[index]
        return Box(low, half), Box(high, half)

    def within(self, other: Box) -> Box | None:
        """Return the intersection of both boxes; None where it has no volume."""
        low = np.maximum(self.centre - self.half, other.centre - other.half)
        high = np.minimum(self.centre + self.half, other.centre + other.half)
        return Box((low + high) / 2, (high - low) / 2) if (high > low).all() else None


def lowest(blocks: Sequence[Block]) -> Array:
    """Return the normalised lower end of each block's range: -1, or ``-below / radius`` where asymmetric."""
    return np.array([b.interval[0] if b.interval else -1.0 for b in blocks])


def root_box(blocks: Sequence[Block], size: float = 1.0) -> Box:
    """Return the whole set, scaled by ``size`` about the nominal point."""
    low, real = lowest(blocks), np.array([b.interval is not None for b in blocks], dtype=bool)
    return Box(np.where(real, size * (1 + low) / 2, 0.0), np.where(real, size * (1 - low) / 2, size))


def gauge(blocks: Sequence[Block], values: Array) -> float:
    """Return the smallest size of the set that holds these entries of Delta (moduli for complex blocks)."""
    low = lowest(blocks)
    return float(np.max(np.where(values >= 0, values, values / low), initial=0.0))


def block_entries(blocks: Sequence[Block], delta: ComplexArray) -> Array:
    """Return the value of each real block in Delta (q, p), and the size of a complex one, shape (n_blocks,)."""
    parts = [(block, delta[w, z]) for block, (w, z) in zip(blocks, block_slices(blocks), strict=True)]
    return np.array([part[0, 0].real if block.interval else np.linalg.norm(part, 2) for block, part in parts])


def centre_matrix(blocks: Sequence[Block], centre: Array) -> Array:
    """Return the Delta (q, p) of a box's centre."""
    matrix = np.zeros(structure_size(blocks))
    for value, block, (w, z) in zip(centre, blocks, block_slices(blocks), strict=True):
        if block.interval:
            matrix[w, z] = value * np.eye(block.rows)
    return matrix


def box_model(model: StateSpaceModel, blocks: Sequence[Block], box: Box) -> StateSpaceModel | None:
    """Return the Delta channels for a box's normalised Delta; None where the loop is ill-posed at the centre."""
    middle = centre_matrix(blocks, box.centre)
    half = np.repeat(box.half, [b.rows for b in blocks])
    if not box.centre.any():
        return StateSpaceModel(model.A, model.B * half, model.C, model.D * half)
    p = model.n_outputs
    try:
        solved = np.linalg.solve(np.eye(p) - model.D @ middle, np.hstack([model.C, model.D]))
    except np.linalg.LinAlgError:
        return None
    if not np.isfinite(solved).all():
        return None
    to_z, direct = solved[:, : model.n_states], solved[:, model.n_states :]
    # w = C z + H w' with z = to_z x + direct H w'
    into = model.B + model.B @ middle @ direct
    return StateSpaceModel(model.A + model.B @ middle @ to_z, into * half, to_z, direct * half)


def box_matrices(M: ComplexArray, blocks: Sequence[Block], boxes: Sequence[Box]) -> ComplexArray:
    """Return ``(I - M C)^-1 M H`` of M (p, q) for each box, shape (k, p, q); NaN where ill-posed at the centre."""
    p = M.shape[0]
    middle = np.stack([centre_matrix(blocks, box.centre) for box in boxes])
    half = np.stack([np.repeat(box.half, [b.rows for b in blocks]) for box in boxes])
    loop = np.eye(p) - M @ middle
    result = np.full((len(boxes), *M.shape), np.nan, dtype=complex)
    for k, matrix in enumerate(loop):
        try:
            result[k] = np.linalg.solve(matrix, M) * half[k]
        except np.linalg.LinAlgError:
            continue
    return result


# --- branch and bound ----------------------------------------------------------------------------------------------

# About a fifth of the gap between the bounds of purely real mu is conservatism of the D-G scalings, which cutting the
# set into boxes removes. A region is a box with its open frequencies; a proof for a box holds for its halves, so they
# inherit the open frequencies only. Where nothing is singular in any region, by continuity from the nominal model no
# Delta of the set destabilises.
REGIONS = 16  # solved together; more: faster per region, more useless ones when a Delta is found
KEPT = 0.0625  # share of the work reserved for a smaller set, and spent before a set is judged infeasible
SEARCHED = 0.02  # share of the work after which a longer search for a lower bound is made
NARROW = 1e-7  # relative width below which a box is not cut because of rounding


class Improved(NamedTuple):
    """A better lower bound found during the proof: its level, and the Delta that attains it."""

    level: float
    values: Any


@dataclass
class Region(Displayable):
    """A box, its open frequencies (for a constant matrix only zero), and the unproved frequency of its parent."""

    box: Box
    open: list[tuple[float, float]]
    hot: float | None = None
    missed: list[tuple[float, float, Array]] = field(default_factory=list)
    in_a_row: int = 0
    proof: tuple[Box, UpperBound] | None = None
    model: StateSpaceModel | None = None  # of the box, for a proof over frequency


@dataclass
class Proof:
    """Bounds of the level (mu, or a gain), the Delta of the lower one if found here, and the proved regions."""

    lower: float
    upper: float
    values: Any = None
    leaves: list[Region] = field(default_factory=list)
    search: Search | None = None
    search_at: float = -np.inf  # the work left at which it is made


class Problem(Protocol):
    """Interface of a problem for `tighten`: its blocks, the set of a level, and the work of a number of regions.

    ``examine`` removes proved frequencies from each region and returns None, or weights of the blocks if it must be
    cut. ``attack`` returns the worst Delta found cheaply from the region's centre, if that is above the level.
    """

    blocks: tuple[Block, ...]

    def work(self, count: int) -> int: ...
    def root(self, level: float) -> Region: ...
    def examine(self, regions: list[Region]) -> list[Array | None]: ...
    def attack(self, region: Region, level: float, budget: Budget) -> Improved | None: ...


Search = Callable[[Budget], Improved | None]


def tighten(
    problem: Problem, lower: float, upper: float, tolerance: float, budget: Budget, search: Search | None = None
) -> Proof:
    """Bring ``upper`` down to ``lower (1 + tolerance)``, or as far as the budget allows."""
    # ``search`` is a longer one for a larger lower bound. The level ``lower (1 + tolerance)`` is tried first. If a
    # larger lower bound is found, or the work does not suffice, the open regions are reduced to the smaller set of a
    # larger level, for which all proofs so far hold.
    proof, last = Proof(lower, upper, search=search), 0.0
    proof.search_at = (1 - SEARCHED) * budget.left
    while proof.upper > proof.lower * (1 + tolerance) * (1 + 1e-12) and not budget.over:
        if budget.left <= last:  # the next level costs more than the one before
            budget.use_up()
            break
        before = budget.left
        if not _Descent(problem, proof, tolerance, budget).run():
            break
        last = before - budget.left
    return proof


class _Descent:
    """One proof of a set that may be reduced during it: a stack of open regions, and the proved ones."""

    def __init__(self, problem: Problem, proof: Proof, tolerance: float, budget: Budget) -> None:
        self.problem, self.proof, self.tolerance, self.budget = problem, proof, tolerance, budget
        self.real = np.array([b.interval is not None for b in problem.blocks], dtype=bool)
        self.level = proof.lower * (1 + tolerance)
        self.root = problem.root(self.level)
        self.regions, self.leaves, self.attacks = [self.root], list[Region](), 0
        self._start_measuring()

    def run(self) -> bool:
        """Prove all regions and set ``upper`` of the proof; return False if that fails."""
        while self.regions and not self.budget.over:
            if not self._examine_some():
                return False
            if self.regions and self.proof.search is not None and self.budget.left <= self.proof.search_at:
                self._take(self.proof.search(self.budget))
                self.proof.search = None
                self._cut_back(max(self.level, self.proof.lower * (1 + self.tolerance)))
            if self.regions and self._infeasible() and not self._retreat():
                self.budget.use_up()
                return False
        if self.regions:
            return False
        self.proof.upper, self.proof.leaves = self.level, self._within_root(self.leaves)
        return True

    def _examine_some(self) -> bool:
        """Examine some regions of the stack and put back their open parts; False where one has rounding size."""
        chosen = self.regions[-REGIONS:]
        del self.regions[-REGIONS:]
        before = [list(r.open) for r in chosen]
        weights = self.problem.examine(chosen)
        self.budget.spend(self.problem.work(len(chosen)))
        sound = True
        for region, was, weight in zip(chosen, before, weights, strict=True):
            if not region.open:
                self.leaves.append(Region(region.box, was, region.hot, proof=region.proof))
                continue
            if weight is None:
                self.regions.append(region)
                continue
            self.attacks += 1  # the given lower bound is nearly always good: search in regions 1, 2, 4, 8, ...
            seldom = self.attacks & (self.attacks - 1)
            found = None if seldom else self.problem.attack(region, self.proof.lower, self.budget)
            self._take(found)
            index = _block_to_cut(region.box, weight, self.real, self.root.box)
            if index is None:
                self.regions.append(region)
                sound = False
                continue
            self.regions.extend(Region(half, list(region.open), region.hot) for half in region.box.halves(index))
        if self.proof.lower * (1 + self.tolerance) > self.level * (1 + 1e-12):
            self._cut_back(self.proof.lower * (1 + self.tolerance))
        return sound

    def _take(self, found: Improved | None) -> None:
        if found is not None and found.level > self.proof.lower:
            self.proof.lower, self.proof.values = found.level, found.values

    def _start_measuring(self) -> None:
        self.work, self.seconds, self.open = self.budget.left, self.budget.seconds_left, self._volume()

    def _volume(self) -> float:
        """Return the open share of the set's volume."""
        whole = np.maximum(self.root.box.half[self.real], 1e-300)
        return sum(float(np.prod(region.box.half[self.real] / whole)) for region in self.regions)

    def _infeasible(self) -> bool:
        """Return whether the work, or the time, is too little, extrapolated from the volume proved so far."""
        left = self._volume() / self.open
        if _too_little(self.budget.left, self.work, left):
            return True
        if _too_little(self.budget.seconds_left, self.seconds, left):
            self.budget.strike()  # the time limit determines the set: not repeatable
            return True
        return False

    def _retreat(self) -> bool:
        """Move a quarter of the way back to the proved level; False if that is next to it."""
        known = self.proof.upper
        level = self.level * (known / self.level) ** 0.25 if np.isfinite(known) else 2 * self.level
        if level * (1 + self.tolerance) >= known:
            return False
        self._cut_back(float(level))
        return True

    def _cut_back(self, level: float) -> None:
        self.level, self.root = level, self.problem.root(level)
        self.regions = self._within_root(self.regions)
        self._start_measuring()

    def _within_root(self, regions: list[Region]) -> list[Region]:
        cut = ((region.box.within(self.root.box), region) for region in regions)
        return [Region(box, list(r.open), r.hot, proof=r.proof) for box, r in cut if box is not None]


def _too_little(available: float, initial: float, left: float) -> bool:
    """Return whether the available work is too little for the volume left, by the progress so far."""
    if initial == np.inf:
        return False
    done = (1 - max(available, 0.0) / initial) / (1 - KEPT) if initial > 0 else 1.0
    return done >= 1 or (done >= KEPT and done**2 * left > (1 - done) * (1 - left))


def _block_to_cut(box: Box, weight: Array, real: Mask, root: Box) -> int | None:
    """Return the real block with the largest weight, wide intervals first; None where all are narrow."""
    share = np.where(real & (box.half > NARROW * root.half), box.half / np.maximum(root.half, 1e-300), 0.0)
    if not share.any():
        return None
    return int(np.argmax((weight / max(float(weight.sum()), 1e-300) + 1e-6) * np.sqrt(share)))


def block_weights(M: ComplexArray, bound: UpperBound, blocks: Sequence[Block]) -> Array:
    """Return the share of each block in the directions in which D, G are closest to failing."""
    try:
        values, vectors = np.linalg.eigh(relative(bound.Dw, supply(M, bound.Dz, bound.G)))
    except np.linalg.LinAlgError:
        return np.ones(len(blocks))
    vectors = np.abs(vectors[:, -3:]) ** 2 * np.maximum(values[-3:], 0.0)
    return np.array([float(vectors[w].sum()) for w, _ in block_slices(blocks)])


class MatrixProblem:
    """mu of one matrix M (p, q)."""

    def __init__(self, M: ComplexArray, blocks: Sequence[Block]) -> None:
        self.M, self.blocks = M, tuple(blocks)

    def root(self, level: float) -> Region:
        """All Delta of size ``1 / level``."""
        return Region(root_box(self.blocks, 1 / level), [(0.0, 0.0)])

    def work(self, count: int) -> int:
        """Return the work of D-G bounds and of forming, weighting and cutting the regions."""
        return points_work(self.blocks, count) + 150 * count

    def examine(self, regions: list[Region]) -> list[Array | None]:
        """Prove each region whose D-G bound is below one."""
        stack = box_matrices(self.M, self.blocks, [r.box for r in regions])
        sound = np.array([bool(np.isfinite(matrix).all()) for matrix in stack], dtype=bool)
        bounds = iter(points_below(stack[sound], self.blocks, 1.0) if sound.any() else [])
        result: list[Array | None] = []
        for region, matrix, good in zip(regions, stack, sound, strict=True):
            bound = next(bounds) if good else None
            if bound is not None and bound.beta < 1:
                region.open.clear()
                region.proof = region.box, bound
                result.append(None)
            else:
                result.append(np.ones(len(self.blocks)) if bound is None else block_weights(matrix, bound, self.blocks))
        return result

    def attack(self, region: Region, level: float, budget: Budget) -> Improved | None:
        """Return a singular Delta inside the box, if a short search finds one."""
        (matrix,) = box_matrices(self.M, self.blocks, [region.box])
        if not np.isfinite(matrix).all():
            return None
        value, delta = lower_bound(matrix, self.blocks, 0, restarts=2, steps=15)
        if delta is None or value < 1:
            return None
        half = np.repeat(region.box.half, [b.rows for b in self.blocks])
        whole = centre_matrix(self.blocks, region.box.centre) + half[:, None] * delta
        return Improved(1 / delta_norm(self.blocks, whole), whole) if singularity(self.M, whole) <= SINGULAR else None
