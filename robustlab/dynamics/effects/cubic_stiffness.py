r"""Cubic stiffness: a spring that hardens (or softens) away from the position's zero.

.. math:: f = -k_3\, q^3

Over a step from :math:`q_0` to :math:`q_1` the force is
:math:`-\tfrac{k_3}{4}(q_1^3 + q_1^2 q_0 + q_1 q_0^2 + q_0^3)`, whose work is exactly the difference of the potential
:math:`k_3 q^4 / 4` (a discrete gradient): the step neither makes nor loses energy.

References
----------
Gonzalez, *Time integration and discrete Hamiltonian systems*, J. Nonlinear Science 6 (1996).
"""

from __future__ import annotations

from collections.abc import Mapping

import numba as nb

from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.ports.law_kernel import GQ, Q0, Q, law
from robustlab.dynamics.ports.step_solutions import bracket, guess, is_open, narrowed

__all__ = ["EFFECT", "cubic_force"]


@nb.njit(cache=True)
def _residual(force, args):  # type: ignore[no-untyped-def]
    q0, q_free, gq, k3 = args
    q1 = q_free + gq * force
    return force + 0.25 * k3 * (q1 + q0) * (q1 * q1 + q0 * q0)


@law
def cubic_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Parameters p = (k_3,); hardening, the residual has a slope of at least one: -residual(0) bounds the root, and so
    does the force that takes the mass to the mirror image of its start, where the spring has done no work.

    A softening spring goes beyond that bound; twice the bound holds it as long as the step resolves the motion.
    """
    args = (seen[Q0], seen[Q], seen[GQ], p[0])
    bound = -_residual(0.0, args)
    if p[0] < 0.0:
        bound *= 2.0
    elif abs(seen[Q] + seen[Q0]) < seen[GQ] * abs(bound):
        bound = -(seen[Q] + seen[Q0]) / seen[GQ]
    low, high = min(bound, 0.0), max(bound, 0.0)
    b = bracket(low, _residual(low, args), high, _residual(high, args))
    while is_open(b):
        force = guess(b)
        b = narrowed(b, force, _residual(force, args))
    return b[0]


class CubicStiffness(Effect):
    """A spring whose force goes with the cube of the position."""

    id = "cubic-stiffness"
    title = "Cubic stiffness"
    equation = "f = -k3 q^3"
    independently = "push with known forces and read the displacement"
    site_kind = "joint"
    needs_position = True
    force = cubic_force

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        unit = f"{scales.force_unit}/{scales.position_unit}3" if scales.position_unit else ""
        prior = Prior("linear", 0.0, scales.force / (0.5 * scales.position) ** 3)
        return (EffectParameter("k3", unit, "cubic stiffness; negative: softening", prior),)

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # Sector of k3 q^3 over |q| <= a; its describing function is 3/4 k3 a^2, inside.
        most = values["k3"] * amplitude**2
        return Footprint(site.name, "position", min(0.0, most), max(0.0, most))


EFFECT = CubicStiffness()
