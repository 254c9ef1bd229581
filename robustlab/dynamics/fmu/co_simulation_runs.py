"""Co-simulation in the child: a unit steps itself from one communication point to the next."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.fmu.native_unit import NativeUnit
from robustlab.errors import NoTrustworthyNumber

__all__ = ["linear_matrices", "stepped"]


def stepped(unit: NativeUnit, values: Mapping[str, float], t: Array, u: Array, longest: float) -> list[Array]:
    """Outputs (n, n_y) at the times t for inputs (n, n_u) held between them; steps of at most ``longest`` s."""
    unit.begin(values, float(t[0]), u[0])
    found = np.empty((len(t), unit.outputs.n))
    for k, time in enumerate(t.tolist()):
        unit.set_inputs(u[k])
        found[k] = unit.get_outputs()
        if not np.isfinite(found[k]).all():
            j = int(np.argmin(np.isfinite(found[k])))
            raise unit.failed(f"{unit.description['outputs'][j]['name']} is {found[k, j]:g} at t = {time:.9g} s")
        if k + 1 < len(t):
            length = t[k + 1] - time
            pieces = max(int(np.ceil(length / longest - 1e-9)), 1)
            for piece in range(pieces):
                unit.step(time + piece * length / pieces, length / pieces)
    return [found]


def linear_matrices(unit: NativeUnit, values: Mapping[str, float], u: Array) -> list[Array]:
    """``[[A, B], [C, D]]`` at the unit's initial state, by its directional derivatives; and the outputs there."""
    unit.begin(values, 0.0, u)
    slopes = unit.directional(unit.states.n + unit.inputs.n)
    if not np.isfinite(slopes).all():
        raise NoTrustworthyNumber(unit.name, "its directional derivatives are not finite", None)
    states = np.array([unit.value(v["reference"]) for v in unit.description["states"]])
    return [slopes, states, unit.get_outputs()]
