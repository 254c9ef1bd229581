r"""The equations of a plant with effects: rates, rest, and the linear model about a point.

.. math::
    \dot x = A x + B\,m(u) + \sum_j b_j f_j, \qquad y = s(C x + D\,m(u)), \qquad f_j \in F_j(q_j, v_j)
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.checks import number
from robustlab.delays.approximation import pade as rational_delay
from robustlab.dynamics.effects.contract import Footprint, Law
from robustlab.dynamics.extended.attached_effect import (
    AttachedEffect,
    holding_force,
    is_set_valued,
    rest_band,
    slopes,
    steady_force,
)
from robustlab.dynamics.extended.nonlinear_steps import About, somewhere
from robustlab.dynamics.extended.simulator import Simulator
from robustlab.dynamics.plant_contract import NonlinearPlant, SteppedPlant, Trim, point_of
from robustlab.dynamics.ports.port_model import AnyPlant, Port, PortModel
from robustlab.dynamics.rest import PASSES, trim_conditions
from robustlab.dynamics.simulation import CLOCK_JITTER
from robustlab.errors import InputError, NoTrustworthyNumber, unknown_name
from robustlab.result import Status
from robustlab.shown import AllFields, listed
from robustlab.statespace import OperatingPoint, StateSpaceModel, append, series

# The laws' steps are laid out for samples of this length in s; longer samples are divided. Larger: quicker, and
# reversals are located less well.
NOMINAL_STEP = 1e-3
# A rate is at rest where it is no more than this share of the terms that make it up.
STILL = 1e-11
# Sweeps over joints that rest together, and the share of the largest force at which they agree.
REST_SWEEPS = 200
REST_AGREED = 1e-13
# Holding forces come before inputs and positions: in the shortest Newton step towards rest they weigh so much less.
CHEAP = 1e4
# The order of a model's rational delays: more states than that say nothing new.
HIGHEST_PADE = 8


@dataclass(frozen=True)
class Holding(AllFields):
    """A force that keeps a joint at rest: any value from ``lower`` to ``upper`` would be given, ``force`` is needed."""

    effect: str
    site: str
    force: float
    lower: float
    upper: float
    unit: str


@dataclass(frozen=True, eq=False)
class HoldingTrim(Trim):
    """A trim with the dry friction and contacts that hold it."""

    # one for each law that is set-valued there. Where it is not empty the point is one of a band of equilibria.
    holding: tuple[Holding, ...] = ()


@dataclass(frozen=True)
class LeftOut:
    """What a linear model does not have: the effect, why, and its footprint at an amplitude (None: none is known)."""

    effect: AttachedEffect
    reason: str
    footprint: Footprint | None

    def to_json(self) -> dict[str, Any]:
        seen = None if self.footprint is None else dict(vars(self.footprint))
        return {"effect": self.effect.to_json(), "reason": self.reason, "footprint": seen}


def extended_model(plant: AnyPlant, effects: Iterable[AttachedEffect]) -> PortModel:
    """Linear equations and ports of the plant with the effects; of a nonlinear one at a point where it has some."""
    attached = list(effects)
    if isinstance(plant, NonlinearPlant):
        return somewhere(plant, attached)
    none = np.zeros((1, len(plant.inputs)))
    run = Simulator(plant, [(e.effect, e.site) for e in attached], none, NOMINAL_STEP)
    return run.model({}, [e.values for e in attached])


@dataclass(frozen=True, eq=False, repr=False)
class ExtendedEquations(SteppedPlant):
    """Equations of a plant with effects."""

    plant: AnyPlant  # the plant without them
    effects: tuple[AttachedEffect, ...]  # in the order in which they were attached
    # linear equations and ports with the effects that are linear; of a nonlinear plant about some point
    model: PortModel = field(init=False)
    # every force law with its effect and its port in that model
    laws: tuple[tuple[AttachedEffect, Law, Port], ...] = field(init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        model = extended_model(self.plant, self.effects)
        object.__setattr__(self, "model", model)
        object.__setattr__(self, "laws", tuple((e, f, model.ports[f.port]) for e in self.effects for f in e.laws()))

    @abstractmethod
    def about(self, x: Array, seen: Array) -> About:
        """The plant with its linear effects at a state and at what it sees of the inputs."""

    @abstractmethod
    def motion(self, u: Array, dt: float, t0: float, x0: Array, step: float | None) -> tuple[Array, Array]:
        """States and outputs for inputs (n, n_u) held for dt seconds each; x0: the plant's own states."""

    def turning(self, x: Array, seen: Array, forces: Mapping[str, float]) -> Array:
        """What the slopes of a nonlinear plant's inertia make of forces at ports (name -> force) and of the effects'
        equations: what A has besides those of the model at the point, (n_x, n_x).
        """
        return np.zeros((len(x), len(x)))

    def nearby(self, where: Mapping[str, Any]) -> tuple[Array, Mapping[str, Any]]:
        """State and input at which the search for a rest begins, and what is asked of it by name."""
        return np.zeros(len(self.states) + len(self.inputs)), where

    def with_parameters(self, **given: Any) -> Any:
        """The same effects on the plant with other values, or (value, relative tolerance), of its own parameters."""
        plant = self.plant.with_parameters(**given)
        return replace(self, plant=plant, parameters=plant.parameters)

    def to_json(self) -> dict[str, Any]:
        """Plant, parameters and effects."""
        return {
            "plant": self.plant.name,
            "parameters": [p.to_json() for p in self.parameters.values()],
            "effects": [e.to_json() for e in self.effects],
        }

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.plant!r} with {listed(map(repr, self.effects), 3)})"

    def mapped_input(self, u: Array) -> Array:
        """What the plant sees of constant inputs u, (n_u,)."""
        return self._mapped("input", u)[0]

    def signal_levels(self, x: Array, u: Array) -> list[tuple[AttachedEffect, int, float]]:
        """Effects on inputs and outputs, the index of their signal, and its value before the effect."""
        seen, into = self._mapped("input", u)
        outof = self._mapped("output", self.about(x, seen).outputs)[1]
        return [found for e in self.effects for found in (*into, *outof) if found[0] is e]

    def _mapped(self, kind: str, levels: Array) -> tuple[Array, list[tuple[AttachedEffect, int, float]]]:
        """Constant inputs or outputs after the effects on them; each effect, its signal, and the level before it."""
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

    def forces(self, x: ArrayLike, u: ArrayLike) -> Array:
        """Forces of the laws at (x, u), in the order of `laws`."""
        return self._forced(*self.point(x, u))[2]

    def output(self, x: ArrayLike, u: ArrayLike) -> Array:
        state, command = self.point(x, u)
        return self._mapped("output", self.about(state, self.mapped_input(command)).outputs)[0]

    def _forced(self, x: Array, u: Array) -> tuple[About, list[Port], Array]:
        """The plant at (x, u), the ports of the laws there, and their forces."""
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
        """A state of the plant alone with zeros for those that effects have added; any other as it is."""
        return np.append(x, np.zeros(len(self.states) - len(x))) if len(x) == self.model.own else x

    def stepped(self, t: Array, u: Array, x0: Array, step: float | None = None) -> tuple[Array, Array]:
        """States and outputs at equally spaced times, the inputs held between them."""
        steps = np.diff(t)
        dt = float(steps.mean()) if len(steps) else NOMINAL_STEP
        if len(steps) and np.abs(steps - dt).max() > CLOCK_JITTER * dt:
            k = int(np.argmax(np.abs(steps - dt)))
            raise InputError(
                "simulate",
                f"t[{k + 1}] - t[{k}] = {steps[k]:.9g} s, mean {dt:.9g} s",
                "equal steps: delays and force laws step with the clock",
                "resample the input on an equally spaced clock",
            )
        own = self.model.own
        if x0[own:].any():
            extra = ", ".join(s.name for s in self.states[own:])
            raise InputError(
                "simulate: x0", f"{extra} start at {x0[own:].tolist()}", "zero: states of effects start so"
            )
        return self.motion(u, dt, float(t[0]), x0[:own], step)

    def equilibrium(self, **where: Any) -> HoldingTrim:
        """Rest with the named inputs, outputs or states at the given values; the others as small as they can be."""
        x, u, residual = self._rest(where)
        holding = []
        for (e, law, port), force in zip(self.laws, self.forces(x, u), strict=True):
            q, v = _motion(port, x)
            if v == 0.0 and not law.memory and is_set_valued(law, q):
                holding.append(Holding(e.effect.id, port.name, float(force), *rest_band(law, q), port.unit))
        return HoldingTrim(self.name, x, u, self.output(x, u), residual, None, Status.CONVERGED, holding=tuple(holding))

    def _rest(self, where: Mapping[str, Any]) -> tuple[Array, Array, float]:
        """State, input and the largest rate there."""
        n = len(self.states)
        s, where = self.nearby(where)
        held, wanted = trim_conditions(self, where)
        s[list(held)] = list(held.values())
        free, rows = np.array([k for k in range(len(s)) if k not in held], dtype=np.intp), list(wanted)
        residual = np.zeros(n)
        for _ in range(PASSES):
            residual = np.concatenate([self.derivative(s[:n], s[n:]), self.output(s[:n], s[n:])[rows]])
            residual[n:] -= list(wanted.values())
            if self._is_still(s, residual):
                return s[:n], s[n:], float(np.abs(residual).max(initial=0.0))
            a, b, c, d = self.jacobians(s[:n], s[n:])
            matrix = np.vstack([np.hstack([a, b]), np.hstack([c[rows], d[rows]])])[:, free]
            size = np.abs(matrix).max(axis=1, initial=0.0)
            scale = np.where(size > 0, size, 1.0)
            holding = self._holding_columns(s) / scale[:n, None]
            held = np.vstack([CHEAP * holding, np.zeros((len(rows), holding.shape[1]))])
            step = np.linalg.lstsq(np.hstack([matrix / scale[:, None], held]), -residual / scale, rcond=1e-12)[0]
            step = step[: len(free)]
            # Newton's steps leave rates of rounding at joints whose rest is what lets them be held: those are zero.
            s[free] += np.where(np.abs(step) > 1e-14 * np.abs(s[free]), step, 0.0)
            s = np.where(np.abs(s) > 1e-12 * np.abs(s).max(initial=0.0), s, 0.0)
        given = ", ".join(f"{name} = {value:g}" if np.ndim(value) == 0 else name for name, value in where.items())
        moving = int(np.argmax(np.abs(residual[:n])))
        name, rate = self.states[moving].name, residual[moving]
        raise NoTrustworthyNumber(
            f"{self.name}: trim",
            f"no rest with {given or 'anything given'}: {name} keeps changing, at {rate:.3g}/s",
            None,
            "give an input that what holds the plant can bear, or leave the input to be found",
        )

    def _holding_columns(self, s: Array) -> Array:
        """Rates per unit of each force that holds its joint and may change: scaled to entries of 1, and one that is at
        the edge of its band to so little that it moves only where nothing else can.
        """
        n = len(self.states)
        columns = [np.zeros((n, 0))]
        _, ports, forces = self._forced(s[:n], s[n:])
        for (_, law, _), port, force in zip(self.laws, ports, forces, strict=True):
            q, v = _motion(port, s[:n])
            if v != 0.0 or law.memory or not is_set_valued(law, q):
                continue
            low, high = rest_band(law, q)
            within = 1.0 if low < force < high else CHEAP**-2
            columns.append(within * (port.force / np.abs(port.force).max())[:, None])
        return np.hstack(columns)

    def _is_still(self, s: Array, residual: Array) -> bool:
        """Whether the rates are the rounding of the terms that make them up, and the outputs where they should be."""
        n, seen = len(self.states), self.mapped_input(s[len(self.states) :])
        (model, rates, _), ports, forces = self._forced(s[:n], s[n:])
        terms = np.abs(model.A) @ np.abs(s[:n]) + np.abs(model.B) @ np.abs(seen)
        terms += np.abs(rates - model.A @ s[:n] - model.B @ seen)  # what a nonlinear plant has besides
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
        stand_in: Mapping[int, Array] | None = None,
    ) -> StateSpaceModel:
        """What `robustlab.linearise` gives: A, B, C, D with the operating point."""
        x, u, amplitude = self._asked_point(at, amplitude, pade)
        (model, _, _), _, forces = self._forced(x, u)
        a, acting = model.A.copy(), dict[str, float]()
        for j, (e, law, port) in enumerate(self.laws):
            port = model.ports[port.name]
            if stand_in is not None and j in stand_in:
                a -= np.outer(port.force, stand_in[j])
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
        a += self.turning(x, self.mapped_input(u), acting)
        into, out = self.signal_gains(x, u, amplitude)
        delays, lags = {"input": [0.0] * len(into), "output": [0.0] * len(out)}, dict[int, float]()
        for e, k, _ in self.signal_levels(x, u):
            delays[e.site.kind][k] += e.delay
            if e.time_constant:
                lags[k] = e.time_constant
        linear = StateSpaceModel(
            a, model.B * into, out[:, None] * model.C, out[:, None] * model.D * into, 0.0, self.inputs, self.outputs,
            self.states, OperatingPoint(x, u, self.output(x, u)), self.name,
        )  # fmt: skip
        return _behind(linear, pade, delays, lags) if pade and (lags or any(map(any, delays.values()))) else linear

    def signal_gains(self, x: Array, u: Array, amplitude: Mapping[str, float]) -> tuple[Array, Array]:
        """Gains of the inputs, (n_u,), and of the outputs, (n_y,), that the effects on them have at (x, u)."""
        into, out = np.ones(len(self.inputs)), np.ones(len(self.outputs))
        for e, k, level in self.signal_levels(x, u):
            gains = into if e.site.kind == "input" else out
            gains[k] *= e.gain(level, amplitude)
        return into, out

    def left_out(
        self, at: Any = None, amplitude: Mapping[str, float] | None = None, pade: int = 0
    ) -> tuple[LeftOut, ...]:
        """What `linear_model` of the same arguments does not have, with footprints at the amplitudes (or at 1)."""
        x, u, amplitude = self._asked_point(at, amplitude, pade)
        found: dict[int, LeftOut] = {}

        def note(e: AttachedEffect, reason: str) -> None:
            found.setdefault(id(e), LeftOut(e, reason, _footprint(e, amplitude)))

        for e, law, port in self.laws:
            q, v = _motion(port, x)
            if e.sector(amplitude, ("speed", "current")) is not None:
                note(e, "the middle of its sector at this amplitude stands for it")
            elif law.memory:
                note(e, "it remembers: the model has its slopes at the point only")
            elif v == 0.0 and is_set_valued(law, q):
                note(e, "set-valued at rest: the model is that of free motion")
            else:
                note(e, "nonlinear: the model has its slopes at the point only")
        for e, _, level in self.signal_levels(x, u):
            seen_by = _footprint(e, amplitude)
            if e.delay:
                words = f"as a Padé approximation of order {pade}" if pade else "left out"
                note(e, f"a delay of {e.delay:g} s, {words}")
            elif e.time_constant:
                if not pade:
                    note(e, f"a lag of {e.time_constant:g} s, left out")
            elif seen_by is not None and e.constant_gain is None:
                chosen = e.site.name in amplitude
                dead = not chosen and e.slope(level) == 0.0
                stands = "the middle of its sector" if chosen else "its slope"
                note(e, "no gain at the point: 1 stands for it" if dead else f"nonlinear: {stands} stands for it")
            elif seen_by is not None and seen_by.offset:
                note(e, "a bounded error that is no gain")
        return tuple(found.values())

    def _asked_point(
        self, at: Any, amplitude: Mapping[str, float] | None, pade: int
    ) -> tuple[Array, Array, Mapping[str, float]]:
        """State and input of a point, and the amplitudes, all checked."""
        found = point_of(self, at, "linearise: at")
        x, u = (found.x, found.u) if isinstance(found, Trim) else found
        sites = tuple(dict.fromkeys(e.site.name for e in self.effects))
        for name, value in (amplitude or {}).items():
            where = f"linearise: amplitude {name!r}"
            if name not in sites:
                raise unknown_name(where, "no effect there", name, sites)
            number(where, value, "a positive number", above=0)
        if isinstance(pade, bool) or not isinstance(pade, int) or not 0 <= pade <= HIGHEST_PADE:
            raise InputError("linearise: pade", f"{pade!r}", f"an order from 0 to {HIGHEST_PADE}")
        return x, u, amplitude or {}


