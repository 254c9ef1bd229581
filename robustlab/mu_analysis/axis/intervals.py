"""Upper bounds on whole frequency intervals: constant D, G, extended by the eigenvalues of a Hamiltonian.

Before that the model of the Delta channels is mapped to continuous time and balanced.
"""

# Phi(omega) = M^* D_z M + j (G M - M^* G^*) - beta^2 D_w is singular where j omega is an eigenvalue of H. Rounding
# moves eigenvalues off the axis, so *every* imaginary part counts as a possible change of sign, and the sign is
# tested between and at these candidates, outwards from a frequency at which Phi < 0 is known. A test of whether an
# eigenvalue is imaginary, with a tolerance, certified wrong intervals.

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import AnyArray, Array, ComplexArray, Mask
from robustlab.budget import Budget
from robustlab.display import Displayable, Facts, in_words, number
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.linear_analysis.frequency import frequency_response, modes_apart, narrow_frequencies, solved_response
from robustlab.linear_analysis.matrices import balancing_factors
from robustlab.linear_analysis.structural import strong_components, with_hidden
from robustlab.mu_analysis.matrix.block_structure import depths, entries, hermitian
from robustlab.mu_analysis.matrix.bounds import divided, skew_upper
from robustlab.mu_analysis.matrix.upper import UpperBound, points_below, points_work
from robustlab.norms.claims import Numbers, block_rows, loop_numbers
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.uncertainty.blocks import Block, block_slices
from robustlab.uncertainty.lft import UncertainModel
from robustlab.verification.claim import Claim

MOST = 1e100  # largest entry of M that is accepted
HIDDEN = 1e-8  # share of the largest eigenvalue of a Gramian below which a direction counts as hidden
TINY = 1e-100  # norm of A below which Gramians overflow or vanish
FREQUENCIES = 8  # at which D, G are computed together
SLACK = 1e-5  # relative reduction of beta in the Hamiltonian: separates double roots
SLOW_PROGRESS = 0.97  # share of the open axis that a round may leave open before the level is raised
COARSEST = 64.0  # accuracy at which the cover ends: no scaling could prove anything there
IDLE = 8  # rounds in which points stay above a level that is not raised
SKEWED = 4  # bounds of mu that one skewed bound costs: counts work only
PROBES = 12  # frequencies at which a sign is tested to find an end, or a change missed by the eigenvalues
NEIGHBOURS = 4  # ends and middles on each side that are tested at once


def check_nominal(uncertain: UncertainModel, where: str) -> None:
    """Reject an argument that is no uncertain model, and a model whose nominal member is not stable."""
    if not isinstance(uncertain, UncertainModel):
        raise InputError(where, type(uncertain).__name__, "an UncertainModel")
    _check_magnitude(uncertain.M, where)
    poles = uncertain.M.poles()
    if not len(poles) or uncertain.M.is_stable():
        return
    worst = poles[np.abs(poles).argmax() if uncertain.M.is_discrete else poles.real.argmax()]
    found = with_hidden(f"nominal closed loop unstable (pole {worst.real:.6g}{worst.imag:+.6g}j)", uncertain.M)
    hint = "close the loop first (UncertainModel.close), or drop an integrator that feeds nothing back"
    raise NoTrustworthyNumber(where, found, "a stable nominal model", hint)


def continuous(model: StateSpaceModel) -> StateSpaceModel:
    """Balance the model, narrow peaks in separate states; map a discrete one by ``s = (z - 1) / (z + 1)``."""
    model = modes_apart(model)
    A, B, C, D = model.A, model.B, model.C, model.D
    n = model.n_states
    if not n:
        return StateSpaceModel(A, B, C, D)
    if model.is_discrete:
        # z = (1 + s) / (1 - s): s x' = (A + I)^-1 (A - I) x + ...
        plus = np.linalg.inv(A + np.eye(n))
        A, B, C, D = plus @ (A - np.eye(n)), np.sqrt(2) * plus @ B, np.sqrt(2) * C @ plus, D - C @ plus @ B
    _check_magnitude(StateSpaceModel(A, B, C, D), "frequency axis")
    scale = balancing_factors(A)
    return _balanced(StateSpaceModel(A / scale[:, None] * scale, B / scale[:, None], C * scale[None, :], D))


