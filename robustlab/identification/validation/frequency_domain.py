r"""Validation line by line, of a record's mean period or of a measured frequency response.

Cone programmes with tangents of |z|^2 from above, multipliers from below: at every explanation
L = sum D (gamma^2 |z|^2 - |w|^2) + sum Lambda (r^2 - |n|^2) >= 0, so max_w L < 0, one small Hermitian system per line,
disproves gamma (Smith, Doyle 1992; Huang, Zhang 2007, theorem 2.1).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import Array, ComplexArray
from robustlab.display import Facts, listed, number
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.comparison.repeats import noise_floor
from robustlab.identification.validation.sampled_problem import (
    SLACK,
    ConeSolution,
    Found,
    Multipliers,
    Rows,
    Search,
    largest_disproved,
    noise_bounds,
    prepared,
    solved_cones,
    sparse_matrices,
    zero_order_hold,
)
from robustlab.identification.validation.validation_result import BlockSize, Validation, concluded, require_replay
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.record import Record
from robustlab.result import Evidence, Table, Tabular
from robustlab.statespace import Signal, StateSpaceModel, real_array
from robustlab.uncertainty.blocks import block_slices
from robustlab.uncertainty.lft import UncertainModel

# z below this share of the largest is rounding: Delta cannot act there.
SILENT = 1e-10
LINE_ROUNDS = 30  # convex-concave steps at most
LINE_MARGIN = 1e-9  # distance of the programmes' target from the noise bound
NO_NOISE = np.zeros((0, 0))  # the noise of an explanation is that of its w
FINEST = 1e-7  # relative, of a disproved gamma
FLOOR = 1e-9  # a multiplier of this share of the largest makes the Lagrangian of a line strictly concave


@dataclass(frozen=True)
class FrequencyData(Tabular, Evidence):
    """A measured frequency response of one input.

    Attributes
    ----------
    omega
        Frequencies in rad/s, shape (n,), increasing.
    response
        Complex, shape (n, n_y), in units of output per input.
    input, outputs
        The driven input, and the measured outputs, by the names of the model.
    name
        Name in messages.

    Raises
    ------
    InputError
        Shapes that differ, numbers that are not finite, frequencies that do not increase.

    Examples
    --------
    >>> import robustlab as rl
    >>> lag = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], 0.0, ["u"], ["y"])
    >>> response = rl.frequency_response(lag, [0.5, 1.0, 2.0])[:, 0, 0] + 0.1
    >>> measured = FrequencyData([0.5, 1.0, 2.0], response, "u", ["y"])
    >>> found = rl.validate(rl.unstructured(lag, 0.2), measured, {"y": 0.02}, domain="frequency")
    >>> round(found.lower, 3), round(found.upper, 3), str(found.status)
    (0.4, 0.4, 'certified')
    """

    omega: Array
    response: ComplexArray
    input: str
    outputs: tuple[str, ...]
    name: str = "frequency response"

    def __init__(
        self, omega: ArrayLike, response: ArrayLike, input: str, outputs: tuple[str, ...] | list[str],
        name: str = "frequency response",
    ) -> None:  # fmt: skip
        w, shape = real_array("omega", omega, 1, name), (np.size(omega), len(outputs))
        try:
            G = np.array(response, dtype=np.complex128)
        except (TypeError, ValueError):
            raise InputError(name, f"response: {response!r}", "complex numbers") from None
        G = G[:, None] if G.ndim == 1 else G
        if not len(w) or not np.isfinite(w).all() or (np.diff(w) <= 0).any() or w[0] < 0:
            raise InputError(name, "omega", "finite increasing frequencies in rad/s, shape (n,)")
        if G.shape != shape or not np.isfinite(G).all():
            raise InputError(name, f"response of shape {G.shape}", f"finite numbers of shape {shape}")
        vars(self).update(omega=w, response=G, input=input, outputs=tuple(outputs), name=name)
        self.__post_init__()

    def facts(self) -> Facts:
        first, last = number(float(self.omega[0])), number(float(self.omega[-1]), "rad/s")
        return [
            ("name", self.name),
            ("from", self.input),
            ("to", listed(self.outputs)),
            ("frequencies", f"{len(self.omega)}, {first} .. {last}"),
        ]

    def table(self) -> Table:
        """Return the response of every output."""
        columns = {name: self.response[:, k] for k, name in enumerate(self.outputs)}
        return Table(("omega", self.omega), columns, {"omega": "rad/s"})


@dataclass(frozen=True)
class SpectralProblem:
    """The affine maps of this module, in scaled signals."""

    omega: Array  # frequencies in rad/s, shape (n,)
    M11: ComplexArray  # (n, p, q)
    M21: ComplexArray  # (n, n_y, q)
    z0: ComplexArray  # (n, p)
    e: ComplexArray  # (n, n_y)
    weight: Array  # of a line in the energy of a real signal (n,): 2, and 1 at zero and at the Nyquist frequency
    real: NDArray[np.bool_]  # lines at which every spectrum of a real signal is real (n,)
    total: bool  # true: ``sum_k weight_k |n_kj|^2 <= radius_j^2`` for each output. False: ``|n_kj| <= 1`` at each line.
    radius: Array  # (n_y,)
    blocks: tuple[tuple[slice, slice], ...]  # slices of w and z of each
    names: tuple[str, ...]
    scale: Array  # divisor of w and z of each

    @property
    def n(self) -> int:
        return len(self.omega)

    def z(self, w: ComplexArray) -> ComplexArray:
        """Compute the inputs of Delta (n, p)."""
        return self.z0 + np.einsum("kij,kj->ki", self.M11, w)

    def noise(self, w: ComplexArray) -> ComplexArray:
        """Compute the remaining noise (n, n_y), over its bound."""
        return self.e - np.einsum("kij,kj->ki", self.M21, w)

    def excess(self, noise: ComplexArray) -> float:
        """Return the noise over its bound: at most 1 if explained."""
        if not self.total:
            return float(np.abs(noise).max(initial=0.0))
        return float(np.sqrt((self.weight @ np.abs(noise) ** 2) / self.radius**2).max(initial=0.0))

    def sizes(self, w: ComplexArray) -> Array:
        """Compute ``|w| / |z|`` of each block at each line (n, blocks); inf where z is zero and w is not."""
        z, found = self.z(w), np.zeros((self.n, len(self.blocks)))
        for i, (rows, cols) in enumerate(self.blocks):
            top, under = np.linalg.norm(w[:, rows], axis=1), np.linalg.norm(z[:, cols], axis=1)
            with np.errstate(divide="ignore", invalid="ignore"):
                found[:, i] = np.where(top > 0, top / under, 0.0)
        return found


def _problem(
    uncertain: UncertainModel, omega: Array, response: ComplexArray, forced: ComplexArray, y: ComplexArray,
    bound: Array, *, weight: Array, real: NDArray[np.bool_], total: bool, radius: Array,
) -> SpectralProblem:  # fmt: skip
    """Scale w and z of each block by its nominal z, and remove every block where its z is zero."""
    # ``response``: of M, (n, p + n_y, q + n_u). ``forced``: nominal z and outputs.
    blocks, (q, p) = tuple(block_slices(uncertain.blocks)), uncertain.delta_shape
    M11, M21, z0 = response[:, :p, :q].copy(), response[:, p:, :q] / bound[..., None], forced[:, :p].copy()
    scales, silent = [], []
    for rows, cols in blocks:
        size = float(np.sqrt((np.abs(z0[:, cols]) ** 2).mean())) or 1.0
        M21[:, :, rows] *= size
        M11[:, :, rows] *= size
        M11[:, cols] /= size
        z0[:, cols] /= size
        scales.append(size)
    loop = float(np.abs(M11).max(initial=0.0))
    for _, cols in blocks:
        size = np.linalg.norm(z0[:, cols], axis=1)
        silent.append(size <= SILENT * max(float(size.max(initial=0.0)), 1e-300))
        z0[silent[-1], cols] = 0.0
    # An undriven well-posed loop is at zero: (I - M11 Delta) z = 0.
    undriven = np.all(silent, axis=0)
    for (rows, cols), quiet in zip(blocks, silent, strict=True):
        alone = np.abs(M11[:, cols]).max(initial=0.0) <= SILENT * max(loop, 1e-3)  # no w can make this z move
        still = quiet if alone else undriven
        M21[still, :, rows] = 0.0
        M11[still, :, rows] = 0.0
    names, e = tuple(b.name for b in uncertain.blocks), (y - forced[:, p:]) / bound
    return SpectralProblem(omega, M11, M21, z0, e, weight, real, total, radius, blocks, names, np.array(scales))


@dataclass(frozen=True)
class Spectrum:
    """A `SpectralProblem` with its data."""

    problem: SpectralProblem
    outputs: tuple[Signal, ...]  # compared outputs with units
    bound: Mapping[str, float]  # noise bound of each
    t: Array  # one mean period of the record, (n_t,), or the frequencies of a response
    y: Array  # its outputs, (n_t, n_y), or the magnitudes
    forced: ComplexArray  # nominal spectrum of the outputs, (n, n_y)
    unit_noise: Array  # divisor of ``e``, (n, n_y) or (1, n_y)
    assumptions: tuple[str, ...]
    offset: Any = 0.0  # mean of the outputs of a model that integrates, (n_y,)

    def simulated(self, w: ComplexArray) -> Array:
        """Compute the outputs with w: a period, or magnitudes."""
        lines = self.forced + np.einsum("kij,kj->ki", self.problem.M21, w) * self.unit_noise
        if not self.problem.total:
            return np.abs(lines)
        n = len(self.t)
        whole = np.zeros((n // 2 + 1, lines.shape[1]), dtype=complex)
        whole[len(whole) - len(lines) :] = lines * n  # all, or all but the mean
        return np.asarray(np.fft.irfft(whole, n, axis=0), dtype=np.float64) + self.offset


def spectrum_of_record(uncertain: UncertainModel, record: Record, noise: Mapping[str, ArrayLike]) -> Spectrum:
    """Compute the lines of a record's mean period; the noise bound is the root mean square over the periods used."""
    where = f"validate {record.name}"
    recorded = prepared(uncertain, record, noise, at_rest=True)
    try:
        floor = noise_floor(record, outputs=[s.name for s in recorded.outputs])
    except NoTrustworthyNumber as error:
        hint = 'domain="time" accepts any uniformly sampled record'
        raise NoTrustworthyNumber(where, f"no steady periods: {error.found}", "whole periods", hint) from None
    if floor.input_std:
        name = next(iter(floor.input_std))
        hint = 'domain="time" accepts any input'
        raise InputError(where, f"input {name!r} does not repeat exactly", "a periodic input: others leak", hint)
    n, dt = floor.samples, recorded.dt
    stacked = np.stack([floor.repeats(column) for column in recorded.y.T], axis=2)
    y = stacked.mean(axis=0)
    changing = ((stacked - y) ** 2).mean(axis=(0, 1)) / recorded.bound**2
    if (changing >= 1).any():
        j = int(changing.argmax())
        found = f"{recorded.outputs[j].name} changes from period to period by {np.sqrt(changing[j]):.3g} of its bound"
        raise NoTrustworthyNumber(where, f"not in steady state: {found}", "a steady record, or the noise it has",
                                  'domain="time", or leave the start of the record out')  # fmt: skip
    u = np.stack([floor.repeats(column).mean(axis=0) for column in recorded.u.T], axis=1)
    lines = np.arange(n // 2 + 1)
    edge = (lines == 0) | (2 * lines == n)
    M, (q, p) = recorded.uncertain.M, uncertain.delta_shape
    changed = f"the change between them is {100 * np.sqrt(changing.max()):.3g} % of the noise bound"
    assumptions = [
        f"steady state over {floor.count} periods of {floor.period:.6g} s from sample {floor.first} on; {changed}",
        "the root mean square of the noise over these periods is within its bound",
    ]
    if M.dt == 0:
        assumptions.append(f"u and w are held between samples of {dt:.6g} s")
    poles = np.linalg.eigvals(M.A)
    rounding = 1e-9 * max(float(np.abs(poles).max(initial=0.0)), 1.0)
    integrates = bool((np.abs(poles - (1.0 if M.dt else 0.0)) <= rounding).any())
    if integrates:
        assumptions.append("the mean over a period is excluded: the model integrates")
    kept = lines[int(integrates) :]
    f = kept / (n * dt)
    A, B = zero_order_hold(M, dt)
    response = frequency_response(StateSpaceModel(A, B, M.C, M.D, dt=dt), 2 * np.pi * f)
    U, Y = np.fft.rfft(u, axis=0)[kept] / n, np.fft.rfft(y, axis=0)[kept] / n
    forced = np.einsum("kij,kj->ki", response[:, :, q:], U)
    problem = _problem(
        uncertain, 2 * np.pi * f, response, forced, Y, recorded.bound[None],
        weight=np.where(edge, 1.0, 2.0)[kept], real=edge[kept], total=True, radius=np.sqrt(1 - changing),
    )  # fmt: skip
    bound = {s.name: float(b) for s, b in zip(recorded.outputs, recorded.bound, strict=True)}
    t, offset = np.arange(n, dtype=np.float64) * dt, y.mean(axis=0) if integrates else 0.0
    unit = recorded.bound[None]
    return Spectrum(problem, recorded.outputs, bound, t, y, forced[:, p:], unit, tuple(assumptions), offset)


def spectrum_of_response(uncertain: UncertainModel, data: FrequencyData, noise: Mapping[str, ArrayLike]) -> Spectrum:
    """Return the lines of a measured frequency response; a noise bound is one number or one for each line (n,)."""
    where = f"validate {data.name}"
    names = [s.name for s in uncertain.inputs]
    known = {"input": names, "output": [s.name for s in uncertain.outputs]}
    for kind, given in (("input", (data.input,)), ("output", data.outputs)):
        if unknown := [name for name in given if name not in known[kind]]:
            raise InputError(where, f"the model has no {kind} {unknown[0]!r}", f"one of {', '.join(known[kind])}")
    chosen = uncertain.select(outputs=list(data.outputs))
    n, M, (q, p) = len(data.omega), chosen.M, uncertain.delta_shape
    given = {name: np.asarray(value, dtype=np.float64) for name, value in noise.items()}
    for name, value in given.items():
        if value.shape not in ((), (n,)):
            raise InputError(f"{where}: noise of {name!r}", f"shape {value.shape}", f"one number, or ({n},)")
    for of_lines in (np.min, np.max):
        noise_bounds({name: float(of_lines(value)) for name, value in given.items()}, data.outputs, where)
    bound = np.column_stack([np.broadcast_to(given[name], n) for name in data.outputs])
    if M.is_discrete and data.omega[-1] > np.pi / M.dt * (1 + 1e-9):
        raise InputError(where, f"{data.omega[-1]:g} rad/s", f"at most pi / dt = {np.pi / M.dt:g} rad/s")
    response = frequency_response(M, data.omega)
    forced = response[:, :, q + names.index(data.input)]
    problem = _problem(
        uncertain, data.omega, response, forced, data.response, bound,
        weight=np.ones(n), real=data.omega == 0, total=False, radius=np.ones(len(data.outputs)),
    )  # fmt: skip
    assumptions = ("at each frequency the noise of an output is within its bound",)
    largest = {name: float(bound[:, j].max()) for j, name in enumerate(data.outputs)}
    y = np.abs(data.response)
    return Spectrum(problem, chosen.outputs, largest, data.omega, y, forced[:, p:], bound, assumptions)


# --- the result -------------------------------------------------------------------------------------------------------


def validate_by_lines(
    uncertain: UncertainModel, data: Record | FrequencyData, noise: Mapping[str, ArrayLike], search: Search,
    progress: Callable[[str], None],
) -> Validation:  # fmt: skip
    """Compute bounds of the smallest gamma over the lines; see `robustlab.identification.validation.validate`."""
    where = f"validate {data.name}"
    if not uncertain.blocks:
        hint = 'domain="time" tests whether noise alone explains a record'
        raise InputError(where, "a set without blocks in the frequency domain", "a block", hint)
    hint, expected = 'domain="time"', "complex scalars and full blocks"
    for block in uncertain.blocks:
        if block.is_real:
            found = f"block {block.name!r} is a real constant, one over all frequencies"
            raise InputError(where, found, expected, hint)  # at each frequency alone it would count as another one
        if not block.is_ball:  # w may not be any vector not longer than z
            found = f"block {block.name!r} is one scalar repeated {block.rows} times"
            raise InputError(where, found, expected, hint)
    if isinstance(data, Record):
        spectrum = spectrum_of_record(uncertain, data, noise)
    else:
        spectrum = spectrum_of_response(uncertain, data, noise)
    problem = spectrum.problem
    found = _smallest(problem, search)
    progress(f"{problem.n} lines: gamma {found.lower:.4g} .. {found.upper:.4g}")
    explained, error, sizes = np.full(spectrum.y.shape, np.nan), 0.0, np.full((problem.n, len(problem.blocks)), np.nan)
    if np.isfinite(found.upper):
        error = require_replay(_replay_error(problem, found.w), data.name)
        explained, sizes = spectrum.simulated(found.w), problem.sizes(found.w)
    largest = zip(problem.names, sizes.max(axis=0).tolist(), strict=True)
    return concluded(
        found,
        search,
        spectrum.outputs,
        record=data.name,
        blocks={name: BlockSize(name, "time-invariant", size) for name, size in largest},
        noise_bound=spectrum.bound,
        noise_norm="rms" if problem.total else "peak",
        replay_error=error,
        assumptions=(*spectrum.assumptions, "complex and full blocks are causal stable time-invariant systems"),
        t=spectrum.t,
        measured=spectrum.y,
        nominal=spectrum.simulated(np.zeros_like(found.w)),
        explained=explained,
        domain="frequency",
        omega=problem.omega,
        line_sizes=np.nan_to_num(sizes),
    )


def _replay_error(problem: SpectralProblem, w: ComplexArray) -> float:
    """Close the loop at each line with ``Delta = w z' / |z|^2`` and compare it with the explanation, over the bound."""
    z = problem.z(w)
    delta = np.zeros((*w.shape, z.shape[1]), dtype=complex)
    for rows, cols in problem.blocks:
        energy = (np.abs(z[:, cols]) ** 2).sum(axis=1)
        back = z[:, cols].conj() / np.where(energy > 0, energy, 1.0)[:, None]
        delta[:, rows, cols] = w[:, rows, None] * back[:, None, :]
    try:
        closed = np.linalg.solve(
            np.eye(w.shape[1]) - delta @ problem.M11, np.einsum("kij,kj->ki", delta, problem.z0)[..., None]
        )
    except np.linalg.LinAlgError:  # an ill-posed loop is no explanation
        return np.inf
    difference = np.einsum("kij,kj->ki", problem.M21, closed[..., 0] - w)
    if problem.total:
        return float(np.sqrt((problem.weight @ np.abs(difference) ** 2).max(initial=0.0)))
    return float(np.abs(difference).max(initial=0.0))


# --- the smallest gamma over all lines -------------------------------------------------------------------------------


def _smallest(problem: SpectralProblem, search: Search) -> Found:
    programme = _Programme(problem, search)
    known = not np.abs(problem.M11).max(initial=0.0)
    exact = "exact" if known else "lower bound exact where the Lagrangian is concave"
    label = f"time-invariant systems at {problem.n} lines ({exact})"
    empty = Multipliers(np.zeros((problem.n, len(problem.blocks))), np.zeros(problem.e.shape))

    def bounds(lower: float, upper: float, excess: float, multipliers: Multipliers, w: ComplexArray) -> Found:
        return Found(lower, upper, NO_NOISE, excess, multipliers, label, problem=problem, w=w, z=problem.z(w))

    none = np.zeros((problem.n, problem.M21.shape[2]), dtype=complex)
    nominal = problem.excess(problem.noise(none))
    if nominal <= 1:
        return bounds(0.0, 0.0, nominal, empty, none)
    free = programme.least_noise()
    least = problem.excess(problem.noise(free.w))
    if least > 1 + SLACK:
        multipliers = Multipliers(empty.D, programme.multipliers(free).noise)
        if not line_lagrangian(problem, multipliers, 1.0) < 0:
            raise NoTrustworthyNumber("validate", f"the noise bound is missed by {least - 1:.1e} of itself, unproved")
        return bounds(np.inf, np.inf, least, multipliers, none)
    best, at, lower, multipliers = np.inf, none, 0.0, empty
    for start in (problem.z0, problem.z(free.w)):
        gamma, w, solved = _descend(programme, start, known)
        if solved is not None:
            trial = programme.multipliers(solved)
            # With one programme per line the multipliers of a line belong to its own gamma: the worst decides.
            top = gamma if np.isfinite(gamma) else float(np.sqrt(solved.g.max(initial=0.0)))
            found = largest_disproved(lambda g, by=trial: line_lagrangian(problem, by, g) < 0, top, FINEST)
            lower, multipliers = (found, trial) if found > lower else (lower, multipliers)
        if gamma < best:
            best, at = gamma, w
        if known or lower >= best * (1 - search.precision):
            break
    excess = problem.excess(problem.noise(at)) if np.isfinite(best) else min(least, 1.0)
    return bounds(lower, best, excess, multipliers, at)


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
    """Maximise L over all w; inf if it is not bounded above, and a negative value is a proof."""
    # For a total bound: the sum over lines, else the line with the smallest maximum.
    q = problem.M21.shape[2]
    to_z, to_w = np.zeros(problem.z0.shape), np.zeros((problem.n, q))
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
