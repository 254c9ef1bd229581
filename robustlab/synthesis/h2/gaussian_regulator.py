"""Linear-quadratic-Gaussian output feedback by separation, with disturbances in its model; the loop is rebuilt."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import AnyArray
from robustlab.budget import Budget
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.linear_analysis.magnitude import balancing_factors, refuse_overflow
from robustlab.mu_analysis.margins.classical import ClassicalMargins, classical_margins
from robustlab.mu_analysis.margins.disk_margin import (
    DiskMargins,
    Place,
    disk_channels,
    disk_margin,
    disk_margin_of,
)
from robustlab.norms import H2Norm, h2_by_gramians, hinf_norm
from robustlab.result import Status
from robustlab.shown import Facts, listed, number
from robustlab.statespace import Signal, StateSpaceModel, as_model
from robustlab.synthesis.h2.disturbance_models import DisturbanceModel, Offset, disturbance_model
from robustlab.synthesis.h2.kalman_filter import KalmanFilter, kalman
from robustlab.synthesis.h2.state_feedback import (
    checked_weight,
    lqr,
    require_definite,
    require_semidefinite,
    semidefinite_root,
)
from robustlab.synthesis.problem.design import Synthesis
from robustlab.synthesis.problem.independent_check import norm_doubt
from robustlab.synthesis.problem.partition import GeneralizedPlant, signal_positions
from robustlab.synthesis.problem.rebuilt_loop import rebuilt_loop

__all__ = ["LqgSynthesis", "lqg"]

# Poles of the rebuilt loop are those of regulator and filter up to changes of its matrix by this share.
SEPARATED = 1e-9
# What is left of a persistent disturbance, as a share of the loop's largest gain from it.
OFFSET_FREE = 1e-6


@dataclass(frozen=True, eq=False, kw_only=True)
class LqgSynthesis(Synthesis):
    r"""An LQG design; ``gamma`` is the H2 norm of ``closed_loop``, the root of the cost.

    A persistent disturbance (constant, sinusoid) is no part of that cost, which would be infinite; a shaped noise is.

    Attributes
    ----------
    F
        Regulator gain, shape (n_u, n_x + n_d): ``u = -F`` times the estimates of plant and disturbance.
    L
        Filter gain, shape (n_x + n_d, n_y).
    regulator_poles, filter_poles
        Of ``A - B F`` without the disturbance, and of the filter of plant and disturbance. Together they are the poles
        of the loop (separation).
    separation
    XX    offsets
        What the rebuilt loop leaves of a persistent disturbance at its frequencies.
    peak
        The largest gain of that loop over all frequencies, to compare it with; NaN without such a disturbance.
    norm
        The H2 norm of the rebuilt loop.
    """

    quantities: ClassVar[Mapping[str, Any]] = {
        **Synthesis.quantities, **dict.fromkeys(("separation", "peak"), float),
    }  # fmt: skip

    F: AnyArray
    L: AnyArray
    regulator_poles: AnyArray
    filter_poles: AnyArray
    separation: float
    offsets: tuple[Offset, ...]
    peak: float
    norm: H2Norm

    def disk_margins(self, at: Place = "input") -> DiskMargins:
        """Disk margins at the plant's inputs or outputs: LQG guarantees none (Doyle 1978), so they are to be read."""
        return disk_margin(self._inner, self.K, at=at, sign=1)

    def classical_margins(self, at: Place = "input") -> ClassicalMargins:
        """Gain, phase and delay margins of each loop alone."""
        return classical_margins(self._inner, self.K, at=at, sign=1)

    @property
    def _inner(self) -> StateSpaceModel:
        """The plant from controls to measurements."""
        p = self.plant
        return p.model.select([s.name for s in p.controls], [s.name for s in p.measurements])

    @cached_property
    def _margin_facts(self) -> Facts:
        rows: Facts = []
        for at in ("input", "output"):
            loop, names = disk_channels(self._inner, self.K, (0, 0), at, 0.0, 1)
            for into, out, name in zip(loop.input_names, loop.output_names, names, strict=True):
                margin = disk_margin_of(loop.select([into], [out]), [name], 0.0, Budget())
                low, high = margin.gain_margin
                degrees = number(np.degrees(margin.phase_margin))
                text = f"{margin.lower:.4g}: factors {number(low)} .. {number(high)}, +-{degrees} degrees"
                rows.append((f"disk margin, {at} {name}", text))
        return rows

    def _gamma_text(self) -> str:
        return f"{self.gamma:.6g} (H2 norm, verified by both Gramians; its square is the cost)"

    def facts(self) -> Facts:
        """What a person wants to read, as (label, text); the disk margins are computed here."""
        rows = super().facts()
        more: Facts = [
            ("poles of the regulator", listed(number(complex(p)) for p in self.regulator_poles)),
            ("poles of the filter", listed(number(complex(p)) for p in self.filter_poles)),
            ("separation holds to", f"{self.separation:.1e}"),
        ]
        for offset in self.offsets:
            text = f"{offset.modelled:.1e}, of {self.peak:.3g} at most; entering at any output {offset.anywhere:.1e}"
            more.append((f"left at {number(offset.frequency)} rad/s", text))
        return [*rows[:5], *more, *self._margin_facts, *rows[6:]]

    def to_json(self) -> dict[str, Any]:
        """Everything but the plant, with arrays."""
        names = ("F", "L", "regulator_poles", "filter_poles", "separation", "offsets", "peak")
        return super().to_json() | {name: getattr(self, name) for name in names} | {"norm": self.norm.to_json()}


