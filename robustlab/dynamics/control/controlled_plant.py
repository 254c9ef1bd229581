"""A plant under feedback as a plant, with effects, other parameters, and any reference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.checks import number
from robustlab.dynamics.effects.effect import EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.effects.parameter_effects import InputDeadZone
from robustlab.dynamics.extended.attached_effect import AttachedEffect
from robustlab.dynamics.extended.extended_plant import ExtendedPlant, with_effects
from robustlab.dynamics.linear_plant import Descriptor, LinearPlant
from robustlab.dynamics.plant_base import LocalModels, NonlinearPlant, Plant, PlantAlong, PortPlace, Trim
from robustlab.dynamics.ports.law_kernel import V, law
from robustlab.dynamics.ports.port_model import AnyPlant, Port, PortModel
from robustlab.errors import InputError
from robustlab.result import Status
from robustlab.signals import Taken, signal_positions
from robustlab.statespace import Signal, StateSpaceModel, as_model


def controlled_plant(plant: LinearPlant, K: Any, controlled: Sequence[str], measured: Sequence[str]) -> LinearPlant:
    """Return the plant under ``u = K v`` with v = (references of the controlled outputs, measured outputs)."""
    where = f"{plant.name} under control"
    model, c, m = loop_parts(plant, K, controlled, measured)
    n, n_k, n_r = len(plant.states), model.n_states, len(c)
    from_r, from_y = model.B[:, :n_r], model.B[:, n_r:]
    d_r, d_y = model.D[:, :n_r], model.D[:, n_r:]

    def equations(p: Mapping[str, float]) -> Descriptor:
        e, f, g, out, direct = plant.matrices(p)
        if direct.any():
            raise InputError(where, "a direct term from input to output", "a plant without one")
        seen = out[m]
        return Descriptor(
            E=np.block([[e, np.zeros((n, n_k))], [np.zeros((n_k, n)), np.eye(n_k)]]),
            F=np.block([[f + g @ d_y @ seen, g @ model.C], [from_y @ seen, model.A]]),
            G=np.vstack([g @ d_r, from_r]),
            C=np.block([[out, np.zeros((len(out), n_k))], [d_y @ seen, model.C]]),
            D=np.vstack([np.zeros((len(out), n_r)), d_r]),
        )

    references = tuple(Signal(f"{plant.outputs[i].name}_ref", plant.outputs[i].unit) for i in c)
    states = (*plant.states, *(Signal(f"controller_{k + 1}") for k in range(n_k)))
    return LinearPlant(
        where, plant.parameters, references, (*plant.outputs, *plant.inputs), states,
        equations=equations, exact=plant.exact,
    )  # fmt: skip


def loop_parts(
    plant: Plant, K: Any, controlled: Sequence[str], measured: Sequence[str]
) -> tuple[StateSpaceModel, list[int], list[int]]:
    """Return a controller as a model, and the indices of its controlled and measured outputs."""
    model, where = as_model(K, "controller"), f"{plant.name} under control"
    known = [s.name for s in plant.outputs]
    c, m = (signal_positions(names, known, f"{where}: output") for names in (controlled, measured))
    sizes = (len(c) + len(m), len(plant.inputs))
    if (model.n_inputs, model.n_outputs) != sizes:
        found = f"{model.n_inputs} inputs and {model.n_outputs} outputs"
        raise InputError(f"{where}: controller", found, f"{sizes[0]} and {sizes[1]}")
    if model.is_discrete:
        hint = "the design before its step discretise; that step (rl.discretise) judges the sampled loop"
        raise InputError(f"{where}: controller", f"a discrete one, dt = {model.dt:g} s", "a continuous one", hint)
    return model, c, m


@dataclass(frozen=True)
class TorqueGains:
    """Gains of a motor torque loop: kp in V/(N m s), kd in V/(N m), ki in V/(N m s2)."""

    kp: float
    kd: float
    ki: float


def torque_gains(p: float, *, R: float, L: float, Km: float, Kb: float, Kf: float, J: float) -> TorqueGains:
    """Return gains for a triple pole -p of the torque of a motor with the free rotor J."""
    b, c, d = -(L * Kf + R * J) / (L * J), -(R * Kf + Kb * Km) / (L * J), Km / L
    return TorqueGains(kp=(3 * p**2 + c) / d, kd=(3 * p + b) / d, ki=p**3 / d)


def actuator_cascade(plant: LinearPlant, p_up: float = 236.0, p_low: float = 3000.0) -> StateSpaceModel:
    """Return the two-layer controller of the thesis for one actuator: an I-PD of the angle over a torque loop."""
    # Březina 2010, eqs 9.1-9.4.
    needed = ("R", "L", "Km", "Kb", "Kf", "J")
    if not isinstance(plant, LinearPlant) or any(n not in plant.values for n in needed) or len(plant.states) != 3:
        raise InputError("actuator cascade", f"plant {plant.name!r}", 'plant("linear-actuator")')
    for name, value in (("p_up", p_up), ("p_low", p_low), ("J", plant.values["J"])):
        number(f"actuator cascade: {name}", value, "a positive number", above=0)
    p, model = plant.values, plant.state_space()
    inertia = p["Km"] / model.A[1, 2]
    gains = torque_gains(p_low, **{name: p[name] for name in needed})
    torque = np.array([0.0, 0.0, -p["Kf"], p["Km"]])
    upper = np.array([0.0, -3 * p_up**2, -3 * p_up, 0.0]) * inertia
    a = [[0.0, 0.0, 0.0], [p_up**3 * inertia, 0.0, 0.0], [0.0, gains.ki, 0.0]]
    b = np.vstack([[1.0, -1.0, 0.0, 0.0], upper - torque, -gains.kp * torque])
    names = [Taken("phi_ref", "rad", "r", "phi"), *(Taken(*s) for s in plant.states)]
    states = ["error_integral", "torque_integral", "sigma"]
    return StateSpaceModel(
        a, b, [[0.0, 0.0, 1.0]], -gains.kd * torque[None], 0.0, names, plant.inputs, states, where="actuator cascade"
    )


def controlled_nonlinear(
    plant: NonlinearPlant, K: Any, controlled: Sequence[str], measured: Sequence[str], at: Trim
) -> ControlledNonlinearPlant | ExtendedPlant:
    """Return the plant under ``u = K v``, with v = (references of the controlled outputs, measured outputs)."""
    model, c, m = loop_parts(plant, K, controlled, measured)
    effects = plant.effects if isinstance(plant, ExtendedPlant) else ()
    base: Any = plant.plant if isinstance(plant, ExtendedPlant) else plant
    for e in effects:
        if e.on_signal or e.effect.structural:
            raise InputError(f"{plant.name} under control", e.in_words, "forces at joints, and parameters")
    n = len(base.states)
    rest = replace(at, x=at.x[:n].copy())
    loop = ControlledNonlinearPlant.of(f"{plant.name} under control", base, model, c, m, rest)
    return with_effects(loop, effects) if effects else loop


@dataclass(frozen=True, eq=False, repr=False)
class ControlledNonlinearPlant(PlantAlong):
    """A nonlinear plant under a linear controller; made by `controlled_nonlinear`."""

    plant: NonlinearPlant  # the plant, without direct term from inputs to outputs
    K: StateSpaceModel  # from (references, measured outputs) to the plant's inputs, in deviations from ``at``
    measured: tuple[int, ...]  # indices into (outputs, states) of the plant
    at: Trim  # equilibrium of the plant
    offset: Array  # v at that equilibrium, (n_r + n_m,)

    @classmethod
    def of(
        cls, name: str, plant: NonlinearPlant, K: StateSpaceModel, controlled: Sequence[int], measured: Sequence[int],
        at: Trim,
    ) -> ControlledNonlinearPlant:  # fmt: skip
        references = tuple(Signal(f"{plant.outputs[i].name}_ref", plant.outputs[i].unit) for i in controlled)
        states = (*plant.states, *(Signal(f"controller_{k + 1}") for k in range(K.n_states)))
        offset = np.concatenate([at.y, at.x])[[*controlled, *measured]]
        return cls(
            name, plant.parameters, references, (*plant.outputs, *plant.inputs), states, plant, K, tuple(measured), at,
            offset,
        )  # fmt: skip

    def with_parameters(self, **given: Any) -> ControlledNonlinearPlant:
        plant = self.plant.with_parameters(**given)
        return replace(self, plant=plant, parameters=plant.parameters)

    @property
    def port_places(self) -> tuple[PortPlace, ...]:
        return self.plant.port_places

    @property
    def start(self) -> Array:
        return np.concatenate([self.at.x, np.zeros(self.K.n_states)])

    def check_reach(self, t: Array, x: Array) -> None:
        self.plant.check_reach(t, x[:, : len(self.plant.states)])

    def _parts(self, x: Array, r: Array, values: Mapping[str, float] | None) -> tuple[Array, Array, Array, Array]:
        """Return the plant's states, outputs, v and inputs at points x (n, n_x), r (n, n_r)."""
        own, inner = np.split(x, [len(self.plant.states)], axis=1)
        y = self.plant.outputs_along(own, np.tile(self.at.u, (len(x), 1)), values)
        v = np.hstack([r, np.hstack([y, own])[:, list(self.measured)]]) - self.offset
        return own, y, v, self.at.u + inner @ self.K.C.T + v @ self.K.D.T

    def rates_along(self, x: Array, u: Array, values: Mapping[str, float] | None = None) -> Array:
        own, _, v, force = self._parts(x, u, values)
        inner = x[:, own.shape[1] :] @ self.K.A.T + v @ self.K.B.T
        return np.hstack([self.plant.rates_along(own, force, values), inner])

    def outputs_along(self, x: Array, u: Array, values: Mapping[str, float] | None = None) -> Array:
        _, y, _, force = self._parts(x, u, values)
        return np.hstack([y, force])

    def local_models(self, x: Array, u: Array, values: Mapping[str, float] | None = None) -> LocalModels:
        own, y, v, force = self._parts(x, u, values)
        local, k, n = self.plant.local_models(own, force, values), self.K, len(x)
        if local.D.any():
            raise InputError(self.name, "a direct term from input to output", "a plant without one")
        n_r = len(self.inputs)
        states = np.broadcast_to(np.eye(own.shape[1]), (n, own.shape[1], own.shape[1]))
        seen = np.concatenate([local.C, states], axis=1)[:, list(self.measured)]

        def many(matrix: Array) -> Array:
            return np.broadcast_to(matrix, (n, *matrix.shape))

        to_force = np.concatenate([k.D[:, n_r:] @ seen, many(k.C)], axis=2)
        to_inner = np.concatenate([k.B[:, n_r:] @ seen, many(k.A)], axis=2)
        none = np.zeros((n, 1, k.n_states))
        a = np.concatenate([local.A, none.repeat(own.shape[1], axis=1)], axis=2) + local.B @ to_force
        c = np.concatenate([local.C, none.repeat(y.shape[1], axis=1)], axis=2)
        return LocalModels(
            np.hstack([local.rates, x[:, own.shape[1] :] @ k.A.T + v @ k.B.T]),
            np.hstack([y, force]),
            np.concatenate([a, to_inner], axis=1),
            np.concatenate([local.B @ k.D[:, :n_r], many(k.B[:, :n_r])], axis=1),
            np.concatenate([c, to_force], axis=1),
            np.concatenate([np.zeros((n, y.shape[1], n_r)), many(k.D[:, :n_r])], axis=1),
            np.concatenate([local.push, np.zeros((n, k.n_states, local.push.shape[2]))], axis=1),
        )

    def equilibrium(self, **where: Any) -> Trim:
        if where:
            raise InputError(f"{self.name}: trim", f"{next(iter(where))!r}", "nothing: the controller has its rest")
        x, r = self.start, self.offset[: len(self.inputs)].copy()
        residual = float(np.abs(self.derivative(x, r)).max())
        return Trim(self.name, x, r, self.output(x, r), residual, None, Status.CONVERGED)


