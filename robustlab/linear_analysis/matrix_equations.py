r"""Riccati and Lyapunov equations, continuous and discrete: finite input in, residual-checked solution out.

One kernel, the ordered real Schur form of a balanced Hamiltonian (Laub 1979), stands behind the continuous Riccati
equations; the QZ algorithm on the balanced extended pencil (Van Dooren 1981; scipy) is the second voice there and the
only one in discrete time. Newton's method (Kleinman 1968) refines what the Schur vectors leave, and every solution is
judged by its residual and by the stability of its loop.

This is also the one door to LAPACK's own routines (`lapack`).
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import AnyArray, Array
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.linear_analysis.magnitude import refuse_overflow
from robustlab.shown import AllFields, Facts, Shown, in_words, number
from robustlab.statespace import real_array

# Relative residual from which on a Riccati solution is refined by Newton's method, and how many steps it gets.
REFINED, NEWTON_STEPS = 1e-10, 4
# Ratio of the states' sizes in a solution from which on it is solved again in other units, and how often.
SPREAD, RESCALED = 1e4, 3
# Up to this many states LAPACK works without blocks, and asking how much room it would like takes longer than it saves.
UNBLOCKED = 32
# Room for LAPACK's work on a matrix with blocks, in columns of it.
ROOM = 64
SOLVABLE = "a stabilisable model, and no eigenvalue there"
MIRRORED = "no unique solution: eigenvalues mirror each other"


# --- Riccati equations -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class RiccatiSolution(Shown, AllFields):
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

    def facts(self) -> Facts:
        residual = number(self.residual, digits=2)
        return [("X", in_words(self.X)), ("gain", in_words(self.gain)), ("relative residual", residual)]


@told_as("care")
def care(
    A: ArrayLike, B: ArrayLike, Q: ArrayLike, R: ArrayLike, S: ArrayLike | None = None, *, tolerance: float = 1e-6
) -> RiccatiSolution:
    r"""Stabilising solution of the continuous-time algebraic Riccati equation.

    .. math:: A^T X + X A + Q - (X B + S) R^{-1} (B^T X + S^T) = 0, \qquad A - B R^{-1} (B^T X + S^T) \text{ stable}

    R is symmetric and invertible and may be indefinite, as in H-infinity synthesis.

    Notes
    -----
    First the ordered Schur form, the quicker one; then the extended pencil, which does not invert R. Newton's method
    refines what either leaves; the smaller residual wins.

    Examples
    --------
    >>> float(round(care([[0.0]], [[1.0]], [[1.0]], [[1.0]]).X[0, 0], 12))
    1.0
    """
    equation = _equation("care", A, B, Q, R, S)
    if not len(equation.a):
        return equation.without_states()
    best: _Candidate | None = None
    solvers: tuple[Callable[[_Equation], AnyArray | None], ...] = (_ordered_schur, _extended_pencil)
    for solve in solvers:
        X = solve(equation)
        if X is None:
            continue
        found = _refined(equation.judged(0.5 * (X + X.T)), equation.judged)
        if found is not None and (best is None or found.residual < best.residual):
            best = found
        if best is not None and best.residual <= tolerance:
            return RiccatiSolution(best.X, equation.gain(best.X), best.residual)
    if best is None:
        with np.errstate(over="ignore", invalid="ignore"):
            refuse_overflow("care", equation.b @ equation.b.T, equation.q @ equation.q, equation.s @ equation.s.T)
        raise NoTrustworthyNumber("care", f"no stabilising solution was found; {_nearest_to_axis(equation)}", SOLVABLE)
    raise NoTrustworthyNumber("care", f"relative residual {best.residual:.1e}", f"at most {tolerance:.1e}")


@told_as("dare")
def dare(
    A: ArrayLike, B: ArrayLike, Q: ArrayLike, R: ArrayLike, S: ArrayLike | None = None, *, tolerance: float = 1e-6
) -> RiccatiSolution:
    """Stabilising solution of the discrete-time algebraic Riccati equation.

    .. math:: A^T X A - X + Q - (A^T X B + S) (R + B^T X B)^{-1} (B^T X A + S^T) = 0

    with ``A + B F`` stable for the gain ``F = -(R + B^T X B)^-1 (B^T X A + S^T)``. R is symmetric and may be singular.

    Examples
    --------
    >>> float(round(dare([[1.0]], [[1.0]], [[1.0]], [[1.0]]).X[0, 0], 12))
    1.61803398875
    """
    equation = _equation("dare", A, B, Q, R, S)
    if not len(equation.a):
        return equation.without_states()
    a, b, q, r, s = equation.a, equation.b, equation.q, equation.r, equation.s
    none = NoTrustworthyNumber("dare", f"no stabilising solution was found; {_nearest_to_circle(equation)}", SOLVABLE)
    X = _extended_pencil(equation, discrete=True)
    if X is None:
        raise none
    with np.errstate(over="ignore", invalid="ignore"):
        X = 0.5 * (X + X.T)
        coupling = b.T @ X @ a + s.T
        try:
            gain = -np.linalg.solve(r + b.T @ X @ b, coupling)
        except np.linalg.LinAlgError:
            raise none from None
    if not np.isfinite(X).all() or not np.isfinite(gain).all() or np.abs(np.linalg.eigvals(a + b @ gain)).max() >= 1:
        raise none
    residual = accepted_residual("dare", (a.T @ X @ a, -X, q, coupling.T @ gain), tolerance)
    return RiccatiSolution(X, gain, residual)


def hamiltonian_riccati(A: AnyArray, G: AnyArray, Q: AnyArray, *, tolerance: float = 1e-6) -> AnyArray | None:
    r"""Stabilising solution of a Riccati equation with its quadratic term given whole: the inner loop of searches.

    .. math:: A^T X + X A - X G X + Q = 0, \qquad A - G X \text{ stable}

    Examples
    --------
    >>> one = np.eye(1)
    >>> float(np.round(hamiltonian_riccati(0 * one, one, 4 * one)[0, 0], 12))
    2.0
    """

    def weighed(X: AnyArray) -> _Candidate:
        with np.errstate(over="ignore", invalid="ignore"):  # NaN is no small residual
            linear, quadratic = A.T @ X, X @ G @ X
            size = 2 * np.linalg.norm(linear) + np.linalg.norm(Q) + np.linalg.norm(quadratic)
            left = linear + linear.T - quadratic + Q
            return _Candidate(X, A - G @ X, left, float(np.linalg.norm(left) / size) if size else 0.0)

    def judged(X: AnyArray) -> _Candidate | None:
        found = weighed(X)
        stable = np.isfinite(found.loop).all() and np.linalg.eigvals(found.loop).real.max() < 0
        return found if stable else None

    if not len(A):
        return np.zeros((0, 0))
    X = _stable_graph(A, G, Q)
    found = None if X is None else _refined(weighed(X), judged)  # stable at first: the Schur form was ordered
    return found.X if found is not None and found.residual <= tolerance else None


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A symmetric X with the loop that it closes, the left-hand side of its equation, and the relative residual."""

    X: AnyArray
    loop: AnyArray
    left: AnyArray
    residual: float


