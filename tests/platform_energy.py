"""Energies of the Stewart platform, summed over its bodies apart from its equations of motion."""

import numpy as np
from scipy.spatial.transform import Rotation

from robustlab.dynamics import stewart


def up(p):
    """Against gravity in the frame of the base."""
    tilt = Rotation.from_euler("y", p["tilt_y"]) * Rotation.from_euler("x", p["tilt_x"])
    return tilt.inv().apply([0.0, 0.0, 1.0])


def potential_energy(plant, pose):
    """Sum of m g times height over all bodies in J."""
    g, p, turn = plant.geometry, plant.values, Rotation.from_euler("xyz", pose[3:])
    top = pose[:3] + g.platform @ turn.as_matrix().T
    w = top - g.base
    y = w - np.sum(w * g.axis, axis=1)[:, None] * g.axis
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    joint = g.base + g.c * y
    k = (top - joint) / np.linalg.norm(top - joint, axis=1, keepdims=True)
    z = np.cross(g.axis, y)
    i = g.mount[:, :1] * z + g.mount[:, 1:] * np.cross(z, k)
    middle = pose[:3] + turn.apply([p[f"platform_c{a}"] for a in "xyz"])
    points = {
        "link": joint + p["link_cg"] * k,
        "nut": joint + (p["nut_at"] + p["nut_cg"]) * k,
        "screw": top - p["screw_cg"] * k,
        "motor": joint + (p["motor_at"] + p["motor_cg"]) * k + p["motor_x"] * i,
    }
    moment = p["platform_mass"] * middle + sum(p[f"{body}_mass"] * at.sum(axis=0) for body, at in points.items())
    return float(p["gravity"] * moment @ up(p))


def kinetic_energy(plant, pose, phidot):
    """1/2 phidot^T M phidot in J."""
    return float(0.5 * phidot @ stewart.mass_matrix(plant, pose) @ phidot)
