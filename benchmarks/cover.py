"""Covers of sets of models: how conservative they are on the thesis' cases, how tight their weights; and discoveries.

    python benchmarks/cover.py [--parts thesis weights discoveries] [--emps emps.h5] [--out FILE]

Sets: five machines between the ends of each case of the thesis (section 10.3.1), each trimmed and linearised by
itself. Loop: the upper layer of the thesis' controller (I-PD with triple poles p), designed on the nominal machine;
the gain is from disturbing torques to angles and rates. 236 1/s is the thesis' own p; 5 1/s is slow enough for the
machine's own stiffness to matter.

Discoveries: linear actuators with a hidden dry friction, simulated by the generator of the blind tests, named by
`robustlab.discover`, and turned into a set by `robustlab.uncertain_from`. Is the truth in it, does a controller hold on
all of it, and does it explain a record that no fit saw?
"""

from __future__ import annotations

import argparse
import datetime
import os
import platform
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import numpy as np

import robustlab as rl
from robustlab.uncertainty.covering.unstructured_cover import unstructured_cover

MEMBERS = 5
POLES = (236.0, 5.0)
TIME_LIMIT = 240.0
FORMS = ("elements", "pca", "ellipsoid")
WEIGHTS = """Weights: largest excess over the bound on a grid ten times finer than the fit's; least: no weight of this
order has a smaller one, proved by alternation; of best: the weight over the best of its order, at most"""


def thesis_sets(cases: list[str]) -> dict[str, list[rl.StateSpaceModel]]:
    from robustlab.dynamics import linearise, trim
    from robustlab.dynamics.stewart.stewart_platform import stewart_platform
    from robustlab.thesis.runs import ALL, LINK

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
    head = f"{'set and form':46}{'order':>6}{'excess %':>10}{'least %':>9}{'of best %':>10}{'lowest':>10}"
    lines = [head + f"{'proved':>8}{'CPU s':>8}"]

    def add(name: str, fit, proved: bool, spent: float) -> None:
        over = 100 * ((1 + fit.excess) / (1 + fit.least) - 1)  # the weight over the best one of its order, at most
        line = f"{name:46}{fit.order:6}{100 * fit.excess:10.2f}{100 * fit.least:9.2f}{over:10.2f}"
        line += f"{fit.lowest:10.1e}{proved!s:>8}{spent:8.1f}"
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
        if made.fit.excess > 0.1:
            start = time.process_time()
            free = unstructured_cover(tuple(models), form, order=8)
            add("    the same, order at most 8", free.fit, free.proved, time.process_time() - start)
    return lines


def discovery_lines(name: str, plant, train, held_out, truth: dict[str, float], effects: dict[str, float]) -> list[str]:
    """One discovery as a set: blocks, truth, a controller on it, and the record that was held out."""
    start = time.process_time()
    found = rl.discover(plant, [train], [held_out])
    spent = time.process_time() - start
    (output,) = held_out.outputs
    made = rl.uncertain_from(found, [output])
    print(f"{name}: {found.verdict}", flush=True)
    lines = [
        f"{name}: {found.verdict}, {', '.join(found.names)}; gap {found.gap_before:.3g} % -> {found.gap_after:.3g} %"
    ]
    lines.append(f"  discover {spent:.0f} s CPU; {len(made.model.blocks)} blocks, {len(made.noise)} bounded inputs,"
                 f" {len(made.left_out)} effects left out")  # fmt: skip
    for b in made.model.blocks:
        lines.append(
            f"  {b.name:26} {b.parameter.low:.5g} .. {b.parameter.high:.5g} {b.parameter.unit}{_true(b, found, truth)}"
        )
    for n in made.noise:
        known = effects.get(n.name.split(": ")[-1])
        lines.append(f"  {n.name:26} at most {n.bound:.5g} {n.unit}" + ("" if known is None else f"; true {known:.5g}"))
    return [
        *lines,
        *(f"  {line}" for line in controlled_lines(made, output, held_out)),
        *held_out_lines(found, made, held_out),
    ]


def _true(block, found, truth: dict[str, float]) -> str:
    """The true value of a parameter, or for a common factor that of the first of its group."""
    first = block.name.split("+")[0]
    if first not in truth:
        return ""
    value = truth[first] / (found.model.plant.values[first] if "+" in block.name else 1.0)
    return f"; true {value:.5g}, delta {block.parameter.delta(value):.2f}"


