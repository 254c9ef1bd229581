"""What every hypothesis refits: the nominal parameters within their tolerances, and the clocks of the inputs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

UNIFORM = 3.0**0.5  # half the width of a uniform distribution, in its standard deviations


@dataclass(frozen=True)
class Nuisance:
    """What every hypothesis refits: nominal parameters that a common factor of their references scales
    (`robustlab.dynamics.parameters.Parameter.reference`), or the clock of an input.
    """

    # label, names: of the group, and its parameters
    label: str
    names: tuple[str, ...]
    # standard deviation of the factor's logarithm; of the factor itself where ``additive``; of a clock's shift in s
    spread: float
    additive: bool = False  # the nominal value is 0: the factor is the value in its unit
    never_negative: bool = False  # physics forbids negative values, as of a friction: an additive factor stops at 0
    input: str = ""  # input whose clock may be shifted against the outputs'; empty for parameters

    def factor(self, z: float) -> float:
        """Factor of the standardised z: 1 at z = 0, or 0 where additive."""
        if not self.additive:
            return float(np.exp(self.spread * z))
        return max(0.0, self.spread * z) if self.never_negative else float(self.spread * z)

    @property
    def ends(self) -> tuple[float, float]:
        """The standardised z at the two ends of the tolerance; a clock has none."""
        if self.input:
            return -np.inf, np.inf
        if self.additive:
            return -np.inf if self.never_negative else -UNIFORM, UNIFORM
        tolerance = np.expm1(UNIFORM * self.spread)
        return float(np.log1p(-tolerance)) / self.spread if tolerance < 1.0 else -np.inf, UNIFORM

    def log_within(self, z: float, std: float) -> float:
        """Log probability that what is known as z, give or take ``std``, lies within the tolerance."""
        low, high = self.ends
        near, far = sorted(((z - high) / std, (low - z) / std), reverse=True)
        inside = float(log_ndtr(-near))
        return inside + float(np.log1p(-np.exp(log_ndtr(far) - inside)))
