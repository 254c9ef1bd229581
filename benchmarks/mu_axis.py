"""Margins, worst-case gains and one matrix: gap and CPU time of what is proved. ``python benchmarks/mu_axis.py``."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import Any

import mu_models
import numpy as np
from harness import heading, middle_and_most, timed

import robustlab as rl
from robustlab.budget import one_thread

CLASSES = {
    "12 states, 12 real": (12, 12, 1, (0.05, 0.7)),
    "12 states, 24 real": (12, 24, 1, (0.05, 0.7)),
    "12 states, 24 real each twice": (12, 24, 2, (0.05, 0.7)),
    "24 states, 12 real, damping 0.002 .. 0.02": (24, 12, 1, (0.002, 0.02)),
}


def model(states: int, count: int, repeats: int, damping: tuple[float, float], seed: int) -> rl.UncertainModel:
    """Random stable model with ``count`` real parameters, each ``repeats`` times."""
    blocks = [rl.RealScalar(f"d{i}", repeats) for i in range(count)]
    made, blocks = mu_models.random_model(states, blocks, damping, seed)
    return rl.UncertainModel(made, blocks)


def with_performance(uncertain: rl.UncertainModel, size: float, seed: int) -> rl.UncertainModel:
    """The set of this size with two inputs and two outputs added."""
    M, rng = uncertain.M, np.random.default_rng(seed)
    n, q, p = M.n_states, M.n_inputs, M.n_outputs
    B = np.hstack([M.B * size, rng.standard_normal((n, 2))])
    C = np.vstack([M.C, rng.standard_normal((2, n))])
    D = np.zeros((p + 2, q + 2))
    D[:p, :q] = M.D * size
    return rl.UncertainModel(rl.StateSpaceModel(M.A, B, C, D), uncertain.blocks)


def by_class(seeds: range, widths: tuple[int, ...], measure: Callable[[rl.UncertainModel, int], Any]) -> None:
    """One line per class: median and largest of what is measured of each model."""
    for name, given in CLASSES.items():
        rows = [measure(model(*given, seed), seed) for seed in seeds]
        cells = (middle_and_most(column) for column in zip(*rows, strict=True))
        print(f"{name:44s} " + " ".join(f"{c:>{w}s}" for c, w in zip(cells, widths, strict=True)), flush=True)


def margins(seeds: range, tolerance: float) -> None:
    """Gap with D, G alone and after branch and bound, CPU seconds."""

    def measure(uncertain: rl.UncertainModel, _: int) -> tuple[float, float, float]:
        alone = rl.robust_stability(uncertain, tolerance=np.inf)
        margin, spent = timed(rl.robust_stability, uncertain, tolerance=tolerance)
        return 100 * alone.gap, 100 * margin.gap, spent

    print(f"\nrobust_stability(tolerance={tolerance:g}), {len(seeds)} models a class")
    print(f"{'class':44s} {'D-G gap %: median  max':>24s} {'gap %: median  max':>22s} {'CPU s: median  max':>22s}")
    by_class(seeds, (24, 22, 22), measure)


CHAINS = ((12, 1, 0), (12, 2, 0), (12, 3, 0), (18, 2, 0), (18, 3, 0), (24, 2, 0), (24, 4, 0), (24, 6, 0))
MOTOR = {"R": 0.1, "L": 0.1, "Km": 0.05, "Kb": 0.05, "Kf": 0.35}
# Not looked at while the search was made: other dampings and numbers of repeats, graphs, the platform's motors.
NEW = {
    "platform legs, torque loops of damping 0.001": lambda: mu_models.platform_legs(MOTOR, 2086.632),
    "graph, 20 masses, 24 springs x 3, 1": lambda: mu_models.spring_graph(20, 24, 3, 1),
    "20 x 4, 1, damping 0.003": lambda: mu_models.chain(20, 4, 1, 0.003),
    "graph, 16 masses, 24 springs x 4, 2, 0.002": lambda: mu_models.spring_graph(16, 24, 4, 2, 0.002),
    "24 x 3, 5, damping 0.01": lambda: mu_models.chain(24, 3, 5, 0.01),
    "graph, 24 masses, 30 springs x 5, 3": lambda: mu_models.spring_graph(24, 30, 5, 3),
    "graph, 20 masses, 24 springs x 4, 7": lambda: mu_models.spring_graph(20, 24, 4, 7),
    "24 x 2, 11": lambda: mu_models.chain(24, 2, 11),
    "24 x 2, 12": lambda: mu_models.chain(24, 2, 12),
    "24 x 4, 11": lambda: mu_models.chain(24, 4, 11),
    "platform legs as the thesis has them": lambda: mu_models.platform_legs(MOTOR),
}


def chains(tolerance: float) -> None:
    """One line per lightly damped model: where the search for a small Delta decides the gap."""
    print(f"\nlightly damped, stiffnesses shared by several springs, robust_stability(tolerance={tolerance:g})")
    print(f"{'masses x springs of each parameter, seed':44s} {'margin':>20s} {'gap %':>8s} {'CPU s':>8s}")
    tuned = {f"{n} x {r}, {seed}": partial(mu_models.chain, n, r, seed) for n, r, seed in CHAINS}
    for name, made in {**tuned, **NEW}.items():
        uncertain = rl.UncertainModel(*made())
        margin, spent = timed(rl.robust_stability, uncertain, tolerance=tolerance)
        ends = f"{margin.lower:.4f} .. {margin.upper:.4f}"
        print(f"{name:44s} {ends:>20s} {100 * margin.gap:8.2f} {spent:8.1f}", flush=True)


def gains(seeds: range) -> None:
    """Worst-case gain of the same models at half their margin."""

    def measure(uncertain: rl.UncertainModel, seed: int) -> tuple[float, float]:
        size = 0.5 * rl.robust_stability(uncertain, tolerance=np.inf).lower
        worst, spent = timed(rl.peak_gain, with_performance(uncertain, size, seed))
        return 100 * worst.gap, spent

    print(f"\nworst_case_gain at half the margin, 2 x 2 performance channels, {len(seeds)} models a class")
    print(f"{'class':44s} {'gap %: median  max':>22s} {'CPU s: median  max':>22s}")
    by_class(seeds, (22, 22), measure)


def matrices(count: int) -> None:
    """One purely real matrix to 1 %."""
    print(f"\nmu(M, blocks, tolerance=0.01), random complex M, purely real, {count} matrices each")
    print(f"{'parameters':44s} {'D-G gap %: median  max':>24s} {'gap %: max':>12s} {'CPU s: median  max':>22s}")
    rng = np.random.default_rng(0)
    for n in (4, 8, 12, 16):
        rows = []
        for _ in range(count):
            M = rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n))
            bounds, spent = timed(rl.mu, M, [[-1, 0]] * n, tolerance=0.01)
            if bounds.lower > 0:
                rows.append((100 * (bounds.scaled / bounds.lower - 1), 100 * (bounds.upper / bounds.lower - 1), spent))
        ends, gaps, times = zip(*rows, strict=True)
        name = f"{n} ({len(rows)} with mu > 0 found)"
        text = f"{middle_and_most(ends):>24s} {max(gaps):12.3f} {middle_and_most(times):>22s}"
        print(f"{name:44s} {text}", flush=True)


def published() -> None:
    made, blocks = mu_models.two_mass()
    margin = rl.robust_stability(rl.UncertainModel(made, blocks))
    ends = f"{margin.lower:.6f} .. {margin.upper:.6f} at {margin.frequency:.3f} rad/s"
    print(f"\ntwo-mass (MathWorks; truth 2.88636): {ends}")
    lag = rl.StateSpaceModel([[-1.0]], [[-0.5, 1.0]], [[-1.0], [1.0]], [[-0.5, 1.0], [0.0, 0.0]])
    tau = rl.RealScalar("tau", parameter=rl.ParameterRange(1.0, 0.5, "s", below=0.25))
    margin = rl.robust_stability(rl.UncertainModel(lag, [tau]))
    print(f"1/(tau s + 1), tau in [0.75, 1.5] around 1 (truth 4): {margin.lower:.6f} .. {margin.upper:.6f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--tolerance", type=float, default=0.01)
    parser.add_argument("--chains", action="store_true", help="only the lightly damped models, to 5 %%")
    given = parser.parse_args()
    print(heading("numpy", "scipy"))
    rl.robust_stability(model(4, 2, 1, (0.05, 0.7), 0))  # compiled kernels are not timed
    if given.chains:
        chains(0.05)
        return
    published()
    matrices(4 * given.seeds)
    margins(range(given.seeds), given.tolerance)
    gains(range(given.seeds))


if __name__ == "__main__":
    with one_thread():
        main()
