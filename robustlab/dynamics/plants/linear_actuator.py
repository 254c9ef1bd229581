r"""Linear actuator on its test jig: DC motor, gears, ball screw, cart; default values: the thesis' leg.

Angle, speed and current are the motor's own; everything behind it is reflected to its shaft by
:math:`n` motor turns per turn of the nut and :math:`h` metres of travel per radian of the motor:

.. math::
    \dot\varphi = \omega, \qquad
    \bigl(J + J_\mathrm{nut} / n^2 + (m_\mathrm{screw} + m_\mathrm{cart})\, h^2\bigr) \dot\omega = K_m i - K_f \omega,
    \qquad L \frac{di}{dt} = u - R i - K_b \omega, \qquad h = \frac{\mathrm{lead}}{2 \pi n}

The nut turns, the screw and the cart slide, the wheels of the gear are massless, the axis lies level (no gravity), and
the only friction is the motor's viscous one; dry friction is added by `robustlab.dynamics.dry_friction`.

References
----------
Březina 2010, section 7.2 (gears, motor) and chapter 11 (jig; eq. 11.1 is `cart_travel`).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.dynamics.linear_plant import Descriptor, LinearPlant
from robustlab.dynamics.parameters import Parameter, overridden
from robustlab.dynamics.plants.dc_motor import PARAMETERS as MOTOR
from robustlab.dynamics.plants.dc_motor import STATES, motor_equations
from robustlab.statespace import Signal, real_array

__all__ = ["cart_travel", "linear_actuator"]

_BODIES = "Březina 2010, App. A; tolerance: section 11.2"
_CART = (
    "not in the text; a sixth of the platform's 3.167 kg, what one of six legs moves; "
    "reflected to the motor it is 0.03 % of the rotor's inertia, so that a guess does no harm"
)

PARAMETERS = (
    *(replace(p, sign="nonnegative") if p.name == "J" else p for p in MOTOR),  # J = 0: the thesis leaves it out
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
    """Plant with input u [V], outputs and states phi [rad], omega [rad/s], i [A], all of the motor.

    ``given``: ``R L Km Kb Kf J J_nut m_screw m_cart``, each as a value or ``(value, relative tolerance)``; ``ratio``
    and ``lead`` as values (tooth counts and a ground thread are exact).

    Raises InputError: an unknown parameter, NaN, a sign that physics forbids, a tolerance on ``ratio`` or ``lead``.

    Examples
    --------
    >>> actuator = linear_actuator(m_cart=(2.0, 0.1))
    >>> round(float(actuator.state_space().A[1, 2]))  # rad/s2 per ampere
    6970
    """
    return LinearPlant(
        "linear-actuator",
        overridden(PARAMETERS, given, "linear-actuator"),
        (Signal("u", "V"),),
        STATES,
        STATES,
        equations=_equations,
        exact=("ratio", "lead"),
    )


def cart_travel(plant: LinearPlant, phi: ArrayLike) -> Array:
    r"""Travel of the cart in m at the motor angles phi (n,) in rad: :math:`q = h \varphi` (eq. 11.1).

    Examples
    --------
    >>> cart_travel(linear_actuator(), [2 * math.pi * 4.8 * 41 / 21]).round(12).tolist()
    [0.004]
    """
    return np.asarray(_travel_per_radian(plant.values) * real_array("phi", phi, 1, plant.name))


def _travel_per_radian(p: Any) -> float:
    return p["lead"] / (2 * math.pi * p["ratio"])


def _equations(p: Any) -> Descriptor:
    h = _travel_per_radian(p)
    inertia = p["J"] + p["J_nut"] / p["ratio"] ** 2 + (p["m_screw"] + p["m_cart"]) * h**2
    return motor_equations(p, inertia)
