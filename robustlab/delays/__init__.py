"""Delays: exact ones in models, their rational approximations with a proved error, responses."""

from robustlab.public_names import lazily

__all__, __getattr__ = lazily(
    __name__, {"model": "DelayedModel delay with_delays", "approximation": "error_weight pade phase_bound"}
)
