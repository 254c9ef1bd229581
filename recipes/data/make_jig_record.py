"""Simulate the records ``jig_*.csv``, which replace measurements on the thesis' test jig.

Run it with ``python recipes/data/make_jig_record.py``. Chapter 11 of the thesis drives one leg of its platform on a
bench: motor, planetary and spur gear, ball screw, cart. The measurements were never published. These records are
simulated, not measured. The program imports nothing from robustlab, so that the comparison with robustlab's model is
independent. This jig differs from the nominal model by:

- dry friction in the screw, as a LuGre bristle at the nut; while it slides it takes 20 mN m of the motor's torque;
- a driver with a voltage drop of 0.6 V;
- parameters off their nominal values, within the thesis' tolerances where it prints them (Kf 35 %, masses and
  inertias of the link 10 %), otherwise within assumed ones (R 10 %, L 10 %, motor constant 5 %, rotor 10 %):
  R +3 %, L -5 %, motor constant -1 %, Kf -15 %, rotor +4 %, nut -5 %, screw +3 %; the thesis does not print the mass
  of the cart, which is 0.6 kg here (the motor constant was chosen so that the model error on the square wave is about
  as large as in the thesis; the others are arbitrary);
- an encoder on the motor with 2000 counts per turn and edge jitter of 1 mrad, and in the rich and slow records a
  current sensor with 20 mA of noise and a resolution of 5 mA.

The equations are integrated by classical Runge-Kutta steps of 10 us.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

SAMPLE_TIME, DURATION, SUBSTEPS = 1e-3, 5.0, 100
DRIVE_LIMIT = 24.0  # V
STROKE = 0.0145  # m either way from the middle: the leg is 159 to 188 mm long

# true parameters of the jig
R, L, K = 2.07 * 1.03, 0.62e-3 * 0.95, 0.052 * 0.99
J_ROTOR, J_NUT, KF = 7.2e-6 * 1.04, 2.2071e-5 * 0.95, 4.8e-5 * 0.85
SCREW, CART = 0.112 * 1.03, 0.6  # kg
RATIO, LEAD = 4.8 * 41 / 21, 0.004  # motor turns per nut turn; m of travel per nut turn
DRIVER_DROP = 0.6  # V

# friction of the screw, at the nut: 20 mN m at the motor; presliding within 2.5 mrad of motor angle
SCREW_FRICTION = 20e-3 * RATIO  # N m
BRISTLE_STIFFNESS = 8.0 * RATIO**2  # N m/rad
BRISTLE_DAMPING = 1e-3 * RATIO**2  # N m s/rad, while the nut hardly turns
COUNTS, EDGE_JITTER = 2000, 1e-3
CURRENT_NOISE, CURRENT_STEP = 20e-3, 5e-3

# kinetic energy of everything that moves with the nut, as an inertia about the nut's axis
NUT_SIDE = J_NUT + (SCREW + CART) * (LEAD / (2 * math.pi)) ** 2 + J_ROTOR * RATIO**2


def rates(w: float, i: float, z: float, u: float) -> tuple[float, float, float]:
    """Return the derivatives of the nut's speed, the motor current and the bristle deflection at motor voltage u."""
    give = w - BRISTLE_STIFFNESS * abs(w) * z / SCREW_FRICTION
    friction = BRISTLE_STIFFNESS * z + BRISTLE_DAMPING * give * math.exp(-abs(w))
    torque = RATIO * (K * i - KF * RATIO * w)
    return (torque - friction) / NUT_SIDE, (u - R * i - K * RATIO * w) / L, give


