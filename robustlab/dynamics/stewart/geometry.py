"""Parameters of the Stewart platform, points and axes of the legs, constants of the equations of motion."""
# Březina 2010, eqs 6.1, 6.2, App. A and B (with the misprints of b6, m2 and m3 corrected).

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.display import Displayable
from robustlab.dynamics.parameters import Parameter, published
from robustlab.errors import InputError, did_you_mean

PRESETS = ("thesis", "physical")

_SHEET = "Březina 2010, App. A and section 7.2 (Maxon RE 35, order number 273754)"


def machine_parameters(preset: str, motors: bool) -> tuple[Parameter, ...]:
    """Return the published parameters; preset ``physical`` adds the rotor inertia omitted by the thesis."""
    if preset not in PRESETS:
        hint = did_you_mean(str(preset), PRESETS)
        raise InputError("stewart-platform: preset", f"{preset!r}", " or ".join(map(repr, PRESETS)), hint)
    if not isinstance(motors, bool):
        raise InputError("stewart-platform: motors", f"{motors!r}", "True or False")
    known = published(Path(__file__).with_name("parameters.toml"))
    parameters = (*known["machine"], *(known["motors"] if motors else ()))
    if preset == "thesis":
        return parameters
    rotor = {"value": 7.2e-6, "source": _SHEET}
    return tuple(replace(p, **rotor) if p.name == "rotor_J" else p for p in parameters)


_PAIR = np.repeat([0.0, 1.0, 2.0], 2) * (2 * np.pi / 3)
_SIDE = np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0])  # of a leg, in its pair of platform points

# Order of the kernels' constants; see `constants`.
CONSTANTS = (
    "turns", "c", "gravity", "ratio", "platform_mass", "platform_x", "platform_y", "platform_z",
    "m0", "m1", "m2", "x1", "x2", "xz", "screw_mass", "screw_cg",
    "leg_I", "leg_J", "leg_K", "nut_I", "nut_J", "nut_K", "rotor", "R", "L", "Km", "Kb", "Kf",
    "platform_cx", "platform_cy", "platform_cz", "up_x", "up_y", "up_z",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Geometry(Displayable):
    """Points and axes, in m; arrays are read-only."""

    # points b and m in the base frame, shape (6, 3)
    base: Array
    bearing: Array
    platform: Array  # points p in the platform frame, shape (6, 3)
    axis: Array  # unit vectors x* of the first joint axes, shape (6, 3)
    # components of the bodies' axis I along the second joint axis z* and along N = z* x K, shape (6, 2)
    mount: Array
    c: float  # distance between the joint's two axes
    home: Array  # home pose (tx, ty, tz, ax, ay, az), shape (6,)
    home_lengths: Array  # actuator lengths at zero nut angles: those at home except for the offsets, shape (6,)
    limits: tuple[float, float]  # shortest and longest actuator
    turns: float  # nut angle per extension, 2 pi / lead in rad/m

    @property
    def radius(self) -> float:
        """Radius of the platform points, which converts angles to lengths."""
        return math.hypot(self.platform[0, 0], self.platform[0, 1])

    @cached_property
    def legs(self) -> Array:
        """Rows for the kernels: b, x*, p, length at home, mount; shape (6, 12)."""
        return np.column_stack([self.base, self.axis, self.platform, self.home_lengths, self.mount])


def geometry(p: Mapping[str, float]) -> Geometry:
    """Compute points and axes from the parameters."""
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
    turns = 2 * np.pi / p["lead"]
    lengths = lengths - np.array([p[f"offset_{i}"] for i in range(1, 7)]) / turns
    limits = p["L_min"], p["L_max"]
    made = Geometry(base, bearing, platform, axis, mount, p["c"], home, lengths, limits, turns)
    for array in (made.base, made.bearing, made.platform, made.axis, made.mount, made.home, made.home_lengths):
        array.setflags(write=False)
    return made


def _assembly(base: Array, axis: Array, top: Array, c: float) -> tuple[Array, Array]:
    """Return lengths at home and mount: the legs are assembled with I = (-1)^i K x e_z / |K x e_z| (eq. 7.2)."""
    w = top - base
    y = w - np.sum(w * axis, axis=1)[:, None] * axis
    reach = np.linalg.norm(y, axis=1, keepdims=True)
    if (reach <= c).any():
        expected = f"less than {reach.min():.6g} m, the joint's distance at home"
        raise InputError("stewart-platform: c", f"{c:g} m", expected)
    y = y / reach
    k = w - c * y
    lengths = np.linalg.norm(k, axis=1)
    k = k / lengths[:, None]
    z = np.cross(axis, y)
    i = _SIDE[:, None] * np.cross(k, [0.0, 0.0, 1.0])
    i = i / np.linalg.norm(i, axis=1, keepdims=True)
    return lengths, np.column_stack([np.sum(i * z, axis=1), np.sum(i * np.cross(z, k), axis=1)])


def constants(p: Mapping[str, Any]) -> Array:
    """Return the constants of the equations of motion besides the legs' geometry, in the order of `CONSTANTS`."""
    link, nut, motor = p["link_mass"], p["nut_mass"], p["motor_mass"]
    at_link, at_nut, at_motor = p["link_cg"], p["nut_at"] + p["nut_cg"], p["motor_at"] + p["motor_cg"]
    turns, x = 2 * np.pi / p["lead"], p["motor_x"]
    about_x, about_y = p["tilt_x"], p["tilt_y"]
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
        "up_x": -np.sin(about_y),
        "up_y": np.sin(about_x) * np.cos(about_y),
        "up_z": np.cos(about_x) * np.cos(about_y),
    }
    columns = [made[name] if name in made else p.get(name, 0.0) for name in CONSTANTS]
    return np.stack(np.broadcast_arrays(*columns), axis=-1).astype(np.float64)


def check_bodies(p: Mapping[str, float]) -> None:
    """Reject inertias of no rigid body: each principal one is at most the sum of the others."""
    for body, axes in {"platform": "xyz", **dict.fromkeys(("link", "nut", "screw", "motor"), "IJK")}.items():
        inertia = np.array([p[f"{body}_{a}"] for a in axes])
        if 2 * inertia.max() > inertia.sum() * (1 + 1e-12):
            found = f"principal inertias {', '.join(f'{value:g}' for value in inertia)} kg m2"
            hint = f"override {', '.join(f'{body}_{a}' for a in axes)} together"
            expected = "no one larger than the sum of the other two (triangle inequality)"
            raise InputError(f"stewart-platform: {body}", found, expected, hint)


def _circle(radius: float, angle: Array, z: float) -> Array:
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(6, z)])
