"""Comparison of a model with a measurement: error, its distribution, equivalent input disturbance, noise floor."""

from robustlab.lazily import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "comparison": "compare",
        "error_analysis": "bins directions motion_of spectrum",
        "envelope": "cover",
        "repeats": "NoiseFloor noise_floor period_of",
        "residual_tests": "input_correlation whiteness",
        "along_motion": "pose_of",
    },
)
