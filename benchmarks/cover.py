"""Covers of sets of models: how conservative they are on the thesis' cases, and how tight their weights.

    python benchmarks/cover.py [--out benchmarks/results/cover.txt]

Sets: five machines between the ends of each case of the thesis (section 10.3.1), each trimmed and linearised by
itself. Loop: the upper layer of the thesis' controller (I-PD with triple poles p), designed on the nominal machine;
the gain is from disturbing torques to angles and rates. 236 1/s is the thesis' own p; 5 1/s is slow enough for the
machine's own stiffness to matter.
"""

from __future__ import annotations

import argparse
import datetime
import platform
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import robustlab as rl
from robustlab.uncertainty.unstructured_cover import unstructured_cover

MEMBERS = 5
POLES = (236.0, 5.0)
TIME_LIMIT = 240.0
FORMS = ("elements", "pca", "ellipsoid")


def thesis_sets(cases: list[str]) -> dict[str, list[rl.StateSpaceModel]]:
    from robustlab.dynamics import linearise, trim
    from robustlab.dynamics.stewart.stewart_platform import stewart_platform
    from robustlab.dynamics.stewart.thesis_runs import ALL, LINK

    plant = stewart_platform()
    made: dict[str, list[rl.StateSpaceModel]] = {}
    if "1" in cases:
        made["1"] = [
            linearise(plant, trim(plant, pose=(0, 0, z, 0, 0, 0)))
            for z in np.linspace(0.1262, 0.1062, MEMBERS).tolist()
        ]
    for name, end, parameters in (("2a", 1.025, LINK), ("2b", 1.10, LINK), ("2c", 1.025, ALL)):
        if name not in cases:
            continue
        made[name] = []
        for factor in np.linspace(1.0, end, MEMBERS).tolist():
            heavy = plant.with_parameters(**{k: factor * plant.values[k] for k in parameters})
            made[name].append(linearise(heavy, trim(heavy)))
    return made


def loop_of(model: rl.StateSpaceModel, p: float) -> Callable[[rl.UncertainModel], rl.UncertainModel]:
    """I-PD of every angle with the triple pole p, designed on a model with angles and rates as states."""
    d, stiffness, damping = model.B[6:], model.A[6:, :6], model.A[6:, 6:]
    one = np.eye(6)
    right = np.hstack([3 * p * p * one + stiffness, 3 * p * one + damping, p**3 * one])
    kp, kd, ki = np.split(np.linalg.solve(d, right), 3, axis=1)
    k = rl.StateSpaceModel(np.zeros((6, 6)), np.hstack([-one, np.zeros((6, 6))]), ki, np.hstack([-kp, -kd]))
    return lambda g: g.feedback(k, 1)


def thesis_lines(cases: list[str]) -> list[str]:
    head = f"{'case':5}{'p 1/s':>7} {'form':10}{'blocks':>7}{'channels':>9}{'missed by':>11}{'ratio <=':>10}"
    lines = [head + f"{'ratio >=':>10}{'status':>11}{'CPU s':>8}"]
    for case, models in thesis_sets(cases).items():
        for form in FORMS:
            start = time.process_time()
            cover = rl.cover(models, form, tolerance=1e-6 if form != "elements" else 1e-9, gain=False)
            built = time.process_time() - start
            for p in POLES:
                start = time.process_time()
                found = rl.conservatism(
                    cover.model, models, loop=loop_of(cover.model.nominal, p), time_limit=TIME_LIMIT
                )
                spent = built + time.process_time() - start
                line = (
                    f"{case:5}{p:7g} {form:10}{len(cover.model.blocks):7}{cover.model.delta_shape[0]:9}"
                    f"{max(cover.misses):11.1e}{found.ratio:10.4f}{found.least:10.4f}{found.status.value:>11}{spent:8.1f}"
                )
                print(line, flush=True)
                lines.append(line)
    return lines


