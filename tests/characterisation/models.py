"""Norms and reductions of random models of many kinds."""

from collections.abc import Iterator
from typing import Any

import numpy as np

import robustlab as rl

from .cases import Case, seeds

RTOL = 1e-6
RTOLS = {"frequency": 1e-2, "h2": 1e-6}
# Kind -> states, inputs, outputs, damping from .. to, sample time.
KINDS: dict[str, tuple[int, int, int, tuple[float, float], float]] = {
    "small": (3, 1, 1, (0.1, 0.9), 0.0),
    "medium": (6, 2, 2, (0.1, 0.9), 0.0),
    "large": (20, 3, 3, (0.1, 0.9), 0.0),
    "very large": (40, 2, 2, (0.1, 0.9), 0.0),
    "light": (6, 1, 2, (1e-4, 1e-2), 0.0),
    "very light": (4, 1, 1, (1e-7, 1e-5), 0.0),
    "discrete": (5, 2, 2, (0.1, 0.9), 0.1),
    "discrete and light": (4, 1, 1, (1e-3, 1e-2), 0.1),
    "wide": (4, 5, 2, (0.1, 0.9), 0.0),
    "direct": (4, 2, 2, (0.1, 0.9), 0.0),
}
EACH = 20
WAYS = ("truncation", "residualisation", "hankel", "stochastic", "coprime")


def cases() -> Iterator[Case]:
    """Twenty models of each kind; six reductions of each way."""
    for kind in KINDS:
        yield Case(f"norms, {kind}", lambda kind=kind: {str(k): norms(model(kind, k)) for k in range(EACH)})
    for way in WAYS:
        yield Case(f"reductions, {way}", lambda way=way: {str(k): reduction(way, k) for k in range(6)})


def norms(m: Any) -> dict[str, Any]:
    """Peak gain and H2 norm; infinite for a direct term."""
    peak, h2 = rl.peak_gain(m), rl.h2_norm(m)
    return {
        "peak": {"lower": peak.lower, "upper": peak.upper, "frequency": peak.frequency, "status": peak.status},
        "h2": h2.value,
        "h2_status": h2.status,
    }


def reduction(way: str, k: int) -> dict[str, Any]:
    """The error of a model of half the order; stochastic wants a square direct term, coprime takes unstable models."""
    m = model(("medium", "large", "direct")[k % 3] if way != "stochastic" else "direct", 100 + k)
    found = rl.reduce_model(m, order=m.n_states // 2, method=way)
    error = found.error
    return {"status": found.status, "error": {"lower": error.lower, "upper": error.upper}, "bound": found.bound}


def model(kind: str, k: int) -> Any:
    """Modes over two decades in other states."""
    n, inputs, outputs, damping, dt = KINDS[kind]
    rng = seeds(4, list(KINDS).index(kind), k)
    A = np.diag(-(10 ** rng.uniform(-1, 1, n)))
    for i in range(0, n - 1, 2):
        omega, zeta = 10 ** rng.uniform(-1, 1), 10 ** rng.uniform(*np.log10(damping))
        A[i : i + 2, i : i + 2] = omega * np.array([[-zeta, 1.0], [-1.0, -zeta]])
    B, C = rng.standard_normal((n, inputs)), rng.standard_normal((outputs, n))
    if n % 2 and damping[1] < 0.1:
        A[-1, -1] = -1.0
    D = rng.standard_normal((outputs, inputs)) if kind == "direct" else np.zeros((outputs, inputs))
    if dt:
        inside = np.linalg.inv(np.eye(n) - dt / 2 * A)
        A, B = inside @ (np.eye(n) + dt / 2 * A), dt * inside @ B
    T = np.linalg.qr(rng.standard_normal((n, n)))[0] * 10 ** rng.uniform(-0.5, 0.5, n)
    back = np.linalg.inv(T)
    return rl.StateSpaceModel(T @ A @ back, T @ B, C @ back, D, dt)
