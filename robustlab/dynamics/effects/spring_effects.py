"""Effects that are springs, stops and couplings at a joint."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numba as nb
import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Effect, Footprint, Law, Prior, Scales, Site
from robustlab.dynamics.ports.law_kernel import GQ, GV, Q0, STEP, V0, Q, V, bracket, guess, is_open, law, narrowed
from robustlab.dynamics.ports.port_model import PortModel
from robustlab.dynamics.ports.split_joint import with_load_side


@nb.njit(cache=True)
def _cubic_residual(force, args):  # type: ignore[no-untyped-def]
    q0, q_free, gq, k3 = args
    q1 = q_free + gq * force
    return force + 0.25 * k3 * (q1 + q0) * (q1 * q1 + q0 * q0)


@law
def cubic_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Parameters p = (k_3,); hardening, the residual has a slope of at least one: -residual(0) bounds the root, and so
    does the force that takes the mass to the mirror image of its start, where the spring has done no work.
    """
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


class CubicStiffness(Effect, row="cubic-stiffness"):
    """Cubic stiffness: a spring that hardens (or softens) away from the position's zero."""

    # Gonzalez, *Time integration and discrete Hamiltonian systems*, J. Nonlinear Science 6 (1996).

    force = cubic_force

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # Sector of k3 q^3 over |q| <= a; its describing function is 3/4 k3 a^2, inside.
        most = values["k3"] * amplitude**2
        return Footprint(site.name, "position", min(0.0, most), max(0.0, most))


@nb.njit(cache=True)
def _push_residual(push, args):  # type: ignore[no-untyped-def]
    """Excess of a push over the one of the contact that it leaves."""
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
    """Parameters p = (q_min, q_max, k_c, d_c)."""
    h = seen[STEP]
    upper = _push(seen[Q0] - p[1], seen[Q] - p[1], seen[V], seen[GQ], seen[GV], h, p[2], p[3])
    if upper > 0.0:
        return -upper
    return _push(p[0] - seen[Q0], p[0] - seen[Q], -seen[V], seen[GQ], seen[GV], h, p[2], p[3])


class EndStop(Effect, row="end-stop"):
    """End stops: springs with damping beyond the limits of the travel, which push and never pull."""

    force = stop_force

    def priors(self, scales: Scales) -> dict[str, Prior]:
        damping = Prior("log", contact_scales(scales)[1], 2.0)
        return {"q_min": limit_prior(scales, -1), "q_max": limit_prior(scales, 1), "dc": damping}

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        # Soft stops that the record presses in, and hard ones near its extremes.
        lower, upper = travel(scales)
        stiffness, damping = contact_scales(scales)
        return tuple(
            {
                "q_min": lower + depth * (upper - lower),
                "q_max": upper - depth * (upper - lower),
                "kc": harder * stiffness,
                "dc": math.sqrt(harder) * damping,
            }
            for depth, harder in ((0.02, 1.0), (0.003, 5.0))
        )

    def visited(self, values: Mapping[str, float], scales: Scales) -> bool:
        if scales.lowest is None or scales.highest is None:
            return True
        return values["q_min"] > scales.lowest or values["q_max"] < scales.highest

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # Slope of the force over the position: 0 between the limits, kc beyond them (the damping is left out).
        reached = amplitude > min(abs(values["q_min"]), abs(values["q_max"]))
        return Footprint(site.name, "position", 0.0, values["kc"] if reached else 0.0)


def travel(scales: Scales) -> tuple[float, float]:
    """Lowest and highest position of the record; around zero where not known."""
    half = 0.5 * scales.position
    if scales.lowest is None or scales.highest is None or not scales.highest > scales.lowest:
        return -half, half
    return scales.lowest, scales.highest


def limit_prior(scales: Scales, side: int) -> Prior:
    """Prior of where a contact begins, within the travel: near its upper (1) or lower (-1) end, or anywhere (0)."""
    lower, upper = travel(scales)
    middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    return Prior("between", middle + 0.96 * side * half, 1.5 if side else 2.0, upper, lower)


def contact_scales(scales: Scales) -> tuple[float, float]:
    """Stiffness that gives by 1 % of the range under the record's force, and three tenths of its critical damping."""
    stiffness = scales.force / (0.01 * scales.position)
    return stiffness, 2.0 * 0.3 * math.sqrt(stiffness * scales.inertia)


# Where a spring is looked for (share of the travel from its end), and its stiffness in `contact_scales`.
STARTS = ((0.02, 1.0), (0.003, 5.0), (0.3, 0.03))