@told_as("synth lqg")
def lqg(
    G: Any,
    Q: ArrayLike,
    R: ArrayLike,
    W: ArrayLike,
    V: ArrayLike,
    *,
    disturbance: Any = None,
    at: Literal["input", "output"] = "input",
    channels: Sequence[str] | None = None,
    disturbance_noise: ArrayLike = 1.0,
    regulated: Sequence[str] | None = None,
) -> LqgSynthesis:
    r"""Linear-quadratic-Gaussian controller ``u = K y``, with *positive* feedback as everywhere in this package.

    .. math:: \dot x = A x + B u + w, \quad y = C x + D u + v, \qquad
        \min_K \lim_{t \to \infty} E [x^T Q x + u^T R u]

    for white noises w, v of intensities W, V; in discrete time of those covariances. It is the state feedback of
    `robustlab.lqr` on the estimate of `robustlab.kalman`; in discrete time on the estimate that uses the measurement of
    the same sample. ``gamma^2`` of the result is the cost.

    With a ``disturbance`` d the filter estimates its state, too. One whose modes decay is shaped noise: the controller
    is optimal for it. A persistent one (constant, sinusoid) is cancelled in the regulated outputs by
    :math:`u = -F (\hat x - \Pi \hat x_d) + \Gamma \hat x_d`, where Pi and Gamma solve the regulator equations; the
    rebuilt loop has to show that nothing is left at its frequencies.

    Parameters
    ----------
    G
        Model with n_x states, n_u inputs and n_y outputs, continuous or discrete.
    Q, R, W, V
        Symmetric positive semidefinite, shapes (n_x, n_x), (n_u, n_u), (n_x, n_x), (n_y, n_y); R and V positive
        definite.
    disturbance
        None; ``"constant"``; the frequency of a sinusoid in rad/s; or a model from white noise to d without direct
        term, with one output (then one for every channel) or one for each channel.
    at
        Whether d adds to the ``"input"`` (the controls) or to the ``"output"`` (the measurements).
    channels
        Names of these inputs or outputs; all where left out.
    disturbance_noise
        Intensity of the white noise that drives the disturbance, for all channels (of a filter: its inputs) or one
        number for each: the larger, the faster its estimate.
    regulated
        Names of the outputs that a persistent disturbance must leave; all where left out.

    Returns
    -------
    LqgSynthesis
        CONVERGED where the rebuilt loop is stable, its H2 norm is verified, its poles are those of regulator and
        filter, and nothing is left of a persistent disturbance; else INACCURATE.

    Raises
    ------
    InputError
        Weights that are not symmetric or semidefinite, or of the wrong size; a singular R or V (the channel is named);
        a disturbance that grows or has a direct term.
    NoTrustworthyNumber
        As for `robustlab.lqr` and `robustlab.kalman`; a disturbance that does not show in the measurements, or that no
        control can cancel.

    References
    ----------
    Kwakernaak, Sivan, *Linear Optimal Control Systems* (1972), chapter 5; Francis, Wonham,
    "The internal model principle of control theory", Automatica 12 (1976).

    Examples
    --------
    >>> lag = StateSpaceModel([[0.5]], [[1.0]], [[1.0]], [[0.0]])
    >>> round(lqg(lag, [[1.0]], [[1.0]], [[1.0]], [[1.0]]).gamma ** 2, 6)
    5.854102
    >>> held = lqg(lag, [[1.0]], [[1.0]], [[1.0]], [[1.0]], disturbance="constant")
    >>> held.offsets[0].modelled < 1e-9 * held.peak
    True
    """
    g = as_model(G, "lqg: G")
    n, p, m = g.n_states, g.n_outputs, g.n_inputs
    if not p or not m:
        raise InputError("lqg: G", f"{p} outputs and {m} inputs", "at least one of each")
    q, r = checked_weight("lqg: Q", Q, n), checked_weight("lqg: R", R, m)
    w, v = checked_weight("lqg: W", W, n), checked_weight("lqg: V", V, p)
    require_semidefinite("lqg: Q", q)
    require_semidefinite("lqg: W", w)
    require_definite("lqg: R", r, [f"control {name} costs nothing" for name in g.input_names])
    require_definite("lqg: V", v, [f"measurement {name} has no noise" for name in g.output_names])
    held = signal_positions(g.output_names if regulated is None else regulated, g.output_names, "lqg: output")
    if disturbance is None and not (channels is None and regulated is None):
        raise InputError("lqg", "channels or regulated outputs without a disturbance", "a disturbance beside them")
    known = None if disturbance is None else disturbance_model(g, disturbance, at, channels, disturbance_noise)
    whole, F, regulator_poles = _regulator(g, q, r, known, held)
    noise = np.zeros((whole.n_states,) * 2)
    noise[:n, :n] = w
    if known is not None:
        noise[n:, n:] = known.filter.B * known.noise @ known.filter.B.T
    estimator = kalman(whole, noise, v)
    plant = _with_noises(g, q, r, w, v, known)
    rebuilt = rebuilt_loop(plant, _controller(whole, F, estimator, v), g.D)
    if rebuilt is None:
        raise NoTrustworthyNumber("synth lqg", "the rebuilt loop is not surely stable, or not well posed")
    return _judged(g, plant, *rebuilt, F, estimator, regulator_poles, known, held)


