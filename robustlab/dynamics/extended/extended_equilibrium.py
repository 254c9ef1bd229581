r"""Rest of a plant with effects: :math:`f(x, u) = 0` with some inputs, outputs or states given.

Newton steps on all that is free, each the shortest that solves the linearised equations, so that inputs and positions
that nothing asks for stay at zero. Forces that hold their joint take part by being what they must be: where they
suffice the equations are fulfilled, and where they do not, the step leads to the edge of what they can hold.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.extended.law_forces import is_set_valued, rest_band
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean
from robustlab.statespace import real_array

if TYPE_CHECKING:
    from robustlab.dynamics.extended.extended_plant import ExtendedPlant

__all__ = ["rest"]

PASSES = 60
# Holding forces come before inputs and positions: in the shortest step they weigh this much less.
CHEAP = 1e4
# At rest to this share of the rates that the terms of the equations have one by one.
STILL = 1e-11


def rest(plant: ExtendedPlant, where: Mapping[str, Any]) -> tuple[Array, Array, float]:
    """State, input and the largest rate there.

    Parameters
    ----------
    where
        Name of an input, output or state -> value. A name that is both output and state means the state.

    Raises
    ------
    InputError
        An unknown name, a value that is no number.
    NoTrustworthyNumber
        No rest.
    """
    n, n_u = len(plant.states), len(plant.inputs)
    states, inputs, outputs = ([s.name for s in kind] for kind in (plant.states, plant.inputs, plant.outputs))
    s, fixed = np.zeros(n + n_u), np.zeros(n + n_u, dtype=np.bool_)
    wanted: dict[int, float] = {}
    for name, value in where.items():
        number = float(real_array(name, value, 0, f"{plant.name}: trim"))
        if name in states or name in inputs:
            k = states.index(name) if name in states else n + inputs.index(name)
            s[k], fixed[k] = number, True
        elif name in outputs:
            wanted[outputs.index(name)] = number
        else:
            known = (*inputs, *outputs, *(x for x in states if x not in outputs))
            hint = did_you_mean(name, known)
            raise InputError(f"{plant.name}: trim", f"{name!r}", f"one of {', '.join(known)}", hint)
    free = np.flatnonzero(~fixed)
    rows = list(wanted)
    residual = np.zeros(n)
    for _ in range(PASSES):
        residual = np.concatenate([plant.derivative(s[:n], s[n:]), plant.output(s[:n], s[n:])[rows]])
        residual[n:] -= list(wanted.values())
        if _is_still(plant, s, residual, n):
            return s[:n], s[n:], float(np.abs(residual).max(initial=0.0))
        a, b, c, d = plant.jacobians(s[:n], s[n:])
        matrix = np.vstack([np.hstack([a, b]), np.hstack([c[rows], d[rows]])])[:, free]
        size = np.abs(matrix).max(axis=1, initial=0.0)
        scale = np.where(size > 0, size, 1.0)
        holding = _holding_columns(plant, s, n) / scale[:n, None]
        held = np.vstack([CHEAP * holding, np.zeros((len(rows), holding.shape[1]))])
        step = np.linalg.lstsq(np.hstack([matrix / scale[:, None], held]), -residual / scale, rcond=1e-12)[0][
            : len(free)
        ]
        # Newton's steps leave rates of rounding at joints whose rest is what lets them be held: those are zero.
        s[free] += np.where(np.abs(step) > 1e-14 * np.abs(s[free]), step, 0.0)
        s = np.where(np.abs(s) > 1e-12 * np.abs(s).max(initial=0.0), s, 0.0)
    given = ", ".join(f"{name} = {value:g}" for name, value in where.items())
    moving = int(np.argmax(np.abs(residual[:n])))
    raise NoTrustworthyNumber(
        f"{plant.name}: trim",
        f"no rest with {given or 'anything given'}: {states[moving]} keeps changing, at {residual[moving]:.3g}/s",
        None,
        "give an input that what holds the plant can bear, or leave the input to be found",
    )


def _holding_columns(plant: ExtendedPlant, s: Array, n: int) -> Array:
    """Rates per unit of each force that holds its joint within its band and may change: scaled to entries of 1."""
    columns = [np.zeros((n, 0))]
    for (_, law, port), force in zip(plant.laws, plant.forces(s[:n], s[n:]), strict=True):
        if float(port.velocity @ s[:n]) != 0.0 or law.memory:
            continue
        q = 0.0 if port.position is None else float(port.position @ s[:n])
        low, high = rest_band(law, q)
        if low < force < high and is_set_valued(law, q):
            columns.append((port.force / np.abs(port.force).max())[:, None])
    return np.hstack(columns)


def _is_still(plant: ExtendedPlant, s: Array, residual: Array, n: int) -> bool:
    """Whether the rates are the rounding of the terms that make them up, and the outputs where they should be."""
    model = plant.model
    forces = plant.forces(s[:n], s[n:])
    terms = np.abs(model.A) @ np.abs(s[:n]) + np.abs(model.B) @ np.abs(plant.mapped_input(s[n:]))
    for (_, _, port), force in zip(plant.laws, forces, strict=True):
        terms = terms + np.abs(port.force * force)
    bound = STILL * terms
    return bool((np.abs(residual[:n]) <= bound).all() and (np.abs(residual[n:]) <= STILL * (1.0 + _size(s))).all())


def _size(s: Array) -> float:
    return float(np.abs(s).max(initial=0.0))
