r"""A linear model in descriptor form with Delta channels, closed to an uncertain state-space model.

.. math::
    E \dot x = F x + G u + L_x w, \quad y = C x + D u + L_y w, \qquad
    z = R\,[x; u; \dot x] + S w, \qquad w = \Delta z

gives, with :math:`\dot x = A x + B u + E^{-1} L_x w` put into z, the M of an upper LFT.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.errors import InputError
from robustlab.statespace import OperatingPoint, Signal, StateSpaceModel
from robustlab.structural import drop_unconnected
from robustlab.uncertainty.blocks import Block
from robustlab.uncertainty.lft import UncertainModel

__all__ = ["Channels", "ROUNDING", "closed_descriptor", "solved"]

# What counts as rounding where a rank is taken.
ROUNDING = 1e-12


class Signals(NamedTuple):
    """Inputs, outputs and states of a model."""

    inputs: Sequence[Signal]
    outputs: Sequence[Signal]
    states: Sequence[Signal]


class Channels(NamedTuple):
    """L (n_x + n_y, q), R (p, 2 n_x + n_u) and S (p, q) of the blocks, in their order."""

    left: Array
    right: Array
    inner: Array
    blocks: tuple[Block, ...]


def solved(e: Array, right: Array, where: str) -> Array:
    """``E^-1 right``; a small inductance in one row and a large mass in another say nothing of the rank of E.

    Raises InputError: E is singular.
    """
    size = np.abs(e).max(axis=1, initial=0.0)
    if (size == 0).any() or (len(e) and np.linalg.cond(e / size[:, None]) > 1 / ROUNDING):
        raise InputError(f"{where}: equations", "E is singular", "an equation for the rate of every state")
    return np.asarray(np.linalg.solve(e, right), dtype=float)


def closed_descriptor(
    nominal: StateSpaceModel,
    e: Array,
    channels: Channels,
    where: str,
    outputs: Sequence[str] | None = None,
    point: OperatingPoint | None = None,
) -> UncertainModel:
    """The uncertain model around a nominal one, whose descriptor form has E and these channels.

    ``outputs``: names of the outputs to keep; states that then neither show nor act are left out. All where left out.

    Raises InputError: a singular E, an output that there is not.
    """
    n, n_u, n_y = nominal.n_states, nominal.n_inputs, nominal.n_outputs
    left, right, inner, blocks = channels
    into_x = solved(e, left[:n], where) + 0.0  # no negative zeros
    r_x, r_u, r_rate = right[:, :n], right[:, n : n + n_u], right[:, n + n_u :]
    w_names = [f"{b.name}[{i + 1}]" if b.rows > 1 else b.name for b in blocks for i in range(b.rows)]
    z_names = [f"{b.name}[{i + 1}]" if b.cols > 1 else b.name for b in blocks for i in range(b.cols)]
    m = StateSpaceModel(
        nominal.A,
        np.hstack([into_x, nominal.B]),
        np.vstack([r_x + r_rate @ nominal.A, nominal.C]),
        np.block([[inner + r_rate @ into_x, r_u + r_rate @ nominal.B], [left[n:].reshape(n_y, -1), nominal.D]]),
        0.0,
        [*(f"w_{name}" for name in w_names), *nominal.inputs],
        [*(f"z_{name}" for name in z_names), *nominal.outputs],
        nominal.states,
        where=f"{where}: uncertain",
    )
    if outputs is None:
        return UncertainModel(m, blocks, point)
    kept = m.select(m.input_names, [*(f"z_{name}" for name in z_names), *outputs])
    # the operating point is one of all outputs
    return UncertainModel(drop_unconnected(kept), blocks)
