r"""Two programs to compare with, both a regression of the force that the nominal model lacks.

For every velocity of the model the rate it lacks, :math:`\dot v - (A x + B u)_v` with smoothed derivatives of the
measured positions and the electric states at rest, is regressed on a library of terms of position, velocity, input and
time. ``stepwise`` adds the term that lowers Schwarz's criterion (BIC) most while one does, as forward stepwise
regression is taught; ``sindy`` is PySINDy's sequentially thresholded least squares with its threshold by the same
criterion (Kaheman et al., *Learning discrepancy models from experimental data*, 2019). A term is a kind; a factor of a
model's own term is one only where it leaves the tolerances.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WINDOW, EDGE, EVERY = 31, 60, 5  # samples: of the Savitzky-Golay filter, left out at the ends, thinning
ORDERS = (1.0, 2.0, 4.0, 7.0, 13.0)  # a unit of length: lines over the position
MOST_TERMS = 4
LEAST_SHARE = 0.05  # of the missing rate, for a term to be named
THRESHOLDS = np.geomspace(3e-3, 0.5, 14)


class Problem(NamedTuple):
    """Terms (label -> (n,)), the rate that is missing (n,), the kind and effect of each term."""

    columns: dict[str, Array]
    target: Array
    names: dict[str, tuple[str, str]]
    joint: str
    nominal: dict[str, float]  # of the terms that the model has itself
    tolerance: float


def answer(folder: Path, program: str) -> dict[str, Any]:
    """Return the answer of one of the programs to a case."""
    began = time.process_time()
    named: list[dict[str, Any]] = []
    for problem in _problems(folder):
        for label in PROGRAMS[program](problem):
            kind, effect = problem.names[label]
            entry = {"kind": kind, "at": problem.joint, "effect": effect}
            if kind not in [n["kind"] for n in named]:
                named.append(entry)
    result = {"verdict": "named" if named else "nothing", "named": named, "possible": [n["kind"] for n in named]}
    return result | {"complete": True, "seconds": round(time.process_time() - began, 3)}


def _problems(folder: Path) -> list[Problem]:
    """Return a problem for every velocity whose position is measured."""
    plant = _model(folder / "model.h5")
    with h5py.File(folder / "records.h5") as file:
        record = {name: (np.asarray(d), d.attrs["role"]) for name, d in file["record"].items()}
    t = record["t"][0]
    dt = float(np.median(np.diff(t)))
    states = plant.states
    x = np.zeros((len(t), len(states)))
    rate = np.zeros_like(x)
    u = np.column_stack([_smooth(record[name][0], dt) for name in plant.inputs])
    places = {
        k: j
        for k in range(len(states)) if states[k][1] in ("rad/s", "m/s")
        for j in range(len(states)) if plant.A[j, k] == 1.0 and not np.delete(plant.A[j], k).any()
    }  # fmt: skip
    for k, j in places.items():
        shown = [i for i, row in enumerate(plant.C) if row[j] == 1.0 and plant.outputs[i] in record]
        if shown:
            measured = record[plant.outputs[shown[0]]][0]
            x[:, j], x[:, k], rate[:, k] = (_smooth(measured, dt, d) for d in (0, 1, 2))
    electric = [k for k, (_, unit) in enumerate(states) if unit == "A"]
    if electric:  # di/dt = 0
        inner = plant.A[np.ix_(electric, electric)]
        outer = x @ plant.A[electric].T + u @ plant.B[electric].T
        x[:, electric] = -np.linalg.solve(inner, outer.T).T
    model = x @ plant.A.T + u @ plant.B.T
    return [
        _problem(x[:, j], x[:, k], rate[:, k], model[:, k], u[:, 0], dt, states[k][0], plant.tolerance)
        for k, j in places.items()
    ]


class Model(NamedTuple):
    """Contents of a model file: matrices, names, (name, unit) of the states, the largest relative tolerance."""

    A: Array
    B: Array
    C: Array
    inputs: list[str]
    states: list[tuple[str, str]]
    outputs: list[str]
    tolerance: float


def _model(path: Path) -> Model:
    with h5py.File(path) as file:
        names = {
            role: [
                tuple(text.decode() for text in row)
                for row in zip(*(file[f"signals/{role}/{column}"][()] for column in ("name", "unit")), strict=True)
            ]
            for role in ("input", "state", "output")
        }
        tolerance = np.nan_to_num(file["plant/parameters/tolerance"][()]).max()
        return Model(
            *(file[matrix][()] for matrix in "ABC"),
            inputs=[name for name, _ in names["input"]],
            states=names["state"],
            outputs=[name for name, _ in names["output"]],
            tolerance=float(tolerance),
        )


def _smooth(x: Array, dt: float, derivative: int = 0) -> Array:
    from scipy.signal import savgol_filter

    return np.asarray(savgol_filter(x, WINDOW, 3, derivative, dt), dtype=float)


def _problem(q: Array, v: Array, a: Array, model: Array, u: Array, dt: float, joint: str, tolerance: float) -> Problem:
    sign = np.tanh(v / (0.01 * np.abs(v).max() + 1e-300))
    length = 1.0 if np.ptp(q) > 1.0 else np.ptp(q) / 10.0
    terms: dict[str, tuple[Array, str, str]] = {
        "1": (np.ones_like(v), "load", "constant-load"),
        "sgn v": (sign, "dry-friction", "coulomb-friction"),
        "|v|": (np.abs(v), "speed-friction", "asymmetric-viscous-friction"),
        "v|v|": (v * np.abs(v), "speed-friction", "quadratic-drag"),
        "v": (v, "speed-friction", "viscous-friction"),
        "q": (q, "spring", "stiffness"),
        "q^3": (q**3, "spring", "cubic-stiffness"),
        "max(q, 0)": (np.maximum(q, 0.0), "spring", "one-sided-spring"),
        "u": (u, "factor", "input-gain"),
        "sgn u": (np.sign(u), "gap-or-limit", "input-dead-zone"),
        "u^3": (u**3, "gap-or-limit", "input-saturation"),
        "du/dt": (np.gradient(u, dt), "lateness", "input-delay"),
        "t u": (np.arange(len(u)) / len(u) * u, "factor", "resistance-heating"),
        "|T| sgn v": (np.abs(model) * sign, "dry-friction", "gear-efficiency"),
    }
    for n in ORDERS:
        for wave in (np.cos, np.sin):
            terms[f"{wave.__name__}({n:g} q)"] = (wave(n * q / length), "periodic-force", "cogging")
    used = slice(EDGE, -EDGE, EVERY)
    columns = {name: column[used] for name, (column, _, _) in terms.items()}
    kinds = {name: (kind, effect) for name, (_, kind, effect) in terms.items()}
    own = np.linalg.lstsq(np.column_stack([q, v, u]), model, rcond=None)[0]
    largest = np.abs(own) * np.std([q, v, u], axis=1)
    nominal = {
        name: float(c) for name, c, s in zip("qvu", own, largest, strict=True) if s > 1e-6 * largest.max()
    }  # fmt: skip
    return Problem(columns, (a - model)[used], kinds, joint, nominal, tolerance)


def _worth(problem: Problem, chosen: list[str]) -> list[str]:
    """Return the terms with a relevant share of the missing rate; own terms changed within tolerance do not count."""
    if not chosen:
        return []
    x = np.column_stack([problem.columns[c] for c in chosen])
    c = np.linalg.lstsq(x, problem.target, rcond=None)[0]
    change = {name: abs(c[k] / problem.nominal[name]) for k, name in enumerate(chosen) if name in problem.nominal}
    within = {name for name, by in change.items() if by <= problem.tolerance}
    sizes = {name: float(np.std(x[:, k] * c[k]) + abs(np.mean(x[:, k]) * c[k]) * (name == "1"))
             for k, name in enumerate(chosen)}  # fmt: skip
    least = LEAST_SHARE * sum(sizes.values())
    return [name for name, size in sizes.items() if size >= least and name not in within]


def _bic(x: Array, y: Array) -> float:
    rest = y - x @ np.linalg.lstsq(x, y, rcond=None)[0] if x.shape[1] else y
    return len(y) * float(np.log(np.mean(rest**2) + 1e-300)) + x.shape[1] * float(np.log(len(y)))


def stepwise(problem: Problem) -> list[str]:
    """Forward selection by BIC, from the model's own terms on: those are known to be inexact."""
    chosen = list(problem.nominal)
    most = len(chosen) + MOST_TERMS

    def criterion(names: list[str]) -> float:
        columns = [problem.columns[n] for n in names]
        return _bic(np.column_stack(columns) if columns else np.zeros((len(problem.target), 0)), problem.target)

    best = criterion(chosen)
    while len(chosen) < most:
        tried = {name: criterion([*chosen, name]) for name in problem.columns if name not in chosen}
        name = min(tried, key=lambda n: tried[n])
        if tried[name] >= best:
            break
        best = tried[name]
        chosen.append(name)
    return _worth(problem, chosen)


