"""Equilibria of nonlinear plants by Newton's method, at nominal and at other parameter values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from robustlab.arrays import Array, Indices
from robustlab.dynamics.parametric_descriptor import TrimmedDescriptor, Values
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean, unknown_name
from robustlab.statespace import real_array

PASSES, HALVINGS = 60, 30
# Rates below this share of the sum of their terms, or below this many units/s, count as zero.
STILL, FLOOR = 1e-10, 1e-13
# Singular values below this share of the largest are directions of a continuum of equilibria.
RANK = 1e-11
# Largest change of an angle in one step in rad.
TURN = 0.5


def trim_conditions(plant: Any, given: Mapping[str, Any]) -> tuple[dict[int, float], dict[int, float]]:
    """Return index in (x, u) -> value and output -> value; states and inputs take precedence over outputs."""
    names = [s.name for s in (*plant.states, *plant.inputs)]
    outputs = [s.name for s in plant.outputs]
    held: dict[int, float] = {}
    wanted: dict[int, float] = {}
    for name, value in given.items():
        number = float(real_array(name, value, 0, f"{plant.name}: trim"))
        if name in names:
            held[names.index(name)] = number
        elif name in outputs:
            wanted[outputs.index(name)] = number
        else:
            known = tuple(dict.fromkeys([*names, *outputs]))
            raise unknown_name(f"{plant.name}: trim: {name!r}", "no state, input or output", name, known)
    return held, wanted


class _Evaluation(NamedTuple):
    """Residual (n,) at a point, its slopes (n, n_x + n_u), its tolerance (n,), and the local model."""

    residual: Array
    slopes: Array
    scale: Array
    local: Any


def newton(
    plant: Any, start: Array, free: Indices, wanted: Mapping[int, float], values: Values | None = None
) -> tuple[Array, float, int, Any]:
    """Return the point reached, its largest residual over its tolerance, the index of that, and the local model."""
    z, found = start.copy(), evaluated(plant, start, wanted, values)
    turning = np.array([float(s.unit == "rad") for s in (*plant.states, *plant.inputs)])[free]
    for _ in range(PASSES if len(free) else 0):
        if found is None or not found.residual.any():
            break
        part = found.slopes[:, free]
        size = np.abs(part).max(axis=1, initial=0.0)
        size[size == 0.0] = 1.0
        change = np.linalg.lstsq(part / size[:, None], -found.residual / size, rcond=RANK)[0]
        norm, turn = np.linalg.norm(found.residual / size), float(np.abs(turning * change).max(initial=0.0))
        share = TURN / max(TURN, turn)
        # within the tolerance only the full step is tried
        for _ in range(1 if (np.abs(found.residual) <= found.scale).all() else HALVINGS):
            trial = z.copy()
            trial[free] += share * change
            after = evaluated(plant, trial, wanted, values)
            if after is not None and np.linalg.norm(after.residual / size) < norm:
                break
            share *= 0.5
        else:
            break
        z, found = trial, after
    if found is None:
        return z, np.inf, 0, None
    excess = np.abs(found.residual) / found.scale
    return z, float(excess.max(initial=0.0)), int(np.argmax(excess)) if len(excess) else 0, found.local


def evaluated(plant: Any, z: Array, wanted: Mapping[int, float], values: Values | None = None) -> _Evaluation | None:
    """Evaluate the plant at a point (x, u); None where it has no value."""
    n_x, rows, targets = len(plant.states), list(wanted), np.array(list(wanted.values()))
    try:
        local = plant.local_models(z[None, :n_x], z[None, n_x:], values)
    except NoTrustworthyNumber:
        return None
    residual = np.concatenate([local.rates[0], local.outputs[0][rows] - targets])
    slopes = np.vstack([np.hstack([local.A[0], local.B[0]]), np.hstack([local.C[0], local.D[0]])[rows]])
    terms = np.abs(slopes) @ np.abs(z) + np.concatenate([np.zeros(n_x), np.abs(targets)])
    return _Evaluation(residual, slopes, STILL * terms + FLOOR, local) if np.isfinite(residual).all() else None


def held_descriptor(
    plant: Any, x: Array, u: Array, hold: Sequence[str] | None, tried: Mapping[str, Values]
) -> TrimmedDescriptor:
    """Return the descriptor form about (x, u) as a function of the parameters."""
    states, inputs = [s.name for s in plant.states], [s.name for s in plant.inputs]
    places = plant.port_places
    ports = [states.index(place.name) for place in places]
    currents = {place.name for place in places if place.kind == "current"}
    names = [*states, *inputs]
    for name in hold or ():
        if name not in names:
            expected = f"of {', '.join(names)}"
            raise InputError(f"{plant.name}: hold", f"no state or input {name!r}", expected, did_you_mean(name, names))
    positions = {place.position for place in places if place.kind == "joint" and place.position}
    choices = [set(states) - currents, *([positions] if positions else []), set(inputs)]
    choices = [set(hold)] if hold is not None else choices
    refused: NoTrustworthyNumber | None = None
    for choice in choices:
        held = choice | {place.name for place in places if place.kind == "joint"}
        follow = np.array([k for k, name in enumerate(names) if name not in held], dtype=np.intp)
        start = np.concatenate([x, u])
        try:
            for label, values in tried.items():
                _following(plant, start, follow, values, f" ({label})")
        except NoTrustworthyNumber as error:
            refused = refused or error
            continue
        free = tuple(k for k in range(len(states)) if k not in ports)
        words = f"held: {', '.join(name for name in names if name in held) or 'nothing'}"
        words += f"; what follows: {', '.join(names[k] for k in follow)}" if len(follow) else ""

        def matrices(values: Values, follow: Indices = follow, start: Array = start) -> Array:
            return descriptor(_following(plant, start, follow, values), ports)

        return TrimmedDescriptor(matrices, words, free)
    assert refused is not None
    raise refused


def descriptor(local: Any, ports: Sequence[int]) -> Array:
    """Return N of `robustlab.dynamics.parametric_descriptor` from the local model at one point; ports: states."""
    a, b, c, d = local.A[0], local.B[0], local.C[0], local.D[0]
    e, inner = np.eye(len(a)), local.push[0][list(ports)]
    if len(ports) and np.linalg.matrix_rank(inner) == len(ports):
        e[np.ix_(ports, ports)] = np.linalg.inv(inner)
    return np.block([[e @ a, e @ b, -e], [c, d, np.zeros((len(c), len(a)))]])


def _following(plant: Any, start: Array, follow: Indices, values: Values, label: str = "") -> Any:
    """Return the local model at the equilibrium for these parameter values; only signals in ``follow`` move."""
    _, excess, row, local = newton(plant, start, follow, {}, values)
    if local is None:
        raise NoTrustworthyNumber(plant.name, f"no finite linear model with what is held{label}")
    if excess > 1.0:
        hint = "hold other states or inputs, so that the others can follow"
        found = f"no rest with what is held: {plant.states[row].name} moves{label}"
        raise NoTrustworthyNumber(plant.name, found, None, hint)
    return local
