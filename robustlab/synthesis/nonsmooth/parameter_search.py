"""Search for the parameters of a controller law: stabilise, central path, descent on the norm, refinement."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import Budget
from robustlab.errors import InputError
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.laws.controller_laws import Law, LawBuilder, Parameter
from robustlab.synthesis.nonsmooth.descent_methods import Function, bfgs, sequential_linear
from robustlab.synthesis.nonsmooth.design_problem import DesignProblem
from robustlab.synthesis.problem.partition import GeneralizedPlant

STABLE = -1e-6  # abscissa (scaled time) at which a start counts as stable
STABILISE_STEPS = 300  # most steps to it
DEEPER_STEPS, DEEP = 15, -0.5  # further steps inside, and the abscissa at which they end
ENTRY_STEPS = 24  # steps on the norm of every start ...
FOLLOWED = 3  # ... number of distinct starts that continue to the end of the path ...
REFINED = 2  # ... and of those that are refined. More: slower, seldom better
REFINE_ROUNDS = 8
REFINE_STEPS = 40
SAME = 1e-4  # relative difference of norms below which ends count as the same optimum
BARRIER = (3.0, 1.0, 0.3)  # barrier weights, from the middle of the feasible set to within about 1 % of the optimum
BARRIER_CLOSER = (0.1, 0.03)  # weights for a start after a descent on the norm ...
BARRIER_KNOWN = (0.3, 0.1, 0.03)  # ... and for a known good controller
BARRIER_STEPS = 60
BARRIER_RTOL = 1e-5
HEADROOM = 1.5  # first level of the path over the norm
DESCENT_STEPS = 100  # of a descent on the norm
REFINE_DESCENT = 40  # of those between linear programs
DESCENT_RTOL = 1e-6
MODES_WELL_APART = 1e6  # condition number of the modes of A_K up to which they are taken as coordinates
MANY = 700  # number of parameters above which A_K is fixed: dense quasi-Newton steps become slow


@dataclass(frozen=True, eq=False)
class Start:
    """The result of one start."""

    kind: str  # `"given"`, `"reduced"`, `"structure"` (its own start) or `"random"`
    # Spectral abscissa (in the plant's scaled time) or violated limit at the end of stabilisation; negative: feasible.
    instability: float
    gamma: float  # norm at its end, in the plant's units, before verification; inf where it was never stable
    p: AnyArray  # its parameters
    values: tuple[float, ...]  # history of the norm

    def to_json(self) -> dict[str, Any]:
        return {k: getattr(self, k) for k in ("kind", "instability", "gamma", "values")}

    def moved(self, problem: DesignProblem, p: AnyArray, norms: Sequence[float]) -> Start:
        """Return the start moved to these parameters with these scaled norms if it ends lower, else itself."""
        values = tuple(x / problem.gain for x in norms)
        if not values[-1] < self.gamma:
            return self
        return replace(self, gamma=values[-1], p=p, values=(*self.values, *values))


def multi_start(
    problem: DesignProblem,
    given: Sequence[tuple[str, AnyArray]],
    starts: int,
    seed: int,
    progress: Callable[[str], None],
) -> list[Start]:
    """Return the results of all starts, the best ones refined; best first."""
    field: list[Start] = []
    total = len(given) + 1 + starts
    for i in range(total):
        if problem.budget.over and field:
            break
        if i < len(given):
            kind, v = given[i][0], problem.variables(given[i][1])
        elif i == len(given):
            kind, v = "structure", problem.start
        else:
            rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i - len(given),)))
            kind, v = "random", _random(problem, rng, (i - len(given)) % 2 == 0)
        field.append(_entered(problem, kind, v))
        best = min(start.gamma for start in field)
        text = f"best norm {best:.6g}" if np.isfinite(best) else "none stabilises yet"
        progress(f"start {i + 1} of {total}: norm {field[-1].gamma:.6g}, {text}")
    for improved, most in ((_followed, FOLLOWED), (_refined, REFINED)):
        field = _distinct_first(field)
        field = [improved(problem, s) if i < most and 0 < s.gamma < np.inf else s for i, s in enumerate(field)]
    return sorted(field, key=lambda s: s.gamma)


def _random(problem: DesignProblem, rng: np.random.Generator, uneven: bool) -> AnyArray:
    """Return a random start; ``uneven``: parameters over decades, as channels can differ that much."""
    count = len(problem.free)
    spread = 10 ** (rng.uniform(-2.0, 2.0, count) if uneven else np.full(count, rng.uniform(-1.0, 1.0)))
    draw = rng.standard_normal(count)
    centred = np.array([c.parameter.centre != 0 for c in problem.coordinates], dtype=bool)
    bounded = np.array([c.logarithmic for c in problem.coordinates], dtype=bool)
    return problem.centre + draw * np.select([centred, bounded], [0.5, 0.3], spread)


def _entered(problem: DesignProblem, kind: str, v: AnyArray) -> Start:
    """Stabilise a start and descend some steps; with limits, or where it is not random, along the central path."""
    v, instability = stabilised(problem, v)
    start = Start(kind, instability, np.inf, problem.parameters(v)[0], ())
    if instability >= STABLE:
        return start
    values = [problem.norm(v)[0]]
    if kind != "random" or problem.limits:
        v, values = central_path(problem, v)
    start = start.moved(problem, problem.parameters(v)[0], [*values, min(values)])
    v, value = _descended(problem, v, ENTRY_STEPS)
    return start.moved(problem, problem.parameters(v)[0], [value])


def _distinct_first(field: list[Start]) -> list[Start]:
    """Sort by norm, with those that end at the same optimum as a better one last."""
    first: list[Start] = []
    again: list[Start] = []
    for start in sorted(field, key=lambda s: s.gamma):
        known = any(abs(s.gamma - start.gamma) <= SAME * start.gamma for s in first if np.isfinite(start.gamma))
        (again if known else first).append(start)
    return first + again


def _followed(problem: DesignProblem, start: Start) -> Start:
    """Continue a start along the central path and by descent on the norm."""
    if problem.budget.over:
        return start
    v, values = central_path(problem, problem.variables(start.p), BARRIER_CLOSER)
    v, value = _descended(problem, v, DESCENT_STEPS)
    return start.moved(problem, problem.parameters(v)[0], [*values[1:], value])


def _refined(problem: DesignProblem, start: Start) -> Start:
    if problem.budget.over:
        return start
    p, value = refined(problem, start.p)
    return start.moved(problem, p, [value])


def _bfgs(problem: DesignProblem, function: Function, v: AnyArray, **steps: Any) -> tuple[AnyArray, float] | None:
    return bfgs(function, v, late=lambda: problem.budget.over, **steps)


def stabilised(problem: DesignProblem, v: AnyArray) -> tuple[AnyArray, float]:
    """Return variables that stabilise all loops and keep the limits, or the best found, and the violation."""
    value = np.inf
    for measure in (problem.instability, problem.violation)[: 2 if problem.limits else 1]:
        function: Function = lambda x, _, measure=measure: measure(x)  # noqa: E731
        value = measure(v)[0]
        for most, below in ((STABILISE_STEPS, 10 * STABLE), (DEEPER_STEPS, DEEP)) if value >= STABLE else ():
            v, value = _bfgs(problem, function, v, max_steps=most, stop_below=below) or (v, value)
            if value >= STABLE:
                break
        if value >= STABLE:
            break
    return v, value


def central_path(
    problem: DesignProblem, v: AnyArray, weights: Sequence[float] = BARRIER
) -> tuple[AnyArray, list[float]]:
    """Return the best minimiser of ``ln gamma + mu * barrier`` for decreasing mu, and the history of the norm."""
    best, at = problem.norm(v)[0], v
    values = [best]
    if not np.isfinite(best) or best <= 0:
        return v, values
    z = np.append(v, np.log(HEADROOM * best))
    for mu in weights:
        found = _bfgs(
            problem, lambda x, _, mu=mu: problem.barrier(x, mu), z, max_steps=BARRIER_STEPS, rtol=BARRIER_RTOL
        )
        if found is None or problem.budget.over:
            break
        z = found[0]
        value = problem.norm(z[:-1])[0]
        values.append(value)
        if value < best:
            best, at = value, z[:-1]
    return at, values


def _descended(problem: DesignProblem, v: AnyArray, steps: int) -> tuple[AnyArray, float]:
    found = _bfgs(problem, problem.norm, v, max_steps=steps, rtol=DESCENT_RTOL)
    return found or (v, problem.norm(v)[0])


def refined(problem: DesignProblem, p: AnyArray) -> tuple[AnyArray, float]:
    """Return parameters improved by sequential linear programs and descents in turn, and their norm."""
    free = problem.free
    low = np.array([c.parameter.low for c in problem.coordinates])
    high = np.array([c.parameter.high for c in problem.coordinates])
    p = p.copy()
    value = problem.value_at(p[free])
    for _ in range(REFINE_ROUNDS):
        if problem.budget.over:
            break
        q, reached = sequential_linear(
            problem.value_at,
            problem.pieces,
            p[free],
            low,
            high,
            max_steps=REFINE_STEPS,
            late=lambda: problem.budget.over,
        )
        full = p.copy()
        full[free] = q
        v, descended = _descended(problem, problem.variables(full), REFINE_DESCENT)
        if descended < reached:
            full, reached = problem.parameters(v)[0], descended
        gained = reached < value * (1 - 3e-4)
        if reached < value:
            p, value = full, reached
        if not gained:
            break
    return p, value


# --- from a known controller ------------------------------------------------------------------------------------------


def descend(plant: GeneralizedPlant, K0: StateSpaceModel, budget: Budget) -> StateSpaceModel:
    """Return a controller of the order of K0 with at most the norm of K0, by descent from K0."""
    if (K0.n_inputs, K0.n_outputs) != (plant.n_meas, plant.n_con):
        found = f"K0 has {K0.n_inputs} inputs and {K0.n_outputs} outputs"
        raise InputError("descend", found, f"{plant.n_meas} and {plant.n_con}")
    law, p = law_around(K0)
    problem = DesignProblem([plant], law, "hinf", (), budget)
    v = problem.variables(p)
    before = problem.norm(v)[0]
    if not np.isfinite(before) or budget.over:
        return K0
    v, _ = central_path(problem, v, BARRIER_KNOWN)
    q, after = refined(problem, problem.parameters(v)[0])
    if not after < before:
        return K0
    return law.model(q, K0.dt, K0.inputs, K0.outputs)


def law_around(K: StateSpaceModel) -> tuple[Law, AnyArray]:
    """Return a law that contains K, in coordinates with few parameters, and its parameters for K."""
    A, B, C = _modal(K)
    k, n_u, n_y = K.n_states, K.n_outputs, K.n_inputs
    builder, theta = LawBuilder(k, n_u, n_y), np.block([[A, B], [C, K.D]])
    row, column = np.indices(theta.shape)
    moves = (theta != 0) | (row >= k) | (column >= k) | (np.abs(row - column) <= 1)
    if moves.sum() > MANY:
        builder.base[:k, :k], moves[:k, :k] = A, False
    places = np.argwhere(moves)
    for i, j in places.tolist():
        builder.parameter(Parameter(f"Theta[{i + 1},{j + 1}]"), (i, j, 1.0))
    return builder.law(), theta[tuple(places.T)]


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
