"""Structured singular value: bounds for matrices, and margins and worst gains proved over the whole frequency axis."""

from robustlab.mu_analysis.bounds import MuBounds, mu
from robustlab.mu_analysis.margin import Margin
from robustlab.mu_analysis.skew import skew_mu
from robustlab.mu_analysis.stability import robust_stability
from robustlab.mu_analysis.worst_gain import WorstCaseGain, robust_performance, worst_case_gain

__all__ = [
    "Margin",
    "MuBounds",
    "WorstCaseGain",
    "mu",
    "robust_performance",
    "robust_stability",
    "skew_mu",
    "worst_case_gain",
]
