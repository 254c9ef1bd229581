r"""Geometry of the Stewart platform, and the numbers that its equations of motion need.

Legs 1..6 go round counter-clockwise. The base points stand in pairs at -30, 90, 210 degrees, the platform points
in pairs at 30, 150, 270 degrees, so that each leg leans from one pair to the next:

.. math::
    b_i = r_b (\cos, \sin)(\beta_i), \quad \beta = \{-30 + \alpha_b,\; 90 - \alpha_b,\; 90 + \alpha_b, \dots\}, \qquad
    p_i = r_p (\cos, \sin)(\pi_i), \quad \pi = \{30 - \alpha_p,\; 30 + \alpha_p,\; \dots\}

The universal joint of leg i turns first about the axis :math:`x^*_i = (m_i - b_i)/|m_i - b_i|` through the bearing
point :math:`m_i = r_m (\cos, \sin)(\beta_i \mp \alpha_m)`, :math:`z = z_m`.

References
----------
Březina 2010, eqs 6.1, 6.2, App. A and B (with the misprints of b6, m2 and m3 corrected).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.errors import InputError

__all__ = ["CONSTANTS", "Geometry", "check_bodies", "constants", "geometry"]

Array = NDArray[np.float64]

_PAIR = np.repeat([0.0, 1.0, 2.0], 2) * (2 * np.pi / 3)
_SIDE = np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0])  # of a leg, in its pair of platform points

# Order of the numbers that the kernels take; see `constants`.
CONSTANTS = (
    "turns", "c", "gravity", "ratio", "platform_mass", "platform_x", "platform_y", "platform_z",
    "m0", "m1", "m2", "x1", "x2", "xz", "screw_mass", "screw_cg",
    "leg_I", "leg_J", "leg_K", "nut_I", "nut_J", "nut_K", "rotor", "R", "L", "Km", "Kb", "Kf",
)  # fmt: skip


@dataclass(frozen=True)
class Geometry:
    """Points and axes, in m; arrays are read-only.

    Attributes
    ----------
    base, bearing
        Points b and m in the base frame, shape (6, 3).
    platform
        Points p in the platform frame, shape (6, 3).
    axis
        Unit vectors x* of the first joint axes, shape (6, 3).
    mount
        Where the bodies' axis I points to in the leg: its components along the second joint axis z* and along
        N = z* x K, shape (6, 2).
    c
        Distance of the joint's two axes.
    home
        Home pose (tx, ty, tz, ax, ay, az), shape (6,).
    home_lengths
        Actuator lengths at home, shape (6,).
    limits
        Shortest and longest actuator.
    turns
        Nut angle per extension, 2 pi / lead in rad/m.
    """

    base: Array
    bearing: Array
    platform: Array
    axis: Array
    mount: Array
    c: float
    home: Array
    home_lengths: Array
    limits: tuple[float, float]
    turns: float

    @property
    def radius(self) -> float:
        """Radius of the platform points, by which angles are made lengths."""
        return math.hypot(self.platform[0, 0], self.platform[0, 1])

    @cached_property
    def legs(self) -> Array:
        """The rows that the kernels take: b, x*, p, length at home, mount; shape (6, 12)."""
        return np.column_stack([self.base, self.axis, self.platform, self.home_lengths, self.mount])


def geometry(p: Mapping[str, float]) -> Geometry:
    """Points and axes from the parameters.

    Raises
    ------
    InputError
        A bearing point that falls on its base point, a lower limit above the upper one.
    """
    if p["L_min"] >= p["L_max"]:
        raise InputError("stewart-platform: L_min", f"{p['L_min']:g} m", f"less than L_max = {p['L_max']:g} m")
    angle_p = np.pi / 6 + _PAIR + _SIDE * p["alpha_p"]
    angle_b = np.pi / 2 + _PAIR[[5, 0, 1, 2, 3, 4]] - _SIDE * p["alpha_b"]
    base = _circle(p["r_b"], angle_b, 0.0)
    bearing = _circle(p["r_m"], angle_b + _SIDE * p["alpha_m"], p["z_m"])
    axis = bearing - base
    length = np.linalg.norm(axis, axis=1, keepdims=True)
    if (length < 1e-9).any():
        raise InputError("stewart-platform", "bearing points fall on the base points", "another r_m, alpha_m or z_m")
    axis = axis / length
    platform = _circle(p["r_p"], angle_p, 0.0)
    home = np.array([0.0, 0.0, p["z_home"], 0.0, 0.0, 0.0])
    lengths, mount = _assembly(base, axis, platform + home[:3], p["c"])
    made = Geometry(
        base, bearing, platform, axis, mount, p["c"], home, lengths, (p["L_min"], p["L_max"]), 2 * np.pi / p["lead"]
    )
    for array in (made.base, made.bearing, made.platform, made.axis, made.mount, made.home, made.home_lengths):
        array.setflags(write=False)
    return made


def _assembly(base: Array, axis: Array, top: Array, c: float) -> tuple[Array, Array]:
    """Lengths at home, and the mount: the legs are put together there with I = (-1)^i K x e_z / |K x e_z| (eq. 7.2)."""
    w = top - base
    y = w - np.sum(w * axis, axis=1)[:, None] * axis
    reach = np.linalg.norm(y, axis=1, keepdims=True)
    if (reach <= c).any():
        raise InputError(
            "stewart-platform: c", f"{c:g} m", f"less than {reach.min():.6g} m, the joint's distance at home"
        )
    y = y / reach
    k = w - c * y
    lengths = np.linalg.norm(k, axis=1)
    k = k / lengths[:, None]
    z = np.cross(axis, y)
    i = _SIDE[:, None] * np.cross(k, [0.0, 0.0, 1.0])
    i = i / np.linalg.norm(i, axis=1, keepdims=True)
    return lengths, np.column_stack([np.sum(i * z, axis=1), np.sum(i * np.cross(z, k), axis=1)])


def constants(p: Mapping[str, Any]) -> Array:
    """What the equations of motion need besides the legs' geometry, in the order of `CONSTANTS`.

    The parameters may be arrays of one shape (n,), for n machines at once; then the result is (n, 28), else (28,).
    ``m0 m1 m2`` are the sums of m, m zeta, m zeta^2 over link, nut and motor body, zeta their height along the leg;
    ``x1 x2 xz`` the motor body's m eta, m eta^2, m zeta eta, eta its offset along I. ``leg_I leg_J leg_K`` are the
    inertias of link, screw and motor body, ``rotor`` is the rotor's, felt as a mass at the screw.
    """
    link, nut, motor = p["link_mass"], p["nut_mass"], p["motor_mass"]
    at_link, at_nut, at_motor = p["link_cg"], p["nut_at"] + p["nut_cg"], p["motor_at"] + p["motor_cg"]
    turns, x = 2 * np.pi / p["lead"], p["motor_x"]
    made = {
        "turns": turns,
        "m0": link + nut + motor,
        "m1": link * at_link + nut * at_nut + motor * at_motor,
        "m2": link * at_link**2 + nut * at_nut**2 + motor * at_motor**2,
        "x1": motor * x,
        "x2": motor * x**2,
        "xz": motor * x * at_motor,
        **{f"leg_{a}": p[f"link_{a}"] + p[f"screw_{a}"] + p[f"motor_{a}"] for a in "IJK"},
        "rotor": p["rotor_J"] * (p["ratio"] * turns) ** 2,
    }
    columns = [made[name] if name in made else p.get(name, 0.0) for name in CONSTANTS]
    return np.stack(np.broadcast_arrays(*columns), axis=-1).astype(np.float64)


def check_bodies(p: Mapping[str, float]) -> None:
    """Refuse inertias that no rigid body has: of the three principal ones none exceeds the sum of the others.

    Raises
    ------
    InputError
        A body that breaks the triangle inequality, with its three numbers.
    """
    for body, axes in {"platform": "xyz", **dict.fromkeys(("link", "nut", "screw", "motor"), "IJK")}.items():
        inertia = np.array([p[f"{body}_{a}"] for a in axes])
        if 2 * inertia.max() > inertia.sum() * (1 + 1e-12):
            found = ", ".join(f"{value:g}" for value in inertia)
            raise InputError(
                f"stewart-platform: {body}",
                f"principal inertias {found} kg m2",
                "no one larger than the sum of the other two (triangle inequality)",
                f"override {', '.join(f'{body}_{a}' for a in axes)} together",
            )


def _circle(radius: float, angle: Array, z: float) -> Array:
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(6, z)])
