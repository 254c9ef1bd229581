"""The controllers of a finished `robustlab run flagship` on the jig's own program: other equations, other integrator.

    python benchmarks/flagship_referee.py out/flagship

Runs the right-hand side of recipes/data/make_jig_record.py (LuGre friction, drop of the driver, true parameters) in
classical Runge-Kutta steps of 20 us under each controller, sampled and held at 10 kHz, with noise on what it sees.
"""

from __future__ import annotations

import json
import math
import runpy
import sys
from pathlib import Path

import numba
import numpy as np

import robustlab as rl
from robustlab.dynamics.simulation import transition

ROOT = Path(__file__).parents[1]
AMPLITUDE, OMEGA, STEP, SUB = 7.3603, math.pi, 1e-4, 5  # rad of the motor, rad/s, s
MM = 0.067932  # of the cart per rad of the motor
NOISE = np.array([0.0, 5e-4, 0.05, 5e-3])  # reference, rad, rad/s, A

JIG = runpy.run_path(str(ROOT / "recipes/data/make_jig_record.py"), init_globals={"__name__": "jig"})
RATES = numba.njit(JIG["rates"])
RATIO, DROP = JIG["RATIO"], JIG["DRIVER_DROP"]


@numba.njit
def loop(phi, gamma, C, D, reference, noise):  # type: ignore[no-untyped-def]
    """Motor angle in rad at the samples."""
    x, angle = np.zeros(len(phi)), np.zeros(len(reference))
    turned = w = i = z = 0.0
    h = STEP / SUB
    for k in range(len(reference)):
        angle[k] = RATIO * turned
        seen = np.array([reference[k], angle[k], RATIO * w, i]) + noise[k]
        u = (C @ x)[0] + (D @ seen)[0]
        x = phi @ x + gamma @ seen
        u = math.copysign(max(abs(u) - DROP, 0.0), u)
        for _ in range(SUB):
            a1, b1, c1 = RATES(w, i, z, u)
            w2 = w + 0.5 * h * a1
            a2, b2, c2 = RATES(w2, i + 0.5 * h * b1, z + 0.5 * h * c1, u)
            w3 = w + 0.5 * h * a2
            a3, b3, c3 = RATES(w3, i + 0.5 * h * b2, z + 0.5 * h * c2, u)
            w4 = w + h * a3
            a4, b4, c4 = RATES(w4, i + h * b3, z + h * c3, u)
            turned += h / 6 * (w + 2 * w2 + 2 * w3 + w4)
            w += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
            i += h / 6 * (b1 + 2 * b2 + 2 * b3 + b4)
            z += h / 6 * (c1 + 2 * c2 + 2 * c3 + c4)
    return angle


def main(folder: Path) -> None:
    """Print the largest errors of both referees."""
    steps = {s["name"]: s["numbers"] for s in json.loads((folder / "result.json").read_text(encoding="utf-8"))["steps"]}
    t = np.arange(round(4.0 / STEP)) * STEP
    share = np.clip(t, 0.0, 1.0)
    wave = AMPLITUDE * share**3 * (10 - 15 * share + 6 * share**2) * np.sin(OMEGA * t)
    noise = np.random.default_rng(0).normal(size=(len(t), 4)) * NOISE
    for name in ("hinf_before", "before", "hinf_after", "after"):
        K = rl.load(folder / "evidence" / f"{name}.h5").data["K"]
        model = rl.StateSpaceModel(K["A"], K["B"], K["C"], K["D"])
        phi, gamma, _ = transition(model, STEP)
        angle = loop(phi, gamma, model.C, model.D, wave, noise)
        error = MM * np.abs(wave - angle)[t >= 2.0].max()
        said = steps["referee"]["controllers"][name]["worst_error"]
        print(f"{name:12} error {error:.5f} mm, in the recipe's referee {said:.5f} mm")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
