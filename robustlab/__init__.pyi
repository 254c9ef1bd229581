# Written by benchmarks/stub.py from the table in __init__.py; do not edit.
from robustlab.analysis.gains_and_margins import classical_margins as classical_margins
from robustlab.analysis.gains_and_margins import disk_margin as disk_margin
from robustlab.analysis.gains_and_margins import peak_gain as peak_gain
from robustlab.analysis.gains_and_margins import robust_stability as robust_stability
from robustlab.analysis.hinf_and_gap import gap as gap
from robustlab.analysis.hinf_and_gap import hinf as hinf
from robustlab.analysis.performance import robust_gain as robust_gain
from robustlab.conversion import ss as ss
from robustlab.conversion import tf as tf
from robustlab.conversion import zpk as zpk
from robustlab.delays.model import DelayedModel as DelayedModel
from robustlab.delays.model import delay as delay
from robustlab.delays.model import with_delays as with_delays
from robustlab.dynamics import linearise as linearise
from robustlab.dynamics import plant as plant
from robustlab.dynamics import simulate as simulate
from robustlab.dynamics import trim as trim
from robustlab.dynamics.descriptor_elimination import descriptor as descriptor
from robustlab.dynamics.extended.extended_plant import with_effects as with_effects
from robustlab.dynamics.symbolic.equations import PlantEquations as PlantEquations
from robustlab.errors import InputError as InputError
from robustlab.errors import NoTrustworthyNumber as NoTrustworthyNumber
from robustlab.errors import RobustlabError as RobustlabError
from robustlab.evidence.verification import verify as verify
from robustlab.identification.comparison.comparison import compare as compare
from robustlab.identification.missing_effects.discovery import discover as discover
from robustlab.identification.missing_effects.updated_plant import uncertain_from as uncertain_from
from robustlab.identification.monitoring import watch as watch
from robustlab.identification.validation import FrequencyData as FrequencyData
from robustlab.identification.validation import validate as validate
from robustlab.identification.validation.model_validation import data_cover as data_cover
from robustlab.iqc.block_types import Nonlinearity as Nonlinearity
from robustlab.iqc.block_types import Varying as Varying
from robustlab.linear_analysis.frequency import frequency_response as frequency_response
from robustlab.linear_analysis.structural import controllability as controllability
from robustlab.linear_analysis.structural import observability as observability
from robustlab.linear_analysis.zeros import zeros as zeros
from robustlab.mu_analysis.axis.robustness import robust_performance as robust_performance
from robustlab.mu_analysis.margins.uncertainty_cover import cover as cover
from robustlab.mu_analysis.matrix.bounds import mu as mu
from robustlab.norms import h2_norm as h2_norm
from robustlab.record import Record as Record
from robustlab.result import Status as Status
from robustlab.statespace import Signal as Signal
from robustlab.statespace import StateSpaceModel as StateSpaceModel
from robustlab.storage.controller_export import export_controller as export_controller
from robustlab.storage.interchange import load as load
from robustlab.storage.interchange import save as save
from robustlab.synthesis.discretisation import d2c as d2c
from robustlab.synthesis.discretisation import discretise as discretise
from robustlab.synthesis.dk.dk_iteration import dk as dk
from robustlab.synthesis.fixed_structure import fixed_structure as fixed_structure
from robustlab.synthesis.goal_tuning import tune as tune
from robustlab.synthesis.h2 import h2 as h2
from robustlab.synthesis.hinf.loop_shaping import mixsyn as mixsyn
from robustlab.synthesis.hinf.loop_shaping import ncf as ncf
from robustlab.synthesis.problem.controller import Controller as Controller
from robustlab.synthesis.problem.generalized_plant import generalized_plant as generalized_plant
from robustlab.synthesis.reduction.controller_reduction import reduce_controller as reduce_controller
from robustlab.synthesis.reduction.model_reduction import minimal as minimal
from robustlab.synthesis.reduction.model_reduction import reduce_model as reduce_model
from robustlab.synthesis.sampled_norm import sampled_data_norm as sampled_data_norm
from robustlab.synthesis.scheduling.parameter_varying import LPVModel as LPVModel
from robustlab.synthesis.scheduling.parameter_varying import lpv_model as lpv_model
from robustlab.synthesis.specifications.loop_functions import loop_functions as loop_functions
from robustlab.synthesis.specifications.weight_design import complementary_weight as complementary_weight
from robustlab.synthesis.specifications.weight_design import control_weight as control_weight
from robustlab.synthesis.specifications.weight_design import makeweight as makeweight
from robustlab.synthesis.specifications.weight_design import performance_weight as performance_weight
from robustlab.uncertainty.blocks import ComplexScalar as ComplexScalar
from robustlab.uncertainty.blocks import FullBlock as FullBlock
from robustlab.uncertainty.blocks import ParameterRange as ParameterRange
from robustlab.uncertainty.blocks import RealScalar as RealScalar
from robustlab.uncertainty.connection import connect as connect
from robustlab.uncertainty.covers import overbound as overbound
from robustlab.uncertainty.elementwise import elementwise as elementwise
from robustlab.uncertainty.frequency_responses import UncertainFrequencyData as UncertainFrequencyData
from robustlab.uncertainty.frequency_responses import frequency_data as frequency_data
from robustlab.uncertainty.gap_metric import coprime_margin as coprime_margin
from robustlab.uncertainty.gap_metric import nu_gap as nu_gap
from robustlab.uncertainty.lft import UncertainModel as UncertainModel
from robustlab.uncertainty.lft import lft as lft
from robustlab.uncertainty.parametric import parametric as parametric
from robustlab.uncertainty.unstructured import unstructured as unstructured
from robustlab.worst_case_analysis import sample as sample
from robustlab.worst_case_analysis import violation_probability as violation_probability
from robustlab.worst_case_analysis import worst_case as worst_case

__version__: str
__all__ = [
    "StateSpaceModel",
    "Signal",
    "ss",
    "tf",
    "zpk",
    "descriptor",
    "Record",
    "load",
    "save",
    "export_controller",
    "DelayedModel",
    "delay",
    "with_delays",
    "plant",
    "trim",
    "linearise",
    "simulate",
    "PlantEquations",
    "with_effects",
    "RealScalar",
    "ComplexScalar",
    "FullBlock",
    "ParameterRange",
    "UncertainModel",
    "lft",
    "elementwise",
    "parametric",
    "UncertainFrequencyData",
    "frequency_data",
    "connect",
    "unstructured",
    "cover",
    "overbound",
    "peak_gain",
    "robust_stability",
    "disk_margin",
    "classical_margins",
    "sample",
    "worst_case",
    "violation_probability",
    "mu",
    "robust_performance",
    "robust_gain",
    "gap",
    "nu_gap",
    "coprime_margin",
    "h2_norm",
    "zeros",
    "controllability",
    "observability",
    "frequency_response",
    "Varying",
    "Nonlinearity",
    "hinf",
    "h2",
    "loop_functions",
    "mixsyn",
    "ncf",
    "dk",
    "fixed_structure",
    "tune",
    "generalized_plant",
    "performance_weight",
    "control_weight",
    "complementary_weight",
    "makeweight",
    "Controller",
    "LPVModel",
    "lpv_model",
    "reduce_model",
    "minimal",
    "reduce_controller",
    "discretise",
    "d2c",
    "sampled_data_norm",
    "compare",
    "discover",
    "watch",
    "data_cover",
    "uncertain_from",
    "validate",
    "FrequencyData",
    "verify",
    "Status",
    "RobustlabError",
    "InputError",
    "NoTrustworthyNumber",
]
