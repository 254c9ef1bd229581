"""Integral quadratic constraints: worst-case gain and stability with nonlinear, time-varying and uncertain blocks."""

from robustlab.lazily import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "analysis": "IqcGain IqcStability iqc_gain iqc_stability",
        "block_types": "Nature Nonlinearity Varying",
        "problem": "IqcProof posed",
        "multipliers": "Filtered",
    },
)
