"""Nominal parameters that every hypothesis refits, and the tolerances that hold them."""

from __future__ import annotations

import math
from collections.abc import Mapping

from robustlab.dynamics.effects.port_model import parameter_groups
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.errors import InputError, did_you_mean
from robustlab.identification.effect_fit import Nuisance
from robustlab.units import share

__all__ = ["nuisance_parameters", "stated_tolerances"]

# Tolerances (relative) of parameters for which the plant states none. A gain without one is taken as exact: it is what
# forces are measured in.
ASSUMED = {
    "inertia": 0.05,
    "resistance": 0.05,
    "inductance": 0.10,
    "torque-constant": 0.03,
    "stiffness": 0.05,
    "viscous-friction": 1.0,
    "input-gain": 0.0,
}


def stated_tolerances(plant: LinearPlant, given: Mapping[str, float] | None) -> dict[str, tuple[float, bool]]:
    """Parameter -> (relative tolerance, whether it was assumed).

    Parameters
    ----------
    given
        Name -> tolerance, 0.05 or ``"5%"``, that overrides the plant's own; 0 holds the parameter.

    Raises
    ------
    InputError
        An unknown name, a negative tolerance.
    """
    given = {name: share(f"tolerances: {name}", value) for name, value in (given or {}).items()}
    for name, tolerance in given.items():
        if name not in plant.parameters:
            known = tuple(plant.parameters)
            raise InputError(
                f"tolerances: {name!r}",
                f"no such parameter of {plant.name}",
                ", ".join(known),
                did_you_mean(name, known),
            )
        if not tolerance >= 0 or not math.isfinite(tolerance):
            raise InputError(f"tolerances: {name}", f"{tolerance}", "a relative tolerance, 0 or more")
    result = {}
    for name, parameter in plant.parameters.items():
        if name in given:
            result[name] = (float(given[name]), False)
        elif parameter.tolerance or not parameter.role:
            result[name] = (parameter.tolerance, False)
        else:
            result[name] = (ASSUMED[parameter.role], True)
    return result


def nuisance_parameters(plant: LinearPlant, tolerances: Mapping[str, tuple[float, bool]]) -> tuple[Nuisance, ...]:
    r"""The groups of parameters with a tolerance r, each with a common factor :math:`e^{s z}`, z standard normal.

    Of a group only those with a tolerance move, by the widest of theirs.
    :math:`s = \ln(1 + r) / \sqrt 3` gives the factor the spread of one that lies anywhere within the tolerance.
    """
    found = []
    for _, label, names in parameter_groups(plant):
        moving = tuple(name for name in names if tolerances[name][0] > 0)
        if moving:
            widest = max(tolerances[name][0] for name in moving)
            found.append(Nuisance(label, moving, math.log1p(widest) / math.sqrt(3.0)))
    return tuple(found)
