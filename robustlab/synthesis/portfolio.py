"""Two scalings of one plant searched side by side: each alone fails somewhere, and where they agree trust grows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robustlab.budget import Budget
from robustlab.synthesis.partition import PlantMatrices
from robustlab.synthesis.scaling import Scaling, by_magnitude
from robustlab.synthesis.search import IMPROVEMENT, SHARES, Candidate, Search, smallest

__all__ = ["Portfolio", "portfolio"]

# The other scaling confirms the leader's gamma with the regularisation of this size.
CONFIRMATION = SHARES[3:4]
DISAGREEMENT = 5e-4


@dataclass(frozen=True, eq=False)
class Portfolio:
    """The searches over two scalings.

    Attributes
    ----------
    leader
        The search that found the smallest gamma.
    other
        The other one.
    disagree
        Relative difference of the gammas they reached; NaN where one found none or was not asked.
    """

    leader: Search
    other: Search
    disagree: float

    def estimated_optimum(self) -> float:
        """The infimum of gamma over all controllers as the search sees it; NaN where it cannot tell.

        Of a regular plant the smallest gamma that passes its own Riccati test; else extrapolated over the size of the
        regularisation, with whose square the regularised optimum rises.
        """
        best, regular = self.leader.best, self.leader.regular_gamma
        if best is not None and regular is not None and regular <= best.gamma * (1 + 1e-9) <= 1.0006 * regular:
            return regular
        by_share = dict(self.leader.optima[-2:])
        if len(by_share) < 2:
            return float("nan")
        (small, low), (large, high) = sorted(by_share.items())
        return max(low - max(high - low, 0.0) * small**2 / (large**2 - small**2), self.leader.floor)

    @property
    def candidates(self) -> list[Candidate]:
        """Of both."""
        return self.leader.candidates + self.other.candidates


def portfolio(
    matrices: PlantMatrices,
    scalings: tuple[Scaling, Scaling],
    budget: Budget,
    floor: float = 0.0,
    D22: NDArray[np.float64] | None = None,
) -> Portfolio:
    """Search both scalings coarsely, refine the better one, and let the other one confirm its gamma.

    ``floor`` is a proved lower bound of gamma: a search that meets it is done. ``D22`` is the direct term that was left
    out of the plant.
    """
    one, two = (Search(matrices, scaling, budget, floor, D22) for scaling in scalings)
    for search in (one, two):
        search.ladder()
        if search.best is not None and search.proved(search.best):
            return Portfolio(search, two if search is one else one, float("nan"))
    if one.best is None and two.best is None:
        for search in (one, two):
            search.take_care()
            search.ladder()
    if one.best is None and two.best is None:  # a control or a measurement of quite another size than its cost
        one = Search(matrices, by_magnitude(matrices), budget, floor, D22)
        one.ladder()
    leader, other = (one, two) if _gamma(one.best) <= _gamma(two.best) else (two, one)
    if not leader.settled:
        leader.polish(leader.best)
    if leader.best is not None and leader.proved(leader.best):
        return Portfolio(leader, other, _difference(leader, _gamma(other.best)))
    # Settled or not: the Riccati test may have failed by rounding alone.
    reached = min(_gamma(other.best), _confirmed(leader, other, CONFIRMATION))
    if leader.best is not None and not _agree(leader.best, leader, reached):
        # One of them is stuck: go over both once more from the better loop, with every solver and all probes.
        for search in (leader, other):
            search.take_care()
        leader.polish(leader.best)
        reached = min(reached, _confirmed(leader, other, SHARES[1:]))
        if reached < _gamma(leader.best) * (1 - IMPROVEMENT):
            leader, other = other, leader
            reached = _gamma(other.best)
    return Portfolio(leader, other, _difference(leader, reached))


def _difference(leader: Search, reached: float) -> float:
    smaller, larger = sorted((_gamma(leader.best), reached))
    return larger / smaller - 1 if smaller > 0 and larger < float("inf") else float("nan")


def _confirmed(leader: Search, other: Search, shares: tuple[float, ...]) -> float:
    """What the other search reaches from the leader's best loop."""
    before = len(other.candidates)
    other.polish(leader.best, shares)
    return _gamma(smallest(other.candidates[before:]))


def _agree(best: Candidate, leader: Search, reached: float) -> bool:
    return leader.negligible(best) or abs(reached - best.gamma) <= DISAGREEMENT * best.gamma


def _gamma(candidate: Candidate | None) -> float:
    return float("inf") if candidate is None else candidate.gamma
