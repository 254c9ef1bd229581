"""Structured singular value: bounds for matrices, and margins and worst gains proved over the whole frequency axis."""

from robustlab.mu_analysis.axis.margin import Margin
from robustlab.mu_analysis.axis.stability import robust_stability
from robustlab.mu_analysis.axis.worst_gain import WorstCaseGain, robust_performance, worst_case_gain
from robustlab.mu_analysis.matrix.bounds import MuBounds, mu

__all__ = [
    "Margin",
    "MuBounds",
    "WorstCaseGain",
    "mu",
    "robust_performance",
    "robust_stability",
    "worst_case_gain",
]
