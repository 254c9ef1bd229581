"""Numbers that choose speed and accuracy of gain scheduling; a benchmark may hand others down."""

from __future__ import annotations

from dataclasses import dataclass

from robustlab.shown import Tuning

__all__ = ["TUNING", "SchedulingTuning"]


@dataclass(frozen=True)
class SchedulingTuning(Tuning):
    """Defaults of `lpv_gain` and of `hinf` of LPV models."""

    # Work that both may take at effort 1, in the units of `robustlab.budget`.
    work: float = 4e8
    # Back-offs from the optimum of the LMIs at which the largest margin is looked for. Smaller: tighter bounds, more
    # of which rounding leaves unproved.
    gain_backoffs: tuple[float, ...] = (1e-4, 1e-3, 1e-2, 0.1)
    # Smallest scaled gain that is told from zero.
    smallest: float = 1e-5
    # Steps of the solver, at most.
    steps: int = 200
    # Bisections for the smallest gamma that a Lyapunov matrix still proves.
    gain_bisections: int = 12
    # Back-offs of a synthesis. Larger: better conditioned controllers, worse gamma.
    synthesis_backoffs: tuple[float, ...] = (0.005, 0.02, 0.1, 0.3)
    # Couplings t of [R tI; tI S] >= 0 beside one that follows the back-off. Larger: better conditioned, sooner
    # infeasible.
    couplings: tuple[float, ...] = (1.5, 1.05)
    # Rounds in which states are balanced by what the LMIs gave in the last.
    balancings: int = 8
    # Channels added to the frozen plant whose Riccati equations give the first states: sizes in turn, from large to
    # small, and how many times its gamma they may cost at the first start, and at the second.
    added: tuple[float, ...] = tuple(10.0 ** (-0.5 * k) for k in range(17))
    costs: tuple[float, ...] = (30.0, 3.0)
    # A loop this close (relative) to the LMIs' optimum ends the search over back-offs.
    near: float = 0.02
    # Points at which frozen loops are looked at beside the grid, and the seed of their places.
    frozen_points: int = 20
    # Entries of the deviation in a cell up to which every choice of signs is asked for: exact, but 2^n inequalities.
    signed_entries: int = 3
    # Inequalities of one problem, at most: beyond it they outlast any patience.
    inequalities: int = 4000


TUNING = SchedulingTuning()
