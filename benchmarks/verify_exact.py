"""Numbers of the judge of `verify_attack`: an exact H2 norm in rationals, and matrices of 60 digits (mpmath).

Nothing of robustlab. Matrices of 60 digits are arrays of objects.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
from exact_loops import System, joined, rational
from flint import fmpq, fmpq_mat
from mpmath import mp

mp.dps = 60


def embedded(X: Any) -> fmpq_mat:
    """The real matrix ``[[Re, -Im], [Im, Re]]`` of fractions: products and definiteness go over to it."""
    X = np.asarray(X, dtype=complex)
    R, J = rational(X.real), rational(X.imag)
    return joined([[R, J * -1], [J, R]])


def h2_square(G: System) -> fmpq:
    """Square of the H2 norm of a stable model in rationals; D counts where it is discrete."""
    n, D = G.A.nrows(), sum((d * d for d in G.D.entries()), fmpq(0))
    if not n:
        return D
    # A^T X + X A + C^T C = 0, or A^T X A - X + C^T C = 0, row by row
    one, A = np.array([[fmpq(int(i == j)) for j in range(n)] for i in range(n)]), np.array(G.A.transpose().tolist())
    system = np.kron(A, A) - np.kron(one, one) if G.discrete else np.kron(A, one) + np.kron(one, A)
    right = fmpq_mat(n * n, 1, [-v for v in (G.C.transpose() * G.C).entries()])
    X = fmpq_mat(n, n, fmpq_mat(n * n, n * n, system.ravel().tolist()).solve(right).entries())
    BXB = G.B.transpose() * X * G.B
    return D + sum((BXB[i, i] for i in range(BXB.nrows())), fmpq(0))


def long(X: Any) -> Any:
    """Doubles, or fractions, as numbers of 60 digits."""
    if isinstance(X, fmpq_mat):
        result = np.empty((X.nrows(), X.ncols()), dtype=object)
        result.ravel()[:] = [mp.mpf(int(x.p)) / int(x.q) for x in X.entries()]
        return result
    X = np.asarray(X)
    result = np.empty(X.shape, dtype=object)
    result.ravel()[:] = [mp.mpmathify(x) for x in X.ravel().tolist()]
    return result


def doubles(X: fmpq_mat) -> Any:
    return np.array([float(Fraction(int(x.p), int(x.q))) for x in X.entries()]).reshape(X.nrows(), X.ncols())


def solve(A: Any, B: Any) -> Any:
    """``A^-1 B`` by elimination; ZeroDivisionError where A is singular."""
    A, B = np.array(A, dtype=object), np.array(B, dtype=object)
    n = len(A)
    for i in range(n):
        k = max(range(i, n), key=lambda r: abs(A[r, i]))
        if A[k, i] == 0:
            raise ZeroDivisionError("singular")
        A[[i, k]], B[[i, k]] = A[[k, i]], B[[k, i]]
        for r in range(i + 1, n):
            f = A[r, i] / A[i, i]
            A[r, i:], B[r] = A[r, i:] - f * A[i, i:], B[r] - f * B[i]
    for i in reversed(range(n)):
        if i + 1 < n:
            B[i] = B[i] - A[i, i + 1 :].dot(B[i + 1 :])
        B[i] = B[i] / A[i, i]
    return B


def positive(X: Any) -> bool:
    """Whether a Hermitian matrix is positive definite, by its pivots."""
    X = np.array(X, dtype=object)
    for i in range(len(X)):
        if not mp.re(X[i, i]) > 0:
            return False
        for r in range(i + 1, len(X)):
            X[r, i + 1 :] = X[r, i + 1 :] - (X[r, i] / mp.re(X[i, i])) * X[i, i + 1 :]
    return True


def star(X: Any) -> Any:
    X = X.T.copy()
    X.ravel()[:] = [mp.conj(x) for x in X.ravel()]
    return X


def response(G: tuple[Any, ...], dt: float, w: Any) -> Any:
    """The response of A, B, C, D at w rad/s; inf: D."""
    A, B, C, D = G
    if not len(A) or (not dt and mp.isinf(w)):
        return D
    s = mp.expjpi(mp.mpf(w) * mp.mpf(dt) / mp.pi) if dt else mp.mpc(0, w)
    return D + C.dot(solve(long(np.eye(len(A))) * s - A, B))


def spectral_norm(X: Any) -> Any:
    if X.shape == (1, 1):
        return abs(X[0, 0])
    return max(mp.svd_c(mp.matrix(X.tolist()), compute_uv=False))


def eigenvalues(A: Any) -> list[Any]:
    if len(A) <= 1:  # mpmath 1.3 gives one state's with its vectors
        return A.ravel().tolist()
    return list(mp.eig(mp.matrix(A.tolist()), left=False, right=False))