def _regulator(
    g: StateSpaceModel, q: AnyArray, r: AnyArray, known: DisturbanceModel | None, held: Sequence[int]
) -> tuple[StateSpaceModel, AnyArray, AnyArray]:
    """The plant with the states of the disturbance, the gain for all of them, and the poles of A - B F."""
    if known is None or known.frequencies:
        found = lqr(g, q, r)
        if known is None:
            return g, found.K, found.poles
        Pi, Gamma = known.cancelling(g, held)
        return known.beside(g), np.hstack([found.K, -Gamma - found.K @ Pi]), found.poles
    whole = known.beside(g)
    cost = np.zeros((whole.n_states,) * 2)
    cost[: g.n_states, : g.n_states] = q
    F = lqr(whole, cost, r).K
    return whole, F, np.linalg.eigvals(g.A - g.B @ F[:, : g.n_states])


def _controller(whole: StateSpaceModel, F: AnyArray, estimator: KalmanFilter, v: AnyArray) -> StateSpaceModel:
    """From y - D u to u; in discrete time from the estimate corrected by this sample's measurement."""
    L, C = estimator.L, whole.C
    with np.errstate(over="ignore", invalid="ignore"):
        if whole.is_discrete:
            P = estimator.P
            M = np.linalg.solve(C @ P @ C.T + v, C @ P).T
        else:
            M = np.zeros_like(L)
        corrected = np.eye(whole.n_states) - M @ C
        A = whole.A - L @ C - whole.B @ F @ corrected
        B, out, D = L - whole.B @ F @ M, -F @ corrected, -F @ M
    refuse_overflow("lqg", A, B, out, D)
    return StateSpaceModel(A, B, out, D, whole.dt)


