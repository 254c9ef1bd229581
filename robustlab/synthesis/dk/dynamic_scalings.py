r"""Rational scalings D(s), G(s) of a block structure that prove a bound of mu at every frequency at once.

.. math:: \| D_z M D_w^{-1} G_M / \beta - G_N \|_\infty \le 1 \quad \Rightarrow \quad \sup_\omega \mu(M) \le \beta

Young, "Robustness with parametric and dynamic uncertainty" (1993), chapter 9; Fan, Tits, Doyle (1991).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.norms import HinfNorm, hinf_norm
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.problem.partition import PlantMatrices, Realisation
from robustlab.uncertainty.blocks import Block, block_slices, structure_size


@dataclass(frozen=True)
class Factor:
    """One scalar factor d(s) by its logarithms; 2 numbers a first-order section, 4 a second-order one."""

    log_gain: float = 0.0  # `log d(0)`
    # `(log z, log p)` or `(log w_z, log 2 zeta_z, log w_p, log 2 zeta_p)`, frequencies in rad/s; sections of second
    # order come first.
    sections: tuple[tuple[float, ...], ...] = ()

    @property
    def order(self) -> int:
        """Number of states."""
        return sum(len(section) // 2 for section in self.sections)

    def parameters(self) -> list[float]:
        """All logarithms in a row."""
        return [self.log_gain, *(value for section in self.sections for value in section)]

    def with_parameters(self, values: Iterator[float]) -> Factor:
        """The same form with the next numbers of ``values``."""
        gain = float(next(values))
        return Factor(gain, tuple(tuple(float(next(values)) for _ in section) for section in self.sections))

    def with_section(self, log_zero: float, log_pole: float) -> Factor:
        """One order higher: times ``(s/z + 1) / (s/p + 1)``; two sections of first order become one of second."""
        return replace(self, sections=_extended(self.sections, log_zero, log_pole))

    def realisation(self) -> Realisation:
        """States, input, output and direct term of d(s), sections in series."""
        return _realised(self)

    def log_modulus(self, omega: AnyArray) -> AnyArray:
        """``log |d(j omega)|``, shape (n_omega,)."""
        result = np.full(len(omega), self.log_gain)
        for section in self.sections:
            half = len(section) // 2
            result += _log_modulus(section[:half], omega) - _log_modulus(section[half:], omega)
        return result


@lru_cache(maxsize=4096)
def _realised(factor: Factor) -> Realisation:
    n = factor.order
    A, B, C, D = np.zeros((n, n)), np.zeros((n, 1)), np.zeros((1, n)), np.array([[np.exp(factor.log_gain)]])
    at = 0
    for section in factor.sections:
        a, b, c, d = _section(section)
        here, before = slice(at, at + len(a)), slice(0, at)
        A[here, here], A[here, before] = a, b @ C[:, before]
        B[here] = b @ D
        C[:, before] *= d
        C[:, here] = c
        D, at = d * D, at + len(a)
    return Realisation(A, B, C, D)


@lru_cache(maxsize=4096)
def _inverse(factor: Factor) -> Realisation:
    A, B, C, D = _realised(factor)
    return Realisation(A - B @ C / D, B / D, -C / D, 1 / D)


def _section(values: tuple[float, ...]) -> Realisation:
    if len(values) == 2:
        zero, pole = np.exp(values)
        d = pole / zero
        return Realisation(np.array([[-pole]]), np.array([[pole]]), np.array([[1 - d]]), np.array([[d]]))
    w_z, two_z, w_p, two_p = np.exp(values)
    d = (w_p / w_z) ** 2
    A = np.array([[0.0, w_p], [-w_p, -two_p * w_p]])
    C = np.array([[1 - d, two_z * w_p / w_z - d * two_p]])
    return Realisation(A, np.array([[0.0], [w_p]]), C, np.array([[d]]))


def _log_modulus(values: tuple[float, ...], omega: AnyArray) -> AnyArray:
    with np.errstate(over="ignore"):
        ratio = omega / np.exp(values[0])
        if len(values) == 1:
            return 0.5 * np.log1p(ratio**2)
        return 0.5 * np.log((1 - ratio**2) ** 2 + (np.exp(values[1]) * ratio) ** 2)


@dataclass(frozen=True)
class CoprimePair:
    """G_M and G_N of one real channel."""

    # `(log p, log q)` or `(log w_p, log 2 zeta_p, log w_q, log 2 zeta_q)` of V and U; none: G = 0.
    sections: tuple[tuple[float, ...], ...] = ()

    @property
    def n_states(self) -> int:
        """States of U and V together."""
        return sum(map(len, self.sections))

    def with_parameters(self, values: Iterator[float]) -> CoprimePair:
        """The same form with the next numbers of ``values``."""
        return CoprimePair(tuple(tuple(float(next(values)) for _ in section) for section in self.sections))

    def with_section(self, log_p: float, log_q: float) -> CoprimePair:
        """One order higher; where p = q it leaves G as it is."""
        return CoprimePair(_extended(self.sections, log_p, log_q))

    def realisation(self) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
        """``(A, B, F, C)`` with ``G_M = 1 + F (sI - A)^-1 B`` and ``G_N = C (sI - A)^-1 B``."""
        return _coprime(self)


def _extended(sections: tuple[tuple[float, ...], ...], one: float, two: float) -> tuple[tuple[float, ...], ...]:
    """Sections with a pair of first-order numbers more; a pair that is there already is merged with it."""
    last = sections[-1] if sections else ()
    if len(last) != 2:
        return (*sections, (one, two))
    merged: list[float] = []
    for old, new in zip(last, (one, two), strict=True):
        middle = 0.5 * (old + new)  # (s + a)(s + b): w = sqrt(a b), 2 zeta = (a + b) / w
        merged += [middle, float(np.logaddexp(old, new) - middle)]
    return (*sections[:-1], tuple(merged))


@dataclass(frozen=True, eq=False)
class BlockScaling:
    """Scalings of one block."""

    # One for a full block, one a channel for a repeated scalar, none for the block whose D is one.
    factors: tuple[Factor, ...]
    mixing: tuple[float, ...] = ()  # entries of T above the diagonal, row by row
    g: tuple[CoprimePair, ...] = ()  # for each channel of a real scalar its G

    @property
    def order(self) -> int:
        """Orders of all factors."""
        return sum(factor.order for factor in self.factors)

    @property
    def g_states(self) -> int:
        """States of all G."""
        return sum(pair.n_states for pair in self.g)

    def with_factor(self, k: int, factor: Factor) -> BlockScaling:
        """With one factor replaced."""
        return replace(self, factors=(*self.factors[:k], factor, *self.factors[k + 1 :]))

    def with_pair(self, k: int, pair: CoprimePair) -> BlockScaling:
        """With the G of one channel replaced."""
        return replace(self, g=(*self.g[:k], pair, *self.g[k + 1 :]))

    def triangular(self) -> AnyArray:
        """T, shape (r, r)."""
        r = len(self.factors)
        T = np.eye(r)
        if self.mixing:
            T[np.triu_indices(r, 1)] = self.mixing
        return T


@dataclass(frozen=True, eq=False)
class DynamicScalings:
    """D(s) and G(s) of a whole structure; see the module's docstring."""

    blocks: tuple[Block, ...]
    parts: tuple[BlockScaling, ...]

    @property
    def orders(self) -> tuple[int, ...]:
        """Order of D, and of G, that each block brings."""
        return tuple(part.order + part.g_states for part in self.parts)

    @property
    def n_states(self) -> int:
        """Number of states that a plant gets when it is scaled."""
        total = 0
        for block, part in zip(self.blocks, self.parts, strict=True):
            sides = block.rows + block.cols if block.d_order == 1 else 2
            total += part.order * sides + part.g_states
        return total

    @property
    def mixed(self) -> bool:
        """Whether there is a G."""
        return any(part.g_states for part in self.parts)

    def parameters(self) -> AnyArray:
        """All free parameters, shape (n_theta,)."""
        values: list[float] = []
        for part in self.parts:
            for factor in part.factors:
                values += factor.parameters()
            values += part.mixing
            values += [value for pair in part.g for section in pair.sections for value in section]
        return np.array(values)

    def with_parameters(self, theta: AnyArray) -> DynamicScalings:
        """The same form with other parameters."""
        values = iter(theta)
        parts = []
        for part in self.parts:
            factors = tuple(factor.with_parameters(values) for factor in part.factors)
            mixing = tuple(float(next(values)) for _ in part.mixing)
            g = tuple(pair.with_parameters(values) for pair in part.g)
            parts.append(BlockScaling(factors, mixing, g))
        return replace(self, parts=tuple(parts))

    def with_part(self, index: int, part: BlockScaling) -> DynamicScalings:
        """With the scalings of one block replaced."""
        return replace(self, parts=(*self.parts[:index], part, *self.parts[index + 1 :]))

    def to_json(self) -> list[dict[str, object]]:
        return [
            {
                "block": block.name,
                "factors": [{"log_gain": f.log_gain, "sections": f.sections} for f in part.factors],
                "mixing": part.mixing,
                "g": [pair.sections for pair in part.g],
            }
            for block, part in zip(self.blocks, self.parts, strict=True)
        ]

    def on_outputs(self) -> Realisation:
        """``D_z(s)``, shape (p, p)."""
        pieces = [
            (factor.realisation(), i)
            for block, part, (_, z) in self._with_slices()
            for factor, i in _channels(block, part, z.start, block.cols)
        ]
        scaling = self._diagonal(pieces, 1)
        if not self._mixes:
            return scaling
        A, B, C, D = scaling
        T = self._mixing(1)
        return Realisation(A, B @ T, C, D @ T)

    def on_inputs(self) -> Realisation:
        """``D_w(s)^{-1}``, shape (q, q)."""
        pieces = [
            (_inverse(factor), i)
            for block, part, (w, _) in self._with_slices()
            for factor, i in _channels(block, part, w.start, block.rows)
        ]
        scaling = self._diagonal(pieces, 0)
        if not self._mixes:
            return scaling
        A, B, C, D = scaling
        back = np.linalg.inv(self._mixing(0))
        return Realisation(A, B, back @ C, back @ D)

    def coprime(self) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
        """``(A, B, F, C)`` with ``G_M = I + F (sI - A)^-1 B`` (q x q) and ``G_N = C (sI - A)^-1 B`` (p x q)."""
        q, p = structure_size(self.blocks)
        pieces = []
        for _, part, (w, z) in self._with_slices():
            pieces += [(g.realisation(), w.start + i, z.start + i) for i, g in enumerate(part.g) if g.sections]
        n = sum(len(piece[0][0]) for piece in pieces)
        A, B, F, C = np.zeros((n, n)), np.zeros((n, q)), np.zeros((q, n)), np.zeros((p, n))
        at = 0
        for (a, b, f, c), i, j in pieces:
            m = len(a)
            A[at : at + m, at : at + m], B[at : at + m, i] = a, b[:, 0]
            F[i, at : at + m], C[j, at : at + m] = f[0], c[0]
            at += m
        return A, B, F, C

    def _with_slices(self) -> list[tuple[Block, BlockScaling, tuple[slice, slice]]]:
        return list(zip(self.blocks, self.parts, block_slices(self.blocks), strict=True))

    def _diagonal(self, pieces: list[tuple[Realisation, int]], side: int) -> Realisation:
        """The factors on their channels, and one on those of blocks whose D is one."""
        size, n = structure_size(self.blocks)[side], sum(len(piece[0][0]) for piece in pieces)
        A, B, C, D = np.zeros((n, n)), np.zeros((n, size)), np.zeros((size, n)), np.zeros((size, size))
        for _, part, where in self._with_slices():
            if not part.factors:
                D[where[side], where[side]] = np.eye(where[side].stop - where[side].start)
        at = 0
        for (a, b, c, d), i in pieces:
            here = slice(at, at + len(a))
            A[here, here], B[here, i], C[i, here], D[i, i] = a, b[:, 0], c[0], d[0, 0]
            at += len(a)
        return Realisation(A, B, C, D)

    @property
    def _mixes(self) -> bool:
        return any(part.mixing for part in self.parts)

    def _mixing(self, side: int) -> AnyArray:
        T = np.eye(structure_size(self.blocks)[side])
        for _, part, where in self._with_slices():
            if part.mixing:
                T[where[side], where[side]] = part.triangular()
        return T


