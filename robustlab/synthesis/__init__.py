"""Controllers: H-infinity and mixed-sensitivity synthesis, every one verified in the loop rebuilt from it."""

from robustlab.synthesis.controller import Controller as Controller
from robustlab.synthesis.controller_reduction import ReducedController as ReducedController
from robustlab.synthesis.controller_reduction import reduce_controller as reduce_controller
from robustlab.synthesis.design import HinfSynthesis as HinfSynthesis
from robustlab.synthesis.design import Synthesis as Synthesis
from robustlab.synthesis.discretisation import discretise as discretise
from robustlab.synthesis.hinf_synthesis import hinf as hinf
from robustlab.synthesis.mixed_sensitivity import mixsyn as mixsyn
from robustlab.synthesis.model_reduction import ReducedModel as ReducedModel
from robustlab.synthesis.model_reduction import balanced_truncation as balanced_truncation
from robustlab.synthesis.model_reduction import hankel_singular_values as hankel_singular_values
from robustlab.synthesis.model_reduction import reduce_model as reduce_model
from robustlab.synthesis.partition import GeneralizedPlant as GeneralizedPlant
from robustlab.synthesis.partition import generalized_plant as generalized_plant
from robustlab.synthesis.sampled_controller import SampledController as SampledController
from robustlab.synthesis.sampled_controller import discretise_controller as discretise_controller
from robustlab.synthesis.sampled_data import SampledDataNorm as SampledDataNorm
from robustlab.synthesis.sampled_data import sampled_data_norm as sampled_data_norm
from robustlab.synthesis.weights import complementary_weight as complementary_weight
from robustlab.synthesis.weights import control_weight as control_weight
from robustlab.synthesis.weights import performance_weight as performance_weight

__all__ = [
    "Controller",
    "GeneralizedPlant",
    "HinfSynthesis",
    "ReducedController",
    "ReducedModel",
    "SampledController",
    "SampledDataNorm",
    "Synthesis",
    "balanced_truncation",
    "complementary_weight",
    "control_weight",
    "discretise",
    "discretise_controller",
    "hankel_singular_values",
    "hinf",
    "generalized_plant",
    "mixsyn",
    "performance_weight",
    "reduce_controller",
    "reduce_model",
    "sampled_data_norm",
]
