r"""Rational scalings D(s), G(s) of a block structure that prove a bound of mu at every frequency at once.

.. math:: \| D_z M D_w^{-1} G_M / \beta - G_N \|_\infty \le 1 \quad \Rightarrow \quad \sup_\omega \mu(M) \le \beta

Young, "Robustness with parametric and dynamic uncertainty" (1993), chapter 9; Fan, Tits, Doyle (1991).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, reduce
from itertools import chain
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.norms import HinfNorm, hinf_norm
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.problem.partition import PlantMatrices, Realisation
from robustlab.uncertainty.blocks import Block, block_slices, structure_size

Sections = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Factor:
    """A scalar factor d(s), stable with a stable inverse, by its logarithms, which are free parameters.

    ``k (s/z + 1)/(s/p + 1) prod (s^2/w_z^2 + 2 zeta_z s/w_z + 1)/(s^2/w_p^2 + 2 zeta_p s/w_p + 1)``.
    """

    log_gain: float = 0.0  # `log d(0)`
    # `(log w_z, log 2 zeta_z, log w_p, log 2 zeta_p)`, then at most one `(log z, log p)`; frequencies in rad/s.
    sections: Sections = ()

    @property
    def order(self) -> int:
        """Number of states."""
        return sum(map(len, self.sections)) // 2

    def parameters(self) -> list[float]:
        """Return all logarithms in a list."""
        return [self.log_gain, *chain(*self.sections)]

    @property
    def inverse(self) -> Factor:
        """The factor 1 / d(s)."""
        swapped = tuple((*s[len(s) // 2 :], *s[: len(s) // 2]) for s in self.sections)
        return Factor(-self.log_gain, swapped)

    def with_parameters(self, values: Iterator[float]) -> Factor:
        """Return a factor of the same form with the next numbers of ``values``."""
        return Factor(float(next(values)), _taken(self.sections, values))

    def with_section(self, log_zero: float, log_pole: float) -> Factor:
        """Multiply by ``(s/z + 1) / (s/p + 1)``; two sections of first order become one of second."""
        return replace(self, sections=_extended(self.sections, log_zero, log_pole))

    def log_modulus(self, omega: AnyArray) -> AnyArray:
        """Return ``log |d(j omega)|``, shape (n_omega,)."""
        result = np.full(len(omega), self.log_gain)
        for section in self.sections:
            half = len(section) // 2
            result += _log_modulus(section[:half], omega) - _log_modulus(section[half:], omega)
        return result


def _put(items: tuple[Any, ...], at: int, new: Any) -> tuple[Any, ...]:
    return (*items[:at], new, *items[at + 1 :])


def _taken(sections: Sections, values: Iterator[float]) -> Sections:
    return tuple(tuple(float(next(values)) for _ in section) for section in sections)


@lru_cache(maxsize=4096)
def _realised(factor: Factor) -> Realisation:
    """Return a realisation of d(s), sections in series."""
    return reduce(_in_series, map(_section, factor.sections), _gain(np.exp(factor.log_gain)))


def _gain(k: float) -> Realisation:
    return Realisation(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[k]]))


def _in_series(first: Realisation, second: Realisation) -> Realisation:
    """Return the second system driven by the first, whose states come first."""
    n, m = len(first.A), len(second.A)
    A, B = np.zeros((n + m, n + m)), np.empty((n + m, first.B.shape[1]))
    A[:n, :n], A[n:, :n], A[n:, n:] = first.A, second.B @ first.C, second.A
    B[:n], B[n:] = first.B, second.B @ first.D
    return Realisation(A, B, np.hstack([second.D @ first.C, second.C]), second.D @ first.D)


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
    """G_M and G_N of a real channel: half the sum and half the difference of two all-pass functions U and V.

    ``|G_M|^2 + |G_N|^2 = 1``, and G = G_N / G_M is imaginary on the axis; it vanishes where U = V.
    """

    # `(log p, log q)` or `(log w_p, log 2 zeta_p, log w_q, log 2 zeta_q)` of V and U; none: G = 0.
    sections: Sections = ()

    @property
    def n_states(self) -> int:
        """States of U and V together."""
        return sum(map(len, self.sections))

    def with_section(self, log_p: float, log_q: float) -> CoprimePair:
        """Increase the order by one; for p = q, G does not change."""
        return CoprimePair(_extended(self.sections, log_p, log_q))


def _extended(sections: Sections, one: float, two: float) -> Sections:
    """Return sections with a first-order pair more, merged with an existing first-order pair."""
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

    # One for a full block, one per channel for a repeated scalar, none for the block with D = 1.
    factors: tuple[Factor, ...]
    mixing: tuple[float, ...] = ()  # of a repeated scalar D = diag(d) T: entries of the unit triangular T, row by row
    g: tuple[CoprimePair, ...] = ()  # G for each channel of a real scalar

    @property
    def order(self) -> int:
        """Sum of the orders of all factors."""
        return sum(factor.order for factor in self.factors)

    @property
    def g_states(self) -> int:
        """Number of states of all G."""
        return sum(pair.n_states for pair in self.g)


@dataclass(frozen=True, eq=False)
class DynamicScalings:
    """D(s) and G(s) of a whole structure; see the module's docstring."""

    blocks: tuple[Block, ...]
    parts: tuple[BlockScaling, ...]

    @property
    def orders(self) -> tuple[int, ...]:
        """Order of D and G of each block."""
        return tuple(part.order + part.g_states for part in self.parts)

    @property
    def n_states(self) -> int:
        """Number of states that scaling adds to a plant."""
        return sum(
            part.order * (block.rows + block.cols if block.d_order == 1 else 2) + part.g_states
            for block, part in zip(self.blocks, self.parts, strict=True)
        )

    @property
    def mixed(self) -> bool:
        """True where a G has states."""
        return any(part.g_states for part in self.parts)

    def parameters(self) -> AnyArray:
        """Return all free parameters, shape (n_theta,)."""
        values: list[float] = []
        for part in self.parts:
            values += chain(*(factor.parameters() for factor in part.factors), part.mixing)
            values += chain(*(section for pair in part.g for section in pair.sections))
        return np.array(values)

    def with_parameters(self, theta: AnyArray) -> DynamicScalings:
        """Return scalings of the same form with other parameters."""
        values, parts = iter(theta), list[BlockScaling]()
        for part in self.parts:
            factors = tuple(factor.with_parameters(values) for factor in part.factors)
            mixing = tuple(float(next(values)) for _ in part.mixing)
            g = tuple(CoprimePair(_taken(pair.sections, values)) for pair in part.g)
            parts.append(BlockScaling(factors, mixing, g))
        return replace(self, parts=tuple(parts))

    def spread(self, places: Sequence[float]) -> DynamicScalings:
        """Return scalings of the same level with a section more in every factor at each of these places."""
        factors = [
            [reduce(lambda f, at: f.with_section(at, at), places, f) for f in part.factors] for part in self.parts
        ]
        parts = (replace(part, factors=tuple(own)) for part, own in zip(self.parts, factors, strict=True))
        return replace(self, parts=tuple(parts))

    def enlarged(self, places: Sequence[float]) -> Iterator[DynamicScalings]:
        """Yield scalings with one section more, of a factor or of a G, at each of these places."""
        for i, part in enumerate(self.parts):
            for name in ("factors", "g"):
                items = getattr(part, name)
                for k, item in enumerate(items):
                    for at in places:
                        larger = replace(part, **{name: _put(items, k, item.with_section(at, at))})
                        yield replace(self, parts=_put(self.parts, i, larger))

    def to_json(self) -> list[dict[str, object]]:
        return [
            {
                "block": block.name,
                "factors": [vars(factor) for factor in part.factors],
                "mixing": part.mixing,
                "g": [pair.sections for pair in part.g],
            }
            for block, part in zip(self.blocks, self.parts, strict=True)
        ]

    def on_outputs(self) -> Realisation:
        """Return ``D_z(s)``, shape (p, p)."""
        (A, B, C, D), T = self._diagonal(1), self._mixing(1)
        return Realisation(A, B @ T, C, D @ T)

    def on_inputs(self) -> Realisation:
        """Return ``D_w(s)^{-1}``, shape (q, q)."""
        (A, B, C, D), back = self._diagonal(0), np.linalg.inv(self._mixing(0))
        return Realisation(A, B, back @ C, back @ D)

    def coprime(self) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
        """Return ``(A, B, F, C)``, ``G_M = I + F (sI - A)^-1 B`` (q x q), ``G_N = C (sI - A)^-1 B`` (p x q)."""
        q, p = structure_size(self.blocks)
        n, at = sum(part.g_states for part in self.parts), 0
        A, B, F, C = np.zeros((n, n)), np.zeros((n, q)), np.zeros((q, n)), np.zeros((p, n))
        for part, (w, z) in zip(self.parts, block_slices(self.blocks), strict=True):
            for i, pair in enumerate(part.g):
                here = slice(at, at + pair.n_states)
                A[here, here], b, F[w.start + i, here], C[z.start + i, here] = _coprime(pair)
                B[here, w.start + i], at = b[:, 0], here.stop
        return A, B, F, C

    def _diagonal(self, side: int) -> Realisation:
        """Return the factors (on the inputs: their inverses) on their channels, 1 for blocks with D = 1."""
        size, pieces = structure_size(self.blocks)[side], list[tuple[Realisation, int]]()
        D = np.zeros((size, size))
        for block, part, where in zip(self.blocks, self.parts, block_slices(self.blocks), strict=True):
            channels = range(where[side].start, where[side].stop)
            if not part.factors:
                D[channels, channels] = 1.0
                continue
            # The factor of a full block is repeated for every channel.
            factors = part.factors * len(channels) if block.d_order == 1 else part.factors
            made = [_realised(factor if side else factor.inverse) for factor in factors]
            pieces += zip(made, channels, strict=True)
        n, at = sum(len(piece[0].A) for piece in pieces), 0
        A, B, C = np.zeros((n, n)), np.zeros((n, size)), np.zeros((size, n))
        for (a, b, c, d), i in pieces:
            here = slice(at, at + len(a))
            A[here, here], B[here, i], C[i, here], D[i, i] = a, b[:, 0], c[0], d[0, 0]
            at += len(a)
        return Realisation(A, B, C, D)

    def _mixing(self, side: int) -> AnyArray:
        T = np.eye(structure_size(self.blocks)[side])
        for part, where in zip(self.parts, block_slices(self.blocks), strict=True):
            if part.mixing:
                rows, columns = np.triu_indices(len(part.factors), 1)
                T[rows + where[side].start, columns + where[side].start] = part.mixing
        return T


