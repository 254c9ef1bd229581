"""Structured singular value: bounds for matrices, and robust stability over the whole frequency axis."""

from robustlab.mu_analysis.bounds import MuBounds, mu

__all__ = ["MuBounds", "mu"]
