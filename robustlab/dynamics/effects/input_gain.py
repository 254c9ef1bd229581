r"""Input gain: the plant gets a multiple of the commanded input.

.. math:: u' = s\,u

A pulse-width modulated driver with dead time :math:`t_d` at the switching frequency f has :math:`s = 1 - 2 t_d f`.
"""

from __future__ import annotations

from robustlab.dynamics.effects.signal_effect import SignalGain

__all__ = ["EFFECT"]


class InputGain(SignalGain):
    """Gain of the driver or of its command."""

    id = "input-gain"
    title = "Input gain"
    equation = "u' = s u"
    independently = "measure the driver's output voltage over the command"
    site_kind = "input"
    spread = 0.1
    meaning = "what acts over what was commanded"
    input = SignalGain.scaled
    tolerance = 0.0  # it is what forces are measured in


EFFECT = InputGain()
