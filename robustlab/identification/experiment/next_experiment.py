r"""What to measure next, so that hypotheses which the present records leave open can be told apart (T-optimality).

For every test signal s, every set of sensors and every pair of open hypotheses, A predicts the outputs from rest and B
is refitted to them, :math:`d^2 = \min_{z, \xi} V_B(z, \xi; \hat y_A) - \|z_B\|^2`; proposed is :math:`\arg\max_s
\min_{A \ne B} d_s(A, B)`, and of several that are safe the one with fewest sensors to add, then the shortest. Where B
contains A only the richer one is taken for the truth. The prior that B pays for the present records is not counted.

Atkinson, Fedorov, "The design of experiments for discriminating between two rival models", Biometrika 62 (1975) 57-70.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.errors import InputError, unknown_name
from robustlab.identification import tuning
from robustlab.identification.experiment.experiment_bench import (
    SAFE,
    Bench,
    Entry,
    Limits,
    Pair,
    distances,
    noise_of,
    trials_of,
)
from robustlab.identification.hypotheses.effect_fit import Fit, Problem
from robustlab.result import Evidence
from robustlab.shown import Facts

MOST_OPPONENTS = 3  # rivals that it is to tell from the named effect
LONGEST_EXPERIMENT = 5000  # samples
TIME_CONSTANTS_SEEN = 20.0  # slowest time constants of the plant in an experiment, at least
TIME_CONSTANTS_A_BEAT = 8.0  # the same in a beat of the signals
MOST_BEATS = 16  # in an experiment
FEWEST_BEATS = 4
CANNOT_TELL = 3.0  # noise sigmas


class Tried(NamedTuple):
    """One entry of the menu: signal, sensors, duration in s, smallest d; refitted, or from the linearised refit."""

    name: str
    sensors: tuple[str, ...]
    duration: float
    separation: float
    refitted: bool


@dataclass(frozen=True)
class NextExperiment(Evidence):
    """The experiment to make next."""

    name: str  # entry of the menu
    description: str  # signal, duration and sensors in words
    advice: str  # where the experiment is not safe to separate the hypotheses: what else would
    t: Array  # clock in s, (n,)
    # inputs, units: input -> samples (n,), each held until the next; input -> unit. Of a platform under control the
    # references of its nut angles, for the controller, and the poses that they belong to
    inputs: Mapping[str, Array]
    units: Mapping[str, str]
    duration: float  # in s
    # sensors, added: outputs to record; those of them that were not recorded so far
    sensors: tuple[str, ...]
    added: tuple[str, ...]
    assumed_noise: Mapping[str, float]  # added sensor -> standard deviation that was assumed for it, in its unit
    # smallest predicted refit distance d over all pairs of open hypotheses, in noise sigmas: below 3 nothing will be
    # told, beyond 10 it is safe
    separation: float
    if_named: float  # the same over the pairs with the named hypothesis as the truth
    now: float  # smallest refit distance of the named hypothesis and a rival for the present records (`refit_distance`)
    hypotheses: tuple[str, ...]  # what is to be separated, the named one first
    pairs: tuple[Pair, ...]  # d of each ordered pair
    menu: tuple[Tried, ...]  # all that was tried

    @property
    def separates(self) -> bool:
        """True where the choice will be safe (d of 10 or more)."""
        return self.separation >= SAFE

    def facts(self) -> Facts:
        """Description, predicted separation, and what else would help."""
        told = f"{self.separation:.3g} noise sigmas of {', '.join(self.hypotheses)}"
        now = f"present records: {self.now:.3g}; 3 tell, {SAFE:.0f} are safe"
        return [("signal", self.description), ("predicted separation", f"{told} ({now})"), ("or", self.advice)]

    def save(self, path: str | Path) -> Path:
        """Write the signal as a text table: a head of names, then the clock in s and each input, sample by sample."""
        from robustlab.files.atomic import atomic_write

        table = np.column_stack([self.t, *self.inputs.values()])
        lines = [",".join(["t", *self.inputs]), *(",".join(f"{v:.9g}" for v in row) for row in table)]
        text = "\n".join(lines) + "\n"
        return atomic_write(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def propose_experiment(
    problem: Problem,
    named: Fit,
    rivals: Sequence[Fit],
    *,
    input_range: Mapping[str, tuple[float, float]] | None = None,
    travel: Mapping[str, float] | None = None,
    longest: float | None = None,
    may_add: Sequence[str] | None = None,
) -> NextExperiment | None:
    """The experiment of the menu that separates the named hypothesis and its rivals best; None where none can.

    By default inputs stay within the recorded sizes, positions in m within their recorded range, and the experiment is
    as long as the longest record.
    """
    rivals = [r for r in rivals if r.hypothesis.key != named.hypothesis.key]
    if not rivals:
        return None
    open_ones = [named, *sorted(rivals, key=lambda f: -f.evidence)[:MOST_OPPONENTS]]
    labels = labels_of(open_ones)
    limits = _limits(problem, input_range, travel, longest, may_add)
    trials = trials_of(problem, open_ones, limits)
    if not trials:
        return None
    noise, assumed = noise_of(problem, named.noise, trials)
    bench = Bench(problem, tuple(open_ones), labels, noise)
    screened = sorted((e for trial in trials for e in bench.screened(trial, limits)), key=bench.preference)
    chosen, pairs, refitted = bench.best_refitted(screened)
    now = min(p.separation for p in distances(problem, open_ones, labels))
    done = {(e.trial.excitation.name, e.sensors, e.count): e for e in refitted}
    menu = [done.get((e.trial.excitation.name, e.sensors, e.count), e) for e in screened]
    return _proposal(
        problem,
        chosen,
        pairs,
        now,
        labels,
        open_ones,
        assumed,
        [_tried(problem, e) for e in sorted(menu, key=bench.preference)],
        limits,
    )


# --- limits ----------------------------------------------------------------------------------------------------------


def _limits(
    problem: Problem,
    input_range: Mapping[str, tuple[float, float]] | None,
    travel: Mapping[str, float] | None,
    longest: float | None,
    may_add: Sequence[str] | None,
) -> Limits:
    plant, records = problem.plant, problem.records
    first = records[0]
    dt, length = first.record.dt, first.windows.length
    outputs = [s.name for s in plant.outputs]
    _known("may_add", may_add or (), outputs)
    new = [k for k, name in enumerate(outputs) if k not in first.columns and (may_add is None or name in may_add)]
    slowest = _slowest(problem)
    fewest = tuning.FEWEST_WINDOWS * length
    if longest is None:
        wanted = max(round(TIME_CONSTANTS_SEEN * slowest / dt), *(r.record.n for r in records))
        samples = max(min(wanted, LONGEST_EXPERIMENT), fewest)
    else:
        if not fewest * dt <= longest < np.inf:
            raise InputError(
                "propose_experiment: longest", f"{longest:g} s", f"at least {fewest * dt:g} s (four windows)"
            )
        samples = round(longest / dt)
    duration = samples * dt
    shortest, longest_beat = duration / MOST_BEATS, duration / FEWEST_BEATS
    beat = min(max(TIME_CONSTANTS_A_BEAT * slowest, shortest), longest_beat)
    return Limits(_ranges(problem, input_range), _travel(problem, travel), samples, beat, tuple(new))


def _slowest(problem: Problem) -> float:
    """Slowest time constant of the nominal plant, a linear one, in s; integrators do not count."""
    assert isinstance(problem.plant, LinearPlant)
    rates = np.abs(problem.plant.state_space().poles().real)
    rates = rates[rates > 1e-9 * rates.max(initial=1e-300)]
    return float(1.0 / rates.min()) if len(rates) else 0.0


def _ranges(problem: Problem, given: Mapping[str, tuple[float, float]] | None) -> dict[str, tuple[float, float]]:
    names = [s.name for s in problem.plant.inputs]
    _known("input_range", given or (), names)
    both_ways = any(unit in ("rad/s", "m/s") for _, unit in problem.plant.states)
    ranges = {}
    for k, name in enumerate(names):
        lowest = min(float(r.u[:, k].min()) for r in problem.records)
        highest = max(float(r.u[:, k].max()) for r in problem.records)
        if both_ways:
            highest = max(abs(lowest), abs(highest))
            lowest = -highest
        if given and name in given:
            lowest, highest = (float(v) for v in given[name])
            if not -np.inf < lowest < highest < np.inf:
                raise InputError(f"propose_experiment: input_range of {name}", f"{given[name]}", "lowest < highest")
        ranges[name] = (lowest, highest)
    return ranges


def _travel(problem: Problem, given: Mapping[str, float] | None) -> dict[int, float]:
    names = [s.name for s in problem.plant.states]
    _known("travel", given or (), names)
    limits = {}
    for k, (name, unit) in enumerate(problem.plant.states):
        if given and name in given:
            if not given[name] > 0:
                raise InputError(f"propose_experiment: travel of {name}", f"{given[name]}", "a positive range")
            limits[k] = float(given[name])
        elif unit == "m":
            limits[k] = max(float(np.ptp(r.smoothed.x[:, k])) for r in problem.records)
    return limits


def _known(what: str, given: Sequence[str] | Mapping[str, object], names: Sequence[str]) -> None:
    for name in given:
        if name not in names:
            raise unknown_name(f"propose_experiment: {what}", f"no {name!r}", name, names)


# --- the answer ------------------------------------------------------------------------------------------------------


def labels_of(fits: Sequence[Fit]) -> tuple[str, ...]:
    """What each hypothesis has that not all have: effect ids, with their sites where the ids alone say too little."""
    keys = [[c.key for c in f.hypothesis.candidates] for f in fits]
    common = set(keys[0]).intersection(*keys[1:])
    own = [[c for c in f.hypothesis.candidates if c.key not in common] for f in fits]
    short = tuple(" + ".join(c.effect.id for c in cs) or "none" for cs in own)
    return short if len(set(short)) == len(short) else tuple(" + ".join(c.key for c in cs) or "none" for cs in own)


def _tried(problem: Problem, entry: Entry) -> Tried:
    first = problem.records[0]
    names = tuple(problem.plant.outputs[k].name for k in entry.sensors)
    duration = entry.count * first.windows.length * first.record.dt
    return Tried(entry.trial.excitation.name, names, duration, entry.separation, entry.refitted)


def _proposal(
    problem: Problem, entry: Entry, pairs: tuple[Pair, ...], now: float, labels: tuple[str, ...], fits: Sequence[Fit],
    assumed: Mapping[str, float], menu: Sequence[Tried], limits: Limits,
) -> NextExperiment:  # fmt: skip
    tried = _tried(problem, entry)
    plant, dt = problem.plant, problem.records[0].record.dt
    n = entry.count * problem.records[0].windows.length
    added = tuple(plant.outputs[k].name for k in entry.added)
    noise = {name: assumed[name] for name in added}
    return NextExperiment(
        tried.name,
        _description(entry, n, dt, plant, tried, noise),
        _advice(entry, pairs, labels, fits, limits, plant),
        dt * np.arange(n, dtype=float),
        {s.name: entry.trial.u[:n, k].copy() for k, s in enumerate(plant.inputs)},
        {s.name: s.unit for s in plant.inputs},
        n * dt,
        tried.sensors,
        added,
        noise,
        tried.separation,
        entry.named,
        now,
        labels,
        pairs,
        tuple(menu),
    )


def _description(entry: Entry, n: int, dt: float, plant: object, tried: Tried, noise: Mapping[str, float]) -> str:
    units = {s.name: s.unit for s in plant.outputs}  # type: ignore[attr-defined]
    text = f"{entry.trial.excitation.text}. {n * dt:.3g} s in all, one sample every {1e3 * dt:.3g} ms; record "
    text += ", ".join(tried.sensors)
    for name, std in noise.items():
        text += f" ({name} is new: a noise of {std:.2g} {units[name]} a sample is assumed)"
    return text


def _advice(
    entry: Entry, pairs: Sequence[Pair], labels: Sequence[str], fits: Sequence[Fit], limits: Limits, plant: object
) -> str:
    if entry.separation >= SAFE:
        return ""
    units = {s.name: s.unit for s in plant.inputs}  # type: ignore[attr-defined]
    within = ", ".join(
        f"{name} between {lo:.3g} and {hi:.3g} {units[name]}" for name, (lo, hi) in limits.ranges.items()
    )
    open_labels = {label for p in pairs if p.separation < SAFE for label in p[:2]}
    effects = dict.fromkeys(
        c.effect
        for label, f in zip(labels, fits, strict=True)
        if label in open_labels
        for c in f.hypothesis.candidates
        if c.effect.id in label
    )
    ways = [f"{effect.id}: {effect.independently}" for effect in effects if effect.independently]
    word = "this may, but need not, separate"
    if entry.separation < CANNOT_TELL:
        word = "nothing on the menu separates"
    if entry.named >= SAFE:
        word = f"if {labels[0]} is right, this will show it ({entry.named:.3g} noise sigmas); else it may not separate"
    text = f"{word} {' and '.join(sorted(open_labels))} with {within}"
    return f"{text}; an independent measurement would ({'; '.join(ways)})" if ways else text
