"""Branch and bound over the real parameters: of one matrix here, over the frequency axis in `axis.axis_problems`.

Newlin, Young, "Mixed mu problems and branch and bound techniques" (1997).
"""

# About a fifth of the distance between the bounds of purely real mu is conservatism of the D-G scalings. It goes
# where the set is cut into boxes. A region is a box together with the frequencies that are still open there; what is
# proved for a box holds for its halves, so they inherit the open frequencies only. Where nothing is singular in any
# region, by continuity from the nominal model no Delta of the set destabilises.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

from robustlab.arrays import Array, ComplexArray, Mask
from robustlab.budget import Budget
from robustlab.mu_analysis.constants import SINGULAR
from robustlab.mu_analysis.matrix.box import Box, box_matrices, centre_matrix, root_box
from robustlab.mu_analysis.matrix.certificate import delta_norm, singularity
from robustlab.mu_analysis.matrix.lower import lower_bound
from robustlab.mu_analysis.matrix.scalings import relative, supply
from robustlab.mu_analysis.matrix.upper import UpperBound, points_below, points_work
from robustlab.shown import Shown
from robustlab.uncertainty.blocks import Block, block_slices

REGIONS = 16  # solved together; more: quicker each, more of them in vain where a Delta is met
KEPT = 0.0625  # share of the work kept for a smaller set, and spent before a set is judged out of reach
NARROW = 1e-7  # relative width below which a box is not cut again: rounding decides there


class Improved(NamedTuple):
    """A better lower bound met on the way: its level, and the Delta that attains it."""

    level: float
    values: Any


@dataclass
class Region(Shown):
    """A box, its open frequencies (for a constant matrix one place, zero), and where its parent could not be proved."""

    box: Box
    open: list[tuple[float, float]]
    hot: float | None = None
    missed: list[tuple[float, float, Array]] = field(default_factory=list)
    in_a_row: int = 0
    proof: tuple[Box, UpperBound] | None = None


@dataclass
class Proof:
    """Bounds of the level (mu, or a gain), what attains the lower one if it was met here, and the regions proved."""

    lower: float
    upper: float
    values: Any = None
    leaves: list[Region] = field(default_factory=list)


class Problem(Protocol):
    """What `tighten` needs to know of a problem: its blocks, the set that a level leaves, the work of so many regions.

    ``examine`` takes what can be proved off each region's open frequencies: None, or weights of the blocks where it is
    to be cut. ``attack`` is the worst Delta found cheaply from the region's centre, where that is above the level.
    """

    blocks: tuple[Block, ...]

    def work(self, count: int) -> int: ...
    def root(self, level: float) -> Region: ...
    def examine(self, regions: list[Region]) -> list[Array | None]: ...
    def attack(self, region: Region, level: float, budget: Budget) -> Improved | None: ...


def tighten(problem: Problem, lower: float, upper: float, tolerance: float, budget: Budget) -> Proof:
    """Bring ``upper`` down to ``lower (1 + tolerance)``, or as far as the budget allows."""
    # That level is tried at once. Where a larger lower bound is met, or the work will not do, what is left is cut back
    # to the smaller set of a larger level: what was proved holds there, too, and nothing begins anew.
    proof, last = Proof(lower, upper), 0.0
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
    """One proof of a set that may get smaller on the way: what is open of it, a stack, and what is proved."""

    def __init__(self, problem: Problem, proof: Proof, tolerance: float, budget: Budget) -> None:
        self.problem, self.proof, self.tolerance, self.budget = problem, proof, tolerance, budget
        self.real = np.array([b.interval is not None for b in problem.blocks], dtype=bool)
        self.level = proof.lower * (1 + tolerance)
        self.root = problem.root(self.level)
        self.regions, self.leaves = [self.root], list[Region]()
        self._begin()

    def run(self) -> bool:
        """Whether all regions were proved: then the level is in the proof, as its ``upper``."""
        while self.regions and not self.budget.over:
            if not self._look():
                return False
            if self.regions and self._out_of_reach() and not self._give_way():
                self.budget.use_up()
                return False
        if self.regions:
            return False
        self.proof.upper, self.proof.leaves = self.level, self._within_root(self.leaves)
        return True

    def _look(self) -> bool:
        """Take some regions off the stack, put back what is left of them; False where one has come to rounding size."""
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
            found = self.problem.attack(region, self.proof.lower, self.budget)
            if found is not None and found.level > self.proof.lower:
                self.proof.lower, self.proof.values = found.level, found.values
            index = _where_to_cut(region.box, weight, self.real, self.root.box)
            if index is None:
                self.regions.append(region)
                sound = False
                continue
            self.regions.extend(Region(half, list(region.open), region.hot) for half in region.box.halves(index))
        if self.proof.lower * (1 + self.tolerance) > self.level * (1 + 1e-12):
            self._cut_back(self.proof.lower * (1 + self.tolerance))
        return sound

    def _begin(self) -> None:
        self.work, self.seconds, self.open = self.budget.left, self.budget.seconds_left, self._volume()

    def _volume(self) -> float:
        """What is open of the set, as a share of its volume."""
        whole = np.maximum(self.root.box.half[self.real], 1e-300)
        return sum(float(np.prod(region.box.half[self.real] / whole)) for region in self.regions)

    def _out_of_reach(self) -> bool:
        """Whether the work, or the time, will not do, as far as the volume proved so far tells."""
        left = self._volume() / self.open
        if _too_little(self.budget.left, self.work, left):
            return True
        if _too_little(self.budget.seconds_left, self.seconds, left):
            self.budget.strike()  # the clock chooses the set: not repeatable
            return True
        return False

    def _give_way(self) -> bool:
        """A quarter of the way back to what is proved already; False where that is next to it."""
        known = self.proof.upper
        level = self.level * (known / self.level) ** 0.25 if np.isfinite(known) else 2 * self.level
        if level * (1 + self.tolerance) >= known:
            return False
        self._cut_back(float(level))
        return True

    def _cut_back(self, level: float) -> None:
        self.level, self.root = level, self.problem.root(level)
        self.regions = self._within_root(self.regions)
        self._begin()

    def _within_root(self, regions: list[Region]) -> list[Region]:
        cut = ((region.box.within(self.root.box), region) for region in regions)
        return [Region(box, list(r.open), r.hot, proof=r.proof) for box, r in cut if box is not None]


