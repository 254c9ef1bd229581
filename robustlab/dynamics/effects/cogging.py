r"""Cogging, torque ripple: a force that is periodic in the position and the same both ways.

.. math:: f = A_c \cos kq + A_s \sin kq

Over a step it is the mean over the way of the step, at the way that the force itself brings about; its work is then
exactly the difference of the potential, so that the step neither makes nor loses energy.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numba as nb

from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.effects.spatial_wave import (
    order_parameter,
    orders_or_usual,
    wave_mean,
    wave_mean_and_slope,
)
from robustlab.dynamics.ports.law_kernel import GQ, Q0, Q, law
from robustlab.dynamics.ports.step_solutions import CLOSE, bracket, guess, is_open, narrowed

__all__ = ["EFFECT", "cogging_force"]


LOOKS = 6  # before the root is bracketed


@nb.njit(cache=True)
def _residual(force, args):  # type: ignore[no-untyped-def]
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
    b = bracket(-most, _residual(-most, args), most, _residual(most, args))
    while is_open(b):
        force = guess(b)
        b = narrowed(b, force, _residual(force, args))
    return b[0]


class Cogging(Effect):
    """A conservative force that is periodic in the position."""

    id = "cogging"
    title = "Cogging (force ripple)"
    equation = "f = Ac cos(k q) + As sin(k q)"
    independently = "turn it slowly by hand without power"
    site_kind = "joint"
    amplitude = ("A", "Ac", "As")
    needs_position = True
    force = cogging_force
    spatial = True

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        wave = Prior("linear", 0.0, 0.2 * scales.force)
        return (
            EffectParameter("Ac", scales.force_unit, "cosine part", wave),
            EffectParameter("As", scales.force_unit, "sine part", wave),
            order_parameter(scales),
        )

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        # Both parts start at zero, where every phase is equally near.
        return tuple({"Ac": 0.0, "As": 0.0, "k": k} for k in orders_or_usual(scales))

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # Its slope over the position, a stiffness of either sign, lies within k A; its size within A.
        size = math.hypot(values["Ac"], values["As"])
        return Footprint(site.name, "position", -values["k"] * size, values["k"] * size, offset=size)


EFFECT = Cogging()