def _balanced(model: StateSpaceModel) -> StateSpaceModel:
    """Return the stable model in balanced states, sorted by their Hankel singular values."""
    # These do not depend on the states of the given model, and are no farther from normal than its transfer function:
    # in others the eigenvalues of a Hamiltonian matrix may be wrong in the fourth digit.
    from scipy.linalg import solve_continuous_lyapunov

    A, B, C = model.A, model.B, model.C
    limit = 1e-6 * -model.poles().real.max() / np.finfo(float).eps
    if not (B.any() and C.any() and TINY < np.linalg.norm(A) < limit):
        return model
    strong, loud = np.abs(B).max(), np.abs(C).max()
    into, out = B / strong, C / loud  # squares of their own could vanish
    reached = _square_root(solve_continuous_lyapunov(A, -into @ into.T))
    seen = _square_root(solve_continuous_lyapunov(A.T, -out.T @ out))
    _, sizes, turn = np.linalg.svd(seen.T @ reached)
    T = reached @ turn.T / np.sqrt(sizes) * (np.sqrt(strong) / np.sqrt(loud))
    T *= np.where(np.linalg.solve(T, B).sum(axis=1) < 0, -1.0, 1.0)
    A, B = (np.linalg.solve(T, matrix) for matrix in (A @ T, B))
    return StateSpaceModel(A, B, C @ T, model.D) if np.linalg.norm(A) * np.linalg.cond(T) < limit else model


def _square_root(gramian: AnyArray) -> AnyArray:
    sizes, vectors = np.linalg.eigh(gramian)
    return vectors * np.sqrt(np.maximum(sizes, HIDDEN * sizes[-1]))


def _check_magnitude(model: StateSpaceModel, where: str) -> None:
    """Reject a model whose products of entries overflow."""
    size = max(np.abs(m).max(initial=0.0) for m in (model.A, model.B, model.C, model.D))
    if not size <= MOST:
        hint = "choose other units of time, of signals, or of the parameters"
        raise NoTrustworthyNumber(where, f"an entry of {size:.3g} in M", f"at most {MOST:g}", hint)


def frequencies(omega: ArrayLike | None, where: str) -> Array:
    """Check and return frequencies in rad/s for the curves of a figure; none where None is given."""
    grid = np.atleast_1d(np.asarray([] if omega is None else omega, dtype=float))
    if grid.ndim != 1 or not np.isfinite(grid).all() or (grid < 0).any():
        raise InputError(f"{where}: omega", "negative or not finite frequencies", "frequencies in rad/s, >= 0")
    return grid


def seed_frequencies(model: StateSpaceModel) -> Array:
    """Return the frequencies of the poles of a continuous model, including narrow peaks."""
    poles = model.poles()
    found = np.abs(np.concatenate([poles, poles.imag]))
    # One of those closer together than 2 %, and every narrower peak.
    marks = np.unique(np.round(np.log(found[found > 0]) / 0.02))
    return np.unique(np.concatenate([np.exp(marks * 0.02), narrow_frequencies(poles)]))


def around(model: StateSpaceModel, omega: float) -> Array:
    """Return frequencies within 5 % of a frequency, and others inside the narrow peak that it may be in."""
    if not 0 < omega < np.inf:
        return np.array([omega])
    distance = np.abs(1j * omega - model.poles()).min(initial=omega)
    width = np.linspace(-1, 1, 21)
    return np.concatenate([[omega], omega * np.exp(0.05 * width), omega + 0.5 * distance * width])


def typical_speed(model: StateSpaceModel) -> float:
    """Median of the poles' moduli in rad/s; 1 without poles."""
    poles = np.abs(model.poles())
    return float(np.median(poles)) if len(poles) else 1.0


