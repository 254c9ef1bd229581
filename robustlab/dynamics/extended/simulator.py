"""Simulation of a plant with effects: in windows with new initial states; nonlinear by iterated linearisation."""
# Unser, Splines: a perfect fit for signal and image processing, IEEE Signal Processing Magazine 16 (1999) 22-38.
# Hochbruck, Ostermann, "Exponential integrators", Acta Numerica 19 (2010) 209-286; Lelarasmee, Ruehli, Sangiovanni-
# Vincentelli, "The waveform relaxation method for time-domain analysis of large scale integrated circuits", IEEE Trans.
# CAD 1 (1982) 131-145.

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.dynamics.effects.effect import Effect, Law, Site
from robustlab.dynamics.extended.attached_effect import AttachedEffect
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.plant_base import LocalModels, NonlinearPlant
from robustlab.dynamics.ports.port_model import (
    AnyPlant,
    Course,
    MotionModel,
    Port,
    PortModel,
    exponentials,
    local_port_model,
    motion_model,
    port_model,
    times,
    with_factors,
)
from robustlab.errors import InputError, NoTrustworthyNumber

# Number of cached matrix exponentials and models.
KEPT = 512

Hold = Literal["zoh", "linear", "smooth"]
DEGREE = 5


class SampledInput:
    """One input of a record."""

    def __init__(self, samples: Array, hold: Hold = "zoh") -> None:
        self.hold: Hold = hold
        self.count = len(samples)
        pieces = samples[:, None] if hold == "zoh" else _pieces(samples, 1 if hold == "linear" else DEGREE)
        still = np.zeros((1, pieces.shape[1]))
        still[0, 0] = samples[0]
        self._pieces = np.vstack([still, pieces])  # row k + 1: the interval after sample k; row 0: before the first

    def steps(self, sub: int, shift: float = 0.0) -> Array:
        """Return means of the halves of each step, (n * sub, 2), ``sub`` per sample, delayed by ``shift`` samples."""
        found = np.empty((self.count, sub, 2))
        for r in range(sub):
            start = r / sub - shift
            first = int(np.floor(start))
            into, across = _weights(start - first, 1.0 / sub, self._pieces.shape[1])
            found[:, r] = self._after(first) @ into
            if across.any():
                found[:, r] += self._after(first + 1) @ across
        return found.reshape(-1, 2)

    def samples(self, shift: float = 0.0) -> Array:
        first = int(np.floor(-shift))
        return self._after(first) @ (-shift - first) ** np.arange(self._pieces.shape[1])

    def _after(self, first: int) -> Array:
        """Return the coefficients of the intervals ``first`` samples after each sample."""
        return self._pieces[np.clip(np.arange(self.count) + first + 1, 0, self.count)]


def _pieces(samples: Array, degree: int) -> Array:
    """Return coefficients (n, degree + 1) of the spline of odd degree, lower for few samples."""
    from scipy.interpolate import PPoly, make_interp_spline

    n = len(samples)
    degree = min(degree, n - 1)
    degree -= 1 - degree % 2 if degree else 0
    found = np.zeros((n, degree + 1))
    if degree > 0:
        spline = PPoly.from_spline(make_interp_spline(np.arange(n), samples, k=degree))
        # An odd spline's inner knots are samples; near the ends one piece spans several of them.
        for m in range(degree + 1):
            found[:-1, m] = spline(np.arange(n - 1), nu=m) / math.factorial(m)
    found[:, 0] = samples
    return found


def _weights(a: float, w: float, terms: int) -> tuple[Array, Array]:
    r"""Return weights (terms, 2) of two neighbouring intervals for a step from :math:`\theta = a` of width w."""
    m = np.arange(terms)

    def seen(low: float, high: float, middle: float) -> Array:
        mean = (high ** (m + 1) - low ** (m + 1)) / (m + 1) / w
        slope = 6.0 / w * ((high ** (m + 2) - low ** (m + 2)) / (m + 2) / w - middle * mean)
        return np.column_stack([mean - 0.5 * slope, mean + 0.5 * slope])

    middle = a + 0.5 * w
    if a + w <= 1.0:
        return seen(a, a + w, middle), np.zeros((terms, 2))
    return seen(a, 1.0, middle), seen(0.0, a + w - 1.0, middle - 1.0)


