r"""Dry friction whose level goes up and down over the position: a bent shaft, an uneven screw or gear.

.. math:: f = -\max(0,\ F_c + P_c \cos kq + P_s \sin kq) \operatorname{sgn} v

The level of a step is its mean over the way of the step, at the way that the force itself brings about.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numba as nb

from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.effects.spatial_wave import order_parameter, orders_or_usual, wave_mean
from robustlab.dynamics.ports.law_kernel import GQ, GV, Q0, V0, Q, V, law
from robustlab.dynamics.ports.step_solutions import (
    CLOSE,
    SECANTS,
    bracket,
    dry_mean_force,
    guess,
    is_open,
    narrowed,
)

__all__ = ["EFFECT", "uneven_force"]


@nb.njit(cache=True)
def _force(level, args):  # type: ignore[no-untyped-def]
    return dry_mean_force(args[0], args[1], args[2], level, 0.0, 1.0)


@nb.njit(cache=True)
def _residual(level, args):  # type: ignore[no-untyped-def]
    """Excess of a level over the one on the way that its friction leaves."""
    _, _, _, q0, q_free, gq, fc, pc, ps, k = args
    return level - max(0.0, fc + wave_mean(q0, q_free + gq * _force(level, args), pc, ps, k))


@law
def uneven_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Parameters p = (F_c, P_c, P_s, k)."""
    args = (seen[V0], seen[V], seen[GV], seen[Q0], seen[Q], seen[GQ], p[0], p[1], p[2], p[3])
    most = max(0.0, p[0]) + abs(p[1]) + abs(p[2])
    # The friction hardly changes the way: a secant from the mean level is there in three or four looks.
    before, r_before = max(0.0, p[0]), _residual(max(0.0, p[0]), args)
    level = before - r_before
    for _ in range(SECANTS):
        r = _residual(level, args)
        if abs(r) <= CLOSE * most:
            return _force(level, args)
        if abs(r) > 0.5 * abs(r_before):
            break
        before, r_before, level = level, r, level - r * (level - before) / (r - r_before)
    b = bracket(0.0, _residual(0.0, args), most, _residual(most, args))
    while is_open(b):
        level = guess(b)
        b = narrowed(b, level, _residual(level, args))
    return _force(b[0], args)


class PositionDependentFriction(Effect):
    """Coulomb friction with a level that is periodic in the position."""

    id = "position-dependent-friction"
    title = "Position-dependent friction"
    equation = "f = -max(0, Fc + Pc cos(k q) + Ps sin(k q)) sgn(v)"
    site_kind = "joint"
    amplitude = ("P", "Pc", "Ps")
    needs_position = True
    force = uneven_force
    refines = "coulomb-friction"
    spatial = True

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        wave = Prior("linear", 0.0, 0.1 * scales.force)
        return (
            EffectParameter("Fc", scales.force_unit, "mean friction level", Prior("log", 0.1 * scales.force, 1.2)),
            EffectParameter("Pc", scales.force_unit, "cosine part of the level", wave),
            EffectParameter("Ps", scales.force_unit, "sine part of the level", wave),
            order_parameter(scales),
        )

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        # Both parts start at zero, where every phase is equally near.
        level = 0.1 * scales.force
        return tuple({"Fc": level, "Pc": 0.0, "Ps": 0.0, "k": k} for k in orders_or_usual(scales))

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # As Coulomb friction of the highest level: 4 F / (pi a) at a sine of the speed amplitude a.
        most = values["Fc"] + math.hypot(values["Pc"], values["Ps"])
        return Footprint(site.name, "speed", 0.0, 4.0 * most / (math.pi * amplitude), offset=most)


EFFECT = PositionDependentFriction()
