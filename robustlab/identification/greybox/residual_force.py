"""Residual force of a hypothesis: evidence for a Gaussian process over speed, position, time or input, or a line, on
top of the random force, in nats, less the log of the searched possibilities, and by cross-validation over windows
(Rasmussen, Williams, *Gaussian Processes for Machine Learning*, 2006, sections 2.7 and 5.4); and its curves with bands.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array, ComplexArray
from robustlab.dynamics.effects.effect import Site
from robustlab.dynamics.plant_base import NonlinearPlant
from robustlab.dynamics.ports.port_model import AnyPlant
from robustlab.errors import RobustlabError
from robustlab.identification.greybox.effect_fit import Fit, Problem
from robustlab.identification.greybox.random_force import (
    FittedWindows,
    ForceResponse,
    NoiseLevel,
    eliminated,
    force_response,
    plain_places,
)
from robustlab.result import Evidence

Over = Literal["speed", "position", "time", "input", "line over time", "line over position"]

MOST_PLACES = 2  # at which a residual force is searched
WAVES = 10  # smooth functions over position and time
LINES = 3  # examined over each coordinate
OVERSAMPLED = 4.0  # wave numbers per turn over the range
TURNS = 2.0  # of a line over the position within its range, at least; fewer are a curve
SLOWEST = 5.0  # periods of a line over time in a record, at least: slower ones are drift
FINEST = 1500.0  # periods within the range, at most
FEWEST_BLOCKS = 8  # of a curve
REST = 0.01  # of the largest speed: slower counts as rest, where dry friction balances any force
BINS = 24
BINS_OF_TIME = 6  # each with several blocks: a share is of blocks that the curve has not seen
SHARP = 0.01  # of the largest speed or input, within which a dry force changes sign
PRIOR = 0.05  # prior probability of an effect outside the catalogue
STRENGTHS = 10.0 ** np.arange(-3.5, 0.1, 0.5)  # lambda, of the force that moves the port
# Errors of singular equations: too little motion, or an unobservable parameter.
SINGULAR = (RobustlabError, np.linalg.LinAlgError, ValueError, ArithmeticError)


class Family(NamedTuple):
    """One family of residual forces: its columns, (n_windows, n_segments, k)."""

    over: Over
    columns: Array
    dry: bool = False
    price: float = 0.0  # log of the number of searched lines
    wave: float = 0.0


def _signed(x: Array) -> Array:
    """Return odd and even functions of x in -1..1, some of them sharp at zero: (..., 10)."""
    sharp, near = np.tanh(x / SHARP), np.exp(-np.abs(x) / 0.1)
    odd = (x, x * np.abs(x), x**3, sharp, np.tanh(x / 0.15), sharp * near)
    return np.stack([*odd, np.ones_like(x), np.sqrt(x**2 + SHARP**2), x**2, near], axis=-1)


def _cosines(x: Array) -> Array:
    """Return long waves over x in -1..1, weighted by a smooth process' prior: (..., WAVES)."""
    j = np.arange(WAVES)
    return np.cos(0.5 * np.pi * j * (x[..., None] + 1.0)) / (1.0 + (j / 3.0) ** 2)


def _smooth(response: ForceResponse) -> list[Family]:
    """Return smooth curves over speed, position, time and input, with and without the sign of the speed."""
    v, turns, families = response.motion.speed, [None], []
    if v is not None:
        turns = [None, np.tanh(v / (SHARP * (float(np.abs(v).max()) or 1.0)))]
        families.append(_curve(response, "speed", v, _signed, None))
    if response.motion.position is not None:
        families += [_curve(response, "position", response.motion.position, _cosines, turn) for turn in turns]
    families += [_curve(response, "time", response.clock, _cosines, turn) for turn in turns]
    families += [_curve(response, "input", u, _signed, None) for u in np.moveaxis(response.u, 2, 0)]
    return [f for f in families if f is not None]


