"""The Stewart platform's speed: medians of wall time, one thread; what the targets ask for stands beside it."""

from __future__ import annotations

import statistics
import time

import numpy as np

import robustlab as rl
from robustlab.dynamics.plant_contract import input_signal
from robustlab.dynamics.stewart import direct_kinematics, inverse_kinematics, linear_models, workspace_grid
from robustlab.dynamics.stewart.kinematics import kernels, motion_kernels


def median(run, times: int = 25) -> float:
    run()
    spent = []
    for _ in range(times):
        start = time.perf_counter()
        run()
        spent.append(time.perf_counter() - start)
    return statistics.median(spent)


def line(name: str, value: float, unit: str, target: str) -> None:
    print(f"{name:58} {value:12.4g} {unit:8} target {target}")


def main() -> None:
    start = time.perf_counter()
    kernels(), motion_kernels()
    line("kernels ready (compiled once, then read from disk)", time.perf_counter() - start, "s", "-")

    plant = rl.plant("stewart-platform")
    g, rng = plant.geometry, np.random.default_rng(0)
    pose, trim = g.home + np.array([0.002, 0.0, 0.001, 0.01, 0.0, 0.02]), rl.trim(plant)
    line(
        "linearise at a pose, with trim and all checks",
        1e3 * median(lambda: rl.linearise(plant, at=pose), 200),
        "ms",
        "<= 0.5",
    )
    moving = (np.concatenate([trim.x[:6], 20 * rng.normal(size=6)]), trim.u)
    line("linearise at a moving point", 1e3 * median(lambda: rl.linearise(plant, at=moving), 200), "ms", "<= 0.5")

    wide = plant.with_parameters(L_min=0.1, L_max=0.25)
    n = 1000
    poses = g.home + rng.uniform(-1, 1, (n, 6)) * [0.005, 0.005, 0.005, 0.03, 0.03, 0.05]
    masses = {k: plant.values[k] * rng.uniform(0.9, 1.1, n) for k in ("platform_mass", "link_mass", "motor_mass")}
    line(
        "1000 linearisations over masses and poses", median(lambda: linear_models(plant, poses, masses)), "s", "<= 0.5"
    )

    def one_by_one() -> None:
        for k in range(100):
            other = wide.with_parameters(**{name: values[k] for name, values in masses.items()})
            rl.linearise(other, at=poses[k])

    line("the same, a new plant each time (from 100)", 10 * median(one_by_one, 5), "s", "<= 0.5")

    twists, torques = 0.1 * rng.normal(size=(n, 6)), 1e-3 * rng.normal(size=(n, 6))
    constants, out = np.repeat(plant.constants[None], n, axis=0), [np.empty((n, 6)) for _ in range(3)]
    run = median(lambda: kernels().forward_dynamics(poses, twists, torques, g.legs, constants, *out))
    line("forward dynamics, batched", 1e6 * run / n, "us", "<= 20")

    t = np.linspace(0, 1, 1001)
    for name, u in (
        ("released from 1.01 times the holding torque", np.repeat(1.01 * trim.u[None], 1001, axis=0)),
        ("sine 2 Hz, 0.01 mN m, six phases", trim.u + 1e-5 * np.sin(4 * np.pi * t[:, None] + np.arange(6))),
        ("sine 20 Hz, 1 mN m on all motors", trim.u + 1e-3 * np.sin(40 * np.pi * t)[:, None]),
    ):
        run = median(lambda u=u: rl.simulate(wide, t, u, trim, hold="spline"))
        line(f"one second at rtol 1e-8: {name}", 1e3 * run, "ms", "<= 8")
        signal = input_signal(t, u, "spline")
        run = median(lambda signal=signal: wide.trajectory(signal, trim.x, rtol=1e-8))
        line("  of it the integrator", 1e3 * run, "ms", "-")

    many = np.tile(poses, (1000, 1))
    line("inverse kinematics", len(many) / median(lambda: inverse_kinematics(g, many), 5), "poses/s", ">= 1e6")
    grid = workspace_grid(g, 11)
    lengths = inverse_kinematics(g, grid)
    run = median(lambda: direct_kinematics(g, lengths), 5)
    found = direct_kinematics(g, lengths)
    line(f"direct kinematics from home, grid of {len(grid)} poses", 1e6 * run / len(grid), "us", "<= 50")
    line("  of them proved", 100 * found.proved.mean(), "%", "100")
    line("  largest error", float(np.abs(found.poses - grid).max()), "m, rad", "-")
    line(
        "direct kinematics of one pose, called from Python",
        1e6 * median(lambda: direct_kinematics(g, lengths[0]), 200),
        "us",
        "<= 50",
    )


if __name__ == "__main__":
    main()
