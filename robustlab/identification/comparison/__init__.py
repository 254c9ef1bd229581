"""Measurement against model: how large the gap is, where it lives, what is missing at an input, what is noise."""

from importlib import import_module
from typing import Any

_WORDS = {
    **dict.fromkeys(("arbitrary_bla", "held_response", "periodic_bla"), "best_linear_approximation"),
    "compare": "comparison",
    **dict.fromkeys(("bins", "directions", "motion_of", "spectrum", "speed_edges", "time_shares"), "error_analysis"),
    "position_edges": "error_analysis",
    "cover": "envelope",
    **dict.fromkeys(("NoiseFloor", "noise_floor", "period_of"), "repeats"),
    **dict.fromkeys(("autocorrelation", "even_odd", "input_correlation", "whiteness"), "residual_tests"),
}

__all__ = list(_WORDS)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name in _WORDS:
        return getattr(import_module(f"{__name__}.{_WORDS[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
