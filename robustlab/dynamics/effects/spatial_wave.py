"""What the effects with a period over the position share: the mean of a wave over a step's way, and its frequency."""

from __future__ import annotations

import math

import numba as nb

from robustlab.dynamics.effects.contract import EffectParameter, Prior, Scales

__all__ = ["order_parameter", "order_prior", "orders_or_usual", "wave_mean", "wave_mean_and_slope"]

SMALL_ANGLE = 0.1  # below: the series of sin(x)/x to x^6 is exact to 3e-14
USUAL_TURNS = (1.0, 2.0, 4.0)  # rad per rad: once, twice, four times a turn
USUAL_PERIODS = (5.0, 10.0, 20.0)  # periods in the range of a straight axis


@nb.njit(cache=True)
def wave_mean(start, end, cosine, sine, k):  # type: ignore[no-untyped-def]
    """Mean of ``cosine cos(k q) + sine sin(k q)`` over the way from ``start`` to ``end``."""
    return wave_mean_and_slope(start, end, cosine, sine, k)[0]


@nb.njit(cache=True)
def wave_mean_and_slope(start, end, cosine, sine, k):  # type: ignore[no-untyped-def]
    """The same, and its slope over ``end``, good to the square of half the angle of the way."""
    half, middle = 0.5 * k * (end - start), 0.5 * k * (start + end)
    x = half * half
    shrink = 1.0 - x / 6.0 * (1.0 - x / 20.0 * (1.0 - x / 42.0)) if abs(half) < SMALL_ANGLE else math.sin(half) / half
    c, s = math.cos(middle), math.sin(middle)
    return shrink * (cosine * c + sine * s), 0.5 * k * shrink * (sine * c - cosine * s)


def orders_or_usual(scales: Scales) -> tuple[float, ...]:
    """Spatial frequencies to start from: the three strongest lines seen, else the usual ones."""
    if scales.orders:
        return scales.orders[:3]
    if scales.position_unit == "rad":
        return USUAL_TURNS
    return tuple(2.0 * math.pi * n / scales.position for n in USUAL_PERIODS)


def order_parameter(scales: Scales) -> EffectParameter:
    """The spatial frequency k of a force over the position."""
    unit = f"rad/{scales.position_unit}" if scales.position_unit else ""
    return EffectParameter("k", unit, "spatial frequency", order_prior(scales))


def order_prior(scales: Scales) -> Prior:
    """Prior of a spatial frequency: half a line's width around the line that was seen, else a decade."""
    centre = orders_or_usual(scales)[0]
    if not scales.orders:
        return Prior("log", centre, 1.2)
    periods = centre * scales.position / (2.0 * math.pi)
    return Prior("log", centre, min(0.3, 0.5 / periods))