def _curve(
    response: ForceResponse, over: Over, x: Array, functions: Callable[[Array], Array], turn: Array | None
) -> Family | None:
    """Return functions of a coordinate along the windows; None if it is constant."""
    low, high = float(x.min()), float(x.max())
    if not high > low:
        return None
    about_zero = functions is not _cosines  # odd and even functions
    middle, half = (0.0, max(-low, high)) if about_zero else (0.5 * (low + high), 0.5 * (high - low))
    columns = functions((x - middle) / half)
    columns = response.mean(columns if turn is None else columns * turn[..., None])
    square = (columns**2).mean(axis=(0, 1))
    return Family(over, columns / np.sqrt(np.maximum(square if about_zero else square.sum(), 1e-300)), turn is not None)


def _lines(windows: FittedWindows) -> list[Family]:
    """Return the strongest lines over time and over the position."""
    response, motion = windows.response, windows.response.motion
    sought: list[tuple[Over, Array, Array | None, float]] = [
        ("line over time", response.mean(response.clock), None, SLOWEST)
    ]
    if motion.position is not None and motion.speed is not None:
        q, v = response.mean(motion.position), response.mean(motion.speed)
        sought.append(("line over position", q, v, TURNS))
    return [
        _line(response, over, x, v, *found)
        for over, x, v, least in sought
        for found in _strongest(windows, x, v, least)
    ]


def _line(response: ForceResponse, over: Over, x: Array, v: Array | None, wave: float, count: float) -> Family:
    """Return cosine and sine with separate phases for each record and, over the position, for each direction."""
    step = response.dt * float(response.edges[1] - response.edges[0])
    # The response to steps at the segments' middles is weaker than to the wave; over many waves it is the mean.
    fade = 1.0 / np.sinc(wave * step) if v is None else np.sinc(wave * v * step)
    phase = 2.0 * np.pi * wave * x
    pair = np.stack([np.cos(phase) * fade, np.sin(phase) * fade], axis=2)
    if v is not None:
        pair = np.concatenate([pair, pair * np.sign(v)[:, :, None]], axis=2)
    columns = [pair * (response.record == k)[:, None, None] for k in np.unique(response.record)]
    return Family(over, np.concatenate(columns, axis=2), price=float(np.log(max(count, 1.0))), wave=wave)


def _strongest(windows: FittedWindows, x: Array, v: Array | None, least: float) -> list[tuple[float, float]]:
    """Return wave numbers (turns per unit) of the strongest lines by the score, and the number of searched ones."""
    record = windows.response.record
    span = max(float(np.ptp(x[record == k])) for k in np.unique(record))
    if not span > 0:
        return []
    steps = np.abs(np.diff(x, axis=1))
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else span
    last = min(0.5 / step, FINEST / span)
    if last * span <= least + 1.0 / OVERSAMPLED:  # one wave number is no spectrum
        return []
    waves = np.arange(least / span, last, 1.0 / (OVERSAMPLED * span))
    power = np.zeros(len(waves))
    some = np.linspace(0, len(waves) - 1, min(24, len(waves))).round().astype(int)
    expected = np.zeros(len(some))
    m, b = windows.segment_sums()
    for turn in (np.ones_like(x),) if v is None else (np.ones_like(x), np.sign(v)):
        for k in np.unique(record):
            power += np.abs(_transformed(x[record == k], (b * turn)[record == k], waves)) ** 2
        for i, at in enumerate(some):
            wave = np.exp(2j * np.pi * waves[at] * x) * turn
            expected[i] += float(np.einsum("ws,wst,wt->", wave.conj(), m, wave).real)
    level = power / np.maximum(np.interp(waves, waves[some], expected), 1e-300)
    found: list[tuple[float, float]] = []
    while len(found) < LINES and level.max(initial=0.0) > 0.0:
        at = int(level.argmax())
        found.append((float(waves[at]), OVERSAMPLED * (last - waves[0]) * span))
        level[np.abs(waves - waves[at]) < 1.0 / span] = 0.0
    return found


def _transformed(x: Array, values: Array, waves: Array) -> ComplexArray:
    """Return the sums of the values times exp(2 pi i wave x) at evenly spaced wave numbers, by a transform of bins."""
    step = float(waves[1] - waves[0])
    width = 1.0 / (step * np.ceil(8.0 * waves[-1] / step))  # an eighth of the shortest wave, and a whole number of them
    padded = round(1.0 / (step * width))
    place = ((x - x.min()) / width).astype(int)
    mass = np.bincount(place.ravel(), weights=values.ravel(), minlength=padded)
    spectrum = np.fft.rfft(mass, padded)
    return np.asarray(spectrum[np.round(waves / step).astype(int)])