def thresholded(labels: Sequence[str], x: Array, y: Array) -> Array:
    """Coefficients (n_terms,) of sequentially thresholded least squares (PySINDy), the threshold chosen by BIC.

    Of terms x (n, n_terms), a constant called "1" among them, for y (n,).
    """
    import pysindy as ps

    scale = np.array([1.0 if label == "1" else x[:, k].std() + 1e-12 for k, label in enumerate(labels)])
    height = y.std() + 1e-300
    best, chosen = np.inf, np.zeros(len(labels))
    for threshold in THRESHOLDS:
        optimizer = ps.STLSQ(threshold=threshold, alpha=1e-6, max_iter=30)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # "all coefficients eliminated" is a valid result here
            optimizer.fit(x / scale, (y / height)[:, None])
        c = np.asarray(optimizer.coef_).ravel()
        rest = y / height - (x / scale) @ c
        bic = len(rest) * np.log(np.mean(rest**2) + 1e-30) + np.count_nonzero(c) * np.log(len(rest))
        if bic < best:
            best, chosen = float(bic), c * height / scale
    return chosen


def sindy(problem: Problem) -> list[str]:
    labels = list(problem.columns)
    c = thresholded(labels, np.column_stack(list(problem.columns.values())), problem.target)
    return _worth(problem, [label for label, value in zip(labels, c, strict=True) if value])


PROGRAMS = {"stepwise": stepwise, "sindy": sindy}
