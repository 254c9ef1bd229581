r"""A spring with a damper that a joint meets beyond one position: a stop on one side, free play before a spring.

.. math::
    f = -\max(0,\ |k| (q - q_0) + d v) \quad (q > q_0,\ k > 0), \qquad
    f = \max(0,\ |k| (q_0 - q) - d v) \quad (q < q_0,\ k < 0)

and nothing on the other side of :math:`q_0`. It pushes and never pulls: the contact and its step are those of
`robustlab.dynamics.effects.end_stop`, with the other stop out of reach.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.effects.end_stop import contact_scales, limit_prior, stop_force, travel

__all__ = ["EFFECT"]

# Where a spring is looked for (share of the travel from its end), and its stiffness in `contact_scales`.
STARTS = ((0.02, 1.0), (0.003, 5.0), (0.3, 0.03))


class OneSidedSpring(Effect):
    """Elastic and damped contact beyond one position."""

    id = "one-sided-spring"
    title = "Spring or stop on one side"
    equation = "f = -max(0, k (q - q0) + d v) above q0; with k < 0 the same below it"
    independently = "move it slowly by hand to both of its ends"
    site_kind = "joint"
    needs_position = True
    force = stop_force

    def variants(self, scales: Scales) -> tuple[Scales, ...]:
        return replace(scales, side=1), replace(scales, side=-1)

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        stiffness, damping = contact_scales(scales)
        per_position = f"{scales.force_unit}/{scales.position_unit}" if scales.position_unit else ""
        per_speed = f"{scales.force_unit} s/{scales.position_unit}" if scales.position_unit else ""
        signed = Prior("log", scales.side * stiffness, 2.5) if scales.side else Prior("linear", 0.0, 5.0 * stiffness)
        return (
            EffectParameter("k", per_position, "stiffness; negative: of a spring below q0", signed),
            EffectParameter("q0", scales.position_unit, "where the contact begins", limit_prior(scales, scales.side)),
            EffectParameter("d", per_speed, "damping of the contact", Prior("log", damping, 2.0)),
        )

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        stiffness, damping = contact_scales(scales)
        lower, upper = travel(scales)
        ends = {1: upper, -1: lower}
        return tuple(
            {
                "k": side * harder * stiffness,
                "q0": ends[side] - side * depth * (upper - lower),
                "d": math.sqrt(harder) * damping,
            }
            for side in ((scales.side,) if scales.side else (1, -1))
            for depth, harder in STARTS
        )

    def arguments(self, values: Mapping[str, float]) -> tuple[float, ...]:
        lower, upper = (-math.inf, values["q0"]) if values["k"] > 0.0 else (values["q0"], math.inf)
        return lower, upper, abs(values["k"]), values["d"]

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint | None:
        # Slope of the force over the position: 0 before q0, |k| beyond (the damping is left out). Of a spring that is
        # pressed at the position's zero no sector about that zero stands for it.
        free = values["q0"] if values["k"] > 0.0 else -values["q0"]
        if free < 0.0:
            return None
        return Footprint(site.name, "position", 0.0, abs(values["k"]) if amplitude > free else 0.0)


EFFECT = OneSidedSpring()