@dataclass(frozen=True, eq=False)
class UnnamedEvidence:
    """A residual force on top of a hypothesis, against the hypothesis alone."""

    # port, over, dry: where it acts, its coordinate, and whether it changes sign with the speed
    port: str
    over: Over
    dry: bool
    evidence: float  # gain in log evidence in nats, less the log of the searched possibilities, without `PRIOR`
    cross_validated: float  # gain in log predictive density of each window given all others
    level: NoiseLevel  # its best noise
    strength: float  # its variance at the best evidence, over that of the noise
    q: float  # V with it
    period: float = float("nan")  # of a line, in s or the unit of the position; NaN for a curve
    wave: tuple[float, float] = (0.0, 0.0)  # amplitudes of its cosine and sine

    @property
    def wins(self) -> bool:
        """Return whether it is more probable than no force, with its prior, and improves held-out windows."""
        return self.evidence > -np.log(PRIOR) and self.cross_validated > 0.0

    @property
    def gain(self) -> float:
        """Return its gain in log evidence including the prior, by the smaller of evidence and cross-validation."""
        return float(np.logaddexp(np.log1p(-PRIOR), np.log(PRIOR) + min(self.evidence, self.cross_validated)))


@dataclass(frozen=True, eq=False)
class Unnamed:
    """Residual of a hypothesis."""

    forces: tuple[UnnamedEvidence, ...]  # best first
    noise_ratio: float  # RMS error of the fit over that of sensor noise and random force
    random_share: float  # RMS of the random force over that of the force that moves the port


def fitted_windows(problem: Problem, fit: Fit) -> tuple[tuple[FittedWindows, Site], ...]:
    """Return a hypothesis' windows under a random force, and the places of curves of a force."""
    # For a linear plant with few joints the force acts at one of them, and each is examined; else it acts at all of
    # them, and those with the largest residual are examined.
    places, most = plain_places(problem, fit), MOST_PLACES
    if len(places) <= most and not isinstance(problem.plant, NonlinearPlant):
        return tuple((FittedWindows(force_response(problem, fit, [p]), fit.z), p) for p in places)
    everywhere = FittedWindows(force_response(problem, fit, places), fit.z)
    return tuple((everywhere.at(k), places[k]) for k in everywhere.strongest()[:most])


def unnamed_force(windows: FittedWindows, place: Site) -> Unnamed:
    """Examine the residual of a hypothesis as a force at one place."""
    kinds = [*_smooth(windows.response), *_lines(windows)]
    forces = [judged(windows, family, len(kinds), place.name) for family in kinds]
    forces.sort(key=lambda f: (not f.wins, -f.evidence))
    level, rest = (forces[0].level, forces[0].q) if forces[0].wins else (windows.alone, windows.alone.alone_q)
    # The sensor noise was estimated with the nominal model, and is too large if that is late or scaled.
    ratio = float(np.sqrt(level.alone_q / min(windows.points, rest)))
    return Unnamed(tuple(forces), ratio, level.size)


def judged(windows: FittedWindows, family: Family, kinds: int, port: str) -> UnnamedEvidence:
    """Evaluate one of ``kinds`` families at its best noise and strength."""
    n_z, n, count = len(windows.z), windows.points, family.columns.shape[2]
    levels = windows.levels(family.columns, windows.smaller)
    alone = max(level.alone for level in [*levels, windows.alone])
    strengths = (STRENGTHS * windows.response.motion.force) ** 2

    def strongest(level: NoiseLevel) -> tuple[float, NoiseLevel, float, float]:
        h, b, det = _projected(windows.with_prior(level.gram.sum(axis=0)), count, n_z)
        w, u = np.linalg.eigh(h)
        w = np.maximum(w, 0.0)
        seen = (u.T @ b) ** 2
        q = level.alone_q - (seen * (strengths[:, None] / (1.0 + strengths[:, None] * w))).sum(axis=1)
        q = np.maximum(q, 1e-12 * level.alone_q)
        logdet = np.log1p(strengths[:, None] * w).sum(axis=1) + level.logdet.sum() + det
        p = -0.5 * n * np.log(q / n) - 0.5 * logdet
        at = int(p.argmax())
        return float(p[at]), level, float(strengths[at]), float(q[at])

    p, level, strength, q = max(map(strongest, levels), key=lambda found: found[0])
    cv = _cross_validated(windows, level, count, strength, q)
    h, b, _ = _projected(windows.with_prior(level.gram.sum(axis=0)), count, n_z)
    mean = np.linalg.solve(h + np.eye(count) / strength, b)
    evidence = float(p - alone - np.log(len(STRENGTHS) * kinds) - family.price)
    found = UnnamedEvidence(port, family.over, family.dry, evidence, cv, level, strength, q)
    if not family.wave:
        return found
    # Over the position, the part independent of the direction, or the dry one if larger by more than rounding.
    dry = family.over == "line over position" and np.hypot(*mean[2:4]) > 1.01 * np.hypot(*mean[:2])
    wave = (float(mean[2]), float(mean[3])) if dry else (float(mean[0]), float(mean[1]))
    return replace(found, dry=bool(dry), period=1.0 / family.wave, wave=wave)


