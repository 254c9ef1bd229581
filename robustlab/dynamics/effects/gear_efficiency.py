r"""Gear losses: dry friction in proportion to the force that drives the joint.

.. math:: f = -(1 - \eta)\, |T| \operatorname{sgn} v

T is the net force of the step at the joint without this loss, :math:`T = (v_\mathrm{free} - v_0)/g_v`: what accelerates
the inertia behind the gear. The joint speeds up with :math:`\eta T` and slows down with :math:`(2 - \eta) T`.
"""

from __future__ import annotations

from collections.abc import Mapping

from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.ports.law_kernel import GV, V0, V, law
from robustlab.dynamics.ports.step_solutions import dry_mean_force

__all__ = ["EFFECT", "loss_force"]


@law
def loss_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Parameters p = (1 - eta,)."""
    level = p[0] * abs(seen[V] - seen[V0]) / seen[GV]
    return dry_mean_force(seen[V0], seen[V], seen[GV], level, 0.0, 1.0)


class GearEfficiency(Effect):
    """Friction of a gear or screw in proportion to what it transmits."""

    id = "gear-efficiency"
    title = "Gear efficiency"
    equation = "f = -(1 - eta) |T| sgn(v), T the net force at the joint"
    independently = "measure the input torque at two known loads"
    site_kind = "joint"
    force = loss_force

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        return (EffectParameter("eta", "", "efficiency of the transmission", Prior("share", 0.85, 1.0)),)

    def arguments(self, values: Mapping[str, float]) -> tuple[float, ...]:
        return (1.0 - values["eta"],)

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # A gain on the driving force between -(1 - eta) (driving) and 1 - eta (braking), at any amplitude.
        loss = 1.0 - values["eta"]
        return Footprint(site.name, "force", -loss, loss)


EFFECT = GearEfficiency()
