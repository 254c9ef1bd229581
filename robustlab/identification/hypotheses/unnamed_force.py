r"""Evidence that a force without a name acts on top of a hypothesis: a Gaussian process over what it may depend on.

Near the fit of a hypothesis S the errors of a window, in units of the sensors' noise, are linear in everything small
(`robustlab.identification.hypotheses.random_force`):

.. math::
    e = J\,\delta + X\,\eta + O\,(\Phi c + d) + \text{noise}, \qquad z + \delta \sim N(0, 1), \quad
    \xi + \eta \sim N(0, 1), \quad d \sim N(0, s^2 K_f), \quad c \sim N(0, \lambda^2)

with a random force d of bandwidth f and size s (no machine runs without), and an unnamed force :math:`\Phi c` that
follows the speed, the position, the time or the input: smoothly, as a line over time or position, or as a jump. All but
the three numbers (s, f, lambda) is Gaussian: the marginal likelihoods of S alone and of S with the unnamed force are
closed forms, each maximised over its own s, f and the common scale of the noise, lambda paid for by the number tried, a
line by the number of lines searched. What is gained is in nats, to be added to the log evidence of S.

So S is not charged with what is random, and nothing is credited to a curve that a random force explains as well. The
second judge is `cross_validated`: what each window gains by curves told by all the others.

References
----------
Rasmussen, Williams, *Gaussian Processes for Machine Learning* (2006), sections 2.7 and 5.4; MacKay, "Bayesian
interpolation", Neural Computation 4 (1992).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from robustlab.arrays import Array, ComplexArray
from robustlab.dynamics.effects.contract import Site
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.errors import RobustlabError
from robustlab.identification import tuning
from robustlab.identification.hypotheses.effect_fit import Fit, Problem
from robustlab.identification.hypotheses.random_force import (
    FittedWindows,
    NoiseLevel,
    eliminated,
    force_response,
    plain_places,
)

Over = Literal[
    "speed", "position", "time", "input", "input rate", "line over time", "line over position", "jumps over time"
]

WAVES = 10  # smooth functions over position and time
LINES = 3  # of each kind looked at
OVERSAMPLED = 4.0  # wave numbers per turn over the range
TURNS = 2.0  # of a line over the position within its range, at least; fewer are a curve
SLOWEST = 5.0  # periods of a line over time in a record, at least: slower ones are drift
FINEST = 1500.0  # periods within the range, at most
JUMPS = 40  # in one record, at most
JUMP_SHARES = (0.3, 0.03)  # of the random force with which jumps are looked for
SHARP = 0.01  # of the largest speed or input, within which a dry force turns round
CURVE = 60  # points of a curve that is told


class Family(NamedTuple):
    """One kind of unnamed force: its columns, (n_windows, n_segments, k) a record, and how it is drawn."""

    over: Over
    coordinate: str
    unit: str
    columns: list[Array]
    basis: Callable[[Array], Array]  # of the coordinate (m,), the columns (m, k)
    grid: Array  # where it is drawn
    dry: bool = False
    price: float = 0.0  # of what was searched, in nats
    wave: float = 0.0


def families(windows: FittedWindows) -> list[Family]:
    """All kinds of force that these windows could show."""
    return [*_smooth(windows), *_lines(windows), *_jumps(windows)]


def _signed(x: Array) -> Array:
    """Odd and even functions of x in -1..1, some of them sharp at zero: (n, 10)."""
    sharp, near = np.tanh(x / SHARP), np.exp(-np.abs(x) / 0.1)
    odd = (x, x * np.abs(x), x**3, sharp, np.tanh(x / 0.15), sharp * near)
    return np.column_stack([*odd, np.ones_like(x), np.sqrt(x**2 + SHARP**2), x**2, near])


def _cosines(x: Array) -> Array:
    """Long waves over x in -1..1, weighted by a smooth process' prior: (n, WAVES)."""
    j = np.arange(WAVES)
    return np.cos(0.5 * np.pi * j * (x[:, None] + 1.0)) / (1.0 + (j / 3.0) ** 2)


