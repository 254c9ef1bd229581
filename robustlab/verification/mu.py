"""Bounds of mu: of a matrix, and of a model at every frequency of the axis or of a band; and what a set contains.

The theorems with their proofs are in theorems.md, in the same symbols. From above: scalings for intervals of
frequency, and for boxes of the real parameters. From below: a Delta near given numbers makes the loop singular, or a
member unstable.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
from flint import arb, arb_mat, fmpq, fmpq_mat
from numpy.typing import NDArray

from robustlab.errors import InputError
from robustlab.verification.balls import (
    PRECISIONS,
    Matrix,
    definite,
    diagonal,
    exact,
    identity,
    inverse,
    magnitudes,
    midpoints,
    precision,
    stack,
    zeros,
)
from robustlab.verification.claim import (
    PROVED,
    Claim,
    Verdict,
    Work,
    complex_or_real,
    not_proved,
    real,
    refuted,
    scalar,
)
from robustlab.verification.models import (
    COMPLEX,
    FULL,
    REAL,
    Block,
    Form,
    Model,
    check_delta,
    model_of,
    read_blocks,
    read_scalings,
    read_shapes,
    scaled_form,
    static,
    within,
)
from robustlab.verification.norms import axis, climb, eigenvalues, outside, stable


def prove_mu_upper(claim: Claim, work: Work) -> Verdict:
    """Prove by ``D_w``, ``D_z``, ``G`` that no Delta with norms within 1/``level`` makes I - ``M`` Delta singular."""
    M = static(claim).D
    p, q = M.nrows(), M.ncols()
    blocks, scalings = read_blocks(claim, q, p), read_scalings(claim, q, p)

    def attempt() -> Verdict:
        form = scaled_form(blocks, *scalings, work)
        if form is None:
            return not_proved("D_w > 0 was not proved")
        work.spend(q)
        answer = definite(form.of(M))
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


ALLOWANCE = 1 + 1e-9  # largest norm of a Delta times its level
LARGER = 1 + 5e-10  # half of it: enlarges the given Delta, to move its pole beyond the boundary
WIDER = (4.0, 64.0, 1e4)  # half width of the box over the first Newton step
LEAST = 1e-20  # smallest half width of a box, as a change of g


def prove_mu_lower(claim: Claim, work: Work) -> Verdict:
    """Prove that a Delta of the ``blocks`` within (1 + 1e-9)/``level`` near ``delta`` makes I - M Delta singular."""
    M = static(claim).D
    return singular_member(claim, M, read_blocks(claim, M.ncols(), M.nrows()), work)


def prove_unstable_member(claim: Claim, work: Work) -> Verdict:
    """Prove that a constant Delta within (1 + 1e-9)/``level`` near ``delta`` gives a pole on or beyond the boundary.

    A member that is not well posed (I - D Delta singular) counts, too.
    """
    G = model_of(claim)
    blocks = read_blocks(claim, G.m, G.p)
    delta = given_delta(claim, blocks, G.m, G.p)

    def attempt() -> Verdict:
        model = model_of(claim)
        larger = exact(delta) * arb(LARGER)
        A = closed(model, larger)
        if A is None or not np.isfinite(midpoints(A)).all():
            return not_proved("the given Delta's member was not proved to be well posed")
        work.spend(2 * model.n)
        if within(blocks, larger, arb(ALLOWANCE), work) and any(outside(v, model.dt) for v in eigenvalues(A)):
            return PROVED
        return not_proved("no pole on or beyond the boundary was proved")

    verdict = climb(attempt)
    if verdict.proved:
        return verdict
    ill_posed = singular_member(claim, G.D, blocks, work)
    return ill_posed if ill_posed.proved else verdict


def given_delta(claim: Claim, blocks: Sequence[Block], q: int, p: int) -> NDArray[Any]:
    delta = complex_or_real(claim, "delta", (q, p))
    check_delta(blocks, delta)
    return delta


def singular_member(claim: Claim, M: Matrix, blocks: Sequence[Block], work: Work) -> Verdict:
    """Prove that a Delta of the structure with norms within ``ALLOWANCE / level`` makes I - M Delta singular."""
    p, q = M.nrows(), M.ncols()
    delta = given_delta(claim, blocks, q, p)

    def attempt() -> Verdict:
        K = identity(p) - M * exact(delta)
        directions = _directions(M, K, blocks)
        for E in directions:
            check_delta(blocks, E)
        radii = zero_within(K, [-(M * exact(E)) for E in directions], work)
        if radii is None:
            return not_proved("no Delta next to the given one was proved to make the loop singular")
        found = exact(delta)
        for E, r in zip(directions, radii, strict=True):
            found = found + exact(E) * arb(0, r)
        if not within(blocks, found, arb(ALLOWANCE), work):
            return not_proved("a Delta makes the loop singular, but its norm was not proved to be within the bound")
        return PROVED

    return climb(attempt)


def _directions(M: Matrix, K: Matrix, blocks: Sequence[Block]) -> list[Any]:
    """Estimate the smallest changes of Delta, relative to each block's level, that move g by 1 and (complex) by j."""
    middle = midpoints(K)
    real = not np.iscomplexobj(middle)
    if not middle.size or not np.isfinite(middle).all():
        return []
    U, _, V = np.linalg.svd(middle)
    bordered = np.block([[middle, U[:, -1:]], [V[-1:], np.zeros((1, 1))]])
    last = np.eye(len(bordered))[-1]
    row, column = np.linalg.solve(bordered.T, last)[:-1] @ midpoints(M), np.linalg.solve(bordered, last)[:-1]
    parts: list[Any] = []
    for block in blocks:
        y, x = row[block.w], column[block.z]
        E = np.outer(y.conj(), x.conj()) if block.kind == FULL else np.eye(len(x), dtype=middle.dtype)
        unit = np.zeros((M.ncols(), M.nrows()), dtype=middle.dtype)
        unit[block.w, block.z] = E / (np.linalg.norm(E, 2) * block.level) if E.any() else 0.0
        parts += [unit] if real or block.kind not in (COMPLEX, FULL) else [unit, 1j * unit]
    moves: Any = np.array([row @ E @ column for E in parts])  # dg = -y^T (-M dDelta) x
    weights = np.linalg.pinv(moves[None] if real else np.stack([moves.real, moves.imag]))
    return [sum((w * E for w, E in zip(column, parts, strict=True)), np.zeros_like(parts[0])) for column in weights.T]


