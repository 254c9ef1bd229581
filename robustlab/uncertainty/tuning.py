"""What the searches of this wing cost and how far they go; results hold whatever these are, they are only wider."""

from __future__ import annotations

from dataclasses import dataclass

from robustlab.shown import Tuning


@dataclass(frozen=True)
class UncertaintyTuning(Tuning):
    """Numbers that choose between speed and sharpness; more work at larger counts and smaller steps."""

    # --- well_posedness
    # Boxes that a proof may cut the real ranges into: fewer leave more questions open.
    boxes: int = 2000
    # Vertices of the real ranges on whose rays a singular Delta is looked for; beyond it so many random ones.
    vertices: int = 1024
    # Random complex Deltas that are turned and aligned for the same purpose.
    random_deltas: int = 60

    # --- parametric
    # Boxes and vertices in which a zero of a denominator is looked for: fewer refuse more ranges that are good.
    denominator_boxes: int = 4000
    denominator_vertices: int = 4096
    # So many of the smallest decompositions are assembled and reduced; the smallest result is taken.
    decompositions: int = 3
    # Orders of the variables in which a decomposition is tried: more find smaller LFTs, in as many times the work.
    variable_orders: int = 24

    # --- overbound
    # Bisection on log(gamma) ends here; far below the tolerances that weights are asked for.
    weight_level: float = 1e-3
    # Rounds in which the points where the weight came out below the bound are added to the programme.
    weight_rounds: int = 8
    # The grid on which a weight is judged has so many points for one of the fit's: fewer miss peaks between them.
    finer_grid: int = 10
    # Bisections with new bases.
    weight_restarts: int = 4
    # The smallest D, relative to its scale: keeps poles off the imaginary axis; larger ones cost sharpness.
    least_denominator: float = 1e-6
    # Ratio of neighbouring q of a basis, at least: closer ones are hardly independent.
    basis_ratio: float = 2.0
    # Shifts of the ratio among which the one that alternates best is taken, as proof of the least excess.
    alternation_centres: int = 101

    # --- covering
    # The bound is taken as hypot(bound, this share of its largest value): a weight needs a positive one.
    bound_floor: float = 1e-4
    # Points of a frequency grid between its ends and around resonances.
    grid_points: int = 150
    # Points of a circle on which Laurent coefficients around a pole are taken.
    circle_points: int = 64
    # Relative distance from the optimum at which Khachiyan's algorithm stops, and its steps at most; the box is fitted
    # to the cloud anyway, so that larger ones only turn it a little.
    ellipsoid_excess: float = 1e-2
    ellipsoid_steps: int = 2000

    # --- distances
    # Relative width of the bracket of the gap.
    gap_rtol: float = 1e-8


TUNING = UncertaintyTuning()
