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
    "ss": "realisations",
    "tf": "realisations",
    "zpk": "realisations",
    "descriptor": "dynamics.descriptor_elimination",
    "Record": "record",
    "load": "storage.interchange",
    "save": "storage.interchange",
    "export_controller": "storage.controller_export",
    # delays
    "DelayedModel": "delays.model",
    "delay": "delays.model",
    "with_delays": "delays.model",
    # plants from physics
    "plant": "dynamics",
    "PlantEquations": "dynamics.symbolic.equations",
    "trim": "dynamics",
    "linearise": "dynamics",
    "simulate": "dynamics",
    "with_effects": "dynamics.extended.extended_plant",
    # uncertainty
    "RealScalar": "uncertainty.blocks",
    "ComplexScalar": "uncertainty.blocks",
    "FullBlock": "uncertainty.blocks",
    "ParameterRange": "uncertainty.blocks",
    "UncertainModel": "uncertainty.lft",
    "elementwise": "uncertainty.elementwise",
    "parametric": "uncertainty.parametric",
    "UncertainFrequencyData": "uncertainty.frequency_responses",
    "frequency_data": "uncertainty.frequency_responses",
    "star": "uncertainty.lft",
    "connect": "uncertainty.named_wiring",
    "unstructured": "uncertainty.unstructured",
    "cover": "mu_analysis.margins.cover",
    "overbound": "uncertainty.covers",
    # analysis
    "peak_gain": "analysis.gains_and_margins",
    "sample": "worst_case_analysis",
    "worst_case": "worst_case_analysis",
    "violation_probability": "worst_case_analysis",
    "mu": "mu_analysis",
    "robust_stability": "analysis.gains_and_margins",
    "disk_margin": "analysis.gains_and_margins",
    "classical_margins": "analysis.gains_and_margins",
    "robust_performance": "mu_analysis",
    "robust_gain": "analysis.performance",
    "gap": "analysis.designs",
    "nu_gap": "uncertainty.distances",
    "coprime_margin": "uncertainty.distances",
    "h2_norm": "norms",
    "zeros": "linear_analysis.zeros",
    "controllability": "linear_analysis.structural",
    "observability": "linear_analysis.structural",
    "frequency_response": "linear_analysis.frequency",
    # nonlinear and time-varying blocks
    "Varying": "iqc.block_types",
    "Nonlinearity": "iqc.block_types",
    # synthesis
    "hinf": "analysis.designs",
    "h2": "synthesis.h2",
    "loop_functions": "synthesis.specifications.loop_functions",
    "mixsyn": "synthesis.hinf.loop_shaping",
    "ncf": "synthesis.hinf.loop_shaping",
    "dk": "synthesis.dk.dk_iteration",
    "fixed_structure": "synthesis.fixed_structure",
    "tune": "synthesis.goal_tuning",
    "generalized_plant": "synthesis.problem.partition",
    "performance_weight": "synthesis.specifications.weight_design",
    "control_weight": "synthesis.specifications.weight_design",
    "complementary_weight": "synthesis.specifications.weight_design",
    "makeweight": "synthesis.specifications.weight_design",
    "Controller": "synthesis.problem.controller",
    # gain scheduling
    "LPVModel": "synthesis.scheduling.parameter_varying",
    "lpv_model": "synthesis.scheduling.parameter_varying",
    # reduction and discretisation
    "reduce_model": "synthesis.reduction.model_reduction",
    "minimal": "synthesis.reduction.model_reduction",
    "reduce_controller": "synthesis.reduction.controller_reduction",
    "discretise": "synthesis.discretisation",
    "d2c": "synthesis.discretisation",
    "sampled_data_norm": "synthesis.sampled_norm",
    # measurements
    "compare": "identification.comparison.comparison",
    "discover": "identification.missing_effects.discovery",
    "watch": "identification.monitoring",
    "data_cover": "identification.validation.data_cover",
    "uncertain_from": "identification.missing_effects.updated_plant",
    "validate": "identification.validation",
    "FrequencyData": "identification.validation",
    # trust
    "verify": "evidence.verification",
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
    if name.startswith("_"):  # asked for by Python itself
        raise AttributeError(f"module 'robustlab' has no attribute {name!r}")
    from robustlab.name_hints import unknown_public_name

    raise AttributeError(unknown_public_name(name, _PUBLIC))


def __dir__() -> list[str]:
    return sorted([*_PUBLIC, "__version__"])
