"""robustlab: a robust-control workbench. ``import robustlab as rl``; every public name is loaded on first use.

The table below is the whole public interface. Type checkers and editors, which do not run ``__getattr__``, read it in
``__init__.pyi``, which ``python benchmarks/stub.py`` writes from this table.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_PUBLIC = {
    # models
    "StateSpaceModel": "statespace",
    "Signal": "statespace",
    "Record": "record",
    "load": "storage",
    "save": "storage",
    "export_controller": "storage.controller_export",
    # plants from physics
    "plant": "dynamics",
    "trim": "dynamics",
    "linearise": "dynamics",
    "simulate": "dynamics",
    "with_effects": "dynamics.effects.extended_plant",
    "effect_names": "dynamics.effects.attached_effect",
    # uncertainty
    "RealScalar": "uncertainty.blocks",
    "ComplexScalar": "uncertainty.blocks",
    "FullBlock": "uncertainty.blocks",
    "ParameterRange": "uncertainty.blocks",
    "UncertainModel": "uncertainty.lft",
    "elementwise": "uncertainty.elementwise",
    "by_cause": "uncertainty.elementwise",
    "parametric": "uncertainty.parametric",
    "centred": "uncertainty.centring",
    "reduction": "uncertainty.structured_reduction",
    "well_posedness": "uncertainty.well_posedness",
    "star": "uncertainty.algebra",
    "beside": "uncertainty.algebra",
    "stacked": "uncertainty.algebra",
    "unstructured": "uncertainty.unstructured",
    "cover": "mu_analysis.cover",
    "conservatism": "mu_analysis.cover",
    "overbound": "uncertainty.overbound",
    "realise_delta": "uncertainty.realised_delta",
    "perturbed_model": "uncertainty.realised_delta",
    # analysis
    "sample": "worst_case_analysis",
    "worst_case": "worst_case_analysis",
    "violation_probability": "worst_case_analysis",
    "sample_size": "worst_case_analysis",
    "mu": "mu_analysis",
    "skew_mu": "mu_analysis",
    "robust_stability": "mu_analysis",
    "robust_performance": "mu_analysis",
    "worst_case_gain": "mu_analysis",
    "small_gain": "mu_analysis.small_gain",
    "disk_margin": "mu_analysis.disk_margin",
    "worst_case_disk_margin": "mu_analysis.worst_case_disk_margin",
    "gap": "uncertainty.gap_metric",
    "nu_gap": "uncertainty.gap_metric",
    "coprime_margin": "uncertainty.coprime",
    "hinf_norm": "norms",
    "controllability": "structural",
    "observability": "structural",
    "frequency_response": "frequency",
    # synthesis
    "hinf": "synthesis",
    "h2": "synthesis",
    "h2_hinf": "synthesis",
    "loop_functions": "synthesis",
    "loop_functions_of": "synthesis",
    "lqr": "synthesis",
    "lqg": "synthesis",
    "place": "synthesis",
    "mixsyn": "synthesis",
    "ncf": "synthesis",
    "dk": "synthesis",
    "fixed_structure": "synthesis",
    "generalized_plant": "synthesis",
    "performance_limits": "synthesis",
    "performance_weight": "synthesis",
    "control_weight": "synthesis",
    "complementary_weight": "synthesis",
    "design_weights": "synthesis",
    "check_weights": "synthesis",
    "makeweight": "synthesis",
    "noise_weight": "synthesis",
    "Controller": "synthesis",
    # reduction and discretisation
    "hankel_singular_values": "synthesis.model_reduction",
    "balanced_truncation": "synthesis.model_reduction",
    "reduce_model": "synthesis.model_reduction",
    "reduce_controller": "synthesis.controller_reduction",
    "discretise": "synthesis.discretisation",
    "discretise_controller": "synthesis.sampled_controller",
    "sampled_data_norm": "synthesis.sampled_data",
    "sampled_robustness": "synthesis.sampled_robustness",
    # measurements
    "compare": "identification",
    "discover": "identification.discovery",
    "DataCover": "identification.data_cover",
    "data_cover": "identification.data_cover",
    "uncertain_from": "identification.remaining_uncertainty",
    "validate": "identification.validation",
    "FrequencyData": "identification.validation",
    # trust
    "Status": "result",
    "RobustlabError": "errors",
    "InputError": "errors",
    "NoTrustworthyNumber": "errors",
}

__all__ = list(_PUBLIC)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from robustlab.provenance import robustlab_version

        return robustlab_version()
    if name in _PUBLIC:
        return getattr(import_module(f"robustlab.{_PUBLIC[name]}"), name)
    raise AttributeError(f"module 'robustlab' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*_PUBLIC, "__version__"])
