"""Linear models of plants at an operating point."""

from __future__ import annotations

from numpy.typing import ArrayLike

from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.plant_contract import Plant
from robustlab.errors import InputError
from robustlab.statespace import OperatingPoint, StateSpaceModel

__all__ = ["linearise"]


def linearise(plant: Plant, at: tuple[ArrayLike, ArrayLike] | None = None) -> StateSpaceModel:
    r"""State-space model of a plant in deviations from an operating point.

    .. math:: A = \partial f / \partial x, \quad B = \partial f / \partial u, \quad
              C = \partial h / \partial x, \quad D = \partial h / \partial u

    Exact for linear plants, where the matrices are the same everywhere.

    Parameters
    ----------
    plant
        A plant, as from `robustlab.dynamics.plant`.
    at
        Operating point as ``(x, u)`` of shapes (n_x,), (n_u,), kept in the model; none where left out.

    Returns
    -------
    StateSpaceModel
        With the plant's signals.

    Raises
    ------
    InputError
        Not a linear plant, or an operating point of the wrong size.

    Examples
    --------
    >>> from robustlab.dynamics import plant
    >>> linearise(plant("dc-motor"))
    StateSpaceModel(3 states, [u] -> [phi, omega, i], continuous)
    """
    if not isinstance(plant, LinearPlant):
        raise InputError("linearise", f"{type(plant).__name__}", "a linear plant, as from plant(name)")
    model = plant.state_space()
    if at is None:
        return model
    if not isinstance(at, (tuple, list)) or len(at) != 2:
        raise InputError("linearise: at", f"{type(at).__name__}", "(x, u), or None")
    x, u = plant.point(*at)
    point = OperatingPoint(x, u, plant.output(x, u))
    return StateSpaceModel(
        model.A, model.B, model.C, model.D, model.dt, model.inputs, model.outputs, model.states, point, plant.name
    )
