"""Star product and concatenation of uncertain models, their inverses, centred ranges, and reduction with its evidence.

Zhou, Doyle, Glover, *Robust and Optimal Control* (1996), sections 10.1-10.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from robustlab.arrays import is_rank_deficient
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.operators import carried_by_rank
from robustlab.result import Status
from robustlab.shown import Facts, Shown, listed, number
from robustlab.signals import Signal, same_units
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block, block_slices
from robustlab.uncertainty.interconnection import Wiring, unique_names
from robustlab.uncertainty.lft import UncertainModel, as_uncertain, interconnected
from robustlab.uncertainty.reduction import reduced


@told_as("star")
@carried_by_rank
def star(first: Any, second: Any, n_to_second: int | None = None, n_to_first: int | None = None) -> UncertainModel:
    r"""Redheffer star product: the last outputs of ``first`` drive the first inputs of ``second``, and its first
    outputs the last inputs of ``first``.

    Parameters
    ----------
    first, second
        Sets, models, matrices or numbers.
    n_to_second
        Number of signals from ``first`` to ``second``; left out, as many as fit: the smaller of the two counts.
    n_to_first
        Number of signals back; likewise.

    Returns
    -------
    UncertainModel
        From (remaining inputs of first, remaining inputs of second) to (remaining outputs of first, of second).

    Raises
    ------
    InputError
        Numbers that do not fit.
    NoTrustworthyNumber
        The nominal loop is not well posed.

    References
    ----------
    Zhou, Doyle, Glover (1996), section 10.3.
    """
    a, b = as_uncertain(first, "star"), as_uncertain(second, "star")
    (a_in, a_out), (b_in, b_out) = ((len(m.inputs), len(m.outputs)) for m in (a, b))
    go = min(a_out, b_in) if n_to_second is None else n_to_second
    back = min(a_in, b_out) if n_to_first is None else n_to_first
    if any(isinstance(n, bool) or not isinstance(n, (int, np.integer)) for n in (go, back)):
        raise InputError("star", f"{go!r} signals over, {back!r} back", "whole numbers, not negative")
    if not (0 <= go <= min(a_out, b_in) and 0 <= back <= min(a_in, b_out)):
        found = f"{go} signals over, {back} back"
        raise InputError("star", found, f"at most {min(a_out, b_in)} and {min(a_in, b_out)}")
    same_units(
        "star",
        [
            *zip(a.outputs[a_out - go :], b.inputs[:go], strict=True),
            *zip(b.outputs[:back], a.inputs[a_in - back :], strict=True),
        ],
    )
    K, E = np.zeros((a_in + b_in, a_out + b_out)), np.zeros((a_in + b_in, a_in - back + b_in - go))
    F = np.zeros((a_out - go + b_out - back, a_out + b_out))
    K[a_in - back : a_in, a_out : a_out + back] = np.eye(back)
    K[a_in : a_in + go, a_out - go : a_out] = np.eye(go)
    E[: a_in - back, : a_in - back] = np.eye(a_in - back)
    E[a_in + go :, a_in - back :] = np.eye(b_in - go)
    F[: a_out - go, : a_out - go] = np.eye(a_out - go)
    F[a_out - go :, a_out + back :] = np.eye(b_out - back)
    inputs, outputs = a.inputs[: a_in - back] + b.inputs[go:], a.outputs[: a_out - go] + b.outputs[back:]
    return interconnected([a, b], Wiring(K, E, F), inputs, outputs, "star")


def upper(M: Any, K: Any) -> UncertainModel:
    """Upper LFT :math:`F_u(M, K) = M_{22} + M_{21} K (I - M_{11} K)^{-1} M_{12}` of two sets: K closes the first
    channels (of the model's own signals; its blocks stay).
    """
    m, k = as_uncertain(M, "upper"), as_uncertain(K, "upper")
    if len(k.outputs) > len(m.inputs) or len(k.inputs) > len(m.outputs):
        found = f"{len(k.outputs)} x {len(k.inputs)} closed into {len(m.outputs)} x {len(m.inputs)}"
        raise InputError("upper", found, "what is closed in must be no larger than the other transposed")
    return star(k, m, len(k.outputs), len(k.inputs))


def inverse(system: Any) -> UncertainModel:
    """The set of the inverses of a square set; inputs and outputs change places."""
    g = as_uncertain(system, "inverse")
    n_u, n_y = len(g.inputs), len(g.outputs)
    if n_u != n_y:
        raise InputError("inverse", f"{n_y} x {n_u}", "a square model")
    m, (q, p) = g.M, g.delta_shape
    d22 = m.D[p:, q:]
    if n_u and is_rank_deficient(d22):
        found = "D is singular at Delta = 0 (every block at its nominal value): the inverse is not proper"
        raise NoTrustworthyNumber("inverse", found)
    # u = D22^-1 (y - C2 x - D21 w)
    u_x, u_w, u_y = (np.linalg.solve(d22, part) for part in (-m.C[p:], -m.D[p:, :q], np.eye(n_u)))
    b2, d12 = m.B[:, q:], m.D[:p, q:]
    model = StateSpaceModel(
        m.A + b2 @ u_x,
        np.hstack([m.B[:, :q] + b2 @ u_w, b2 @ u_y]),
        np.vstack([m.C[:p] + d12 @ u_x, u_x]),
        np.block([[m.D[:p, :q] + d12 @ u_w, d12 @ u_y], [u_w, u_y]]),
        m.dt,
        unique_names([*m.inputs[:q], *g.outputs]),
        unique_names([*m.outputs[:p], *g.inputs]),
        m.states,
        where="inverse",
    )
    return UncertainModel(model, g.blocks)


@told_as("beside")
@carried_by_rank
def beside(*systems: Any) -> UncertainModel:
    """``[G1, G2, ...]``: outputs added, inputs side by side (horizontal concatenation).

    Parameters
    ----------
    *systems
        Sets, models, matrices or numbers with equally many outputs; one at least.

    Returns
    -------
    UncertainModel
        From all inputs, in this order, to the outputs of the first.

    Raises
    ------
    InputError
        Numbers of outputs or sample times that do not fit; a block name that stands for two different uncertainties.
    UnitMismatch
        Outputs that are added carry different units.
    """
    parts = _sharing("outputs", "beside", systems)
    n_y = len(parts[0].outputs)
    n_u = sum(len(part.inputs) for part in parts)
    wiring = Wiring(np.zeros((n_u, n_y * len(parts))), np.eye(n_u), np.hstack([np.eye(n_y)] * len(parts)))
    return interconnected(parts, wiring, [s for part in parts for s in part.inputs], parts[0].outputs, "beside")


@told_as("stacked")
@carried_by_rank
def stacked(*systems: Any) -> UncertainModel:
    """``[G1; G2; ...]``: the same inputs, outputs below one another (vertical concatenation).

    Parameters
    ----------
    *systems
        Sets, models, matrices or numbers with equally many inputs; one at least.

    Returns
    -------
    UncertainModel
        From the inputs of the first to all outputs, in this order.

    Raises
    ------
    InputError
        Numbers of inputs or sample times that do not fit; a block name that stands for two different uncertainties.
    UnitMismatch
        Inputs that are one carry different units.
    """
    parts = _sharing("inputs", "stacked", systems)
    n_u = len(parts[0].inputs)
    n_y = sum(len(part.outputs) for part in parts)
    wiring = Wiring(np.zeros((n_u * len(parts), n_y)), np.vstack([np.eye(n_u)] * len(parts)), np.eye(n_y))
    return interconnected(parts, wiring, parts[0].inputs, [s for part in parts for s in part.outputs], "stacked")


def _sharing(side: Literal["inputs", "outputs"], where: str, systems: Sequence[Any]) -> list[UncertainModel]:
    """The operands, whose signals on this side are the same."""
    if not systems:
        raise InputError(where, "no operand", "at least one")
    first, *others = (as_uncertain(system, where) for system in systems)
    shared: Sequence[Signal] = getattr(first, side)
    for part in others:
        own: Sequence[Signal] = getattr(part, side)
        if len(own) != len(shared):
            found = f"{len(own)} {side} {'beside' if side == 'outputs' else 'below'} {len(shared)}"
            raise InputError(where, found, "equal numbers")
        same_units(where, zip(shared, own, strict=True))
    return [first, *others]


def centred(uncertain: UncertainModel, level: float = 1.0) -> UncertainModel:
    """`UncertainModel.centred`, which see."""
    # [-rho m, m] becomes c + r [-1, 1] by Delta = C + R Delta', c = m (1 - rho) / 2, r = m (1 + rho) / 2: an LFT.
    if isinstance(level, bool) or not isinstance(level, (int, float)) or not 0 < level < np.inf:
        raise InputError("centred", f"level {level!r}", "a positive finite number")
    q, p = uncertain.delta_shape
    centre, scale = np.zeros((q, p)), np.eye(q) * level
    blocks: list[Block] = []
    for block, (w, z) in zip(uncertain.blocks, block_slices(uncertain.blocks), strict=True):
        middle, half, symmetric = block.centred(level)
        if middle:
            centre[w, z] = middle * np.eye(block.rows)
        scale[w, w] = half * np.eye(block.rows)
        blocks.append(symmetric)
    # [z'; w] = [0 I; R C] [w'; z]: Delta' on the outside, the set's channels on the inside
    change = np.block([[np.zeros((p, q)), np.eye(p)], [scale, centre]])
    inside = UncertainModel(StateSpaceModel([], [], [], change), blocks)
    return upper(uncertain.M, inside)


@dataclass(frozen=True, eq=False)
class Reduction(Shown):
    """A reduced set, and the evidence that its input-output behaviour is that of the given one.

    Attributes
    ----------
    model
        The reduced set; a scalar block without any effect is gone.
    before, after
        Block name -> size (repetitions, or the larger side of a full block).
    invariance
        Largest part of what enters or leaves the kept channels through the dropped ones, relative to the largest
        singular value of the (scaled) channel matrices: zero for an exact reduction. This is the algebraic certificate,
        valid for every Delta at once.
    difference
        Largest difference of the two frequency responses at random complex Delta inside the set and random
        frequencies, relative to each response's largest entry (or to a thousandth of the largest summand, where
        the summands cancel).
    points
        How many (Delta, omega) were compared; none where nothing was removed.
    status
        CONVERGED where both are below 1e-9, INACCURATE otherwise (then ``model`` is the given one).
    """

    model: UncertainModel
    before: dict[str, int]
    after: dict[str, int]
    invariance: float
    difference: float
    points: int
    status: Status

    def facts(self) -> Facts:
        sizes = [f"{name} {size} -> {self.after.get(name, 0)}" for name, size in self.before.items()]
        return [
            ("sizes", listed(sizes)),
            ("set", repr(self.model)),
            ("invariance", number(self.invariance)),
            ("difference", f"{number(self.difference)} at {self.points} points"),
        ]

    def to_json(self) -> dict[str, object]:
        return {**vars(self), "model": self.model.to_json()}

    def __str__(self) -> str:
        changed = [f"{k} {v} -> {self.after.get(k, 0)}" for k, v in self.before.items() if self.after.get(k, 0) != v]
        said = ", ".join(changed) or "nothing to remove"
        return f"{said}; invariance {self.invariance:.1e}, difference {self.difference:.1e} ({self.status})"


def reduction(uncertain: UncertainModel, tolerance: float = 1e-12, seed: int = 0) -> Reduction:
    """`reduce_model` of a set, which see; ``seed`` is that of the Deltas and frequencies at which both are compared."""
    found = reduced(uncertain.M, uncertain.blocks, tolerance, seed)
    same = found.blocks == uncertain.blocks
    model = uncertain if same else UncertainModel(found.M, found.blocks, uncertain.operating_point)
    status = Status.CONVERGED if found.proved else Status.INACCURATE
    before, after = ({b.name: max(b.rows, b.cols) for b in m.blocks} for m in (uncertain, model))
    return Reduction(model, before, after, found.invariance, found.difference, found.points, status)
