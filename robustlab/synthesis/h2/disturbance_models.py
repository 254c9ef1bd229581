r"""Disturbances that a controller is to know: constant, sinusoidal, or shaped noise, beside the plant that they act on.

.. math:: \dot x_d = A_d x_d + B_d w_d, \quad d = C_d x_d, \qquad \dot x = A x + B u + E d + w, \quad
    y = C x + D u + F d + v

At an input d adds to the control (columns of B, D for E, F), at an output to the measurement (E = 0, columns of I).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import AnyArray
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.statespace import Signal, StateSpaceModel, lower_lft
from robustlab.synthesis.hinf.mixed_sensitivity import weight_on_channels
from robustlab.synthesis.problem.partition import signal_positions

__all__ = ["DisturbanceModel", "Offset", "disturbance_model"]

# Modes of a shaping filter count as persistent within this distance of the boundary, relative to the filter's size.
PERSISTENT = 1e-9
# The regulator equations count as solved below this residual, relative to their right side.
SOLVED = 1e-8


@dataclass(frozen=True)
class Offset:
    """What is left at one frequency (rad/s) of a persistent disturbance.

    Attributes
    ----------
    frequency
        Of the disturbance's mode.
    modelled
        Gain from the disturbance, where it was said to act, to the regulated outputs.
    anywhere
        Gain from a disturbance at any measured output to the regulated outputs: zero too where K contains a model of
        the disturbance for each of them, which then holds for plants nearby.
    """

    frequency: float
    modelled: float
    anywhere: float

    def to_json(self) -> dict[str, float]:
        """All fields."""
        return vars(self).copy()


@dataclass(frozen=True, eq=False)
class DisturbanceModel:
    """The filter from white noise to d, and where d acts.

    Attributes
    ----------
    filter
        From white noises to d, no direct term.
    E, F
        From d to the states and to the measurements of the plant.
    noise
        Intensity (discrete: covariance) of the filter's white noise, one number for each of its inputs.
    """

    filter: StateSpaceModel
    E: AnyArray
    F: AnyArray
    noise: AnyArray

    @property
    def frequencies(self) -> list[float]:
        """Frequencies >= 0 in rad/s of the modes that do not decay."""
        m = self.filter
        lasting = m.poles()[_inside(m) <= PERSISTENT]
        s = np.log(lasting) / m.dt if m.is_discrete else lasting
        return sorted({round(abs(float(omega)), 12) for omega in np.imag(s)})

    def beside(self, g: StateSpaceModel) -> StateSpaceModel:
        """The plant with the states of the filter below its own."""
        m, nothing = self.filter, np.zeros
        A = np.block([[g.A, self.E @ m.C], [nothing((m.n_states, g.n_states)), m.A]])
        B = np.vstack([g.B, nothing((m.n_states, g.n_inputs))])
        return StateSpaceModel(
            A, B, np.hstack([g.C, self.F @ m.C]), g.D, g.dt, g.inputs, g.outputs, [*g.states, *m.states], where="lqg"
        )

    def cancelling(self, g: StateSpaceModel, regulated: Sequence[int]) -> tuple[AnyArray, AnyArray]:
        r"""``Pi, Gamma`` with which the disturbance leaves nothing in the regulated outputs: they solve

        .. math:: \Pi A_d = A \Pi + B \Gamma + E C_d, \qquad 0 = C_r \Pi + D_r \Gamma + F_r C_d

        References
        ----------
        Francis, Wonham, "The internal model principle of control theory", Automatica 12 (1976).
        """
        m, rows = self.filter, list(regulated)
        n, n_u, n_d = g.n_states, g.n_inputs, m.n_states
        one = np.eye(n_d)
        states = np.hstack([np.kron(one, g.A) - np.kron(m.A.T, np.eye(n)), np.kron(one, g.B)])
        outputs = np.hstack([np.kron(one, g.C[rows]), np.kron(one, g.D[rows])])
        right = -np.concatenate([(self.E @ m.C).ravel(order="F"), (self.F[rows] @ m.C).ravel(order="F")])
        whole = np.vstack([states, outputs])
        found = np.linalg.lstsq(whole, right, rcond=None)[0]
        if np.linalg.norm(whole @ found - right) > SOLVED * max(float(np.linalg.norm(right)), 1e-300):
            names = ", ".join(g.output_names[i] for i in rows)
            at = ", ".join(f"{omega:.6g}" for omega in self.frequencies)
            raise NoTrustworthyNumber(
                "synth lqg",
                f"no control holds {names} against this disturbance: a zero at its frequency ({at} rad/s), or more "
                "outputs than controls",
                "outputs that the controls can hold",
                "name them: regulated=[...]",
            )
        return found[: n * n_d].reshape((n, n_d), order="F"), found[n * n_d :].reshape((n_u, n_d), order="F")

    def disturbed(self, g: StateSpaceModel, K: StateSpaceModel, regulated: Sequence[int]) -> StateSpaceModel:
        """The loop from d to the regulated outputs."""
        return _disturbed(g, self.E, self.F, K, regulated)

    def offsets(self, g: StateSpaceModel, K: StateSpaceModel, regulated: Sequence[int]) -> tuple[Offset, ...]:
        """What the rebuilt loop lets through at the frequencies of the persistent modes."""
        modelled = self.disturbed(g, K, regulated)
        anywhere = _disturbed(g, np.zeros((g.n_states, g.n_outputs)), np.eye(g.n_outputs), K, regulated)
        omega = self.frequencies
        gains = [np.linalg.norm(frequency_response(loop, omega), 2, axis=(1, 2)) for loop in (modelled, anywhere)]
        return tuple(Offset(*(float(x) for x in row)) for row in zip(omega, *gains, strict=True))


def disturbance_model(
    g: StateSpaceModel,
    given: Any,
    at: Literal["input", "output"],
    channels: Sequence[str] | None,
    noise: ArrayLike,
) -> DisturbanceModel:
    """The disturbance that `robustlab.lqg` was told of; see there for what may be given."""
    if at not in ("input", "output"):
        raise InputError("lqg: at", f"{at!r}", '"input" or "output"')
    known, signals = (g.input_names, g.inputs) if at == "input" else (g.output_names, g.outputs)
    places = signal_positions(known if channels is None else channels, known, f"lqg: {at}")
    n = len(places)
    if not n:
        raise InputError("lqg: channels", "none", f"at least one of {', '.join(known)}")
    if isinstance(given, str) and given == "constant":
        given = 0.0
    if isinstance(given, (int, float, np.number)) and not isinstance(given, bool):
        model = _persistent(float(given), [signals[i].name for i in places], g.dt)
        intensity = np.repeat(_intensities(noise, n), model.n_states // n)
    elif isinstance(given, str):
        raise InputError("lqg: disturbance", f"{given!r}", '"constant", a frequency in rad/s, or a model of a filter')
    else:
        model = weight_on_channels(given, n, g.dt, "lqg: disturbance")
        intensity = _intensities(noise, model.n_inputs)
    _check(model, n)
    E = g.B[:, places] if at == "input" else np.zeros((g.n_states, n))
    F = g.D[:, places] if at == "input" else np.eye(g.n_outputs)[:, places]
    states = [Signal(f"disturbance state {k + 1}") for k in range(model.n_states)]
    model = StateSpaceModel(model.A, model.B, model.C, model.D, g.dt, model.inputs, model.outputs, states)
    return DisturbanceModel(model, E, F, intensity)


def _intensities(noise: ArrayLike, n: int) -> AnyArray:
    if np.iscomplexobj(noise):
        raise InputError("lqg: disturbance_noise", f"{noise!r}", "real numbers")
    try:
        sizes = np.broadcast_to(np.asarray(noise, dtype=float), (n,))
    except (TypeError, ValueError):
        raise InputError("lqg: disturbance_noise", f"{noise!r}", f"a positive number, or {n} of them") from None
    if not (np.isfinite(sizes).all() and (sizes > 0).all()):
        raise InputError("lqg: disturbance_noise", f"{noise!r}", "positive numbers")
    return sizes


def _persistent(omega: float, names: Sequence[str], dt: float) -> StateSpaceModel:
    """Undriven modes at +-omega (rad/s), one pair (a constant: one mode) for each channel; each state has its noise."""
    if not (omega >= 0 and np.isfinite(omega)) or (dt and omega * dt >= np.pi):
        most = f" below {np.pi / dt:.6g} rad/s, half the sampling frequency" if dt else ""
        raise InputError("lqg: disturbance", f"frequency {omega:g}", f"a positive frequency in rad/s{most}")
    if omega == 0:
        A, C = np.array([[1.0 if dt else 0.0]]), np.array([[1.0]])
    elif dt:
        c, s = np.cos(omega * dt), np.sin(omega * dt)
        A, C = np.array([[c, s], [-s, c]]), np.array([[1.0, 0.0]])
    else:
        A, C = np.array([[0.0, omega], [-omega, 0.0]]), np.array([[1.0, 0.0]])
    n = len(names)
    whole, out = np.kron(np.eye(n), A), np.kron(np.eye(n), C)
    return StateSpaceModel(
        whole, np.eye(len(whole)), out, np.zeros((n, len(whole))), dt, None, [f"d on {name}" for name in names]
    )


def _inside(m: StateSpaceModel) -> AnyArray:
    """How far every pole is inside the stability region, as a share of the filter's size."""
    poles = np.asarray(m.poles())
    size = 1.0 if m.is_discrete else max(float(np.abs(poles).max(initial=0.0)), 1e-300)
    return (1 - np.abs(poles)) if m.is_discrete else -np.real(poles) / size


