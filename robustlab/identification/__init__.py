"""Model against measurement: how large the gap is, where it lives, and what the residual still contains."""

from robustlab.identification.comparison.comparison import Comparison, OutputGap, compare

__all__ = ["Comparison", "OutputGap", "compare"]
