r"""Riccati and Lyapunov equations, continuous and discrete: every solution is checked by its residual.

Continuous Riccati equations are solved by the ordered real Schur form of a balanced Hamiltonian (Laub 1979), refined by
Newton's method (Kleinman 1968); discrete ones by the QZ algorithm on the extended pencil (Van Dooren 1981; scipy).
`lapack` gives LAPACK's own routines. Balancing is by powers of two, which is exact.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import AnyArray, Array
from robustlab.errors import NoTrustworthyNumber, error_context
from robustlab.linear_analysis import slicot
from robustlab.statespace import Signal, StateSpaceModel

# Relative residual above which a Riccati solution is refined by Newton's method, and the largest number of steps.
REFINED, NEWTON_STEPS = 1e-10, 4
# Ratio of the states' sizes in a solution above which it is solved again in other units, at most so many times.
SPREAD, RESCALED = 1e4, 3
# Up to this many states LAPACK works without blocks, and no workspace query is needed.
UNBLOCKED = 32
# LAPACK's workspace for a matrix with blocks, in columns of it.
ROOM = 64
SOLVABLE = "a stabilisable model, and no eigenvalue of the pencil on {}"

Weighed = tuple[AnyArray, AnyArray, float]  # closed-loop matrix of an X, left-hand side of its equation, residual


class RiccatiSolution(NamedTuple):
    """The stabilising X (n, n) and the gain ``F = -R^-1 (B^T X + S^T)`` (m, n)."""

    X: Array
    gain: Array


@error_context("care")
def care(
    A: ArrayLike, B: ArrayLike, Q: ArrayLike, R: ArrayLike, S: ArrayLike | None = None, *, tolerance: float = 1e-6
) -> RiccatiSolution:
    """Solve ``A^T X + X A + Q - (X B + S) R^{-1} (B^T X + S^T) = 0`` for the stabilising X; R may be indefinite."""
    a, b, q, r, s = _matrices(A, B, Q, R, S)
    if not len(a):
        return RiccatiSolution(np.zeros((0, 0)), np.zeros((len(r), 0)))
    try:
        back = np.linalg.inv(r)
        with np.errstate(over="ignore", invalid="ignore"):
            whole = a - b @ back @ s.T, b @ back @ b.T, q - s @ back @ s.T
    except np.linalg.LinAlgError:
        raise NoTrustworthyNumber("care", "no stabilising solution was found; R is singular", "a regular R") from None

    def weighed(X: AnyArray) -> Weighed:
        with np.errstate(over="ignore", invalid="ignore"):
            gain = -np.linalg.solve(r, b.T @ X + s.T)
            quadratic = (X @ b + s) @ gain
            size = 2 * np.linalg.norm(a.T @ X) + np.linalg.norm(q) + np.linalg.norm(quadratic)
            left = a.T @ X + X @ a + q + quadratic
            return a + b @ gain, left, float(np.linalg.norm(left) / size) if size else 0.0

    X = _stable_graph(*whole)
    if X is None or not _is_stable(weighed(X)[0]):
        raise NoTrustworthyNumber("care", "no stabilising solution was found", SOLVABLE.format("the imaginary axis"))
    X, residual = _refined(X, weighed)
    if not residual <= tolerance:
        raise NoTrustworthyNumber("care", f"relative residual {residual:.1e}", f"at most {tolerance:.1e}")
    return RiccatiSolution(X, -np.linalg.solve(r, b.T @ X + s.T))


@error_context("dare")
def dare(
    A: ArrayLike, B: ArrayLike, Q: ArrayLike, R: ArrayLike, S: ArrayLike | None = None, *, tolerance: float = 1e-6
) -> RiccatiSolution:
    """Solve ``A^T X A - X + Q - (A^T X B + S) (R + B^T X B)^{-1} (B^T X A + S^T) = 0`` for the stabilising X.

    The gain is ``F = -(R + B^T X B)^-1 (B^T X A + S^T)``; R may be singular.
    """
    a, b, q, r, s = _matrices(A, B, Q, R, S)
    if not len(a):
        return RiccatiSolution(np.zeros((0, 0)), np.zeros((len(r), 0)))
    from scipy.linalg import solve_discrete_are

    none = NoTrustworthyNumber("dare", "no stabilising solution was found", SOLVABLE.format("the unit circle"))
    with judged_afterwards():
        try:
            X = solve_discrete_are(a, b, q, r, s=s)
            X = 0.5 * (X + X.T)
            coupling = b.T @ X @ a + s.T
            gain = -np.linalg.solve(r + b.T @ X @ b, coupling)
            largest = np.abs(np.linalg.eigvals(a + b @ gain)).max()
        except (np.linalg.LinAlgError, ValueError):  # of entries that are not finite, too
            raise none from None
    if not largest < 1:
        raise none
    small_residual("dare", 0.5 * (a.T @ X @ a - X + coupling.T @ gain), q, tolerance)
    return RiccatiSolution(X, gain)


def hamiltonian_riccati(A: AnyArray, G: AnyArray, Q: AnyArray, *, tolerance: float = 1e-6) -> AnyArray | None:
    """Solve ``A^T X + X A - X G X + Q = 0`` for the X with stable ``A - G X``, for searches; None if not found."""
    if not len(A):
        return np.zeros((0, 0))
    X = _stable_graph(A, G, Q)
    if X is None:
        return None

    def weighed(X: AnyArray) -> Weighed:
        with np.errstate(over="ignore", invalid="ignore"):  # NaN counts as a large residual
            linear, quadratic = A.T @ X, X @ G @ X
            size = 2 * np.linalg.norm(linear) + np.linalg.norm(Q) + np.linalg.norm(quadratic)
            left = linear + linear.T - quadratic + Q
            return A - G @ X, left, float(np.linalg.norm(left) / size) if size else 0.0

    X, residual = _refined(X, weighed)  # the first one is stable: the Schur form was ordered
    return X if residual <= tolerance else None


def _matrices(A: ArrayLike, B: ArrayLike, Q: ArrayLike, R: ArrayLike, S: ArrayLike | None) -> list[Array]:
    a, b, q, r = (np.asarray(matrix, dtype=float) for matrix in (A, B, Q, R))
    return [a, b, q, r, np.zeros(b.shape) if S is None else np.asarray(S, dtype=float)]


def _stable_graph(A: AnyArray, G: AnyArray, Q: AnyArray) -> AnyArray | None:
    """Return the X of `_schur_graph`, solved again in states that scale its diagonal to one if it spans decades."""
    # Otherwise the small entries of X have no digits, which balancing the Hamiltonian does not change.
    X = _schur_graph(A, G, Q)
    for _ in range(RESCALED):
        size = None if X is None else np.sqrt(np.abs(np.diag(X)))
        if X is None or size is None or not size.all() or size.max() < SPREAD * size.min():
            break
        t = np.exp2(-np.rint(np.log2(size)))
        with np.errstate(over="ignore", invalid="ignore"):
            again = _schur_graph(A / t[:, None] * t, G / np.outer(t, t), Q * np.outer(t, t))
        if again is None:
            break
        X = again / np.outer(t, t)
    return X


def _schur_graph(A: AnyArray, G: AnyArray, Q: AnyArray) -> AnyArray | None:
    """Return the X with ``[I; X]`` the stable subspace of ``[[A, -G], [-Q, -A^T]]`` (Laub 1979); or None."""
    n = len(A)
    hamiltonian = np.empty((2 * n, 2 * n))
    hamiltonian[:n, :n], hamiltonian[:n, n:] = A, -G
    hamiltonian[n:, :n], hamiltonian[n:, n:] = -Q, -A.T
    if not np.isfinite(hamiltonian).all():  # LAPACK may not return from NaN
        return None
    balanced, _, _, scale, _ = lapack().dgebal(hamiltonian, scale=1, permute=0)
    ordered = functools.partial(lapack().dgees, lambda re, _: re < 0, balanced)
    room = 6 * n if n <= UNBLOCKED else int(ordered(lwork=-1)[-2][0])
    _, count, _, _, z, _, info = ordered(lwork=room, sort_t=1)
    if info != 0 or count != n:
        return None
    z = scale[:, None] * z[:, :n]
    try:
        X = np.linalg.solve(z[:n].T, z[n:].T)
    except np.linalg.LinAlgError:
        return None
    return 0.5 * (X + X.T) if np.isfinite(X).all() else None


def _refined(X: AnyArray, weighed: Callable[[AnyArray], Weighed]) -> tuple[AnyArray, float]:
    """Refine the solution by Newton's steps while the residual falls (Kleinman 1968); return it with the residual."""
    # X may be wrong by tens of per cent if the eigenvalues of the Hamiltonian span ten decades.
    from scipy.linalg import LinAlgError, solve_continuous_lyapunov

    loop, left, residual = weighed(X)
    for _ in range(NEWTON_STEPS):
        if not residual > REFINED or not np.isfinite(loop).all():
            break
        with judged_afterwards():  # eigenvalues may nearly mirror each other
            try:  # scipy's: X of 16 decades loses digits in SB03MD, and levels of D-K half a percent with them
                step = solve_continuous_lyapunov(loop.T, -0.5 * (left + left.T))
            except (LinAlgError, ValueError):
                break
        better = X + 0.5 * (step + step.T)
        after = weighed(better)
        if not after[2] < residual or not _is_stable(after[0]):
            break
        X, (loop, left, residual) = better, after
    return X, residual


