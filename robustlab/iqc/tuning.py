"""Numbers that choose how long a proof by integral quadratic constraints is looked for, in one place."""

from __future__ import annotations

from dataclasses import dataclass

from robustlab.budget import MILLION
from robustlab.shown import Tuning

__all__ = ["TUNING", "IqcTuning"]


@dataclass(frozen=True)
class IqcTuning(Tuning):
    """Tuning of this wing; no number here decides whether a bound holds.

    Work is counted in units of about a microsecond (`robustlab.budget`).
    """

    work: float = 60 * MILLION  # the usual work of a proof at effort 1
    poles: tuple[float, ...] = (1.0, 4.0, 0.25)
    # Times that a least gain is looked for at most, each in states measured by the P before; again while it falls below
    # this share of the one before.
    balancings: int = 4
    better: float = 0.98
    # of the multipliers, in terms of the model's typical speed, tried in turn; more: closer bounds, more work
    back_offs: tuple[float, ...] = (1e-5, 1e-4, 1e-3, 1e-2, 5e-2, 0.2)
    # shares above the solver's least gain at which the proof is tried in turn; smaller: closer, with less slack
    # relative distance of a margin from a size that was not proved, of a gain from one attained; smaller: more work
    close: float = 1e-3
    near: float = 0.05  # the same, from which on only the best basis so far is tried; smaller: closer, more work
    least: float = 1e-3  # size of the set below which no margin is looked for
    largest: float = 64.0  # and beyond which
    members: int = 64  # linear members at the ends of all ranges that bound the gain from below
    states: int = 60  # of the model with its filters; more unknowns than that are not begun


TUNING = IqcTuning()
