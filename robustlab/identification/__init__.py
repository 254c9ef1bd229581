"""Measurement against model: how large the gap is, what is missing, what remains, whether a set explains a record."""

from __future__ import annotations

from importlib import import_module
from typing import Any

# What other rooms ask for, beside the functions that `robustlab` itself hands out; name -> module.
_WORDS = {
    "compare": "comparison.comparison",
    "Comparison": "comparison.comparison_result",
    "OutputGap": "comparison.comparison_result",
    "cover": "comparison.envelope",
    "discover": "naming.discovery",
    "Discovery": "naming.discovery_result",
    "LeftOver": "naming.residual_force",
    "moving_samples": "naming.residual_force",
    "remaining_lines": "naming.residual_force",
    "residual_curves": "naming.residual_force",
    "EffectValue": "naming.discovery_parts",
    "Gap": "naming.discovery_parts",
    "InputClock": "naming.discovery_parts",
    "NamedEffect": "naming.discovery_parts",
    "NominalValue": "naming.discovery_parts",
    "Rival": "naming.discovery_parts",
    "SearchEntry": "naming.discovery_parts",
    "SetProbability": "naming.discovery_parts",
    "ForceCurve": "naming.residual_force",
    "ResidualForce": "naming.residual_force",
    "prepare": "hypotheses.prepared_record",
    "ports_of": "hypotheses.prepared_record",
    "window_length": "hypotheses.prepared_record",
    "smooth_disturbance": "hypotheses.disturbance_smoother",
    "smooth_motion": "hypotheses.motion_smoother",
    "candidates": "hypotheses.candidates",
    "catalogue": "hypotheses.candidates",
    "nuisance_parameters": "hypotheses.candidates",
    "stated_tolerances": "hypotheses.candidates",
    "with_absolute_tolerances": "hypotheses.candidates",
    "spatial_orders": "hypotheses.candidates",
    "timed_lines": "hypotheses.candidates",
    "Problem": "hypotheses.effect_fit",
    "Hypothesis": "hypotheses.effect_fit",
    "FitPlan": "hypotheses.effect_fit",
    "refit_distance": "hypotheses.effect_fit",
    "Simulator": "hypotheses.effect_fit",
    "Windows": "hypotheses.effect_fit",
    "NoiseModel": "hypotheses.effect_fit",
    "first_noise": "hypotheses.noise",
    "held_out_fit": "hypotheses.noise",
    "predictive": "hypotheses.noise",
    "FittedWindows": "hypotheses.random_force",
    "ForceResponse": "hypotheses.random_force",
    "PortMotion": "hypotheses.random_force",
    "force_response": "hypotheses.random_force",
    "plain_places": "hypotheses.random_force",
    "Family": "hypotheses.unnamed_force",
    "fitted_windows": "hypotheses.unnamed_force",
    "judged": "hypotheses.unnamed_force",
    "unnamed_force": "hypotheses.unnamed_force",
    "watch": "monitoring.watch",
    "Watch": "monitoring.watch",
    "check_record": "record_check.suitability",
    "suitability": "record_check.suitability",
    "join_clocks": "record_check.resampling",
    "validate": "validation.model_validation",
    "Validation": "validation.validation_result",
}

__all__ = list(_WORDS)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name in _WORDS:
        return getattr(import_module(f"robustlab.identification.{_WORDS[name]}"), name)
    raise AttributeError(f"module 'robustlab.identification' has no attribute {name!r}")