def _is_stable(loop: AnyArray) -> bool:
    return bool(np.isfinite(loop).all()) and np.linalg.eigvals(loop).real.max() < 0


def lyapunov(A: ArrayLike, Q: ArrayLike, discrete: bool = False, *, tolerance: float = 1e-6) -> Array:
    """Solve ``A X + X A^T + Q = 0``, or ``A X A^T - X + Q = 0`` if discrete, for a symmetric Q."""
    a, q = np.asarray(A, dtype=float), np.asarray(Q, dtype=float)
    X = slicot.lyapunov_solution(a, q, discrete)
    small_residual("lyapunov", 0.5 * (a @ X @ a.T - X) if discrete else a @ X, q, tolerance)
    return X


def small_residual(where: str, half: AnyArray, known: AnyArray, tolerance: float) -> None:
    """Refuse a solution of ``half + half^T + known = 0`` with a residual above this share of its terms."""
    size = 2 * np.linalg.norm(half) + np.linalg.norm(known)
    residual = float(np.linalg.norm(half + half.T + known) / size) if size else 0.0
    if not residual <= tolerance:
        raise NoTrustworthyNumber(where, f"relative residual {residual:.1e}", f"at most {tolerance:.1e}")


@contextmanager
def judged_afterwards() -> Iterator[None]:
    """Ignore warnings of ill-conditioned steps whose residual is checked afterwards."""
    from scipy.linalg import LinAlgWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LinAlgWarning)
        warnings.simplefilter("ignore", RuntimeWarning)
        yield


