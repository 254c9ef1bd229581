"""Claims about loops with exact delays, and about the weights that cover what a rational delay misses."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from robustlab.arrays import Array
from robustlab.delays.model import DelayedModel
from robustlab.delays.neglected import NeglectedWeight
from robustlab.delays.pade import error_weight, pade
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.mu_analysis.margins.delay_loops import DelayDiskMargins
from robustlab.mu_analysis.margins.delay_margins import DelayGain
from robustlab.mu_analysis.margins.delay_stability import DelayStability
from robustlab.mu_analysis.matrix.upper import upper_bounds
from robustlab.norms.numbers import ABOVE, Numbers, above, block_rows, matrices, model_numbers
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block, ComplexScalar
from robustlab.uncertainty.lft import UncertainModel
from robustlab.verification.claim import Claim

TOLERANCE = 1e-12  # for the rounding of a stored approximation and of its weight: at zero both are no exact zeros
NEAR = 1e-4  # of one over the delay: up to here the weights of neglected delays lie above w tau
GRID = np.geomspace(1e-2, 1e4, 20_000)  # frequencies over one over the delay, at which the far end is sought
LOOKS, CUTS = 9, 14  # points of an interval at which scalings are tried, and halvings of an interval


def loop_numbers_of(model: DelayedModel) -> Numbers:
    """The model between the delays, and their lengths in s."""
    return {**model_numbers(model.H), "delays": model.delays}


def stability_claims(found: DelayStability) -> list[Claim]:
    """That all roots of the loop lie left of the axis, where that was found."""
    if found.system is None or not found.stable:
        return []
    return [Claim("delayed-stable", loop_numbers_of(found.system))]


def gain_claims(found: DelayGain) -> list[Claim]:
    """That the loop is stable with a gain of at most ``upper``."""
    return [] if found.system is None else _norm(loop_numbers_of(found.system), found)


def _norm(numbers: Numbers, found: DelayGain) -> list[Claim]:
    if not np.isfinite(found.upper):
        return []
    hint = {"frequency": np.array(float(found.frequency))} if np.isfinite(found.frequency) else {}
    return [Claim("delayed-norm", {**numbers, "gamma": np.array(above(found.upper)), **hint})]


def disk_claims(found: DelayDiskMargins) -> list[Claim]:
    """Of one loop its gain; of several the gain of each, and mu of all at once."""
    if found.gain is not None:
        return gain_claims(found.gain)
    loops = found.sensitivity
    if loops is None:
        return []
    claims = [
        Claim("delayed-norm", {**loop_numbers_of(loops[i, i]), "gamma": np.array(ABOVE / margin.lower)})
        for i, margin in enumerate(found.channels.values()) if 0 < margin.lower < np.inf
    ]  # fmt: skip
    if not 0 < found.simultaneous.lower < np.inf:
        return claims
    level, blocks = ABOVE / found.simultaneous.lower, [ComplexScalar(name) for name in found.channels]
    scalings = _scalings(loops, blocks, level)
    if scalings is not None:
        numbers = {**loop_numbers_of(loops), "blocks": block_rows(blocks), "level": np.array(level), **scalings}
        claims.insert(0, Claim("delayed-mu", numbers))
    return claims


def _scalings(model: DelayedModel, blocks: Sequence[Block], level: float) -> Numbers | None:
    """Intervals that cover the axis, each with the D of one of its points that keeps mu below the level in it."""
    speed = float(np.abs(model.pade(2).poles()).max(initial=1.0))
    cuts = [0.0, *np.geomspace(1e-2 * speed, 10.0 * speed, 10).tolist(), np.inf]
    todo = [(a, b, CUTS) for a, b in itertools.pairwise(cuts)]
    found: list[tuple[float, float, Array]] = []
    while todo:
        a, b, left = todo.pop()
        last = 1e3 * a if np.isinf(b) else b
        omega = np.geomspace(a, last, LOOKS) if a else np.linspace(a, last, LOOKS)
        M = frequency_response(model, omega)
        d = np.sqrt(np.real(np.diag(upper_bounds(M[LOOKS // 2][None], blocks, 1e-4)[0].Dw)))
        if np.linalg.norm(d[:, None] * M / d, 2, axis=(1, 2)).max() < level:
            found.append((a, b, d))
        elif not left or np.isinf(b):
            return None
        else:
            middle = np.sqrt(a * b) if a else 0.5 * b
            todo += [(a, float(middle), left - 1), (float(middle), b, left - 1)]
    found.sort(key=lambda piece: piece[0])
    D = np.stack([np.diag(d * d) for _, _, d in found])
    return {
        "low": np.array([a for a, _, _ in found]), "high": np.array([b for _, b, _ in found]),
        "D_w": D, "D_z": D, "G": np.zeros_like(D),
    }  # fmt: skip


# --- weights ---------------------------------------------------------------------------------------------------------


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
        more = {"far": np.array(_far(R, W, low, high)), "tolerance": np.array(TOLERANCE)}
        claims.append(_weight(R, W, low, high, more))
    return claims


def neglected_claims(found: NeglectedWeight) -> list[Claim]:
    """That the weight covers the error of leaving out every delay up to the longest."""
    if found.delay is None:
        return []
    one, tau = StateSpaceModel([], [], [], [[1.0]]), found.delay
    more = {"far": np.array(_far(one, found.weight, 0.0, tau)), "near": np.array(NEAR / tau)}
    return [_weight(one, found.weight, 0.0, tau, more)]


def _weight(R: StateSpaceModel, W: StateSpaceModel, low: float, high: float, more: Numbers) -> Claim:
    numbers = {**matrices(R, "R_{}"), **matrices(W, "W_{}"), "dt": np.array(0.0), "range": np.array([low, high])}
    return Claim("delay-weight", {**numbers, **more})


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
