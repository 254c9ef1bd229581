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
from robustlab.statespace import OperatingPoint, Signal, StateSpaceModel, as_model, lower_lft
from robustlab.uncertainty.blocks import (
    Block,
    RealScalar,
    as_blocks,
    delta_matrix,
    structure_size,
)

__all__ = ["UncertainModel", "upper_lft"]

# I - M11 Delta with a condition number above this has no digits left that could be trusted.
ILL_POSED = 1e12


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
    if p and q and np.linalg.cond(loop) > ILL_POSED:
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
class UncertainModel:
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

        Values outside [-1, 1] are allowed: a critical Delta may be larger than the set.

        Raises
        ------
        InputError
            Unknown names, wrong shapes, complex values (those have a frequency response only: `response`).
        NoTrustworthyNumber
            This Delta makes the model ill-posed.
        """
        return upper_lft(self.M, delta_matrix(self.blocks, delta))

    def response(self, omega: ArrayLike, delta: Mapping[str, Any]) -> NDArray[np.complex128]:
        """Frequency response of the member for a real or complex Delta, shape (n_omega, n_y, n_u)."""
        d = delta_matrix(self.blocks, delta)
        q, p = d.shape
        m = frequency_response(self.M, omega)
        loop = np.eye(p) - m[:, :p, :q] @ d
        return m[:, p:, q:] + m[:, p:, :q] @ d @ np.linalg.solve(loop, m[:, :p, q:])

    def physical(self, delta: Mapping[str, Any]) -> dict[str, tuple[float, str]]:
        """Parameter values and units that belong to a Delta, for real blocks that stand for a physical parameter."""
        return {
            b.name: (b.parameter.value(float(np.real(delta.get(b.name, 0.0)))), b.parameter.unit)
            for b in self.blocks
            if isinstance(b, RealScalar) and b.parameter is not None
        }

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
        """The same set with each repeated scalar block repeated as rarely as its own channels allow.

        Block i alone is an LFT in one variable; like the states of a transfer function in 1/s, repetitions that its
        channels cannot reach or that do not show at its outputs are removed (Kalman decomposition, one block after the
        other).
        A scalar block without any effect vanishes altogether: its name is then unknown to `evaluate`.

        Parameters
        ----------
        tolerance
            Singular values below ``tolerance`` times the largest count as zero.

        References
        ----------
        D'Andrea, Khatri, "Kalman decomposition of linear fractional transformation representations" (1997).
        """
        from robustlab.uncertainty.reduction import reduce_blocks

        m, blocks = reduce_blocks(self.M, self.blocks, tolerance)
        return UncertainModel(m, blocks, self.operating_point)

    def to_json(self) -> dict[str, object]:
        """M and blocks as plain types."""
        return {"M": self.M, "blocks": [_block_json(b) for b in self.blocks]}

    def __repr__(self) -> str:
        kinds = [type(b).__name__ for b in self.blocks]
        count = ", ".join(f"{kinds.count(k)} {k}" for k in dict.fromkeys(kinds)) or "no uncertainty"
        return f"UncertainModel({self.M.n_states} states, Delta {self.delta_shape[0]} x {self.delta_shape[1]}: {count})"


def _block_json(block: Block) -> dict[str, object]:
    data: dict[str, object] = {"name": block.name, "kind": type(block).__name__, "rows": block.rows, "cols": block.cols}
    if isinstance(block, RealScalar) and block.parameter is not None:
        data["parameter"] = block.parameter.to_json()
    return data
