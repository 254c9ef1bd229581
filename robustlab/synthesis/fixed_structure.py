"""Controllers of a fixed structure or order: the parameters of smallest verified norm.

For one plant, several at once, or the worst member of an uncertain plant, by adding scenarios at worst cases.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import MILLION, NOT_REPEATABLE, Budget, one_thread
from robustlab.checks import choice, whole
from robustlab.display import AllFields, Facts
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.mu_analysis.axis.margin import WorstCaseGain
from robustlab.mu_analysis.axis.robustness import worst_case_gain
from robustlab.norms import H2Norm, HinfNorm, h2_by_gramians, hinf_norm
from robustlab.result import Status, Table, Tabular
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.synthesis.h2 import synthesize_h2
from robustlab.synthesis.hinf.hinf_synthesis import synthesize
from robustlab.synthesis.problem.certify import Certificate, certified
from robustlab.synthesis.problem.design import Synthesis, design_budget, final_status, limiting_channels
from robustlab.synthesis.problem.gamma_lower_bound import require_stabilisable
from robustlab.synthesis.problem.generalized_plant import (
    GeneralizedPlant,
    as_generalized_plant,
    common_scaling,
    require_performance,
)
from robustlab.synthesis.reduction.model_reduction import reduce_model
from robustlab.synthesis.structures.controller_structures import FixedOrder, Law, as_structure
from robustlab.synthesis.structures.objectives import DesignProblem, Limit, Start, multi_start
from robustlab.uncertainty.lft import UncertainModel
from robustlab.uncertainty.perturbation_systems import realise_delta

WHERE = "synth fixed"
VERIFIED = 4  # best candidates that are verified: the norm of the search is not a proof. More: slower, seldom better
SAME = 1 + 1e-4  # ratio of the verified norm to that of the search up to which no other candidate is verified
ROUNDS = 12  # most scenarios
ENOUGH = 1.01  # ratio of the worst-case gain to the scenarios' gain that ends the rounds. Smaller: more rounds
DESIGN_SHARE, SEARCH_SHARE = 0.5, 0.3  # of the remaining work: for one design, for one worst member with its proof
KEPT = 1e-9  # largest value at which a limit counts as kept: the search stays strictly inside
FULL_SHARE, FULL_WORK = 0.2, 10 * MILLION  # share of the remaining work for the full-order design, and most for it
FULL_HINF_REL, FULL_H2_REL = 1.05, 1.0005  # its norm over the optimum: a lower bandwidth is easier to reduce
MOST_STARTS = 10000  # largest number of random starts
MODES_WELL_APART = 1e6  # condition number of the modes of A_K up to which they are taken as coordinates


@dataclass(frozen=True)
class ParameterValue(AllFields):
    """A parameter of the controller with its value and bounds."""

    name: str
    value: float
    unit: str
    low: float
    high: float

    derived: ClassVar[tuple[str, ...]] = ("at_bound",)

    @property
    def at_bound(self) -> bool:
        """True within 0.2 % of the range (with one bound: of its own size) from a bound."""
        if self.low == self.high:
            return False
        width = self.high - self.low if abs(self.low) + abs(self.high) < float("inf") else max(abs(self.value), 1e-300)
        return min(self.value - self.low, self.high - self.value) <= 2e-3 * width


@dataclass(frozen=True)
class LimitValue(AllFields):
    """A limit of the design and its value: at most zero where it is kept, -1 far inside."""

    text: str
    value: float

    derived: ClassVar[tuple[str, ...]] = ("active",)

    @property
    def active(self) -> bool:
        """True where the design is at the limit (within 1 %)."""
        return self.value > -1e-2


@dataclass(frozen=True, eq=False, kw_only=True)
class ParametricDesign(Tabular, Synthesis):
    """Base of designs of a given structure, with the values of their parameters and limits."""

    parameters: tuple[ParameterValue, ...]
    limits: tuple[LimitValue, ...]  # with the largest value over all plants

    @property
    def values(self) -> dict[str, float]:
        """The parameters' values by name, usable as the start of another design."""
        return {p.name: p.value for p in self.parameters}

    def parameter_facts(self) -> Facts:
        """Return a row for each limit and each of the first parameters."""
        rows = [("limit", f"{limit.text}{' (active)' if limit.active else ''}") for limit in self.limits]
        shown = self.parameters[:40]
        rows += [(p.name, f"{p.value:.6g} {p.unit}{' (at its bound)' if p.at_bound else ''}".rstrip()) for p in shown]
        more = len(self.parameters) - len(shown)
        return [*rows, ("further parameters", str(more))] if more else rows


