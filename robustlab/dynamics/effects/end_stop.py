r"""End stops: springs with damping beyond the limits of the travel, which push and never pull.

For the upper stop, with the depth :math:`\delta = q - q_\max`,

.. math:: f = -\max(0,\ k_c\, \delta + d_c\, v) \quad (\delta > 0), \qquad f = 0 \quad (\delta \le 0)

and its mirror image at the lower one. Both limits lie within the travel that a record reaches: one that no motion
presses on is no parameter of it (`robustlab.dynamics.effects.one_sided_spring` has a stop on one side).

Over a step the spring's force is the one whose work is exactly the difference of its potential
:math:`k_c \max(\delta, 0)^2 / 2`, so that an undamped stop returns what it took even where a step is too long to see
the contact; the damping acts at the change of the depth over the step. A damper that stops the motion within less than
a step would ring: there it acts at the end velocity for the share of the way in contact, the two weighted by 1 and
:math:`(d_c g_v / 2)^4`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numba as nb

from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.ports.law_kernel import GQ, GV, Q0, STEP, Q, V, law
from robustlab.dynamics.ports.step_solutions import bracket, guess, is_open, narrowed

__all__ = ["EFFECT", "contact_scales", "limit_prior", "stop_force", "travel"]


@nb.njit(cache=True)
def _residual(push, args):  # type: ignore[no-untyped-def]
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
    b = bracket(0.0, _residual(0.0, args), most, _residual(most, args))
    while is_open(b):
        push = guess(b)
        b = narrowed(b, push, _residual(push, args))
    return b[0]


@law
def stop_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Parameters p = (q_min, q_max, k_c, d_c)."""
    h = seen[STEP]
    upper = _push(seen[Q0] - p[1], seen[Q] - p[1], seen[V], seen[GQ], seen[GV], h, p[2], p[3])
    if upper > 0.0:
        return -upper
    return _push(p[0] - seen[Q0], p[0] - seen[Q], -seen[V], seen[GQ], seen[GV], h, p[2], p[3])


class EndStop(Effect):
    """Limits of the travel, with an elastic and damped contact."""

    id = "end-stop"
    title = "End stop"
    equation = "f = -max(0, kc (q - q_max) + dc v) beyond q_max, mirrored below q_min"
    independently = "move it slowly by hand to its ends"
    site_kind = "joint"
    needs_position = True
    force = stop_force

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        stiffness, damping = contact_scales(scales)
        per_position = f"{scales.force_unit}/{scales.position_unit}" if scales.position_unit else ""
        per_speed = f"{scales.force_unit} s/{scales.position_unit}" if scales.position_unit else ""
        return (
            EffectParameter("q_min", scales.position_unit, "lower limit", limit_prior(scales, -1)),
            EffectParameter("q_max", scales.position_unit, "upper limit", limit_prior(scales, 1)),
            EffectParameter("kc", per_position, "stiffness of the contact", Prior("log", stiffness, 2.5)),
            EffectParameter("dc", per_speed, "damping of the contact", Prior("log", damping, 2.0)),
        )

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


EFFECT = EndStop()
