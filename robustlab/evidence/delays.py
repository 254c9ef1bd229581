"""Claims about the weights that cover what a rational delay misses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robustlab.delays.approximation import error_weight, pade
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.norms.numbers import matrices
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block
from robustlab.uncertainty.lft import UncertainModel
from robustlab.verification.claim import Claim

TOLERANCE = 1e-12  # for the rounding of a stored approximation and of its weight: at zero both are no exact zeros
GRID = np.geomspace(1e-2, 1e4, 20_000)  # frequencies over one over the delay, at which the far end is sought


def set_claims(found: UncertainModel) -> list[Claim]:
    """That the weights of the set's delays cover them."""
    return weight_claims(found.blocks)


def weight_claims(blocks: Sequence[Block]) -> list[Claim]:
    """Of each block that stands for a delay: its weight covers what the approximation misses of every such delay."""
    claims: list[Claim] = []
    for covered in dict.fromkeys(b.covers for b in blocks if b.covers is not None):
        tau, spread, order, slope = covered
        R, W = pade(tau, order), error_weight(order, slope, spread / tau).scaled(tau)
        low, high = max(tau - spread, 0.0), tau + spread
        numbers = {**matrices(R, "R_{}"), **matrices(W, "W_{}"), "dt": np.array(0.0), "range": np.array([low, high])}
        more = {"far": np.array(_far(R, W, low, high)), "tolerance": np.array(TOLERANCE)}
        claims.append(Claim("delay-weight", {**numbers, **more}))
    return claims


def _far(R: StateSpaceModel, W: StateSpaceModel, low: float, high: float) -> float:
    """Where the weight has passed all that can be missed, before the arc of the delays reaches the opposite of R."""
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    omega = GRID / middle
    r, w = (frequency_response(G, omega)[:, 0, 0] for G in (R, W))
    short = np.abs(w) ** 2 <= 2.0 + 2.0 * np.abs(r) ** 2
    passed = float(omega[np.flatnonzero(short)[-1] + 1]) if short.any() else float(omega[0])
    opposite = np.abs(np.angle(r.conj() * np.exp(-1j * omega * middle))) + omega * half >= np.pi
    if not half or not opposite.any():
        return 1.001 * passed
    return float(min(1.001 * passed, np.sqrt(passed * max(omega[np.argmax(opposite)], passed))))
