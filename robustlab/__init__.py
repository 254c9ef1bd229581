"""robustlab: a robust-control workbench. ``import robustlab as rl``; every public name is loaded on first use.

The table below is the whole public interface.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the same table for type checkers and editors, which do not run __getattr__
    from robustlab.dynamics import linearise as linearise
    from robustlab.dynamics import plant as plant
    from robustlab.dynamics import simulate as simulate
    from robustlab.dynamics.effects.attached_effect import effect_names as effect_names
    from robustlab.dynamics.effects.extended_plant import with_effects as with_effects
    from robustlab.errors import InputError as InputError
    from robustlab.errors import NoTrustworthyNumber as NoTrustworthyNumber
    from robustlab.errors import RobustlabError as RobustlabError
    from robustlab.frequency import frequency_response as frequency_response
    from robustlab.identification import compare as compare
    from robustlab.identification.discovery import discover as discover
    from robustlab.identification.remaining_uncertainty import uncertain_from as uncertain_from
    from robustlab.identification.validation import FrequencyData as FrequencyData
    from robustlab.identification.validation import validate as validate
    from robustlab.mu_analysis import mu as mu
    from robustlab.mu_analysis import robust_performance as robust_performance
    from robustlab.mu_analysis import robust_stability as robust_stability
    from robustlab.mu_analysis import skew_mu as skew_mu
    from robustlab.mu_analysis import worst_case_gain as worst_case_gain
    from robustlab.mu_analysis.cover import conservatism as conservatism
    from robustlab.mu_analysis.cover import cover as cover
    from robustlab.mu_analysis.disk_margin import disk_margin as disk_margin
    from robustlab.mu_analysis.small_gain import small_gain as small_gain
    from robustlab.mu_analysis.worst_case_disk_margin import worst_case_disk_margin as worst_case_disk_margin
    from robustlab.norms import hinf_norm as hinf_norm
    from robustlab.record import Record as Record
    from robustlab.result import Status as Status
    from robustlab.statespace import Signal as Signal
    from robustlab.statespace import StateSpaceModel as StateSpaceModel
    from robustlab.storage import load as load
    from robustlab.storage import save as save
    from robustlab.storage.controller_export import export_controller as export_controller
    from robustlab.structural import controllability as controllability
    from robustlab.structural import observability as observability
    from robustlab.synthesis import Controller as Controller
    from robustlab.synthesis import check_weights as check_weights
    from robustlab.synthesis import complementary_weight as complementary_weight
    from robustlab.synthesis import control_weight as control_weight
    from robustlab.synthesis import design_weights as design_weights
    from robustlab.synthesis import dk as dk
    from robustlab.synthesis import fixed_structure as fixed_structure
    from robustlab.synthesis import generalized_plant as generalized_plant
    from robustlab.synthesis import h2 as h2
    from robustlab.synthesis import h2_hinf as h2_hinf
    from robustlab.synthesis import hinf as hinf
    from robustlab.synthesis import loop_functions as loop_functions
    from robustlab.synthesis import loop_functions_of as loop_functions_of
    from robustlab.synthesis import lqg as lqg
    from robustlab.synthesis import lqr as lqr
    from robustlab.synthesis import makeweight as makeweight
    from robustlab.synthesis import mixsyn as mixsyn
    from robustlab.synthesis import ncf as ncf
    from robustlab.synthesis import noise_weight as noise_weight
    from robustlab.synthesis import performance_limits as performance_limits
    from robustlab.synthesis import performance_weight as performance_weight
    from robustlab.synthesis import place as place
    from robustlab.synthesis.controller_reduction import reduce_controller as reduce_controller
    from robustlab.synthesis.discretisation import discretise as discretise
    from robustlab.synthesis.model_reduction import balanced_truncation as balanced_truncation
    from robustlab.synthesis.model_reduction import hankel_singular_values as hankel_singular_values
    from robustlab.synthesis.model_reduction import reduce_model as reduce_model
    from robustlab.synthesis.sampled_controller import discretise_controller as discretise_controller
    from robustlab.synthesis.sampled_data import sampled_data_norm as sampled_data_norm
    from robustlab.synthesis.sampled_robustness import sampled_robustness as sampled_robustness
    from robustlab.uncertainty.algebra import beside as beside
    from robustlab.uncertainty.algebra import stacked as stacked
    from robustlab.uncertainty.algebra import star as star
    from robustlab.uncertainty.blocks import ComplexScalar as ComplexScalar
    from robustlab.uncertainty.blocks import FullBlock as FullBlock
    from robustlab.uncertainty.blocks import ParameterRange as ParameterRange
    from robustlab.uncertainty.blocks import RealScalar as RealScalar
    from robustlab.uncertainty.centring import centred as centred
    from robustlab.uncertainty.coprime import coprime_margin as coprime_margin
    from robustlab.uncertainty.elementwise import by_cause as by_cause
    from robustlab.uncertainty.elementwise import elementwise as elementwise
    from robustlab.uncertainty.gap_metric import gap as gap
    from robustlab.uncertainty.gap_metric import nu_gap as nu_gap
    from robustlab.uncertainty.lft import UncertainModel as UncertainModel
    from robustlab.uncertainty.overbound import overbound as overbound
    from robustlab.uncertainty.parametric import parametric as parametric
    from robustlab.uncertainty.realised_delta import perturbed_model as perturbed_model
    from robustlab.uncertainty.realised_delta import realise_delta as realise_delta
    from robustlab.uncertainty.structured_reduction import reduction as reduction
    from robustlab.uncertainty.unstructured import unstructured as unstructured
    from robustlab.uncertainty.well_posedness import well_posedness as well_posedness
    from robustlab.worst_case_analysis import sample as sample
    from robustlab.worst_case_analysis import sample_size as sample_size
    from robustlab.worst_case_analysis import violation_probability as violation_probability
    from robustlab.worst_case_analysis import worst_case as worst_case

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
