r"""Gain of a loop with the effects of its plant as nonlinear or time-varying blocks.

`robustlab.dynamics.extended.effect_blocks` replaces each effect that has a sector by a gain with a range, and mu
assumes this gain to be constant. Here the same blocks have the classes of the catalogue:

==========================  ==========================================================================================
effect                      class
==========================  ==========================================================================================
saturation of an input      odd, slope in [0, 1], sector from limit / amplitude to 1
dead zone of an input       odd, slope in [0, 1], sector from 0 to 1 - d / amplitude
Coulomb friction            rejected: a joint may stick away from zero, so no gain to a position is finite; with a
                            stick speed v_s odd, slope and sector [0, Fc / v_s]
any other with a sector     a gain between the ends of its sector that may change at every instant
==========================  ==========================================================================================

A gain by harmonic balance only (a range of describing functions) is no sector and is rejected.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from robustlab.checks import number
from robustlab.display import Facts, bracket, listed
from robustlab.dynamics.extended.effect_blocks import EffectBlocks, effect_blocks
from robustlab.dynamics.extended.extended_plant import ExtendedPlant
from robustlab.errors import InputError, error_context
from robustlab.feedback import feedback_loop
from robustlab.iqc.analysis import IqcGain, iqc_gain
from robustlab.iqc.block_types import Nature, Nonlinearity, Varying
from robustlab.mu_analysis import WorstCaseGain, worst_case_gain
from robustlab.norms import PeakGain
from robustlab.verification.claim import Claim

__all__ = ["EffectGain", "effect_gain"]

# A relay F has the describing function 4 F / (pi a): at this multiple of the stick speed it is F / v_s.
STICK = 1.2732395447351628
# Effects on an input that are memoryless, odd and of slope in [0, 1].
ODD_INPUTS = ("input-saturation", "input-dead-zone")


@dataclass(frozen=True, eq=False)
class EffectGain(PeakGain):
    """The gain of a loop with effects: proved for their own classes, and that of constant gains for comparison.

    Attributes
    ----------
    lower, upper, proved, status
        Those of ``proved``, by integral quadratic constraints; its blocks are the effects and the uncertain parameters.
    as_constants
        The worst-case gain of the same set with all effects as constant gains, as in mu and harmonic balance. It is no
        proof for a nonlinearity; it shows the conservatism of one.
    left_out
        Effect at its place -> the reason why it is in no block; bounded errors, which are inputs, among them.
    loop
        The feedback law and its source.
    """

    proved: IqcGain
    as_constants: WorstCaseGain
    left_out: Mapping[str, str]
    loop: str = ""

    quantities: ClassVar[Mapping[str, Any]] = {**PeakGain.quantities, "as_constants": float}

    def claims(self) -> list[Claim]:
        return self.proved.claims()

    def numbers(self) -> dict[str, Any]:
        return {**super().numbers(), "as_constants": self.as_constants.upper}

    def facts(self) -> Facts:
        return [("loop", self.loop), *super().facts()]

    def evidence(self) -> Facts:
        """Return the proof, and the gain of the same ranges as constants."""
        constants = bracket(self.as_constants.lower, self.as_constants.upper, ("attained", "proved for constants"))
        return [*self.proved.evidence(), ("as constant gains", constants)]


@error_context("effect_gain")
def effect_gain(
    plant: ExtendedPlant,
    controller: Any = None,
    outputs: Sequence[str] | None = None,
    amplitude: Mapping[str, float] | None = None,
    stick_speed: Mapping[str, float] | None = None,
    sign: int | None = None,
    order: int = 2,
    time_limit: float | None = None,
    effort: float = 1.0,
) -> EffectGain:
    """`robustlab.peak_gain` of a plant with effects in a loop, from disturbances at its inputs to its outputs."""
    if controller is None:
        raise InputError("effect_gain: controller", "none for a plant with effects", "the K that closes its loop")
    slow = dict(stick_speed or {})
    places = {e.site.name: e for e in plant.effects if e.effect.id == "coulomb-friction"}
    for name, speed in slow.items():
        if name not in places:
            where = f"effect_gain: stick_speed {name!r}"
            raise InputError(where, "no Coulomb friction there", listed(places) or "none")
        number(f"effect_gain: stick_speed {name!r}", speed, "a positive speed", above=0)
    rubbing = next((name for name in places if name not in slow), None)
    if rubbing is not None:
        raise InputError(
            "effect_gain", f"Coulomb friction at {rubbing}, of sector [0, inf): no strict inequality holds",
            "a stick_speed there", "the speed below which the force grows in proportion to it, as in simulations",
        )  # fmt: skip
    levels = {**(amplitude or {}), **{name: STICK * v for name, v in slow.items()}}
    made = effect_blocks(plant, outputs, amplitude=levels, dry="gain")
    inputs = [s.name for s in plant.inputs]
    around, s, source = feedback_loop(made.model.select(inputs), controller, sign, "effect_gain")
    loop = made.model.select(inputs).feedback(around, s)
    natures = _natures(plant, made, amplitude or {}, slow)
    proved = iqc_gain(loop, natures, order=order, time_limit=time_limit, effort=effort)
    constants = worst_case_gain(loop, time_limit=time_limit, effort=effort)
    left = {**made.left_out, **{n.name: "a bounded error: an input, no gain" for n in made.noise}}
    return EffectGain(
        proved.lower, proved.upper, None, proved.status, proved, constants, left, source,
        conditions=proved.conditions, notes=tuple(f"not in it: {name}: {why}" for name, why in left.items()),
    )  # fmt: skip


def _natures(
    plant: ExtendedPlant, made: EffectBlocks, amplitude: Mapping[str, float], slow: Mapping[str, float]
) -> dict[str, Nature]:
    """Return block name -> nature of every effect's block; parameters stay constants."""
    effects = {e.key: e for e in plant.effects}
    found: dict[str, Nature] = {}
    for block in made.model.blocks:
        e = effects.get(block.name.rstrip("'"))
        if e is None or block.parameter is None:
            continue
        sector = block.parameter.low, block.parameter.high
        place = e.site.name
        if e.effect.id in ODD_INPUTS:
            holds = f"while the signal stays within {amplitude[place]:g}"
            found[block.name] = Nonlinearity(sector, (0.0, 1.0), odd=True, holds=holds)
        elif e.effect.id == "coulomb-friction":
            words = f"sticking as creep below {slow[place]:g}"
            found[block.name] = Nonlinearity(sector, sector, odd=True, holds=words)
        elif block.name in made.approximate:
            where = f"effect_gain: {e.key}"
            raise InputError(where, "a gain by harmonic balance only", "an effect with a sector", "take it out")
        elif not e.effect.delay and not e.time_constant and e.scale is None:
            local = f"while its signal stays within {amplitude[place]:g}" if place in amplitude else ""
            found[block.name] = Varying(holds=local or ("within the amplitudes given" if amplitude else ""))
    return found
