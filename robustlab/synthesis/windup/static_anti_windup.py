r"""Static anti-windup: what the actuator does not take is told to the controller, by the gain of least proved L2 gain.

.. math:: \dot x_c = A_c x_c + B_c y + L (\mathrm{sat}(u_c) - u_c), \quad
          u_c = C_c x_c + D_c y + H (\mathrm{sat}(u_c) - u_c), \quad u = \mathrm{sat}(u_c)

With q = u_c - sat(u_c), a dead zone of the sector [0, k], the loop is linear in q and w. In :math:`Q = P^{-1}`, U
diagonal and :math:`X = \Lambda U`, :math:`\Lambda = -[L; H]`, the least gamma is a linear matrix inequality:

.. math:: \begin{bmatrix} A Q + Q A^T & B_q U + B_v X + k Q C_u^T & B_w & Q C_z^T \\
    \cdot & k (D_{uq} U + D_{uv} X) + (\cdot)^T - 2 U & k D_{uw} & (D_{zq} U + D_{zv} X)^T \\
    \cdot & \cdot & -\gamma I & D_{zw}^T \\ \cdot & \cdot & \cdot & -\gamma I \end{bmatrix} \prec 0

It only finds the gain. The gain that is reported is proved for the loop rebuilt from it, by integral quadratic
constraints (`robustlab.iqc`).

References
----------
Mulder, Kothare, Morari, "Multivariable anti-windup controller synthesis using linear matrix inequalities", Automatica
37 (2001); Grimm et al., "Antiwindup for stable linear systems with input saturation: an LMI-based synthesis", IEEE TAC
48 (2003).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import Budget, search_budget
from robustlab.closing import wired
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.iqc import IqcGain, Nonlinearity, iqc_gain
from robustlab.norms import hinf_norm
from robustlab.norms.level_set import well_scaled
from robustlab.result import Status
from robustlab.shown import Facts, Shown, number
from robustlab.signals import is_number
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.synthesis.hinf.lmi_synthesis import solve_conic
from robustlab.synthesis.windup.back_calculation import back_calculation

# Work of the search at effort 1, and of one inequality with n states.
WORK = 60e6
STEP = 30.0
# The gain is looked for at this share above the least level, where the smallest one is taken.
RELAXED = 0.02
# Back-calculation is compared in a grid so much finer than its time.
FINE = 200


@dataclass(frozen=True, eq=False)
class AntiWindup(Shown):
    """A controller with static anti-windup, and the proved gain of its loop.

    Attributes
    ----------
    L, H
        Gains on ``sat(u_c) - u_c`` into the controller's states (n_c, n_u) and into its outputs (n_u, n_u).
    proved
        Worst L2 gain of the saturated loop with them.
    without, back
        The same without anti-windup, and with back-calculation of the time ``time`` in s.
    linear
        H-infinity norm of the loop that never saturates: no anti-windup comes below.
    level
        What the synthesis inequality said; not proved, shown for comparison.
    controller
        The controller as given.
    plant
        The plant with its performance channel first, the one that was added too.
    calculated
        Gains of the back-calculation, those of L above those of H.
    status
        That of ``proved``.
    """

    L: Array
    H: Array
    proved: IqcGain
    without: IqcGain
    back: IqcGain
    time: float
    linear: float
    level: float
    controller: StateSpaceModel
    plant: StateSpaceModel
    calculated: Array

    quantities: ClassVar[Mapping[str, Any]] = {
        "lower": float, "upper": float, "without": float, "back": float, "linear": float, "L": [[float]],
    }  # fmt: skip

    def numbers(self) -> dict[str, Any]:
        """What is proved of each, and the gain."""
        gains = {"lower": self.proved.lower, "upper": self.proved.upper}
        return gains | {
            "without": self.without.upper, "back": self.back.upper, "linear": self.linear, "L": self.L.tolist(),
        }  # fmt: skip

    def headline(self) -> str:
        """The proved gain beside that without."""
        return f"worst L2 gain {self.proved.bounds()}, without anti-windup {self.without.bounds()}"

    @property
    def gain(self) -> Array:
        """L above H: from ``sat(u_c) - u_c`` to the controller's states and outputs."""
        return np.vstack([self.L, self.H])

    @property
    def notes(self) -> tuple[str, ...]:
        """Conditions of the proof."""
        return self.proved.conditions

    @property
    def status(self) -> Status:
        """That of ``proved``."""
        return self.proved.status

    def to_model(self) -> StateSpaceModel:
        """The controller with ``sat(u_c) - u_c`` of each output as further inputs."""
        K = self.controller
        more = [(f"cut of {s.name}", s.unit) for s in K.outputs]
        return StateSpaceModel(
            K.A, np.hstack([K.B, self.L]), K.C, np.hstack([K.D, self.H]), 0.0, [*K.inputs, *more], K.outputs, K.states
        )

    def sampled(self, dt: float) -> tuple[StateSpaceModel, Array]:
        """The controller held over steps of ``dt`` s, and the gain of its states: what `export_controller` takes."""
        from robustlab.synthesis.sampled.discretisation import by_formula

        if self.H.any():
            raise InputError("AntiWindup.sampled", "a gain H on the outputs, an algebraic loop", "direct=False")
        held, n = by_formula(self.to_model(), dt, "zoh"), self.controller.n_inputs
        K = StateSpaceModel(
            held.A, held.B[:, :n], held.C, held.D[:, :n], dt, held.inputs[:n], held.outputs, held.states
        )
        return K, held.B[:, n:]

    def facts(self) -> Facts:
        """The proved gain and what it is to be compared with."""
        rows = [("worst-case L2 gain", self.proved), ("without anti-windup", self.without),
                (f"back-calculation, {number(self.time, 's')}", self.back)]  # fmt: skip
        said = [(label, found.bounds()) for label, found in rows]
        return [
            *said,
            ("loop that never saturates", number(self.linear)),
            (
                "gain L",
                f"{self.L.shape[0]} x {self.L.shape[1]}, largest entry {number(float(np.abs(self.L).max(initial=0)))}",
            ),
            ("holds", ", ".join(self.proved.conditions)),
        ]

    def to_json(self) -> dict[str, Any]:
        """All attributes but those that can be made anew, and the status."""
        kept = {name: value for name, value in vars(self).items() if name not in ("plant", "calculated")}
        return {"type": "AntiWindup", **kept, "status": self.status}