def _rates(x: Array) -> Array:
    """Odd functions of x in -1..1: a late, early or slow input is missed as a force like these."""
    return np.column_stack([x, np.tanh(x / 0.1), np.tanh(x / SHARP)])


def _smooth(windows: FittedWindows) -> list[Family]:
    """Smooth curves over speed, position, time and input, some of them turned round with the motion."""
    records, first = windows.records, windows.records[0]
    families = []
    sign = None
    if (speeds := _all([r.motion.speed for r in records])) is not None:
        most = max(float(np.abs(v).max()) for v in speeds) or 1.0
        sign = [np.tanh(v / (SHARP * most)) for v in speeds]
        families.append(_curve(windows, ("speed", "speed", first.motion.speed_unit), speeds, _signed, None))
    turns = [None] if sign is None else [None, sign]
    if (positions := _all([r.motion.position for r in records])) is not None:
        own = ("position", "position", first.motion.position_unit)
        families += [_curve(windows, own, positions, _cosines, turn) for turn in turns]
    before = np.cumsum([0.0, *(len(r.record.u) * windows.dt for r in records)])
    clocks = [b + windows.dt * np.arange(len(r.record.u)) for b, r in zip(before, records, strict=False)]
    families += [_curve(windows, ("time", "time", "s"), clocks, _cosines, turn) for turn in turns]
    for j, (name, unit) in enumerate(windows.problem.plant.inputs):
        inputs = [r.record.u[:, j] for r in records]
        rates = [np.gradient(u, windows.dt) for u in inputs]
        families.append(_curve(windows, ("input", name, unit), inputs, _signed, None))
        families.append(_curve(windows, ("input rate", name, f"{unit}/s"), rates, _rates, None))
    return [f for f in families if f is not None]


def _all(arrays: list[Array | None]) -> list[Array] | None:
    """The arrays, None where one is missing."""
    found = [a for a in arrays if a is not None]
    return found if len(found) == len(arrays) else None


def _curve(
    windows: FittedWindows,
    what: tuple[Over, str, str],
    raw: list[Array],
    functions: Callable[[Array], Array],
    turn: list[Array] | None,
) -> Family | None:
    """Functions of a coordinate along the records; None where it stays the same."""
    low, high = min(float(x.min()) for x in raw), max(float(x.max()) for x in raw)
    if not high > low:
        return None
    # What is odd or even is so about zero.
    about_zero = functions is not _cosines
    middle, half = (0.0, max(-low, high)) if about_zero else (0.5 * (low + high), 0.5 * (high - low))
    columns = []
    for k, (record, x) in enumerate(zip(windows.records, raw, strict=True)):
        column = functions((x - middle) / half)
        columns.append(record.mean(column if turn is None else column * turn[k][:, None]))
    square = np.concatenate([c.reshape(-1, c.shape[2]) ** 2 for c in columns]).mean(axis=0)
    size = np.sqrt(np.maximum(square if about_zero else square.sum(), 1e-300))
    return Family(
        *what, [c / size for c in columns], lambda x: functions((x - middle) / half) / size,
        np.linspace(low, high, CURVE), turn is not None,
    )  # fmt: skip


def _lines(windows: FittedWindows) -> list[Family]:
    """The strongest lines over time and position."""
    records = windows.records
    clocks = [r.mean(windows.dt * np.arange(len(r.record.u))[:, None])[:, :, 0] for r in records]
    families = [
        _line(windows, ("line over time", "time", "s"), clocks, None, *found)
        for found in _strongest(windows, clocks, None, SLOWEST)
    ]
    positions, speeds = _all([r.motion.position for r in records]), _all([r.motion.speed for r in records])
    if positions is not None and speeds is not None:
        q, v = ([r.mean(x[:, None])[:, :, 0] for r, x in zip(records, a, strict=True)] for a in (positions, speeds))
        own = ("line over position", "position", records[0].motion.position_unit)
        families += [_line(windows, own, q, v, *found) for found in _strongest(windows, q, v, TURNS)]
    return families


