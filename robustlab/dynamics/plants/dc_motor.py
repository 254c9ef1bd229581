r"""Permanent-magnet DC motor; default values are the thesis' Maxon RE 35.

.. math::
    \dot\varphi = \omega, \qquad
    J \dot\omega = K_m i - K_f \omega, \qquad
    L \frac{di}{dt} = u - R i - K_b \omega

References
----------
Březina 2010, eqs 7.3-7.5 (states omega and i; the angle is added here).
"""

from __future__ import annotations

from typing import Any

from robustlab.dynamics.linear_plant import Descriptor, LinearPlant
from robustlab.dynamics.parameters import Parameter, overridden
from robustlab.statespace import Signal

__all__ = ["PARAMETERS", "STATES", "dc_motor", "motor_equations"]

_SHEET = "Březina 2010, App. A and section 7.2 (Maxon RE 35, order number 273754)"
_COVER = f"{_SHEET}; tolerance: section 10.1.1"

PARAMETERS = (
    Parameter("R", 2.07, "ohm", 0.0, _SHEET, "terminal resistance", "positive", role="resistance"),
    Parameter("L", 0.62e-3, "H", 0.0, _SHEET, "terminal inductance", "positive", role="inductance"),
    Parameter("Km", 0.052, "N m/A", 0.0, _SHEET, "torque constant", "either", role="torque-constant"),
    Parameter("Kb", 0.052, "V s/rad", 0.0, _SHEET, "back-EMF constant", "either", role="torque-constant"),
    Parameter("Kf", 4.8e-5, "N m s/rad", 0.35, _COVER, "viscous friction", "nonnegative", role="viscous-friction"),
    Parameter("J", 7.2e-6, "kg m2", 0.0, _SHEET, "rotor inertia", "positive", role="inertia"),
)


STATES = (Signal("phi", "rad"), Signal("omega", "rad/s"), Signal("i", "A"))


def dc_motor(**given: Any) -> LinearPlant:
    """Plant with input u [V], outputs and states phi [rad], omega [rad/s], i [A].

    ``given``: ``R L Km Kb Kf J``, each as a value or ``(value, relative tolerance)``.
    """
    parameters = overridden(PARAMETERS, given, "dc-motor")
    return LinearPlant("dc-motor", parameters, (Signal("u", "V"),), STATES, STATES, equations=_equations)


def _equations(p: Any) -> Descriptor:
    return motor_equations(p, p["J"])


def motor_equations(p: Any, inertia: float) -> Descriptor:
    """The motor with an inertia on its shaft (eqs 7.3-7.5)."""
    return Descriptor(
        E=[[1, 0, 0], [0, inertia, 0], [0, 0, p["L"]]],
        F=[[0, 1, 0], [0, -p["Kf"], p["Km"]], [0, -p["Kb"], -p["R"]]],
        G=[[0], [0], [1]],
        C=[[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    )