def acting(model: StateSpaceModel, blocks: Sequence[Block]) -> Mask:
    """Return which states, then blocks, act directly on which, by the zeros of A, B, C, D: ``[i, j]``, j on i."""
    into, out = np.zeros((model.n_inputs, len(blocks))), np.zeros((len(blocks), model.n_outputs))
    for i, (w, z) in enumerate(block_slices(blocks)):
        into[w, i] = out[i, z] = 1
    B, C, D = (model.B != 0) @ into, out @ (model.C != 0), out @ (model.D != 0) @ into
    return np.block([[model.A != 0, B], [C, D]]) > 0


def model_frequency(dt: float, omega: float) -> float:
    """Frequency in rad/s of the model itself: ``w = 2 atan(omega) / dt`` where it was mapped."""
    return float(2 * np.arctan(omega) / dt) if dt else float(omega)


# --- cover ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Piece(Displayable):
    """``mu <= beta`` is proved for all ``low <= omega <= high`` (rad/s) by the constant scalings ``bound``."""

    low: float
    high: float
    beta: float
    bound: UpperBound
    members: tuple[int, ...] | None = None

    def facts(self) -> Facts:
        facts = [("proved", f"mu <= {number(self.beta)} for {number(self.low)} .. {number(self.high, 'rad/s')}")]
        return facts if self.members is None else [*facts, ("blocks", in_words(self.members))]


@dataclass
class AxisCover:
    """Proved and open intervals of the axis [0, inf]."""

    pieces: list[Piece] = field(default_factory=list)
    open: list[tuple[float, float]] = field(default_factory=lambda: [(0.0, float("inf"))])

    @property
    def beta(self) -> float:
        """Largest proved level."""
        return max((piece.beta for piece in self.pieces), default=0.0)

    def add(self, piece: Piece) -> None:
        """Remove the inside of a proved interval from the open ones."""
        self.pieces.append(piece)
        self.open = remaining(self.open, piece.low, piece.high)

    def open_share(self, scale: float) -> float:
        """Return the open part of the axis as an angle: the sum of differences of ``atan(omega / scale)``."""
        low, high = np.array(self.open).reshape(-1, 2).T / scale
        with np.errstate(divide="ignore", invalid="ignore"):
            spans = np.arctan2(np.where(high < np.inf, high - low, 1.0), np.where(high < np.inf, 1 + low * high, low))
        return float(spans.sum())

    def take_points(self, pending: list[float], scale: float, count: int) -> Array:
        """Remove and return the next pending frequencies that are still open, else new ones."""
        while pending:
            chosen = [w for w in pending[:count] if any(low <= w <= high for low, high in self.open)]
            del pending[:count]
            if chosen:
                return np.array(chosen)
        return next_points(self.open, scale, count)

    def reported(
        self, dt: float, level: float
    ) -> tuple[tuple[tuple[float, float, float], ...], tuple[tuple[float, float], ...]]:
        """Return pieces as ``(low, high, bound)``, at most ``level``, and open intervals, in the model's rad/s."""
        at = partial(model_frequency, dt)
        pieces = tuple((at(p.low), at(p.high), min(p.beta, level)) for p in self.pieces)
        return pieces, tuple((at(low), at(high)) for low, high in self.open)


def remaining(intervals: Sequence[tuple[float, float]], low: float, high: float) -> list[tuple[float, float]]:
    """Return the intervals without what is between ``low`` and ``high``."""
    parts = [part for a, b in intervals for part in ((a, min(b, low)), (max(a, high), b))]
    return [(a, b) for a, b in parts if a < b]


def next_points(intervals: Sequence[tuple[float, float]], scale: float, count: int) -> Array:
    """Return a frequency inside each interval, the widest (in decades) first, at most ``count``."""
    found = []
    for low, high in intervals:
        if low <= 0 or high == np.inf:
            point = 0.3 * high if high < np.inf else 3 * low if low > 0 else scale
            found.append((-np.inf, point))
        else:
            found.append((-float(np.log(high / low)), float(np.sqrt(low) * np.sqrt(high))))
    return np.array([point for _, point in sorted(found)[:count]])


