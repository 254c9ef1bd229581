"""The peer of the naming bench: discrepancy modelling with PySINDy's STLSQ on the torque residual of a DC motor.

After Kaheman, Kaiser, Strom, Kutz and Brunton, "Learning discrepancy models from experimental data" (2019): the torque
that the nominal model lacks, J dw/dt - K/R (u - K w) + b w with smoothed derivatives of the angle, is regressed on a
library of terms. Kind to the peer: the threshold is chosen per case by BIC, the smoothing window and the rank of wrong
parameters by the report with hindsight, and a wrong parameter is a name only where it leaves its tolerance. It uses the
angle alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from naming.regression import thresholded
from numpy.typing import NDArray

__all__ = ["WINDOWS", "peer_names"]

Array = NDArray[np.float64]

WINDOWS = (9, 15, 21, 31, 41, 61)  # samples of the Savitzky-Golay filter
ORDERS = (1, 2, 4, 13, 26)  # lines over the position
GEAR = 9.37  # of friction that follows the turns of what is driven, as in the thesis' actuator
STRIBECK = 10.0  # rad/s
EDGE, EVERY = 60, 5  # samples left out at the ends; thinning

NAMES = {
    "1": "constant-load",
    "sgn w": "coulomb-friction",
    "stribeck": "stribeck-friction",
    "|w|": "asymmetric-viscous-friction",
    "w|w|": "quadratic-drag",
    "sgn u": "input-dead-zone",
    "u^3": "input-saturation",
    "du/dt": "input-delay or sensor-delay",
    "t u": "resistance-heating",
    "|T| sgn w": "gear-efficiency",
    "phi": "stiffness",
    "phi^3": "cubic-stiffness",
    "cos(phi/N) sgn w": "position-dependent-friction",
    "sin(phi/N) sgn w": "position-dependent-friction",
} | {f"{wave}({n} phi)": "cogging" for wave in ("cos", "sin") for n in ORDERS}

# Relative changes of the coefficients of u and w per relative change of a parameter, and its tolerance. The
# acceleration is no term: with it the library holds the residual itself. What looks alike counts as either name.
LINEAR = {
    "torque-constant": ((1.0, -2.0), 0.03),
    "resistance or inertia": ((-1.0, 1.0), 0.06),
    "input-gain or sensor-gain": ((1.0, 0.0), 0.03),
    "viscous-friction": ((0.0, -1.0), 0.05),
}


def peer_names(case: Any) -> dict[str, list[str]]:
    """Variant -> names by falling share of the torque; an empty list says that nothing is missing.

    The variants are the smoothing windows, each with wrong parameters ranked by their torque or behind all other terms.
    """
    found = {}
    for window in WINDOWS:
        shares, parameter = _shares(case, window)
        ranked = {"": shares | parameter, "*": shares | dict.fromkeys(parameter, 0.0)}
        found |= {f"{window}{mark}": sorted(s, key=lambda name, s=s: -s[name]) for mark, s in ranked.items()}
    return found


def _shares(case: Any, window: int) -> tuple[dict[str, float], dict[str, float]]:
    """Torque of each chosen name; the wrong parameter, if any, apart."""
    columns, target, nominal = _library(case, window)
    labels = list(columns)
    used = slice(EDGE, -EDGE, EVERY)
    X = np.column_stack([columns[label] for label in labels])[used]
    chosen = thresholded(labels, X, target[used])
    shares: dict[str, float] = {}
    for k, label in enumerate(labels):
        if chosen[k] and label in NAMES:
            size = abs(chosen[k]) * (X[:, k].std() if label != "1" else 1.0)
            shares[NAMES[label]] = max(shares.get(NAMES[label], 0.0), float(size))
    return shares, _wrong_parameter(dict(zip(labels, chosen, strict=True)), columns, nominal)


def _library(case: Any, window: int) -> tuple[dict[str, Array], Array, dict[str, float]]:
    """Terms (label -> (n,)), the torque that the nominal model lacks (n,), and the nominal coefficients."""
    from scipy.signal import savgol_filter

    record, p = case.record, {name: value.value for name, value in case.plant.parameters.items()}
    dt, u, phi = record.dt, record["u"], record["phi"]

    def smooth(x: Array, derivative: int = 0) -> Array:
        return savgol_filter(x, window, 3, derivative, dt)

    angle, w, a, uf = smooth(phi), smooth(phi, 1), smooth(phi, 2), smooth(u)
    sign = np.tanh(w)
    nominal = {"u": p["Km"] / p["R"], "w": p["Km"] * p["Kb"] / p["R"]}
    drive = nominal["u"] * (uf - p["Kb"] * w)
    target = p["J"] * a - drive + p["Kf"] * w
    columns = {
        "u": uf,
        "w": w,
        "1": np.ones_like(w),
        "sgn w": smooth(sign),
        "stribeck": smooth(sign * np.exp(-((w / STRIBECK) ** 2))),
        "|w|": np.abs(w),
        "w|w|": w * np.abs(w),
        "sgn u": smooth(np.sign(u)),
        "u^3": smooth(u**3),
        "du/dt": smooth(u, 1),
        "t u": np.arange(len(u)) / len(u) * uf,
        "|T| sgn w": np.abs(drive) * sign,
        "phi": angle,
        "phi^3": angle**3,
        "cos(phi/N) sgn w": np.cos(angle / GEAR) * sign,
        "sin(phi/N) sgn w": np.sin(angle / GEAR) * sign,
    }
    for n in ORDERS:
        columns |= {f"cos({n} phi)": np.cos(n * angle), f"sin({n} phi)": np.sin(n * angle)}
    return columns, target, nominal


def _wrong_parameter(c: dict[str, float], columns: dict[str, Array], nominal: dict[str, float]) -> dict[str, float]:
    """The parameter whose change explains the linear coefficients best, if it leaves its tolerance, with its torque."""
    shift = np.array([c[key] / nominal[key] for key in ("u", "w")])
    torque = float(np.std(sum(c[key] * columns[key] for key in ("u", "w"))))
    fits = {}
    for name, (way, tolerance) in LINEAR.items():
        direction = np.array(way)
        change = float(shift @ direction / (direction @ direction))
        fits[name] = (float(np.sum((shift - change * direction) ** 2)), abs(change) / tolerance)
    name, (_, beyond) = min(fits.items(), key=lambda item: item[1][0])
    return {name: torque * (1 - 1 / beyond)} if beyond > 1.0 else {}
