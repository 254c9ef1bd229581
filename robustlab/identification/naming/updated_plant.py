"""The plant after naming: nominal parameters as refitted, the named effects attached."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from robustlab.dynamics.extended.attached_effect import AttachedEffect
from robustlab.dynamics.extended.extended_plant import with_effects
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.ports.port_model import parameter_groups
from robustlab.identification.hypotheses.effect_fit import Fit, Problem

__all__ = ["fitted_together", "updated_plant"]

ONE_FACTOR = "scaled by one factor"
SIGMAS = 2.0  # standard deviations that a refitted parameter's tolerance covers
MOST = 0.99  # a tolerance stays below the value itself


def updated_plant(problem: Problem, fit: Fit, source: str) -> Any:
    """The plant with the fitted factors in its parameters, tolerances from the fit, and every other effect attached.

    A wrong parameter becomes the plant's new value. A parameter that the fit did not touch keeps value and tolerance.
    A `LinearPlant` where no effect has to be attached, else an `ExtendedPlant`.
    """
    plant = problem.plant
    factors, values = problem.split(fit.hypothesis, fit.z)
    spread = _spreads(problem, fit)
    attached = []
    at = len(problem.nuisances)
    for candidate, own in zip(fit.hypothesis.candidates, values, strict=True):
        changed = candidate.effect.factors(plant, candidate.site, own)
        for name, factor in changed.items():
            factors[name] = factors.get(name, 1.0) * factor
        if not changed:
            std = {}
            for k, p in enumerate(candidate.parameters):
                z, s = fit.z[at + k], fit.std[at + k]
                std[p.name] = 0.5 * abs(p.prior.value(z + s) - p.prior.value(z - s))
            attached.append(AttachedEffect(candidate.effect, candidate.site, own, std, source))
        at += len(candidate.parameters)
    base = _refitted(plant, factors, spread, source)
    return with_effects(base, attached) if attached else base


def _spreads(problem: Problem, fit: Fit) -> dict[str, float]:
    """Relative standard deviation of each refitted parameter."""
    found = {}
    for nuisance, s in zip(problem.nuisances, fit.std, strict=False):
        found.update(dict.fromkeys(nuisance.names, nuisance.spread * float(s)))
    at = len(problem.nuisances)
    for candidate in fit.hypothesis.candidates:
        if candidate.site.kind == "parameter":
            z, s = fit.z[at], fit.std[at]
            prior = candidate.parameters[0].prior
            relative = 0.5 * abs(prior.value(z + s) - prior.value(z - s)) / abs(prior.value(z))
            for name in candidate.effect.factors(problem.plant, candidate.site, candidate.values(fit.z[at : at + 1])):
                found[name] = relative
        at += len(candidate.parameters)
    return found


def _refitted(plant: LinearPlant, factors: dict[str, float], spread: dict[str, float], source: str) -> LinearPlant:
    changes = {
        name: (plant.parameters[name].value * factor, min(MOST, SIGMAS * spread.get(name, 0.0)))
        for name, factor in factors.items()
        if plant.parameters[name].value and name not in plant.exact
    }
    made = plant.with_parameters(**changes)
    told = {n: replace(p, source=source) if n in changes else p for n, p in made.parameters.items()}
    for names in _together(plant, changes):
        words = f"{', '.join(names)} {ONE_FACTOR}; {source}"
        told |= {n: replace(told[n], source=words) for n in names}
    return replace(made, parameters=told)


def _together(plant: LinearPlant, changed: Iterable[str]) -> list[tuple[str, ...]]:
    known = set(changed)
    groups = [tuple(n for n in names if n in known) for _, _, names in parameter_groups(plant)]
    return [names for names in groups if len(names) > 1]


def fitted_together(plant: Any) -> list[tuple[str, tuple[str, ...]]]:
    """Groups of parameters of an updated plant that the fit scaled by one factor: (label, names).

    Of each alone it knows no more than that factor. Told by their source, which files keep.
    """
    base = getattr(plant, "plant", plant)
    if not isinstance(base, LinearPlant):
        return []
    sources = {n: p.source for n, p in base.parameters.items() if ONE_FACTOR in p.source}
    return [
        ("+".join(names), names) for names in _together(base, sources) if len({sources[n] for n in names}) == 1
    ]  # fmt: skip
