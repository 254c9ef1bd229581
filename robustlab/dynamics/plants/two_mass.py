r"""Two inertias on a shaft, coupled by a spring and a damper; the torque acts on the first.

.. math::
    J_1 \ddot\varphi_1 = \tau - c (\dot\varphi_1 - \dot\varphi_2) - k (\varphi_1 - \varphi_2), \qquad
    J_2 \ddot\varphi_2 = c (\dot\varphi_1 - \dot\varphi_2) + k (\varphi_1 - \varphi_2)
"""

from __future__ import annotations

from typing import Any

from robustlab.dynamics.linear_plant import Descriptor, LinearPlant
from robustlab.dynamics.parameters import Parameter, overridden
from robustlab.statespace import Signal

__all__ = []

_EXAMPLE = "example value, no published source"

PARAMETERS = (
    Parameter("J1", 1e-3, "kg m2", 0.0, _EXAMPLE, "inertia on the motor's side", "positive", role="inertia"),
    Parameter("J2", 2e-3, "kg m2", 0.0, _EXAMPLE, "inertia on the load's side", "positive", role="inertia"),
    Parameter("c", 2e-3, "N m s/rad", 0.0, _EXAMPLE, "damping of the shaft", "nonnegative", role="viscous-friction"),
    Parameter("k", 10.0, "N m/rad", 0.0, _EXAMPLE, "stiffness of the shaft", "nonnegative", role="stiffness"),
)


def two_mass(**given: Any) -> LinearPlant:
    """Plant with input torque [N m], outputs phi1, phi2 [rad], states phi1, phi2, omega1, omega2.

    ``given``: ``J1 J2 c k``, each as a value or ``(value, relative tolerance)``.
    """
    angles = (Signal("phi1", "rad"), Signal("phi2", "rad"))
    return LinearPlant(
        "two-mass",
        overridden(PARAMETERS, given, "two-mass"),
        (Signal("torque", "N m"),),
        angles,
        (*angles, Signal("omega1", "rad/s"), Signal("omega2", "rad/s")),
        equations=_equations,
    )


def _equations(p: Any) -> Descriptor:
    c, k = p["c"], p["k"]
    return Descriptor(
        E=[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, p["J1"], 0], [0, 0, 0, p["J2"]]],
        F=[[0, 0, 1, 0], [0, 0, 0, 1], [-k, k, -c, c], [k, -k, c, -c]],
        G=[[0], [0], [1], [0]],
        C=[[1, 0, 0, 0], [0, 1, 0, 0]],
    )
