"""Kinds of unnamed force: smooth curves over speed, position, time and input, lines over time and position, jumps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np

from robustlab.arrays import Array, ComplexArray
from robustlab.identification.hypotheses.random_force import FittedWindows

__all__ = ["Family", "Over", "families"]

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
