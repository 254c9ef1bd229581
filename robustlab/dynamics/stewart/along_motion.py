"""The Stewart platform about points of a motion: rates, exact Jacobians, and what acts at nuts and motors."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.plant_contract import PortPlace
from robustlab.dynamics.stewart.compilation import kernels
from robustlab.dynamics.stewart.geometry import Geometry
from robustlab.dynamics.stewart.kinematics import direct_kinematics
from robustlab.errors import NoTrustworthyNumber

__all__ = ["accelerations", "derivatives", "motion", "places", "torques"]

NAME = "stewart-platform"


def places(motors: bool) -> tuple[PortPlace, ...]:
    """A torque at each nut, and with motors a voltage at each current."""
    nuts = tuple(PortPlace(f"phidot_{i}", "joint", "N m", f"phi_{i}") for i in range(1, 7))
    return nuts + tuple(PortPlace(f"i_{i}", "current", "V") for i in range(1, 7) if motors)


def motion(geometry: Geometry, x: Array) -> tuple[Array, Array]:
    """Poses and twists (n, 6) of the states (n, 12 or 18).

    Raises
    ------
    NoTrustworthyNumber
        Nut angles that no pose could be proved to have.
    """
    return _kept_motion(geometry, np.ascontiguousarray(x[:, :12]).tobytes())


@lru_cache(maxsize=64)
def _kept_motion(geometry: Geometry, states: bytes) -> tuple[Array, Array]:
    """`motion`, kept: masses and motors change nothing of it."""
    x = np.frombuffer(states).reshape(-1, 12)
    lengths = np.ascontiguousarray(geometry.home_lengths + x[:, :6] / geometry.turns)
    shortest = lengths.min(initial=np.inf)
    if not shortest > 0.0:
        row = int(np.argmin(lengths.min(axis=1)))
        raise NoTrustworthyNumber(NAME, f"the nut angles of point {row} make an actuator shorter than nothing")
    found = direct_kinematics(geometry, lengths)
    if not found.proved.all():
        raise NoTrustworthyNumber(
            NAME, f"no pose with the nut angles of point {int(np.argmin(found.proved))} was found"
        )
    poses = np.ascontiguousarray(found.poses)
    matrix = np.empty((len(x), 6, 6))
    kernels().jacobians(poses, geometry.legs, geometry.c, lengths, matrix)
    twists = np.linalg.solve(geometry.turns * matrix, x[:, 6:, None])[..., 0]
    return poses, np.ascontiguousarray(twists)


def torques(values: Mapping[str, float], x: Array, u: Array) -> Array:
    """Motor torques (n, 6): the inputs, or with motors (18 states) what the currents and the speeds make."""
    if x.shape[1] == 12:
        return np.array(u, order="C")
    return values["Km"] * x[:, 12:] - values["Kf"] * values["ratio"] * x[:, 6:12]


def accelerations(geometry: Geometry, constants: Array, x: Array, torque: Array) -> Array:
    """Of the nuts, (n, 6)."""
    poses, twists = motion(geometry, x)
    phi, rates, found = np.empty_like(poses), np.empty_like(poses), np.empty_like(poses)
    numbers = np.array(np.broadcast_to(constants, (len(x), len(constants))), order="C")
    kernels().forward_dynamics(poses, twists, torque, geometry.legs, numbers, phi, rates, found)
    return found


def derivatives(geometry: Geometry, constants: Array, x: Array, torque: Array) -> tuple[Array, Array, Array]:
    """Derivatives of the nuts' accelerations over nut angles, rates and motor torques, (n, 6, 6) each.

    Raises
    ------
    NoTrustworthyNumber
        A singular pose.
    """
    poses, twists = motion(geometry, x)
    numbers = np.array(np.broadcast_to(constants, (len(x), len(constants))), order="C")
    stiffness, damping, gain = np.empty((3, len(x), 6, 6))
    if not kernels().linearisations(poses, twists, torque, geometry.legs, numbers, stiffness, damping, gain):
        raise NoTrustworthyNumber(NAME, "singular pose along the motion: no linear model in nut coordinates")
    return stiffness, damping, gain
