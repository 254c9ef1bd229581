"""The plants of the blind tests: what the user believes (values with tolerances) and the machine that follows.

Oscillator and two-mass drive are drawn anew with every seed: resonance and damping are the point of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from .machine import Machine


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
    """A plant: nominal values with relative tolerances, and how its machine follows from the true values."""

    nominal: Mapping[str, tuple[float, float]]  # name -> (value, relative tolerance)
    together: tuple[tuple[str, ...], ...]  # names that are one physical constant and are perturbed by one factor
    machine: Callable[[Mapping[str, float]], Machine]  # true values -> machine without effects
    output: str
    unit: str
    length: float  # of the coordinate per radian of a motor: scales all draws, forces by 1 / length
    largest: float
    disturbance: float  # factor on the level's coloured torque
    resonance: tuple[float, float]  # range in Hz of a soft coupling's frequency
    feedback: tuple[float, float] | None  # kp, kd of the position controller; None: never in closed loop
    reach: float  # range of the references in closed loop
    electrical: bool
    input: str = "u"
    input_unit: str = "V"
    force: float | None = None  # scales of the draws where they are not 1 / length and length
    speed: float | None = None
    dt: float = 1e-3
    inputs: str = "levels"  # kind of excitation, see `excitation.voltage`: "levels", "balanced" or "resonant"
    second: str = ""  # second measured coordinate, of body 2
    vary: Callable[[Setup, np.random.Generator], Setup] | None = None  # the setup of one seed, drawn anew

    @property
    def force_scale(self) -> float:
        """Factor from a motor's torque to this plant's force."""
        return 1.0 / self.length if self.force is None else self.force

    @property
    def speed_scale(self) -> float:
        return self.length if self.speed is None else self.speed


ELECTRICAL = {"R": (2.07, 0.06), "L": (0.62e-3, 0.1), "Km": (0.0525, 0.03), "Kb": (0.0525, 0.03)}
TURNS = 4.8 * 41 / 21  # motor turns per turn of the thesis' screw nut
LEAD = 0.004


def _motor(true: Mapping[str, float]) -> Machine:
    return Machine(
        J1=true["J"], R=true["R"], L=true["L"], Kt=true["Km"], Ke=true["Kb"], b_pos=true["Kf"], b_neg=true["Kf"]
    )


def _actuator(true: Mapping[str, float]) -> Machine:
    per_radian = LEAD / (2 * math.pi * TURNS)
    reflected = true["J_nut"] / TURNS**2 + (true["m_screw"] + true["m_cart"]) * per_radian**2
    return _motor(true)._replace(J1=true["J"] + reflected)


def _oscillator_of_a_seed(setup: Setup, r: np.random.Generator) -> Setup:
    """Mass 1 kg, 8 to 15 samples a period, damping ratio 0.005 to 0.03."""
    w, zeta = 2 * math.pi / (setup.dt * r.uniform(8, 15)), r.uniform(0.005, 0.03)
    nominal = {"m": (1.0, 0.03), "c": (2 * zeta * w, 0.3), "k": (w**2, 0.02)}
    length = 2.0 * setup.largest / w**2  # twice the static deflection: what resonates swings ten times as far
    return replace(setup, nominal=nominal, length=length)


def _two_mass_of_a_seed(setup: Setup, r: np.random.Generator) -> Setup:
    """Resonance at 10 to 40 Hz, damping ratio 0.01 to 0.05, load 0.5 to 3 times the motor."""
    J1, ratio, w, zeta = 1e-3, r.uniform(0.5, 3), 2 * math.pi * r.uniform(10, 40), r.uniform(0.01, 0.05)
    J = J1 * ratio / (1 + ratio)
    nominal = {"J1": (J1, 0.05), "J2": (J1 * ratio, 0.05), "c": (2 * zeta * w * J, 0.5), "k": (w**2 * J, 0.1)}
    return replace(setup, nominal=nominal)


MOTOR = Setup(
    nominal={**ELECTRICAL, "J": (1.5e-5, 0.06), "Kf": (1e-5, 0.5)}, together=(("Km", "Kb"),), machine=_motor,
    output="phi", unit="rad", length=1.0, largest=24.0, disturbance=1.0, resonance=(15.0, 60.0),
    feedback=(2.0, 0.02), reach=25.0, electrical=True,
)  # fmt: skip
ACTUATOR = {
    **ELECTRICAL, "J": (7.2e-6, 0.06), "Kf": (4.8e-5, 0.35), "J_nut": (2.2071e-5, 0.1), "m_screw": (0.112, 0.1),
    "m_cart": (3.167 / 6, 0.5),
}  # fmt: skip
PLANTS = {
    "dc-motor": MOTOR,
    "linear-actuator": replace(MOTOR, nominal=ACTUATOR, machine=_actuator),
    "servo-axis": Setup(
        nominal={"M": (95.1089, 0.06), "Fv": (203.5034, 0.3), "gain": (35.15065, 0.03)}, together=(),
        machine=lambda p: Machine(J1=p["M"], winding=0.0, gain=p["gain"], b_pos=p["Fv"], b_neg=p["Fv"]),
        output="q", unit="m",
        length=2.5e-3 / (2 * math.pi),  # the EMPS screw's lead per radian: M length**2 is then a motor's inertia
        largest=1.2, resonance=(6.0, 20.0),
        disturbance=0.1,  # 0.05 N at the level mid: nothing holds the axis but its slides, so that forces integrate
        feedback=(2500.0, 100.0), reach=0.012, electrical=False,
    ),
    "mass-spring-damper": Setup(
        nominal={}, together=(),
        machine=lambda p: Machine(J1=p["m"], winding=0.0, gain=1.0, b_pos=p["c"], b_neg=p["c"], k=p["k"]),
        output="q", unit="m", length=1.0, largest=10.0,
        resonance=(0.0, 0.0), disturbance=1.0, feedback=None, reach=0.0, electrical=False,
        force=16.7,  # as the largest input to that of the motor
        input="f", input_unit="N", dt=2e-3, inputs="resonant", vary=_oscillator_of_a_seed,
    ),
    "two-mass": Setup(
        nominal={}, together=(),
        machine=lambda p: Machine(J1=p["J1"], winding=0.0, gain=1.0, J2=p["J2"], k_s=p["k"], c_s=p["c"]),
        output="phi1", unit="rad", length=1.0, largest=1.0,
        resonance=(0.0, 0.0), disturbance=0.1, feedback=(0.3, 0.04), reach=8.0, electrical=False,
        input="torque", input_unit="N m", force=5.0, speed=0.1, inputs="balanced", second="phi2",
        vary=_two_mass_of_a_seed,
    ),
}  # fmt: skip
