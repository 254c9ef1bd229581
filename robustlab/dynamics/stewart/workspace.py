r"""Workspace and singularities of the Stewart platform.

The singularity measure is the smallest singular value of the Jacobian in :math:`(v, r_p\,\omega)`, which makes all its
entries pure numbers: 1/measure bounds how far the platform can give way per unit error of the lengths.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import Array
from robustlab.dynamics.stewart.compilation import kernels
from robustlab.dynamics.stewart.geometry import Geometry
from robustlab.dynamics.stewart.kinematics import inverse_kinematics, poses_array, velocity_jacobian
from robustlab.errors import InputError, NoTrustworthyNumber

__all__ = ["ConditionMap", "check_pose", "condition_map", "inside", "singularity", "workspace_grid"]

COORDINATES = ("tx", "ty", "tz", "ax", "ay", "az")
# Lengths this little beyond a limit are within it: the rounding of a published limit pose.
SLACK = 1e-9
# Below this measure a pose counts as singular: six digits of the torques are gone.
SINGULAR = 1e-6
# Half widths of a box about home that holds the workspace, in m and rad: found by two million random poses.
REACH = (0.024, 0.024, 0.02, 0.14, 0.14, 0.10)


def inside(geometry: Geometry, poses: ArrayLike) -> NDArray[np.bool_]:
    """True where all six actuators are within their limits, shape (n,)."""
    array, _ = poses_array(poses)
    lengths = inverse_kinematics(geometry, array)
    low, high = geometry.limits
    return np.asarray(((lengths >= low - SLACK) & (lengths <= high + SLACK)).all(axis=1))


def singularity(geometry: Geometry, poses: ArrayLike) -> Array:
    """Smallest and largest singular value of the dimensionless Jacobian, shape (2,) or (n, 2)."""
    array, one = poses_array(poses)
    jacobian = velocity_jacobian(geometry, array)
    jacobian[:, :, 3:] /= geometry.radius
    sigma = np.linalg.svd(jacobian, compute_uv=False)[:, [5, 0]]
    return np.asarray(sigma[0] if one else sigma, dtype=np.float64)


def check_pose(geometry: Geometry, pose: ArrayLike, where: str) -> Array:
    """The pose (6,) where it is within the workspace and not singular.

    Raises
    ------
    InputError
        An actuator beyond its limits, by number and length.
    NoTrustworthyNumber
        A singular pose.
    """
    array = real_array_of_one(pose, where)
    found, matrix = np.empty((1, 6)), np.empty((1, 6, 6))
    kernels().jacobians(array[None], geometry.legs, geometry.c, found, matrix)
    lengths = found[0]
    low, high = geometry.limits
    if lengths.min() < low - SLACK or lengths.max() > high + SLACK:
        beyond = (lengths < low - SLACK) | (lengths > high + SLACK)
        i = int(np.argmax(np.maximum(low - lengths, lengths - high)))
        count = int(beyond.sum())
        more = f" ({count} of 6 actuators are out of range)" if count > 1 else ""
        raise InputError(
            where,
            f"pose out of the workspace: actuator {i + 1} would be {1e3 * lengths[i]:.6g} mm{more}",
            f"{1e3 * low:.6g} .. {1e3 * high:.6g} mm",
            "the limits are the parameters L_min and L_max",
        )
    matrix[0, :, 3:] /= geometry.radius
    sigma = np.linalg.svd(matrix[0], compute_uv=False)
    if not sigma[5] > SINGULAR * sigma[0]:
        raise NoTrustworthyNumber(
            where, f"singular pose: the Jacobian's smallest singular value is {sigma[5]:.3g}", None,
            "the actuators cannot hold the platform there",
        )  # fmt: skip
    return array


def real_array_of_one(pose: ArrayLike, where: str) -> Array:
    """One finite pose of shape (6,)."""
    array, one = poses_array(pose, "pose", where)
    if not one:
        raise InputError(where, f"{len(array)} poses", "one pose (tx, ty, tz, ax, ay, az)")
    return array[0]


def workspace_grid(geometry: Geometry, points: int = 5, reach: ArrayLike = REACH) -> Array:
    """Poses (n, 6) within the workspace, from a grid of points^6 about home with the given half widths in m and rad.

    The default half widths just cover the workspace of the published machine; 11 points give 13 240 poses.
    """
    half = real_array_of_one(reach, "workspace_grid: reach")
    axes = [np.linspace(-width, width, points) for width in half]
    grid = geometry.home + np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 6)
    return grid[inside(geometry, grid)]


@dataclass(frozen=True, eq=False)
class ConditionMap:
    """Condition of the Jacobian over two coordinates of the pose; NaN out of the workspace."""

    names: tuple[str, str]  # the two coordinates, of tx ty tz ax ay az
    # first, second: their values, (n1,), (n2,)
    first: Array
    second: Array
    # condition, smallest: condition number and smallest singular value, (n1, n2)
    condition: Array
    smallest: Array

    def to_json(self) -> dict[str, Any]:
        """All attributes."""
        return dict(vars(self))


def condition_map(
    geometry: Geometry, names: tuple[str, str], first: ArrayLike, second: ArrayLike, pose: ArrayLike | None = None
) -> ConditionMap:
    """Map over the coordinates ``names``, the others as in ``pose`` (home where left out).

    Raises
    ------
    InputError
        Names that are not two different coordinates of a pose.
    """
    if len(names) != 2 or names[0] == names[1] or any(name not in COORDINATES for name in names):
        raise InputError("condition_map: names", f"{names!r}", f"two of {', '.join(COORDINATES)}")
    one, two = np.atleast_1d(np.asarray(first, float)), np.atleast_1d(np.asarray(second, float))
    poses = np.tile(
        real_array_of_one(geometry.home if pose is None else pose, "condition_map"), (len(one), len(two), 1)
    )
    poses[:, :, COORDINATES.index(names[0])] = one[:, None]
    poses[:, :, COORDINATES.index(names[1])] = two[None, :]
    flat = poses.reshape(-1, 6)
    sigma = np.where(inside(geometry, flat)[:, None], singularity(geometry, flat), np.nan).reshape(
        len(one), len(two), 2
    )
    return ConditionMap((names[0], names[1]), one, two, sigma[..., 1] / sigma[..., 0], sigma[..., 0])
