"""Loops with delays next to their limit: how long the answer takes, and whether it is true, judged by other means.

``python benchmarks/near_limits.py FIRST LAST``; CPU seconds of each call alone. Judge: the eigenvalues of the
infinitesimal generator on Chebyshev points.
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
    first, last = int(sys.argv[1]), int(sys.argv[2])
    statuses, seconds, wrong = Counter[str](), [], []
    for seed in range(first, last):
        status, took, true = delay(seed)
        statuses[status] += 1
        seconds.append(took)
        if not true:
            wrong.append(seed)
    middle, late = np.quantile(seconds, [0.5, 0.9])
    took = f"CPU median {middle:.2f} s, 90 % {late:.2f} s, most {max(seconds):.2f} s"
    print(f"delay  {first} to {last - 1}: {dict(statuses)}, WRONG {wrong or 0}; {took}")


if __name__ == "__main__":
    main()
