"""Numbers that choose how long the analysis and design of sampled loops take and how close they come, in one place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustlab.budget import MILLION
from robustlab.shown import Tuning


@dataclass(frozen=True)
class SampledTuning(Tuning):
    """Tuning of digital controllers and sampled loops; no number here decides whether a bound holds, only how tight."""

    # --- exact maps over an interval (lifting, held_intervals); read from TUNING alone ---
    short: float = 1e-3  # doubling starts where |A| h is below this; smaller: more doublings
    doublings: int = 12  # at least so many: the error of the start falls by 4 in each
    nodes: int = 12  # Gauss nodes of a panel
    node_reach: float = 2.0  # largest |eigenvalue| times the length of a panel; smaller: more panels
    gone: float = 40.0  # modes that have decayed by e^-gone count no more for it
    most_panels: int = 4096  # beyond it a mode is refused as too fast
    room: float = 0.05  # share left for what drives the rests where their gains on each other are large
    # --- the norm (sampled_norm) ---
    intervals: tuple[int, ...] = (2, 4, 8, 16, 32, 64)  # of a period, one after the other until the bracket is closed
    most_lifted: int = 256  # lifted disturbance or performance channels at most: norms cost their cube
    # --- robustness (sampled_robustness) ---
    robustness_work: float = 60 * MILLION  # the usual work at effort 1
    aim_share: float = 0.3  # of the work left: for the search of a critical Delta
    proof_share: float = 0.7  # of the work left: for a proof
    degrees: tuple[int, ...] = (1, 2, 3, 4, 5)  # of the polynomials, tried in this order
    loose: float = 0.05  # how loose the cover may be (times the size of Delta) for a degree to be worth a try
    most_delta: int = 48  # channels of Delta in a loop that is tried: beyond it a single frequency takes minutes
    proof: float = 1e-3  # accuracy of the proofs
    search: float = 1e-2  # accuracy of the search for a critical Delta
    member: float = 1e-2  # accuracy of the norm of a member
    sizes: int = 6  # sizes of the worst direction that are tried for the member that attains most
    settled: float = 1e-3  # relative change of a size that ends a search
    # Multiples of a critical Delta at which its member is tried for instability.
    multiples: tuple[float, ...] = (1.0, 1.001, *np.geomspace(1.01, 300.0, 24))
    largest: float = 1e6  # margins beyond this, or below its inverse, are none to prepare for
    # --- digital controllers (sampled_controller) ---
    controller_work: float = 60 * MILLION  # the usual work at effort 1
    design_intervals: int = 4  # of a period, on which the direct design sees disturbance and performance
    design_gamma_rel: float = 1.02  # allowed ratio of its gamma to the smallest: larger: slower poles
    most_design: int = 48  # lifted channels of the direct design at most


TUNING = SampledTuning()
