"""Interconnections of models with Delta channels: block-diagonal operands, then wires.

Zhou, Doyle, Glover, *Robust and Optimal Control* (1996), section 9.1.
"""

# Every interconnection of LFTs is an LFT in the same named blocks; a plain model is one without blocks. A block name
# in several operands is the same uncertainty: its channels become one repeated block, which is then reduced. Signals
# keep their names; of equal ones the later get _2, _3, ... A stable weight, the size of a dynamic uncertainty at each
# frequency, becomes part of M, so that Delta stays normalised: w = Delta W z (side z), w = W Delta z (side w).

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean
from robustlab.signals import MAX_NAME
from robustlab.statespace import Signal, StateSpaceModel, append
from robustlab.uncertainty.blocks import Block, block_slices, structure_size
from robustlab.uncertainty.upper_lft import is_singular

Part = tuple[StateSpaceModel, tuple[Block, ...]]  # a model whose first channels are those of the blocks


class Wiring(NamedTuple):
    """``u = K y + E v``, ``o = F y``: v are the inputs and o the outputs of the interconnection."""

    K: Array
    E: Array
    F: Array


def ones(rows: int, cols: int, *wires: tuple[int, int, int]) -> Array:
    """Return a matrix of zeros with an identity of ``size`` at each ``(row, column, size)``."""
    matrix = np.zeros((rows, cols))
    for row, col, size in wires:
        matrix[row : row + size, col : col + size] = np.eye(size)
    return matrix


def joined(
    parts: Sequence[Part], wiring: Wiring, inputs: Sequence[Signal], outputs: Sequence[Signal], where: str
) -> Part:
    """Return the wired model of all operands; y and u of the wiring are their signals in this order."""
    channels: dict[str, tuple[list[Block], list[int], list[int]]] = {}
    u: list[int] = []
    y: list[int] = []
    first_in, first_out = 0, 0
    for m, own in parts:
        q, p = structure_size(own)
        for block, (w, z) in zip(own, block_slices(own), strict=True):
            same, ins, outs = channels.setdefault(block.name, ([], [], []))
            same.append(block)
            ins += range(first_in + w.start, first_in + w.stop)
            outs += range(first_out + z.start, first_out + z.stop)
        u += range(first_in + q, first_in + m.n_inputs)
        y += range(first_out + p, first_out + m.n_outputs)
        first_in, first_out = first_in + m.n_inputs, first_out + m.n_outputs
    blocks = tuple(_merged(same, where) for same, _, _ in channels.values())
    w, z = ([k for places in channels.values() for k in places[side]] for side in (1, 2))
    m = append(*(unnamed(m, f"{i}", where) for i, (m, _) in enumerate(parts)))
    whole, n = np.block([[m.A, m.B], [m.C, m.D]]), m.n_states
    inner = whole[np.ix_([*range(n), *(n + k for k in z)], [*range(n), *(n + k for k in w)])]
    into, out = whole[[*range(n), *(n + k for k in z)]][:, [n + k for k in u]], whole[[n + k for k in y]]
    out, d22 = out[:, [*range(n), *(n + k for k in w)]], m.D[np.ix_(y, u)]
    # y = out (x, w) + D22 u, u = K y + E v = gain (x, w, v)
    around, n_v = wiring.K @ d22, wiring.E.shape[1]
    acyclic = _is_acyclic(around)
    if not acyclic and is_singular(around):
        found = "the loop is not well posed at Delta = 0 (every block at its nominal value): I - K D22 is singular"
        raise NoTrustworthyNumber(where, found)
    gain = rest = np.hstack([wiring.K @ out, wiring.E])
    if acyclic:  # (I - K D22)^-1 is a finite sum of powers: exact entries stay exact
        while (rest := around @ rest).any():
            gain = gain + rest
    else:
        gain = np.linalg.solve(np.eye(len(around)) - around, gain)
    shown = wiring.F @ np.hstack([out, np.zeros((len(out), n_v))]) + wiring.F @ d22 @ gain
    whole = np.vstack([np.hstack([inner, np.zeros((len(inner), n_v))]) + into @ gain, shown])
    signals = channels_first(blocks, inputs, outputs)
    states = unique_names([s for m, _ in parts for s in m.states])
    model = StateSpaceModel(
        whole[:n, :n], whole[:n, n:], whole[n:, :n], whole[n:, n:], m.dt, *signals, states, where=where
    )
    merged = [name for name, (same, _, _) in channels.items() if len(same) > 1]
    if not merged:
        return model, blocks
    from robustlab.uncertainty.reduction import reduce_blocks  # files of sets are read without it

    return reduce_blocks(model, blocks, names=merged, keep=True)


