r"""What to measure next, so that hypotheses that the present records leave open can be told apart (T-optimality).

Proposed is the signal whose smallest refit distance over all pairs is largest (Atkinson, Fedorov, Biometrika 62, 1975);
where B contains A only the richer one is taken for the truth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path
from typing import NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.extended.simulator import Simulator, Windows
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.identification import tuning
from robustlab.identification.hypotheses.disturbance_smoother import SmoothedRecord
from robustlab.identification.hypotheses.effect_fit import Fit, FitPlan, NoiseModel, Problem, predicted, refit_distance
from robustlab.identification.hypotheses.prepared_record import PreparedRecord
from robustlab.identification.response.response import slowest_time_constant
from robustlab.record import Record
from robustlab.result import Evidence
from robustlab.shown import Facts

MOST_OPPONENTS = 3  # rivals that it is to tell from the named effect
LONGEST_EXPERIMENT = 5000  # samples
TIME_CONSTANTS_SEEN = 20.0  # slowest time constants of the plant in an experiment, at least
TIME_CONSTANTS_A_BEAT = 8.0  # the same in a beat of the signals
MOST_BEATS = 16  # in an experiment
FEWEST_BEATS = 4
CANNOT_TELL = 3.0  # noise sigmas
SAFE = 10.0  # the same, from which an experiment is safe to separate
SHORTER_BEATS = (1.0, 0.5, 0.25, 0.125)  # tried where the plant would run out of its travel
REFITTED_ENTRIES = 5  # of the menu, properly: more find better experiments, each costs fits of all pairs
REFIT_ITERATIONS = 12  # valleys of two parameters that nearly do the same are long
ASSUMED_NOISE = 1e-3  # of the range, of a sensor that was not recorded so far
SENSOR_WORTH = 0.25  # share of d that a new sensor must bring
SHORTEST_PERIOD = 4.0  # samples of the fastest sine
HEATING = 7  # lengths of an ordinary experiment that the winding is warmed for


class Pair(NamedTuple):
    """Refit distance of ``rival`` to what ``truth`` predicts, in noise sigmas."""

    truth: str
    rival: str
    separation: float


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
) -> NextExperiment | None:
    """The experiment of the menu that separates the named hypothesis and its rivals best; None where none can.

    Inputs stay within the recorded sizes, positions in m within their recorded range; the experiment is as long as the
    longest record, or twenty slowest time constants.
    """
    rivals = [r for r in rivals if r.hypothesis.key != named.hypothesis.key]
    if not rivals:
        return None
    open_ones = [named, *sorted(rivals, key=lambda f: -f.evidence)[:MOST_OPPONENTS]]
    labels = labels_of(open_ones)
    limits = _limits(problem)
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


@dataclass(frozen=True)
class Limits:
    """Range of each input, largest travel by index of the state, samples and beat of an experiment, addable outputs."""

    ranges: Mapping[str, tuple[float, float]]
    travel: Mapping[int, float]
    samples: int
    beat: float
    addable: tuple[int, ...]


def _limits(problem: Problem) -> Limits:
    plant, records, first = problem.plant, problem.records, problem.records[0]
    assert isinstance(plant, LinearPlant)
    dt, slowest = first.record.dt, slowest_time_constant(plant.state_space())
    wanted = max(round(TIME_CONSTANTS_SEEN * slowest / dt), *(r.record.n for r in records))
    samples = max(min(wanted, LONGEST_EXPERIMENT), tuning.FEWEST_WINDOWS * first.windows.length)
    beat = min(max(TIME_CONSTANTS_A_BEAT * slowest, samples * dt / MOST_BEATS), samples * dt / FEWEST_BEATS)
    both_ways = any(unit in ("rad/s", "m/s") for _, unit in plant.states)
    ranges = {}
    for k, signal in enumerate(plant.inputs):
        low, high = (float(f([f(r.u[:, k]) for r in records])) for f in (np.min, np.max))
        ranges[signal.name] = (-max(abs(low), abs(high)), max(abs(low), abs(high))) if both_ways else (low, high)
    travel = {
        k: max(float(np.ptp(r.smoothed.x[:, k])) for r in records)
        for k, (_, unit) in enumerate(plant.states)
        if unit == "m"
    }
    new = tuple(k for k in range(len(plant.outputs)) if k not in first.columns)
    return Limits(ranges, travel, samples, beat, new)


@dataclass(frozen=True, eq=False)
class Excitation:
    """One test signal of one input: samples, held for one sample time each, and what it is in words."""

    name: str
    u: Array  # (samples,)
    text: str


def experiment_menu(
    name: str, unit: str, lowest: float, highest: float, samples: int, dt: float, beat: float, warm: bool = False
) -> tuple[Excitation, ...]:
    """Test signals of one input within a range; ``beat``: unit of all periods in s; ``warm``: one that heats, too."""
    beat = _rounded(beat, dt)
    middle, half = 0.5 * (lowest + highest), 0.5 * (highest - lowest)
    t = dt * np.arange(samples, dtype=float)
    fastest = max(SHORTEST_PERIOD * dt, beat / 40.0)
    sweep = (2.0 * beat, min(fastest, beat))  # longest and shortest period
    cycle = min(8.0 * beat, samples * dt)

    def held(beats: float, *shares: float) -> Array:
        # Half a sample more: a change that falls on a sample must not depend on rounding.
        index = np.floor((t + 0.5 * dt) / _rounded(beats * beat, dt)).astype(int)
        return np.array(shares)[index % len(shares)]

    def square(beats: float) -> Array:
        return held(0.5 * beats, 1.0, -1.0)

    def triangle(beats: float) -> Array:
        return np.arcsin(np.sin(2.0 * np.pi * t / _rounded(beats * beat, dt))) * 2.0 / np.pi

    def sine(beats: float) -> Array:
        return np.sin(2.0 * np.pi * t / _rounded(beats * beat, dt))

    def swept() -> Array:
        rate = np.log(sweep[0] / sweep[1]) / cycle
        return np.sin(2.0 * np.pi * np.expm1(rate * (t % cycle)) / (rate * sweep[0]))

    def multisine() -> Array:
        order = np.arange(1, max(2, int(cycle / fastest) + 1), 2)
        phase = -np.pi * np.arange(len(order)) ** 2 / len(order)
        waves = np.cos(2.0 * np.pi * np.outer(t / cycle, order) + phase).sum(axis=1)
        return waves / np.abs(waves).max()

    block = round(8.0 * beat / dt)
    parts = (held(0.5, 1, -1, 0.5, -0.5, 0.1, -0.1), 0.3 * triangle(2), 0.08 * triangle(2), 0.03 * sine(0.25))
    lengths = [round(share * block) for share in (0.375, 0.25, 0.25, 0.125)]
    rich = np.concatenate([part[: min(n, samples)] for part, n in zip(parts, lengths, strict=True)])
    shapes = {
        "one-way steps": held(1, 0.25, 0.6, 1, 0.4, 0.8),
        "levels both ways": held(1, 1, -1, 0.6, -0.6, 0.3, -0.3, 0.15, -0.15),
        "square wave": square(1),
        "small fast reversals": 0.15 * square(0.25),
        "slow triangle through zero": 0.15 * triangle(8),
        "slow triangle through zero, small": 0.06 * triangle(8),
        "small sine": 0.06 * sine(0.5),
        "sine sweep": 0.5 * swept(),
        "odd multisine": multisine(),
        "rich": np.resize(rich, samples),
    }
    if warm:
        shapes["first block again when warm"] = np.concatenate([rich, np.resize(square(1), HEATING * samples), rich])
    within = f"of {name} between {lowest:.3g} and {highest:.3g}{f' {unit}' if unit else ''} from rest"
    return tuple(
        Excitation(key, np.clip(middle + half * shape, lowest, highest), f"{key} {within}, periods of {beat:.3g} s")
        for key, shape in shapes.items()
    )


def _rounded(seconds: float, dt: float) -> float:
    """Two digits, in whole pairs of samples."""
    return max(2, 2 * round(float(f"{seconds:.2g}") / dt / 2.0)) * dt


# --- the experiments as records --------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Trial:
    """A signal of the menu, the inputs (n, n_u), and the states of each hypothesis from rest, (n, n_x)."""

    excitation: Excitation
    u: Array
    states: tuple[Array, ...]
    outputs: Array  # (n, n_y) of the named hypothesis
    long: bool


def trials_of(problem: Problem, fits: Sequence[Fit], limits: Limits) -> list[Trial]:
    """All signals that the plant can take, with shorter beats where the travel asks for them."""
    dt = problem.records[0].record.dt
    warm = any(c.effect.long_memory for f in fits for c in f.hypothesis.candidates)
    several, shorter = len(problem.plant.inputs) > 1, SHORTER_BEATS
    found: list[Trial] = []
    for k, signal in enumerate(problem.plant.inputs):
        lowest, highest = limits.ranges[signal.name]
        if not lowest < highest:
            continue
        done: set[str] = set()
        for factor in shorter if limits.travel else shorter[:1]:
            beat = max(limits.beat * factor, 4.0 * dt)
            for entry in experiment_menu(signal.name, signal.unit, lowest, highest, limits.samples, dt, beat, warm):
                if entry.name in done:
                    continue
                u = np.tile([min(max(0.0, lo), hi) for lo, hi in limits.ranges.values()], (len(entry.u), 1))
                u[:, k] = entry.u
                named = replace(entry, name=f"{entry.name} on {signal.name}") if several else entry
                trial = _tried_out(problem, fits, named, u, limits)
                if trial is not None:
                    done.add(entry.name)
                    found.append(trial)
    return found


def _tried_out(problem: Problem, fits: Sequence[Fit], entry: Excitation, u: Array, limits: Limits) -> Trial | None:
    """The signal as each hypothesis answers it; None where one runs away or beyond the travel."""
    dt, n_x = problem.records[0].record.dt, len(problem.plant.states)
    states, outputs = [], None
    for fit in fits:
        effects = [(c.effect, c.site) for c in fit.hypothesis.candidates]
        factors, values = problem.split(fit.hypothesis, fit.z)
        simulator = Simulator(problem.plant, effects, u, dt)
        with np.errstate(all="ignore"):
            motion = simulator.run(factors, values, np.zeros((1, n_x)), Windows(np.zeros(1, dtype=np.int64), len(u)))
        x = motion.states[0, :, :n_x]
        if not np.isfinite(x).all() or any(np.ptp(x[:, j]) > 1.01 * top for j, top in limits.travel.items()):
            return None
        states.append(x.copy())
        outputs = motion.outputs[0] if outputs is None else outputs
    assert outputs is not None
    return Trial(entry, u, tuple(states), outputs, len(u) > limits.samples)


def noise_of(problem: Problem, present: NoiseModel, trials: Sequence[Trial]) -> tuple[NoiseModel, dict[str, float]]:
    """Noise of all outputs of the plant, averaged: as found where recorded, else assumed, and what it is per sample."""
    spans = np.max([np.ptp(t.outputs, axis=0) for t in trials], axis=0)
    std = ASSUMED_NOISE * np.where(spans > 0.0, spans, 1.0)
    assumed = {s.name: float(v) for s, v in zip(problem.plant.outputs, std, strict=True)}
    std /= np.sqrt(problem.records[0].thin)
    ar = np.zeros((len(present.ar), len(std)))
    for j, k in enumerate(problem.records[0].columns):
        std[k], ar[:, k] = present.std[j], present.ar[:, j]
        del assumed[problem.plant.outputs[k].name]
    return NoiseModel(std, ar), assumed


def _as_record(
    problem: Problem, trial: Trial, truth: int, shown: Mapping[int, float], columns: Sequence[int], count: int
) -> PreparedRecord:
    """The first ``count`` windows of an experiment, started where the hypothesis ``truth`` is; outputs still zero.

    ``shown`` is what the truth lets its sensors show, by output.
    """
    first = problem.records[0]
    length = first.windows.length
    n = count * length
    x, t = trial.states[truth][:n], first.record.dt * np.arange(n, dtype=float)
    starts = np.arange(count, dtype=np.int64) * length
    names = [s.name for s in problem.plant.inputs]
    record = Record(t, {name: trial.u[:n, k] for k, name in enumerate(names)}, name=trial.excitation.name)
    # What a smoother would know of it: the predicted motion, as well as it knew the present one.
    share = _told_by_output(problem)
    told = np.array([x @ share.get(c, np.zeros((x.shape[1],) * 2)) for c in columns])
    x = x + sum((shown.get(c, 1.0) - 1.0) * part for c, part in zip(columns, told, strict=True))
    start_std = np.median(np.concatenate([r.x0_std for r in problem.records]), axis=0)
    known = [r.smoothed for r in problem.records]
    std = np.median(np.concatenate([s.x_std for s in known]), axis=0)
    force_std = np.median(np.concatenate([s.d_std for s in known]), axis=0)
    smoothed = SmoothedRecord(
        t, x, np.tile(std, (n, 1)), np.broadcast_to(np.diag(std**2), (n, len(std), len(std))).copy(),
        np.zeros((n, len(force_std))), np.tile(force_std, (n, 1)), np.zeros(len(columns)), known[0].bandwidth,
        0.0,
    )  # fmt: skip
    return PreparedRecord(
        record, trial.u[:n], np.zeros((n, len(columns))), tuple(columns), Windows(starts, length), x[starts].copy(),
        np.tile(start_std, (count, 1)), smoothed, told, np.zeros_like(told), first.push, first.thin,
        np.zeros(len(columns)),
    )  # fmt: skip


def _told_by_output(problem: Problem) -> dict[int, Array]:
    """For each measured output the matrix M with which x M is its share in the smoothed states x of the records."""
    found = {}
    for j, column in enumerate(problem.records[0].columns):
        own = [r for r in problem.records if r.told[j].any()]  # those that have this sensor
        x, told = (np.concatenate(part) for part in zip(*((r.smoothed.x, r.told[j]) for r in own), strict=True))
        size = np.maximum(np.abs(x).max(axis=0), 1e-300)
        found[column] = np.linalg.lstsq(x / size, told, rcond=None)[0] / size[:, None]
    return found


# --- distances -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Entry:
    """An experiment of ``count`` windows with all these sensors, those ``added`` of which are new, and its d.

    ``named`` is the smallest d with the named hypothesis as the truth, ``separation`` that of all pairs.
    """

    trial: Trial
    sensors: tuple[int, ...]
    added: tuple[int, ...]
    count: int
    named: float
    separation: float
    refitted: bool


@dataclass(frozen=True, eq=False)
class Bench:
    """Where the experiments are judged: the problem, the open hypotheses with their labels, noise of all outputs."""

    problem: Problem
    fits: tuple[Fit, ...]
    labels: tuple[str, ...]
    noise: NoiseModel

    def preference(self, entry: Entry) -> tuple[int, int, int, float]:
        """Sorts the safe ones first, of these the ones without a new sensor, then the short ones.

        Next come those that are safe if the named hypothesis is right, and then the others, by d. A rival may have come
        out so weak that no experiment could show it: that must not buy a sensor.
        """
        if entry.separation >= SAFE:
            return 0, len(entry.added), entry.count, -entry.separation
        if entry.named >= SAFE:
            return 1, len(entry.added), 0, -entry.separation
        return 2, 0, 0, -entry.separation / (1.0 + SENSOR_WORTH * len(entry.added))

    def screened(self, trial: Trial, limits: Limits) -> list[Entry]:
        """The experiment with the present sensors and with each new one, whole and half as long, linearised."""
        present = self.problem.records[0].columns
        whole = len(trial.u) // self.problem.records[0].windows.length
        counts = [whole] if trial.long or whole < 2 * tuning.FEWEST_WINDOWS else [whole // 2, whole]
        choices = [(present, ()), *((tuple(sorted((*present, k))), (k,)) for k in limits.addable)]
        everything = range(len(self.problem.plant.outputs))
        smallest, named = np.full((2, len(choices), len(counts)), np.inf)
        for a, b in permutations(range(len(self.fits)), 2):
            # Among several rivals, those with the named one decide; the others are looked at in the refits.
            if (a and b) or _contains(self.fits[b], self.fits[a]):
                continue
            there = self._predicted(trial, a, tuple(everything), whole, self.noise)
            products = _products(there, self.fits[b], self.noise)
            for i, (sensors, _) in enumerate(choices):
                own = products[:, list(sensors)].sum(axis=1)
                for j, count in enumerate(counts):
                    d = _linearised_distance(own[:count], self.fits[b].z)
                    smallest[i, j] = min(smallest[i, j], d)
                    if a == 0:
                        named[i, j] = min(named[i, j], d)
        named = np.where(np.isfinite(named), named, smallest)  # all rivals contain it
        return [
            Entry(trial, sensors, added, count, float(named[i, j]), float(smallest[i, j]), False)
            for i, (sensors, added) in enumerate(choices)
            for j, count in enumerate(counts)
        ]

    def _predicted(self, trial: Trial, truth: int, columns: tuple[int, ...], count: int, noise: NoiseModel) -> Problem:
        """The experiment as a problem whose measured outputs are those of the hypothesis ``truth``."""
        hypothesis = self.fits[truth].hypothesis
        _, values = self.problem.split(hypothesis, self.fits[truth].z)
        shown, _, _ = self.problem.sensors([(c.effect, c.site) for c in hypothesis.candidates], values)
        record = _as_record(self.problem, trial, truth, shown, columns, count)
        there = self.problem.on([record])
        return predicted(there, _from_rest(self.fits[truth], there, noise))

    def best_refitted(self, screened: Sequence[Entry]) -> tuple[Entry, tuple[Pair, ...], list[Entry]]:
        """The first entry whose proper refit is safe, else the best of those tried; its pairs; all that were tried.

        The linearised refit may be far off where hypotheses are curved; so the next try has other sensors or another
        length, and another signal.
        """
        done: list[tuple[Entry, tuple[Pair, ...]]] = []
        seen: set[object] = set()
        for entry in screened:
            kinds = {(entry.sensors, entry.count), (entry.sensors, entry.trial.excitation.name)}
            if seen & kinds:
                continue
            seen |= kinds
            best = max((e.separation for e, _ in done), default=0.0)
            pairs = self._refitted(entry, best)
            smallest = min(p.separation for p in pairs)
            named = min((p.separation for p in pairs if p.truth == self.labels[0]), default=smallest)
            done.append((replace(entry, named=named, separation=smallest, refitted=True), pairs))
            if done[-1][0].separation >= SAFE or len(done) >= REFITTED_ENTRIES:
                break
        chosen, pairs = min(done, key=lambda d: self.preference(d[0]))
        return chosen, pairs, [e for e, _ in done]

    def _refitted(self, entry: Entry, best: float) -> tuple[Pair, ...]:
        """Distances of the pairs; given up once one is smaller than that of the best entry so far."""
        sensors = list(entry.sensors)
        noise = NoiseModel(self.noise.std[sensors], self.noise.ar[:, sensors])
        pairs: list[Pair] = []
        closest: tuple[float, Problem, Fit, Fit] | None = None
        for a, b in _ordered(self.fits):
            there = self._predicted(entry.trial, a, entry.sensors, entry.count, noise)
            rival = _from_rest(self.fits[b], there, noise)
            d = _proper_distance(there, rival, rival.z)
            pairs.append(Pair(self.labels[a], self.labels[b], d))
            if closest is None or d < closest[0]:
                closest = d, there, self.fits[a], rival
            if a and d < min(best, SAFE):
                return tuple(pairs)
        # A refit may have ended in a side valley; the pair that decides is tried again from elsewhere.
        assert closest is not None
        d, there, truth, rival = closest
        known = len(there.nuisances)
        again = _proper_distance(there, rival, np.concatenate([truth.z[:known], rival.z[known:]]))
        return tuple(p._replace(separation=min(d, again)) if p.separation == d else p for p in pairs)


def _proper_distance(there: Problem, rival: Fit, z: Array) -> float:
    """Distance of the rival, refitted from z to predicted outputs."""
    cost = there.fit(rival.hypothesis, rival.noise, z, rival.starts, FitPlan(REFIT_ITERATIONS)).cost
    return float(np.sqrt(max(0.0, cost - float(rival.z @ rival.z))))


def _from_rest(fit: Fit, there: Problem, noise: NoiseModel) -> Fit:
    """The fit with unmoved window starts on the windows of another problem."""
    n_x = len(there.plant.states)
    return replace(fit, starts=tuple(np.zeros((len(c), n_x)) for c in there.chosen), noise=noise)


def _ordered(fits: Sequence[Fit]) -> list[tuple[int, int]]:
    """Truth and rival of all pairs, the named hypothesis as truth first, then as rival; no rival contains its truth."""
    pairs = [(a, b) for a, b in permutations(range(len(fits)), 2) if not _contains(fits[b], fits[a])]
    return sorted(pairs, key=lambda pair: (pair[0] > 0, pair[1] > 0))


def _contains(rich: Fit, poor: Fit) -> bool:
    """True where the rich hypothesis has all effects of the poor one, or refinements of them, and something more."""

    def has(effect: str, site: object) -> bool:
        own = rich.hypothesis.candidates
        return any(c.site == site and effect in (c.effect.id, c.effect.refines) for c in own)

    return all(has(c.effect.id, c.site) for c in poor.hypothesis.candidates)


def distances(problem: Problem, fits: Sequence[Fit], labels: Sequence[str]) -> list[Pair]:
    """Refit distances on the records of the problem, of the pairs with the first hypothesis."""
    pairs = [(a, b) for a, b in _ordered(fits) if 0 in (a, b)]
    return [Pair(labels[a], labels[b], refit_distance(problem, fits[a], fits[b])) for a, b in pairs]


def _products(problem: Problem, rival: Fit, noise: NoiseModel) -> Array:
    """Products of the n columns [over z, over the starts, residual] of the rival, (n_windows, n_y, n, n)."""
    n_x, n_y = len(problem.plant.states), len(problem.records[0].columns)
    simulators = problem.simulators(rival.hypothesis)
    rest = np.zeros((len(problem.chosen[0]), n_x))
    step, start_step = tuning.STEP, tuning.START_STEP

    def residual(z: Array, start: Array) -> Array:
        errors = problem.errors(rival.hypothesis, z, [start], simulators)
        r = problem.whitened(errors, noise)[0]
        return r.reshape(len(r), -1, n_y)

    here = residual(rival.z, rest)
    over_z = [(residual(rival.z + step * e, rest) - here) / step for e in np.eye(len(rival.z))]
    over_x = [(residual(rival.z, rest + start_step * e) - here) / start_step for e in np.eye(n_x)]
    columns = np.stack([*over_z, *over_x, here], axis=3)  # (n_windows, n_points, n_y, n)
    columns = np.swapaxes(columns, 1, 2)
    return np.swapaxes(columns, 2, 3) @ columns


def _linearised_distance(products: Array, z: Array) -> float:
    """D after one Gauss-Newton step of the rival, window starts eliminated; products (n_windows, n, n)."""
    n_z = len(z)
    inner = products[:, n_z:-1, n_z:-1] + np.eye(products.shape[1] - n_z - 1)
    rest = np.concatenate([products[:, :n_z], products[:, -1:]], axis=1)
    over = rest[:, :, n_z:-1]  # of z and r with the starts
    both = np.concatenate([rest[:, :, :n_z], rest[:, :, -1:]], axis=2)
    left = (both - over @ np.linalg.solve(inner, np.swapaxes(over, 1, 2))).sum(axis=0)
    hessian, gradient = np.eye(n_z) + left[:-1, :-1], z + left[:-1, -1]
    gained = left[-1, -1] - gradient @ np.linalg.solve(hessian, gradient)
    return float(np.sqrt(max(0.0, gained)))


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
