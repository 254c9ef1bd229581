r"""Validation line by line: cone programmes with tangents of |z|^2 from above, multipliers from below.

At every explanation L = sum D (gamma^2 |z|^2 - |w|^2) + sum Lambda (r^2 - |n|^2) >= 0, so max_w L < 0, one small
Hermitian system per line, disproves gamma (Smith, Doyle 1992; Huang, Zhang 2007, theorem 2.1).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array, ComplexArray
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.validation.cone_programme import (
    SLACK,
    ConeSolution,
    Multipliers,
    Rows,
    Search,
    largest_disproved,
    solved_cones,
    sparse_matrices,
)
from robustlab.identification.validation.spectral_data import (
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
    in_own_units,
    require_replay,
)
from robustlab.record import Record
from robustlab.uncertainty.lft import UncertainModel

LINE_ROUNDS = 30  # convex-concave steps at most
LINE_MARGIN = 1e-9  # distance of the programmes' target from the noise bound
FINEST = 1e-7  # relative, of a disproved gamma
FLOOR = 1e-9  # a multiplier of this share of the largest makes the Lagrangian of a line strictly concave


def fits_frequency_domain(
    data: Record | FrequencyData,
    domain: str,
    norm: str | None,
    window: float | None,
    at_rest: bool,
    noise: Mapping[str, ArrayLike] | None,
) -> None:
    """Refuse options without a meaning in the frequency domain."""
    where = f"validate {data.name}"
    if domain == "time":
        raise InputError(where, "a frequency response in the time domain", 'domain="frequency"')
    if norm == "peak" and isinstance(data, Record):
        hint = 'noise_norm="rms"; a transform keeps the energy of the noise, not its peak'
        raise InputError(where, "a peak bound of the noise in the frequency domain", "an rms bound", hint)
    if norm == "rms" and isinstance(data, FrequencyData):
        raise InputError(where, "an rms bound on a frequency response", "a bound at each line")
    for name, given in (("windows", window), ("at_rest", at_rest)):
        if given:
            raise InputError(where, f"{name} in the frequency domain", "whole periods in steady state", 'domain="time"')
    if noise is None and isinstance(data, FrequencyData):
        raise NoTrustworthyNumber(where, "no noise bound was given", None, "noise={output: bound}, in its unit")


def validate_by_lines(
    uncertain: UncertainModel,
    data: Record | FrequencyData,
    noise: Mapping[str, ArrayLike],
    search: Search,
    period: float | None,
    progress: Callable[[str], None],
    estimated: bool,
) -> Validation:
    """Compute bounds of the smallest gamma over the lines; see `robustlab.identification.validation.validate`."""
    if not uncertain.blocks:
        hint = 'domain="time" tests whether noise alone explains a record'
        raise InputError(f"validate {data.name}", "a set without blocks in the frequency domain", "a block", hint)
    if isinstance(data, Record):
        spectrum = spectrum_of_record(uncertain, data, {k: float(np.asarray(v)) for k, v in noise.items()}, period)
    else:
        spectrum = spectrum_of_response(uncertain, data, noise)
    problem = spectrum.problem
    found = _smallest(problem, search)
    progress(f"{problem.n} lines: gamma {found.lower:.4g} .. {found.upper:.4g}")
    explained, error, sizes = np.full(spectrum.y.shape, np.nan), 0.0, np.full((problem.n, len(problem.blocks)), np.nan)
    if np.isfinite(found.upper):
        error = _replay_error(problem, found.w)
        require_replay(error, data.name)
        explained, sizes = _explained(spectrum, found.w), problem.sizes(found.w)
    w, z = in_own_units(found.w, problem.z(found.w), problem.blocks, problem.scale)
    exact = "exact" if found.known else "lower bound exact where the Lagrangian is concave"
    return Validation(
        status=concluded(found.lower, found.upper, search),
        notes=(search.budget.remark,) if search.budget.remark else (),
        record=data.name,
        lower=found.lower,
        upper=found.upper,
        label=f"time-invariant systems at {problem.n} lines ({exact})",
        blocks={
            block: BlockSize(block, "time-invariant", float(size))
            for block, size in zip(problem.names, sizes.max(axis=0), strict=True)
        },
        noise_bound=spectrum.bound,
        noise_norm="rms" if problem.total else "peak",
        excess=found.least_noise if np.isinf(found.upper) else problem.excess(problem.noise(found.w)),
        replay_error=error,
        assumptions=(
            *spectrum.assumptions,
            *(("the noise bound was estimated from the record's own periods",) if estimated else ()),
            "complex and full blocks are causal stable time-invariant systems",
        ),
        t=spectrum.t,
        measured=spectrum.y,
        nominal=spectrum.nominal,
        explained=explained,
        outputs=tuple((s.name, s.unit) for s in spectrum.outputs),
        w=w,
        z=z,
        multipliers=found.multipliers.arrays(),
        recheck=found.recheck,
        domain="frequency",
        omega=problem.omega,
        line_sizes=np.nan_to_num(sizes),
    )


def _replay_error(problem: SpectralProblem, w: ComplexArray) -> float:
    """Close the loop at each line with ``Delta = w z' / |z|^2`` and compare it with the explanation, over the bound."""
    n, q, p = problem.n, w.shape[1], problem.z0.shape[1]
    z = problem.z(w)
    delta = np.zeros((n, q, p), dtype=complex)
    for rows, cols in problem.blocks:
        energy = (np.abs(z[:, cols]) ** 2).sum(axis=1)
        back = z[:, cols].conj() / np.where(energy > 0, energy, 1.0)[:, None]
        delta[:, rows, cols] = w[:, rows, None] * back[:, None, :]
    try:
        closed = np.linalg.solve(np.eye(q) - delta @ problem.M11, np.einsum("kij,kj->ki", delta, problem.z0)[..., None])
    except np.linalg.LinAlgError:  # an ill-posed loop is no explanation
        return np.inf
    difference = np.einsum("kij,kj->ki", problem.M21, closed[..., 0] - w)
    if problem.total:
        return float(np.sqrt((problem.weight @ np.abs(difference) ** 2).max(initial=0.0)))
    return float(np.abs(difference).max(initial=0.0))