class OneSidedSpring(Effect, row="one-sided-spring"):
    """A spring with a damper that a joint meets beyond one position: a stop on one side, free play before a spring."""

    force = stop_force

    def variants(self, scales: Scales) -> tuple[Scales, ...]:
        return replace(scales, side=1), replace(scales, side=-1)

    def priors(self, scales: Scales) -> dict[str, Prior]:
        stiffness, damping = contact_scales(scales)
        signed = Prior("log", scales.side * stiffness, 2.5) if scales.side else Prior("linear", 0.0, 5.0 * stiffness)
        return {"k": signed, "q0": limit_prior(scales, scales.side), "d": Prior("log", damping, 2.0)}

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        stiffness, damping = contact_scales(scales)
        lower, upper = travel(scales)
        ends = {1: upper, -1: lower}
        return tuple(
            {
                "k": side * harder * stiffness,
                "q0": ends[side] - side * depth * (upper - lower),
                "d": math.sqrt(harder) * damping,
            }
            for side in ((scales.side,) if scales.side else (1, -1))
            for depth, harder in STARTS
        )

    def arguments(self, values: Mapping[str, float]) -> tuple[float, ...]:
        lower, upper = (-math.inf, values["q0"]) if values["k"] > 0.0 else (values["q0"], math.inf)
        return lower, upper, abs(values["k"]), values["d"]

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint | None:
        # Slope of the force over the position: 0 before q0, |k| beyond (the damping is left out). Of a spring that is
        # pressed at the position's zero no sector about that zero stands for it.
        free = values["q0"] if values["k"] > 0.0 else -values["q0"]
        if free < 0.0:
            return None
        return Footprint(site.name, "position", 0.0, abs(values["k"]) if amplitude > free else 0.0)


SHORT = 1e-4  # of a way: below, its mean by the trapezoid, which is off by a twelfth of its square


@nb.njit(cache=True)
def _branch(z, way, rate):  # type: ignore[no-untyped-def]
    """End and integral of z' = 1 - rate z over a way >= 0."""
    x = rate * way
    rise = way if x == 0.0 else -math.expm1(-x) / rate
    end = z + (1.0 - rate * z) * rise
    return end, 0.5 * way * (z + end) if x < SHORT else (way - (end - z)) / rate


@nb.njit(cache=True)
def _hysteresis_stretch(z, way, rho):  # type: ignore[no-untyped-def]
    """End and mean of z over a way in units of q_y, in one direction."""
    sign = 1.0 if way > 0.0 else -1.0
    along, left, area = sign * z, abs(way), 0.0
    if left == 0.0:
        return z, z
    if along < 0.0:  # on its way back to zero
        back = min(left, -along if rho == 0.0 else math.log1p(-rho * along) / rho)
        along, area = _branch(along, back, rho)
        left -= back
    if left > 0.0:
        along, more = _branch(along, left, 1.0)
        area += more
    return sign * along, sign * area / abs(way)


@nb.njit(cache=True)
def _hysteresis(force, args):  # type: ignore[no-untyped-def]
    """Deflection z at the end of the step under this force, and its mean over the step."""
    v0, v_free, gv, way_free, gq, h, start, width, rho = args
    v1, way = v_free + gv * force, way_free + gq * force
    if v0 * v1 < 0.0:
        share = v0 / (v0 - v1)
        more = way - 0.5 * h * (v0 + v1)  # where the velocity did not run linearly
        turned, mean = _hysteresis_stretch(start, share * (0.5 * h * v0 + more) / width, rho)
        end, after = _hysteresis_stretch(turned, (1.0 - share) * (0.5 * h * v1 + more) / width, rho)
        return end, share * mean + (1.0 - share) * after
    return _hysteresis_stretch(start, way / width, rho)


@nb.njit(cache=True)
def _hysteresis_residual(force, level, args):  # type: ignore[no-untyped-def]
    return force + level * _hysteresis(force, args)[1]


