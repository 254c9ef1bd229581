r"""Validation line by line: cone programmes with tangents of |z|^2 from above, multipliers from below.

At every explanation L = sum D (gamma^2 |z|^2 - |w|^2) + sum Lambda (r^2 - |n|^2) >= 0, so max_w L < 0, one small
Hermitian system a line, disproves gamma (Smith, Doyle 1992; Huang, Zhang 2007, theorem 2.1).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import Array, ComplexArray, Indices
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.comparison.best_linear_approximation import held_response
from robustlab.identification.comparison.repeats import noise_floor
from robustlab.identification.validation.cone_programme import ConeSolution, Rows, Search, solved_cones, sparse_matrices
from robustlab.identification.validation.sampled_problem import noise_bounds, prepared
from robustlab.identification.validation.validation_result import (
    BlockSize,
    Validation,
    concluded,
    each_alone,
    in_own_units,
    require_replay,
)
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.record import Record
from robustlab.result import Evidence
from robustlab.shown import Facts, listed, number
from robustlab.statespace import Signal, real_array
from robustlab.tables import Table, Tabular
from robustlab.uncertainty.blocks import block_slices
from robustlab.uncertainty.frequency_responses import UncertainFrequencyData, frequency_data
from robustlab.uncertainty.lft import UncertainModel

# Below this share of the largest one z is rounding: Delta cannot act there.
SILENT = 1e-10


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
        What messages call it.

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
        self,
        omega: ArrayLike,
        response: ArrayLike,
        input: str,
        outputs: tuple[str, ...] | list[str],
        name: str = "frequency response",
    ) -> None:
        w = real_array("omega", omega, 1, name)
        try:
            G = np.array(response, dtype=np.complex128)
        except (TypeError, ValueError):
            raise InputError(name, f"response: {response!r}", "complex numbers") from None
        for word, given in (("input", input), ("name", name)):
            if not isinstance(given, str):
                raise InputError(f"FrequencyData: {word}", repr(given), "a word")
        if isinstance(outputs, str) or not isinstance(outputs, Sequence):
            raise InputError("FrequencyData: outputs", repr(outputs), "a list of names")
        G = G[:, None] if G.ndim == 1 else G
        if w.ndim != 1 or not len(w) or not np.isfinite(w).all() or (np.diff(w) <= 0).any() or w[0] < 0:
            raise InputError(name, "omega", "finite increasing frequencies in rad/s, shape (n,)")
        if G.shape != (len(w), len(outputs)) or not np.isfinite(G).all():
            raise InputError(
                name, f"response of shape {G.shape}", f"finite numbers of shape ({len(w)}, {len(outputs)})"
            )
        for field, value in zip(("omega", "response", "input", "outputs", "name"), (w, G, input, tuple(outputs), name),
                                strict=True):  # fmt: skip
            object.__setattr__(self, field, value)
        self.__post_init__()

    def facts(self) -> Facts:
        """What a person wants to read, as (label, text)."""
        return [
            ("name", self.name),
            ("from", self.input),
            ("to", listed(self.outputs)),
            (
                "frequencies",
                f"{len(self.omega)}, {number(float(self.omega[0]))} .. {number(float(self.omega[-1]), 'rad/s')}",
            ),
        ]

    def uncertain(self, radius: ArrayLike) -> UncertainFrequencyData:
        """The response with what is not known of it, (n,) or (n, n_y); see `robustlab.frequency_data`."""
        r = np.asarray(radius, dtype=np.float64)
        r = r[:, :, None] if r.ndim == 2 else r
        whole, ins = self.response[:, :, None], [self.input]
        return frequency_data(whole, self.omega, radius=r, name=self.name, inputs=ins, outputs=self.outputs)

    def table(self) -> Table:
        """The response of every output."""
        columns = {name: self.response[:, k] for k, name in enumerate(self.outputs)}
        return Table(("omega", self.omega), columns, {"omega": "rad/s"})


@dataclass(frozen=True)
class SpectralProblem:
    """The affine maps of this module, in scaled signals."""

    omega: Array  # frequencies in rad/s, shape (n,)
    # M11, M21, z0, e: (n, p, q), (n, n_y, q), (n, p), (n, n_y)
    M11: ComplexArray
    M21: ComplexArray
    z0: ComplexArray
    e: ComplexArray
    # how often a line counts in the energy of a real signal (n,): 2, and 1 at zero and at the Nyquist frequency
    weight: Array
    real: NDArray[np.bool_]  # lines at which every spectrum of a real signal is real (n,)
    total: bool  # true: ``sum_k weight_k |n_kj|^2 <= radius_j^2`` for each output. False: ``|n_kj| <= 1`` at each line.
    radius: Array  # (n_y,)
    # blocks, names, scale: slices of w and z of each block, names, and what w and z of the block are divided by
    blocks: tuple[tuple[slice, slice], ...]
    names: tuple[str, ...]
    scale: Array

    @property
    def n(self) -> int:
        """Number of lines."""
        return len(self.omega)

    def z(self, w: ComplexArray) -> ComplexArray:
        """Inputs of Delta (n, p)."""
        return self.z0 + np.einsum("kij,kj->ki", self.M11, w)

    def noise(self, w: ComplexArray) -> ComplexArray:
        """Noise that is left (n, n_y), over its bound."""
        return self.e - np.einsum("kij,kj->ki", self.M21, w)

    def excess(self, noise: ComplexArray) -> float:
        """Noise over its bound: at most 1 where it is explained."""
        if not self.total:
            return float(np.abs(noise).max(initial=0.0))
        return float(np.sqrt((self.weight @ np.abs(noise) ** 2) / self.radius**2).max(initial=0.0))

    def sizes(self, w: ComplexArray) -> Array:
        """``|w| / |z|`` of each block at each line (n, blocks); inf where z is zero and w is not."""
        z, found = self.z(w), np.zeros((self.n, len(self.blocks)))
        for i, (rows, cols) in enumerate(self.blocks):
            top, under = np.linalg.norm(w[:, rows], axis=1), np.linalg.norm(z[:, cols], axis=1)
            with np.errstate(divide="ignore", invalid="ignore"):
                found[:, i] = np.where(top > 0, top / under, 0.0)
        return found

    def scaled(self) -> SpectralProblem:
        """W and z of each block in units of its nominal z, and every block taken out where nothing can reach it."""
        M11, M21, z0 = self.M11.copy(), self.M21.copy(), self.z0.copy()
        scales = []
        for rows, cols in self.blocks:
            size = float(np.sqrt((np.abs(z0[:, cols]) ** 2).mean())) or 1.0
            M21[:, :, rows] *= size
            M11[:, :, rows] *= size
            M11[:, cols] /= size
            z0[:, cols] /= size
            scales.append(size)
        loop = float(np.abs(M11).max(initial=0.0))
        silent = []
        for _, cols in self.blocks:
            size = np.linalg.norm(z0[:, cols], axis=1)
            silent.append(size <= SILENT * max(float(size.max(initial=0.0)), 1e-300))
            z0[np.ix_(silent[-1], range(cols.start, cols.stop))] = 0.0
        # With nothing to start it a well-posed loop is at rest: (I - M11 Delta) z = 0.
        undriven = np.all(silent, axis=0)
        for (rows, cols), quiet in zip(self.blocks, silent, strict=True):
            alone = np.abs(M11[:, cols]).max(initial=0.0) <= SILENT * max(loop, 1e-3)  # no w can make this z move
            still = quiet if alone else undriven
            M21[np.ix_(still, range(M21.shape[1]), range(rows.start, rows.stop))] = 0.0
            M11[np.ix_(still, range(M11.shape[1]), range(rows.start, rows.stop))] = 0.0
        return replace(self, M11=M11, M21=M21, z0=z0, scale=np.array(scales))


@dataclass(frozen=True)
class Spectrum:
    """A `SpectralProblem` and what stands behind it."""

    problem: SpectralProblem  # the maps
    # outputs, bound: judged outputs with units, and the noise bound of each
    outputs: tuple[Signal, ...]
    bound: Mapping[str, float]
    # t, y, nominal: one mean period of the record, the outputs (n_t, n_y), and the nominal steady state; for a
    # frequency response its frequencies and the magnitudes
    t: Array
    y: Array
    nominal: Array
    complex_y: ComplexArray  # the measured spectrum (n, n_y), in the units of the outputs
    unit_noise: Array  # what ``e`` was divided by, shape (n, n_y) or (1, n_y)
    said: tuple[str, ...]  # what is taken for granted


def spectrum_of_record(
    uncertain: UncertainModel, record: Record, noise: Mapping[str, float], period: float | None
) -> Spectrum:
    """The lines of a record's mean period; the noise bound is the root mean square over the periods used."""
    where = f"validate {record.name}"
    _refused_blocks(uncertain, where)
    recorded = prepared(uncertain, record, noise, norm="rms", at_rest=True)
    try:
        floor = noise_floor(record, period=period, outputs=[s.name for s in recorded.outputs])
    except NoTrustworthyNumber as error:
        hint = 'domain="time" takes any record on a uniform clock'
        raise NoTrustworthyNumber(where, f"no steady periods: {error.found}", "whole periods", hint) from None
    if floor.input_std:
        name = next(iter(floor.input_std))
        hint = 'domain="time" takes any input'
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
    M, (p, q) = recorded.uncertain.M, _channels(uncertain)
    changed = f"what changes between them is {100 * np.sqrt(changing.max()):.3g} % of the noise bound"
    said = [
        f"steady state over {floor.count} periods of {floor.period:.6g} s from sample {floor.first} on; {changed}",
        "the root mean square of the noise over these periods is within its bound",
    ]
    if M.dt == 0:
        said.append(f"u and w are held between samples of {dt:.6g} s")
    kept = lines
    if _integrates(M.A, M.dt):
        kept = lines[1:]
        said.append("the mean over a period is not judged: the model integrates")
    f = kept / (n * dt)
    response = held_response(M, f, dt)
    U, Y = np.fft.rfft(u, axis=0)[kept] / n, np.fft.rfft(y, axis=0)[kept] / n
    forced = np.einsum("kij,kj->ki", response[:, :, q:], U)
    e = (Y - forced[:, p:]) / recorded.bound
    left, weight = np.sqrt(1 - changing), np.where(edge, 1.0, 2.0)[kept]
    problem = SpectralProblem(
        2 * np.pi * f, response[:, :p, :q], response[:, p:, :q] / recorded.bound[None, :, None], forced[:, :p], e,
        weight=weight, real=edge[kept], total=True, radius=left, **_layout(uncertain),
    ).scaled()  # fmt: skip
    whole = np.zeros((n // 2 + 1, len(recorded.outputs)), dtype=complex)
    whole[kept] = forced[:, p:] * n
    nominal = np.fft.irfft(whole, n, axis=0)
    if len(kept) < len(lines):
        nominal = nominal + y.mean(axis=0)
    bound = {s.name: float(b) for s, b in zip(recorded.outputs, recorded.bound, strict=True)}
    return Spectrum(
        problem,
        recorded.outputs,
        bound,
        np.arange(n, dtype=np.float64) * dt,
        y,
        np.asarray(nominal, dtype=np.float64),
        Y,
        recorded.bound[None],
        tuple(said),
    )


def spectrum_of_response(uncertain: UncertainModel, data: FrequencyData, noise: Mapping[str, ArrayLike]) -> Spectrum:
    """The lines of a measured frequency response; a noise bound is one number or one for each line (n,)."""
    where = f"validate {data.name}"
    _refused_blocks(uncertain, where)
    names = [s.name for s in uncertain.inputs]
    for kind, given, known in (("input", (data.input,), names),
                               ("output", data.outputs, [s.name for s in uncertain.outputs])):  # fmt: skip
        unknown = [name for name in given if name not in known]
        if unknown:
            raise InputError(where, f"the model has no {kind} {unknown[0]!r}", f"one of {', '.join(known)}")
    chosen = uncertain.select(outputs=list(data.outputs))
    n = len(data.omega)
    for name in set(noise) - set(data.outputs):
        raise InputError(f"{where}: noise of {name!r}", "no such output", f"one of {', '.join(data.outputs)}")
    bound = np.empty((n, len(data.outputs)))
    for j, name in enumerate(data.outputs):
        given = np.asarray(noise.get(name, np.nan), dtype=np.float64)
        if given.shape not in ((), (n,)):
            raise InputError(f"{where}: noise of {name!r}", f"shape {given.shape}", f"one number, or ({n},)")
        lowest = {name: float(given.min())} if name in noise else {}
        noise_bounds(lowest, (name,), "peak", where)
        if not np.isfinite(given).all():
            raise InputError(f"{where}: noise of {name!r}", "numbers that are not finite", "positive numbers")
        bound[:, j] = given
    M, (p, q) = chosen.M, _channels(uncertain)
    if M.is_discrete and data.omega[-1] > np.pi / M.dt * (1 + 1e-9):
        raise InputError(where, f"{data.omega[-1]:g} rad/s", f"at most pi / dt = {np.pi / M.dt:g} rad/s")
    response = frequency_response(M, data.omega)
    forced = response[:, :, q + names.index(data.input)]
    e = (data.response - forced[:, p:]) / bound
    problem = SpectralProblem(
        data.omega, response[:, :p, :q], response[:, p:, :q] / bound[:, :, None], forced[:, :p], e,
        weight=np.ones(n), real=data.omega == 0, total=False, radius=np.ones(len(data.outputs)), **_layout(uncertain),
    ).scaled()  # fmt: skip
    said = ("at each frequency the noise of an output is within its bound",)
    largest = {name: float(bound[:, j].max()) for j, name in enumerate(data.outputs)}
    sizes = np.abs(data.response), np.abs(forced[:, p:])
    return Spectrum(problem, chosen.outputs, largest, data.omega, *sizes, data.response, bound, said)


def _channels(uncertain: UncertainModel) -> tuple[int, int]:
    q, p = uncertain.delta_shape
    return p, q


def _layout(uncertain: UncertainModel) -> dict[str, Any]:
    """The blocks' part of a problem that is not scaled yet."""
    names = tuple(b.name for b in uncertain.blocks)
    return {"blocks": tuple(block_slices(uncertain.blocks)), "names": names, "scale": np.ones(len(names))}


def _integrates(A: Array, dt: float) -> bool:
    poles = np.linalg.eigvals(A) if len(A) else np.zeros(0)
    largest = max(float(np.abs(poles).max(initial=0.0)), 1.0)
    return bool((np.abs(poles - (1.0 if dt else 0.0)) <= 1e-9 * largest).any())


def _refused_blocks(uncertain: UncertainModel, where: str) -> None:
    for block in uncertain.blocks:
        if block.is_real:
            raise InputError(
                where, f"block {block.name!r} is a real constant, one over all frequencies",
                "complex and full blocks: at each frequency alone it would count as another one", 'domain="time"',
            )  # fmt: skip
        if not block.is_ball:
            raise InputError(where, f"block {block.name!r} is one scalar repeated {block.rows} times",
                             "blocks whose w may be any vector not longer than z", 'domain="time"')  # fmt: skip


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
