"""Robust stability and worst-case gain of models, with their gaps; margins of loops."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

import robustlab as rl

from .bounds import structure
from .cases import ROOT, Case, seeds

RTOL = 1e-3
RTOLS = {"frequency": 1e-2}


def cases() -> Iterator[Case]:
    """Twenty models, each asked for its margin and its worst gain; loops; distances."""
    for plant, (output, ranges) in PLANTS.items():
        yield Case(plant, lambda p=plant, o=output, r=ranges: both(rl.plant(p, **r).uncertain(outputs=[o])),
                   plant in ("mass-spring-damper", "servo-axis"))  # fmt: skip
    yield Case("two masses, published", lambda: margin(two_mass()))
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
    """The margin, and the gain where every member is stable."""
    return margin(uncertain) | gain(uncertain)


def margin(uncertain: Any) -> dict[str, Any]:
    """How much of the set is stable."""
    found = rl.robust_stability(uncertain)
    return {"margin": {"status": found.status, "lower": found.lower, "upper": found.upper}}


def gain(uncertain: Any) -> dict[str, Any]:
    """The worst gain of a member."""
    if uncertain.M.n_inputs == sum(b.cols if hasattr(b, "cols") else b.rows for b in uncertain.blocks):
        return {}
    found = rl.peak_gain(uncertain)
    return {"gain": {"status": found.status, "lower": found.lower, "upper": found.upper}}


def random_model(kind: str, n: int, states: int, damping: tuple[float, float] = (0.05, 0.7)) -> Any:
    """Oscillators over two decades, mixed by a random map, with one input and output beside the blocks' channels."""
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


def two_mass() -> Any:
    """MathWorks: two masses and a spring, 20 %, under 100 ((s + 1)/(0.001 s + 1))^3; published 2.8826 .. 2.8864."""
    A = np.array([[0, 1, 0, 0], [-1, 0, 1, 0], [0, 0, 0, 1], [1, 0, -1, 0]], dtype=float)
    B = np.zeros((4, 4))
    B[1], B[3] = [-0.2, 0, -0.2, 1], [0, -0.2, 0.2, 0]
    C = np.array([A[1], A[3], [1, 0, -1, 0], [0, 0, 1, 0]])
    D = np.array([B[1], B[3], [0] * 4, [0] * 4])
    Ak, Bk, Ck, Dk = -1000.0 * np.eye(3), np.zeros((3, 1)), np.zeros((1, 3)), 100.0 * 1000.0**3
    for i in range(3):
        Ak[i, :i] = -999000.0 * 1000.0 ** np.arange(i - 1, -1, -1)
        Bk[i, 0], Ck[0, i] = 1000.0**i, -100.0 * 999000.0 * 1000.0 ** (2 - i)
    loop = np.block([[A - B[:, 3:] * Dk @ C[3:], -B[:, 3:] @ Ck], [Bk @ C[3:], Ak]])
    B_all = np.vstack([B[:, :3], Bk @ D[3:, :3]])
    C_all = np.hstack([C[:3] - D[:3, 3:] * Dk @ C[3:], -D[:3, 3:] @ Ck])
    return rl.UncertainModel(rl.StateSpaceModel(loop, B_all, C_all, D[:3, :3]), [rl.RealScalar(k) for k in "abc"])


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
