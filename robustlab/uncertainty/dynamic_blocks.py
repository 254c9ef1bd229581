r"""Dynamic (unmodelled) uncertainty with weights.

A `FullBlock` or `ComplexScalar` stands for every stable linear time-invariant :math:`\Delta(s)` of gain at most one.
A stable weight says how large the uncertainty is at each frequency; it goes into M, so that Delta stays normalised:

.. math:: w = \Delta \, W z \quad (\text{side } z), \qquad w = W \Delta \, z \quad (\text{side } w)

References
----------
Březina 2010, section 4.2; Zhou, Doyle, Glover, *Robust and Optimal Control* (1996), section 9.1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from robustlab.errors import InputError, did_you_mean
from robustlab.statespace import Signal, StateSpaceModel, append, series
from robustlab.uncertainty.blocks import Block, structure_size
from robustlab.uncertainty.interconnection import Part


def weighted(
    m: StateSpaceModel, given: Sequence[Block], weights: Mapping[str, Any], side: str, read: Callable[[Any, str], Part]
) -> Part:
    """M and blocks with a stable weight in the channels of each named block; see `UncertainModel.weighted`.

    ``read(weight, where)`` makes M and blocks of what was given as a weight, once it is known to be wanted.

    Raises
    ------
    InputError
        No such block, a real block (its range is its weight), a weight that is unstable, of another sample time or of
        a size that does not fit.
    """
    if side not in ("z", "w"):
        raise InputError("weighted", f"side {side!r}", "'z' (before Delta) or 'w' (after it)")
    names = tuple(b.name for b in given)
    for name in weights:
        if name not in names:
            expected = f"one of {', '.join(names) or 'none'}"
            raise InputError(f"weighted: {name!r}", "no such block", expected, did_you_mean(name, names))
    parts: list[StateSpaceModel] = []
    blocks: list[Block] = []
    for i, block in enumerate(given):
        size = block.cols if side == "z" else block.rows
        if block.name in weights:
            weight, block = _weight(block, weights[block.name], side, read)
        else:
            weight = StateSpaceModel([], [], [], np.eye(size), m.dt)
        parts.append(_plain(weight, f"{i}", [f"{block.name}: {s.name}" for s in weight.states]))
        blocks.append(block)
    q, p = structure_size(given)
    free_in, free_out = m.inputs[q:], m.outputs[p:]
    rest = free_out if side == "z" else free_in
    through = StateSpaceModel([], [], [], np.eye(len(rest)), m.dt)
    bank = append(*parts, _plain(through, "rest", []))
    base = StateSpaceModel(m.A, m.B, m.C, m.D, m.dt)  # units meet no units: a weight carries any
    whole = series(base, bank) if side == "z" else series(bank, base)
    order = [*range(m.n_states), *range(m.n_states, whole.n_states)]
    if side == "w":  # series puts the bank's states first
        order = [*range(bank.n_states, whole.n_states), *range(bank.n_states)]
    taken = {s.name for s in m.states}
    states = [*m.states, *(Signal(_free(s.name, taken), s.unit) for s in bank.states)]
    after_q, after_p = structure_size(blocks)
    inputs = [*(m.inputs[:q] if after_q == q else _numbered("w:", after_q, free_in)), *free_in]
    outputs = [*(m.outputs[:p] if after_p == p else _numbered("z:", after_p, free_out)), *free_out]
    model = StateSpaceModel(
        whole.A[np.ix_(order, order)], whole.B[order], whole.C[:, order], whole.D, m.dt, inputs, outputs, states,
        where="weighted",
    )  # fmt: skip
    return model, tuple(blocks)


def _weight(block: Block, given: Any, side: str, read: Callable[[Any, str], Part]) -> tuple[StateSpaceModel, Block]:
    """The weight on all channels of one block, and the block that is left for Delta."""
    where = f"weighted: {block.name!r}"
    if block.is_real:
        raise InputError(where, "a real parameter", "a full or complex block", "a parameter's range is its weight")
    weight, own = read(given, where)
    if own:
        raise InputError(where, "an uncertain weight", "a model without uncertainty")
    if weight.n_states and not weight.is_stable():
        raise InputError(where, f"an unstable weight (abscissa {weight.spectral_abscissa():.6g})", "a stable weight")
    size = block.cols if side == "z" else block.rows
    shape = weight.n_outputs, weight.n_inputs
    if shape == (1, 1):
        copies = [_plain(weight, f"{k}", [f"{s.name}#{k + 1}" if size > 1 else s.name for s in weight.states])
                  for k in range(size)]  # fmt: skip
        return append(*copies), block
    if block.is_scalar:
        raise InputError(where, f"a weight of {shape[0]} x {shape[1]}", "1 x 1 for a scalar block")
    if shape[side == "z"] != size or 0 in shape:
        wanted = f"n x {size}" if side == "z" else f"{size} x n"
        raise InputError(where, f"a weight of {shape[0]} x {shape[1]}", f"1 x 1 or {wanted} (side {side})")
    return weight, block.resized(block.rows, shape[0]) if side == "z" else block.resized(shape[1], block.cols)


def _plain(system: StateSpaceModel, mark: str, states: list[str]) -> StateSpaceModel:
    inputs = [f"i{mark}.{k}" for k in range(system.n_inputs)]
    outputs = [f"o{mark}.{k}" for k in range(system.n_outputs)]
    return StateSpaceModel(system.A, system.B, system.C, system.D, system.dt, inputs, outputs, states)


def _free(name: str, taken: set[str]) -> str:
    while name in taken:
        name = f"{name}'"
    taken.add(name)
    return name


def _numbered(prefix: str, count: int, taken: tuple[Signal, ...]) -> list[Signal]:
    names = {s.name for s in taken}
    return [Signal(_free(f"{prefix}{k + 1}", names)) for k in range(count)]