@law
def driver_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Parameters p = (d,)."""
    return -max(-p[0], min(p[0], seen[V]))


class _DriverInLoop(InputDeadZone):
    """The dead zone at one control of a loop, as a force law instead of an input map."""

    force = driver_force

    def __init__(self, port: Port) -> None:
        super().__init__("input-dead-zone")
        self.port = port

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        return (EffectParameter("d", self.port.speed_unit, "half width of the dead zone", Prior("log", 1.0, 1.0)),)

    def sites(self, plant: AnyPlant, model: PortModel) -> tuple[Site, ...]:
        return (Site("joint", self.port.name),)

    def extend(self, model: PortModel, site: Site, values: Mapping[str, float]) -> PortModel:
        port = self.port.widened(len(model.A) - len(self.port.force))
        return replace(model, ports={**model.ports, port.name: port})

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint | None:
        return None  # included in the law


def driver_in_loop(loop: LinearPlant, plant: LinearPlant, control: str, values: Mapping[str, Any]) -> AttachedEffect:
    """Return the dead zone of the driver of one control, for `with_effects` of the loop."""
    closed = loop.state_space()
    row = [s.name for s in loop.outputs].index(control)
    if closed.D[row].any():
        found = "a controller with a direct term from the reference"
        raise InputError(f"input-dead-zone at {control}", found, "a strictly proper one")
    k = [s.name for s in plant.inputs].index(control)
    force = np.zeros(closed.n_states)
    force[: len(plant.states)] = plant.state_space().B[:, k]
    unit = plant.inputs[k].unit
    port = Port(f"driver {control}", "joint", unit, unit, "", force, closed.C[row].copy(), None)
    return AttachedEffect(_DriverInLoop(port), Site("joint", port.name), dict(values), source="as given")