KEPT_SIGNALS = 256  # sampled inputs of all records
KEPT_INPUTS = 8  # sets of shifted inputs of a simulator
KEPT_MOTIONS = 24  # parameter values about a motion
POINTS = 60  # representative points of a motion
STEPS_A_PERIOD = 20  # of the plant's fastest oscillation
LEAST_STEPS, MOST_STEPS = 2, 16  # per sample; electric time constants are shorter


# Whole step, first and second half, n_points of each: phi, psi of the halves, gamma_u, drift; steps of each point.
_Table = tuple[Array, Array, Array, Array, int]


@dataclass(frozen=True)
class Windows:
    """Equally long windows of a record: first sample of each, and their length in samples."""

    starts: NDArray[np.int64]
    length: int


@dataclass(frozen=True, eq=False)
class Motion:
    """States (n_windows, length, n_x), outputs (n_windows, length, n_y), forces of the laws (n_windows, length, n)."""

    states: Array
    outputs: Array
    forces: Array
    model: PortModel  # equations with effects


@lru_cache(maxsize=64)
def stepping(plant: LinearPlant, dt: float) -> int:
    """Return the steps per sample for all simulations of a plant: 20 per period of its fastest oscillation."""
    poles = np.linalg.eigvals(port_model(plant).A)
    fastest = float(np.abs(poles.imag).max(initial=0.0))
    steps = math.ceil(STEPS_A_PERIOD * fastest * dt / (2.0 * math.pi) - 1e-9)
    return min(max(steps, LEAST_STEPS), MOST_STEPS)


