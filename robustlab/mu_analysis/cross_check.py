r"""A second voice for margins and worst-case gains: SLICOT, which shares no line with robustlab.

For a margin, ``AB13MD`` bounds :math:`\mu(M(j\omega))` from above at the critical frequency and on a grid. What our
explicit Delta attains must lie below its bound; where the D-G bound is exact (:math:`2 m_r + m_C \le 3` for
:math:`m_r` real scalars and :math:`m_C` full complex blocks, none repeated), its bound must lie below what we have
proved. For a worst-case gain, ``AB13DD`` gives the norm of the member at our worst Delta, which must lie within our
bounds.

References
----------
Fan, Tits, Doyle, "Robustness in the presence of mixed parametric uncertainty and unmodeled dynamics", IEEE TAC 36
(1991); Packard, Doyle, "The complex structured singular value", Automatica 29 (1993).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robustlab.arrays import Array, ComplexArray
from robustlab.linear_analysis.frequency import default_grid, frequency_response
from robustlab.mu_analysis.axis.margin import Margin
from robustlab.mu_analysis.axis.worst_gain import WorstCaseGain
from robustlab.result import Status
from robustlab.shown import AllFields, Facts, Shown
from robustlab.slicot import peak_gain, structured_norm_bounds
from robustlab.uncertainty.blocks import Block, block_slices
from robustlab.uncertainty.lft import UncertainModel
from robustlab.uncertainty.realised_delta import perturbed_model, realise_delta

POINTS = 40  # frequencies of the grid
# Relative differences that are no contradiction: AB13MD is an iteration of its own, AB13DD is asked for ten digits.
MU_DIGITS, GAIN_DIGITS = 1e-4, 1e-6


@dataclass(frozen=True)
class CrossCheck(AllFields, Shown):
    """What SLICOT says beside our bounds."""

    routine: str  # the routine asked
    ours: tuple[float, float]  # our bounds of the peak of mu, or of the gain (lower, upper)
    theirs: float  # its largest bound of mu over the frequencies, or its norm of the member at our worst Delta
    # asked, answered: how many frequencies or members it was asked about, and for how many it had an answer
    asked: int
    answered: int
    exact: bool  # whether its bound of mu is mu itself, so that it could contradict our upper bound too
    # CONVERGED: it agrees. INCONCLUSIVE: it had no answer that could contradict us. FAILED: it contradicts us; one of
    # the two is wrong.
    status: Status
    said: str  # the same in words

    def facts(self) -> Facts:
        """What it says."""
        return [("SLICOT", self.said)]


def cross_check(uncertain: UncertainModel, result: Margin | WorstCaseGain) -> CrossCheck:
    """Ask SLICOT about a margin of stability, or about a worst-case gain.

    Raises DependencyMissing: slycot is not installed; NoTrustworthyNumber: the routine crashed or did not end.
    """
    return _margin(uncertain, result) if isinstance(result, Margin) else _gain(uncertain, result)


def _margin(uncertain: UncertainModel, margin: Margin) -> CrossCheck:
    channels, blocks = uncertain.delta_channels, uncertain.blocks
    grid = default_grid(channels, POINTS) if channels.n_states else np.zeros(1)
    critical = [] if margin.frequency is None else [margin.frequency]
    matrices, sizes, real = _as_square(frequency_response(channels, np.concatenate([critical, grid])), blocks)
    theirs = structured_norm_bounds(matrices, sizes, real)
    known = np.isfinite(theirs)
    ours = (_inverse(margin.upper), _inverse(margin.lower))
    exact = _is_exact(blocks)
    largest = float(theirs[known].max(initial=0.0))
    words = f"AB13MD bounds mu by {largest:.6g} at {known.sum()} of {len(theirs)} frequencies"
    status, verdict = Status.CONVERGED, "agrees"
    comparable = (critical and known[0]) or (exact and margin.status is Status.CERTIFIED and known.any())
    if not comparable:
        status, verdict = Status.INCONCLUSIVE, "nothing that could contradict us"
    elif critical and known[0] and theirs[0] < ours[0] * (1 - MU_DIGITS):
        status = Status.FAILED
        verdict = f"contradicts: {theirs[0]:.6g} at the critical frequency, where our Delta attains {ours[0]:.6g}"
    elif exact and margin.status is Status.CERTIFIED and largest > ours[1] * (1 + MU_DIGITS):
        status = Status.FAILED
        verdict = f"contradicts: its bound is exact for these blocks, and we have proved {ours[1]:.6g}"
    said = f"{words}: {verdict}"
    return CrossCheck("AB13MD", ours, largest, len(theirs), int(known.sum()), exact, status, said)


def _gain(uncertain: UncertainModel, worst: WorstCaseGain) -> CrossCheck:
    ours = (worst.lower, worst.upper)
    if not np.isfinite(worst.lower) or worst.frequency is None:
        said = "AB13DD is not asked: there is no stable worst member"
        return CrossCheck("AB13DD", ours, float("inf"), 0, 0, False, Status.INCONCLUSIVE, said)
    # A complex Delta of one frequency becomes stable systems of its size: the member's norm is at least its gain there.
    real = all(np.isrealobj(value) for value in worst.delta.values())
    delta = worst.delta if real else realise_delta(uncertain.blocks, worst.delta, worst.frequency, uncertain.dt)
    member = perturbed_model(uncertain, delta)
    theirs = peak_gain(member.A, member.B, member.C, member.D, discrete=member.is_discrete)
    agrees = worst.lower * (1 - GAIN_DIGITS) <= theirs <= worst.upper * (1 + GAIN_DIGITS)
    verdict = "agrees" if agrees else f"contradicts: we say {ours[0]:.9g} .. {ours[1]:.9g}"
    said = f"AB13DD gives the member at the worst Delta the norm {theirs:.9g}: {verdict}"
    return CrossCheck("AB13DD", ours, theirs, 1, 1, False, Status.CONVERGED if agrees else Status.FAILED, said)


def _as_square(matrices: ComplexArray, blocks: Sequence[Block]) -> tuple[ComplexArray, list[int], list[bool]]:
    """M for the square blocks that AB13MD knows: zeros fill up rectangular ones, asymmetric ranges are widened.

    A repeated scalar becomes a full block: a larger set, whose bound holds for ours too.
    """
    sizes = [max(b.rows, b.cols) for b in blocks]
    starts = np.concatenate([[0], np.cumsum(sizes)])
    square = np.zeros((len(matrices), starts[-1], starts[-1]), dtype=complex)
    places = [(slice(s, s + b.cols), slice(s, s + b.rows)) for s, b in zip(starts, blocks, strict=False)]
    for (out, _), (_, z) in zip(places, block_slices(blocks), strict=True):
        for (_, into), (w, _), b in zip(places, block_slices(blocks), blocks, strict=True):
            widest = 1.0 if b.interval is None else max(-b.interval[0], b.interval[1])
            square[:, out, into] = widest * matrices[:, z, w]
    return square, sizes, [b.interval is not None and b.rows == 1 for b in blocks]


def _is_exact(blocks: Sequence[Block]) -> bool:
    """Whether the D-G bound of these blocks equals mu."""
    real = sum(b.interval == (-1.0, 1.0) and b.rows == 1 for b in blocks)
    full = sum(b.is_ball for b in blocks)
    return real + full == len(blocks) and 2 * real + full <= 3


def _inverse(value: Array | float) -> float:
    return float(1 / value) if value else float("inf")
