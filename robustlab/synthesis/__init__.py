"""Controllers: H-infinity and mixed-sensitivity synthesis, every one verified in the loop rebuilt from it."""

from robustlab.synthesis.controller import Controller as Controller
from robustlab.synthesis.design import HinfSynthesis as HinfSynthesis
from robustlab.synthesis.design import Synthesis as Synthesis
from robustlab.synthesis.dk_design import DKSynthesis as DKSynthesis
from robustlab.synthesis.dk_iteration import dk as dk
from robustlab.synthesis.hinf_synthesis import hinf as hinf
from robustlab.synthesis.mixed_sensitivity import mixsyn as mixsyn
from robustlab.synthesis.partition import GeneralizedPlant as GeneralizedPlant
from robustlab.synthesis.partition import generalized_plant as generalized_plant
from robustlab.synthesis.weights import complementary_weight as complementary_weight
from robustlab.synthesis.weights import control_weight as control_weight
from robustlab.synthesis.weights import performance_weight as performance_weight

__all__ = [
    "Controller",
    "DKSynthesis",
    "GeneralizedPlant",
    "HinfSynthesis",
    "Synthesis",
    "complementary_weight",
    "control_weight",
    "dk",
    "hinf",
    "generalized_plant",
    "mixsyn",
    "performance_weight",
]
