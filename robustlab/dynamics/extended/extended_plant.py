"""Plants with effects, x' = A x + B m(u) + sum b_j f_j: rates, equilibrium, linear model about a point, simulation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Any, Literal, NamedTuple, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.checks import number, whole
from robustlab.delays.approximation import pade as rational_delay
from robustlab.display import AllFields, listed
from robustlab.dynamics.effects.effect import Law
from robustlab.dynamics.equilibrium import PASSES, trim_conditions
from robustlab.dynamics.extended.attached_effect import (
    DEFAULT_AMPLITUDE,
    POSITION_STEP,
    AttachedEffect,
    attach,
    holding_force,
    is_set_valued,
    rest_band,
    slopes,
    steady_force,
)
from robustlab.dynamics.extended.simulator import (
    About,
    Drive,
    Simulator,
    Windows,
    factors_of,
    generic_model,
    load_coordinates,
    march,
    point_model,
    scaled,
    with_linear_parts,
)
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.plant_base import NonlinearPlant, SteppedPlant, Trim, point_of
from robustlab.dynamics.ports.port_model import AnyPlant, Port, PortModel, linear_plant_of, local_port_model, port_model
from robustlab.dynamics.simulation import CLOCK_JITTER
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean, error_context, unknown_name
from robustlab.result import Status
from robustlab.statespace import OperatingPoint, Signal, StateSpaceModel, append, series

# Longest step of the laws in s; longer samples are divided. Larger: faster, less accurate reversals.
NOMINAL_STEP = 1e-3
# A rate below this share of the sum of its terms counts as zero.
STILL = 1e-11
# Largest number of sweeps over joints at rest, and their convergence relative to the largest force.
REST_SWEEPS = 200
REST_AGREED = 1e-13
# Weight ratio by which a Newton step to the equilibrium prefers holding forces to inputs and positions.
CHEAP = 1e4
# Largest Padé order of delays.
HIGHEST_PADE = 8
# Steps of a nonlinear plant are halved until the states change by less than this share of their RMS, and largest number
# of halvings.
HALVED = 1e-4
MOST_HALVINGS = 5
LEAST_SIZE = 1e-6  # rad, m, rad/s, m/s, A: smallest reference of relative differences


@dataclass(frozen=True)
class Holding(AllFields):
    """A force that keeps a joint at rest: ``force`` is needed, ``lower`` to ``upper`` is possible."""

    effect: str
    site: str
    force: float
    lower: float
    upper: float
    unit: str


@dataclass(frozen=True, eq=False)
class HoldingTrim(Trim):
    """A trim with the dry friction and contacts that hold it."""

    # one for each law that is set-valued there; if not empty, the point is one of a band of equilibria
    holding: tuple[Holding, ...] = ()


class LeftOut(NamedTuple):
    """An effect that a linear model omits, and why."""

    effect: AttachedEffect
    reason: str


def extended_model(plant: AnyPlant, effects: Iterable[AttachedEffect]) -> PortModel:
    """Return linear equations and ports of the plant with the effects; of a nonlinear one at a generic point."""
    attached = list(effects)
    if isinstance(plant, NonlinearPlant):
        return generic_model(plant, attached)
    return with_linear_parts(port_model(plant, factors_of(plant, attached)), attached)


@dataclass(frozen=True, eq=False, repr=False)
class ExtendedPlant(SteppedPlant):
    """A linear or nonlinear plant with effects; made by `with_effects`."""

    plant: AnyPlant  # without effects
    effects: tuple[AttachedEffect, ...]  # in the order of attachment
    model: PortModel = field(init=False)  # with the linear effects; of a nonlinear plant about a generic point
    laws: tuple[tuple[AttachedEffect, Law, Port], ...] = field(init=False)  # ports as of that model
    changed: Any = field(init=False)  # a nonlinear plant with the parameters changed by effects; None: linear

    def __post_init__(self) -> None:
        super().__post_init__()
        model = extended_model(self.plant, self.effects)
        object.__setattr__(self, "model", model)
        object.__setattr__(self, "laws", tuple((e, f, model.ports[f.port]) for e in self.effects for f in e.laws()))
        changed = None if isinstance(self.plant, LinearPlant) else scaled(self.plant, self.effects)
        object.__setattr__(self, "changed", changed)

    @property
    def is_linear(self) -> bool:
        """True if the plant without effects is linear."""
        return self.changed is None

    def with_parameters(self, **given: Any) -> Any:
        plant = self.plant.with_parameters(**given)
        return replace(self, plant=plant, parameters=plant.parameters)

    def to_json(self) -> dict[str, Any]:
        return {
            "plant": self.plant.name,
            "parameters": [p.to_json() for p in self.parameters.values()],
            "effects": [e.to_json() for e in self.effects],
        }

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.plant!r} with {listed(map(repr, self.effects), 3)})"

    def mapped_input(self, u: Array) -> Array:
        return self._mapped("input", u)[0]

    def signal_levels(self, x: Array, u: Array) -> list[tuple[AttachedEffect, int, float]]:
        """Return effects on inputs and outputs, the index of their signal, and its value before the effect."""
        seen, into = self._mapped("input", u)
        outof = self._mapped("output", self.about(x, seen).outputs)[1]
        return [found for e in self.effects for found in (*into, *outof) if found[0] is e]

    def _mapped(self, kind: str, levels: Array) -> tuple[Array, list[tuple[AttachedEffect, int, float]]]:
        """Apply the effects to constant inputs or outputs; return these, and each effect, signal and level."""
        after, met = levels.copy(), []
        names = [s.name for s in (self.inputs if kind == "input" else self.outputs)]
        for e in self.effects:
            if e.site.kind == kind:
                k = names.index(e.site.name)
                met.append((e, k, float(after[k])))
                after[k] = e.mapped(after[k])
        return after, met

    def derivative(self, x: ArrayLike, u: ArrayLike) -> Array:
        (_, rates, _), ports, forces = self._forced(*self.point(x, u))
        return rates + sum((port.force * f for port, f in zip(ports, forces, strict=True)), 0.0 * rates)

    def output(self, x: ArrayLike, u: ArrayLike) -> Array:
        state, command = self.point(x, u)
        return self._mapped("output", self.about(state, self.mapped_input(command)).outputs)[0]

    def _forced(self, x: Array, u: Array) -> tuple[About, list[Port], Array]:
        """Return the plant at (x, u), and the ports and forces of the laws."""
        about = self.about(x, self.mapped_input(u))
        rates, ports = about.rates, [about.model.ports[port.name] for _, _, port in self.laws]
        forces, resting = np.zeros(len(self.laws)), []
        for j, (_, law, port) in enumerate(self.laws):
            q, v = _motion(port, x)
            if v != 0.0:
                forces[j] = steady_force(law, q, v)
            elif law.memory or is_set_valued(law, q):
                resting.append(j)
            else:
                forces[j] = sum(rest_band(law, q)) / 2.0
        for _ in range(REST_SWEEPS if len(resting) > 1 else len(resting)):
            before = forces.copy()
            for j in resting:
                law, port = self.laws[j][1], ports[j]
                others = ((p, f) for i, (p, f) in enumerate(zip(ports, forces, strict=True)) if i != j)
                total = rates + sum(p.force * f for p, f in others)
                mobility = float(port.velocity @ port.force)
                forces[j] = holding_force(law, _motion(port, x)[0], float(port.velocity @ total), mobility)
            if np.abs(forces - before).max() <= REST_AGREED * np.abs(forces).max():
                break
        return about, ports, forces

    def whole_state(self, x: Array) -> Array:
        """Append zeros for the states of effects where they are missing."""
        return np.append(x, np.zeros(len(self.states) - len(x))) if len(x) == self.model.own else x

    def stepped(self, t: Array, u: Array, x0: Array, step: float | None = None) -> tuple[Array, Array]:
        """Return states and outputs at equally spaced times, the inputs held between them."""
        steps = np.diff(t)
        dt = float(steps.mean()) if len(steps) else NOMINAL_STEP
        if len(steps) and np.abs(steps - dt).max() > CLOCK_JITTER * dt:
            k = int(np.argmax(np.abs(steps - dt)))
            found = f"t[{k + 1}] - t[{k}] = {steps[k]:.9g} s, mean {dt:.9g} s"
            hint = "resample the input on equal steps"
            raise InputError("simulate", found, "equal steps: delays and force laws step with the clock", hint)
        own = self.model.own
        if x0[own:].any():
            extra = ", ".join(s.name for s in self.states[own:])
            found = f"{extra} start at {x0[own:].tolist()}"
            raise InputError("simulate: x0", found, "zero: states of effects start so")
        return self.motion(u, dt, float(t[0]), x0[:own], step)

    def equilibrium(self, **where: Any) -> HoldingTrim:
        """Return the smallest equilibrium with the named inputs, outputs or states at the given values."""
        n = len(self.states)
        s, conditions = self._search_start(where)
        held, wanted = trim_conditions(self, conditions)
        s[list(held)] = list(held.values())
        free, rows = np.array([k for k in range(len(s)) if k not in held], dtype=np.intp), list(wanted)
        residual = np.zeros(n)
        for _ in range(PASSES):
            residual = np.concatenate([self.derivative(s[:n], s[n:]), self.output(s[:n], s[n:])[rows]])
            residual[n:] -= list(wanted.values())
            if self._is_equilibrium(s, residual):
                break
            a, b, c, d = self.jacobians(s[:n], s[n:])
            matrix = np.vstack([np.hstack([a, b]), np.hstack([c[rows], d[rows]])])[:, free]
            size = np.abs(matrix).max(axis=1, initial=0.0)
            scale = np.where(size > 0, size, 1.0)
            # rates per unit of each holding force; those at the edge of their band have low weight
            columns = [
                (1.0 if h.lower < h.force < h.upper else CHEAP**-2) * (port.force / np.abs(port.force).max())
                for port, h in self._holding(s[:n], s[n:])
            ]
            held = np.zeros((len(residual), len(columns)))
            held[:n] = CHEAP * (np.reshape(columns, (len(columns), n)).T / scale[:n, None])
            step = np.linalg.lstsq(np.hstack([matrix / scale[:, None], held]), -residual / scale, rcond=1e-12)[0]
            step = step[: len(free)]
            # Rounding of Newton's steps must not move a joint that is held at rest.
            s[free] += np.where(np.abs(step) > 1e-14 * np.abs(s[free]), step, 0.0)
            s = np.where(np.abs(s) > 1e-12 * np.abs(s).max(initial=0.0), s, 0.0)
        else:
            texts = (f"{name} = {v:g}" if np.ndim(v) == 0 else name for name, v in conditions.items())
            moving = int(np.argmax(np.abs(residual[:n])))
            found = f"no rest with {', '.join(texts) or 'anything given'}: {self.states[moving].name} keeps changing"
            hint = "give an input within the limits of the holding forces, or leave it free"
            raise NoTrustworthyNumber(f"{self.name}: trim", f"{found}, at {residual[moving]:.3g}/s", None, hint)
        x, u = s[:n], s[n:]
        holding = tuple(h for _, h in self._holding(x, u))
        rate = float(np.abs(residual).max(initial=0.0))
        return HoldingTrim(self.name, x, u, self.output(x, u), rate, None, Status.CONVERGED, holding=holding)

    def _holding(self, x: Array, u: Array) -> list[tuple[Port, Holding]]:
        """Return port and holding force of each law that is set-valued at rest there."""
        _, ports, forces = self._forced(x, u)
        return [
            (port, Holding(e.effect.id, port.name, float(force), *rest_band(law, q), port.unit))
            for (e, law, _), port, force in zip(self.laws, ports, forces, strict=True)
            for q, v in [_motion(port, x)]
            if v == 0.0 and is_set_valued(law, q)
        ]

    def _is_equilibrium(self, s: Array, residual: Array) -> bool:
        """Return whether the rates are rounding errors of their terms and the outputs meet the conditions."""
        n, seen = len(self.states), self.mapped_input(s[len(self.states) :])
        (model, rates, _), ports, forces = self._forced(s[:n], s[n:])
        terms = np.abs(model.A) @ np.abs(s[:n]) + np.abs(model.B) @ np.abs(seen)
        terms += np.abs(rates - model.A @ s[:n] - model.B @ seen)  # nonlinear part
        for port, force in zip(ports, forces, strict=True):
            terms = terms + np.abs(port.force * force)
        size = np.full(len(residual) - n, 1.0 + float(np.abs(s).max(initial=0.0)))
        return bool((np.abs(residual) <= STILL * np.concatenate([terms, size])).all())

    def jacobians(self, x: ArrayLike, u: ArrayLike) -> tuple[Array, Array, Array, Array]:
        model = self.linear_model((x, u))
        return model.A, model.B, model.C, model.D

    def linear_model(
        self,
        at: Any = None,
        amplitude: Mapping[str, float] | None = None,
        pade: int = 0,
        *,
        replacements: Mapping[int, Array] | None = None,
    ) -> StateSpaceModel:
        """Return the result of `robustlab.linearise`; ``replacements``: index of a law -> row of ``f = -row x``."""
        x, u, amplitude = self._checked_point(at, amplitude, pade)
        (model, _, _), _, forces = self._forced(x, u)
        a, acting = model.A.copy(), dict[str, float]()
        for j, (e, law, port) in enumerate(self.laws):
            port = model.ports[port.name]
            if replacements is not None and j in replacements:
                a -= np.outer(port.force, replacements[j])
                continue
            q, v = _motion(port, x)
            middle = e.sector(amplitude, ("speed", "current"))
            if middle is not None:
                a -= np.outer(port.force, port.velocity) * 0.5 * (middle.gain_lower + middle.gain_upper)
                continue
            if v == 0.0 and is_set_valued(law, q):
                continue
            acting[port.name] = acting.get(port.name, 0.0) + forces[j]
            stiffness, damping = slopes(law, q, v)
            a += np.outer(port.force, damping * port.velocity)
            if port.position is not None:
                a += np.outer(port.force, stiffness * port.position)
        if not self.is_linear:
            a += self._inertia_jacobian(x, self.mapped_input(u), acting)
        into, out = np.ones(len(self.inputs)), np.ones(len(self.outputs))
        delays, lags = {"input": [0.0] * len(into), "output": [0.0] * len(out)}, dict[int, float]()
        for e, k, level in self.signal_levels(x, u):
            gains = into if e.site.kind == "input" else out
            gains[k] *= e.gain(level, amplitude)
            delays[e.site.kind][k] += e.delay
            if e.time_constant:
                lags[k] = e.time_constant
        linear = StateSpaceModel(
            a, model.B * into, out[:, None] * model.C, out[:, None] * model.D * into, 0.0, self.inputs, self.outputs,
            self.states, OperatingPoint(x, u, self.output(x, u)), self.name,
        )  # fmt: skip
        return _with_delays(linear, pade, delays, lags) if pade and (lags or any(map(any, delays.values()))) else linear

    def left_out(
        self, at: Any = None, amplitude: Mapping[str, float] | None = None, pade: int = 0
    ) -> tuple[LeftOut, ...]:
        """Return the effects that `linear_model` omits, with footprints at the amplitudes (default 1)."""
        x, u, amplitude = self._checked_point(at, amplitude, pade)
        found: dict[int, LeftOut] = {}

        def note(e: AttachedEffect, reason: str) -> None:
            found.setdefault(id(e), LeftOut(e, reason))

        for e, law, port in self.laws:
            q, v = _motion(port, x)
            if e.sector(amplitude, ("speed", "current")) is not None:
                note(e, "replaced by the middle of its sector at this amplitude")
            elif law.memory:
                note(e, "it has memory: the model has its slopes at the point only")
            elif v == 0.0 and is_set_valued(law, q):
                note(e, "set-valued at rest: the model is that of free motion")
            else:
                note(e, "nonlinear: the model has its slopes at the point only")
        for e, _, level in self.signal_levels(x, u):
            seen_by = e.footprint(amplitude.get(e.site.name, DEFAULT_AMPLITUDE))
            if e.delay:
                words = f"as a Padé approximation of order {pade}" if pade else "left out"
                note(e, f"a delay of {e.delay:g} s, {words}")
            elif e.time_constant:
                if not pade:
                    note(e, f"a lag of {e.time_constant:g} s, left out")
            elif seen_by is not None and e.constant_gain is None:
                chosen = e.site.name in amplitude
                dead = not chosen and e.slope(level) == 0.0
                gain = "the middle of its sector" if chosen else "its slope"
                note(e, "no gain at the point: replaced by 1" if dead else f"nonlinear: replaced by {gain}")
            elif seen_by is not None and seen_by.offset:
                note(e, "a bounded error that is no gain")
        return tuple(found.values())

    def _checked_point(
        self, at: Any, amplitude: Mapping[str, float] | None, pade: int
    ) -> tuple[Array, Array, Mapping[str, float]]:
        found = point_of(self, at, "linearise: at")
        x, u = (found.x, found.u) if isinstance(found, Trim) else found
        sites = tuple(dict.fromkeys(e.site.name for e in self.effects))
        for name, value in (amplitude or {}).items():
            where = f"linearise: amplitude {name!r}"
            if name not in sites:
                raise unknown_name(where, "no effect there", name, sites)
            number(where, value, "a positive number", above=0)
        whole("linearise: pade", pade, 0, HIGHEST_PADE)
        return x, u, amplitude or {}

    def about(self, x: Array, seen: Array) -> About:
        """Return the plant with its linear effects at a state and effective inputs."""
        if not self.is_linear:
            return point_model(self.changed, self.effects, x, seen)
        model = self.model
        return About(model, model.A @ x + model.B @ seen, model.C @ x + model.D @ seen)

    def _inertia_jacobian(self, x: Array, seen: Array, forces: Mapping[str, float]) -> Array:
        """Return the part of A from the derivative of a nonlinear plant's inertia under forces at ports."""
        own, n = len(self.plant.states), len(self.states)
        rows = load_coordinates(self.changed, self.effects)
        at = rows @ x
        here, n_u = self.changed.local_models(at[None], seen[None]), len(seen)
        steps = POSITION_STEP * np.maximum(np.abs(at), 1.0)
        shifts = np.concatenate([k * np.diag(steps) for k in (1.0, -1.0, 0.5, -0.5)])
        local = self.changed.local_models(at + shifts, np.tile(seen, (len(shifts), 1)))
        model = with_linear_parts(local_port_model(self.changed, local), self.effects)
        if model.A is local.A and not any(forces.values()):
            return np.zeros((n, n))
        entering = model.B[..., n_u:]
        rates = model.A @ x + entering @ here.rates[0] - (entering @ local.A) @ at
        rates = rates + (model.B[..., :n_u] - entering @ local.B) @ seen
        for port, force in forces.items():
            rates = rates + force * model.ports[port].force
        up, down, near_up, near_down = rates.reshape(4, own, n)
        wide, narrow = ((a - b) / steps[:, None] for a, b in ((0.5 * up, 0.5 * down), (near_up, near_down)))
        return ((4.0 * narrow - wide) / 3.0).T @ rows

    def motion(
        self, u: Array, dt: float, t0: float, x0: Array, step: float | None, hold: Literal["zoh", "foh"] = "zoh"
    ) -> tuple[Array, Array]:
        """Return states and outputs for inputs (n, n_u) held for dt seconds each; x0: the plant's own states."""
        if self.is_linear:
            return self.forced(u, dt, t0, x0, step)[:2]
        parts = max(1, int(np.ceil(dt / (step or NOMINAL_STEP) - 1e-9)))
        states, outputs = self._stepped(_drive(self, u, dt, t0, parts, hold), x0, None)
        if step is not None:
            return states[::parts], outputs[::parts]
        off, units = np.inf, np.array([s.unit for s in self.states])
        for _ in range(MOST_HALVINGS):
            coarse, parts = states, 2 * parts
            between = np.arange(len(u) * parts) / 2.0
            guess = np.column_stack([np.interp(between, np.arange(len(coarse)), column) for column in coarse.T])
            states, outputs = self._stepped(_drive(self, u, dt, t0, parts, hold), x0, guess)
            found = states[::parts]
            size, off_by = (np.sqrt(np.mean(x**2, axis=0)) for x in (found, found - coarse[:: parts // 2]))
            # RMS difference, relative to the largest state of the same unit
            shares = [off_by[units == unit].max() / max(size[units == unit].max(), LEAST_SIZE) for unit in set(units)]
            off = float(max(shares, default=0.0))
            if off <= HALVED:
                return found, outputs[::parts]
        found = f"steps of {1e6 * dt / parts:.3g} us still change the motion by {off:.2g} of its size"
        hint = "a step of your own, without error control: simulate(..., step=1e-4)"
        raise NoTrustworthyNumber(f"{self.name}: simulate", found, None, hint)

    def _stepped(self, drive: Drive, x0: Array, guess: Array | None) -> tuple[Array, Array]:
        own = len(self.plant.states)
        states = march(self.changed, self.effects, drive, self.whole_state(x0), guess)
        outputs = self.changed.outputs_along(states[:, :own], drive.mean - drive.rise).copy()
        for e in self.effects:
            if e.site.kind == "output":
                k = [s.name for s in self.outputs].index(e.site.name)
                outputs[:, k] = e.effect.output(outputs[None, :, k], e.values, drive.h)[0]
        return states, outputs

    def _search_start(self, where: Mapping[str, Any]) -> tuple[Array, Mapping[str, Any]]:
        """Return the initial state and input of the search for an equilibrium, and its conditions."""
        if self.is_linear:
            return np.zeros(len(self.states) + len(self.inputs)), where
        signals = {s.name for s in (*self.states, *self.inputs, *self.outputs)}
        given = {name: value for name, value in where.items() if name in signals}
        other = {name: value for name, value in where.items() if name not in signals}
        try:
            rest = self.changed.equilibrium(**where)
        except (InputError, NoTrustworthyNumber):
            if not other:
                return np.zeros(len(self.states) + len(self.inputs)), given
            rest = self.changed.equilibrium(**other)
        x, names = self.whole_state(rest.x).copy(), [s.name for s in self.states]
        joints = [p for p in self.changed.port_places if p.position]
        x[[names.index(p.name) for p in joints]] = 0.0  # rounding would mean sliding
        if other and rest.pose is not None:
            given |= {p.position: x[names.index(p.position)] for p in joints}
        return np.concatenate([x, rest.u]), given

    def forced(self, u: Array, dt: float, t0: float, x0: Array, step: float | None) -> tuple[Array, Array, Array]:
        """Simulate a linear plant; return states, outputs, and mean forces over the samples, (n, n_laws)."""
        parts = max(1, int(np.ceil(dt / (step or NOMINAL_STEP) - 1e-9)))
        held = np.repeat(u, parts, axis=0)
        run = Simulator(self.plant, [(e.effect, e.site) for e in self.effects], held, dt / parts, t0)
        whole = Windows(np.zeros(1, dtype=np.int64), len(held))
        motion = run.run({}, [e.values for e in self.effects], x0[None], whole)
        forces = motion.forces[0, [*range(1, len(held)), -1]].reshape(len(u), parts, -1).mean(axis=1)
        return motion.states[0, ::parts], motion.outputs[0, ::parts], forces

    def to_model(self) -> StateSpaceModel:
        return self.linear_model()

    def uncertain(self, *_: Any, **__: Any) -> NoReturn:
        raise InputError("uncertain", f"{self.name} carries effects", "a plant without", "rl.uncertain_from takes it")


def _motion(port: Port, x: Array) -> tuple[float, float]:
    """Return position (0 without one) and velocity at a port."""
    q = 0.0 if port.position is None else float(port.position @ x)
    return q, float(port.velocity @ x)


def _with_delays(
    model: StateSpaceModel, order: int, delays: Mapping[str, list[float]], lags: Mapping[int, float]
) -> StateSpaceModel:
    """Add rational delays of inputs and outputs, and first-order lags (input -> time constant in s) to a model."""
    point = model.operating_point
    assert point is not None
    lagging = {k: StateSpaceModel([[-1 / T]], [[1 / T]], [[1.0]], [[0.0]]) for k, T in lags.items()}
    late = {side: {k: rational_delay(d, order) for k, d in enumerate(all_of) if d} for side, all_of in delays.items()}
    through = StateSpaceModel([], [], [], [[1.0]])
    stages = [(model, list[Any](model.states), point.x)]
    for kind, made, signals, level in (
        ("lag", lagging, model.inputs, point.u),
        ("delay_input", late["input"], model.inputs, point.u),
        ("delay_output", late["output"], model.outputs, point.y),
    ):
        if not made:
            continue
        bank = append(*(made.get(k, through).renamed([f"u{k}"], [f"y{k}"]) for k in range(len(signals))))
        names: list[Any] = [(f"lag_{signals[k].name}", signals[k].unit) for k in sorted(made)]
        if kind != "lag":
            names = [(f"{kind}_{signals[k].name}_{i + 1}", "") for k in sorted(made) for i in range(made[k].n_states)]
        stage = bank, names, np.asarray(-np.linalg.solve(bank.A, bank.B @ level), dtype=np.float64)
        stages.insert(len(stages) if kind == "delay_output" else 0, stage)
    models, states, x = zip(*stages, strict=True)
    m, point = reduce(series, models), OperatingPoint(np.concatenate(x), point.u, point.y)
    names = [name for part in states for name in part]
    return StateSpaceModel(m.A, m.B, m.C, m.D, 0.0, model.inputs, model.outputs, names, point, "pade")


def _drive(plant: ExtendedPlant, u: Array, dt: float, t0: float, parts: int, hold: str) -> Drive:
    h = dt / parts
    if hold == "foh":  # of a loop, whose effects are not on its inputs
        between = np.arange(len(u) * parts + 1) / parts
        fine = np.column_stack([np.interp(between, np.arange(len(u)), column) for column in u.T])
        rise = 0.5 * np.diff(fine, axis=0)
        return Drive(fine[:-1] + rise, rise, h, t0)
    pairs, held = [(e.effect, e.site) for e in plant.effects], np.repeat(u, parts, axis=0)
    motion = np.zeros((2, len(plant.plant.states)))  # not simulated
    simulator = Simulator(plant.plant, pairs, held, h, sub=1, motion=motion)
    return Drive(*simulator.seen_input([e.values for e in plant.effects]), h, t0)


@error_context("with_effects")
def with_effects(
    plant: AnyPlant | StateSpaceModel,
    effects: Mapping[str, Mapping[str, Any]] | Iterable[AttachedEffect] | AttachedEffect,
) -> Any:
    """Attach effects to a plant.

    Parameters
    ----------
    plant
        A linear plant, a continuous model whose velocity states have units, a nonlinear plant that declares where
        forces act, or a plant with effects.
    effects
        ``{"coulomb-friction": {"Fc": 5e-3}}``, with a value or (value, standard deviation) for each parameter of the
        effect, and ``"coulomb-friction@omega"`` if there are several places. Or attached effects.

    Returns
    -------
    ExtendedPlant
        A plant for `simulate`, `trim`, `linearise` and `save`.

    Raises
    ------
    InputError
        Unknown effect, parameter or place, no place or several, NaN, a nonlinear plant without linear models along a
        motion.

    Examples
    --------
    >>> from robustlab.dynamics import plant, simulate
    >>> axis = with_effects(plant("servo-axis"), {"coulomb-friction": {"Fc": 20.0}})
    >>> simulate(axis, [0.0, 0.1, 0.2], [0.5, 0.5, 0.5])["v"]  # 0.5 V push with 17.6 N: it sticks
    array([0., 0., 0.])
    """
    base: AnyPlant
    if isinstance(plant, ExtendedPlant):
        base, attached = plant.plant, list(plant.effects)
    else:
        base, attached = plant if isinstance(plant, NonlinearPlant) else linear_plant_of(plant, "with_effects"), []
    if not isinstance(effects, AttachedEffect | Iterable):
        raise InputError("with_effects: effects", repr(effects), "effects with their parameters, {name: {...}}")
    given: Any = (effects,) if isinstance(effects, AttachedEffect) else effects
    for one in given:
        model = extended_model(base, attached)
        e = attach(one, given[one], base, model) if isinstance(effects, Mapping) else _checked(one, base, model)
        if any((other.effect.id, other.site) == (e.effect.id, e.site) for other in attached):
            raise InputError(f"effect {e.effect.id} at {e.site}", "given twice", "each effect once at a site")
        attached.append(e)
    if not attached:
        raise InputError("with_effects", "no effect", "at least one")
    model, states = extended_model(base, attached), list(base.states)
    for k in range(model.own, len(model.A)):  # added by effects, named after their ports
        unit = np.eye(len(model.A))[k]
        name, of = f"effect_state_{k - model.own + 1}", ""
        for port in model.ports.values():
            if port.position is not None and np.array_equal(port.position, unit):
                name, of = port.name, port.position_unit
            elif np.array_equal(port.velocity, unit):
                name, of = f"{port.name}.rate", port.speed_unit
        states.append(Signal(name, of))
    signals = base.inputs, base.outputs, tuple(states)
    return ExtendedPlant(base.name, base.parameters, *signals, base, tuple(attached))


def _checked(e: Any, base: AnyPlant, model: PortModel) -> AttachedEffect:
    if not isinstance(e, AttachedEffect):
        raise InputError("with_effects", f"{e!r}", "a table of effects, or attached effects")
    names = [site.name for site in e.effect.sites(base, model) if site.kind == e.site.kind]
    if e.site.name not in names:
        hint = did_you_mean(e.site.name, names)
        raise InputError(f"effect {e.effect.id}: site {e.site.name!r}", "no such place", ", ".join(names), hint)
    return e
