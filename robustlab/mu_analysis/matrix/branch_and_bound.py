r"""Branch and bound over the real parameters, with the interval bounds over frequency inside.

About a fifth of the distance between the bounds of purely real mu is conservatism of the D-G scalings. It goes where
the set is cut into boxes: in each box the real parameters have a smaller range around their own centre. A region is a
box together with the frequencies that are still open there; what is proved for a box holds for its halves, so they
inherit the open frequencies only. Nothing is singular in any region: then, by continuity from the stable nominal
model, no Delta of the set destabilises.

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

from robustlab.arrays import Array, ComplexArray
from robustlab.budget import Budget
from robustlab.frequency import frequency_response
from robustlab.mu_analysis.axis.intervals import AxisCover, extend, extend_work
from robustlab.mu_analysis.axis.pole_migration import perturbed_state_matrix
from robustlab.mu_analysis.matrix.box import Box, block_entries, box_matrices, box_model, centre_matrix, gauge, root_box
from robustlab.mu_analysis.matrix.certificate import delta_norm, singularity
from robustlab.mu_analysis.matrix.gain import ascend_corners
from robustlab.mu_analysis.matrix.lower import SINGULAR, lower_bound
from robustlab.mu_analysis.matrix.scalings import hermitian
from robustlab.mu_analysis.matrix.upper import UpperBound, points_below, points_work
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks.base import Block, RealScalar, block_slices

__all__ = ["GainProblem", "Improved", "MarginProblem", "MatrixProblem", "Proof", "Region", "tighten"]


BATCH = 16  # regions solved together
INSIDE = 0.98  # level aimed at in a region, so that its D, G hold on an interval worth having
PROVED = 0.9999  # a level below this proves the point
SEARCHED = 2  # regions of a batch in which a Delta is searched for, where the problem is one matrix
NARROW = 1e-7  # relative width below which a box is not cut again: rounding decides there


@dataclass(frozen=True)
class Improved:
    """A better lower bound met on the way: its level, and the Delta that attains it.

    ``values`` are the entries of the real blocks (complex ones are 0); for a constant matrix the whole Delta (q, p).
    """

    level: float
    values: NDArray[Any]


@dataclass
class Region:
    """A box, its open frequencies (for a constant matrix one place, zero), and where its parent could not be proved."""

    box: Box
    open: list[tuple[float, float]]
    hot: float | None = None


@dataclass
class Proof:
    """What branch and bound has come to.

    Attributes
    ----------
    lower, upper
        Bounds of the level (mu, or the worst gain).
    values
        What attains ``lower``, as in `Improved`; None where the lower bound that was given is still the best.
    leaves
        Regions proved, each with the frequencies that its ancestors had left to it.
    solves
        D-G problems solved.
    """

    lower: float
    upper: float
    values: NDArray[Any] | None = None
    leaves: list[Region] = field(default_factory=list)
    solves: int = 0


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


def tighten(problem: Problem, lower: float, upper: float, tolerance: float, budget: Budget) -> Proof:
    """Bring ``upper`` down to ``lower (1 + tolerance)``, or as far as the budget allows.

    A wide gap is halved first, and halved again: each level costs several times the one before it, so that what is
    proved when the work is done is worth having, and the way there cost little.

    Parameters
    ----------
    lower, upper
        Level attained, and level proved already (inf: none).
    budget
        Where it is over, the search stops.
    """
    proof = Proof(lower, upper)
    while proof.upper > proof.lower * (1 + tolerance) * (1 + 1e-12) and not budget.over:
        gap = min(proof.upper / proof.lower - 1, 2.0)
        level = proof.lower * (1 + (tolerance if gap <= 3 * tolerance else gap / 2))
        regions, leaves = [problem.root(level)], []
        worse = _prove(problem, regions, level, budget, leaves, proof)
        if worse is not None:
            proof.lower, proof.values = worse.level, worse.values
        elif regions:  # the budget is over, or a box has come to rounding size
            break
        else:
            proof.upper, proof.leaves = level, leaves
    return proof


def _prove(
    problem: Problem, regions: list[Region], level: float, budget: Budget, leaves: list[Region], proof: Proof
) -> Improved | None:
    """Work on the regions, a stack emptied in place, until all are proved or the budget is over; or a Delta above it.

    A region whose box has come to rounding size is put back, and ends the work.
    """
    real, root = _real(problem), problem.root(level).box
    while regions and not budget.over:
        chosen = regions[-BATCH:]
        del regions[-BATCH:]
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
            index = _where_to_cut(region.box, weight, real, root)
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


def _real(problem: Problem) -> NDArray[np.bool_]:
    return np.array([isinstance(b, RealScalar) for b in problem.blocks], dtype=bool)


def _where_to_cut(box: Box, weight: Array, real: NDArray[np.bool_], root: Box) -> int | None:
    """The real block that weighs most in what is not proved, wide intervals first; None where all are narrow."""
    share = np.where(real & (box.half > NARROW * root.half), box.half / np.maximum(root.half, 1e-300), 0.0)
    if not share.any():
        return None
    return int(np.argmax((weight / max(float(weight.sum()), 1e-300) + 1e-6) * np.sqrt(share)))


def _weights(M: ComplexArray, bound: UpperBound, blocks: Sequence[Block]) -> Array:
    """How much each block carries of the directions in which D, G come nearest to failing."""
    product = bound.G @ M
    supply = hermitian(M) @ bound.Dz @ M + 1j * (product - hermitian(product))
    try:
        factor = np.linalg.cholesky(bound.Dw)
        half = np.linalg.solve(factor, supply)
        relative = np.linalg.solve(factor, hermitian(half))
        values, vectors = np.linalg.eigh((relative + hermitian(relative)) / 2)
    except np.linalg.LinAlgError:
        return np.ones(len(blocks))
    vectors = np.abs(vectors[:, -3:]) ** 2 * np.maximum(values[-3:], 0.0)
    return np.array([float(vectors[w].sum()) for w, _ in block_slices(blocks)])


# --- constant matrices -----------------------------------------------------------------------------------------------


class MatrixProblem:
    """mu of one matrix M (p, q)."""

    def __init__(self, M: ComplexArray, blocks: Sequence[Block]) -> None:
        self.M, self.blocks = M, tuple(blocks)
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
            result.append(np.ones(len(self.blocks)) if bound is None else _weights(matrix, bound, self.blocks))
            if bound is not None:
                failed.append((-bound.beta, k))
        # The lower bound that was given is good nearly always: looks at batch 1, 2, 4, 8, ... cost little.
        self._batches += 1
        if self._batches & (self._batches - 1) == 0:
            for _, k in sorted(failed)[:SEARCHED]:
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
        if singularity(self.M, whole) <= SINGULAR and (self._found is None or 1 / size > self._found.level):
            self._found = Improved(1 / size, whole)

    def attack(self, region: Region) -> Improved | None:
        """The worst Delta that the search of open regions has met."""
        return self._found


# --- the whole frequency axis ----------------------------------------------------------------------------------------


class _AxisProblem:
    """Regions of a stable continuous model's Delta channels over [0, inf]."""

    def __init__(self, model: StateSpaceModel, blocks: Sequence[Block], hot: float | None) -> None:
        self.model, self.blocks, self.hot = model, tuple(blocks), hot
        poles = np.abs(model.poles())
        self.scale = float(np.median(poles)) if len(poles) else 1.0

    def work(self, count: int) -> int:
        """A D-G bound and an interval of each region, and the eigenvalues of a few members."""
        return points_work(self.blocks, count) + count * (500 + extend_work(self.model))

    def examine(self, regions: list[Region]) -> list[Array | None]:
        """One frequency of each region: proved with an interval around it, or the region has to be cut."""
        models = [box_model(self.model, self.blocks, r.box) for r in regions]
        places = [self._frequency(r) for r in regions]
        sound = [k for k, m in enumerate(models) if m is not None]
        result: list[Array | None] = [np.ones(len(self.blocks)) for _ in regions]
        if not sound:
            return result
        responses = np.concatenate([frequency_response(_known(models[k]), np.array([places[k]])) for k in sound])
        for k, M, bound in zip(sound, responses, points_below(responses, self.blocks, INSIDE), strict=True):
            region, model = regions[k], _known(models[k])
            piece = extend(model, bound, 1.0, places[k]) if bound.beta < PROVED else None
            if piece is None or not piece.low <= places[k] <= piece.high:
                region.hot = places[k]
                result[k] = _weights(M, bound, self.blocks)
                continue
            cover = AxisCover(open=region.open)
            cover.add(piece)
            region.open, region.hot = cover.open, None
            result[k] = None
        return result

    def _frequency(self, region: Region) -> float:
        if region.hot is not None and any(low <= region.hot <= high for low, high in region.open):
            return region.hot
        return float(AxisCover(open=region.open).next_points(self.scale, 1)[0])


