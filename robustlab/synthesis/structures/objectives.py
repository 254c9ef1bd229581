"""Search for the parameters of a controller law that minimise norms of loops under limits: stabilise, descend, refine.

Norms are smooth almost everywhere. BFGS with a weak Wolfe line search is slow where several peaks have the same height;
sequential linear programs with one function for every peak near the maximum go on from there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import Budget, dense
from robustlab.checks import number
from robustlab.norms import linf_norm
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.problem.generalized_plant import GeneralizedPlant, Realisation, Scaling, common_scaling
from robustlab.synthesis.structures.controller_structures import Law, unpacked
from robustlab.synthesis.structures.loops import LoopFamily, Valued, extreme_pole

INSIDE = 1e-3  # least distance of a start from its bounds, as a share of their range

LimitAt = tuple[float, AnyArray]  # the c of a limit for a packed controller, with its gradient


# --- limits -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Limit:
    """Base of all limits: a dimensionless c that must be negative, -1 far inside."""

    of_controller: ClassVar[bool] = False  # True for a limit of the controller alone, with one value for all plants
    words: ClassVar[str]

    def __post_init__(self) -> None:
        for field in fields(self):
            where = f"fixed structure: {type(self).__name__}: {field.name}"
            number(where, getattr(self, field.name), above=0, at_most=1 if field.name == "ratio" else np.inf)

    @property
    def text(self) -> str:
        return self.words.format(**vars(self))

    def value(self, plant_loop: StateSpaceModel, K: StateSpaceModel) -> float:
        """Return the c of a finished design; negative or zero where the limit is kept."""
        raise NotImplementedError

    def evaluate(self, family: LoopFamily, theta: AnyArray, scaling: Scaling, dt: float) -> LimitAt:
        """Return the c and its gradient by the packed controller of the scaled plant; infinite without a value."""
        raise NotImplementedError


def _continuous_poles(poles: AnyArray, dt: float) -> AnyArray:
    """Return poles in rad/s, ``log(z)/dt`` for a sampled loop."""
    return np.log(np.where(poles == 0, 1e-300, poles).astype(complex)) / dt if dt else poles


@dataclass(frozen=True)
class _PoleLimit(Limit):
    """A limit of every pole of the loop."""

    def measure(self, s: AnyArray) -> tuple[AnyArray, AnyArray]:
        """Return the c of poles s, and the w with ``dc = Re(w ds)``."""
        raise NotImplementedError

    def value(self, plant_loop: StateSpaceModel, K: StateSpaceModel) -> float:
        poles = plant_loop.poles()
        return float(self.measure(_continuous_poles(poles, plant_loop.dt))[0].max(initial=-1.0))

    def evaluate(self, family: LoopFamily, theta: AnyArray, scaling: Scaling, dt: float) -> LimitAt:
        unit = 1.0 if dt else scaling.rate
        found = family.pole(theta, lambda poles: self.measure(_continuous_poles(unit * poles, dt))[0])
        if found is None:
            return np.inf, np.zeros_like(theta)
        pole, G = found
        c, w = self.measure(_continuous_poles(np.array([unit * pole]), dt))
        return float(c[0]), np.real(w[0] * (1 / (pole * dt) if dt and pole else unit) * G)


@dataclass(frozen=True)
class Decay(_PoleLimit):
    """Every mode of the loop decays at least as ``exp(-rate t)``; rate in 1/s."""

    rate: float
    words = "decay rate >= {rate:g} 1/s"

    def measure(self, s: AnyArray) -> tuple[AnyArray, AnyArray]:
        return np.real(s) / self.rate + 1, np.full(len(s), 1 / self.rate)


@dataclass(frozen=True)
class Damping(_PoleLimit):
    """Every mode of the loop has at least this damping ratio (0 to 1)."""

    ratio: float
    words = "damping >= {ratio:g}"

    def measure(self, s: AnyArray) -> tuple[AnyArray, AnyArray]:
        size = np.maximum(np.abs(s), 1e-300)
        return self.ratio + np.real(s) / size, 1 / size - np.real(s) * np.conj(s) / size**3


@dataclass(frozen=True)
class Bandwidth(_PoleLimit):
    """No pole of the loop has a modulus above this frequency in rad/s."""

    frequency: float
    words = "poles within {frequency:g} rad/s"

    def measure(self, s: AnyArray) -> tuple[AnyArray, AnyArray]:
        size = np.maximum(np.abs(s), 1e-300)
        return np.abs(s) / self.frequency - 1, np.conj(s) / (size * self.frequency)


@dataclass(frozen=True)
class StableController(Limit):
    """The controller itself is stable (integrators are not)."""

    of_controller = True
    words = "controller stable"

    def value(self, plant_loop: StateSpaceModel, K: StateSpaceModel) -> float:
        return K.spectral_abscissa() if K.n_states else -1.0

    def evaluate(self, family: LoopFamily, theta: AnyArray, scaling: Scaling, dt: float) -> LimitAt:
        k, G = family.order, np.zeros_like(theta)
        if not k:
            return -1.0, G
        if not np.isfinite(theta).all():
            return np.inf, G
        at, u, v = extreme_pole(theta[:k, :k], np.abs if dt else np.real)
        size, by = max(abs(at), 1e-300), np.outer(u, v)
        G[:k, :k] = np.real(by * np.conj(at) / size) if dt else np.real(by)
        return float(size - 1 if dt else at.real), G


@dataclass(frozen=True)
class RollOff(Limit):
    """The controller's gain is at most ``gain`` at and above ``frequency`` (rad/s), in the plant's units."""

    of_controller = True
    words = "controller gain <= {gain:g} from {frequency:g} rad/s on"
    frequency: float
    gain: float

    def value(self, plant_loop: StateSpaceModel, K: StateSpaceModel) -> float:
        return self._peak(Realisation.of(K), self.frequency, K.dt)[0] / self.gain - 1

    def _peak(self, K: Realisation, frequency: float, dt: float) -> tuple[float, float]:
        """Return the proved largest gain from this frequency on, and its frequency."""
        if not all(np.isfinite(m).all() for m in K):
            return np.inf, np.nan
        last = np.pi / dt if dt else np.inf
        found = linf_norm(StateSpaceModel(*K, dt), 1e-9, band=(min(frequency, (1 - 1e-9) * last), last))
        return found.upper, found.frequency

    def evaluate(self, family: LoopFamily, theta: AnyArray, scaling: Scaling, dt: float) -> LimitAt:
        # In the units of the plant's signals, but in the scaled plant's time.
        k, ones = family.order, np.ones(family.order)
        back = np.append(ones, scaling.u)[:, None] * np.append(ones, scaling.y)
        K = Realisation(*unpacked(theta * back, k))
        value, omega = self._peak(K, self.frequency if dt else self.frequency / scaling.rate, dt)
        if not np.isfinite(value):
            return np.inf, np.zeros_like(theta)
        gain, row, column = K.D, np.zeros((k, K.D.shape[0])), np.zeros((k, K.D.shape[1]))
        if k and np.isfinite(omega):
            shifted = (np.exp(1j * omega * dt) if dt else 1j * omega) * np.eye(k) - K.A
            row, column = np.linalg.solve(shifted.T, K.C.T + 0j), np.linalg.solve(shifted, K.B + 0j)
            gain = K.C @ column + K.D
        left, _, right = np.linalg.svd(gain)
        u, v = left[:, 0].conj(), right[0].conj()
        by_theta = np.outer(np.append(row @ u, u), np.append(column @ v, v))
        return value / self.gain - 1, np.real(by_theta) / self.gain * back


# --- the problem ------------------------------------------------------------------------------------------------------


Piece = tuple[float, AnyArray, bool]  # an active function: value, gradient by the free parameters, whether a limit


class DesignProblem:
    """The closed loops of all plants as functions of the search variables v of a law.

    ``objective``: the norm of every plant's loop, or one for all; ``limited``: plants whose loops have the limits.
    """

    def __init__(
        self, plants: Sequence[GeneralizedPlant], law: Law, objective: str | Sequence[str], limits: Sequence[Limit],
        budget: Budget, limited: Sequence[GeneralizedPlant] = (),
    ) -> None:  # fmt: skip
        self.budget = budget
        self.kinds = (objective,) * len(plants) if isinstance(objective, str) else tuple(objective)
        self.plants, self.law, self.objective, self.limits = tuple(plants), law, self.kinds[0], tuple(limits)
        self.dt = plants[0].model.dt
        scalings = common_scaling([*plants, *limited])
        self.scaling = scalings[0]
        k = law.sizes[0]
        rate, u, y = self.scaling.rate, self.scaling.u, self.scaling.y
        # Norms of the scaled plants; an H2 norm next to H-infinity norms is in their unit of time.
        self._h2_unit = float(np.sqrt(rate)) if "hinf" in self.kinds else 1.0
        self.gain = self.scaling.gain if "hinf" in self.kinds else self.scaling.gain / np.sqrt(rate)
        # Theta of the scaled plant is that of the law, entry by entry times this.
        self._scale = np.concatenate([np.full(k, 1 / rate), 1 / u])[:, None] * np.concatenate([np.ones(k), 1 / y])
        families = [
            LoopFamily(s.apply(plant.matrices()), plant.D22 * y[:, None] * u, k, self.dt > 0)
            for s, plant in zip(scalings, [*plants, *limited], strict=True)
        ]
        self.families = families[: len(self.plants)]
        self._each = list(zip(self.families, self.kinds, strict=True))
        self.limited = [
            (limit, family)
            for limit in limits
            for family in (families[len(self.plants) :] or families)[: 1 if limit.of_controller else None]
        ]
        self._set_coordinates()
        # Measured work of one evaluation: the law, and for every loop its poles and a norm with its gradient.
        self._work = 300 + sum(dense(len(family.A), 2) for family in self.families)

    def _set_coordinates(self) -> None:
        everything = self.law.parameters
        low, high, start, centre = np.array([(q.low, q.high, q.start, q.centre) for q in everything]).reshape(-1, 4).T
        self.fixed = np.clip(start, low, high)
        self.free = np.flatnonzero(low < high)
        self.low, self.high, self.centred = low[self.free], high[self.free], centre[self.free] != 0
        # A change of one in v changes the scaled controller by one.
        steep = self.law.steepness(self.fixed, self._scale)[self.free]
        self._size = 1 / np.where((steep > 0) & np.isfinite(steep), steep, 1.0)
        self._above, self._below = np.isfinite(self.low), np.isfinite(self.high)
        self._both = self._above & self._below
        self.logarithmic = self._both & (self.low > 0) & (self.high > 10 * self.low)
        first, last = np.where(self._both, self.low, 0.0), np.where(self._both, self.high, 2.0)
        for end in (first, last):
            end[self.logarithmic] = np.log(end[self.logarithmic])
        self._first, self._half = first, 0.5 * (last - first)
        self._unit = np.where(self.logarithmic, 1.0, np.minimum(self._size / self._half, 1.0))
        self.start = self.variables(self.fixed)
        self.centre = self.start + centre[self.free]

    # --- variables, parameters, controllers --------------------------------------------------------------------------

    def parameters(self, v: AnyArray) -> tuple[AnyArray, AnyArray]:
        """Return all parameters, and the derivatives of the free ones with respect to v."""
        angle, root = v * self._unit, np.sqrt(1 + v * v)
        inside, by_inside = self._first + self._half * (1 + np.sin(angle)), self._half * np.cos(angle) * self._unit
        powers = np.exp(inside, where=self.logarithmic, out=np.ones_like(inside))
        inside, by_inside = np.where(self.logarithmic, powers, inside), by_inside * powers
        away, by_away = self._size * (root - 1), self._size * v / root
        kinds = [self._both, self._above, self._below]
        p = self.fixed.copy()
        p[self.free] = np.select(kinds, [inside, self.low + away, self.high - away], self._size * v)
        return p, np.select(kinds, [by_inside, by_away, -by_away], self._size)

    def variables(self, p: AnyArray) -> AnyArray:
        """Return the search variables of given parameters, those at a bound a little inside."""
        q = p[self.free]
        inside = np.log(q, where=self.logarithmic, out=q.copy()) - self._first
        share = np.clip(inside / (2 * self._half), INSIDE, 1 - INSIDE)
        away = np.maximum(np.where(self._above, q - self.low, self.high - q) / self._size, INSIDE)
        hyperbola = np.sqrt((1 + away) ** 2 - 1)
        kinds = [self._both, self._above | self._below]
        return np.select(kinds, [np.arcsin(2 * share - 1) / self._unit, hyperbola], q / self._size)

    def filled(self, q: AnyArray) -> AnyArray:
        """Return all parameters from the free ones."""
        p = self.fixed.copy()
        p[self.free] = q
        return p

    def theta(self, p: AnyArray) -> AnyArray:
        """Return the packed controller of the scaled plant."""
        return self.law.packed(p) * self._scale

    def by_parameters(self, p: AnyArray, G: AnyArray) -> AnyArray:
        """Return the gradient by the free parameters from that by the scaled packed controller."""
        return self.law.pullback(p, G * self._scale)[self.free]

    # --- objectives --------------------------------------------------------------------------------------------------

    def instability(self, v: AnyArray, _: float = np.inf) -> Valued:
        """Return the largest spectral abscissa of all loops (discrete: modulus minus one) with its gradient."""
        p, slopes, theta = self._at(v)
        value, G = max((family.abscissa(theta) for family in self.families), key=lambda found: found[0])
        return value, None if G is None else self.by_parameters(p, G) * slopes

    def violation(self, v: AnyArray, _: float = np.inf) -> Valued:
        """Return the largest limit value with its gradient; infinite for an unstable loop."""
        p, slopes, theta = self._at(v)
        if not all(family.abscissa(theta)[0] < 0 for family in self.families):
            return np.inf, None
        worst, G = max(self.limit_values(theta), key=lambda pair: pair[0])
        return worst, self.by_parameters(p, G) * slopes if np.isfinite(worst) else None

    def _at(self, v: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
        self.budget.spend(self._work)
        p, slopes = self.parameters(v)
        return p, slopes, self.theta(p)

    def limit_values(self, theta: AnyArray) -> list[LimitAt]:
        """Return the c and the gradient of every limit and plant; an infinite c where there is no value."""
        return [limit.evaluate(family, theta, self.scaling, self.dt) for limit, family in self.limited]

    def norms(self, p: AnyArray) -> list[float]:
        """Return the norm of every plant's loop in the plants' units; inf where unstable."""
        theta = self.theta(p)
        return [self._one(family, kind, theta, np.inf)[0] / self.gain for family, kind in self._each]

    def norm(self, v: AnyArray, give_up_above: float = np.inf, mu: float = 0.0) -> Valued:
        """Return the largest norm of the scaled loops, or, with mu, its logarithm and a barrier of the limits."""
        p, slopes = self.parameters(v)
        value, G = self._norm_at(p, np.exp(give_up_above) if mu and give_up_above < 300 else give_up_above, mu)
        if mu:
            value, G = float(np.log(max(value, 1e-300))), None if G is None else G / max(value, 1e-300)
        return value, None if G is None else self.by_parameters(p, G) * slopes

    def value_at(self, q: AnyArray) -> float:
        """Return the norm at given free parameters."""
        return self._norm_at(self.filled(q), np.inf, 0.0)[0]

    def _norm_at(self, p: AnyArray, give_up_above: float, mu: float) -> Valued:
        self.budget.spend(self._work)
        theta = self.theta(p)
        limits = self.limit_values(theta)
        if not all(c < 0 for c, _ in limits):
            return np.inf, None
        barrier = float(np.prod([(-c) ** -mu for c, _ in limits]))
        worst: Valued = -np.inf, None
        for family, kind in self._each:
            found = self._one(family, kind, theta, give_up_above / barrier)
            if not np.isfinite(found[0]) or found[0] * barrier >= give_up_above:
                return found[0] * barrier, None
            worst = max(worst, found, key=lambda pair: pair[0])
        value, G = worst
        if G is not None and mu:
            G = barrier * (G - mu * value * sum(by / c for c, by in limits))
        return value * barrier, G

    def _one(self, family: LoopFamily, kind: str, theta: AnyArray, give_up_above: float) -> Valued:
        """Return a norm with its gradient."""
        if kind == "hinf":
            return family.norm(theta, give_up_above)
        value, G = family.h2_norm(theta)
        return value * self._h2_unit, None if G is None else G * self._h2_unit

    def pieces(self, q: AnyArray, value: float, radius: float) -> list[Piece]:
        """Return all peaks near the maximum and all limits near zero as functions of the free parameters."""
        p = self.filled(q)
        self.budget.spend(2 * self._work)
        theta = self.theta(p)
        found: list[tuple[float, AnyArray]] = []
        for family, kind in self._each:
            if kind == "hinf":
                found += family.active(theta, value, 0.1, 0.02 + 0.5 * radius)
            else:
                norm, G = self._one(family, kind, theta, np.inf)
                found += [(norm, G)] if G is not None and norm > 0.8 * value else []
        near = [(c, G) for c, G in self.limit_values(theta) if np.isfinite(c) and c > -0.5]
        both = [(f, G, False) for f, G in found] + [(c, G, True) for c, G in near]
        return [(f, self.by_parameters(p, G), limit) for f, G, limit in both]


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
    problem: DesignProblem, given: Sequence[tuple[str, AnyArray]], starts: int, seed: int,
    progress: Callable[[str], None],
) -> list[Start]:  # fmt: skip
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