def balanced_eigenvalues(matrix: AnyArray) -> AnyArray | None:
    """Return the eigenvalues of a square matrix after balancing, shape (n,); None if it is not finite."""
    if not np.isfinite(matrix).all():
        return None
    if not matrix.size:
        return np.zeros(0)
    # The transpose has the same eigenvalues, and LAPACK's memory layout.
    real, imag, _, _, info = lapack().dgeev(matrix.T, compute_vl=0, compute_vr=0, lwork=ROOM * len(matrix))
    if info:
        raise np.linalg.LinAlgError("the QR algorithm did not converge")
    return real + 1j * imag


@functools.cache
def lapack() -> Any:
    """Return scipy's module of raw LAPACK routines, for thousands of small problems; callers check for finite input."""
    from scipy.linalg import lapack as routines

    return routines


SWEEPS = 20
# Products of entries between these neither overflow nor vanish.
FAINTEST, STRONGEST = 1e-100, 1e100


def system_matrix(m: StateSpaceModel) -> Array:
    return np.block([[m.A, m.B], [m.C, m.D]])


def of_system_matrix(
    whole: Array, n: int, dt: float, inputs: Sequence[Signal], outputs: Sequence[Signal], states: Sequence[Signal],
    where: str,
) -> StateSpaceModel:  # fmt: skip
    parts = whole[:n, :n], whole[:n, n:], whole[n:, :n], whole[n:, n:]
    return StateSpaceModel(*parts, dt, inputs, outputs, states, where=where)


