"""The Stewart platform: geometry, kinematics, rigid-body dynamics, plant."""

from robustlab.public_names import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "stewart_platform": "StewartPlatform bias_torque direct_kinematics inside inverse_kinematics mass_matrix"
        " nut_angles singularity velocity_jacobian",
    },
)