def zero_within(K: Matrix, directions: Sequence[Matrix], work: Work) -> list[arb] | None:
    """Return r so that ``K + sum s_i directions_i`` is singular for some ``|s_i| <= r_i``, by Krawczyk's test, or None.

    It holds for the exact matrix in the ball K (n, n). One direction with real matrices, else two.
    """
    n, middle = K.nrows(), midpoints(K)
    real = not any(np.iscomplexobj(midpoints(X)) for X in (K, *directions))
    if not n or len(directions) != (1 if real else 2) or not np.isfinite(middle).all():
        return None
    if not real:
        K = K + exact(np.zeros((n, n), dtype=complex))
    U, _, V = np.linalg.svd(middle)
    border = exact(np.ascontiguousarray(U[:, -1:])), exact(np.ascontiguousarray(V[-1:]))
    work.spend(2 * n)
    start = _value_and_slopes(K, directions, border)
    if start is None:
        return None
    g, J = start
    slope = midpoints(J)
    if not np.isfinite(slope).all() or np.linalg.matrix_rank(slope) < len(slope):
        return None
    C, every = exact(np.linalg.inv(slope)), range(len(slope))
    newton, floor = magnitudes(C * g), magnitudes(C) * arb_mat(len(slope), 1, [LEAST] * len(slope))
    for wider in WIDER:
        r = arb_mat(len(slope), 1, [(newton[i, 0] * wider + floor[i, 0]).upper() for i in every])
        box = K
        for i, X in enumerate(directions):
            box = box + X * arb(0, r[i, 0])
        answer = _value_and_slopes(box, directions, border)
        if answer is None:
            return None
        reached = newton + magnitudes(identity(len(slope)) - C * answer[1]) * r
        if all(reached[i, 0] < r[i, 0] for i in every):
            return [r[i, 0] for i in every]
    return None


