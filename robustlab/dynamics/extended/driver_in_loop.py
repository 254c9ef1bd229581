r"""A driver with a dead zone inside a loop: what a controller commands is a state of the loop, no recorded input.

.. math:: u' = u + f, \qquad f = -\max(-d, \min(d, u)), \qquad u = c^T x

which is `robustlab.dynamics.effects.signal_effects.InputDeadZone`, as a force law at a port
whose "velocity" is the command.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from robustlab.dynamics.effects.contract import EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.effects.signal_effects import InputDeadZone
from robustlab.dynamics.extended.attached_effect import AttachedEffect
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.ports.law_kernel import V, law
from robustlab.dynamics.ports.port_model import AnyPlant, Port, PortModel
from robustlab.errors import InputError

__all__ = ["driver_in_loop"]


@law
def driver_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Parameters p = (d,)."""
    return -max(-p[0], min(p[0], seen[V]))


class _DriverInLoop(InputDeadZone):
    """The dead zone at one control of a loop: a force law where the effect of the catalogue maps an input."""

    force = driver_force

    def __init__(self, port: Port) -> None:
        self.port = port

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        return (EffectParameter("d", self.port.speed_unit, "half width of the dead zone", Prior("log", 1.0, 1.0)),)

    def sites(self, plant: AnyPlant, model: PortModel) -> tuple[Site, ...]:
        return (Site("joint", self.port.name),)

    def extend(self, model: PortModel, site: Site, values: Mapping[str, float]) -> PortModel:
        port = self.port.widened(len(model.A) - len(self.port.force))
        return model.with_port(port)

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint | None:
        return None  # what it does is all in the law


def driver_in_loop(loop: LinearPlant, plant: LinearPlant, control: str, values: Mapping[str, Any]) -> AttachedEffect:
    """The dead zone of the driver of one control, for `with_effects` of the loop.

    Parameters
    ----------
    loop
        `robustlab.dynamics.control.controlled_plant.controlled_plant` of ``plant``: the plant's states first,
        its inputs among the outputs.
    plant
        The plant with the same parameter values.
    control
        Name of an input of the plant.
    values
        ``{"d": half width}``.

    Raises
    ------
    InputError
        A control that is no input of the plant; a controller with a direct term from the reference, whose command is
        no state of the loop.
    """
    where = f"input-dead-zone at {control}"
    names = [s.name for s in plant.inputs]
    if control not in names:
        raise InputError(where, "no such control", f"one of {', '.join(names)}")
    closed = loop.state_space()
    row = [s.name for s in loop.outputs].index(control)
    if closed.D[row].any():
        raise InputError(where, "a controller with a direct term from the reference", "a strictly proper one")
    k = names.index(control)
    force = np.zeros(closed.n_states)
    force[: len(plant.states)] = plant.state_space().B[:, k]
    unit = plant.inputs[k].unit
    port = Port(f"driver {control}", "joint", unit, unit, "", force, closed.C[row].copy(), None)
    effect = _DriverInLoop(port)
    return AttachedEffect(effect, Site("joint", port.name), dict(values), source="as given")
