r"""Algebra of uncertain models: every interconnection of LFTs is an LFT, in the same named blocks.

Operands are uncertain models, state-space models (or what has ``to_model``), matrices and numbers. A block name that
occurs in several operands is one and the same uncertainty: its channels become one repeated block, which is then
reduced. Signals keep their names; where two would be called the same, the later ones get ``_2``, ``_3``, ...

The same set about the middle of its ranges.

A real block whose range is wider on one side fills :math:`[-\rho m, m]` in Delta at level m. Methods that need an
interval around zero get it by an affine change of Delta, which is an LFT:

.. math:: \Delta = C + R \, \Delta', \qquad c = \tfrac{m}{2} (1 - \rho), \quad r = \tfrac{m}{2} (1 + \rho)

References
----------
Zhou, Doyle, Glover, *Robust and Optimal Control* (1996), sections 10.1-10.3; Redheffer (1960) for the star product.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.errors import InputError, NoTrustworthyNumber, UnitMismatch
from robustlab.statespace import MAX_NAME, Signal, StateSpaceModel, append, as_model, real_array
from robustlab.uncertainty.blocks import Block, block_slices
from robustlab.uncertainty.lft import UncertainModel, is_singular
from robustlab.uncertainty.reduction import reduce_blocks

__all__ = [
    "as_uncertain",
    "beside",
    "feedback",
    "inverse",
    "lower",
    "parallel",
    "product",
    "series",
    "stacked",
    "star",
    "upper",
    "centred",
]


def as_uncertain(system: Any, where: str = "as_uncertain") -> UncertainModel:
    """An uncertain model as it is; a model, a matrix or a number as one without blocks.

    Raises
    ------
    InputError
        None of these, complex entries, NaN or Inf.

    Examples
    --------
    >>> as_uncertain([[2.0, 0.0]])
    UncertainModel(0 states, Delta 0 x 0: no uncertainty)
    """
    if isinstance(system, UncertainModel):
        return system
    if isinstance(system, (int, float, list, tuple, np.ndarray, np.number)) and not isinstance(system, bool):
        gain = real_array("gain", system, 2, where)
        return UncertainModel(StateSpaceModel([], [], [], gain, 0.0, where=where), ())
    model = as_model(system, where)
    return UncertainModel(model, (), model.operating_point)


def product(second: Any, first: Any) -> UncertainModel:
    r"""``second @ first``: the transfer matrix :math:`G_2(s) G_1(s)`; what leaves ``first`` enters ``second``.

    A number multiplies every channel. The result has the inputs of ``first`` and the outputs of ``second``; the
    signals of a matrix or a number are not named, and the other side's are kept where sizes allow it.

    Raises
    ------
    InputError
        Sizes or sample times that do not fit; a block name that stands for two different uncertainties.
    UnitMismatch
        An output of ``first`` and the input of ``second`` that it drives carry different units.

    Examples
    --------
    >>> gain = UncertainModel(StateSpaceModel([], [], [], [[0.0, 0.1], [1.0, 1.0]]), [RealScalar("k")])
    >>> twice = product(2.0, gain)
    >>> twice.evaluate({"k": 1.0}).D
    array([[2.2]])
    """
    if _is_number(second):
        second = float(second) * np.eye(len(as_uncertain(first, "product").outputs))
    elif _is_number(first):
        first = float(first) * np.eye(len(as_uncertain(second, "product").inputs))
    g2, g1 = as_uncertain(second, "product"), as_uncertain(first, "product")
    n_v, n_m, n_o = len(g1.inputs), len(g1.outputs), len(g2.outputs)
    if n_m != len(g2.inputs):
        raise InputError("product", f"{n_m} outputs into {len(g2.inputs)} inputs", "equal numbers")
    _same_units("product", zip(g1.outputs, g2.inputs, strict=True))
    joint = _join([g1, g2], "product")
    inputs = _names_of(second, first, g1.inputs, g2.inputs)
    outputs = _names_of(first, second, g2.outputs, g1.outputs)
    wiring = _Wiring(
        K=np.block([[np.zeros((n_v, n_m + n_o))], [np.eye(n_m), np.zeros((n_m, n_o))]]),
        E=np.vstack([np.eye(n_v), np.zeros((n_m, n_v))]),
        F=np.hstack([np.zeros((n_o, n_m)), np.eye(n_o)]),
    )
    return _wired(joint, wiring, inputs, outputs, "product")


def series(first: Any, *others: Any) -> UncertainModel:
    """What leaves each operand enters the next: ``series(a, b, c) = c @ b @ a``; see `product`."""
    result = as_uncertain(first, "series")
    for other in others:
        result = product(other, result)
    return result


def parallel(first: Any, second: Any, sign: int = 1) -> UncertainModel:
    """``first + sign * second`` for two sets of one size.

    A number stands for a 1 x 1 gain: for more channels it could mean the identity or every entry, so a matrix is asked
    for.

    Raises
    ------
    InputError
        Sizes or sample times that do not fit; a block name that stands for two different uncertainties.
    UnitMismatch
        Signals that are added carry different units.
    """
    if sign not in (1, -1):
        raise InputError("parallel", f"sign {sign!r}", "1 or -1")
    a, b = as_uncertain(first, "parallel"), as_uncertain(second, "parallel")
    shape = len(a.outputs), len(a.inputs)
    if shape != (len(b.outputs), len(b.inputs)):
        found = f"{shape[0]} x {shape[1]} and {len(b.outputs)} x {len(b.inputs)}"
        raise InputError("parallel", found, "equal sizes", "write a number c as c * numpy.eye(n), or as a full matrix")
    _same_units("parallel", [*zip(a.inputs, b.inputs, strict=True), *zip(a.outputs, b.outputs, strict=True)])
    n_y, n_u = shape
    wiring = _Wiring(
        K=np.zeros((2 * n_u, 2 * n_y)),
        E=np.vstack([np.eye(n_u), np.eye(n_u)]),
        F=np.hstack([np.eye(n_y), sign * np.eye(n_y)]),
    )
    inputs, outputs = _names_of(second, first, a.inputs, b.inputs), _names_of(second, first, a.outputs, b.outputs)
    return _wired(_join([a, b], "parallel"), wiring, inputs, outputs, "parallel")


def feedback(forward: Any, back: Any = 1.0, sign: int = -1) -> UncertainModel:
    r"""From r to y for ``y = G e``, ``e = r + sign H y``: :math:`(I - sign\, G H)^{-1} G`, with the signals of G.

    Raises
    ------
    InputError
        Sizes or sample times that do not fit.
    NoTrustworthyNumber
        The nominal loop is not well posed: ``I - sign D_G D_H`` is singular at Delta = 0.
    """
    if sign not in (1, -1):
        raise InputError("feedback", f"sign {sign!r}", "1 or -1")
    g = as_uncertain(forward, "feedback")
    n_u, n_y = len(g.inputs), len(g.outputs)
    if _is_number(back):
        if n_u != n_y:
            raise InputError("feedback", f"the number {back} around {n_y} x {n_u} channels", "a matrix or a model")
        back = float(back) * np.eye(n_u)
    h = as_uncertain(back, "feedback")
    if (len(h.outputs), len(h.inputs)) != (n_u, n_y):
        found = f"what is fed back is {len(h.outputs)} x {len(h.inputs)}"
        raise InputError("feedback", found, f"{n_u} x {n_y} for a model of {n_y} x {n_u}")
    _same_units("feedback", [*zip(g.outputs, h.inputs, strict=True), *zip(h.outputs, g.inputs, strict=True)])
    wiring = _Wiring(
        K=np.block([[np.zeros((n_u, n_y)), sign * np.eye(n_u)], [np.eye(n_y), np.zeros((n_y, n_u))]]),
        E=np.vstack([np.eye(n_u), np.zeros((n_y, n_u))]),
        F=np.hstack([np.eye(n_y), np.zeros((n_y, n_u))]),
    )
    return _wired(_join([g, h], "feedback"), wiring, g.inputs, g.outputs, "feedback")


def star(first: Any, second: Any, n_to_second: int | None = None, n_to_first: int | None = None) -> UncertainModel:
    r"""Redheffer star product: the last outputs of ``first`` drive the first inputs of ``second``, and its first
    outputs the last inputs of ``first``.

    Parameters
    ----------
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
    if not (0 <= go <= min(a_out, b_in) and 0 <= back <= min(a_in, b_out)):
        found = f"{go} signals over, {back} back"
        raise InputError("star", found, f"at most {min(a_out, b_in)} and {min(a_in, b_out)}")
    _same_units(
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
    return _wired(_join([a, b], "star"), _Wiring(K, E, F), inputs, outputs, "star")


def lower(P: Any, K: Any) -> UncertainModel:
    r"""Lower LFT :math:`F_l(P, K) = P_{11} + P_{12} K (I - P_{22} K)^{-1} P_{21}`: K closes the last channels of P.

    Raises
    ------
    InputError
        K is larger than P.
    NoTrustworthyNumber
        The nominal loop is not well posed.
    """
    p, k = as_uncertain(P, "lower"), as_uncertain(K, "lower")
    _check_inside("lower", k, p)
    return star(p, k, len(k.inputs), len(k.outputs))


def upper(M: Any, K: Any) -> UncertainModel:
    r"""Upper LFT :math:`F_u(M, K) = M_{22} + M_{21} K (I - M_{11} K)^{-1} M_{12}` of two sets: K closes the first
    channels (of the model's own signals; its blocks stay).

    Raises
    ------
    InputError
        K is larger than M.
    NoTrustworthyNumber
        The nominal loop is not well posed.
    """
    m, k = as_uncertain(M, "upper"), as_uncertain(K, "upper")
    _check_inside("upper", k, m)
    return star(k, m, len(k.outputs), len(k.inputs))


def inverse(system: Any) -> UncertainModel:
    """The set of the inverses of a square set; inputs and outputs change places.

    Raises
    ------
    InputError
        Not square.
    NoTrustworthyNumber
        D is singular at Delta = 0: the inverse is not proper there.

    Examples
    --------
    >>> gain = UncertainModel(StateSpaceModel([], [], [], [[0.0, 0.5], [1.0, 1.0]]), [RealScalar("k")])
    >>> round(float(inverse(gain).evaluate({"k": 1.0}).D[0, 0]), 12)
    0.666666666667
    """
    g = as_uncertain(system, "inverse")
    n_u, n_y = len(g.inputs), len(g.outputs)
    if n_u != n_y:
        raise InputError("inverse", f"{n_y} x {n_u}", "a square model")
    m, (q, p) = g.M, g.delta_shape
    d22 = m.D[p:, q:]
    if n_u and _is_rank_deficient(d22):
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
        _unique([*m.inputs[:q], *g.outputs]),
        _unique([*m.outputs[:p], *g.inputs]),
        m.states,
        where="inverse",
    )
    return UncertainModel(model, g.blocks)


