"""The Stewart platform: geometry, kinematics, rigid-body dynamics, plant."""

from robustlab.dynamics.stewart.geometry import Geometry
from robustlab.dynamics.stewart.kinematics import (
    DirectPoses,
    direct_kinematics,
    inside,
    inverse_kinematics,
    nut_angles,
    singularity,
    velocity_jacobian,
)
from robustlab.dynamics.stewart.stewart_platform import StewartPlatform, bias_torque, mass_matrix, stewart_platform

__all__ = [
    "DirectPoses",
    "Geometry",
    "StewartPlatform",
    "bias_torque",
    "direct_kinematics",
    "inside",
    "inverse_kinematics",
    "mass_matrix",
    "nut_angles",
    "singularity",
    "stewart_platform",
    "velocity_jacobian",
]
