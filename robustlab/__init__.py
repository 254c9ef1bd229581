"""robustlab: a robust-control workbench. ``import robustlab as rl``; every public name is loaded on first use.

The table below is the whole public interface. Type checkers and editors, which do not run ``__getattr__``, read it in
``__init__.pyi``, which ``python benchmarks/stub.py`` writes from this table.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_GROUPS = {  # heading of the reference page -> module -> its public names
    "models": {
        "statespace": "StateSpaceModel Signal",
        "conversion": "ss tf zpk",
        "dynamics.descriptor_elimination": "descriptor",
        "record": "Record",
        "storage.interchange": "load save",
        "storage.controller_export": "export_controller",
    },
    "delays": {"delays.model": "DelayedModel delay with_delays"},
    "plants from physics": {
        "dynamics": "plant trim linearise simulate",
        "dynamics.symbolic.equations": "PlantEquations",
        "dynamics.extended.extended_plant": "with_effects",
    },
    "uncertainty": {
        "uncertainty.blocks": "RealScalar ComplexScalar FullBlock ParameterRange",
        "uncertainty.lft": "UncertainModel lft",
        "uncertainty.elementwise": "elementwise",
        "uncertainty.parametric": "parametric",
        "uncertainty.frequency_responses": "UncertainFrequencyData frequency_data",
        "uncertainty.connection": "connect",
        "uncertainty.unstructured": "unstructured",
        "mu_analysis.margins.uncertainty_cover": "cover",
        "uncertainty.covers": "overbound",
    },
    "analysis": {
        "analysis.gains_and_margins": "peak_gain robust_stability disk_margin classical_margins",
        "worst_case_analysis": "sample worst_case violation_probability",
        "mu_analysis.matrix.bounds": "mu",
        "mu_analysis.axis.robustness": "robust_performance",
        "analysis.performance": "robust_gain",
        "analysis.hinf_and_gap": "gap",
        "uncertainty.gap_metric": "nu_gap coprime_margin",
        "norms": "h2_norm",
        "linear_analysis.zeros": "zeros",
        "linear_analysis.structural": "controllability observability",
        "linear_analysis.frequency": "frequency_response",
    },
    "nonlinear and time-varying blocks": {"iqc.block_types": "Varying Nonlinearity"},
    "synthesis": {
        "analysis.hinf_and_gap": "hinf",
        "synthesis.h2": "h2",
        "synthesis.specifications.loop_functions": "loop_functions",
        "synthesis.hinf.loop_shaping": "mixsyn ncf",
        "synthesis.dk.dk_iteration": "dk",
        "synthesis.fixed_structure": "fixed_structure",
        "synthesis.goal_tuning": "tune",
        "synthesis.problem.generalized_plant": "generalized_plant",
        "synthesis.specifications.weight_design": "performance_weight control_weight complementary_weight makeweight",
        "synthesis.problem.controller": "Controller",
    },
    "gain scheduling": {"synthesis.scheduling.parameter_varying": "LPVModel lpv_model"},
    "reduction and discretisation": {
        "synthesis.reduction.model_reduction": "reduce_model minimal",
        "synthesis.reduction.controller_reduction": "reduce_controller",
        "synthesis.discretisation": "discretise d2c",
        "synthesis.sampled_norm": "sampled_data_norm",
    },
    "measurements": {
        "identification.comparison.comparison": "compare",
        "identification.missing_effects.discovery": "discover",
        "identification.monitoring": "watch",
        "identification.validation.model_validation": "data_cover",
        "identification.missing_effects.updated_plant": "uncertain_from",
        "identification.validation": "validate FrequencyData",
    },
    "trust": {
        "evidence.verification": "verify",
        "result": "Status",
        "errors": "RobustlabError InputError NoTrustworthyNumber",
    },
}
_PUBLIC = {name: module for group in _GROUPS.values() for module, names in group.items() for name in names.split()}

__all__ = list(_PUBLIC)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from robustlab.provenance import robustlab_version

        return robustlab_version()
    if name in _PUBLIC:
        return getattr(import_module(f"robustlab.{_PUBLIC[name]}"), name)
    if name.startswith("_"):  # requested by Python itself
        raise AttributeError(f"module 'robustlab' has no attribute {name!r}")
    from robustlab.public_names import unknown_public_name

    raise AttributeError(unknown_public_name(name, _PUBLIC))


def __dir__() -> list[str]:
    return sorted([*_PUBLIC, "__version__"])