@dataclass(frozen=True, eq=False)
class _Loop:
    """The loop from [q, v, w] to [u_c, z]; v = (into the controller's states, into its outputs)."""

    A: Array
    B: dict[str, Array]
    C: dict[str, Array]
    D: dict[tuple[str, str], Array]

    def closed(self, gain: Array) -> StateSpaceModel:
        """With ``v = -gain q`` as a model from [q, w] to [u_c, z]."""
        D, sizes = self.D, [self.B["q"].shape[1], self.B["w"].shape[1], len(self.C["u"]), len(self.C["z"])]
        direct = [[D[o, "q"] - D[o, "v"] @ gain, D[o, "w"]] for o in ("u", "z")]
        names = [[f"{word}{i + 1}" for i in range(n)] for word, n in zip(("q", "w", "uc", "z"), sizes, strict=True)]
        into = np.hstack([self.B["q"] - self.B["v"] @ gain, self.B["w"]])
        out = np.vstack([self.C["u"], self.C["z"]])
        return StateSpaceModel(self.A, into, out, np.block(direct), 0.0, names[0] + names[1], names[2] + names[3])


@told_as("anti_windup")
def anti_windup(
    plant: Any,
    controller: Any,
    limits: Any = (-1.0, 1.0),
    reach: float = math.inf,
    direct: bool = False,
    time: float | None = None,
    order: int = 2,
    time_limit: float | None = None,
    effort: float = 1.0,
) -> AntiWindup:
    r"""Static anti-windup gain for a controller ``u = K y`` whose outputs saturate, with the proved L2 gain.

    Parameters
    ----------
    plant
        Continuous. Its last inputs are u, its last outputs y; those before them are the performance channel w, z. A
        plant with u and y alone gets one: w is added to what the controller sees, and z is what it sees (with -K for
        the controller: from the reference to the control error).
    controller
        K: n_c states; the loop ``u = K y`` is stable.
    limits
        ``(low, high)`` of all controls, or a list of one for each; low < 0 < high.
    reach
        ``|u_c|`` stays below this multiple of its smaller limit, more than 1: the sector of the dead zone is then
        [0, 1 - 1 / reach], and what is proved holds while it does. inf: for all signals, which needs a stable plant.
    direct
        Whether the outputs are corrected too (H). That is an algebraic loop, which a digital controller does not have.
    time
        Of the back-calculation that is compared, in s; the slowest time constant of the loop where left out.
    order, time_limit, effort
        As in `robustlab.peak_gain`.

    Returns
    -------
    AntiWindup
        The gains, the proved gain, and those without anti-windup and with back-calculation.

    Raises
    ------
    InputError
        Sizes or limits that do not fit, a discrete model.
    NoTrustworthyNumber
        The loop is unstable without saturation; the inequality has no solution, as for an unstable plant without reach.

    References
    ----------
    Mulder, Kothare, Morari (2001); Grimm et al. (2003).

    Examples
    --------
    >>> plant = StateSpaceModel([[-0.1]], [[1.0]], [[1.0]], [[0.0]])
    >>> pi = StateSpaceModel([[0.0]], [[-1.0]], [[2.0]], [[-3.0]])
    >>> found = anti_windup(plant, pi)
    >>> found.status.value, found.proved.upper < found.without.upper
    ('certified', True)
    """
    P, K = as_model(plant, "anti_windup: plant"), as_model(controller, "anti_windup: controller")
    if P.is_discrete or K.is_discrete:
        raise InputError("anti_windup", "a discrete model", "continuous ones", "rl.d2c makes one")
    if not K.n_outputs or not P.n_states + K.n_states:
        raise InputError(
            "anti_windup", "no control, or a loop without states", "a dynamic loop whose controls saturate"
        )
    pairs = _limits(limits, K.n_outputs)
    if not reach > 1:
        raise InputError("anti_windup: reach", f"{reach!r}", "more than 1, or inf")
    if time is not None and not 0 < time < math.inf:
        raise InputError("anti_windup: time", f"{time!r}", "a positive number of seconds")
    width = 1.0 if math.isinf(reach) else 1.0 - 1.0 / reach
    K = wired(K, P.outputs[P.n_outputs - K.n_inputs :], P.inputs[P.n_inputs - K.n_outputs :], "anti_windup")
    P = _with_performance(P, K)
    loop = _loop(P, K)
    linear = loop.closed(np.zeros((K.n_states + K.n_outputs, K.n_outputs)))
    if linear.n_states and not linear.is_stable():
        worst = linear.poles()[linear.poles().real.argmax()]
        raise NoTrustworthyNumber(
            "anti_windup", f"the loop u = K y is unstable without saturation (pole {worst:.4g})", "a stable loop",
            "for negative feedback give -K, or a controller that says so: rl.Controller(K, takes='r - y')",
        )  # fmt: skip
    budget = search_budget("anti_windup", WORK, effort, time_limit)
    level, gain = _synthesised(loop, linear, K.n_states, width, direct, budget)
    symmetric = all(math.isclose(-low, high) for low, high in pairs)
    law = Nonlinearity(
        (0.0, width), (0.0, 1.0), odd=symmetric,
        holds="" if math.isinf(reach) else f"while it stays within {reach:g} times its limit",
    )  # fmt: skip
    slow = float(-1.0 / linear.poles().real.max()) if time is None else time
    laws = {(f"uc{i + 1}", f"q{i + 1}"): law for i in range(K.n_outputs)}
    w, z = (linear.input_names[K.n_outputs :], linear.output_names[K.n_outputs :])

    def judged(of: Array) -> IqcGain:
        return iqc_gain(loop.closed(of), laws, None, z, order, None, time_limit, effort)

    calculated = np.vstack([_calculated(K, pairs, slow), np.zeros((K.n_outputs, K.n_outputs))])
    found, without, back = (judged(of) for of in (gain, np.zeros_like(gain), calculated))
    norm = hinf_norm(linear.select(w, z)).upper
    return AntiWindup(gain[: K.n_states], gain[K.n_states :], found, without, back, slow, norm, level, K, P, calculated)


