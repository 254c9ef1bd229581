r"""Friction in proportion to the load that a gear passes on, with one share while driven and another while braking.

.. math::
    f = -k\, |T| \operatorname{sgn} v, \qquad k = k_d \text{ where } T v > 0 \text{ (driving)}, \quad
    k_b \text{ where } T v < 0 \text{ (back-driving)}

T is the net force of the step at the joint without this friction, as in `robustlab.dynamics.effects.gear_efficiency`,
which is :math:`k_d = k_b = 1 - \eta`: a worm gear takes more while it is driven from behind. A constant part is Coulomb
friction. What rests on the gear without moving it (a weight held by the motor) is not in T; where loads are held, the
friction of the gear grows by more than this.

Under a constant T a step is known in closed form: on with :math:`(1 - k_d) T`, or slower by :math:`(1 + k_b) |T|` to
a stop, and from there the other way.

References
----------
Duclusaud, Passault, Padois, Ly, *Extended Friction Models for the Physics Simulation of Servo Actuators*,
arXiv 2410.08650 (2024): load-dependent and directional models, there of the torques of motor and load.
"""

from __future__ import annotations

from collections.abc import Mapping

from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.ports.law_kernel import GV, V0, V, law

__all__ = ["EFFECT", "directional_loss"]


@law
def directional_loss(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Mean over the step of p = (k_d, k_b), exact for a constant drive; beyond k_d = 1 nothing sets it in motion."""
    drive = seen[V] - seen[V0]  # T times the compliance
    driven = min(p[0], 1.0)
    if seen[V0] * drive >= 0.0:
        return -driven * drive / seen[GV]
    share = abs(seen[V0]) / ((1.0 + p[1]) * abs(drive))  # of the step until it stops
    if share >= 1.0:
        return p[1] * drive / seen[GV]
    return ((1.0 - share) * (1.0 - driven) * drive - seen[V]) / seen[GV]


class LoadDependentFriction(Effect):
    """Friction of a gear or screw that takes different shares of what drives and of what brakes."""

    id = "load-dependent-friction"
    title = "Load-dependent friction, driven and back-driven"
    equation = "f = -k |T| sgn(v), k = kd while T drives, kb while it brakes; T the net force at the joint"
    independently = "measure the input torque while lifting and while lowering a known load"
    site_kind = "joint"
    force = directional_loss
    refines = "gear-efficiency"

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        return (
            EffectParameter("kd", "", "share lost while driven", Prior("share", 0.15, 1.0)),
            EffectParameter("kb", "", "share lost while back-driven", Prior("log", 0.15, 1.0)),
        )

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # A gain on the driving force between -kd (driving) and kb (braking), at any amplitude.
        most = max(values["kd"], values["kb"])
        return Footprint(site.name, "force", -most, most)


EFFECT = LoadDependentFriction()
