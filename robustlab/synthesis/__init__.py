"""Controllers, every one verified in the loop rebuilt from it; packages, each importing from those before it only:

problem, specifications, structures, hinf, h2, dk, scheduling, reduction, fixed_structure, goal_tuning, sampled.
"""

from robustlab.lazily import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "structures.laws": "PID Decentralised FixedOrder FixedPoles MultichannelPID Part StaticGain",
        "structures.problem": "Bandwidth Damping Decay RollOff StableController",
        "goal_tuning": "GainGoal MarginGoal SensitivityGoal TrackingGoal VarianceGoal",
        "problem.partition": "GeneralizedPlant PlantMatrices",
        "problem.controller": "Controller",
        "problem.design": "Design Synthesis HinfSynthesis",
        "scheduling.parameter_varying": "LPVController",
        "scheduling.scheduled_synthesis": "closed_loop",
        "problem.performance_measure": "MeasureName plant_with_scalings",
        "problem.gamma_bounds": "gamma_bound",
        "hinf.mixed_sensitivity": "mixed_sensitivity_plant",
        "specifications.tracking_problem": "TrackingLoop tracking_problem",
        "specifications.weight_design": "error_weight",
        "specifications.tracking_loop": "tracking_loop with_law",
        "structures.loops": "LoopFamily",
        "structures.search": "descend",
        "dk.dk_design": "DKSynthesis mu_floor",
        "dk.robust_problem": "RobustProblem",
        "dk.dynamic_scalings": "BlockScaling Factor unit_scalings",
        "dk.dk_iteration": "structure_with_performance",
        "sampled.discretisation": "SampledMethod merged_modes",
        "sampled.lifting": "lift mean_and_variance",
        "reduction.controller_reduction": "ReducedController",
    },
)
