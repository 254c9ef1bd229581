"""Springs, stops and couplings at a joint."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numba as nb
import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.effect import Effect, Footprint, Law, Prior, Scales, Site
from robustlab.dynamics.ports.law_kernel import GQ, GV, Q0, STEP, V0, Q, V, bracket, guess, is_open, law, narrowed
from robustlab.dynamics.ports.port_model import PortModel, with_load_side


@nb.njit(cache=True)
def _cubic_residual(force, args):  # type: ignore[no-untyped-def]
    q0, q_free, gq, k3 = args
    q1 = q_free + gq * force
    return force + 0.25 * k3 * (q1 + q0) * (q1 * q1 + q0 * q0)


@law
def cubic_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Return the force for p = (k_3,)."""
    # Hardening: the root lies below -residual(0), and below the force to the mirror image of the start (zero work).
    args = (seen[Q0], seen[Q], seen[GQ], p[0])
    bound = -_cubic_residual(0.0, args)
    if p[0] < 0.0:
        bound *= 2.0
    elif abs(seen[Q] + seen[Q0]) < seen[GQ] * abs(bound):
        bound = -(seen[Q] + seen[Q0]) / seen[GQ]
    low, high = min(bound, 0.0), max(bound, 0.0)
    b = bracket(low, _cubic_residual(low, args), high, _cubic_residual(high, args))
    while is_open(b):
        force = guess(b)
        b = narrowed(b, force, _cubic_residual(force, args))
    return b[0]


class CubicStiffness(Effect, ids="cubic-stiffness"):
    """Cubic stiffness: a spring that hardens (or softens) away from the position's zero."""

    # Gonzalez, *Time integration and discrete Hamiltonian systems*, J. Nonlinear Science 6 (1996).

    force = cubic_force

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # Sector of k3 q^3 over |q| <= a; its describing function is 3/4 k3 a^2, inside.
        most = values["k3"] * amplitude**2
        return Footprint(site.name, "position", min(0.0, most), max(0.0, most))


@nb.njit(cache=True)
def _push_residual(push, args):  # type: ignore[no-untyped-def]
    """Return the push minus the contact force of the resulting motion."""
    before, free, v_free, gq, gv, h, stiffness, damping = args
    after, v = free - gq * push, v_free - gv * push
    if before <= 0.0 and after <= 0.0:
        return push
    if before >= 0.0 and after >= 0.0:
        spring, share = 0.5 * stiffness * (before + after), 1.0
    else:
        inside = max(before, after)
        share = inside / abs(after - before)
        spring = 0.5 * stiffness * inside * share
    stiff = (0.5 * damping * gv) ** 4
    rate = ((max(after, 0.0) - max(before, 0.0)) / h + stiff * share * v) / (1.0 + stiff)
    return push - max(0.0, spring + damping * rate)


@nb.njit(cache=True)
def _push(before, free, v_free, gq, gv, h, stiffness, damping):  # type: ignore[no-untyped-def]
    if before <= 0.0 and free <= 0.0:
        return 0.0
    fastest = max(v_free, (max(free, 0.0) - max(before, 0.0)) / h, 0.0)
    most = stiffness * max(before, free, 0.0) + damping * fastest
    args = (before, free, v_free, gq, gv, h, stiffness, damping)
    b = bracket(0.0, _push_residual(0.0, args), most, _push_residual(most, args))
    while is_open(b):
        push = guess(b)
        b = narrowed(b, push, _push_residual(push, args))
    return b[0]


