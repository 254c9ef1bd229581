"""Delays: exact ones in models, their rational approximations with a proved error, weights that cover, responses.

`model` has the delayed model and its interconnections, `pade` the rational delay and the proof of its error,
`neglected` the weights for what a model leaves out, `response` the responses over time.
"""

from robustlab.delays.model import DelayedModel, delay, uncertain_delays, with_delays
from robustlab.delays.neglected import neglected_delay, neglected_lag

__all__ = ["DelayedModel", "delay", "neglected_delay", "neglected_lag", "uncertain_delays", "with_delays"]
