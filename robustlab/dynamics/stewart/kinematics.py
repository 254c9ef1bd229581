r"""Kinematics of the Stewart platform: lengths, Jacobians, proved poses, workspace and singularities.

.. math::
    L_i = |p_{T,i} - d_i|, \quad p_T = T + R p, \quad d = b + c\,y^*, \qquad
    \dot L = K \cdot v + (\rho \times K) \cdot \omega, \qquad \rho = R p,
"""
# Březina 2010, eqs 6.3, 6.4 (plain joint), 6.5-6.8 (shifted joint). Kantorovich, Akilov, "Functional Analysis", 2nd
# ed., Pergamon 1982, chapter XVIII.

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import Array
from robustlab.dynamics.integrator.compilation import compiled
from robustlab.dynamics.stewart.geometry import Geometry
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.result import Status
from robustlab.statespace import real_array

HERE = Path(__file__).parent
TEXT = "stewart-platform: compiling the equations of motion (once on this machine, a minute or two) ..."


@cache
def kernels() -> ModuleType:
    """Load the compiled kinematics and dynamics."""
    return compiled(HERE / "kernels.py", "robustlab.dynamics.stewart.kernels", (), TEXT)


@cache
def motion_kernels() -> ModuleType:
    """Load the compiled integrators."""
    from robustlab.dynamics.integrator.steps import TABLE

    steps = HERE.parent / "integrator" / "steps.py"
    leaves = (HERE / "kernels.py", steps, TABLE)
    return compiled(HERE / "motion_kernels.py", "robustlab.dynamics.stewart.motion_kernels", leaves, TEXT)


# Limit of Newton steps of the direct kinematics; a pose needs four or five.
LIMIT = 60


def poses_array(value: ArrayLike, name: str = "pose", where: str = "stewart-platform") -> tuple[Array, bool]:
    """Return one pose (6,) or many (n, 6) as a finite array (n, 6), and whether it was one."""
    one = np.ndim(value) == 1
    array = real_array(name, value, 1 if one else 2, where)
    if array.shape[-1] != 6:
        raise InputError(where, f"{name} has shape {array.shape}", "(6,) or (n, 6)")
    return np.array(array.reshape(-1, 6), order="C"), one  # writable, as required by the kernels


def inverse_kinematics(geometry: Geometry, poses: ArrayLike) -> Array:
    """Return actuator lengths in m at the poses (6,) or (n, 6), of the same shape."""
    array, one = poses_array(poses)
    lengths = np.empty_like(array)
    kernels().inverse_lengths(array, geometry.legs, geometry.c, lengths)
    return lengths[0] if one else lengths


def nut_angles(geometry: Geometry, poses: ArrayLike) -> Array:
    """Return nut angles phi = 2 pi / lead (L - L(home)) in rad at the poses (6,) or (n, 6); positive: extension."""
    return geometry.turns * (inverse_kinematics(geometry, poses) - geometry.home_lengths)


def velocity_jacobian(geometry: Geometry, poses: ArrayLike) -> Array:
    """Return J of dL/dt = J (v, omega), shape (6, 6) or (n, 6, 6); times ``geometry.turns``: nut rates."""
    array, one = poses_array(poses)
    matrices = np.empty((len(array), 6, 6))
    kernels().jacobians(array, geometry.legs, geometry.c, np.empty_like(array), matrices)
    return matrices[0] if one else matrices


@dataclass(frozen=True, eq=False)
class DirectPoses:
    """Poses found by Newton's method, each with its certificate; arrays of n rows."""

    poses: Array  # shape (n, 6)
    # true where the Newton-Kantorovich theorem proves a unique pose within ``radius``
    proved: NDArray[np.bool_]
    # Kantorovich's number (at most 1/2), and the bound on |dT|, r_p |d angles| to the exact pose in m
    h: Array
    radius: Array

    @property
    def pose(self) -> Array:
        """The pose (6,) if there is only one."""
        if len(self.poses) != 1:
            raise InputError("DirectPoses.pose", f"{len(self.poses)} poses", "one; take .poses")
        return self.poses[0]

    @property
    def status(self) -> Status:
        return Status.CERTIFIED if self.proved.all() else Status.INCONCLUSIVE


