"""What is proved of sampled uncertain loops against members of the set, each with its own exact discretisation.

    python benchmarks/sampled_robustness.py --out benchmarks/results/sampled_robustness.txt

Random plants of 2 to 4 states with 1 or 2 real parameters (1 or 2 repetitions each, some ranges wider on one side), in
turn without direct terms, with them, and with parameters that reach the sampler; sample times of 0.02, 0.1, 0.3 s;
delays of 0, 0.5, 1, 1.3 sample times. `sampled_robustness` proves a margin; then random members and corners of exactly
that size (times 0.9999) are discretised one by one (matrix exponentials, past controls as states) and closed: none may
be unstable, and no sampled-data norm of a member may exceed the proved bound. "ratio": proved over attained mu.
"""

from __future__ import annotations

import argparse
import datetime
import time
from pathlib import Path

import numpy as np
from scipy.linalg import expm

import robustlab as rl
from robustlab.statespace import lower_lft

MEMBERS, NORMS = 100, 6


def plant(kind: int, rng: np.random.Generator) -> rl.UncertainModel:
    """A random plant: kind 0 without direct terms, 1 with them, 2 with parameters and noise at the sampler."""
    n = int(rng.integers(2, 5))
    A = rng.normal(size=(n, n))
    A -= (np.linalg.eigvals(A).real.max() + rng.uniform(-0.3, 1.0)) * np.eye(n)
    repeats = [int(rng.integers(1, 3)) for _ in range(rng.integers(1, 3))]
    q = sum(repeats)
    B, C, D = rng.normal(size=(n, q + 3)), rng.normal(size=(q + 3, n)), np.zeros((q + 3, q + 3))
    B[:, :q] *= 0.3
    if kind >= 1:
        D[: q + 2, : q + 2] = 0.15 * rng.normal(size=(q + 2, q + 2))
        D[q : q + 2, -1] = 0.3
    if kind == 2:
        D[:q, q : q + 2] = 0.0
        D[-1, :q] = 0.2 * rng.normal(size=q)
        D[-1, q + 1] = 0.3
    wide = [rl.ParameterRange(1.0, 1.0, "", rng.uniform(0.5, 1.5)) if rng.random() < 0.3 else None for _ in repeats]
    blocks = [rl.RealScalar(f"d{i}", r, w) for i, (r, w) in enumerate(zip(repeats, wide, strict=True))]
    return rl.UncertainModel(rl.StateSpaceModel(A, B, C, D), blocks)


def spectral_radius(P: rl.StateSpaceModel, K: rl.StateSpaceModel, delay: float) -> float:
    """Of the sampled loop of one member, by hand: two matrix exponentials and a queue of controls."""
    n, dt = P.n_states, K.dt
    whole = int(delay / dt + 1e-12)
    part = delay - whole * dt

    def held(h: float) -> tuple[np.ndarray, np.ndarray]:
        block = np.zeros((n + 1, n + 1))
        block[:n, :n], block[:n, n] = P.A, P.B[:, -1]
        moved = expm(block * h)
        return moved[:n, :n], moved[:n, n]

    past = whole + 1
    A, B = np.zeros((n + past, n + past)), np.zeros((n + past, 1))
    A[:n, :n] = held(dt)[0]
    late, rest = held(part)[1], held(dt - part)
    A[:n, n + whole] = rest[0] @ late
    if whole:
        A[:n, n + whole - 1] = rest[1]
    else:
        B[:n, 0] = rest[1]
    B[n, 0] = 1.0
    A[n + 1 :, n:-1] += np.eye(past - 1)
    C = np.hstack([P.C[-1:], np.zeros((1, past))])
    loop = lower_lft(rl.StateSpaceModel(A, B, C, [[0.0]], dt), K)
    return float(np.abs(loop.poles()).max())


def stabilising(uncertain: rl.UncertainModel, dt: float, delay: float, rng: np.random.Generator):
    """A first-order lag and a gain that stabilise the nominal plant; None where the draws hold none."""
    for gain in (0.0, *rng.normal(size=20)):
        K = rl.StateSpaceModel([[0.5]], [[1.0]], [[0.3 * gain]], [[gain]], dt)
        if spectral_radius(uncertain.nominal, K, delay) < 0.99:
            return K
    return None


def case(seed: int) -> tuple[str, float, int] | None:
    """A line, the ratio of proved to attained, and the number of violations."""
    rng = np.random.default_rng(seed)
    uncertain = plant(seed % 3, rng)
    dt = float(rng.choice([0.02, 0.1, 0.3]))
    delay = float(rng.choice([0.0, 0.5, 1.0, 1.3])) * dt
    K = stabilising(uncertain, dt, delay, rng)
    if K is None:
        return None
    start = time.process_time()
    robust = rl.sampled_robustness(uncertain, K, delay=delay)
    spent = time.process_time() - start
    violations = 0
    for i in range(MEMBERS):
        draw = {b.name: rng.uniform(-1, 1) if i % 2 else rng.choice([-1.0, 1.0]) for b in uncertain.blocks}
        at_edge = uncertain.evaluate({name: 0.9999 * robust.stability.lower * v for name, v in draw.items()})
        violations += spectral_radius(at_edge, K, delay) >= 1
        if i < NORMS:
            member = uncertain.evaluate({name: 0.9999 * robust.margin * v for name, v in draw.items()})
            norm = rl.sampled_data_norm(member, K, delay=delay, n_meas=1, n_con=1, rtol=0.05)
            violations += norm.lower > robust.mu_upper * (1 + 1e-9)
    ratio = robust.mu_upper / robust.mu_lower
    sizes = ",".join(str(b.repeats) for b in uncertain.blocks)
    shown = robust.stability
    line = (
        f"{seed:4d} {seed % 3:4d} {dt:6.2f} {delay / dt:6.1f} {sizes:>7s} {robust.mu_lower:10.4f}"
        f" {robust.mu_upper:10.4f} {ratio:7.4f} {shown.lower:9.4f} {shown.upper:9.4f} {robust.degree:6d}"
        f" {violations:5d} {spent:6.1f}  {robust.status}"
    )
    return line, ratio, violations


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=24)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    lines = [
        f"{datetime.date.today()}, robustlab, CPU time of one process on a loaded machine",
        f"{MEMBERS} members a case at the edge of the proved stability, {NORMS} at that of the proved performance",
        "seed kind     dt  delay repeats   attained     proved   ratio  stable to, unstable at  degree  viol.  CPU s",
    ]
    print("\n".join(lines), flush=True)
    ratios, violations, seed = [], 0, 0
    while len(ratios) < options.cases:
        found = case(seed)
        seed += 1
        if found is None:
            continue
        line, ratio, violated = found
        ratios.append(ratio)
        violations += violated
        lines.append(line)
        print(line, flush=True)
    lines.append(
        f"{len(ratios)} cases, {violations} violations; proved over attained mu: median {np.median(ratios):.4f}, "
        f"largest {max(ratios):.4f}"
    )
    print(lines[-1])
    if options.out:
        options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
