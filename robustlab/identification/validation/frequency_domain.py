r"""Validation line by line: cone programmes with tangents of |z|^2 from above, multipliers from below.

At every explanation L = sum D (gamma^2 |z|^2 - |w|^2) + sum Lambda (r^2 - |n|^2) >= 0, so max_w L < 0, one small
Hermitian system a line, disproves gamma (Smith, Doyle 1992; Huang, Zhang 2007, theorem 2.1).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array, ComplexArray, Indices
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.validation.cone_programme import ConeSolution, Rows, Search, solved_cones, sparse_matrices
from robustlab.identification.validation.spectral_problem import (
    FrequencyData,
    SpectralProblem,
    Spectrum,
    spectrum_of_record,
    spectrum_of_response,
)
from robustlab.identification.validation.validation_result import (
    BlockSize,
    Validation,
    concluded,
    each_alone,
    in_own_units,
    require_replay,
)
from robustlab.record import Record
from robustlab.uncertainty.lft import UncertainModel

LINE_ROUNDS = 30  # convex-concave steps at most
LINE_MARGIN = 1e-9  # by which the programmes aim inside the noise bound
HALVINGS = 60  # of the interval in which a disproved gamma is looked for

# Rounding in the noise of an explanation, over its bound.
SLACK = 1e-9
# A multiplier of this share of the largest keeps the Lagrangian of a line strictly concave.
FLOOR = 1e-9


def fits_frequency_domain(
    data: Record | FrequencyData,
    domain: str,
    norm: str | None,
    window: float | None,
    at_rest: bool,
    missing: Mapping[str, Sequence[int]] | None,
    noise: Mapping[str, ArrayLike] | None,
) -> None:
    """Refuse what has no meaning there."""
    where = f"validate {data.name}"
    if domain == "time":
        raise InputError(where, "a frequency response in the time domain", 'domain="frequency"')
    if norm == "peak" and isinstance(data, Record):
        raise InputError(where, "a peak bound of the noise in the frequency domain", "an rms bound",
                         'noise_norm="rms"; a transform keeps the energy of the noise, not its peak')  # fmt: skip
    if norm == "rms" and isinstance(data, FrequencyData):
        raise InputError(where, "an rms bound on a frequency response", "a bound at each line")
    for name, given in (("windows", window), ("a start at rest", at_rest or None), ("missing samples", missing)):
        if given:
            raise InputError(where, f"{name} in the frequency domain", "whole periods in steady state", 'domain="time"')
    if noise is None and isinstance(data, FrequencyData):
        raise NoTrustworthyNumber(where, "no noise bound was given", None, "noise={output: bound}, in its unit")


def validate_by_lines(
    uncertain: UncertainModel,
    data: Record | FrequencyData,
    noise: Mapping[str, ArrayLike],
    search: Search,
    *,
    period: float | None,
    per_block: bool,
    progress: Callable[[str], None],
    estimated: bool,
) -> Validation:
    """Bounds of the smallest gamma over the lines; see `robustlab.identification.validation.validate`."""
    if not uncertain.blocks:
        hint = 'domain="time" tells whether noise alone explains a record'
        raise InputError(f"validate {data.name}", "a set without blocks in the frequency domain", "a block", hint)
    if isinstance(data, Record):
        spectrum = spectrum_of_record(uncertain, data, {k: float(np.asarray(v)) for k, v in noise.items()}, period)
    else:
        spectrum = spectrum_of_response(uncertain, data, noise)
    problem = spectrum.problem
    found = smallest_by_lines(problem, search)
    progress(f"{problem.n} lines: gamma {found.lower:.4g} .. {found.upper:.4g}")
    alone: dict[str, tuple[float, float]] = {}
    if per_block and np.isfinite(found.upper):
        alone = each_alone(problem.names, search, partial(smallest_by_lines, problem), progress)
    said = (
        *spectrum.said,
        *(("the noise bound was estimated from the record's own periods",) if estimated else ()),
        "complex and full blocks are causal stable time-invariant systems",
    )
    return _result(data.name, spectrum, found, alone, said, search)


def _result(
    name: str,
    spectrum: Spectrum,
    found: SpectralSizes,
    alone: Mapping[str, tuple[float, float]],
    said: tuple[str, ...],
    search: Search,
) -> Validation:
    problem, budget = spectrum.problem, search.budget
    explained, error = np.full(spectrum.y.shape, np.nan), 0.0
    sizes = np.zeros((problem.n, len(problem.blocks)))
    if np.isfinite(found.upper):
        error = _replay_error(problem, found.w)
        require_replay(error, name)
        explained = _explained(spectrum, found.w)
        sizes = problem.sizes(found.w)
    w, z = in_own_units(found.w, problem.z(found.w), problem.blocks, problem.scale)
    largest = sizes.max(axis=0, initial=0.0) if np.isfinite(found.upper) else np.full(len(problem.blocks), np.nan)
    exact = "exact" if found.known else "lower bound exact where the Lagrangian is concave"
    return Validation(
        status=concluded(found.lower, found.upper, search.precision, budget),
        notes=(budget.remark,) if budget.remark else (),
        record=name,
        lower=found.lower,
        upper=found.upper,
        label=f"time-invariant systems at {problem.n} lines ({exact})",
        blocks={
            block: BlockSize(block, "time-invariant", float(size), *alone.get(block, (np.nan, np.nan)))
            for block, size in zip(problem.names, largest, strict=True)
        },
        noise_bound=spectrum.bound,
        noise_norm="rms" if problem.total else "peak",
        excess=found.least_noise if np.isinf(found.upper) else problem.excess(problem.noise(found.w)),
        replay_error=error,
        assumptions=said,
        t=spectrum.t,
        measured=spectrum.y,
        nominal=spectrum.nominal,
        explained=explained,
        outputs=tuple((s.name, s.unit) for s in spectrum.outputs),
        w=w,
        z=z,
        multipliers={"energy": found.multipliers.D, "noise": found.multipliers.noise},
        recheck=found.recheck,
        domain="frequency",
        omega=problem.omega,
        line_sizes=sizes,
    )


def _replay_error(problem: SpectralProblem, w: ComplexArray) -> float:
    """The loop closed at each line with ``Delta = w z' / |z|^2``, against the explanation, over the noise bound."""
    n, q, p = problem.n, w.shape[1], problem.z0.shape[1]
    z = problem.z(w)
    delta = np.zeros((n, q, p), dtype=complex)
    for rows, cols in problem.blocks:
        energy = (np.abs(z[:, cols]) ** 2).sum(axis=1)
        back = z[:, cols].conj() / np.where(energy > 0, energy, 1.0)[:, None]
        delta[:, rows, cols] = w[:, rows, None] * back[:, None, :]
    try:
        closed = np.linalg.solve(np.eye(q) - delta @ problem.M11, np.einsum("kij,kj->ki", delta, problem.z0)[..., None])
    except np.linalg.LinAlgError:  # a Delta that makes the loop ill-posed is no explanation
        return np.inf
    noise = problem.e - np.einsum("kij,kj->ki", problem.M21, closed[..., 0])
    difference = noise - problem.noise(w)
    if problem.total:
        return float(np.sqrt((problem.weight @ np.abs(difference) ** 2).max(initial=0.0)))
    return float(np.abs(difference).max(initial=0.0))