def _explained(spectrum: Spectrum, w: ComplexArray) -> Array:
    """Compute the outputs of the explanation: a period, or magnitudes."""
    problem = spectrum.problem
    moved = np.einsum("kij,kj->ki", problem.M21, w) * spectrum.unit_noise
    if not problem.total:
        return np.abs(spectrum.complex_y - problem.e * spectrum.unit_noise + moved)
    n = len(spectrum.t)
    whole = np.zeros((n // 2 + 1, moved.shape[1]), dtype=complex)
    whole[len(whole) - problem.n :] = moved * n
    return spectrum.nominal + np.fft.irfft(whole, n, axis=0)


# --- the smallest gamma over all lines -------------------------------------------------------------------------------


class _Sizes(NamedTuple):
    """Bounds of gamma; both inf if no Delta of any size explains the data."""

    lower: float
    upper: float
    w: ComplexArray  # (n, q); zeros if nothing was found
    multipliers: Multipliers  # of the lower bound; noise is the same over all lines for a total bound
    least_noise: float  # factor on the noise bound with which some Delta explains the data; at most 1: no increase
    known: bool  # whether z is known, and the test thereby convex
    recheck: Callable[[], float] | None  # recomputes the lower bound from the multipliers alone


def _smallest(problem: SpectralProblem, search: Search) -> _Sizes:
    programme = _Programme(problem, search)
    known = not np.abs(problem.M11).max(initial=0.0)
    none = np.zeros((problem.n, problem.M21.shape[2]), dtype=complex)
    empty = Multipliers(np.zeros((problem.n, len(problem.blocks))), np.zeros(problem.e.shape))
    nominal = problem.excess(problem.noise(none))
    if nominal <= 1:
        return _Sizes(0.0, 0.0, none, empty, nominal, known, None)
    free = programme.least_noise()
    least = problem.excess(problem.noise(free.w))
    if least > 1 + SLACK:
        multipliers = Multipliers(empty.D, programme.multipliers(free).noise)
        if not line_lagrangian(problem, multipliers, 1.0) < 0:
            raise NoTrustworthyNumber("validate", f"the noise bound is missed by {least - 1:.1e} of itself, unproved")
        return _Sizes(np.inf, np.inf, none, multipliers, least, known, None)

    def disproved(by: Multipliers, start: float) -> float:
        return largest_disproved(lambda gamma: line_lagrangian(problem, by, gamma) < 0, start, FINEST)

    best, at, lower, multipliers = np.inf, none, 0.0, empty
    for start in (problem.z0, problem.z(free.w)):
        gamma, w, solved = _descend(programme, start, known)
        if solved is not None:
            trial = programme.multipliers(solved)
            # With one programme per line the multipliers of a line belong to its own gamma: the worst decides.
            top = gamma if np.isfinite(gamma) else float(np.sqrt(solved.g.max(initial=0.0)))
            found = disproved(trial, top)
            lower, multipliers = (found, trial) if found > lower else (lower, multipliers)
        if gamma < best:
            best, at = gamma, w
        if known or lower >= best * (1 - search.precision):
            break
    recheck = (lambda: disproved(multipliers, lower * (1 + 1e-6))) if lower > 0 else None
    return _Sizes(lower, best, at, multipliers, min(least, 1.0), known, recheck)


def _descend(programme: _Programme, z: ComplexArray, known: bool) -> tuple[float, ComplexArray, _Solved | None]:
    """Return the best gamma attained by its w, that w, and the last programme solved."""
    problem, search = programme.problem, programme.search
    best, at, last, before = np.inf, np.zeros_like(problem.e[:, :0]), None, np.inf
    for _ in range(1 if known else LINE_ROUNDS):
        solved = programme.smallest(z)
        if solved is None:
            break
        last, z = solved, problem.z(solved.w)
        within = problem.excess(problem.noise(solved.w)) <= 1 + SLACK
        gamma = float(problem.sizes(solved.w).max(initial=0.0)) if within else np.inf
        if gamma < best:
            best, at = gamma, solved.w
        if gamma > before * (1 - 0.02 * search.precision) or search.budget.over:
            break
        before = gamma
    return best, at, last


# --- certificate -----------------------------------------------------------------------------------------------------


def line_lagrangian(problem: SpectralProblem, multipliers: Multipliers, gamma: float) -> float:
    """Maximise L over all w: for a total bound the sum over lines, else the line with the smallest maximum.

    +inf if L is not bounded above. A negative value is a proof.
    """
    n, p = problem.z0.shape
    q = problem.M21.shape[2]
    to_z, to_w = np.zeros((n, p)), np.zeros((n, q))
    for i, (rows, cols) in enumerate(problem.blocks):
        to_z[:, cols] = (gamma**2 * multipliers.D[:, i])[:, None]
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
    unbounded = (flat & ((values > 1e-12 * size) | (turned > 1e-14 * reach))).any(axis=1)
    gained = np.where(flat, 0.0, turned / np.where(flat, 1.0, -values)).sum(axis=1)
    if problem.total:
        top = float(noise.max(axis=0, initial=0.0) / problem.weight.max() @ problem.radius**2)
        rounding = 1e-12 * (abs(top) + float(np.abs(at_zero).sum()) + float(gained.sum()))
        return np.inf if unbounded.any() else float((at_zero + gained).sum()) + top + rounding
    top = noise.sum(axis=1)
    each = at_zero + gained + top + 1e-12 * (np.abs(at_zero) + gained + top)
    return float(np.where(unbounded | ~(top > 0), np.inf, each).min(initial=np.inf))


# --- programmes ------------------------------------------------------------------------------------------------------


class _Solved(NamedTuple):
    w: ComplexArray
    g: Array
    cones: ConeSolution


class _Programme:
    """Cone programmes in the real and imaginary parts of w, and g: one over all lines, or one for each."""

    def __init__(self, problem: SpectralProblem, search: Search) -> None:
        self.problem, self.search = problem, search
        sparse, n, many = sparse_matrices(), problem.n, problem.n * problem.M21.shape[2]
        every = sparse.identity(2 * many + (1 if problem.total else n), format="csr")
        # Rows of one variable each; one row of g for each line.
        self.re, self.im, own = every[:many], every[many : 2 * many], every[2 * many :]
        self.g = sparse.csr_matrix(np.ones((n, 1))) @ own if problem.total else own

    def _affine(self, gains: ComplexArray) -> tuple[Any, Any]:
        """Return rows for the real and the imaginary part of ``gains_k w_k`` (n, q) at each line."""
        n, q = gains.shape
        at = np.repeat(np.arange(n), q), np.arange(n * q)
        re, im = (sparse_matrices().csr_matrix((part.ravel(), at), (n, n * q)) for part in (gains.real, gains.imag))
        return re @ self.re - im @ self.im, im @ self.re + re @ self.im

    def _noise(self, free: bool) -> list[Rows]:
        """Constrain the noise by its bound, or by g times its bound."""
        sparse, p, found = sparse_matrices(), self.problem, []
        head, inside = (self.g, 0.0) if free else (0.0 * self.g, 1 - LINE_MARGIN)
        for j, e in enumerate(p.e.T):
            re, im = self._affine(p.M21[:, j])
            parts, radius = np.concatenate([e.real, e.imag]), np.full(p.n, inside)
            rows, height = sparse.vstack([re, im]), 3
            if p.total:
                root = np.tile(np.sqrt(p.weight), 2)
                rows, parts, height = sparse.diags(root) @ rows, root * parts, 1 + 2 * p.n
                radius = p.radius[j] * radius[:1]
            cone = sparse.vstack([-p.radius[j] * head[:1] if p.total else -head, rows])
            found.append(Rows(cone, np.concatenate([radius, parts]), "second-order", height, ("noise", j)))
        return found

    def _blocks(self, z: ComplexArray) -> list[Rows]:
        """Constrain ``(g + eps, g - eps, 2 w)`` to the cone, with the tangents eps at z."""
        sparse, p, found = sparse_matrices(), self.problem, []
        q = p.M21.shape[2]
        for i, (rows, cols) in enumerate(p.blocks):
            here = z[:, cols]
            tangent, _ = self._affine(2 * np.einsum("ki,kij->kj", here.conj(), p.M11[:, cols]))
            eps = (2 * (here.conj() * p.z0[:, cols]).sum(axis=1)).real - (np.abs(here) ** 2).sum(axis=1)
            w = [-2 * part[k::q] for k in range(rows.start, rows.stop) for part in (self.re, self.im)]
            cone = sparse.vstack([-self.g - tangent, tangent - self.g, *w])
            offset = np.concatenate([eps, -eps, np.zeros(p.n * len(w))])
            found.append(Rows(cone, offset, "second-order", 2 + len(w), ("block", i)))
        return found

    def smallest(self, z: ComplexArray) -> _Solved | None:
        """Minimise g with the tangents at z; None if infeasible."""
        return self._solved([*self._noise(False), *self._blocks(z)])

    def least_noise(self) -> _Solved:
        """Minimise the factor on the noise bound over any w."""
        found = self._solved(self._noise(True))
        if found is None:
            raise NoTrustworthyNumber("validate", "the solver gave no answer for the least noise")
        return found

    def _solved(self, rows: list[Rows]) -> _Solved | None:
        """Minimise g, with w real where every spectrum is."""
        p, many = self.problem, self.re.shape[0]
        still = self.im[np.repeat(p.real, many // p.n)]
        if still.shape[0]:
            rows = [*rows, Rows(still, np.zeros(still.shape[0]), "zero")]
        cost = np.zeros(self.re.shape[1])
        cost[2 * many :] = 1.0
        found = solved_cones(cost, rows, self.search.budget)
        if found is None:
            return None
        w = found.x[:many] + 1j * found.x[many : 2 * many]
        return _Solved(w.reshape(p.n, -1), np.maximum(self.g @ found.x, 0.0), found)

    def multipliers(self, solved: _Solved) -> Multipliers:
        """Derive the multipliers of the quadratic certificate from those of the cone programme."""
        p = self.problem
        noise, D = np.zeros(p.e.shape), np.zeros((p.n, len(p.blocks)))
        g = np.maximum(solved.g, 1e-6 * float(solved.g.max(initial=0.0)) + 1e-12)
        for (kind, k), part in solved.cones.dual.items():
            if kind == "noise":  # at |n| = r the slope of r^2 - |n|^2 is 2 r times that of r - |n|
                noise[:, k] = p.weight * part[0] / (2 * p.radius[k]) if p.total else 0.5 * part[0]
            else:
                D[:, k] = (part[0] - part[1]) / g
        noise, D = np.maximum(noise, 0.0), np.maximum(D, 0.0)
        if p.total:
            D += FLOOR * max(float(D.max(initial=0.0)), float(noise.max(initial=0.0)))
        else:
            D += FLOOR * np.maximum(D.max(axis=1, initial=0.0), noise.max(axis=1, initial=0.0))[:, None]
        return Multipliers(D, noise)