def _channels(block: Block, part: BlockScaling, start: int, size: int) -> list[tuple[Factor, int]]:
    """Each factor with each of its channels; the one factor of a full block comes once for every channel."""
    if not part.factors:
        return []
    factors = part.factors * size if block.d_order == 1 else part.factors
    return [(factor, start + i) for i, factor in enumerate(factors)]


@lru_cache(maxsize=4096)
def _coprime(pair: CoprimePair) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
    halves = [[section[: len(section) // 2] for section in pair.sections]]
    halves.append([section[len(section) // 2 :] for section in pair.sections])
    (A_v, B_v, C_v), (A_u, B_u, C_u) = (_all_pass(half) for half in halves)
    n = len(A_u)
    A = np.zeros((2 * n, 2 * n))
    A[:n, :n], A[n:, n:] = A_u, A_v
    return A, np.vstack([B_u, B_v]), np.hstack([C_u, C_v]) / 2, np.hstack([C_u, -C_v]) / 2


def _all_pass(sections: list[tuple[float, ...]]) -> tuple[AnyArray, AnyArray, AnyArray]:
    """States, input, output of the product of ``(s - a)/(s + a)``, ``(s^2 - e s + w^2)/(s^2 + e s + w^2)``; D = 1."""
    n = sum(map(len, sections))
    A, B, C = np.zeros((n, n)), np.zeros((n, 1)), np.zeros((1, n))
    at = 0
    for section in sections:
        m = len(section)
        if m == 1:
            w = e = float(np.exp(section[0]))
            a = np.array([[-w]])
        else:
            w = float(np.exp(section[0]))
            e = w * float(np.exp(section[1]))
            a = np.array([[0.0, w], [-w, -e]])
        root = np.sqrt(2 * e)
        here = slice(at, at + m)
        A[here, here] = a
        A[at + m - 1, :at] = root * C[0, :at]
        B[at + m - 1], C[0, at + m - 1] = root, -root
        at += m
    return A, B, C


def reference_block(blocks: Sequence[Block]) -> int | None:
    """The block whose D is one: of those with a scalar D the one whose D would cost most states; None: none has one."""
    scalar = [(block.rows + block.cols, i) for i, block in enumerate(blocks) if block.d_order == 1]
    return max(scalar)[1] if scalar else None


def unit_scalings(blocks: Sequence[Block]) -> DynamicScalings:
    """D = I, G = 0."""
    one = reference_block(blocks)
    parts = []
    for i, block in enumerate(blocks):
        r = block.d_order
        factors = () if i == one else (Factor(),) * r
        g = (CoprimePair(),) * r if block.g_basis() else ()
        parts.append(BlockScaling(factors, (0.0,) * (r * (r - 1) // 2), g))
    return DynamicScalings(tuple(blocks), tuple(parts))


# --- what they prove --------------------------------------------------------------------------------------------------


def plant_at_level(p: PlantMatrices, scalings: DynamicScalings, beta: float) -> PlantMatrices:
    """The plant with these scalings at a level; channels beyond the blocks (regularisation) get beta alone."""
    _, n_w, n_u, n_z, n_y = p.sizes
    q, r = structure_size(scalings.blocks)
    Az, Bz, Cz, Dz = _padded(scalings.on_outputs(), n_z - r)
    Aw, Bw, Cw, Dw = _padded(scalings.on_inputs(), n_w - q)
    Ag, Bg, F, Cg = scalings.coprime()
    Bg = np.hstack([Bg, np.zeros((len(Ag), n_w - q))])
    F = np.vstack([F, np.zeros((n_w - q, len(Ag)))]) / beta
    Cg = np.vstack([Cg, np.zeros((n_z - r, len(Ag)))])
    n, a, b, g = len(p.A), len(Az), len(Aw), len(Ag)
    A = np.zeros((n + a + b + g,) * 2)
    x, z, w, c = slice(0, n), slice(n, n + a), slice(n + a, n + a + b), slice(n + a + b, None)
    A[x, x], A[x, w], A[x, c] = p.A, p.B1 @ Cw, p.B1 @ (Dw @ F)
    A[z, x], A[z, z], A[z, w], A[z, c] = Bz @ p.C1, Az, Bz @ (p.D11 @ Cw), Bz @ (p.D11 @ (Dw @ F))
    A[w, w], A[w, c], A[c, c] = Aw, Bw @ F, Ag
    Dw = Dw / beta
    B1, B2 = np.zeros((len(A), n_w)), np.zeros((len(A), n_u))
    B1[x], B1[z], B1[w], B1[c] = p.B1 @ Dw, Bz @ (p.D11 @ Dw), Bw / beta, Bg
    B2[x], B2[z] = p.B2, Bz @ p.D12
    C1, C2 = np.zeros((n_z, len(A))), np.zeros((n_y, len(A)))
    C1[:, x], C1[:, z], C1[:, w] = Dz @ p.C1, Cz, Dz @ (p.D11 @ Cw)
    C1[:, c] = Dz @ (p.D11 @ (beta * Dw @ F)) - Cg
    C2[:, x], C2[:, w], C2[:, c] = p.C2, p.D21 @ Cw, p.D21 @ (beta * Dw @ F)
    return PlantMatrices(A, B1, B2, C1, C2, Dz @ p.D11 @ Dw, Dz @ p.D12, p.D21 @ Dw)


def _padded(system: Realisation, extra: int) -> Realisation:
    """With ``extra`` channels more that go straight through."""
    A, B, C, D = system
    if not extra:
        return system
    n, m = len(A), len(D)
    direct = np.eye(m + extra)
    direct[:m, :m] = D
    return Realisation(A, np.hstack([B, np.zeros((n, extra))]), np.vstack([C, np.zeros((extra, n))]), direct)


def loop_at_level(loop: StateSpaceModel, scalings: DynamicScalings, beta: float = 1.0) -> StateSpaceModel:
    """A continuous loop, whose inputs and outputs are those of the blocks, with these scalings at a level."""
    none_in, none_out = np.zeros((loop.n_states, 0)), np.zeros((0, loop.n_states))
    bare = PlantMatrices(
        loop.A, loop.B, none_in, loop.C, none_out, loop.D, np.zeros((loop.n_outputs, 0)), np.zeros((0, loop.n_inputs))
    )
    s = plant_at_level(bare, scalings, beta)
    return StateSpaceModel(s.A, s.B1, s.C1, s.D11, where="scaled loop")


def proved_level(
    loop: StateSpaceModel, scalings: DynamicScalings, guess: float = 1.0, rtol: float = 1e-6
) -> tuple[float, HinfNorm]:
    """Smallest beta that these scalings prove for mu of a stable continuous loop at all frequencies; inf where none."""
    norm = hinf_norm(loop_at_level(loop, scalings), rtol)
    if not scalings.mixed:
        return norm.upper, norm
    low, high, step, proof = 0.0, np.inf, 1e-4, None
    trial = guess
    for _ in range(80):
        norm = hinf_norm(loop_at_level(loop, scalings, trial), min(rtol, 1e-7))
        if norm.upper <= 1:
            high, proof = trial, norm
        else:
            low = trial
        if proof is not None and high - low <= rtol * high:
            break
        if proof is None:
            trial = low * (1 + step)
        else:
            trial = high * (1 - step) if low == 0.0 else float(np.sqrt(low * high))
        step = min(3 * step, 0.9)
    return (float("inf"), norm) if proof is None else (high, proof)
