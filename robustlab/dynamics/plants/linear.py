"""Linear plants: masses with springs, dampers and drives, electric motors, a linear actuator."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from robustlab.dynamics.linear_plant import Descriptor, LinearPlant
from robustlab.dynamics.parameters import overridden, published
from robustlab.errors import InputError, unknown_name
from robustlab.statespace import MAX_STATES, Signal

_PUBLISHED = published(Path(__file__).with_name("parameters.toml"))


def _made(
    name: str, given: Any, driving: Signal, outputs: tuple[Signal, ...], states: tuple[Signal, ...], equations: Any,
    exact: tuple[str, ...] = (),
) -> LinearPlant:  # fmt: skip
    """Return the plant with one input, its published parameters overridden by the given ones."""
    return LinearPlant(name, overridden(_PUBLISHED[name], given, name), (driving,), outputs, states, equations, exact)


def servo_axis(**given: Any) -> LinearPlant:
    """Return a linear servo axis: a driven carriage with viscous friction."""
    # Janot, Gautier, Brunot, "Data set and reference models of EMPS", Workshop on Nonlinear System Identification
    # Benchmarks (2019).
    states = (Signal("q", "m"), Signal("v", "m/s"))
    return _made("servo-axis", given, Signal("u", "V"), states, states, _servo_axis)


def _servo_axis(p: Any) -> Descriptor:
    return Descriptor(E=[[1, 0], [0, p["M"]]], F=[[0, 1], [0, -p["Fv"]]], G=[[0], [p["gain"]]], C=[[1, 0], [0, 1]])


def two_mass(**given: Any) -> LinearPlant:
    """Return two inertias coupled by a spring and a damper; the torque acts on the first."""
    angles = (Signal("phi1", "rad"), Signal("phi2", "rad"))
    states = (*angles, Signal("omega1", "rad/s"), Signal("omega2", "rad/s"))
    return _made("two-mass", given, Signal("torque", "N m"), angles, states, _two_mass)


def _two_mass(p: Any) -> Descriptor:
    c, k = p["c"], p["k"]
    return Descriptor(
        E=[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, p["J1"], 0], [0, 0, 0, p["J2"]]],
        F=[[0, 0, 1, 0], [0, 0, 0, 1], [-k, k, -c, c], [k, -k, c, -c]],
        G=[[0], [0], [1], [0]],
        C=[[1, 0, 0, 0], [0, 1, 0, 0]],
    )


def mass_spring_damper(**given: Any) -> LinearPlant:
    """Return a chain of masses, springs and dampers; mass 1 is connected to a wall."""
    names = tuple(p.name for p in _PUBLISHED["mass-spring-damper"])
    for name in given:
        if name not in names:
            raise unknown_name(f"mass-spring-damper: {name!r}", "no such parameter", name, names)
    lists = {name: list(value) for name, value in given.items() if isinstance(value, (list, np.ndarray))}
    lengths = {len(value) for value in lists.values()} or {1}
    if len(lengths) > 1 or 0 in lengths:
        found = ", ".join(f"{len(value)} values of {name}" for name, value in lists.items())
        raise InputError("mass-spring-damper", found, "equally many of each, at least one")
    n = lengths.pop()
    if 2 * n > MAX_STATES:
        raise InputError("mass-spring-damper", f"{n} masses", f"at most {MAX_STATES // 2}")
    defaults, values = [], {}
    for p in _PUBLISHED["mass-spring-damper"]:
        for j, name in enumerate(_numbered(p.name, n)):
            meaning = p.meaning if n == 1 else f"{p.meaning} {j + 1}"
            defaults.append(replace(p, name=name, meaning=meaning))
            if p.name in given:
                values[name] = lists[p.name][j] if p.name in lists else given[p.name]
    q = [Signal(name, "m") for name in _numbered("q", n)]
    v = [Signal(name, "m/s") for name in _numbered("v", n)]
    return LinearPlant(
        "mass-spring-damper",
        overridden(defaults, values, "mass-spring-damper"),
        tuple(Signal(name, "N") for name in _numbered("f", n)),
        (*q, *v),
        (*q, *v),
        equations=partial(_mass_spring_damper, n=n),
    )


def _numbered(name: str, n: int) -> Sequence[str]:
    return [name] if n == 1 else [f"{name}{j + 1}" for j in range(n)]


def _mass_spring_damper(p: Any, n: int) -> Descriptor:
    m, c, k = ([p[name] for name in _numbered(letter, n)] for letter in "mck")
    # Elongation j is q_j - q_(j-1); the transposed matrix maps the springs' forces to the masses.
    elongation = np.eye(n) - np.eye(n, k=-1)
    stiffness, damping = (elongation.T @ np.diag(value) @ elongation for value in (k, c))
    eye, zero = np.eye(n), np.zeros((n, n))
    return Descriptor(
        E=np.block([[eye, zero], [zero, np.diag(m)]]),
        F=np.block([[zero, eye], [-stiffness, -damping]]),
        G=np.vstack([zero, eye]),
        C=np.eye(2 * n),
    )


STATES = (Signal("phi", "rad"), Signal("omega", "rad/s"), Signal("i", "A"))


def dc_motor(**given: Any) -> LinearPlant:
    """Return a permanent-magnet DC motor; defaults: the thesis' Maxon RE 35."""
    # Březina 2010, eqs 7.3-7.5 (states omega and i; the angle is added here).
    return _made("dc-motor", given, Signal("u", "V"), STATES, STATES, _dc_motor)


def _dc_motor(p: Any) -> Descriptor:
    return motor_equations(p, p["J"])


def motor_equations(p: Any, inertia: float) -> Descriptor:
    """Return the motor's equations with an inertia on its shaft (eqs 7.3-7.5)."""
    return Descriptor(
        E=[[1, 0, 0], [0, inertia, 0], [0, 0, p["L"]]],
        F=[[0, 1, 0], [0, -p["Kf"], p["Km"]], [0, -p["Kb"], -p["R"]]],
        G=[[0], [0], [1]],
        C=[[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    )


def brushless_motor(**given: Any) -> LinearPlant:
    """Return a brushless motor under current control; input: the q current."""
    # Gerry Chen, measurements of cogging and friction of a brushless motor, github.com/gchenfc.
    states = (Signal("phi", "rad"), Signal("omega", "rad/s"))
    return _made("brushless-motor", given, Signal("i", "A"), states, states, _brushless_motor)


def _brushless_motor(p: Any) -> Descriptor:
    return Descriptor(E=[[1, 0], [0, p["J"]]], F=[[0, 1], [0, -p["Kf"]]], G=[[0], [p["Kt"]]], C=[[1, 0], [0, 1]])


def linear_actuator(**given: Any) -> LinearPlant:
    """Return a linear actuator on its test jig: DC motor, gears, ball screw, cart; defaults: the thesis' leg."""
    # Březina 2010, section 7.2 (gears, motor) and chapter 11 (jig).
    return _made("linear-actuator", given, Signal("u", "V"), STATES, STATES, _linear_actuator, ("ratio", "lead"))


def _linear_actuator(p: Any) -> Descriptor:
    h = p["lead"] / (2 * math.pi * p["ratio"])  # travel of the cart per angle of the motor (eq. 11.1)
    inertia = p["J"] + p["J_nut"] / p["ratio"] ** 2 + (p["m_screw"] + p["m_cart"]) * h**2
    return motor_equations(p, inertia)