def _line(
    windows: FittedWindows,
    what: tuple[Over, str, str],
    x: list[Array],
    v: list[Array] | None,
    wave: float,
    count: float,
) -> Family:
    """Cosine and sine with phases of their own in each record, over the position in each direction, too."""
    columns = []
    for k, record in enumerate(windows.records):
        step = windows.dt * float(record.edges[1] - record.edges[0])
        # A staircase at the segments' middles answers weaker than the wave; a segment that sees many waves, their mean.
        fade = 1.0 / np.sinc(wave * step) if v is None else np.sinc(wave * v[k] * step)
        phase = 2.0 * np.pi * wave * x[k]
        pair = np.stack([np.cos(phase) * fade, np.sin(phase) * fade], axis=2)
        if v is not None:
            pair = np.concatenate([pair, pair * np.sign(v[k])[:, :, None]], axis=2)
        own = [np.zeros_like(pair)] * len(windows.records)
        own[k] = pair
        columns.append(np.concatenate(own, axis=2))
    width = columns[0].shape[2]

    def basis(x: Array) -> Array:
        drawn = np.zeros((len(x), width))  # in the first record, the part that is the same both ways
        drawn[:, 0], drawn[:, 1] = np.cos(2.0 * np.pi * wave * x), np.sin(2.0 * np.pi * wave * x)
        return drawn

    grid = np.linspace(0.0, 1.0 / wave, CURVE)
    return Family(*what, columns, basis, grid, price=float(np.log(max(count, 1.0))), wave=wave)


def _strongest(
    windows: FittedWindows, x: list[Array], v: list[Array] | None, least: float
) -> list[tuple[float, float]]:
    """Wave numbers (turns per unit) of the strongest lines by the score, and how many were searched."""
    span = max(float(np.ptp(a)) for a in x)
    if not span > 0:
        return []
    steps = np.concatenate([np.abs(np.diff(a, axis=1)).ravel() for a in x])
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else span
    last = min(0.5 / step, FINEST / span)
    if last * span <= least + 1.0 / OVERSAMPLED:  # one wave number is no spectrum
        return []
    waves = np.arange(least / span, last, 1.0 / (OVERSAMPLED * span))
    power = np.zeros(len(waves))
    some = np.linspace(0, len(waves) - 1, min(24, len(waves))).round().astype(int)
    expected = np.zeros(len(some))
    for k, (m, b) in enumerate(windows.segment_sums()):
        speed = None if v is None else v[k]
        for turn in (1.0,) if speed is None else (1.0, np.sign(speed)):
            power += np.abs(_transformed(x[k], b * turn, waves)) ** 2
            for i, at in enumerate(some):
                wave = np.exp(2j * np.pi * waves[at] * x[k]) * turn
                expected[i] += float(np.einsum("ws,wst,wt->", wave.conj(), m, wave).real)
    level = power / np.maximum(np.interp(waves, waves[some], expected), 1e-300)
    found: list[tuple[float, float]] = []
    while len(found) < LINES and level.max(initial=0.0) > 0.0:
        at = int(level.argmax())
        found.append((float(waves[at]), OVERSAMPLED * (last - waves[0]) * span))
        level[np.abs(waves - waves[at]) < 1.0 / span] = 0.0
    return found


def _transformed(x: Array, values: Array, waves: Array) -> ComplexArray:
    """Sum of the values times exp(2 pi i wave x) at evenly spaced wave numbers, by one transform of fine bins."""
    step = float(waves[1] - waves[0])
    width = 1.0 / (step * np.ceil(8.0 * waves[-1] / step))  # an eighth of the shortest wave, and a whole number of them
    padded = round(1.0 / (step * width))
    place = ((x - x.min()) / width).astype(int)
    mass = np.bincount(place.ravel(), weights=values.ravel(), minlength=padded)
    spectrum = np.fft.rfft(mass, padded)
    return np.asarray(spectrum[np.round(waves / step).astype(int)])