@dataclass(frozen=True, eq=False, kw_only=True)
class FixedSynthesis(ParametricDesign):
    """A controller of a given structure; ``gamma`` bounds the largest norm over all models.

    For an uncertain plant, ``gamma`` is the proved upper bound of the worst-case gain where that proof succeeded.
    """

    quantities: ClassVar[Mapping[str, Any]] = {"peak_frequency": float}
    saved = (
        "objective", "parameters", "gammas", "peak_frequency", "limits", "active", "starts", "scenarios",
        "worst_case_gain",
    )  # fmt: skip

    objective: str  # "hinf" or "h2"
    gammas: tuple[float, ...]  # verified norm (H-infinity: upper bound) of the loop of every model or scenario
    peak_frequency: float  # in rad/s, at which the worst loop attains its norm; NaN for H2
    starts: tuple[Start, ...]  # best first
    scenarios: tuple[Mapping[str, Any], ...] = ()  # the Delta of each, for an uncertain plant
    worst: WorstCaseGain | None = None  # over the whole set, for an uncertain plant
    plants: tuple[GeneralizedPlant, ...] = ()  # of every loop, or the uncertain plant of `worst`, for `rl.verify`

    @property
    def worst_case_gain(self) -> WorstCaseGain | None:
        return self.worst

    @property
    def active(self) -> tuple[str, ...]:
        """Active limits and parameters at their bounds."""
        bounds = tuple(f"{p.name} at its bound" for p in self.parameters if p.at_bound)
        return (*(limit.text for limit in self.limits if limit.active), *bounds)

    def _gamma_text(self) -> str:
        if self.objective == "h2":
            return f"{self.gamma:.6g} (H2 norm, both Gramians)"
        if self.worst is not None and self.gamma == self.worst.upper:
            return f"{self.gamma:.6g} (proved for the whole set; a member attains {self.worst.lower:.6g})"
        return f"{self.gamma:.6g} at {self.peak_frequency:.4g} rad/s (verified upper bound)"

    def facts(self) -> Facts:
        rows = super().facts()
        if len(self.gammas) > 1:
            label = "gamma of every scenario" if self.worst is not None else "gamma of every model"
            rows.insert(2, (label, ", ".join(f"{g:.5g}" for g in self.gammas)))
        stable = sum(s.gamma < float("inf") for s in self.starts)
        rows.append(("starts", f"{len(self.starts)}, of which {stable} stabilised"))
        return [*rows, *self.parameter_facts()]

    def table(self) -> Table:
        columns = {key: [getattr(p, key) for p in self.parameters] for key in ("value", "low", "high", "unit")}
        return Table(("parameter", [p.name for p in self.parameters]), columns)


