r"""Branch and bound over the real parameters: of one matrix here, over the frequency axis in `axis.axis_problems`.

About a fifth of the distance between the bounds of purely real mu is conservatism of the D-G scalings. It goes where
the set is cut into boxes: in each box the real parameters have a smaller range around their own centre. A region is a
box together with the frequencies that are still open there; what is proved for a box holds for its halves, so they
inherit the open frequencies only. Where nothing is singular in any region, by continuity from the nominal model no
Delta of the set destabilises.

References
----------
Newlin, Young, "Mixed mu problems and branch and bound techniques" (1997); Roos, Biannic, "A detailed comparative
analysis of mu lower bound algorithms" (2015) for what the lower bound is tested against.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array, ComplexArray, Mask
from robustlab.budget import Budget
from robustlab.mu_analysis.matrix.box import Box, box_matrices, centre_matrix, root_box
from robustlab.mu_analysis.matrix.certificate import delta_norm, singularity
from robustlab.mu_analysis.matrix.lower import lower_bound
from robustlab.mu_analysis.matrix.scalings import relative, supply
from robustlab.mu_analysis.matrix.upper import UpperBound, points_below, points_work
from robustlab.mu_analysis.tuning import TUNING, MuTuning
from robustlab.shown import Shown
from robustlab.uncertainty.blocks import Block, block_slices


@dataclass(frozen=True)
class Improved:
    """A better lower bound met on the way: its level, and the Delta that attains it.

    ``values`` are the entries of the real blocks (complex ones are 0); for a constant matrix the whole Delta (q, p).
    """

    level: float
    values: NDArray[Any]


@dataclass
class Region(Shown):
    """A box, its open frequencies (for a constant matrix one place, zero), and where its parent could not be proved.

    ``missed`` are the frequencies at which it was not proved itself, with the level and each block's weight there.
    """

    box: Box
    open: list[tuple[float, float]]
    hot: float | None = None
    missed: list[tuple[float, float, Array]] = field(default_factory=list)
    in_a_row: int = 0


@dataclass
class Proof:
    """What branch and bound has come to."""

    # lower, upper: bounds of the level (mu, or the worst gain)
    lower: float
    upper: float
    # What attains `lower`, as in `Improved`; None where the lower bound that was given is still the best.
    values: NDArray[Any] | None = None
    # Regions proved, each with the frequencies that its ancestors had left to it.
    leaves: list[Region] = field(default_factory=list)
    solves: int = 0  # D-G problems solved


class Problem(Protocol):
    """What `tighten` needs to know of a problem."""

    @property
    def blocks(self) -> Sequence[Block]:
        """All blocks."""
        ...

    def work(self, count: int) -> int:
        """Work of one look at so many regions."""
        ...

    def root(self, level: float) -> Region:
        """The whole set in which nothing may be singular if the level is an upper bound."""
        ...

    def examine(self, regions: list[Region]) -> list[Array | None]:
        """Take what can be proved off each region's open frequencies.

        Returns the weight of each block for a region that has to be cut, None for others.
        """
        ...

    def attack(self, region: Region) -> Improved | None:
        """The worst Delta found cheaply from the region's centre, inside it."""
        ...


def tighten(
    problem: Problem, lower: float, upper: float, tolerance: float, budget: Budget, tuning: MuTuning = TUNING
) -> Proof:
    """Bring ``upper`` down to ``lower (1 + tolerance)``, or as far as the budget allows.

    A wide gap is halved first, and halved again: each level costs several times the one before it, so that what is
    proved when the work is done is worth having, and the way there cost little.

    ``lower``, ``upper``: level attained, and level proved already (inf: none).
    ``budget``: where it is over, the search stops.
    """
    proof = Proof(lower, upper)
    while proof.upper > proof.lower * (1 + tolerance) * (1 + 1e-12) and not budget.over:
        gap = min(proof.upper / proof.lower - 1, 2.0)
        level = proof.lower * (1 + (tolerance if gap <= 3 * tolerance else gap / 2))
        regions, leaves = [problem.root(level)], []
        worse = _prove(problem, regions, level, budget, leaves, proof, tuning)
        if worse is not None:
            proof.lower, proof.values = worse.level, worse.values
        elif regions:  # the budget is over, or a box has come to rounding size
            break
        else:
            proof.upper, proof.leaves = level, leaves
    return proof


def by_regions(count: int) -> str:
    """What a result says of a proof by so many regions."""
    return f"proved by branch and bound; regions of parameters and frequency: {count}"


