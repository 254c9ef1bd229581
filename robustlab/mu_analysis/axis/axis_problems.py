"""Branch-and-bound problems over the whole frequency axis: regions of parameters and frequency."""

# A region is proved where intervals with constant D, G cover its open frequencies; a proof for an ancestor also holds
# in it.

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import Budget, dense
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.mu_analysis.axis.axis_model import typical_speed
from robustlab.mu_analysis.axis.intervals import Piece, extend, extend_work, next_points, remaining
from robustlab.mu_analysis.axis.mode_ascent import REACH, ascended, member_poles, member_size, member_work, shrunk
from robustlab.mu_analysis.axis.pole_migration import Destabilising
from robustlab.mu_analysis.matrix.box import Box, block_entries, box_model, centre_matrix, root_box
from robustlab.mu_analysis.matrix.branch_and_bound import Improved, Region, block_weights
from robustlab.mu_analysis.matrix.skew import ascend
from robustlab.mu_analysis.matrix.upper import points_below, points_work
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block

INSIDE = 0.98  # level aimed at in a region; smaller: wider intervals, more cuts
PROVED = 0.9999  # a level below this proves the point
MISSES = 3  # consecutive unproved frequencies after which a region is cut; more: fewer repeated, more useless proofs
ASCENT_WORK = 200  # measured work of a step of an ascent without its eigenvalues
CORNERS = 4  # steps of the ascent of a gain from the centre of a region
NEAR_MISS = 0.01  # log width around a missed frequency in which no other is tried before the cut

__all__ = ["GainProblem", "MarginProblem"]


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
