"""Integral quadratic constraints: worst-case gain and stability with nonlinear, time-varying and uncertain blocks."""

from robustlab.public_names import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "analysis": "IqcGain IqcProof IqcStability posed",
        "block_types": "BlockType Nonlinearity Varying",
        "inequality": "Filtered",
    },
)
