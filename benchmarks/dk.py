"""D-K iteration and reduction of controllers: certified peaks of mu, orders and CPU time.

    python benchmarks/dk.py --what default|column|reduction

default, column: the distillation column of Skogestad and Postlethwaite, *Multivariable Feedback Control* (2005),
section 8.12. Published: 1.0144 after D-K iteration, "optimal" 0.974. Each controller is judged by mu on the whole axis,
by rl.robust_stability. reduction: the column's controller to lower orders.
"""

from __future__ import annotations

import numpy as np
from harness import heading, options, timed

import robustlab as rl
from robustlab.synthesis import GeneralizedPlant

BLOCKS = [rl.FullBlock("u", 2, 2), rl.FullBlock("p", 2, 2)]  # of the column


def distillation() -> rl.StateSpaceModel:
    """wI = (s + 0.2)/(0.5 s + 1), wP = (s/2 + 0.05)/s with a pole at -1e-6, G = G0 / (75 s + 1), y = -(G u + w)."""
    gain, eye, zero, eps = np.array([[87.8, -86.4], [108.2, -109.6]]), np.eye(2), np.zeros((2, 2)), 1e-5
    A = np.block([[-eye / 75, zero, zero], [zero, -2 * eye, zero], [gain, zero, -eps / 10 * eye]])
    B = np.block([[eye / 75, zero, eye / 75], [zero, zero, 2 * eye], [zero, eye, zero]])
    C = np.block([[zero, -1.8 * eye, zero], [0.5 * gain, zero, 0.05 * (1 - eps) * eye], [-gain, zero, zero]])
    D = np.block([[zero, zero, 2 * eye], [zero, 0.5 * eye, zero], [zero, -eye, zero]])
    return rl.StateSpaceModel(A, B, C, D)


def whole_axis(plant: rl.StateSpaceModel, K: rl.StateSpaceModel, blocks: list, n: int) -> tuple[float, float]:
    """Bounds of the peak of mu of the loop, by the margin's own proof."""
    loop = rl.UncertainModel(GeneralizedPlant(plant, n, n).close(K), blocks)
    margin = rl.robust_stability(loop)
    return 1 / margin.upper, 1 / margin.lower


def default() -> None:
    """The call as a user makes it, on the column: level, order, time; then the lowest order within 1 % of it."""
    plant, blocks = distillation(), BLOCKS
    rl.dk(plant, blocks, 2, 2, effort=0.02)  # compiled kernels are not timed
    design, cpu = timed(rl.dk, plant, blocks, 2, 2)
    print(f"  default: gamma {design.gamma:.6f} {design.status.value} ({design.K.n_states} states), CPU {cpu:.1f} s")
    print(f"    {design.why}")
    small, cpu = timed(rl.reduce_controller, design, loss=0.01)
    low, high = whole_axis(plant, small.K, blocks, 2)
    print(
        f"  reduced: gamma {small.gamma:.6f} ({small.K.n_states} states, {small.loss:.2%} above), margin's own proof "
        f"[{low:.4f}, {high:.4f}], CPU {cpu:.1f} s",
        flush=True,
    )


def column() -> None:
    """Classical D-K iteration alone, and with direct minimisation, for several largest orders."""
    plant, blocks = distillation(), BLOCKS
    for direct, order in ((False, 26), (True, 10), (True, 14), (True, 18), (True, 22)):
        how = {"max_order": order, "order_rel": 0.0, "effort": 2.5, "progress": None}
        design, cpu = timed(rl.dk, plant, blocks, 2, 2, direct=direct, **how)
        first = min((s.gamma for s in design.history if s.stage != "direct"), default=np.nan)
        low, high = whole_axis(plant, design.K, blocks, 2)
        print(
            f"  {'direct' if direct else 'D-K   '} max_order {order:2d}: gamma {design.gamma:.4f} ({design.K.n_states} "
            f"states), D-K stage {first:.4f}, margin's own proof [{low:.4f}, {high:.4f}], CPU {cpu:.1f} s",
            flush=True,
        )


def reduction() -> None:
    """The column's controller at each loss and order, certified at all frequencies."""
    design = rl.dk(distillation(), BLOCKS, 2, 2)
    print(f"  full controller: gamma {design.gamma:.5f}, {design.K.n_states} states")
    for how in ({"loss": 1e-3}, {"loss": 1e-2}, {"order": 10}, {"order": 8}, {"order": 6}):
        small, cpu = timed(rl.reduce_controller, design, **how)
        print(
            f"  {how}: {small.K.n_states} states, gamma {small.original_gamma:.5f} -> {small.gamma:.5f}, "
            f"loss {small.loss:.4%}, {small.status}, CPU {cpu:.1f} s",
            flush=True,
        )


PARTS = {"default": default, "column": column, "reduction": reduction}

if __name__ == "__main__":
    what = options(__doc__, what=tuple(PARTS)).what
    print(heading("numpy", "scipy", "slycot"))
    PARTS[what]()