def beside(*systems: Any) -> UncertainModel:
    """``[G1, G2, ...]``: outputs added, inputs side by side (horizontal concatenation)."""
    parts = _parts("beside", systems)
    n_y = len(parts[0].outputs)
    for part in parts[1:]:
        if len(part.outputs) != n_y:
            raise InputError("beside", f"{len(part.outputs)} outputs beside {n_y}", "equal numbers")
        _same_units("beside", zip(parts[0].outputs, part.outputs, strict=True))
    n_u = sum(len(part.inputs) for part in parts)
    wiring = _Wiring(np.zeros((n_u, n_y * len(parts))), np.eye(n_u), np.hstack([np.eye(n_y)] * len(parts)))
    return _wired(
        _join(parts, "beside"), wiring, [s for part in parts for s in part.inputs], parts[0].outputs, "beside"
    )


def stacked(*systems: Any) -> UncertainModel:
    """``[G1; G2; ...]``: the same inputs, outputs below one another (vertical concatenation)."""
    parts = _parts("stacked", systems)
    n_u = len(parts[0].inputs)
    for part in parts[1:]:
        if len(part.inputs) != n_u:
            raise InputError("stacked", f"{len(part.inputs)} inputs below {n_u}", "equal numbers")
        _same_units("stacked", zip(parts[0].inputs, part.inputs, strict=True))
    n_y = sum(len(part.outputs) for part in parts)
    wiring = _Wiring(np.zeros((n_u * len(parts), n_y)), np.vstack([np.eye(n_u)] * len(parts)), np.eye(n_y))
    return _wired(
        _join(parts, "stacked"), wiring, parts[0].inputs, [s for part in parts for s in part.outputs], "stacked"
    )