@error_context("synth fixed")
def fixed_structure(
    P: Any,
    structure: Any = "static",
    *,
    n_meas: int | None = None,
    n_con: int | None = None,
    objective: str = "hinf",
    limits: Sequence[Limit] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    start: Any = None,
    starts: int = 16,
    seed: int = 0,
    time_limit: float | None = None,
    effort: float = 1.0,
    progress: Callable[[str], None] | None = None,
) -> FixedSynthesis:
    r"""Compute a controller of given structure with the smallest norm of the closed loop, ``u = K(p) y``.

    .. math:: \min_p \max_i \|F_l(P_i, K(p))\|, \qquad K(p) \text{ stabilises every } P_i

    BFGS brings every start to where all loops are stable and limits are kept, then down the norm; linear programs over
    all active peaks refine the best. The problem is not convex: the result is a local optimum, verified on the loops
    rebuilt from K. Lewis, Overton 2013 (BFGS); Apkarian, Noll 2006 (active peaks).

    Parameters
    ----------
    P
        Generalised plant in any form that `hinf` accepts, or a list of them (one controller for all). For an uncertain
        model the worst-case gain from w to z is minimised by adding scenarios, and its proved bound is reported.
    structure
        A structure of `robustlab.synthesis.structures.controller_structures`, an order, a mask of a static gain, a list
        of structures (one per channel), or words: ``"static"``, ``"pid"``, ``"order:2"``, ``"poles:-1,-20"``.
    objective, limits, bounds
        ``"hinf"`` or ``"h2"``; limits of the design: `Decay`, `Damping`, `Bandwidth`, `StableController`, `RollOff`;
        ``(low, high)`` by parameter name.
    start, starts, seed
        Further start: parameters by name, a list of such mappings, or an earlier result. Number of random starts, in
        addition to the given ones, the structure's own and, for a `FixedOrder`, the full-order design reduced to the
        order; and their seed.
    n_meas, n_con, time_limit, effort, progress
        As for `robustlab.hinf`.

    Returns
    -------
    FixedSynthesis
        The design, with a stabilising, verified K that keeps the limits.

    Raises
    ------
    InputError, NoTrustworthyNumber
        Plants that do not fit together, an unknown structure or parameter, an H2 norm that is infinite by structure. A
        mode that no controller can stabilise, or no start that stabilised all plants: no proof that there is none.

    Examples
    --------
    >>> from robustlab.statespace import StateSpaceModel
    >>> P = StateSpaceModel([[1.0]], [[1.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0], [0, 1], [0, 0]])
    >>> design = fixed_structure(P, "static", n_meas=1, n_con=1, objective="h2")  # the LQR gain 1 + sqrt(2)
    >>> round(design.gamma**2, 4), round(design.values["K[u2,y3]"], 3)
    (2.4142, -2.414)
    """
    choice(f"{WHERE}: objective", objective, ("hinf", "h2"))
    whole(f"{WHERE}: starts", starts, 0, MOST_STARTS)
    for limit in limits:
        if not isinstance(limit, Limit):
            raise InputError(f"{WHERE}: limits", f"{limit!r}", "Decay, Damping, Bandwidth, StableController, RollOff")
    budget = design_budget(WHERE, effort, time_limit)
    plants = _plants(P, n_meas, n_con)
    say = progress or (lambda _: None)
    with one_thread():
        first = plants[0]
        law = law_of(first, structure, bounds)
        given = [("given", p) for p in given_starts(law, start)]

        def design(problem: DesignProblem, known: Sequence[tuple[str, AnyArray]]) -> FixedSynthesis:
            return _best_verified(problem, multi_start(problem, known, starts, seed, say))

        if first.blocks:
            if objective != "hinf":
                expected = '"hinf", or a list of members'
                raise InputError(WHERE, f"objective {objective!r} of an uncertain plant", expected)
            return _for_worst_member(first, law, limits, given, budget, design, say)
        problem = DesignProblem(plants, law, objective, limits, budget)
        if objective == "h2":
            require_finite_h2(problem)
        ordered = isinstance(as_structure(structure, first), FixedOrder)
        return design(problem, [*given, *(_reduced_start(problem) if ordered else [])])


def law_of(plant: GeneralizedPlant, structure: Any, bounds: Mapping[str, tuple[float, float]] | None) -> Law:
    """Return the law of a structure, in any accepted form, on the plant's signals with these bounds by name."""
    law = as_structure(structure, plant).law(plant.measurements, plant.controls, plant.model.dt)
    parameters = list(law.parameters)
    for name, pair in (bounds or {}).items():
        q = parameters[j := _place(name, law)]
        try:
            low, high = (float(x) for x in pair)
        except (TypeError, ValueError):
            low = high = np.nan
        if not low <= high:
            raise InputError(f"{WHERE}: bounds of {name}", f"{pair!r}", "(low, high)")
        parameters[j] = replace(q, low=low, high=high, start=float(np.clip(q.start, low, high)))
    return replace(law, parameters=tuple(parameters))


def _plants(P: Any, n_meas: int | None, n_con: int | None) -> list[GeneralizedPlant]:
    given = list(P) if isinstance(P, (list, tuple)) else [P]
    if not given:
        raise InputError(WHERE, "an empty list of plants", "at least one")
    plants = [as_generalized_plant(plant, n_meas, n_con, WHERE) for plant in given]
    first = plants[0]
    for i, plant in enumerate(plants, start=1):
        place = WHERE if len(plants) == 1 else f"{WHERE}: plant {i}"
        if (plant.n_meas, plant.n_con, plant.model.dt) != (first.n_meas, first.n_con, first.model.dt):
            found = f"{plant.n_meas} measurements, {plant.n_con} controls, dt = {plant.model.dt:g} s"
            raise InputError(place, found, f"{first.n_meas}, {first.n_con} and {first.model.dt:g} s as plant 1")
        if plant.blocks and len(plants) > 1:
            raise InputError(place, "an uncertain model in a list", "its members (evaluate), or the set alone")
        require_performance(plant, place)
        continuous = plant.continuous()
        scaling = common_scaling([continuous])[0]
        require_stabilisable(scaling.apply(continuous.matrices()), plant.model.state_names, place, scaling.rate)
    return plants


