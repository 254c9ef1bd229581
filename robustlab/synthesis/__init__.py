"""Controllers: H-infinity and mixed-sensitivity synthesis, every one verified in the loop rebuilt from it."""

from robustlab.synthesis.controller import Controller as Controller
from robustlab.synthesis.design import HinfSynthesis as HinfSynthesis
from robustlab.synthesis.design import Synthesis as Synthesis
from robustlab.synthesis.dk_design import DKSynthesis as DKSynthesis
from robustlab.synthesis.dk_iteration import dk as dk
from robustlab.synthesis.h2_synthesis import H2Synthesis as H2Synthesis
from robustlab.synthesis.h2_synthesis import h2 as h2
from robustlab.synthesis.hinf_synthesis import hinf as hinf
from robustlab.synthesis.loop_functions import LoopFunctions as LoopFunctions
from robustlab.synthesis.loop_functions import loop_functions as loop_functions
from robustlab.synthesis.loop_functions import loop_functions_of as loop_functions_of
from robustlab.synthesis.loop_shaping import NcfSynthesis as NcfSynthesis
from robustlab.synthesis.loop_shaping import ncf as ncf
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
    "H2Synthesis",
    "HinfSynthesis",
    "LoopFunctions",
    "NcfSynthesis",
    "Synthesis",
    "complementary_weight",
    "control_weight",
    "h2",
    "dk",
    "hinf",
    "loop_functions",
    "loop_functions_of",
    "generalized_plant",
    "mixsyn",
    "ncf",
    "performance_weight",
]
