r"""Inverse kinematics of the Stewart platform, and its Jacobians of velocity and acceleration in closed form.

.. math::
    L_i = |p_{T,i} - d_i|, \quad p_T = T + R p, \quad d = b + c\,y^*, \qquad
    \dot L = K \cdot v + (\rho \times K) \cdot \omega, \qquad \rho = R p,

    \ddot L = J \dot V + K \cdot \omega \times (\omega \times \rho) + r \dot\theta^2 \sin\beta + L \dot\beta^2

with :math:`V = (v, \omega)` the platform's twist in the base frame at the origin T of the platform frame,
:math:`\dot\theta = z \cdot \dot s / r` and :math:`\dot\beta = N \cdot \dot s / L` (see
`robustlab.dynamics.stewart.kernels`).

A pose is (tx, ty, tz, ax, ay, az) in m and rad, R = Rz(az) Ry(ay) Rx(ax).

References
----------
Březina 2010, eqs 6.3, 6.4 (plain joint), 6.5-6.8 (shifted joint).
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.dynamics.stewart.compilation import kernels
from robustlab.dynamics.stewart.geometry import Geometry
from robustlab.errors import InputError
from robustlab.statespace import real_array

__all__ = [
    "acceleration_bias",
    "inverse_kinematics",
    "nut_angles",
    "poses_array",
    "rotation",
    "twist",
    "velocity_jacobian",
]

Array = NDArray[np.float64]
Joint = Literal["shifted", "simple"]


def poses_array(value: ArrayLike, name: str = "pose", where: str = "stewart-platform") -> tuple[Array, bool]:
    """One pose (6,) or many (n, 6) as a finite array (n, 6), and whether it was one.

    Raises
    ------
    InputError
        Another shape, or NaN or Inf, by index.
    """
    one = np.ndim(value) == 1
    array = real_array(name, value, 1 if one else 2, where)
    if array.shape[-1] != 6:
        raise InputError(where, f"{name} has shape {array.shape}", "(6,) or (n, 6)")
    return np.array(array.reshape(-1, 6), order="C"), one  # writable: the kernels take no read-only arrays


def inverse_kinematics(geometry: Geometry, poses: ArrayLike, joint: Joint = "shifted") -> Array:
    """Actuator lengths in m at the poses (6,) or (n, 6), of the same shape.

    Parameters
    ----------
    joint
        ``"shifted"``: the joint's axes are c apart (eqs 6.5-6.8). ``"simple"``: they meet (eqs 6.3, 6.4).

    Raises
    ------
    InputError
        A pose that is no pose, an unknown joint.
    """
    array, one = poses_array(poses)
    if joint not in ("shifted", "simple"):
        raise InputError("inverse_kinematics: joint", f"{joint!r}", "'shifted' or 'simple'")
    lengths = np.empty_like(array)
    kernels().inverse_lengths(array, geometry.legs, geometry.c if joint == "shifted" else 0.0, lengths)
    return lengths[0] if one else lengths


def nut_angles(geometry: Geometry, poses: ArrayLike) -> Array:
    """Nut angles phi = 2 pi / lead (L - L(home)) in rad at the poses (6,) or (n, 6); positive is extension."""
    return geometry.turns * (inverse_kinematics(geometry, poses) - geometry.home_lengths)


def velocity_jacobian(geometry: Geometry, poses: ArrayLike) -> Array:
    """J of dL/dt = J (v, omega), shape (6, 6) or (n, 6, 6); times ``geometry.turns`` it gives the nut rates."""
    array, one = poses_array(poses)
    matrices = np.empty((len(array), 6, 6))
    kernels().jacobians(array, geometry.legs, geometry.c, np.empty_like(array), matrices)
    return matrices[0] if one else matrices


def acceleration_bias(geometry: Geometry, poses: ArrayLike, twists: ArrayLike) -> Array:
    """d2L/dt2 at dV/dt = 0, so that d2L/dt2 = J dV/dt + bias; shape of the poses, (6,) or (n, 6)."""
    array, one = poses_array(poses)
    rates, _ = poses_array(twists, "twist")
    if rates.shape != array.shape:
        raise InputError("acceleration_bias", f"{len(rates)} twists", f"{len(array)}, one for each pose")
    bias = np.empty_like(array)
    kernels().length_bias(array, rates, geometry.legs, geometry.c, bias)
    return bias[0] if one else bias


def rotation(pose: ArrayLike) -> Array:
    """R = Rz(az) Ry(ay) Rx(ax) of a pose, shape (3, 3)."""
    _, _, _, ax, ay, az = np.asarray(pose, dtype=np.float64)
    (cx, cy, cz), (sx, sy, sz) = np.cos([ax, ay, az]), np.sin([ax, ay, az])
    return np.array(
        [
            [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
            [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
            [-sy, cy * sx, cy * cx],
        ]
    )


def twist(pose: ArrayLike, rates: ArrayLike) -> Array:
    """(v, omega) at the rates of the pose's six coordinates, shape (6,)."""
    _, _, _, _, ay, az = np.asarray(pose, dtype=np.float64)
    rate = np.asarray(rates, dtype=np.float64)
    turn = np.array(
        [
            [np.cos(az) * np.cos(ay), -np.sin(az), 0.0],
            [np.sin(az) * np.cos(ay), np.cos(az), 0.0],
            [-np.sin(ay), 0.0, 1.0],
        ]
    )
    return np.concatenate([rate[:3], turn @ rate[3:]])
