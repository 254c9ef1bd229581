"""Numbers that choose how long the analysis and design of sampled loops take and how close they come, in one place."""

from __future__ import annotations

from dataclasses import dataclass

from robustlab.budget import MILLION
from robustlab.shown import Tuning


@dataclass(frozen=True)
class SampledTuning(Tuning):
    """Tuning of digital controllers and sampled loops; no number here decides whether a bound holds, only how tight."""

    # --- exact maps over an interval (lifting); read from TUNING alone ---
    short: float = 1e-3  # doubling starts where |A| h is below this; smaller: more doublings
    doublings: int = 12  # at least so many: the error of the start falls by 4 in each
    # --- the norm (sampled_norm) ---
    intervals: tuple[int, ...] = (2, 4, 8, 16, 32, 64)  # of a period, one after the other until the bracket is closed
    most_lifted: int = 256  # lifted disturbance or performance channels at most: norms cost their cube
    # --- digital controllers (sampled_controller) ---
    controller_work: float = 60 * MILLION  # the usual work at effort 1
    design_intervals: int = 4  # of a period, on which the direct design sees disturbance and performance
    design_gamma_rel: float = 1.02  # allowed ratio of its gamma to the smallest: larger: slower poles
    most_design: int = 48  # lifted channels of the direct design at most


TUNING = SampledTuning()
