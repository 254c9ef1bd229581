"""An effect at its place, with numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from robustlab.dynamics.effects.contract import Effect, EffectParameter, Scales, Site
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.ports.port_model import PortModel
from robustlab.errors import InputError, did_you_mean
from robustlab.statespace import real_array

__all__ = ["AttachedEffect", "attach", "effect_names"]


@dataclass(frozen=True)
class AttachedEffect:
    """One effect of a plant.

    Attributes
    ----------
    effect
        Of the catalogue.
    site
        Where it sits.
    values
        Name -> value of each of its parameters.
    std
        Name -> standard deviation, for those that a fit has determined.
    source
        Where the values come from: a record, a fit, a data sheet.

    Raises
    ------
    InputError
        A missing or unknown parameter, NaN, a negative value of a quantity that is positive by nature, a negative
        standard deviation.
    """

    effect: Effect
    site: Site
    values: Mapping[str, float]
    std: Mapping[str, float] = field(default_factory=dict)
    source: str = ""

    def __post_init__(self) -> None:
        where = f"effect {self.effect.id}"
        values = {name: _number(where, name, value) for name, value in self.values.items()}
        object.__setattr__(self, "values", self.effect.checked(values))
        for parameter in self.parameters:
            if parameter.name not in self.values:
                needed = ", ".join(p.name for p in self.parameters)
                raise InputError(f"{where} at {self.site}", f"no value for {parameter.name!r}", needed)
            if parameter.prior.kind != "linear" and self.values[parameter.name] < 0:
                found = f"{parameter.name} = {self.values[parameter.name]:g}"
                raise InputError(where, found, f"no negative {parameter.meaning}")
        std = {name: _number(where, f"standard deviation of {name}", value) for name, value in self.std.items()}
        for name, value in std.items():
            if name not in self.values:
                hint = did_you_mean(name, tuple(self.values))
                raise InputError(f"{where}: std", f"no parameter {name!r}", ", ".join(self.values), hint)
            if value < 0:
                raise InputError(f"{where}: standard deviation of {name}", f"{value:g}", "0 or more")
        object.__setattr__(self, "std", std)

    @property
    def parameters(self) -> tuple[EffectParameter, ...]:
        """The effect's parameters at this kind of site; units are those of the catalogue without a record."""
        return _parameters(self.effect, self.site)

    def to_json(self) -> dict[str, Any]:
        """Id, title, equation, site, source, and the parameters with value, standard deviation and unit."""
        return {
            "id": self.effect.id,
            "title": self.effect.title,
            "equation": self.effect.equation,
            "site": self.site.name,
            "site_kind": self.site.kind,
            "source": self.source,
            "parameters": {
                p.name: {
                    "value": self.values[p.name],
                    "std": self.std.get(p.name),
                    "unit": p.unit,
                    "meaning": p.meaning,
                }
                for p in self.parameters
            },
        }

    def __repr__(self) -> str:
        values = ", ".join(f"{name}={value:g}" for name, value in self.values.items())
        return f"{self.effect.id}@{self.site.name}({values})"


def _number(where: str, name: str, value: Any) -> float:
    return float(real_array(name, value, 0, where))


def _parameters(effect: Effect, site: Site) -> tuple[EffectParameter, ...]:
    # Effects that may scale a parameter or act at a joint tell the two by the unit of force.
    return effect.parameters(Scales(force_unit="N" if site.kind in ("joint", "current") else ""))


def attach(
    key: str, given: Mapping[str, Any], plant: LinearPlant, model: PortModel, taken: Iterable[AttachedEffect] = ()
) -> AttachedEffect:
    """The effect named by ``key`` (``"id"`` or ``"id@site"``) with the given values at its only, or named, site.

    Parameters
    ----------
    given
        Name -> value, or (value, standard deviation).
    taken
        Effects that the plant has already.

    Raises
    ------
    InputError
        Unknown effect or site (with the closest name), no site at all, several and none named, the same one twice.
    """
    from robustlab.dynamics.effects.catalogue import effect as named

    name, _, place = key.partition("@")
    effect = named(name)
    where = f"effect {name}"
    if not isinstance(given, Mapping):
        raise InputError(where, f"{given!r}", "a table of its parameters: name -> value or (value, standard deviation)")
    values: dict[str, float] = {}
    std: dict[str, float] = {}
    for parameter, value in given.items():
        if isinstance(value, (tuple, list)):
            if len(value) != 2:
                raise InputError(
                    f"{where}: {parameter}", f"{len(value)} entries", "a value or (value, standard deviation)"
                )
            values[parameter], std[parameter] = value
        else:
            values[parameter] = value
    values = effect.checked({n: _number(where, n, v) for n, v in values.items()})
    sites = [s for s in effect.sites(plant, model) if {p.name for p in _parameters(effect, s)} == set(values)]
    attached = AttachedEffect(effect, _site(where, sites, place, plant), values, std)
    if any(other.effect.id == name and other.site == attached.site for other in taken):
        raise InputError(f"{where} at {attached.site}", "given twice", "each effect once at a site")
    return attached


def _site(where: str, sites: list[Site], place: str, plant: LinearPlant) -> Site:
    names = [site.name for site in sites]
    if not sites:
        raise InputError(where, f"{plant.name} has no place for it", "a plant with such a joint, input or parameter")
    if not place:
        if len(sites) == 1:
            return sites[0]
        head, shown = where.removeprefix("effect "), ", ".join(names)
        raise InputError(
            where, f"{len(sites)} places where it may sit: {shown}", "one", f'name it: "{head}@{names[0]}"'
        )
    for site in sites:
        if place == site.name or (site.kind == "parameter" and place in site.name.split("+")):
            return site
    raise InputError(
        f"{where}: site {place!r}", "no such place", f"one of {', '.join(names)}", did_you_mean(place, names)
    )


def effect_names() -> tuple[str, ...]:
    """Ids of all effects of the catalogue.

    Examples
    --------
    >>> "coulomb-friction" in effect_names()
    True
    """
    from robustlab.dynamics.effects.catalogue import catalogue

    return tuple(catalogue())