class Simulator:
    """A plant with effects under a recorded input."""

    def __init__(
        self,
        plant: AnyPlant,
        effects: Sequence[tuple[Effect, Site]],
        u: Array,
        dt: float,
        t0: float = 0.0,
        *,
        sub: int | None = None,
        hold: Sequence[Hold] | None = None,
        rough: bool = False,
        motion: Array | None = None,
    ) -> None:
        self.plant, self.effects, self.dt, self.t0 = plant, tuple(effects), dt, t0
        self.rough, self._course = rough, None
        if isinstance(plant, NonlinearPlant):
            assert motion is not None  # about which it is linear
            self._course = _course(plant, motion, u, dt)
            sub = LEAST_STEPS if sub is None else sub
        self.sub = stepping(plant, dt) if sub is None else sub
        holds = ("zoh",) * len(plant.inputs) if hold is None else tuple(hold)
        self._inputs = [_cached_input(column.tobytes(), kind) for column, kind in zip(u.T, holds, strict=True)]
        self._steps: dict[tuple[float, ...], Array] = {}

    def about(self, motion: Array | None) -> Simulator:
        """Return the simulator of a nonlinear plant about another motion."""
        other = copy(self)
        if isinstance(self.plant, NonlinearPlant) and motion is not None and self._course is not None:
            other._course = _course(self.plant, motion, self._course.u, self.dt, self._course)
        return other

    def run(
        self,
        factors: Mapping[str, float],
        values: Sequence[Mapping[str, float]],
        x0: Array,
        windows: Windows,
        shift: Sequence[float] | None = None,
        near: tuple[Mapping[str, float], Sequence[Mapping[str, float]]] | None = None,
    ) -> Motion:
        about = self._about(factors, values, windows, near) if self._course else None
        model = self._with_effects(about.model, values) if about else self.model(factors, values)
        late = self._late(values, shift)
        seen = self._seen(values, late)
        start = self._start(model, values, seen, x0, windows, about)
        states, forces = self._step(model, self.laws(values), seen, start, windows, about)
        direct = 0.0
        if model.D.any():
            u = [signal.samples(d / self.dt) for signal, d in zip(self._inputs, late, strict=True)]
            u = np.column_stack(self._mapped(u, values, self.dt))[windows.starts[:, None] + np.arange(windows.length)]
            d = model.D if about is None else model.D[about.points].reshape(*u.shape[:2], *model.D.shape[1:])
            direct = times(d, u)
        runs = np.split(states, len(states) // len(windows.starts)) if len(windows.starts) else [states]
        outputs = np.concatenate([_outputs_along(about, model, run) + direct for run in runs])
        runs = np.split(outputs, len(runs))  # views
        for (effect, site), v in zip(self.effects, values, strict=True):
            if site.kind == "output":
                k = [s.name for s in self.plant.outputs].index(site.name)
                for run in runs:
                    run[:, :, k] = effect.output(run[:, :, k], v, self.dt)
        return Motion(states, outputs, forces, model)

    def laws(self, values: Sequence[Mapping[str, float]]) -> list[Law]:
        return [law for (e, site), v in zip(self.effects, values, strict=True) for law in e.laws(site, v)]

    def model(self, factors: Mapping[str, float], values: Sequence[Mapping[str, float]]) -> PortModel:
        """Return the linear equations with effects; of a nonlinear plant at some points of its motion."""
        if self._course is not None:
            places = np.unique(np.linspace(0, len(self._course.x) - 2, POINTS).astype(np.int64))
            return self._with_effects(self._about(factors, values, Windows(places, 1)).model, values)
        assert isinstance(self.plant, LinearPlant)
        total = self._total(factors, values)
        return self._with_effects(_cached_port_model(self.plant, tuple(sorted(total.items()))), values)

    def _total(self, factors: Mapping[str, float], values: Sequence[Mapping[str, float]]) -> dict[str, float]:
        """Return the factors of the plant's parameters, including those of the effects."""
        total = dict(factors)
        for (effect, site), v in zip(self.effects, values, strict=True):
            for name, factor in effect.factors(self.plant, site, v).items():
                total[name] = total.get(name, 1.0) * factor
        return total

    def _with_effects(self, model: PortModel, values: Sequence[Mapping[str, float]]) -> PortModel:
        for (effect, site), v in zip(self.effects, values, strict=True):
            model = effect.extend(model, site, v)
        return model

    def _about(
        self,
        factors: Mapping[str, float],
        values: Sequence[Mapping[str, float]],
        windows: Windows,
        near: tuple[Mapping[str, float], Sequence[Mapping[str, float]]] | None = None,
    ) -> MotionModel:
        """Return a nonlinear plant about its motion in the windows, without effects."""
        assert self._course is not None
        total = self._total(factors, values)
        known = total if near is None else self._total(*near)
        key = tuple(sorted(known.items())), windows.starts.tobytes(), windows.length, self.sub
        about = _cached_model(self._course, *key)
        return about if known == total else with_factors(about, self._course, total)

    def seen_input(self, values: Sequence[Mapping[str, float]]) -> tuple[Array, Array]:
        """Return effective inputs from each sample to the next as m + r (2 tau/dt - 1): m and r, (n, n_u) each."""
        late = self._late(values, None)
        halves = [s.steps(1, d / self.dt).ravel() for s, d in zip(self._inputs, late, strict=True)]
        seen = np.column_stack(self._mapped(halves, values, 0.5 * self.dt))
        first, second = seen[::2], seen[1::2]
        return 0.5 * (first + second), second - first

    def _late(self, values: Sequence[Mapping[str, float]], shift: Sequence[float] | None) -> tuple[float, ...]:
        """Return the delay of each input in s; delays commute with the other maps."""
        names = [s.name for s in self.plant.inputs]
        late = [0.0] * len(names) if shift is None else [float(d) for d in shift]
        for (effect, site), v in zip(self.effects, values, strict=True):
            if site.kind == "input" and effect.delay:
                late[names.index(site.name)] += v[effect.delay]
        return tuple(late)

    def _seen(self, values: Sequence[Mapping[str, float]], late: tuple[float, ...]) -> Array:
        """Return the effective inputs in each step, (n * sub, n_u)."""
        steps = self._steps.get(late)
        if steps is None:
            if len(self._steps) > KEPT_INPUTS:
                self._steps.clear()
            halves = [_cached_halves(s, self.sub, d / self.dt) for s, d in zip(self._inputs, late, strict=True)]
            steps = self._steps[late] = np.hstack([np.column_stack([h[:, k] for h in halves]) for k in (0, 1)])
            if all(s.hold == "zoh" for s in self._inputs) and not any(late):
                steps = self._steps[late] = np.ascontiguousarray(steps[:, : len(late)])
        if not any(site.kind == "input" and not effect.delay for effect, site in self.effects):
            return steps
        n_u = len(self._inputs)
        parts = steps.shape[1] // n_u  # of a step
        columns = [np.ravel(steps[:, k::n_u]) for k in range(n_u)]
        mapped = self._mapped(columns, values, self.dt / self.sub / parts)
        return np.hstack([np.column_stack([m[k::parts] for m in mapped]) for k in range(parts)])

    def _mapped(self, u: list[Array], values: Sequence[Mapping[str, float]], h: float) -> list[Array]:
        """Apply the effects on inputs in steps of h seconds, except delays (`_late`)."""
        names = [s.name for s in self.plant.inputs]
        for (effect, site), v in zip(self.effects, values, strict=True):
            if site.kind == "input" and not effect.delay:
                k = names.index(site.name)
                u[k] = effect.input(u[k], v, h)
        return u

    def _step(
        self, model: PortModel, laws: Sequence[Law], u: Array, start: Array, windows: Windows, about: MotionModel | None
    ) -> tuple[Array, Array]:
        phi, psi, gamma_u, drift, stride = self._table(model, u.shape[1], about)
        push = np.zeros((phi.shape[1], len(laws), phi.shape[-1]))
        for j, law in enumerate(laws):
            push[:, j] = times(psi, model.ports[law.port].force)
        whole = push @ np.swapaxes(phi[1], 1, 2) + push
        # Windows of a nonlinear plant need not be consecutive: x0 sets all states.
        own = model.own if about is None else phi.shape[-1]
        table = phi, gamma_u, np.array([whole, push, push]), drift, stride
        inputs = u, self.dt / self.sub, self.t0, self.sub
        return step_laws(laws, model.ports, table, inputs, windows, start, own, not self.rough)

    def _start(
        self, model: PortModel, values: Sequence[Mapping[str, float]], u: Array, x0: Array, windows: Windows,
        about: MotionModel | None,
    ) -> Array:  # fmt: skip
        """Return all states at the window starts; a load behind a joint of a nonlinear plant starts in equilibrium."""
        n, n_u = model.A.shape[-1], len(self._inputs)
        start = np.zeros((len(x0), n))
        start[:, : model.own] = x0
        if about is None or not len(start):
            return start
        window = np.arange(len(start)) % len(windows.starts)
        steps = window * windows.length * self.sub
        at, entering = about.steps[steps], np.hstack([u[windows.starts[window] * self.sub, :n_u], about.rates[steps]])
        for (effect, site), v in zip(self.effects, values, strict=True):
            if effect.structural:
                between = next(p for p in model.ports.values() if p.kind == "relative" and p.name.startswith(site.name))
                rows = between.velocity @ model.A[at], between.velocity @ model.B[at]
                pull = np.sum(rows[0] * start, axis=1) + np.sum(rows[1] * entering, axis=1)
                assert between.position is not None
                start += np.outer(effect.resting(v, pull), between.position)
        return start

    def _table(self, model: PortModel, columns: int, about: MotionModel | None) -> _Table:
        """Return the discretised plant without laws for inputs of so many columns."""
        h, n_u = self.dt / self.sub, len(self._inputs)
        if about is None:
            halves = _cached_exponential(model.A.tobytes(), 0.5 * h)
            phi, psi, gamma_u = _in_steps(model.B, *halves, columns > n_u)
            return phi[:, None], psi[None], gamma_u[:, None], np.zeros((3, 0, len(model.A))), 1
        make = _cached_along if model is about.model else _table_along  # cached if no effect changes the plant
        return make(about, model, h, n_u, columns > n_u)


def step_laws(
    laws: Sequence[Law], ports: Mapping[str, Port], table: tuple[Array, Array, Array, Array, int],
    inputs: tuple[Array, float, float, int], windows: Windows, x0: Array, own: int, halves: bool,
    memory: Array | None = None,
) -> tuple[Array, Array]:  # fmt: skip
    """Return states and forces in the windows; table: phi, gamma_u, push, drift, stride; inputs: u, h, t0, sub."""
    from robustlab.dynamics.ports.law_kernel import step_windows

    (phi, gamma_u, push, drift, stride), n_laws = table, len(laws)
    n = phi.shape[-1]
    velocity, position = np.zeros((n_laws, n)), np.zeros((n_laws, n))
    parameters = np.zeros((n_laws, max([1, *(len(law.parameters) for law in laws)])))
    for j, law in enumerate(laws):
        port = ports[law.port]
        velocity[j] = port.velocity
        if port.position is not None:
            position[j] = port.position
        parameters[j, : len(law.parameters)] = law.parameters
    if memory is None:
        memory = np.zeros((n_laws, max([1, *(law.memory for law in laws)])))
    addresses = np.array([law.function.address for law in laws], dtype=np.uintp)
    states, forces = np.empty((len(x0), windows.length, n)), np.zeros((len(x0), windows.length, n_laws))
    step_windows(
        addresses, parameters, memory, phi, gamma_u, push, velocity, position, drift, stride, *inputs,
        windows.starts, windows.length, x0, own, halves, states, forces,
    )  # fmt: skip
    return states, forces


@lru_cache(maxsize=KEPT_SIGNALS)
def _cached_input(samples: bytes, hold: Hold) -> SampledInput:
    return SampledInput(np.frombuffer(samples), hold)


# Mostly only one of several inputs is shifted anew.
_cached_halves = lru_cache(maxsize=4 * KEPT_SIGNALS)(SampledInput.steps)


@lru_cache(maxsize=KEPT)
def _cached_port_model(plant: LinearPlant, factors: tuple[tuple[str, float], ...]) -> PortModel:
    return port_model(plant, dict(factors))


@lru_cache(maxsize=KEPT)
def _cached_exponential(a: bytes, h: float) -> tuple[Array, Array, Array]:
    n = math.isqrt(len(a) // 8)
    return exponential(np.frombuffer(a).reshape(n, n), h)


@lru_cache(maxsize=32)
def _cached_course(plant: NonlinearPlant, motion: bytes, u: bytes, dt: float, like: Course | None) -> Course:
    x, v = np.frombuffer(motion).reshape(-1, len(plant.states)), np.frombuffer(u).reshape(-1, len(plant.inputs))
    return Course(plant, x, v, dt, like)


def _course(plant: NonlinearPlant, motion: Array, u: Array, dt: float, like: Course | None = None) -> Course:
    """Return the motion as a course, shared by all simulators of a record."""
    return _cached_course(plant, np.ascontiguousarray(motion).tobytes(), np.ascontiguousarray(u).tobytes(), dt, like)


@lru_cache(maxsize=KEPT_MOTIONS)
def _cached_model(
    course: Course, factors: tuple[tuple[str, float], ...], starts: bytes, length: int, sub: int
) -> MotionModel:
    return motion_model(course, dict(factors), np.frombuffer(starts, dtype=np.int64), length, sub)


def _steps_along(model: PortModel, h: float, n_u: int, rising: bool) -> tuple[Array, Array, Array, Array]:
    """Return phi (3, ...), psi, gamma_u (3, ...) of `_Table`, and the input matrix of rates in half a step."""
    phi, psi, ramp = exponentials(model.A, 0.5 * h)
    return *_in_steps(model.B[..., :n_u], phi, psi, ramp, rising), psi @ model.B[..., n_u:]


_cached_steps = lru_cache(maxsize=KEPT_MOTIONS)(_steps_along)


def _table_along(about: MotionModel, model: PortModel, h: float, n_u: int, rising: bool) -> _Table:
    from robustlab.dynamics.ports.law_kernel import drifts

    phi, psi, gamma_u, entering = (_cached_steps if model is about.model else _steps_along)(model, h, n_u, rising)
    drift = np.empty((3, len(about.rates), phi.shape[-1]))
    drifts(entering, phi[1], about.steps, about.rates, drift)
    return phi, psi, gamma_u, drift, about.stride


_cached_along = lru_cache(maxsize=KEPT_MOTIONS)(_table_along)


def _in_steps(b: Array, phi: Array, psi: Array, ramp: Array, rising: bool) -> tuple[Array, Array, Array]:
    """Return phi (3, ...), psi, gamma_u (3, ...) of the whole step and its halves from the exponentials of a half."""
    first = second = psi @ b
    if rising:  # u1, u2: means over the halves, with a rise of u2 - u1 in each
        mean, rise = first, 0.5 * (ramp @ b)
        first, second = np.concatenate([mean - rise, rise], -1), np.concatenate([-rise, mean + rise], -1)
    return np.array([phi @ phi, phi, phi]), psi, np.array([phi @ first + second, first, second])


def _outputs_along(about: MotionModel | None, model: PortModel, motion: Array) -> Array:
    """Return outputs of states (n_windows, length, n), without direct terms."""
    if about is None:
        return motion @ model.C.T
    offsets = about.offsets.reshape(*motion.shape[:2], -1)
    if (model.C[0] == model.C).all():
        return motion @ model.C[0].T + offsets
    return times(model.C[about.points].reshape(*motion.shape[:2], *model.C.shape[1:]), motion) + offsets


def exponential(a: Array, h: float) -> tuple[Array, Array, Array]:
    r"""Return ``exp(A h)``, :math:`\int_0^h e^{A s} ds` and :math:`\int_0^h e^{A (h - s)} (2 s / h - 1)\, ds`."""
    from scipy.linalg import expm

    n = len(a)
    chain = np.zeros((3 * n, 3 * n))
    chain[:n, :n], chain[:n, n : 2 * n], chain[n : 2 * n, 2 * n :] = a * h, np.eye(n), np.eye(n)
    both: Array = np.asarray(expm(chain), dtype=float)
    psi = h * both[:n, n : 2 * n]
    return both[:n, :n].copy(), psi, 2.0 * h * both[:n, 2 * n :] - psi


def rising(a: Array, b: Array, dt: float) -> Array:
    """Return columns (n_x, n_u) whose held inputs act like inputs along the line 2 tau/dt - 1."""
    _, psi, ramp = exponential(a, dt)
    return np.linalg.solve(psi, ramp @ b)


# --- a nonlinear plant in one run -------------------------------------------------------------------------------------


class About(NamedTuple):
    """A plant with its linear effects at a point: model, rates (n_x,) without the laws, outputs (n_y,)."""

    model: PortModel
    rates: Array
    outputs: Array


def factors_of(plant: AnyPlant, effects: Iterable[AttachedEffect]) -> dict[str, float]:
    """Return plant parameter -> common factor of the effects."""
    factors: dict[str, float] = {}
    for e in effects:
        for name, factor in e.effect.factors(plant, e.site, e.values).items():
            factors[name] = factors.get(name, 1.0) * factor
    return factors


def scaled(plant: NonlinearPlant, effects: Iterable[AttachedEffect]) -> NonlinearPlant:
    changed = {name: plant.parameters[name].reference * f for name, f in factors_of(plant, effects).items()}
    return plant.with_parameters(**changed) if changed else plant


def with_linear_parts(model: PortModel, effects: Iterable[AttachedEffect]) -> PortModel:
    """Return the model extended by the linear parts of the effects."""
    for e in effects:
        model = e.effect.extend(model, e.site, e.values)
    return model


def load_coordinates(plant: NonlinearPlant, effects: Iterable[AttachedEffect]) -> Array:
    """Return rows (n_own, n_x) from all states to the plant's states in the coordinates of its load."""
    names, split = [s.name for s in plant.states], [e.site.name for e in effects if e.effect.structural]
    rows = np.eye(len(names), len(names) + 2 * len(split))
    for k, joint in enumerate(split):
        place = next(p for p in plant.port_places if p.name == joint)
        rows[names.index(joint), len(names) + 2 * k + 1] = -1.0
        if place.position:
            rows[names.index(place.position), len(names) + 2 * k] = -1.0
    return rows


def point_model(plant: NonlinearPlant, effects: Sequence[AttachedEffect], x: Array, u: Array) -> About:
    """Return the model about the state x (including effects) and effective inputs u."""
    at = load_coordinates(plant, effects) @ x
    model, entering, local = _about(plant, effects, at, u)
    rates = model.A @ x + model.B @ u + entering @ (local.rates[0] - local.A[0] @ at - local.B[0] @ u)
    return About(model, rates, local.outputs[0] + local.C[0] @ (x[: model.own] - at))


def generic_model(plant: NonlinearPlant, effects: Sequence[AttachedEffect]) -> PortModel:
    """Return the model about a point without symmetries (all states near 0.1), else the equilibrium, else zero."""
    changed = scaled(plant, effects)
    n, u = len(plant.states), np.zeros(len(plant.inputs))
    reason = ""
    for place in (lambda: 0.1 + 0.01 * np.arange(n), lambda: changed.equilibrium().x, lambda: np.zeros(n)):
        try:
            return _about(changed, effects, place(), u)[0]
        except NoTrustworthyNumber as error:
            reason = error.found
    raise InputError(f"{plant.name}: effects", f"no linear model at 0.1, at rest and at zero: {reason}", "one of them")


def _about(
    plant: NonlinearPlant, effects: Sequence[AttachedEffect], x: Array, u: Array
) -> tuple[PortModel, Array, LocalModels]:
    """Return the model with the effects, the input matrix of the plant's rates (n_x, n_own), and the plant's model."""
    local = plant.local_models(x[None], u[None])
    wide = with_linear_parts(local_port_model(plant, local), effects)
    ports = {name: replace(p, force=p.force[0] if p.force.ndim > 1 else p.force) for name, p in wide.ports.items()}
    b, entering = np.split(wide.B[0], [len(u)], axis=1)
    return PortModel(wide.A[0], b, wide.C[0], wide.D[0], ports, len(x)), entering, local


FIRST, MOST = 32, 256  # steps of a block
PASSES = 8  # iterations of a block before it is shortened
QUICK = 4  # iterations up to which the next block is lengthened
AGREED = 1e-8  # relative change in the last iteration; convergence is quadratic
LEAST = 1e-12  # rad, m, rad/s, m/s, A: rounding
GAUSS = 0.5 / 3.0**0.5  # distance of the Gauss points from the middle, in steps


@dataclass(frozen=True, eq=False)
class Drive:
    """Effective inputs in steps, ``mean + rise (2 tau/h - 1)``, (n, n_u) each; h, t0 in s."""

    mean: Array
    rise: Array
    h: float
    t0: float


def march(
    plant: NonlinearPlant, effects: Sequence[AttachedEffect], drive: Drive, x0: Array, guess: Array | None = None
) -> Array:
    """Simulate block by block; return states (n, n_x) at the beginnings of the steps."""
    laws = [law for e in effects for law in e.laws()]
    memory = np.zeros((len(laws), max([1, *(law.memory for law in laws)])))
    last = len(drive.mean) - 1
    states = np.empty((last + 1, len(x0)))
    states[0] = x0
    at, length = 0, FIRST if guess is None else MOST
    while at < last:
        count = min(length, last - at)
        block = _Block(plant, effects, laws, drive, at, count, memory)
        try:
            found, passes = block.settled(states[at], None if guess is None else guess[at : at + count + 1])
            words = "" if found is not None else "the motion over one step does not settle"
        except NoTrustworthyNumber as error:
            found, passes, words = None, PASSES, f"{error.where}: {error.found}"
        if found is None:
            if count == 1:
                reason = f"no motion beyond t = {drive.t0 + at * drive.h:.6g} s: {words}"
                hint = "shorter steps, or a motion within the machine's reach"
                raise NoTrustworthyNumber(f"{plant.name}: simulate", reason, None, hint)
            length = max(1, count // 4)
            continue
        reached = found[1:, : len(plant.states)]
        plant.check_reach(drive.t0 + drive.h * (at + 1 + np.arange(count)), reached)
        states[at : at + count + 1] = found
        memory = block.after
        at += count
        length = min(2 * count, MOST) if passes <= QUICK else count if passes < PASSES else max(1, count // 2)
    return states


@dataclass(eq=False)
class _Block:
    """A block of steps."""

    plant: NonlinearPlant
    effects: Sequence[AttachedEffect]
    laws: Sequence[Law]
    drive: Drive
    at: int
    count: int
    memory: Array  # of the laws before its first step

    def __post_init__(self) -> None:
        self.load_coordinates, self.after = load_coordinates(self.plant, self.effects), self.memory
        chosen = slice(self.at, self.at + self.count)
        self.mean, self.rise = self.drive.mean[chosen], self.drive.rise[chosen]

    def settled(self, start: Array, guess: Array | None) -> tuple[Array | None, int]:
        """Return states (count + 1, n_x), or None without convergence, and the number of iterations."""
        motion = start[None].repeat(self.count + 1, axis=0) if guess is None else guess
        before = np.inf
        for k in range(1, PASSES + 1):
            # The first iteration without a guess is about one point.
            found, speed = self._iterated(start, motion, self.count if guess is None and k == 1 else 1)
            if not np.isfinite(found).all():
                return None, k
            size = AGREED * (np.abs(found).max(axis=0) + speed * self.drive.h) + LEAST
            change = float((np.abs(found - motion).max(axis=0) / size).max())
            motion = found
            if change <= 1.0:
                if any(law.memory for law in self.laws):
                    self.after = self.memory.copy()
                    self._stepped(start, self.after, self.count)
                return found, k
            if k > 3 and change > before:
                return None, k
            before = change
        return None, PASSES

    def _iterated(self, start: Array, motion: Array, stride: int) -> tuple[Array, Array]:
        """Simulate the plant linearised about a motion; return states (count + 1, n_x) and the largest rates."""
        h, count, n_u, own = self.drive.h, self.count, self.mean.shape[1], len(self.plant.states)
        course = Course(self.plant, motion, self.mean, h)
        steps = np.arange(count)
        of = steps // stride
        x, u = course.at(np.minimum((np.arange(of[-1] + 1) + 0.5) * stride, count - 0.5))
        local = self.plant.local_models(x @ self.load_coordinates.T, u)
        model = with_linear_parts(local_port_model(self.plant, local), self.effects)
        halves = exponentials(model.A, 0.5 * h)
        parts = []
        if model.A is not local.A:
            entering, added = model.B[..., n_u:], model.A.copy()
            added -= entering @ local.A @ self.load_coordinates
            parts = [_with_differences(part) for part in (entering, added, model.B[..., :n_u] - entering @ local.B)]
        sides, size = [], np.zeros(model.A.shape[-1])
        for share in (-GAUSS, GAUSS):
            x, _ = course.at(steps + 0.5 + share)
            u = self.mean + 2.0 * share * self.rise
            rates = self.plant.rates_along(x @ self.load_coordinates.T, u)
            size[:own] = np.maximum(size[:own], np.abs(rates).max(axis=0))
            if parts:  # transformed by the effects
                enters, adds, drives = ((here + share * by + 0.5 * share**2 * twice)[of] for here, by, twice in parts)
                rates = times(enters, rates) + times(adds, x) + times(drives, u)
            sides.append(rates - times(model.A[of], x))
        phi, psi, ramp = (matrices[of] for matrices in halves)
        middle, rise = 0.5 * (sides[0] + sides[1]), (sides[1] - sides[0]) / (4.0 * GAUSS)
        turned = times(ramp, 0.5 * rise)
        first = times(psi, middle - 0.5 * rise) + turned
        second = times(psi, middle + 0.5 * rise) + turned
        drift = np.array([times(phi, first) + second, first, second])
        push = np.zeros((2, len(model.A), len(self.laws), model.A.shape[-1]))
        for j, law in enumerate(self.laws):
            here, by, twice = _with_differences(model.ports[law.port].force)
            for k, share in enumerate((-0.25, 0.25)):  # over the halves: mean, and half of the rise
                rising = 0.25 * by + 0.5 * share * twice
                push[k, :, j] = times(halves[1], here + share * by + twice / 24.0) + times(halves[2], rising)
        whole = push[0] @ np.swapaxes(halves[0], 1, 2) + push[1]
        phi = np.array([halves[0] @ halves[0], halves[0], halves[0]])
        push = np.array([whole, *push])
        rows = np.minimum(np.arange(-(-(count + 1) // stride)), phi.shape[1] - 1)
        if len(rows) > phi.shape[1]:  # one more step, for the state at the end
            phi, push = (np.ascontiguousarray(np.take(part, rows, axis=1)) for part in (phi, push))
        drift = np.concatenate([drift, drift[:, -1:]], axis=1)
        self._table = (phi, push, drift), model.ports, stride
        return self._stepped(start, self.memory.copy(), count + 1), size

    def _stepped(self, start: Array, memory: Array, length: int) -> Array:
        """Step; return states (length, n_x) at the beginnings of the steps, and update the memory."""
        (phi, push, drift), ports, stride = self._table
        no_input = np.zeros((*phi.shape[:3], 0))
        table = phi, no_input, push, np.ascontiguousarray(drift[:, :length]), stride
        inputs = np.zeros((self.at + length, 0)), self.drive.h, self.drive.t0, 1
        window = Windows(np.array([self.at], dtype=np.int64), length)
        return step_laws(self.laws, ports, table, inputs, window, start[None].copy(), phi.shape[-1], True, memory)[0][0]


def _with_differences(values: Array) -> tuple[Array, Array, Array]:
    if len(values) < 3:
        return values, np.zeros_like(values), np.zeros_like(values)
    first = np.gradient(values, axis=0, edge_order=2)
    return values, first, np.gradient(first, axis=0, edge_order=2)
