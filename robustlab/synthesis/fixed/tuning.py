"""Numbers that choose speed and accuracy, at their measured defaults; what is returned is proved whatever they are."""

from __future__ import annotations

from dataclasses import dataclass

from robustlab.budget import MILLION
from robustlab.shown import Tuning


@dataclass(frozen=True)
class FixedTuning(Tuning):
    """Controllers of fixed structure."""

    # Work of a design at effort 1.
    work: float = 60 * MILLION
    # Candidates that are verified, best first; the optimiser's own norm is not a proof. More: slower, seldom better.
    verified: int = 4

    # --- starts from other designs
    # Random starts of the search for the best static gain.
    static_starts: int = 6
    # Shares of the work left for it and for the full order, and most for that.
    static_share: float = 0.3
    full_share: float = 0.2
    full_work: float = 10 * MILLION
    # The full-order design may be so much worse than the best one: it is calmer then, and easier to reduce.
    full_hinf_rel: float = 1.05
    full_h2_rel: float = 1.0005
    # First and last pole of the states beside a static gain, in units of the plant's rate (discrete: in the z-plane).
    poles: tuple[float, float] = (0.3, 3.0)
    discrete_poles: tuple[float, float] = (0.2, 0.8)

    # --- goals
    # Factor of hard goals in the search, so that they hold after it; most rounds, and the gain that is worth another.
    harder: float = 1 + 1e-5
    goal_rounds: int = 12
    # Share of the work for the first search, from many starts.
    goal_start: float = 0.6
    # Weights of the soft goals, in turn, until the hard ones are met.
    goal_shares: tuple[float, ...] = (0.5, 0.2, 0.05, 0.01, 0.0)
    goal_progress: float = 1e-3

    # --- the worst member of a set
    # Most scenarios.
    rounds: int = 12
    # Worst-case gain over the scenarios' gain at which the scenarios count as enough. Smaller: more rounds.
    enough: float = 1.01
    # Shares of the work that remains: for one design, and for one search for the worst member with its proof.
    design_share: float = 0.5
    search_share: float = 0.3


TUNING = FixedTuning()
