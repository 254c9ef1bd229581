r"""Controllers of a given structure for goals and several plants: hard goals met, the others made small.

With hard goals g and soft goals f the search makes :math:`\max(g, \alpha f)` small, first for alpha = 1, then again and
again for alpha = 1 / (the f reached), from where it is: the value starts at 1 and falls, so that every step keeps the
hard goals and lowers the soft ones, until both are 1. Where the hard goals are not met at first, alpha falls until they
are, at last to 0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import Budget, one_thread
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.norms import H2Norm, HinfNorm, h2_by_gramians, hinf_norm
from robustlab.result import Status
from robustlab.shown import Facts, number
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.synthesis.fixed.constants import VERIFIED, WORK
from robustlab.synthesis.fixed.design_goals import Goal, OvershootGoal, StandardLoop
from robustlab.synthesis.fixed.fixed_structure import (
    KEPT,
    LimitValue,
    ParameterValue,
    bounded_law,
    check_starts,
    given_starts,
    not_found,
    require_finite_h2,
)
from robustlab.synthesis.laws.controller_laws import Law, model_of
from robustlab.synthesis.laws.controller_structures import as_structure
from robustlab.synthesis.nonsmooth.constants import BARRIER_CLOSER
from robustlab.synthesis.nonsmooth.design_limits import Limit
from robustlab.synthesis.nonsmooth.design_problem import DesignProblem
from robustlab.synthesis.nonsmooth.parameter_search import central_path, multi_start, polished
from robustlab.synthesis.problem.design import Synthesis, design_budget, told
from robustlab.synthesis.problem.gamma_bounds import pointwise_bound
from robustlab.synthesis.problem.independent_check import norm_doubt
from robustlab.synthesis.problem.partition import GeneralizedPlant
from robustlab.synthesis.problem.scaling import common_scaling, equilibrated, paths_first
from robustlab.tables import Table, Tabular

# Factor of hard goals in the search, so that they hold after it; most rounds, and the gain that is worth another.
HARDER = 1 + 1e-5
GOAL_ROUNDS = 12
# Share of the work for the first search, from many starts.
GOAL_START = 0.6
# Weights of the soft goals, in turn, until the hard ones are met.
GOAL_SHARES = (0.5, 0.2, 0.05, 0.01, 0.0)
GOAL_PROGRESS = 1e-3


@dataclass(frozen=True)
class GoalValue:
    """A goal, and what the design reaches of it."""

    # text, hard: the goal in words, and whether it had to be met
    text: str
    hard: bool
    # Verified norm of its weighted loop for every plant (H-infinity: upper bound): met where at most 1.
    values: tuple[float, ...]
    # Proved for every controller of any structure: no value is below it; NaN where it was not asked for.
    floor: float = float("nan")
    # The plants whose loops with K have these norms, "hinf" or "h2"; for `robustlab.verify`.
    plants: tuple[GeneralizedPlant, ...] = ()
    norm: str = "hinf"

    @property
    def value(self) -> float:
        """The largest of the values."""
        return max(self.values)

    @property
    def met(self) -> bool:
        """At most 1."""
        return self.value <= 1

    def to_json(self) -> dict[str, Any]:
        told = {name: value for name, value in vars(self).items() if name not in ("plants", "norm")}
        return told | {"value": self.value, "met": self.met}


@dataclass(frozen=True, eq=False, kw_only=True)
class TunedSynthesis(Tabular, Synthesis):
    """A controller of given structure for goals, ``u = K (r - y)``.

    ``gamma`` is the largest value of the soft goals (of all goals where every one is hard); ``closed_loop`` is the loop
    of the first plant with all of its signals. CERTIFIED (CONVERGED with a variance among the goals) where every hard
    goal is met; INFEASIBLE where a hard one is proved to be out of reach of any controller; INCONCLUSIVE where one is
    missed and that is not known.

    Attributes
    ----------
    goals
        What was reached of every goal.
    limits
        The limits with their values, the largest over all plants.
    parameters
        The controller's parameters.
    overshoot
        Largest overshoot in percent of the outputs' responses to steps of their own references, over all plants:
        simulated, not proved; NaN where a response ends at zero.
    history
        Largest value of the soft goals after each round.
    """

    quantities: ClassVar[Mapping[str, Any]] = {
        **Synthesis.quantities, **dict.fromkeys(("missed", "overshoot"), float),
    }  # fmt: skip

    goals: tuple[GoalValue, ...]
    limits: tuple[LimitValue, ...]
    parameters: tuple[ParameterValue, ...]
    overshoot: float
    history: tuple[float, ...]

    @property
    def values(self) -> dict[str, float]:
        """The parameters' values by name; a start for another design."""
        return {p.name: p.value for p in self.parameters}

    @property
    def missed(self) -> tuple[GoalValue, ...]:
        """The hard goals that are not met."""
        return tuple(goal for goal in self.goals if goal.hard and not goal.met)

    def numbers(self) -> dict[str, Any]:
        return {**super().numbers(), "missed": len(self.missed)}

    def _gamma_text(self) -> str:
        return f"{self.gamma:.6g} (largest soft goal, verified)" if self.history else f"{self.gamma:.6g} (largest goal)"

    def facts(self) -> Facts:
        rows = super().facts()
        for goal in self.goals:
            word = ("hard" if goal.hard else "soft") + ("" if goal.met else ", missed" if goal.hard else ", above 1")
            floor = f"; no controller below {goal.floor:.4g}" if goal.floor > 1 else ""
            rows.append((goal.text, f"{goal.value:.4g} ({word}{floor})"))
        rows += [("limit", f"{limit.text}{' (active)' if limit.active else ''}") for limit in self.limits]
        rows.append(("overshoot, simulated", f"{number(self.overshoot)} %"))
        return rows + [(p.name, f"{p.value:.6g} {p.unit}".rstrip()) for p in self.parameters[:40]]

    def table(self) -> Table:
        """A row for each goal."""
        columns = {key: [getattr(goal, key) for goal in self.goals] for key in ("hard", "value", "met")}
        return Table(("goal", [goal.text for goal in self.goals]), columns)

    def to_json(self) -> dict[str, Any]:
        return super().to_json() | {
            "goals": [goal.to_json() for goal in self.goals],
            "missed": [goal.text for goal in self.missed],
            "limits": [limit.to_json() for limit in self.limits],
            "parameters": [p.to_json() for p in self.parameters],
            "overshoot": self.overshoot,
            "history": list(self.history),
        }


