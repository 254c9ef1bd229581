"""Effects at a motor's current: what its brushes and its warming take of the voltage."""

from __future__ import annotations

import math
from collections.abc import Mapping

from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.effects.friction_effects import dry_force
from robustlab.dynamics.ports.law_kernel import GV, STEP, V0, V, law


class BrushDrop(Effect):
    """Voltage drop of brushes: a constant voltage against the current."""

    id = "brush-drop"
    title = "Brush voltage drop"
    equation = "f = -Vb sgn(i), |f| <= Vb at i = 0"
    independently = "measure voltage and current at the terminals with the rotor held"
    constant_loss = "voltage"
    site_kind = "current"
    force = dry_force

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        prior = Prior("log", 0.05 * scales.force, 1.2)
        return (EffectParameter("Vb", scales.force_unit, "voltage drop", prior),)

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # Describing function of the relay at a sine of the current amplitude a: 4 Vb / (pi a).
        gain = 4.0 * values["Vb"] / (math.pi * amplitude)
        return Footprint(site.name, "current", 0.0, gain, offset=values["Vb"], describing=gain)


@law
def heating_drop(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Drop of p = (kappa, T) at the middle of the step: mean current times the resistance z[0] there."""
    resistance = z[0]
    drop = -resistance * 0.5 * (seen[V0] + seen[V]) / (1.0 + 0.5 * seen[GV] * resistance)
    current = 0.5 * (seen[V0] + seen[V] + seen[GV] * drop)
    final = p[0] * current * current
    z_next[0] = final + (resistance - final) * math.exp(-seen[STEP] / p[1])
    return drop


QUICKEST = 0.5  # s: no winding heats faster; a resistance that follows the current within less has another cause


class ResistanceHeating(Effect):
    """A winding that warms up: a resistance that grows with the heat it has taken."""

    id = "resistance-heating"
    title = "Heating of the winding"
    equation = "f = -dR i, T dR' = kappa i^2 - dR"
    independently = "measure the winding with an ohmmeter, cold and right after a long run"
    site_kind = "current"
    force = heating_drop
    memory = 1
    long_memory = True

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        time = Prior("log", 3.0 * scales.duration, 1.5)
        return (
            EffectParameter("kappa", "Ohm/A2", "final rise per squared current", Prior("log", _rise(scales), 1.5)),
            EffectParameter("T", "s", "thermal time constant", time),
        )

    def visited(self, values: Mapping[str, float], scales: Scales) -> bool:
        return values["T"] >= QUICKEST

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        return tuple({"kappa": _rise(scales), "T": share * scales.duration} for share in (0.5, 5.0))

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # A resistance anywhere between cold and the warmest that this current can make it.
        return Footprint(site.name, "current", 0.0, values["kappa"] * amplitude**2)


def _rise(scales: Scales) -> float:
    """A fifth of a resistance of the winding's size, at a third of the largest current."""
    return 0.2 * scales.force / scales.current / (scales.current / 3.0) ** 2


EFFECTS = (BrushDrop(), ResistanceHeating())
