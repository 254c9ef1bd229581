"""How far models stay from records that no fit saw, in windows and in free run, and what each name contributes there.

An effect is material where the RMS error without it is larger by a share and by what the sensor resolves, where its
force is such a share of what moves its joint, or where only parameters beyond tolerances could replace it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import chi2

from robustlab.arrays import Array, Indices
from robustlab.dynamics.extended.simulator import Windows
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.identification import tuning
from robustlab.identification.hypotheses.effect_fit import Fit, FitPlan, Problem, simulated_outputs
from robustlab.identification.hypotheses.noise import clearly_larger, in_phase, restarted, spans, window_errors
from robustlab.identification.hypotheses.prepared_record import PreparedRecord
from robustlab.identification.naming.discovery_result import Gap, overall
from robustlab.identification.naming.first_look import without

MOST_CLOCK = 3.0  # standard deviations of an input's clock
LIKELY = 0.999  # probability within which the parameters lie together; within tolerances they always do
TOGETHER = "all parameters together"


@dataclass(frozen=True, eq=False)
class Gaps:
    """Errors by output in windows and in free run, whether the updated are clearly worse, and signals."""

    windows: Mapping[str, Gap]
    free_run: Mapping[str, Gap]
    free_run_on: str
    worse: bool
    series: Mapping[str, Any]

    @property
    def worse_than_given(self) -> bool:
        """Whether the updated model's free run has a larger error than that of the model as given."""
        return overall(self.free_run, "updated") > overall(self.free_run, "nominal")


def held_out_gaps(held: Problem, models: Mapping[str, Fit], known: Sequence[PreparedRecord] = ()) -> Gaps:
    """Errors of ``nominal``, ``refitted`` and ``updated`` on the held-out windows and over their whole records."""
    # Parameters stay, window starts are found anew; so are phases of effects over time in records not known.
    own = {name: in_phase(held, fit, known)[0] for name, fit in models.items()}
    placed = {name: restarted(own[name], fit) for name, fit in models.items()}
    outputs = {name: simulated_outputs(own[name], fit) for name, fit in placed.items()}
    runs = [unbroken(record) for record in held.records]
    free = {
        name: run_free(own[name], [unbroken(record) for record in own[name].records], fit)
        for name, fit in models.items()
    }
    measured = [r.measured[chosen] for r, chosen in zip(held.records, held.chosen, strict=True)]
    followed = [r.measured for r in runs]
    # The record with most sensors is drawn.
    k = int(np.argmax([np.isfinite(r.y).any(axis=0).sum() for r in held.records]))
    first, windows = held.records[k], held.records[k].windows
    drawn = (windows.starts[held.chosen[k]][:, None] + np.arange(windows.length)).ravel()
    whole = runs[k].windows.starts[0] + np.arange(runs[k].windows.length)
    names = ", ".join(r.record.name for r in held.records)
    if isinstance(held.plant, NonlinearPlant):
        names += " (linear about the recorded motion)"
    partly = any(len(chosen) < r.count for r, chosen in zip(held.records, held.chosen, strict=True))
    return Gaps(
        _gaps(held, measured, outputs),
        _gaps(held, followed, free),
        f"all of {names}, which the fit saw in part" if partly else names,
        clearly_larger(*(window_errors(own[name], placed[name]) for name in ("updated", "refitted"))),
        _series(held, first, drawn, measured[k], {name: values[k] for name, values in outputs.items()})
        | {"free_run": _series(held, first, whole, followed[k], {name: values[k] for name, values in free.items()})},
    )


def unbroken(record: PreparedRecord) -> PreparedRecord:
    """The longest stretch of a record whose windows follow each other without a gap, as one window."""
    starts, length = record.windows.starts, record.windows.length
    groups = np.split(np.arange(len(starts)), np.flatnonzero(np.diff(starts) != length) + 1)
    longest = max(groups, key=len)
    a, b = longest[0], longest[-1]
    windows = Windows(starts[a : a + 1], int(starts[b] + length - starts[a]))
    return replace(record, windows=windows, x0=record.x0[a : a + 1], x0_std=record.x0_std[a : a + 1])


def run_free(held: Problem, runs: Sequence[PreparedRecord], fit: Fit) -> list[Array]:
    """Outputs of one simulation over each run, (1, length, n_measured), from the state that its first window tells."""
    lengths = [r.windows.length for r in held.records]
    beginnings = [replace(r, windows=Windows(r.windows.starts, n)) for r, n in zip(runs, lengths, strict=True)]
    start = restarted(held.on(beginnings), fit)
    with np.errstate(all="ignore"):
        return simulated_outputs(held.on(runs), start)


def _gaps(held: Problem, measured: Sequence[Array], outputs: Mapping[str, Sequence[Array]]) -> dict[str, Gap]:
    found = {}
    for j, (column, span) in enumerate(zip(held.records[0].columns, spans(held.records), strict=True)):
        if not any(np.isfinite(y[:, :, j]).any() for y in measured):
            continue
        signal = held.plant.outputs[column]
        rms = {
            name: _rms(
                [(y - model)[:, :, j][np.isfinite(y[:, :, j])] for y, model in zip(measured, values, strict=True)]
            )
            for name, values in outputs.items()
        }
        found[signal.name] = Gap(signal.name, signal.unit, float(span), **rms)
    return found


