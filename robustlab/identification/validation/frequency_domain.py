"""Validation in the frequency domain, from a record in steady state or from a measured frequency response."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array, ComplexArray
from robustlab.budget import Budget
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.validation.line_programme import SpectralSizes, smallest_by_lines
from robustlab.identification.validation.result import BlockSize, Validation
from robustlab.identification.validation.spectral_problem import (
    FrequencyData,
    SpectralProblem,
    Spectrum,
    spectrum_of_record,
    spectrum_of_response,
)
from robustlab.record import Record
from robustlab.result import Status
from robustlab.uncertainty.lft import UncertainModel

__all__ = ["fits_frequency_domain", "validate_by_lines"]


SMALLEST = 1e-6


def fits_frequency_domain(
    data: Record | FrequencyData,
    domain: str,
    norm: str | None,
    delta: str,
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
    if delta != "time-invariant":
        raise InputError(where, f"{delta} blocks in the frequency domain", "time-invariant ones", 'domain="time"')
    for name, given in (("windows", window), ("a start at rest", at_rest or None), ("missing samples", missing)):
        if given:
            raise InputError(where, f"{name} in the frequency domain", "whole periods in steady state", 'domain="time"')
    if noise is None and isinstance(data, FrequencyData):
        raise NoTrustworthyNumber(where, "no noise bound was given", None, "noise={output: bound}, in its unit")


def validate_by_lines(
    uncertain: UncertainModel,
    data: Record | FrequencyData,
    noise: Mapping[str, ArrayLike],
    *,
    period: float | None,
    per_block: bool,
    precision: float,
    budget: Budget,
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
    count = len(uncertain.blocks)
    found = smallest_by_lines(problem, np.ones(count, dtype=bool), precision, budget)
    progress(f"{problem.n} lines: gamma {found.lower:.4g} .. {found.upper:.4g}")
    alone: dict[str, tuple[float, float]] = {}
    if per_block and np.isfinite(found.upper):
        for k, block in enumerate(uncertain.blocks):
            progress(f"block {block.name} alone")
            part = smallest_by_lines(problem, np.arange(count) == k, precision, budget)
            alone[block.name] = part.lower, part.upper
    said = (
        *spectrum.said,
        *(("the noise bound was estimated from the record's own periods",) if estimated else ()),
        "complex and full blocks are causal stable time-invariant systems",
    )
    return _result(data, spectrum, found, alone, said, precision, budget)


def _result(
    data: Record | FrequencyData,
    spectrum: Spectrum,
    found: SpectralSizes,
    alone: Mapping[str, tuple[float, float]],
    said: tuple[str, ...],
    precision: float,
    budget: Budget,
) -> Validation:
    problem = spectrum.problem
    explained, error = np.full(spectrum.y.shape, np.nan), 0.0
    w, z, sizes = found.w, problem.z(found.w), np.zeros((problem.n, len(problem.blocks)))
    if np.isfinite(found.upper):
        error = _replay_error(problem, found.w)
        if not error <= 1e-3:
            raise NoTrustworthyNumber(
                f"validate {data.name}", f"the explanation is off by {error:.1e} of the noise bound when replayed"
            )
        explained = _explained(spectrum, found.w)
        sizes = problem.sizes(found.w)
    w, z = w.copy(), z.copy()
    for (rows, cols), size in zip(problem.blocks, problem.scale, strict=True):
        w[:, rows] *= size
        z[:, cols] *= size
    largest = sizes.max(axis=0, initial=0.0) if np.isfinite(found.upper) else np.full(len(problem.blocks), np.nan)
    exact = "exact" if found.known else "lower bound exact where the Lagrangian is concave"
    evidence = {"energy": found.multipliers.D, "noise": found.multipliers.noise}
    return Validation(
        status=_status(found, precision, budget),
        notes=(budget.remark,) if budget.remark else (),
        record=data.name,
        lower=found.lower,
        upper=found.upper,
        label=f"time-invariant systems at {problem.n} lines ({exact})",
        blocks={
            name: BlockSize(name, "time-invariant", float(size), *alone.get(name, (np.nan, np.nan)))
            for name, size in zip(problem.names, largest, strict=True)
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
        multipliers=evidence,
        recheck=found.recheck,
        domain="frequency",
        omega=problem.omega,
        line_sizes=sizes,
    )


def _status(found: SpectralSizes, precision: float, budget: Budget) -> Status:
    if np.isinf(found.lower):
        return Status.INFEASIBLE
    if budget.struck:
        return Status.TIMEOUT
    if np.isfinite(found.upper) and found.upper - found.lower <= 1.01 * precision * max(found.upper, SMALLEST):
        return Status.CERTIFIED
    if found.lower > 1 or found.upper <= 1:
        return Status.CONVERGED
    return Status.INCONCLUSIVE


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
