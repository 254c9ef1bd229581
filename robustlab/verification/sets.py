r"""A set of models with two given end points: an identity of rational numbers, without rounding."""

from __future__ import annotations

import math

import numpy as np
from flint import fmpq, fmpq_mat
from numpy.typing import NDArray

from robustlab.errors import InputError
from robustlab.verification.claim import PROVED, Claim, Verdict, Work, real, refuted, scalar
from robustlab.verification.forms import REAL, read_shapes


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
