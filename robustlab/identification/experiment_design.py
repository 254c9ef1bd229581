r"""Design of the next experiment to distinguish candidate models that the present records do not (T-optimality).

The proposed signal has the largest smallest refit distance over the pairs of the named candidate and a rival (Atkinson,
Fedorov, Biometrika 62, 1975). The named one is assumed true, or a rival that contains it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.display import Facts
from robustlab.dynamics.extended.simulator import Simulator, Windows
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.identification import constants
from robustlab.identification.greybox.effect_fit import Fit, FitPlan, NoiseModel, Problem, predicted, refit_distance
from robustlab.identification.response.response import slowest_time_constant
from robustlab.record import Record
from robustlab.result import Evidence

MOST_OPPONENTS = 3  # rivals to be distinguished from the named effect
LONGEST_EXPERIMENT = 5000  # samples
TIME_CONSTANTS = 20.0  # slowest time constants of the plant in an experiment, at least
TIME_CONSTANTS_A_BEAT = 8.0  # the same in a beat of the signals
MOST_BEATS = 16  # in an experiment
FEWEST_BEATS = 4
SAFE = 10.0  # noise sigmas from which an experiment separates safely
SHORTER_BEATS = (1.0, 0.5, 0.25, 0.125)  # tried if the plant would exceed its travel
REFITTED_ENTRIES = 4  # of the menu: more find better experiments, each costs fits of all pairs
SIGNALS_EACH = 2  # of these with the same sensors
REFIT_ITERATIONS = 12  # two nearly equivalent parameters form long valleys
ASSUMED_NOISE = 1e-3  # of the range, of a new sensor
SENSOR_WORTH = 0.25  # share of d that a new sensor must bring
SHORTEST_PERIOD = 4.0  # samples of the fastest sine


@dataclass(frozen=True)
class NextExperiment(Evidence):
    """Proposed experiment."""

    name: str  # entry of the menu
    description: str  # signal, duration and sensors in words
    advice: str  # alternatives if the experiment does not separate the candidates safely
    t: Array  # time in s, (n,)
    inputs: Mapping[str, Array]  # input -> samples (n,), each held until the next
    units: Mapping[str, str]
    duration: float  # in s
    sensors: tuple[str, ...]  # outputs to record
    added: tuple[str, ...]  # those of them that were not recorded so far
    assumed_noise: Mapping[str, float]  # added sensor -> assumed standard deviation, in its unit
    # smallest predicted refit distance d of the named candidate and a rival, in noise sigmas: below 3
    # indistinguishable, from 10 on safe
    separation: float
    now: float  # the same for the present records (`refit_distance`)
    hypotheses: tuple[str, ...]  # candidates to be separated, the named one first

    def facts(self) -> Facts:
        size = f"{self.separation:.3g} noise sigmas of {', '.join(self.hypotheses)}"
        now = f"present records: {self.now:.3g}; {constants.CANNOT_TELL:.0f} distinguish, {SAFE:.0f} are safe"
        return [("signal", self.description), ("predicted separation", f"{size} ({now})"), ("or", self.advice)]

    def save(self, path: str | Path) -> Path:
        """Write the signal as a text table: a row of names, then time in s and each input, sample by sample."""
        from robustlab.files.atomic import atomic_write

        table = np.column_stack([self.t, *self.inputs.values()])
        lines = [",".join(["t", *self.inputs]), *(",".join(f"{v:.9g}" for v in row) for row in table)]
        text = "\n".join(lines) + "\n"
        return atomic_write(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def propose_experiment(problem: Problem, named: Fit, rivals: Sequence[Fit]) -> NextExperiment | None:
    """Select the experiment of the menu that separates the named candidate and its rivals best; None if none can."""
    # Inputs stay within the recorded sizes, positions in m within their recorded range.
    rivals = [r for r in rivals if r.hypothesis.key != named.hypothesis.key]
    rivals = sorted(rivals, key=lambda f: -f.evidence)[:MOST_OPPONENTS]
    fits, pairs = [named, *rivals], [(r, named) if _contains(r, named) else (named, r) for r in rivals]
    limits = _limits(problem)
    trials = _trials(problem, fits, limits) if rivals else []
    if not trials:
        return None
    noise, assumed = _noise(problem, named.noise, trials)
    screened = sorted((e for t in trials for e in _screened(problem, pairs, noise, t)), key=_preference)
    # The linearised refit may be wrong for curved candidates; so not all refitted entries have the same sensors.
    done: list[_Entry] = []
    for entry in screened:
        if sum(entry.sensors == e.sensors for e in done) < SIGNALS_EACH:
            done.append(_refitted(problem, pairs, noise, entry))
        if done[-1].separation >= SAFE or len(done) >= REFITTED_ENTRIES:
            break
    chosen = min(done, key=_preference)
    plant, dt, u = problem.plant, problem.records[0].record.dt, chosen.trial.u
    outputs, units = [s.name for s in plant.outputs], {s.name: s.unit for s in (*plant.inputs, *plant.outputs)}
    sensors, added = (tuple(outputs[k] for k in columns) for columns in (chosen.sensors, chosen.added))
    new = [f" ({name} is new: a noise of {assumed[name]:.2g} {units[name]} a sample is assumed)" for name in added]
    size = f"{len(u) * dt:.3g} s in all, one sample every {1e3 * dt:.3g} ms"
    return NextExperiment(
        name=chosen.trial.name,
        description=f"{chosen.trial.text}. {size}; record {', '.join(sensors)}{''.join(new)}",
        advice=_advice(chosen, fits, limits, units),
        t=dt * np.arange(len(u), dtype=float),
        inputs={s.name: u[:, k].copy() for k, s in enumerate(plant.inputs)},
        units={s.name: s.unit for s in plant.inputs},
        duration=len(u) * dt,
        sensors=sensors,
        added=added,
        assumed_noise={name: assumed[name] for name in added},
        separation=chosen.separation,
        now=min(refit_distance(problem, *p) for pair in pairs for p in (pair, pair[::-1]) if not _contains(*p[::-1])),
        hypotheses=_labels(fits),
    )


# --- limits ----------------------------------------------------------------------------------------------------------


class _Limits(NamedTuple):
    """Bounds of the menu's signals and of the motion."""

    ranges: Mapping[str, tuple[float, float]]  # of each input
    travel: Mapping[int, float]  # largest range of a state, by its index
    samples: int
    beat: float  # unit of all periods, s


