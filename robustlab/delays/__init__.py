"""Delays: exact ones in models, their rational approximations with a proved error, weights that cover, responses.

`model` has the delayed model and its interconnections, `signal_delays` those that have their delays at inputs and
outputs, `pade` the rational delay and the proof of its error,
`neglected` the weights for what a model leaves out, `response` the responses over time.
"""

from robustlab.delays.model import DelayedModel
from robustlab.delays.neglected import neglected_dynamics
from robustlab.delays.signal_delays import delay, uncertain_delays, with_delays

__all__ = ["DelayedModel", "delay", "neglected_dynamics", "uncertain_delays", "with_delays"]
