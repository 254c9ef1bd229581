r"""Wrong parameters of the plant: one physical quantity, scaled.

.. math:: p' = s\,p \quad\text{for all parameters p of the group}
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from robustlab.dynamics.effects.contract import Effect, EffectParameter, Scales, Site
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.dynamics.ports.port_model import AnyPlant, Port, PortModel, parameter_groups, port_model


class ParameterEffect(Effect):
    """Factor of every parameter of a group (`robustlab.dynamics.ports.port_model.parameter_groups`)."""

    site_kind = "parameter"
    gain_like = True
    scale = "s"

    def tried(self, scales: Scales) -> dict[str, tuple[float, ...]]:
        (s,) = self._of_rows(self.rows, scales)
        return {"s": (s.prior.value(1.0), s.prior.value(-1.0))}

    def factors(self, plant: AnyPlant, site: Site, values: Mapping[str, float]) -> dict[str, float]:
        if site.kind != "parameter":
            return {}
        return dict.fromkeys(site.name.split("+"), values["s"])


def has_ground_term(plant: AnyPlant, port: Port, role: str, rows: tuple[Port, ...], of: str) -> bool:
    """Return whether parameters of this role already create a force between the joint and the ground."""
    if isinstance(plant, NonlinearPlant):
        return any(p.role == role and not p.value for p in plant.parameters.values())
    directions = [getattr(r, of) for r in rows if getattr(r, of) is not None]
    together = np.sum(directions, axis=0)
    nominal = port_model(plant).A
    at_zero = [(p.role, p.name, (p.name,)) for p in plant.parameters.values() if not p.value and p.tolerance]
    for group_role, _, names in (*parameter_groups(plant), *at_zero):
        if group_role == role:
            change = port_model(plant, dict.fromkeys(names, 2.0)).A - nominal
            row = port.velocity @ change
            if abs(row @ together) > 1e-9 * np.abs(row).sum():
                return True
    return False


class MotorEffect(ParameterEffect):
    r"""A wrong parameter of all motors, or of one motor: there it scales the terms of its current,
    :math:`\Delta \dot x = (s - 1)\, T x`, with T the terms of the parameter.
    """

    couples: bool  # whether it is in the terms that couple the current with other states, else in that of the current

    def sites(self, plant: AnyPlant, model: PortModel) -> tuple[Site, ...]:
        currents = tuple(p.name for p in model.ports.values() if p.kind == "current")
        one = tuple(Site("current", name) for name in currents) if len(currents) > 1 else ()
        return (*super().sites(plant, model), *one)

    def extend(self, model: PortModel, site: Site, values: Mapping[str, float]) -> PortModel:
        if site.kind != "current":
            return model
        k = int(np.argmax(model.ports[site.name].velocity))
        others = [j for j in range(model.own) if j != k]
        a = model.A.copy()
        for row, column in [*((j, k) for j in others), *((k, j) for j in others)] if self.couples else [(k, k)]:
            a[..., row, column] += (values["s"] - 1.0) * model.A[..., row, column]
        return replace(model, A=a)


class MisplacedEffect(ParameterEffect):
    """Wrong coordinates: each is shifted, zero or not."""

    gain_like = False
    scale = ""

    def sites(self, plant: AnyPlant, model: PortModel) -> tuple[Site, ...]:
        return tuple(s for s in super().sites(plant, model) if len(s.name.split("+")) == len(self.rows))

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        return ({p.name: p.prior.value(0.1) for p in self.parameters(scales)},)

    def factors(self, plant: AnyPlant, site: Site, values: Mapping[str, float]) -> dict[str, float]:
        own = [plant.parameters[name] for name in site.name.split("+")]
        return {p.name: (p.value + values[n]) / p.reference for p, n in zip(own, self.rows, strict=True)}


class GroundedEffect(ParameterEffect):
    """A wrong parameter, or at a joint without the term a force to ground, linear in position or velocity."""

    at_joint: Mapping[str, tuple[Any, ...]]  # row of the coefficient at a joint
    of: str  # argument of the force: ``"position"`` or ``"velocity"``

    @property
    def symbol(self) -> str:
        """Name of the coefficient at a joint."""
        return next(iter(self.at_joint))

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        return self._of_rows(self.at_joint if scales.force_unit else self.rows, scales)

    def tried(self, scales: Scales) -> dict[str, tuple[float, ...]]:
        if not scales.force_unit:
            return super().tried(scales)
        (p,) = self.parameters(scales)
        return {p.name: (p.prior.value(0.0), p.prior.value(-1.5))}

    def sites(self, plant: AnyPlant, model: PortModel) -> tuple[Site, ...]:
        joints = tuple(p for p in model.ports.values() if p.kind == "joint" and getattr(p, self.of) is not None)
        whole = model if isinstance(plant, NonlinearPlant) else port_model(plant)
        own = tuple(p for p in whole.ports.values() if p.kind == "joint" and "." not in p.name)
        nominal = {p.name: p for p in own}
        missing = tuple(
            Site("joint", p.name)
            for p in joints
            if p.name not in nominal or not has_ground_term(plant, nominal[p.name], self.id, own, self.of)
        )
        return (*super().sites(plant, model), *missing)

    def extend(self, model: PortModel, site: Site, values: Mapping[str, float]) -> PortModel:
        if site.kind != "joint":
            return model
        port = model.ports[site.name]
        return model.with_state_feedback(port, -values[self.symbol] * getattr(port, self.of))

    def names_of(self, values: Mapping[str, float]) -> Sequence[str]:
        return list(self.at_joint) if self.symbol in values else super().names_of(values)


class Inertia(ParameterEffect, row="inertia"):
    """Wrong inertia: the true value is a multiple of the nominal one."""


class CentreOfMass(MisplacedEffect, row="centre-of-mass"):
    """Wrong centre of mass."""


class GravityDirection(MisplacedEffect, row="gravity-direction"):
    """Tilted base: wrong direction of gravity."""


class Resistance(MotorEffect, row="resistance"):
    """Wrong resistance: the true value is a multiple of the nominal one."""

    couples = False


class TorqueConstant(MotorEffect, row="torque-constant"):
    """Wrong torque constant: the true value is a multiple of the nominal one."""

    couples = True


class Stiffness(GroundedEffect, row="stiffness"):
    """Wrong stiffness, or a spring to ground at a joint without one."""

    of = "position"


class ViscousFriction(GroundedEffect, row="viscous-friction"):
    """Wrong viscous friction, or friction at a joint without it."""

    of = "velocity"