def _with_noises(
    g: StateSpaceModel, q: AnyArray, r: AnyArray, w: AnyArray, v: AnyArray, known: DisturbanceModel | None
) -> GeneralizedPlant:
    """The H2 problem: unit white noises in, ``(Q^1/2 x, R^1/2 u)`` out; a shaped disturbance is a part of it."""
    n, p, m, zero = g.n_states, g.n_outputs, g.n_inputs, np.zeros
    cost, noise = semidefinite_root(q), semidefinite_root(w).T
    inputs = [f"process noise {i + 1}" for i in range(noise.shape[1])]
    if known is not None and not known.frequencies:
        driven = known.filter.B * np.sqrt(known.noise)
        whole, n_d = known.beside(g), known.filter.n_states
        cost, noise = np.hstack([cost, zero((len(cost), n_d))]), np.block(
            [[noise, zero((n, driven.shape[1]))], [zero((n_d, noise.shape[1])), driven]]
        )  # fmt: skip
        inputs += [f"noise of disturbance {i + 1}" for i in range(driven.shape[1])]
        g, n = whole, n + n_d
    k = noise.shape[1]
    D = np.block([[zero((len(cost), k + p + m))], [zero((m, k + p)), semidefinite_root(r)],
                  [zero((p, k)), semidefinite_root(v).T, g.D]])  # fmt: skip
    inputs += [f"noise on {y}" for y in g.output_names]
    outputs = [f"state cost {i + 1}" for i in range(len(cost))] + [f"cost of {u}" for u in g.input_names]
    model = StateSpaceModel(
        g.A, np.hstack([noise, zero((n, p)), g.B]), np.vstack([cost, zero((m, n)), g.C]), D, g.dt,
        [*(Signal(name) for name in inputs), *g.inputs], [*(Signal(name) for name in outputs), *g.outputs], g.states,
        where="lqg",
    )  # fmt: skip
    return GeneralizedPlant(model, p, m)


# --- what the rebuilt loop says --------------------------------------------------------------------------------------


def _judged(
    g: StateSpaceModel,
    plant: GeneralizedPlant,
    K: StateSpaceModel,
    loop: StateSpaceModel,
    F: AnyArray,
    estimator: KalmanFilter,
    regulator_poles: AnyArray,
    known: DisturbanceModel | None,
    held: Sequence[int],
) -> LqgSynthesis:
    norm = h2_by_gramians(loop)
    gamma, doubt = norm_doubt(plant, K, loop, norm)
    # States of a shaping filter stand in the plant of the cost; no controller moves them, and they are no loop's.
    inner = GeneralizedPlant(g, g.n_outputs, g.n_inputs).close(K)
    regulator = g.A - g.B @ F[:, : g.n_states]
    separation = _separation(inner.A, (regulator, estimator.estimator.A))
    offsets: tuple[Offset, ...] = ()
    peak, doubts = float("nan"), [doubt] * bool(doubt)
    if known is not None and known.frequencies:
        offsets = known.offsets(g, K, held)
        peak = hinf_norm(known.disturbed(g, K, held)).lower
        left = max(offset.modelled for offset in offsets)
        if not left <= OFFSET_FREE * peak:
            doubts.append(f"{left:.1e} is left of the persistent disturbance, of a largest gain of {peak:.3g}")
    if separation > SEPARATED:
        doubts.append(f"the poles of the loop are those of regulator and filter to {separation:.1e} only")
    if not norm.status.trustworthy:
        doubts.append(norm.reason)
    if estimator.status is not Status.CONVERGED:
        doubts.append(estimator.reason)
    said = "loop rebuilt from K: stable, H2 norm verified; its poles are those of regulator and filter"
    said += "; nothing is left of the disturbance" if offsets else ""
    return LqgSynthesis(
        K=K, gamma=gamma, closed_loop=loop, status=Status.INACCURATE if doubts else Status.CONVERGED,
        reason="; ".join(doubts) if doubts else said, limit="", plant=plant, method="lqg", F=F, L=estimator.L,
        regulator_poles=regulator_poles, filter_poles=estimator.poles, separation=separation, offsets=offsets,
        peak=float(peak), norm=norm,
    )  # fmt: skip


def _separation(loop: AnyArray, parts: Sequence[AnyArray]) -> float:
    """The largest relative change that makes a pole of a part one of the loop, or a pole of the loop one of the parts.

    A change of ``sigma_min(s I - A)`` makes s a pole of A, and no smaller one. Poles that both parts share are double
    in the loop and known to the root of that only: there the product of the changes of both parts counts.
    """

    def change(A: AnyArray, poles: AnyArray) -> AnyArray:
        t = balancing_factors(A)
        balanced = A / t[:, None] * t
        shifted = poles[:, None, None] * np.eye(len(A)) - balanced
        return np.linalg.svd(shifted, compute_uv=False)[:, -1] / max(float(np.linalg.norm(balanced, 2)), 1e-300)

    parts = [part for part in parts if len(part)]
    if not parts:
        return 0.0
    there = max(float(change(loop, np.linalg.eigvals(part)).max()) for part in parts)
    poles = np.linalg.eigvals(loop)
    back = np.prod([change(part, poles) for part in parts], axis=0)
    return max(there, float(back.max()))
