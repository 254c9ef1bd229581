"""Controllers, every one verified in the loop rebuilt from it; rooms, each importing from those before it only:

problem, specifications, laws, nonsmooth, hinf, h2, dk, scheduling, reduction, fixed, sampled, windup.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

# What a design is asked for or answered with, beside the functions that `robustlab` itself hands out; name -> module.
_WORDS = {
    "PID": "laws.controller_structures",
    "Decentralised": "laws.controller_structures",
    "FixedOrder": "laws.controller_structures",
    "FixedPoles": "laws.controller_structures",
    "MultichannelPID": "laws.controller_structures",
    "Part": "laws.controller_structures",
    "Series": "laws.controller_structures",
    "StaticGain": "laws.controller_structures",
    "Sum": "laws.controller_structures",
    "Bandwidth": "nonsmooth.design_limits",
    "Damping": "nonsmooth.design_limits",
    "Decay": "nonsmooth.design_limits",
    "RollOff": "nonsmooth.design_limits",
    "StableController": "nonsmooth.design_limits",
    "GainGoal": "fixed.goal_tuning",
    "MarginGoal": "fixed.goal_tuning",
    "SensitivityGoal": "fixed.goal_tuning",
    "TrackingGoal": "fixed.goal_tuning",
    "VarianceGoal": "fixed.goal_tuning",
    "GeneralizedPlant": "problem.partition",
    "Controller": "problem.controller",
    "Design": "problem.design",
    "Synthesis": "problem.design",
    "HinfSynthesis": "problem.design",
    "LPVController": "scheduling.parameter_varying",
    "closed_loop": "scheduling.scheduled_synthesis",
    "PlantMatrices": "problem.partition",
    "MeasureName": "problem.performance_measure",
    "gamma_bound": "problem.gamma_bounds",
    "mixed_sensitivity_plant": "hinf.mixed_sensitivity",
    "TrackingLoop": "specifications.tracking_problem",
    "tracking_problem": "specifications.tracking_problem",
    "error_weight": "specifications.weight_design",
    "tracking_loop": "specifications.tracking_loop",
    "with_law": "specifications.tracking_loop",
    "LoopFamily": "nonsmooth.loop_family",
    "descend": "nonsmooth.parameter_search",
    "DKSynthesis": "dk.dk_design",
    "RobustProblem": "dk.robust_problem",
    "BlockScaling": "dk.dynamic_scalings",
    "Factor": "dk.dynamic_scalings",
    "unit_scalings": "dk.dynamic_scalings",
    "structure_with_performance": "dk.dk_iteration",
    "mu_floor": "dk.mu_floor",
    "SampledMethod": "sampled.discretisation",
    "merged_modes": "sampled.discretisation",
    "lift": "sampled.lifting",
    "mean_and_variance": "sampled.lifting",
    "back_calculation": "windup.back_calculation",
}

__all__ = list(_WORDS)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name in _WORDS:
        return getattr(import_module(f"robustlab.synthesis.{_WORDS[name]}"), name)
    raise AttributeError(f"module 'robustlab.synthesis' has no attribute {name!r}")