def unnamed(m: StateSpaceModel, mark: str, where: str = "StateSpaceModel") -> StateSpaceModel:
    """Return the model with unique names of signals."""
    inputs, outputs = [f"i{mark}.{k}" for k in range(m.n_inputs)], [f"o{mark}.{k}" for k in range(m.n_outputs)]
    return StateSpaceModel(m.A, m.B, m.C, m.D, m.dt, inputs, outputs, where=where)


def _merged(same: list[Block], where: str) -> Block:
    """Merge the blocks of the same uncertainty in several operands."""
    first = same[0]
    if len(same) == 1:
        return first
    name = f"{where}: block {first.name!r}"
    for other in same[1:]:
        if type(other) is not type(first):
            found = f"is a {type(first).__name__} in one operand and a {type(other).__name__} in another"
            raise InputError(name, found, "one uncertainty for one name", "rename one of the two blocks")
    return first.merged(same[1:], name)


def channels_first(
    blocks: Sequence[Block], inputs: Sequence[Signal], outputs: Sequence[Signal]
) -> tuple[list[Signal], list[Signal]]:
    """Return inputs and outputs of M: the channels, named ``w:k`` or ``w:k#2``, then the signals with their names."""
    sides = []
    for prefix, size, signals in (("w", "rows", inputs), ("z", "cols", outputs)):
        names = [(b.name[: MAX_NAME - 20], k, getattr(b, size)) for b in blocks for k in range(getattr(b, size))]
        made = [Signal(f"{prefix}:{name}" if n == 1 else f"{prefix}:{name}#{k + 1}") for name, k, n in names]
        unique = unique_names([*signals, *made])
        sides.append([*unique[len(signals) :], *unique[: len(signals)]])
    return sides[0], sides[1]


def unique_names(given: Sequence[Signal]) -> list[Signal]:
    """Make names unique by ``_2``, ``_3``, ..., keeping the first one."""
    taken: set[str] = set()
    result: list[Signal] = []
    for signal in given:
        name, count = signal.name, 1
        while name in taken:
            count += 1
            name = f"{signal.name[: MAX_NAME - 8]}_{count}"
        taken.add(name)
        result.append(signal if count == 1 else Signal(name, signal.unit))
    return result


def _is_acyclic(matrix: Array) -> bool:
    """Return whether the non-zero entries form no cycle, so that I - matrix has determinant one."""
    edges = matrix != 0
    alive = np.ones(len(edges), dtype=bool)
    while alive.any():
        leaves = alive & ~(edges[:, alive].any(axis=1))
        if not leaves.any():
            return False
        alive &= ~leaves
    return True


def recentred(M: StateSpaceModel, blocks: Sequence[Block], centre: Array, scale: Array, where: str) -> StateSpaceModel:
    """Return M for Delta' with Delta = ``centre + scale Delta'``: ``w = centre z + scale w'``."""
    q, p = structure_size(blocks)
    K, E = np.zeros((M.n_inputs, M.n_outputs)), np.eye(M.n_inputs)
    K[:q, :p], E[:q, :q] = centre, scale
    return joined([(M, ())], Wiring(K, E, np.eye(M.n_outputs)), M.inputs, M.outputs, where)[0]