def balancing_factors(matrix: AnyArray) -> AnyArray:
    """Return powers of two t (n,): rows and columns of ``matrix / t[:, None] * t`` have one size (LAPACK gebal)."""
    if not matrix.size:
        return np.ones(len(matrix))
    if not np.isfinite(matrix).all():
        raise ValueError("a matrix to be balanced has entries that are NaN or infinite")
    return np.asarray(lapack().dgebal(np.abs(matrix), scale=1, permute=0)[3])


def balancing_exponents(A: AnyArray, into: AnyArray, out: AnyArray) -> AnyArray:
    """Return exponents t (n,) of states ``x = 2^t x'`` that balance rows of [A, into] against columns of [A; out]."""
    n = len(A)
    a, b, c = _exponents(A), _exponents(into).max(1, initial=-np.inf), _exponents(out).max(0, initial=-np.inf)
    off, t = np.where(np.eye(n, dtype=bool), -np.inf, a), np.zeros(n)
    for _ in range(SWEEPS):
        k, w, z = _top(a - t[:, None] + t), _top(b - t), _top(c + t)
        settled = True
        for i in range(n):
            row = max((off[i] + t).max() - t[i] - k, b[i] - t[i] - w)
            column = max((off[:, i] - t).max() + t[i] - k, c[i] + t[i] - z)
            if row == -np.inf and column == -np.inf:
                continue
            step = row if column == -np.inf else -column if row == -np.inf else 0.5 * (row - column)
            step = float(np.round(step))
            t[i] += step
            settled &= abs(step) <= 1
        if settled:
            break
    return t.astype(int)


def equilibrating_exponents(matrix: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Return exponents r, c: the largest entries of rows and columns of ``2^r matrix 2^c`` are near 1 (Ruiz 2001)."""
    e, r, c = _exponents(np.abs(matrix)), np.zeros((len(matrix), 1)), np.zeros(matrix.shape[1])
    for _ in range(SWEEPS):
        now = e + r + c
        row, column = now.max(axis=1, initial=-np.inf, keepdims=True), now.max(axis=0, initial=-np.inf)
        r, c = r - 0.5 * np.where(np.isfinite(row), row, 0), c - 0.5 * np.where(np.isfinite(column), column, 0)
    return np.round(r[:, 0]).astype(int), np.round(c).astype(int)


def refuse_extremes(model: StateSpaceModel, where: str) -> None:
    """Refuse models whose entries are too large or too small to be multiplied with one another."""
    for matrix in (model.A, model.B, model.C, model.D):
        top = float(np.abs(matrix).max(initial=0.0))
        if top and not FAINTEST < top < STRONGEST:
            found, expected = f"the largest entry of a matrix of the model is {top:.0e}", "between 1e-100 and 1e100"
            raise NoTrustworthyNumber(where, found, expected, "choose other units of signals or time")


def refuse_overflow(where: str, *arrays: AnyArray) -> None:
    if not all(np.isfinite(array).all() for array in arrays):
        hint = "choose units in which the model's entries are closer to one another"
        raise NoTrustworthyNumber(where, "a product of the model's entries overflows", "numbers below 1e308", hint)


def _exponents(matrix: AnyArray) -> AnyArray:
    return np.where(matrix == 0, -np.inf, np.frexp(matrix)[1])


def _top(exponents: AnyArray) -> int:
    top = exponents.max(initial=-np.inf)
    return int(top) if np.isfinite(top) else 0