def _limits(problem: Problem) -> _Limits:
    plant, records, first = problem.plant, problem.records, problem.records[0]
    assert isinstance(plant, LinearPlant)
    dt, slowest = first.record.dt, slowest_time_constant(plant.state_space())
    wanted = max(round(TIME_CONSTANTS * slowest / dt), *(r.record.n for r in records))
    samples = max(min(wanted, LONGEST_EXPERIMENT), constants.FEWEST_WINDOWS * first.windows.length)
    samples -= samples % first.windows.length
    beat = min(max(TIME_CONSTANTS_A_BEAT * slowest, samples * dt / MOST_BEATS), samples * dt / FEWEST_BEATS)
    both_ways = any(unit in ("rad/s", "m/s") for _, unit in plant.states)
    ranges = {}
    for k, signal in enumerate(plant.inputs):
        low, high = (float(f([f(r.u[:, k]) for r in records])) for f in (np.min, np.max))
        ranges[signal.name] = (-max(abs(low), abs(high)), max(abs(low), abs(high))) if both_ways else (low, high)
    lengths = [k for k, (_, unit) in enumerate(plant.states) if unit == "m"]
    travel = {k: max(float(np.ptp(r.smoothed.x[:, k])) for r in records) for k in lengths}
    return _Limits(ranges, travel, samples, beat)


