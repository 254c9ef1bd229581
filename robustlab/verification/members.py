r"""Proves that a Delta near given numbers makes the loop singular, or an unstable member; and what a set contains.

Stored numbers never make a determinant exactly zero. Proved is a zero close to them: a family of matrices
:math:`K(s) = K_0 + \sum_i s_i K_i`, affine in one or two real numbers, is singular for some :math:`|s_i| \le r_i` with
proved r. Border K by two vectors b, c that make it regular; then

.. math:: g(s) = e^T \begin{pmatrix} K(s) & b \\ c^* & 0 \end{pmatrix}^{-1} e = \frac{\det K(s)}{\det(\text{bordered})},
          \qquad \frac{\partial g}{\partial s_i} = -y^T K_i x ,

where x and y are the upper parts of the bordered matrix's last column and row of its inverse, e its last unit vector.

Krawczyk's theorem: if :math:`|{-C g(0)} + (I - C J) [-r, r]| < r` in each entry, with J enclosing the derivatives over
the box and any matrix C, then g has a zero in the box: by Brouwer :math:`s - C g(s)` has a fixed point there, and the
strict inequality makes C J, hence C, regular. A complex g counts as two real equations, a real one as one.

References
----------
Krawczyk, "Newton-Algorithmen zur Bestimmung von Nullstellen mit Fehlerschranken", Computing 4 (1969).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from flint import arb, arb_mat, fmpq, fmpq_mat
from numpy.typing import NDArray

from robustlab.errors import InputError
from robustlab.verification.balls import Matrix, exact, identity, inverse, magnitudes, midpoints, stack, zeros
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
from robustlab.verification.forms import COMPLEX, FULL, REAL, Block, check_delta, read_blocks, read_shapes, within
from robustlab.verification.models import Model, model_of
from robustlab.verification.norms import climb, eigenvalues, outside

ALLOWANCE = 1 + 1e-9  # largest norm of a Delta times its level
LARGER = 1 + 5e-10  # half of it: enlarges the given Delta, to move its pole beyond the boundary
WIDER = (4.0, 64.0, 1e4)  # half width of the box over the first Newton step
LEAST = 1e-20  # smallest half width of a box, as a change of g


def prove_mu_lower(claim: Claim, work: Work) -> Verdict:
    """Prove that a Delta of the ``blocks`` within (1 + 1e-9)/``level`` near ``delta`` makes I - M Delta singular."""
    M = complex_or_real(claim, "M", (None, None))
    blocks = read_blocks(claim, M.shape[1], M.shape[0])
    return singular_member(claim, exact(M), blocks, work)


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
    """Return the dataset ``delta`` (q, p); InputError where it has not the structure."""
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
    """Estimate the smallest changes of Delta, relative to each block's level, that move g by 1 and (complex) by j.

    They have Delta's structure to the last bit.
    """
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
    """Return half widths r so that ``K + sum s_i directions_i`` is singular for some ``|s_i| <= r_i``, or None.

    ``K``: ball matrix (n, n); the claim holds for the exact matrix in it. One direction with real matrices, else two.
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
    r"""Return A of the member, :math:`A + B \Delta (I - D \Delta)^{-1} C`; None where not proved to be well posed."""
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
