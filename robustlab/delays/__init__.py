"""Delays: exact ones in models, their rational approximations with a proved error, responses.

`model` has the delayed model and its interconnections, `signal_delays` those that have their delays at inputs and
outputs, `pade` the rational delay and the proof of its error, `response` the responses over time.
"""

from robustlab.delays.model import DelayedModel
from robustlab.delays.signal_delays import delay, uncertain_delays, with_delays

__all__ = ["DelayedModel", "delay", "uncertain_delays", "with_delays"]
