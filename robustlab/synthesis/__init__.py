"""Controllers, every one verified in the loop rebuilt from it; packages, each importing from those before it only:

problem, specifications, laws, nonsmooth, hinf, h2, dk, scheduling, reduction, fixed, sampled, windup.
"""

from robustlab.lazily import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "laws.controller_structures": ("PID Decentralised FixedOrder FixedPoles MultichannelPID Part StaticGain Sum"),
        "nonsmooth.design_limits": "Bandwidth Damping Decay RollOff StableController",
        "fixed.goal_tuning": "GainGoal MarginGoal SensitivityGoal TrackingGoal VarianceGoal",
        "problem.partition": "GeneralizedPlant PlantMatrices",
        "problem.controller": "Controller",
        "problem.design": "Design Synthesis HinfSynthesis",
        "scheduling.parameter_varying": "LPVController",
        "scheduling.scheduled_synthesis": "closed_loop",
        "problem.certify": "MeasureName plant_with_scalings",
        "problem.limits": "gamma_bound",
        "hinf.loop_shaping": "mixed_sensitivity_plant",
        "specifications.tracking_problem": "TrackingLoop tracking_problem",
        "specifications.weight_design": "error_weight",
        "specifications.tracking_loop": "tracking_loop with_law",
        "nonsmooth.loop_family": "LoopFamily",
        "nonsmooth.parameter_search": "descend",
        "dk.dk_design": "DKSynthesis RobustProblem mu_floor",
        "dk.scalings": "BlockScaling Factor unit_scalings",
        "dk.dk_iteration": "structure_with_performance",
        "sampled.discretisation": "SampledMethod merged_modes",
        "sampled.lifting": "lift mean_and_variance",
        "windup.back_calculation": "back_calculation",
        "reduction.controller_reduction": "ReducedController",
    },
)
