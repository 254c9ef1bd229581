r"""Points at which a nonlinear plant stays, with some of its states, inputs and outputs held.

.. math:: f(x, u) = 0, \qquad x_i = \bar x_i, \quad u_j = \bar u_j, \quad h_k(x, u) = \bar y_k

Newton's method with the exact Jacobian, in steps of least length, each shortened until the residual falls; where the
plant rests at many points, then along them to the one nearest to the start.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from robustlab.arrays import Array, Indices, Mask
from robustlab.dynamics.plant_contract import NonlinearPlant, Trim
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean
from robustlab.result import Status
from robustlab.statespace import real_array

__all__ = ["rest"]

PASSES, HALVINGS = 60, 30
# A plant is at rest where no rate is more than this share of the terms that make it up, or than this many units/s.
STILL, FLOOR = 1e-10, 1e-13
# A residual below this share is told as INACCURATE; above it there is no rest.
NEAR = 1e-6
# Singular values below this share of the largest are directions in which the plant may rest anywhere.
RANK = 1e-11
# A step turns no coordinate by more than this (rad): the equations turn with it.
TURN = 0.5
# The rest that is nearest to where the search began is found to this share.
AGREED = 1e-9
# Where Newton's method stalls at zero (a force that grows with the square of a speed), it starts again from these.
STARTS = (1.0, 0.1, 10.0, -1.0)


def rest(plant: NonlinearPlant, where: Mapping[str, Any]) -> Trim:
    """The rest nearest to zero, or to ``where["start"]``, with the other entries of ``where`` held."""
    n_x, n_u = len(plant.states), len(plant.inputs)
    given = dict(where)
    x, u = plant.point(*given.pop("start")) if "start" in given else (np.zeros(n_x), np.zeros(n_u))
    began = np.concatenate([x, u])
    held, wanted = _held(plant, given)
    began[list(held)] = list(held.values())
    free = np.array([k for k in range(n_x + n_u) if k not in held], dtype=np.intp)
    starts = [began] + ([] if "start" in where else [_shifted(began, free, level) for level in STARTS])
    best = np.inf, began, 0
    for start in starts:
        z, excess, row = _newton(plant, start, free, wanted)
        if excess < best[0]:
            best = excess, z, row
        if excess <= 1.0:
            break
    excess, z, row = best
    if not excess <= NEAR / STILL:
        names = [f"the rate of {s.name}" for s in plant.states] + [f"output {plant.outputs[k].name}" for k in wanted]
        asked = ", ".join(f"{k} = {v:g}" for k, v in given.items()) or "zero inputs"
        raise NoTrustworthyNumber(
            plant.name,
            f"no rest was found with {asked}: {names[row]} stays off",
            None,
            "hold other states, inputs or outputs, or give start=(x, u) near to it",
        )
    z, excess = _nearest(plant, began, (z, excess), free, wanted)
    x, u = z[:n_x], z[n_x:]
    residual = float(np.abs(plant.derivative(x, u)).max(initial=0.0))
    status = Status.CONVERGED if excess <= 1.0 else Status.INACCURATE
    return Trim(plant.name, x.copy(), u.copy(), plant.output(x, u), residual, None, status)


def _held(plant: NonlinearPlant, given: Mapping[str, Any]) -> tuple[dict[int, float], dict[int, float]]:
    """Places in (x, u) -> value, and outputs -> value; a name of both is the state's or input's."""
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
            raise InputError(
                f"{plant.name}: trim: {name!r}",
                "no state, input or output",
                f"one of {', '.join(known)}",
                did_you_mean(name, known),
            )
    return held, wanted


def _shifted(began: Array, free: Indices, level: float) -> Array:
    start = began.copy()
    start[free] += level
    return start


def _nearest(
    plant: NonlinearPlant, began: Array, found: tuple[Array, float], free: Indices, wanted: Mapping[int, float]
) -> tuple[Array, float]:
    """The rest moved towards where the search began, along all directions in which the plant rests anywhere."""
    for _ in range(PASSES):
        z, excess = found
        local = _residual(plant, z, wanted)
        if local is None:
            break
        way = (began - z)[free]
        part = local[1][:, free]
        size = np.abs(part).max(axis=1, initial=0.0)
        size[size == 0.0] = 1.0
        way = way - np.linalg.lstsq(part / size[:, None], part @ way / size, rcond=RANK)[0]
        trial = z.copy()
        trial[free] += way
        if np.linalg.norm(way) <= AGREED * (1.0 + np.linalg.norm(z)):
            break
        after = _newton(plant, trial, free, wanted)
        if after[1] > max(1.0, excess) or np.linalg.norm(after[0] - began) >= np.linalg.norm(z - began):
            break
        found = after[:2]
    return found


def _newton(
    plant: NonlinearPlant, start: Array, free: Indices, wanted: Mapping[int, float]
) -> tuple[Array, float, int]:
    """The point reached, its residual as a multiple of what counts as rest, and the equation of the largest one."""
    z, step_left = start.copy(), PASSES
    found = _residual(plant, z, wanted)
    while found is not None and step_left:
        step_left -= 1
        residual, jacobian, scale = found
        if (np.abs(residual) <= scale).all():
            break
        part = jacobian[:, free]
        size = np.abs(part).max(axis=1, initial=0.0)
        size[size == 0.0] = 1.0
        change = np.linalg.lstsq(part / size[:, None], -residual / size, rcond=RANK)[0]
        turn = np.abs(change[_angles(plant)[free]]).max(initial=0.0)
        norm, share = float(np.linalg.norm(residual / size)), 1.0 if turn <= TURN else TURN / turn
        for _ in range(HALVINGS):
            trial = z.copy()
            trial[free] += share * change
            after = _residual(plant, trial, wanted)
            if after is not None and np.linalg.norm(after[0] / size) < norm:
                break
            share *= 0.5
        else:
            break
        z, found = trial, after
    if found is None:
        return z, np.inf, 0
    excess = np.abs(found[0]) / found[2]
    row = int(np.argmax(excess)) if len(excess) else 0
    return z, float(excess.max(initial=0.0)), row


def _angles(plant: NonlinearPlant) -> Mask:
    return np.array([s.unit == "rad" for s in (*plant.states, *plant.inputs)])


def _residual(plant: NonlinearPlant, z: Array, wanted: Mapping[int, float]) -> tuple[Array, Array, Array] | None:
    """Residual (n,), its Jacobian (n, n_x + n_u), and what counts as rest (n,); None where the plant has no value."""
    n_x, rows = len(plant.states), list(wanted)
    try:
        local = plant.local_models(z[None, :n_x], z[None, n_x:])
    except NoTrustworthyNumber:
        return None
    residual = np.concatenate([local.rates[0], local.outputs[0][rows] - list(wanted.values())])
    jacobian = np.vstack([np.hstack([local.A[0], local.B[0]]), np.hstack([local.C[0], local.D[0]])[rows]])
    terms = np.abs(jacobian) @ np.abs(z) + np.concatenate([np.zeros(n_x), np.abs(list(wanted.values()))])
    return residual, jacobian, STILL * terms + FLOOR
