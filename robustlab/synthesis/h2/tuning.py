"""Numbers that choose speed and accuracy, at their measured defaults; what is returned is proved whatever they are."""

from __future__ import annotations

from dataclasses import dataclass

from robustlab.budget import MILLION
from robustlab.shown import Tuning

__all__ = ["TUNING", "H2Tuning"]


@dataclass(frozen=True)
class H2Tuning(Tuning):
    """H2 designs, and H2 designs under an H-infinity bound."""

    # Work of a design at effort 1.
    work: float = 60 * MILLION
    # Sizes of added penalties and noises, scaled. Longer: singular plants get closer to their infimum, K faster.
    ladder: tuple[float, ...] = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
    # Singular values of D12 or D21, scaled, above which that side needs no help. Smaller: digits are lost.
    regular: float = 1e-6
    # The regularised optimum falls with the regularisation; two steps that gain less than this end the ladder.
    settled: float = 1e-4
    # Controllers, best first, that the second voice is asked about. More: fewer unconfirmed results, slower.
    heard: int = 6
    # Largest residual of a Riccati solution: those of singular plants lose digits; the rebuilt loop decides.
    residual: float = 1e-3

    # --- under an H-infinity bound
    # Loss of the H2 designs where they have to be kept finite.
    kept_finite: float = 1.0005
    # Levels of the H-infinity inequality in shares of the bound: above 1, because the common Lyapunov matrix makes it
    # conservative; below 1, because the solver may miss its level by a little. Longer: wider searches.
    levels: tuple[float, ...] = (1.0, 1.3, 1.7, 2.5, 4.0, 8.0)
    lower_levels: tuple[float, ...] = (0.995, 0.97, 0.9)
    # Steps of bisection between two levels. More: closer to the bound.
    refinements: int = 5
    # Factors by which the split of the level between w and z is moved, as long as the H2 norm falls by this much.
    split_factors: tuple[float, ...] = (3.0, 1 / 3)
    split_gain: float = 0.01
    # The bound over the smallest H-infinity norm from which on a softer design is looked for, too.
    room: float = 1.02
    # Powers of the fourth root of ten, first and last, of the H-infinity channel's weight in H2 designs.
    weight_steps: tuple[int, int] = (-4, 12)
    # Most steps of the conic solver, and the weight on the size of X and Y, which keeps K finite where the infimum is
    # not attained. A larger one: calmer controllers, a larger norm.
    lyapunov_steps: int = 200
    lyapunov_size: float = 1e-7


TUNING = H2Tuning()