def _menu(lowest: float, highest: float, samples: int, dt: float, beat: float) -> dict[str, Array]:
    """Return test signals of one input within a range by name, (samples,); ``beat``: unit of all periods in s."""
    middle, half = 0.5 * (lowest + highest), 0.5 * (highest - lowest)
    t = dt * np.arange(samples, dtype=float)
    fastest = max(SHORTEST_PERIOD * dt, beat / 40.0)
    sweep = (2.0 * beat, min(fastest, beat))  # longest and shortest period
    cycle = min(8.0 * beat, samples * dt)

    def held(beats: float, *shares: float) -> Array:
        # Half a sample more: a change at a sample must not depend on rounding.
        index = np.floor((t + 0.5 * dt) / _rounded(beats * beat, dt)).astype(int)
        return np.array(shares)[index % len(shares)]

    def sine(beats: float) -> Array:
        return np.sin(2.0 * np.pi * t / _rounded(beats * beat, dt))

    rate = np.log(sweep[0] / sweep[1]) / cycle
    order = np.arange(1, max(2, int(cycle / fastest) + 1), 2)
    phase = -np.pi * np.arange(len(order)) ** 2 / len(order)
    multisine = np.cos(2.0 * np.pi * np.outer(t / cycle, order) + phase).sum(axis=1)
    slow_triangle = np.arcsin(sine(8)) * 2.0 / np.pi
    shapes = {
        "one-way steps": held(1, 0.25, 0.6, 1, 0.4, 0.8),
        "levels both ways": held(1, 1, -1, 0.6, -0.6, 0.3, -0.3, 0.15, -0.15),
        "square wave": held(0.5, 1, -1),
        "small fast reversals": 0.15 * held(0.125, 1, -1),
        "slow triangle through zero": 0.15 * slow_triangle,
        "slow triangle through zero, small": 0.06 * slow_triangle,
        "small sine": 0.06 * sine(0.5),
        "sine sweep": 0.5 * np.sin(2.0 * np.pi * np.expm1(rate * (t % cycle)) / (rate * sweep[0])),
        "odd multisine": multisine / np.abs(multisine).max(),
    }
    return {name: np.clip(middle + half * shape, lowest, highest) for name, shape in shapes.items()}


def _rounded(seconds: float, dt: float) -> float:
    """Round a time to two digits and to whole pairs of samples."""
    return max(2, 2 * round(float(f"{seconds:.2g}") / dt / 2.0)) * dt


# --- the experiments as records --------------------------------------------------------------------------------------


class _Trial(NamedTuple):
    """A signal of the menu with the simulated candidates."""

    name: str
    text: str
    u: Array  # (n, n_u)
    states: dict[Fit, Array]  # of each candidate from zero, (n, n_x)
    outputs: Array  # (n, n_y) of the named candidate


def _trials(problem: Problem, fits: Sequence[Fit], limits: _Limits) -> list[_Trial]:
    """Return all signals within the travel of the plant, with shorter beats where needed."""
    dt, found = problem.records[0].record.dt, dict[str, _Trial]()
    for k, signal in enumerate(problem.plant.inputs):
        lowest, highest = limits.ranges[signal.name]
        for factor in (SHORTER_BEATS if limits.travel else (1.0,)) if lowest < highest else ():
            beat = _rounded(max(limits.beat * factor, 4.0 * dt), dt)
            within = f"of {signal.name} between {lowest:.3g} and {highest:.3g} {signal.unit}".rstrip()
            for shape, samples in _menu(lowest, highest, limits.samples, dt, beat).items():
                name = f"{shape} on {signal.name}" if len(problem.plant.inputs) > 1 else shape
                if name in found:
                    continue
                u = np.tile([min(max(0.0, lo), hi) for lo, hi in limits.ranges.values()], (len(samples), 1))
                u[:, k] = samples
                text = f"{shape} {within} from rest, periods of {beat:.3g} s"
                if trial := _tried_out(problem, fits, name, text, u, limits):
                    found[name] = trial
    return list(found.values())


def _tried_out(problem: Problem, fits: Sequence[Fit], name: str, text: str, u: Array, limits: _Limits) -> _Trial | None:
    """Simulate each candidate with a signal; None if one diverges or exceeds the travel."""
    dt, n_x = problem.records[0].record.dt, len(problem.plant.states)
    states, outputs = dict[Fit, Array](), []
    for fit in fits:
        effects = [(c.effect, c.site) for c in fit.hypothesis.candidates]
        factors, values = problem.split(fit.hypothesis, fit.z)
        simulator = Simulator(problem.plant, effects, u, dt)
        with np.errstate(all="ignore"):
            motion = simulator.run(factors, values, np.zeros((1, n_x)), Windows(np.zeros(1, dtype=np.int64), len(u)))
        x = motion.states[0, :, :n_x]
        if not np.isfinite(x).all() or any(np.ptp(x[:, j]) > 1.01 * top for j, top in limits.travel.items()):
            return None
        states[fit] = x.copy()
        outputs.append(motion.outputs[0])
    return _Trial(name, text, u, states, outputs[0])