def run(command: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return true motor angle and current at the sample times; the driver's command is held between them."""
    n, h = len(command), SAMPLE_TIME / SUBSTEPS
    phi, current = np.empty(n), np.empty(n)
    turned = w = i = z = 0.0  # the nut's angle and speed, the current, the bristle
    for k in range(n):
        phi[k], current[k] = RATIO * turned, i
        u = math.copysign(max(abs(float(command[k])) - DRIVER_DROP, 0.0), float(command[k]))
        for _ in range(SUBSTEPS):
            a1, b1, c1 = rates(w, i, z, u)
            w2 = w + 0.5 * h * a1
            a2, b2, c2 = rates(w2, i + 0.5 * h * b1, z + 0.5 * h * c1, u)
            w3 = w + 0.5 * h * a2
            a3, b3, c3 = rates(w3, i + 0.5 * h * b2, z + 0.5 * h * c2, u)
            w4 = w + h * a3
            a4, b4, c4 = rates(w4, i + h * b3, z + h * c3, u)
            turned += h / 6 * (w + 2 * w2 + 2 * w3 + w4)
            w += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
            i += h / 6 * (b1 + 2 * b2 + 2 * b3 + b4)
            z += h / 6 * (c1 + 2 * c2 + 2 * c3 + c4)
    return phi, current


# --- commanded voltage -----------------------------------------------------------------------------------------------


def square() -> np.ndarray:
    """Return a square wave of 11.8 V and 1 Hz after 0.1 s at zero."""
    t = np.arange(round(DURATION / SAMPLE_TIME)) * SAMPLE_TIME
    forward = np.floor((t - 0.1 + 1e-9) / 0.5) % 2 == 0
    return np.where(t < 0.1 - 1e-9, 0.0, np.where(forward, 11.8, -11.8))


def rich(seed: int) -> np.ndarray:
    """Return random levels and reversals up to the drive's limit, with slow ramps through zero and pauses between.

    The signs keep the cart within its stroke; a level that would exceed it is held for a shorter time.
    """
    rng = np.random.default_rng(seed)
    parts, reached, reach = [np.zeros(100)], 0.0, 0.8 * STROKE
    metres_per_volt_second = LEAD / (2 * math.pi * RATIO * 0.054)
    limit = True
    for stage in range(3):
        room = round(1.0 / SAMPLE_TIME)
        while room > 0:
            size = DRIVE_LIMIT if limit else rng.uniform(1.0, DRIVE_LIMIT)
            limit = False
            sign = -math.copysign(1.0, reached) if abs(reached) > 0.5 * reach else rng.choice([-1.0, 1.0])
            free = reach - sign * reached
            longest = free / (metres_per_volt_second * size)
            n = max(1, min(room, round(min(rng.uniform(0.06, 0.25), longest) / SAMPLE_TIME)))
            parts.append(np.full(n, sign * size))
            reached += sign * size * metres_per_volt_second * n * SAMPLE_TIME
            room -= n
        if stage < 2:
            top = rng.uniform(2.2, 3.2) * rng.choice([-1.0, 1.0])
            there, back = np.linspace(0.0, top, 175), np.linspace(top, -top, 350)
            parts += [np.zeros(50), there, back, np.linspace(-top, 0.0, 175)]
    command = np.concatenate(parts)
    n = round(DURATION / SAMPLE_TIME)
    return np.round(np.pad(command, (0, max(0, n - len(command))))[:n], 2)


def slow(seed: int) -> np.ndarray:
    """Return random levels of 1.8 V to 4 V and reversals: slow motions where friction and drop are relevant.

    The first level is the largest; the signs keep the cart near the middle.
    """
    rng = np.random.default_rng(seed)
    parts, reached, n = [np.zeros(100)], 0.0, round(DURATION / SAMPLE_TIME)
    size = 4.0
    while sum(map(len, parts)) < n:
        sign = -math.copysign(1.0, reached) if abs(reached) > 0.3 else rng.choice([-1.0, 1.0])
        length = round(rng.uniform(0.06, 0.22) / SAMPLE_TIME)
        parts.append(np.full(length, sign * size))
        reached += sign * size * length * SAMPLE_TIME / 4.0
        size = rng.uniform(1.8, 4.0)
    return np.round(np.concatenate(parts)[:n], 2)


RECORDS = {
    "jig_square": (square, 20110101, "square wave of 11.8 V"),
    "jig_rich": (lambda: rich(20110102), 20110102, "random levels, reversals, slow ramps"),
    "jig_rich_held_out": (lambda: rich(20110103), 20110103, "the same kind of input, other numbers"),
    "jig_slow": (lambda: slow(20110104), 20110104, "slow motions: random levels of 1.8 V to 4 V"),
    "jig_slow_held_out": (lambda: slow(20110105), 20110105, "the same kind of input, other numbers"),
}


def simulate(name: str, duration: float = DURATION) -> np.ndarray:
    """Return columns t, u, phi, i of the first ``duration`` seconds of a record, as measured by the sensors."""
    command, seed, _ = RECORDS[name]
    n, whole = round(duration / SAMPLE_TIME), round(DURATION / SAMPLE_TIME)
    u = command()[:n]
    phi, current = run(u)
    rng = np.random.default_rng(seed)
    jitter, noise = rng.normal(0.0, EDGE_JITTER, whole)[:n], rng.normal(0.0, CURRENT_NOISE, whole)[:n]
    count = 2 * math.pi / COUNTS
    shown = np.round((current + noise) / CURRENT_STEP) * CURRENT_STEP
    return np.column_stack([np.arange(n) * SAMPLE_TIME, u, np.floor((phi + jitter) / count) * count, shown])


HEADER = """\
# SIMULATED stand-in for a measured record, not a measurement: motor, gears, ball screw, cart on the thesis' test jig,
# with dry friction and a driver drop that the nominal model does not have. Made by make_jig_record.py (own equations
# and integrator, seed {seed}); {what}.
# u: command to the driver; phi: encoder on the motor, 2000 counts a turn{current}
"""


def main() -> None:
    """Write the files to the folder of this script."""
    for name, (_, seed, what) in RECORDS.items():
        with_current = name != "jig_square"
        header = HEADER.format(seed=seed, what=what, current="; i: current, 5 mA resolution" if with_current else "")
        columns = "t [s],u [V],phi [rad]" + (",i [A]" if with_current else "")
        rows = [
            f"{t:.3f},{u:g},{phi:.4f}" + (f",{i:.3f}" if with_current else "") for t, u, phi, i in simulate(name) + 0.0
        ]
        path = Path(__file__).with_name(f"{name}.csv")
        path.write_text(header + "\n".join([columns, *rows]) + "\n", encoding="utf-8")
        print(f"{path.name}: {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
