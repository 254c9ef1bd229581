"""Load effects: constant, gravity, periodic in position or time."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numba as nb

from robustlab.dynamics.effects.contract import Effect, Footprint, Prior, Scales, Site
from robustlab.dynamics.ports.law_kernel import CLOSE, GQ, Q0, STEP, TIME, Q, bracket, guess, is_open, law, narrowed
from robustlab.dynamics.ports.port_model import Port

SMALL_ANGLE = 0.1  # below: the series of sin(x)/x to x^6 is exact to 3e-14
USUAL_TURNS = (1.0, 2.0, 4.0)  # rad per rad: once, twice, four times a turn
USUAL_PERIODS = (5.0, 10.0, 20.0)  # periods in the range of a straight axis


@nb.njit(cache=True)
def wave_mean(start, end, cosine, sine, k):  # type: ignore[no-untyped-def]
    """Return the mean of ``cosine cos(k q) + sine sin(k q)`` from ``start`` to ``end``."""
    return wave_mean_and_slope(start, end, cosine, sine, k)[0]


@nb.njit(cache=True)
def wave_mean_and_slope(start, end, cosine, sine, k):  # type: ignore[no-untyped-def]
    """Return the mean and its slope over ``end``, with an error of the square of half the angle."""
    half, middle = 0.5 * k * (end - start), 0.5 * k * (start + end)
    x = half * half
    shrink = 1.0 - x / 6.0 * (1.0 - x / 20.0 * (1.0 - x / 42.0)) if abs(half) < SMALL_ANGLE else math.sin(half) / half
    c, s = math.cos(middle), math.sin(middle)
    return shrink * (cosine * c + sine * s), 0.5 * k * shrink * (sine * c - cosine * s)


def orders_or_usual(scales: Scales) -> tuple[float, ...]:
    """Return initial spatial frequencies: the three strongest lines, else usual ones."""
    if scales.orders:
        return scales.orders[:3]
    if scales.position_unit == "rad":
        return USUAL_TURNS
    return tuple(2.0 * math.pi * n / scales.position for n in USUAL_PERIODS)


def order_prior(scales: Scales) -> Prior:
    """Return the prior of a spatial frequency: half a line width around a detected line, else a decade."""
    centre = orders_or_usual(scales)[0]
    if not scales.orders:
        return Prior("log", centre, 1.2)
    periods = centre * scales.position / (2.0 * math.pi)
    return Prior("log", centre, min(0.3, 0.5 / periods))


class WaveEffect(Effect):
    """A wave of spatial frequency k; the fit starts at zero amplitude, where no phase is preferred."""

    def priors(self, scales: Scales) -> dict[str, Prior]:
        return {"k": order_prior(scales)}

    def tried(self, scales: Scales) -> dict[str, tuple[float, ...]]:
        return {"k": orders_or_usual(scales)}


@law
def load_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Return the force for p = (T_0,)."""
    return -p[0]


class ConstantLoad(Effect, row="constant-load"):
    """Constant load: gravity along the axis, a preload, or an offset."""

    force = load_force

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, "speed", 0.0, 0.0, offset=abs(values["T0"]))


LOOKS = 6  # Newton steps before the root is bracketed


@nb.njit(cache=True)
def _wave_residual(force, args):  # type: ignore[no-untyped-def]
    q0, q_free, gq, cosine, sine, k = args
    return force - wave_mean(q0, q_free + gq * force, cosine, sine, k)


@law
def cogging_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Return the force for p = (A_c, A_s, k)."""
    most = abs(p[0]) + abs(p[1])
    args = (seen[Q0], seen[Q], seen[GQ], p[0], p[1], p[2])
    # The force hardly changes the displacement: Newton's method from zero converges in two steps. `feedback` bounds the
    # influence of the force on its mean; the local slope does not, as it is zero at a crest.
    force, feedback = 0.0, 0.5 * seen[GQ] * abs(p[2]) * most
    for _ in range(LOOKS if feedback < 0.5 else 0):
        mean, slope = wave_mean_and_slope(seen[Q0], seen[Q] + seen[GQ] * force, p[0], p[1], p[2])
        r = force - mean
        force -= r / (1.0 - seen[GQ] * slope)
        if abs(r) * feedback <= CLOSE * most:
            return force
    b = bracket(-most, _wave_residual(-most, args), most, _wave_residual(most, args))
    while is_open(b):
        force = guess(b)
        b = narrowed(b, force, _wave_residual(force, args))
    return b[0]


class Cogging(WaveEffect, row="cogging"):
    """Cogging, torque ripple: a force periodic in the position, equal in both directions."""

    force = cogging_force

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # The slope over the position, a stiffness of either sign, is at most k A; the force at most A.
        size = math.hypot(values["Ac"], values["As"])
        return Footprint(site.name, "position", -values["k"] * size, values["k"] * size, offset=size)


class PendulumGravity(Effect, row="pendulum-gravity"):
    """Gravity of a pendulum: an eccentric weight at a rotary joint."""

    force = cogging_force

    def fits(self, port: Port) -> bool:
        return super().fits(port) and port.position_unit == "rad"

    def arguments(self, values: Mapping[str, float]) -> tuple[float, ...]:
        return -values["H"], -values["G"], 1.0

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # The slope over the position, a stiffness of either sign, and the force are at most m g l.
        size = math.hypot(values["G"], values["H"])
        return Footprint(site.name, "position", -size, size, offset=size)


MAINS = (50.0, 100.0, 60.0, 120.0)  # Hz: mains frequencies and their doubles (rectifiers)


@law
def ripple_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Return the force for p = (A_c, A_s, f); the mean where TIME is not finite."""
    if not math.isfinite(seen[TIME]):
        return 0.0
    return wave_mean(seen[TIME], seen[TIME] + seen[STEP], p[0], p[1], 2.0 * math.pi * p[2])


FEWEST_TURNS = 2.0  # periods of a ripple within the record


class TorqueRipple(Effect, row="torque-ripple"):
    """Force ripple over time: mains, a beat of two clocks, another unbalanced machine."""

    force = ripple_force

    def visited(self, values: Mapping[str, float], scales: Scales) -> bool:
        return values["f"] * scales.duration >= FEWEST_TURNS

    def priors(self, scales: Scales) -> dict[str, Prior]:
        # Half a line width around a detected line, else the range of the mains.
        starts = _lines_or_mains(scales)
        centre = math.exp(sum(map(math.log, starts)) / len(starts))
        width = 0.5 / (centre * scales.duration)
        return {"f": Prior("log", centre, min(0.3, width) if len(scales.lines) == 1 else 0.5)}

    def tried(self, scales: Scales) -> dict[str, tuple[float, ...]]:
        return {"f": _lines_or_mains(scales)}

    def begun(self, values: Mapping[str, float], later: float) -> Mapping[str, float]:
        angle = 2.0 * math.pi * values["f"] * later
        turn, ac, as_ = complex(math.cos(angle), math.sin(angle)), values["Ac"], values["As"]
        wave = complex(ac, -as_) * turn  # Ac cos + As sin is the real part of (Ac - i As) exp(2 pi i f t)
        return {**values, "Ac": wave.real, "As": -wave.imag}

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # A bounded load, no gain of the motion.
        return Footprint(site.name, "time", 0.0, 0.0, offset=math.hypot(values["Ac"], values["As"]))


def _lines_or_mains(scales: Scales) -> tuple[float, ...]:
    """Return initial frequencies: the detected lines, else those of the mains below the Nyquist frequency."""
    mains = tuple(f for f in MAINS if f < 0.5 / scales.dt)
    return scales.lines or mains or (0.1 / scales.dt,)
