"""Controllers, every one verified in the loop rebuilt from it; parts, each importing from those before it only:

problem, specifications, structures, hinf, h2, dk, scheduling, reduction, fixed_structure, goal_tuning,
sampled_norm, discretisation.
"""

from robustlab.public_names import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "structures.controller_structures": "PID Decentralised FixedOrder FixedPoles MultichannelPID Part StaticGain",
        "structures.objectives": "Bandwidth Damping Decay RollOff StableController",
        "goal_tuning": "GainGoal MarginGoal SensitivityGoal TrackingGoal VarianceGoal",
        "problem.generalized_plant": "GeneralizedPlant PlantMatrices",
        "problem.controller": "Controller",
        "problem.design": "Design Synthesis HinfSynthesis",
        "scheduling.parameter_varying": "LPVController",
        "scheduling.scheduled_synthesis": "closed_loop",
        "problem.certify": "MeasureName",
        "problem.gamma_lower_bound": "gamma_bound",
        "hinf.loop_shaping": "mixed_sensitivity_plant",
        "specifications.weight_design": "error_weight",
        "specifications.tracking": "TrackingLoop tracking_loop tracking_problem with_law",
        "structures.loops": "LoopFamily",
        "dk.dk_iteration": "DKSynthesis RobustProblem mu_floor structure_with_performance",
        "dk.scalings": "BlockScaling Factor unit_scalings",
        "reduction.controller_reduction": "ReducedController",
    },
)
