"""Comparison of a model with a measurement: error, its distribution, equivalent input disturbance, noise floor."""

from robustlab.public_names import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "comparison": "compare",
        "error_analysis": "bins directions input_correlation motion_of spectrum whiteness",
        "envelope": "cover",
        "repeats": "NoiseFloor noise_floor period_of",
    },
)
