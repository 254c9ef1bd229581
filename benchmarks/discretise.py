"""What a digital controller loses on a flexible chain, by method and sample rate, in the norm of the sampled loop.

    python benchmarks/discretise.py

Free chains of equal masses and springs, damping ratio 0.5 %, force on the first mass. A disturbance force acts on the
measured mass; the measurement is noisy; position and control are to be small. The continuous controller is `hinf`'s;
omega_c is its highest gain crossover. Loss: proved upper bound of the sampled-data norm (between samples too) over the
norm of the continuous loop, minus one. "-": the sampled loop is not stable.
"""

from __future__ import annotations

import time

import numpy as np

from robustlab.linear_analysis.frequency import frequency_response
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.hinf.hinf_synthesis import hinf
from robustlab.synthesis.problem.partition import GeneralizedPlant
from robustlab.synthesis.sampled.sampled_controller import discretise

RATIOS = (6, 12, 20, 30, 60)
METHODS = ("tustin", "tustin-prewarp", "zoh", "foh", "matched", "direct")
DAMPING = 0.005


def chain(masses: int, measured: int, effort: float, noise: float) -> GeneralizedPlant:
    """Inputs force, noise, u; outputs position, effort, y."""
    n = masses
    stiffness = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    stiffness[0, 0] = stiffness[-1, -1] = 1.0
    squares, modes = np.linalg.eigh(stiffness)
    damping = modes @ np.diag(2 * DAMPING * np.sqrt(np.maximum(squares, 0))) @ modes.T
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -damping]])
    B, C = np.zeros((2 * n, 3)), np.zeros((3, 2 * n))
    B[n + measured, 0] = B[n, 2] = C[0, measured] = C[2, measured] = 1.0
    D = np.array([[0, 0, 0], [0, 0, effort], [0, noise, 0]])
    names = ["force", "noise", "u"], ["position", "effort", "y"]
    return GeneralizedPlant(StateSpaceModel(A, B, C, D, 0.0, *names), 1, 1)


def crossover(plant: GeneralizedPlant, K: StateSpaceModel) -> float:
    omega = np.geomspace(1e-3, 1e2, 4000)
    loop = frequency_response(plant.model, omega)[:, 2, 2] * frequency_response(K, omega)[:, 0, 0]
    return float(omega[np.abs(loop) > 1].max())


def main() -> None:
    for title, plant in (
        ("4 masses, measured at the far end", chain(4, 3, 0.1, 0.1)),
        ("4 masses, measured where the force acts", chain(4, 0, 1.0, 0.1)),
        ("6 masses, measured at the far end", chain(6, 5, 0.1, 0.1)),
    ):
        design = hinf(plant)
        omega_c = crossover(plant, design.K)
        print(f"{title}: gamma {design.gamma:.4f}, omega_c {omega_c:.3f} rad/s, K has {design.K.n_states} states")
        print(f"  omega_s/omega_c  {'  '.join(f'{name:>14s}' for name in METHODS)}  CPU s")
        for ratio in RATIOS:
            start = time.process_time()
            dt = 2 * np.pi / (ratio * omega_c)
            losses = {}
            for method in METHODS:  # each by itself: none is cut short because another is better
                try:
                    found = discretise(design, dt, method=method)
                    losses[method] = f"{100 * found.loss:.2f} %"
                except ArithmeticError:  # not stable
                    losses[method] = "-"
                except ValueError:  # the peak to prewarp at lies beyond the Nyquist frequency
                    losses[method] = "no"
            cpu = time.process_time() - start
            print(f"  {ratio:15d}  {'  '.join(f'{losses[name]:>14s}' for name in METHODS)}  {cpu:.1f}", flush=True)


if __name__ == "__main__":
    main()