def cover_axis(
    model: StateSpaceModel, blocks: Sequence[Block], level: float, *, first: Array, budget: Budget, accuracy: float,
    varying: Mask | None = None,
) -> AxisCover:  # fmt: skip
    """Prove a level on [0, inf] of a stable continuous model, within ``accuracy`` above its D-G peak."""
    # The level is mu; where inputs vary it is skewed mu: the size of their blocks is one over it, of the others one.
    cover, scale, step, idle = AxisCover(), typical_speed(model), accuracy, 0
    level *= 1 + accuracy
    pending = list(np.unique(np.concatenate([[0.0, np.inf], first])))
    while cover.open and not budget.over and step < COARSEST:
        fresh, before = not pending, cover.open_share(scale)
        omega = cover.take_points(pending, scale, FREQUENCIES)
        response = frequency_response(model, omega)
        least = 1e-9 * float(np.linalg.norm(response, axis=(1, 2)).max(initial=1e-290))  # level that counts as zero
        budget.spend(points_work(blocks, len(omega)))
        if varying is None:
            target = level / (1 + step / 2)
            bounds = points_below(response, blocks, target)
            # A bound below its target was stopped early and does not limit the level.
            missed = [b.beta for b in bounds if target < b.beta < np.inf]
            level = max(level, max(missed, default=0.0) * (1 + step), least)
            scaled, beta = model, level
        else:
            level, target = max(level, least), 1 / (1 + accuracy / 2)
            bounds = points_below(divided(response, varying, level), blocks, target)
            over = [k for k, b in enumerate(bounds) if not b.beta < 1 / (1 + accuracy / 4)]
            if over:
                raised = max(skew_upper(response[k], blocks, varying)[0] for k in over) * (1 + accuracy)
                if not np.isfinite(raised) or (raised <= level and idle == IDLE):
                    break  # the other blocks alone are too near to it
                idle = idle + 1 if raised <= level else 0
                level = max(level, raised)
                again = points_below(divided(response[over], varying, level), blocks, target)
                budget.spend((SKEWED + 1) * points_work(blocks, len(over)))
                for k, bound in zip(over, again, strict=True):
                    bounds[k] = bound
            B, D = divided(model.B, varying, level), divided(model.D, varying, level)
            scaled, beta = StateSpaceModel(model.A, B, model.C, D), 1.0
        for w, bound in zip(omega, bounds, strict=True):
            if budget.over:  # an interval with 70 blocks takes seconds
                return cover
            piece = extend(scaled, bound, beta, float(w))
            budget.spend(extend_work(model))
            if piece is not None:
                cover.add(replace(piece, beta=level))
        if fresh and cover.open_share(scale) > SLOW_PROGRESS * before:
            step *= 2
            level *= 1 + step
    return cover


def cover_parts(
    model: StateSpaceModel, blocks: Sequence[Block], beta: float, *, first: Array, budget: Budget, accuracy: float
) -> AxisCover:
    """Apply `cover_axis` to each strongly connected part of M11; mu of the whole is the largest of theirs."""
    whole, n, acts = AxisCover(open=[]), model.n_states, acting(model, blocks)
    labels = strong_components(acts)
    for label in np.unique(labels[n:]):
        members = np.flatnonzero(labels[n:] == label)
        itself = n + members[0]
        if len(members) == 1 and not acts[itself, itself] and label not in labels[:n]:
            continue  # a block in no cycle: its mu is 0
        w, z = entries(blocks, members)
        part = StateSpaceModel(model.A, model.B[:, w], model.C[z], model.D[z[:, None], w])
        some = [blocks[int(i)] for i in members]
        cover = cover_axis(part, some, beta, first=first, budget=budget, accuracy=accuracy)
        whole.pieces += [replace(piece, members=tuple(int(i) for i in members)) for piece in cover.pieces]
        whole.open += cover.open
    return whole


