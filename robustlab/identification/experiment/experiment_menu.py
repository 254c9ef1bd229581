"""Test signals that a next experiment is chosen from: patterns of simple pieces that a person can set up by hand."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from robustlab.arrays import Array

__all__ = ["Excitation", "Piece", "experiment_menu"]


SHORTEST_PERIOD = 4.0  # samples of the fastest sine
HEATING = 7  # lengths of an ordinary experiment that the winding is warmed for


@dataclass(frozen=True)
class Piece:
    """A stretch of one simple signal between ``low`` and ``high``.

    Attributes
    ----------
    kind
        ``"levels"``: held one after the other, each for ``period``; ``"square"`` (high first), ``"triangle"`` and
        ``"sine"`` (from the middle upwards) of this period; ``"sweep"``: sine whose period falls geometrically from
        ``period`` to ``shortest``; ``"multisine"``: odd harmonics of 1/``period`` up to 1/``shortest``, Schroeder
        phases.
    duration, period, shortest
        In s.
    low, high
        Extremes, in the unit of the input.
    levels
        Of the kind ``"levels"``.
    """

    kind: Literal["levels", "square", "triangle", "sine", "sweep", "multisine"]
    duration: float
    period: float
    low: float = 0.0
    high: float = 0.0
    levels: tuple[float, ...] = ()
    shortest: float = 0.0

    def samples(self, dt: float) -> Array:
        """The signal at 0, dt, ... before its end."""
        t = dt * np.arange(max(1, round(self.duration / dt)), dtype=float)
        if self.kind == "levels":
            # Half a sample more: a change that falls on a sample must not depend on rounding.
            index = np.floor((t + 0.5 * dt) / self.period).astype(int)
            return np.array(self.levels)[index % len(self.levels)]
        return 0.5 * (self.low + self.high) + 0.5 * (self.high - self.low) * self._wave(t, dt)

    def _wave(self, t: Array, dt: float) -> Array:
        """Between -1 and 1."""
        if self.kind == "square":
            return np.where((t + 0.5 * dt) % self.period < 0.5 * self.period, 1.0, -1.0)
        angle = 2.0 * np.pi * t / self.period
        if self.kind == "triangle":
            return np.arcsin(np.sin(angle)) * 2.0 / np.pi
        if self.kind == "sine":
            return np.sin(angle)
        if self.kind == "sweep":
            rate = np.log(self.period / self.shortest) / self.duration
            return np.sin(2.0 * np.pi * np.expm1(rate * t) / (rate * self.period))
        order = np.arange(1, max(2, int(self.period / self.shortest) + 1), 2)
        phase = -np.pi * np.arange(len(order)) ** 2 / len(order)
        waves = np.cos(angle[:, None] * order + phase).sum(axis=1)
        return waves / np.abs(waves).max()

    def text(self, unit: str) -> str:
        """In words, with its duration."""
        sep = f" {unit}" if unit else ""
        between = f"between {_level(self.low)}{sep} and {_level(self.high)}{sep}"
        length = f"for {_time(self.duration)}"
        if self.kind == "levels":
            shown = self.levels[: max(1, int(np.ceil(self.duration / self.period - 1e-6)))]
            if len(set(shown)) == 1:
                return f"{_level(shown[0])}{sep} {length}"
            again = ", over and over" if self.duration > len(self.levels) * self.period * (1.0 + 1e-6) else ""
            values = f"{', '.join(_level(v) for v in shown[:-1])} and {_level(shown[-1])}{sep}"
            return f"the levels {values}, each for {_time(self.period)}{again} ({_time(self.duration)})"
        if self.kind == "sweep":
            return f"a sine {between} whose period falls from {_time(self.period)} to {_time(self.shortest)}, {length}"
        if self.kind == "multisine":
            return (
                f"a multisine {between} of the odd harmonics of a period of {_time(self.period)}, up to "
                f"{1.0 / self.shortest:.3g} Hz, {length}"
            )
        word = {"square": "a square wave", "triangle": "a triangle wave", "sine": "a sine"}[self.kind]
        return f"{word} {between} with period {_time(self.period)} {length}"


@dataclass(frozen=True)
class Excitation:
    """One entry of the menu: a pattern of pieces, gone through over and over for ``samples`` sample times."""

    name: str
    input: str
    unit: str
    pieces: tuple[Piece, ...]
    samples: int

    def signal(self, dt: float) -> Array:
        """The input, (samples,), held for dt each."""
        cycle = np.concatenate([piece.samples(dt) for piece in self.pieces])
        return np.resize(cycle, self.samples)

    def text(self, samples: int, dt: float) -> str:
        """The first ``samples`` sample times in words."""
        parts, left, cycle = [], samples * dt, sum(p.duration for p in self.pieces)
        for piece in self.pieces:
            if left <= 0.5 * dt:
                break
            parts.append(replace(piece, duration=min(piece.duration, left)).text(self.unit))
            left -= piece.duration
        again = f"; this over and over for {_time(samples * dt)}" if samples * dt > cycle + 0.5 * dt else ""
        return f"{self.input} from rest: {', then '.join(parts)}{again}"


def experiment_menu(
    name: str, unit: str, lowest: float, highest: float, samples: int, dt: float, beat: float, warm: bool = False
) -> tuple[Excitation, ...]:
    """Signals of one input between two extremes.

    Parameters
    ----------
    name, unit, lowest, highest
        The input and the range that no signal leaves.
    samples, dt
        Length of each signal, and the sample time in s.
    beat
        Unit of all periods and dwell times in s: long enough for the plant to settle, short enough for many changes.
    warm
        Also a much longer one that warms the machine up between two equal blocks.
    """
    beat = _rounded(beat, dt)
    duration = samples * dt
    middle, half = 0.5 * (lowest + highest), 0.5 * (highest - lowest)

    def at(share: float) -> float:
        value = float(f"{middle + half * share:.3g}")
        return min(max(value, lowest), highest)

    def levels(dwell: float, *shares: float) -> Piece:
        dwell = _rounded(dwell * beat, dt)
        return Piece("levels", dwell * len(shares), dwell, levels=tuple(at(s) for s in shares))

    def wave(kind: Literal["square", "triangle", "sine"], share: float, beats: float, length: float = np.inf) -> Piece:
        period = _rounded(beats * beat, dt)
        return Piece(kind, min(_rounded(length * beat, dt) if np.isfinite(length) else duration, duration), period,
                     at(-share), at(share))  # fmt: skip

    fastest = max(SHORTEST_PERIOD * dt, beat / 40.0)
    slowest = min(2.0 * beat, duration)
    rich = (
        levels(0.5, 1, -1, 0.5, -0.5, 0.1, -0.1),
        wave("triangle", 0.3, 2, 2),
        wave("triangle", 0.08, 2, 2),
        wave("sine", 0.03, 0.25, 0.5),
        levels(0.5, 0),
    )
    patterns: dict[str, tuple[Piece, ...]] = {
        "step": (levels(1, 0), Piece("levels", duration, duration, levels=(at(1),))),
        "square wave": (wave("square", 1, 1),),
        "square wave of a third": (wave("square", 1 / 3, 1),),
        "one-way steps": (levels(1, 0.25, 0.6, 1, 0.4, 0.8),),
        "levels both ways": (levels(1, 1, -1, 0.6, -0.6, 0.3, -0.3, 0.15, -0.15),),
        "slow triangle through zero, large": (wave("triangle", 0.4, 8),),
        "slow triangle through zero, medium": (wave("triangle", 0.15, 8),),
        "slow triangle through zero, small": (wave("triangle", 0.06, 8),),
        "rich": rich,
        "odd multisine": (
            Piece("multisine", min(8 * beat, duration), min(8 * beat, duration), at(-1), at(1), (), fastest),
        ),
        "sine sweep": (
            Piece("sweep", min(8 * beat, duration), slowest, at(-0.5), at(0.5), (), min(fastest, slowest / 2)),
        ),
        "slow speeds both ways": (levels(2, 0.08, -0.08, 0.16, -0.16, 0.3, -0.3),),
        "micro sine": (wave("sine", 0.02, 0.5),),
        "small sine": (wave("sine", 0.06, 0.5),),
        "small fast reversals": (wave("square", 0.15, 0.25),),
        "coast-down": (levels(1, 1, 0, -1, 0),),
        "small steps about rest": (levels(0.5, 0, 0.03, 0.06, 0.1, 0.06, 0.03, 0, -0.03, -0.06, -0.1, -0.06, -0.03),),
    }
    menu = [Excitation(key, name, unit, pieces, samples) for key, pieces in patterns.items()]
    if warm:
        block = sum(p.duration for p in rich)
        hot = replace(wave("square", 1, 1), duration=_rounded(HEATING * duration, dt))
        total = round((2.0 * block + hot.duration) / dt)
        menu.append(Excitation("first block again when warm", name, unit, (*rich, hot, *rich), total))
    return tuple(menu)


def _rounded(seconds: float, dt: float) -> float:
    """Two digits, in whole pairs of samples."""
    return max(2, 2 * round(float(f"{seconds:.2g}") / dt / 2.0)) * dt


def _level(value: float) -> str:
    return f"{value:+.3g}" if value else "0"


def _time(seconds: float) -> str:
    return f"{seconds:.3g} s" if seconds >= 0.1 else f"{1e3 * seconds:.3g} ms"