def _jumps(windows: FittedWindows) -> list[Family]:
    """Steps of the force, found one after the other.

    A random force as strong as one that jumps hides each of its jumps; so they are looked for with less of it.
    """
    families = []
    for share in JUMP_SHARES:
        found = [_steps(windows, *sums) for sums in windows.segment_sums(share)]
        total = sum(len(places) for places in found)
        if not total:
            continue
        price, first, columns = 0.0, 0, []
        for record, places in zip(windows.records, found, strict=True):
            n, s = len(record.gram), record.segments
            block = np.zeros((n * s, total))
            for i, at in enumerate(places):
                block[at:, first + i] = 1.0
            price += float(np.sum(np.log(n * s / np.arange(1, len(places) + 1))))
            first += len(places)
            columns.append(block.reshape(n, s, total))
        families.append(_drawn_jumps(windows, found, columns, price))
    return families


def _drawn_jumps(windows: FittedWindows, found: list[list[int]], columns: list[Array], price: float) -> Family:
    """The family of steps, drawn along the first record."""
    record = windows.records[0]
    begins = windows.dt * (record.samples[:, :1] + record.edges[:-1]).ravel()

    def basis(t: Array) -> Array:
        drawn = np.zeros((len(t), columns[0].shape[2]))
        for i, at in enumerate(found[0]):
            drawn[:, i] = t >= begins[at]
        return drawn

    return Family("jumps over time", "time", "s", columns, basis, begins, price=price)


def _steps(windows: FittedWindows, gram: Array, score: Array) -> list[int]:
    """Segments at which a step of the force begins, the one that explains most first."""
    n, s = score.shape
    h = np.zeros((n * s, n * s))
    for w in range(n):
        h[w * s : (w + 1) * s, w * s : (w + 1) * s] = gram[w]
    # A step is the sum of all later segments.
    h = h[::-1, ::-1].cumsum(axis=0).cumsum(axis=1)[::-1, ::-1].copy()
    g = score.ravel()[::-1].cumsum()[::-1].copy()
    ridge = 1.0 / windows.force**2
    places: list[int] = []
    while len(places) < JUMPS:
        scale = np.diag(h) + ridge
        gain = 0.5 * (g**2 / scale - np.log(scale / ridge))
        gain[places] = -np.inf
        at = int(gain.argmax())
        if gain[at] < np.log(n * s / (1.0 + len(places))):
            break
        places.append(at)
        row = h[:, at] / np.sqrt(scale[at])
        g = g - row * g[at] / np.sqrt(scale[at])
        h -= np.outer(row, row)
    return places


PRIOR = 0.05  # probability that something acts that is not in the catalogue, before any data
# What the sums end with where there is hardly any motion, or nothing that tells some parameter.
UNTOLD = (RobustlabError, np.linalg.LinAlgError, ValueError, ArithmeticError)
STRENGTHS = 10.0 ** np.arange(-3.5, 0.1, 0.5)  # lambda, of the force that moves the port


@dataclass(frozen=True, eq=False)
class UnnamedEvidence:
    """An unnamed force on top of a hypothesis, against the hypothesis alone."""

    # port, over, coordinate, dry: where it acts, what it follows (of an input: which); ``dry`` where it turns round
    # with the direction of motion
    port: str
    over: Over
    coordinate: str
    dry: bool
    # gain in log evidence, in nats; what was searched is paid for, the prior of an unnamed force is not
    evidence: float
    cross_validated: float  # gain in log predictive density, window by window, with the curve told by all the others
    fall: float  # by how much the cost falls, at the noise of the hypothesis with the force
    share: float  # of what the hypothesis leaves beyond that noise, which share goes; 0..1
    rms: float  # of the force along the records
    # x, force, std: the curve: coordinate, force and its standard deviation; of a line over one period
    x: Array
    force: Array
    std: Array
    # unit, coordinate_unit: of the force and of the coordinate
    unit: str
    coordinate_unit: str
    # period, amplitude, amplitude_std: of a line; NaN for a curve. ``period`` in ``coordinate_unit``.
    period: float = float("nan")
    amplitude: float = float("nan")
    amplitude_std: float = float("nan")

    @property
    def wins(self) -> bool:
        """Whether it is more probable than nothing, its prior included, and helps on data that it was not told."""
        return self.evidence > -np.log(PRIOR) and self.cross_validated > 0.0


