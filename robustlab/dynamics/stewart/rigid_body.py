r"""Rigid-body dynamics of the Stewart platform in nut coordinates.

.. math:: M(\varphi)\,\ddot\varphi + b(\varphi, \dot\varphi) = k\,u, \qquad M = J^{-T} M_V J^{-1}
"""
# Březina 2010, section 7.1 and App. A.

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.dynamics.stewart.geometry import up
from robustlab.dynamics.stewart.kinematics import (
    SINGULAR,
    check_pose,
    kernels,
    real_array_of_one,
    rotation,
    singularity,
)
from robustlab.dynamics.stewart.stewart_platform import StewartPlatform
from robustlab.errors import NoTrustworthyNumber
from robustlab.statespace import real_array


def nut_to_twist(plant: StewartPlatform, pose: ArrayLike) -> Array:
    """J^-1 of ``V = J^-1 dphi/dt``, shape (6, 6). Raises NoTrustworthyNumber: a singular pose."""
    array = real_array_of_one(pose, plant.name)
    smallest, largest = singularity(plant.geometry, array)
    if not smallest > SINGULAR * largest:
        raise NoTrustworthyNumber(plant.name, f"singular pose: smallest singular value {smallest:.3g}")
    return np.asarray(np.linalg.inv(_equations(plant, array, np.zeros(6))[2]), dtype=np.float64)


def mass_matrix(plant: StewartPlatform, pose: ArrayLike) -> Array:
    """M in kg m2 at the nuts, shape (6, 6)."""
    inverse = nut_to_twist(plant, pose)
    mass = _equations(plant, real_array_of_one(pose, plant.name), np.zeros(6))[0]
    return np.asarray(inverse.T @ mass @ inverse, dtype=np.float64)


def bias_torque(plant: StewartPlatform, pose: ArrayLike, phidot: ArrayLike) -> Array:
    """Torques b in N m at the nuts: gravity and velocity terms at the nut rates phidot (6,)."""
    inverse = nut_to_twist(plant, pose)
    array, rates = real_array_of_one(pose, plant.name), real_array("phidot", phidot, 1, plant.name)
    mass, force, _, bias = _equations(plant, array, inverse @ rates)
    return inverse.T @ (force - mass @ (inverse @ bias))


def trim_torque(plant: StewartPlatform, pose: ArrayLike) -> Array:
    """Motor torques in N m that hold the pose, shape (6,); the pose must be within the workspace."""
    return bias_torque(plant, check_pose(plant.geometry, pose, plant.name), np.zeros(6)) / plant.values["ratio"]


def kinetic_energy(plant: StewartPlatform, pose: ArrayLike, phidot: ArrayLike) -> float:
    """1/2 phidot^T M phidot in J."""
    rates = real_array("phidot", phidot, 1, plant.name)
    return float(0.5 * rates @ mass_matrix(plant, pose) @ rates)


def potential_energy(plant: StewartPlatform, pose: ArrayLike) -> float:
    """Sum of m g times height over all bodies in J; zero where every centre of gravity is as high as the origin."""
    g, p, array = plant.geometry, plant.values, real_array_of_one(pose, plant.name)
    top = array[:3] + g.platform @ rotation(array).T
    w = top - g.base
    y = w - np.sum(w * g.axis, axis=1)[:, None] * g.axis
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    joint = g.base + g.c * y
    k = (top - joint) / np.linalg.norm(top - joint, axis=1, keepdims=True)
    z = np.cross(g.axis, y)
    i = g.mount[:, :1] * z + g.mount[:, 1:] * np.cross(z, k)
    middle = array[:3] + rotation(array) @ [p[f"platform_c{a}"] for a in "xyz"]
    height = p["platform_mass"] * float(middle @ up(p)) + sum(
        p[f"{body}_mass"] * float(np.sum(points @ up(p)))
        for body, points in {
            "link": joint + p["link_cg"] * k,
            "nut": joint + (p["nut_at"] + p["nut_cg"]) * k,
            "screw": top - p["screw_cg"] * k,
            "motor": joint + (p["motor_at"] + p["motor_cg"]) * k + p["motor_x"] * i,
        }.items()
    )
    return float(p["gravity"] * height)


def _equations(plant: StewartPlatform, pose: Array, twist: Array) -> tuple[Array, Array, Array, Array]:
    """Mass matrix, forces, nut Jacobian and bias in the platform's twist."""
    mass, jacobian = np.empty((6, 6)), np.empty((6, 6))
    force, bias = np.empty(6), np.empty(6)
    kernels().equations(
        np.array(pose),
        np.array(twist),
        plant.geometry.legs,
        np.array(plant.constants),
        mass,
        force,
        jacobian,
        bias,
        np.empty(6),
    )
    return mass, force, jacobian, bias
