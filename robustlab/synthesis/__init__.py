"""Controllers, every one verified in the loop rebuilt from it; parts, each importing from those before it only:

problem, specifications, laws, nonsmooth, hinf, h2, dk, scheduling, reduction, fixed, sampled_norm,
discretisation, windup.
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
        "problem.performance_measure": "MeasureName plant_with_scalings",
        "problem.gamma_bounds": "gamma_bound",
        "hinf.mixed_sensitivity": "mixed_sensitivity_plant",
        "specifications.weight_design": "error_weight",
        "specifications.tracking": "TrackingLoop tracking_loop tracking_problem with_law",
        "nonsmooth.loop_family": "LoopFamily",
        "nonsmooth.parameter_search": "descend",
        "dk.dk_design": "DKSynthesis mu_floor",
        "dk.robust_problem": "RobustProblem",
        "dk.dynamic_scalings": "BlockScaling Factor unit_scalings",
        "dk.dk_iteration": "structure_with_performance",
        "windup.back_calculation": "back_calculation",
        "reduction.controller_reduction": "ReducedController",
    },
)
