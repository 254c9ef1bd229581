"""Operating points at which a plant stays."""

from __future__ import annotations

from typing import Any

from robustlab.dynamics.plant_contract import NonlinearPlant, Plant, Trim
from robustlab.errors import InputError

__all__ = ["trim"]


def trim(plant: Plant, **where: Any) -> Trim:
    r"""State and input with :math:`f(x, u) = 0`.

    Parameters
    ----------
    plant
        A nonlinear plant, as from `robustlab.dynamics.plant`. (A linear one rests at zero.)
    where
        What the plant offers: the Stewart platform takes ``pose=(tx, ty, tz, ax, ay, az)`` in m and rad, or
        ``phi=`` six nut angles in rad; home where nothing is given. A plant with effects takes inputs, outputs and
        states by name: ``trim(axis, u=0.1)``; its trim has ``.holding``, the forces that hold it and their limits.

    Returns
    -------
    Trim
        With ``.x``, ``.u``, ``.y``, and the residual that was evaluated there.

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
        raise InputError(
            "trim", f"{name} is no nonlinear plant", "a nonlinear plant", "a linear plant rests at x = 0, u = 0"
        )
    return plant.equilibrium(**where)