def _explained(spectrum: Spectrum, w: ComplexArray) -> Array:
    """Outputs of the explanation: a period, or magnitudes."""
    problem = spectrum.problem
    moved = np.einsum("kij,kj->ki", problem.M21, w) * spectrum.unit_noise
    if not problem.total:
        at = (problem.e * spectrum.unit_noise, moved)
        return np.abs(spectrum.complex_y - at[0] + at[1])
    n = len(spectrum.t)
    whole = np.zeros((n // 2 + 1, moved.shape[1]), dtype=complex)
    whole[len(whole) - problem.n :] = moved * n
    return spectrum.nominal + np.fft.irfft(whole, n, axis=0)


# --- the smallest gamma over all lines -------------------------------------------------------------------------------


@dataclass(frozen=True)
class LineMultipliers:
    """Multipliers of a certificate: D (n, blocks), and noise (n, n_y); the same over all lines for a total bound."""

    D: Array
    noise: Array


@dataclass(frozen=True)
class SpectralSizes:
    """What `smallest_by_lines` found."""

    # lower, upper: bounds of gamma; both inf where no Delta of any size explains the data
    lower: float
    upper: float
    w: ComplexArray  # (n, q); zeros where nothing was found
    multipliers: LineMultipliers  # those of the lower bound
    # by what factor the noise bound would have to grow for any Delta at all to explain the data; at most 1: none
    least_noise: float
    known: bool  # whether z is known, and the test thereby convex
    recheck: Callable[[], float] | None  # the lower bound once more, from the multipliers alone


def smallest_by_lines(problem: SpectralProblem, search: Search) -> SpectralSizes:
    """Bounds over the blocks that are scaled; the others keep the size 1."""
    programme = _Programme(problem, search)
    known = not np.abs(problem.M11).max(initial=0.0)
    none = np.zeros((problem.n, problem.M21.shape[2]), dtype=complex)
    empty = LineMultipliers(np.zeros((problem.n, len(problem.blocks))), np.zeros(problem.e.shape))
    if problem.excess(problem.noise(none)) <= 1:
        return SpectralSizes(0.0, 0.0, none, empty, problem.excess(problem.noise(none)), known, None)
    free = programme.least_noise()
    least = problem.excess(problem.noise(free.w))
    if least > 1 + SLACK:
        multipliers = LineMultipliers(empty.D, programme.multipliers(free).noise)
        if not line_lagrangian(problem, multipliers, np.ones(len(problem.blocks))) < 0:
            raise NoTrustworthyNumber("validate", f"the noise bound is missed by {least - 1:.1e} of itself, unproved")
        return SpectralSizes(np.inf, np.inf, none, multipliers, least, known, None)
    best, at, lower, multipliers = np.inf, none, 0.0, empty
    for start in (problem.z0, problem.z(free.w)):
        gamma, w, solved = _descend(programme, start, known)
        if solved is not None:
            trial = programme.multipliers(solved)
            # With several programmes in one the multipliers of a line are those of its own gamma: the worst decides.
            top = gamma if np.isfinite(gamma) else float(np.sqrt(solved.g.max(initial=0.0)))
            disproved = _largest_disproved(problem, trial, search, top)
            lower, multipliers = (disproved, trial) if disproved > lower else (lower, multipliers)
        if gamma < best:
            best, at = gamma, w
        if known or lower >= best * (1 - search.precision):
            break

    def recheck() -> float:
        return _largest_disproved(problem, multipliers, search, lower * (1 + 1e-6))

    return SpectralSizes(lower, best, at, multipliers, min(least, 1.0), known, recheck if lower > 0 else None)


def _descend(programme: _Programme, z: ComplexArray, known: bool) -> tuple[float, ComplexArray, _Solved | None]:
    """Best gamma that its own w shows, that w, and the last programme solved."""
    problem, search = programme.problem, programme.search
    best, at, last, before = np.inf, np.zeros_like(problem.e[:, :0]), None, np.inf
    for _ in range(1 if known else LINE_ROUNDS):
        solved = programme.smallest(z)
        if solved is None:
            break
        last = solved
        z = problem.z(solved.w)
        gamma = _shown_size(problem, solved.w, search)
        if gamma < best:
            best, at = gamma, solved.w
        if gamma > before * (1 - 0.02 * search.precision) or search.budget.over:
            break
        before = gamma
    return best, at, last


def _shown_size(problem: SpectralProblem, w: ComplexArray, search: Search) -> float:
    """Largest size of the scaled blocks that w needs; inf where it leaves too much noise or breaks another block."""
    sizes = problem.sizes(w)
    if problem.excess(problem.noise(w)) > 1 + SLACK or (sizes[:, ~search.scaled] > 1 + 1e-6).any():
        return np.inf
    return float(sizes[:, search.scaled].max(initial=0.0))


# --- certificate -----------------------------------------------------------------------------------------------------


def line_lagrangian(problem: SpectralProblem, multipliers: LineMultipliers, gammas: Array) -> float:
    """Largest value of L over all w: for a total bound of the sum over lines, else of the line where it is smallest.

    +inf where L is not bounded above. Negative is a proof.
    """
    n, p = problem.z0.shape
    q = problem.M21.shape[2]
    to_z, to_w = np.zeros((n, p)), np.zeros((n, q))
    for i, (rows, cols) in enumerate(problem.blocks):
        to_z[:, cols] = (gammas[i] ** 2 * multipliers.D[:, i])[:, None]
        to_w[:, rows] = multipliers.D[:, i][:, None]
    noise = multipliers.noise
    M11, M21 = problem.M11, problem.M21
    back = M11.conj().transpose(0, 2, 1) * to_z[:, None, :], M21.conj().transpose(0, 2, 1) * noise[:, None, :]
    H = back[0] @ M11 - back[1] @ M21
    H[:, range(q), range(q)] -= to_w
    slope = np.einsum("kij,kj->ki", back[0], problem.z0) + np.einsum("kij,kj->ki", back[1], problem.e)
    at_zero = (to_z * np.abs(problem.z0) ** 2).sum(axis=1) - (noise * np.abs(problem.e) ** 2).sum(axis=1)
    values, vectors = np.linalg.eigh(0.5 * (H + H.conj().transpose(0, 2, 1)))
    turned = np.abs(np.einsum("kij,ki->kj", vectors.conj(), slope)) ** 2
    size = np.abs(values).max(axis=1, initial=0.0)[:, None] + 1e-300
    reach = size * (np.abs(at_zero)[:, None] + 1e-300)
    flat = values > -1e-12 * size
    if problem.total:
        if (flat & ((values > 1e-12 * size) | (turned > 1e-14 * reach))).any():
            return np.inf
        gained = np.where(flat, 0.0, turned / np.where(flat, 1.0, -values)).sum(axis=1)
        Lambda = noise.max(axis=0, initial=0.0) / problem.weight.max()
        top = float(Lambda @ problem.radius**2)
        least = float((at_zero + gained).sum())
        return least + top + 1e-12 * (abs(top) + float(np.abs(at_zero).sum()) + float(gained.sum()))
    bad = (flat & ((values > 1e-12 * size) | (turned > 1e-14 * reach))).any(axis=1)
    gained = np.where(flat, 0.0, turned / np.where(flat, 1.0, -values)).sum(axis=1)
    each = at_zero + gained + noise.sum(axis=1)
    each += 1e-12 * (np.abs(at_zero) + gained + noise.sum(axis=1))
    each[bad | ~(noise.sum(axis=1) > 0)] = np.inf
    return float(each.min(initial=np.inf))


def _largest_disproved(problem: SpectralProblem, multipliers: LineMultipliers, search: Search, start: float) -> float:
    """Largest gamma, at most ``start``, that the multipliers disprove; L grows with gamma, so halving finds it."""

    def disproved(gamma: float) -> bool:
        return line_lagrangian(problem, multipliers, search.gammas(gamma)) < 0

    if not start > 0 or not np.isfinite(start) or not disproved(0.0):
        return 0.0
    good, high = 0.0, start
    for _ in range(HALVINGS):
        middle = 0.5 * (good + high)
        good, high = (middle, high) if disproved(middle) else (good, middle)
        if high - good < 1e-7 * high:
            break
    return good


# --- programmes ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Solved:
    w: ComplexArray
    g: Array
    cones: ConeSolution


class _Programme:
    """Cone programmes in the real and imaginary parts of w, and g: one, or one for each line where they are apart."""

    def __init__(self, problem: SpectralProblem, search: Search) -> None:
        self.problem, self.search = problem, search
        self.q = problem.M21.shape[2]
        self.n_g = 1 if problem.total else problem.n
        self.at_g = 2 * problem.n * self.q
        self.size = self.at_g + self.n_g

    def _affine(self, gains: ComplexArray, offset: ComplexArray) -> tuple[Any, Array]:
        """Rows for real and imaginary part of ``offset_k + gains_k w_k`` (n,), one after the other at each line."""
        n, q = gains.shape
        cols = (2 * q * np.arange(n)[:, None] + np.arange(q)).repeat(2, axis=0).reshape(n, 2, q)
        rows = np.arange(2 * n).reshape(n, 2, 1).repeat(q, axis=2)
        re = np.stack([gains.real, gains.imag], axis=1)
        im = np.stack([-gains.imag, gains.real], axis=1)
        values = np.concatenate([re.ravel(), im.ravel()])
        at = np.concatenate([rows.ravel(), rows.ravel()]), np.concatenate([cols.ravel(), (cols + q).ravel()])
        matrix = sparse_matrices().csr_matrix((values, at), (2 * n, self.size))
        return matrix, np.stack([offset.real, offset.imag], axis=1).ravel()

    def _g(self, lines: Indices, values: Array) -> Any:
        """Rows that hold ``values`` times the g of each line."""
        which = self.at_g + (np.zeros_like(lines) if self.n_g == 1 else lines)
        return sparse_matrices().csr_matrix((values, (np.arange(len(lines)), which)), (len(lines), self.size))

    def _noise(self, free: bool) -> list[Rows]:
        """Noise within its bound, or within g times its bound."""
        sparse, p, found = sparse_matrices(), self.problem, []
        every, inside = np.arange(p.n), 0.0 if free else 1 - LINE_MARGIN
        for j in range(p.e.shape[1]):
            rows, offset = self._affine(-p.M21[:, j], p.e[:, j])
            if p.total:
                root, radius = np.sqrt(p.weight).repeat(2), p.radius[j]
                head = (
                    self._g(np.zeros(1, dtype=int), np.array([radius])) if free else sparse.csr_matrix((1, self.size))
                )
                matrix, height = -sparse.vstack([head, sparse.diags(root) @ rows]), 1 + 2 * p.n
                offset = np.concatenate([[radius * inside], root * offset])
            else:
                head = self._g(every, np.ones(p.n)) if free else sparse.csr_matrix((p.n, self.size))
                turn = np.column_stack([every, p.n + 2 * every, p.n + 2 * every + 1]).ravel()
                matrix, height = -sparse.vstack([head, rows]).tocsr()[turn], 3
                offset = np.concatenate([np.full(p.n, inside), offset])[turn]
            found.append(Rows(matrix, offset, "second-order", height, ("noise", j)))
        return found

    def _blocks(self, z: ComplexArray) -> list[Rows]:
        """``(g + eps, g - eps, 2 w)`` in the cone, with the tangents eps at z."""
        sparse, p, found = sparse_matrices(), self.problem, []
        every = np.arange(p.n)
        for i, (rows, cols) in enumerate(p.blocks):
            here = z[:, cols]
            slope = np.einsum("ki,kij->kj", here.conj(), p.M11[:, cols])
            tangent, offset = self._affine(2 * slope, 2 * (here.conj() * p.z0[:, cols]).sum(axis=1))
            tangent, offset = tangent[::2], offset[::2] - (np.abs(here) ** 2).sum(axis=1)
            ones, unit = (
                (self._g(every, np.ones(p.n)), 0.0)
                if self.search.scaled[i]
                else (sparse.csr_matrix(tangent.shape), 1.0)
            )
            inner = []
            for row in range(rows.start, rows.stop):
                pick = np.zeros((p.n, self.q))
                pick[:, row] = 2.0
                inner.append(self._affine(pick.astype(complex), np.zeros(p.n, dtype=complex))[0])
            stacked = sparse.vstack([ones + tangent, ones - tangent, *inner]).tocsr()
            wide = 2 * len(inner)
            heads = [every, p.n + every]
            turn = np.column_stack(
                [*heads, *((2 + 2 * k) * p.n + 2 * every + part for k in range(len(inner)) for part in (0, 1))]
            ).ravel()
            offset = np.concatenate([unit + offset, unit - offset, np.zeros(p.n * wide)])[turn]
            found.append(Rows(-stacked[turn], offset, "second-order", 2 + wide, ("block", i)))
        return found

    def _still(self) -> list[Rows]:
        """W is real where every spectrum is."""
        lines = np.flatnonzero(self.problem.real)
        cols = (2 * self.q * lines[:, None] + self.q + np.arange(self.q)).ravel()
        if not len(cols):
            return []
        ones = np.ones(len(cols)), (np.arange(len(cols)), cols)
        return [Rows(sparse_matrices().csr_matrix(ones, (len(cols), self.size)), np.zeros(len(cols)), "zero")]

    def smallest(self, z: ComplexArray) -> _Solved | None:
        """Smallest g with the tangents at z; None where there is none."""
        return self._solved([*self._still(), *self._noise(False), *self._blocks(z)])

    def least_noise(self) -> _Solved:
        """Smallest factor on the noise bound with any w."""
        found = self._solved([*self._still(), *self._noise(True)])
        if found is None:
            raise NoTrustworthyNumber("validate", "the solver gave no answer for the least noise")
        return found

    def _solved(self, rows: list[Rows]) -> _Solved | None:
        cost = np.zeros(self.size)
        cost[self.at_g :] = 1.0
        found = solved_cones(cost, rows, self.search.budget)
        if found is None:
            return None
        n = self.problem.n
        w = found.x[: self.at_g].reshape(n, 2, self.q)
        g = np.broadcast_to(found.x[self.at_g :], (n,)).copy()
        return _Solved(w[:, 0] + 1j * w[:, 1], np.maximum(g, 0.0), found)

    def multipliers(self, solved: _Solved) -> LineMultipliers:
        """Multipliers of the quadratic certificate from those of the cone programme."""
        p = self.problem
        noise, D = np.zeros(p.e.shape), np.zeros((p.n, len(p.blocks)))
        g = np.maximum(solved.g, 1e-6 * float(solved.g.max(initial=0.0)) + 1e-12)
        for (kind, k), part in solved.cones.dual:
            if kind == "noise":  # at |n| = r the slope of r^2 - |n|^2 is 2 r times that of r - |n|
                noise[:, k] = p.weight * part[0] / (2 * p.radius[k]) if p.total else 0.5 * part.reshape(p.n, 3)[:, 0]
            else:
                cone = part.reshape(p.n, -1)
                D[:, k] = (cone[:, 0] - cone[:, 1]) / (g if self.search.scaled[k] else 1.0)
        noise, D = np.maximum(noise, 0.0), np.maximum(D, 0.0)
        if p.total:
            D += FLOOR * max(float(D.max(initial=0.0)), float(noise.max(initial=0.0)))
        else:
            D += FLOOR * np.maximum(D.max(axis=1, initial=0.0), noise.max(axis=1, initial=0.0))[:, None]
        return LineMultipliers(D, noise)
