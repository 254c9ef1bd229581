r"""Loop shaping with two degrees of freedom: robust as `ncf`, and the references answered as a reference model does.

For the shaped plant :math:`G_s = M_s^{-1} N_s` the controller :math:`u_s = [K_1 \; K_2] [\beta; y]` makes small

.. math:: \begin{bmatrix} u_s \\ y \\ e \\ \beta \\ y \end{bmatrix} = \begin{bmatrix} 0 & 0 & I \\ 0 & M_s^{-1} & G_s \\
    -\rho^2 T_{ref} & \rho W_o M_s^{-1} & \rho W_o G_s \\ \rho I & 0 & 0 \\ 0 & M_s^{-1} & G_s \end{bmatrix}
    \begin{bmatrix} r \\ \phi \\ u_s \end{bmatrix}

rho = 0 is plain loop shaping. A constant W_i before K_1 then makes the steady state that of the reference model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.checks import number
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.linear_analysis.magnitude import refuse_overflow
from robustlab.linear_analysis.matrix_equations import care
from robustlab.norms import HinfNorm, bilinear_to_continuous, bilinear_to_discrete, hinf_norm
from robustlab.result import Status
from robustlab.shown import Facts
from robustlab.signals import Taken
from robustlab.statespace import Signal, StateSpaceModel, append, series
from robustlab.synthesis.hinf.constants import WORK
from robustlab.synthesis.hinf.hinf_synthesis import synthesize
from robustlab.synthesis.hinf.mixed_sensitivity import weight_on_channels
from robustlab.synthesis.problem.design import Synthesis, design_budget
from robustlab.synthesis.problem.independent_check import hinf_voice
from robustlab.synthesis.problem.partition import GeneralizedPlant, signal_positions
from robustlab.synthesis.problem.rebuilt_loop import named_controller, surely_stable
from robustlab.uncertainty.distances.coprime import CoprimeMargin, coprime_margin, coprime_riccati

# The steady state of the rebuilt loop may differ from the reference model's by this share.
STEADY = 1e-6


@dataclass(frozen=True, eq=False, kw_only=True)
class TwoDegreeSynthesis(Synthesis):
    r"""A loop-shaping design with two degrees of freedom, ``u = K [r; y]`` with positive feedback of y.

    ``K = W1 [K_1 W_i, K_2 W2]`` is for the plant as given; ``closed_loop`` leads from the references, noise on y and a
    disturbance on u to y and u. ``gamma`` bounds the norm of the problem that was solved (see the module's equation):
    the loop of the shaped plant is as robust as a `NcfSynthesis` of that gamma, and the error of the model matching is
    at most gamma / rho^2 before W_i.

    Attributes
    ----------
    gamma_min
        The smallest gamma without references, exact: no rho gets below.
    rho
        Weight of the model matching.
    margin
        Verified coprime stability margin of the shaped loop with K_2 alone.
    matching
        H-infinity norm of ``T - T_ref``, T the rebuilt loop from the references to the outputs that follow.
    steady_error
        Largest entry of ``T - T_ref`` at s = 0, over the largest of ``T_ref`` there.
    prefilter
        W_i, shape (n_r, n_r).
    K_shaped, shaped_plant
        ``[K_1, K_2]``, and ``W2 G W1``.
    reference_model
        From the references to what the outputs are to do.
    references
        How many of K's inputs are references; they come first.
    problem, apart
        The plant whose loop with K_shaped has the norm ``gamma``, and the one whose loop with K is ``T - T_ref``.
    """

    quantities: ClassVar[Mapping[str, Any]] = {
        **Synthesis.quantities, **dict.fromkeys(("gamma_min", "rho", "steady_error", "references"), float),
    }  # fmt: skip

    gamma_min: float
    rho: float
    margin: CoprimeMargin
    matching: HinfNorm
    steady_error: float
    prefilter: AnyArray
    K_shaped: StateSpaceModel
    shaped_plant: StateSpaceModel
    reference_model: StateSpaceModel
    references: int
    problem: GeneralizedPlant
    apart: GeneralizedPlant

    def facts(self) -> Facts:
        rows = super().facts()
        verdict = (
            "the loop's shape is kept" if self.margin.lower >= 0.25 else "shape the loop differently, or a lower rho"
        )
        return [
            *rows[:2],
            ("smallest gamma without references", f"{self.gamma_min:.6g}"),
            ("margin of the loop", f"{self.margin.lower:.4g}, of {1 / self.gamma_min:.4g} possible: {verdict}"),
            ("distance from the reference model", f"{self.matching.upper:.4g} at {self.matching.frequency:.4g} rad/s"),
            ("steady-state error of the matching", f"{self.steady_error:.1e}"),
            *rows[2:],
        ]

    def to_json(self) -> dict[str, Any]:
        names = ("gamma_min", "rho", "steady_error", "prefilter", "references")
        models = ("margin", "matching", "K_shaped", "shaped_plant", "reference_model")
        whole = super().to_json() | {name: getattr(self, name) for name in names}
        return whole | {name: getattr(self, name).to_json() for name in models}


def two_degree_plant(
    shaped: StateSpaceModel, reference_model: StateSpaceModel, rho: float, followed: AnyArray
) -> GeneralizedPlant:
    """The generalised plant of the equation above; ``followed`` is W_o, shape (n_r, n_y).

    Discrete models are mapped bilinearly, the problem is written in continuous time, and mapped back: norms stay.

    References
    ----------
    Skogestad, Postlethwaite 2005, eqs 9.87 and 9.88; Hoyle, Hyde, Limebeer (1991).
    """
    dt = shaped.dt
    g, t = (bilinear_to_continuous(m) if dt else m for m in (shaped, reference_model))
    n, n_t, n_u, n_y, n_r = g.n_states, t.n_states, g.n_inputs, g.n_outputs, t.n_inputs
    R = np.eye(n_y) + g.D @ g.D.T
    found = care(g.A.T, g.C.T, g.B @ g.B.T, R, g.B @ g.D.T)
    values, vectors = np.linalg.eigh(R)
    root, back = (vectors * np.sqrt(values)) @ vectors.T, (vectors / np.sqrt(values)) @ vectors.T
    H = (found.X @ g.C.T + g.B @ g.D.T) @ back
    o = np.zeros
    A = np.block([[g.A, o((n, n_t))], [o((n_t, n)), t.A]])
    B = np.block([[o((n, n_r)), H, g.B], [t.B, o((n_t, n_y)), o((n_t, n_u))]])
    C = np.block([
        [o((n_u, n)), o((n_u, n_t))], [g.C, o((n_y, n_t))], [rho * followed @ g.C, -(rho**2) * t.C],
        [o((n_r, n + n_t))], [g.C, o((n_y, n_t))],
    ])  # fmt: skip
    D = np.block([
        [o((n_u, n_r)), o((n_u, n_y)), np.eye(n_u)],
        [o((n_y, n_r)), root, g.D],
        [-(rho**2) * t.D, rho * followed @ root, rho * followed @ g.D],
        [rho * np.eye(n_r), o((n_r, n_y)), o((n_r, n_u))],
        [o((n_y, n_r)), root, g.D],
    ])  # fmt: skip
    refuse_overflow("synth ncf", A, B, C, D)
    model = StateSpaceModel(A, B, C, D)
    if dt:
        model = bilinear_to_discrete(model, dt)
    names = [f"r{k + 1}" for k in range(n_r)], [f"phi{k + 1}" for k in range(n_y)], [f"us{k + 1}" for k in range(n_u)]
    outputs = [*(f"control {k + 1}" for k in range(n_u)), *(f"output {k + 1}" for k in range(n_y))]
    outputs += [f"error {k + 1}" for k in range(n_r)] + [f"reference {k + 1}" for k in range(n_r)]
    model = model.renamed([x for part in names for x in part], [*outputs, *(f"ys{k + 1}" for k in range(n_y))])
    return GeneralizedPlant(model, n_r + n_y, n_u)


def two_degree_design(
    g: StateSpaceModel,
    before: StateSpaceModel,
    behind: StateSpaceModel,
    given: Any,
    outputs: Sequence[str] | None,
    rho: float,
    factor: float,
) -> TwoDegreeSynthesis:
    """The design for plant and weights, with names, units and sample times that fit; see `robustlab.ncf`."""
    rows = signal_positions(g.output_names if outputs is None else outputs, g.output_names, "synth ncf: output")
    t = _reference_model(given, len(rows), g.dt)
    number("synth ncf: rho", rho, "a positive number, such as 1", above=0)
    if behind.n_states or behind.n_inputs != behind.n_outputs or np.linalg.cond(behind.D) > 1e12:
        raise InputError(
            "synth ncf: W2", "a weight with states, or not invertible", "constants, beside a reference model",
            "what shapes the loop over frequency belongs into W1",
        )  # fmt: skip
    followed = np.linalg.inv(behind.D)[rows]
    bare = g.renamed(list(g.input_names), list(g.output_names))
    shaped = series(series(before, bare), behind)
    problem = two_degree_plant(shaped, t, rho, followed)
    equations = coprime_riccati(bilinear_to_continuous(shaped) if g.dt else shaped)
    solved = synthesize(problem, "hinf", factor, design_budget("synth ncf", WORK, 1.0, None))
    plant = _plant_with_references(g, rows)
    K0 = _full(solved.K, np.eye(len(rows)), before, behind, plant)
    T0, wanted = (
        plant.close(K0).select(plant.model.input_names[: len(rows)], [g.output_names[i] for i in rows]).dc_gain(),
        t.dc_gain(),
    )
    if np.linalg.cond(T0) > 1e12:
        raise NoTrustworthyNumber("synth ncf", "no reference moves every output in steady state: a zero at s = 0")
    prefilter = np.linalg.solve(T0, wanted)
    K = _full(solved.K, prefilter, before, behind, plant)
    loop = plant.close(K)
    if not surely_stable(loop):
        raise NoTrustworthyNumber("synth ncf", "the loop of the plant as given is not surely stable")
    apart = _less_reference(plant, t, rows)
    matching = hinf_norm(apart.close(K))
    T = loop.select(loop.input_names[: len(rows)], [g.output_names[i] for i in rows])
    steady = float(np.abs(T.dc_gain() - wanted).max(initial=0.0)) / max(float(np.abs(wanted).max(initial=0.0)), 1e-300)
    inner = solved.K
    K2 = StateSpaceModel(inner.A, inner.B[:, len(rows) :], inner.C, inner.D[:, len(rows) :], inner.dt)
    margin = coprime_margin(shaped, K2.renamed(list(shaped.output_names), list(shaped.input_names)), sign=1)
    doubts = [] if solved.status.trustworthy else [solved.reason]
    doubts += [f"margin: {margin.reason}"] * (margin.status is not Status.CERTIFIED)
    doubts += [f"steady state misses the reference model by {steady:.1e}"] * (not steady <= STEADY)
    doubt = hinf_voice(plant, K, loop).doubt(0.0, np.inf)
    doubts += [doubt] * bool(doubt)
    said = "loops of the shaped plant and of the plant as given were rebuilt and are stable; steady state as the model"
    return TwoDegreeSynthesis(
        K=K, gamma=solved.gamma, closed_loop=loop, status=Status.INACCURATE if doubts else solved.status,
        reason="; ".join(doubts) or said, limit=solved.limit, plant=plant, method="ncf with a reference model",
        gamma_min=1 / equations.best_margin, rho=rho, margin=margin, matching=matching, steady_error=steady,
        prefilter=prefilter, K_shaped=inner, shaped_plant=shaped, reference_model=t, references=len(rows),
        problem=problem, apart=apart,
    )  # fmt: skip


def _reference_model(given: Any, n: int, dt: float) -> StateSpaceModel:
    t = weight_on_channels(given, n, dt, "synth ncf: reference_model")
    if (t.n_inputs, t.n_outputs) != (n, n):
        found = f"{t.n_outputs} outputs and {t.n_inputs} inputs"
        raise InputError("synth ncf: reference_model", found, f"{n} and {n}, or one and one")
    if not surely_stable(t):
        raise InputError("synth ncf: reference_model", "not stable", "a stable model")
    if not t.dc_gain().any():
        raise InputError(
            "synth ncf: reference_model", "zero in steady state", "a steady state for the outputs to reach"
        )
    return t


def _plant_with_references(g: StateSpaceModel, rows: Sequence[int]) -> GeneralizedPlant:
    """From (r, noise on y, disturbance on u, u) to (y, total u; r, measured y)."""
    n, n_r, n_y, n_u, o = g.n_states, len(rows), g.n_outputs, g.n_inputs, np.zeros
    r, noise, force, u = np.split(np.eye(n_r + n_y + 2 * n_u), np.cumsum([n_r, n_y, n_u]))
    total = force + u
    D = np.vstack([g.D @ total, total, r, g.D @ total + noise])
    C = np.vstack([g.C, o((n_u + n_r, n)), g.C])
    references = [Signal(f"{g.outputs[i].name} reference", g.outputs[i].unit) for i in rows]
    inputs = [*references, *(Signal(f"noise {s.name}", s.unit) for s in g.outputs)]
    inputs += [Signal(f"disturbance {s.name}", s.unit) for s in g.inputs]
    outputs = [*g.outputs, *(Signal(f"{s.name} total", s.unit) for s in g.inputs)]
    outputs += [Taken(f"{s.name} taken", s.unit, "r", g.output_names[i]) for i, s in zip(rows, references, strict=True)]
    outputs += [Taken(f"{s.name} measured", s.unit, "y", s.name) for s in g.outputs]
    model = StateSpaceModel(g.A, g.B @ total, C, D, g.dt, [*inputs, *g.inputs], outputs, g.states, where="synth ncf")
    return GeneralizedPlant(model, n_r + n_y, n_u)


def _less_reference(plant: GeneralizedPlant, t: StateSpaceModel, rows: Sequence[int]) -> GeneralizedPlant:
    """From (r, u) to (T r - T_ref r; r, measured y): the plant with references, and the reference model beside it."""
    m, n, n_r = plant.model, plant.model.n_states, len(rows)
    columns = [*range(n_r), *range(plant.n_w, m.n_inputs)]
    kept = [*rows, *range(plant.n_z, m.n_outputs)]
    A = np.block([[m.A, np.zeros((n, t.n_states))], [np.zeros((t.n_states, n)), t.A]])
    B = np.vstack([m.B[:, columns], np.hstack([t.B, np.zeros((t.n_states, plant.n_con))])])
    C = np.hstack([m.C[kept], np.vstack([-t.C, np.zeros((plant.n_meas, t.n_states))])])
    D = m.D[np.ix_(kept, columns)].copy()
    D[:n_r, :n_r] -= t.D
    signals = [m.inputs[i] for i in columns], [m.outputs[i] for i in kept]
    return GeneralizedPlant(StateSpaceModel(A, B, C, D, m.dt, *signals, where="synth ncf"), plant.n_meas, plant.n_con)


def _full(
    inner: StateSpaceModel,
    prefilter: AnyArray,
    before: StateSpaceModel,
    behind: StateSpaceModel,
    plant: GeneralizedPlant,
) -> StateSpaceModel:
    """``W1 [K_1 W_i, K_2 W2]`` with the plant's names."""
    n = len(prefilter)
    first = StateSpaceModel([], [], [], prefilter, inner.dt, [f"i{k}" for k in range(n)], [f"o{k}" for k in range(n)])
    second = behind.renamed([f"y{k}" for k in range(behind.n_inputs)], [f"s{k}" for k in range(behind.n_outputs)])
    whole = series(series(append(first, second), inner), before)
    return named_controller(whole, plant.measurements, plant.controls, inner.dt)
