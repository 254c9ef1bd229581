r"""Gramians and their factors from one real Schur form of A, for all that is asked of the same A.

Both come from recursions over the blocks of the triangle, whose work is products of matrices; every solution is judged
by its residual.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import AnyArray
from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis.magnitude import balancing_factors
from robustlab.linear_analysis.matrix_equations import MIRRORED, ROOM, check_shapes, lapack, small_residual
from robustlab.statespace import StateSpaceModel, real_array

__all__ = ["SchurForm", "balanced_schur", "lyapunov_factors"]

# Up to this many rows and columns LAPACK solves an equation in triangular form, a column at a time.
LEAF = 32


@dataclass(frozen=True, eq=False)
class SchurForm:
    """The real Schur form ``A = Z T Z^T`` of a finite matrix, shapes (n, n), n > 0: one for all that A is asked."""

    T: AnyArray
    Z: AnyArray

    @classmethod
    def of(cls, A: AnyArray, where: str) -> SchurForm:
        """By the QR algorithm; `NoTrustworthyNumber` where that does not converge."""
        T, _, _, _, Z, _, failed = lapack().dgees(lambda *_: False, A, lwork=ROOM * len(A))
        if failed:
            raise NoTrustworthyNumber(where, "the QR algorithm did not converge")
        return cls(T, Z)

    def modes(self) -> tuple[AnyArray, AnyArray]:
        """Eigenvalues (n,) and eigenvectors (n, n) of A: a fraction of the work that they are from A."""
        poles, vectors = np.linalg.eig(self.T)
        return poles, self.Z @ vectors

    def gramian(self, right: AnyArray, *, dual: bool = False, tolerance: float = 1e-6) -> AnyArray:
        """X with ``A X + X A^T + right right^T = 0``, or, dual, with A^T in the place of A (Bartels, Stewart 1972)."""
        T, known = self.T, self.Z.T @ right
        known = known @ known.T
        with np.errstate(invalid="ignore", over="ignore"):
            X = _symmetric(T, -known, dual)
        if not np.isfinite(X).all():
            raise NoTrustworthyNumber("gramians", MIRRORED)
        small_residual("gramians", T.T @ X if dual else T @ X, known, tolerance)
        X = self.Z @ X @ self.Z.T
        return 0.5 * (X + X.T)


def balanced_schur(model: StateSpaceModel) -> tuple[SchurForm, AnyArray]:
    """The Schur form of a model's A in balanced states ``x / t``, and t (n,); kept, with the poles and modes."""
    known = vars(model).get("_schur")
    if known is not None:
        return SchurForm(*known[:2]), known[2]
    t = balancing_factors(model.A)
    form = SchurForm.of(model.A / t[:, None] * t, "poles")
    poles, modes = form.modes()
    model._with_modes((poles, t[:, None] * modes))
    vars(model)["_schur"] = form.T, form.Z, t
    return form, t


def _symmetric(T: AnyArray, known: AnyArray, dual: bool) -> AnyArray:
    """Symmetric X with ``T X + X T^T = known``, or, dual, ``T^T X + X T = known``: half after half of T.

    References
    ----------
    Jonsson, Kagstrom, "Recursive blocked algorithms for solving triangular systems, part I", ACM TOMS 28 (2002).
    """
    if len(T) <= LEAF:
        return _in_one(T, T, known, dual)
    k = _middle(T)
    a, across, d = T[:k, :k], T[:k, k:], T[k:, k:]
    X = np.empty(T.shape)
    if dual:
        X[:k, :k] = _symmetric(a, known[:k, :k], dual)
        X[:k, k:] = _general(a, d, known[:k, k:] - X[:k, :k] @ across, dual)
        moved = across.T @ X[:k, k:]
        X[k:, k:] = _symmetric(d, known[k:, k:] - moved - moved.T, dual)
    else:
        X[k:, k:] = _symmetric(d, known[k:, k:], dual)
        X[:k, k:] = _general(a, d, known[:k, k:] - across @ X[k:, k:], dual)
        moved = across @ X[:k, k:].T
        X[:k, :k] = _symmetric(a, known[:k, :k] - moved - moved.T, dual)
    X[k:, :k] = X[:k, k:].T
    return X


def _general(S: AnyArray, T: AnyArray, known: AnyArray, dual: bool) -> AnyArray:
    """X with ``S X + X T^T = known``, or, dual, ``S^T X + X T = known``."""
    if max(known.shape) <= LEAF:
        return _in_one(S, T, known, dual)
    if len(S) < len(T):  # the same of X^T
        return _general(T, S, known.T, dual).T
    k = _middle(S)
    a, across, d = S[:k, :k], S[:k, k:], S[k:, k:]
    if dual:
        first = _general(a, T, known[:k], dual)
        return np.vstack([first, _general(d, T, known[k:] - across.T @ first, dual)])
    last = _general(d, T, known[k:], dual)
    return np.vstack([_general(a, T, known[:k] - across @ last, dual), last])


