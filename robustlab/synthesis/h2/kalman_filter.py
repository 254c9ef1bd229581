"""Steady-state Kalman filter: its gain by a Riccati equation, its error covariance again by a Lyapunov equation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import AnyArray
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.linear_analysis.magnitude import refuse_overflow
from robustlab.linear_analysis.matrix_equations import RiccatiSolution, care, dare, lyapunov
from robustlab.linear_analysis.structural import observability
from robustlab.result import Status
from robustlab.shown import Facts, Shown, listed, number
from robustlab.statespace import Signal, StateSpaceModel, as_model, real_array
from robustlab.synthesis.h2.state_feedback import checked_weight, require_definite, require_semidefinite
from robustlab.synthesis.problem.rebuilt_loop import surely_stable

__all__ = ["KalmanFilter", "kalman"]

# Covariances by the Riccati and by the Lyapunov equation may differ by this share of their largest entry.
AGREE = 1e-6


@dataclass(frozen=True, eq=False)
class KalmanFilter(Shown):
    r"""A steady-state Kalman filter with its evidence.

    Attributes
    ----------
    L
        Gain, shape (n_x, n_y): :math:`\dot{\hat x} = A \hat x + B u + L (y - C \hat x - D u)`.
    P
        Covariance of the error ``x - xhat``, shape (n_x, n_x), from the Riccati equation; in discrete time that of the
        prediction ``xhat_{k|k-1}``.
    estimator
        The filter as a model: inputs u and y, outputs the estimated states.
    poles
        Its poles, the eigenvalues of ``A - L C``.
    status
        CONVERGED where the error dynamics are stable beyond rounding and their own Lyapunov equation gives P again to
        1e-6; else INACCURATE.
    reason
        By how much the two covariances differ, and the Riccati residual.
    """

    quantities: ClassVar[Mapping[str, Any]] = {
        "L": [[float]], "poles": [{"re": float, "im": float}], "deviations": {"*": float},
    }  # fmt: skip

    L: AnyArray
    P: AnyArray
    estimator: StateSpaceModel
    poles: AnyArray
    status: Status
    reason: str

    @property
    def deviations(self) -> dict[str, float]:
        """Standard deviation of the error of each state."""
        return dict(zip(self.estimator.state_names, np.sqrt(np.maximum(np.diag(self.P), 0.0)), strict=True))

    def facts(self) -> Facts:
        """What a person wants to read, as (label, text)."""
        deviations = np.sqrt(np.maximum(np.diag(self.P), 0.0))
        return [
            ("gain", f"{self.L.shape[0]} states, {self.L.shape[1]} measurements"),
            ("poles", listed(number(complex(p)) for p in self.poles)),
            ("standard deviation of the error", listed(number(float(x)) for x in deviations)),
            ("how well", self.reason),
        ]

    def to_json(self) -> dict[str, Any]:
        """All attributes."""
        return {"type": "KalmanFilter", **vars(self)}


@told_as("kalman")
def kalman(G: Any, W: ArrayLike, V: ArrayLike, N: ArrayLike | None = None) -> KalmanFilter:
    r"""Steady-state Kalman filter, also known as linear-quadratic estimator.

    .. math:: \dot x = A x + B u + w, \quad y = C x + D u + v, \qquad
        A P + P A^T + W - (P C^T + N) V^{-1} (C P + N^T) = 0, \quad L = (P C^T + N) V^{-1}

    for white noises w, v of intensities W, V and cross-intensity N. In discrete time W, V, N are covariances, the
    filter predicts: ``xhat_{k+1} = A xhat_k + B u_k + L (y_k - C xhat_k - D u_k)`` with
    ``L = (A P C^T + N) (C P C^T + V)^-1``.

    Parameters
    ----------
    G
        Model with n_x states and n_y outputs, continuous or discrete.
    W, V, N
        Shapes (n_x, n_x), (n_y, n_y), (n_x, n_y); N is zero where left out. ``[W N; N^T V]`` symmetric positive
        semidefinite; V positive definite in continuous time. Noise that enters through a matrix E has ``W = E Q E^T``.

    Returns
    -------
    KalmanFilter
        With the filter as a model whose inputs and outputs are named after those of G.

    Raises
    ------
    InputError
        Noises that are not symmetric, not semidefinite or of the wrong size; a singular V in continuous time (the
        measurement without noise is named).
    NoTrustworthyNumber
        A mode that does not decay and does not show in the outputs (named), or one on the stability boundary that no
        noise moves.

    References
    ----------
    Anderson, Moore, *Optimal Filtering* (1979), sections 4.4 and 5.4; Kwakernaak, Sivan, *Linear Optimal Control
    Systems* (1972), section 4.3.

    Examples
    --------
    >>> lag = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> found = kalman(lag, [[3.0]], [[1.0]])  # -2 P + 3 - P^2 = 0
    >>> found.L.round(9).tolist(), found.estimator.output_names
    ([[1.0]], ('x1 estimated',))
    """
    g = as_model(G, "kalman: G")
    n, p = g.n_states, g.n_outputs
    w, v = checked_weight("kalman: W", W, n), checked_weight("kalman: V", V, p)
    s = np.zeros((n, p)) if N is None else real_array("N", N, 2, "kalman")
    if s.shape != (n, p):
        raise InputError("kalman: N", f"shape {s.shape}", f"{(n, p)}")
    if not g.is_discrete:
        require_definite("kalman: V", v, [f"measurement {name} has no noise" for name in g.output_names])
    require_semidefinite("kalman: [W N; N' V]", np.block([[w, s], [s.T, v]]))
    try:
        found: RiccatiSolution = (dare if g.is_discrete else care)(g.A.T, g.C.T, w, v, s)
    except NoTrustworthyNumber as error:
        raise NoTrustworthyNumber("kalman", *_unsolvable(g, error)) from None
    L, P = -found.gain.T, found.X
    estimator = _as_model(g, L)
    if not surely_stable(estimator):
        raise NoTrustworthyNumber("kalman", "the error dynamics are not surely stable: a pole lies on the boundary")
    with np.errstate(over="ignore", invalid="ignore"):
        noise = w + L @ v @ L.T - s @ L.T - L @ s.T
    refuse_overflow("kalman", noise)
    status, reason = _again(estimator, P, noise)
    return KalmanFilter(L, P, estimator, estimator.poles(), status, f"{reason}; Riccati residual {found.residual:.1e}")


def _again(estimator: StateSpaceModel, P: AnyArray, noise: AnyArray) -> tuple[Status, str]:
    """The covariance of the error ``e' = (A - L C) e + w - L v`` from its own Lyapunov equation, beside P."""
    try:
        covariance = lyapunov(estimator.A, noise, estimator.is_discrete)
    except NoTrustworthyNumber as error:
        return Status.INACCURATE, f"no second covariance: {error.found}"
    size = max(float(np.abs(x).max(initial=0.0)) for x in (P, covariance))  # a sum of squares might overflow
    share = float(np.abs(covariance - P).max(initial=0.0)) / max(size, 1e-300)
    text = f"the Lyapunov equation of the error gives the covariance again to {share:.1e}"
    return (Status.CONVERGED if share <= AGREE else Status.INACCURATE), text


def _as_model(g: StateSpaceModel, L: AnyArray) -> StateSpaceModel:
    """From u and y to the estimated states."""
    with np.errstate(over="ignore", invalid="ignore"):
        A, B = g.A - L @ g.C, np.hstack([g.B - L @ g.D, L])
    refuse_overflow("kalman", A, B)
    taken = set(g.input_names)
    measured = [Signal(f"{y.name} measured", y.unit) if y.name in taken else y for y in g.outputs]
    states = [Signal(f"{x.name} estimated", x.unit) for x in g.states]
    return StateSpaceModel(
        A, B, np.eye(g.n_states), np.zeros((g.n_states, B.shape[1])), g.dt, [*g.inputs, *measured], states,
        g.states, where="kalman",
    )  # fmt: skip


def _unsolvable(g: StateSpaceModel, error: NoTrustworthyNumber) -> tuple[str, str]:
    modes = observability(g).unstable_modes
    if modes:
        return f"no filter with a stable error exists: {modes[0].meaning}", "a detectable model"
    return f"{error.found}; no noise in W may move a mode there", "process noise on every mode on the boundary"
