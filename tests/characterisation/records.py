"""Records against models: comparison with three of them, and sets validated by twelve."""

from collections.abc import Iterator
from typing import Any

import numpy as np

import robustlab as rl

from .cases import ROOT, SHARED, Case, seeds

RTOL = 1e-6
DT = 0.01


def cases() -> Iterator[Case]:
    """Three comparisons, twelve validations."""
    data = ROOT / "recipes" / "data"
    motor = (data / "motor_record.csv", None, ["u"], ["phi", "i"])
    jig = (data / "jig_rich.csv", None, ["u"], None)
    emps = (SHARED / "emps.h5", "train", ["u"], ["q"])
    yield Case("compare motor", lambda: compare("dc-motor", *motor))
    yield Case("compare actuator", lambda: compare("linear-actuator", *jig))
    yield Case("compare EMPS", lambda: compare("servo-axis", *emps), shared=True)
    for k, n in ((1, 80), (2, 120), (2, 60)):
        yield Case(f"validate time-varying {k} {n}", lambda k=k, n=n: additive(k, n))
    for k in (1, 2, 3):
        yield Case(f"validate constants {k}", lambda k=k: constants(k), k > 2)
    for form in ("additive", "output-multiplicative", "inverse-output-multiplicative"):
        yield Case(f"validate over frequency, {form}", lambda form=form: steady(form))


def compare(plant: str, path: Any, group: str | None, inputs: list[str], outputs: list[str] | None) -> dict[str, Any]:
    """Where a plant misses a record."""
    found = rl.compare(rl.plant(plant), rl.Record.read(path, group, inputs, outputs))
    keys = ("range", "peak", "rms", "fit", "peak_time", "windowed_peak", "windowed_rms", "windowed_fit")
    return {"status": found.status, "outputs": {
        name: {key: getattr(gap, key) for key in keys} for name, gap in found.outputs.items()}}  # fmt: skip


def validate(model: Any, record: Any, noise: dict[str, float], **options: Any) -> dict[str, Any]:
    """The smallest scaling of the set that explains a record."""
    found = rl.validate(model, record, noise, **options)
    return {"status": found.status, "invalidated": found.invalidated,
            "scaling": {"lower": found.lower, "upper": found.upper}}  # fmt: skip


def additive(k: int, n: int) -> dict[str, Any]:
    """y = sum of G_i w_i with z_i = u_i and w_i late by some samples, with more noise than is stated."""
    rng = seeds(6, k, n)
    a, b = rng.uniform(0.2, 0.9, k), rng.uniform(0.5, 2.0, k)
    A, none, eye = np.diag(a), np.zeros((k, k)), np.eye(k)
    B, C = np.hstack([eye, none]), np.vstack([none, (0.5 * b)[None]])
    D = np.block([[none, eye], [b[None], np.zeros((1, k))]])
    names = [*(f"w{i}" for i in range(k)), *(f"u{i}" for i in range(k))], [*(f"z{i}" for i in range(k)), "y"]
    model = rl.UncertainModel(
        rl.StateSpaceModel(A, B, C, D, DT, *names), [rl.FullBlock(f"d{i}", 1, 1) for i in range(k)]
    )
    t, u = np.arange(n) * DT, rng.standard_normal((k, n))
    y = np.zeros(n)
    for i in range(k):
        late = np.concatenate([np.zeros(3 + i), u[i]])[:n] * 0.7
        y += np.convolve(np.r_[b[i], 0.5 * b[i] * a[i] ** np.arange(n - 1)], late)[:n]
    size = 0.05 * float(np.abs(y).max())
    record = rl.Record(t, {f"u{i}": u[i] for i in range(k)}, {"y": y + 1.2 * size * rng.uniform(-1, 1, n)})
    return validate(model, record, {"y": size}, at_rest=True)


def constants(k: int) -> dict[str, Any]:
    """A mass on a spring whose constants are off by more than the set allows."""
    ranges = {"c": (1.5, 0.25), "k": (8.0, 0.25), "m": (2.0, 0.1)}
    true = {"c": 1.5 * 1.3, "k": 8.0 * 0.8, "m": 2.0 * 1.05}
    named = list(ranges)[:k]
    model = rl.plant("mass-spring-damper", **{"m": 2.0, "c": 1.5, "k": 8.0} | {key: ranges[key] for key in named})
    machine = rl.plant("mass-spring-damper", **{"m": 2.0, "c": 1.5, "k": 8.0} | {key: true[key] for key in named})
    rng, t = seeds(7, k), np.arange(150) * 0.05
    force = np.repeat(rng.choice([-1.0, 1.0], 10), 15)
    y = rl.simulate(machine, t, {"f": force})["q"]
    size = 0.02 * float(np.abs(y).max())
    record = rl.Record(t, {"f": force}, {"q": y + 0.9 * size * rng.uniform(-1, 1, len(t))})
    return validate(model.uncertain(outputs=["q"]), record, {"q": size}, at_rest=True)


def steady(form: str) -> dict[str, Any]:
    """Whole periods of a lag whose gain is off by 30 %, in a set of 20 %."""
    G = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], 0.0, ["u"], ["y"])
    rng, n, periods = seeds(8), 64, 3
    phases = rng.uniform(0, 2 * np.pi, 5)
    u = np.cos(2 * np.pi * np.outer(np.arange(n), np.arange(1, 6)) / n + phases).sum(axis=1)
    many = np.tile(u, periods + 8)
    y = 1.3 * rl.simulate(G, np.arange(len(many)) * 0.2, {"u": many})["y"][-n * periods :]
    size = 0.02 * float(np.abs(y).max())
    noise = 0.5 * size * rng.uniform(-1, 1, len(y))
    record = rl.Record(np.arange(len(y)) * 0.2, {"u": np.tile(u, periods)}, {"y": y + noise})
    return validate(rl.unstructured(G, 0.2, form), record, {"y": size}, domain="frequency")