# --- one joint model, then wires ------------------------------------------------------------------------------------


class _Joint(NamedTuple):
    """All operands in one model with inputs (w, u) and outputs (z, y); equal names of blocks stand together."""

    model: StateSpaceModel
    q: int
    p: int
    blocks: tuple[Block, ...]
    merged: frozenset[str]


class _Wiring(NamedTuple):
    """``u = K y + E v``, ``o = F y``: v are the inputs and o the outputs of the interconnection."""

    K: Array
    E: Array
    F: Array


def _join(parts: Sequence[UncertainModel], where: str) -> _Joint:
    plain = [
        StateSpaceModel(
            m.A, m.B, m.C, m.D, m.dt,
            [f"w{i}.{j}" for j in range(m.n_inputs)], [f"z{i}.{j}" for j in range(m.n_outputs)], where=where,
        )
        for i, m in enumerate(part.M for part in parts)
    ]  # fmt: skip
    model = append(*plain)
    first_in, first_out = 0, 0
    channels: dict[str, tuple[list[Block], list[int], list[int]]] = {}
    rest_in: list[int] = []
    rest_out: list[int] = []
    for part in parts:
        q, p = part.delta_shape
        for block, (w, z) in zip(part.blocks, block_slices(part.blocks), strict=True):
            same, ins, outs = channels.setdefault(block.name, ([], [], []))
            same.append(block)
            ins += range(first_in + w.start, first_in + w.stop)
            outs += range(first_out + z.start, first_out + z.stop)
        rest_in += range(first_in + q, first_in + part.M.n_inputs)
        rest_out += range(first_out + p, first_out + part.M.n_outputs)
        first_in, first_out = first_in + part.M.n_inputs, first_out + part.M.n_outputs
    blocks = tuple(_merged(same, where) for same, _, _ in channels.values())
    order_in = [k for _, ins, _ in channels.values() for k in ins]
    order_out = [k for _, _, outs in channels.values() for k in outs]
    q, p = len(order_in), len(order_out)
    order_in, order_out = order_in + rest_in, order_out + rest_out
    states = _unique([s for part in parts for s in part.M.states])
    arranged = StateSpaceModel(
        model.A, model.B[:, order_in], model.C[order_out], model.D[np.ix_(order_out, order_in)], model.dt, states=states
    )
    merged = frozenset(name for name, (same, _, _) in channels.items() if len(same) > 1)
    return _Joint(arranged, q, p, blocks, merged)


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