@law
def stop_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Return the force for p = (q_min, q_max, k_c, d_c)."""
    h = seen[STEP]
    upper = _push(seen[Q0] - p[1], seen[Q] - p[1], seen[V], seen[GQ], seen[GV], h, p[2], p[3])
    if upper > 0.0:
        return -upper
    return _push(p[0] - seen[Q0], p[0] - seen[Q], -seen[V], seen[GQ], seen[GV], h, p[2], p[3])


class EndStop(Effect, ids="end-stop"):
    """End stops: damped springs beyond the limits of the travel, compression only."""

    force = stop_force

    def priors(self, scales: Scales) -> dict[str, Prior]:
        damping = Prior("log", contact_scales(scales)[1], 2.0)
        return {"q_min": limit_prior(scales, -1), "q_max": limit_prior(scales, 1), "dc": damping}

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        # Soft stops within the record's travel, and hard ones near its extremes.
        lower, upper = travel(scales)
        contacts = contact_starts(scales)[:2]
        return tuple({"q_min": lower + depth, "q_max": upper - depth, "kc": k, "dc": d} for depth, k, d in contacts)

    def visited(self, values: Mapping[str, float], scales: Scales) -> bool:
        lower, upper = scales.lowest, scales.highest
        return lower is None or upper is None or values["q_min"] > lower or values["q_max"] < upper

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # Slope of the force over the position: 0 between the limits, kc beyond them (without damping).
        reached = amplitude > min(abs(values["q_min"]), abs(values["q_max"]))
        return Footprint(site.name, "position", 0.0, values["kc"] if reached else 0.0)


def travel(scales: Scales) -> tuple[float, float]:
    """Return the lowest and highest position of the record; symmetric about zero if unknown."""
    half = 0.5 * scales.position
    if scales.lowest is None or scales.highest is None or not scales.highest > scales.lowest:
        return -half, half
    return scales.lowest, scales.highest


def limit_prior(scales: Scales, side: int) -> Prior:
    """Return the prior of a contact position within the travel: near the upper (1) or lower (-1) end, or any (0)."""
    lower, upper = travel(scales)
    middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    return Prior("between", middle + 0.96 * side * half, 1.5 if side else 2.0, upper, lower)


def contact_scales(scales: Scales) -> tuple[float, float]:
    """Return the stiffness for a deflection of 1 % of the range under the record's force, and 30 % critical damping."""
    stiffness = scales.force / (0.01 * scales.position)
    return stiffness, 2.0 * 0.3 * math.sqrt(stiffness * scales.inertia)


def contact_starts(scales: Scales) -> list[tuple[float, float, float]]:
    """Return initial values of a contact: depth from the end of the travel, stiffness and damping."""
    (lower, upper), (stiffness, damping) = travel(scales), contact_scales(scales)
    shares = ((0.02, 1.0), (0.003, 5.0), (0.3, 0.03))  # of the travel, of the stiffness
    return [(depth * (upper - lower), k * stiffness, math.sqrt(k) * damping) for depth, k in shares]


class OneSidedSpring(Effect, ids="one-sided-spring"):
    """A damped spring beyond one position: a stop on one side, free play before a spring."""

    force = stop_force

    def variants(self, scales: Scales) -> tuple[Scales, ...]:
        return replace(scales, side=1), replace(scales, side=-1)

    def priors(self, scales: Scales) -> dict[str, Prior]:
        stiffness, damping = contact_scales(scales)
        signed = Prior("log", scales.side * stiffness, 2.5) if scales.side else Prior("linear", 0.0, 5.0 * stiffness)
        return {"k": signed, "q0": limit_prior(scales, scales.side), "d": Prior("log", damping, 2.0)}

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        lower, upper = travel(scales)
        return tuple(
            {"k": side * k, "q0": (upper if side > 0 else lower) - side * depth, "d": d}
            for side in ((scales.side,) if scales.side else (1, -1))
            for depth, k, d in contact_starts(scales)
        )

    def arguments(self, values: Mapping[str, float]) -> tuple[float, ...]:
        lower, upper = (-math.inf, values["q0"]) if values["k"] > 0.0 else (values["q0"], math.inf)
        return lower, upper, abs(values["k"]), values["d"]

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint | None:
        # Slope of the force over the position: 0 before q0, |k| beyond (without damping). A spring in contact at
        # position zero has no sector about zero.
        free = values["q0"] if values["k"] > 0.0 else -values["q0"]
        if free < 0.0:
            return None
        return Footprint(site.name, "position", 0.0, abs(values["k"]) if amplitude > free else 0.0)


SHORT = 1e-4  # displacement below which the trapezoid gives its mean, with an error of a twelfth of its square


@nb.njit(cache=True)
def _branch(z, way, rate):  # type: ignore[no-untyped-def]
    """Return the end value and integral of z' = 1 - rate z over a displacement >= 0."""
    x = rate * way
    rise = way if x == 0.0 else -math.expm1(-x) / rate
    end = z + (1.0 - rate * z) * rise
    return end, 0.5 * way * (z + end) if x < SHORT else (way - (end - z)) / rate


