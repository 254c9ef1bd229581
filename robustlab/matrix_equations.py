r"""Riccati and Lyapunov equations: finite input in, residual-checked solution out.

Stability decided in exact arithmetic, for matrices whose eigenvalues lie too close to the boundary for rounding.

The floating-point entries are taken as the rational numbers that they are; the characteristic polynomial is computed
by Faddeev and LeVerrier's recursion in whole numbers,

.. math:: M_k = N M_{k-1} + c_{k-1} I, \qquad c_k = -\mathrm{tr}(N M_k) / k,

and its roots are judged by Routh's array. Nothing is rounded, so the answer is the truth about the matrix as given.

References
----------
Faddeev, Sominskii 1949; Routh 1877; Gantmacher, *The Theory of Matrices*, chapters IV and XV.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import AnyArray
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.magnitude import refuse_overflow
from robustlab.statespace import real_array

__all__ = [
    "RiccatiSolution",
    "balanced_eigenvalues",
    "care",
    "dare",
    "gramians",
    "hamiltonian_riccati",
    "lyapunov",
    "lyapunov_factor",
    "exactly_stable",
]


# Relative residual from which on a Riccati solution is refined by Newton's method, and how many steps it gets.
REFINED, NEWTON_STEPS = 1e-10, 4


@dataclass(frozen=True, eq=False)
class RiccatiSolution:
    """Stabilising solution of a Riccati equation.

    Attributes
    ----------
    X
        The symmetric solution, shape (n, n).
    gain
        ``F = -R^-1 (B^T X + S^T)``, shape (m, n); ``A + B F`` is stable.
    residual
        Norm of the equation's left-hand side divided by the sum of the norms of its terms.
    """

    X: AnyArray
    gain: AnyArray
    residual: float


def care(
    A: ArrayLike, B: ArrayLike, Q: ArrayLike, R: ArrayLike, S: ArrayLike | None = None, *, tolerance: float = 1e-6
) -> RiccatiSolution:
    r"""Stabilising solution of the continuous-time algebraic Riccati equation.

    .. math:: A^T X + X A + Q - (X B + S) R^{-1} (B^T X + S^T) = 0, \qquad A - B R^{-1} (B^T X + S^T) \text{ stable}

    R is symmetric and invertible and may be indefinite, as in H-infinity synthesis.

    Parameters
    ----------
    A, B, Q, R, S
        Shapes (n, n), (n, m), (n, n), (m, m), (n, m); S is zero where left out.
    tolerance
        Largest relative residual that is accepted.

    Raises
    ------
    InputError
        Shapes that do not fit, or NaN or Inf.
    NoTrustworthyNumber
        No stabilising solution was found (the Hamiltonian has eigenvalues on or too close to the imaginary axis), or
        none whose residual is small enough.

    Notes
    -----
    First the ordered real Schur form of the balanced Hamiltonian (Laub 1979), the quicker one; then the QZ algorithm on
    the balanced extended pencil (Van Dooren 1981; scipy), which does not invert R. Newton's method refines what either
    leaves (Kleinman 1968); the smaller residual wins.

    Examples
    --------
    >>> float(round(care([[0.0]], [[1.0]], [[1.0]], [[1.0]]).X[0, 0], 12))
    1.0
    """
    a, b, q, r = (real_array(k, v, 2, "care") for k, v in (("A", A), ("B", B), ("Q", Q), ("R", R)))
    n, m = a.shape[0], r.shape[0]
    s = np.zeros((n, m)) if S is None else real_array("S", S, 2, "care")
    for name, matrix, shape in (
        ("A", a, (n, n)),
        ("B", b, (n, m)),
        ("Q", q, (n, n)),
        ("R", r, (m, m)),
        ("S", s, (n, m)),
    ):
        if matrix.shape != shape:
            raise InputError("care", f"{name} is {matrix.shape}", f"{shape}")
    if n == 0:
        return RiccatiSolution(np.zeros((0, 0)), np.zeros((m, 0)), 0.0)
    best: RiccatiSolution | None = None
    solvers: tuple[Callable[..., AnyArray | None], ...] = (_ordered_schur, _extended_pencil)
    for solve in solvers:
        X = solve(a, b, q, r, s)
        if X is None:
            continue
        found = _refined_care((a, b, q, r, s), _checked_care((a, b, q, r, s), 0.5 * (X + X.T)))
        if found is not None and (best is None or found.residual < best.residual):
            best = found
        if best is not None and best.residual <= tolerance:
            return best
    if best is None:
        with np.errstate(over="ignore", invalid="ignore"):
            refuse_overflow("care", b @ b.T, q @ q, s @ s.T)
        raise NoTrustworthyNumber(
            "care", "no stabilising solution: the Hamiltonian has eigenvalues on the imaginary axis"
        )
    raise NoTrustworthyNumber("care", f"relative residual {best.residual:.1e}", f"at most {tolerance:.1e}")


def hamiltonian_riccati(A: AnyArray, G: AnyArray, Q: AnyArray, *, tolerance: float = 1e-6) -> AnyArray | None:
    r"""Stabilising solution of a Riccati equation with its quadratic term given whole: the inner loop of searches.

    .. math:: A^T X + X A - X G X + Q = 0, \qquad A - G X \text{ stable}

    Parameters
    ----------
    A, G, Q
        Shapes (n, n); G and Q symmetric, both may be indefinite. Shapes are not checked.
    tolerance
        Largest relative residual that is accepted.

    Returns
    -------
    ndarray or None
        X, symmetric; None where the Hamiltonian has eigenvalues on the imaginary axis, where it has no graph subspace,
        for input that is not finite, and where the residual is too large.

    References
    ----------
    Laub 1979: ordered real Schur form of the (balanced) Hamiltonian.

    Examples
    --------
    >>> one = np.eye(1)
    >>> float(np.round(hamiltonian_riccati(0 * one, one, 4 * one)[0, 0], 12))
    2.0
    """
    n = A.shape[0]
    if n == 0:
        return np.zeros((0, 0))
    hamiltonian = np.empty((2 * n, 2 * n))
    hamiltonian[:n, :n], hamiltonian[:n, n:] = A, -G
    hamiltonian[n:, :n], hamiltonian[n:, n:] = -Q, -A.T
    if not np.isfinite(hamiltonian).all():  # LAPACK may not return from NaN
        return None
    gebal, gees = _lapack()
    balanced, _, _, scale, _ = gebal(hamiltonian, scale=1, permute=0)
    _, count, _, _, z, _, info = gees(lambda re, im: re < 0, balanced, sort_t=1)
    if info != 0 or count != n:
        return None
    z = scale[:, None] * z[:, :n]
    try:
        X = np.linalg.solve(z[:n].T, z[n:].T)
    except np.linalg.LinAlgError:
        return None
    X = 0.5 * (X + X.T)
    if not np.isfinite(X).all():
        return None
    residual, left = _hamiltonian_residual(A, G, Q, X)
    for _ in range(NEWTON_STEPS):  # as in _refined_care
        if residual <= REFINED:
            break
        step = _newton_step(A - G @ X, left)
        if step is None:
            break
        after, left_after = _hamiltonian_residual(A, G, Q, X + step)
        if not after < residual or np.linalg.eigvals(A - G @ (X + step)).real.max() >= 0:
            break
        X, residual, left = X + step, after, left_after
    return X if residual <= tolerance else None


def _hamiltonian_residual(A: AnyArray, G: AnyArray, Q: AnyArray, X: AnyArray) -> tuple[float, AnyArray]:
    """Relative residual of the equation with the quadratic term given whole, and its left-hand side."""
    with np.errstate(over="ignore", invalid="ignore"):  # NaN is no small residual
        linear, quadratic = A.T @ X, X @ G @ X
        size = 2 * np.linalg.norm(linear) + np.linalg.norm(Q) + np.linalg.norm(quadratic)
        left = linear + linear.T - quadratic + Q
        return (float(np.linalg.norm(left) / size) if size else 0.0), left


def balanced_eigenvalues(matrix: AnyArray) -> AnyArray | None:
    """Eigenvalues of a square matrix after balancing, shape (n,); None where it is not finite."""
    if not np.isfinite(matrix).all():
        return None
    return np.linalg.eigvals(_lapack()[0](matrix, scale=1, permute=0)[0])


@functools.cache
def _lapack() -> tuple[Any, Any]:
    """LAPACK's balancing and ordered real Schur form for float64, without scipy's checks around them."""
    from scipy.linalg import get_lapack_funcs

    gebal, gees = get_lapack_funcs(("gebal", "gees"), dtype=np.float64)
    return gebal, gees


def _extended_pencil(a: AnyArray, b: AnyArray, q: AnyArray, r: AnyArray, s: AnyArray) -> AnyArray | None:
    from scipy.linalg import LinAlgError, LinAlgWarning, solve_continuous_are

    with warnings.catch_warnings():
        # An ill-conditioned step is judged by the residual afterwards, not by a warning.
        warnings.simplefilter("ignore", LinAlgWarning)
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            X = solve_continuous_are(a, b, q, r, s=s)
        except (LinAlgError, ValueError):  # ValueError: R is singular to working precision
            return None
    return X if np.isfinite(X).all() else None


def _ordered_schur(a: AnyArray, b: AnyArray, q: AnyArray, r: AnyArray, s: AnyArray) -> AnyArray | None:
    from scipy.linalg import LinAlgError, matrix_balance, schur

    n = a.shape[0]
    try:
        ri = np.linalg.inv(r)
        with np.errstate(over="ignore", invalid="ignore"):
            a1 = a - b @ ri @ s.T
            hamiltonian = np.block([[a1, -b @ ri @ b.T], [-(q - s @ ri @ s.T), -a1.T]])
        if not np.isfinite(hamiltonian).all():
            return None
        with np.errstate(invalid="ignore"):  # scipy casts scale factors to int as if they were a permutation
            balanced, (scale, _) = matrix_balance(hamiltonian, permute=False, separate=True)
        _, z, *count = schur(balanced, output="real", sort="lhp")
        if count != [n]:
            return None
        z = scale[:, None] * z[:, :n]
        X = np.linalg.solve(z[:n].T, z[n:].T).T
    except (LinAlgError, np.linalg.LinAlgError):
        return None
    return X if np.isfinite(X).all() else None


def _checked_care(
    equation: tuple[AnyArray, AnyArray, AnyArray, AnyArray, AnyArray], X: AnyArray
) -> RiccatiSolution | None:
    """Residual and gain of a candidate; None where it does not stabilise."""
    a, b, q, r, s = equation
    with np.errstate(over="ignore", invalid="ignore"):
        try:
            gain = -np.linalg.solve(r, b.T @ X + s.T)
        except np.linalg.LinAlgError:
            return None
        closed = a + b @ gain
        if not np.isfinite(closed).all() or np.linalg.eigvals(closed).real.max() >= 0:
            return None
        quadratic = (X @ b + s) @ gain
        size = 2 * np.linalg.norm(a.T @ X) + np.linalg.norm(q) + np.linalg.norm(quadratic)
        residual = np.linalg.norm(a.T @ X + X @ a + q + quadratic) / size if size else 0.0
    return RiccatiSolution(X, gain, float(residual)) if np.isfinite(residual) else None


def _refined_care(
    equation: tuple[AnyArray, AnyArray, AnyArray, AnyArray, AnyArray], found: RiccatiSolution | None
) -> RiccatiSolution | None:
    """The solution after Newton's steps ``A_X^T dX + dX A_X + residual = 0``, as long as they help.

    The Schur vectors of a Hamiltonian are known to eps times its norm; where its eigenvalues span ten decades X may
    be wrong by tens of per cent while the relative residual is 1e-3. Newton converges quadratically from there.
    """
    a, b, q, _, s = equation
    for _ in range(NEWTON_STEPS):
        if found is None or found.residual <= REFINED:
            break
        X = found.X
        step = _newton_step(a + b @ found.gain, a.T @ X + X @ a + q + (X @ b + s) @ found.gain)
        after = None if step is None else _checked_care(equation, X + step)
        if after is None or after.residual >= found.residual:
            break
        found = after
    return found


def _newton_step(closed: AnyArray, left: AnyArray) -> AnyArray | None:
    """Symmetric dX with ``closed^T dX + dX closed + left = 0``; None where there is none."""
    from scipy.linalg import LinAlgError, solve_continuous_lyapunov

    with warnings.catch_warnings():
        # Eigenvalues that nearly mirror each other: the step is judged by the residual after it.
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            step = solve_continuous_lyapunov(closed.T, -0.5 * (left + left.T))
        except (LinAlgError, ValueError):
            return None
    return 0.5 * (step + step.T) if np.isfinite(step).all() else None


def lyapunov(A: ArrayLike, Q: ArrayLike, discrete: bool = False, *, tolerance: float = 1e-6) -> AnyArray:
    r"""Solution X of the Lyapunov equation, shape (n, n).

    .. math:: A X + X A^T + Q = 0 \qquad\text{or, discrete,}\qquad A X A^T - X + Q = 0

    Raises
    ------
    InputError
        Shapes that do not fit, NaN or Inf.
    NoTrustworthyNumber
        No unique solution (eigenvalues that mirror each other at the stability boundary), or a relative residual above
        ``tolerance``.

    Examples
    --------
    >>> float(lyapunov([[-0.5]], [[2.0]])[0, 0])
    2.0
    """
    from scipy.linalg import LinAlgError, LinAlgWarning, solve_continuous_lyapunov, solve_discrete_lyapunov

    a, q = real_array("A", A, 2, "lyapunov"), real_array("Q", Q, 2, "lyapunov")
    n = a.shape[0]
    for name, matrix in (("A", a), ("Q", q)):
        if matrix.shape != (n, n):
            raise InputError("lyapunov", f"{name} is {matrix.shape}", f"{(n, n)}")
    if n == 0:
        return np.zeros((0, 0))
    poles = np.linalg.eigvals(a)
    # LAPACK moves eigenvalues that mirror each other apart and answers with a huge X of small residual: refuse before.
    gap = np.abs(np.multiply.outer(poles, poles) - 1 if discrete else np.add.outer(poles, poles)).min()
    if gap <= 10 * np.finfo(float).eps * float(np.abs(poles).max() if not discrete else 1.0):
        raise NoTrustworthyNumber("lyapunov", "no unique solution: eigenvalues mirror each other")
    with warnings.catch_warnings():
        # Judged by the residual below.
        warnings.simplefilter("ignore", LinAlgWarning)
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            X = solve_discrete_lyapunov(a, q) if discrete else solve_continuous_lyapunov(a, -q)
        except (LinAlgError, ValueError):
            raise NoTrustworthyNumber("lyapunov", "no unique solution: eigenvalues mirror each other") from None
    if not np.isfinite(X).all():
        raise NoTrustworthyNumber("lyapunov", "the solution is not finite")
    terms = (a @ X @ a.T, -X, q) if discrete else (a @ X, X @ a.T, q)
    size = sum(np.linalg.norm(term) for term in terms)
    residual = float(np.linalg.norm(sum(terms)) / size) if size else 0.0
    if residual > tolerance:
        raise NoTrustworthyNumber("lyapunov", f"relative residual {residual:.1e}", f"at most {tolerance:.1e}")
    return np.asarray(X)


def dare(
    A: ArrayLike, B: ArrayLike, Q: ArrayLike, R: ArrayLike, S: ArrayLike | None = None, *, tolerance: float = 1e-6
) -> RiccatiSolution:
    r"""Stabilising solution of the discrete-time algebraic Riccati equation.

    .. math:: A^T X A - X + Q - (A^T X B + S) (R + B^T X B)^{-1} (B^T X A + S^T) = 0

    with ``A + B F`` stable for the gain ``F = -(R + B^T X B)^-1 (B^T X A + S^T)``. R is symmetric and may be singular.

    Parameters
    ----------
    A, B, Q, R, S
        Shapes (n, n), (n, m), (n, n), (m, m), (n, m); S is zero where left out.
    tolerance
        Largest relative residual that is accepted.

    Raises
    ------
    InputError
        Shapes that do not fit, or NaN or Inf.
    NoTrustworthyNumber
        No stabilising solution was found (eigenvalues of the pencil on or too close to the unit circle), or its
        residual is too large.

    References
    ----------
    Van Dooren 1981: QZ algorithm on the balanced extended pencil (scipy).

    Examples
    --------
    >>> float(round(dare([[1.0]], [[1.0]], [[1.0]], [[1.0]]).X[0, 0], 12))
    1.61803398875
    """
    from scipy.linalg import LinAlgError, LinAlgWarning, solve_discrete_are

    a, b, q, r = (real_array(k, v, 2, "dare") for k, v in (("A", A), ("B", B), ("Q", Q), ("R", R)))
    n, m = a.shape[0], r.shape[0]
    s = np.zeros((n, m)) if S is None else real_array("S", S, 2, "dare")
    shapes = (("A", a, (n, n)), ("B", b, (n, m)), ("Q", q, (n, n)), ("R", r, (m, m)), ("S", s, (n, m)))
    for name, matrix, shape in shapes:
        if matrix.shape != shape:
            raise InputError("dare", f"{name} is {matrix.shape}", f"{shape}")
    if n == 0:
        return RiccatiSolution(np.zeros((0, 0)), np.zeros((m, 0)), 0.0)
    none = "no stabilising solution: the pencil has eigenvalues on the unit circle"
    with warnings.catch_warnings():
        # Judged by the residual below.
        warnings.simplefilter("ignore", LinAlgWarning)
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            X = solve_discrete_are(a, b, q, r, s=s)
            X = 0.5 * (X + X.T)
            coupling = b.T @ X @ a + s.T
            gain = -np.linalg.solve(r + b.T @ X @ b, coupling)
        except (LinAlgError, np.linalg.LinAlgError, ValueError):
            raise NoTrustworthyNumber("dare", none) from None
    if not np.isfinite(X).all() or not np.isfinite(gain).all() or np.abs(np.linalg.eigvals(a + b @ gain)).max() >= 1:
        raise NoTrustworthyNumber("dare", none)
    terms = (a.T @ X @ a, -X, q, coupling.T @ gain)
    size = sum(np.linalg.norm(term) for term in terms)
    residual = float(np.linalg.norm(sum(terms)) / size) if size else 0.0
    if residual > tolerance:
        raise NoTrustworthyNumber("dare", f"relative residual {residual:.1e}", f"at most {tolerance:.1e}")
    return RiccatiSolution(X, gain, residual)


def gramians(
    A: ArrayLike, B: ArrayLike, C: ArrayLike, discrete: bool = False, *, tolerance: float = 1e-6
) -> tuple[AnyArray, AnyArray]:
    r"""Both Gramians of a stable model, shapes (n, n); in continuous time from one Schur form.

    .. math:: A P + P A^T + B B^T = 0, \quad A^T Q + Q A + C^T C = 0 \qquad\text{or, discrete,}\qquad
        A P A^T - P + B B^T = 0, \quad A^T Q A - Q + C^T C = 0

    Raises
    ------
    InputError
        Shapes that do not fit, NaN or Inf.
    NoTrustworthyNumber
        The model is not stable, or a relative residual above ``tolerance``.

    References
    ----------
    Bartels, Stewart 1972.

    Examples
    --------
    >>> [float(x[0, 0]) for x in gramians([[-0.5]], [[2.0]], [[3.0]])]
    [4.0, 9.0]
    """
    from scipy.linalg import get_lapack_funcs, schur

    a, b, c = (real_array(k, v, 2, "gramians") for k, v in (("A", A), ("B", B), ("C", C)))
    n = a.shape[0]
    for name, matrix, shape in (("A", a, (n, n)), ("B", b, (n, b.shape[1])), ("C", c, (c.shape[0], n))):
        if matrix.shape != shape:
            raise InputError("gramians", f"{name} is {matrix.shape}", f"{shape}")
    if discrete or n == 0:
        return lyapunov(a, b @ b.T, discrete, tolerance=tolerance), lyapunov(
            a.T, c.T @ c, discrete, tolerance=tolerance
        )
    parts: Any = schur(a, output="real")
    T, Z = parts
    dtrsyl: Any = get_lapack_funcs("trsyl", (T,))
    zb, cz = Z.T @ b, c @ Z
    P, scale_p, info_p = dtrsyl(T, T, -zb @ zb.T, tranb="T")
    Q, scale_q, info_q = dtrsyl(T, T, -cz.T @ cz, trana="T")
    if info_p or info_q or not (np.isfinite(P).all() and np.isfinite(Q).all()) or min(scale_p, scale_q) < 1:
        raise NoTrustworthyNumber("gramians", "no unique solution: eigenvalues mirror each other")
    for t, X, q in ((T, P, zb @ zb.T), (T.T, Q, cz.T @ cz)):
        linear = t @ X
        size = 2 * np.linalg.norm(linear) + np.linalg.norm(q)
        residual = np.linalg.norm(linear + linear.T + q) / size if size else 0.0
        if not residual <= tolerance:
            raise NoTrustworthyNumber("gramians", f"relative residual {residual:.1e}", f"at most {tolerance:.1e}")
    P, Q = Z @ P @ Z.T, Z @ Q @ Z.T
    return 0.5 * (P + P.T), 0.5 * (Q + Q.T)


def lyapunov_factor(A: ArrayLike, B: ArrayLike, *, tolerance: float = 1e-8) -> AnyArray:
    r"""Triangular factor L, shape (n, n), of a controllability Gramian: the Gramian itself is never formed.

    .. math:: A X + X A^T + B B^T = 0, \qquad X = L L^T

    Eigenvalues of X down to ``eps^2`` of the largest keep their sign, which an eigenvalue decomposition of X loses.

    Parameters
    ----------
    A, B
        Shapes (n, n), (n, m); A is stable (continuous time).
    tolerance
        Largest relative residual that is accepted.

    Raises
    ------
    InputError
        Shapes that do not fit, NaN or Inf.
    NoTrustworthyNumber
        A is not stable, or the residual is too large.

    References
    ----------
    Hammarling, "Numerical solution of the stable, non-negative definite Lyapunov equation", IMA J. Numer. Anal. 2
    (1982), sections 3, 5.

    Examples
    --------
    >>> float(lyapunov_factor([[-0.5]], [[2.0]])[0, 0])
    2.0
    """
    from scipy.linalg import schur, solve_triangular

    a, b = real_array("A", A, 2, "lyapunov_factor"), real_array("B", B, 2, "lyapunov_factor")
    n = a.shape[0]
    for name, matrix, shape in (("A", a, (n, n)), ("B", b, (n, b.shape[1]))):
        if matrix.shape != shape:
            raise InputError("lyapunov_factor", f"{name} is {matrix.shape}", f"{shape}")
    if n == 0 or not b.any():
        return np.zeros((n, n))
    s, q = (np.asarray(part) for part in schur(a, output="complex")[:2])
    poles = np.diag(s)
    if np.real(poles).max() >= 0:
        raise NoTrustworthyNumber(
            "lyapunov_factor", f"A has the eigenvalue {poles[np.real(poles).argmax()]:.6g}", "a stable A"
        )
    rest, u = (q.conj().T @ b).astype(complex), np.zeros((n, n), complex)
    # Last row of U first; what is left of the right-hand side is again of the form B B^H.
    for k in range(n - 1, -1, -1):
        size = np.linalg.norm(rest[k])
        if size == 0:
            continue
        decay, direction = np.sqrt(-2 * np.real(poles[k])), rest[k].conj() / size
        u[k, k] = size / decay
        if k:
            shifted = s[:k, :k] + poles[k].conj() * np.eye(k)
            u[:k, k] = solve_triangular(shifted, -(decay * (rest[:k] @ direction) + s[:k, k] * u[k, k]))
            rest[:k] -= decay * np.outer(u[:k, k], direction.conj())
    factor = q @ u
    if not np.isfinite(factor).all():
        raise NoTrustworthyNumber("lyapunov_factor", "the factor is not finite")
    # X is real, so its real and imaginary factors side by side are a real factor of it.
    L = np.asarray(np.linalg.qr(np.hstack([np.real(factor), np.imag(factor)]).T, mode="r")).T
    X = L @ L.T
    size = 2 * np.linalg.norm(a @ X) + np.linalg.norm(b @ b.T)
    residual = float(np.linalg.norm(a @ X + X @ a.T + b @ b.T) / size)
    if residual > tolerance:
        raise NoTrustworthyNumber("lyapunov_factor", f"relative residual {residual:.1e}", f"at most {tolerance:.1e}")
    return L


# Beyond this size whole numbers become long; the doubtful cases of practice are smaller.
MOST_STATES = 12


def exactly_stable(A: NDArray[Any], discrete: bool = False) -> bool | None:
    """Whether all eigenvalues lie in the open left half plane (discrete: unit disk); None for more than 12 states.

    Parameters
    ----------
    A
        Real, finite, shape (n, n).

    Examples
    --------
    >>> exactly_stable(np.array([[-1.0, 1e8], [-1e-8, 1.0]])), exactly_stable(np.array([[-1e-300]]))
    (False, True)
    """
    n = len(A)
    if n > MOST_STATES:
        return None
    if not n:
        return True
    ratios = [[float(x).as_integer_ratio() for x in row] for row in A]
    common = max(denominator for row in ratios for _, denominator in row)  # powers of two: the largest is a multiple
    whole = [[numerator * (common // denominator) for numerator, denominator in row] for row in ratios]
    coefficients = _characteristic(whole)
    if discrete:
        coefficients = _mapped([c * common ** (n - k) for k, c in enumerate(coefficients)])
    return _all_left(coefficients)


def _characteristic(N: list[list[int]]) -> list[int]:
    """Coefficients of det(x I - N), the highest power first."""
    n = len(N)
    M, coefficients = [[0] * n for _ in range(n)], [1]
    for k in range(1, n + 1):
        M = [[sum(N[i][h] * M[h][j] for h in range(n)) for j in range(n)] for i in range(n)]
        for i in range(n):
            M[i][i] += coefficients[-1]
        trace = sum(N[i][h] * M[h][i] for i in range(n) for h in range(n))
        coefficients.append(-trace // k)  # divides without rest
    return coefficients


def _mapped(p: list[int]) -> list[int]:
    """``(1 - s)^n p((1 + s)/(1 - s))``: the unit disk becomes the left half plane, z = -1 infinity."""
    n, found = len(p) - 1, [0] * len(p)
    for k, c in enumerate(p):
        term = [c]
        for sign in [1] * (n - k) + [-1] * k:  # times (sign s + 1), the highest power first
            term = [sign * a + b for a, b in zip([*term, 0], [0, *term], strict=True)]
        found = [a + b for a, b in zip(found, term, strict=True)]
    return found


def _all_left(p: list[int]) -> bool:
    """Whether all roots have a negative real part, by Routh's array; a missing highest power is a root at infinity."""
    above, row = [Fraction(x) for x in p[0::2]], [Fraction(x) for x in p[1::2]]
    sign = above[0]
    while row:
        if sign * row[0] <= 0:
            return False
        factor = above[0] / row[0]
        longer = [*row[1:], *([Fraction(0)] * (len(above) - len(row)))]
        above, row = row, [a - factor * b for a, b in zip(above[1:], longer, strict=True)]
    return sign != 0