@dataclass(frozen=True, eq=False)
class _Equation:
    """The matrices of a Riccati equation, checked."""

    a: Array
    b: Array
    q: Array
    r: Array
    s: Array

    def without_states(self) -> RiccatiSolution:
        return RiccatiSolution(np.zeros((0, 0)), np.zeros((len(self.r), 0)), 0.0)

    def gain(self, X: AnyArray) -> AnyArray:
        """That of the continuous equation."""
        return -np.linalg.solve(self.r, self.b.T @ X + self.s.T)

    def judged(self, X: AnyArray) -> _Candidate | None:
        """The candidate of the continuous equation; None where it does not stabilise."""
        a, b, q, s = self.a, self.b, self.q, self.s
        with np.errstate(over="ignore", invalid="ignore"):
            try:
                gain = self.gain(X)
            except np.linalg.LinAlgError:
                return None
            loop = a + b @ gain
            if not np.isfinite(loop).all() or np.linalg.eigvals(loop).real.max() >= 0:
                return None
            quadratic = (X @ b + s) @ gain
            size = 2 * np.linalg.norm(a.T @ X) + np.linalg.norm(q) + np.linalg.norm(quadratic)
            left = a.T @ X + X @ a + q + quadratic
            residual = float(np.linalg.norm(left) / size) if size else 0.0
        return _Candidate(X, loop, left, residual) if np.isfinite(residual) else None


def _equation(where: str, A: ArrayLike, B: ArrayLike, Q: ArrayLike, R: ArrayLike, S: ArrayLike | None) -> _Equation:
    a, b, q, r = (real_array(k, v, 2, where) for k, v in (("A", A), ("B", B), ("Q", Q), ("R", R)))
    n, m = len(a), len(r)
    s = np.zeros((n, m)) if S is None else real_array("S", S, 2, where)
    check_shapes(where, A=(a, (n, n)), B=(b, (n, m)), Q=(q, (n, n)), R=(r, (m, m)), S=(s, (n, m)))
    return _Equation(a, b, q, r, s)


def check_shapes(where: str, **wanted: tuple[Array, tuple[int, int]]) -> None:
    """Raises InputError: a matrix that has not the shape beside it."""
    for name, (matrix, shape) in wanted.items():
        if matrix.shape != shape:
            raise InputError(where, f"{name} is {matrix.shape}", f"{shape}")


