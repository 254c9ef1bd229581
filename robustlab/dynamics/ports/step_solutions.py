r"""Mean forces over one step that several laws share: bracketed roots and dry friction that turns within the step.

A law answers with one force for the whole step. The mean of the true force over the step makes that second order in the
step length; the force at the end alone would be first order, and a reversal would come up to a step early. Within the
step the velocity is taken to run linearly from its start to its end.

Compiled laws are cached by the date of their own file: after a change here, touch the files that use it.
"""

from __future__ import annotations

import math

import numba as nb

__all__ = ["CLOSE", "SECANTS", "bracket", "dry_mean_force", "guess", "is_open", "narrowed", "stribeck_mean"]

ROUNDING = 4e-16
MOST_LOOKS = 200
CLOSE = 1e-13  # of the largest force: what the rounding of a position of many turns leaves
SECANTS = 6  # looks of a law whose force hardly acts back on itself, before it brackets its root
FAR = 6.1  # Stribeck velocities, beyond which exp(-(v/vs)^2) is below rounding
SERIES_BELOW = 1e-3  # of the Stribeck velocity: there the difference of two error functions has lost digits


@nb.njit(cache=True)
def bracket(low, r_low, high, r_high):  # type: ignore[no-untyped-def]
    """Bracket of a root of r(x) with r(low) <= 0 <= r(high), x and r of one unit; closed where an end fails that.

    The search is a loop in each law, since compiled functions that take functions cannot be kept on disk::

        b = bracket(low, r(low), high, r(high))
        while is_open(b):
            x = guess(b)
            b = narrowed(b, x, r(x))
        root = b[0]
    """
    if r_low >= 0.0:
        return low, 0.0, low, 0.0, 0.0, 0.0
    if r_high <= 0.0:
        return high, 0.0, high, 0.0, 0.0, 0.0
    return low, r_low, high, r_high, 0.0, ROUNDING * (abs(low) + abs(high))


@nb.njit(cache=True)
def is_open(b):  # type: ignore[no-untyped-def]
    """Whether there is more to find in the bracket than rounding."""
    return b[2] - b[0] > b[5]


@nb.njit(cache=True)
def guess(b):  # type: ignore[no-untyped-def]
    """Next place to look: regula falsi, and a bisection every fourth time so that the bracket always shrinks."""
    low, r_low, high, r_high, count, _ = b
    x = (low * r_high - high * r_low) / (r_high - r_low)
    if int(abs(count)) % 4 == 3 or not low < x < high:
        x = low + 0.5 * (high - low)
    return x


@nb.njit(cache=True)
def narrowed(b, x, r):  # type: ignore[no-untyped-def]
    """The bracket after r was found at x; the end that stays is weighted down if it stayed before (Illinois).

    The count of looks carries the sign of the end that moved last. A residual within rounding closes the bracket.
    """
    low, r_low, high, r_high, count, rounding = b
    looks = abs(count) + 1.0
    if not abs(r) > rounding or looks > MOST_LOOKS:
        return x, 0.0, x, 0.0, 0.0, 0.0
    if r < 0.0:
        return x, r, high, 0.5 * r_high if count < 0.0 else r_high, -looks, rounding
    return low, 0.5 * r_low if count > 0.0 else r_low, x, r, looks, rounding


@nb.njit(cache=True)
def stribeck_mean(start, end, width):  # type: ignore[no-untyped-def]
    r"""Mean of :math:`e^{-(v/v_s)^2}` between two velocities: a difference of error functions."""
    a, b = start / width, end / width
    if abs(b - a) < SERIES_BELOW:
        x = 0.5 * (a + b)
        return math.exp(-x * x) * (1.0 + (4.0 * x * x - 2.0) * (b - a) ** 2 / 24.0)
    return 0.5 * math.sqrt(math.pi) * (math.erf(b) - math.erf(a)) / (b - a)


@nb.njit(cache=True)
def _slide(start, free, compliance, level, rise, width):  # type: ignore[no-untyped-def]
    """End velocity >= 0 of a body that slides forward from ``start`` >= 0; -1 where it stops on the way.

    The residual is the excess of the end velocity over the one that the mean friction on the way to it brings about.
    The motion is monotone within the step, so that its root lies on that side of the start to which the body is
    accelerated there.
    """
    fall, swing = compliance * level, compliance * rise
    if rise == 0.0 or min(start, free - fall) > FAR * width:
        return free - fall if free >= fall else -1.0
    here = start - free + fall + swing * stribeck_mean(start, start, width)
    if here <= 0.0:
        end = max(start, free)
        b = bracket(start, here, end, end - free + fall + swing * stribeck_mean(start, end, width))
    else:
        still = fall - free + swing * stribeck_mean(start, 0.0, width)
        if still > 0.0:
            return -1.0
        b = bracket(0.0, still, start, here)
    while is_open(b):
        end = guess(b)
        b = narrowed(b, end, end - free + fall + swing * stribeck_mean(start, end, width))
    return b[0]


@nb.njit(cache=True)
def dry_mean_force(v0, v_free, compliance, level, rise, width):  # type: ignore[no-untyped-def]
    r"""Mean force of dry friction :math:`-(F + \Delta F e^{-(v/v_s)^2}) \operatorname{sgn} v` over a step.

    v0 is the velocity at the start of the step, v_free that at its end without the friction, ``compliance`` the change
    of the end velocity per unit of force. A body that stops within the step sticks, with the end velocity exactly zero,
    if :math:`F + \Delta F` holds what drives it; otherwise it slides on the other way for the rest of the step.
    """
    sign = 1.0 if v0 > 0.0 or (v0 == 0.0 and v_free > 0.0) else -1.0
    start, free = sign * v0, sign * v_free
    drive = free - start  # change of velocity over the step without friction
    holding = compliance * (level + rise)
    if start > 0.0 or drive > holding:
        end = _slide(start, free, compliance, level, rise, width)
        if end >= 0.0:
            return -sign * (level if rise == 0.0 else level + rise * stribeck_mean(start, end, width))
    if drive >= -holding:
        return -sign * free / compliance
    friction = level if rise == 0.0 else level + rise * stribeck_mean(start, 0.0, width)
    left = 1.0 - start / (compliance * friction - drive)  # share of the step after the stop
    back = _slide(0.0, -left * drive, left * compliance, level, rise, width)
    return -sign * (max(back, 0.0) + free) / compliance
