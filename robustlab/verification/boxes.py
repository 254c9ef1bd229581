r"""Robust stability over boxes of the real parameters, each box with its own scalings.

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

from flint import arb

from robustlab.errors import InputError
from robustlab.verification.axis import axis
from robustlab.verification.balls import diagonal, identity, inverse, zeros
from robustlab.verification.claim import PROVED, Claim, Verdict, Work, not_proved, real, scalar
from robustlab.verification.forms import REAL, Block, read_blocks, read_scalings, scaled_form
from robustlab.verification.models import Model, model_of
from robustlab.verification.mu import beyond_nyquist
from robustlab.verification.norms import climb
from robustlab.verification.stability import stable

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
