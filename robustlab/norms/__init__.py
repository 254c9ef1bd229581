"""System norms: H-infinity as a proved bracket, H2 by both Gramians; and the bilinear map, which keeps the first."""

from robustlab.norms.bilinear_map import bilinear_to_continuous, bilinear_to_discrete
from robustlab.norms.hinfinity import QUIET, HinfNorm, gain_rounding, hinf_norm, norm_as_given
from robustlab.norms.impulse_energy import H2Norm, h2_norm

__all__ = [
    "QUIET",
    "H2Norm",
    "HinfNorm",
    "bilinear_to_continuous",
    "bilinear_to_discrete",
    "gain_rounding",
    "h2_norm",
    "hinf_norm",
    "norm_as_given",
]
