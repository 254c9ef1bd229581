"""Linear-quadratic regulator with integral action on chosen outputs; the loop with its references is rebuilt."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import AnyArray
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.linear_analysis.structural import controllability
from robustlab.result import Status
from robustlab.shown import Facts, Shown, listed, number
from robustlab.signals import Taken
from robustlab.statespace import Signal, StateSpaceModel, as_model, lower_lft
from robustlab.synthesis.h2.state_feedback import lqr
from robustlab.synthesis.problem.controller import Controller
from robustlab.synthesis.problem.partition import signal_positions
from robustlab.synthesis.problem.rebuilt_loop import surely_stable

__all__ = ["IntegralFeedback", "lqi"]

# The steady-state gain of the rebuilt loop may differ from I by this.
STEADY = 1e-6


@dataclass(frozen=True, eq=False)
class IntegralFeedback(Shown):
    r"""State feedback with integral action, ``u = -K x - K_i x_i``, and the loop that it closes.

    Attributes
    ----------
    K, K_i
        Shapes (n_u, n_x) and (n_u, n_r), n_r chosen outputs.
    controller
        From the references, the chosen outputs and the states to the controls:
        ``x_i' = r - y`` (discrete: ``x_i + dt (r - y)``), ``u = -K x - K_i x_i``; closed with positive feedback, as
        every `robustlab.Controller`.
    closed_loop
        From the references to the chosen outputs, rebuilt from model and controller.
    poles
        Its poles.
    steady_error
        Largest entry of ``I -`` the steady-state gain of ``closed_loop``.
    X
        Riccati solution of the model with its integrators: the cost from ``(x, x_i)`` is its quadratic form.
    status
        CONVERGED where the rebuilt loop is stable beyond rounding and its steady-state error is below 1e-6; else
        INACCURATE.
    reason
        How well.
    """

    quantities: ClassVar[Mapping[str, Any]] = {
        "K": [[float]], "K_i": [[float]], "poles": [{"re": float, "im": float}],
        "steady_error": ..., "spectral_abscissa": float,
    }  # fmt: skip

    K: AnyArray
    K_i: AnyArray
    controller: Controller
    closed_loop: StateSpaceModel
    poles: AnyArray
    steady_error: float
    X: AnyArray
    status: Status
    reason: str

    @property
    def spectral_abscissa(self) -> float:
        """That of the closed loop; negative means stable."""
        return self.closed_loop.spectral_abscissa()

    def facts(self) -> Facts:
        """What a person wants to read, as (label, text)."""
        return [
            ("gain", f"{self.K.shape[0]} controls, {self.K.shape[1]} states, {self.K_i.shape[1]} integrators"),
            ("poles", listed(number(complex(p)) for p in self.poles)),
            ("steady-state error", number(self.steady_error, digits=2)),
            ("how well", self.reason),
        ]

    def to_json(self) -> dict[str, Any]:
        """All attributes."""
        return {"type": "IntegralFeedback", **vars(self)}


@told_as("lqi")
def lqi(
    G: Any, Q: ArrayLike, R: ArrayLike, N: ArrayLike | None = None, *, outputs: Sequence[str] | None = None
) -> IntegralFeedback:
    r"""Linear-quadratic regulator whose chosen outputs follow constant references without error.

    .. math:: \dot x_i = r - y, \qquad \min \int z^T Q z + u^T R u + 2 z^T N u \, dt, \quad z = (x, x_i)

    for r = 0; in discrete time :math:`x_{i,k+1} = x_{i,k} + dt (r_k - y_k)` and the sum, as in MATLAB's ``lqi``.
    Constant disturbances that keep the loop stable leave no error either.

    Parameters
    ----------
    G
        Model with n_x states and n_u inputs, continuous or discrete; all states are measured.
    Q, R, N
        Shapes (n_x + n_r, n_x + n_r), (n_u, n_u), (n_x + n_r, n_u); as for `robustlab.lqr`.
    outputs
        Names of the n_r outputs that are to follow; all where left out.

    Returns
    -------
    IntegralFeedback
        Gains, controller, and the rebuilt loop from r to y.

    Raises
    ------
    InputError
        As for `robustlab.lqr`; an unknown output; more outputs than controls, or a zero at s = 0 (z = 1) between them,
        through which no constant control passes.
    NoTrustworthyNumber
        As for `robustlab.lqr`.

    References
    ----------
    Young, Willems, "An approach to the linear multivariable servomechanism problem", Int. J. Control 15 (1972).

    Examples
    --------
    >>> lag = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> found = lqi(lag, np.diag([0.0, 1.0]), [[1.0]])
    >>> found.K.round(6).tolist(), found.K_i.round(6).tolist(), found.steady_error < 1e-12
    ([[0.732051]], [[-1.0]], True)
    """
    g = as_model(G, "lqi: G")
    chosen = signal_positions(g.output_names if outputs is None else outputs, g.output_names, "lqi: output")
    with_integrators = _with_integrators(g, chosen)
    _require_a_path(g, with_integrators, chosen)
    found = lqr(with_integrators, Q, R, N)
    K, K_i = found.K[:, : g.n_states], found.K[:, g.n_states :]
    controller = _controller(g, chosen, K, K_i)
    loop = lower_lft(_seen_by(g, chosen), controller)
    if not surely_stable(loop):
        raise NoTrustworthyNumber("lqi", "the rebuilt loop is not surely stable: a pole lies on the boundary")
    try:
        steady = loop.dc_gain()
    except InputError as refused:
        raise NoTrustworthyNumber("lqi", f"no steady-state gain of the rebuilt loop: {refused.found}") from None
    error = float(np.abs(np.eye(len(chosen)) - steady).max(initial=0.0))
    status = Status.CONVERGED if error <= STEADY else Status.INACCURATE
    reason = f"rebuilt loop stable, its steady-state error {error:.1e}; {found.reason.rpartition('; ')[2]}"
    assert found.X is not None
    kept = Controller(controller, None, status, "lqi")
    return IntegralFeedback(K, K_i, kept, loop, loop.poles(), error, found.X, status, reason)


def _with_integrators(g: StateSpaceModel, chosen: list[int]) -> StateSpaceModel:
    """The model with ``x_i' = -y`` (discrete: ``x_i - dt y``) below its states."""
    step, n, r = (g.dt, g.n_states, len(chosen)) if g.is_discrete else (1.0, g.n_states, len(chosen))
    stays = np.eye(r) if g.is_discrete else np.zeros((r, r))
    A = np.block([[g.A, np.zeros((n, r))], [-step * g.C[chosen], stays]])
    B = np.vstack([g.B, -step * g.D[chosen]])
    states = [*g.states, *(Signal(f"integral of {g.output_names[i]}") for i in chosen)]
    return StateSpaceModel(
        A, B, np.eye(n + r), np.zeros((n + r, g.n_inputs)), g.dt, g.inputs, None, states, where="lqi"
    )