def _prove(
    problem: Problem,
    regions: list[Region],
    level: float,
    budget: Budget,
    leaves: list[Region],
    proof: Proof,
    tuning: MuTuning,
) -> Improved | None:
    """Work on the regions, a stack emptied in place, until all are proved or the budget is over; or a Delta above it.

    A region whose box has come to rounding size is put back, and ends the work.
    """
    real, root = real_blocks(problem.blocks), problem.root(level).box
    while regions and not budget.over:
        chosen = regions[-tuning.regions :]
        del regions[-tuning.regions :]
        before = [list(r.open) for r in chosen]
        proof.solves += len(chosen)
        weights = problem.examine(chosen)
        budget.spend(problem.work(len(chosen)))
        stuck, worst = False, None
        for region, was, weight in zip(chosen, before, weights, strict=True):
            if not region.open:
                leaves.append(Region(region.box, was, region.hot))
                continue
            if weight is None:
                regions.append(region)
                continue
            found = problem.attack(region)
            if found is not None and found.level > level and (worst is None or found.level > worst.level):
                worst = found
            index = _where_to_cut(region.box, weight, real, root, tuning.narrow)
            if index is None:
                regions.append(region)
                stuck = True
                continue
            regions.extend(Region(half, list(region.open), region.hot) for half in region.box.halves(index))
        if worst is not None:
            return worst
        if stuck:
            return None
    return None


def real_blocks(blocks: Sequence[Block]) -> Mask:
    """Which blocks are real scalars, shape (n_blocks,): those whose interval can be cut."""
    return np.array([b.interval is not None for b in blocks], dtype=bool)


def _where_to_cut(box: Box, weight: Array, real: Mask, root: Box, narrow: float) -> int | None:
    """The real block that weighs most in what is not proved, wide intervals first; None where all are narrow."""
    share = np.where(real & (box.half > narrow * root.half), box.half / np.maximum(root.half, 1e-300), 0.0)
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

    def __init__(self, M: ComplexArray, blocks: Sequence[Block], tuning: MuTuning = TUNING) -> None:
        self.M, self.blocks, self.tuning = M, tuple(blocks), tuning
        self._found: Improved | None = None
        self._batches = 0

    def root(self, level: float) -> Region:
        """All Delta of size ``1 / level``."""
        return Region(root_box(self.blocks, 1 / level), [(0.0, 0.0)])

    def work(self, count: int) -> int:
        """D-G bounds, and what goes with a region: forming it, weighing it, cutting it."""
        return points_work(self.blocks, count) + 150 * count

    def examine(self, regions: list[Region]) -> list[Array | None]:
        """A region is proved where its D-G bound is below one; the worst others are searched for a Delta."""
        stack = box_matrices(self.M, self.blocks, [r.box for r in regions])
        sound = [bool(np.isfinite(matrix).all()) for matrix in stack]
        bounds = iter(points_below(stack[sound], self.blocks, 1.0) if any(sound) else [])
        result: list[Array | None] = []
        failed: list[tuple[float, int]] = []
        for k, (region, matrix, good) in enumerate(zip(regions, stack, sound, strict=True)):
            bound = next(bounds) if good else None
            if bound is not None and bound.beta < 1:
                region.open.clear()
                result.append(None)
                continue
            result.append(np.ones(len(self.blocks)) if bound is None else block_weights(matrix, bound, self.blocks))
            if bound is not None:
                failed.append((-bound.beta, k))
        # The lower bound that was given is good nearly always: looks at batch 1, 2, 4, 8, ... cost little.
        self._batches += 1
        if self._batches & (self._batches - 1) == 0:
            for _, k in sorted(failed)[: self.tuning.searched]:
                self._search(stack[k], regions[k].box)
        return result

    def _search(self, matrix: ComplexArray, box: Box) -> None:
        """A singular Delta inside the box, if a short search finds one."""
        value, delta = lower_bound(matrix, self.blocks, 0, restarts=2, steps=15)
        if delta is None or value < 1:
            return
        half = np.repeat(box.half, [b.rows for b in self.blocks])
        whole = centre_matrix(self.blocks, box.centre) + half[:, None] * delta
        size = delta_norm(self.blocks, whole)
        if singularity(self.M, whole) <= self.tuning.singular and (self._found is None or 1 / size > self._found.level):
            self._found = Improved(1 / size, whole)

    def attack(self, region: Region) -> Improved | None:
        """The worst Delta that the search of open regions has met."""
        return self._found