def _value_and_slopes(
    K: Matrix, directions: Sequence[Matrix], border: tuple[Matrix, Matrix]
) -> tuple[Matrix, Matrix] | None:
    """Return the values of the real equations g = 0, a column, and their slopes; None: the bordered K is singular."""
    n, kind = K.nrows(), type(K)
    bordered = stack([[K, border[0]], [border[1], zeros(1, 1)]])
    last = kind(n + 1, 1, [0] * n + [1])
    try:
        x, y = bordered.solve(last), bordered.transpose().solve(last)
    except ZeroDivisionError:
        return None
    upper, lower = kind(n, 1, x.entries()[:n]), kind(1, n, y.entries()[:n])
    slopes = [-(lower * X * upper)[0, 0] for X in directions]
    if kind is arb_mat:
        return arb_mat(1, 1, [x[n, 0]]), arb_mat(1, 1, slopes)
    g = x[n, 0]
    return arb_mat(2, 1, [g.real, g.imag]), arb_mat(2, 2, [v.real for v in slopes] + [v.imag for v in slopes])


def closed(G: Model, delta: Matrix) -> Matrix | None:
    """Return A of the member; None where not proved to be well posed."""
    N = inverse(identity(G.p) - G.D * delta)
    return None if N is None else G.A + G.B * delta * N * G.C


def prove_set(claim: Claim, work: Work) -> Verdict:
    r"""Prove that the LFT ``A .. D`` is ``A0 .. D0`` at all parameters 0 and ``A1 .. D1`` at all 1, in the same state.

    With datasets ``delta`` (k,) and ``ranges`` (k, 2) the second is with these parameters, each within its range.

    The channels of Delta (``blocks``, real ones) come first:
    :math:`A + B_1 N C_1`, :math:`B_2 + B_1 N D_{12}`, :math:`C_2 + D_{21} N C_1`, :math:`D_{22} + D_{21} N D_{12}`,
    :math:`N = \Delta (I - D_{11} \Delta)^{-1}`. A dataset ``tolerance`` allows for entries that differ by as much.
    """
    A, B, C, D = (real(claim, name, (None, None)) for name in "ABCD")
    n, (p, m), sizes = len(A), D.shape, [rows for _, rows, _ in read_shapes(claim, kinds=(REAL,))]
    q = sum(sizes)
    for name, shape in (("A", (n, n)), ("B", (n, m)), ("C", (p, n))):
        real(claim, name, shape)
    if q > min(p, m):
        raise InputError("blocks", f"{q} channels", "no more than the model has")
    ends = [
        np.block([[real(claim, f"A{end}", (n, n)), real(claim, f"B{end}", (n, m - q))],
                  [real(claim, f"C{end}", (p - q, n)), real(claim, f"D{end}", (p - q, m - q))]])
        for end in (0, 1)
    ]  # fmt: skip
    tolerance = fraction(scalar(claim, "tolerance", zero=True)) if "tolerance" in claim.numbers else fmpq(0)
    work.spend(n + max(p, m))
    rest = _rational(np.block([[A, B[:, q:]], [C[q:], D[q:, q:]]]))
    into, out = (_rational(X) for X in (np.vstack([B[:, :q], D[q:, :q]]), np.hstack([C[:q], D[:q, q:]])))
    delta = _rational(np.diag(np.repeat(_parameters(claim, len(sizes)), sizes)))
    try:
        perturbed = rest + into * delta * (_rational(np.eye(q)) - _rational(D[:q, :q]) * delta).solve(out)
    except ZeroDivisionError:
        return refuted("the set is not well posed at these parameters")
    for end, mine in enumerate((rest, perturbed)):
        differences = [abs(x) for x in (mine - _rational(ends[end])).entries()]
        worst = max(differences, default=fmpq(0))
        if worst > tolerance:
            row, col = divmod(differences.index(worst), n + m - q)
            name = ("A" if col < n else "B") if row < n else ("C" if col < n else "D")
            size = int(worst.p) / int(worst.q) if worst < 10**300 else math.inf
            return refuted(f"an entry of {name}{end} differs by {size:.6g}")
    return PROVED


def _parameters(claim: Claim, k: int) -> NDArray[np.float64]:
    """Return all ones, or ``delta``; InputError where one of its entries is outside its range."""
    if "delta" not in claim.numbers:
        return np.ones(k)
    delta, ranges = real(claim, "delta", (k,)), real(claim, "ranges", (k, 2))
    if not ((ranges[:, 0] <= delta) & (delta <= ranges[:, 1])).all():
        raise InputError("delta", f"{delta.tolist()}", "parameters within their ranges")
    return delta


def fraction(x: float) -> fmpq:
    return fmpq(*x.as_integer_ratio())


def _rational(X: NDArray[np.float64]) -> fmpq_mat:
    rows, cols = X.shape
    return fmpq_mat(rows, cols, [fraction(x) for x in X.ravel().tolist()])
