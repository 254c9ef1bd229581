"""Parameters of a linear plant that move together: a fit that scales them all by one factor knows that factor only.

The inertias of a drive train are an example: a record shows their sum. A range for each alone would say what nobody
measured; one block for the common factor says what was measured, and nothing else.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from robustlab.dynamics.linear_plant import Descriptor, LinearPlant
from robustlab.dynamics.parameters import Parameter
from robustlab.errors import InputError

__all__ = ["tied_plant"]


def tied_plant(plant: LinearPlant, groups: Iterable[tuple[str, tuple[str, ...]]]) -> LinearPlant:
    r"""The same plant with one further parameter s = 1 for each group, which scales all of the group.

    .. math:: p_k = \bar p_k + \bar p_k (s - 1) \quad \text{for each } k \text{ of the group}

    Its tolerance is the widest of the group's, whose own are taken off; groups of one, or without a tolerance, stay.

    Parameters
    ----------
    groups
        (label, names of parameters) each.

    Raises
    ------
    InputError
        A label that is the name of a parameter, a name that is none, one in two groups.

    Examples
    --------
    >>> from robustlab.dynamics import plant
    >>> motor = plant("dc-motor", Km=(0.05, 0.02), Kb=(0.05, 0.02), Kf=(4.8e-5, 0.0))
    >>> [b.name for b in tied_plant(motor, [("Km+Kb", ("Km", "Kb"))]).uncertain(["omega"]).blocks]
    ['Km+Kb']
    """
    parameters, scaled = dict(plant.parameters), plant.values
    tied: dict[str, tuple[str, ...]] = {}
    seen: set[str] = set()
    for label, names in groups:
        for name in names:
            if name not in plant.parameters or name in seen:
                word = "stands in two groups" if name in seen else "no such parameter"
                raise InputError(f"tied_plant: {name!r}", word, f"each of {', '.join(plant.parameters)} once at most")
        seen.update(names)
        members = [plant.parameters[name] for name in names]
        widest = max((p.tolerance for p in members), default=0.0)
        if len(names) < 2 or not widest:
            continue
        if label in parameters:
            raise InputError(f"tied_plant: {label!r}", "a parameter of that name", "another label")
        parameters |= {p.name: replace(p, tolerance=0.0) for p in members}
        sources = list(dict.fromkeys(p.source for p in members))
        meaning = "common factor"
        parameters[label] = Parameter(label, 1.0, "", widest, "; ".join(sources), meaning, "positive")
        tied[label] = names
    if not tied:
        return plant
    original = plant.equations

    def equations(p: Mapping[str, float]) -> Descriptor:
        values = {name: p[name] for name in plant.parameters}
        for label, names in tied.items():
            for name in names:
                values[name] += scaled[name] * (p[label] - 1.0)
        return original(values)

    return replace(plant, parameters=parameters, equations=equations)
