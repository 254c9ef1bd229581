"""The Stewart platform: geometry, kinematics, rigid-body dynamics, plant."""

from robustlab.lazily import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "kinematics": "direct_kinematics inside inverse_kinematics nut_angles singularity velocity_jacobian",
        "stewart_platform": "StewartPlatform bias_torque mass_matrix",
    },
)
