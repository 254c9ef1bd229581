"""Models with Delta channels in one interconnection: all operands side by side, then wires.

Zhou, Doyle, Glover, *Robust and Optimal Control* (1996), section 9.1.
"""

# Every interconnection of LFTs is an LFT in the same named blocks. A block name that occurs in several operands is
# one and the same uncertainty: its channels become one repeated block, which is then reduced. Signals keep their
# names; where two would be called the same, the later ones get _2, _3, ... A stable weight says how large a dynamic
# uncertainty is at each frequency; it goes into M, so that Delta stays normalised: w = Delta W z (side z), w = W
# Delta z (side w).

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean
from robustlab.signals import MAX_NAME
from robustlab.statespace import Signal, StateSpaceModel, append, series
from robustlab.uncertainty.blocks import Block, block_slices, structure_size
from robustlab.uncertainty.reduction import reduce_blocks
from robustlab.uncertainty.upper_lft import is_singular

# A model whose first channels are those of the blocks.
Part = tuple[StateSpaceModel, tuple[Block, ...]]


class Joint(NamedTuple):
    """All operands in one model with inputs (w, u) and outputs (z, y); equal names of blocks stand together."""

    model: StateSpaceModel
    q: int
    p: int
    blocks: tuple[Block, ...]
    merged: frozenset[str]


class Wiring(NamedTuple):
    """``u = K y + E v``, ``o = F y``: v are the inputs and o the outputs of the interconnection."""

    K: Array
    E: Array
    F: Array


def join(parts: Sequence[Part], where: str) -> Joint:
    """All operands side by side, not yet wired."""
    model = append(*(_plain(m, f"{i}", where=where) for i, (m, _) in enumerate(parts)))
    first_in, first_out = 0, 0
    channels: dict[str, tuple[list[Block], list[int], list[int]]] = {}
    rest_in: list[int] = []
    rest_out: list[int] = []
    for m, own in parts:
        q, p = structure_size(own)
        for block, (w, z) in zip(own, block_slices(own), strict=True):
            same, ins, outs = channels.setdefault(block.name, ([], [], []))
            same.append(block)
            ins += range(first_in + w.start, first_in + w.stop)
            outs += range(first_out + z.start, first_out + z.stop)
        rest_in += range(first_in + q, first_in + m.n_inputs)
        rest_out += range(first_out + p, first_out + m.n_outputs)
        first_in, first_out = first_in + m.n_inputs, first_out + m.n_outputs
    blocks = tuple(_merged(same, where) for same, _, _ in channels.values())
    order_in = [k for _, ins, _ in channels.values() for k in ins]
    order_out = [k for _, _, outs in channels.values() for k in outs]
    q, p = len(order_in), len(order_out)
    order_in, order_out = order_in + rest_in, order_out + rest_out
    states = unique_names([s for m, _ in parts for s in m.states])
    arranged = StateSpaceModel(
        model.A, model.B[:, order_in], model.C[order_out], model.D[np.ix_(order_out, order_in)], model.dt, states=states
    )
    merged = frozenset(name for name, (same, _, _) in channels.items() if len(same) > 1)
    return Joint(arranged, q, p, blocks, merged)


def _merged(same: list[Block], where: str) -> Block:
    """One block for the same uncertainty in several operands."""
    first = same[0]
    if len(same) == 1:
        return first
    name = f"{where}: block {first.name!r}"
    for other in same[1:]:
        if type(other) is not type(first):
            found = f"is a {type(first).__name__} in one operand and a {type(other).__name__} in another"
            raise InputError(name, found, "one uncertainty for one name", "rename one of the two blocks")
    return first.merged(same[1:], name)


