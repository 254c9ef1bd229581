"""Two-layer control of a machine with motors: an upper I-PD for the angles, a torque loop for each motor."""
# Březina 2010, eqs 9.1-9.4. Eqs 9.2 and 9.4 lack one derivative; the gains are right for the plants written above.

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.linearisation import linearise, trim
from robustlab.dynamics.plant_contract import Trim
from robustlab.dynamics.stewart.stewart_platform import StewartPlatform
from robustlab.errors import InputError
from robustlab.signals import Taken
from robustlab.statespace import Signal, StateSpaceModel, real_array

# Without a rotor in the machine the lower layer still designs with one, as the thesis does (its eq. 9.3).
ROTOR = 7.2e-6
NUMBERS = range(1, 7)


@dataclass(frozen=True)
class TorqueGains:
    """Gains of a motor's torque loop: kp in V/(N m s), kd in V/(N m), ki in V/(N m s2)."""

    kp: float
    kd: float
    ki: float


@dataclass(frozen=True, eq=False)
class LayeredController:
    """Any linear upper layer above the motors' torque loops, in deviations from the trim at which it was designed."""

    upper: StateSpaceModel  # from r, phi, phidot (6 each) to the six motor torques that it asks for; continuous
    lower: TorqueGains  # gains of every motor's torque loop
    at: Trim  # the trim; its torques and voltages are added to what the controller gives

    def __post_init__(self) -> None:
        if (self.upper.n_inputs, self.upper.n_outputs) != (18, 6) or self.upper.is_discrete:
            kind = "discrete" if self.upper.is_discrete else "continuous"
            found = f"{self.upper.n_inputs} inputs and {self.upper.n_outputs} outputs, {kind}"
            raise InputError("layered controller", found, "r, phi, phidot (6 each) in and 6 torques out, continuous")

    def state_space(self) -> StateSpaceModel:
        """Linear model of the controller: inputs r, phi, phidot, torque (6 each), outputs the six voltages."""
        upper, lower = self.upper, self.lower
        n, one, none = upper.n_states, np.eye(6), np.zeros((6, 6))
        below = np.zeros((6, n))
        a = np.block([[upper.A, np.zeros((n, 12))], [upper.C, none, none], [below, lower.ki * one, none]])
        b = np.block([[upper.B, np.zeros((n, 6))], [upper.D, -one], [np.zeros((6, 18)), -lower.kp * one]])
        c, d = np.hstack([below, none, one]), np.hstack([np.zeros((6, 18)), -lower.kd * one])
        inputs = [*_ABOVE, *(Taken(*s) for s in _TORQUES)]
        return StateSpaceModel(a, b, c, d, 0.0, inputs, _signals(("u", "V")), where="two-layer")


def _signals(*kinds: tuple[str, str]) -> list[Signal]:
    return [Signal(f"{name}_{i}", unit) for name, unit in kinds for i in NUMBERS]


_ABOVE = [
    *(Taken(f"r_{i}", "rad", "r", f"phi_{i}") for i in NUMBERS),
    *(Taken(*s) for s in _signals(("phi", "rad"), ("phidot", "rad/s"))),
]
_TORQUES = _signals(("torque", "N m"))


def upper_layer(Kp: Array, Kd: Array, Ki: Array) -> StateSpaceModel:
    """The I-PD of the angles with these gains (6, 6): inputs r, phi, phidot (6 each), outputs the six motor torques."""
    one, none = np.eye(6), np.zeros((6, 6))
    b, d = np.hstack([one, -one, none]), np.hstack([none, -Kp, -Kd])
    return StateSpaceModel(none, b, Ki, d, 0.0, _ABOVE, _TORQUES, where="two-layer: upper layer")


def torque_gains(p: float, *, R: float, L: float, Km: float, Kb: float, Kf: float, J: float) -> TorqueGains:
    """Gains that give the torque of a motor with the free rotor J the triple pole -p."""
    b, c, d = -(L * Kf + R * J) / (L * J), -(R * Kf + Kb * Km) / (L * J), Km / L
    return TorqueGains(kp=(3 * p**2 + c) / d, kd=(3 * p + b) / d, ki=p**3 / d)


def two_layer(
    plant: StewartPlatform, p_up: float = 236.0, p_low: float = 3000.0, at: Trim | None = None, rotor_J: float = ROTOR
) -> LayeredController:
    """Two-layer controller of a Stewart platform with motors."""
    if not (isinstance(plant, StewartPlatform) and plant.motors):
        raise InputError("two_layer", "a plant without motors", 'plant("stewart-platform", motors=True)')
    for name, value in (("p_up", p_up), ("p_low", p_low), ("rotor_J", rotor_J)):
        if not float(real_array(name, value, 0, "two_layer")) > 0:
            raise InputError(f"two_layer: {name}", f"{value:g}", "a positive number")
    point = trim(plant) if at is None else at
    p, a, one = plant.values, linearise(plant, point).A, np.eye(6)
    gain = a[6:12, 12:] / p["Km"]
    stiffness, damping = a[6:12, :6], a[6:12, 6:12] + gain * p["Kf"] * p["ratio"]  # the motor's own damping is in m
    right = np.hstack([3 * p_up**2 * one + stiffness, 3 * p_up * one + damping, p_up**3 * one])
    upper = np.asarray(np.linalg.solve(gain, right), dtype=np.float64)
    motor = {name: p[name] for name in ("R", "L", "Km", "Kb", "Kf")}
    gains = torque_gains(p_low, J=rotor_J, **motor)
    return LayeredController(upper_layer(upper[:, :6], upper[:, 6:12], upper[:, 12:]), gains, point)


def measured(plant: StewartPlatform) -> Array:
    """What the controller is fed, ``(phi, phidot, torque) = C x``, shape (18, 18); torque = Km i - Kf n phidot."""
    p, c = plant.values, np.eye(18)
    c[12:, 12:] *= p["Km"]
    c[12:, 6:12] = -p["Kf"] * p["ratio"] * np.eye(6)
    return c


def closed_loop(plant: StewartPlatform, controller: LayeredController, at: Trim | None = None) -> StateSpaceModel:
    """Linear model of the machine under control: references r (6) to nut angles, torques and voltages (18)."""
    model, k, c = linearise(plant, controller.at if at is None else at), controller.state_space(), measured(plant)
    from_r, from_y = k.B[:, :6], k.B[:, 6:]
    direct = k.D[:, 6:] @ c
    a = np.block([[model.A + model.B @ direct, model.B @ k.C], [from_y @ c, k.A]])
    b = np.vstack([np.zeros((18, 6)), from_r])
    none = np.zeros((6, k.n_states))
    outputs = np.vstack([np.hstack([c[:6], none]), np.hstack([c[12:], none]), np.hstack([direct, k.C])])
    names = _signals(("phi", "rad"), ("torque", "N m"), ("u", "V"))
    return StateSpaceModel(a, b, outputs, np.zeros((18, 6)), 0.0, k.inputs[:6], names, where="closed_loop")
