r"""Proof that a matrix is stable, where its eigenvalues alone may be too ill-conditioned to say so.

First the eigenvalues with their condition numbers: each is known to about ``eps |A| / |y^* x|`` (Wilkinson). Where that
is not enough, a Lyapunov function in extended precision:

.. math:: P \succ 0, \quad -(A^T P + P A) \succ 0 \quad\Rightarrow\quad A \text{ is stable}

(discrete: :math:`P - A^T P A \succ 0`). P is proposed in ordinary precision; both signs are shown by Cholesky
factorisations in extended precision with room for every rounding error, so nothing rests on how P was found.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis.matrix_equations import lyapunov

EPS = float(np.finfo(float).eps)
EXTENDED = float(np.finfo(np.longdouble).eps)
# Backward error of the QR algorithm in units of eps |A|.
BACKWARD = 10.0
NEWTON_STEPS = 3


def proved_stable(A: AnyArray, discrete: bool = False) -> bool:
    """True where all eigenvalues are proved to lie in the open left half plane, or in the open unit disk.

    ``A``: shape (n, n).
    ``discrete``: which of the two regions.

    Examples
    --------
    >>> proved_stable(np.array([[-1.0, 1e6], [0.0, -1.0]])), proved_stable(np.array([[0.0]]))
    (True, False)
    """
    from scipy.linalg import eig, matrix_balance

    if not A.size:
        return True
    if not np.isfinite(A).all():
        return False
    with np.errstate(invalid="ignore"):  # scipy casts scale factors to int as if they were a permutation
        balanced = np.asarray(matrix_balance(A, permute=False)[0])
    decomposed: Any = eig(balanced, left=True, right=True)
    values, left, right = decomposed
    alignment = np.abs((left.conj() * right).sum(axis=0))
    with np.errstate(divide="ignore"):
        blur = BACKWARD * EPS * float(np.linalg.norm(balanced, 2)) / alignment
    margin = 1 - np.abs(values) if discrete else -np.real(values)
    if (margin > blur).all():
        return True
    if not (margin > 0).all():
        return False
    # In coordinates of its modes the matrix is nearly diagonal and any sum of squares decreases; else ask a solver.
    modal = _in_modes(balanced, values, right)
    if modal is not None and _decreases(np.eye(len(A)), *modal, discrete):
        return True
    try:
        P = lyapunov(balanced.T, np.eye(len(A)), discrete, tolerance=0.5)
    except NoTrustworthyNumber:
        return False
    return _decreases(P, balanced.astype(np.longdouble), np.zeros(A.shape, np.longdouble), discrete)


def _in_modes(A: AnyArray, values: AnyArray, vectors: AnyArray) -> tuple[AnyArray, AnyArray] | None:
    """A in real coordinates of its modes, each entry with its error; None where the modes are no basis."""
    # Of a conjugate pair the real and the imaginary part, at one scale: their block is then [[a, b], [-b, a]].
    basis = np.where(np.imag(values) < 0, np.imag(vectors), np.real(vectors))
    try:
        inverse = np.linalg.inv(basis).astype(np.longdouble)
    except np.linalg.LinAlgError:
        return None
    n = len(A)
    T, exact, eye = basis.astype(np.longdouble), A.astype(np.longdouble), np.eye(n, dtype=np.longdouble)
    for _ in range(NEWTON_STEPS):
        inverse = inverse @ (2 * eye - T @ inverse)
    rounding = 4 * n * EXTENDED
    left_over = np.abs(eye - inverse @ T) + rounding * (np.abs(inverse) @ np.abs(T))
    if not float(left_over.sum(axis=1).max()) < 1e-3:
        return None
    modal = inverse @ exact @ T
    # The true inverse is (I + R + R^2 + ...) times this one, |R| <= left_over.
    series = left_over + 1.01 * left_over @ left_over
    error = rounding * (np.abs(inverse) @ np.abs(exact) @ np.abs(T)) + series @ np.abs(modal)
    return modal, error


def _decreases(P: AnyArray, A: AnyArray, uncertain: AnyArray, discrete: bool) -> bool:
    """Whether P and its decrease along A are positive definite, in spite of rounding and of A's own error."""
    P = (0.5 * (P + P.T)).astype(np.longdouble)
    if not np.isfinite(P).all():
        return False
    half = A.T @ P @ A if discrete else A.T @ P
    Q = P - 0.5 * (half + half.T) if discrete else -(half + half.T)
    rounding = 4 * len(A) * EXTENDED
    if discrete:
        size = np.abs(A.T) @ np.abs(P) @ (rounding * np.abs(A) + 2 * uncertain) + uncertain.T @ np.abs(P) @ uncertain
        size = size + rounding * np.abs(P)
    else:
        size = (rounding * np.abs(A.T) + uncertain.T) @ np.abs(P)
    return _positive_definite(P, np.zeros(P.shape)) and _positive_definite(Q, size + size.T)


def _positive_definite(M: AnyArray, error: AnyArray) -> bool:
    """Cholesky in extended precision of M, scaled to a diagonal of one, less what errors and rounding may take."""
    n = len(M)
    size = np.diag(M)
    if not (size > 0).all():
        return False
    scale = 1 / np.sqrt(size)
    rest = scale[:, None] * M * scale
    rest = rest - np.diag((scale[:, None] * error * scale).sum(axis=1) + 4 * n * EXTENDED)
    for k in range(n):
        pivot = rest[k, k]
        if not pivot > 0:
            return False
        row = rest[k, k + 1 :] / np.sqrt(pivot)
        rest[k + 1 :, k + 1 :] -= np.outer(row, row)
    return True
