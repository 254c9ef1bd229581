"""Loads and friction at a joint, and their like in an electric circuit: brushes, a winding that warms up."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numba as nb

from robustlab.dynamics.effects.effect import Effect, Footprint, Prior, Scales, Site
from robustlab.dynamics.ports.law_kernel import (
    CLOSE,
    GQ,
    GV,
    Q0,
    SECANTS,
    STEP,
    TIME,
    V0,
    Q,
    V,
    bracket,
    dry_mean_force,
    guess,
    is_open,
    law,
    narrowed,
)
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


class ConstantLoad(Effect, ids="constant-load"):
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


class Cogging(WaveEffect, ids="cogging"):
    """Cogging, torque ripple: a force periodic in the position, equal in both directions."""

    force = cogging_force

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # The slope over the position, a stiffness of either sign, is at most k A; the force at most A.
        size = math.hypot(values["Ac"], values["As"])
        return Footprint(site.name, "position", -values["k"] * size, values["k"] * size, offset=size)


class PendulumGravity(Effect, ids="pendulum-gravity"):
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


class TorqueRipple(Effect, ids="torque-ripple"):
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


@law
def dry_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Return the mean force for p = (F_c,), exact for a constant drive, with sticking and reversals."""
    return dry_mean_force(seen[V0], seen[V], seen[GV], p[0], 0.0, 1.0)


class DryEffect(Effect, ids="coulomb-friction brush-drop"):
    """A force against the motion, or a voltage of brushes against the current, that holds at rest."""

    force = dry_force

    def levels(self, values: Mapping[str, float], amplitude: float) -> tuple[float, float]:
        """Return the level of the relay with the same first harmonic at an amplitude, and the largest level."""
        (level,) = self.arguments(values)
        return level, level

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # Describing function of the relay of level F for a sinusoidal signal of amplitude a: 4 F / (pi a).
        level, most = self.levels(values, amplitude)
        gain = 4.0 * level / (math.pi * amplitude)
        signal = "current" if self.site_kind == "current" else "speed"
        return Footprint(site.name, signal, 0.0, gain, offset=most, describing=gain)


ROUNDING = 1e-13


@law
def uneven_dry_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Return the mean force for p = (F_+, F_-), exact for a constant drive."""
    level, load = 0.5 * (p[0] + p[1]), 0.5 * (p[0] - p[1])
    force = dry_mean_force(seen[V0], seen[V] - seen[GV] * load, seen[GV], level, 0.0, 1.0) - load
    sticks = -seen[V] / seen[GV]
    return sticks if abs(force - sticks) <= ROUNDING * level else force  # exactly at rest despite rounding of the load


class AsymmetricCoulombFriction(DryEffect, ids="asymmetric-coulomb-friction"):
    """Dry friction whose level differs between the directions."""

    force = uneven_dry_force

    def unrefined(self, values: Mapping[str, float]) -> Mapping[str, float]:
        return {"Fc": 0.5 * (values["F_pos"] + values["F_neg"])}

    def levels(self, values: Mapping[str, float], amplitude: float) -> tuple[float, float]:
        return 0.5 * (values["F_pos"] + values["F_neg"]), max(values["F_pos"], values["F_neg"])


@law
def stribeck_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Return the mean force for p = (F_c, dF, v_s), with sticking, breakaway and reversals."""
    return dry_mean_force(seen[V0], seen[V], seen[GV], p[0], p[1], p[2])


class StribeckFriction(DryEffect, ids="stribeck-friction"):
    """Stribeck friction: dry friction whose level decreases with the speed, from breakaway to sliding."""

    # Armstrong-Helouvry, Dupont, Canudas de Wit, *A survey of models, analysis tools and compensation methods for the
    # control of machines with friction*, Automatica 30 (1994), eq. 5.

    force = stribeck_force

    def visited(self, values: Mapping[str, float], scales: Scales) -> bool:
        return values["vs"] <= scales.speed

    def levels(self, values: Mapping[str, float], amplitude: float) -> tuple[float, float]:
        # Fc + dF D(r) / r, with Dawson's integral D and r = a / vs
        from scipy.special import dawsn

        ratio = amplitude / values["vs"]
        return values["Fc"] + values["dF"] * float(dawsn(ratio)) / ratio, values["Fc"] + values["dF"]


@nb.njit(cache=True)
def _contact_stretch(deflection, way, limit):  # type: ignore[no-untyped-def]
    """Return the deflection after a displacement ``way`` of the contact, and its mean; ``limit`` is g."""
    x = abs(way) / limit
    end = math.copysign(limit, way)
    left = math.exp(-x)
    mean = 1.0 - 0.5 * x if x < 1e-8 else -math.expm1(-x) / x
    return end + (deflection - end) * left, end + (deflection - end) * mean