def _footprint(e: AttachedEffect, amplitude: Mapping[str, float]) -> Footprint | None:
    return e.footprint(amplitude[e.site.name]) if e.site.name in amplitude else e.footprint()


def _motion(port: Port, x: Array) -> tuple[float, float]:
    """Position (0 without one) and velocity at a port."""
    q = 0.0 if port.position is None else float(port.position @ x)
    return q, float(port.velocity @ x)


def _behind(
    model: StateSpaceModel, order: int, delays: Mapping[str, list[float]], lags: Mapping[int, float]
) -> StateSpaceModel:
    """The model with the delays of its inputs and outputs as rational ones, and with first-order lags of some inputs
    (number of the input -> time constant in s) between those and itself.
    """
    point = model.operating_point
    assert point is not None
    lagging = [StateSpaceModel([[-1 / T]], [[1 / T]], [[1.0]], [[0.0]]) if (T := lags.get(k)) else None
               for k in range(model.n_inputs)]  # fmt: skip
    late = {side: [rational_delay(d, order) if d else None for d in delays[side]] for side in delays}
    banks = (
        ("delay_input", late["input"], model.inputs, point.u),
        ("lag", lagging, model.inputs, point.u),
        ("delay_output", late["output"], model.outputs, point.y),
    )
    whole, states, x = None, [], list[Array]()
    for kind, channels, signals, level in banks:
        if kind == "delay_output":
            whole, states = model if whole is None else series(whole, model), [*states, *model.states]
            x.append(point.x)
        if not any(channels):
            continue
        bank = append(
            *((m or StateSpaceModel([], [], [], [[1.0]])).renamed([f"u{k}"], [f"y{k}"]) for k, m in enumerate(channels))
        )
        whole = bank if whole is None else series(whole, bank)
        for s, m in zip(signals, channels, strict=True):
            count = 0 if m is None else m.n_states
            name, unit = (f"lag_{s.name}", s.unit) if kind == "lag" else (f"{kind}_{s.name}", "")
            states += [(name if kind == "lag" else f"{name}_{i + 1}", unit) for i in range(count)]
        x.append(np.asarray(-np.linalg.solve(bank.A, bank.B @ level), dtype=np.float64))
    assert whole is not None
    point = OperatingPoint(np.concatenate(x), point.u, point.y)
    return StateSpaceModel(whole.A, whole.B, whole.C, whole.D, 0.0, model.inputs, model.outputs, states, point, "pade")
