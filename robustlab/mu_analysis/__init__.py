"""Structured singular value: bounds for matrices, and margins and worst gains proved over the whole frequency axis."""

from robustlab.public_names import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "axis.margin": "Margin WorstCaseGain replay",
        "axis.robustness": "robust_performance robust_stability worst_case_gain",
        "margins.uncertainty_cover": "COVER_FORMS",
        "margins.disk_margin": "gain_and_phase",
        "matrix.bounds": "MuBounds mu",
        "matrix.lower": "smallest_step",
        "matrix.block_structure": "delta_norm",
        "matrix.upper": "proves",
    },
)