def parameter_values(law: Law, p: AnyArray) -> tuple[ParameterValue, ...]:
    return tuple(
        ParameterValue(q.name, x, q.unit, q.low, q.high) for q, x in zip(law.parameters, p.tolist(), strict=True)
    )


def _place(name: str, law: Law) -> int:
    names = [p.name for p in law.parameters]
    return names.index(choice(f"{WHERE}: parameter", name, names))


def given_starts(law: Law, start: Any) -> list[AnyArray]:
    """Return the given starts as parameter vectors; missing parameters have the structure's own start."""
    if isinstance(start, Mapping) or not isinstance(start, Iterable):
        start = [] if start is None else [start]
    found: list[AnyArray] = []
    for item in start:
        values = item if isinstance(item, Mapping) else getattr(item, "values", None)
        if not isinstance(values, Mapping):
            raise InputError(f"{WHERE}: start", f"{type(item).__name__}", "values by parameter name")
        p = np.array([q.start for q in law.parameters], dtype=float)
        for name, value in values.items():
            q = law.parameters[j := _place(name, law)]
            if not q.low <= float(value) <= q.high:
                raise InputError(f"{WHERE}: start of {name}", f"{value}", f"{q.low:g} to {q.high:g}")
            p[j] = float(value)
        found.append(p)
    return found


def _reduced_start(problem: DesignProblem) -> list[tuple[str, AnyArray]]:
    """Return ``("reduced", p)``: the full-order design for the first plant, reduced to the order of the law.

    Nothing where either fails, or where that design has a lower order. It wins 21 of 38 COMPleib designs of order 1
    and 2 from one random start.
    """
    law, plant, budget = problem.law, problem.plants[0], problem.budget
    order, part = law.sizes[0], budget.share(min(FULL_SHARE, FULL_WORK / max(budget.left, 1.0)))
    if not order or part.over:
        return []
    try:
        hinf = problem.objective == "hinf"
        K = (synthesize(plant, "hinf", FULL_HINF_REL, part) if hinf else synthesize_h2(plant, FULL_H2_REL, part)).K
    except (InputError, NoTrustworthyNumber):
        return []
    for method in ("coprime", "truncation") if K.n_states >= order else ():
        # A controller can be too fast for the one, or have too many unstable modes for the other.
        with suppress(InputError, NoTrustworthyNumber):
            small = reduce_model(K, order, method=method).model if K.n_states > order else K
            A, B, C = _modal(small)
            p = np.zeros(len(law.parameters))
            p[law.top] = np.block([[A, B], [C, small.D]])[law.row, law.column]
            return [("reduced", np.clip(p, [q.low for q in law.parameters], [q.high for q in law.parameters]))]
    return []


def _modal(K: StateSpaceModel) -> tuple[AnyArray, AnyArray, AnyArray]:
    """Return A, B, C with A in real modal form, or as given where the modes are not well separated."""
    if not K.n_states:
        return K.A, K.B, K.C
    values, vectors = np.linalg.eig(K.A)
    columns: list[AnyArray] = []
    for value, vector in zip(values, vectors.T, strict=True):
        if value.imag > 0:
            columns += [vector.real, vector.imag]
        elif value.imag == 0:
            columns.append(vector.real)
    T = np.column_stack(columns)
    if np.linalg.cond(T) > MODES_WELL_APART:
        return K.A, K.B, K.C
    inverse = np.linalg.inv(T)
    A, B, C = inverse @ K.A @ T, inverse @ K.B, K.C @ T
    near = np.abs(np.subtract.outer(np.arange(len(A)), np.arange(len(A)))) <= 1
    A = np.where(near, A, 0.0)  # entries elsewhere are rounding
    size = np.sqrt(np.maximum(np.linalg.norm(B, axis=1), 1e-300) / np.maximum(np.linalg.norm(C, axis=0), 1e-300))
    size = np.where((size > 1e-8) & (size < 1e8), size, 1.0)
    return A * size[None, :] / size[:, None], B / size[:, None], C * size


# --- search -----------------------------------------------------------------------------------------------------------


