"""A two-link arm under a PD controller with a hidden effect: equations of its own, small steps, no code of robustlab.

The equations are Lagrange's, written out for two links with geared rotors; dry friction is Karnopp's in the form of a
steep saturated line (its slope holds a joint within 1e-5 rad/s), which no force law of robustlab is.
"""

import math

import numpy as np

from robustlab.record import Record

__all__ = ["NOMINAL", "arm_record"]

NOMINAL = {
    "m_1": 4.0, "c_1": 0.2, "I_1": 0.0533, "I_r1": 0.10, "b_1": 0.8,
    "m_2": 2.5, "c_2": 0.15, "I_2": 0.0188, "I_r2": 0.04, "b_2": 0.3, "l_1": 0.4, "g": 9.81,
}  # fmt: skip
TONES = ((0.23, 0.5), (0.61, 0.3), (1.1, 0.12))  # Hz, rad
STIFF = 1e-3  # rad/s at which dry friction is whole


def arm_record(
    seed: int, coulomb: tuple[float, float] = (0.0, 0.0), seconds: float = 3.0, dt: float = 2e-3, noise: float = 2e-4,
    parts: int = 20, **changed: float,
) -> Record:  # fmt: skip
    """Record of torques and joint angles; ``coulomb`` friction in N m, ``changed`` parameters of the true machine."""
    p = {**NOMINAL, **changed}
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0.0, 2.0 * math.pi, (2, len(TONES)))
    n, h = round(seconds / dt), dt / parts
    a2, a3 = p["m_2"] * p["l_1"] * p["c_2"], p["I_2"] + p["m_2"] * p["c_2"] ** 2
    a1 = p["I_1"] + p["I_2"] + p["m_1"] * p["c_1"] ** 2 + p["m_2"] * (p["l_1"] ** 2 + p["c_2"] ** 2) + p["I_r1"]
    g1, g2 = (p["m_1"] * p["c_1"] + p["m_2"] * p["l_1"]) * p["g"], p["m_2"] * p["c_2"] * p["g"]

    def wanted(t: float, j: int) -> tuple[float, float]:
        turns = [2.0 * math.pi * f for f, _ in TONES]
        q = sum(a * math.sin(w * t + s) for (_, a), w, s in zip(TONES, turns, phases[j], strict=True))
        return q, sum(a * w * math.cos(w * t + s) for (_, a), w, s in zip(TONES, turns, phases[j], strict=True))

    (q1, w1), (q2, w2) = wanted(0.0, 0), wanted(0.0, 1)
    angles, torques = np.empty((n, 2)), np.empty((n, 2))
    for k in range(n):
        (r1, v1), (r2, v2) = wanted(k * dt, 0), wanted(k * dt, 1)
        u1 = 150.0 * (r1 - q1) + 15.0 * (v1 - w1) + 17.7 * math.cos(r1) + 3.7 * math.cos(r1 + r2)
        u2 = 40.0 * (r2 - q2) + 4.0 * (v2 - w2) + 3.7 * math.cos(r1 + r2)
        angles[k], torques[k] = (q1, q2), (u1, u2)
        for _ in range(parts):
            s, c = math.sin(q2), math.cos(q2)
            m11, m12, m22 = a1 + 2.0 * a2 * c, a3 + a2 * c, a3 + p["I_r2"]
            fall = g2 * math.cos(q1 + q2)
            f1 = u1 + a2 * s * w2 * (2.0 * w1 + w2) - p["b_1"] * w1 - g1 * math.cos(q1) - fall
            f2 = u2 - a2 * s * w1 * w1 - p["b_2"] * w2 - fall
            f1 -= coulomb[0] * max(-1.0, min(1.0, w1 / STIFF))
            f2 -= coulomb[1] * max(-1.0, min(1.0, w2 / STIFF))
            det = m11 * m22 - m12 * m12
            w1 += h * (m22 * f1 - m12 * f2) / det
            w2 += h * (m11 * f2 - m12 * f1) / det
            q1 += h * w1
            q2 += h * w2
    seen = angles + noise * rng.standard_normal(angles.shape)
    units = {"torque_1": "N m", "torque_2": "N m", "q_1": "rad", "q_2": "rad"}
    inputs = {"torque_1": torques[:, 0], "torque_2": torques[:, 1]}
    return Record(dt * np.arange(n), inputs, {"q_1": seen[:, 0], "q_2": seen[:, 1]}, units, f"arm {seed}")