def _known(model: StateSpaceModel | None) -> StateSpaceModel:
    assert model is not None
    return model


class MarginProblem(_AxisProblem):
    """The largest mu over the axis: levels are mu, the set has size ``1 / level``."""

    def root(self, level: float) -> Region:
        """All Delta of size ``1 / level`` on the whole axis."""
        return Region(root_box(self.blocks, 1 / level), [(0.0, float("inf"))], self.hot)

    def attack(self, region: Region) -> Improved | None:
        """From the centre to the corner that moves the pole next to the axis outwards, as long as that helps."""
        centre, half = region.box.centre, region.box.half
        values = centre
        for _ in range(3):
            if self._rightmost(values) >= 0:
                return self._crossing(values)
            slope = self._slope(values, region.hot or 0.0)
            corner = np.where(_real(self), centre + half * np.sign(slope), 0.0)
            if np.array_equal(corner, values):
                return None
            values = corner
        return self._crossing(values) if self._rightmost(values) >= 0 else None

    def _perturbed(self, values: Array) -> Array:
        delta = centre_matrix(self.blocks, values).astype(complex)
        return np.real(perturbed_state_matrix(self.model, delta))

    def _rightmost(self, values: Array) -> float:
        matrix = self._perturbed(values)
        if not np.isfinite(matrix).all():
            return float("inf")
        return float(np.linalg.eigvals(matrix).real.max(initial=-np.inf))

    def _slope(self, values: Array, omega: float) -> Array:
        """Derivative of the real part of the pole next to ``j omega`` by each entry."""
        delta = centre_matrix(self.blocks, values)
        poles, right = np.linalg.eig(self._perturbed(values))
        k = int(np.argmin(np.abs(poles - 1j * omega)))
        left = np.linalg.solve(right.T + 1e-13 * np.eye(len(poles)), np.eye(len(poles))[k])
        z = np.linalg.solve(np.eye(self.model.n_outputs) - self.model.D @ delta, self.model.C @ right[:, k])
        back = np.eye(self.model.n_inputs) - delta @ self.model.D
        w = np.linalg.solve(back.T, self.model.B.T @ left)
        gains = [
            (w[sw] * z[sz]).sum().real if isinstance(b, RealScalar) else 0.0
            for b, (sw, sz) in zip(self.blocks, block_slices(self.blocks), strict=True)
        ]
        return np.array(gains)

    def _crossing(self, values: Array) -> Improved | None:
        """The smallest multiple of these entries, by bisection, at which a pole is on or right of the axis."""
        stable, unstable = 0.0, 1.0
        for _ in range(50):
            middle = (stable + unstable) / 2
            if self._rightmost(middle * values) >= 0:
                unstable = middle
            else:
                stable = middle
        size = gauge(self.blocks, unstable * values)
        return Improved(1 / size, unstable * values) if size > 0 else None


class GainProblem(_AxisProblem):
    """The largest gain over the axis and the unit set: levels are gains; the last block stands for the performance."""

    def root(self, level: float) -> Region:
        """The unit set, and a performance block of size ``1 / level``."""
        whole = root_box(self.blocks)
        half = whole.half.copy()
        half[-1] = 1 / level
        return Region(Box(whole.centre, half), [(0.0, float("inf"))], self.hot)

    def attack(self, region: Region) -> Improved | None:
        """From the centre to the corner that raises the gain at the frequency in question, as long as that helps."""
        M = frequency_response(self.model, np.array([region.hot if region.hot is not None else self.scale]))[0]
        met = ascend_corners(M, self.blocks, region.box, region.box.centre)
        best = max(met, key=lambda gain: gain.value, default=None)
        if best is None:
            return None
        return Improved(best.value, np.append(block_entries(self.blocks[:-1], best.delta), 0.0))
