r"""Constant load: gravity along the axis, a preload, or an offset.

.. math:: f = -T_0
"""

from __future__ import annotations

from collections.abc import Mapping

from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.ports.law_kernel import law

__all__ = ["EFFECT", "load_force"]


@law
def load_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Parameters p = (T_0,)."""
    return -p[0]


class ConstantLoad(Effect):
    """A load that acts in one direction, at rest as in motion."""

    id = "constant-load"
    title = "Constant load"
    equation = "f = -T0"
    independently = "turn the machine on its side or take the weight off"
    site_kind = "joint"
    force = load_force

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        prior = Prior("linear", 0.0, 0.3 * scales.force)
        return (EffectParameter("T0", scales.force_unit, "load against the positive direction", prior),)

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        """On either side: beside dry friction, which a load holds at rest, no load may be the bottom of a valley."""
        return tuple({"T0": side * 0.15 * scales.force} for side in (1.0, -1.0))

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, "speed", 0.0, 0.0, offset=abs(values["T0"]))


EFFECT = ConstantLoad()
