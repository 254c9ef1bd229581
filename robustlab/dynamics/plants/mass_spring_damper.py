r"""Masses in a row: mass 1 hangs on a wall by spring and damper 1, mass j on mass j - 1 by spring and damper j.

.. math::
    m_j \ddot q_j = f_j - k_j (q_j - q_{j-1}) - c_j (\dot q_j - \dot q_{j-1})
                    + k_{j+1} (q_{j+1} - q_j) + c_{j+1} (\dot q_{j+1} - \dot q_j), \qquad q_0 = 0

The last mass is free on its other side. One mass has the signals f, q, v and the parameters m, c, k; a chain of n has
f1..fn, q1..qn, v1..vn and m1..mn, c1..cn, k1..kn.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from robustlab.dynamics.linear_plant import Descriptor, LinearPlant
from robustlab.dynamics.parameters import Parameter, overridden
from robustlab.errors import InputError, unknown_name
from robustlab.statespace import MAX_STATES, Signal

__all__ = []

_EXAMPLE = "example value, no published source"

PARAMETERS = (
    Parameter("m", 1.0, "kg", 0.0, _EXAMPLE, "mass", "positive", role="inertia"),
    Parameter("c", 1.0, "N s/m", 0.0, _EXAMPLE, "damping", "nonnegative", role="viscous-friction"),
    Parameter("k", 100.0, "N/m", 0.0, _EXAMPLE, "stiffness", "nonnegative", role="stiffness"),
)


def mass_spring_damper(**given: Any) -> LinearPlant:
    """Plant with a force f [N] on each mass, outputs and states q [m] and v [m/s] of each mass.

    ``given``: ``m c k``, each a value, a tuple ``(value, relative tolerance)``, or a list of those, one for each mass.
    Lists must be equally long; what is no list counts for every mass of the chain.

    Raises InputError: lists of different lengths, an empty list, unknown names, values that physics forbids.
    """
    names = tuple(p.name for p in PARAMETERS)
    for name in given:
        if name not in names:
            raise unknown_name(f"mass-spring-damper: {name!r}", "no such parameter", name, names)
    lists = {name: list(value) for name, value in given.items() if isinstance(value, (list, np.ndarray))}
    lengths = {len(value) for value in lists.values()} or {1}
    if len(lengths) > 1 or 0 in lengths:
        found = ", ".join(f"{len(value)} values of {name}" for name, value in lists.items())
        raise InputError("mass-spring-damper", found, "equally many of each, at least one")
    n = lengths.pop()
    if 2 * n > MAX_STATES:
        raise InputError("mass-spring-damper", f"{n} masses", f"at most {MAX_STATES // 2}")
    defaults, values = [], {}
    for p in PARAMETERS:
        for j, name in enumerate(_numbered(p.name, n)):
            meaning = p.meaning if n == 1 else f"{p.meaning} {j + 1}"
            defaults.append(Parameter(name, p.value, p.unit, p.tolerance, p.source, meaning, p.sign, p.role))
            if p.name in given:
                values[name] = lists[p.name][j] if p.name in lists else given[p.name]
    q = [Signal(name, "m") for name in _numbered("q", n)]
    v = [Signal(name, "m/s") for name in _numbered("v", n)]
    return LinearPlant(
        "mass-spring-damper",
        overridden(defaults, values, "mass-spring-damper"),
        tuple(Signal(name, "N") for name in _numbered("f", n)),
        (*q, *v),
        (*q, *v),
        equations=partial(_equations, n=n),
    )


def _numbered(name: str, n: int) -> Sequence[str]:
    return [name] if n == 1 else [f"{name}{j + 1}" for j in range(n)]


def _equations(p: Any, n: int) -> Descriptor:
    m, c, k = ([p[name] for name in _numbered(letter, n)] for letter in "mck")
    # Elongation j is q_j - q_(j-1); the same matrix, transposed, takes the forces of the springs back to the masses.
    elongation = np.eye(n) - np.eye(n, k=-1)
    stiffness, damping = (elongation.T @ np.diag(value) @ elongation for value in (k, c))
    eye, zero = np.eye(n), np.zeros((n, n))
    return Descriptor(
        E=np.block([[eye, zero], [zero, np.diag(m)]]),
        F=np.block([[zero, eye], [-stiffness, -damping]]),
        G=np.vstack([zero, eye]),
        C=np.eye(2 * n),
    )
