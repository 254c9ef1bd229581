"""Validation in the frequency domain, from a record in steady state or from a measured frequency response."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array, ComplexArray, Mask
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.validation.line_programme import SpectralSizes, smallest_by_lines
from robustlab.identification.validation.result import (
    BlockSize,
    Validation,
    concluded,
    each_alone,
    in_own_units,
    require_replay,
)
from robustlab.identification.validation.spectral_problem import (
    FrequencyData,
    SpectralProblem,
    Spectrum,
    spectrum_of_record,
    spectrum_of_response,
)
from robustlab.identification.validation.tuning import Search
from robustlab.record import Record
from robustlab.uncertainty.lft import UncertainModel

__all__ = ["fits_frequency_domain", "validate_by_lines"]


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

        def bounds(scaled: Mask) -> tuple[float, float]:
            part = smallest_by_lines(problem, replace(search, scaled=scaled))
            return part.lower, part.upper

        alone = each_alone(problem.names, bounds, progress)
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
