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


Sides = Sequence[tuple[Any, Any]]  # the ends of each block's interval: doubles, or exact fractions
Region = tuple[Sides, float, float]  # a box, and an interval of frequencies


def prove_mu_axis(
    claim: Claim, work: Work, build: Callable[[Claim], Model] = model_of, *, boxed: bool = False, banded: bool = False
) -> Verdict:
    """Prove that A is stable, and at every frequency no Delta of the set makes I - M(jw) Delta singular.

    The set: norms within 1/``level``. Evidence: intervals ``low``, ``high`` (N,) in rad/s, in each of which the form of
    its scalings ``D_w``, ``D_z``, ``G`` (N, ...) is positive definite.

    ``boxed``: real parameters are within ``size`` times their ``ranges`` (k, 2), the ends for size one, about zero; of
    blocks that are not real -1, 1. Each interval has a ``box`` (N, k, 2).
    ``banded``: the claim is limited to the frequencies ``band`` (2,), without stability.
    """
    G, band = build(claim), (0.0, math.inf)
    blocks, low = read_blocks(claim, G.m, G.p), real(claim, "low", (None,))
    count = len(low)
    high = real(claim, "high", (count,), infinite=True)
    root: list[tuple[Fraction, Fraction]] = []
    boxes = np.zeros((count, 0, 2))
    if boxed:
        size = Fraction(scalar(claim, "size"))
        root = [(size * Fraction(a), size * Fraction(b)) for a, b in _ranges(claim, blocks)]
        boxes = real(claim, "box", (count, len(blocks), 2))
    if banded:
        start, stop = band = tuple[float, float](real(claim, "band", (2,), infinite=True).tolist())
        if not 0 <= start <= stop or math.isinf(start):
            raise InputError("band", f"{start}, {stop}", "two frequencies, the lower one first")
    regions: dict[int, Region] = {}
    for i, (sides, a, b) in enumerate(zip(boxes.tolist(), low.tolist(), high.tolist(), strict=True)):
        if not 0 <= a <= b or any(x > y for x, y in sides):
            raise InputError("box, low, high", f"{sides}, {a}, {b}", "ends in order")
        if a <= band[1] and b >= band[0] and not _beyond_nyquist(a, G.dt):
            end = math.inf if _beyond_nyquist(b, G.dt) else b
            regions[i] = ([(x, y) for x, y in sides], max(a, band[0]), min(end, band[1]))
    left = uncovered(root, list(regions.values()), band, work)
    if left is not None:
        sides = "".join(f" {float(x):.6g} .. {float(y):.6g}," for x, y in left[0])
        raise InputError("box, low, high", f"nothing covers{sides} {left[1]} to {left[2]} rad/s", "what covers all")
    D_w, D_z, scales = read_scalings(claim, G.m, G.p, count)
    own = [replace(b, level=1.0) if boxed and b.kind == REAL else b for b in blocks]

    def attempt(chosen: Sequence[int]) -> Verdict:
        first = chosen[0]
        inside = within_box(build(claim), blocks, boxes[first].tolist()) if boxed else build(claim)
        if inside is None:
            return not_proved(f"box {first}: its middle was not proved to be well posed")
        intervals: list[tuple[float, float, Form]] = []
        for i in chosen:
            form = scaled_form(own, D_w[i], D_z[i], scales[i], work)
            if form is None:
                return not_proved(f"interval {i}: D_w > 0 was not proved")
            intervals.append((*regions[i][1:], form))
        answer = axis(inside, intervals, work)
        return answer if answer.proved or not boxed else replace(answer, where=f"box {first}: {answer.where}")

    verdict = PROVED if banded else climb(lambda: stable(build(claim), work))
    for chosen in [[i] for i in regions] if boxed else [list(regions)]:
        if verdict.proved:
            verdict = climb(lambda chosen=chosen: attempt(chosen))
    return verdict


def as_performance(claim: Claim) -> Claim:
    """Return the mu claim for "no member's gain is above ``gamma``"; the last block, a full one, is the performance.

    The other blocks have the level one. If no performance block within 1/gamma makes the loop singular, the gain from
    its w to its z is below gamma (main loop theorem).
    """
    rows = read_shapes(claim)
    if not rows or rows[-1][0] != FULL:
        raise InputError("blocks", f"{rows[-1:]}", "a full block, the performance, as the last one")
    if "size" in claim.numbers and scalar(claim, "size") != 1:
        raise InputError("size", f"{scalar(claim, 'size')}", "1: the gain is that over the whole set")
    return Claim(claim.kind, {**claim.numbers, "level": np.array([1.0] * (len(rows) - 1) + [scalar(claim, "gamma")])})


def _beyond_nyquist(w: float, dt: float) -> bool:
    with precision(PRECISIONS[-1]):
        return bool(dt > 0 and arb(w) * arb(dt) >= arb.pi())


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


def uncovered(root: Sides, regions: Sequence[Region], band: tuple[float, float], work: Work) -> Region | None:
    """Return a part of the root box and frequencies that no region covers; None where all is covered in the band.

    A partly covered part is cut at a face of a region, which is a number of the file, so comparisons are exact.
    """
    todo = [(list(root), list(range(len(regions))))]
    while todo:
        box, candidates = todo.pop()
        work.spend(1)
        near = [i for i in candidates if _touches(regions[i][0], box)]
        whole = {i for i in near if all(x <= a and y >= b for (x, y), (a, b) in zip(regions[i][0], box, strict=True))}
        gaps = _gaps(sorted(regions[i][1:] for i in whole), band)
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


def _gaps(intervals: Sequence[tuple[float, float]], band: tuple[float, float]) -> list[tuple[float, float]]:
    """Return the parts of the band outside of the sorted closed intervals, which lie in it."""
    gaps, reached = [], band[0]
    for a, b in intervals:
        if a > reached:
            gaps.append((reached, a))
        reached = max(reached, b)
    if not intervals or reached < band[1]:
        gaps.append((reached, band[1]))
    return gaps
