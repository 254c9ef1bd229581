r"""Upper bounds of mu: of one matrix, and of a model at every frequency of the axis or of a band.

Boxes: Robust stability over boxes of the real parameters, each box with its own scalings.

In a box real block i has its delta in :math:`[c_i - h_i, c_i + h_i]`. With C and H the diagonal matrices of these on
the channels of w (zero and one on other blocks), :math:`\Delta = C + H \Delta'`, and the loop of M is singular for
:math:`\Delta` if and only if that of

.. math:: M' = N M H, \quad N = (I - M C)^{-1}

is for :math:`\Delta'`, which has levels of one; C is a constant feedback, so M' is a state-space model where
:math:`I - D C` is regular. If boxes and frequency intervals cover the set at all frequencies, each with a form that is
positive definite there, no Delta makes the loop singular; the nominal model is a stable member, the set is connected,
so every member is stable.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
from flint import arb

from robustlab.errors import InputError
from robustlab.verification.axis import axis
from robustlab.verification.balls import PRECISIONS, definite, diagonal, exact, identity, inverse, precision, zeros
from robustlab.verification.claim import PROVED, Claim, Verdict, Work, complex_or_real, not_proved, real, scalar
from robustlab.verification.forms import FULL, REAL, Block, Form, read_blocks, read_scalings, read_shapes, scaled_form
from robustlab.verification.models import Model, model_of
from robustlab.verification.norms import climb, stable


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


Sides = Sequence[tuple[Any, Any]]  # the ends of each block's interval: doubles, or exact fractions
Region = tuple[Sides, float, float]  # a box, and an interval of frequencies


def prove_mu_boxes(claim: Claim, work: Work, build: Callable[[Claim], Model] = model_of) -> Verdict:
    """Prove that no Delta with real parameters within ``size`` times their ``ranges`` destabilises ``build``'s model.

    ``ranges`` (k, 2): the ends for size one, about zero; of blocks that are not real -1, 1, their norms are within
    1/``level``. Evidence: ``box`` (N, k, 2), ``low``, ``high`` (N,) in rad/s, ``D_w``, ``D_z``, ``G`` (N, ...): in each
    box, at the frequencies of its interval, the form is positive definite.
    """
    G = build(claim)
    blocks, size = read_blocks(claim, G.m, G.p), Fraction(scalar(claim, "size"))
    root = [(size * Fraction(a), size * Fraction(b)) for a, b in _ranges(claim, blocks)]
    low = real(claim, "low", (None,))
    count = len(low)
    high, boxes = real(claim, "high", (count,), infinite=True), real(claim, "box", (count, len(blocks), 2))
    regions: list[Region] = []
    for sides, a, b in zip(boxes.tolist(), low.tolist(), high.tolist(), strict=True):
        if not 0 <= a <= b or any(x > y for x, y in sides):
            raise InputError("box, low, high", f"{sides}, {a}, {b}", "ends in order")
        regions.append(([(x, y) for x, y in sides], a, math.inf if beyond_nyquist(b, G.dt) else b))
    left = uncovered(root, regions, work)
    if left is not None:
        sides = ", ".join(f"{float(x):.6g} .. {float(y):.6g}" for x, y in left[0])
        raise InputError("box", f"nothing covers {sides} between {left[1]} and {left[2]} rad/s", "boxes that cover all")
    stacks = read_scalings(claim, G.m, G.p, count)
    verdict = climb(lambda: stable(build(claim), work))
    if not verdict.proved:
        return verdict

    def one(i: int) -> Verdict:
        inside = within_box(build(claim), blocks, boxes[i].tolist())
        if inside is None:
            return not_proved(f"box {i}: its middle was not proved to be well posed")
        own = [replace(b, level=1.0) if b.kind == REAL else b for b in blocks]
        form = scaled_form(own, stacks[0][i], stacks[1][i], stacks[2][i], work)
        if form is None:
            return not_proved(f"box {i}: D_w > 0 was not proved")
        answer = axis(inside, [(float(low[i]), float(high[i]), form)], work)
        return answer if answer.proved else replace(answer, where=f"box {i}: {answer.where}")

    for i in range(count):
        verdict = climb(lambda i=i: one(i))
        if not verdict.proved:
            return verdict
    return PROVED


def _ranges(claim: Claim, blocks: Sequence[Block]) -> list[tuple[float, float]]:
    ranges = real(claim, "ranges", (len(blocks), 2)).tolist()
    for block, (a, b) in zip(blocks, ranges, strict=True):
        if not (a <= 0 <= b if block.kind == REAL else (a, b) == (-1.0, 1.0)):
            raise InputError("ranges", f"{a}, {b}", "an interval about zero; -1, 1 of a block that is not real")
    return [(a, b) if block.kind == REAL else (0.0, 0.0) for block, (a, b) in zip(blocks, ranges, strict=True)]


def within_box(G: Model, blocks: Sequence[Block], sides: Sides) -> Model | None:
    """Return the model in feedback with the normalised Delta of a box; None where not proved to be well posed."""
    centre, half = zeros(G.m, G.p), []
    for block, (a, b) in zip(blocks, sides, strict=True):
        rows = range(block.w.start, block.w.stop)
        if block.kind != REAL:
            half += [arb(1) for _ in rows]
            continue
        for w, z in zip(rows, range(block.z.start, block.z.stop), strict=True):
            centre[w, z] = (arb(a) + arb(b)) / 2
        half += [(arb(b) - arb(a)) / 2 for _ in rows]
    N = inverse(identity(G.p) - G.D * centre)
    if N is None:
        return None
    H, back = diagonal(half), G.B * centre * N
    return Model(G.A + back * G.C, (G.B + back * G.D) * H, N * G.C, N * G.D * H, G.dt)


def uncovered(root: Sides, regions: Sequence[Region], work: Work) -> Region | None:
    """Return a part of the root box and frequencies that no region covers; None where all is covered at 0 .. inf.

    A partly covered part is cut at a face of a region, which is a number of the file, so comparisons are exact.
    """
    todo = [(list(root), list(range(len(regions))))]
    while todo:
        box, candidates = todo.pop()
        work.spend(1)
        near = [i for i in candidates if _touches(regions[i][0], box)]
        whole = {i for i in near if all(x <= a and y >= b for (x, y), (a, b) in zip(regions[i][0], box, strict=True))}
        gaps = _gaps(sorted(regions[i][1:] for i in whole))
        if not gaps:
            continue
        faces = Counter(
            (side, face)
            for i in near if i not in whole and any(regions[i][1] < b and regions[i][2] > a for a, b in gaps)
            for side, ends in enumerate(regions[i][0]) for face in ends if box[side][0] < face < box[side][1]
        )  # fmt: skip
        if not faces:
            return box, *gaps[0]
        (side, face), _ = max(faces.items(), key=lambda item: (item[1], -item[0][0]))
        for ends in ((box[side][0], face), (face, box[side][1])):
            todo.append(([*box[:side], ends, *box[side + 1 :]], near))
    return None


def _touches(sides: Sides, box: Sides) -> bool:
    """Test whether they overlap in more than a boundary; for an interval of one point, in that point."""
    return all((x < b and y > a) or (a == b and x <= a <= y) for (x, y), (a, b) in zip(sides, box, strict=True))


def _gaps(intervals: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the parts of 0 .. inf outside of the sorted closed intervals."""
    gaps, reached = [], 0.0
    for a, b in intervals:
        if a > reached:
            gaps.append((reached, a))
        reached = max(reached, b)
    if not intervals or reached < math.inf:
        gaps.append((reached, math.inf))
    return gaps
