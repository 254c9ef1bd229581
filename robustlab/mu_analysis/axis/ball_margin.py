"""The scalings of a proved margin, confirmed in ball arithmetic at frequencies of their intervals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustlab.errors import InputError
from robustlab.frequency import frequency_response
from robustlab.mu_analysis.axis.axis_model import continuous
from robustlab.mu_analysis.axis.intervals import Piece
from robustlab.mu_analysis.axis.margin import Margin
from robustlab.mu_analysis.matrix.ball_proof import certified_in_balls
from robustlab.uncertainty.blocks import block_slices
from robustlab.uncertainty.lft import UncertainModel

__all__ = ["BallCheck", "margin_in_balls"]

POINTS = 5


@dataclass(frozen=True)
class BallCheck:
    """How many of the inequalities that were tried hold in ball arithmetic."""

    proved: int
    tried: int

    def to_json(self) -> dict[str, int]:
        """Both numbers."""
        return {"proved": self.proved, "tried": self.tried}


def margin_in_balls(uncertain: UncertainModel, margin: Margin) -> BallCheck:
    """Confirm the D-G inequality of each proved interval at five frequencies in it, in ball arithmetic.

    The response M at a frequency is taken as the doubles that it is computed to; from there on the proof is free of
    rounding. It does not cover what lies between the frequencies: that is the Hamiltonian's part, in floating point.

    Raises
    ------
    InputError
        The margin was proved by branch and bound, or ranges are asymmetric: then D, G belong to boxes of parameters.
    DependencyMissing
        python-flint is not installed.
    """
    if not all(isinstance(piece, Piece) for piece in margin.proof):
        hint = "repeat with tolerance=inf: the margin that D, G alone prove"
        raise InputError("margin_in_balls", "a margin proved by branch and bound", "one proved by scalings", hint)
    if not all(b.is_symmetric for b in uncertain.blocks):
        raise InputError("margin_in_balls", "asymmetric ranges", "symmetric ones")
    model = continuous(uncertain.delta_channels)
    slices = block_slices(uncertain.blocks)
    proved = tried = 0
    for piece in margin.proof:
        assert isinstance(piece, Piece)
        members = range(len(uncertain.blocks)) if piece.members is None else piece.members
        w = np.concatenate([np.arange(slices[i][0].start, slices[i][0].stop) for i in members])
        z = np.concatenate([np.arange(slices[i][1].start, slices[i][1].stop) for i in members])
        top = piece.high if np.isfinite(piece.high) else 1e3 * max(piece.low, 1.0)
        for M in frequency_response(model, np.linspace(piece.low, top, POINTS)):
            part = M[z[:, None], w]
            tried += 1
            proved += certified_in_balls(part, piece.bound.Dw, piece.bound.G, piece.beta, piece.bound.Dz)
    return BallCheck(proved, tried)
