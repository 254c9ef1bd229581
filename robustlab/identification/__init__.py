"""Measurement against model: how large the gap is, what is missing, what remains, whether a set explains a record."""

from robustlab.public_names import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "experiment_design": "propose_experiment",
        "comparison.comparison": "compare Comparison OutputGap",
        "comparison.envelope": "cover",
        "missing_effects.discovery": "discover",
        "missing_effects.discovery_result": (
            "Discovery EffectValue Gap InputClock NamedEffect NominalValue Rival SetProbability"
        ),
        "greybox.prepared_record": "prepare ports_of window_length",
        "greybox.disturbance_smoother": "smooth_disturbance",
        "greybox.motion_smoother": "smooth_motion",
        "greybox.candidates": (
            "candidates catalogue nuisance_parameters stated_tolerances with_absolute_tolerances "
            "spatial_orders timed_lines"
        ),
        "greybox.effect_fit": "Problem Hypothesis FitPlan refit_distance Simulator Windows NoiseModel",
        "greybox.noise": "whitening first_noise held_out_fit as_fitted",
        "greybox.random_force": "FittedWindows ForceResponse PortMotion force_response plain_places",
        "greybox.residual_force": (
            "Family fitted_windows judged unnamed_force residual_force force_curves ForceCurve ResidualForce"
        ),
        "monitoring": "watch Watch ChangeTest PieceEquations onset",
        "data_checks.suitability": "check_record suitability",
        "data_checks.resampling": "join_clocks",
        "validation.model_validation": "validate",
        "validation.validation_result": "Validation",
    },
)
