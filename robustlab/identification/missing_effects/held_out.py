"""Errors of models on held-out records, in windows and in free run, and the relevance of each effect there.

An effect is relevant if the RMS error without it is larger by the share `MATERIAL` and by the sensor's resolution, if
its force is such a share of the force at its joint, or if only parameters beyond tolerances could replace it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import gammaincinv

from robustlab.arrays import Array, Indices
from robustlab.dynamics.extended.simulator import Windows
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.identification import tuning
from robustlab.identification.greybox.effect_fit import Fit, FitPlan, Problem, simulated_outputs
from robustlab.identification.greybox.noise import clearly_larger, in_phase, restarted, spans, window_errors
from robustlab.identification.greybox.prepared_record import PreparedRecord
from robustlab.identification.missing_effects.discovery_result import LINEAR, Gap
from robustlab.identification.missing_effects.set_search import without

MOST_CLOCK = 3.0  # standard deviations of an input's clock
LIKELY = 0.999  # joint probability of the parameters beyond which they are improbable
TOGETHER = "all parameters together"


class Gaps(NamedTuple):
    """Errors by output in windows and in free run, whether the updated model is clearly worse, and signals."""

    windows: Mapping[str, Gap]
    free_run: Mapping[str, Gap]
    free_run_on: str
    worse: bool  # than the refitted one, in windows
    series: Mapping[str, Any]


class Simulated(NamedTuple):
    """A fit on held-out data: with re-estimated initial states, outputs of windows and whole runs by record."""

    problem: Problem
    fit: Fit
    windows: list[Array]
    runs: list[Array]


def simulated(held: Problem, fit: Fit, known: Sequence[PreparedRecord]) -> Simulated:
    """Simulate a fit on held-out windows and over each record."""
    # Initial states are re-estimated, and in records not ``known`` the phases of effects over time.
    own = in_phase(held, fit, known)[0]
    placed, runs = restarted(own, fit), [unbroken(record) for record in own.records]
    lengths = [r.windows.length for r in own.records]
    beginnings = [replace(r, windows=Windows(r.windows.starts, n)) for r, n in zip(runs, lengths, strict=True)]
    start = restarted(own.on(beginnings), fit)
    with np.errstate(all="ignore"):
        return Simulated(own, placed, simulated_outputs(own, placed), simulated_outputs(own.on(runs), start))


def _measured(held: Problem) -> tuple[list[Array], list[Array]]:
    """Return the measured outputs of the held-out windows and of the whole runs."""
    windows = [r.measured[chosen] for r, chosen in zip(held.records, held.chosen, strict=True)]
    return windows, [unbroken(record).measured for record in held.records]


def held_out_gaps(held: Problem, models: Mapping[str, Fit], known: Sequence[PreparedRecord]) -> Gaps:
    """Return errors of ``nominal``, ``refitted`` and ``updated`` on the held-out windows and whole records."""
    own = {name: simulated(held, fit, known) for name, fit in models.items()}
    outputs, free = {name: s.windows for name, s in own.items()}, {name: s.runs for name, s in own.items()}
    measured, followed = _measured(held)
    # Plot the record with most sensors.
    k = int(np.argmax([np.isfinite(r.y).any(axis=0).sum() for r in held.records]))
    first, windows = held.records[k], held.records[k].windows
    drawn = (windows.starts[held.chosen[k]][:, None] + np.arange(windows.length)).ravel()
    whole = unbroken(first).windows.starts[0] + np.arange(followed[k].shape[1])
    names = ", ".join(r.record.name for r in held.records)
    if isinstance(held.plant, NonlinearPlant):
        names += f" ({LINEAR})"
    partly = any(len(chosen) < r.count for r, chosen in zip(held.records, held.chosen, strict=True))
    return Gaps(
        _gaps(held, measured, outputs),
        _gaps(held, followed, free),
        f"all of {names}, which the fit saw in part" if partly else names,
        clearly_larger(*(window_errors(own[name].problem, own[name].fit) for name in ("updated", "refitted"))),
        _series(held, first, drawn, measured[k], {name: values[k] for name, values in outputs.items()})
        | {"free_run": _series(held, first, whole, followed[k], {name: values[k] for name, values in free.items()})},
    )


def unbroken(record: PreparedRecord) -> PreparedRecord:
    """Return the longest stretch of windows without a gap, as one window."""
    starts, length = record.windows.starts, record.windows.length
    groups = np.split(np.arange(len(starts)), np.flatnonzero(np.diff(starts) != length) + 1)
    longest = max(groups, key=len)
    a, b = longest[0], longest[-1]
    windows = Windows(starts[a : a + 1], int(starts[b] + length - starts[a]))
    return replace(record, windows=windows, x0=record.x0[a : a + 1], x0_std=record.x0_std[a : a + 1])


def _gaps(held: Problem, measured: Sequence[Array], outputs: Mapping[str, Sequence[Array]]) -> dict[str, Gap]:
    rms, ranges = {name: _rms(measured, measured, values) for name, values in outputs.items()}, spans(held.records)
    return {
        (signal := held.plant.outputs[column]).name: Gap(
            signal.name, signal.unit, float(ranges[j]), **{name: float(values[j]) for name, values in rms.items()}
        )
        for j, column in enumerate(held.records[0].columns)
        if any(np.isfinite(y[:, :, j]).any() for y in measured)
    }


def _rms(measured: Sequence[Array], ours: Sequence[Array], theirs: Sequence[Array]) -> Array:
    """Return the RMS difference of each output where it was measured, (n_measured,); infinite if a model diverges."""
    y, a, b = (np.concatenate([p.reshape(-1, p.shape[-1]) for p in parts]) for parts in (measured, ours, theirs))
    known = np.isfinite(y)
    with np.errstate(all="ignore"):
        difference = np.where(known, b - a, 0.0)
        difference[~np.isfinite(difference)] = np.inf
        return np.asarray(np.sqrt((difference**2).sum(axis=0) / np.maximum(known.sum(axis=0), 1)))


def _series(
    held: Problem, record: PreparedRecord, samples: Indices, measured: Array, outputs: Mapping[str, Array]
) -> dict[str, Any]:
    """Return time, inputs and outputs of one record at these samples; NaN for diverged outputs."""
    signals = {}
    for j, column in enumerate(record.columns):
        if np.isfinite(measured[:, :, j]).any():
            own = {name: np.where(np.isfinite(y), y, np.nan)[:, :, j].ravel() for name, y in outputs.items()}
            signals[held.plant.outputs[column].name] = {"measured": measured[:, :, j].ravel(), **own}
    inputs = {s.name: record.record.inputs[s.name][samples] for s in held.plant.inputs}
    return {"t": record.record.t[samples], "record": record.record.name, "inputs": inputs, "outputs": signals}


def without_effects(problem: Problem, fit: Fit, keys: Collection[str]) -> Fit:
    """Refit the set without these effects, from the parameters of the whole set."""
    while (k := next((k for k, c in enumerate(fit.hypothesis.candidates) if c.key in keys), None)) is not None:
        hypothesis, z = without(problem, fit, k)
        fit = problem.fit(hypothesis, fit.noise, z, fit.starts, FitPlan(tuning.FULL))
    return fit


def at_limits(problem: Problem, fit: Fit) -> frozenset[str]:
    """Return labels of the nuisances that a fit moved beyond their limits, and `TOGETHER` if all are improbable."""
    moving = problem.moving(fit.hypothesis)
    own = [
        (n, float(z), (-MOST_CLOCK, MOST_CLOCK) if n.input else n.ends)
        for n, moves, z in zip(problem.nuisances, moving, fit.z, strict=False) if moves
    ]  # fmt: skip
    found = {n.label for n, z, (low, high) in own if not low <= z <= high}
    if sum(z**2 for _, z, _ in own) > 2.0 * gammaincinv(max(1, len(own)) / 2, LIKELY):
        found.add(TOGETHER)
    return frozenset(found)


def is_relevant(held: Problem, whole: Simulated, less: Simulated) -> bool:
    """Return whether the errors on held-out data are larger with the set ``less`` an effect than with the whole one."""
    resolution, runs = np.max([r.resolution for r in held.records], axis=0), _measured(held)
    for measured, ours, theirs in zip(runs, (whole.windows, whole.runs), (less.windows, less.runs), strict=True):
        own, other = _rms(measured, measured, ours), _rms(measured, measured, theirs)
        with np.errstate(all="ignore"):
            worse = ~(other - own < tuning.MATERIAL * own)  # true for a diverged model
            apart = _rms(measured, ours, theirs)
            if np.any(worse & (own < np.inf) & ~(apart < 0.5 * resolution) & ~(other <= own)):
                return True
    return False
