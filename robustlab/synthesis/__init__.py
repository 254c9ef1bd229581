"""Controllers: H-infinity and mixed-sensitivity synthesis, every one verified in the loop rebuilt from it."""

from robustlab.synthesis.dk.dk_design import DKSynthesis as DKSynthesis
from robustlab.synthesis.dk.dk_iteration import dk as dk
from robustlab.synthesis.fixed.fixed_result import FixedSynthesis as FixedSynthesis
from robustlab.synthesis.fixed.fixed_structure import fixed_structure as fixed_structure
from robustlab.synthesis.h2.h2_synthesis import H2Synthesis as H2Synthesis
from robustlab.synthesis.h2.h2_synthesis import h2 as h2
from robustlab.synthesis.h2.mixed_h2_hinf import MixedSynthesis as MixedSynthesis
from robustlab.synthesis.h2.mixed_h2_hinf import h2_hinf as h2_hinf
from robustlab.synthesis.h2.state_feedback import StateFeedback as StateFeedback
from robustlab.synthesis.h2.state_feedback import lqg as lqg
from robustlab.synthesis.h2.state_feedback import lqr as lqr
from robustlab.synthesis.h2.state_feedback import place as place
from robustlab.synthesis.hinf.hinf_synthesis import hinf as hinf
from robustlab.synthesis.hinf.loop_shaping import NcfSynthesis as NcfSynthesis
from robustlab.synthesis.hinf.loop_shaping import ncf as ncf
from robustlab.synthesis.hinf.mixed_sensitivity import mixsyn as mixsyn
from robustlab.synthesis.laws.controller_structures import PID as PID
from robustlab.synthesis.laws.controller_structures import Decentralised as Decentralised
from robustlab.synthesis.laws.controller_structures import FixedOrder as FixedOrder
from robustlab.synthesis.laws.controller_structures import FixedPoles as FixedPoles
from robustlab.synthesis.laws.controller_structures import MultichannelPID as MultichannelPID
from robustlab.synthesis.laws.controller_structures import Part as Part
from robustlab.synthesis.laws.controller_structures import Series as Series
from robustlab.synthesis.laws.controller_structures import StaticGain as StaticGain
from robustlab.synthesis.laws.controller_structures import Sum as Sum
from robustlab.synthesis.nonsmooth.design_limits import Bandwidth as Bandwidth
from robustlab.synthesis.nonsmooth.design_limits import Damping as Damping
from robustlab.synthesis.nonsmooth.design_limits import Decay as Decay
from robustlab.synthesis.nonsmooth.design_limits import RollOff as RollOff
from robustlab.synthesis.nonsmooth.design_limits import StableController as StableController
from robustlab.synthesis.problem.design import Controller as Controller
from robustlab.synthesis.problem.design import HinfSynthesis as HinfSynthesis
from robustlab.synthesis.problem.design import Synthesis as Synthesis
from robustlab.synthesis.problem.partition import GeneralizedPlant as GeneralizedPlant
from robustlab.synthesis.problem.partition import generalized_plant as generalized_plant
from robustlab.synthesis.problem.performance_limits import PerformanceLimits as PerformanceLimits
from robustlab.synthesis.problem.performance_limits import performance_limits as performance_limits
from robustlab.synthesis.reduction.controller_reduction import ReducedController as ReducedController
from robustlab.synthesis.reduction.controller_reduction import reduce_controller as reduce_controller
from robustlab.synthesis.reduction.model_reduction import ReducedModel as ReducedModel
from robustlab.synthesis.reduction.model_reduction import balanced_truncation as balanced_truncation
from robustlab.synthesis.reduction.model_reduction import hankel_singular_values as hankel_singular_values
from robustlab.synthesis.reduction.model_reduction import reduce_model as reduce_model
from robustlab.synthesis.sampled.discretisation import discretise as discretise
from robustlab.synthesis.sampled.sampled_controller import SampledController as SampledController
from robustlab.synthesis.sampled.sampled_controller import discretise_controller as discretise_controller
from robustlab.synthesis.sampled.sampled_data import SampledDataNorm as SampledDataNorm
from robustlab.synthesis.sampled.sampled_data import sampled_data_norm as sampled_data_norm
from robustlab.synthesis.sampled.sampled_robustness import SampledRobustness as SampledRobustness
from robustlab.synthesis.sampled.sampled_robustness import sampled_robustness as sampled_robustness
from robustlab.synthesis.specifications.loop_functions import LoopFunctions as LoopFunctions
from robustlab.synthesis.specifications.loop_functions import loop_functions as loop_functions
from robustlab.synthesis.specifications.loop_functions import loop_functions_of as loop_functions_of
from robustlab.synthesis.specifications.weight_design import DesignWeights as DesignWeights
from robustlab.synthesis.specifications.weight_design import check_weights as check_weights
from robustlab.synthesis.specifications.weight_design import complementary_weight as complementary_weight
from robustlab.synthesis.specifications.weight_design import control_weight as control_weight
from robustlab.synthesis.specifications.weight_design import design_weights as design_weights
from robustlab.synthesis.specifications.weight_design import makeweight as makeweight
from robustlab.synthesis.specifications.weight_design import noise_weight as noise_weight
from robustlab.synthesis.specifications.weight_design import performance_weight as performance_weight

__all__ = [
    "PID",
    "Bandwidth",
    "Controller",
    "DKSynthesis",
    "Damping",
    "Decay",
    "Decentralised",
    "FixedOrder",
    "FixedPoles",
    "FixedSynthesis",
    "DesignWeights",
    "GeneralizedPlant",
    "H2Synthesis",
    "HinfSynthesis",
    "LoopFunctions",
    "MixedSynthesis",
    "NcfSynthesis",
    "PerformanceLimits",
    "StateFeedback",
    "Synthesis",
    "check_weights",
    "complementary_weight",
    "control_weight",
    "design_weights",
    "h2",
    "dk",
    "MultichannelPID",
    "Part",
    "RollOff",
    "Series",
    "StableController",
    "StaticGain",
    "Sum",
    "ReducedController",
    "ReducedModel",
    "SampledController",
    "SampledDataNorm",
    "SampledRobustness",
    "balanced_truncation",
    "fixed_structure",
    "h2_hinf",
    "discretise",
    "discretise_controller",
    "hankel_singular_values",
    "hinf",
    "loop_functions",
    "loop_functions_of",
    "generalized_plant",
    "lqg",
    "lqr",
    "makeweight",
    "mixsyn",
    "ncf",
    "noise_weight",
    "performance_limits",
    "performance_weight",
    "place",
    "reduce_controller",
    "reduce_model",
    "sampled_data_norm",
    "sampled_robustness",
]