def units(name: str, count: int, seed: int, inputs: list[str], outputs: list[str], **tolerances: float) -> list:
    """Random units of a plant, each parameter uniform within its tolerance."""
    rng = np.random.default_rng(seed)
    plant = rl.plant(name)
    nominal = plant.values
    made = []
    for _ in range(count):
        changed = {k: nominal[k] * (1 + t * rng.uniform(-1, 1)) for k, t in tolerances.items()}
        model = rl.linearise(plant.with_parameters(**changed))
        made.append(model.select(inputs, outputs))
    return made


def weight_sets() -> dict[str, tuple[list, str]]:
    motor = {"R": 0.1, "Km": 0.1, "Kb": 0.1, "J": 0.2, "L": 0.2}
    spring = {"m": 0.1, "c": 0.3, "k": 0.1}
    two = {"J1": 0.1, "J2": 0.2, "k": 0.1, "c": 0.3}
    lags = [rl.StateSpaceModel([[-1 / t]], [[g / t]], [[1.0]], [[0.0]])
            for g, t in ((1, 1), (1.2, 1.3), (0.9, 0.8), (1.1, 0.7))]  # fmt: skip
    speed = units("dc-motor", 20, 1, ["u"], ["omega"], **motor)
    mass = units("mass-spring-damper", 12, 2, ["f"], ["q"], **spring)
    angle = units("linear-actuator", 12, 3, ["u"], ["phi"], Km=0.05, R=0.1, Kf=0.35)
    twin = units("two-mass", 8, 4, ["torque"], ["phi1"], **two)
    return {
        "4 lags, additive": (lags, "additive"),
        "4 lags, multiplicative": (lags, "input-multiplicative"),
        "4 lags, inverse multiplicative": (lags, "inverse-input-multiplicative"),
        "20 motors, additive": (speed, "additive"),
        "20 motors, multiplicative": (speed, "output-multiplicative"),
        "20 motors, inverse multiplicative": (speed, "inverse-output-multiplicative"),
        "12 actuators (integrating), multiplicative": (angle, "input-multiplicative"),
        "12 mass-spring-dampers, additive": (mass, "additive"),
        "12 mass-spring-dampers, multiplicative": (mass, "input-multiplicative"),
        "12 mass-spring-dampers, inverse": (mass, "inverse-input-multiplicative"),
        "8 two-mass drives, multiplicative": (twin, "input-multiplicative"),
    }


def weight_lines() -> list[str]:
    from robustlab.dynamics.effects.effect_blocks import delay_block

    lines = [f"{'set and form':46}{'order':>6}{'excess %':>10}{'lowest':>10}{'proved':>8}{'CPU s':>8}"]

    def add(name: str, fit, proved: bool, spent: float) -> None:
        line = f"{name:46}{fit.order:6}{100 * fit.excess:10.2f}{fit.lowest:10.1e}{proved!s:>8}{spent:8.1f}"
        print(line, flush=True)
        lines.append(line)

    for name, (models, form) in weight_sets().items():
        start = time.process_time()
        try:
            made = unstructured_cover(tuple(models), form)
        except rl.RobustlabError as error:
            lines.append(f"{name:46} {error.found}")
            print(lines[-1], flush=True)
            continue
        add(name, made.fit, made.proved, time.process_time() - start)
    for delay, spread, order in ((1.0, 0.0, 1), (1.0, 0.0, 2), (1.0, 0.2, 2), (1.0, 1.0, 2)):
        start = time.process_time()
        _, fit = delay_block(delay, spread, order, "delay")
        add(f"delay {delay:g} +- {spread:g} s less Pade {order}", fit, False, time.process_time() - start)
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--weights-only", action="store_true")
    parser.add_argument("--cases", nargs="+", default=["1", "2a", "2b", "2c"], help="cases of the thesis")
    options = parser.parse_args()
    head = [
        f"{datetime.date.today()}, robustlab, {platform.machine()}, CPU time of one process on a loaded machine",
        "",
    ]
    parts = ["Weights: largest excess over the bound on a grid ten times finer than the fit's", *weight_lines()]
    if not options.weights_only:
        parts = ["Worst gain of the cover over that of the set", *thesis_lines(options.cases), "", *parts]
    text = "\n".join([*head, *parts, ""])
    if options.out:
        options.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