@nb.njit(cache=True)
def _contact(force, args):  # type: ignore[no-untyped-def]
    """Return the deflection at the end of the step under this force, and that whose force acts over the step."""
    v0, v_free, compliance, h, start, limit, stiffness = args
    v1 = v_free + compliance * force
    stiff = (0.5 * compliance * h * stiffness) ** 4
    if v0 * v1 < 0.0:
        share = v0 / (v0 - v1)
        turned, mean = _contact_stretch(start, 0.5 * share * h * v0, limit)
        end, back = _contact_stretch(turned, 0.5 * (1.0 - share) * h * v1, limit)
        acting = end
        if abs(v_free - v0) > compliance * stiffness * limit:  # the drive exceeds the friction: it slides back
            acting = share * mean + (1.0 - share) * end
        return end, (share * mean + (1.0 - share) * back + stiff * acting) / (1.0 + stiff)
    end, mean = _contact_stretch(start, 0.5 * h * (v0 + v1), limit)
    return end, (mean + stiff * end) / (1.0 + stiff)


@nb.njit(cache=True)
def _contact_residual(force, args):  # type: ignore[no-untyped-def]
    return force + args[6] * _contact(force, args)[1]


@law
def presliding_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Return the force for p = (F_c, sigma_0); the residual's slope over the force is at least one."""
    limit = p[0] / p[1]
    start = min(max(z[0], -limit), limit)
    args = (seen[V0], seen[V], seen[GV], seen[STEP], start, limit, p[1])
    b = bracket(-p[0], _contact_residual(-p[0], args), p[0], _contact_residual(p[0], args))
    while is_open(b):
        force = guess(b)
        b = narrowed(b, force, _contact_residual(force, args))
    force = b[0]
    z_next[0] = _contact(force, args)[0]
    return force


class Presliding(Effect, ids="presliding"):
    """Presliding: dry friction whose contact deflects like a spring before it slides."""

    # Dahl, *A solid friction model* (1968); Canudas de Wit, Olsson, Astrom, Lischinsky, *A new model for control of
    # systems with friction*, IEEE Trans. Automatic Control 40 (1995).

    force = presliding_force
    memory = 1

    def visited(self, values: Mapping[str, float], scales: Scales) -> bool:
        # A contact that never slides is a spring; without a position this is unknown.
        return not scales.position_unit or values["Fc"] / values["sigma0"] <= scales.position

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # In a steady loop of position amplitude a the force is at most Fc tanh(sigma0 a / Fc), its first harmonic at
        # most 4/pi of that.
        level = values["Fc"]
        gain = 4.0 / math.pi * level * math.tanh(values["sigma0"] * amplitude / level) / amplitude
        return Footprint(site.name, "position", 0.0, gain, offset=level)


@nb.njit(cache=True)
def _level_force(level, args):  # type: ignore[no-untyped-def]
    return dry_mean_force(args[0], args[1], args[2], level, 0.0, 1.0)


@nb.njit(cache=True)
def _level_residual(level, args):  # type: ignore[no-untyped-def]
    """Return the level minus the mean level along the resulting motion."""
    _, _, _, q0, q_free, gq, fc, pc, ps, k = args
    return level - max(0.0, fc + wave_mean(q0, q_free + gq * _level_force(level, args), pc, ps, k))


@law
def uneven_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Return the force for p = (F_c, P_c, P_s, k)."""
    args = (seen[V0], seen[V], seen[GV], seen[Q0], seen[Q], seen[GQ], p[0], p[1], p[2], p[3])
    most = max(0.0, p[0]) + abs(p[1]) + abs(p[2])
    # The friction hardly changes the displacement: the secant method converges in three or four evaluations.
    before, r_before = max(0.0, p[0]), _level_residual(max(0.0, p[0]), args)
    level = before - r_before
    for _ in range(SECANTS):
        r = _level_residual(level, args)
        if abs(r) <= CLOSE * most:
            return _level_force(level, args)
        if abs(r) > 0.5 * abs(r_before):
            break
        before, r_before, level = level, r, level - r * (level - before) / (r - r_before)
    b = bracket(0.0, _level_residual(0.0, args), most, _level_residual(most, args))
    while is_open(b):
        level = guess(b)
        b = narrowed(b, level, _level_residual(level, args))
    return _level_force(b[0], args)


class PositionDependentFriction(WaveEffect, ids="position-dependent-friction"):
    """Dry friction whose level is periodic in the position: a bent shaft, an uneven screw or gear."""

    force = uneven_force

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # As Coulomb friction of the highest level: 4 F / (pi a) at the speed amplitude a.
        most = values["Fc"] + math.hypot(values["Pc"], values["Ps"])
        return Footprint(site.name, "speed", 0.0, 4.0 * most / (math.pi * amplitude), offset=most)


@law
def loss_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Return the force for p = (1 - eta,)."""
    level = p[0] * abs(seen[V] - seen[V0]) / seen[GV]
    return dry_mean_force(seen[V0], seen[V], seen[GV], level, 0.0, 1.0)