def _projected(gram: Array, count: int, n_z: int) -> tuple[Array, Array, float]:
    """Return the family's normal equations with the parameters eliminated, and log det of the parameters' ones."""
    if n_z == 0:
        return gram[:count, :count], gram[:count, -1], 0.0
    inner = gram[count:-1, count:-1]
    solved = np.linalg.solve(inner, gram[count:-1])
    rest = gram - gram[:, count:-1] @ solved
    return rest[:count, :count], rest[:count, -1], float(np.linalg.slogdet(inner)[1])


def _cross_validated(windows: FittedWindows, level: NoiseLevel, count: int, strength: float, q: float) -> float:
    """Return the gain by the family in the log predictive density of each window given the others, summed."""
    n_z, n, points, alone = len(windows.z), windows.points, windows.response.points, windows.alone

    def predictive(grams: Array, logdet: Array, k: int, scale: float) -> float:
        total = grams.sum(axis=0)
        every = windows.with_prior(np.concatenate([total[None], total - grams]))
        if k:
            every[:, :k, :k] += np.eye(k) / strength
        v, det = eliminated(every, k + n_z)
        p = -0.5 * v / scale - 0.5 * det
        return float(np.sum(p[0] - p[1:] - 0.5 * logdet - 0.5 * points * np.log(scale)))

    without = alone.gram[:, -n_z - 1 :, -n_z - 1 :]
    return predictive(level.gram, level.logdet, count, q / n) - predictive(without, alone.logdet, 0, alone.alone_q / n)


# --- curves ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ForceCurve(Evidence):
    """Residual force over one coordinate."""

    coordinate: str
    unit: str
    # x, value, low, high: middle of each bin, mean force in it, and its 95 % band, (n_bins,), in order of x
    x: Array
    value: Array
    low: Array
    high: Array
    count: NDArray[np.int_]  # samples in each bin
    share: float  # of the variance explained by a curve over this coordinate in blocks not fitted, 0..1


@dataclass(frozen=True)
class ResidualForce(Evidence):
    """The residual force over each coordinate."""

    unit: str  # of the force
    rms: float
    noise_share: float  # of its variance, by the estimate's own std
    curves: Mapping[str, ForceCurve]  # coordinate -> curve
    blocks: int  # number of blocks


def residual_force(plant: AnyPlant, places: Sequence[tuple[FittedWindows, Site]]) -> ResidualForce | None:
    """Return the residual force at the most probable place; a block is a window."""
    windows, _ = max(places, key=lambda there: there[0].log_likelihood)
    force, std = windows.force_along()
    response, motion = windows.response, windows.response.motion
    along = {"time": (response.clock, "s"), "speed": (motion.speed, motion.speed_unit)}
    along["position"] = motion.position, motion.position_unit
    along |= {f"input {s.name}": (response.u[:, :, j], s.unit) for j, s in enumerate(plant.inputs)}
    coordinates = {name: response.mean(x).ravel() for name, (x, _) in along.items() if x is not None}
    block = np.repeat(np.arange(len(force)), force.shape[1])
    units = {name: unit for name, (_, unit) in along.items()}
    return force_curves(force.ravel(), std.ravel(), coordinates, block, units, motion.unit)


