r"""Input delay: the plant sees the input d seconds late.

.. math:: u'(t) = u(t - d)

The input is held in steps; each step of the delayed input is its mean over that step. A simulation shifts the samples
themselves (`robustlab.dynamics.ports.sampled_input`), first moments included.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.signal_effect import SignalDelay

__all__ = ["EFFECT"]


class InputDelay(SignalDelay):
    """Dead time of a bus, a driver, or a clock that runs ahead of the plant's."""

    id = "input-delay"
    title = "Input delay"
    equation = "u'(t) = u(t - d)"
    independently = "put command and driver output on an oscilloscope with one trigger"
    site_kind = "input"

    def input(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        steps = self.steps(values, h)
        whole = int(min(steps, len(signal)))
        part = min(1.0, steps - whole)
        k = np.arange(len(signal)) - whole  # before the first sample the first value was held
        return (1.0 - part) * signal[np.maximum(k, 0)] + part * signal[np.maximum(k - 1, 0)]


EFFECT = InputDelay()
