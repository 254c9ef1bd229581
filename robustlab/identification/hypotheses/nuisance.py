"""Nominal parameters that every hypothesis refits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Nuisance"]


@dataclass(frozen=True)
class Nuisance:
    """Nominal parameters that are refitted together by a common factor of their references
    (`robustlab.dynamics.parameters.Parameter.reference`).

    Attributes
    ----------
    label, names
        Of the group, and its parameters.
    spread
        Standard deviation of the factor's logarithm; of the factor itself where ``additive``.
    additive
        The nominal value is 0: the factor is the value in its unit.
    never_negative
        Physics forbids negative values, as of a friction: an additive factor stops at 0.
    """

    label: str
    names: tuple[str, ...]
    spread: float
    additive: bool = False
    never_negative: bool = False

    def factor(self, z: float) -> float:
        """Factor of the standardised z: 1 at z = 0, or 0 where additive."""
        if not self.additive:
            return float(np.exp(self.spread * z))
        return max(0.0, self.spread * z) if self.never_negative else float(self.spread * z)
