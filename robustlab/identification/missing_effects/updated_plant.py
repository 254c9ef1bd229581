"""The updated plant: refitted parameters, named effects attached; and its uncertain model with the residual force."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from robustlab.dynamics.extended.attached_effect import AttachedEffect
from robustlab.dynamics.extended.effect_blocks import Amplitude, Dry, EffectBlocks, effect_blocks
from robustlab.dynamics.extended.extended_plant import with_effects
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.parameters import Parameter
from robustlab.dynamics.plant_base import NonlinearPlant
from robustlab.dynamics.ports.port_model import AnyPlant, parameter_groups
from robustlab.errors import InputError, error_context
from robustlab.identification import constants
from robustlab.identification.greybox.effect_fit import Candidate, Fit, Problem

ONE_FACTOR = "scaled by one factor"
SIGMAS = 2.0  # standard deviations in a refitted parameter's tolerance
MOST = 0.99  # largest relative tolerance
TIMES_RMS = 3.0  # bound of the residual force: nearly all of a normal distribution


def updated_plant(problem: Problem, fit: Fit, source: str, kinds: Sequence[Any] = ()) -> Any:
    """Return the plant with fitted parameters and tolerances, and every other effect attached."""
    # The size of an effect whose form is open has the interval of its class.
    plant = problem.plant
    factors, values = problem.split(fit.hypothesis, fit.z)
    spread = _spreads(problem, fit)
    attached = []
    for (candidate, place), own in zip(problem.slices(fit.hypothesis), values, strict=True):
        changed = candidate.effect.factors(plant, candidate.site, own)
        for name, factor in changed.items():
            factors[name] = factors.get(name, 1.0) * factor
        if not changed:
            each = zip(candidate.parameters, fit.z[place].tolist(), fit.std[place].tolist(), strict=True)
            std = {p.name: 0.5 * abs(p.prior.value(z + s) - p.prior.value(z - s)) for p, z, s in each}
            first = candidate.parameters[0]
            std[first.name] = max(std[first.name], abs(own[first.name]) * _spread_of(kinds, candidate))
            attached.append(AttachedEffect(candidate.effect, candidate.site, own, std, source))
    base = _refitted(plant, factors, spread, source)
    return with_effects(base, attached) if attached else base


def _spread_of(kinds: Sequence[Any], candidate: Candidate) -> float:
    """Return the relative standard deviation of an open class's size, if it is that of the effect's first parameter."""
    for kind in kinds:
        own = candidate.key in kind.members and not kind.settled
        if own and kind.values and kind.values[0].unit == candidate.parameters[0].unit:
            size = kind.values[0]
            return 0.5 * (size.upper - size.lower) / (constants.INTERVAL * abs(size.value)) if size.value else 0.0
    return 0.0


def _spreads(problem: Problem, fit: Fit) -> dict[str, float]:
    """Return the standard deviation of each refitted parameter: relative, or in its unit for a nominal value of 0."""
    found = {}
    for nuisance, s in zip(problem.nuisances, fit.std, strict=False):
        found.update(dict.fromkeys(nuisance.names, nuisance.spread * float(s)))
    for candidate, own in problem.slices(fit.hypothesis):
        if candidate.site.kind == "parameter":
            z, s = float(fit.z[own.start]), float(fit.std[own.start])
            prior = candidate.parameters[0].prior
            relative = 0.5 * abs(prior.value(z + s) - prior.value(z - s)) / abs(prior.value(z))
            for name in candidate.effect.factors(problem.plant, candidate.site, candidate.values(fit.z[own])):
                found[name] = relative
    return found


def _refitted(plant: AnyPlant, factors: dict[str, float], spread: dict[str, float], source: str) -> AnyPlant:
    changes = {
        name: _new_value(plant.parameters[name], factor, SIGMAS * spread.get(name, 0.0))
        for name, factor in factors.items()
        if name not in getattr(plant, "exact", ())
    }
    made = plant.with_parameters(**changes)
    parameters = {n: replace(p, source=source) if n in changes else p for n, p in made.parameters.items()}
    for names in _together(plant, changes):
        words = f"{', '.join(names)} {ONE_FACTOR}; {source}"
        parameters |= {n: replace(parameters[n], source=words) for n in names}
    return replace(made, parameters=parameters)


def _new_value(nominal: Parameter, factor: float, width: float) -> tuple[float, float]:
    """Return value and tolerance, as `Parameter` reads them, of a parameter at a factor of its reference."""
    value = nominal.reference * factor
    return (value, min(MOST, width if nominal.value else width / abs(value))) if value else (0.0, width)


def _together(plant: AnyPlant, changed: Iterable[str]) -> list[tuple[str, ...]]:
    known = set(changed)
    groups = [tuple(n for n in names if n in known) for _, _, names in parameter_groups(plant)]
    return [names for names in groups if len(names) > 1]


def fitted_together(plant: Any) -> list[tuple[str, tuple[str, ...]]]:
    """Return the groups of an updated plant's parameters that the fit scaled by one factor: (label, names)."""
    base = getattr(plant, "plant", plant)
    if not isinstance(base, (LinearPlant, NonlinearPlant)):
        return []
    sources = {n: p.source for n, p in base.parameters.items() if ONE_FACTOR in p.source}
    return [
        ("+".join(names), names) for names in _together(base, sources) if len({sources[n] for n in names}) == 1
    ]  # fmt: skip


# --- the uncertain model ---------------------------------------------------------------------------------------------


@error_context("uncertain_from")
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

    The updated plant's parameters have the ranges of the fit (those that it scaled together: one range in common), its
    effects become blocks and bounded inputs, and the residual force an input of three times its root mean square.

    Parameters
    ----------
    found
        `Discovery`, or a plant with or without effects (its updated plant from a file).
    outputs, sigmas, amplitude, dry, pade
        See `robustlab.dynamics.extended.effect_blocks.effect_blocks`. Without amplitudes dry friction is a bounded
        force; a force that grows with the speed is then described up to the largest speed of the residual force.

    Returns
    -------
    EffectBlocks
        ``.model`` is the `UncertainModel`, with the origin of each block and the bounded inputs in their units.

    Raises
    ------
    InputError
        A discovery without an updated plant, an effect with a sector at a place without an amplitude.
    NoTrustworthyNumber
        The blocks do not reproduce the plant's linear model.

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
    if not hasattr(found, "residual_force"):
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
        found.model, outputs, sigmas=sigmas, amplitude=chosen, dry=dry, pade=pade, unnamed=unnamed,
        tied=fitted_together(found.model),
    )  # fmt: skip


def _speeds(found: Any) -> dict[str, Amplitude]:
    """Return the largest speed along the records, if only one joint has effects."""
    curve = None if found.residual_force is None else found.residual_force.curves.get("speed")
    joints = {e.site.name for e in getattr(found.model, "effects", ()) if e.site.kind == "joint"}
    if curve is None or len(joints) != 1:
        return {}
    size = float(np.abs(curve.x).max())
    return {joints.pop(): size} if size > 0 else {}