@law
def hysteretic_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Parameters p = (F_y, q_y, rho)."""
    start = min(max(z[0], -1.0), 1.0)
    args = (seen[V0], seen[V], seen[GV], seen[Q] - seen[Q0], seen[GQ], seen[STEP], start, p[1], p[2])
    b = bracket(-p[0], _hysteresis_residual(-p[0], p[0], args), p[0], _hysteresis_residual(p[0], p[0], args))
    while is_open(b):
        force = guess(b)
        b = narrowed(b, force, _hysteresis_residual(force, p[0], args))
    z_next[0] = _hysteresis(b[0], args)[0]
    return b[0]


class BoucWen(Effect, row="bouc-wen"):
    """Hysteretic spring: a force that lags behind the displacement and yields, at any speed (Bouc, Wen)."""

    # Wen, *Method for random vibration of hysteretic systems*, J. Engineering Mechanics 102 (1976); Ikhouane, Rodellar,
    # *On the hysteretic Bouc-Wen model*, Nonlinear Dynamics 42 (2005), normalised form.

    force = hysteretic_force
    memory = 1

    def visited(self, values: Mapping[str, float], scales: Scales) -> bool:
        # What never yields is a spring; where no position is known, neither is whether it did.
        return not scales.position_unit or values["qy"] <= scales.position

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # In a steady loop of the position amplitude a, z goes from -m to m over the way 2 a:
        # log(1 + rho m) / rho - log(1 - m) = 2 a / q_y. The first harmonic is at most 4/pi of F_y m.
        from scipy.optimize import root_scalar

        rho, way = values["rho"], 2.0 * amplitude / values["qy"]

        def excess(m: float) -> float:
            return (math.log1p(rho * m) / rho if rho else m) - math.log1p(-m) - way

        most = 1.0 - 1e-15
        reached = float(root_scalar(excess, bracket=(0.0, most)).root) if excess(most) > 0.0 else 1.0
        return Footprint(
            site.name, "position", 0.0, 4.0 / math.pi * values["Fy"] * reached / amplitude, offset=values["Fy"]
        )


DAMPING = 0.2


@nb.njit(cache=True)
def _met(d0, free, gq, spring, damper):  # type: ignore[no-untyped-def]
    """Push of a flank that is met within the step: from d0 <= 0 before it to ``free`` > 0 behind it without a push."""
    slope = 1.0 + gq * (spring + damper)
    middle = 0.5 * (free + d0 + gq * damper * d0)
    depth = (middle + math.sqrt(middle * middle - slope * free * d0)) / slope
    return (free - depth) / gq


@nb.njit(cache=True)
def _left(d0, free, gq, spring, damper):  # type: ignore[no-untyped-def]
    """Push of a flank that is left within the step: from the depth d0 > 0."""
    stored = spring * d0 * d0 - damper * d0 * (d0 - free)
    if stored <= 0.0:  # the flanks part faster than the spring follows
        return 0.0
    half = 0.5 * (d0 - free + gq * damper * d0)
    root = math.sqrt(half * half + gq * stored)
    return stored / (half + root) if half > 0.0 else (root - half) / gq


@law
def flank_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Force per reduced inertia; p = (half gap, omega^2, 2 zeta omega)."""
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
    across = -free - 2.0 * p[0]  # the same from the other flank
    if across + gq * push > 0.0:  # it has crossed the gap: what the one flank stored and has not given back is lost
        if across > 0.0:
            return side * _met(-d0 - 2.0 * p[0], across, gq, spring, damper)
        push = -across / gq
    return -side * push


GAPS = tuple(2.0**-k for k in range(4, 10))  # shares of the travel from which a gap is looked for
SHARE = 0.35  # of the inertia behind a gap or coupling, where nothing tells it
FLANK = 120.0  # Hz, of a closed contact with that share


def share_prior(scales: Scales) -> Prior:
    """Prior of the load's share of a joint's inertia: about what the plant's parameters tell."""
    return Prior("share", float(np.mean(scales.shares)) if scales.shares else SHARE, 0.8)


def flank_frequency(share: float) -> float:
    """Usual frequency of a closed contact in Hz: on one flank a lighter load swings faster."""
    return FLANK * math.sqrt(SHARE * (1.0 - SHARE) / (share * (1.0 - share)))


class Backlash(Effect, row="backlash"):
    """Backlash: a gap between the drive and its load, who push each other at its flanks and never pull."""

    # Nordin, Galic, Gutman, New models for backlash and gear play, Int. J. Adaptive Control and Signal Processing 11
    # (1997) 49-63; Greenspan, Discrete numerical methods in physics and engineering (1974) for the exact balance of
    # energy.

    def priors(self, scales: Scales) -> dict[str, Prior]:
        share = share_prior(scales)
        return {"share": share, "f": Prior("log", flank_frequency(share.value(0.0)), 0.4)}

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        # Of a load that pulls the flights are short, and told by when they end: from half or twice the gap none is
        # found.
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
        # At the flank to which the two are pressed, as deep as that takes.
        return np.sign(pull) * (0.5 * values["gap"] + np.abs(pull) / (2.0 * math.pi * values["f"]) ** 2)

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # The load's position follows the drive's within half the gap.
        return Footprint(site.name, "position", 1.0, 1.0, offset=0.5 * values["gap"])


class FlexibleCoupling(Effect, row="flexible-coupling"):
    """Flexible coupling: the joint's inertia is two, with a spring and a damper between them."""

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