@nb.njit(cache=True)
def _hysteresis_stretch(z, way, rho):  # type: ignore[no-untyped-def]
    """Return the end value and mean of z over a displacement in units of q_y, in one direction."""
    sign = 1.0 if way > 0.0 else -1.0
    along, left, area = sign * z, abs(way), 0.0
    if left == 0.0:
        return z, z
    if along < 0.0:  # unloading
        back = min(left, -along if rho == 0.0 else math.log1p(-rho * along) / rho)
        along, area = _branch(along, back, rho)
        left -= back
    if left > 0.0:
        along, more = _branch(along, left, 1.0)
        area += more
    return sign * along, sign * area / abs(way)


@nb.njit(cache=True)
def _hysteresis(force, args):  # type: ignore[no-untyped-def]
    """Return the deflection z at the end of the step under this force, and its mean over the step."""
    v0, v_free, gv, way_free, gq, h, start, width, rho = args
    v1, way = v_free + gv * force, way_free + gq * force
    if v0 * v1 < 0.0:
        share = v0 / (v0 - v1)
        more = way - 0.5 * h * (v0 + v1)  # correction for a nonlinear velocity profile
        turned, mean = _hysteresis_stretch(start, share * (0.5 * h * v0 + more) / width, rho)
        end, after = _hysteresis_stretch(turned, (1.0 - share) * (0.5 * h * v1 + more) / width, rho)
        return end, share * mean + (1.0 - share) * after
    return _hysteresis_stretch(start, way / width, rho)


@nb.njit(cache=True)
def _hysteresis_residual(force, level, args):  # type: ignore[no-untyped-def]
    return force + level * _hysteresis(force, args)[1]


@law
def hysteretic_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Return the force for p = (F_y, q_y, rho)."""
    start = min(max(z[0], -1.0), 1.0)
    args = (seen[V0], seen[V], seen[GV], seen[Q] - seen[Q0], seen[GQ], seen[STEP], start, p[1], p[2])
    b = bracket(-p[0], _hysteresis_residual(-p[0], p[0], args), p[0], _hysteresis_residual(p[0], p[0], args))
    while is_open(b):
        force = guess(b)
        b = narrowed(b, force, _hysteresis_residual(force, p[0], args))
    z_next[0] = _hysteresis(b[0], args)[0]
    return b[0]


class BoucWen(Effect, ids="bouc-wen"):
    """Hysteretic spring: a rate-independent force that lags behind the displacement and yields (Bouc, Wen)."""

    # Wen, *Method for random vibration of hysteretic systems*, J. Engineering Mechanics 102 (1976); Ikhouane, Rodellar,
    # *On the hysteretic Bouc-Wen model*, Nonlinear Dynamics 42 (2005), normalised form.

    force = hysteretic_force
    memory = 1

    def visited(self, values: Mapping[str, float], scales: Scales) -> bool:
        # Without yielding it is a spring; without a position this is unknown.
        return not scales.position_unit or values["qy"] <= scales.position

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # In a steady loop of position amplitude a, z goes from -m to m over the displacement 2 a:
        # log(1 + rho m) / rho - log(1 - m) = 2 a / q_y. The first harmonic is at most 4/pi of F_y m.
        from scipy.optimize import root_scalar

        rho, way = values["rho"], 2.0 * amplitude / values["qy"]

        def excess(m: float) -> float:
            return (math.log1p(rho * m) / rho if rho else m) - math.log1p(-m) - way

        most = 1.0 - 1e-15
        reached = float(root_scalar(excess, bracket=(0.0, most)).root) if excess(most) > 0.0 else 1.0
        gain = 4.0 / math.pi * values["Fy"] * reached / amplitude
        return Footprint(site.name, "position", 0.0, gain, offset=values["Fy"])


DAMPING = 0.2


@nb.njit(cache=True)
def _met(d0, free, gq, spring, damper):  # type: ignore[no-untyped-def]
    """Return the push of a flank reached within the step: from d0 <= 0 to ``free`` > 0 without a push."""
    slope = 1.0 + gq * (spring + damper)
    middle = 0.5 * (free + d0 + gq * damper * d0)
    depth = (middle + math.sqrt(middle * middle - slope * free * d0)) / slope
    return (free - depth) / gq


@nb.njit(cache=True)
def _left(d0, free, gq, spring, damper):  # type: ignore[no-untyped-def]
    """Return the push of a flank that separates within the step from the depth d0 > 0."""
    stored = spring * d0 * d0 - damper * d0 * (d0 - free)
    if stored <= 0.0:  # the flanks separate faster than the spring
        return 0.0
    half = 0.5 * (d0 - free + gq * damper * d0)
    root = math.sqrt(half * half + gq * stored)
    return stored / (half + root) if half > 0.0 else (root - half) / gq


@law
def flank_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Return the force per reduced inertia for p = (half gap, omega^2, 2 zeta omega)."""
    gq, spring, damper = seen[GQ], 0.5 * p[1], p[2] / seen[STEP]
    side = 1.0 if seen[Q0] > 0.0 else -1.0
    d0, free = side * seen[Q0] - p[0], side * seen[Q] - p[0]
    push = 0.0
    if d0 > 0.0:
        push = max((spring * (d0 + free) + damper * (free - d0)) / (1.0 + gq * (spring + damper)), 0.0)
        if free - gq * push < 0.0:
            push = _left(d0, free, gq, spring, damper)
    elif free > 0.0:
        push = _met(d0, free, gq, spring, damper)
    across = -free - 2.0 * p[0]  # depth at the other flank
    if across + gq * push > 0.0:  # the gap is crossed: energy still stored at the first flank is lost
        if across > 0.0:
            return side * _met(-d0 - 2.0 * p[0], across, gq, spring, damper)
        push = -across / gq
    return -side * push


