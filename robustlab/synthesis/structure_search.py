"""Search for the parameters of a controller law: stabilise, follow the central path, descend on the norm, polish.

The first half of the path shows which basin a start lies in; only the best starts go on.

Every start goes through the same steps, with budgets in steps rather than in time, so that the same seed gives the same
answer; the time limit only cuts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.synthesis.active_peaks import sequential_linear
from robustlab.synthesis.bfgs import Function, bfgs
from robustlab.synthesis.design_problem import DesignProblem

__all__ = ["Start", "central_path", "multi_start", "polished", "stabilised"]

Array = NDArray[Any]
Late = Callable[[], bool]

# The abscissa (in scaled time) at which a start counts as stable, and the steps that move it further inside.
STABLE = -1e-6
STABILISE_STEPS, DEEPER_STEPS, DEEP = 300, 15, -0.5
# Weights of the barrier: the first finds the middle of the feasible set, the last ends within about a percent.
BARRIER = (3.0, 1.0, 0.3)
CLOSER = (0.1, 0.03)
BARRIER_STEPS, BARRIER_RTOL = 60, 1e-5
DESCENT_STEPS, DESCENT_RTOL = 40, 1e-6
# Starts that are followed to the end of the path, and those of them that are polished.
FOLLOWED, POLISHED, POLISH_ROUNDS, POLISH_STEPS = 4, 2, 8, 40
HEADROOM = 1.5
# Ends whose norms differ by less than this share count as the same optimum.
SAME = 1e-4


@dataclass(frozen=True)
class Start:
    """What became of one start.

    Attributes
    ----------
    kind
        ``"given"``, ``"structure"`` (its own start) or ``"random"``.
    instability
        Spectral abscissa (in the plant's scaled time) or violated limit where stabilisation ended; negative: feasible.
    gamma
        Norm at its end, in the plant's units, before verification; inf where it was never stable.
    p
        Its parameters.
    values
        Norms on the way.
    """

    kind: str
    instability: float
    gamma: float
    p: Array
    values: tuple[float, ...]

    def to_json(self) -> dict[str, Any]:
        """All but the parameters."""
        return {k: getattr(self, k) for k in ("kind", "instability", "gamma", "values")}


def stabilised(problem: DesignProblem, v: Array, late: Late) -> tuple[Array, float]:
    """Variables from v on that stabilise all loops and keep the limits, or the best found, and what is violated.

    The second is negative for a feasible design; else the spectral abscissa (in scaled time) or the violated limit.
    """

    def loops(x: Array, _: float) -> tuple[float, Array | None]:
        return problem.instability(x)

    def limits(x: Array, _: float) -> tuple[float, Array | None]:
        return problem.violation(x)

    v, value = _below_zero(loops, v, late)
    if value >= STABLE or not problem.limits:
        return v, value
    return _below_zero(limits, v, late)


def _below_zero(function: Function, v: Array, late: Late) -> tuple[Array, float]:
    """Descent until the function is negative, and a few steps further."""
    value = function(v, np.inf)[0]
    if value < STABLE:
        return v, value
    found = bfgs(function, v, max_steps=STABILISE_STEPS, stop_below=10 * STABLE, late=late)
    if found is None or found.value >= STABLE:
        return (v, value) if found is None else (found.x, found.value)
    deeper = bfgs(function, found.x, max_steps=DEEPER_STEPS, stop_below=DEEP, late=late)
    return (found.x, found.value) if deeper is None else (deeper.x, deeper.value)


def central_path(
    problem: DesignProblem, v: Array, late: Late, weights: Sequence[float] = BARRIER
) -> tuple[Array, list[float]]:
    """Minimisers of ``ln gamma + mu * barrier`` for falling mu, from feasible variables; norms on the way."""
    best, at = problem.norm(v)[0], v
    values = [best]
    if not np.isfinite(best) or best <= 0:
        return v, values
    z = np.append(v, np.log(HEADROOM * best))
    for mu in weights:

        def function(x: Array, _: float, mu: float = mu) -> tuple[float, Array | None]:
            return problem.barrier(x, mu)

        found = bfgs(function, z, max_steps=BARRIER_STEPS, rtol=BARRIER_RTOL, late=late)
        if found is None or late():
            break
        z = found.x
        value = problem.norm(z[:-1])[0]
        values.append(value)
        if value < best:
            best, at = value, z[:-1]
    return at, values


def _descended(problem: DesignProblem, v: Array, late: Late) -> tuple[Array, float]:
    found = bfgs(problem.norm, v, max_steps=DESCENT_STEPS, rtol=DESCENT_RTOL, late=late)
    return (v, problem.norm(v)[0]) if found is None else (found.x, found.value)


def polished(problem: DesignProblem, p: Array, late: Late) -> tuple[Array, float]:
    """Parameters improved by sequential linear programs and descents in turn."""
    free = problem.free
    low = np.array([c.parameter.low for c in problem.coordinates])
    high = np.array([c.parameter.high for c in problem.coordinates])
    p = p.copy()
    value = problem.value_at(p[free])
    for _ in range(POLISH_ROUNDS):
        if late():
            break
        q, reached = sequential_linear(
            problem.value_at, problem.pieces, p[free], low, high, max_steps=POLISH_STEPS, late=late
        )
        full = p.copy()
        full[free] = q
        v, descended = _descended(problem, problem.variables(full), late)
        if descended < reached:
            full, reached = problem.parameters(v)[0], descended
        gained = reached < value * (1 - 3e-4)
        if reached < value:
            p, value = full, reached
        if not gained:
            break
    return p, value


def _random(problem: DesignProblem, rng: np.random.Generator, uneven: bool) -> Array:
    """A random start; ``uneven`` ones spread their parameters over decades, because channels differ that much."""
    count = len(problem.free)
    spread = 10 ** (rng.uniform(-2.0, 2.0, count) if uneven else np.full(count, rng.uniform(-1.0, 1.0)))
    draw = rng.standard_normal(count)
    centred = np.array([c.parameter.centre != 0 for c in problem.coordinates], dtype=bool)
    bounded = np.array([c.logarithmic for c in problem.coordinates], dtype=bool)
    return problem.centre + draw * np.select([centred, bounded], [0.5, 0.3], spread)


def multi_start(
    problem: DesignProblem, given: Sequence[Array], starts: int, seed: int, late: Late, progress: Callable[[str], None]
) -> list[Start]:
    """All starts, the best ones polished; best first. Those that were never stable come last."""
    found: list[Start] = []
    total = len(given) + 1 + starts
    for i in range(total):
        if late() and found:
            break
        if i < len(given):
            kind, v = "given", problem.variables(given[i])
        elif i == len(given):
            kind, v = "structure", problem.start
        else:
            rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i - len(given),)))
            kind, v = "random", _random(problem, rng, (i - len(given)) % 2 == 0)
        found.append(_one_start(problem, kind, v, late))
        best = min(s.gamma for s in found)
        text = f"best norm {best:.6g}" if np.isfinite(best) else "none stabilises yet"
        progress(f"start {i + 1} of {total}: norm {found[-1].gamma:.6g}, {text}")
    found.sort(key=lambda s: s.gamma)
    followed = [_followed(problem, s, late) if i < FOLLOWED else s for i, s in enumerate(found)]
    return _best_polished(problem, sorted(followed, key=lambda s: s.gamma), late, progress)


def _one_start(problem: DesignProblem, kind: str, v: Array, late: Late) -> Start:
    v, instability = stabilised(problem, v, late)
    if instability >= STABLE:
        return Start(kind, instability, np.inf, problem.parameters(v)[0], ())
    v, values = central_path(problem, v, late)
    norms = tuple(x / problem.gain for x in values)
    return Start(kind, instability, min(norms), problem.parameters(v)[0], norms)


def _followed(problem: DesignProblem, start: Start, late: Late) -> Start:
    """A start taken to the end of the path and down the norm itself."""
    if not np.isfinite(start.gamma) or start.gamma == 0 or late():
        return start
    v, values = central_path(problem, problem.variables(start.p), late, CLOSER)
    v, value = _descended(problem, v, late)
    norms = (*start.values, *(x / problem.gain for x in (*values[1:], value)))
    gamma = value / problem.gain
    if not gamma < start.gamma:
        return start
    return Start(start.kind, start.instability, gamma, problem.parameters(v)[0], norms)


def _best_polished(
    problem: DesignProblem, found: list[Start], late: Late, progress: Callable[[str], None]
) -> list[Start]:
    done: list[Start] = []
    ends: list[float] = []  # norms of the starts that were polished, before it: one of each optimum is enough
    for start in found:
        new = np.isfinite(start.gamma) and all(abs(end - start.gamma) > SAME * start.gamma for end in ends)
        if len(ends) == POLISHED or not new or start.gamma == 0 or late():
            done.append(start)
            continue
        ends.append(start.gamma)
        p, value = polished(problem, start.p, late)
        gamma = value / problem.gain
        if gamma < start.gamma:
            progress(f"polished: norm {start.gamma:.6g} -> {gamma:.6g}")
        done.append(Start(start.kind, start.instability, gamma, p, (*start.values, gamma)))
    return sorted(done, key=lambda s: s.gamma)
