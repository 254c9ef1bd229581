"""Sets of models: element by element, covers; samples, worst members, probabilities."""

from collections.abc import Iterator
from typing import Any

import numpy as np

import robustlab as rl

from .cases import ROOT, Case, seeds

RTOL = 1e-9
# What a search ends at, and what is fitted.
RTOLS = {"residual": 0.0, "value": 1e-6, "nominal_value": 1e-6}
STRUCTURES = ("elements", "columns", "rows", "matrices", "single")
STEP = np.linspace(0.0, 0.1, 101)


def cases() -> Iterator[Case]:
    """Exact sets by every structure; a motor's worst members by several metrics."""
    for structure in STRUCTURES:
        yield Case(f"elementwise, {structure}", lambda structure=structure: elementwise(structure))
    for form in ("elements", "pca"):
        yield Case(f"cover, {form}", lambda form=form: cover(form))
    yield Case("samples", samples)
    for metric in ("peak-deviation", "peak", "settling-time", "hinf"):
        yield Case(f"worst {metric}", lambda metric=metric: worst(metric))
    for metric, limit in (("peak-deviation", 20.0), ("hinf", 18.6)):
        yield Case(f"probability, {metric}", lambda metric=metric, limit=limit: probability(metric, limit))


def motor() -> Any:
    """A motor with four ranges, seen at its speed."""
    ranges = {"R": (2.07, 0.1), "Kf": (4.8e-5, 0.35), "J": (7.2e-6, 0.1), "Km": (0.052, 0.05)}
    return rl.plant("dc-motor", **ranges).uncertain(outputs=["omega"])


def pair(k: int) -> tuple[Any, Any]:
    """The two motors of the shipped files, or two random models."""
    if k == 0:
        return rl.load(ROOT / "models" / "motor_nominal.h5"), rl.load(ROOT / "models" / "motor_perturbed.h5")
    rng = seeds(5, k)
    parts = [rng.standard_normal(shape) for shape in ((3, 3), (3, 2), (2, 3), (2, 2))]
    moved = [m * (1 + 0.1 * rng.standard_normal(m.shape) * (rng.random(m.shape) < 0.5)) for m in parts]
    return rl.StateSpaceModel(*parts), rl.StateSpaceModel(*moved)


def elementwise(structure: str) -> dict[str, Any]:
    """Blocks, and by how much the ends of the set miss the two models."""
    found = {}
    for k in range(3):
        ends = pair(k)
        made = rl.elementwise(*ends, structure)
        found[str(k)] = {
            "blocks": {b.name.replace(",", " "): b.rows for b in made.blocks},
            "residual": max(
                float(np.abs(getattr(made.evaluate({b.name: at for b in made.blocks}), m) - getattr(end, m)).max())
                for at, end in zip((0.0, 1.0), ends, strict=True)
                for m in "ABCD"
            ),
        }
    return found


def cover(form: str) -> dict[str, Any]:
    """A set around both motors."""
    made = rl.cover(pair(0), form)
    return {"status": made.status, "blocks": {b.name: b.rows for b in made.model.blocks}}


def samples() -> dict[str, Any]:
    """The first members of two seeds, with all corners of one."""
    found = {str(seed): rl.sample(motor(), 12, seed).deltas for seed in (0, 7)}
    found["corners"] = rl.sample(motor(), 2, 3, "all").deltas
    return {key: [[d[name] for name in sorted(d)] for d in deltas] for key, deltas in found.items()}


def arguments(metric: str) -> dict[str, Any]:
    """Return the arguments of a metric of a response."""
    if metric == "hinf":
        return {}
    return {"output": "omega", "t": STEP, "u": np.full(len(STEP), 42.0)}


def worst(metric: str) -> dict[str, Any]:
    """The worst member that is found."""
    found = rl.worst_case(motor(), metric, **arguments(metric))
    return {"status": found.status, "value": found.value, "nominal_value": found.nominal_value,
            "work": found.evaluations}  # fmt: skip


def probability(metric: str, limit: float) -> dict[str, Any]:
    """How probable it is that a limit is violated."""
    found = rl.violation_probability(motor(), metric, limit, n=200, seed=3, **arguments(metric))
    return {"status": found.status, "violations": found.violations, "probability": found.probability,
            "between": [found.lower, found.upper], "worst": found.worst_value, "index": found.worst_index}  # fmt: skip
