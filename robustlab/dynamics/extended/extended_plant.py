r"""A linear plant with effects, as a plant of its own.

.. math::
    \dot x = A x + B\,m(u) + \sum_j b_j f_j, \qquad y = s(C x + D\,m(u)), \qquad f_j \in F_j(q_j, v_j)

with the input maps m, the sensors s, and force laws that may be set-valued at rest (dry friction). A, B and the ports
already carry what the effects change in the linear equations; their further states stand at the end of x.

What is time-dependent or remembers (delays, heating, hysteresis) is exact in `simulate` only. ``derivative`` and
``output`` take delays as absent, laws with memory as settled, and a law that is set-valued at rest with the force that
holds its joint wherever it can.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Footprint, Law
from robustlab.dynamics.extended.attached_effect import AttachedEffect, attach
from robustlab.dynamics.extended.law_forces import holding_force, is_set_valued, rest_band, steady_force
from robustlab.dynamics.extended.simulator import Simulator, Windows
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.plant_contract import NonlinearPlant, SteppedPlant, Trim
from robustlab.dynamics.ports.port_model import Port, PortModel, linear_plant_of
from robustlab.errors import InputError, did_you_mean
from robustlab.result import Status
from robustlab.statespace import Signal, StateSpaceModel
from robustlab.uncertainty.lft import UncertainModel

__all__ = ["ExtendedPlant", "Holding", "HoldingTrim", "LeftOut", "extended_model", "with_effects"]

# Steps of the clock may differ by this share of the mean; effects with samples of their own need equal ones.
CLOCK_JITTER = 1e-6
# The laws' steps are laid out for samples of this length in s; longer samples are divided.
NOMINAL_STEP = 1e-3
SWEEPS, AGREED = 200, 1e-13


@dataclass(frozen=True)
class Holding:
    """A force that keeps a joint at rest: any value from ``lower`` to ``upper`` would be given, ``force`` is needed."""

    effect: str
    site: str
    force: float
    lower: float
    upper: float
    unit: str

    def to_json(self) -> dict[str, Any]:
        """All attributes."""
        return dict(vars(self))


@dataclass(frozen=True, eq=False)
class HoldingTrim(Trim):
    """A trim with the dry friction and contacts that hold it.

    Attributes
    ----------
    holding
        One for each law that is set-valued there. Where it is not empty the point is one of a band of equilibria.
    """

    holding: tuple[Holding, ...] = ()


@dataclass(frozen=True)
class LeftOut:
    """What a linear model does not have: the effect, why, and its footprint at an amplitude (None: none is known)."""

    effect: AttachedEffect
    reason: str
    footprint: Footprint | None

    def to_json(self) -> dict[str, Any]:
        """All attributes."""
        seen = None if self.footprint is None else dict(vars(self.footprint))
        return {"effect": self.effect.to_json(), "reason": self.reason, "footprint": seen}


@dataclass(frozen=True, eq=False, repr=False)
class ExtendedPlant(SteppedPlant):
    """A linear plant with effects; made by `with_effects`.

    Attributes
    ----------
    plant
        The plant without them.
    effects
        In the order in which they were attached.
    model
        Linear equations and ports with the effects that are linear.
    """

    plant: LinearPlant
    effects: tuple[AttachedEffect, ...]
    model: PortModel = field(init=False)
    laws: tuple[tuple[AttachedEffect, Law, Port], ...] = field(init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        model = extended_model(self.plant, self.effects)
        object.__setattr__(self, "model", model)
        laws = [(e, law, model.ports[law.port]) for e in self.effects for law in e.effect.laws(e.site, e.values)]
        object.__setattr__(self, "laws", tuple(laws))

    # --- the equations -----------------------------------------------------------------------------------------------

    def mapped_input(self, u: Array) -> Array:
        """What the plant sees of constant inputs u, (n_u,)."""
        seen = u.copy()
        for e in self.effects:
            if e.site.kind == "input":
                k = [s.name for s in self.inputs].index(e.site.name)
                seen[k] = e.effect.input(np.full(8, seen[k]), e.values, NOMINAL_STEP)[-1]
        return seen

    def mapped_output(self, y: Array) -> Array:
        """What is recorded of constant outputs y, (n_y,)."""
        seen = y.copy()
        for e in self.effects:
            if e.site.kind == "output":
                k = [s.name for s in self.outputs].index(e.site.name)
                seen[k] = e.effect.output(np.full((1, 8), seen[k]), e.values, NOMINAL_STEP)[0, -1]
        return seen

    def derivative(self, x: ArrayLike, u: ArrayLike) -> Array:
        """``f(x, u)``, shape (n_x,); where the forces are set-valued, those that keep their joints at rest."""
        state, command = self.point(x, u)
        rates, forces = self._rates(state, command)
        return rates + sum((port.force * f for (_, _, port), f in zip(self.laws, forces, strict=True)), 0.0 * rates)

    def forces(self, x: ArrayLike, u: ArrayLike) -> Array:
        """Forces of the laws at (x, u), in the order of `laws`."""
        return self._rates(*self.point(x, u))[1]

    def output(self, x: ArrayLike, u: ArrayLike) -> Array:
        """``h(x, u)``, shape (n_y,)."""
        state, command = self.point(x, u)
        return self.mapped_output(self.model.C @ state + self.model.D @ self.mapped_input(command))

    def _rates(self, x: Array, u: Array) -> tuple[Array, Array]:
        """``A x + B m(u)``, and the forces of the laws."""
        rates = self.model.A @ x + self.model.B @ self.mapped_input(u)
        forces, resting = np.zeros(len(self.laws)), []
        for j, (_, law, port) in enumerate(self.laws):
            q, v = _motion(port, x)
            if v != 0.0:
                forces[j] = steady_force(law, q, v)
            elif law.memory or is_set_valued(law, q):
                resting.append(j)
            else:
                forces[j] = sum(rest_band(law, q)) / 2.0
        for _ in range(SWEEPS if len(resting) > 1 else len(resting)):
            before = forces.copy()
            for j in resting:
                _, law, port = self.laws[j]
                total = rates + sum(p.force * f for i, ((_, _, p), f) in enumerate(self._with(forces)) if i != j)
                mobility = float(port.velocity @ port.force)
                forces[j] = holding_force(law, _motion(port, x)[0], float(port.velocity @ total), mobility)
            if np.abs(forces - before).max() <= AGREED * np.abs(forces).max():
                break
        return rates, forces

    def _with(self, forces: Array) -> Any:
        return zip(self.laws, forces, strict=True)

    # --- simulation --------------------------------------------------------------------------------------------------

    def whole_state(self, x: Array) -> Array:
        """A state of the plant alone with zeros for those that effects have added; any other as it is."""
        return np.append(x, np.zeros(len(self.states) - len(x))) if len(x) == self.model.own else x

    def stepped(self, t: Array, u: Array, x0: Array, step: float | None = None) -> tuple[Array, Array]:
        """States and outputs at equally spaced times, the inputs held between them (`Simulator`).

        Raises
        ------
        InputError
            Unequal steps of the clock, a start at which a state that an effect has added is not zero.
        """
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
        parts = max(1, int(np.ceil(dt / (step or NOMINAL_STEP) - 1e-9)))
        held = np.repeat(u, parts, axis=0)
        pairs = [(e.effect, e.site) for e in self.effects]
        run = Simulator(self.plant, pairs, held, dt / parts, float(t[0]))
        whole = Windows(np.zeros(1, dtype=np.int64), len(held))
        motion = run.run({}, [e.values for e in self.effects], x0[None, :own], whole)
        return motion.states[0, ::parts], motion.outputs[0, ::parts]

    # --- equilibria and linear models --------------------------------------------------------------------------------

    def equilibrium(self, **where: Any) -> HoldingTrim:
        """Rest with the named inputs, outputs or states at the given values; the others as small as they can be.

        Raises
        ------
        InputError
            An unknown name.
        NoTrustworthyNumber
            No rest there: the input moves the plant against all that could hold it.
        """
        from robustlab.dynamics.extended.extended_equilibrium import rest

        x, u, residual = rest(self, where)
        holding = []
        forces = self.forces(x, u)
        for (e, law, port), force in self._with(forces):
            q, v = _motion(port, x)
            if v == 0.0 and not law.memory and is_set_valued(law, q):
                holding.append(Holding(e.effect.id, port.name, float(force), *rest_band(law, q), port.unit))
        return HoldingTrim(self.name, x, u, self.output(x, u), residual, None, Status.CONVERGED, holding=tuple(holding))

    def jacobians(self, x: ArrayLike, u: ArrayLike) -> tuple[Array, Array, Array, Array]:
        """A, B, C, D at (x, u), as `linear_model` takes them; slopes of laws by differences."""
        model = self.linear_model((x, u))
        return model.A, model.B, model.C, model.D

    def linear_model(
        self, at: Any = None, amplitude: Mapping[str, float] | None = None, pade: int = 0
    ) -> StateSpaceModel:
        """What `robustlab.linearise` gives; see `robustlab.dynamics.extended.extended_linear_model.linear_model`."""
        from robustlab.dynamics.extended.extended_linear_model import linear_model

        return linear_model(self, at, amplitude or {}, pade)

    def left_out(
        self, at: Any = None, amplitude: Mapping[str, float] | None = None, pade: int = 0
    ) -> tuple[LeftOut, ...]:
        """What the linear model with the same arguments does not have."""
        from robustlab.dynamics.extended.extended_linear_model import left_out

        return left_out(self, at, amplitude or {}, pade)

    def to_model(self) -> StateSpaceModel:
        """The linear model at the rest with the smallest inputs; functions that take a model call it."""
        return self.linear_model()

    def uncertain(self, outputs: Any = None, sigmas: float = 2.0) -> UncertainModel:
        """The linear part with its tolerances as an exact LFT.

        See `robustlab.dynamics.extended.extended_uncertainty.uncertain`; `left_out` has what it does not cover.
        """
        from robustlab.dynamics.extended.extended_uncertainty import uncertain

        return uncertain(self, outputs, sigmas)

    def with_parameters(self, **given: Any) -> ExtendedPlant:
        """The same effects on the plant with other values, or (value, relative tolerance), of its own parameters."""
        return _extended(self.plant.with_parameters(**given), self.effects)

    def to_json(self) -> dict[str, Any]:
        """Plant, parameters and effects."""
        return {
            "plant": self.plant.name,
            "parameters": [p.to_json() for p in self.parameters.values()],
            "effects": [e.to_json() for e in self.effects],
        }

    def __repr__(self) -> str:
        return f"ExtendedPlant({self.plant!r} with {', '.join(map(repr, self.effects))})"


def with_effects(
    plant: LinearPlant | StateSpaceModel | ExtendedPlant,
    effects: Mapping[str, Mapping[str, Any]] | Iterable[AttachedEffect] | AttachedEffect,
) -> ExtendedPlant:
    """The plant with effects attached.

    Parameters
    ----------
    plant
        A linear plant, a continuous model whose velocity states have units, or a plant that has effects already.
    effects
        ``{"coulomb-friction": {"Fc": 5e-3}}``, with a value or (value, standard deviation) for each parameter of the
        effect. Where there is more than one place, it is named: ``"coulomb-friction@omega"``. Or attached effects.

    Returns
    -------
    ExtendedPlant
        A plant for `simulate`, `trim`, `linearise` and `save`.

    Raises
    ------
    InputError
        Unknown effect, parameter or place (with the closest name), no place or several, NaN, a nonlinear plant.

    Examples
    --------
    >>> from robustlab.dynamics import plant, simulate
    >>> axis = with_effects(plant("servo-axis"), {"coulomb-friction": {"Fc": 20.0}})
    >>> simulate(axis, [0.0, 0.1, 0.2], [0.5, 0.5, 0.5])["v"]  # 0.5 V push with 17.6 N: it sticks
    array([0., 0., 0.])
    """
    if isinstance(plant, NonlinearPlant) and not isinstance(plant, ExtendedPlant):
        raise InputError(
            "with_effects",
            f"{plant.name} is a nonlinear plant",
            "a linear Plant or a StateSpaceModel",
            "dry friction at the nuts of the platform: robustlab.dynamics.stewart.friction",
        )
    base = plant.plant if isinstance(plant, ExtendedPlant) else linear_plant_of(plant, "with_effects")
    attached = list(plant.effects) if isinstance(plant, ExtendedPlant) else []
    if isinstance(effects, Mapping):
        table: Mapping[Any, Any] = effects
        for key, values in table.items():
            attached.append(attach(key, values, base, extended_model(base, attached), attached))
    else:
        for e in (effects,) if isinstance(effects, AttachedEffect) else effects:
            attached.append(_fitting(e, base, attached))
    if not attached:
        raise InputError("with_effects", "no effect", "at least one")
    return _extended(base, tuple(attached))


def _fitting(e: Any, base: LinearPlant, taken: list[AttachedEffect]) -> AttachedEffect:
    """The attached effect, once the plant has its place and nothing of the kind there."""
    if not isinstance(e, AttachedEffect):
        raise InputError("with_effects", f"{e!r}", "a table of effects, or attached effects")
    names = [site.name for site in e.effect.sites(base, extended_model(base, taken)) if site.kind == e.site.kind]
    if e.site.name not in names:
        hint = did_you_mean(e.site.name, names)
        raise InputError(f"effect {e.effect.id}: site {e.site.name!r}", "no such place", ", ".join(names), hint)
    if any((other.effect.id, other.site) == (e.effect.id, e.site) for other in taken):
        raise InputError(f"effect {e.effect.id} at {e.site}", "given twice", "each effect once at a site")
    return e


def _extended(base: LinearPlant, effects: tuple[AttachedEffect, ...]) -> ExtendedPlant:
    model = extended_model(base, effects)
    states = (*base.states, *_further_states(base, model))
    return ExtendedPlant(base.name, base.parameters, base.inputs, base.outputs, states, base, effects)


def extended_model(plant: LinearPlant, effects: Iterable[AttachedEffect]) -> PortModel:
    """Linear equations and ports of the plant with the effects."""
    attached = list(effects)
    none = np.zeros((1, len(plant.inputs)))
    run = Simulator(plant, [(e.effect, e.site) for e in attached], none, NOMINAL_STEP)
    return run.model({}, [e.values for e in attached])


def _further_states(plant: LinearPlant, model: PortModel) -> tuple[Signal, ...]:
    """Names of the states that effects have added, after the ports that read them."""
    found = []
    for k in range(model.own, len(model.A)):
        unit = np.eye(len(model.A))[k]
        name, of = f"effect_state_{k - model.own + 1}", ""
        for port in model.ports.values():
            if port.position is not None and np.array_equal(port.position, unit):
                name, of = port.name, port.position_unit
            elif np.array_equal(port.velocity, unit):
                name, of = f"{port.name}.rate", port.speed_unit
        found.append(Signal(name, of))
    return tuple(found)


def _motion(port: Port, x: Array) -> tuple[float, float]:
    """Position (0 without one) and velocity at a port."""
    q = 0.0 if port.position is None else float(port.position @ x)
    return q, float(port.velocity @ x)
