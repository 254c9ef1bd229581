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
    name: str, driving: Signal, outputs: tuple[Signal, ...], states: tuple[Signal, ...], equations: Any,
    exact: tuple[str, ...] = (), /, **given: Any,
) -> LinearPlant:  # fmt: skip
    """Return the plant with one input, its published parameters overridden by the given ones."""
    return LinearPlant(name, overridden(_PUBLISHED[name], given, name), (driving,), outputs, states, equations, exact)


def _servo_axis(p: Any) -> Descriptor:
    return Descriptor(E=[[1, 0], [0, p["M"]]], F=[[0, 1], [0, -p["Fv"]]], G=[[0], [p["gain"]]], C=[[1, 0], [0, 1]])


def _two_mass(p: Any) -> Descriptor:
    c, k = p["c"], p["k"]
    return Descriptor(
        E=[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, p["J1"], 0], [0, 0, 0, p["J2"]]],
        F=[[0, 0, 1, 0], [0, 0, 0, 1], [-k, k, -c, c], [k, -k, c, -c]],
        G=[[0], [0], [1], [0]],
        C=[[1, 0, 0, 0], [0, 1, 0, 0]],
    )


def _dc_motor(p: Any, inertia: float | None = None) -> Descriptor:
    """Return the motor's equations with an inertia on its shaft, its own where left out (eqs 7.3-7.5)."""
    return Descriptor(
        E=[[1, 0, 0], [0, p["J"] if inertia is None else inertia, 0], [0, 0, p["L"]]],
        F=[[0, 1, 0], [0, -p["Kf"], p["Km"]], [0, -p["Kb"], -p["R"]]],
        G=[[0], [0], [1]],
        C=[[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    )


def _brushless_motor(p: Any) -> Descriptor:
    return Descriptor(E=[[1, 0], [0, p["J"]]], F=[[0, 1], [0, -p["Kf"]]], G=[[0], [p["Kt"]]], C=[[1, 0], [0, 1]])


def _linear_actuator(p: Any) -> Descriptor:
    h = p["lead"] / (2 * math.pi * p["ratio"])  # travel of the cart per angle of the motor (eq. 11.1)
    return _dc_motor(p, p["J"] + p["J_nut"] / p["ratio"] ** 2 + (p["m_screw"] + p["m_cart"]) * h**2)


VOLTAGE, AXIS = Signal("u", "V"), (Signal("q", "m"), Signal("v", "m/s"))
ROTOR = (Signal("phi", "rad"), Signal("omega", "rad/s"))
MOTOR = (*ROTOR, Signal("i", "A"))
ANGLES = (Signal("phi1", "rad"), Signal("phi2", "rad"))
ROTORS = (*ANGLES, Signal("omega1", "rad/s"), Signal("omega2", "rad/s"))

# A driven carriage with viscous friction. Janot, Gautier, Brunot, "Data set and reference models of EMPS", Workshop on
# Nonlinear System Identification Benchmarks (2019).
servo_axis = partial(_made, "servo-axis", VOLTAGE, AXIS, AXIS, _servo_axis)
# Two inertias coupled by a spring and a damper; the torque acts on the first.
two_mass = partial(_made, "two-mass", Signal("torque", "N m"), ANGLES, ROTORS, _two_mass)
# The thesis' Maxon RE 35, Březina 2010, eqs 7.3-7.5 (states omega and i; the angle is added here).
dc_motor = partial(_made, "dc-motor", VOLTAGE, MOTOR, MOTOR, _dc_motor)
# Under current control: the q current is the input. Gerry Chen, measurements of cogging and friction of a brushless
# motor, github.com/gchenfc.
brushless_motor = partial(_made, "brushless-motor", Signal("i", "A"), ROTOR, ROTOR, _brushless_motor)
# The thesis' leg on its test jig: DC motor, gears, ball screw, cart; Březina 2010, section 7.2 and chapter 11.
linear_actuator = partial(_made, "linear-actuator", VOLTAGE, MOTOR, MOTOR, _linear_actuator, ("ratio", "lead"))


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
