"""The closed loop of an LPV plant and an LPV controller, as an LPV model with the error between the points proved."""

from __future__ import annotations

from itertools import product

import numpy as np

from robustlab.arrays import Array
from robustlab.errors import InputError
from robustlab.statespace import Signal
from robustlab.synthesis.problem.partition import PlantMatrices
from robustlab.synthesis.scheduling.parameter_varying import EXACT, KNOWN, PROVED, LPVModel

__all__ = ["closed_loop", "plant_matrices"]


def plant_matrices(plant: LPVModel, n_meas: int, n_con: int, where: str) -> list[PlantMatrices]:
    """The generalised plants at the points of the grid."""
    n, (n_z, n_w) = plant.n_states, _performance(plant, n_meas, n_con, where)
    m = plant.matrices.reshape(-1, *plant.matrices.shape[-2:])
    if m[:, n + n_z :, n + n_w :].any() or plant.deviation[..., n + n_z :, n + n_w :].any():
        hint = "put a fast lag between controls and measurements"
        raise InputError(where, "a direct term from the controls to the measurements (D22)", "D22 = 0", hint)
    rows = slice(None, n), slice(n, n + n_z), slice(n + n_z, None)
    cols = slice(None, n), slice(n, n + n_w), slice(n + n_w, None)
    order = ((0, 0), (0, 1), (0, 2), (1, 0), (2, 0), (1, 1), (1, 2), (2, 1))
    return [PlantMatrices(*(np.array(one[rows[i], cols[j]]) for i, j in order)) for one in m]


def _performance(plant: LPVModel, n_meas: int, n_con: int, where: str) -> tuple[int, int]:
    n_z, n_w = len(plant.outputs) - n_meas, len(plant.inputs) - n_con
    for word, count, left in (("n_meas", n_meas, n_z), ("n_con", n_con, n_w)):
        if isinstance(count, bool) or not isinstance(count, (int, np.integer)) or count < 1 or left < 1:
            found = f"{word} = {count!r} of a plant with {len(plant.inputs)} inputs and {len(plant.outputs)} outputs"
            raise InputError(where, found, "at least one, and at least one w and z beside them")
    return n_z, n_w


def closed_loop(plant: LPVModel, law: LPVModel, where: str) -> LPVModel:
    """The loop from w to z of ``u = K(rho) y``; the law on the grid of the plant, whose last signals are its own."""
    n_meas, n_con = len(law.inputs), len(law.outputs)
    n_z, n_w = _performance(plant, n_meas, n_con, where)
    n, n_k = plant.n_states, law.n_states

    def parts(m: Array) -> tuple[Array, Array, Array]:
        """P, U and V of stacked plants (or of bounds of their entries), states (x, x_k)."""
        lead = m.shape[:-2]
        P = np.zeros((*lead, n + n_k + n_z, n + n_k + n_w))
        U, V = np.zeros((*lead, n + n_k + n_z, n_k + n_con)), np.zeros((*lead, n_k + n_meas, n + n_k + n_w))
        for at, own in ((slice(0, n), slice(0, n)), (slice(n + n_k, None), slice(n, n + n_z))):
            P[..., at, :n], P[..., at, n + n_k :] = m[..., own, :n], m[..., own, n : n + n_w]
            U[..., at, n_k:] = m[..., own, n + n_w :]
        V[..., n_k:, :n], V[..., n_k:, n + n_k :] = m[..., n + n_z :, :n], m[..., n + n_z :, n : n + n_w]
        return P, U, V

    P, U, V = parts(plant.matrices)
    U[..., n : n + n_k, :n_k] = V[..., :n_k, n : n + n_k] = np.eye(n_k)
    states = [*plant.states, *(Signal(f"k{i + 1}") for i in range(n_k))]
    # The plant's own deviation and the products' curvature.
    e_P, e_U, e_V = parts(plant.deviation)
    deviation = np.zeros((*plant.deviation.shape[:-2], *P.shape[-2:]))
    for cell in plant.cells():
        (u, d_u), (k, d_k), (v, d_v) = (_largest(m, cell) for m in (U, law.matrices, V))
        bend = sum(0.25 * (du @ dk @ v + du @ k @ dv + u @ dk @ dv) for du, dk, dv in zip(d_u, d_k, d_v, strict=True))
        eu, ev = e_U[cell], e_V[cell]
        deviation[cell] = e_P[cell] + bend + eu @ k @ (v + ev) + u @ k @ ev
    known = plant.known
    if deviation.any():
        deviation *= 1 + 1e-12
        known = max(known, PROVED, key=KNOWN.index)
    return LPVModel.of(
        plant.parameters, P + U @ law.matrices @ V, n + n_k, plant.inputs[:n_w], plant.outputs[:n_z], states,
        deviation, known if deviation.any() else EXACT,
    )  # fmt: skip


def _largest(m: Array, cell: tuple[int, ...]) -> tuple[Array, list[Array]]:
    """Largest absolute entries over the vertices of a cell, and of the changes along each parameter."""
    k = len(cell)
    corner = m[tuple(slice(i, i + 2) for i in cell)]
    changes = [np.abs(np.diff(corner, axis=axis)).reshape(-1, *m.shape[-2:]).max(axis=0) for axis in range(k)]
    return np.max([np.abs(corner[at]) for at in product((0, 1), repeat=k)], axis=0), changes