def extend_work(model: StateSpaceModel) -> int:
    """Return the measured work of `extend`: the eigenvalues of H, and the signs at some of them and at the probes."""
    n, p = model.n_states, max(model.n_inputs, model.n_outputs)
    return 600 + (2 * n) ** 3 // 100 + 3 * PROBES * (2 + p**2 // 20 + p**3 // 400)


def extend(model: StateSpaceModel, bound: UpperBound, beta: float, omega: float) -> Piece | None:
    """Return the interval around ``omega`` on which D and G of ``bound`` prove beta; None if not at ``omega``."""
    if not bound.beta < beta:
        return None
    stricter = max(beta * (1 - SLACK), (bound.beta + beta) / 2)
    # Inputs and outputs scaled by D, in which D is the identity.
    into = hermitian(np.linalg.inv(np.linalg.cholesky(bound.Dw)))
    out = hermitian(np.linalg.cholesky(bound.Dz))
    G = hermitian(into) @ np.linalg.solve(out.T, bound.G.T).T

    def holds(omega: Array) -> Mask:
        M = out @ solved_response(model, omega) @ into
        product = G @ M
        level = hermitian(M) @ M + 1j * (product - hermitian(product))
        finite = np.isfinite(level).all(axis=(1, 2))
        level[~finite] = 0
        return finite & (np.linalg.eigvalsh(level)[:, -1] < ((stricter + beta) / 2) ** 2)

    speed = float(np.abs(model.A).sum(axis=0).max(initial=1.0))
    candidates = _candidates(model.A, model.B @ into, out @ model.C, out @ model.D @ into, G, stricter)
    if candidates is None:
        return None
    # The sign is constant on each segment between neighbouring ends, if the candidates are right: ends and middles of
    # segments are tested outwards. At a candidate the stricter level is attained: if the sign is wrong there, rounding
    # has moved it.
    ends = np.concatenate([[0.0], np.unique(candidates[candidates > 0])])
    points = np.append(np.repeat(ends, 2), np.inf)
    points[1::2] = np.append((ends[1:] + ends[:-1]) / 2, 2 * ends[-1] + speed)
    own = 2 * int(np.searchsorted(ends, omega, side="right")) - 1
    first = max(own - NEIGHBOURS, 0)
    right = holds(np.append(points[first : own + NEIGHBOURS + 1], omega))
    if not (right[-1] and right[own - first]):
        return None
    low = _far(points[own::-1], right[own - first :: -1], holds)
    high = _far(points[own:], right[own - first : -1], holds)
    # Shrink by a small share of the frequency, or of the piece where that is narrower.
    low += 1e-9 * min(low, omega - low)
    high -= 1e-9 * min(high, high - omega) if np.isfinite(high) else 0.0
    # Eigenvalues of H can be wrong in the first digits where D, G are extreme: probes detect this.
    top = high if np.isfinite(high) else 1e3 * max(low, speed)
    bottom = low if low > 0 else 1e-6 * top
    if not holds(np.concatenate([np.linspace(low, top, PROBES), np.geomspace(bottom, top, PROBES)])).all():
        return None
    return Piece(low, high, beta, bound) if low < high else None


def _far(points: Array, right: Mask, holds: Callable[[Array], Mask]) -> float:
    """Return the last point up to which all hold, in this order from a middle on; ``right``: of the first ones."""
    while right.all() and len(right) < len(points):
        right = np.append(right, holds(points[len(right) : 2 * len(right)]))
    return float(points[len(right) - 1 if right.all() else int(right.argmin()) - 1])


def _candidates(A: Array, B: AnyArray, C: AnyArray, D: AnyArray, G: ComplexArray, beta: float) -> Array | None:
    """Return the moduli of the imaginary parts of all eigenvalues of H; None where H is too ill-conditioned."""
    cross = 1j * G
    R = hermitian(D) @ D + cross @ D + hermitian(cross @ D) - beta**2 * np.eye(len(G))
    S = hermitian(C) @ D + hermitian(cross @ C)
    if not np.isfinite(R).all() or (len(R) and np.linalg.cond(R) > 1e13):
        return None
    to_b = np.linalg.solve(R, hermitian(B))
    to_s = np.linalg.solve(R, hermitian(S))
    F = A - B @ to_s
    H = np.block([[F, -B @ to_b], [S @ to_s - hermitian(C) @ C, -hermitian(F)]])
    if not np.isfinite(H).all():
        return None
    t = balancing_factors(H)
    return np.abs(np.linalg.eigvals(H / t[:, None] * t).imag)


