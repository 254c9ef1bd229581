"""Worst-case search against brute force: random stable sets of six real parameters, D11 not zero, every metric.

Brute force: all 3^6 points of the lattice {-1, 0, 1}^6 and 6000 random ones, about ten times the search's own points.

    python benchmarks/worst_case.py
"""

from __future__ import annotations

import itertools
import os
import time

import numpy as np

import robustlab as rl
from robustlab.worst_case_analysis import METRICS, MetricRequest
from robustlab.worst_case_analysis.draws import RealSet
from robustlab.worst_case_analysis.metrics import make_metric

T = np.linspace(0, 15, 301)
SETS = 6


def family(seed, n=4, q=6):
    """A set with n states and q parameters."""
    rng = np.random.default_rng(seed)
    a = rng.standard_normal((n, n))
    a -= (np.linalg.eigvals(a).real.max() + 0.5) * np.eye(n)
    d = np.zeros((q + 1, q + 1))
    d[:q, :q] = 0.1 * rng.standard_normal((q, q))
    b = np.hstack([0.15 * rng.standard_normal((n, q)), rng.standard_normal((n, 1))])
    c = np.vstack([0.15 * rng.standard_normal((q, n)), rng.standard_normal((1, n))])
    return rl.UncertainModel(rl.StateSpaceModel(a, b, c, d), [rl.RealScalar(f"p{k}") for k in range(q)])


def gap(metric, seed, points):
    """(brute force's worst over the search's in percent, CPU seconds of the search, evaluations, its status)."""
    model, u = family(seed), np.ones((len(T), 1))
    judge = make_metric(model, MetricRequest(metric, t=T, u=u))
    brute = (judge.sense * judge.of(RealSet(judge.uncertain).members(points))).max()
    started = time.process_time()
    found = rl.worst_case(model, metric, t=T, u=u, seed=1)
    seconds = time.process_time() - started
    ours = judge.sense * found.search_value
    same = ours == brute or (not np.isfinite(ours) and not np.isfinite(brute))
    return 0.0 if same else 100 * (brute - ours) / abs(brute), seconds, found.evaluations, str(found.status)


def main():
    """Print the table."""
    rng = np.random.default_rng(0)
    points = np.vstack([list(itertools.product([-1.0, 0.0, 1.0], repeat=6)), rng.uniform(-1, 1, (6000, 6))])
    print(f"# {time.strftime('%Y-%m-%d')}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, {SETS} sets each")
    print("# a positive gap: brute force found worse; a negative one: the search did")
    print("metric               largest gap %   smallest gap %   mean cpu s   evaluations   status")
    for metric in METRICS:
        rows = [gap(metric, seed, points) for seed in range(SETS)]
        gaps, seconds, evaluations, states = (list(column) for column in zip(*rows, strict=True))
        print(
            f"{metric:20s} {max(gaps):13.2e} {min(gaps):16.2e} {np.mean(seconds):12.2f} "
            f"{int(np.mean(evaluations)):13d}   {', '.join(sorted(set(states)))}",
            flush=True,
        )


if __name__ == "__main__":
    main()
