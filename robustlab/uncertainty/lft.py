r"""Uncertain models as upper linear fractional transformations of a structured Delta.

.. math:: F_u(M, \Delta) = M_{22} + M_{21} \Delta (I - M_{11} \Delta)^{-1} M_{12}
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab import statespace
from robustlab.arrays import AnyArray, Array, is_rank_deficient
from robustlab.checks import number as checked_number
from robustlab.checks import whole
from robustlab.display import SHOWN_BLOCKS, Displayable, Facts, listed, number, with_units
from robustlab.display import Part as TablePart
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.feedback import feedback_loop, wired
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.linear_analysis.matrices import balancing_factors, of_system_matrix, system_matrix
from robustlab.linear_analysis.structural import strong_components
from robustlab.operators import TransferMatrix, carried_by_rank
from robustlab.provenance import Traced
from robustlab.signals import MAX_NAME, Signal, is_constant, is_number, picked, real_array, same_units
from robustlab.statespace import OperatingPoint, StateSpaceModel, append, as_model, lower_lft
from robustlab.uncertainty.blocks import SAMPLED, Block, as_blocks, block_slices, delta_matrix, structure_size

# Every interconnection of LFTs is an LFT in the same named blocks; a plain model is one without blocks. A block name
# in several operands is the same uncertainty: its channels become one repeated block, which is then reduced. Signals
# keep their names; of equal ones the later get _2, _3, ...

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
    u, y, first_in, first_out = list[int](), list[int](), 0, 0
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
    taken, result = set[str](), list[Signal]()
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
    (q, p), n = d.shape, M.n_states
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


@dataclass(frozen=True, init=False, eq=False)
class UncertainModel(TransferMatrix, Displayable, Traced):
    r"""A set of models ``F_u(M, Delta)`` over all block-diagonal Delta with normalised blocks; immutable.

    Parameters
    ----------
    M
        State-space model whose first q inputs ``w`` and first p outputs ``z`` are the Delta channels (``w = Delta z``).
    blocks
        The blocks of Delta in the order of those channels; see `robustlab.uncertainty.blocks.as_blocks`.
    operating_point
        Operating point of the nominal model.

    Examples
    --------
    >>> from robustlab.uncertainty.blocks import RealScalar
    >>> M = StateSpaceModel([[-1.0]], [[-0.2, 1.0]], [[1.0], [1.0]], [[0.0, 0.0], [0.0, 0.0]])
    >>> lag = UncertainModel(M, [RealScalar("pole")])
    >>> lag.evaluate({"pole": 1.0}).A
    array([[-1.2]])
    """

    for_control = "G.nominal.to_control() is its nominal model as a control.StateSpace"

    M: StateSpaceModel
    blocks: tuple[Block, ...]
    operating_point: OperatingPoint | None

    quantities: ClassVar[Mapping[str, Any]] = {
        **StateSpaceModel.quantities, "blocks": [str], "channels": "1", "sampled": [str],
    }  # fmt: skip

    def __init__(self, M: StateSpaceModel, blocks: Any, operating_point: OperatingPoint | None = None) -> None:
        model = as_model(M, "UncertainModel: M")
        checked = as_blocks(blocks)
        q, p = structure_size(checked)
        if model.n_inputs < q or model.n_outputs < p:
            found = f"M has {model.n_inputs} inputs and {model.n_outputs} outputs"
            raise InputError("UncertainModel", found, f"at least {q} and {p}: the blocks' channels come first")
        self.__dict__.update(M=model, blocks=checked, operating_point=operating_point)

    @property
    def delta_shape(self) -> tuple[int, int]:
        """Return ``(q, p)``, the shape of Delta."""
        return structure_size(self.blocks)

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """Return the inputs of the models in the set."""
        return self.M.inputs[self.delta_shape[0] :]

    @property
    def outputs(self) -> tuple[Signal, ...]:
        """Return the outputs of the models in the set."""
        return self.M.outputs[self.delta_shape[1] :]

    @property
    def dt(self) -> float:
        """Return the sample time in s; 0: continuous time."""
        return self.M.dt

    @property
    def nominal(self) -> StateSpaceModel:
        """Return the model at Delta = 0."""
        (q, p), m = self.delta_shape, self.M
        signals = m.inputs[q:], m.outputs[p:], m.states
        return StateSpaceModel(m.A, m.B[:, q:], m.C[p:], m.D[p:, q:], m.dt, *signals, self.operating_point)

    def to_model(self) -> StateSpaceModel:
        """Return the nominal model, for functions that take a model."""
        return self.nominal

    @property
    def delta_channels(self) -> StateSpaceModel:
        """Return M11, the system from w to z in feedback with Delta."""
        (q, p), m = self.delta_shape, self.M
        return StateSpaceModel(m.A, m.B[:, :q], m.C[:p], m.D[:p, :q], m.dt, m.inputs[:q], m.outputs[:p], m.states)

    def evaluate(self, delta: Mapping[str, Any]) -> StateSpaceModel:
        """Return the member of the set for one real value (or matrix) per block name; omitted blocks are zero.

        Values outside [-1, 1] are allowed: a critical Delta may be larger than the set. A full block also takes a
        StateSpaceModel (rows x cols), a complex scalar one of 1 x 1; its states come last. Complex values: `response`.
        """
        constant, dynamic = self._split(delta)
        (q, p), m = constant.shape, self.M
        if np.iscomplexobj(constant):
            raise InputError("evaluate", "a complex Delta", "real numbers or models", "use response(omega, delta)")
        if not dynamic:
            try:
                return upper_lft(m, constant)
            except NoTrustworthyNumber as error:
                raise NoTrustworthyNumber("evaluate", f"{error.found} ({self.named(delta)})") from None
        system = self._delta_system(constant, dynamic)
        if is_singular(m.D[:p, :q] @ system.D):
            found = f"I - D11 D_Delta is singular: this Delta makes the model ill-posed ({self.named(delta)})"
            raise NoTrustworthyNumber("evaluate", found)
        last = m.select(m.input_names[q:] + m.input_names[:q], m.output_names[p:] + m.output_names[:p])
        return lower_lft(last, system).renamed(self.inputs, self.outputs)

    def _split(self, delta: Mapping[str, Any]) -> tuple[NDArray[Any], dict[str, StateSpaceModel]]:
        """Return Delta of the constant values, and the dynamic ones by name."""
        dynamic = {name: value for name, value in delta.items() if isinstance(value, StateSpaceModel)}
        zero = {b.name: b.zero for b in self.blocks}
        constant = {name: zero.get(name, 0.0) if name in dynamic else value for name, value in delta.items()}
        return delta_matrix(self.blocks, constant), dynamic

    def response(self, omega: ArrayLike, delta: Mapping[str, Any]) -> NDArray[np.complex128]:
        """Return the member's frequency response for a real, complex or dynamic Delta, shape (n_omega, n_y, n_u)."""
        d, dynamic = self._split(delta)
        q, p = d.shape
        m = frequency_response(self.M, omega)
        if dynamic:
            d = d + frequency_response(self._delta_system(np.zeros((q, p)), dynamic), omega)
        return closed_response(m, d)

    def _delta_system(self, constant: NDArray[Any], dynamic: Mapping[str, StateSpaceModel]) -> StateSpaceModel:
        """Return Delta(s), q x p, of the constant and the dynamic values."""
        parts: list[StateSpaceModel] = []
        for b, (w, z) in zip(self.blocks, block_slices(self.blocks), strict=True):
            system, shape = dynamic.get(b.name), b.value_shape
            if system is None:
                parts.append(StateSpaceModel([], [], [], constant[w, z], self.dt))
                continue
            if b.is_real:
                raise InputError(f"delta {b.name!r}", "a dynamic value for a real block", "a real number")
            if (system.n_outputs, system.n_inputs) != shape:
                found = f"a model of {system.n_outputs} x {system.n_inputs}"
                raise InputError(f"delta {b.name!r}", found, f"{shape[0]} x {shape[1]}")
            parts += [system] * (b.rows // shape[0])
        return append(*(unnamed(part, f"{i}") for i, part in enumerate(parts)))

    def named(self, delta: Mapping[str, Any]) -> str:
        """Return a Delta in words: normalised values, and those of parameters."""
        texts = []
        for b in self.blocks:
            value = delta.get(b.name, 0.0)
            if isinstance(value, StateSpaceModel) or np.size(value) != 1:
                texts.append(f"{b.name} = a {'model' if isinstance(value, StateSpaceModel) else 'matrix'}")
                continue
            text = f"{b.name} = {complex(np.asarray(value).reshape(())):.6g}".replace("+0j", "")
            if p := b.parameter:
                text += f": {p.value(float(np.real(value))):.6g} {p.unit}".rstrip()
            texts.append(text)
        return "Delta: " + (", ".join(texts[:12]) + (", ..." if len(texts) > 12 else "") or "none")

    # --- algebra: the functions below; the operators are those of `TransferMatrix` -----------------------------------

    operator_rank = 1  # a set and a model make a set

    def _product(self, second: Any, first: Any) -> UncertainModel:
        return product(second, first)

    def _sum(self, first: Any, second: Any, sign: int) -> UncertainModel:
        return parallel(first, second, sign)

    def _loop(self, forward: Any, back: Any, sign: int | None) -> UncertainModel:
        return feedback(forward, back, sign)

    def _identity(self) -> UncertainModel:
        return as_uncertain(self.nominal**0)

    def __getitem__(self, key: Any) -> UncertainModel:
        """Return ``G[outputs, inputs]`` by numbers, slices, names or lists of these; blocks and states are kept."""
        (q, p), ins, outs = self.delta_shape, self.M.input_names, self.M.output_names
        some_outs, some_ins = picked(key, outs[p:], ins[q:])
        return UncertainModel(self.M.select([*ins[:q], *some_ins], [*outs[:p], *some_outs]), self.blocks)

    def select(self, inputs: Sequence[str] | None = None, outputs: Sequence[str] | None = None) -> UncertainModel:
        """Return the same set with the named inputs and outputs only."""
        return self[slice(None) if outputs is None else outputs, slice(None) if inputs is None else inputs]

    def inverse(self) -> UncertainModel:
        """Return the set of the inverses of a square set; inputs and outputs are exchanged."""
        return inverse(self)

    def physical(self, delta: Mapping[str, Any]) -> dict[str, tuple[float, str]]:
        """Return the parameter values and units of a Delta, for real blocks with a physical parameter."""
        ranges = [(b.name, b.parameter) for b in self.blocks if b.parameter is not None]
        return {name: (r.value(float(np.real(delta.get(name, 0.0)))), r.unit) for name, r in ranges}

    def impossible(self, delta: Mapping[str, Any]) -> tuple[str, ...]:
        """Return remarks on the physically impossible parameter values of a Delta (see `ParameterRange.impossible`)."""
        ranges = {b.name: b.parameter for b in self.blocks if b.parameter is not None and b.name in delta}
        values = [(name, r, r.value(float(np.real(delta[name])))) for name, r in ranges.items()]
        return tuple(
            f"{f'{name} = {value:.6g} {r.unit}'.rstrip()} is physically impossible ({why}): no real plant has it"
            for name, r, value in values
            if (why := r.impossible(value))
        )

    @property
    def sampled(self) -> tuple[str, ...]:
        """Return the names of the blocks that were computed from samples and hold for these only; see ``origin``."""
        return tuple(b.name for b in self.blocks if b.origin.startswith(SAMPLED))

    @property
    def remarks(self) -> tuple[str, ...]:
        """Return the remarks on this set for results about it."""
        if not self.sampled:
            return ()
        names = ", ".join(self.sampled)
        return (f"the set holds the plant for samples only (blocks {names}): what is proved is proved for the set",)

    def centred(self, level: float = 1.0) -> UncertainModel:
        """Return the set with every real range symmetric about its own middle, where the new nominal model is.

        Members are the same, their deltas are not: a range [0.75, 1.5] around 1 becomes 1.125 +- 0.375. ``level``
        scales all blocks before: 2 moves each end twice as far from the nominal value.
        """
        # [-rho m, m] becomes c + r [-1, 1] by Delta = C + R Delta', c = m (1 - rho) / 2, r = m (1 + rho) / 2.
        level = checked_number("centred: level", level, "a positive finite number", above=0)
        q, p = self.delta_shape
        centre, scale, blocks = np.zeros((q, p)), np.eye(q), []
        for block, (w, z) in zip(self.blocks, block_slices(self.blocks), strict=True):
            middle, half, symmetric = block.centred(level)
            if middle:
                centre[w, z] = middle * np.eye(block.rows)
            scale[w, w] *= half
            blocks.append(symmetric)
        return UncertainModel(recentred(self.M, self.blocks, centre, scale, "centred"), blocks)

    def realised(self, delta: Mapping[str, Any], frequency: float) -> dict[str, float | StateSpaceModel]:
        """Return stable systems for the blocks of a complex Delta, of its norm, equal to it at one frequency in rad/s.

        Real parameters remain numbers. With the critical Delta of `robust_stability` and its frequency, the member of
        these values has a pole there. Complex values at the ends of the axis are rejected: real systems are real there.
        """
        from robustlab.uncertainty.perturbation_systems import realise_delta  # loads the norms

        return realise_delta(self.blocks, delta, frequency, self.dt)

    def close(self, K: StateSpaceModel) -> UncertainModel:
        """Return the uncertain closed loop ``u = K y``: y are the last ``K.n_inputs`` outputs, u the last inputs.

        Signals of K and of the plant are connected by name where possible (`robustlab.feedback`).
        """
        k = as_model(K, "close: K")
        y, u = self.M.outputs[self.M.n_outputs - k.n_inputs :], self.M.inputs[self.M.n_inputs - k.n_outputs :]
        return UncertainModel(lower_lft(self.M, wired(k, y, u, "close")), self.blocks)

    def reduce(self, tolerance: float = 1e-12) -> UncertainModel:
        """Return the same set with minimal repetitions of each scalar block, without those that have no effect.

        Singular values below ``tolerance`` times the largest count as zero. `reduce_model` gives the evidence.
        """
        from robustlab.uncertainty.reduction import reduction  # files of sets are read without it

        return reduction(self, tolerance).model

    def to_json(self) -> dict[str, object]:
        data: dict[str, object] = {"M": self.M, "blocks": [b.to_json() for b in self.blocks]}
        data["delta_shape"] = list(self.delta_shape)
        return {**data, "sampled": list(self.sampled)} if self.sampled else data

    def numbers(self) -> dict[str, Any]:
        size = {"blocks": [b.name for b in self.blocks], "channels": self.delta_shape[0]}
        return {**self.nominal.numbers(), **size} | ({"sampled": list(self.sampled)} if self.sampled else {})

    def headline(self) -> str:
        return f"uncertain model with {len(self.blocks)} blocks, {self.M.n_states} states"

    def details(self) -> list[TablePart]:
        shown = self.blocks[:SHOWN_BLOCKS]
        words = [b.parameter.words if b.parameter else "-" for b in shown]
        rows = [(b.name, type(b).__name__, f"{b.rows} x {b.cols}", w) for b, w in zip(shown, words, strict=True)]
        more = len(self.blocks) - len(shown)
        sources = dict.fromkeys(b.origin for b in shown if b.origin)
        origins = [(f"{', '.join(b.name for b in shown if b.origin == source)}: {source}",) for source in sources]
        title = f"the first {len(shown)} blocks; {more} more" if more else ""
        return [TablePart(title, ("block", "kind", "size", "stands for"), rows), TablePart("", (), origins)]

    def facts(self) -> Facts:
        return [
            ("time", f"discrete, dt = {self.dt:g} s" if self.dt else "continuous"),
            ("inputs", with_units(self.inputs)),
            ("outputs", with_units(self.outputs)),
            ("states", str(self.M.n_states)),
            (f"{len(self.blocks)} blocks", self._ranges() or "no uncertainty"),
            ("Delta", " x ".join(map(str, self.delta_shape))),
            ("held by samples only", listed(self.sampled)),
        ]

    def _ranges(self) -> str:
        rows = [(b.name, b.parameter) for b in self.blocks]
        return listed(f"{name} {number(r.low)} .. {number(r.high, r.unit)}" if r else name for name, r in rows)

    def _numbers(self) -> list[str]:
        return [f"blocks: {self._ranges() or 'none'}", "at Delta = 0:", *self.nominal._numbers()]

    def __repr__(self) -> str:
        kinds = [type(b).__name__ for b in self.blocks]
        count = ", ".join(f"{kinds.count(k)} {k}" for k in dict.fromkeys(kinds)) or "no uncertainty"
        return f"UncertainModel({self.M.n_states} states, Delta {self.delta_shape[0]} x {self.delta_shape[1]}: {count})"


def as_uncertain(system: Any, where: str = "as_uncertain") -> UncertainModel:
    """Return an uncertain model as it is; a model, a matrix or a number as one without blocks."""
    if isinstance(system, UncertainModel):
        return system
    if is_constant(system):
        gain = real_array("gain", system, 2, where)
        return UncertainModel(StateSpaceModel([], [], [], gain, 0.0, where=where), ())
    model = as_model(system, where)
    return UncertainModel(model, (), model.operating_point)


def with_channels(
    plain: StateSpaceModel, blocks: Sequence[Block], left: Array, right: Array, inner: Array | float = 0.0
) -> UncertainModel:
    """Return the set ``[A B; C D] + left Delta (I - inner Delta)^-1 right`` around a model."""
    (q, p), n = structure_size(blocks), plain.n_states
    signals = channels_first(blocks, plain.inputs, plain.outputs)
    model = StateSpaceModel(
        plain.A, np.hstack([left[:n], plain.B]), np.vstack([right[:, :n], plain.C]),
        np.block([[np.zeros((p, q)) + inner, right[:, n:]], [left[n:], plain.D]]), plain.dt, *signals, plain.states,
    )  # fmt: skip
    return UncertainModel(model, blocks, plain.operating_point)


def _nominal(operand: Any) -> Any:
    return operand.nominal if isinstance(operand, UncertainModel) else operand


def product(second: Any, first: Any) -> UncertainModel:
    """Return ``second @ first``, the transfer matrix :math:`G_2(s) G_1(s)`."""
    plain = statespace.product(_nominal(second), _nominal(first))
    n_y, n_u = plain.D.shape
    pairs = (second, n_y), (first, n_u)
    g2, g1 = (as_uncertain(float(g) * np.eye(n) if is_number(g) else g, "product") for g, n in pairs)
    n = len(g1.outputs)
    K, F = ones(n_u + n, n + n_y, (n_u, 0, n)), ones(n_y, n + n_y, (0, n, n_y))
    wiring = Wiring(K, ones(n_u + n, n_u, (0, 0, n_u)), F)
    return interconnected([g1, g2], wiring, plain.inputs, plain.outputs, "product")


def parallel(first: Any, second: Any, sign: int = 1) -> UncertainModel:
    """Return ``first + sign * second`` for two sets of one size."""
    plain = statespace.parallel(_nominal(first), _nominal(second), sign)
    parts = [as_uncertain(first, "sum"), as_uncertain(second, "sum")]
    n_y, n_u = plain.D.shape
    F = np.hstack([np.eye(n_y), sign * np.eye(n_y)])
    wiring = Wiring(np.zeros((2 * n_u, 2 * n_y)), np.vstack([np.eye(n_u)] * 2), F)
    return interconnected(parts, wiring, plain.inputs, plain.outputs, "sum")


def feedback(forward: Any, back: Any = 1.0, sign: int | None = None) -> UncertainModel:
    r"""Return :math:`(I - sign\, G H)^{-1} G`, of ``y = G e``, ``e = r + sign H y``, with the signals of G."""
    g = as_uncertain(forward, "feedback")
    n_u, n_y = len(g.inputs), len(g.outputs)
    h, sign = return_path(g, back, sign, lambda given: as_uncertain(given, "feedback"), "a model")
    n = n_u + n_y
    K = ones(n, n, (n_u, 0, n_y)) + sign * ones(n, n, (0, n_y, n_u))
    wiring = Wiring(K, ones(n, n_u, (0, 0, n_u)), ones(n_y, n, (0, 0, n_y)))
    return interconnected([g, h], wiring, g.inputs, g.outputs, "feedback")


def return_path(g: Any, back: Any, sign: int | None, read: Callable[[Any], Any], kind: str) -> tuple[Any, int]:
    """Convert the return path H of a loop by ``read``, check it against G, and return it with the feedback's sign."""
    n_u, n_y = len(g.inputs), len(g.outputs)
    if is_number(back):
        if n_u != n_y:
            raise InputError("feedback", f"the number {back} around {n_y} x {n_u} channels", "a matrix or a model")
        back = float(back) * np.eye(n_u)
    back, sign, _ = feedback_loop(g, back, sign)
    h = read(back)
    if (len(h.outputs), len(h.inputs)) != (n_u, n_y):
        found = f"what is fed back is {len(h.outputs)} x {len(h.inputs)}"
        raise InputError("feedback", found, f"{n_u} x {n_y} for {kind} of {n_y} x {n_u}")
    same_units("feedback", [*zip(g.outputs, h.inputs, strict=True), *zip(h.outputs, g.inputs, strict=True)])
    return h, sign


def inverse(g: UncertainModel) -> UncertainModel:
    """Return the set of the inverses of a square set; inputs and outputs are exchanged."""
    n_u, n_y = len(g.inputs), len(g.outputs)
    if n_u != n_y:
        raise InputError("inverse", f"{n_y} x {n_u}", "a square model")
    m, (q, p), n = g.M, g.delta_shape, g.M.n_states
    if n_u and is_rank_deficient(m.D[p:, q:]):
        found = "D is singular at Delta = 0 (every block at its nominal value): the inverse is not proper"
        raise NoTrustworthyNumber("inverse", found)
    # u = D22^-1 (y - C2 x - D21 w), of (x, w, y)
    u = np.linalg.solve(m.D[p:, q:], np.hstack([-m.C[p:], -m.D[p:, :q], np.eye(n_u)]))
    rest = np.block([[m.A, m.B[:, :q], np.zeros((n, n_u))], [m.C[:p], m.D[:p, :q], np.zeros((p, n_u))]])
    rows = np.vstack([rest + np.vstack([m.B[:, q:], m.D[:p, q:]]) @ u, u])
    sides = unique_names([*m.inputs[:q], *g.outputs]), unique_names([*m.outputs[:p], *g.inputs])
    return UncertainModel(of_system_matrix(rows, n, m.dt, *sides, m.states, "inverse"), g.blocks)


@error_context("lft")
@carried_by_rank
def lft(first: Any, second: Any, n_to_second: int | None = None, n_to_first: int | None = None) -> UncertainModel:
    r"""Return the Redheffer star product of two models (Zhou, Doyle, Glover 1996, section 10.3).

    The last outputs of ``first`` drive the first inputs of ``second``, and its first outputs the last inputs of
    ``first``.

    Parameters
    ----------
    first, second
        Sets, models, matrices or numbers.
    n_to_second
        Number of signals from ``first`` to ``second``; by default as many as possible.
    n_to_first
        Number of signals back; likewise.

    Returns
    -------
    UncertainModel
        From (remaining inputs of first, remaining inputs of second) to (remaining outputs of first, of second).

    Raises
    ------
    InputError
        Numbers beyond the available signals.
    NoTrustworthyNumber
        The nominal loop is not well posed.
    """
    a, b = as_uncertain(first, "lft"), as_uncertain(second, "lft")
    (a_in, a_out), (b_in, b_out) = ((len(m.inputs), len(m.outputs)) for m in (a, b))
    go = min(a_out, b_in) if n_to_second is None else n_to_second
    back = min(a_in, b_out) if n_to_first is None else n_to_first
    whole("lft: n_to_second", go, 0, min(a_out, b_in))
    whole("lft: n_to_first", back, 0, min(a_in, b_out))
    meet = [*zip(a.outputs[a_out - go :], b.inputs[:go], strict=True)]
    same_units("lft", [*meet, *zip(b.outputs[:back], a.inputs[a_in - back :], strict=True)])
    n_u, n_y, v, o = a_in + b_in, a_out + b_out, a_in - back, a_out - go  # v, o: of the first that remain
    wiring = Wiring(
        K=ones(n_u, n_y, (v, a_out, back), (a_in, o, go)),
        E=ones(n_u, n_u - back - go, (0, 0, v), (a_in + go, v, b_in - go)),
        F=ones(n_y - go - back, n_y, (0, 0, o), (o, a_out + back, b_out - back)),
    )
    return interconnected([a, b], wiring, a.inputs[:v] + b.inputs[go:], a.outputs[:o] + b.outputs[back:], "lft")


def interconnected(
    parts: Sequence[UncertainModel], wiring: Wiring, inputs: Sequence[Signal], outputs: Sequence[Signal], where: str
) -> UncertainModel:
    """Return the sets in one interconnection; see `robustlab.uncertainty.lft`."""
    return UncertainModel(*joined([(g.M, g.blocks) for g in parts], wiring, inputs, outputs, where))