def weighted(M: StateSpaceModel, given: Sequence[Block], weights: Mapping[str, Part], side: str) -> Part:
    """Return M and blocks with a stable weight in the channels of each named block; see `UncertainModel.weighted`."""
    if side not in ("z", "w"):
        raise InputError("weighted", f"side {side!r}", "'z' (before Delta) or 'w' (after it)")
    names = tuple(b.name for b in given)
    for name in weights:
        if name not in names:
            expected = f"one of {', '.join(names) or 'none'}"
            raise InputError(f"weighted: {name!r}", "no such block", expected, did_you_mean(name, names))
    parts, blocks, wires = [M], list(given), []
    channels: list[int] = []  # the channels of the result on that side
    (q, p), n_in, n_out = structure_size(given), M.n_inputs, M.n_outputs
    for i, (block, (w, z)) in enumerate(zip(given, block_slices(given), strict=True)):
        if block.name not in weights:
            channels += range(z.start, z.stop) if side == "z" else range(w.start, w.stop)
            continue
        weight, blocks[i] = _weight(block, weights[block.name], side)
        parts.append(weight)
        wires.append((n_in, z.start, block.cols) if side == "z" else (w.start, n_out, block.rows))
        after_in, after_out = n_in + weight.n_inputs, n_out + weight.n_outputs
        channels += range(n_out, after_out) if side == "z" else range(n_in, after_in)
        n_in, n_out = after_in, after_out
    E, F = np.eye(n_in)[:, : M.n_inputs], np.eye(n_out)[: M.n_outputs]
    if side == "z":
        F = np.eye(n_out)[[*channels, *range(p, M.n_outputs)]]
    else:
        E = np.eye(n_in)[:, [*channels, *range(q, M.n_inputs)]]
    sides = channels_first(blocks, M.inputs[q:], M.outputs[p:])
    found, _ = joined([(m, ()) for m in parts], Wiring(ones(n_in, n_out, *wires), E, F), *sides, "weighted")
    return found, tuple(blocks)


def _weight(block: Block, given: Part, side: str) -> tuple[StateSpaceModel, Block]:
    """Return the weight on all channels of one block, and the remaining block of Delta."""
    where = f"weighted: {block.name!r}"
    if block.is_real:
        raise InputError(where, "a real parameter", "a full or complex block", "a parameter's range is its weight")
    weight, own = given
    if own:
        raise InputError(where, "an uncertain weight", "a model without uncertainty")
    if weight.n_states and not weight.is_stable():
        raise InputError(where, f"an unstable weight (abscissa {weight.spectral_abscissa():.6g})", "a stable weight")
    size = block.cols if side == "z" else block.rows
    shape = weight.n_outputs, weight.n_inputs
    if shape == (1, 1):
        A, B, C, D = (np.kron(np.eye(size), X) for X in (weight.A, weight.B, weight.C, weight.D))
        marks = [f"#{k + 1}" if size > 1 else "" for k in range(size)]
        states = [f"{block.name}: {s.name}{mark}" for mark in marks for s in weight.states]
        return StateSpaceModel(A, B, C, D, weight.dt, states=states), block
    if block.is_scalar:
        raise InputError(where, f"a weight of {shape[0]} x {shape[1]}", "1 x 1 for a scalar block")
    if shape[side == "z"] != size or 0 in shape:
        wanted = f"n x {size}" if side == "z" else f"{size} x n"
        raise InputError(where, f"a weight of {shape[0]} x {shape[1]}", f"1 x 1 or {wanted} (side {side})")
    states = [f"{block.name}: {s.name}" for s in weight.states]
    weight = StateSpaceModel(weight.A, weight.B, weight.C, weight.D, weight.dt, states=states)
    return weight, block.resized(block.rows, shape[0]) if side == "z" else block.resized(shape[1], block.cols)
