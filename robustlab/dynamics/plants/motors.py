"""Electric motors, and the linear actuator that one of them drives."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.dynamics.linear_plant import Descriptor, LinearPlant
from robustlab.dynamics.parameters import Parameter, overridden
from robustlab.statespace import Signal, real_array

_SHEET = "Březina 2010, App. A and section 7.2 (Maxon RE 35, order number 273754)"
_COVER = f"{_SHEET}; tolerance: section 10.1.1"

DC_MOTOR = (
    Parameter("R", 2.07, "ohm", 0.0, _SHEET, "terminal resistance", "positive", role="resistance"),
    Parameter("L", 0.62e-3, "H", 0.0, _SHEET, "terminal inductance", "positive", role="inductance"),
    Parameter("Km", 0.052, "N m/A", 0.0, _SHEET, "torque constant", "either", role="torque-constant"),
    Parameter("Kb", 0.052, "V s/rad", 0.0, _SHEET, "back-EMF constant", "either", role="torque-constant"),
    Parameter("Kf", 4.8e-5, "N m s/rad", 0.35, _COVER, "viscous friction", "nonnegative", role="viscous-friction"),
    Parameter("J", 7.2e-6, "kg m2", 0.0, _SHEET, "rotor inertia", "positive", role="inertia"),
)


STATES = (Signal("phi", "rad"), Signal("omega", "rad/s"), Signal("i", "A"))


def dc_motor(**given: Any) -> LinearPlant:
    """Permanent-magnet DC motor; default values are the thesis' Maxon RE 35."""
    # Březina 2010, eqs 7.3-7.5 (states omega and i; the angle is added here).
    parameters = overridden(DC_MOTOR, given, "dc-motor")
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


_CHEN = "Chen, github.com/gchenfc (unloaded motor on an ODrive)"

BRUSHLESS_MOTOR = (
    Parameter("J", 2.5e-4, "kg m2", 0.0, _CHEN, "inertia of the rotor", "positive", role="inertia"),
    Parameter("Kf", 0.0, "N m s/rad", 0.0, _CHEN, "viscous friction", "nonnegative", role="viscous-friction"),
    Parameter("Kt", 0.06, "N m/A", 0.0, _CHEN, "torque per ampere", "either", role="input-gain"),
)


def brushless_motor(**given: Any) -> LinearPlant:
    """Brushless motor under current control: the drive sets the torque-making (q) current."""
    # Gerry Chen, measurements of cogging and friction of a brushless motor, github.com/gchenfc.
    states = (Signal("phi", "rad"), Signal("omega", "rad/s"))
    return LinearPlant(
        "brushless-motor",
        overridden(BRUSHLESS_MOTOR, given, "brushless-motor"),
        (Signal("i", "A"),),
        states,
        states,
        equations=_brushless_motor,
    )


def _brushless_motor(p: Any) -> Descriptor:
    return Descriptor(E=[[1, 0], [0, p["J"]]], F=[[0, 1], [0, -p["Kf"]]], G=[[0], [p["Kt"]]], C=[[1, 0], [0, 1]])


_BODIES = "Březina 2010, App. A; tolerance: section 11.2"
_CART = (
    "not in the text; a sixth of the platform's 3.167 kg, what one of six legs moves; "
    "reflected to the motor it is 0.03 % of the rotor's inertia, so that a guess does no harm"
)

LINEAR_ACTUATOR = (
    *(replace(p, sign="nonnegative") if p.name == "J" else p for p in DC_MOTOR),  # J = 0: the thesis leaves it out
    Parameter("J_nut", 2.2071e-5, "kg m2", 0.10, _BODIES, "inertia of the screw nut about its axis", "nonnegative",
              role="inertia"),
    Parameter("m_screw", 0.112, "kg", 0.10, _BODIES, "mass of the ball screw, which slides", "nonnegative",
              role="inertia"),
    Parameter("m_cart", 3.167 / 6, "kg", 0.5, _CART, "mass of the cart", "nonnegative", role="inertia"),
    Parameter("ratio", 4.8 * 41 / 21, "rad/rad", 0.0, "Březina 2010, section 6.1.1", "motor turns per nut turn",
              "positive"),
    Parameter("lead", 0.004, "m", 0.0, "Březina 2010, App. A", "travel of the screw per turn of the nut", "positive"),
)  # fmt: skip


def linear_actuator(**given: Any) -> LinearPlant:
    """Linear actuator on its test jig: DC motor, gears, ball screw, cart; default values: the thesis' leg."""
    # Březina 2010, section 7.2 (gears, motor) and chapter 11 (jig; eq. 11.1 is `cart_travel`).
    return LinearPlant(
        "linear-actuator",
        overridden(LINEAR_ACTUATOR, given, "linear-actuator"),
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
