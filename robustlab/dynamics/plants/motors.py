"""Electric motors, and the linear actuator that one of them drives."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.dynamics.linear_plant import Descriptor, LinearPlant
from robustlab.dynamics.parameters import overridden, published
from robustlab.statespace import Signal, real_array

_PUBLISHED = published(Path(__file__).with_name("parameters.toml"))


STATES = (Signal("phi", "rad"), Signal("omega", "rad/s"), Signal("i", "A"))


def dc_motor(**given: Any) -> LinearPlant:
    """Permanent-magnet DC motor; default values are the thesis' Maxon RE 35."""
    # Březina 2010, eqs 7.3-7.5 (states omega and i; the angle is added here).
    parameters = overridden(_PUBLISHED["dc-motor"], given, "dc-motor")
    return LinearPlant("dc-motor", parameters, (Signal("u", "V"),), STATES, STATES, equations=_dc_motor)


def _dc_motor(p: Any) -> Descriptor:
    return motor_equations(p, p["J"])


def motor_equations(p: Any, inertia: float) -> Descriptor:
    """The motor with an inertia on its shaft (eqs 7.3-7.5)."""
    return Descriptor(
        E=[[1, 0, 0], [0, inertia, 0], [0, 0, p["L"]]],
        F=[[0, 1, 0], [0, -p["Kf"], p["Km"]], [0, -p["Kb"], -p["R"]]],
        G=[[0], [0], [1]],
        C=[[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    )


def brushless_motor(**given: Any) -> LinearPlant:
    """Brushless motor under current control: the drive sets the torque-making (q) current."""
    # Gerry Chen, measurements of cogging and friction of a brushless motor, github.com/gchenfc.
    states = (Signal("phi", "rad"), Signal("omega", "rad/s"))
    return LinearPlant(
        "brushless-motor",
        overridden(_PUBLISHED["brushless-motor"], given, "brushless-motor"),
        (Signal("i", "A"),),
        states,
        states,
        equations=_brushless_motor,
    )


def _brushless_motor(p: Any) -> Descriptor:
    return Descriptor(E=[[1, 0], [0, p["J"]]], F=[[0, 1], [0, -p["Kf"]]], G=[[0], [p["Kt"]]], C=[[1, 0], [0, 1]])


def linear_actuator(**given: Any) -> LinearPlant:
    """Linear actuator on its test jig: DC motor, gears, ball screw, cart; default values: the thesis' leg."""
    # Březina 2010, section 7.2 (gears, motor) and chapter 11 (jig; eq. 11.1 is `cart_travel`).
    return LinearPlant(
        "linear-actuator",
        overridden(_PUBLISHED["linear-actuator"], given, "linear-actuator"),
        (Signal("u", "V"),),
        STATES,
        STATES,
        equations=_linear_actuator,
        exact=("ratio", "lead"),
    )


def cart_travel(plant: LinearPlant, phi: ArrayLike) -> Array:
    r"""Travel of the cart in m at the motor angles phi (n,) in rad: :math:`q = h \varphi` (eq. 11.1)."""
    return np.asarray(_travel_per_radian(plant.values) * real_array("phi", phi, 1, plant.name))


def _travel_per_radian(p: Any) -> float:
    return p["lead"] / (2 * math.pi * p["ratio"])


def _linear_actuator(p: Any) -> Descriptor:
    h = _travel_per_radian(p)
    inertia = p["J"] + p["J_nut"] / p["ratio"] ** 2 + (p["m_screw"] + p["m_cart"]) * h**2
    return motor_equations(p, inertia)
