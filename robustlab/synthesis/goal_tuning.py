r"""Controllers of a given structure for goals and several plants: hard goals met, the others made small.

A goal is the norm of a weighted loop of ``u = K (r - y)`` and is met where it is at most one. The search minimises
:math:`\max(g, \alpha f)` of hard goals g and soft goals f, repeatedly with alpha = 1 / (the f reached).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import Budget, one_thread
from robustlab.checks import choice, number, whole
from robustlab.display import Facts
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.norms import bilinear_to_discrete
from robustlab.result import Status, Table
from robustlab.signals import Taken
from robustlab.statespace import StateSpaceModel, append, as_model, series
from robustlab.synthesis import fixed_structure as fixed
from robustlab.synthesis.problem.design import design_budget, final_status
from robustlab.synthesis.problem.gamma_lower_bound import gamma_bound
from robustlab.synthesis.problem.generalized_plant import GeneralizedPlant
from robustlab.synthesis.specifications.weight_design import performance_weight, weight_on_channels
from robustlab.synthesis.structures.controller_structures import Law
from robustlab.synthesis.structures.objectives import DesignProblem, Limit, multi_start, refined

INPUTS = ("reference", "disturbance", "noise")
OUTPUTS = ("output", "control", "total", "error")
CUTS = {"output": ("reference", "error"), "input": ("disturbance", "total")}  # inputs, outputs of a sensitivity
HARDER = 1 + 1e-5  # factor of hard goals in the search, so that they hold in the verification
GOAL_SHARES = (0.5, 0.2, 0.05, 0.01, 0.0)  # weights of the soft goals, in turn, until the hard ones are met
GOAL_ROUNDS = 12  # most rounds
GOAL_PROGRESS = 1e-3  # relative decrease of the soft goals below which the rounds end
BOLD = 1.5  # power of the hard goals' slack by which soft ones weigh more: 5 rounds for 10, until it misses one
GOAL_START = 0.6  # share of the work for the first search, from many starts


@dataclass(frozen=True, kw_only=True)
class Goal:
    """Base of all goals; ``hard`` ones must be met before the others are minimised."""

    hard: bool = False
    norm: ClassVar[str] = "hinf"

    @property
    def text(self) -> str:
        """The goal in words: its numbers by name."""
        named = {n: v for n, v in vars(self).items() if n not in ("hard", "weight") and v is not None}
        words = [f"{n} {v:g}" if isinstance(v, float) else f"{n} {v}" for n, v in named.items()]
        return f"{type(self).__name__.removesuffix('Goal').lower()}: {', '.join(words)}"

    def requirement(self) -> tuple[str, str, Any]:
        """Return the groups of inputs and of outputs, and the weight of their transfer function."""
        raise NotImplementedError

    def channel(self, loop: GeneralizedPlant, share: float = 1.0) -> GeneralizedPlant:
        """Return the generalised plant whose norm is at most one where the goal is met; z times ``share``."""
        model, n_z, n_w = loop.model, loop.n_z, loop.n_w
        into, out, weight = self.requirement()
        ins, outs = _signals(model.input_names[:n_w], into, INPUTS), _signals(model.output_names[:n_z], out, OUTPUTS)
        T, n = model.select([*ins, *model.input_names[n_w:]], [*outs, *model.output_names[n_z:]]), len(outs)
        D = np.array(T.D)
        if isinstance(self, MarginGoal):
            D[:n, :n] -= 0.5 * np.eye(n)
        if T.dt and isinstance(weight, StateSpaceModel) and not weight.dt:
            weight = bilinear_to_discrete(weight, T.dt)
        weight = share * weight_on_channels(weight, n, T.dt, "goal: weight")
        weight = weight.renamed([f"v{i + 1}" for i in range(n)], [f"z{i + 1}" for i in range(weight.n_outputs)])
        kept = StateSpaceModel([], [], [], np.eye(loop.n_meas), T.dt, outputs=T.outputs[n:])
        weighted = series(StateSpaceModel(T.A, T.B, T.C, D, T.dt, T.inputs), append(weight, kept))
        return GeneralizedPlant(weighted, loop.n_meas, loop.n_con)


@dataclass(frozen=True)
class TrackingGoal(Goal):
    """Tracking of the references: ``|W S| <= 1`` with the weight of `robustlab.performance_weight` at the bandwidth
    2 / response_time, with this steady-state error and peak.
    """

    response_time: float
    error: float = 1e-2
    peak: float = 2.0

    def requirement(self) -> tuple[str, str, Any]:
        bandwidth = 2 / _positive("response_time", self.response_time)
        return "reference", "error", performance_weight(bandwidth, self.error, self.peak)


@dataclass(frozen=True)
class SensitivityGoal(Goal):
    """Sensitivity at the plant's outputs (or inputs) below ``peak``, and, with a ``bandwidth`` in rad/s, below
    ``error`` at low frequency (disturbance rejection).
    """

    peak: float = 2.0
    at: str = "output"
    bandwidth: float | None = None
    error: float = 1e-2

    def requirement(self) -> tuple[str, str, Any]:
        cut, peak, w_b = CUTS[choice("goal: at", self.at, CUTS)], _positive("peak", self.peak), self.bandwidth
        return *cut, 1 / peak if w_b is None else performance_weight(w_b, self.error, peak)


@dataclass(frozen=True)
class GainGoal(Goal):
    """Weighted gain from one group of signals to another of at most ``bound``.

    From disturbances to outputs: rejection; from references to outputs: a bound of the resonance and the overshoot.
    """

    bound: float = 1.0
    inputs: str = "disturbance"
    outputs: str = "output"
    weight: Any = 1.0

    def requirement(self) -> tuple[str, str, Any]:
        share, weight = 1 / _positive("bound", self.bound), self.weight
        numbers = isinstance(weight, (int, float, list, np.ndarray))
        return self.inputs, self.outputs, share * (np.array(weight) if numbers else as_model(weight, "goal: weight"))


@dataclass(frozen=True)
class VarianceGoal(GainGoal):
    """H2 norm of at most ``bound``: the root of the summed output variances for white noise of unit intensity."""

    norm: ClassVar[str] = "h2"


@dataclass(frozen=True)
class MarginGoal(Goal):
    r"""Disk margin of at least ``disk`` at the plant's outputs or inputs: :math:`\|S - I/2\|_\infty \le 1/\alpha`.

    The norm treats several loops as one full block, which requires more than the simultaneous margin of all loops.
    """

    disk: float
    at: str = "output"

    def requirement(self) -> tuple[str, str, Any]:
        return *CUTS[choice("goal: at", self.at, CUTS)], _positive("disk", self.disk)


def _positive(name: str, value: float) -> float:
    return number(f"goal: {name}", value, "a positive number", above=0)


def _signals(names: Sequence[str], group: str, groups: Sequence[str]) -> list[str]:
    """Return the signals of a group among the names."""
    choice(f"goal: {'inputs' if groups is INPUTS else 'outputs'}", group, groups)
    return [name for name in names if name.startswith(f"{group} ")]


def _loop(g: StateSpaceModel) -> GeneralizedPlant:
    """Return the open loop from (r, d, n, u) to (y, u, u + d, r - y, and the measured error r - y - n)."""
    n, m, p = g.n_states, g.n_inputs, g.n_outputs
    r, d, noise, u = np.split(np.eye(p + m + p + m), np.cumsum([p, m, p]))
    through, none = g.D @ (u + d), np.zeros((m, n))
    C = np.vstack([g.C, none, none, -g.C, -g.C])
    D = np.vstack([through, u, u + d, r - through, r - through - noise])
    y, v = g.output_names, g.input_names
    ins = [f"{group} {s}" for group, names in zip(INPUTS, (y, v, y), strict=True) for s in names]
    outs = [f"{group} {s}" for group, names in zip(OUTPUTS, (y, v, v, y), strict=True) for s in names]
    taken = [Taken(f"error {s.name} measured", s.unit, "r - y", s.name) for s in g.outputs]
    signals = [*ins, *g.inputs], [*outs, *taken], g.states
    return GeneralizedPlant(StateSpaceModel(g.A, g.B @ (u + d), C, D, g.dt, *signals, where="tune"), p, m)


@dataclass(frozen=True)
class GoalValue:
    """A goal with its verified values."""

    text: str
    hard: bool
    norm: str  # "hinf" or "h2"
    values: tuple[float, ...]  # verified norm of its weighted loop for every plant (H-infinity: upper bound)
    floor: float  # proved lower bound of the value for every controller of any structure; NaN where not computed
    plants: tuple[GeneralizedPlant, ...]  # plants whose loops with K have these norms, for `robustlab.verify`

    @property
    def value(self) -> float:
        return max(self.values)

    @property
    def met(self) -> bool:
        """True where every value is at most 1."""
        return self.value <= 1

    def to_json(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in ("text", "hard", "values", "floor", "value", "met")}


@dataclass(frozen=True, eq=False, kw_only=True)
class TunedSynthesis(fixed.ParametricDesign):
    """A controller of given structure for goals, ``u = K (r - y)``.

    ``gamma`` is the largest value of the soft goals (of all goals where every one is hard); ``closed_loop`` is the loop
    of the first plant with all of its signals. Status: CERTIFIED (CONVERGED with a variance among the goals) if every
    hard goal is met; INFEASIBLE if a hard goal is proved to be infeasible for any controller; else INCONCLUSIVE.
    """

    saved = ("goals", "limits", "parameters")

    goals: tuple[GoalValue, ...]  # with their verified values

    @property
    def missed(self) -> tuple[GoalValue, ...]:
        return tuple(goal for goal in self.goals if goal.hard and not goal.met)

    def _gamma_text(self) -> str:
        return f"{self.gamma:.6g} (largest {'' if all(goal.hard for goal in self.goals) else 'soft '}goal, verified)"

    def facts(self) -> Facts:
        rows = super().facts()
        for goal in self.goals:
            word = ("hard" if goal.hard else "soft") + ("" if goal.met else ", missed" if goal.hard else ", above 1")
            floor = f"; no controller below {goal.floor:.4g}" if goal.floor > 1 else ""
            rows.append((goal.text, f"{goal.value:.4g} ({word}{floor})"))
        return [*rows, *self.parameter_facts()]

    def table(self) -> Table:
        columns = {key: [getattr(goal, key) for goal in self.goals] for key in ("hard", "value", "met")}
        return Table(("goal", [goal.text for goal in self.goals]), columns)


@error_context("synth tune")
def tune(
    G: Any,
    structure: Any = "pid",
    goals: Sequence[Goal | Limit] = (),
    *,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    start: Any = None,
    starts: int = 8,
    seed: int = 0,
    time_limit: float | None = None,
    effort: float = 1.0,
    progress: Callable[[str], None] | None = None,
) -> TunedSynthesis:
    r"""Tune a controller of given structure for one plant or several: meet the hard goals, minimise the soft ones.

    .. math:: \min_p \max_{soft} f_i(p) \quad\text{such that}\quad f_j(p) \le 1 \text{ for hard goals}, \qquad
        u = K(p) (r - y)

    A goal is a norm of a weighted closed loop and is met where it is at most 1: tracking, sensitivity, gains,
    variances, disk margins. Limits of poles and of the controller always hold. Apkarian, Noll 2006; Apkarian, Gahinet,
    Buhr, "Multi-model, multi-objective tuning of fixed-structure controllers", European Control Conference (2014).

    Parameters
    ----------
    G
        Plant from controls to measurements, or a list of them with equal signals and sample time for one controller.
    structure
        As for `robustlab.fixed_structure`; its measurements are the errors r - y.
    goals
        `TrackingGoal`, `SensitivityGoal`, `GainGoal`, `VarianceGoal`, `MarginGoal` of `robustlab.synthesis`, hard with
        ``hard=True``; and the limits `Decay`, `Damping`, `Bandwidth`, `StableController`, `RollOff`.
    bounds, start, starts, seed, time_limit, effort, progress
        As for `robustlab.fixed_structure`.

    Returns
    -------
    TunedSynthesis
        The goals with their values, verified on loops rebuilt from K, and the hard goals that were missed.

    Raises
    ------
    InputError, NoTrustworthyNumber
        No goal, plants that do not fit together, an unknown signal, a variance that is infinite by structure. No start
        stabilised all plants and kept the limits, which does not prove that no controller does.

    Examples
    --------
    >>> from robustlab.synthesis import MarginGoal, TrackingGoal
    >>> lag = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> found = tune(lag, "pi", [TrackingGoal(1.0), MarginGoal(1.0, hard=True)], starts=1)
    >>> found.status.value, found.gamma < 1, found.missed
    ('certified', True, ())
    """
    wanted, limits = [g for g in goals if isinstance(g, Goal)], [g for g in goals if isinstance(g, Limit)]
    if wrong := [g for g in goals if not isinstance(g, (Goal, Limit))]:
        raise InputError("synth tune: goals", f"{wrong[0]!r}", "TrackingGoal, MarginGoal, ..., Damping, Decay, ...")
    if not wanted:
        raise InputError("synth tune: goals", "none", "at least one goal in addition to limits")
    whole("synth tune: starts", starts, 0, fixed.MOST_STARTS)
    budget = design_budget("synth tune", effort, time_limit)
    loops = [_loop(g) for g in _plants(G)]
    hard = np.array([goal.hard for goal in wanted])
    with one_thread():
        law = fixed.law_of(loops[0], structure, bounds)
        given = [("given", p) for p in fixed.given_starts(law, start)]

        def problem(alpha: float, budget: Budget) -> DesignProblem:
            """Minimise ``max(g, alpha f)`` over all plants; for alpha = 0 the hard goals alone."""
            active = [goal for goal in wanted if goal.hard or alpha]
            plants = [goal.channel(loop, HARDER if goal.hard else alpha) for goal in active for loop in loops]
            kinds = [goal.norm for goal in active for _ in loops]
            return DesignProblem(plants, law, kinds, limits, budget, limited=loops if limits else [])

        first = problem(1.0, budget.share(GOAL_START))
        fixed.require_finite_h2(first)
        ends = multi_start(first, given, starts, seed, progress or (lambda _: None))

        def reached(p: AnyArray) -> tuple[float, float]:
            """Return the largest hard and the largest soft goal."""
            values = np.array(first.norms(p)).reshape(len(wanted), len(loops)).max(axis=1)
            return float(values[hard].max(initial=0.0)), float(values[~hard].max(initial=0.0))

        stable = [(*reached(end.p), end.p) for end in ends[: fixed.VERIFIED] if np.isfinite(end.gamma)]
        if not stable:
            raise fixed.not_found(first, ends)
        needed, wished, p = min(stable, key=lambda found: (max(found[0], 1.0), found[1]))
        bold = BOLD
        for k in range(GOAL_ROUNDS if hard.any() else 0):
            met = needed <= 1
            if budget.over or (wished <= 0 if met else k == len(GOAL_SHARES)):
                break
            q, _ = refined(problem(needed**-bold / wished if met else GOAL_SHARES[k], budget), p)
            now, lower = reached(q)
            if not met or (now <= 1 and lower < wished * (1 - GOAL_PROGRESS)):
                p, needed, wished = q, now, lower
            elif bold:
                bold = 0.0
            else:
                break
        return _verified(p, law, loops, wanted, limits, budget)


def _plants(G: Any) -> list[StateSpaceModel]:
    models = [as_model(g, "synth tune: G") for g in (G if isinstance(G, (list, tuple)) else [G])]
    if not models or not models[0].n_inputs or not models[0].n_outputs:
        raise InputError("synth tune: G", "no plant, or one without inputs or outputs", "at least one of each")
    first = models[0]
    for i, other in enumerate(models[1:], start=2):
        if (other.input_names, other.output_names, other.dt) != (first.input_names, first.output_names, first.dt):
            expected = f"those of plant 1: {', '.join(first.input_names + first.output_names)}"
            raise InputError("synth tune", f"plant {i} has other signals or another sample time", expected)
    return models


def _verified(
    p: AnyArray, law: Law, loops: Sequence[GeneralizedPlant], wanted: Sequence[Goal], limits: Sequence[Limit],
    budget: Budget,
) -> TunedSynthesis:  # fmt: skip
    """Return the design with every goal verified on loops rebuilt from K."""
    first = loops[0]
    K = law.model(p, first.model.dt, first.measurements, first.controls)
    closed = [loop.close(K) for loop in loops]
    kept = fixed.kept_limits(limits, closed, K)
    if any(limit.value > fixed.KEPT for limit in kept):
        raise NoTrustworthyNumber("synth tune", "the limits do not hold for the loop rebuilt from K")
    goals, doubts = list[GoalValue](), list[str]()
    for goal in wanted:
        plants = tuple(goal.channel(loop) for loop in loops)
        proofs = [fixed.certified_norm(plant, K, goal.norm)[1] for plant in plants]
        doubts += [f"{goal.text}: {proof.doubt}" for proof in proofs if proof.doubt]
        values = tuple(proof.gamma for proof in proofs)
        unmet = goal.hard and goal.norm == "hinf" and max(values) > 1
        floor = max(gamma_bound(plant).value for plant in plants) if unmet else float("nan")
        goals.append(GoalValue(goal.text, goal.hard, goal.norm, values, floor, plants))
    missed = [goal for goal in goals if goal.hard and not goal.met]
    if doubts:
        status, parts = Status.INACCURATE, doubts[:1]
    elif missed:
        proved = any(goal.floor > 1 for goal in missed)
        status = Status.INFEASIBLE if proved else Status.INCONCLUSIVE
        why = "no controller of any structure meets it (proved by a bound of gamma)"
        parts = ["; ".join(f"hard goal missed: {goal.text} ({goal.value:.4g})" for goal in missed)]
        parts.append(why if proved else "a local search: no proof that it cannot be met; take more starts")
    else:
        status = Status.CONVERGED if any(goal.norm == "h2" for goal in goals) else Status.CERTIFIED
        met = "every hard goal is met" if any(goal.hard for goal in goals) else "no hard goals"
        parts = [f"{met}; loops rebuilt from K: stable, norms verified", "a local optimum"]
    status, reason = final_status(status, parts, budget)
    soft = [goal.value for goal in goals if not goal.hard] or [goal.value for goal in goals]
    return TunedSynthesis(
        K=K, gamma=max(soft), closed_loop=closed[0], status=status, reason=reason, limit="", plant=first, method="tune",
        goals=tuple(goals), limits=kept, parameters=fixed.parameter_values(law, p),
    )  # fmt: skip
