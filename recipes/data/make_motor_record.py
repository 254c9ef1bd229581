"""Simulate ``motor_record.csv``, which replaces a measured record in ``make demo``.

Run it with ``python recipes/data/make_motor_record.py``. The program imports nothing from robustlab, so that the
comparison with robustlab's model is independent. This motor differs from that model by:

- parameters off their data-sheet values: R +4 %, L -6 %, torque and back-EMF constant -2 %, J +5 %, Kf -20 %;
- dry friction of bearings and brushes with presliding (LuGre model: Coulomb 6 mN m, break-away 8.5 mN m);
- a driver with a voltage drop of 0.6 V;
- an encoder with 2000 counts per turn, and a current sensor with 20 mA of noise and a resolution of 5 mA.

The equations are integrated by classical Runge-Kutta steps of 20 us.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

SEED = 20100712
SAMPLE_TIME, DURATION, SUBSTEPS = 1e-3, 4.6, 50

# true parameters of the motor
R, L, K, J, KF = 2.07 * 1.04, 0.62e-3 * 0.94, 0.052 * 0.98, 7.2e-6 * 1.05, 4.8e-5 * 0.80
COULOMB, BREAK_AWAY, STRIBECK_SPEED = 6.0e-3, 8.5e-3, 4.0
BRISTLE_STIFFNESS, BRISTLE_DAMPING = 0.6, 1.0e-3
DRIVER_DROP = 0.6
COUNTS, CURRENT_NOISE, CURRENT_STEP = 2000, 20e-3, 5e-3

# (until s, voltage at the start, voltage at the end): rest, steps, reversals, levels, slow ramps through zero
SEGMENTS = (
    (0.10, 0.0, 0.0),
    (0.40, 12.0, 12.0),
    (0.70, -12.0, -12.0),
    (0.90, 6.0, 6.0),
    (1.10, -6.0, -6.0),
    (1.30, 3.0, 3.0),
    (1.50, -3.0, -3.0),
    (1.60, 0.0, 0.0),
    (2.20, 0.0, 2.0),
    (3.20, 2.0, -2.0),
    (3.70, -2.0, 0.0),
    (3.85, 9.0, 9.0),
    (4.00, 4.5, 4.5),
    (4.15, -9.0, -9.0),
    (4.30, -4.5, -4.5),
    (4.45, 12.0, 12.0),
    (4.60, 0.0, 0.0),
)


def voltage(t: np.ndarray) -> np.ndarray:
    """Return the command in V at the sample times; it is held between them."""
    u, start = np.zeros_like(t), 0.0
    for stop, first, last in SEGMENTS:
        inside = (t >= start - 1e-9) & (t < stop - 1e-9)
        u[inside] = first + (last - first) * (t[inside] - start) / (stop - start)
        start = stop
    return np.round(u, 3)


def rates(x: tuple[float, ...], u: float) -> tuple[float, ...]:
    """Return the derivatives of angle, speed, current and bristle deflection."""
    _, w, i, z = x
    level = COULOMB + (BREAK_AWAY - COULOMB) * math.exp(-((w / STRIBECK_SPEED) ** 2))
    dz = w - BRISTLE_STIFFNESS * abs(w) * z / level
    friction = BRISTLE_STIFFNESS * z + BRISTLE_DAMPING * dz * math.exp(-abs(w)) + KF * w
    applied = math.copysign(max(abs(u) - DRIVER_DROP, 0.0), u)
    return w, (K * i - friction) / J, (applied - R * i - K * w) / L, dz


def step(x: tuple[float, ...], u: float, h: float) -> tuple[float, ...]:
    """Return the state after one classical Runge-Kutta step."""

    def at(k: tuple[float, ...], share: float) -> tuple[float, ...]:
        return tuple(a + share * h * b for a, b in zip(x, k, strict=True))

    k1 = rates(x, u)
    k2 = rates(at(k1, 0.5), u)
    k3 = rates(at(k2, 0.5), u)
    k4 = rates(at(k3, 1.0), u)
    return tuple(a + h / 6 * (p + 2 * q + 2 * r + s) for a, p, q, r, s in zip(x, k1, k2, k3, k4, strict=True))


def simulate(duration: float = DURATION) -> np.ndarray:
    """Return columns t, u, phi, i as measured by the sensors, shape (n, 4)."""
    n = round(duration / SAMPLE_TIME)
    t = np.arange(n) * SAMPLE_TIME
    u = voltage(t)
    x: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    phi, current = np.empty(n), np.empty(n)
    for k in range(n):
        phi[k], current[k] = x[0], x[2]
        for _ in range(SUBSTEPS):
            x = step(x, float(u[k]), SAMPLE_TIME / SUBSTEPS)
    noise = np.random.default_rng(SEED).normal(0.0, CURRENT_NOISE, round(DURATION / SAMPLE_TIME))[:n]
    count = 2 * math.pi / COUNTS
    shown = np.round((current + noise) / CURRENT_STEP) * CURRENT_STEP
    return np.column_stack([t, u, np.floor(phi / count) * count, shown])


HEADER = """\
# SIMULATED stand-in for a measured record, not a measurement: a Maxon RE 35 motor with friction, driver drop, sensors
# that the nominal model does not have. Made by make_motor_record.py (own equations and integrator, seed {seed}).
# u: command to the driver; phi: encoder, 2000 counts a turn; i: current sensor, 5 mA resolution, 20 mA noise
t [s],u [V],phi [rad],i [A]
"""


def main() -> None:
    """Write the file to the folder of this script."""
    path = Path(__file__).with_name("motor_record.csv")
    rows = (f"{t:.3f},{u:.3f},{phi:.5f},{i:.3f}" for t, u, phi, i in simulate() + 0.0)
    path.write_text(HEADER.format(seed=SEED) + "\n".join(rows) + "\n", encoding="utf-8")
    print(f"{path.name}: {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
