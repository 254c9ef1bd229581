r"""A winding that warms up: a resistance that grows during the run.

.. math:: f = -\Delta R_\infty \left(1 - e^{-t/T}\right) i

t is the time since the beginning of the run; f is a voltage. :math:`\Delta R_\infty` is in ohm, as a law knows its own
parameters only: 0.39 % of the winding's resistance per K of final temperature rise (copper). A record much shorter than
T shows the ratio :math:`\Delta R_\infty / T` alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from robustlab.dynamics.effects.effect_contract import Effect, EffectParameter, Footprint, Law, Prior, Scales, Site
from robustlab.dynamics.effects.law_kernel import GV, STEP, TIME, V0, V, law

__all__ = ["EFFECT", "heating_drop"]


@law
def heating_drop(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Drop of p = (dR_inf, T) at the middle of the step: mean current times resistance there."""
    resistance = -p[0] * math.expm1(-(seen[TIME] + 0.5 * seen[STEP]) / p[1])
    return -resistance * 0.5 * (seen[V0] + seen[V]) / (1.0 + 0.5 * seen[GV] * resistance)


class ResistanceHeating(Effect):
    """Resistance that grows with the temperature of the winding."""

    id = "resistance-heating"
    title = "Heating of the winding"
    equation = "f = -dR_inf (1 - exp(-t/T)) i, t since the beginning of the run"
    site_kind = "current"
    substeps = 4  # electric time constants are shorter than a sample

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        # The largest voltage over the largest current is a resistance of the winding's size.
        rise = Prior("log", 0.2 * scales.force / scales.current, 1.5)
        return (
            EffectParameter("dR_inf", "Ohm", "final rise of the resistance", rise),
            EffectParameter("T", "s", "thermal time constant", Prior("log", 3.0 * scales.duration, 1.5)),
        )

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        rise = 0.2 * scales.force / scales.current
        return tuple({"dR_inf": rise, "T": share * scales.duration} for share in (0.5, 5.0))

    def laws(self, site: Site, values: Mapping[str, float]) -> tuple[Law, ...]:
        return (Law(heating_drop, site.name, (values["dR_inf"], values["T"])),)

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # A resistance anywhere between cold and warm.
        return Footprint(site.name, "current", 0.0, values["dR_inf"])


EFFECT = ResistanceHeating()
