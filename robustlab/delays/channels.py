"""The channels of a model's delays: their order, chains of them, and what stands in the place of one."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from robustlab.arrays import Array
from robustlab.delays.approximation import error_weight, pade, phase_bound
from robustlab.errors import NoTrustworthyNumber
from robustlab.statespace import StateSpaceModel, append
from robustlab.uncertainty.blocks import Block, ComplexScalar, FullBlock
from robustlab.uncertainty.lft import UncertainModel
from robustlab.uncertainty.upper_lft import upper_lft


def rearranged(model: StateSpaceModel, ins: Iterable[int], outs: Iterable[int]) -> StateSpaceModel:
    """The model with these of its inputs and outputs, by number."""
    i, o = list(ins), list(outs)
    return StateSpaceModel(
        model.A, model.B[:, i], model.C[o], model.D[np.ix_(o, i)], 0.0,
        [model.inputs[k] for k in i], [model.outputs[k] for k in o], model.states, where="DelayedModel",
    )  # fmt: skip


def closed(model: StateSpaceModel, lengths: Array) -> tuple[StateSpaceModel, Array]:
    """Without the channels whose delay is zero."""
    none = np.flatnonzero(lengths == 0).tolist()
    if not len(none):
        return model, lengths
    rest = [k for k in range(model.n_inputs) if k not in none], [k for k in range(model.n_outputs) if k not in none]
    try:
        found = upper_lft(rearranged(model, [*none, *rest[0]], [*none, *rest[1]]), np.eye(len(none)))
    except NoTrustworthyNumber:
        singular = "a loop through a delay of zero is not well posed"
        raise NoTrustworthyNumber("DelayedModel", singular) from None
    return found, lengths[lengths > 0]


def chained(model: StateSpaceModel, lengths: Array) -> tuple[StateSpaceModel, Array]:
    """Two delays of which one feeds the other and nothing else become one, of their sum."""
    while True:
        n = len(lengths)
        feeds = np.vstack([model.B, model.D])[:, :n] != 0
        reads = np.hstack([model.C, model.D])[:n] != 0
        pair = next(
            (
                (i, j)
                for i in range(n)
                for j in range(n)
                if i != j and feeds[model.n_states + j, i] and feeds[:, i].sum() == 1 and reads[j].sum() == 1
            ),
            None,
        )
        if pair is None:
            return model, lengths
        i, j = pair
        gain = model.D[j, i]
        # what enters delay i leaves delay j: the channel keeps z_i and w_j
        B, D = model.B.copy(), model.D.copy()
        B[:, i], D[:, i] = gain * B[:, j], gain * D[:, j]
        merged = StateSpaceModel(model.A, B, model.C, D, 0.0, model.inputs, model.outputs, model.states)
        total = lengths.copy()
        total[i] += lengths[j]
        keep_in, keep_out = ([k for k in range(count) if k != j] for count in (model.n_inputs, model.n_outputs))
        model, lengths = rearranged(merged, keep_in, keep_out), np.delete(total, j)


def in_order(model: StateSpaceModel, lengths: Array) -> tuple[StateSpaceModel, Array]:
    """The channels sorted by the lengths of their delays."""
    order = np.argsort(lengths, kind="stable").tolist()
    n = len(order)
    if np.array_equal(order, np.arange(n)):
        return model, lengths.copy()
    ins, outs = [*order, *range(n, model.n_inputs)], [*order, *range(n, model.n_outputs)]
    return rearranged(model, ins, outs), lengths[order]


def named(model: StateSpaceModel, index: int) -> StateSpaceModel:
    """The model in the place of the delay of this number, its states named by it."""
    states = [f"delay{index + 1}.{k + 1}" for k in range(model.n_states)]
    return StateSpaceModel(model.A, model.B, model.C, model.D, 0.0, [f"z{index}"], [f"w{index}"], states)


def covering(tau: float, spread: float, order: int, weight_order: int, i: int = 0, name: str = "") -> UncertainModel:
    """``R + W Delta``: all delays within ``spread`` of ``tau``, as a set with one input and one output.

    A block's name is what its Delta depends on, so that equal names are one uncertainty: the length of the delay and
    both orders; of a spread its channel, and the name that the user gives.
    """
    rational = pade(tau, order)
    weight = error_weight(order, weight_order, spread / tau).scaled(tau)
    covers = (tau, spread, order, weight_order)
    if spread:
        words = f"a delay of {tau:g} s +- {spread:g} s, covered at all frequencies: proved"
        block: Block = FullBlock(
            f"{name}spread {i + 1} of {tau!r} s +- {spread!r} s", 1, 1, origin=words, covers=covers
        )
    else:
        bound = phase_bound(order)
        words = f"what Padé's approximation of order {order} of a delay of {tau:g} s misses, at most min(2,"
        words += f" {bound.coefficient:.3g} (w {tau:g} s)^{bound.power}) for all w: proved"
        block = ComplexScalar(
            f"delay of {tau!r} s (order {order}, slope {weight.n_states})", origin=words, covers=covers
        )
    states = [
        f"{kind}{i + 1}.{k + 1}" for kind, m in (("weight", weight), ("delay", rational)) for k in range(m.n_states)
    ]
    side = append(*(m.renamed([f"i{k}"], [f"o{k}"]) for k, m in enumerate((weight, rational))))
    into = np.array([[0.0, 1.0], [0.0, 1.0]])  # (w, z) into both
    D = side.D @ into
    D[1, 0] = 1.0
    model = StateSpaceModel(side.A, side.B @ into, side.C, D, 0.0, [f"w{i}", "in"], [f"z{i}", "out"], states)
    return UncertainModel(model, [block])