def _limits(limits: Any, count: int) -> list[tuple[float, float]]:
    given = np.asarray(limits, dtype=object)
    fits = given.shape in ((2,), (count, 2)) and all(is_number(x) for x in given.ravel())
    pairs = np.broadcast_to(given.astype(float), (count, 2)) if fits else np.zeros((0, 2))
    if len(pairs) != count or not np.isfinite(pairs).all() or not ((pairs[:, 0] < 0) & (pairs[:, 1] > 0)).all():
        raise InputError("anti_windup: limits", f"{limits!r}", f"(low, high) with low < 0 < high, one or {count}")
    return [(float(low), float(high)) for low, high in pairs]


def _with_performance(P: StateSpaceModel, K: StateSpaceModel) -> StateSpaceModel:
    """The plant, with w added to what the controller sees, and that as z, where it has neither."""
    n_u, n_y, n = K.n_outputs, K.n_inputs, P.n_states
    n_w, n_z = P.n_inputs - n_u, P.n_outputs - n_y
    if n_w < 0 or n_z < 0:
        found = f"a controller of {n_u} x {n_y} for a plant of {P.n_outputs} x {P.n_inputs}"
        raise InputError("anti_windup", found, "at least as many inputs and outputs of the plant")
    if not n_w and not n_z:
        B, C = np.hstack([np.zeros((n, n_y)), P.B]), np.vstack([P.C, P.C])
        return StateSpaceModel(P.A, B, C, np.block([[np.eye(n_y), P.D], [np.eye(n_y), P.D]]))
    if not n_w or not n_z:
        raise InputError("anti_windup", "a plant with half a performance channel", "w and z before u and y, or neither")
    return P


