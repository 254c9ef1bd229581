"""Measurement against model: how large the gap is, what is missing, what remains, whether a set explains a record."""

from robustlab.lazily import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "comparison.comparison": "compare",
        "comparison.comparison_result": "Comparison OutputGap",
        "comparison.envelope": "cover",
        "naming.discovery": "discover",
        "naming.discovery_result": "Discovery",
        "naming.residual_force": "LeftOver moving_samples remaining_lines residual_curves ForceCurve ResidualForce",
        "naming.discovery_parts": (
            "EffectValue Gap InputClock NamedEffect NominalValue Rival SearchEntry SetProbability"
        ),
        "hypotheses.prepared_record": "prepare ports_of window_length",
        "hypotheses.disturbance_smoother": "smooth_disturbance",
        "hypotheses.motion_smoother": "smooth_motion",
        "hypotheses.candidates": (
            "candidates catalogue nuisance_parameters stated_tolerances with_absolute_tolerances "
            "spatial_orders timed_lines"
        ),
        "hypotheses.effect_fit": "Problem Hypothesis FitPlan refit_distance Simulator Windows NoiseModel",
        "hypotheses.noise": "whitening first_noise held_out_fit as_fitted",
        "hypotheses.random_force": "FittedWindows ForceResponse PortMotion force_response plain_places",
        "hypotheses.unnamed_force": "Family fitted_windows judged unnamed_force",
        "monitoring.watch": "watch Watch",
        "record_check.suitability": "check_record suitability",
        "record_check.resampling": "join_clocks",
        "validation.model_validation": "validate",
        "validation.validation_result": "Validation",
    },
)
