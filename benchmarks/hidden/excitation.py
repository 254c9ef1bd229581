"""Inputs of the blind tests, drawn from a generator, held between samples; amplitudes are shares of the largest."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

Array = NDArray[np.float64]

KINDS = ("rich", "square", "oneway", "multisine", "steps")
SQUARE = 11.8 / 24.0  # the thesis' +-11.8 V at a 24 V supply


def voltage(
    kind: str, n: int, dt: float, largest: float, rng: np.random.Generator, *, inputs: str = "levels",
    resonance: float = 0.0,
) -> Array:  # fmt: skip
    """Voltage (n,) in V (or force, or torque).

    ``rich``: levels up to the largest voltage, in both directions at least once, small levels, slow ramps through
    zero, small sines, of random dwell, in random order;
    ``square``: +-11.8 V of 24 V, random period; ``oneway``: steps of one sign; ``steps``: levels of both signs;
    ``multisine``: random-phase odd multisine plus levels.

    ``inputs`` "balanced", for a plant that turns freely: every piece is followed by its opposite, so that the speed
    comes back; "resonant", for an oscillator of the frequency ``resonance`` in Hz: the pieces of "rich" are sweeps and
    noise about the resonance, bursts at it, and levels after which it swings freely.
    """
    if kind not in KINDS:
        raise ValueError(f"excitation {kind!r}: one of {', '.join(KINDS)}")
    if kind == "square":
        period = rng.uniform(0.35, 0.7)
        return largest * SQUARE * np.where(np.arange(n) * dt % period < period / 2, 1.0, -1.0)
    if kind == "multisine":
        levels = 0.6 if inputs == "levels" else 0.0
        return _multisine(n, dt, largest, rng, levels, max(60.0, 1.5 * resonance))
    if kind == "rich" and inputs == "resonant":
        return _joined(n, lambda: _swing(dt, resonance, rng), largest)
    piece = {
        "rich": _rich_piece,
        "oneway": lambda dt, rng: np.full(int(rng.uniform(0.1, 0.5) / dt), rng.uniform(0.25, 1)),
        "steps": lambda dt, rng: np.full(int(rng.uniform(0.15, 0.5) / dt), rng.uniform(-1, 1)),
    }[kind]
    if inputs == "balanced":
        return _joined(n, lambda: np.concatenate([p := piece(dt, rng), -p]), largest)
    pieces = [np.full(int(0.12 / dt), side * rng.uniform(0.9, 1)) for side in (-1, 1)] if kind == "rich" else []
    while sum(map(len, pieces)) < n:
        pieces.append(piece(dt, rng))
    order = rng.permutation(len(pieces) - 1) if kind == "rich" else range(len(pieces) - 1)
    return largest * np.concatenate([*(pieces[k] for k in order), pieces[-1]])[:n]


def reference(n: int, dt: float, reach: float, rng: np.random.Generator) -> Array:
    """Position (n,) to follow: smooth moves between random places within +-reach, short and long, with rests."""
    out, k, here = np.zeros(n), 0, 0.0
    while k < n:
        move, rest = (int(s / dt) for s in (rng.uniform(0.1, 0.5), rng.uniform(0.02, 0.15)))
        there = here + rng.uniform(-0.05, 0.05) * reach if rng.random() < 0.3 else rng.uniform(-reach, reach)
        s = np.arange(1, move + 1) / move
        piece = np.concatenate([here + (there - here) * s**3 * (10 - 15 * s + 6 * s**2), np.full(rest, there)])
        out[k : k + len(piece)] = piece[: n - k]
        k, here = k + len(piece), there
    return out


def _joined(n: int, piece: Callable[[], Array], largest: float) -> Array:
    pieces: list[Array] = []
    while sum(map(len, pieces)) < n:
        pieces.append(piece())
    return largest * np.concatenate(pieces)[:n]


def _swing(dt: float, resonance: float, rng: np.random.Generator) -> Array:
    """A piece for an oscillator."""
    m, choice = int(rng.uniform(0.25, 0.8) / dt), rng.random()
    t, size = np.arange(m) * dt, rng.uniform(0.15, 1)
    if choice < 0.4:  # a sweep through the resonance, either way
        low, high = resonance * rng.uniform(0.3, 0.8), resonance * rng.uniform(1.2, 1.7)
        if rng.random() < 0.5:
            low, high = high, low
        return size * np.sin(2 * math.pi * (low * t + 0.5 * (high - low) * t**2 / (m * dt)))
    if choice < 0.6:  # noise that is smooth over a sixth of a period
        noise = gaussian_filter1d(rng.normal(size=m), 1 / (6 * resonance * dt))
        return np.clip(size * noise / (2 * noise.std()), -1, 1)
    if choice < 0.8:  # a burst, then free
        return np.where(t < 0.4 * m * dt, size * np.sin(2 * math.pi * resonance * rng.uniform(0.97, 1.03) * t), 0.0)
    return np.full(m, rng.choice([-1.0, 1.0]) * size)


def _rich_piece(dt: float, rng: np.random.Generator) -> Array:
    m = int(rng.uniform(0.08, 0.5) / dt)
    choice = rng.random()
    if choice < 0.45:
        return np.full(m, rng.uniform(-1, 1))
    if choice < 0.65:
        return np.full(m, rng.uniform(-0.12, 0.12))
    if choice < 0.85:
        width = rng.choice([0.3, 0.08])
        return np.linspace(rng.uniform(-width, width), rng.uniform(-width, width), m)
    turns = max(1, round(rng.uniform(4, 15) * m * dt))
    return rng.uniform(0.01, 0.05) * np.sin(2 * math.pi * turns * np.arange(m) / m)


def _multisine(n: int, dt: float, largest: float, rng: np.random.Generator, level: float, top: float) -> Array:
    t, duration = np.arange(n) * dt, n * dt
    lines = np.arange(1, int(top * duration), 2) / duration
    lines = lines[:: max(1, len(lines) // 60)]
    waves = np.cos(2 * math.pi * np.outer(t, lines) + rng.uniform(0, 2 * math.pi, len(lines))).sum(axis=1)
    levels, k = np.zeros(n), 0
    while k < n:
        m = int(rng.uniform(0.3, 0.8) / dt)
        levels[k : k + m] = rng.uniform(-level, level)
        k += m
    return largest * np.clip(0.4 * waves / np.abs(waves).max() + levels, -1, 1)
