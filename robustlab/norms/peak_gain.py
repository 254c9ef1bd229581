"""Base of results about the largest gain: two bounds, where the lower is attained, and their conditions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from robustlab.display import Facts, bracket, listed, number
from robustlab.result import Bracket


@dataclass(frozen=True, eq=False)
class PeakGain(Bracket):
    """Bounds of the largest gain of a system; each kind of system has a class of its own with more evidence.

    Attributes
    ----------
    lower, upper
        ``lower <= gain <= upper``: ``lower`` is attained, at ``frequency`` or by a member; ``upper`` is proved, inf
        without proof. Both inf where the system, or a member of it, is unstable.
    frequency
        Where ``lower`` is attained, rad/s; None where that has no meaning, NaN or None where the gain is infinite.
    status
        How far both can be trusted.
    conditions
        Assumptions of the bounds.
    notes
        Remarks for the reader of a report.
    """

    conditions: tuple[str, ...] = field(default=(), kw_only=True)
    notes: tuple[str, ...] = field(default=(), kw_only=True)

    quantities: ClassVar[Mapping[str, Any]] = {"lower": float, "upper": float}
    unstable: ClassVar[str] = "infinite: a member is unstable"  # text of infinite bounds

    def bounds(self) -> str:
        """Return both bounds in words."""
        if math.isinf(self.lower):
            return self.unstable
        if math.isinf(self.upper):
            return f"{number(self.lower)} (attained), no bound proved"
        return bracket(self.lower, self.upper, ("attained", "proved"))

    def place(self) -> str:
        """Return where ``lower`` is attained, in words; empty if unknown."""
        return number(self.frequency, "rad/s")

    def headline(self) -> str:
        if math.isinf(self.lower):
            return f"the gain is {self.unstable}" if self.unstable.startswith("infinite") else self.unstable
        proved = f"is at most {number(self.upper)}" if math.isfinite(self.upper) else "has no proved bound"
        return f"the gain {proved}; {number(self.lower)} is attained"

    def facts(self) -> Facts:
        return [
            ("largest gain", self.bounds()),
            ("attained at", self.place()),
            *self.evidence(),
            ("holds", listed(self.conditions)),
            *(("note", note) for note in self.notes),
        ]

    def evidence(self) -> Facts:
        """Return the facts of this kind of system."""
        return []
