r"""Rational scalings D(s), G(s) of a block structure that prove a bound of mu at every frequency at once.

.. math:: \| D_z M D_w^{-1} G_M / \beta - G_N \|_\infty \le 1 \quad \Rightarrow \quad \sup_\omega \mu(M) \le \beta

Young, "Robustness with parametric and dynamic uncertainty" (1993), chapter 9; Fan, Tits, Doyle (1991).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, reduce
from itertools import chain, product
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import Budget, dense
from robustlab.linear_analysis.frequency import default_grid, frequency_response
from robustlab.mu_analysis.matrix.upper import UpperBound, points_work, upper_bounds
from robustlab.norms import HinfNorm, hinf_norm
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.hinf.two_riccati import smallest_level
from robustlab.synthesis.problem.generalized_plant import PlantMatrices, Realisation
from robustlab.uncertainty.blocks import Block, block_slices

FIRST_STEP = 1e-4  # of the logarithm of a level away from its guess
FIRST_POINTS = 40  # frequencies of the first grid
ROUNDS = 3  # rounds of refinement ...
ADDED = 24  # ... and frequencies added in each; more: fewer peaks missed, more work
CHUNK = 8  # frequencies between two checks of the budget
MU_TOLERANCE = 1e-4  # of the upper bounds
PROOF_RTOL = 1e-6  # of the level that scalings prove
LOG_ERROR = 0.1  # mu lower than the peak by this logarithm counts half for the constant D; larger: even weights

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
        return sum(map(len, self.sections)) // 2

    def parameters(self) -> list[float]:
        return [self.log_gain, *chain(*self.sections)]

    @property
    def inverse(self) -> Factor:
        """The factor 1 / d(s)."""
        swapped = tuple((*s[len(s) // 2 :], *s[: len(s) // 2]) for s in self.sections)
        return Factor(-self.log_gain, swapped)

    def with_parameters(self, values: Iterator[float]) -> Factor:
        """Return a factor of the same form with the next numbers of ``values``."""
        return Factor(float(next(values)), _taken(self.sections, values))

    def with_section(self, zero: float, pole: float) -> Factor:
        """Multiply by ``(s/z + 1) / (s/p + 1)`` with these logarithms of z and p."""
        return replace(self, sections=_extended(self.sections, zero, pole))


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
    # G of each channel of a real scalar, by two all-pass functions V and U: `(log p, log q)` or `(log w_p,
    # log 2 zeta_p, log w_q, log 2 zeta_q)`. G_M and G_N are half their sum and half their difference:
    # |G_M|^2 + |G_N|^2 = 1, G = G_N / G_M is imaginary on the axis. Where U = V, and without sections, G = 0.
    g: tuple[Sections, ...] = ()

    @property
    def order(self) -> int:
        return sum(factor.order for factor in self.factors)

    @property
    def g_states(self) -> int:
        return sum(len(section) for sections in self.g for section in sections)

    def with_section(self, k: int, one: float, two: float) -> BlockScaling:
        """Return the scalings with one section more of the k-th factor or, behind the factors, G."""
        if (i := k - len(self.factors)) < 0:
            return replace(self, factors=_put(self.factors, k, self.factors[k].with_section(one, two)))
        return replace(self, g=_put(self.g, i, _extended(self.g[i], one, two)))


@dataclass(frozen=True, eq=False)
class DynamicScalings:
    """D(s) and G(s) of a whole structure; see the module's docstring."""

    blocks: tuple[Block, ...]
    parts: tuple[BlockScaling, ...]
    slices: tuple[tuple[slice, slice], ...] = ()  # channels of each block, w and z; found where left out

    def __post_init__(self) -> None:
        if not self.slices:
            object.__setattr__(self, "slices", tuple(block_slices(self.blocks)))

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
        return any(part.g_states for part in self.parts)

    def parameters(self) -> AnyArray:
        """Return all free parameters, shape (n_theta,)."""
        values: list[float] = []
        for part in self.parts:
            values += chain(*(factor.parameters() for factor in part.factors), part.mixing)
            values += chain(*chain(*part.g))
        return np.array(values)

    def with_parameters(self, theta: AnyArray) -> DynamicScalings:
        """Return scalings of the same form with other parameters."""
        values, parts = iter(theta), list[BlockScaling]()
        for part in self.parts:
            factors = tuple(factor.with_parameters(values) for factor in part.factors)
            mixing = tuple(float(next(values)) for _ in part.mixing)
            g = tuple(_taken(sections, values) for sections in part.g)
            parts.append(BlockScaling(factors, mixing, g))
        return replace(self, parts=tuple(parts))

    def spread(self, places: Sequence[float]) -> DynamicScalings:
        """Return scalings of the same level with a section more in every factor at each of these places."""
        factors = [
            [reduce(lambda f, at: f.with_section(at, at), places, f) for f in part.factors] for part in self.parts
        ]
        parts = (replace(part, factors=tuple(own)) for part, own in zip(self.parts, factors, strict=True))
        return replace(self, parts=tuple(parts))

    def enlarged(self, places: Sequence[float], apart: float) -> Iterator[tuple[DynamicScalings, DynamicScalings]]:
        """Yield scalings of the same level with one section more, of a factor or of a G, at each of these places."""
        for i, part in enumerate(self.parts):
            for k, at in product(range(len(part.factors) + len(part.g)), places):
                flat, tilted = (part.with_section(k, at + move, at) for move in (0.0, apart))
                yield replace(self, parts=_put(self.parts, i, flat)), replace(self, parts=_put(self.parts, i, tilted))

    def to_json(self) -> list[dict[str, object]]:
        pairs = zip(self.blocks, self.parts, strict=True)
        return [{"block": b.name, **vars(p), "factors": [vars(factor) for factor in p.factors]} for b, p in pairs]

    def on_outputs(self, size: int = 0) -> Realisation:
        """Return ``D_z(s)``, shape (p, p), with further channels of gain 1 up to ``size``."""
        made = self._diagonal(1, size)
        T = self._mixing(1, len(made.D))
        return made if T is None else made._replace(B=made.B @ T, D=made.D @ T)

    def on_inputs(self, size: int = 0) -> Realisation:
        """Return ``D_w(s)^{-1}``, shape (q, q), with further channels of gain 1 up to ``size``."""
        made = self._diagonal(0, size)
        T = self._mixing(0, len(made.D))
        return made if T is None else made._replace(C=np.linalg.solve(T, made.C), D=np.linalg.solve(T, made.D))

    def coprime(self, m: int, p: int) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
        """Return ``(A, B, F, C)``, ``G_M = I + F (sI - A)^-1 B`` (m x m), ``G_N = C (sI - A)^-1 B`` (p x m)."""
        n, at = sum(part.g_states for part in self.parts), 0
        A, B, F, C = np.zeros((n, n)), np.zeros((n, m)), np.zeros((m, n)), np.zeros((p, n))
        for part, (w, z) in zip(self.parts, self.slices, strict=True):
            for i, sections in enumerate(part.g):
                if sections:
                    made, b, f, c = _coprime(sections)
                    here = slice(at, at + len(made))
                    A[here, here], F[w.start + i, here], C[z.start + i, here] = made, f, c
                    B[here, w.start + i], at = b[:, 0], here.stop
        return A, B, F, C

    def _diagonal(self, side: int, size: int) -> Realisation:
        """Return the factors (on the inputs: their inverses) on their channels, 1 on all others."""
        size = max(size, self.slices[-1][side].stop)
        direct, dynamic, n = np.ones(size), list[tuple[int, Realisation]](), 0
        for block, part, where in zip(self.blocks, self.parts, self.slices, strict=True):
            first, stop = where[side].start, where[side].stop
            for k, factor in enumerate(part.factors):
                # The factor of a full block is repeated for every channel.
                channels = range(first, stop) if block.d_order == 1 else range(first + k, first + k + 1)
                if factor.sections:
                    made = _realised(factor if side else factor.inverse)
                    direct[channels] = made.D[0, 0]
                    dynamic += [(i, made) for i in channels]
                    n += len(channels) * len(made.A)
                else:
                    direct[channels] = np.exp(factor.log_gain if side else -factor.log_gain)
        A, B, C, at = np.zeros((n, n)), np.zeros((n, size)), np.zeros((size, n)), 0
        for i, (a, b, c, _) in dynamic:
            here = slice(at, at + len(a))
            A[here, here], B[here, i], C[i, here], at = a, b[:, 0], c[0], here.stop
        return Realisation(A, B, C, np.diag(direct))

    def _mixing(self, side: int, size: int) -> AnyArray | None:
        """Return the constant triangular matrices of all repeated scalars; None for none."""
        if not any(part.mixing for part in self.parts):
            return None
        T = np.eye(size)
        for part, where in zip(self.parts, self.slices, strict=True):
            if part.mixing:
                rows, columns = np.triu_indices(len(part.factors), 1)
                T[rows + where[side].start, columns + where[side].start] = part.mixing
        return T