def _too_little(there: float, begun_with: float, left: float) -> bool:
    """Whether what there is will not do for the volume left, by what was done with the rest of it."""
    if begun_with == np.inf:
        return False
    done = (1 - max(there, 0.0) / begun_with) / (1 - KEPT) if begun_with > 0 else 1.0
    return done >= 1 or (done >= KEPT and done**2 * left > (1 - done) * (1 - left))


def _where_to_cut(box: Box, weight: Array, real: Mask, root: Box) -> int | None:
    """The real block that weighs most in what is not proved, wide intervals first; None where all are narrow."""
    share = np.where(real & (box.half > NARROW * root.half), box.half / np.maximum(root.half, 1e-300), 0.0)
    if not share.any():
        return None
    return int(np.argmax((weight / max(float(weight.sum()), 1e-300) + 1e-6) * np.sqrt(share)))


def block_weights(M: ComplexArray, bound: UpperBound, blocks: Sequence[Block]) -> Array:
    """How much each block carries of the directions in which D, G come nearest to failing."""
    try:
        values, vectors = np.linalg.eigh(relative(bound.Dw, supply(M, bound.Dz, bound.G)))
    except np.linalg.LinAlgError:
        return np.ones(len(blocks))
    vectors = np.abs(vectors[:, -3:]) ** 2 * np.maximum(values[-3:], 0.0)
    return np.array([float(vectors[w].sum()) for w, _ in block_slices(blocks)])


class MatrixProblem:
    """mu of one matrix M (p, q)."""

    def __init__(self, M: ComplexArray, blocks: Sequence[Block]) -> None:
        self.M, self.blocks, self._attacks = M, tuple(blocks), 0

    def root(self, level: float) -> Region:
        """All Delta of size ``1 / level``."""
        return Region(root_box(self.blocks, 1 / level), [(0.0, 0.0)])

    def work(self, count: int) -> int:
        """D-G bounds, and what goes with a region: forming it, weighing it, cutting it."""
        return points_work(self.blocks, count) + 150 * count

    def examine(self, regions: list[Region]) -> list[Array | None]:
        """A region is proved where its D-G bound is below one."""
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
        """A singular Delta inside the box, if a short search finds one."""
        # The lower bound that was given is good nearly always: looks at region 1, 2, 4, 8, ... cost little.
        self._attacks += 1
        (matrix,) = box_matrices(self.M, self.blocks, [region.box])
        if self._attacks & (self._attacks - 1) or not np.isfinite(matrix).all():
            return None
        value, delta = lower_bound(matrix, self.blocks, 0, restarts=2, steps=15)
        if delta is None or value < 1:
            return None
        half = np.repeat(region.box.half, [b.rows for b in self.blocks])
        whole = centre_matrix(self.blocks, region.box.centre) + half[:, None] * delta
        return Improved(1 / delta_norm(self.blocks, whole), whole) if singularity(self.M, whole) <= SINGULAR else None
