"""Robust stability and worst-case gain of models, with their gaps; margins of loops."""

from collections.abc import Iterator
from typing import Any

import numpy as np

import robustlab as rl

from .bounds import structure
from .cases import ROOT, Case, seeds

RTOL = 1e-3


def cases() -> Iterator[Case]:
    """Yield seventeen sets, each with its margin and its worst gain; loops; distances."""
    for plant, (output, ranges) in PLANTS.items():
        yield Case(plant, lambda p=plant, o=output, r=ranges: both(rl.plant(p, **r).uncertain(outputs=[o])),
                   plant in ("mass-spring-damper", "servo-axis"))  # fmt: skip
    for kind in ("real", "mixed", "mixed full", "complex", "full", "real x2"):
        for n, states in ((2, 4), (4, 6)):
            yield Case(f"{kind} {n}", lambda kind=kind, n=n, states=states: both(random_model(kind, n, states)), n > 2)
    yield Case("real 6, light damping", lambda: both(random_model("real", 6, 12, (0.002, 0.02))), True)
    yield Case("loops", loops)
    yield Case("distances", distances)


# Plant -> an output that does not drift, and ranges: nominal value, share.
PLANTS = {
    "dc-motor": ("omega", {"R": (2.07, 0.1), "Kf": (4.8e-5, 0.35), "J": (7.2e-6, 0.1)}),
    "servo-axis": ("v", {"M": (95.0, 0.25), "Fv": (200.0, 0.25)}),
    "linear-actuator": ("omega", {"R": (2.07, 0.1), "Kf": (4.8e-5, 0.35), "m_cart": (0.53, 0.5)}),
    "mass-spring-damper": ("q", {"m": (2.0, 0.1), "c": (1.5, 0.25), "k": (8.0, 0.25)}),
}


def both(uncertain: Any) -> dict[str, Any]:
    """How much of the set is stable, and the worst gain of a member."""
    found = {"margin": rl.robust_stability(uncertain), "gain": rl.peak_gain(uncertain)}
    return {key: {"status": f.status, "lower": f.lower, "upper": f.upper} for key, f in found.items()}


def random_model(kind: str, n: int, states: int, damping: tuple[float, float] = (0.05, 0.7)) -> Any:
    """Oscillators over two decades, mixed by a random map, with one input, one output and the blocks' channels."""
    blocks, rng = structure(kind, n), seeds(3, n, len(kind), states)
    q, p = sum(b.rows for b in blocks) + 1, sum(b.cols if hasattr(b, "cols") else b.rows for b in blocks) + 1
    omega = 10 ** rng.uniform(-1, 1, states // 2)
    zeta = 10 ** rng.uniform(*np.log10(damping), states // 2)
    A = np.zeros((states, states))
    for i, (w, z) in enumerate(zip(omega, zeta, strict=True)):
        A[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[-z * w, w], [-w, -z * w]]
    mix = np.eye(states) + 0.3 * rng.standard_normal((states, states)) / np.sqrt(states)
    root, back = np.repeat(np.sqrt(omega), 2), np.linalg.inv(mix)
    B, C = rng.standard_normal((states, q)) * root[:, None], rng.standard_normal((p, states)) * root
    # A set of which about every third is stable as a whole.
    size = 0.3 * np.sqrt(zeta.min())
    D = 0.1 * rng.standard_normal((p, q))
    scale_in, scale_out = np.r_[np.full(q - 1, size), 1.0], np.r_[np.full(p - 1, size), 1.0]
    M = rl.StateSpaceModel(mix @ A @ back, mix @ B * scale_in, scale_out[:, None] * (C @ back), D * scale_out[:, None])
    return rl.UncertainModel(M, blocks)


def loops() -> dict[str, Any]:
    """Disk and classical margins of a motor under a PI controller, negative feedback."""
    G = rl.load(ROOT / "models" / "motor_nominal.h5")
    speed = rl.StateSpaceModel(G.A, G.B, G.C[:1], G.D[:1])
    K = rl.StateSpaceModel([[0.0]], [[1.0]], [[5.0]], [[0.05]])
    disk, classic = rl.disk_margin(speed, K, sign=-1), rl.classical_margins(speed, K, sign=-1)
    return {
        "disk": {"status": disk.status, "lower": disk.lower, "upper": disk.upper},
        "classical": {"gain": [classic.gain_low, classic.gain_high], "phase": classic.phase, "delay": classic.delay},
    }


def distances() -> dict[str, Any]:
    """nu-gap of two motors."""
    first, second = (rl.load(ROOT / "models" / f"motor_{name}.h5") for name in ("nominal", "perturbed"))
    found = rl.nu_gap(first, second)
    return {"nu": {"status": found.status, "lower": found.lower, "upper": found.upper}}
