"""D-K iteration and reduction of controllers: certified peaks of mu, orders and CPU time.

    python benchmarks/dk.py --what default|column|mixed|reduction|models

default, column: the distillation column of Skogestad and Postlethwaite, *Multivariable Feedback Control* (2005),
section 8.12. Published: 1.0144 after D-K iteration, "optimal" 0.974. Each controller is judged by mu on the whole axis,
by rl.robust_stability. mixed: real blocks as complex ones and as what they are, on an oscillator
x'' = -(1 + 0.5 delta) x - 0.02 x' + u + 0.1 d with y = x + 0.1 n, z = [x; u], and on two unit masses with a spring
1 + 0.5 delta and a damper 0.02 between them, u on the first, 0.05 d on the second, whose position is measured with
noise 0.05 n, z = 0.5 [x2; u]. reduction: the column's controller to lower orders. models: chains of masses (force to
position of the first) by every method, beside control.balred.
"""

from __future__ import annotations

from typing import Any

import control
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


def oscillator() -> rl.StateSpaceModel:
    """Problem 2."""
    D = np.zeros((4, 4))
    D[2, 3], D[3, 2] = 1.0, 0.1
    return rl.StateSpaceModel(
        [[0, 1], [-1, -0.02]], [[0, 0, 0, 0], [-1, 0.1, 0, 1]], [[0.5, 0], [1, 0], [0, 0], [1, 0]], D
    )


def two_masses() -> rl.StateSpaceModel:
    """Problem 3."""
    c = 0.02
    A = [[0, 0, 1, 0], [0, 0, 0, 1], [-1, 1, -c, c], [1, -1, c, -c]]
    B = [[0, 0, 0, 0], [0, 0, 0, 0], [-1, 0, 0, 1], [1, 0.05, 0, 0]]
    C = [[0.5, -0.5, 0, 0], [0, 0.5, 0, 0], [0, 0, 0, 0], [0, 1, 0, 0]]
    D = np.zeros((4, 4))
    D[2, 3], D[3, 2] = 0.5, 0.05
    return rl.StateSpaceModel(A, B, C, D)


def whole_axis(plant: rl.StateSpaceModel, K: rl.StateSpaceModel, blocks: list, n: int) -> tuple[float, float]:
    """Bounds of the peak of mu of the loop, by the margin's own proof."""
    loop = rl.UncertainModel(GeneralizedPlant(plant, n, n).close(K), blocks)
    margin = rl.robust_stability(loop)
    return 1 / margin.upper, 1 / margin.lower


def default() -> None:
    """The call as a user makes it, on the column: level, order, time; then the lowest order within 1 % of it."""
    plant, blocks = distillation(), BLOCKS
    rl.dk(
        oscillator(), [rl.ComplexScalar("k"), rl.FullBlock("p", 2, 2)], 1, 1, effort=0.02
    )  # compiled kernels are not timed
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


def mixed() -> None:
    """Real blocks as complex ones, and as what they are."""
    for name, plant in (("oscillator", oscillator()), ("two masses", two_masses())):
        blocks = [rl.RealScalar("k"), rl.FullBlock("p", 2, 2)]
        found = []
        for real in (False, True):
            design, cpu = timed(rl.dk, plant, blocks, 1, 1, mixed=real, max_order=12, order_rel=0.0, effort=2.5)
            low, high = whole_axis(plant, design.K, blocks, 1)
            found.append(design.gamma)
            print(
                f"  {name}, {'D-G-K      ' if real else 'complex D-K'}: gamma {design.gamma:.4f} ({design.K.n_states} "
                f"states), mixed mu by the margin's own proof [{low:.4f}, {high:.4f}], CPU {cpu:.1f} s",
                flush=True,
            )
        print(f"  {name}: certified mixed mu {1 - found[1] / found[0]:.1%} below complex D-K", flush=True)


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


def models() -> None:
    """Errors of each method on chains of masses, and CPU times beside `control.balred`."""
    low, high = 0.2, 1.0
    ways: dict[str, dict[str, Any]] = {
        "truncation": {},
        "residualisation": {"method": "residualisation"},
        "hankel": {"method": "hankel"},
        "stochastic": {"method": "stochastic", "floor": 0.01},
        "band": {"band": (low, high)},
    }
    print("states  order  method           error     promised  any omega  in band   status     CPU ms")
    for masses in (4, 10, 30):
        chain = rl.linearise(rl.plant("mass-spring-damper", m=[1.0] * masses, c=[0.1] * masses, k=[1.0] * masses))
        G = chain.select(["f1"], ["q1"])
        order = G.n_states // 2
        for name, how in ways.items():
            found, cpu = timed(rl.reduce_model, G, order, **how)
            own = f"{found.error.upper:8.3g}  {found.bound:8.3g}"
            print(row(G, order, name, own, gap_of(G, found.model, low, high), str(found.status), cpu))
        theirs, cpu = timed(control.balred, G.to_control(), order)
        small = rl.StateSpaceModel.from_control(theirs).renamed(G.inputs, G.outputs)
        print(row(G, order, "control.balred", f"{'-':>8s}  {'-':>8s}", gap_of(G, small, low, high), "", cpu))


def row(G: rl.StateSpaceModel, order: int, name: str, own: str, seen: str, status: str, cpu: float) -> str:
    return f"{G.n_states:6d}  {order:5d}  {name:15s}  {own}  {seen}  {status:9s}  {1e3 * cpu:7.1f}"


def gap_of(G: rl.StateSpaceModel, small: rl.StateSpaceModel, low: float, high: float) -> str:
    """Proved size of the difference at all frequencies, and in a band."""
    gap = G - small
    return f"{rl.peak_gain(gap).upper:9.3g}  {rl.peak_gain(gap, band=(low, high)).upper:8.3g}"


PARTS = {
    "default": default, "column": column, "mixed": mixed, "reduction": reduction, "models": models,
}  # fmt: skip

if __name__ == "__main__":
    what = options(__doc__, what=tuple(PARTS)).what
    print(heading("numpy", "scipy", "slycot", "control"))
    PARTS[what]()
