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
    "LPVController": "scheduling.scheduled_controller",
}

__all__ = list(_WORDS)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name in _WORDS:
        return getattr(import_module(f"robustlab.synthesis.{_WORDS[name]}"), name)
    raise AttributeError(f"module 'robustlab.synthesis' has no attribute {name!r}")
