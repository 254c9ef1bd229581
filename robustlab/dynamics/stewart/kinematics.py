r"""Kinematics of the Stewart platform: lengths and Jacobians in closed form, poses by Newton's method with a proof.

.. math::
    L_i = |p_{T,i} - d_i|, \quad p_T = T + R p, \quad d = b + c\,y^*, \qquad
    \dot L = K \cdot v + (\rho \times K) \cdot \omega, \qquad \rho = R p,

    \ddot L = J \dot V + K \cdot \omega \times (\omega \times \rho) + r \dot\theta^2 \sin\beta + L \dot\beta^2

with :math:`V = (v, \omega)` the platform's twist in the base frame at the origin T of the platform frame,
:math:`\dot\theta = z \cdot \dot s / r` and :math:`\dot\beta = N \cdot \dot s / L` (see
`robustlab.dynamics.stewart.kernels`). A pose is (tx, ty, tz, ax, ay, az) in m and rad, R = Rz(az) Ry(ay) Rx(ax).

The way back, from lengths to a pose: in the coordinates :math:`x = (T, r_p\,(a_x, a_y, a_z))` the Newton-Kantorovich
theorem holds at the end of the iteration. With :math:`\beta \ge \|L'(x)^{-1}\|`, :math:`\eta = \beta |L(x) - L^\star|`
and a Lipschitz constant gamma of :math:`L'`,

.. math:: h = \beta \gamma \eta \le 1/2 \quad\Rightarrow\quad
          \text{one and only one pose with lengths } L^\star \text{ within } \frac{2\eta}{1 + \sqrt{1 - 2h}} .

gamma is known in closed form. The Hessian of a length in its platform point s is
:math:`N N^T / L + z z^T \sin\beta / r`, of norm at most 1/L (since :math:`r = c + L \sin\beta`). Along a unit direction
of x the point moves with :math:`|s'| \le 2` and :math:`|s''| \le 3/r_p`, so that
:math:`|L_i''| \le 4/L_{min} + 3/r_p` and :math:`\gamma = \sqrt 6 (4/L_{min} + 3/r_p)`. The rounding of the computed
lengths is added to the miss.

References
----------
Březina 2010, eqs 6.3, 6.4 (plain joint), 6.5-6.8 (shifted joint).
Kantorovich, Akilov, "Functional Analysis", 2nd ed., Pergamon 1982, chapter XVIII.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import Array
from robustlab.dynamics.stewart.compilation import kernels
from robustlab.dynamics.stewart.geometry import Geometry
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.result import Status
from robustlab.statespace import real_array

__all__ = [
    "DirectPoses",
    "assembly_poses",
    "direct_kinematics",
    "acceleration_bias",
    "inverse_kinematics",
    "nut_angles",
    "poses_array",
    "rotation",
    "twist",
    "velocity_jacobian",
]


Joint = Literal["shifted", "simple"]
# Newton steps of the direct kinematics; a pose takes four or five.
LIMIT = 60


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


@dataclass(frozen=True, eq=False)
class DirectPoses:
    """Poses found by Newton's method, each with its certificate; arrays of n rows."""

    poses: Array  # shape (n, 6)
    lengths: Array  # actuator lengths that were asked for, (n, 6)
    # true where the Newton-Kantorovich theorem proves one pose within ``radius`` of the one given
    proved: NDArray[np.bool_]
    # h, radius: Kantorovich's number (at most 1/2), and the bound on |dT|, r_p |d angles| to the exact pose in m
    h: Array
    radius: Array
    residual: Array  # euclidean norm of the lengths' errors in m
    iterations: NDArray[np.int64]  # Newton steps; -1 where the Jacobian was singular

    @property
    def pose(self) -> Array:
        """The pose (6,), where there is only one."""
        if len(self.poses) != 1:
            raise InputError("DirectPoses.pose", f"{len(self.poses)} poses", "one; take .poses")
        return self.poses[0]

    @property
    def status(self) -> Status:
        """CERTIFIED where every pose is proved, else INCONCLUSIVE."""
        return Status.CERTIFIED if self.proved.all() else Status.INCONCLUSIVE

    def to_json(self) -> dict[str, Any]:
        """All arrays, and the status."""
        names = ("poses", "lengths", "proved", "h", "radius", "residual", "iterations")
        return {**{name: getattr(self, name) for name in names}, "status": self.status}


def direct_kinematics(geometry: Geometry, lengths: ArrayLike, start: ArrayLike | None = None) -> DirectPoses:
    """Poses at which the actuators have these lengths.

    Parameters
    ----------
    lengths
        In m, shape (6,) or (n, 6).
    start
        Pose (6,) or poses (n, 6) to start from, for example the last known ones; home where left out.

    Returns
    -------
    DirectPoses
        Where a length is out of reach, ``proved`` is False; nothing is raised, so that one bad row spoils no other.

    Raises
    ------
    InputError
        Wrong shapes, NaN, a length that is not positive.
    """
    target, _ = poses_array(lengths, "lengths")
    if (target <= 0).any():
        k, i = np.argwhere(target <= 0)[0]
        raise InputError("direct_kinematics", f"lengths[{k},{i}] = {target[k, i]:g} m", "positive lengths")
    if start is None:
        seeds = np.empty_like(target)
        seeds[:] = geometry.home
    else:
        seed, one = poses_array(start, "start")
        if not one and len(seed) != len(target):
            raise InputError(
                "direct_kinematics", f"{len(seed)} starts", f"1 or {len(target)}, one for each row of lengths"
            )
        seeds = np.array(np.broadcast_to(seed, target.shape), order="C")
    poses, facts = np.empty_like(target), np.empty((len(target), 4))
    kernels().direct_poses(target, seeds, geometry.legs, geometry.c, LIMIT, poses, facts)
    proved = (facts[:, 0] >= 0) & (facts[:, 1] <= 0.5)
    return DirectPoses(poses, target, proved, facts[:, 1], facts[:, 2], facts[:, 3], facts[:, 0].astype(np.int64))


def assembly_poses(geometry: Geometry, lengths: ArrayLike, seeds: ArrayLike) -> DirectPoses:
    """All different poses with one set of lengths (6,) that Newton's method reaches from the seeds (n, 6).

    A Stewart platform can be put together in several ways with the same lengths; seeds from a grid over (and beyond)
    the workspace find those that lie there. Only proved poses are kept; it is no proof that there are no more.

    Raises
    ------
    NoTrustworthyNumber
        No seed led to a proved pose.
    """
    target, _ = poses_array(lengths, "lengths")
    starts, _ = poses_array(seeds, "seeds")
    found = direct_kinematics(geometry, np.repeat(target[:1], len(starts), axis=0), starts)
    kept: list[int] = []
    for k in np.flatnonzero(found.proved & (np.abs(found.poses[:, 4]) < np.pi / 2)):
        pose = np.concatenate([found.poses[k, :3], np.exp(1j * found.poses[k, 3:])])
        others = [np.concatenate([found.poses[j, :3], np.exp(1j * found.poses[j, 3:])]) for j in kept]
        if all(np.abs(pose - other).max() > 1e-7 for other in others):
            kept.append(int(k))
    if not kept:
        raise NoTrustworthyNumber(
            "assembly_poses", f"none of {len(starts)} seeds led to a proved pose", None, "check the lengths, in m"
        )
    names = ("poses", "lengths", "proved", "h", "radius", "residual", "iterations")
    return DirectPoses(*(getattr(found, name)[kept] for name in names))
