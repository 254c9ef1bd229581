"""Effects that are a load: constant, of gravity, or periodic over the position or the time."""

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


def order_prior(scales: Scales) -> Prior:
    """Prior of a spatial frequency: half a line's width around the line that was seen, else a decade."""
    centre = orders_or_usual(scales)[0]
    if not scales.orders:
        return Prior("log", centre, 1.2)
    periods = centre * scales.position / (2.0 * math.pi)
    return Prior("log", centre, min(0.3, 0.5 / periods))


class WaveEffect(Effect):
    """A wave of the spatial frequency k; its cosine and sine part start at zero, where every phase is equally near."""

    def priors(self, scales: Scales) -> dict[str, Prior]:
        return {"k": order_prior(scales)}

    def tried(self, scales: Scales) -> dict[str, tuple[float, ...]]:
        return {"k": orders_or_usual(scales)}


@law
def load_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Parameters p = (T_0,)."""
    return -p[0]


class ConstantLoad(Effect, row="constant-load"):
    """Constant load: gravity along the axis, a preload, or an offset."""

    force = load_force

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, "speed", 0.0, 0.0, offset=abs(values["T0"]))


LOOKS = 6  # before the root is bracketed


@nb.njit(cache=True)
def _wave_residual(force, args):  # type: ignore[no-untyped-def]
    q0, q_free, gq, cosine, sine, k = args
    return force - wave_mean(q0, q_free + gq * force, cosine, sine, k)


@law
def cogging_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Parameters p = (A_c, A_s, k)."""
    most = abs(p[0]) + abs(p[1])
    args = (seen[Q0], seen[Q], seen[GQ], p[0], p[1], p[2])
    # The force hardly changes the way: Newton steps from no force at all are there after two looks. What it does back
    # to its mean is at most `feedback`; the slope at one place says less: none where a crest is the middle of the way.
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
    """Cogging, torque ripple: a force that is periodic in the position and the same both ways."""

    force = cogging_force

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # Its slope over the position, a stiffness of either sign, lies within k A; its size within A.
        size = math.hypot(values["Ac"], values["As"])
        return Footprint(site.name, "position", -values["k"] * size, values["k"] * size, offset=size)


class PendulumGravity(Effect, row="pendulum-gravity"):
    """Gravity of a pendulum: a weight off the axis of a joint that turns."""

    force = cogging_force

    def fits(self, port: Port) -> bool:
        return super().fits(port) and port.position_unit == "rad"

    def arguments(self, values: Mapping[str, float]) -> tuple[float, ...]:
        return -values["H"], -values["G"], 1.0

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # Its slope over the position, a stiffness of either sign, lies within m g l; so does its size.
        size = math.hypot(values["G"], values["H"])
        return Footprint(site.name, "position", -size, size, offset=size)


MAINS = (50.0, 100.0, 60.0, 120.0)  # Hz: of both kinds of mains, and of what a rectifier makes of them


@law
def ripple_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Parameters p = (A_c, A_s, f); outside of time (no finite TIME) its mean."""
    if not math.isfinite(seen[TIME]):
        return 0.0
    return wave_mean(seen[TIME], seen[TIME] + seen[STEP], p[0], p[1], 2.0 * math.pi * p[2])


FEWEST_TURNS = 2.0  # of a ripple within the record: fewer are a slope or a bow


class TorqueRipple(Effect, row="torque-ripple"):
    """Ripple of the force over time: mains, a beat of two clocks, an unbalanced neighbour."""

    force = ripple_force

    def visited(self, values: Mapping[str, float], scales: Scales) -> bool:
        return values["f"] * scales.duration >= FEWEST_TURNS

    def priors(self, scales: Scales) -> dict[str, Prior]:
        # Half a line's width around the line that was seen, else the range of the mains.
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
        # No gain of the motion at all: a bounded load.
        return Footprint(site.name, "time", 0.0, 0.0, offset=math.hypot(values["Ac"], values["As"]))


def _lines_or_mains(scales: Scales) -> tuple[float, ...]:
    """Frequencies to start from: the lines seen, else those of the mains that the sampling shows."""
    shown = tuple(f for f in MAINS if f < 0.5 / scales.dt)
    return scales.lines or shown or (0.1 / scales.dt,)
