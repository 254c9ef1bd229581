r"""Random Deltas and vertices, drawn when they are asked for, and the members of a set of real scalars at them.

Sample i depends on the seed and on i alone. Many members are made at once without a Delta matrix for each: with
:math:`S = \begin{bmatrix} A & B \\ C & D \end{bmatrix}` and the diagonal :math:`\Delta = \mathrm{diag}(c)`,

.. math:: S(c) = S_0 + L \, \mathrm{diag}(c) \, (I - D_{11} \mathrm{diag}(c))^{-1} R,

which is :math:`S_0 + \sum_k c_k L_k R_k` where D11 = 0, as in element-wise sets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, overload

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.statespace import real_array
from robustlab.uncertainty.blocks import Block
from robustlab.uncertainty.lft import UncertainModel
from robustlab.uncertainty.upper_lft import ILL_POSED
from robustlab.worst_case_analysis.ensemble import Ensemble, lft_parts, split, state_scale

# "all" vertices are listed up to this many real deltas; subsets are drawn from a full list up to the same number.
MAX_LISTED = 16
# Members are computed in blocks that begin at its multiples: a sample's value must not depend on how many are drawn.
BLOCK = 512
BLOCK_NUMBERS = 2_000_000  # of large models, which take smaller blocks
TABLE = 4_000_000  # numbers of all L_k R_k up to which they are kept


def is_count(value: Any, least: int) -> bool:
    """Whether a number of samples, vertices or threads, or a seed, is a whole number, at least ``least``."""
    return not isinstance(value, bool) and isinstance(value, (int, np.integer)) and int(value) >= least


class Deltas(Sequence[Mapping[str, Any]]):
    """The Deltas of n random samples and of vertices after them, as a sequence of mappings of block names to values.

    None of them is kept: a million samples take no memory.

    ``blocks``: structure of Delta.
    ``n``: number of random samples; sample i is drawn from ``SeedSequence(seed, spawn_key=(i,))``.
    ``signs``: vertices (n_v, k) of the k real scalars; complex and full blocks are put on their boundary there, at
    random.
    """

    def __init__(self, blocks: Sequence[Block], n: int, seed: int, signs: Array) -> None:
        self.blocks, self.n, self.seed, self.signs = tuple(blocks), n, seed, signs
        self._reals = tuple(b.name for b in blocks if b.interval)
        self._asymmetric = [(k, b) for k, b in enumerate(self.blocks) if not b.is_symmetric]

    @property
    def all_real(self) -> bool:
        """Whether every block is a real scalar."""
        return len(self._reals) == len(self.blocks)

    def __len__(self) -> int:
        return self.n + len(self.signs)

    @overload
    def __getitem__(self, index: int) -> Mapping[str, Any]: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Mapping[str, Any], ...]: ...
    def __getitem__(self, index: int | slice) -> Mapping[str, Any] | tuple[Mapping[str, Any], ...]:
        if isinstance(index, slice):
            return tuple(self[i] for i in range(*index.indices(len(self))))
        if not -len(self) <= index < len(self):
            raise IndexError(f"sample {index} of {len(self)}")
        index %= len(self)
        if index < self.n:
            return delta_of_sample(self.blocks, self.seed, index)
        row = self.signs[index - self.n]
        values = delta_of_sample(self.blocks, self.seed, index - self.n, boundary=True)
        return {**values, **{name: float(s) for name, s in zip(self._reals, row, strict=True)}}

    def numbers(self, part: slice) -> Array:
        """Normalised values of the real scalars of some samples, shape (k, d); for sets of real scalars only."""
        inside = np.arange(part.start, max(part.start, min(part.stop, self.n)))
        drawn = np.array([_generator(self.seed, int(i)).uniform(-1.0, 1.0, len(self.blocks)) for i in inside])
        drawn = drawn.reshape(len(inside), len(self.blocks))
        for k, block in self._asymmetric:
            drawn[:, k] = [block.in_range(place) for place in drawn[:, k].tolist()]
        corners = self.signs[max(part.start - self.n, 0) : max(part.stop - self.n, 0)]
        return np.concatenate([drawn, corners]) if len(corners) else drawn

    def to_json(self) -> list[Mapping[str, Any]]:
        """All of them."""
        return list(self)


def delta_of_sample(blocks: Sequence[Block], seed: int, index: int, *, boundary: bool = False) -> dict[str, Any]:
    """Delta of one sample: it depends on the blocks, the seed and the sample's index, and on nothing else.

    ``boundary``: complex scalars and full blocks on their boundary, as at vertices (drawn apart from the samples
    inside).

    Examples
    --------
    >>> from robustlab.uncertainty.blocks import RealScalar
    >>> block = RealScalar("pole")
    >>> delta_of_sample([block], 7, 1)["pole"] == delta_of_sample([block], 7, 1)["pole"]
    True
    """
    key = (index, 1) if boundary else (index,)
    rng = _generator(seed, *key)
    return {block.name: block.draw(rng, boundary) for block in blocks}


def _generator(seed: int, *key: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))


def vertex_signs(k: int, count: int | Literal["all"], seed: int) -> Array:
    """Vertices of the box [-1, 1]^k, shape (n, k): all where ``count`` allows it, else so many seeded ones."""
    if count == "all" and k > MAX_LISTED:
        hint = "ask for a number of vertices"
        raise InputError("sample", f"all vertices of {k} real deltas (2^{k})", f"at most 2^{MAX_LISTED}", hint)
    number = 2**k if count == "all" else count
    if number == 0:
        return np.zeros((0, k))
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0, 2)))
    if k > MAX_LISTED:
        # Equal draws are rare among so many vertices; where they happen, fewer different ones come back.
        drawn = rng.integers(0, 2, (number, k))
        bits = drawn[np.sort(np.unique(drawn, axis=0, return_index=True)[1])]
        return real_array("vertices", 2 * bits - 1, 2)
    order = np.arange(2**k) if number >= 2**k else rng.permutation(2**k)[:number]
    bits = (order[:, None] >> np.arange(k)[::-1]) & 1
    return real_array("vertices", 2 * bits - 1, 2)


class RealSet:
    """A set of real scalar blocks, prepared for the evaluation of many members.

    `block` is how many members belong in one call.

    ``uncertain``: a set whose blocks are all `RealScalar`.
    """

    def __init__(self, uncertain: UncertainModel) -> None:
        m, blocks = uncertain.M, uncertain.blocks
        ends = [b.interval for b in blocks if b.interval]
        assert len(ends) == len(blocks)
        self.n_states, self.dt = m.n_states, m.dt
        self.below = np.array([-low for low, _ in ends])
        self.of_channel = np.repeat(np.arange(len(blocks)), [b.rows for b in blocks])
        self._scale = state_scale(m.A)
        self._left, self._right, self._d11, self._nominal = lft_parts(uncertain)
        self._table: Array | None = None
        self.block = max(1, min(BLOCK, BLOCK_NUMBERS // max(1, self._nominal.size)))
        small = self.block == BLOCK and len(blocks) * self._nominal.size <= TABLE
        if not self._d11.any() and small:
            products = self._left.T[:, :, None] * self._right[:, None, :]
            table = np.zeros((len(blocks), *self._nominal.shape))
            np.add.at(table, self.of_channel, products)
            self._table = table.reshape(len(blocks), self._nominal.size)

    def __len__(self) -> int:
        return len(self.below)

    def channels(self, theta: Array) -> Array:
        """The numbers on Delta's diagonal (k, q) that belong to normalised deltas (k, d)."""
        return np.where(theta < 0, theta * self.below, theta)[:, self.of_channel]

    def drawn(self, deltas: Deltas, part: slice, where: str) -> Ensemble:
        """The members at some of the samples. Raises NoTrustworthyNumber: one of them is ill-posed."""
        ensemble = self.members(deltas.numbers(part))
        if ensemble.ill_posed.any():
            index = part.start + int(np.argmax(ensemble.ill_posed))
            found = f"sample {index} makes the model ill-posed (I - D11 Delta is singular): {deltas[index]}"
            raise NoTrustworthyNumber(where, found)
        return ensemble

    def members(self, theta: Array) -> Ensemble:
        """The members at normalised deltas (k, d)."""
        k = len(theta)
        ill_posed = np.zeros(k, dtype=bool)
        if self._table is not None:
            # Filled up to whole blocks: a product of another shape may round differently.
            numbers = np.zeros((-(-k // BLOCK) * BLOCK, len(self)))
            numbers[:k] = np.where(theta < 0, theta * self.below, theta)
            change = np.concatenate([numbers[i : i + BLOCK] @ self._table for i in range(0, len(numbers), BLOCK)])
            whole = self._nominal + change[:k].reshape(k, *self._nominal.shape)
            return split(whole, self.n_states, self.dt, ill_posed, self._scale)
        diagonal = self.channels(theta)
        right: NDArray[Any] = np.broadcast_to(self._right, (k, *self._right.shape))
        if self._d11.any():
            loop = np.eye(len(self._d11)) - self._d11 * diagonal[:, None, :]
            ill_posed = ~(np.linalg.cond(loop) <= ILL_POSED)
            loop[ill_posed] = np.eye(len(self._d11))
            diagonal = np.where(ill_posed[:, None], 0.0, diagonal)
            right = np.linalg.solve(loop, right)
        whole = self._nominal + (self._left * diagonal[:, None, :]) @ right
        return split(whole, self.n_states, self.dt, ill_posed, self._scale)