@dataclass(frozen=True, eq=False)
class Unnamed:
    """What a hypothesis leaves."""

    forces: tuple[UnnamedEvidence, ...]  # best first
    # RMS error of the fit, starts and parameters at their best, over what the sensors' noise and the machine's random
    # force make of it; the random force is what no unnamed force explains
    noise_ratio: float
    # random_force, random_share, bandwidth: its RMS in the unit of the port and over that of the force that moves the
    # port, and its bandwidth in Hz
    random_force: float
    random_share: float
    bandwidth: float


def fitted_windows(problem: Problem, fit: Fit) -> tuple[tuple[FittedWindows, Site], ...]:
    """What a hypothesis leaves in the windows under a random force, and where curves of a force are to be looked for.

    Of a linear plant with few joints (``most_places``) the random force acts at one of them, and each is asked; of
    any other at all of them, and those are asked where more than it is left.
    """
    places, most = plain_places(problem, fit), tuning.MOST_PLACES
    if len(places) <= most and not isinstance(problem.plant, NonlinearPlant):
        return tuple((FittedWindows(force_response(problem, fit, [p]), fit.z, problem), p) for p in places)
    everywhere = FittedWindows(force_response(problem, fit, places), fit.z, problem)
    return tuple((everywhere.at(k), places[k]) for k in everywhere.strongest()[:most])


def unnamed_force(windows: FittedWindows, place: Site) -> Unnamed:
    """What a hypothesis leaves, told as a force at one place."""
    kinds = families(windows)
    best = [_judged(windows, family, len(kinds)) for family in kinds]
    told = [_told(windows, place, f, b) for f, b in zip(kinds, best, strict=True)]
    order = sorted(range(len(told)), key=lambda k: (not told[k].wins, -told[k].evidence))
    first = best[order[0]]
    level, rest = (first.level, first.q) if told[order[0]].wins else (windows.alone, windows.alone.alone_q)
    # What is called the sensors' noise was told by the nominal model, and is too large where that is late or scaled.
    ratio = float(np.sqrt(level.alone_q / min(windows.points, rest)))
    return Unnamed(tuple(told[k] for k in order), ratio, level.size * windows.force, level.size, level.bandwidth)


class _Best(NamedTuple):
    """The best noise and strength of one family, and what comes of them."""

    level: NoiseLevel
    strength: float
    evidence: float
    cross_validated: float
    q: float
    mean: Array
    covariance: Array


def _judged(windows: FittedWindows, family: Family, kinds: int) -> _Best:
    """One of so many kinds at its own best noise and strength."""
    n_z, n, count = len(windows.z), windows.points, family.columns[0].shape[2]
    levels = windows.levels(family.columns, windows.smaller)
    alone = max(level.alone for level in [*levels, windows.alone])
    strengths = (STRENGTHS * windows.force) ** 2
    found = None
    for level in levels:
        h, b, det = _projected(windows.with_prior(level.gram.sum(axis=0)), count, n_z)
        w, u = np.linalg.eigh(h)
        w = np.maximum(w, 0.0)
        seen = (u.T @ b) ** 2
        q = level.alone_q - (seen * (strengths[:, None] / (1.0 + strengths[:, None] * w))).sum(axis=1)
        q = np.maximum(q, 1e-12 * level.alone_q)
        logdet = np.log1p(strengths[:, None] * w).sum(axis=1) + level.logdet.sum() + det
        p = -0.5 * n * np.log(q / n) - 0.5 * logdet
        at = int(p.argmax())
        if found is None or p[at] > found[0]:
            found = (float(p[at]), level, strengths[at], float(q[at]))
    assert found is not None
    p, level, strength, q = found
    cv = _cross_validated(windows, level.gram, count, strength, windows.alone, level, q)
    h, b, _ = _projected(windows.with_prior(level.gram.sum(axis=0)), count, n_z)
    inner = np.linalg.inv(h + np.eye(count) / strength)
    evidence = p - alone - np.log(len(STRENGTHS) * kinds) - family.price
    return _Best(level, strength, float(evidence), cv, q, inner @ b, inner * q / n)


