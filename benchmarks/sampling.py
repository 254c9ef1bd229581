"""Responses of uncertain Stewart platforms: seconds and memory for 1000 and 10 000 samples.

The platform of the thesis (12 states, 6 torques, 12 outputs) linearised at two heights, every entry that changes an
uncertain parameter of its own (72), 500-point responses of all 12 outputs. Peer: model by model with scipy.

    python benchmarks/sampling.py
"""

from __future__ import annotations

import os
import platform
import resource
import sys
import time

import numpy as np
import scipy

import robustlab as rl

POINTS, T_END = 500, 0.058


def uncertain_platform():
    """The element-wise set between home and 20 mm lower."""
    plant = rl.plant("stewart-platform", preset="thesis")
    home, low = (rl.linearise(plant, at=[0, 0, z, 0, 0, 0]) for z in (0.1262, 0.1062))
    return rl.elementwise(home, low)


def timed(run):
    """Result, CPU seconds, elapsed seconds."""
    cpu, clock = time.process_time(), time.monotonic()
    found = run()
    return found, time.process_time() - cpu, time.monotonic() - clock


def peak_mb():
    """Largest memory of this process so far, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def peer(model, t, u, count):
    """scipy.signal, one member after the other."""
    from scipy.signal import cont2discrete, dlsim

    for delta in rl.sample(model, count, 1).deltas:
        m = model.evaluate(delta)
        discrete = cont2discrete((m.A, m.B, m.C, m.D), t[1])
        dlsim((*discrete[:4], t[1]), u)


def main(counts: list[int]) -> None:
    """Print the table."""
    model = uncertain_platform()
    t = np.linspace(0.0, T_END, POINTS)
    u = np.tile(0.1 * np.sin(2 * np.pi * 2 * t)[:, None], 6)
    versions = f"Python {platform.python_version()}, numpy {np.__version__}, scipy {scipy.__version__}"
    print(f"# {time.strftime('%Y-%m-%d')}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, {versions}")
    print(f"# memory before: {peak_mb():.0f} MB")
    print("what                                     samples    cpu s   elapsed s   peak MB   us a sample")
    for count in counts:
        _, cpu, clock = timed(lambda n=count: rl.sample(model, n, 1).respond(t, u))
        row("responses of all members", count, cpu, clock)
    _, cpu, clock = timed(lambda: peer(model, t, u, 50))
    row("scipy.signal, model by model", 50, cpu, clock)


def row(what, count, cpu, clock):
    """One line."""
    print(f"{what:40s} {count:8d} {cpu:8.2f} {clock:11.2f} {peak_mb():9.0f} {1e6 * cpu / count:13.1f}")


if __name__ == "__main__":
    main([int(text) for text in sys.argv[1:]] or [1000, 10_000])
