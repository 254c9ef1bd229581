r"""Uncertain models as upper linear fractional transformations of a structured Delta.

.. math:: F_u(M, \Delta) = M_{22} + M_{21} \Delta (I - M_{11} \Delta)^{-1} M_{12}

References
----------
Březina 2010, sections 4.4-4.5; Zhou, Doyle, Glover, *Robust and Optimal Control* (1996), section 10.1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.frequency import frequency_response
from robustlab.provenance import Traced
from robustlab.statespace import OperatingPoint, Signal, StateSpaceModel, append, as_model, lower_lft
from robustlab.uncertainty.balancing import balanced
from robustlab.uncertainty.blocks import (
    Block,
    as_blocks,
    delta_matrix,
    structure_size,
)

__all__ = ["UncertainModel", "is_singular", "upper_lft"]

# I - M11 Delta with a condition number above this has no digits left that could be trusted.
ILL_POSED = 1e12


def is_singular(product: ArrayLike) -> bool:
    """Whether ``I - product`` is singular, or so near to it that nothing can be trusted; product has shape (n, n).

    Its determinant is that of its strongly connected parts: entries on no cycle do not count, however large they are.
    Nor must the units of the channels decide: each part is balanced first (a similarity by powers of two).
    """
    from scipy.sparse.csgraph import connected_components

    matrix = np.asarray(product)
    if not matrix.any():
        return False
    count, label = connected_components(matrix != 0, directed=True, connection="strong")
    for k in range(count):
        part = np.flatnonzero(label == k)
        inner = matrix[part[:, None], part]
        if inner.any() and not np.linalg.cond(np.eye(len(part)) - balanced(inner)) <= ILL_POSED:
            return True
    return False


def upper_lft(M: StateSpaceModel, delta: ArrayLike) -> StateSpaceModel:
    r"""``F_u(M, Delta)`` for a constant real Delta (q, p), which closes the first q inputs and p outputs of M.

    Raises
    ------
    NoTrustworthyNumber
        I - D11 Delta is singular: the perturbed model is not well posed.
    """
    d = np.asarray(delta)
    if np.iscomplexobj(d):
        raise InputError(
            "upper_lft", "a complex Delta", "a real one", "a complex Delta acts on frequency responses only"
        )
    q, p = d.shape
    n_w, n_z = M.n_inputs, M.n_outputs
    b1, b2 = M.B[:, :q], M.B[:, q:]
    c1, c2 = M.C[:p], M.C[p:]
    d11, d12, d21, d22 = M.D[:p, :q], M.D[:p, q:], M.D[p:, :q], M.D[p:, q:]
    if q > n_w or p > n_z:
        raise InputError("upper_lft", f"Delta is {d.shape}, M has {n_w} inputs and {n_z} outputs", "a smaller Delta")
    loop = np.eye(p) - d11 @ d
    if is_singular(d11 @ d):
        raise NoTrustworthyNumber("upper_lft", "I - D11 Delta is singular: this Delta makes the model ill-posed")
    # z = (I - D11 Delta)^-1 (C1 x + D12 u), w = Delta z
    gain = d @ np.linalg.solve(loop, np.hstack([c1, d12])) if p else np.zeros((q, M.n_states + n_w - q))
    w_x, w_u = gain[:, : M.n_states], gain[:, M.n_states :]
    return StateSpaceModel(
        M.A + b1 @ w_x,
        b2 + b1 @ w_u,
        c2 + d21 @ w_x,
        d22 + d21 @ w_u,
        M.dt,
        M.inputs[q:],
        M.outputs[p:],
        M.states,
        where="upper_lft",
    )


@dataclass(frozen=True, init=False, eq=False)
class UncertainModel(Traced):
    r"""A set of models ``F_u(M, Delta)`` over all block-diagonal Delta with normalised blocks; immutable.

    Parameters
    ----------
    M
        State-space model whose first q inputs ``w`` and first p outputs ``z`` are the Delta channels (``w = Delta z``).
    blocks
        The blocks of Delta in the order of those channels; see `robustlab.uncertainty.blocks.as_blocks`.
    operating_point
        Operating point of the nominal model.

    Raises
    ------
    InputError
        Fewer channels than the blocks need, block names used twice.

    Examples
    --------
    >>> M = StateSpaceModel([[-1.0]], [[-0.2, 1.0]], [[1.0], [1.0]], [[0.0, 0.0], [0.0, 0.0]])
    >>> lag = UncertainModel(M, [RealScalar("pole")])
    >>> lag.evaluate({"pole": 1.0}).A
    array([[-1.2]])
    """

    M: StateSpaceModel
    blocks: tuple[Block, ...]
    operating_point: OperatingPoint | None

    def __init__(self, M: StateSpaceModel, blocks: Any, operating_point: OperatingPoint | None = None) -> None:
        model = as_model(M, "UncertainModel: M")
        checked = as_blocks(blocks)
        q, p = structure_size(checked)
        if model.n_inputs < q or model.n_outputs < p:
            raise InputError(
                "UncertainModel",
                f"M has {model.n_inputs} inputs and {model.n_outputs} outputs",
                f"at least {q} and {p}: the blocks' channels come first",
            )
        put = object.__setattr__
        put(self, "M", model)
        put(self, "blocks", checked)
        put(self, "operating_point", operating_point)

    @property
    def delta_shape(self) -> tuple[int, int]:
        """``(q, p)``: shape of Delta."""
        return structure_size(self.blocks)

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """Inputs of the models in the set."""
        return self.M.inputs[self.delta_shape[0] :]

    @property
    def outputs(self) -> tuple[Signal, ...]:
        """Outputs of the models in the set."""
        return self.M.outputs[self.delta_shape[1] :]

    @property
    def dt(self) -> float:
        """Sample time in s; 0 means continuous time."""
        return self.M.dt

    @property
    def nominal(self) -> StateSpaceModel:
        """The model at Delta = 0."""
        q, p = self.delta_shape
        m = self.M
        return StateSpaceModel(
            m.A, m.B[:, q:], m.C[p:], m.D[p:, q:], m.dt, m.inputs[q:], m.outputs[p:], m.states, self.operating_point
        )

    def to_model(self) -> StateSpaceModel:
        """The nominal model, so that functions which take a model take the nominal one of a set."""
        return self.nominal

    @property
    def delta_channels(self) -> StateSpaceModel:
        """M11: the system from w to z that Delta sees."""
        q, p = self.delta_shape
        m = self.M
        return StateSpaceModel(m.A, m.B[:, :q], m.C[:p], m.D[:p, :q], m.dt, m.inputs[:q], m.outputs[:p], m.states)

    def evaluate(self, delta: Mapping[str, Any]) -> StateSpaceModel:
        """The member of the set for one real value (or matrix) per block name; blocks left out are zero.

        Values outside [-1, 1] are allowed: a critical Delta may be larger than the set. A full or complex block also
        takes a StateSpaceModel (rows x cols for a full block, 1 x 1 for a scalar one): a dynamic Delta, closed in. The
        member's states are then those of M followed by those of the Deltas.

        Raises
        ------
        InputError
            Unknown names, wrong shapes, complex values (those have a frequency response only: `response`), a dynamic
            value for a real block.
        NoTrustworthyNumber
            This Delta makes the model ill-posed; the message names its values.
        """
        dynamic = {name: value for name, value in delta.items() if isinstance(value, StateSpaceModel)}
        constant = delta_matrix(self.blocks, {name: v for name, v in delta.items() if name not in dynamic})
        try:
            return self._with_dynamics(constant, dynamic) if dynamic else upper_lft(self.M, constant)
        except NoTrustworthyNumber as error:
            raise NoTrustworthyNumber("evaluate", f"{error.found} ({self.named(delta)})") from None

    def _with_dynamics(self, constant: NDArray[Any], dynamic: Mapping[str, StateSpaceModel]) -> StateSpaceModel:
        """The member for a Delta with models in it."""
        q, p = constant.shape
        if np.iscomplexobj(constant):
            raise InputError("evaluate", "a complex Delta", "real numbers or models", "use response(omega, delta)")
        system = self._delta_system(constant, dynamic)
        if is_singular(self.M.D[:p, :q] @ system.D):
            raise NoTrustworthyNumber("evaluate", "I - D11 D_Delta is singular: this Delta makes the model ill-posed")
        order = self.M.input_names[q:] + self.M.input_names[:q], self.M.output_names[p:] + self.M.output_names[:p]
        return lower_lft(self.M.select(*order), system).renamed(self.inputs, self.outputs)

    def response(self, omega: ArrayLike, delta: Mapping[str, Any]) -> NDArray[np.complex128]:
        """Frequency response of the member for a real, complex or dynamic Delta, shape (n_omega, n_y, n_u)."""
        dynamic = {name: value for name, value in delta.items() if isinstance(value, StateSpaceModel)}
        d: NDArray[Any] = delta_matrix(self.blocks, {name: v for name, v in delta.items() if name not in dynamic})
        q, p = d.shape
        m = frequency_response(self.M, omega)
        if dynamic:
            d = d + frequency_response(self._delta_system(np.zeros((q, p)), dynamic), omega)
        loop = np.eye(p) - m[:, :p, :q] @ d
        return m[:, p:, q:] + m[:, p:, :q] @ d @ np.linalg.solve(loop, m[:, :p, q:])

    def _delta_system(self, constant: NDArray[Any], dynamic: Mapping[str, StateSpaceModel]) -> StateSpaceModel:
        """Delta(s), q x p: the constant values with the dynamic ones in their places."""
        known = {b.name for b in self.blocks}
        for name in dynamic:
            if name not in known:
                delta_matrix(self.blocks, {name: 0.0})  # says so
        parts: list[StateSpaceModel] = []
        row, col = 0, 0
        for b in self.blocks:
            value = constant[row : row + b.rows, col : col + b.cols]
            row, col = row + b.rows, col + b.cols
            if b.name not in dynamic:
                parts.append(StateSpaceModel([], [], [], value, self.dt))
                continue
            system = dynamic[b.name]
            if b.is_real:
                raise InputError(f"delta {b.name!r}", "a dynamic value for a real block", "a real number")
            shape, count = b.value_shape, b.rows // b.value_shape[0]
            if (system.n_outputs, system.n_inputs) != shape:
                found = f"a model of {system.n_outputs} x {system.n_inputs}"
                raise InputError(f"delta {b.name!r}", found, f"{shape[0]} x {shape[1]}")
            parts += [system] * count
        plain = [StateSpaceModel(s.A, s.B, s.C, s.D, s.dt, *_numbered(i, s)) for i, s in enumerate(parts)]
        return append(*plain)

    def named(self, delta: Mapping[str, Any]) -> str:
        """A Delta in words: normalised values, and the parameters' where they stand for any."""
        said = []
        for b in self.blocks:
            value = delta.get(b.name, 0.0)
            if isinstance(value, StateSpaceModel) or np.size(value) != 1:
                said.append(f"{b.name} = a {'model' if isinstance(value, StateSpaceModel) else 'matrix'}")
                continue
            text = f"{b.name} = {complex(np.asarray(value).reshape(())):.6g}".replace("+0j", "")
            if b.parameter is not None:
                parameter = b.parameter
                text += f": {parameter.value(float(np.real(value))):.6g} {parameter.unit}".rstrip()
            said.append(text)
        return "Delta: " + (", ".join(said[:12]) + (", ..." if len(said) > 12 else "") or "none")

    # --- algebra: see robustlab.uncertainty.algebra -------------------------------------------------------------------

    __array_ufunc__ = None  # numpy arrays on the left leave the operation to us

    def __matmul__(self, other: Any) -> UncertainModel:
        """``self @ other``: the product of the transfer matrices; ``other`` comes first in the signal's way."""
        from robustlab.uncertainty.algebra import product

        return product(self, other)

    def __rmatmul__(self, other: Any) -> UncertainModel:
        from robustlab.uncertainty.algebra import product

        return product(other, self)

    __mul__, __rmul__ = __matmul__, __rmatmul__

    def __add__(self, other: Any) -> UncertainModel:
        from robustlab.uncertainty.algebra import parallel

        return parallel(self, other)

    def __radd__(self, other: Any) -> UncertainModel:
        from robustlab.uncertainty.algebra import parallel

        return parallel(other, self)

    def __sub__(self, other: Any) -> UncertainModel:
        from robustlab.uncertainty.algebra import parallel

        return parallel(self, other, sign=-1)

    def __rsub__(self, other: Any) -> UncertainModel:
        from robustlab.uncertainty.algebra import parallel

        return parallel(other, self, sign=-1)

    def __neg__(self) -> UncertainModel:
        from robustlab.uncertainty.algebra import product

        return product(-1.0, self)

    def inverse(self) -> UncertainModel:
        """The set of the inverses; see `robustlab.uncertainty.algebra.inverse`."""
        from robustlab.uncertainty.algebra import inverse

        return inverse(self)

    def feedback(self, other: Any = 1.0, sign: int = -1) -> UncertainModel:
        """``y = self e, e = r + sign other y``; see `robustlab.uncertainty.algebra.feedback`."""
        from robustlab.uncertainty.algebra import feedback

        return feedback(self, other, sign)

    def weighted(self, weights: Mapping[str, Any], side: str = "z") -> UncertainModel:
        """Weights absorbed into the channels of named blocks; see `robustlab.uncertainty.dynamic_blocks.weighted`."""
        from robustlab.uncertainty.dynamic_blocks import weighted

        return weighted(self, weights, side)

    def physical(self, delta: Mapping[str, Any]) -> dict[str, tuple[float, str]]:
        """Parameter values and units that belong to a Delta, for real blocks that stand for a physical parameter."""
        return {
            b.name: (b.parameter.value(float(np.real(delta.get(b.name, 0.0)))), b.parameter.unit)
            for b in self.blocks
            if b.parameter is not None
        }

    def impossible(self, delta: Mapping[str, Any]) -> tuple[str, ...]:
        """One remark for each parameter value of a Delta that no real plant has (see `ParameterRange.impossible`)."""
        found = []
        for b in self.blocks:
            if b.parameter is not None and b.name in delta:
                value = b.parameter.value(float(np.real(delta[b.name])))
                if why := b.parameter.impossible(value):
                    text = f"{b.name} = {value:.6g} {b.parameter.unit}".rstrip()
                    found.append(f"{text} is physically impossible ({why}): no real plant is this one")
        return tuple(found)

    def select(self, inputs: Sequence[str] | None = None, outputs: Sequence[str] | None = None) -> UncertainModel:
        """The same set with the named inputs and outputs only."""
        q, p = self.delta_shape
        ins = list(self.M.input_names[:q]) + list(inputs if inputs is not None else self.M.input_names[q:])
        outs = list(self.M.output_names[:p]) + list(outputs if outputs is not None else self.M.output_names[p:])
        return UncertainModel(self.M.select(ins, outs), self.blocks)

    def close(self, K: StateSpaceModel) -> UncertainModel:
        """The uncertain closed loop ``u = K y``: y are the last ``K.n_inputs`` outputs, u the last inputs."""
        return UncertainModel(lower_lft(self.M, as_model(K, "close: K")), self.blocks)

    def reduce(self, tolerance: float = 1e-12) -> UncertainModel:
        """The same set with each scalar block repeated as rarely as its channels allow; `reduction` shows the evidence.

        Like the states of a transfer function in 1/s, repetitions that the channels cannot reach or that do not show
        are removed (Kalman decomposition, block by block and then jointly). A scalar block without any effect vanishes
        altogether: its name is then unknown to `evaluate`.

        Parameters
        ----------
        tolerance
            Singular values below ``tolerance`` times the largest count as zero.

        References
        ----------
        D'Andrea, Khatri, "Kalman decomposition of linear fractional transformation representations" (1997).
        """
        from robustlab.uncertainty.structured_reduction import reduction

        return reduction(self, tolerance).model

    def to_json(self) -> dict[str, object]:
        """M and blocks as plain types."""
        return {"M": self.M, "blocks": [b.to_json() for b in self.blocks]}

    def __repr__(self) -> str:
        kinds = [type(b).__name__ for b in self.blocks]
        count = ", ".join(f"{kinds.count(k)} {k}" for k in dict.fromkeys(kinds)) or "no uncertainty"
        return f"UncertainModel({self.M.n_states} states, Delta {self.delta_shape[0]} x {self.delta_shape[1]}: {count})"


def _numbered(index: int, system: StateSpaceModel) -> tuple[list[str], list[str]]:
    """Signal names that no other part of an appended system has."""
    return [f"z{index}.{j}" for j in range(system.n_inputs)], [f"w{index}.{j}" for j in range(system.n_outputs)]
