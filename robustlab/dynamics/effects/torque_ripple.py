r"""Ripple of the force over time: mains, a beat of two clocks, an unbalanced neighbour.

.. math:: f = A_c \cos 2 \pi f t + A_s \sin 2 \pi f t

t counts from the first sample of the record (`robustlab.dynamics.extended.simulator.Simulator` from its ``t0``): of two
records that were not started by the ripple itself, each has phases of its own. Over a step the force is its mean over
the step's time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.effects.spatial_wave import wave_mean
from robustlab.dynamics.ports.law_kernel import STEP, TIME, law

__all__ = ["EFFECT", "ripple_force"]

MAINS = (50.0, 100.0, 60.0, 120.0)  # Hz: of both kinds of mains, and of what a rectifier makes of them


@law
def ripple_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Parameters p = (A_c, A_s, f); outside of time (no finite TIME) its mean."""
    if not math.isfinite(seen[TIME]):
        return 0.0
    return wave_mean(seen[TIME], seen[TIME] + seen[STEP], p[0], p[1], 2.0 * math.pi * p[2])


class TorqueRipple(Effect):
    """A force that is periodic in time, whatever the motion."""

    id = "torque-ripple"
    title = "Ripple over time"
    equation = "f = Ac cos(2 pi f t) + As sin(2 pi f t)"
    independently = "record the position while the machine stands under power"
    site_kind = "joint"
    amplitude = ("A", "Ac", "As")
    force = ripple_force
    timed = "f"

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        wave = Prior("linear", 0.0, 0.2 * scales.force)
        return (
            EffectParameter("Ac", scales.force_unit, "cosine part", wave),
            EffectParameter("As", scales.force_unit, "sine part", wave),
            EffectParameter("f", "Hz", "frequency", _frequency(scales)),
        )

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        # Both parts start at zero, where every phase is equally near.
        return tuple({"Ac": 0.0, "As": 0.0, "f": f} for f in _lines_or_mains(scales))

    def begun(self, values: Mapping[str, float], later: float) -> Mapping[str, float]:
        angle = 2.0 * math.pi * values["f"] * later
        turn, ac, as_ = complex(math.cos(angle), math.sin(angle)), values["Ac"], values["As"]
        wave = complex(ac, -as_) * turn  # Ac cos + As sin is the real part of (Ac - i As) exp(2 pi i f t)
        return {**values, "Ac": wave.real, "As": -wave.imag}

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # No gain of the motion at all: a bounded load.
        return Footprint(site.name, "time", 0.0, 0.0, offset=math.hypot(values["Ac"], values["As"]))


def _lines_or_mains(scales: Scales) -> tuple[float, ...]:
    """Frequencies to start from: the lines seen, else those of the mains that the sampling shows."""
    shown = tuple(f for f in MAINS if f < 0.5 / scales.dt)
    return scales.lines or shown or (0.1 / scales.dt,)


def _frequency(scales: Scales) -> Prior:
    """Prior of the frequency: half a line's width around the line that was seen, else the range of the mains."""
    starts = _lines_or_mains(scales)
    centre = math.exp(sum(map(math.log, starts)) / len(starts))
    if len(scales.lines) == 1:
        return Prior("log", centre, min(0.3, 0.5 / (centre * scales.duration)))
    return Prior("log", centre, 0.5)


EFFECT = TorqueRipple()
