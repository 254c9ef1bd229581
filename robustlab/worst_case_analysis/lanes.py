"""Responses of many members by the compiled kernels, for models that are worth loading them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robustlab.worst_case_analysis.ensemble import Ensemble, Hold, time_responses, transitions
from robustlab.worst_case_analysis.excitation import Excitation

__all__ = ["Lanes", "in_lanes", "responses"]

Array = NDArray[np.float64]
Entries = NDArray[np.int64]

# From this many products per member on, loading the compiled kernel is worth its time.
COMPILED_FROM = 20_000


@dataclass(frozen=True)
class Lanes:
    """Arrays as the kernels take them; see `robustlab.worst_case_analysis.response_kernels`."""

    matrices: tuple[Array, Array, Array, Array]
    c_entries: Entries
    d_entries: Entries
    u: Array
    v: Array
    x0: Array

    @property
    def arguments(self) -> tuple[Array, Array, Array, Array, Entries, Entries, Array, Array, Array]:
        """In the kernels' order."""
        return (*self.matrices, self.c_entries, self.d_entries, self.u, self.v, self.x0)


def in_lanes(ensemble: Ensemble, drive: Excitation, x0: Array, hold: Hold) -> Lanes:
    """The kernels' arrays for some members under one input."""
    used = np.flatnonzero(drive.u.any(axis=0))
    phi, gamma, slope = transitions(ensemble, drive.h, hold, used)
    u = np.ascontiguousarray(drive.u[:, used])
    v = u[:-1]
    if hold == "foh":
        gamma, v = np.concatenate([gamma, slope], axis=2), np.hstack([v, np.diff(u, axis=0)])
    d = ensemble.D[:, :, used]
    # Entries that are zero in every member cost nothing; which ones are, all members of a set share.
    where_c, where_d = (np.argwhere((matrix != 0).any(axis=0)) for matrix in (ensemble.C, d))
    grouped = (_grouped(phi), _grouped(gamma), _grouped(ensemble.C), _grouped(d))
    entries = [np.ascontiguousarray(where.reshape(-1, 2), dtype=np.int64) for where in (where_c, where_d)]
    return Lanes(grouped, entries[0], entries[1], u, np.ascontiguousarray(v), np.array(x0, dtype=float))


def _grouped(matrices: Array) -> Array:
    """(k, r, c) as (n_groups, r, c, LANES), zeros after the last."""
    from robustlab.worst_case_analysis.response_kernels import LANES

    k, rows, columns = matrices.shape
    groups = -(-k // LANES)
    whole = np.zeros((groups * LANES, rows, columns))
    whole[:k] = matrices
    return np.ascontiguousarray(whole.reshape(groups, LANES, rows, columns).transpose(0, 2, 3, 1))


def responses(ensemble: Ensemble, drive: Excitation, x0: Array, hold: Hold, out: Array | None = None) -> Array:
    """Outputs of all (real) members (k, n_t, n_y), by the way that suits the size of one of them.

    The choice depends on the model and the clock alone, so that a member's response does not depend on how many others
    are asked for.
    """
    n_t, n_y = len(drive.u), ensemble.C.shape[1]
    if n_t * max(1, len(x0)) ** 2 < COMPILED_FROM:
        found = time_responses(ensemble, drive.h, drive.u, x0, hold)
        if out is None:
            return found
        out[:] = found
        return out
    from robustlab.worst_case_analysis.response_kernels import respond

    out = np.empty((len(ensemble), n_t, n_y)) if out is None else out
    with np.errstate(over="ignore", invalid="ignore"):
        respond(*in_lanes(ensemble, drive, x0, hold).arguments, out)
    return out