# --- claims --------------------------------------------------------------------------------------------------------

APART = 64  # binary digits between the scalings of parts of which one acts on the other, and not back
DEEPEST = 900  # total binary digits: the range of doubles


def loop_axis_claims(
    plant: StateSpaceModel, K: StateSpaceModel, blocks: Sequence[Block], level: float, pieces: Sequence[Any]
) -> list[Claim]:
    """Return the claim that mu of the loop of P and K is at most ``level``; none where pieces cannot be joined."""
    scalings = joined_scalings(continuous(lower_lft(plant, K)), blocks, pieces, partial(model_frequency, plant.dt))
    if scalings is None:
        return []
    numbers = {**loop_numbers(plant, K), "blocks": block_rows(blocks), "level": np.array(level)}
    return [Claim("mu-axis", {**numbers, **scalings})]


def joined_scalings(
    model: StateSpaceModel, blocks: Sequence[Block], pieces: Sequence[Any], at: Callable[[float], float]
) -> Numbers | None:
    """Return the pieces as intervals in rad/s with scalings of all blocks; None where they cannot be joined."""
    # M is block triangular in these parts. With D of each part times 2^(-64 k), k its depth, the coupling between parts
    # is negligible; a block in no cycle has the identity.
    whole = tuple(range(len(blocks)))
    if pieces and all(p.members is None or p.members == whole for p in pieces):
        return interval_scalings(pieces, at)
    acts = acting(model, blocks)
    counted = np.arange(len(acts)) >= model.n_states
    depth = depths(acts, strong_components(acts), counted)[model.n_states :]
    if depth.max(initial=0) * APART > DEEPEST:
        return None
    parts: dict[tuple[int, ...], list[Piece]] = {}
    for p in pieces:
        parts.setdefault(p.members or whole, []).append(p)
    cuts = np.unique([end for p in pieces for end in (p.low, p.high)] + [0.0, np.inf])
    q, p_ = model.n_inputs, model.n_outputs
    result: list[Any] = []
    for low, high in itertools.pairwise(cuts):
        Dw, Dz, G = np.eye(q, dtype=complex), np.eye(p_, dtype=complex), np.zeros((q, p_), dtype=complex)
        for i, (w, z) in enumerate(block_slices(blocks)):
            Dw[w, w] *= 2.0 ** (-APART * depth[i])
            Dz[z, z] *= 2.0 ** (-APART * depth[i])
        for members, own in parts.items():
            piece = next((x for x in own if x.low <= low and x.high >= high), None)
            if piece is None:
                return None
            w, z = entries(blocks, np.array(members))
            scale = 2.0 ** (-APART * depth[members[0]]) / 2.0 ** np.round(np.log2(np.abs(piece.bound.Dw).max()))
            Dw[w[:, None], w], Dz[z[:, None], z] = scale * piece.bound.Dw, scale * piece.bound.Dz
            G[w[:, None], z] = scale * piece.bound.G
        result.append(Piece(float(low), float(high), np.inf, UpperBound(np.inf, Dw, Dz, G)))
    return interval_scalings(result, at)


def interval_scalings(pieces: Sequence[Any], at: Callable[[float], float]) -> Numbers:
    """Return the intervals in rad/s of the model, sorted, with their scalings."""
    ordered = sorted(pieces, key=lambda p: p.low)
    stacks = {name: np.stack([getattr(p.bound, key) for p in ordered]).astype(complex)
              for name, key in (("D_w", "Dw"), ("D_z", "Dz"), ("G", "G"))}  # fmt: skip
    ends = {"low": np.array([at(p.low) for p in ordered]), "high": np.array([at(p.high) for p in ordered])}
    return {**ends, **stacks}