def _rms(errors: Sequence[Array]) -> float:
    """Over all samples; infinite where a model's output is no number any more."""
    with np.errstate(over="ignore"):
        value = float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
    return value if np.isfinite(value) else np.inf


def _series(
    held: Problem, record: PreparedRecord, samples: Indices, measured: Array, outputs: Mapping[str, Array]
) -> dict[str, Any]:
    """Clock, inputs and outputs of one record at these samples; outputs beyond numbers are NaN."""
    signals = {}
    for j, column in enumerate(record.columns):
        if np.isfinite(measured[:, :, j]).any():
            own = {name: np.where(np.isfinite(y), y, np.nan)[:, :, j].ravel() for name, y in outputs.items()}
            signals[held.plant.outputs[column].name] = {"measured": measured[:, :, j].ravel(), **own}
    inputs = {s.name: record.record.inputs[s.name][samples] for s in held.plant.inputs}
    return {"t": record.record.t[samples], "record": record.record.name, "inputs": inputs, "outputs": signals}


@dataclass(frozen=True)
class Matter:
    """Whether an effect is material, and the held-out error without it: of windows, in percent of the range."""

    material: bool
    error_without: float


@dataclass(frozen=True, eq=False)
class Errors:
    """Held-out errors of one model: of its windows and of whole runs, one array (..., n_measured) a record."""

    windows: Sequence[Array]
    runs: Sequence[Array]


def errors_of(held: Problem, fit: Fit, known: Sequence[PreparedRecord]) -> Errors:
    """Errors of a fit on held-out windows, starts found anew, and from each record's own start to its end."""
    own = in_phase(held, fit, known)[0]
    placed = restarted(own, fit)
    windows = [
        record.measured[chosen] - outputs
        for record, chosen, outputs in zip(own.records, own.chosen, simulated_outputs(own, placed), strict=True)
    ]
    runs = [unbroken(record) for record in own.records]
    return Errors(windows, [r.measured - y for r, y in zip(runs, run_free(own, runs, fit), strict=True)])


def without_effects(problem: Problem, fit: Fit, keys: Collection[str]) -> Fit:
    """The set without these effects, refitted from where the whole set stands."""
    while (k := next((k for k, c in enumerate(fit.hypothesis.candidates) if c.key in keys), None)) is not None:
        hypothesis, z = without(problem, fit, k)
        fit = problem.fit(hypothesis, fit.noise, z, fit.starts, FitPlan(tuning.FULL))
    return fit


def strained(problem: Problem, fit: Fit) -> frozenset[str]:
    """Labels of the nuisances that a fit has taken beyond what they may be, and `TOGETHER` where all are improbable."""
    moving = problem.moving(fit.hypothesis)
    own = [(n, float(z)) for n, moves, z in zip(problem.nuisances, moving, fit.z, strict=False) if moves]
    found = set()
    for nuisance, z in own:
        low, high = (-MOST_CLOCK, MOST_CLOCK) if nuisance.input else nuisance.ends
        if not low <= z <= high:
            found.add(nuisance.label)
    if sum(z**2 for _, z in own) > chi2.ppf(LIKELY, max(1, len(own))):
        found.add(TOGETHER)
    return frozenset(found)


def late_clocks(problem: Problem, fit: Fit) -> frozenset[str]:
    """Labels of the clocks that a fit has moved further than clocks are off: they stand for a lateness."""
    return strained(problem, fit) & {n.label for n in problem.nuisances if n.input}


def matter_of(held: Problem, whole: Errors, less: Errors, needed: bool) -> Matter:
    """What is missing in ``less`` brings to ``whole``; ``needed``: it is material whatever the errors say."""
    ranges = spans(held.records)
    seen = ranges > 0.0
    with np.errstate(over="ignore"):
        share = _rms_by_output(less.windows)[seen] / ranges[seen]
    resolution = np.max([r.resolution for r in held.records], axis=0)
    material = needed or any(
        _matters(ours, theirs, resolution, tuning.MATERIAL)
        for ours, theirs in ((whole.windows, less.windows), (whole.runs, less.runs))
    )
    return Matter(material, 100.0 * float(np.sqrt(np.mean(share**2))))


def _matters(ours: Sequence[Array], theirs: Sequence[Array], resolution: Array, share: float) -> bool:
    with np.errstate(all="ignore"):
        own, other = _rms_by_output(ours), _rms_by_output(theirs)
        apart = _rms_by_output([b - a for a, b in zip(ours, theirs, strict=True)])
        worse = ~(other - own < share * own)  # a model that diverges without it is worse, too
        return bool(np.any(worse & (own < np.inf) & ~(apart < 0.5 * resolution) & ~(other <= own)))


def _rms_by_output(errors: Sequence[Array]) -> Array:
    """Over all known samples of each output, (n_measured,); infinite where a model's output is no number any more."""
    rows = np.concatenate([e.reshape(-1, e.shape[-1]) for e in errors])
    return np.sqrt(np.nansum(rows**2, axis=0) / np.maximum(np.sum(~np.isnan(rows), axis=0), 1))
