"""The plants of the blind tests: what the user believes (values with tolerances) and the machine that follows."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from .machine import Machine

__all__ = ["LEVELS", "PLANTS", "Level", "Setup"]


@dataclass(frozen=True)
class Level:
    """Noise at the motor's shaft: encoder; standard deviations of angle, coloured torque and current."""

    counts_per_turn: float
    angle: float
    torque: float
    current: float


LEVELS = {
    "low": Level(2000, 5e-4, 2e-5, 5e-3),
    "mid": Level(2000, 2e-3, 2e-4, 2e-2),
    "high": Level(500, 1e-2, 8e-4, 6e-2),
}


@dataclass(frozen=True)
class Setup:
    """A plant: nominal values with relative tolerances, and how its machine follows from the true values.

    Attributes
    ----------
    nominal
        Name -> (value, relative tolerance).
    together
        Groups of names that are one physical constant and are perturbed by one factor.
    machine
        True values -> `Machine` without effects.
    length
        Unit of the coordinate per radian of a motor (1 for angles), which scales all draws: forces by 1 / length.
    disturbance
        Factor on the level's coloured torque.
    resonance
        Range in Hz of a soft coupling's frequency.
    feedback
        kp, kd of the position controller; `reach` is what it is asked to move within.
    """

    nominal: Mapping[str, tuple[float, float]]
    together: tuple[tuple[str, ...], ...]
    machine: Callable[[Mapping[str, float]], Machine]
    output: str
    unit: str
    length: float
    largest: float
    disturbance: float
    resonance: tuple[float, float]
    feedback: tuple[float, float]
    reach: float
    electrical: bool


ELECTRICAL = {"R": (2.07, 0.06), "L": (0.62e-3, 0.1), "Km": (0.0525, 0.03), "Kb": (0.0525, 0.03)}
TURNS = 4.8 * 41 / 21  # motor turns per turn of the thesis' screw nut
LEAD = 0.004


def _motor(true: Mapping[str, float]) -> Machine:
    return Machine(
        J1=true["J"],
        R=true["R"],
        L=true["L"],
        Kt=true["Km"],
        Ke=true["Kb"],
        b_pos=true["Kf"],
        b_neg=true["Kf"],
    )


def _actuator(true: Mapping[str, float]) -> Machine:
    per_radian = LEAD / (2 * math.pi * TURNS)
    reflected = true["J_nut"] / TURNS**2 + (true["m_screw"] + true["m_cart"]) * per_radian**2
    return _motor(true)._replace(J1=true["J"] + reflected)


def _axis(true: Mapping[str, float]) -> Machine:
    return Machine(J1=true["M"], winding=0.0, gain=true["gain"], b_pos=true["Fv"], b_neg=true["Fv"])


PLANTS = {
    "dc-motor": Setup(
        nominal={**ELECTRICAL, "J": (1.5e-5, 0.06), "Kf": (1e-5, 0.5)},
        together=(("Km", "Kb"),),
        machine=_motor,
        output="phi",
        unit="rad",
        length=1.0,
        largest=24.0,
        disturbance=1.0,
        resonance=(15.0, 60.0),
        feedback=(2.0, 0.02),
        reach=25.0,
        electrical=True,
    ),
    "linear-actuator": Setup(
        nominal={
            **ELECTRICAL,
            "J": (7.2e-6, 0.06),
            "Kf": (4.8e-5, 0.35),
            "J_nut": (2.2071e-5, 0.1),
            "m_screw": (0.112, 0.1),
            "m_cart": (3.167 / 6, 0.5),
        },
        together=(("Km", "Kb"),),
        machine=_actuator,
        output="phi",
        unit="rad",
        length=1.0,
        largest=24.0,
        disturbance=1.0,
        resonance=(15.0, 60.0),
        feedback=(2.0, 0.02),
        reach=25.0,
        electrical=True,
    ),
    "servo-axis": Setup(
        nominal={"M": (95.1089, 0.06), "Fv": (203.5034, 0.3), "gain": (35.15065, 0.03)},
        together=(),
        machine=_axis,
        output="q",
        unit="m",
        length=2.5e-3 / (2 * math.pi),  # the EMPS screw's lead per radian: M length**2 is then a motor's inertia
        largest=1.2,
        resonance=(6.0, 20.0),
        disturbance=0.1,  # 0.05 N at the level mid: nothing holds the axis but its slides, so that forces integrate
        feedback=(2500.0, 100.0),
        reach=0.012,
        electrical=False,
    ),
}
