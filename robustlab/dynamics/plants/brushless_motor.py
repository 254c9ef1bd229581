r"""Brushless motor under current control: the drive sets the torque-making (q) current.

.. math:: \dot\varphi = \omega, \qquad J \dot\omega = K_t i - K_f \omega

The drive's current loop is taken to be so fast that the current is an input; the measured current serves as well as the
one that was asked for. Default values are those published with measurements of an unloaded hobby motor of seven pole
pairs on an ODrive; friction and cogging are left out on purpose: this is the nominal model that measurements are
compared with.

References
----------
Gerry Chen, measurements of cogging and friction of a brushless motor, github.com/gchenfc.
"""

from __future__ import annotations

from typing import Any

from robustlab.dynamics.linear_plant import Descriptor, LinearPlant
from robustlab.dynamics.parameters import Parameter, overridden
from robustlab.statespace import Signal

__all__ = []

_CHEN = "Chen, github.com/gchenfc (unloaded motor on an ODrive)"

PARAMETERS = (
    Parameter("J", 2.5e-4, "kg m2", 0.0, _CHEN, "inertia of the rotor", "positive", role="inertia"),
    Parameter("Kf", 0.0, "N m s/rad", 0.0, _CHEN, "viscous friction", "nonnegative", role="viscous-friction"),
    Parameter("Kt", 0.06, "N m/A", 0.0, _CHEN, "torque per ampere", "either", role="input-gain"),
)


def brushless_motor(**given: Any) -> LinearPlant:
    """Plant with input i [A], outputs and states phi [rad], omega [rad/s].

    ``given``: ``J Kf Kt``, each as a value or ``(value, relative tolerance)``.
    """
    states = (Signal("phi", "rad"), Signal("omega", "rad/s"))
    return LinearPlant(
        "brushless-motor",
        overridden(PARAMETERS, given, "brushless-motor"),
        (Signal("i", "A"),),
        states,
        states,
        equations=_equations,
    )


def _equations(p: Any) -> Descriptor:
    return Descriptor(E=[[1, 0], [0, p["J"]]], F=[[0, 1], [0, -p["Kf"]]], G=[[0], [p["Kt"]]], C=[[1, 0], [0, 1]])