def _best_verified(problem: DesignProblem, found: Sequence[Start]) -> FixedSynthesis:
    """Return the best verified design of some starts, best first."""
    kept: list[FixedSynthesis] = []
    for start in found[:VERIFIED]:
        design = _verified(problem, start) if np.isfinite(start.gamma) else None
        kept += [] if design is None else [design]
        if design is not None and design.status.trustworthy and design.gamma <= start.gamma * SAME:
            break
    if not kept:
        raise not_found(problem, found)
    best = min(kept, key=lambda d: (not d.status.trustworthy, d.gamma))
    parts = [best.reason, f"{len(found)} starts; a local optimum"]
    status, reason = final_status(best.status, parts, problem.budget)
    return replace(best, starts=tuple(found), status=status, reason=reason)


def _for_worst_member(
    plant: GeneralizedPlant, law: Law, limits: Sequence[Limit], given: Sequence[tuple[str, AnyArray]], budget: Budget,
    design: Callable[[DesignProblem, Sequence[tuple[str, AnyArray]]], FixedSynthesis], say: Callable[[str], None],
) -> FixedSynthesis:  # fmt: skip
    """Design on scenarios, add the worst Delta of the loop, and repeat; return the design of smallest worst case."""
    uncertain = UncertainModel(plant.model, plant.blocks)
    deltas: list[Mapping[str, Any]] = [{}]
    members = [GeneralizedPlant(uncertain.nominal, plant.n_meas, plant.n_con)]
    done: list[tuple[FixedSynthesis, WorstCaseGain]] = []
    last: list[tuple[str, AnyArray]] = []
    while len(done) < ROUNDS and not (done and budget.over):
        try:
            problem = DesignProblem(members, law, "hinf", limits, budget.share(DESIGN_SHARE))
            found = design(problem, [*last, *given])
        except NoTrustworthyNumber:
            if done:
                break
            raise
        loop = UncertainModel(lower_lft(uncertain.M, found.K), uncertain.blocks)
        worst = worst_case_gain(loop, tolerance=0.02, budget=budget.share(SEARCH_SHARE))
        done.append((replace(found, worst=worst, scenarios=tuple(deltas), plants=(plant,)), worst))
        say(f"{len(members)} scenarios: gain {found.gamma:.5g}, worst member {worst.lower:.5g}")
        member = _member(uncertain, worst) if worst.lower > ENOUGH * found.gamma else None
        if member is None:
            break
        last = [("given", np.array([p.value for p in found.parameters]))]
        deltas.append(dict(worst.delta))
        members.append(GeneralizedPlant(member, plant.n_meas, plant.n_con))
    found, worst = min(done, key=lambda pair: (pair[1].lower, pair[1].upper))
    if np.isfinite(worst.upper) and worst.status is Status.CERTIFIED:
        gamma = worst.upper if found.status.trustworthy else max(worst.upper, found.gamma)
        sound = Status.INACCURATE if found.status is Status.INACCURATE else Status.CERTIFIED
        parts = [found.reason, "worst-case gain over the whole set proved"]
    else:
        gamma, sound = max(found.gamma, worst.lower), Status.INCONCLUSIVE
        parts = ["the worst-case gain was not proved" if np.isfinite(worst.lower) else "a member is unstable"]
    status, reason = final_status(sound, [*parts, f"{len(found.scenarios)} scenarios"], budget)
    return replace(found, gamma=gamma, status=status, reason=reason)


def _member(uncertain: UncertainModel, worst: WorstCaseGain) -> StateSpaceModel | None:
    """Return the member at the worst Delta as a model; complex values are realised as stable systems."""
    with suppress(NoTrustworthyNumber):
        if not any(np.any(np.imag(value)) for value in worst.delta.values()):
            return uncertain.evaluate({name: np.real(value) for name, value in worst.delta.items()})
        if worst.frequency is not None:
            return uncertain.evaluate(realise_delta(uncertain.blocks, worst.delta, worst.frequency, uncertain.dt))
    return None


# --- verification -----------------------------------------------------------------------------------------------------


def kept_limits(
    limits: Sequence[Limit], loops: Sequence[StateSpaceModel], K: StateSpaceModel
) -> tuple[LimitValue, ...]:
    """Return the largest value of every limit over the loops rebuilt from K."""
    return tuple(LimitValue(limit.text, max(limit.value(loop, K) for loop in loops)) for limit in limits)


def certified_norm(
    plant: GeneralizedPlant, K: StateSpaceModel, objective: str
) -> tuple[HinfNorm | H2Norm, Certificate]:
    """Return the norm of the loop rebuilt from K and its certificate in ball arithmetic."""
    loop = plant.close(K)
    norm = hinf_norm(loop) if objective == "hinf" else h2_by_gramians(loop)
    return norm, certified(plant, K, norm)


