"""Integral quadratic constraints: worst-case gain and stability with nonlinear, time-varying and uncertain blocks.

nature          what a block is: a parameter that varies, a memoryless nonlinearity
filtered_model  a model and the filters of its multipliers as one
multipliers     the constraints of every class, with their unknowns
inequality      the linear matrix inequality: solved, and proved without the solver
problem         a set with natures: its middles, its members, its inequalities
analysis        worst-case gain and stability margin
"""

from robustlab.iqc.analysis import IqcGain, IqcStability, iqc_gain, iqc_stability
from robustlab.iqc.nature import Nature, Nonlinearity, Varying
from robustlab.iqc.problem import IqcProof

__all__ = [
    "IqcGain",
    "IqcProof",
    "IqcStability",
    "Nature",
    "Nonlinearity",
    "Varying",
    "iqc_gain",
    "iqc_stability",
]