class GearEfficiency(Effect, ids="gear-efficiency"):
    """Gear losses: dry friction proportional to the driving force of the joint."""

    force = loss_force

    def arguments(self, values: Mapping[str, float]) -> tuple[float, ...]:
        return (1.0 - values["eta"],)

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # Gain of the driving force between -(1 - eta) (driving) and 1 - eta (braking), at any amplitude.
        loss = 1.0 - values["eta"]
        return Footprint(site.name, "force", -loss, loss)


@law
def directional_loss(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Return the mean force for p = (k_d, k_b), exact for a constant drive; with k_d >= 1 the drive never moves it."""
    drive = seen[V] - seen[V0]  # T times the compliance
    driven = min(p[0], 1.0)
    if seen[V0] * drive >= 0.0:
        return -driven * drive / seen[GV]
    share = abs(seen[V0]) / ((1.0 + p[1]) * abs(drive))  # of the step until it stops
    if share >= 1.0:
        return p[1] * drive / seen[GV]
    return ((1.0 - share) * (1.0 - driven) * drive - seen[V]) / seen[GV]


class LoadDependentFriction(Effect, ids="load-dependent-friction"):
    """Friction proportional to the load of a gear, with different shares while driving and braking."""

    # Duclusaud, Passault, Padois, Ly, *Extended Friction Models for the Physics Simulation of Servo Actuators*, arXiv
    # 2410.08650 (2024): load-dependent and directional models of the torques of motor and load.

    force = directional_loss

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # Gain of the driving force between -kd (driving) and kb (braking), at any amplitude.
        most = max(values["kd"], values["kb"])
        return Footprint(site.name, "force", -most, most)


# Limit of the accelerating half, as a share of the velocity per half step: above it the time constant is shorter than
# the step.
MOST_PUSH = 0.5


@law
def asymmetric_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Return the force for p = (dF_v,) at the mean speed of the step."""
    v0, v1, gv = seen[V0], seen[V], seen[GV]
    free = 0.5 * (v0 + v1)  # mean velocity without the force
    gain = 0.5 * gv * p[0]
    opposing = gain if free > 0.0 else -gain
    force = -p[0] * abs(free) / (1.0 + max(opposing, -MOST_PUSH))
    if v0 * (v1 + gv * force) >= 0.0:
        return force
    way = 1.0 if v1 > v0 else -1.0
    linear, last = way * (v1 - v0) + 2.0 * gain * v1, p[0] * (v0 * v0 + v1 * v1)
    inside = linear * linear - gv * (2.0 * way + p[0] * gv) * last
    if linear <= 0.0 or inside < 0.0:  # the force itself turns the motion within the step
        return force
    return -last / (linear + math.sqrt(inside))


class AsymmetricViscousFriction(Effect, ids="asymmetric-viscous-friction"):
    """Viscous friction that differs between the directions, antisymmetric about the plant's own."""

    force = asymmetric_force

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # Sector of -dFv |v| over v: either sign, at any amplitude.
        size = abs(values["dFv"])
        return Footprint(site.name, "speed", -size, size)


@law
def drag_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Return the force for p = (c,); the mean velocity v solves v + (gv c / 2) v |v| = its value without drag."""
    free = 0.5 * (seen[V0] + seen[V])
    v = 2.0 * free / (1.0 + math.sqrt(1.0 + 2.0 * seen[GV] * p[0] * abs(free)))
    return -p[0] * v * abs(v)


class QuadraticDrag(Effect, ids="quadratic-drag"):
    """Quadratic drag: fans, fluids, windage."""

    force = drag_force

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # Sector of c v |v| over |v| <= a; its describing function is 8 c a / (3 pi), inside.
        return Footprint(site.name, "speed", 0.0, values["c"] * amplitude)


@law
def heating_drop(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Return the voltage drop for p = (kappa, T) at mid-step: mean current times the resistance z[0]."""
    resistance = z[0]
    drop = -resistance * 0.5 * (seen[V0] + seen[V]) / (1.0 + 0.5 * seen[GV] * resistance)
    current = 0.5 * (seen[V0] + seen[V] + seen[GV] * drop)
    final = p[0] * current * current
    z_next[0] = final + (resistance - final) * math.exp(-seen[STEP] / p[1])
    return drop


QUICKEST = 0.5  # s: shortest thermal time constant of a winding


class ResistanceHeating(Effect, ids="resistance-heating"):
    """Heating of a winding: a resistance that increases with the dissipated heat."""

    force = heating_drop
    memory = 1

    def priors(self, scales: Scales) -> dict[str, Prior]:
        # 20 % of the winding's resistance at a third of the largest current.
        rise = 0.2 * scales.force / scales.current / (scales.current / 3.0) ** 2
        return {"kappa": Prior("log", rise, 1.5)}

    def visited(self, values: Mapping[str, float], scales: Scales) -> bool:
        return values["T"] >= QUICKEST

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # Any resistance between cold and the steady state of this current.
        return Footprint(site.name, "current", 0.0, values["kappa"] * amplitude**2)