def wired(joint: Joint, wiring: Wiring, inputs: Sequence[Signal], outputs: Sequence[Signal], where: str) -> Part:
    """Close the wires of an interconnection: y = C2 x + D21 w + D22 u with u = K y + E v."""
    m, q, p = joint.model, joint.q, joint.p
    n = m.n_states
    b2, c2, d12, d22 = m.B[:, q:], m.C[p:], m.D[:p, q:], m.D[p:, q:]
    around = wiring.K @ d22
    acyclic = _is_acyclic(around)
    if not acyclic and is_singular(around):
        found = "the loop is not well posed at Delta = 0 (every block at its nominal value): I - K D22 is singular"
        raise NoTrustworthyNumber(where, found)
    into = np.hstack([wiring.K @ c2, wiring.K @ m.D[p:, :q], wiring.E])
    if acyclic:  # (I - K D22)^-1 is a finite sum of powers: what is exact stays exact
        gain, rest = into, around @ into
        while rest.any():
            gain, rest = gain + rest, around @ rest
    else:
        gain = np.linalg.solve(np.eye(len(around)) - around, into)
    # from (x, w, v): what the interconnection's signals are, then the states, channels and outputs
    shown = wiring.F @ np.hstack([c2, m.D[p:, :q], np.zeros((len(c2), wiring.E.shape[1]))]) + wiring.F @ d22 @ gain
    change = np.vstack([b2, d12]) @ gain
    whole = np.block([[m.A, m.B[:, :q]], [m.C[:p], m.D[:p, :q]]])
    upper_part = np.hstack([whole, np.zeros((n + p, wiring.E.shape[1]))]) + change
    model = StateSpaceModel(
        upper_part[:n, :n],
        upper_part[:n, n:],
        np.vstack([upper_part[n:, :n], shown[:, :n]]),
        np.vstack([upper_part[n:, n:], shown[:, n:]]),
        m.dt,
        unique_names([*inputs, *_channel_names("w", joint.blocks)], len(inputs)),
        unique_names([*outputs, *_channel_names("z", joint.blocks)], len(outputs)),
        m.states,
        where=where,
    )
    blocks = joint.blocks
    if joint.merged:
        return reduce_blocks(model, blocks, names=joint.merged, keep=True)
    return model, blocks


def _channel_names(prefix: str, blocks: Sequence[Block]) -> list[Signal]:
    """Names of the Delta channels, for example ``w:k`` or ``w:k#2``."""
    names = []
    for b in blocks:
        count = b.rows if prefix == "w" else b.cols
        short = b.name[: MAX_NAME - 20]
        names += [f"{prefix}:{short}" if count == 1 else f"{prefix}:{short}#{k + 1}" for k in range(count)]
    return [Signal(name) for name in names]


def unique_names(given: Sequence[Signal], last: int = 0) -> list[Signal]:
    """Names made unique by ``_2``, ``_3``, ..., the first one kept; the first ``last`` signals are moved to the end."""
    taken: set[str] = set()
    result: list[Signal] = []
    for signal in given:
        name, count = signal.name, 1
        while name in taken:
            count += 1
            name = f"{signal.name[: MAX_NAME - 8]}_{count}"
        taken.add(name)
        result.append(signal if count == 1 else Signal(name, signal.unit))
    return [*result[last:], *result[:last]]


def _is_acyclic(matrix: Array) -> bool:
    """Whether the non-zero entries form no cycle: then I - matrix has determinant one whatever the entries are."""
    edges = matrix != 0
    alive = np.ones(len(edges), dtype=bool)
    while alive.any():
        leaves = alive & ~(edges[:, alive].any(axis=1))
        if not leaves.any():
            return False
        alive &= ~leaves
    return True


def weighted(
    m: StateSpaceModel, given: Sequence[Block], weights: Mapping[str, Any], side: str, read: Callable[[Any, str], Part]
) -> Part:
    """M and blocks with a stable weight in the channels of each named block; see `UncertainModel.weighted`."""
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


def _plain(
    m: StateSpaceModel, mark: str, states: list[str] | None = None, where: str = "StateSpaceModel"
) -> StateSpaceModel:
    """The model with names of signals that no other part has."""
    inputs, outputs = [f"i{mark}.{k}" for k in range(m.n_inputs)], [f"o{mark}.{k}" for k in range(m.n_outputs)]
    return StateSpaceModel(m.A, m.B, m.C, m.D, m.dt, inputs, outputs, states, where=where)


def _free(name: str, taken: set[str]) -> str:
    while name in taken:
        name = f"{name}'"
    taken.add(name)
    return name


def _numbered(prefix: str, count: int, taken: tuple[Signal, ...]) -> list[Signal]:
    names = {s.name for s in taken}
    return [Signal(_free(f"{prefix}{k + 1}", names)) for k in range(count)]