def _loop(P: StateSpaceModel, K: StateSpaceModel) -> _Loop:
    n_u, n_y, n, n_c = K.n_outputs, K.n_inputs, P.n_states, K.n_states
    n_w, n_z = P.n_inputs - n_u, P.n_outputs - n_y
    B, C, D = P.B, P.C, P.D
    # Signals as rows over [x, x_c | q, v_c, v_u, w]; u_c = E (C_c x_c + D_c (C x + D_w w - D_u q) + v_u)
    sizes = {"x": n, "xc": n_c, "q": n_u, "vc": n_c, "vu": n_u, "w": n_w}
    ends = np.cumsum([0, *sizes.values()])
    one = {key: np.eye(ends[-1])[ends[i] : ends[i + 1]] for i, key in enumerate(sizes)}
    Dyu = D[n_z:, n_w:]
    rest = K.D @ (C[n_z:] @ one["x"] + D[n_z:, :n_w] @ one["w"] - Dyu @ one["q"])
    try:
        uc = np.linalg.solve(np.eye(n_u) - K.D @ Dyu, K.C @ one["xc"] + rest + one["vu"])
    except np.linalg.LinAlgError:
        raise InputError("anti_windup", "a loop that is not well posed", "I - D_K D_P invertible") from None
    u = uc - one["q"]
    y = C[n_z:] @ one["x"] + D[n_z:, :n_w] @ one["w"] + Dyu @ u
    z = C[:n_z] @ one["x"] + D[:n_z, :n_w] @ one["w"] + D[:n_z, n_w:] @ u
    rate = np.vstack([P.A @ one["x"] + B[:, :n_w] @ one["w"] + B[:, n_w:] @ u, K.A @ one["xc"] + K.B @ y + one["vc"]])
    a, cuts = n + n_c, (n + n_c, n + n_c + n_u, n + 2 * n_c + 2 * n_u)
    parts = {"q": slice(cuts[0], cuts[1]), "v": slice(cuts[1], cuts[2]), "w": slice(cuts[2], None)}
    return _Loop(
        rate[:, :a], {k: rate[:, p] for k, p in parts.items()}, {"u": uc[:, :a], "z": z[:, :a]},
        {(o, k): rows[:, p] for o, rows in (("u", uc), ("z", z)) for k, p in parts.items()},
    )  # fmt: skip


