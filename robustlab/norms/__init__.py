"""System norms with their evidence, and the bilinear map, which keeps the H-infinity norm."""

from robustlab.norms.bilinear_map import bilinear_to_continuous, bilinear_to_discrete
from robustlab.norms.claims import loop_numbers, model_numbers
from robustlab.norms.h2 import H2Norm, h2_by_channels, h2_by_gramians, h2_norm
from robustlab.norms.hinfinity import (
    QUIET,
    HinfNorm,
    PeakGain,
    balancing_units,
    gain_rounding,
    hinf_norm,
    linf_norm,
    unstable_norm,
    well_scaled,
)

__all__ = [
    "QUIET", "H2Norm", "HinfNorm", "PeakGain", "balancing_units", "bilinear_to_continuous", "bilinear_to_discrete",
    "gain_rounding", "h2_by_channels", "h2_by_gramians", "h2_norm", "hinf_norm", "linf_norm", "loop_numbers",
    "model_numbers", "unstable_norm", "well_scaled",
]  # fmt: skip