def _verified(problem: DesignProblem, start: Start) -> FixedSynthesis | None:
    """Return the design of a start with the norms of its rebuilt loops; None if unstable or a limit is violated."""
    plants, law, first = problem.plants, problem.law, problem.plants[0]
    try:
        K = law.model(start.p, first.model.dt, first.measurements, first.controls)
        loops = tuple(plant.close(K) for plant in plants)
        limits = kept_limits(problem.limits, loops, K)
        if any(limit.value > KEPT for limit in limits):
            return None
        norms, proofs = zip(*(certified_norm(plant, K, problem.objective) for plant in plants), strict=True)
    except (InputError, NoTrustworthyNumber):  # entries overflow, or a loop is not well posed
        return None
    gammas = tuple(proof.gamma for proof in proofs)
    if not np.isfinite(gammas).all():
        return None
    worst = int(np.argmax(gammas))
    doubt, largest = next((proof.doubt for proof in proofs if proof.doubt), ""), norms[worst]
    proved = all(isinstance(norm, HinfNorm) or norm.status is Status.CERTIFIED for norm in norms)
    many = "loop" if len(norms) == 1 else f"{len(norms)} loops"
    peak = float(largest.frequency) if isinstance(largest, HinfNorm) else np.nan
    return FixedSynthesis(
        K=K, gamma=max(gammas), closed_loop=loops[worst],
        status=Status.INACCURATE if doubt else Status.CERTIFIED if proved else Status.CONVERGED,
        reason=doubt or f"{many} rebuilt from K: stable, norm proved in ball arithmetic",
        limit=limiting_channels(loops[worst], peak) if np.isfinite(peak) else "",
        plant=plants[worst], method="fixed", objective=problem.objective, parameters=parameter_values(law, start.p),
        gammas=gammas, peak_frequency=peak, limits=limits, starts=(start,),
        plants=tuple(plants),
    )  # fmt: skip


def require_finite_h2(problem: DesignProblem) -> None:
    """Raise where a continuous loop has a direct term and thus no H2 norm."""
    moved = problem.start + np.random.default_rng(0).standard_normal(len(problem.start))
    for i, (family, kind) in enumerate(zip(problem.families, problem.kinds, strict=True), start=1):
        for v in () if problem.dt or kind != "h2" else (problem.start, moved):
            loop = family.member(problem.theta(problem.parameters(v)[0]))
            if loop is not None and loop.loop.D.any():
                found = "the closed loop has a direct term from w to z: its H2 norm is infinite"
                expected = "D11 = 0, and no direct path from w over the controller to z"
                hint = "take a strictly proper structure, such as FixedOrder(n, strictly_proper=True)"
                raise InputError(f"{WHERE}: plant {i}", found, expected, hint)


def not_found(problem: DesignProblem, found: Sequence[Start]) -> NoTrustworthyNumber:
    """Return the error that names the unstable pole or the violated limits of the start that came nearest."""
    theta, discrete = problem.theta(min(found, key=lambda s: s.instability).p), problem.dt > 0
    edges = [family.abscissa(theta)[0] for family in problem.families]
    which = int(np.argmax(edges))
    if edges[which] < 0 and problem.limits:
        values = zip(problem.limited, problem.limit_values(theta), strict=True)
        broken = dict.fromkeys(limit.text for (limit, _), (c, _) in values if c >= 0)
        text = f"no start kept every limit; in the nearest, {', '.join(broken) or 'the norm'} fails"
    else:
        worst = problem.families[which].pole(theta, np.abs if discrete else np.real)
        pole = complex(np.nan) if worst is None else worst[0] * (1.0 if discrete else problem.scaling.rate)
        pole_text = f"{pole.real:.6g}" + (f"{pole.imag:+.6g}j" if pole.imag else "")
        plant = "the plant" if len(edges) == 1 else f"plant {which + 1}"
        text = f"no start stabilised {plant}: nearest pole {'z' if discrete else 's'} = {pole_text}"
    ended = f"; {NOT_REPEATABLE}" if problem.budget.struck else ""
    hint = "not found is no proof that there is none: try more starts, another seed, or a richer structure"
    return NoTrustworthyNumber(WHERE, f"{text} ({len(found)} starts{ended})", hint=hint)
