"""Equilibria of plants, and linear models about operating points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from numpy.typing import ArrayLike

from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.plant_base import NonlinearPlant, Plant, SteppedPlant, Trim, point_of
from robustlab.errors import InputError, error_context
from robustlab.provenance import code_of
from robustlab.statespace import OperatingPoint, StateSpaceModel


@error_context("trim")
def trim(plant: Plant, **where: Any) -> Trim:
    r"""State and input with :math:`f(x, u) = 0`.

    Parameters
    ----------
    plant
        A nonlinear plant, as from `robustlab.dynamics.plant`. (The equilibrium of a linear one is zero.)
    **where
        Conditions. The Stewart platform takes ``pose=(tx, ty, tz, ax, ay, az)`` in m and rad, or ``phi=`` six nut
        angles in rad; default: home. A plant with effects takes inputs, outputs and states by name:
        ``trim(axis, u=0.1)``; its trim has ``.holding``, the forces that hold it and their limits. A plant from
        `robustlab.PlantEquations` takes inputs, outputs and states by name too, and ``start=(x, u)``, the start of the
        search.

    Returns
    -------
    Trim
        With ``.x``, ``.u``, ``.y``, and the residual evaluated there.

    Raises
    ------
    InputError
        A linear plant; a pose out of the workspace, of the wrong shape, or with NaN.
    NoTrustworthyNumber
        A singular pose, or nut angles that no pose has.

    Examples
    --------
    >>> from robustlab.dynamics import plant
    >>> trim(plant("stewart-platform"), pose=[0, 0, 0.1262, 0, 0, 0]).u.round(8)
    array([0.00087011, 0.00087011, 0.00087011, 0.00087011, 0.00087011,
           0.00087011])
    """
    if not isinstance(plant, NonlinearPlant):
        name = getattr(plant, "name", type(plant).__name__)
        hint = "a linear plant rests at x = 0, u = 0"
        raise InputError("trim", f"{name} is no nonlinear plant", "a nonlinear plant", hint)
    return plant.equilibrium(**where)


@error_context("linearise")
def linearise(
    plant: Plant,
    at: Trim | OperatingPoint | ArrayLike | None = None,
    *,
    amplitude: Mapping[str, float] | None = None,
    pade: int = 0,
) -> StateSpaceModel:
    r"""State-space model of a plant in deviations from an operating point.

    .. math:: A = \partial f / \partial x, \quad B = \partial f / \partial u, \quad
              C = \partial h / \partial x, \quad D = \partial h / \partial u

    Exact: linear plants have the same matrices everywhere, nonlinear ones have exact derivatives of their equations.

    Parameters
    ----------
    plant
        A plant, as from `robustlab.dynamics.plant`.
    at
        Operating point, stored in the model: a `Trim`, or ``(x, u)`` of shapes (n_x,), (n_u,), in equilibrium or not;
        for a mechanism also a pose (6,), which is trimmed. Default: none for a linear plant, the trim at home for
        others.
    amplitude
        Plants with effects: place of an effect -> amplitude of its speed or signal. There the effect is replaced by the
        middle of its sector; elsewhere by its local slope, dry friction at rest by nothing (``plant.left_out()``).
    pade
        Plants with effects: order of the Padé approximation of their delays; 0 omits them.

    Returns
    -------
    StateSpaceModel
        With the plant's signals.

    Raises
    ------
    InputError
        Not a plant, or an operating point of the wrong size.

    Examples
    --------
    >>> from robustlab.dynamics import plant
    >>> linearise(plant("dc-motor"))
    StateSpaceModel(3 states, [u] -> [phi, omega, i], continuous)
    """
    if isinstance(plant, SteppedPlant):
        return plant.linear_model(at, amplitude, pade)
    if amplitude or pade:
        raise InputError("linearise", "amplitude or pade for a plant without effects", "neither")
    if isinstance(plant, NonlinearPlant):
        found = point_of(plant, at, "linearise: at")
        if isinstance(found, Trim):
            matrices, point = plant.jacobians_at(found), found.operating_point
        else:
            matrices, point = plant.jacobians(*found), OperatingPoint(*found, plant.output(*found))
        model = StateSpaceModel(*matrices, 0.0, plant.inputs, plant.outputs, plant.states, point, plant.name)
        if plant.provenance is not None and code_of(plant):
            model.traced(plant.provenance)
        return model
    if not isinstance(plant, LinearPlant):
        expected = "a linear plant or a nonlinear one, as from plant(name)"
        raise InputError("linearise", f"{type(plant).__name__}", expected)
    model = plant.state_space()
    if at is None:
        return model
    given = (at.x, at.u) if isinstance(at, (Trim, OperatingPoint)) else at
    if not (isinstance(given, (tuple, list)) and len(given) == 2):
        raise InputError("linearise: at", type(at).__name__, "(x, u), or None")
    x, u = plant.point(*given)
    return replace(model, operating_point=OperatingPoint(x, u, plant.output(x, u)))
