"""Effects of each machine family, and the effects that its records cannot distinguish."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from .effects import EFFECTS, MOTOR_ONLY, OUTSIDE_EFFECTS

# On an integrating plant a constant offset of the angle only shifts the origin; a measured current shows it.
CURRENT_ONLY = ("sensor-bias",)

# With its own spring and stroke: no gear, no shaft, no effect periodic in the position.
OSCILLATOR = (
    "inertia", "viscous-friction", "stiffness", "coulomb-friction", "asymmetric-viscous-friction", "constant-load",
    "quadratic-drag", "input-delay", "input-dead-zone", "input-saturation", "input-gain", "sensor-gain", "sensor-bias",
    "sensor-delay", "cubic-stiffness", "end-stop", "actuator-lag", "asymmetric-coulomb-friction", "bouc-wen",
    "torque-ripple", "one-sided-spring", "magnitude-sensor",
)  # fmt: skip
# The model has a shaft and no friction of its own. Springs to ground do not occur in such a drive; stops and a pendulum
# do.
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

# Equivalent effects, which no record of the family distinguishes, and the name used for them. One output of a linear
# plant shows a gain or a delay at its input and at its sensor alike. On a spring a constant load shifts the equilibrium
# as a bias does. A friction level that depends on the direction equals a symmetric one and a constant load.
ANYWHERE = {"asymmetric-coulomb-friction": ("coulomb-friction", "constant-load")}
ONE_OUTPUT = {**ANYWHERE, "sensor-gain": ("input-gain",), "sensor-delay": ("input-delay",)}
ON_A_SPRING = {**ONE_OUTPUT, "sensor-bias": ("constant-load",)}


@dataclass(frozen=True)
class Family:
    """A machine with its sensors, the effects tested on it, and the equivalent effects."""

    plant: str
    current: bool
    classes: tuple[str, ...]
    outside: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    twins: Mapping[str, tuple[str, ...]]


def merged(twins: Mapping[str, tuple[str, ...]], effects: Iterable[str]) -> frozenset[str]:
    """Return the effects with equivalent ones merged."""
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
