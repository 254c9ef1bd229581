r"""Hysteretic spring: a force that lags behind the displacement and yields, at any speed (Bouc, Wen).

.. math::
    f = -F_y z, \qquad q_y \dot z = v - b\, |v|\, z - (1 - b)\, v\, |z|, \qquad \rho = 2 b - 1

that is :math:`q_y \dot z = v (1 - |z|)` while z grows in size, and :math:`v (1 + \rho |z|)` while it falls: the
spring is stiffer by :math:`1 + \rho |z|` on its way back. With :math:`\rho = 0` it comes back along a straight line of
the stiffness :math:`F_y / q_y`, with :math:`\rho = 1` it is Dahl's friction
(`robustlab.dynamics.effects.presliding`); no :math:`\rho \ge 0` gives back more than it took. The exponent n is 1.

Over a stretch in one direction z is exactly known (two exponentials of the way), and so is its mean over it. The force
of a step is that mean; where the velocity turns within the step there are two stretches, for which it is taken to run
linearly.

References
----------
Wen, *Method for random vibration of hysteretic systems*, J. Engineering Mechanics 102 (1976); Ikhouane, Rodellar,
*On the hysteretic Bouc-Wen model*, Nonlinear Dynamics 42 (2005), normalised form.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numba as nb

from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.ports.law_kernel import GQ, GV, Q0, STEP, V0, Q, V, law
from robustlab.dynamics.ports.step_solutions import bracket, guess, is_open, narrowed

__all__ = ["EFFECT", "hysteretic_force"]

SHORT = 1e-4  # of a way: below, its mean by the trapezoid, which is off by a twelfth of its square


@nb.njit(cache=True)
def _branch(z, way, rate):  # type: ignore[no-untyped-def]
    """End and integral of z' = 1 - rate z over a way >= 0."""
    x = rate * way
    rise = way if x == 0.0 else -math.expm1(-x) / rate
    end = z + (1.0 - rate * z) * rise
    return end, 0.5 * way * (z + end) if x < SHORT else (way - (end - z)) / rate


@nb.njit(cache=True)
def _stretch(z, way, rho):  # type: ignore[no-untyped-def]
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
        turned, mean = _stretch(start, share * (0.5 * h * v0 + more) / width, rho)
        end, after = _stretch(turned, (1.0 - share) * (0.5 * h * v1 + more) / width, rho)
        return end, share * mean + (1.0 - share) * after
    return _stretch(start, way / width, rho)


@nb.njit(cache=True)
def _residual(force, level, args):  # type: ignore[no-untyped-def]
    return force + level * _hysteresis(force, args)[1]


@law
def hysteretic_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Parameters p = (F_y, q_y, rho)."""
    start = min(max(z[0], -1.0), 1.0)
    args = (seen[V0], seen[V], seen[GV], seen[Q] - seen[Q0], seen[GQ], seen[STEP], start, p[1], p[2])
    b = bracket(-p[0], _residual(-p[0], p[0], args), p[0], _residual(p[0], p[0], args))
    while is_open(b):
        force = guess(b)
        b = narrowed(b, force, _residual(force, p[0], args))
    z_next[0] = _hysteresis(b[0], args)[0]
    return b[0]


class BoucWen(Effect):
    """A spring to ground that yields and remembers."""

    id = "bouc-wen"
    title = "Hysteretic spring"
    equation = "f = -Fy z, qy z' = v (1 - |z|) while |z| grows, v (1 + rho |z|) while it falls"
    independently = "push slowly forth and back with known forces and read the displacement"
    site_kind = "joint"
    needs_position = True
    force = hysteretic_force
    memory = 1
    long_memory = True  # the way over which it forgets may be longer than that of a window

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        return (
            EffectParameter("Fy", scales.force_unit, "force at which it yields", Prior("log", 0.2 * scales.force, 1.2)),
            EffectParameter(
                "qy", scales.position_unit, "displacement to yield", Prior("log", 0.1 * scales.position, 1.2)
            ),
            EffectParameter("rho", "", "stiffening on the way back; 1: Dahl's friction", Prior("log", 0.3, 1.0)),
        )

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        return tuple({"Fy": 0.2 * scales.force, "qy": part * scales.position, "rho": 0.3} for part in (0.02, 0.1, 0.4))

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


EFFECT = BoucWen()
