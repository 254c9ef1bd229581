"""Which effects are asked for on which machine, and which records cannot tell them apart."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from .effects import EFFECTS, MOTOR_ONLY, OUTSIDE_EFFECTS

# A constant offset of the angle is no more than another zero on a plant that integrates; a current shows it.
CURRENT_ONLY = ("sensor-bias",)

# With a spring and a stroke of its own: no gear, no shaft, nothing that repeats over the position.
OSCILLATOR = (
    "inertia", "viscous-friction", "stiffness", "coulomb-friction", "asymmetric-viscous-friction", "constant-load",
    "quadratic-drag", "input-delay", "input-dead-zone", "input-saturation", "input-gain", "sensor-gain", "sensor-bias",
    "sensor-delay", "cubic-stiffness", "end-stop", "actuator-lag", "asymmetric-coulomb-friction", "bouc-wen",
    "torque-ripple", "one-sided-spring", "magnitude-sensor",
)  # fmt: skip
# It has its shaft already, and no friction of its own to be uneven; springs to ground are no part of such a drive, but
# stops and a pendulum on it are.
TWO_MASS = (
    "inertia", "viscous-friction", "stiffness", "coulomb-friction", "stribeck-friction", "presliding",
    "constant-load", "quadratic-drag", "position-dependent-friction", "cogging",
    "input-delay", "input-dead-zone", "input-saturation", "input-gain", "sensor-gain", "sensor-eccentricity",
    "sensor-delay", "end-stop", "pendulum-gravity", "actuator-lag", "asymmetric-coulomb-friction",
    "torque-ripple", "one-sided-spring",
)  # fmt: skip
NO_AXIS = (*MOTOR_ONLY, "pendulum-gravity", "magnitude-sensor")
NO_ENCODER = (*CURRENT_ONLY, "magnitude-sensor")  # an encoder that counts knows its sign

MOTOR = tuple(name for name in EFFECTS if name not in NO_ENCODER)
ACTUATOR = tuple(name for name in MOTOR if name != "pendulum-gravity")
AXIS = tuple(name for name in EFFECTS if name not in (*CURRENT_ONLY, *NO_AXIS))
OUTSIDE = tuple(OUTSIDE_EFFECTS)
WITHOUT_MOTOR = tuple(name for name in OUTSIDE if name != "field-weakening")
WITHOUT_SHAFT = tuple(name for name in WITHOUT_MOTOR if name != "nonlinear-resonance")

MOTOR_PAIRS = (
    *(("coulomb-friction", other) for other in (
        "input-dead-zone", "constant-load", "cogging", "inertia", "quadratic-drag", "input-delay",
        "asymmetric-viscous-friction", "flexible-coupling", "resistance-heating", "stiffness",
    )),
    ("constant-load", "quadratic-drag"), ("input-delay", "input-dead-zone"), ("backlash", "constant-load"),
    ("input-saturation", "cogging"), ("brush-drop", "input-delay"), ("coulomb-friction", "pendulum-gravity"),
)  # fmt: skip
ACTUATOR_PAIRS = tuple(p for p in MOTOR_PAIRS if set(p) <= set(ACTUATOR))
AXIS_PAIRS = tuple(p for p in MOTOR_PAIRS if set(p) <= set(AXIS))
OSCILLATOR_PAIRS = (
    ("cubic-stiffness", "constant-load"), ("cubic-stiffness", "coulomb-friction"), ("cubic-stiffness", "input-delay"),
    ("coulomb-friction", "stiffness"), ("quadratic-drag", "stiffness"), ("end-stop", "coulomb-friction"),
    ("viscous-friction", "input-dead-zone"), ("one-sided-spring", "inertia"),
)  # fmt: skip
TWO_MASS_PAIRS = (
    ("coulomb-friction", "constant-load"), ("coulomb-friction", "stiffness"), ("coulomb-friction", "input-delay"),
    ("coulomb-friction", "cogging"), ("coulomb-friction", "pendulum-gravity"), ("cogging", "input-saturation"),
    ("inertia", "quadratic-drag"), ("end-stop", "coulomb-friction"),
)  # fmt: skip

# Exact twins, which no record of the family tells apart, told in one way of saying it: one output of a linear plant
# shows a gain, or a delay, at its input as it does at its sensor; on a spring a constant load moves the rest position
# as a bias does; and a friction level that depends on the direction is an even one and a constant load.
ANYWHERE = {"asymmetric-coulomb-friction": ("coulomb-friction", "constant-load")}
ONE_OUTPUT = {**ANYWHERE, "sensor-gain": ("input-gain",), "sensor-delay": ("input-delay",)}
ON_A_SPRING = {**ONE_OUTPUT, "sensor-bias": ("constant-load",)}


@dataclass(frozen=True)
class Family:
    """A kind of machine with its sensors: the classes that are judged on it, and what is an exact twin of what."""

    plant: str
    current: bool
    classes: tuple[str, ...]
    outside: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    twins: Mapping[str, tuple[str, ...]]


def told(twins: Mapping[str, tuple[str, ...]], effects: Iterable[str]) -> frozenset[str]:
    """A set of effects as it is told where exact twins are one."""
    return frozenset(name for effect in effects for name in twins.get(effect, (effect,)))


FAMILIES: Mapping[str, Family] = {
    "motor": Family("dc-motor", False, MOTOR, OUTSIDE, MOTOR_PAIRS, ONE_OUTPUT),
    "motor-current": Family("dc-motor", True, (*MOTOR, *CURRENT_ONLY), OUTSIDE, MOTOR_PAIRS, ANYWHERE),
    "axis": Family("servo-axis", False, AXIS, WITHOUT_MOTOR, AXIS_PAIRS, ONE_OUTPUT),
    "actuator": Family("linear-actuator", False, ACTUATOR, OUTSIDE, ACTUATOR_PAIRS, ONE_OUTPUT),
    "oscillator": Family("mass-spring-damper", False, OSCILLATOR, WITHOUT_SHAFT, OSCILLATOR_PAIRS, ON_A_SPRING),
    "two-mass": Family("two-mass", False, TWO_MASS, WITHOUT_SHAFT, TWO_MASS_PAIRS, ANYWHERE),
}


def possible(plant: str, effect: str) -> bool:
    """Whether the plant can have the effect; an axis or motor may have those of every class that needs no more."""
    known = {e for f in FAMILIES.values() if f.plant == plant for e in (*f.classes, *f.outside)}
    more = set(CURRENT_ONLY) if plant in ("dc-motor", "linear-actuator", "servo-axis") else set()
    return effect in known | more