def force_curves(
    force: Array, std: Array, x: Mapping[str, Array], block: NDArray[np.int_], units: Mapping[str, str], unit: str
) -> ResidualForce | None:
    """Return curves of a force (n,) over the coordinates, of the samples in motion; None with too few blocks."""
    if "speed" in x:
        moving = np.abs(x["speed"]) > REST * np.abs(x["speed"]).max()
        if moving.mean() >= 0.2:
            force, std, block = force[moving], std[moving], block[moving]
            x = {name: values[moving] for name, values in x.items()}
    count = len(used := np.unique(block))
    if count < FEWEST_BLOCKS:
        return None
    belongs = (used[:, None] == block).astype(float)
    curves = {
        name: _binned(name, units.get(name, ""), force, std, values, belongs)
        for name, values in x.items()
        if np.ptp(values) > 0.0
    }
    variance = float(np.var(force))
    noise = min(1.0, float(np.mean(std**2)) / variance) if variance > 0.0 else 1.0
    return ResidualForce(unit, float(np.sqrt(np.mean(force**2))), noise, curves, count)


def _binned(name: str, unit: str, force: Array, std: Array, x: Array, belongs: Array) -> ForceCurve:
    """Return means in bins with equal counts, bands from the scatter of the blocks, and the held-out share."""
    sides = [side for side in (x[x < 0], x[x > 0]) if len(side)] if name == "speed" else [x]
    most = BINS_OF_TIME if name == "time" else BINS
    parts = [np.quantile(s, np.linspace(0.0, 1.0, max(2, round(most * len(s) / len(x))) + 1)) for s in sides]
    edges = np.unique(np.concatenate(parts))
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(0, len(edges) - 2))
    used, place = np.unique(place, return_inverse=True)
    one = (place[:, None] == np.arange(len(used))).astype(float)
    count, weight, sums = one.sum(axis=0), belongs @ one, belongs @ (one * force[:, None])
    value = sums.sum(axis=0) / count
    # In a bin with few blocks the spread between blocks is unreliable: the spread within the bin counts as well.
    visits = (weight > 0).sum(axis=0)
    between = np.sqrt(((sums - value * weight) ** 2).sum(axis=0) * visits / np.maximum(visits - 1, 1)) / count
    inside = np.sqrt((one * (force[:, None] - value) ** 2).sum(axis=0) / count)
    own = np.sqrt((one * std[:, None] ** 2).sum(axis=0) / count / visits)
    spread = np.maximum(between, own)
    band = 2.0 * np.where(visits < 4, np.maximum(spread, inside), spread)
    # Each block is predicted by the means of the others; where they have none, by their mean over all bins.
    others = sums.sum(axis=0) - sums, count - weight
    mean = (others[0].sum(axis=1) / others[1].sum(axis=1))[:, None]
    predicted = np.where(others[1] > 0, others[0] / np.maximum(others[1], 1.0), mean)
    left = float(force @ force - 2.0 * (predicted * sums).sum() + (predicted**2 * weight).sum())
    whole = float(force @ force - 2.0 * (mean * sums).sum() + (mean**2 * weight).sum())
    share = max(0.0, 1.0 - left / whole) if whole > 0.0 else 0.0
    middle = (one * x[:, None]).sum(axis=0) / count
    return ForceCurve(name, unit, middle, value, value - band, value + band, count.astype(int), share)


def remaining_lines(
    places: Sequence[tuple[FittedWindows, Site]], left: Sequence[Unnamed]
) -> tuple[dict[str, Any], ...]:
    """Return the most probable line with evidence over position and over time at each place, the largest first."""
    found = []
    for (windows, _), forces in zip(places, left, strict=False):  # none is left of singular equations
        motion = windows.response.motion
        lines = [f for f in forces.forces if f.wins and np.isfinite(f.period)]
        for over, unit in (("position", motion.position_unit), ("time", "s")):
            if (line := next((f for f in lines if f.over.endswith(over)), None)) is not None:
                size = {"amplitude": float(np.hypot(*line.wave)), "force_unit": motion.unit}
                found.append({"over": over, "period": line.period, "unit": unit, **size, "evidence": line.evidence})
    return tuple(sorted(found, key=lambda line: -line["amplitude"]))
