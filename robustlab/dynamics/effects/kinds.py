"""The tree of kinds: what a person would call an effect where its form is not settled."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

Where = Literal["joint", "path", "sensor"]
Quantity = Literal["level", "viscous", "stiffness", "force", "amplitude", "period", "delay", "factor"]

MEANINGS: Mapping[Quantity, str] = {
    "level": "work against the motion over the way, the level of a dry friction",
    "viscous": "work against the motion over the squared speed, the equivalent viscous coefficient",
    "stiffness": "slope of the force over the stroke",
    "force": "mean force against the positive direction, as of a load",
    "amplitude": "amplitude",
    "period": "period",
    "delay": "total lateness at low frequency",
    "factor": "factor of the path from input to sensor",
}


@dataclass(frozen=True)
class Kind:
    """A kind of effects."""

    id: str
    title: str
    wider: str | None
    where: Where
    quantities: tuple[Quantity, ...] = ()
    form: str = ""


KINDS: Mapping[str, Kind] = {
    kind.id: kind
    for kind in (
        Kind("force", "a force at the joint", None, "joint"),
        Kind(
            "resisting-force", "a force against the motion", "force", "joint", ("viscous",),
            "constant speeds, slow and fast, in both directions",
        ),
        Kind(
            "dry-friction", "dry friction", "resisting-force", "joint", ("level",),
            "slow reversals, some of them shorter than what the contact gives way by",
        ),
        Kind(
            "speed-friction", "friction that grows with the speed", "resisting-force", "joint", ("viscous",),
            "constant speeds up to the largest, in both directions",
        ),
        Kind(
            "force-of-position", "a force of the position", "force", "joint", (),
            "slow motion over the whole stroke and beyond",
        ),
        Kind(
            "spring", "a spring", "force-of-position", "joint", ("stiffness",),
            "slow motion over the whole stroke, in both directions",
        ),
        Kind(
            "load", "a constant load", "force-of-position", "joint", ("force",),
            "another attitude of the machine: gravity turns with it",
        ),
        Kind(
            "periodic-force", "a force periodic in the position", "force-of-position", "joint",
            ("amplitude", "period"), "slow motion over many periods",
        ),
        Kind(
            "force-of-time", "a force over time", "force", "joint", ("amplitude", "period"),
            "a record at another speed: what comes with time keeps its period",
        ),
        Kind(
            "lateness", "a lateness", None, "path", ("delay",),
            "command and sensor on an oscilloscope with one trigger, or a second sensor",
        ),
        Kind(
            "factor", "a factor between input and sensor", None, "path", ("factor",),
            "a second sensor on the way, or one of the factors measured by itself",
        ),
        Kind(
            "gap-or-limit", "a limit or gap in the path", None, "path", (),
            "small and large amplitudes, slow and fast",
        ),
        Kind("sensor-error", "an error of the sensor", None, "sensor", (), "the sensor against another one"),
    )
}  # fmt: skip

# Effect -> its kind.
KIND_OF: Mapping[str, str] = {
    effect: kind
    for kind, effects in {
        "dry-friction": (
            "coulomb-friction", "asymmetric-coulomb-friction", "stribeck-friction", "presliding", "bouc-wen",
            "position-dependent-friction", "load-dependent-friction", "gear-efficiency",
        ),
        "speed-friction": ("viscous-friction", "asymmetric-viscous-friction", "quadratic-drag"),
        "spring": ("stiffness", "cubic-stiffness", "one-sided-spring", "end-stop"),
        "load": ("constant-load", "gravity-direction", "centre-of-mass"),
        "periodic-force": ("cogging", "pendulum-gravity"),
        "force-of-time": ("torque-ripple",),
        "lateness": ("input-delay", "sensor-delay", "actuator-lag"),
        "factor": (
            "input-gain", "torque-constant", "inertia", "resistance", "sensor-gain", "resistance-heating",
        ),
        "gap-or-limit": (
            "input-saturation", "input-dead-zone", "brush-drop", "backlash", "flexible-coupling",
        ),
        "sensor-error": ("sensor-bias", "sensor-eccentricity", "magnitude-sensor", "quantisation"),
    }.items()
    for effect in effects
}  # fmt: skip


def upwards(kind: str) -> Iterator[Kind]:
    """A kind and those that it is a part of, the narrowest first."""
    at: str | None = kind
    while at is not None:
        yield KINDS[at]
        at = KINDS[at].wider