def _noise(problem: Problem, present: NoiseModel, trials: Sequence[_Trial]) -> tuple[NoiseModel, dict[str, float]]:
    """Return the averaged noise of all outputs, estimated where recorded, else assumed; and the assumed per sample."""
    spans, outputs = np.max([np.ptp(t.outputs, axis=0) for t in trials], axis=0), problem.plant.outputs
    std = ASSUMED_NOISE * np.where(spans > 0.0, spans, 1.0)
    assumed = {s.name: float(v) for s, v in zip(outputs, std, strict=True)}
    std /= np.sqrt(problem.records[0].thin)
    ar = np.zeros((len(present.ar), len(std)))
    for j, k in enumerate(problem.records[0].columns):
        std[k], ar[:, k] = present.std[j], present.ar[:, j]
        del assumed[outputs[k].name]
    return NoiseModel(std, ar), assumed


def _predicted(problem: Problem, fit: Fit, trial: _Trial, columns: Sequence[int], noise: NoiseModel) -> Problem:
    """Set up the experiment as a problem whose measured outputs are those of the candidate ``fit``."""
    first, x = problem.records[0], trial.states[fit]
    length, n, t = first.windows.length, len(x), first.record.dt * np.arange(len(x), dtype=float)
    _, values = problem.split(fit.hypothesis, fit.z)
    shown, _, _ = problem.sensors([(c.effect, c.site) for c in fit.hypothesis.candidates], values)
    starts = np.arange(n // length, dtype=np.int64) * length
    record = Record(t, {s.name: trial.u[:, k] for k, s in enumerate(problem.plant.inputs)}, name=trial.name)
    # Result of a smoother: the predicted motion with the accuracy of the present one.
    share = _shares_of_outputs(problem)
    parts = np.array([x @ share.get(c, np.zeros((x.shape[1],) * 2)) for c in columns])
    x = x + sum((shown.get(c, 1.0) - 1.0) * part for c, part in zip(columns, parts, strict=True))
    start_std = np.median(np.concatenate([r.x0_std for r in problem.records]), axis=0)
    made = replace(
        first, record=record, u=trial.u, y=np.zeros((n, len(columns))), columns=tuple(columns),
        windows=Windows(starts, length), x0=x[starts].copy(), x0_std=np.tile(start_std, (len(starts), 1)),
        smoothed=replace(first.smoothed, x=x), state_shares=parts, constant=np.zeros_like(parts),
        resolution=np.zeros(len(columns)),
    )  # fmt: skip
    there = problem.on([made])
    return predicted(there, _from_rest(fit, there, noise))


def _shares_of_outputs(problem: Problem) -> dict[int, Array]:
    """Fit for each measured output the matrix M with which x M is its share in the smoothed states x."""
    found = {}
    for j, column in enumerate(problem.records[0].columns):
        own = [r for r in problem.records if r.state_shares[j].any()]  # those that have this sensor
        x, share = (
            np.concatenate(part) for part in zip(*((r.smoothed.x, r.state_shares[j]) for r in own), strict=True)
        )
        size = np.maximum(np.abs(x).max(axis=0), 1e-300)
        found[column] = np.linalg.lstsq(x / size, share, rcond=None)[0] / size[:, None]
    return found


# --- distances -------------------------------------------------------------------------------------------------------


class _Entry(NamedTuple):
    """An experiment with its sensors and its smallest d."""

    trial: _Trial
    sensors: tuple[int, ...]
    added: tuple[int, ...]  # new sensors
    separation: float
    close: frozenset[Fit] = frozenset()  # candidates that it does not separate


def _preference(entry: _Entry) -> tuple[bool, int, float]:
    """Sort key: safe ones first, with few new sensors, then by d."""
    safe = entry.separation >= SAFE
    worth = 1.0 if safe else 1.0 + SENSOR_WORTH * len(entry.added)
    return not safe, len(entry.added) if safe else 0, -entry.separation / worth


def _screened(problem: Problem, pairs: Sequence[tuple[Fit, Fit]], noise: NoiseModel, trial: _Trial) -> list[_Entry]:
    """Evaluate the experiment with the present sensors and with each new one, linearised."""
    present = problem.records[0].columns
    new = (k for k in range(len(problem.plant.outputs)) if k not in present)
    choices = [(present, ()), *((tuple(sorted((*present, k))), (k,)) for k in new)]
    smallest = np.full(len(choices), np.inf)
    for true, other in pairs:
        there = _predicted(problem, true, trial, range(len(problem.plant.outputs)), noise)
        rival = _from_rest(other, there, noise)
        ((over_z, over_x),) = there.derivatives(rival)
        (left,) = there.whitened(there.errors(rival.hypothesis, rival.z, rival.starts), noise)
        columns = np.concatenate([over_z, over_x, left[:, :, None]], axis=2)
        columns = columns.reshape(len(left), -1, len(noise.std), columns.shape[2])  # (n_windows, points, n_y, .)
        for i, (sensors, _) in enumerate(choices):
            seen = columns[:, :, list(sensors)].reshape(len(left), -1, columns.shape[3])
            smallest[i] = min(smallest[i], _linearised_distance(seen, rival.z))
    return [_Entry(trial, *choices[i], float(d)) for i, d in enumerate(smallest)]


def _refitted(problem: Problem, pairs: Sequence[tuple[Fit, Fit]], noise: NoiseModel, entry: _Entry) -> _Entry:
    sensors, distances = list(entry.sensors), []
    own = NoiseModel(noise.std[sensors], noise.ar[:, sensors])
    for true, other in pairs:
        there = _predicted(problem, true, entry.trial, entry.sensors, own)
        rival = _from_rest(other, there, own)
        cost = there.fit(rival.hypothesis, own, rival.z, rival.starts, FitPlan(REFIT_ITERATIONS)).cost
        distances.append(float(np.sqrt(max(0.0, cost - float(rival.z @ rival.z)))))
    close = frozenset(fit for pair, d in zip(pairs, distances, strict=True) if d < SAFE for fit in pair)
    return entry._replace(separation=min(distances), close=close)


def _from_rest(fit: Fit, there: Problem, noise: NoiseModel) -> Fit:
    """Return the fit with unchanged window starts on the windows of another problem."""
    n_x = len(there.plant.states)
    return replace(fit, starts=tuple(np.zeros((len(c), n_x)) for c in there.chosen), noise=noise)


def _contains(rich: Fit, poor: Fit) -> bool:
    """Check that the rich candidate has all effects of the poor one, or refinements of them."""
    own = {(name, c.site) for c in rich.hypothesis.candidates for name in (c.effect.id, c.effect.refines)}
    return own >= {(c.effect.id, c.site) for c in poor.hypothesis.candidates}


def _linearised_distance(columns: Array, z: Array) -> float:
    """Compute d after one Gauss-Newton step of the rival, starts eliminated; columns (windows, points, z starts r)."""
    n_z, products = len(z), np.swapaxes(columns, 1, 2) @ columns
    own, starts = [*range(n_z), -1], slice(n_z, -1)
    inner = products[:, starts, starts] + np.eye(products.shape[1] - n_z - 1)
    over, both = products[:, own, starts], products[:, own][:, :, own]  # of z and r with the starts; of these alone
    left = (both - over @ np.linalg.solve(inner, np.swapaxes(over, 1, 2))).sum(axis=0)
    hessian, gradient = np.eye(n_z) + left[:-1, :-1], z + left[:-1, -1]
    gained = left[-1, -1] - gradient @ np.linalg.solve(hessian, gradient)
    return float(np.sqrt(max(0.0, gained)))


# --- the result ------------------------------------------------------------------------------------------------------


def _labels(fits: Sequence[Fit]) -> tuple[str, ...]:
    """Label each candidate by the effects that not all have: ids, with their sites if the ids are ambiguous."""
    keys = [[c.key for c in f.hypothesis.candidates] for f in fits]
    common = set(keys[0]).intersection(*keys[1:])
    own = [[c for c in f.hypothesis.candidates if c.key not in common] for f in fits]
    short = tuple(" + ".join(c.effect.id for c in cs) or "none" for cs in own)
    return short if len(set(short)) == len(short) else tuple(" + ".join(c.key for c in cs) or "none" for cs in own)


def _advice(entry: _Entry, fits: Sequence[Fit], limits: _Limits, units: Mapping[str, str]) -> str:
    if entry.separation >= SAFE:
        return ""
    ranges = [f"{name} between {lo:.3g} and {hi:.3g} {units[name]}" for name, (lo, hi) in limits.ranges.items()]
    close = {label: f for label, f in zip(_labels(fits), fits, strict=True) if f in entry.close}
    own = [(label, c.effect) for label, f in close.items() for c in f.hypothesis.candidates]
    effects = dict.fromkeys(effect for label, effect in own if effect.id in label)
    ways = [f"{effect.id}: {effect.independently}" for effect in effects if effect.independently]
    word = "this may, but need not, separate"
    if entry.separation < constants.CANNOT_TELL:
        word = "nothing on the menu separates"
    text = f"{word} {' and '.join(sorted(close))} with {', '.join(ranges)}"
    return f"{text}; an independent measurement would ({'; '.join(ways)})" if ways else text
