"""How large the gap between model and record is, where it lives, and what the residual still contains.

comparison                  `compare`
along_motion                the same for a nonlinear plant, about the recorded motion, joint by joint
error_analysis              what linear and nonlinear plants share
comparison_result           `Comparison` and its text
localisation                over time, speed, position, amplitude, direction and frequency; as an addition to the input
residual_tests              is the residual white, is it independent of the input; even and odd nonlinearity
noise_floor                 noise without a model, where a record repeats
best_linear_approximation   the measured frequency response beside the model's
envelope                    `cover`: does an uncertain model reach the record
"""

from importlib import import_module
from typing import Any

_WORDS = {
    **dict.fromkeys(("arbitrary_bla", "held_response", "periodic_bla"), "best_linear_approximation"),
    "compare": "comparison",
    **dict.fromkeys(("bins", "directions", "motion_of", "spectrum", "speed_edges", "time_shares"), "localisation"),
    "position_edges": "localisation",
    "cover": "envelope",
    **dict.fromkeys(("NoiseFloor", "noise_floor", "period_of"), "repeats"),
    **dict.fromkeys(("autocorrelation", "even_odd", "input_correlation", "whiteness"), "residual_tests"),
}

__all__ = list(_WORDS)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name in _WORDS:
        return getattr(import_module(f"{__name__}.{_WORDS[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