def _wired(
    joint: _Joint, wiring: _Wiring, inputs: Sequence[Signal], outputs: Sequence[Signal], where: str
) -> UncertainModel:
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
        _unique([*inputs, *_channel_names("w", joint.blocks)], len(inputs)),
        _unique([*outputs, *_channel_names("z", joint.blocks)], len(outputs)),
        m.states,
        where=where,
    )
    blocks = joint.blocks
    if joint.merged:
        model, blocks = reduce_blocks(model, blocks, names=joint.merged, keep=True)
    return UncertainModel(model, blocks)


def _channel_names(prefix: str, blocks: Sequence[Block]) -> list[Signal]:
    """Names of the Delta channels, for example ``w:k`` or ``w:k#2``."""
    names = []
    for b in blocks:
        count = b.rows if prefix == "w" else b.cols
        short = b.name[: MAX_NAME - 20]
        names += [f"{prefix}:{short}" if count == 1 else f"{prefix}:{short}#{k + 1}" for k in range(count)]
    return [Signal(name) for name in names]


def _unique(given: Sequence[Signal], last: int = 0) -> list[Signal]:
    """Names made unique by ``_2``, ``_3``, ..., the first one kept; the first ``last`` signals are moved to the end."""
    taken: set[str] = set()
    result: list[Signal] = []
    for signal in given:
        name, count = signal.name, 1
        while name in taken:
            count += 1
            name = f"{signal.name[: MAX_NAME - 8]}_{count}"
        taken.add(name)
        result.append(Signal(name, signal.unit))
    return [*result[last:], *result[:last]]


