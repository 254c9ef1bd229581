"""Noise of the blind tests: encoder, current sensor, and a coloured torque at the motor's shaft."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .machine import Array
from .plants import Level, Setup

BANDWIDTH = 5.0  # of the torque disturbance in Hz


@dataclass(frozen=True)
class Noise:
    """One realisation, arrays (n,), and the encoder's step in the unit of the coordinate."""

    angle: Array
    torque: Array
    current: Array
    second: Array
    lsb: float


def noise(level: Level, setup: Setup, n: int, dt: float, rng: np.random.Generator) -> Noise:
    """Draw the noise of one run of n samples."""
    length = setup.length
    return Noise(
        angle=level.angle * length * rng.normal(size=n),
        torque=setup.disturbance * level.torque * setup.force_scale * coloured(n, dt, rng),
        current=level.current * rng.normal(size=n),
        second=level.angle * length * rng.normal(size=n),
        lsb=2 * math.pi / level.counts_per_turn * length,
    )


def coloured(n: int, dt: float, rng: np.random.Generator) -> Array:
    """First-order low-pass noise (n,) of unit variance, stationary from the first sample."""
    keep = math.exp(-2 * math.pi * BANDWIDTH * dt)
    white, out = rng.normal(size=n), np.empty(n)
    state = white[0]
    for k in range(n):
        out[k] = state
        state = keep * state + math.sqrt(1 - keep * keep) * white[k]
    return out