@lru_cache(maxsize=4096)
def _coprime(pair: CoprimePair) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
    """Return ``(A, B, F, C)`` with ``G_M = 1 + F (sI - A)^-1 B`` and ``G_N = C (sI - A)^-1 B``."""
    V, U = (
        reduce(
            _in_series, [_all_pass(s[: len(s) // 2] if first else s[len(s) // 2 :]) for s in pair.sections], _gain(1)
        )
        for first in (True, False)
    )
    n = len(U.A)
    A = np.zeros((2 * n, 2 * n))
    A[:n, :n], A[n:, n:] = U.A, V.A
    return A, np.vstack([U.B, V.B]), np.hstack([U.C, V.C]) / 2, np.hstack([U.C, -V.C]) / 2


def _all_pass(section: tuple[float, ...]) -> Realisation:
    """Return ``(s - a)/(s + a)`` or ``(s^2 - e s + w^2)/(s^2 + e s + w^2)``."""
    w = float(np.exp(section[0]))
    e = w if len(section) == 1 else w * float(np.exp(section[1]))
    A = np.array([[-w]] if len(section) == 1 else [[0.0, w], [-w, -e]])
    B = np.zeros((len(A), 1))
    B[-1] = np.sqrt(2 * e)
    return Realisation(A, B, -B.T, np.eye(1))


def reference_block(blocks: Sequence[Block]) -> int | None:
    """Return the block with D = 1: of those with a scalar D the one whose D would cost most states; None: no such."""
    scalar = [(block.rows + block.cols, i) for i, block in enumerate(blocks) if block.d_order == 1]
    return max(scalar)[1] if scalar else None


def unit_scalings(blocks: Sequence[Block]) -> DynamicScalings:
    """Return the scalings D = I, G = 0."""
    one, parts = reference_block(blocks), list[BlockScaling]()
    for i, block in enumerate(blocks):
        r = block.d_order
        g = (CoprimePair(),) * r if block.g_basis() else ()
        parts.append(BlockScaling(() if i == one else (Factor(),) * r, (0.0,) * (r * (r - 1) // 2), g))
    return DynamicScalings(tuple(blocks), tuple(parts))


def plant_at_level(p: PlantMatrices, scalings: DynamicScalings, beta: float) -> PlantMatrices:
    """Return the plant with these scalings at a level; channels beyond the blocks (regularisation) get beta alone."""
    _, n_w, n_u, n_z, n_y = p.sizes
    whole = Realisation(
        p.A,
        np.hstack([p.B1, p.B2]),
        np.vstack([p.C1, p.C2]),
        np.block([[p.D11, p.D12], [p.D21, np.zeros((n_y, n_u))]]),
    )
    A, B, C, D = _at_level(whole, scalings, beta, n_w)
    return PlantMatrices(A, B[:, :n_w], B[:, n_w:], C[:n_z], C[n_z:], D[:n_z, :n_w], D[:n_z, n_w:], D[n_z:, :n_w])


def loop_at_level(loop: StateSpaceModel, scalings: DynamicScalings, beta: float = 1.0) -> StateSpaceModel:
    """Return a continuous loop on the blocks' channels with these scalings at a level."""
    scaled = _at_level(Realisation.of(loop), scalings, beta, loop.n_inputs)
    return StateSpaceModel(*scaled, where="scaled loop")


def _at_level(system: Realisation, scalings: DynamicScalings, beta: float, n_w: int) -> Realisation:
    """Return the system with its first channels scaled, and its first ``n_w`` inputs divided by beta."""
    (q, r), (p, m) = structure_size(scalings.blocks), system.D.shape
    A, B, F, G_N = scalings.coprime()
    direct = np.eye(m)
    direct[range(n_w), range(n_w)] /= beta
    n = len(A)
    into = Realisation(A, np.hstack([B, np.zeros((n, m - q))]), np.vstack([F / beta, np.zeros((m - q, n))]), direct)
    for stage in (_padded(scalings.on_inputs(), m - q), system, _padded(scalings.on_outputs(), p - r)):
        into = _in_series(into, stage)
    into.C[:r, :n] -= G_N
    return into


def _padded(system: Realisation, extra: int) -> Realisation:
    """Return the system with ``extra`` further channels of gain 1."""
    A, B, C, D = system
    n, direct = len(A), np.eye(len(D) + extra)
    direct[: len(D), : len(D)] = D
    return Realisation(A, np.hstack([B, np.zeros((n, extra))]), np.vstack([C, np.zeros((extra, n))]), direct)


def proved_level(
    loop: StateSpaceModel, scalings: DynamicScalings, guess: float = 1.0, rtol: float = 1e-6
) -> tuple[float, HinfNorm]:
    """Return the smallest bound of mu of a stable continuous loop that these scalings prove; inf: none."""
    norm = hinf_norm(loop_at_level(loop, scalings), rtol)
    if not scalings.mixed:
        return norm.upper, norm
    # With G: steps away from the guess that grow, then bisection.
    low, high, trial, step = 0.0, np.inf, guess, 1e-4
    for _ in range(80):
        found = hinf_norm(loop_at_level(loop, scalings, trial), min(rtol, 1e-7))
        if found.upper <= 1:
            high, norm = trial, found
        else:
            low = trial
        if high - low <= rtol * high < np.inf:
            break
        if low and high < np.inf:
            trial = float(np.sqrt(low * high))
        else:
            trial, step = trial * (1 + step if low else 1 - step), min(3 * step, 0.9)
    return high, norm
