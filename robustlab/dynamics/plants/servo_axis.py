r"""Linear servo axis: a drive that pushes a carriage against viscous friction.

.. math:: \dot q = v, \qquad M \dot v = g u - F_v v

Default values are the published linear part of the EMPS benchmark (a Maxon motor driving a ball screw); its dry
friction and offset are left out on purpose: this is the nominal model that measurements are compared with.

References
----------
Janot, Gautier, Brunot, "Data set and reference models of EMPS", Workshop on Nonlinear System Identification
Benchmarks (2019).
"""

from __future__ import annotations

from typing import Any

from robustlab.dynamics.linear_plant import Descriptor, LinearPlant
from robustlab.dynamics.parameters import Parameter, overridden
from robustlab.statespace import Signal

__all__ = []

_EMPS = "Janot, Gautier, Brunot 2019 (EMPS)"

PARAMETERS = (
    Parameter("M", 95.1089, "kg", 0.0, _EMPS, "moving mass seen at the carriage", "positive", role="inertia"),
    Parameter("Fv", 203.5034, "N s/m", 0.0, _EMPS, "viscous friction", "nonnegative", role="viscous-friction"),
    Parameter("gain", 35.15065, "N/V", 0.0, _EMPS, "force at the carriage per volt", "either", role="input-gain"),
)


def servo_axis(**given: Any) -> LinearPlant:
    """Plant with input u [V], outputs and states q [m], v [m/s].

    ``given``: ``M Fv gain``, each as a value or ``(value, relative tolerance)``.
    """
    states = (Signal("q", "m"), Signal("v", "m/s"))
    return LinearPlant(
        "servo-axis",
        overridden(PARAMETERS, given, "servo-axis"),
        (Signal("u", "V"),),
        states,
        states,
        equations=_equations,
    )


def _equations(p: Any) -> Descriptor:
    return Descriptor(E=[[1, 0], [0, p["M"]]], F=[[0, 1], [0, -p["Fv"]]], G=[[0], [p["gain"]]], C=[[1, 0], [0, 1]])
