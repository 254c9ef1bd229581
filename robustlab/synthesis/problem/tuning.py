"""Numbers that choose speed and accuracy, at their measured defaults; what is returned is proved whatever they are."""

from __future__ import annotations

import math
from dataclasses import dataclass

from robustlab.budget import MILLION
from robustlab.shown import Tuning


@dataclass(frozen=True)
class ProblemTuning(Tuning):
    """Checks of a finished loop, and bounds of what any loop can do."""

    # --- the second voice: P and K evaluated separately
    # A value whose error bound exceeds this share of the largest gain (of its own size; of the polynomial) is computed
    # once more with 30 digits. Smaller: more of them, slower.
    quick: float = 1e-6
    quick_everywhere: float = 1e-5
    quick_rouche: float = 2e-2
    # Error up to which the rebuilt loop's polynomial is taken from its modes.
    modes: float = 1e-6
    # Frequencies per decade between the poles, and most of them.
    per_decade: int = 5
    most_points: int = 120
    # Zooms into the highest local maxima: how often, how many maxima, points in each, least height of one.
    zooms: int = 2
    zoom_peaks: int = 3
    zoom_points: int = 7
    peak_share: float = 0.9
    # Frequencies that hit a pole move by this share of the distance to the loop's poles, which T cannot feel.
    aside: float = 1e-6
    # Work with many digits that one check may do, in points times states cubed.
    careful_work: float = 2e6
    # Numbers of a stack that is kept in memory.
    chunk: int = 4_000_000

    # --- the H2 norm by quadrature
    # From so many states of the loop on the rebuilt loop's response is compared in its place.
    many_states: int = 30
    # Difference of the two rules in a panel (share of the whole) that ends it, most points.
    panel_change: float = 1e-6
    most_nodes: int = 20_000

    # --- lower bounds of gamma
    # Points of the right half plane: radii and angles of a polar grid. More: a little higher bounds.
    radii: int = 48
    angles: tuple[float, ...] = (0.0, 0.5, 1.0, 1.35, 1.5, math.pi / 2)
    # Refinements around the best points, how many of them, and points that every scaling has to confirm.
    refinements: int = 4
    refined: int = 3
    confirmed: int = 12

    # --- measures of loops
    # Points of the grid on which candidates are compared before one of them is proved.
    measure_grid: int = 60
    # Most work of the proof of one candidate without scalings.
    margin_work: float = 30 * MILLION


TUNING = ProblemTuning()
