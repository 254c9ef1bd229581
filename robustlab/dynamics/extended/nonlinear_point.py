"""A nonlinear plant with effects about one point: its parameters under the effects, linear model and ports there."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.extended.attached_effect import AttachedEffect
from robustlab.dynamics.plant_contract import LocalModels, NonlinearPlant
from robustlab.dynamics.ports.motion_model import local_port_model
from robustlab.dynamics.ports.port_model import PortModel
from robustlab.errors import InputError, NoTrustworthyNumber

__all__ = ["About", "point_model", "scaled", "somewhere", "with_linear_parts"]


class About(NamedTuple):
    """A plant with its linear effects at a point: model there, rates (n_x,) without the laws, outputs (n_y,)."""

    model: PortModel
    rates: Array
    outputs: Array


def scaled(plant: NonlinearPlant, effects: Iterable[AttachedEffect]) -> NonlinearPlant:
    """The plant with the parameters that the effects give it."""
    factors: dict[str, float] = {}
    for e in effects:
        for name, factor in e.effect.factors(plant, e.site, e.values).items():
            factors[name] = factors.get(name, 1.0) * factor
    changed = {name: plant.parameters[name].reference * factor for name, factor in factors.items()}
    return plant.with_parameters(**changed) if changed else plant


def with_linear_parts(model: PortModel, effects: Iterable[AttachedEffect]) -> PortModel:
    """The model extended by what the effects are in its equations."""
    for e in effects:
        model = e.effect.extend(model, e.site, e.values)
    return model


def point_model(plant: NonlinearPlant, effects: Sequence[AttachedEffect], x: Array, u: Array) -> About:
    """About the state x, those of the effects included, and what the plant sees of the inputs.

    Parameters
    ----------
    plant
        As `scaled` gives it.
    """
    model, entering, local = _about(plant, effects, x[: len(plant.states)], u)
    rates = model.A @ x + entering @ (local.rates[0] - local.A[0] @ x[: model.own])
    return About(model, rates, local.outputs[0])


def somewhere(plant: NonlinearPlant, effects: Sequence[AttachedEffect]) -> PortModel:
    """The model about a point at which the plant has one and nothing is zero by symmetry: all states near 0.1; else
    its rest, or zero.

    Raises
    ------
    InputError
        A plant without models along a motion, or one that has none at any of these points.
    """
    changed = scaled(plant, effects)
    n, u = len(plant.states), np.zeros(len(plant.inputs))
    said = ""
    for place in (lambda: 0.1 + 0.01 * np.arange(n), lambda: changed.equilibrium().x, lambda: np.zeros(n)):
        try:
            return _about(changed, effects, place(), u)[0]
        except NoTrustworthyNumber as error:
            said = error.found
    raise InputError(f"{plant.name}: effects", f"no linear model at 0.1, at rest and at zero: {said}", "one of them")


def _about(
    plant: NonlinearPlant, effects: Sequence[AttachedEffect], x: Array, u: Array
) -> tuple[PortModel, Array, LocalModels]:
    """The model with the effects, how the plant's own rates enter it (n_x, n_own), and the plant's own model."""
    local = plant.local_models(x[None], u[None])
    wide = with_linear_parts(local_port_model(plant, local), effects)
    ports = {name: replace(p, force=p.force[0] if p.force.ndim > 1 else p.force) for name, p in wide.ports.items()}
    b, entering = np.split(wide.B[0], [len(u)], axis=1)
    return PortModel(wide.A[0], b, wide.C[0], wide.D[0], ports, len(x)), entering, local