@told_as("synth tune")
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
    r"""Controller of a given structure that meets hard goals and makes the soft ones small, for one plant or several.

    .. math:: \min_p \max_{soft} f_i(p) \quad\text{such that}\quad f_j(p) \le 1 \text{ for hard goals}, \qquad
        u = K(p) (r - y)

    Every goal is a norm of a weighted closed loop, met where it is at most 1: tracking, sensitivity, gains, variances,
    disk margins, overshoot (by a proxy). Limits of poles and of the controller are always kept.

    Parameters
    ----------
    G
        Plant from controls to measurements, or a list of plants with the same signals and sample time; one controller
        for all of them.
    structure
        As for `robustlab.fixed_structure`; its measurements are the errors r - y.
    goals
        `TrackingGoal`, `SensitivityGoal`, `GainGoal`, `VarianceGoal`, `MarginGoal`, `OvershootGoal` of
        `robustlab.synthesis`, hard with ``hard=True``; and the limits `Decay`, `Damping`, `Bandwidth`,
        `StableController`, `RollOff`.
    bounds, start, starts, seed, time_limit, effort, progress
        As for `robustlab.fixed_structure`.

    Returns
    -------
    TunedSynthesis
        With what was reached of every goal, verified on loops rebuilt from K, and the hard goals that were missed.

    Raises
    ------
    InputError
        No goal but limits, plants that do not fit together, an unknown signal, a variance that is infinite by
        structure.
    NoTrustworthyNumber
        No start stabilised all plants and kept the limits; that is no proof that nothing does.

    References
    ----------
    Apkarian, Noll, "Nonsmooth H-infinity synthesis" (2006); Apkarian, Gahinet, Buhr, "Multi-model, multi-objective
    tuning of fixed-structure controllers", European Control Conference (2014).

    Examples
    --------
    >>> from robustlab.synthesis import MarginGoal, TrackingGoal
    >>> lag = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> found = tune(lag, "pi", [TrackingGoal(1.0), MarginGoal(1.0, hard=True)], starts=1)
    >>> found.status.value, found.gamma < 1, found.missed
    ('certified', True, ())
    """
    where = "synth tune"
    wanted = [goal for goal in goals if isinstance(goal, Goal)]
    limits = [goal for goal in goals if isinstance(goal, Limit)]
    if len(wanted) + len(limits) < len(goals):
        other = next(goal for goal in goals if not isinstance(goal, (Goal, Limit)))
        raise InputError(f"{where}: goals", f"{other!r}", "TrackingGoal, MarginGoal, ..., Damping, Decay, ...")
    if not wanted:
        raise InputError(f"{where}: goals", "none", "at least one goal beside the limits")
    check_starts(where, starts)
    budget = design_budget(where, WORK, effort, time_limit)
    loops = [StandardLoop.of(g) for g in _plants(G)]
    with one_thread():
        first = loops[0].plant
        law = as_structure(structure, common_scaling([first])[0].rate).law(
            first.measurements, first.controls, first.model.dt
        )
        law = bounded_law(law, bounds or {})
        search = _GoalSearch(loops, wanted, limits, law, budget, progress or (lambda _: None))
        p, history = search.found([("given", q) for q in given_starts(law, start)], starts, seed)
        return search.judged(p, history)


