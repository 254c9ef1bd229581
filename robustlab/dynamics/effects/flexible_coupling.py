r"""Flexible coupling: the joint's inertia is two, with a spring and a damper between them.

.. math::
    F = -k \delta - c \dot\delta, \qquad k = \omega^2 m, \quad c = 2 \zeta \omega m, \quad
    \omega = 2 \pi f, \quad m = s (1 - s) J

f is the natural frequency of the two inertias against each other with nothing else attached
(`robustlab.dynamics.ports.port_model`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from robustlab.dynamics.effects.contract import Effect, EffectParameter, Prior, Scales, Site
from robustlab.dynamics.ports.port_model import PortModel, with_load_side

__all__ = ["EFFECT"]

HIGHEST = 200.0  # Hz
LOWEST = 10.0


class FlexibleCoupling(Effect):
    """Spring and damper between the drive, which is measured, and its load."""

    id = "flexible-coupling"
    title = "Flexible coupling"
    equation = "F = -w^2 m delta - 2 zeta w m delta', w = 2 pi f, m = share (1 - share) J"
    independently = "hold the motor and twist the output with a known torque"
    site_kind = "joint"
    structural = True

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        middle = math.sqrt(LOWEST * HIGHEST)
        return (
            EffectParameter("f", "Hz", "frequency of the drive against the load", Prior("log", middle, 0.9)),
            EffectParameter("zeta", "", "damping ratio of that mode", Prior("log", 0.03, 0.8)),
            EffectParameter("share", "", "load's share of the inertia", Prior("share", 0.35, 0.8)),
        )

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        return tuple({"f": f, "zeta": 0.03, "share": 0.35} for f in (18.0, 45.0, 110.0))

    def extend(self, model: PortModel, site: Site, values: Mapping[str, float]) -> PortModel:
        wide = with_load_side(model, site.name, values["share"], "twist", f"effect {self.id}")
        omega = 2.0 * math.pi * values["f"]
        twist = wide.ports[f"{site.name}.twist"]
        assert twist.position is not None
        row = -(omega**2) * twist.position - 2.0 * values["zeta"] * omega * twist.velocity
        return wide.with_state_feedback(twist, np.asarray(row))


EFFECT = FlexibleCoupling()
