"""Structured singular value: bounds for matrices, and robust stability over the whole frequency axis."""

from robustlab.mu_analysis.bounds import MuBounds, mu
from robustlab.mu_analysis.margin import Margin
from robustlab.mu_analysis.stability import robust_stability

__all__ = ["Margin", "MuBounds", "mu", "robust_stability"]