def _ordered_schur(equation: _Equation) -> AnyArray | None:
    a, b, q, s = equation.a, equation.b, equation.q, equation.s
    try:
        ri = np.linalg.inv(equation.r)
    except np.linalg.LinAlgError:
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        return _stable_graph(a - b @ ri @ s.T, b @ ri @ b.T, q - s @ ri @ s.T)


def _nearest_to_axis(equation: _Equation) -> str:
    a, b, q, s = equation.a, equation.b, equation.q, equation.s
    try:
        inverse = np.linalg.inv(equation.r)
    except np.linalg.LinAlgError:
        return "R is singular"
    with np.errstate(over="ignore", invalid="ignore"):
        A, G, Q = a - b @ inverse @ s.T, b @ inverse @ b.T, q - s @ inverse @ s.T
        poles = balanced_eigenvalues(np.block([[A, -G], [-Q, -A.T]]))
    if poles is None:
        return "the entries of the Hamiltonian overflow"
    nearest = poles[np.abs(np.real(poles)).argmin()]
    return f"the eigenvalue of the Hamiltonian nearest to the imaginary axis is {nearest:.3g} rad/s"


def _nearest_to_circle(equation: _Equation) -> str:
    from scipy.linalg import eigvals

    a, b, q, r, s = equation.a, equation.b, equation.q, equation.r, equation.s
    n, m, zero = len(a), len(r), np.zeros
    left = np.block([[a, zero((n, n)), b], [-q, np.eye(n), -s], [s.T, zero((m, n)), r]])
    right = np.block(
        [[np.eye(n), zero((n, n + m))], [zero((n, n)), a.T, zero((n, m))], [zero((m, n)), -b.T, zero((m, m))]]
    )
    alpha, beta = np.abs(eigvals(left, right, homogeneous_eigvals=True))
    with np.errstate(divide="ignore", invalid="ignore"):
        moduli = alpha / beta  # infinite ones are part of a pencil, 0 / 0 makes it singular
        far = np.abs(np.log(moduli))
    if np.isnan(far).any():
        return "the pencil is singular"
    return f"the eigenvalue of the pencil nearest to the unit circle has the modulus {moduli[far.argmin()]:.9g}"


def _stable_graph(A: AnyArray, G: AnyArray, Q: AnyArray) -> AnyArray | None:
    """Return the X of `_schur_graph`, solved again in states that bring its diagonal to one where it spans decades.

    The Schur vectors are known to eps times the norm of the Hamiltonian: of X from 1 to 1e16 no digit of the small
    entries is left, and balancing the Hamiltonian alone does not see that.
    """
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
    """Symmetric X whose graph ``[I; X]`` is the stable subspace of the Hamiltonian ``[[A, -G], [-Q, -A^T]]``.

    Laub 1979: ordered real Schur form of the balanced Hamiltonian. None where as many eigenvalues as states are not
    stable, or the subspace is no graph.
    """
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


def _extended_pencil(equation: _Equation, discrete: bool = False) -> AnyArray | None:
    """X from the QZ algorithm on the balanced extended pencil (Van Dooren 1981); None where there is none."""
    from scipy.linalg import LinAlgError, solve_continuous_are, solve_discrete_are

    solve = solve_discrete_are if discrete else solve_continuous_are
    with judged_afterwards():
        try:
            X = solve(equation.a, equation.b, equation.q, equation.r, s=equation.s)
        except (LinAlgError, ValueError):  # ValueError: R is singular to working precision
            return None
    return X if np.isfinite(X).all() else None


def _refined(found: _Candidate | None, judged: Callable[[AnyArray], _Candidate | None]) -> _Candidate | None:
    """The solution after Newton's steps ``A_X^T dX + dX A_X + left = 0``, as long as they help (Kleinman 1968).

    The Schur vectors of a Hamiltonian are known to eps times its norm; where its eigenvalues span ten decades X may
    be wrong by tens of per cent while the relative residual is 1e-3. Newton converges quadratically from there.
    """
    for _ in range(NEWTON_STEPS):
        if found is None or found.residual <= REFINED:
            break
        step = _newton_step(found.loop, found.left)
        after = None if step is None else judged(found.X + step)
        if after is None or not after.residual < found.residual:
            break
        found = after
    return found


def _newton_step(loop: AnyArray, left: AnyArray) -> AnyArray | None:
    """Symmetric dX with ``loop^T dX + dX loop + left = 0``; None where there is none."""
    from scipy.linalg import LinAlgError, solve_continuous_lyapunov

    with judged_afterwards():  # eigenvalues may nearly mirror each other
        try:
            step = solve_continuous_lyapunov(loop.T, -0.5 * (left + left.T))
        except (LinAlgError, ValueError):
            return None
    return 0.5 * (step + step.T) if np.isfinite(step).all() else None


# --- Lyapunov equations ----------------------------------------------------------------------------------------------


