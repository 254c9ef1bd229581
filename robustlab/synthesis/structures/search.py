"""Search for the parameters of a controller law: stabilise, descend on the norm, refine.

Norms are smooth almost everywhere. BFGS with a weak Wolfe line search is slow where several peaks have the same height;
sequential linear programs with one function for every peak near the maximum go on from there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import Budget
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.problem.partition import GeneralizedPlant
from robustlab.synthesis.structures.laws import Law, LawBuilder, Parameter
from robustlab.synthesis.structures.loops import Valued
from robustlab.synthesis.structures.problem import DesignProblem, Piece

STABLE = -1e-6  # abscissa (scaled time) at which a start counts as stable
STABILISE_STEPS = 300  # most steps to it
DEEPER_STEPS, DEEP = 15, -0.5  # further steps inside, and the abscissa at which they end
ENTRY_STEPS = 24  # steps on the norm of every start
REFINED = 2  # number of distinct starts that are refined. More: slower, seldom better
# Further refinements of the best from near it, and their distance relative to the variables. Without them the static
# gains of TF3 and HE3 in COMPleib from two random starts are 15 % and 5 % worse.
SHAKES, SHAKE = 2, 0.1
REFINE_ROUNDS = 8
DESCENT_STEPS = 100  # before the first round
ROUND_LINEAR, ROUND_DESCENT = 40, 40  # steps of a round
SAME = 1e-4  # relative difference of norms below which ends count as the same optimum
BARRIER = (3.0, 1.0, 0.3)  # weights of the limits' barrier, from the middle of the feasible set outwards
BARRIER_CLOSER = (0.1, 0.03)  # the same from a point that is known to be good
BARRIER_STEPS, BARRIER_RTOL = 60, 1e-5
DESCENT_RTOL = 1e-6
MODES_WELL_APART = 1e6  # condition number of the modes of A_K up to which they are taken as coordinates
MANY = 700  # number of parameters above which A_K is fixed: dense quasi-Newton steps become slow
DECREASE, CURVATURE = 1e-4, 0.5  # weak Wolfe conditions: shares of the predicted decrease and of the slope
LINE_STEPS = 25  # most trials of a line search
STALL_STEPS = 8  # consecutive steps of almost no decrease that end a descent. More: slower, rarely lower
RADIUS, SMALLEST_RADIUS, LARGEST_RADIUS = 3e-2, 1e-8, 0.5  # first, last, largest trust region, relative to parameters
WORTHWHILE = 1e-8  # predicted decrease, as a share of the value, that ends the search. Smaller: more programs for less

# ``function(x, give_up_above)``: value and gradient, which need not be exact where the value is above that level.
Function = Callable[[AnyArray, float], Valued]


@dataclass(frozen=True, eq=False)
class Start:
    """The result of one start."""

    kind: str  # `"given"`, `"reduced"`, `"structure"` (its own start) or `"random"`
    # Spectral abscissa (in the plant's scaled time) or violated limit at the end of stabilisation; negative: feasible.
    instability: float
    gamma: float  # norm at its end, in the plant's units, before verification; inf where it was never stable
    p: AnyArray  # its parameters

    def to_json(self) -> dict[str, Any]:
        return {k: getattr(self, k) for k in ("kind", "instability", "gamma")}


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
        kind, v = "structure", problem.start
        if i < len(given):
            kind, v = given[i][0], problem.variables(given[i][1])
        elif i > len(given):
            kind, v = "random", _random(problem, seed, i - len(given))
        v, instability = stabilised(problem, v)
        gamma = np.inf
        if instability < STABLE:
            v, gamma = descended(problem, v, ENTRY_STEPS, BARRIER)
        field.append(Start(kind, instability, gamma / problem.gain, problem.parameters(v)[0]))
        best = min(start.gamma for start in field)
        text = f"best norm {best:.6g}" if np.isfinite(best) else "none stabilises yet"
        progress(f"start {i + 1} of {total}: norm {field[-1].gamma:.6g}, {text}")
    field.sort(key=lambda s: s.gamma)
    distinct = [i for i, s in enumerate(field) if not i or s.gamma > field[i - 1].gamma * (1 + SAME)]
    for i in distinct[:REFINED]:
        field[i] = _improved(problem, field[i], field[i].p)
    field.sort(key=lambda s: s.gamma)
    rng = np.random.default_rng(seed)
    for _ in range(SHAKES):
        v = problem.variables(field[0].p)
        v = v + SHAKE * rng.standard_normal(len(v)) * np.maximum(np.abs(v), SHAKE)
        field[0] = _improved(problem, field[0], problem.parameters(v)[0])
    return field


def _random(problem: DesignProblem, seed: int, number: int) -> AnyArray:
    """Return a random start; every other one has parameters over decades, as channels can differ that much."""
    rng, count = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,))), len(problem.free)
    spread = 10 ** (np.full(count, rng.uniform(-1.0, 1.0)) if number % 2 else rng.uniform(-2.0, 2.0, count))
    sizes = np.select([problem.centred, problem.logarithmic], [0.5, 0.3], spread)
    return problem.centre + rng.standard_normal(count) * sizes


def _improved(problem: DesignProblem, start: Start, p: AnyArray) -> Start:
    """Return the start moved to the end of a refinement from p if that is lower, else itself."""
    if problem.budget.over or not 0 < start.gamma < np.inf:
        return start
    q, value = refined(problem, p)
    return replace(start, gamma=value / problem.gain, p=q) if value / problem.gain < start.gamma else start


def stabilised(problem: DesignProblem, v: AnyArray) -> tuple[AnyArray, float]:
    """Return variables that stabilise all loops and keep the limits, or the best found, and the violation."""
    value = np.inf
    for measure in (problem.instability, problem.violation)[: 2 if problem.limits else 1]:
        value = measure(v)[0]
        for most, below in ((STABILISE_STEPS, 10 * STABLE), (DEEPER_STEPS, DEEP)) if value >= STABLE else ():
            v, value = bfgs(measure, v, problem, most, stop_below=below) or (v, value)
            if value >= STABLE:
                break
        if value >= STABLE:
            break
    return v, value


def descended(problem: DesignProblem, v: AnyArray, steps: int, weights: Sequence[float] = ()) -> tuple[AnyArray, float]:
    """Return the best end of descents on the norm, with limits first under their barrier of falling weight."""
    at, best = v, problem.norm(v)[0]
    for mu in (*weights, 0.0) if problem.limits else (0.0,):
        most, rtol = (BARRIER_STEPS, BARRIER_RTOL) if mu else (steps, DESCENT_RTOL)
        found = bfgs(lambda x, above, mu=mu: problem.norm(x, above, mu), v if mu else at, problem, most, rtol)
        if found is None:
            break
        v, value = found[0], problem.norm(found[0])[0] if mu else found[1]
        at, best = (v, value) if value < best else (at, best)
    return at, best


def refined(problem: DesignProblem, p: AnyArray) -> tuple[AnyArray, float]:
    """Return parameters improved by a descent, then by linear programs and descents in turn, and their norm."""
    value = problem.value_at(p[problem.free])
    v, lower = descended(problem, problem.variables(p), DESCENT_STEPS, BARRIER_CLOSER)
    p, value = (problem.parameters(v)[0], lower) if lower < value else (p, value)
    for _ in range(REFINE_ROUNDS):
        if problem.budget.over:
            break
        q, reached = sequential_linear(problem, p[problem.free], ROUND_LINEAR)
        full = problem.filled(q)
        v, lower = descended(problem, problem.variables(full), ROUND_DESCENT)
        if lower < reached:
            full, reached = problem.parameters(v)[0], lower
        gained = reached < value * (1 - 3e-4)
        if reached < value:
            p, value = full, reached
        if not gained:
            break
    return p, value


# --- BFGS -------------------------------------------------------------------------------------------------------------


def bfgs(
    function: Function, x: AnyArray, problem: DesignProblem, max_steps: int, rtol: float = 1e-9,
    stop_below: float = -np.inf,
) -> tuple[AnyArray, float] | None:  # fmt: skip
    """Return the end of a descent from x and its value; None where the function has no finite value at x."""
    value, gradient = function(x, np.inf)
    if gradient is None or not np.isfinite(value) or not np.isfinite(gradient).all():
        return None
    inverse, fresh, stalled, steps = _steepest(gradient, 1.0), True, 0, 0
    while steps < max_steps and value >= stop_below and stalled < STALL_STEPS and not problem.budget.over:
        direction = -inverse @ gradient
        slope = float(gradient @ direction)
        found = _line_search(function, x, value, direction, slope, stop_below, problem.budget) if slope < 0 else None
        if found is None:
            if fresh:
                break
            inverse, fresh = _steepest(gradient, 1e-2 * float(np.linalg.norm(direction))), True
            continue
        new, new_value, new_gradient = found
        s, y = new - x, new_gradient - gradient
        inverse, fresh = _updated(inverse, s, y, fresh)
        stalled = stalled + 1 if value - new_value < rtol * abs(value) else 0
        x, value, gradient, steps = new, new_value, new_gradient, steps + 1
    return x, value


def _steepest(gradient: AnyArray, length: float) -> AnyArray:
    return np.eye(len(gradient)) * (length / max(float(np.linalg.norm(gradient)), 1e-300))


def _updated(inverse: AnyArray, s: AnyArray, y: AnyArray, fresh: bool) -> tuple[AnyArray, bool]:
    sy = float(s @ y)
    # y^T y can underflow to zero.
    if not sy > 1e-14 * float(np.linalg.norm(s) * np.linalg.norm(y)) or not y @ y > 0:
        return inverse, fresh
    if fresh:
        inverse = np.eye(len(s)) * (sy / float(y @ y))
    hy = inverse @ y
    scale = (1 + float(y @ hy) / sy) / sy
    cross = np.outer(hy, s) / sy
    return inverse + scale * np.outer(s, s) - cross - cross.T, False


def _line_search(
    function: Function, x: AnyArray, value: float, direction: AnyArray, slope: float, stop_below: float, budget: Budget
) -> tuple[AnyArray, float, AnyArray] | None:
    """Return a point that meets the weak Wolfe conditions, or sufficient decrease alone (Lewis, Overton, alg. 2.6)."""
    step, low, high = 1.0, 0.0, np.inf
    best: tuple[AnyArray, float, AnyArray] | None = None
    for _ in range(LINE_STEPS):
        new = x + step * direction
        level = value + DECREASE * step * slope
        new_value, gradient = function(new, level)
        if gradient is None or not new_value <= level or not np.isfinite(gradient).all():
            high = step
        else:
            best = new, new_value, gradient
            if float(gradient @ direction) >= CURVATURE * slope or new_value < stop_below:
                break
            low = step
        step = 0.5 * (low + high) if np.isfinite(high) else 2 * step
        if budget.over or (np.isfinite(high) and high - low < 1e-14):
            break
    return best


# --- sequential linear programs ---------------------------------------------------------------------------------------


def sequential_linear(problem: DesignProblem, x: AnyArray, max_steps: int) -> tuple[AnyArray, float]:
    """Return the best free parameters found from x, and their norm, by linear programs over active pieces."""
    value, radius = problem.value_at(x), RADIUS
    for _ in range(max_steps):
        if problem.budget.over or radius < SMALLEST_RADIUS or not np.isfinite(value):
            break
        size = np.maximum(np.abs(x), 1e-2 * max(float(np.median(np.abs(x))), 1e-12))
        step = _step(problem.pieces(x, value, radius), size, radius, problem.low - x, problem.high - x)
        if step is None:
            radius *= 0.5
            continue
        d, predicted = step
        if value - predicted < WORTHWHILE * value:
            break
        new_value = problem.value_at(x + d)
        if new_value < value - 0.02 * (value - predicted):
            if value - new_value > 0.5 * (value - predicted):
                radius = min(2 * radius, LARGEST_RADIUS)
            x, value = x + d, new_value
        else:
            radius *= 0.4
    return x, value


def _step(
    pieces: list[Piece], size: AnyArray, radius: float, low: AnyArray, high: AnyArray
) -> tuple[AnyArray, float] | None:
    """Return the step within the trust region that makes the linearised pieces smallest, and their value there."""
    from scipy.optimize import linprog

    objective = np.array([not limit for _, _, limit in pieces], dtype=bool)
    values = np.array([value for value, _, _ in pieces])
    top = float(values[objective].max(initial=0.0))
    if not top > 0:
        return None
    n, scales = len(size), np.where(objective, top, 1.0)
    slopes = np.array([gradient for _, gradient, _ in pieces]) * size / scales[:, None]
    rows = np.hstack([slopes, -1.0 * objective[:, None]])
    if not np.isfinite(rows).all():
        return None
    lower, upper = np.clip(low / size, -radius, 0.0), np.clip(high / size, 0.0, radius)
    bounds = [*zip(lower, upper, strict=True), (None, None)]
    found = linprog(np.append(np.zeros(n), 1.0), A_ub=rows, b_ub=-values / scales, bounds=bounds, method="highs")
    return (found.x[:n] * size, float(found.x[n] * top)) if found.status == 0 else None


# --- from a known controller ------------------------------------------------------------------------------------------


def descend(plant: GeneralizedPlant, K0: StateSpaceModel, budget: Budget) -> StateSpaceModel:
    """Return a controller of the order of K0 with at most the norm of K0, by descent from K0."""
    law, p = law_around(K0)
    problem = DesignProblem([plant], law, "hinf", (), budget)
    before = problem.value_at(p)
    if not np.isfinite(before) or budget.over:
        return K0
    q, after = refined(problem, p)
    return law.model(q, K0.dt, K0.inputs, K0.outputs) if after < before else K0


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