def _require_a_path(g: StateSpaceModel, with_integrators: StateSpaceModel, chosen: list[int]) -> None:
    """Refuse where constant controls cannot hold the outputs; what is wrong with the model itself is told by `lqr`."""
    if len(chosen) > g.n_inputs:
        raise InputError(
            "lqi", f"{len(chosen)} outputs to hold by {g.n_inputs} controls", "at most as many as controls"
        )
    # Integrators add hidden modes where such a zero is, and only there.
    if len(controllability(with_integrators).modes) <= len(controllability(g).modes):
        return
    names = ", ".join(g.output_names[i] for i in chosen)
    at = "z = 1" if g.is_discrete else "s = 0"
    raise InputError(
        "lqi", f"a zero at {at} from the controls to {names}: no constant control holds them", "no such zero"
    )


def _controller(g: StateSpaceModel, chosen: list[int], K: AnyArray, K_i: AnyArray) -> StateSpaceModel:
    """From (r, y, x) to u."""
    r, n, m = len(chosen), g.n_states, g.n_inputs
    step, stays = (g.dt, np.eye(r)) if g.is_discrete else (1.0, np.zeros((r, r)))
    outputs = [g.outputs[i] for i in chosen]
    references = [Taken(f"{y.name} reference", y.unit, "r", y.name) for y in outputs]
    measured = [Taken(f"{y.name} measured", y.unit, "y", y.name) for y in outputs]
    states = [Taken(*x) for x in g.states]
    B = step * np.hstack([np.eye(r), -np.eye(r), np.zeros((r, n))])
    D = np.hstack([np.zeros((m, 2 * r)), -K])
    integrals = [Signal(f"integral of {y.name}") for y in outputs]
    return StateSpaceModel(stays, B, -K_i, D, g.dt, [*references, *measured, *states], g.inputs, integrals, where="lqi")


def _seen_by(g: StateSpaceModel, chosen: list[int]) -> StateSpaceModel:
    """From (r, u) to (y, then what the controller takes: r, y, x)."""
    r, n = len(chosen), g.n_states
    outputs = [g.outputs[i] for i in chosen]
    references = [Signal(f"{y.name} reference", y.unit) for y in outputs]
    C = np.vstack([g.C[chosen], np.zeros((r, n)), g.C[chosen], np.eye(n)])
    D = np.vstack(
        [
            np.hstack([np.zeros((r, r)), g.D[chosen]]),
            np.hstack([np.eye(r), np.zeros((r, g.n_inputs))]),
            np.hstack([np.zeros((r, r)), g.D[chosen]]),
            np.zeros((n, r + g.n_inputs)),
        ]
    )
    B = np.hstack([np.zeros((n, r)), g.B])
    taken = [*(f"{y.name} reference taken" for y in outputs), *(f"{y.name} measured" for y in outputs)]
    taken += [f"{x.name} measured as a state" for x in g.states]
    return StateSpaceModel(
        g.A, B, C, D, g.dt, [*references, *g.inputs], [*outputs, *(Signal(name) for name in taken)], where="lqi"
    )