def _projected(gram: Array, count: int, n_z: int) -> tuple[Array, Array, float]:
    """Normal equations of the family with the parameters eliminated, and log det of the parameters' equations."""
    if n_z == 0:
        return gram[:count, :count], gram[:count, -1], 0.0
    inner = gram[count:-1, count:-1]
    solved = np.linalg.solve(inner, gram[count:-1])
    rest = gram - gram[:, count:-1] @ solved
    return rest[:count, :count], rest[:count, -1], float(np.linalg.slogdet(inner)[1])


def _cross_validated(
    windows: FittedWindows, gram: Array, count: int, strength: float, alone: NoiseLevel, level: NoiseLevel, q: float
) -> float:
    """Sum over the windows of the log predictive density given the others, with the family less without."""
    n_z, n = len(windows.z), windows.points
    points = np.concatenate([r.points for r in windows.records])

    def predictive(grams: Array, logdet: Array, k: int, scale: float) -> float:
        total = grams.sum(axis=0)
        every = np.concatenate([total[None], total - grams])
        every = windows.with_prior(every)
        if k:
            every[:, :k, :k] += np.eye(k) / strength
        v, det = eliminated(every, k + n_z)
        p = -0.5 * v / scale - 0.5 * det
        return float(np.sum(p[0] - p[1:] - 0.5 * logdet - 0.5 * points * np.log(scale)))

    without = alone.gram[:, -n_z - 1 :, -n_z - 1 :]
    return predictive(gram, level.logdet, count, q / n) - predictive(without, alone.logdet, 0, alone.alone_q / n)


def _told(windows: FittedWindows, place: Site, family: Family, best: _Best) -> UnnamedEvidence:
    """The evidence with the force drawn."""
    n = windows.points
    fall = (best.level.alone_q - best.q) / (best.q / n)
    beyond = best.level.alone_q / best.q * n - n
    share = float(np.clip(fall / beyond, 0.0, 1.0)) if beyond > 0 else 0.0
    along = np.concatenate([(c @ best.mean).ravel() for c in family.columns])
    drawn = family.basis(family.grid)
    mean, covariance, dry = best.mean, best.covariance, family.dry
    period = amplitude = amplitude_std = float("nan")
    if family.wave:
        # Of a line over the position the part that is the same both ways, or the one that turns round with the motion.
        dry = family.over == "line over position" and np.hypot(*mean[2:4]) > 1.01 * np.hypot(
            *mean[:2]
        )  # not by rounding
        if dry:
            mean, covariance = np.roll(mean, -2), np.roll(covariance, -2, axis=(0, 1))
        period, amplitude = 1.0 / family.wave, float(np.hypot(*mean[:2]))
        amplitude_std = float(np.sqrt(0.5 * (covariance[0, 0] + covariance[1, 1])))
    std = np.sqrt(np.maximum(np.einsum("mk,kl,ml->m", drawn, covariance, drawn), 0.0))
    return UnnamedEvidence(
        place.name, family.over, family.coordinate, bool(dry), best.evidence, best.cross_validated, float(fall), share,
        float(np.sqrt(np.mean(along**2))),
        family.grid, drawn @ mean, std, windows.records[0].motion.unit, family.unit, period, amplitude, amplitude_std,
    )  # fmt: skip
