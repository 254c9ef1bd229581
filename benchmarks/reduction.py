"""Reduction of models by every method, beside python-control; and of the distillation column's mu controller.

    python benchmarks/reduction.py --models
    python benchmarks/reduction.py [--loss 0.001] [--no-mu]

With --models: chains of masses (force to position of the first), each method at one order. Ours come with their proof,
the peer's errors are computed by us afterwards, and its time is without them. The rest is about one controller, every
order certified at all frequencies.

The column of Skogestad and Postlethwaite, *Multivariable Feedback Control* (2005), section 8.12. The scalings D(s)
below come from a direct search over their gains, zeros and poles; the full controller is the H-infinity controller of
the plant scaled with them. Everything else is computed here: the norm of the scaled loop (a bound of mu at every
frequency) of the full controller and of every reduced one, and mu by intervals with scalings of its own as a second
opinion.
"""

from __future__ import annotations

import argparse
from typing import Any

import control
import numpy as np
from dk import distillation
from harness import timed

import robustlab as rl
from robustlab import hinf
from robustlab.mu_analysis import robust_performance
from robustlab.statespace import StateSpaceModel, append, series
from robustlab.synthesis import GeneralizedPlant, descend
from robustlab.synthesis.problem.performance_measure import plant_with_scalings
from robustlab.synthesis.reduction.controller_reduction import reduce_controller
from robustlab.uncertainty.blocks import ComplexScalar
from robustlab.uncertainty.lft import UncertainModel

# log k, log z (3), log p (3) of d(s) = k prod (s/z + 1)/(s/p + 1), the same for both inputs; performance has d = 1.
LOG_D = (1.1718838168, -2.5068659207, 4.8517257507, -2.6786586802, -0.3489962858, -0.2995493640, -4.8840303405)
BLOCKS = (ComplexScalar("input1"), ComplexScalar("input2"))


def lag(k: float, zeros: list[float], poles: list[float]) -> StateSpaceModel:
    model = StateSpaceModel([], [], [], [[k]])
    for z, p in zip(zeros, poles, strict=True):
        model = series(model, StateSpaceModel([[-p]], [[p]], [[1 - p / z]], [[p / z]]))
    return model


def scalings() -> tuple[StateSpaceModel, StateSpaceModel]:
    sides: list[list[StateSpaceModel]] = [[], []]
    k, z, p = np.exp(LOG_D[0]), sorted(np.exp(LOG_D[1:4])), sorted(np.exp(LOG_D[4:]))
    for i in range(2):
        for side, part in zip(sides, (lag(k, z, p), lag(1 / k, p, z)), strict=True):
            side.append(part.renamed([f"i{i}"], [f"o{i}"]))
    rest = StateSpaceModel([], [], [], np.eye(2), inputs=["a", "b"], outputs=["c", "d"])
    return append(*sides[0], rest), append(*sides[1], rest)


def models() -> None:
    """Errors of each method on chains of masses, and CPU times beside `control.balred`."""
    low, high = 0.2, 1.0
    ways: dict[str, dict[str, Any]] = {
        "truncation": {},
        "residualisation": {"method": "residualisation"},
        "hankel": {"method": "hankel"},
        "stochastic": {"method": "stochastic", "floor": 0.01},
    }
    print("states  order  method           error     promised  any omega  in band   status     CPU ms")
    for masses in (4, 10, 30):
        chain = rl.linearise(rl.plant("mass-spring-damper", m=[1.0] * masses, c=[0.1] * masses, k=[1.0] * masses))
        G = chain.select(["f1"], ["q1"])
        order = G.n_states // 2
        for name, options in ways.items():
            found, cpu = timed(rl.reduce_model, G, order, **options)
            own = f"{found.error.upper:8.3g}  {found.bound:8.3g}"
            print(row(G, order, name, own, told(G, found.model, low, high), str(found.status), cpu))
        theirs, cpu = timed(control.balred, G.to_control(), order)
        small = rl.StateSpaceModel.from_control(theirs).renamed(G.inputs, G.outputs)
        print(row(G, order, "control.balred", f"{'-':>8s}  {'-':>8s}", told(G, small, low, high), "", cpu))


def row(G: StateSpaceModel, order: int, name: str, own: str, seen: str, status: str, cpu: float) -> str:
    return f"{G.n_states:6d}  {order:5d}  {name:15s}  {own}  {seen}  {status:9s}  {1e3 * cpu:7.1f}"


def told(G: StateSpaceModel, small: StateSpaceModel, low: float, high: float) -> str:
    """Proved size of the difference at all frequencies, and in a band."""
    gap = G - small
    return f"{rl.peak_gain(gap).upper:9.3g}  {rl.peak_gain(gap, band=(low, high)).upper:8.3g}"


def main() -> None:
    parser = argparse.ArgumentParser(description="Reduction of the distillation column's mu controller.")
    parser.add_argument("--loss", type=float, default=1e-3)
    parser.add_argument("--no-mu", action="store_true", help="without the second opinion by mu on intervals")
    parser.add_argument("--models", action="store_true", help="models instead of the controller")
    options = parser.parse_args()
    if options.models:
        models()
        return
    plant, d = GeneralizedPlant(distillation(), 2, 2, BLOCKS), scalings()
    design, cpu = timed(hinf, plant_with_scalings(plant, d), gamma_rel=1.0)
    full = design.K
    print(f"full controller: {full.n_states} states, CPU {cpu:.1f} s")
    how = {"measure": "mu", "scalings": d, "improve": descend}
    small, cpu = timed(reduce_controller, plant, full, loss=options.loss, progress=print, **how)
    print(
        f"{full.n_states} -> {small.K.n_states} states: certified mu {small.original_gamma:.5f} -> {small.gamma:.5f}, "
        f"loss {100 * small.loss:.4f} % (allowed {100 * options.loss:g} %), {small.status}, CPU {cpu:.1f} s"
    )
    for order in (10, 8, 6):
        forced = reduce_controller(plant, full, order=order, **how)
        print(f"{full.n_states} -> {order}: certified mu {forced.gamma:.5f}, loss {100 * forced.loss:.3f} %")
    for name, K in () if options.no_mu else (("full", full), (f"{small.K.n_states} states", small.K)):
        margin, cpu = timed(robust_performance, UncertainModel(plant.close(K), BLOCKS), tolerance=1e-3)
        ends = f"{1 / margin.upper:.5f} <= mu <= {1 / margin.lower:.5f}"
        print(f"second opinion, {name}: {ends} ({margin.status}), CPU {cpu:.1f} s")


if __name__ == "__main__":
    main()
