r"""Effects that are a misjudged parameter of the plant: one physical quantity, scaled.

.. math:: p' = s\,p \quad\text{for all parameters p of the group}
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from robustlab.dynamics.effects.contract import Effect, EffectParameter, Prior, Scales, Site
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.dynamics.ports.port_model import AnyPlant, Port, PortModel, parameter_groups, port_model
from robustlab.errors import InputError


class ParameterEffect(Effect):
    """Scales every parameter of a group (`robustlab.dynamics.ports.port_model.parameter_groups`)."""

    site_kind = "parameter"
    gain_like = True
    scale = "s"
    spread: float  # standard deviation of log s
    quantity: str  # what is scaled, in words

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        meaning = f"{self.quantity}, true value over the nominal one"
        return (EffectParameter("s", "", meaning, Prior("log", 1.0, self.spread)),)

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        return ({"s": math.exp(self.spread)}, {"s": math.exp(-self.spread)})

    def factors(self, plant: AnyPlant, site: Site, values: Mapping[str, float]) -> dict[str, float]:
        if site.kind != "parameter":
            return {}
        names = self._group(plant, site)
        return dict.fromkeys(names, values["s"])

    def _group(self, plant: AnyPlant, site: Site) -> list[str]:
        """Parameters of the group with this label."""
        names = site.name.split("+")
        for name in names:
            if name not in plant.parameters:
                raise InputError(f"effect {self.id}: site {site.name!r}", "no such parameters", f"of {plant.name}")
        return names


def has_ground_term(plant: AnyPlant, port: Port, role: str, rows: tuple[Port, ...], of: str) -> bool:
    """Whether parameters of this role already give the joint a force against the ground."""
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
    r"""A parameter effect of motors that can also be wrong in one motor of several: there it scales the terms of its
    current, :math:`\Delta \dot x = (s - 1)\, T x`, with T those of the plant's own terms that the parameter makes.
    """

    def sites(self, plant: AnyPlant, model: PortModel) -> tuple[Site, ...]:
        currents = tuple(p.name for p in model.ports.values() if p.kind == "current")
        one = tuple(Site("current", name) for name in currents) if len(currents) > 1 else ()
        return (*super().sites(plant, model), *one)

    def extend(self, model: PortModel, site: Site, values: Mapping[str, float]) -> PortModel:
        if site.kind != "current":
            return model
        k = int(np.argmax(model.ports[site.name].velocity))
        a = model.A.copy()
        for row, column in self.terms(model, k):
            a[..., row, column] += (values["s"] - 1.0) * model.A[..., row, column]
        return replace(model, A=a)

    def terms(self, model: PortModel, current: int) -> list[tuple[int, int]]:
        """Rows and columns of A that the parameter of this motor makes; ``current`` is the index of its current."""
        raise NotImplementedError


class MisplacedEffect(ParameterEffect):
    """Coordinates that are not what the plant says: each is shifted, zero or not."""

    gain_like = False
    scale = ""
    components: tuple[str, ...]  # names of the shifts; the plant has as many parameters of the effect's role
    unit: str  # of the shifts

    def sites(self, plant: AnyPlant, model: PortModel) -> tuple[Site, ...]:
        found = super().sites(plant, model)
        return tuple(s for s in found if len(s.name.split("+")) == len(self.components))

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        prior = Prior("linear", 0.0, self.spread)
        return tuple(EffectParameter(n, self.unit, f"{self.quantity}, {n}", prior) for n in self.components)

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        return (dict.fromkeys(self.components, 0.1 * self.spread),)

    def factors(self, plant: AnyPlant, site: Site, values: Mapping[str, float]) -> dict[str, float]:
        names = self._group(plant, site)
        own = [plant.parameters[name] for name in names]
        return {p.name: (p.value + values[n]) / p.reference for p, n in zip(own, self.components, strict=True)}


class GroundedEffect(ParameterEffect):
    """A parameter effect that can also sit at a joint whose equation lacks the term: a force to ground, linear in the
    joint's position or velocity, whose coefficient is the parameter named `symbol`.
    """

    symbol: str  # name of the coefficient at a joint
    of: str  # what the force is proportional to: ``"position"`` or ``"velocity"``

    def at_joint(self, scales: Scales) -> EffectParameter:
        """The coefficient at a joint, with its prior."""
        raise NotImplementedError

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        return (self.at_joint(scales),) if scales.force_unit else super().parameters(scales)

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        if not scales.force_unit:
            return super().starts(scales)
        prior = self.at_joint(scales).prior
        return ({self.symbol: prior.value(0.0)}, {self.symbol: prior.value(-1.5)})

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
        row = getattr(port, self.of)
        if row is None:
            raise InputError(
                f"effect {self.id}: {site.name}", f"a joint without a {self.of}", f"a joint with a {self.of}"
            )
        return model.with_state_feedback(port, -values[self.symbol] * row)

    def checked(self, values: Mapping[str, float]) -> dict[str, float]:
        if self.symbol not in values:
            return super().checked(values)
        return self._checked(values, self.parameters(Scales(force_unit="N")))


class Inertia(ParameterEffect):
    """Misjudged inertia: the true value is a multiple of the nominal one."""

    id = "inertia"
    title = "Misjudged inertia"
    equation = "J' = s J"
    independently = "weigh the parts, or add a known inertia and compare"
    spread = 0.4
    tolerance = 0.05
    quantity = "inertia or mass"


class CentreOfMass(MisplacedEffect):
    """A centre of mass that is not where the plant has it."""

    id = "centre-of-mass"
    title = "Misplaced centre of mass"
    equation = "c' = c + (x, y, z)"
    independently = "balance the body on an edge in two positions, or hang it from two points"
    components = ("x", "y", "z")
    unit = "m"
    spread = 0.03
    tolerance = 0.0
    quantity = "shift of the centre of mass"


class GravityDirection(MisplacedEffect):
    """A base that does not stand level: gravity acts in another direction than the plant says."""

    id = "gravity-direction"
    title = "Base that is not level"
    equation = "t' = t + (x, y)"
    independently = "lay a level on the base, along both axes"
    components = ("x", "y")
    unit = "rad"
    spread = 0.05
    tolerance = 0.0
    quantity = "tilt of the base"


class Resistance(MotorEffect):
    """Misjudged resistance: the true value is a multiple of the nominal one."""

    id = "resistance"
    title = "Misjudged resistance"
    equation = "R' = s R"
    independently = "measure the winding with an ohmmeter, rotor held, in several positions"
    spread = 0.3
    tolerance = 0.05
    quantity = "resistance"

    def terms(self, model: PortModel, current: int) -> list[tuple[int, int]]:
        return [(current, current)]


class TorqueConstant(MotorEffect):
    """Misjudged torque constant: the true value is a multiple of the nominal one."""

    id = "torque-constant"
    title = "Misjudged torque constant"
    equation = "K' = s K (torque and back-EMF)"
    independently = "turn the motor from outside and measure its open-circuit voltage per speed"
    spread = 0.12
    tolerance = 0.03
    quantity = "torque constant and back-EMF constant"

    def terms(self, model: PortModel, current: int) -> list[tuple[int, int]]:
        others = [k for k in range(model.own) if k != current]
        return [(k, current) for k in others] + [(current, k) for k in others]


class Stiffness(GroundedEffect):
    """Stiffness: a misjudged spring, or a spring to ground at a joint that has none."""

    id = "stiffness"
    title = "Stiffness, misjudged or missing"
    equation = "k' = s k; f = -k q at a joint without a spring"
    independently = "push with known forces and read the displacement"
    spread = 0.4
    tolerance = 0.05
    quantity = "stiffness"
    symbol = "k"
    of = "position"

    def at_joint(self, scales: Scales) -> EffectParameter:
        unit = f"{scales.force_unit}/{scales.position_unit}" if scales.position_unit else ""
        prior = Prior("log", 0.3 * scales.force / scales.position, 1.5)
        return EffectParameter("k", unit, "stiffness of a spring to ground", prior)


class ViscousFriction(GroundedEffect):
    """Viscous friction: a misjudged coefficient, or friction at a joint whose equation has none."""

    id = "viscous-friction"
    title = "Viscous friction, misjudged or missing"
    equation = "b' = s b; f = -b v at a joint without friction"
    independently = "measure the no-load current at several speeds"
    spread = 1.5
    tolerance = 1.0
    quantity = "viscous friction"
    symbol = "b"
    of = "velocity"

    def at_joint(self, scales: Scales) -> EffectParameter:
        unit = f"{scales.force_unit} s/{scales.speed_unit.removesuffix('/s')}" if scales.speed_unit else ""
        prior = Prior("log", 0.1 * scales.force / scales.speed, 1.5)
        return EffectParameter("b", unit, "viscous friction to ground", prior)


EFFECTS = (
    Inertia(),
    CentreOfMass(),
    GravityDirection(),
    Resistance(),
    TorqueConstant(),
    Stiffness(),
    ViscousFriction(),
)
