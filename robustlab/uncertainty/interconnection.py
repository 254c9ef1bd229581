"""Interconnections of models with Delta channels: block-diagonal operands, then wires.

Zhou, Doyle, Glover, *Robust and Optimal Control* (1996), section 9.1.
"""

# Every interconnection of LFTs is an LFT in the same named blocks; a plain model is one without blocks. A block name
# in several operands is the same uncertainty: its channels become one repeated block, which is then reduced. Signals
# keep their names; of equal ones the later get _2, _3, ...

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import AnyArray, Array
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.linear_analysis.matrices import balancing_factors, of_system_matrix, system_matrix
from robustlab.linear_analysis.structural import strong_components
from robustlab.signals import MAX_NAME
from robustlab.statespace import Signal, StateSpaceModel, append
from robustlab.uncertainty.blocks import Block, block_slices, structure_size

ILL_POSED = 1e12  # condition number of I - M11 Delta above which results are rounding

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
    whole, n = system_matrix(m), m.n_states
    inner = whole[np.ix_([*range(n), *(n + k for k in z)], [*range(n), *(n + k for k in w)])]
    into, out = whole[[*range(n), *(n + k for k in z)]][:, [n + k for k in u]], whole[[n + k for k in y]]
    out, d22 = out[:, [*range(n), *(n + k for k in w)]], m.D[np.ix_(y, u)]
    # y = out (x, w) + D22 u, u = K y + E v = gain (x, w, v)
    around, n_v = wiring.K @ d22, wiring.E.shape[1]
    single = not around.any() or len(set(strong_components(around != 0))) == len(around)
    acyclic = single and not around.diagonal().any()
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
    states = unique_names([s for m, _ in parts for s in m.states])
    model = of_system_matrix(whole, n, m.dt, *channels_first(blocks, inputs, outputs), states, where)
    merged = [name for name, (same, _, _) in channels.items() if len(same) > 1]
    if not merged:
        return model, blocks
    from robustlab.uncertainty.reduction import reduce_each  # files of sets are read without it

    return reduce_each(model, blocks, merged)


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


def recentred(M: StateSpaceModel, blocks: Sequence[Block], centre: Array, scale: Array, where: str) -> StateSpaceModel:
    """Return M for Delta' with Delta = ``centre + scale Delta'``: ``w = centre z + scale w'``."""
    q, p = structure_size(blocks)
    K, E = np.zeros((M.n_inputs, M.n_outputs)), np.eye(M.n_inputs)
    K[:q, :p], E[:q, :q] = centre, scale
    return joined([(M, ())], Wiring(K, E, np.eye(M.n_outputs)), M.inputs, M.outputs, where)[0]


# --- closed by a constant Delta ---------------------------------------------------------------------------------------


def is_singular(product: ArrayLike) -> bool:
    """Return whether ``I - product`` (n, n) is singular or too ill-conditioned."""
    matrix = np.asarray(product)
    if not matrix.any():
        return False
    label = strong_components(matrix != 0)
    for k in range(int(label.max()) + 1):
        part = np.flatnonzero(label == k)
        inner = matrix[part[:, None], part]
        scale = balancing_factors(inner)  # the answer is independent of the units of channels
        if inner.any() and not np.linalg.cond(np.eye(len(part)) - inner / scale[:, None] * scale) <= ILL_POSED:
            return True
    return False


def upper_lft(M: StateSpaceModel, delta: ArrayLike) -> StateSpaceModel:
    """Return ``F_u(M, Delta)`` for a constant real Delta (q, p) on the first q inputs and p outputs of M."""
    d = np.asarray(delta)
    if np.iscomplexobj(d):
        hint = "a complex Delta acts on frequency responses only"
        raise InputError("upper_lft", "a complex Delta", "a real one", hint)
    (q, p), n = d.shape, M.n_states
    if q > M.n_inputs or p > M.n_outputs:
        found = f"Delta is {d.shape}, M has {M.n_inputs} inputs and {M.n_outputs} outputs"
        raise InputError("upper_lft", found, "a smaller Delta")
    around = M.D[:p, :q] @ d
    if is_singular(around):
        raise NoTrustworthyNumber("upper_lft", "I - D11 Delta is singular: this Delta makes the model ill-posed")
    # z = (I - D11 Delta)^-1 (C1 x + D12 u), w = Delta z
    seen = np.hstack([M.C[:p], M.D[:p, q:]])
    w = d @ np.linalg.solve(np.eye(p) - around, seen) if p else np.zeros((q, seen.shape[1]))
    rest = np.delete(np.delete(system_matrix(M), slice(n, n + p), axis=0), slice(n, n + q), axis=1)
    whole = rest + np.vstack([M.B[:, :q], M.D[p:, :q]]) @ w
    return of_system_matrix(whole, n, M.dt, M.inputs[q:], M.outputs[p:], M.states, "upper_lft")


def closed_response(m: AnyArray, d: AnyArray) -> AnyArray:
    """Return ``F_u`` of responses m (n_omega, ..., ...) for Delta d, one (q, p) or one for each frequency."""
    q, p = d.shape[-2:]
    loop = np.eye(p) - m[:, :p, :q] @ d
    return m[:, p:, q:] + m[:, p:, :q] @ d @ np.linalg.solve(loop, m[:, :p, q:])