GAPS = tuple(2.0**-k for k in range(4, 10))  # initial values of a gap as shares of the travel
SHARE = 0.35  # default load share of the inertia behind a gap or coupling
FLANK = 120.0  # Hz, of a closed contact with that share


def share_prior(scales: Scales) -> Prior:
    """Return the prior of the load's share of a joint's inertia, centred at the plant's parameters."""
    return Prior("share", float(np.mean(scales.shares)) if scales.shares else SHARE, 0.8)


def flank_frequency(share: float) -> float:
    """Return the usual frequency of a closed contact in Hz, which is higher for a lighter load."""
    return FLANK * math.sqrt(SHARE * (1.0 - SHARE) / (share * (1.0 - share)))


class Backlash(Effect, ids="backlash"):
    """Backlash: contact force at the flanks of the gap between drive and load, compression only."""

    # Nordin, Galic, Gutman, New models for backlash and gear play, Int. J. Adaptive Control and Signal Processing 11
    # (1997) 49-63; Greenspan, Discrete numerical methods in physics and engineering (1974) for the exact balance of
    # energy.

    def priors(self, scales: Scales) -> dict[str, Prior]:
        share = share_prior(scales)
        return {"share": share, "f": Prior("log", flank_frequency(share.value(0.0)), 0.4)}

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        # With a pulling load the flights are short: a fit from half or twice the gap does not converge.
        sizes, shares = (GAPS, scales.shares) if scales.shares else ((2e-4, 2e-3, 2e-2), (SHARE,))
        return tuple(
            {"gap": size * scales.position, "share": s, "f": flank_frequency(s)} for s in shares for size in sizes
        )

    def extend(self, model: PortModel, site: Site, values: Mapping[str, float]) -> PortModel:
        return with_load_side(model, site.name, values["share"], "gap", f"effect {self.id}")

    def laws(self, site: Site, values: Mapping[str, float]) -> tuple[Law, ...]:
        omega = 2.0 * math.pi * values["f"]
        return (Law(flank_force, f"{site.name}.gap", (0.5 * values["gap"], omega**2, 2.0 * DAMPING * omega)),)

    def resting(self, values: Mapping[str, float], pull: Array) -> Array:
        # At the loaded flank, at its static deflection.
        return np.sign(pull) * (0.5 * values["gap"] + np.abs(pull) / (2.0 * math.pi * values["f"]) ** 2)

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # The load's position equals the drive's within half the gap.
        return Footprint(site.name, "position", 1.0, 1.0, offset=0.5 * values["gap"])


class FlexibleCoupling(Effect, ids="flexible-coupling"):
    """Flexible coupling: two inertias with a spring and a damper between them."""

    def priors(self, scales: Scales) -> dict[str, Prior]:
        return {"share": share_prior(scales)}

    def extend(self, model: PortModel, site: Site, values: Mapping[str, float]) -> PortModel:
        wide = with_load_side(model, site.name, values["share"], "twist", f"effect {self.id}")
        omega = 2.0 * math.pi * values["f"]
        twist = wide.ports[f"{site.name}.twist"]
        assert twist.position is not None
        row = -(omega**2) * twist.position - 2.0 * values["zeta"] * omega * twist.velocity
        return wide.with_state_feedback(twist, np.asarray(row))

    def resting(self, values: Mapping[str, float], pull: Array) -> Array:
        return pull / (2.0 * math.pi * values["f"]) ** 2
