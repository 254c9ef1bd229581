r"""Lyapunov and Sylvester equations for users: the solution with its residual.

The rooms take `robustlab.linear_analysis.matrix_equations.lyapunov` and its factored forms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import AnyArray
from robustlab.errors import told_as
from robustlab.linear_analysis.matrix_equations import accepted_residual, check_shapes, lyapunov, unique_solution
from robustlab.shown import AllFields, Facts, Shown, in_words, number
from robustlab.statespace import real_array


@dataclass(frozen=True, eq=False)
class LinearSolution(Shown, AllFields):
    """Solution of a linear matrix equation.

    Attributes
    ----------
    X
        The solution.
    residual
        Norm of what is left of the equation divided by the sum of the norms of its terms.
    """

    X: AnyArray
    residual: float

    def facts(self) -> Facts:
        """What a person wants to read, as (label, text)."""
        return [("X", in_words(self.X)), ("relative residual", number(self.residual, digits=2))]


@told_as("lyap")
def lyap(A: ArrayLike, Q: ArrayLike, *, tolerance: float = 1e-6) -> LinearSolution:
    r"""Continuous Lyapunov equation.

    .. math:: A X + X A^T + Q = 0

    Parameters
    ----------
    A, Q
        Real, shapes (n, n); Q need not be symmetric.
    tolerance
        Largest relative residual that is accepted.

    Returns
    -------
    LinearSolution
        X, shape (n, n); for a stable A and ``Q = B B^T`` the controllability Gramian.

    Raises
    ------
    InputError
        Shapes that do not fit, NaN or Inf.
    NoTrustworthyNumber
        No unique solution (two eigenvalues of A add up to zero), or a residual that is too large.

    References
    ----------
    Bartels, Stewart 1972 (LAPACK, through scipy).

    Examples
    --------
    >>> float(lyap([[-0.5]], [[2.0]]).X[0, 0])
    2.0
    """
    return _lyapunov_solution("lyap", A, Q, tolerance)


@told_as("dlyap")
def dlyap(A: ArrayLike, Q: ArrayLike, *, tolerance: float = 1e-6) -> LinearSolution:
    r"""Discrete Lyapunov (Stein) equation.

    .. math:: A X A^T - X + Q = 0

    Parameters
    ----------
    A, Q
        Real, shapes (n, n); Q need not be symmetric.
    tolerance
        Largest relative residual that is accepted.

    Returns
    -------
    LinearSolution
        X, shape (n, n); for a stable A the sum of ``A^k Q (A^T)^k``.

    Raises
    ------
    InputError
        Shapes that do not fit, NaN or Inf.
    NoTrustworthyNumber
        No unique solution (the product of two eigenvalues of A is one), or a residual that is too large.

    Examples
    --------
    >>> float(dlyap([[0.5]], [[3.0]]).X[0, 0])
    4.0
    """
    return _lyapunov_solution("dlyap", A, Q, tolerance, discrete=True)


def _lyapunov_solution(
    where: str, A: ArrayLike, Q: ArrayLike, tolerance: float, discrete: bool = False
) -> LinearSolution:
    X = lyapunov(A, Q, discrete, tolerance=tolerance)
    a, q = (np.atleast_2d(np.asarray(given, dtype=float)) for given in (A, Q))
    parts = (a @ X @ a.T, -X, q) if discrete else (a @ X, X @ a.T, q)
    return LinearSolution(X, accepted_residual(where, parts, tolerance))


@told_as("sylvester")
def sylvester(A: ArrayLike, B: ArrayLike, Q: ArrayLike, *, tolerance: float = 1e-6) -> LinearSolution:
    r"""Sylvester equation, with the signs of scipy and MATLAB's ``sylvester``.

    .. math:: A X + X B = Q

    Parameters
    ----------
    A, B, Q
        Real, shapes (n, n), (m, m), (n, m).
    tolerance
        Largest relative residual that is accepted.

    Returns
    -------
    LinearSolution
        X, shape (n, m).

    Raises
    ------
    InputError
        Shapes that do not fit, NaN or Inf.
    NoTrustworthyNumber
        No unique solution (an eigenvalue of A and one of B add up to zero), or a residual that is too large.

    References
    ----------
    Bartels, Stewart 1972 (LAPACK, through scipy).

    Examples
    --------
    >>> float(sylvester([[1.0]], [[3.0]], [[8.0]]).X[0, 0])
    2.0
    """
    from scipy.linalg import solve_sylvester

    a, b, q = (real_array(name, given, 2, "sylvester") for name, given in (("A", A), ("B", B), ("Q", Q)))
    n, m = len(a), len(b)
    check_shapes("sylvester", A=(a, (n, n)), B=(b, (m, m)), Q=(q, (n, m)))
    if not n or not m:
        return LinearSolution(np.zeros((n, m)), 0.0)
    one, two = np.linalg.eigvals(a), np.linalg.eigvals(b)
    size = max(float(np.abs(one).max()), float(np.abs(two).max()))
    X = unique_solution("sylvester", np.add.outer(one, two), size, lambda: solve_sylvester(a, b, q))
    return LinearSolution(X, accepted_residual("sylvester", (a @ X, X @ b, -q), tolerance))
