"""Questions next to a limit: how long they take, and whether both ends are true, judged by other means.

``python benchmarks/near_limits.py [gain|disk|delay] FIRST LAST``; CPU seconds of each call alone. Judges: members at
random and worst-case gains for robust gain margins, the members' own margins for disk margins, the eigenvalues of the
infinitesimal generator on Chebyshev points for delays.
"""

from __future__ import annotations

import sys
from collections import Counter
from typing import Any

import numpy as np
from harness import timed

import robustlab as rl


def attempted(call: Any) -> Any:
    """What a call returns, or the error that refuses it."""
    try:
        return call()
    except rl.RobustlabError as error:
        return error


def times(uncertain: rl.UncertainModel, size: float) -> rl.UncertainModel:
    M, q = uncertain.M, uncertain.delta_shape[0]
    grown = np.append(np.full(q, size), np.ones(M.n_inputs - q))
    return rl.UncertainModel(rl.StateSpaceModel(M.A, M.B * grown, M.C, M.D * grown, M.dt), uncertain.blocks)


def random_set(seed: int) -> tuple[rl.UncertainModel, np.random.Generator]:
    """All kinds of blocks, channels, direct terms, sample times."""
    rng = np.random.default_rng(1000 + seed)
    n = int(rng.integers(1, 6))
    A = rng.normal(size=(n, n))
    A -= (np.linalg.eigvals(A).real.max() + rng.uniform(0.05, 1)) * np.eye(n)
    blocks = [
        [rl.RealScalar("a")],
        [rl.RealScalar("a"), rl.RealScalar("b", 1 + seed // 6 % 2)],
        [rl.RealScalar("a"), rl.ComplexScalar("c")],
        [rl.FullBlock("f", 2, 1), rl.RealScalar("a")],
        [rl.RealScalar("a", parameter=rl.ParameterRange(1.0, 0.3, below=0.1)), rl.RealScalar("b")],
        [rl.RealScalar("a"), rl.RealScalar("b"), rl.RealScalar("c")],
    ][seed % 6]
    q, p = sum(b.rows for b in blocks), sum(b.cols for b in blocks)
    m, k = (int(rng.integers(1, 3)) for _ in range(2))
    size = 10.0 ** rng.uniform(-1, 0.5)
    B, C = rng.normal(size=(n, q + m)), rng.normal(size=(p + k, n))
    B[:, :q] *= size
    C[:p] *= size
    D = 0.1 * rng.normal(size=(p + k, q + m)) if rng.random() < 0.4 else np.zeros((p + k, q + m))
    dt = 0.1 if seed % 5 == 4 else 0.0
    A = A / (1.2 * max(1, np.abs(np.linalg.eigvals(A)).max())) if dt else A
    return rl.UncertainModel(rl.StateSpaceModel(A, B, C, D, dt), blocks), rng


def gain(seed: int) -> tuple[str, float, bool]:
    uncertain, rng = random_set(seed)
    level = rl.peak_gain(uncertain.nominal).upper * float(rng.choice([1.05, 1.5, 3.0, 20.0]))
    found, seconds = timed(attempted, lambda: rl.robust_gain(uncertain, level))
    if isinstance(found, rl.RobustlabError):
        return "refused", seconds, True
    true = True
    if 0 < found.lower < 1e5:
        inside = times(uncertain, found.lower * (1 - 1e-6))
        true = rl.peak_gain(inside, tolerance=0.05, effort=0.02).lower <= level * (1 + 1e-6)
    if 0 < found.upper < np.inf and all(b.interval for b in uncertain.blocks):
        member = attempted(lambda: uncertain.evaluate({k: float(np.real(v)) for k, v in found.delta.items()}))
        if not isinstance(member, rl.RobustlabError) and member.is_stable():
            true &= rl.peak_gain(member).upper >= level * (1 - 1e-6)
    return str(found.status), seconds, bool(true)


OSCILLATOR = {"k": (1, 0.2), "c": (0.2, 0.3)}


def disk(seed: int) -> tuple[str, float, bool]:
    """A controller whose gain brings the worst member to 1e-4 ... 5e-2 of its stability limit."""
    rng = np.random.default_rng(seed // 4)
    plant = rl.parametric([[0, 1], ["-k", "-c"]], [[0], [1]], [[1, 0]], [[0]], OSCILLATOR)
    pole, zero = 10.0 ** rng.uniform(-1, 1, size=2)
    sign, direct = float(rng.choice([1, -1])), float(rng.choice([0, 1]))

    def controller(g: float) -> rl.StateSpaceModel:
        return rl.StateSpaceModel([[-pole]], [[1.0]], [[sign * g * zero]], [[sign * g * direct]])

    def margin(g: float) -> float:
        found = attempted(lambda: rl.robust_stability(plant.feedback(controller(g))))
        return 0.0 if isinstance(found, rl.RobustlabError) else found.lower

    low, high = 0.0, 1.0
    while margin(high) > 1 and high < 1e4:
        low, high = high, 2 * high
    for _ in range(14 if high < 1e4 else 0):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if margin(middle) > 1 else (low, middle)
    K = controller(low * (1 - (1e-4, 1e-3, 1e-2, 5e-2)[seed % 4]))
    found, seconds = timed(attempted, lambda: rl.disk_margin(plant, K))
    if isinstance(found, rl.RobustlabError):
        return "refused", seconds, True
    members = [rl.disk_margin(plant.evaluate({"k": a, "c": b}), K).simultaneous.upper for a in (-1, 1) for b in (-1, 1)]
    return str(found.status), seconds, min(members) >= found.lower * (1 - 1e-6)


def rightmost(A: Any, parts: Any, delays: Any, order: int) -> float:
    """Breda, Maset, Vermiglio, SIAM J. Sci. Comput. 27 (2005)."""
    n, longest = len(A), max(delays)
    x = np.cos(np.pi * np.arange(order + 1) / order)
    c = np.hstack([2.0, np.ones(order - 1), 2.0]) * (-1.0) ** np.arange(order + 1)
    D = np.outer(c, 1 / c) / (x[:, None] - x[None, :] + np.eye(order + 1))
    D = 2.0 / longest * (D - np.diag(D.sum(axis=1)))
    made = np.kron(D, np.eye(n))
    made[:n] = 0.0
    made[:n, :n] = A
    weights = np.hstack([0.5, np.ones(order - 1), 0.5]) * (-1.0) ** np.arange(order + 1)
    for part, tau in zip(parts, delays, strict=True):
        off = -tau - longest * (x - 1.0) / 2.0
        at = (np.abs(off) < 1e-14).astype(float) if np.abs(off).min() < 1e-14 else weights / off
        made[:n] += np.kron(at / at.sum(), part)
    return float(np.linalg.eigvals(made).real.max())


def delay(seed: int) -> tuple[str, float, bool]:
    """One to three delays, each at its own input; the loop's gain is brought near the limit in every second case."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(1, 6)), int(rng.integers(1, 4))
    A = rng.normal(size=(n, n)) * 10.0 ** rng.uniform(-0.5, 0.7)
    A -= (np.linalg.eigvals(A).real.max() + rng.uniform(0.05, 0.5)) * np.eye(n)
    B, C = rng.normal(size=(n, m)), rng.normal(size=(m, n))
    delays = 10.0 ** rng.uniform(-2.0, 0.6, size=m)
    speed = float(np.abs(np.linalg.eigvals(A)).max() + np.linalg.norm(B @ C, 2)) * float(delays.max())
    order = int(min(60, 20 + 6 * speed))

    def root(g: float, order: int = order) -> float:
        return rightmost(A, [-g * np.outer(B[:, k], C[k]) for k in range(m)], delays, order)

    g = 1.0
    if seed % 2:
        low, high = 0.0, 64.0
        for _ in range(24 if root(high) > 0 else 0):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if root(middle) > 0 else (middle, high)
        g = low * (1 + float(rng.choice([-1, 1])) * 1e-4)
    plant = rl.StateSpaceModel(A, B, g * C, np.zeros((m, m)), inputs=[f"u{k}" for k in range(m)])
    loop = rl.with_delays(plant, inputs={f"u{k}": float(tau) for k, tau in enumerate(delays)}).feedback(np.eye(m))
    found, seconds = timed(attempted, lambda: rl.robust_stability(loop))
    if isinstance(found, rl.RobustlabError):
        return "refused", seconds, True
    one, two = root(g), root(g, int(1.3 * order))
    sure = abs(one - two) < 0.1 * abs(one)
    return str(found.status), seconds, found.stable is None or not sure or found.stable is (one < 0)


def main() -> None:
    what, first, last = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    call, statuses, seconds, wrong = {"gain": gain, "disk": disk, "delay": delay}[what], Counter[str](), [], []
    for seed in range(first, last):
        status, took, true = call(seed)
        statuses[status] += 1
        seconds.append(took)
        if not true:
            wrong.append(seed)
    middle, late = np.quantile(seconds, [0.5, 0.9])
    took = f"CPU median {middle:.2f} s, 90 % {late:.2f} s, most {max(seconds):.2f} s"
    print(f"{what:6s} {first} to {last - 1}: {dict(statuses)}, WRONG {wrong or 0}; {took}")


if __name__ == "__main__":
    main()