def controlled_lines(made, output: str, record) -> list[str]:
    """An H-infinity controller of the nominal member, judged on the whole set."""
    from robustlab.synthesis.specifications.tracking_problem import tracking_problem

    start = time.process_time()
    size, drive = np.ptp(record.outputs[output]) / 50, np.abs(record.inputs["u"]).max()
    problem = tracking_problem(
        made.model.select([*(n.name for n in made.noise), "u"], [output]), [output], [output],
        W1=rl.performance_weight(bandwidth=30.0, peak=2.0, error=1e-3), W2=1.0 / drive, reference={output: size},
        reference_bandwidth=10.0, noise={output: 1e-3 * size}, loads={n.name: 1.0 for n in made.noise},
    )  # fmt: skip
    designed = rl.hinf(problem.nominal)
    loop = problem.close(designed.K)
    margin, worst = rl.robust_stability(loop), rl.peak_gain(loop, time_limit=60)
    text = f"controller: gamma {designed.gamma:.4g} ({designed.status}); stable on {margin.lower:.4g} times the set"
    text += f" ({margin.status}); worst gain {worst.lower:.4g} .. {worst.upper:.4g} ({worst.status})"
    return [f"{text}; {time.process_time() - start:.1f} s CPU"]


def held_out_lines(found, made, held_out) -> list[str]:
    """The smallest Delta that explains the held-out record: of the set, and of dynamics at the bare plant's input."""
    from robustlab.dynamics.extended.effect_loads import effect_loads

    (output,) = held_out.outputs
    noise = {output: 4.0 * found.gaps[output].updated}
    bound = f"{noise[output]:.3g} {found.gaps[output].unit} (4 times the rms gap of the updated model)"
    lines = [f"  held out: {held_out.n} samples in windows of {found.window:.3g} s, noise bound {bound}"]
    base = rl.linearise(getattr(found.model, "plant", found.model)).select(["u"], [output])
    loose = rl.unstructured(base, 1.0, "input-multiplicative")
    short = {k: v[:1000] for k, v in held_out.inputs.items()}, {k: v[:1000] for k, v in held_out.outputs.items()}
    start_of = rl.Record(held_out.t[:1000], *short, held_out.units, held_out.name)
    known = effect_loads(found.model, records=[held_out])
    own = {n.name for n in made.noise} >= {n.name for n in known.loads}
    own_set = made.model if own else known.model.select(outputs=[output])
    for name, model, record in (
        (f"the set{'' if own else ' with all effects as loads'}, known loads", own_set, known.along(held_out)),
        ("without the named effects, dynamics of the input's size, first 1000 samples", loose, start_of),
    ):
        start = time.process_time()
        judged = rl.validate(model, record, noise, window=found.window, time_limit=120)
        text = f"    {name}: {judged.verdict}; noise left {judged.excess:.3g} of its bound ({judged.status})"
        lines.append(f"{text}; {time.process_time() - start:.1f} s CPU")
    return lines


def discoveries(seeds: list[int], emps: Path | None) -> list[str]:
    from hidden.cases import make_case
    from hidden.plants import PLANTS

    lines = []
    for seed in seeds:
        case = make_case("coulomb-friction", seed, plant="linear-actuator")
        nominal = PLANTS["linear-actuator"].nominal
        truth = {name: value * case.perturbed.get(name, 1.0) for name, (value, _) in nominal.items()}
        friction = {name: values["Fc"] for name, values in case.true_parameters.items()}
        name = f"linear actuator, seed {seed}"
        lines += discovery_lines(name, case.plant, case.record, case.held_out, truth, friction)
    if emps is not None:
        train, test = (rl.Record.read(emps, group=g, inputs=["u"], outputs=["q"]) for g in ("train", "test"))
        published = {"M": 95.1089}
        lines += discovery_lines("EMPS (a real machine)", rl.plant("servo-axis"), train, test, published, {})
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--parts", nargs="+", default=["thesis", "weights", "discoveries"])
    parser.add_argument("--cases", nargs="+", default=["1", "2a", "2b", "2c"], help="cases of the thesis")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2], help="of the linear actuators")
    parser.add_argument("--emps", type=Path, help="the published record of a servo axis, which is not ours to ship")
    options = parser.parse_args()
    versions = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "cvxpy", "clarabel"))
    head = [
        f"{datetime.date.today()}, robustlab {rl.__version__}, {versions}, Python {platform.python_version()},",
        f"{platform.machine()}, CPU time of one process on a loaded machine of {os.cpu_count()} cores",
    ]
    parts = {
        "thesis": ("Worst gain of the cover over that of the set", lambda: thesis_lines(options.cases)),
        "weights": (
            WEIGHTS,
            weight_lines,
        ),
        "discoveries": ("Discoveries as sets of models", lambda: discoveries(options.seeds, options.emps)),
    }
    text = "\n".join([*head, *(line for name in options.parts for line in ("", parts[name][0], *parts[name][1]())), ""])
    if options.out:
        options.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