@lru_cache(maxsize=4096)
def _coprime(sections: Sections) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
    """Return ``(A, B, F, C)`` with ``G_M = 1 + F (sI - A)^-1 B`` and ``G_N = C (sI - A)^-1 B``."""
    halves = [s[: len(s) // 2] for s in sections], [s[len(s) // 2 :] for s in sections]
    V, U = (reduce(_in_series, map(_all_pass, half), _gain(1)) for half in halves)
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
        g = ((),) * r if block.g_basis() else ()
        parts.append(BlockScaling(() if i == one else (Factor(),) * r, (0.0,) * (r * (r - 1) // 2), g))
    return DynamicScalings(tuple(blocks), tuple(parts))


def plant_at_level(
    whole: Realisation, sizes: tuple[int, int, int, int, int], scalings: DynamicScalings, beta: float
) -> PlantMatrices:
    """Return the plant with these scalings at a level; channels beyond the blocks (regularisation) get beta alone."""
    _, n_w, _, n_z, _ = sizes
    return PlantMatrices.of(_at_level(whole, scalings, beta, n_w), n_w, n_z)


def _at_level(system: Realisation, scalings: DynamicScalings, beta: float, n_w: int) -> Realisation:
    """Return the system with its first channels scaled, and its first ``n_w`` inputs divided by beta."""
    p, m = system.D.shape
    A, B, C, D = scalings.on_inputs(m)
    rows = np.where(np.arange(m) < n_w, 1 / beta, 1.0)[:, None]
    scaled = _in_series(_in_series(Realisation(A, B, rows * C, rows * D), system), scalings.on_outputs(p))
    if not scalings.mixed:
        return scaled
    A, B, F, G_N = scalings.coprime(m, p)
    both = _in_series(Realisation(A, B, F, np.eye(m)), scaled)
    both.C[:, : len(A)] -= G_N
    return both


def proved_level(loop: StateSpaceModel, scalings: DynamicScalings, guess: float) -> tuple[float, HinfNorm]:
    """Return the smallest bound of mu of a stable continuous loop that these scalings prove; inf: none."""
    norms = dict[float, HinfNorm]()

    def norm(beta: float) -> float | None:
        scaled = _at_level(Realisation.of(loop), scalings, beta, loop.n_inputs)
        norms[beta] = hinf_norm(StateSpaceModel(*scaled, where="scaled loop"), 1e-7 if scalings.mixed else PROOF_RTOL)
        return norms[beta].upper if np.isfinite(norms[beta].upper) else None

    if not scalings.mixed:
        norm(1.0)
        return norms[1.0].upper, norms[1.0]
    found = smallest_level(norm, guess, PROOF_RTOL, Budget(), FIRST_STEP)
    return (np.inf, next(iter(norms.values()))) if found is None else (found[0], norms[found[0]])


# --- mu of a loop, and the constant D nearest to its scalings ---------------------------------------------------------


@dataclass(frozen=True, eq=False)
class MuCurve:
    """Upper bounds of mu with their D, G at frequencies in rad/s."""

    omega: AnyArray  # ascending frequencies, shape (n_omega,)
    response: AnyArray  # frequency response of the loop, shape (n_omega, p, q)
    bounds: tuple[UpperBound, ...]

    @property
    def levels(self) -> AnyArray:
        """The upper bounds, shape (n_omega,)."""
        return np.array([bound.beta for bound in self.bounds])

    @property
    def peak(self) -> float:
        """The largest upper bound; not a bound between the frequencies."""
        return float(self.levels.max(initial=0.0))


def mu_curve(loop: StateSpaceModel, blocks: Sequence[Block], budget: Budget, first: AnyArray | None = None) -> MuCurve:
    """Return the curve of a stable continuous loop on adaptive frequencies."""
    # Each round adds the middles of the intervals in which mu is close to its peak or D changes most.
    grid = default_grid(loop, FIRST_POINTS, 1.0) if first is None else first
    stride = max(1, len(grid) // CHUNK)  # interleaved, so that a small budget covers the whole axis
    order = np.concatenate([np.arange(start, len(grid), stride) for start in range(stride)])
    curve = _measured(None, loop, blocks, grid[order], budget)
    for _ in range(ROUNDS):
        if budget.over:
            break
        levels, omega, top = curve.levels, curve.omega, max(curve.peak, 1e-300)
        d = np.log(np.array([np.einsum("ii->i", b.Dw).real for b in curve.bounds]))
        d -= d.mean(axis=1, keepdims=True)
        height = np.maximum(levels[1:], levels[:-1]) / top
        change = np.abs(np.diff(d, axis=0)).max(axis=1) + np.abs(np.diff(levels)) / top
        urgency = height**4 * change * (np.diff(np.log(omega)) > 1e-3)
        chosen = np.argsort(-urgency)[:ADDED]
        chosen = chosen[urgency[chosen] > 0.02]
        if not len(chosen):
            break
        curve = _measured(curve, loop, blocks, np.sqrt(omega[chosen]) * np.sqrt(omega[chosen + 1]), budget)
    return curve


def _measured(
    curve: MuCurve | None, loop: StateSpaceModel, blocks: Sequence[Block], omega: AnyArray, budget: Budget
) -> MuCurve:
    """Return the curve extended by these frequencies as far as the budget allows, at least by the first ones."""
    responses, bounds = ([], []) if curve is None else ([curve.response], list(curve.bounds))
    known = np.zeros(0) if curve is None else curve.omega
    done = 0
    while done < len(omega) and (not done or not budget.over):
        chunk = omega[done : done + CHUNK]
        budget.spend(points_work(blocks, len(chunk)) + dense(loop.n_states))
        responses.append(frequency_response(loop, chunk))
        bounds += upper_bounds(responses[-1], blocks, MU_TOLERANCE)
        done += len(chunk)
    known = np.concatenate([known, omega[:done]])
    order = np.argsort(known, kind="stable")
    return MuCurve(known[order], np.concatenate(responses)[order], tuple(bounds[i] for i in order))


def constant_scalings(curve: MuCurve, blocks: Sequence[Block]) -> DynamicScalings:
    """Return the constant D nearest to the scalings of the curve, above all around its peak."""
    unit, D = unit_scalings(blocks), np.stack([bound.Dw for bound in curve.bounds])
    weights = LOG_ERROR / (LOG_ERROR + np.log(max(curve.peak, 1e-300) / np.maximum(curve.levels, 1e-300)))
    one, top, parts = reference_block(blocks), int(np.argmax(curve.levels)), list[BlockScaling]()
    known = 1.0 if one is None else D[:, unit.slices[one][0].start, unit.slices[one][0].start].real
    for i, (block, part, (w, _)) in enumerate(zip(blocks, unit.parts, unit.slices, strict=True)):
        own, mixing = D[:, w, w], part.mixing
        if block.d_order > 1:
            lower = np.linalg.cholesky(own[top].real)
            T = (lower / np.diag(lower)).T
            back, mixing = np.linalg.inv(T), tuple(T[np.triu_indices(block.rows, 1)])
            own = back.T @ own @ back
        logs = [0.5 * np.log(np.maximum(own[:, k, k].real, 1e-300) / known) for k in range(block.d_order)]
        factors = () if i == one else tuple(Factor(float(np.average(log, weights=weights))) for log in logs)
        parts.append(BlockScaling(factors, mixing, part.g))
    return DynamicScalings(unit.blocks, tuple(parts))
