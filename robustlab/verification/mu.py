r"""Upper bounds of mu: of one matrix, and of a model at every frequency of the axis or of a band."""

from __future__ import annotations

import math

import numpy as np
from flint import arb

from robustlab.errors import InputError
from robustlab.verification.axis import axis
from robustlab.verification.balls import PRECISIONS, definite, exact, precision
from robustlab.verification.claim import (
    PROVED,
    Claim,
    Verdict,
    Work,
    complex_or_real,
    not_proved,
    real,
    scalar,
)
from robustlab.verification.forms import FULL, Form, read_blocks, read_scalings, read_shapes, scaled_form
from robustlab.verification.models import model_of
from robustlab.verification.norms import climb
from robustlab.verification.stability import stable


def prove_mu_upper(claim: Claim, work: Work) -> Verdict:
    """Prove by ``D_w``, ``D_z``, ``G`` that no Delta with norms within 1/``level`` makes I - ``M`` Delta singular."""
    M = complex_or_real(claim, "M", (None, None))
    p, q = M.shape
    blocks = read_blocks(claim, q, p)
    scalings = read_scalings(claim, q, p)

    def attempt() -> Verdict:
        form = scaled_form(blocks, *scalings, work)
        if form is None:
            return not_proved("D_w > 0 was not proved")
        work.spend(q)
        answer = definite(form.of(exact(M)))
        return PROVED if answer.proved else not_proved(f"the form's smallest eigenvalue is {answer.least:.3g}")

    return climb(attempt)


def prove_mu_axis(claim: Claim, work: Work) -> Verdict:
    """Prove that A is stable, and at every frequency no Delta within 1/``level`` makes I - M(jw) Delta singular.

    Evidence: intervals ``low``, ``high`` (k,) in rad/s with their scalings ``D_w``, ``D_z``, ``G`` (k, ...). A dataset
    ``band`` (2,) limits the claim to the band, without stability.
    """
    G = model_of(claim)
    blocks = read_blocks(claim, G.m, G.p)
    pieces = covering(claim, G.dt)
    stacks = read_scalings(claim, G.m, G.p, len(claim.numbers["low"]))

    def by_frequency() -> Verdict:
        intervals: list[tuple[float, float, Form]] = []
        for i, a, b in pieces:
            form = scaled_form(blocks, stacks[0][i], stacks[1][i], stacks[2][i], work)
            if form is None:
                return not_proved(f"interval {i}: D_w > 0 was not proved")
            intervals.append((a, b, form))
        return axis(model_of(claim), intervals, work)

    verdict = PROVED if "band" in claim.numbers else climb(lambda: stable(model_of(claim), work))
    return climb(by_frequency) if verdict.proved else verdict


def as_performance(claim: Claim) -> Claim:
    """Return the mu claim for "no member's gain is above ``gamma``"; the last block, a full one, is the performance.

    The other blocks have the level one. If no performance block within 1/gamma makes the loop singular, the gain from
    its w to its z is below gamma (main loop theorem).
    """
    rows = read_shapes(claim)
    if not rows or rows[-1][0] != FULL:
        raise InputError("blocks", f"{rows[-1:]}", "a full block, the performance, as the last one")
    if "band" in claim.numbers:
        raise InputError("band", "a band", "none: the gain is that at all frequencies")
    if "size" in claim.numbers and scalar(claim, "size") != 1:
        raise InputError("size", f"{scalar(claim, 'size')}", "1: the gain is that over the whole set")
    return Claim(claim.kind, {**claim.numbers, "level": np.array([1.0] * (len(rows) - 1) + [scalar(claim, "gamma")])})


def covering(claim: Claim, dt: float) -> list[tuple[int, float, float]]:
    """Return index, start and stop in rad/s of the part that each interval has to prove, after those before it.

    Together they cover all frequencies, zero to infinity (discrete: pi/dt), or ``band``, both ends included. InputError
    where ``low`` and ``high`` do not.
    """
    low = real(claim, "low", (None,))
    high = real(claim, "high", (len(low),), infinite=True)
    start, stop = 0.0, math.inf
    if "band" in claim.numbers:
        start, stop = real(claim, "band", (2,), infinite=True).tolist()
        if not 0 <= start <= stop or math.isinf(start):
            raise InputError("band", f"{start}, {stop}", "two frequencies, the lower one first")
    result: list[tuple[int, float, float]] = []
    reached = start
    for i, (a, b) in enumerate(zip(low.tolist(), high.tolist(), strict=True)):
        if not 0 <= a <= b or (i and a < low[i - 1]):
            raise InputError("low, high", f"interval {i}: {a}, {b}", "intervals sorted by low")
        if a > reached:
            raise InputError("low, high", f"a gap between {reached} and {a} rad/s", "intervals that cover all")
        if b > reached or (b == reached and not result):
            result.append((i, reached, min(b, stop)))
            reached = b
            if reached >= stop or beyond_nyquist(reached, dt):
                return result
    raise InputError("low, high", f"they end at {reached} rad/s", "intervals that cover all")


def beyond_nyquist(w: float, dt: float) -> bool:
    with precision(PRECISIONS[-1]):
        return bool(dt > 0 and arb(w) * arb(dt) >= arb.pi())
