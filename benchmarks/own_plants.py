"""Plants of one's own: what a second of motion and many linear models cost; medians of CPU time, one thread.

``python benchmarks/own_plants.py`` prints the lines of ``benchmarks/results/own_plants.txt``.
"""

from __future__ import annotations

import statistics
import time

import casadi as ca
import numpy as np
from harness import heading, timed

import robustlab as rl


def chain(links: int = 6, **given):
    """Pendulum of point masses on rigid rods in a plane, by their absolute angles: 12 states and a full mass matrix."""
    p = rl.PlantEquations("chain")
    m = [p.parameter(f"m_{k}", 1.0 - 0.1 * k, "kg") for k in range(links)]
    length = [p.parameter(f"l_{k}", 0.5 - 0.05 * k, "m") for k in range(links)]
    g = p.parameter("g", 9.81, "m/s2")
    torque = p.input("torque", "N m")
    q, w = zip(*(p.joint(f"q_{k}", f"w_{k}", "rad") for k in range(links)), strict=True)
    below = [sum(m[k:]) for k in range(links)]
    arm = [[below[max(i, j)] * length[i] * length[j] for j in range(links)] for i in range(links)]
    turned = range(links)
    mass = [[arm[i][j] * ca.cos(q[i] - q[j]) for j in turned] for i in turned]
    force = [-sum(arm[i][j] * ca.sin(q[i] - q[j]) * w[j] ** 2 for j in turned) for i in turned]
    for i in turned:
        force[i] = force[i] - below[i] * g * length[i] * ca.sin(q[i])
    force[0] = force[0] + torque
    p.motion(mass, force)
    for k in turned:
        p.output(f"q_{k}", q[k], "rad")
    return p.plant(**given)


START = np.ravel([[angle, 0.0] for angle in np.linspace(0.5, 2.0, 6)])


def median(run, times: int = 25) -> float:
    run()
    return statistics.median(timed(run)[1] for _ in range(times))


def line(name: str, value: float, unit: str, target: str = "-") -> None:
    print(f"{name:66} {value:10.4g} {unit:4} target {target}")


def main() -> None:
    print(heading("numpy", "casadi", "numba"))
    start = time.perf_counter()
    plant = chain()
    line("chain of 6 links, 12 states: equations to tapes", 1e3 * (time.perf_counter() - start), "ms")
    for name in ("rates", "models"):
        line(f"  operations of the tape of {name}", len(getattr(plant.equations, name).operations), "")
    t = np.linspace(0.0, 1.0, 1001)
    wave = np.sin(20 * t)
    cases = (("no torque", 0 * t, "zoh"), ("sine, held for 1 ms each", wave, "zoh"), ("sine, spline", wave, "spline"))
    for name, u, hold in cases:
        spent = median(lambda u=u, hold=hold: rl.simulate(plant, t, u, START, hold=hold))
        line(f"one second at rtol 1e-8, 1001 samples: {name}", 1e3 * spent, "ms", "<= 20")
    rng = np.random.default_rng(0)
    x, u = rng.normal(size=(5000, 12)), np.zeros((5000, 1))
    line("5000 linear models along a motion", 1e3 * median(lambda: plant.local_models(x, u), 7), "ms")
    values = {"m_0": rng.uniform(0.9, 1.1, 5000)}
    line("  each at a mass of its own", 1e3 * median(lambda: plant.local_models(x, u, values), 7), "ms")
    line("one linear model at a trim", 1e3 * median(lambda: rl.linearise(plant), 50), "ms")


if __name__ == "__main__":
    main()