def _synthesised(
    loop: _Loop, linear: StateSpaceModel, n_c: int, width: float, direct: bool, budget: Budget
) -> tuple[float, Array]:
    """The level of the inequality, and the smallest gain (n_c + n_u, n_u) a little above it."""
    import cvxpy as cp

    n_u, n_w, n_z = loop.B["q"].shape[1], loop.B["w"].shape[1], len(loop.C["z"])
    n_v = n_c + (n_u if direct else 0)
    columns = [loop.B["q"], loop.B["v"][:, :n_v], loop.B["w"]]
    D = np.block([[loop.D[o, "q"], loop.D[o, "v"][:, :n_v], loop.D[o, "w"]] for o in ("u", "z")])
    whole = StateSpaceModel(loop.A, np.hstack(columns), np.vstack([loop.C["u"], loop.C["z"]]), D)
    m = well_scaled(whole)[0] if whole.n_states else whole
    unit = max(hinf_norm(linear.select(linear.input_names[n_u:], linear.output_names[n_u:])).upper, 1e-9)
    size = np.maximum(np.abs(m.B[:, n_u : n_u + n_v]).max(axis=0, initial=0.0), 1e-9) if m.n_states else np.ones(n_v)
    Bq, Bv, Bw = m.B[:, :n_u], m.B[:, n_u : n_u + n_v] / size, m.B[:, n_u + n_v :]
    Cu, Cz = m.C[:n_u], m.C[n_u:] / unit
    (Duq, Duv, Duw), (Dzq, Dzv, Dzw) = (np.split(d, [n_u, n_u + n_v], axis=1) for d in (m.D[:n_u], m.D[n_u:] / unit))
    Duv, Dzv = Duv / size, Dzv / size
    n = m.n_states
    Q, U, gamma = cp.Variable((n, n), symmetric=True), cp.Variable(n_u), cp.Variable()
    X: Any = cp.Variable((n_v, n_u)) if n_v else np.zeros((0, n_u))
    diagonal = cp.diag(U)
    qx = Bq @ diagonal + Bv @ X + width * Q @ Cu.T
    qq = width * (Duq @ diagonal + Duv @ X)
    zq = (Dzq @ diagonal + Dzv @ X).T
    ax = m.A @ Q
    matrix = cp.bmat([
        [ax + ax.T, qx, Bw, Q @ Cz.T],
        [qx.T, qq + qq.T - 2 * diagonal, width * Duw, zq],
        [Bw.T, width * Duw.T, -gamma * np.eye(n_w), Dzw.T],
        [Cz @ Q, zq.T, Dzw, -gamma * np.eye(n_z)],
    ])  # fmt: skip
    inside = -1e-9 * np.eye(n + n_u + n_w + n_z)
    holds: list[Any] = [0.5 * (matrix + matrix.T) << inside, Q >> 1e-9 * np.eye(n), cp.min(U) >= 1e-9]
    work = 5000 + STEP * n**4
    outcome = solve_conic(cp.Problem(cp.Minimize(gamma), holds), budget, work)
    if not outcome.usable or gamma.value is None or U.value is None:
        hint = "a plant that is not stable takes a reach: no proof holds for all signals then"
        raise NoTrustworthyNumber("anti_windup", f"no static gain was found: {outcome.text}", None, hint)
    least, found = float(gamma.value), (np.asarray(U.value), None if not n_v else np.asarray(X.value))
    if n_v:
        small: list[Any] = [*holds, gamma <= least * (1 + RELAXED), U - 0.3 * found[0] >= 0]
        again = solve_conic(cp.Problem(cp.Minimize(cp.norm(X, "fro")), small), budget, work)
        if again.usable and U.value is not None and X.value is not None:
            found = np.asarray(U.value), np.asarray(X.value)
    gain = np.zeros((n_c + n_u, n_u))
    if found[1] is not None:
        gain[:n_v] = -(found[1] / size[:, None]) / found[0]
    return least * unit, gain


def _calculated(K: StateSpaceModel, pairs: Sequence[tuple[float, float]], time: float) -> Array:
    """Back-calculation in continuous time: the digital one in steps so fine that they do not matter."""
    from scipy.linalg import expm

    if not K.n_states:
        return np.zeros((0, K.n_outputs))
    dt = time / FINE
    fine = StateSpaceModel(np.asarray(expm(K.A * dt)), K.B * dt, K.C, K.D, dt)
    return back_calculation(fine, pairs, time) / dt