def _plants(G: Any) -> list[StateSpaceModel]:
    given = list(G) if isinstance(G, (list, tuple)) else [G]
    if not given:
        raise InputError("synth tune", "an empty list of plants", "at least one")
    models = [as_model(g, "synth tune: G") for g in given]
    first = models[0]
    if not first.n_inputs or not first.n_outputs:
        raise InputError(
            "synth tune: G", f"{first.n_outputs} outputs and {first.n_inputs} inputs", "at least one of each"
        )
    for i, other in enumerate(models[1:], start=2):
        if (other.input_names, other.output_names, other.dt) != (first.input_names, first.output_names, first.dt):
            found = f"plant {i} has other signals or another sample time"
            raise InputError(
                "synth tune", found, f"those of plant 1: {', '.join(first.input_names + first.output_names)}"
            )
    return models


@dataclass(frozen=True, eq=False)
class _GoalSearch:
    """The search for the parameters, and the verdict about them."""

    loops: Sequence[StandardLoop]
    goals: Sequence[Goal]
    limits: Sequence[Limit]
    law: Law
    budget: Budget
    say: Callable[[str], None]

    def _problem(self, alpha: float, soft: bool = True, part: float = 1.0) -> DesignProblem:
        """``max(g, alpha f)`` over all plants; without ``soft`` of the hard goals alone. Hard ones a little harder."""
        plants: list[GeneralizedPlant] = []
        kinds: list[str] = []
        for goal in self.goals:
            if goal.hard or soft:
                share = HARDER if goal.hard else alpha
                plants += [_times(goal.channel(loop), share) for loop in self.loops]
                kinds += [goal.norm] * len(self.loops)
        inner = [loop.plant for loop in self.loops] if self.limits else []
        budget = self.budget if part == 1 else self.budget.share(part)
        return DesignProblem(plants, self.law, kinds, self.limits, budget, limited=inner)

    def _reached(self, everything: DesignProblem, p: AnyArray) -> tuple[float, float]:
        """Largest hard and largest soft goal."""
        values = np.array(everything.norms(p)).reshape(len(self.goals), len(self.loops)).max(axis=1)
        hard = np.array([goal.hard for goal in self.goals])
        return float(values[hard].max(initial=0.0)), float(values[~hard].max(initial=0.0))

    def found(
        self, given: Sequence[tuple[str, AnyArray]], starts: int, seed: int
    ) -> tuple[AnyArray, tuple[float, ...]]:
        """Parameters, and the largest soft goal of every round (none where all goals are hard)."""
        everything = self._problem(1.0, part=GOAL_START)
        require_finite_h2(everything)
        ends = multi_start(everything, given, starts, seed, self.say)
        stable = [end for end in ends if np.isfinite(end.gamma)][:VERIFIED]
        if not stable:
            raise not_found(everything, ends)
        p, (hard, soft) = min(
            ((end.p, self._reached(everything, end.p)) for end in stable),
            key=lambda pair: (max(pair[1][0], 1.0), pair[1][1]),
        )
        for alpha in GOAL_SHARES:
            if hard <= 1 or self.budget.over:
                break
            p = self._improved(self._problem(alpha, soft=alpha > 0), p)
            hard, soft = self._reached(everything, p)
        some_soft = not all(goal.hard for goal in self.goals)
        history = [soft] * some_soft
        rounds = GOAL_ROUNDS if some_soft and hard and hard <= 1 else 0
        for k in range(rounds):
            if self.budget.over or soft <= 0:
                break
            q = self._improved(self._problem(1 / soft), p)
            other = self._reached(everything, q)
            if not (other[0] <= 1 and other[1] < soft):
                break
            settled = other[1] > soft * (1 - GOAL_PROGRESS)
            p, soft = q, other[1]
            history.append(soft)
            self.say(f"round {k + 1}: hard goals {other[0]:.5g}, soft goals {soft:.5g}")
            if settled:
                break
        return p, tuple(history)

    def _improved(self, problem: DesignProblem, p: AnyArray) -> AnyArray:
        v, _ = central_path(problem, problem.variables(p), BARRIER_CLOSER)
        q, value = polished(problem, problem.parameters(v)[0])
        return q if value < problem.norm(problem.variables(p))[0] else p

    # --- the verdict ---------------------------------------------------------------------------------------------

    def judged(self, p: AnyArray, history: tuple[float, ...]) -> TunedSynthesis:
        """The design with every goal verified on loops rebuilt from K."""
        first = self.loops[0].plant
        K = model_of(self.law, p, first.model.dt, first.measurements, first.controls)
        whole = [loop.plant.close(K) for loop in self.loops]
        limits = tuple(LimitValue(c.text, max(c.value(loop, K) for loop in whole)) for c in self.limits)
        if any(limit.value > KEPT for limit in limits):
            raise NoTrustworthyNumber("synth tune", "the limits do not hold for the loop rebuilt from K")
        doubts: list[str] = []
        goals = tuple(self._value(goal, K, doubts) for goal in self.goals)
        soft = [goal.value for goal in goals if not goal.hard] or [goal.value for goal in goals]
        status, parts = self._status(goals, doubts)
        status, reason = told(status, parts, self.budget)
        return TunedSynthesis(
            K=K, gamma=max(soft), closed_loop=whole[0], status=status, reason=reason, limit="", plant=first,
            method="tune", goals=goals, limits=limits, history=history,
            overshoot=max((_overshoot(loop, self.loops[0].g.output_names) for loop in whole), key=_nan_last),
            parameters=tuple(
                ParameterValue(q.name, float(x), q.unit, q.low, q.high)
                for q, x in zip(self.law.parameters, p, strict=True)
            ),
        )  # fmt: skip

    def _value(self, goal: Goal, K: StateSpaceModel, doubts: list[str]) -> GoalValue:
        values: list[float] = []
        plants = [goal.channel(loop) for loop in self.loops]
        for plant in plants:
            loop = plant.close(K)
            norm: HinfNorm | H2Norm = hinf_norm(loop) if goal.norm == "hinf" else h2_by_gramians(loop)
            value, doubt = norm_doubt(plant, K, loop, norm)
            doubts += [f"{goal.text}: {why}" for why in (doubt, "" if norm.status.trustworthy else norm.reason) if why]
            values.append(value)
        floor = float("nan")
        if goal.hard and goal.norm == "hinf" and max(values) > 1:
            floor = max(_floor(plant) for plant in plants)
        return GoalValue(goal.text, goal.hard, tuple(values), floor, tuple(plants), goal.norm)

    def _status(self, goals: Sequence[GoalValue], doubts: Sequence[str]) -> tuple[Status, list[str]]:
        if doubts:
            return Status.INACCURATE, list(doubts[:1])
        missed = [goal for goal in goals if goal.hard and not goal.met]
        if missed:
            said = "; ".join(f"hard goal missed: {goal.text} ({goal.value:.4g})" for goal in missed)
            if any(goal.floor > 1 for goal in missed):
                return Status.INFEASIBLE, [said, "no controller of any structure meets it (proved by a bound of gamma)"]
            return Status.INCONCLUSIVE, [said, "a local search: no proof that it cannot be met; take more starts"]
        computed = any(goal.norm == "h2" for goal in self.goals)
        hard = "every hard goal is met" if any(goal.hard for goal in goals) else "no hard goals"
        parts = [f"{hard}; loops rebuilt from K: stable, norms verified", "a local optimum"]
        if any(isinstance(goal, OvershootGoal) for goal in self.goals):
            parts.append("the overshoot is held by a proxy")
        return (Status.CONVERGED if computed else Status.CERTIFIED), parts


