"""State feedback by Riccati equation or pole placement; closed loops are verified."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import AnyArray
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.linear_analysis.magnitude import balancing_exponents, is_moderate, refuse_overflow
from robustlab.linear_analysis.matrix_equations import RiccatiSolution, care, dare
from robustlab.linear_analysis.structural import controllability
from robustlab.result import Status
from robustlab.shown import Facts, Shown, listed, number
from robustlab.signals import Signal, Taken
from robustlab.statespace import StateSpaceModel, as_model, real_array
from robustlab.synthesis.problem.controller import Controller
from robustlab.synthesis.problem.rebuilt_loop import surely_stable

__all__ = [
    "StateFeedback",
    "checked_weight",
    "lqr",
    "place",
    "require_definite",
    "require_semidefinite",
    "semidefinite_root",
]


# Eigenvalues of a weight below this share of its largest count as zero.
RANK = 1e-13
# Placed poles may miss their places by this share of the largest of them.
PLACED = 1e-6


@dataclass(frozen=True, eq=False)
class StateFeedback(Shown):
    r"""A gain ``u = -K x`` with the loop that it closes.

    Attributes
    ----------
    K
        Shape (n_u, n_x).
    poles
        Eigenvalues of ``A - B K`` as they came out, in rad/s, or in the z plane.
    status
        CONVERGED where the poles are where they should be; INACCURATE where they miss their places.
    reason
        How well.
    X
        Solution of the Riccati equation: the optimal cost from the state x is ``x^T X x``; None for pole placement.
    """

    quantities: ClassVar[Mapping[str, Any]] = {"K": [[float]], "poles": [{"re": float, "im": float}], "X": [[float]]}

    K: AnyArray
    poles: AnyArray
    status: Status
    reason: str
    X: AnyArray | None = None
    states: tuple[Signal, ...] = ()  # of the model, which the controller takes by name
    inputs: tuple[Signal, ...] = ()
    dt: float = 0.0

    # Why it is no controller by itself: it does not know the names of the states.
    no_model: ClassVar[str] = "u = -K x: give its K, a matrix, and sign=-1, around a model with the states as outputs"

    @property
    def controller(self) -> Controller:
        """``u = -K x`` as a controller that takes the states by name; the minus is within it."""
        gain = StateSpaceModel([], [], [], -self.K, self.dt, [Taken(*x) for x in self.states], self.inputs)
        return Controller(gain, None, self.status, "lqr")

    def headline(self) -> str:
        """What is fed back."""
        return f"{self.K.shape[1]} states fed back to {self.K.shape[0]} controls"

    def facts(self) -> Facts:
        """What a person wants to read, as (label, text)."""
        return [
            ("gain", f"{self.K.shape[0]} controls, {self.K.shape[1]} states"),
            ("poles", listed(number(complex(p) if p.imag else float(p.real)) for p in self.poles)),
            ("how well", self.reason),
        ]

    def to_json(self) -> dict[str, Any]:
        """All attributes."""
        names = ("K", "poles", "status", "reason", "X")
        return {"type": "StateFeedback", **{name: getattr(self, name) for name in names}}


def _signals(g: StateSpaceModel) -> tuple[tuple[Signal, ...], tuple[Signal, ...], float]:
    return g.states, g.inputs, g.dt


@told_as("lqr")
def lqr(G: Any, Q: ArrayLike, R: ArrayLike, N: ArrayLike | None = None) -> StateFeedback:
    r"""Linear-quadratic regulator ``u = -K x``, as in python-control and MATLAB.

    .. math:: \min \int x^T Q x + u^T R u + 2 x^T N u \, dt \qquad\text{or}\qquad \min \sum_k x_k^T Q x_k + ...

    Parameters
    ----------
    G
        Model with n_x states and n_u inputs, continuous or discrete; only A and B matter.
    Q, R, N
        Shapes (n_x, n_x), (n_u, n_u), (n_x, n_u). ``[Q N; N^T R]`` symmetric positive semidefinite; R positive definite
        in continuous time.

    Returns
    -------
    StateFeedback
        With the Riccati solution X; its loop is stable beyond rounding.

    Raises
    ------
    InputError
        Weights that are not symmetric, not semidefinite, of the wrong size, or a singular R in continuous time (the
        control that costs nothing is named).
    NoTrustworthyNumber
        A mode that the inputs cannot stabilise (named), or one on the stability boundary that costs nothing.

    Examples
    --------
    >>> integrators = StateSpaceModel([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], [[0]])
    >>> lqr(integrators, np.diag([1.0, 0.0]), [[1.0]]).K.round(6).tolist()
    [[1.0, 1.414214]]
    """
    g = as_model(G, "lqr: G")
    n, m = g.n_states, g.n_inputs
    q = checked_weight("lqr: Q", Q, n)
    r = checked_weight("lqr: R", R, m)
    s = np.zeros((n, m)) if N is None else real_array("N", N, 2, "lqr")
    if s.shape != (n, m):
        raise InputError("lqr: N", f"shape {s.shape}", f"{(n, m)}")
    if not g.is_discrete:
        require_definite("lqr: R", r, [f"control {name} costs nothing" for name in g.input_names])
    require_semidefinite("lqr: [Q N; N' R]", np.block([[q, s], [s.T, r]]))
    try:
        found: RiccatiSolution = (dare if g.is_discrete else care)(g.A, g.B, q, r, s)
    except NoTrustworthyNumber as error:
        raise NoTrustworthyNumber("lqr", *_unsolvable(g, error)) from None
    K = -found.gain
    loop = _closed(g, K)
    if not surely_stable(loop):
        raise NoTrustworthyNumber("lqr", "the closed loop is not surely stable: a pole lies on the stability boundary")
    return StateFeedback(
        K, loop.poles(), Status.CONVERGED, f"stable; Riccati residual {found.residual:.1e}", found.X, *_signals(g)
    )


@told_as("place")
def place(G: Any, poles: Sequence[complex] | ArrayLike) -> StateFeedback:
    r"""State feedback ``u = -K x`` that puts the eigenvalues of ``A - B K`` where they are wanted.

    With several inputs the freedom left is used for well-conditioned eigenvectors (Kautsky, Nichols, Van Dooren 1985;
    Yang, Tits 1996; scipy).

    Parameters
    ----------
    G
        Model with n_x states, continuous or discrete; only A and B matter.
    poles
        n_x numbers in rad/s (dt = 0) or in the z plane; complex ones in conjugate pairs; none more often than B has
        independent columns.

    Returns
    -------
    StateFeedback
        Without X; INACCURATE where the poles miss their places.

    Raises
    ------
    InputError
        A wrong number of poles, no conjugate pairs, unstable poles, a pole wanted too often, or modes that the inputs
        do not move (named).
    NoTrustworthyNumber
        The method broke down.

    Examples
    --------
    >>> integrators = StateSpaceModel([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], [[0]])
    >>> place(integrators, [-1 + 1j, -1 - 1j]).K.round(9).tolist()
    [[2.0, 2.0]]
    """
    from scipy.signal import place_poles

    g = as_model(G, "place: G")
    wanted = _wanted(g, poles)
    if not g.n_states:
        return StateFeedback(np.zeros((g.n_inputs, 0)), wanted, Status.CONVERGED, "no states", None, *_signals(g))
    test = controllability(g)
    if not test.complete:
        modes = "; ".join(mode.meaning for mode in test.modes)
        raise InputError("place", f"the inputs do not move every mode: {modes}", "a controllable model")
    a, b, back = _ordinary(g)
    independent = int(np.linalg.matrix_rank(b))
    values, counts = np.unique(wanted, return_counts=True)
    if counts.max() > independent:
        raise InputError(
            "place",
            f"pole {values[counts.argmax()]:.6g} is wanted {counts.max()} times",
            f"at most {independent} times, as many as B has independent columns",
            "move them a little apart",
        )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # slow convergence: the poles that came out are compared below
        try:
            placed: Any = place_poles(a, b, wanted)
        except (ValueError, np.linalg.LinAlgError) as error:
            raise NoTrustworthyNumber("place", f"the method broke down: {error}") from None
    with np.errstate(over="ignore", under="ignore"):
        K = np.ascontiguousarray(np.ldexp(np.real(placed.gain_matrix), back))
    refuse_overflow("place", K)
    reached = _closed(g, K).poles()
    miss = _largest_distance(reached, wanted)
    size = max(float(np.abs(wanted).max()), 1e-300)
    status = Status.CONVERGED if miss <= PLACED * size else Status.INACCURATE
    reason = f"poles miss their places by {miss / size:.1e} of the largest at most"
    return StateFeedback(K, reached, status, reason, None, *_signals(g))


# --- checks ----------------------------------------------------------------------------------------------------------


def checked_weight(where: str, given: ArrayLike, n: int) -> AnyArray:
    """A symmetric matrix of n rows; ``where`` is ``"function: name"``."""
    matrix = real_array(where.rsplit(": ", 1)[-1], given, 2, where.split(":", 1)[0])
    if matrix.shape != (n, n):
        raise InputError(where, f"shape {matrix.shape}", f"{(n, n)}")
    if np.abs(matrix - matrix.T).max(initial=0.0) > 1e-12 * np.abs(matrix).max(initial=0.0):
        raise InputError(where, "not symmetric", "a symmetric matrix", "take (M + M.T) / 2")
    return 0.5 * (matrix + matrix.T)


def require_semidefinite(where: str, matrix: AnyArray) -> None:
    """Refuse a symmetric matrix with a negative eigenvalue."""
    values = np.linalg.eigvalsh(matrix)
    if len(values) and values[0] < -RANK * len(values) * max(float(np.abs(values).max()), 1e-300):
        raise InputError(where, f"eigenvalue {values[0]:.3g}", "a positive semidefinite matrix")


def require_definite(where: str, matrix: AnyArray, meanings: list[str]) -> None:
    """Refuse a symmetric matrix that is not positive definite; ``meanings`` says what each row stands for."""
    values, vectors = np.linalg.eigh(matrix)
    if len(values) and values[0] <= RANK * max(float(values[-1]), 0.0):
        worst = int(np.argmax(np.abs(vectors[:, 0])))
        word = "singular" if values[0] > -RANK * max(float(np.abs(values).max()), 1e-300) else "indefinite"
        hint = "robustlab.h2 solves such problems, by regularisation with its cost reported"
        raise InputError(where, f"{word}: {meanings[worst]}", "a positive definite matrix", hint)


def semidefinite_root(matrix: AnyArray) -> AnyArray:
    """F with ``F^T F = matrix``, as many rows as its rank, at least one."""
    values, vectors = np.linalg.eigh(matrix)
    kept = values > RANK * max(float(values.max(initial=0.0)), 0.0)
    if not kept.any():
        return np.zeros((1, len(matrix)))
    return np.sqrt(values[kept])[:, None] * vectors[:, kept].T


def _closed(g: StateSpaceModel, K: AnyArray) -> StateSpaceModel:
    return StateSpaceModel(g.A - g.B @ K, g.B, np.eye(g.n_states), np.zeros((g.n_states, g.n_inputs)), g.dt)


def _ordinary(g: StateSpaceModel) -> tuple[AnyArray, AnyArray, NDArray[np.int64]]:
    """A and B in states and controls of order one where their entries are extreme, and the exponents of K that undo it.

    ``K = 2^w K' T^-1`` for ``x = T x'``, ``u = 2^w u'``.
    """
    if is_moderate(g.A, g.B):
        return g.A, g.B, np.zeros((g.n_inputs, g.n_states), dtype=int)
    t = balancing_exponents(g.A, g.B, np.zeros((0, g.n_states)))
    w = -int((np.frexp(g.B)[1] - t[:, None])[g.B != 0].max()) if g.B.any() else 0
    with np.errstate(over="ignore", under="ignore"):
        return np.ldexp(g.A, t - t[:, None]), np.ldexp(g.B, w - t[:, None]), np.tile(w - t, (g.n_inputs, 1))


def _unsolvable(g: StateSpaceModel, error: NoTrustworthyNumber) -> tuple[str, str]:
    with np.errstate(over="ignore", invalid="ignore"):
        refuse_overflow("lqr", g.B @ g.B.T)
    modes = controllability(g).unstable_modes
    if modes:
        return f"no stabilising gain exists: {modes[0].meaning}", "a stabilisable model"
    return f"{error.found}; a mode there may cost nothing in Q", "a cost that sees every mode on the boundary"


def _wanted(g: StateSpaceModel, poles: Any) -> AnyArray:
    try:
        wanted = np.atleast_1d(np.asarray(poles, dtype=complex)).ravel()
    except (TypeError, ValueError):
        raise InputError("place: poles", f"{poles!r}", "complex numbers") from None
    if len(wanted) != g.n_states or not np.isfinite(wanted).all():
        raise InputError("place: poles", f"{len(wanted)} poles", f"{g.n_states} finite numbers, one for each state")
    if not np.allclose(np.sort_complex(wanted), np.sort_complex(wanted.conj()), rtol=1e-12, atol=0):
        raise InputError("place: poles", "a complex pole without its conjugate", "conjugate pairs")
    unstable = np.abs(wanted) >= 1 if g.is_discrete else np.real(wanted) >= 0
    if unstable.any():
        region = "inside the unit circle" if g.is_discrete else "in the open left half plane"
        raise InputError("place: poles", f"{wanted[unstable][0]:.6g} is not stable", f"poles {region}")
    return wanted


def _largest_distance(one: AnyArray, other: AnyArray) -> float:
    """Largest distance in the best matching of two sets of equally many points."""
    from scipy.optimize import linear_sum_assignment

    distance = np.abs(one[:, None] - other)
    return float(distance[linear_sum_assignment(distance)].max())
