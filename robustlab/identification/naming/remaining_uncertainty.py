r"""What remains after naming, as blocks: from a discovery, or its updated plant, to an uncertain model.

The updated plant's parameters have the ranges of the fit (those that it scaled together: one range in common), its
effects become blocks and bounded inputs, and the force that nothing explains becomes an input of three times its root
mean square.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robustlab.dynamics.extended.effect_blocks import EffectBlocks, effect_blocks
from robustlab.dynamics.extended.force_blocks import Amplitude, Dry
from robustlab.errors import InputError
from robustlab.identification.naming.discovery_result import Discovery
from robustlab.identification.naming.updated_plant import fitted_together

__all__ = ["uncertain_from"]

# Of a force of which nothing is known but its mean square: nearly all of a normal one lies within.
TIMES_RMS = 3.0


def uncertain_from(
    found: Any,
    outputs: Sequence[str] | None = None,
    *,
    sigmas: float = 2.0,
    amplitude: Mapping[str, Amplitude] | None = None,
    dry: Dry | None = None,
    pade: int = 2,
) -> EffectBlocks:
    """The uncertain model of what a discovery found and of what it left unexplained, each block with its origin.

    Parameters
    ----------
    found
        `Discovery`, or a plant with or without effects (its updated plant from a file).
    outputs, sigmas, amplitude, dry, pade
        See `robustlab.dynamics.extended.effect_blocks.effect_blocks`. Without amplitudes dry friction is a bounded
        force; a force that grows with the speed is then described up to the largest speed of the residual force that
        the discovery knows.

    Raises
    ------
    InputError
        A discovery without an updated plant, an effect with a sector at a place without an amplitude.
    NoTrustworthyNumber
        The blocks do not give back the plant's own linear model.

    Examples
    --------
    >>> import robustlab as rl
    >>> motor = rl.plant("dc-motor", R=(2.07, 0.10))
    >>> rough = rl.with_effects(motor, {"coulomb-friction": {"Fc": (0.005, 2e-4)}})
    >>> [(n.name, round(n.bound, 5), n.unit) for n in uncertain_from(rough).noise]
    [('load omega: coulomb-friction', 0.0054, 'N m')]
    >>> blocks = uncertain_from(rough, amplitude={"omega": 10.0})
    >>> blocks.origins["coulomb-friction@omega"].split("; ")[1]
    'harmonic balance, for oscillations of amplitude 10 rad/s and more'
    """
    if not isinstance(found, Discovery):
        tied = fitted_together(found)
        return effect_blocks(found, outputs, sigmas=sigmas, amplitude=amplitude, dry=dry, pade=pade, tied=tied)
    if found.model is None:
        raise InputError("uncertain_from", "a discovery without an updated plant", "one with a model")
    left = found.residual_force
    unnamed = None
    if left is not None and left.rms > 0 and not found.complete:
        text = f"force that no effect explains, {TIMES_RMS:g} times its RMS of {left.rms:.4g} {left.unit}"
        unnamed = TIMES_RMS * left.rms, f"{text}; from {', '.join(found.records)}"
    if dry is None and not amplitude:
        dry = "load"
    chosen = {**_speeds(found), **(amplitude or {})}
    return effect_blocks(
        found.model,
        outputs,
        sigmas=sigmas,
        amplitude=chosen,
        dry=dry,
        pade=pade,
        unnamed=unnamed,
        tied=fitted_together(found.model),
    )


def _speeds(found: Discovery) -> dict[str, Amplitude]:
    """Largest speed along the records, for the only joint that has effects."""
    curve = None if found.residual_force is None else found.residual_force.curves.get("speed")
    joints = {e.site.name for e in getattr(found.model, "effects", ()) if e.site.kind == "joint"}
    if curve is None or len(joints) != 1:
        return {}
    size = float(np.abs(curve.x).max())
    return {joints.pop(): size} if size > 0 else {}
