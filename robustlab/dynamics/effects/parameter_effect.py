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

__all__ = ["ParameterEffect", "has_ground_term"]


class ParameterEffect(Effect):
    """Scales every parameter of a group (`robustlab.dynamics.ports.port_model.parameter_groups`).

    Attributes
    ----------
    spread
        Standard deviation of log s.
    quantity
        What is scaled, in words.
    """

    site_kind = "parameter"
    gain_like = True
    scale = "s"
    spread: float
    quantity: str

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        """The factor s."""
        meaning = f"{self.quantity}, true value over the nominal one"
        return (EffectParameter("s", "", meaning, Prior("log", 1.0, self.spread)),)

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        """One above and one below the nominal value."""
        return ({"s": math.exp(self.spread)}, {"s": math.exp(-self.spread)})

    def factors(self, plant: AnyPlant, site: Site, values: Mapping[str, float]) -> dict[str, float]:
        """Factor s for each parameter of the group."""
        if site.kind != "parameter":
            return {}
        names = site.name.split("+")  # the label of the group
        for name in names:
            if name not in plant.parameters:
                raise InputError(f"effect {self.id}: site {site.name!r}", "no such parameters", f"of {plant.name}")
        return dict.fromkeys(names, values["s"])


def has_ground_term(plant: AnyPlant, port: Port, role: str, rows: tuple[Port, ...], of: str) -> bool:
    """Whether parameters of this role already give the joint a force against the ground.

    They do where the force that they give is not zero in a motion that all joints ``rows`` share; ``of`` says whether
    the motion is that of the ``"velocity"`` or of the ``"position"``. (A spring between two masses is none to ground.)
    A parameter of the value 0 with a tolerance gives one too. (In a nonlinear plant only these do: its equations do not
    say at which joint a damping acts.)
    """
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
    """Coordinates that are not what the plant says: each is shifted, zero or not.

    Attributes
    ----------
    components
        Names of the shifts; the plant has as many parameters of the effect's role.
    unit
        Of the shifts.
    """

    gain_like = False
    scale = ""
    components: tuple[str, ...]
    unit: str

    def sites(self, plant: AnyPlant, model: PortModel) -> tuple[Site, ...]:
        found = super().sites(plant, model)
        return tuple(s for s in found if len(s.name.split("+")) == len(self.components))

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        prior = Prior("linear", 0.0, self.spread)
        return tuple(EffectParameter(n, self.unit, f"{self.quantity}, {n}", prior) for n in self.components)

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        return (dict.fromkeys(self.components, 0.1 * self.spread),)

    def factors(self, plant: AnyPlant, site: Site, values: Mapping[str, float]) -> dict[str, float]:
        """Of each parameter, over its reference."""
        names = site.name.split("+")
        for name in names:
            if name not in plant.parameters:
                raise InputError(f"effect {self.id}: site {site.name!r}", "no such parameters", f"of {plant.name}")
        own = [plant.parameters[name] for name in names]
        return {p.name: (p.value + values[n]) / p.reference for p, n in zip(own, self.components, strict=True)}


class GroundedEffect(ParameterEffect):
    """A parameter effect that can also sit at a joint whose equation lacks the term: a force to ground, linear in
    the joint's position or velocity, whose coefficient is the parameter named `symbol`.

    Attributes
    ----------
    symbol
        Name of the coefficient at a joint.
    of
        What the force is proportional to: ``"position"`` or ``"velocity"``.
    """

    symbol: str
    of: str

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
