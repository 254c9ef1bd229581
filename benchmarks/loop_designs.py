"""Published mixed-sensitivity and loop-shaping designs, beside control.mixsyn and control.hinfsyn.

    python benchmarks/loop_designs.py [--random 40]

Mixed sensitivity: gamma is the verified norm of the loop rebuilt from K; for python-control too, where the rebuilt loop
may turn out unstable. Loop shaping: gamma_min against the published figure, and what the returned controller reaches
against the factor asked for, on the example and on random plants, continuous and discrete.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from pathlib import Path

import control
import numpy as np

from robustlab.norms import hinf_norm
from robustlab.statespace import StateSpaceModel, append, lower_lft
from robustlab.synthesis.hinf.loop_shaping import ncf
from robustlab.synthesis.hinf.mixed_sensitivity import mixed_sensitivity_plant, mixsyn
from robustlab.synthesis.specifications.weight_design import performance_weight
from robustlab.uncertainty.distances.coprime import four_block

DATA = Path(__file__).parents[2] / "shared" / "data" / "robust-designs"


def disturbed() -> StateSpaceModel:
    """200 / ((10 s + 1) (0.05 s + 1)^2)."""
    return StateSpaceModel([[-0.1, 0, 0], [20, -20, 0], [0, 20, -20]], [[20.0], [0], [0]], [[0, 0, 1]], [[0]])


def two_by_two() -> StateSpaceModel:
    """[[1, 1], [2 s + 1, 2]] / (0.2 s^2 + 1.2 s + 1): one second-order chain per input."""
    chain, zeros = np.array([[0.0, 1.0], [-5.0, -6.0]]), np.zeros((2, 2))
    B = np.array([[0, 0], [1, 0], [0, 0], [0, 1]])
    return StateSpaceModel(
        np.block([[chain, zeros], [zeros, chain]]), B, [[5, 0, 5, 0], [5, 10, 10, 0]], np.zeros((2, 2))
    )


def diagonal(first: StateSpaceModel, second: StateSpaceModel) -> StateSpaceModel:
    return append(first.renamed(["u1"], ["y1"]), second.renamed(["u2"], ["y2"]))


def squared() -> StateSpaceModel:
    s = control.tf("s")
    return StateSpaceModel.from_control(control.ss((s / 1.5**0.5 + 10) ** 2 / (s + 10 * 1e-4) ** 2))


def mixed_cases() -> list[tuple[str, StateSpaceModel, StateSpaceModel]]:
    w = [performance_weight(b, 1e-4, 1.5) for b in (0.25, 25.0)]
    return [
        ("SP_2.17_W1", disturbed(), performance_weight(10.0, 1e-4, 1.5)),
        ("SP_2.17_W1_squared", disturbed(), squared()),
        ("SP_3.8_d1", two_by_two(), diagonal(w[0], w[0])),
        ("SP_3.8_d2", two_by_two(), diagonal(w[0], w[1])),
        ("SP_3.8_d3", two_by_two(), diagonal(w[1], w[0])),
    ]


def peer(G: StateSpaceModel, W1: StateSpaceModel) -> str:
    """control.mixsyn as its documentation shows it, on transfer functions made into one realisation."""
    start = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            g, w = G.to_control(), W1.to_control()
            if G.n_outputs == 1:
                g, w = control.ss(control.ss2tf(g)), control.ss(control.ss2tf(w))
            K, _, (gamma, _) = control.mixsyn(g, w, control.ss([], [], [], np.eye(G.n_inputs)))
    except (ValueError, ArithmeticError, control.ControlException) as error:
        return f"{type(error).__name__}"
    cpu = time.process_time() - start
    plant, _ = mixed_sensitivity_plant(G, W1, 1.0)
    true = hinf_norm(plant.close(StateSpaceModel(K.A, K.B, K.C, K.D))).value
    text = f"{true:.5g}" if np.isfinite(true) else "UNSTABLE loop"
    return f"claims {gamma:.5g}, true {text}, {cpu:.2f} s"


def mass_damper_spring() -> StateSpaceModel:
    text = (DATA / "mass_damper_spring.json").read_text(encoding="utf-8")
    data = {k: np.array(v) for k, v in json.loads(text)["plant"].items()}
    w = z = slice(3, None)
    return StateSpaceModel(
        data["A"],
        np.hstack([data["B1"][:, w], data["B"]]),
        np.vstack([data["C1"][z], data["C"]]),
        np.block([[data["D11"][z, w], data["D12"][z]], [data["D21"][:, w], np.zeros((1, 1))]]),
    )


def mixed(figures: dict[str, float]) -> None:
    for name, G, W1 in mixed_cases():
        start = time.process_time()
        design = mixsyn(G, W1, 1.0, gamma_rel=1.0)
        cpu = time.process_time() - start
        true = hinf_norm(design.plant.close(design.K)).upper
        print(
            f"{name:20s} reference {figures[name]:8.5g}  robustlab {true:8.5f} ({true / figures[name]:.5f}) {cpu:.2f} s"
            f"  control.mixsyn {peer(G, W1)}",
            flush=True,
        )
    from robustlab.synthesis.hinf.hinf_synthesis import hinf

    start = time.process_time()
    P = mass_damper_spring()
    design = hinf(P, 1, 1, gamma_rel=1.0)
    cpu = time.process_time() - start
    true = hinf_norm(lower_lft(P, design.K)).upper
    print(f"{'mass-damper-spring':20s} reference {0.95:8.5g}  robustlab {true:8.5f} ({true / 0.95:.5f}) {cpu:.2f} s")


def random_plant(rng: np.random.Generator, dt: float) -> StateSpaceModel:
    n, p, m = int(rng.integers(1, 9)), int(rng.integers(1, 4)), int(rng.integers(1, 4))
    A = rng.standard_normal((n, n))
    if dt:
        A *= rng.uniform(0.5, 1.6) / np.abs(np.linalg.eigvals(A)).max()
    D = rng.standard_normal((p, m)) * rng.integers(0, 2)
    return StateSpaceModel(A, rng.standard_normal((n, m)), rng.standard_normal((p, n)), D, dt)


def shaping(gamma_published: float, count: int) -> None:
    pi = StateSpaceModel([[0.0]], [[1.0]], [[2.0]], [[1.0]])
    design = ncf(disturbed(), pi)
    print(
        f"\nS&P 9.3: gamma_min {design.gamma_min:.6f} (reference {gamma_published}), reached at 1.1: {design.gamma:.5f}"
    )
    for dt in (0.0, 0.1):
        rng, worst, cpu, certified = np.random.default_rng(1), 0.0, [], 0
        for _ in range(count):
            G, factor = random_plant(rng, dt), float(rng.choice([1.01, 1.05, 1.1, 1.5]))
            start = time.process_time()
            design = ncf(G, factor=factor)
            cpu.append(time.process_time() - start)
            reached = hinf_norm(lower_lft(four_block(G), design.K)).upper
            worst = max(worst, reached / (factor * design.gamma_min))
            certified += design.status.value == "certified"
        print(
            f"{count} random plants, dt = {dt:g} s (1..8 states, to 3 x 3, half with D, many unstable): "
            f"reached / (factor gamma_min) at most {worst:.5f}; certified {certified}; "
            f"CPU median {np.median(cpu):.3f} s"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description="Published loop designs.")
    parser.add_argument("--random", type=int, default=40)
    options = parser.parse_args()
    cases = json.loads((DATA / "mixed_sensitivity_ncf.json").read_text(encoding="utf-8"))["cases"]
    mixed({c["name"]: c["gamma_measured"] for c in cases if "gamma_measured" in c})
    shaping(next(c["gamma_min_measured"] for c in cases if c["name"] == "SP_9.3_NCF"), options.random)


if __name__ == "__main__":
    main()
