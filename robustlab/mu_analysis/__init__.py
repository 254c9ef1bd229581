"""Structured singular value: bounds for matrices, and margins and worst gains proved over the whole frequency axis."""

from importlib import import_module
from typing import Any

from robustlab.mu_analysis.axis.margin import Margin, WorstCaseGain
from robustlab.mu_analysis.axis.robustness import robust_performance, robust_stability, worst_case_gain
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

_MORE = {  # loaded on first use
    "replay": "axis.margin", "COVER_FORMS": "margins.cover",
    "gain_and_phase": "margins.disk_margin", "delta_norm": "matrix.certificate",
    "proves": "matrix.certificate", "smallest_step": "matrix.lower",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    if name in _MORE:
        return getattr(import_module(f"robustlab.mu_analysis.{_MORE[name]}"), name)
    raise AttributeError(f"module 'robustlab.mu_analysis' has no attribute {name!r}")