def _check(model: StateSpaceModel, n: int) -> None:
    where = "lqg: disturbance"
    if model.n_outputs != n or not model.n_states:
        raise InputError(where, f"{model.n_outputs} outputs, {model.n_states} states", f"{n} outputs and some states")
    if model.D.any():
        raise InputError(where, "a direct term", "a filter without one", "white noise belongs into W or V")
    inside = _inside(model)
    if inside.min() < -PERSISTENT:
        pole = model.poles()[int(inside.argmin())]
        raise InputError(where, f"a mode that grows ({pole:.6g})", "modes that decay or persist")


def _disturbed(
    g: StateSpaceModel, E: AnyArray, F: AnyArray, K: StateSpaceModel, regulated: Sequence[int]
) -> StateSpaceModel:
    """The loop from d to the regulated outputs."""
    rows = list(regulated)
    model = StateSpaceModel(
        g.A,
        np.hstack([E, g.B]),
        np.vstack([g.C[rows], g.C]),
        np.block([[F[rows], g.D[rows]], [F, g.D]]),
        g.dt,
        [*(f"d{k}" for k in range(E.shape[1])), *(f"u{k}" for k in range(g.n_inputs))],
        [*(f"z{k}" for k in rows), *(f"y{k}" for k in range(g.n_outputs))],
    )
    return lower_lft(model, K)
