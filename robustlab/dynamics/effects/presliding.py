r"""Presliding: dry friction whose contact gives way like a spring before it slides.

.. math:: f = -\sigma_0 z, \qquad \dot z = v - \frac{|v|\, z}{g}, \qquad g = \frac{F_c}{\sigma_0}

Over a stretch s in one direction the contact's deflection is exactly :math:`z \to \pm g + (z \mp g) e^{-|s|/g}`, at any
speed (Dahl; LuGre without its damping). The step is one such stretch, or two where the velocity turns. The force
is the mean over the way, whose work is exactly what the contact stores and dissipates. A contact that is stiffer than
the step can follow would ring: there the force is the one at the end of the step, with which it comes to rest; only of
a first stretch that is followed by sliding the other way its mean counts for its share of the step. With
:math:`c = \sigma_0 g_v h / 2`, half the square of the contact's frequency in steps, the force is
:math:`(f_\mathrm{mean} + c^4 f_\mathrm{end}) / (1 + c^4)`.

References
----------
Dahl, *A solid friction model* (1968); Canudas de Wit, Olsson, Astrom, Lischinsky, *A new model for control of systems
with friction*, IEEE Trans. Automatic Control 40 (1995).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numba as nb

from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.ports.law_kernel import GV, STEP, V0, V, law
from robustlab.dynamics.ports.step_solutions import bracket, guess, is_open, narrowed

__all__ = ["EFFECT", "presliding_force"]


@nb.njit(cache=True)
def _stretch(deflection, way, limit):  # type: ignore[no-untyped-def]
    """Deflection after the contact has moved by ``way``, and its mean over that way; ``limit`` is g."""
    x = abs(way) / limit
    end = math.copysign(limit, way)
    left = math.exp(-x)
    mean = 1.0 - 0.5 * x if x < 1e-8 else -math.expm1(-x) / x
    return end + (deflection - end) * left, end + (deflection - end) * mean


@nb.njit(cache=True)
def _contact(force, args):  # type: ignore[no-untyped-def]
    """Deflection at the end of the step under this force, and the deflection whose force acts over the step."""
    v0, v_free, compliance, h, start, limit, stiffness = args
    v1 = v_free + compliance * force
    stiff = (0.5 * compliance * h * stiffness) ** 4
    if v0 * v1 < 0.0:
        share = v0 / (v0 - v1)
        turned, mean = _stretch(start, 0.5 * share * h * v0, limit)
        end, back = _stretch(turned, 0.5 * (1.0 - share) * h * v1, limit)
        acting = end
        if abs(v_free - v0) > compliance * stiffness * limit:  # what drives it cannot be held: it slides back
            acting = share * mean + (1.0 - share) * end
        return end, (share * mean + (1.0 - share) * back + stiff * acting) / (1.0 + stiff)
    end, mean = _stretch(start, 0.5 * h * (v0 + v1), limit)
    return end, (mean + stiff * end) / (1.0 + stiff)


@nb.njit(cache=True)
def _residual(force, args):  # type: ignore[no-untyped-def]
    return force + args[6] * _contact(force, args)[1]


@law
def presliding_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Parameters p = (F_c, sigma_0); the residual rises with the force at a slope of at least one."""
    limit = p[0] / p[1]
    start = min(max(z[0], -limit), limit)
    args = (seen[V0], seen[V], seen[GV], seen[STEP], start, limit, p[1])
    b = bracket(-p[0], _residual(-p[0], args), p[0], _residual(p[0], args))
    while is_open(b):
        force = guess(b)
        b = narrowed(b, force, _residual(force, args))
    force = b[0]
    z_next[0] = _contact(force, args)[0]
    return force


class Presliding(Effect):
    """Dry friction with an elastic contact (Dahl)."""

    id = "presliding"
    title = "Presliding (elastic dry friction)"
    equation = "f = -sigma0 z, z' = v - |v| z sigma0 / Fc"
    site_kind = "joint"
    force = presliding_force
    memory = 1
    refines = "coulomb-friction"

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        unit = f"{scales.force_unit}/{scales.speed_unit.removesuffix('/s')}" if scales.force_unit else ""
        stiffness = 0.1 * scales.force / (1e-3 * scales.position)
        return (
            EffectParameter("Fc", scales.force_unit, "friction level", Prior("log", 0.1 * scales.force, 1.2)),
            EffectParameter("sigma0", unit, "stiffness of the contact", Prior("log", stiffness, 2.5)),
        )

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        level = 0.1 * scales.force
        return tuple({"Fc": level, "sigma0": level / (g * scales.position)} for g in (1e-4, 1e-3, 1e-2))

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # In a steady loop of the position amplitude a the force stays within Fc tanh(sigma0 a / Fc); its first harmonic
        # is at most 4/pi of that.
        level = values["Fc"]
        gain = 4.0 / math.pi * level * math.tanh(values["sigma0"] * amplitude / level) / amplitude
        return Footprint(site.name, "position", 0.0, gain, offset=level)


EFFECT = Presliding()
