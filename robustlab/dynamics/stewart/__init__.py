"""The Stewart platform: geometry, kinematics, rigid-body dynamics, plant."""

from __future__ import annotations

from robustlab.dynamics.stewart.geometry import Geometry
from robustlab.dynamics.stewart.kinematics import (
    ConditionMap,
    DirectPoses,
    acceleration_bias,
    assembly_poses,
    condition_map,
    direct_kinematics,
    inside,
    inverse_kinematics,
    nut_angles,
    rotation,
    singularity,
    twist,
    velocity_jacobian,
    workspace_grid,
)
from robustlab.dynamics.stewart.rigid_body import (
    bias_torque,
    kinetic_energy,
    mass_matrix,
    potential_energy,
    trim_torque,
)
from robustlab.dynamics.stewart.stewart_platform import LinearModels, StewartPlatform, linear_models, stewart_platform

__all__ = [
    "ConditionMap",
    "DirectPoses",
    "Geometry",
    "LinearModels",
    "StewartPlatform",
    "acceleration_bias",
    "assembly_poses",
    "bias_torque",
    "condition_map",
    "direct_kinematics",
    "inside",
    "inverse_kinematics",
    "kinetic_energy",
    "linear_models",
    "mass_matrix",
    "nut_angles",
    "potential_energy",
    "rotation",
    "singularity",
    "stewart_platform",
    "trim_torque",
    "twist",
    "velocity_jacobian",
    "workspace_grid",
]