def lyapunov(A: ArrayLike, Q: ArrayLike, discrete: bool = False, *, tolerance: float = 1e-6) -> AnyArray:
    r"""Solution X of the Lyapunov equation, shape (n, n).

    .. math:: A X + X A^T + Q = 0 \qquad\text{or, discrete,}\qquad A X A^T - X + Q = 0

    Examples
    --------
    >>> float(lyapunov([[-0.5]], [[2.0]])[0, 0])
    2.0
    """
    from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

    a, q = real_array("A", A, 2, "lyapunov"), real_array("Q", Q, 2, "lyapunov")
    n = a.shape[0]
    check_shapes("lyapunov", A=(a, (n, n)), Q=(q, (n, n)))
    if n == 0:
        return np.zeros((0, 0))
    poles = np.linalg.eigvals(a)
    with np.errstate(over="ignore", invalid="ignore"):
        apart = np.multiply.outer(poles, poles) - 1 if discrete else np.add.outer(poles, poles)
    size = float(np.abs(poles).max() if not discrete else 1.0)
    X = unique_solution(
        "lyapunov", apart, size, lambda: solve_discrete_lyapunov(a, q) if discrete else solve_continuous_lyapunov(a, -q)
    )
    accepted_residual("lyapunov", (a @ X @ a.T, -X, q) if discrete else (a @ X, X @ a.T, q), tolerance)
    return X


def unique_solution(where: str, apart: AnyArray, size: float, solve: Callable[[], AnyArray]) -> AnyArray:
    """What ``solve`` gives of a linear matrix equation; ``apart`` is 0 where two eigenvalues mirror each other."""
    # LAPACK moves eigenvalues that mirror each other apart and answers with a huge X of small residual: refuse before.
    with np.errstate(over="ignore", invalid="ignore"):
        gap = np.abs(apart).min()
    if gap <= 10 * np.finfo(float).eps * size:
        raise NoTrustworthyNumber(where, MIRRORED)
    with judged_afterwards():
        try:
            X = np.asarray(solve())
        except (np.linalg.LinAlgError, ValueError):
            raise NoTrustworthyNumber(where, MIRRORED) from None
    if not np.isfinite(X).all():
        raise NoTrustworthyNumber(where, "the solution is not finite")
    return X


# --- judging, and the door to LAPACK ---------------------------------------------------------------------------------


def small_residual(where: str, half: AnyArray, known: AnyArray, tolerance: float) -> None:
    """Refuse the solution of ``half + half^T + known = 0`` that leaves more than this share of its terms."""
    size = 2 * np.linalg.norm(half) + np.linalg.norm(known)
    residual = float(np.linalg.norm(half + half.T + known) / size) if size else 0.0
    if not residual <= tolerance:
        raise NoTrustworthyNumber(where, f"relative residual {residual:.1e}", f"at most {tolerance:.1e}")


def accepted_residual(where: str, terms: tuple[AnyArray, ...], tolerance: float) -> float:
    """Norm of the sum of an equation's terms, relative to the sum of their norms."""
    refuse_overflow(where, *terms)
    # Squares of entries overflow or vanish long before the entries do: a power of two first, which costs no digit.
    top = max((float(np.abs(term).max(initial=0.0)) for term in terms), default=0.0)
    scaled = [np.ldexp(term, -int(np.frexp(top)[1])) for term in terms]
    size = sum(np.linalg.norm(term) for term in scaled)
    residual = float(np.linalg.norm(sum(scaled)) / size) if size else 0.0
    if not residual <= tolerance:
        raise NoTrustworthyNumber(where, f"relative residual {residual:.1e}", f"at most {tolerance:.1e}")
    return residual


@contextmanager
def judged_afterwards() -> Iterator[None]:
    """An ill-conditioned step is judged by the residual after it, not by a warning."""
    from scipy.linalg import LinAlgWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LinAlgWarning)
        warnings.simplefilter("ignore", RuntimeWarning)
        yield


def balanced_eigenvalues(matrix: AnyArray) -> AnyArray | None:
    """Eigenvalues of a square matrix after balancing, shape (n,); None where it is not finite."""
    if not np.isfinite(matrix).all():
        return None
    if not matrix.size:
        return np.zeros(0)
    # Those of the transpose are the same, and it lies in memory as LAPACK wants it.
    real, imag, _, _, info = lapack().dgeev(matrix.T, compute_vl=0, compute_vr=0, lwork=ROOM * len(matrix))
    if info:
        raise np.linalg.LinAlgError("the QR algorithm did not converge")
    return real + 1j * imag


@functools.cache
def lapack() -> Any:
    """The module of raw LAPACK routines, without the checks and copies of their usual fronts.

    For loops of thousands of small problems; callers check that what they hand over is finite.
    """
    from scipy.linalg import lapack as routines

    return routines