def _in_one(S: AnyArray, T: AnyArray, known: AnyArray, dual: bool) -> AnyArray:
    """`_general` by LAPACK; NaN where it had to scale the solution, or move eigenvalues that mirror each other."""
    X, scale, info = lapack().dtrsyl(S, T, known, **({"trana": "T"} if dual else {"tranb": "T"}))
    return X if not info and scale == 1 else np.full(known.shape, np.nan)


def _middle(T: AnyArray) -> int:
    """Where a triangle with blocks of two on its diagonal is cut in two."""
    k = len(T) // 2
    return k + int(T[k, k - 1] != 0)


def lyapunov_factors(
    A: ArrayLike, B: ArrayLike, C: ArrayLike, form: SchurForm | None = None, *, tolerance: float = 1e-8
) -> tuple[AnyArray, AnyArray]:
    r"""Triangular factors of both Gramians, shapes (n, n), from one Schur form: no Gramian is ever formed.

    .. math:: A P + P A^T + B B^T = 0, \quad P = L_c L_c^T, \qquad A^T Q + Q A + C^T C = 0, \quad Q = L_o L_o^T

    Eigenvalues of P and Q down to ``eps^2`` of the largest keep their sign, which a decomposition of them loses.

    References
    ----------
    Hammarling, "Numerical solution of the stable, non-negative definite Lyapunov equation", IMA J. Numer. Anal. 2
    (1982), sections 3, 5.

    Examples
    --------
    >>> [float(x[0, 0]) for x in lyapunov_factors([[-0.5]], [[2.0]], [[3.0]])]
    [2.0, 3.0]
    """
    where = "lyapunov_factors"
    a, b, c = (real_array(k, v, 2, where) for k, v in (("A", A), ("B", B), ("C", C)))
    n = a.shape[0]
    check_shapes(where, A=(a, (n, n)), B=(b, (n, b.shape[1])), C=(c, (c.shape[0], n)))
    if n == 0 or not (b.any() or c.any()):
        return np.zeros((n, n)), np.zeros((n, n))
    form = form or SchurForm.of(a, where)
    s, _, poles, q, _, info = lapack().zgees(lambda _: 0, form.T)  # with next to nothing left to do
    q = form.Z @ q
    if info:
        raise NoTrustworthyNumber(where, "the QR algorithm did not converge")
    if np.real(poles).max() >= 0:
        raise NoTrustworthyNumber(where, f"A has the eigenvalue {poles[np.real(poles).argmax()]:.6g}", "a stable A")
    reach = _hammarling(a, b, s, q, tolerance)
    # A^T is conj(q) s^T q^T, whose middle is lower triangular: upper, with its states in reverse order.
    return reach, _hammarling(a.T, c.T, s.T[::-1, ::-1], q.conj()[:, ::-1], tolerance)


def _hammarling(a: AnyArray, b: AnyArray, s: AnyArray, q: AnyArray, tolerance: float) -> AnyArray:
    """L with ``a L L^T + L L^T a^T + b b^T = 0`` for ``a = q s q^H``, s upper triangular."""
    where, n = "lyapunov_factors", len(a)
    if not b.any():
        return np.zeros((n, n))
    rest, u = (q.conj().T @ b).astype(complex), np.zeros((n, n), complex, order="F")
    # Last column of U first; what is left of the right-hand side is again of the form B B^H. Vectors have their full
    # length, with zeros from row k on: parts of matrices would be copied.
    solve, shifted, columns = lapack().ztrtrs, s.copy(order="F"), s.T.copy()
    poles = s.diagonal()
    sums, decays = np.add.outer(poles.conj(), poles), np.sqrt(-2 * np.real(poles)).tolist()
    diagonal = np.einsum("ii->i", shifted)
    for k in range(n - 1, -1, -1):
        size = math.sqrt(np.vdot(rest[k], rest[k]).real)
        if size == 0:
            continue
        decay, unit = decays[k], rest[k] / size
        known = rest @ unit.conj()
        known *= -decay
        known -= columns[k] * (size / decay)
        known[k:] = 0.0
        diagonal[:] = sums[k]
        x, info = solve(shifted, known)
        if info:
            raise NoTrustworthyNumber(where, MIRRORED)
        u[:, k] = x
        u[k, k] = size / decay
        x *= decay
        rest -= np.multiply.outer(x, unit)
    factor = q @ u
    if not np.isfinite(factor).all():
        raise NoTrustworthyNumber(where, "the factor is not finite")
    # X is real, so its real and imaginary factors side by side are a real factor of it.
    L = np.asarray(np.linalg.qr(np.hstack([np.real(factor), np.imag(factor)]).T, mode="r")).T
    with np.errstate(over="ignore", invalid="ignore"):  # NaN is no small residual
        small_residual(where, a @ (L @ L.T), b @ b.T, tolerance)
    return L