def direct_kinematics(geometry: Geometry, lengths: ArrayLike, start: ArrayLike | None = None) -> DirectPoses:
    """Find the poses for these actuator lengths."""
    target, _ = poses_array(lengths, "lengths")
    if (target <= 0).any():
        k, i = np.argwhere(target <= 0)[0]
        raise InputError("direct_kinematics", f"lengths[{k},{i}] = {target[k, i]:g} m", "positive lengths")
    seed, one = poses_array(geometry.home if start is None else start, "start")
    if not one and len(seed) != len(target):
        raise InputError("direct_kinematics", f"{len(seed)} starts", f"1 or {len(target)}, one for each row of lengths")
    seeds = np.array(np.broadcast_to(seed, target.shape), order="C")
    poses, facts = np.empty_like(target), np.empty((len(target), 4))
    kernels().direct_poses(target, seeds, geometry.legs, geometry.c, LIMIT, poses, facts)
    proved = (facts[:, 0] >= 0) & (facts[:, 1] <= 0.5)  # facts: Newton steps (-1: singular), h, radius, residual
    return DirectPoses(poses, proved, facts[:, 1], facts[:, 2])


# Allowed excess of a limit in m: rounding of a published limit pose.
SLACK = 1e-9
# Ratio of singular values below which a pose counts as singular: six digits of the torques are lost.
SINGULAR = 1e-6


def inside(geometry: Geometry, poses: ArrayLike) -> NDArray[np.bool_]:
    """Return where all six actuators are within their limits, shape (n,)."""
    array, _ = poses_array(poses)
    lengths = inverse_kinematics(geometry, array)
    low, high = geometry.limits
    return np.asarray(((lengths >= low - SLACK) & (lengths <= high + SLACK)).all(axis=1))


def singularity(geometry: Geometry, poses: ArrayLike) -> Array:
    """Return the smallest and largest singular value of the dimensionless Jacobian, shape (2,) or (n, 2)."""
    array, one = poses_array(poses)
    jacobian = velocity_jacobian(geometry, array)
    jacobian[:, :, 3:] /= geometry.radius
    sigma = np.linalg.svd(jacobian, compute_uv=False)[:, [5, 0]]
    return np.asarray(sigma[0] if one else sigma, dtype=np.float64)


def check_pose(geometry: Geometry, pose: ArrayLike, where: str) -> Array:
    """Return the pose (6,) if it is within the workspace and not singular."""
    array = real_array_of_one(pose, where)
    lengths = inverse_kinematics(geometry, array)
    low, high = geometry.limits
    count = int(((lengths < low - SLACK) | (lengths > high + SLACK)).sum())
    if count:
        i = int(np.argmax(np.maximum(low - lengths, lengths - high)))
        more = f" ({count} of 6 actuators are out of range)" if count > 1 else ""
        found = f"pose out of the workspace: actuator {i + 1} would be {1e3 * lengths[i]:.6g} mm{more}"
        hint = "the limits are the parameters L_min and L_max"
        raise InputError(where, found, f"{1e3 * low:.6g} .. {1e3 * high:.6g} mm", hint)
    smallest, largest = singularity(geometry, array)
    if not smallest > SINGULAR * largest:
        found = f"singular pose: the Jacobian's smallest singular value is {smallest:.3g}"
        raise NoTrustworthyNumber(where, found, None, "the actuators cannot hold the platform there")
    return array


def real_array_of_one(pose: ArrayLike, where: str) -> Array:
    """Return one finite pose of shape (6,)."""
    array, one = poses_array(pose, "pose", where)
    if not one:
        raise InputError(where, f"{len(array)} poses", "one pose (tx, ty, tz, ax, ay, az)")
    return array[0]