# --- checks ----------------------------------------------------------------------------------------------------------


def _is_number(operand: Any) -> bool:
    return isinstance(operand, (int, float, np.number)) and not isinstance(operand, bool)


def _is_constant(operand: Any) -> bool:
    return isinstance(operand, (int, float, list, tuple, np.ndarray, np.number))


def _names_of(other: Any, owner: Any, signals: Sequence[Signal], others: Sequence[Signal]) -> Sequence[Signal]:
    """The signals of ``owner``; those of the other operand where the owner is a constant and the sizes are equal."""
    return others if _is_constant(owner) and not _is_constant(other) and len(others) == len(signals) else signals


def _parts(where: str, systems: Sequence[Any]) -> list[UncertainModel]:
    if not systems:
        raise InputError(where, "no operand", "at least one")
    return [as_uncertain(system, where) for system in systems]


def _check_inside(where: str, inner: UncertainModel, outer: UncertainModel) -> None:
    if len(inner.outputs) > len(outer.inputs) or len(inner.inputs) > len(outer.outputs):
        found = f"{len(inner.outputs)} x {len(inner.inputs)} closed into {len(outer.outputs)} x {len(outer.inputs)}"
        raise InputError(where, found, "what is closed in must be no larger than the other transposed")


def _same_units(where: str, pairs: Any) -> None:
    for one, other in pairs:
        if one.unit and other.unit and one.unit != other.unit:
            found = f"{one.name} [{one.unit}] meets {other.name} [{other.unit}]"
            raise UnitMismatch(where, found, "equal units")


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


def _is_rank_deficient(matrix: Array) -> bool:
    """Whether a square matrix is singular, its rows and columns brought to one size first."""
    scaled = matrix.copy()
    for axis in (1, 0, 1):
        size = np.abs(scaled).max(axis=axis, keepdims=True)
        if not size.all():
            return True
        scaled = scaled / size
    return not np.linalg.cond(scaled) <= 1e12


def centred(uncertain: UncertainModel, level: float = 1.0) -> UncertainModel:
    """The set scaled by ``level``, with every real range symmetric about its own middle.

    Members are the same, their deltas are not: a range [0.75, 1.5] around 1 becomes 1.125 +- 0.375. Block names, full
    and complex blocks stay (the latter scaled by ``level``). The new nominal model is the member at the middles.

    Parameters
    ----------
    level
        Positive: 2 takes each end twice as far from the nominal value.

    Raises
    ------
    InputError
        A level that is not positive and finite.
    NoTrustworthyNumber
        The member at the middles is not well posed.

    Examples
    --------
    >>> from robustlab.uncertainty.parametric import parametric
    >>> lag = parametric([["-1/tau"]], [["1/tau"]], [[1]], [[0]], {"tau": (1.0, 0.75, 1.5)})
    >>> middle = centred(lag)
    >>> middle.blocks[0].parameter
    ParameterRange(nominal=1.125, radius=0.375, unit='', below=None)
    >>> [float(m.evaluate({"tau": -1.0}).A[0, 0].round(12)) for m in (lag, middle)]
    [-1.333333333333, -1.333333333333]
    """
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