def _times(plant: GeneralizedPlant, share: float) -> GeneralizedPlant:
    """With z in another unit."""
    m, n_z = plant.model, plant.n_z
    C, D = np.array(m.C), np.array(m.D)
    C[:n_z] *= share
    D[:n_z] *= share
    return GeneralizedPlant(StateSpaceModel(m.A, m.B, C, D, m.dt, m.inputs, m.outputs), plant.n_meas, plant.n_con)


def _floor(plant: GeneralizedPlant) -> float:
    """What no controller of any structure gets below."""
    matrices = plant.continuous().matrices()
    bound = pointwise_bound(matrices, (paths_first(matrices), equilibrated(matrices)), plant.model.dt)
    return bound.value if bound.proved else 0.0


def _nan_last(value: float) -> float:
    return value if np.isfinite(value) else -np.inf


def _overshoot(loop: StateSpaceModel, outputs: Sequence[str], steps: int = 4000) -> float:
    """Largest overshoot in percent of y after steps of its own reference, over ten of the slowest time constants."""
    from scipy.linalg import expm

    worst = -np.inf
    for name in outputs:
        T = loop.select([f"reference {name}"], [f"output {name}"])
        poles, final = T.poles(), float(T.dc_gain()[0, 0])
        if abs(final) < 1e-9:
            continue
        if T.is_discrete:
            slowest = max(float(np.abs(poles).max(initial=0.0)), 1e-6)
            A, B, count = T.A, T.B, int(min(max(10 / -np.log(slowest), 10), 1e5))
        else:
            h, count = 10 / max(float(-poles.real.max(initial=-np.inf)), 1e-12) / steps, steps
            n = T.n_states
            moved = expm(h * np.block([[T.A, T.B], [np.zeros((1, n + 1))]]))
            A, B = moved[:n, :n], moved[:n, n:]
        x, top = np.zeros(T.n_states), -np.inf
        for _ in range(count):
            top = max(top, float((T.C @ x + T.D[:, 0])[0]) / final)
            x = A @ x + B[:, 0]
        worst = max(worst, 100 * (top - 1))
    return max(worst, 0.0) if np.isfinite(worst) else float("nan")
