r"""Best linear approximation of a measured system, line by line or by Welch's H1, and the model's response.

Noise from the scatter of the periods, distortions from that of neighbouring lines (Pintelon, Schoukens, *System
Identification*, 2012, sections 2.7, 4.3 and 7.2).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import Array, ComplexArray
from robustlab.dynamics.simulation import transition
from robustlab.identification.comparison.error_analysis import bin_index, log_bands, uniform_samples, welch_segments
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.result import Evidence
from robustlab.statespace import StateSpaceModel

EXCITED = 1e-10  # of the strongest line's power: weaker lines are rounding
SIGNAL_TO_NOISE = 10.0  # power of a line's average input over that of its noise
LOCAL_LINES = 7  # through which the parabola goes
PARABOLA = 3  # its coefficients
MISSED = 0.05  # of the lines of a right model are outside their circle


@dataclass(frozen=True)
class BestLinearApproximation(Evidence):
    r"""Frequency response from one input to one output, measured and modelled; arrays have shape (n_f,)."""

    method: str  # ``"periods"`` or ``"Welch H1"``
    frequency: Array  # in Hz; the excited lines only where the data are periodic
    response: ComplexArray  # the estimate, complex, in units of output per input
    std: Array  # standard deviation of ``response``: \sqrt{E|\hat G - G|^2}, everything included
    # noise_std, nonlinear_std: the parts due to noise and to nonlinear distortions; None where the data cannot separate
    # them
    noise_std: Array | None
    nonlinear_std: Array | None
    coherence: Array  # share of the measured output's power (of one period, one segment) that is linear in the inputs
    model: ComplexArray  # the model's response for an input held between samples, complex
    bands: Array  # edges of bands in Hz, shape (n_bands + 1,)
    # per band: RMS of model minus response over RMS of the response, shape (n_bands,); None without a line
    relative_error: tuple[float | None, ...]
    # per band: share of the lines at which the model is outside the 95 % circle; about 0.05 for a right model
    outside: tuple[float | None, ...]
    notes: tuple[str, ...]  # limits of the estimate

    def band_coherence(self) -> list[float | None]:
        """Return the median coherence of each band; None for a band without a line."""
        return self._medians(self.coherence)

    def _medians(self, values: Array) -> list[float | None]:
        part = bin_index(self.frequency, self.bands)
        return [float(np.median(values[part == k])) if (part == k).any() else None for k in range(len(self.bands) - 1)]

    def band_table(self) -> dict[str, object]:
        """Return the model error per band, and the medians of coherence, noise and distortion over the response."""
        part = bin_index(self.frequency, self.bands)
        size = np.abs(self.response)

        def relative(s: Array | None) -> list[float | None] | None:
            return None if s is None else self._medians(np.divide(s, size, out=np.zeros_like(s), where=size > 0))

        return {
            "method": self.method,
            "bands": self.bands,
            "lines": [int((part == k).sum()) for k in range(len(self.bands) - 1)],
            "relative_error": list(self.relative_error),
            "outside": list(self.outside),
            "coherence": self.band_coherence(),
            "relative_std": relative(self.std),
            "relative_noise": relative(self.noise_std),
            "relative_nonlinear": relative(self.nonlinear_std),
            "notes": list(self.notes),
        }

    def to_json(self) -> dict[str, object]:
        """Return the bands, and all series as real numbers: magnitude and phase (degrees) of the responses."""
        return self.band_table() | {
            "frequency": self.frequency,
            "magnitude": np.abs(self.response),
            "phase": np.degrees(np.angle(self.response)),
            "std": self.std,
            "noise_std": self.noise_std,
            "nonlinear_std": self.nonlinear_std,
            "line_coherence": self.coherence,
            "model_magnitude": np.abs(self.model),
            "model_phase": np.degrees(np.angle(self.model)),
        }


def periodic_bla(
    u: ArrayLike, y: ArrayLike, dt: float, model: StateSpaceModel | None = None, lines: NDArray[np.int_] | None = None
) -> BestLinearApproximation | None:
    """Estimate the best linear approximation from whole periods in steady state, u and y (count, n)."""
    u, y = (np.asarray(x, dtype=np.float64) for x in (u, y))
    count, n = u.shape
    lines = np.arange(1, (n + 1) // 2) if lines is None else np.asarray(lines)
    U, Y = (np.fft.rfft(x, axis=1)[:, lines] / n for x in (u, y))
    mean_u, mean_y = U.mean(axis=0), Y.mean(axis=0)
    power = np.abs(mean_u) ** 2
    noise_u = (np.abs(U - mean_u) ** 2).sum(axis=0) / (count - 1) / count
    keep = (power > EXCITED * power.max(initial=0.0)) & (power > SIGNAL_TO_NOISE * noise_u)
    if not keep.any():
        return None
    lines, U, Y, mean_u, mean_y = lines[keep], U[:, keep], Y[:, keep], mean_u[keep], mean_y[keep]
    f = lines / (n * dt)
    response = mean_y / mean_u
    # First-order propagation: e_G = (e_y - G e_u) / U, from the same periods, so also for a noise that feeds back.
    noise = (np.abs((Y - response * U) / mean_u) ** 2).sum(axis=0) / (count - 1) / count
    at = held_response(model, f, dt)[:, 0, 0] if model is not None else np.zeros(len(f), complex)
    total = _local_scatter(lines, response, at)
    nonlinear = None if total is None else np.sqrt(np.maximum(0.0, total - noise))
    linear = np.abs(response) ** 2
    # In one period: the noise of a single period, and the distortions.
    rest = noise * count + (0.0 if nonlinear is None else nonlinear**2)
    coherence = np.divide(linear, linear + rest, out=np.zeros_like(linear), where=linear > 0)
    few = f"fewer than {LOCAL_LINES} lines: distortions are not separated from the linear response"
    return _with_bands(
        "periods", f, response, noise if total is None else np.maximum(total, noise),
        count - 1 if total is None else LOCAL_LINES - PARABOLA, coherence, at, (few,) if total is None else (),
        np.sqrt(noise), nonlinear,
    )  # fmt: skip


def arbitrary_bla(
    t: Array, inputs: Mapping[str, Array], y: Array, model: StateSpaceModel
) -> dict[str, BestLinearApproximation]:
    """Estimate the response from each input to one output by Welch's H1 (Hann window, half overlap).

    var G_j = (1 - coherence^2) / (m - n_u) S_yy (S_uu^-1)_jj with m effective averages. ``model``: from these inputs.
    Signals on a nonuniform time base are interpolated to its mean step.
    """
    from scipy.signal import csd

    names = [name for name, x in inputs.items() if np.ptp(x)]
    dt, (y, *columns) = uniform_samples(t, y, *(inputs[name] for name in names))
    segment, averages = welch_segments(len(y))
    if not names or averages < len(names) + 1 or segment < 8:
        return {}
    options: dict[str, Any] = {"fs": 1.0 / dt, "nperseg": segment, "noverlap": segment // 2}

    def cross(a: Array, b: Array) -> tuple[Array, ComplexArray]:
        f, s = csd(a, b, window="hann", detrend="constant", **options)  # conj(A) B
        return np.asarray(f, dtype=np.float64), np.asarray(s, dtype=np.complex128)

    f, of_y = cross(y, y)
    use = slice(1, None)  # the means are removed: no information at frequency 0
    Suu = np.array([[cross(b, a)[1][use] for b in columns] for a in columns]).transpose(2, 0, 1)
    Syu = np.array([cross(b, y)[1][use] for b in columns]).T
    f, Syy = f[use], of_y.real[use]
    trace = np.trace(Suu, axis1=1, axis2=2).real
    excited = (np.linalg.eigvalsh(Suu)[:, 0] > EXCITED * trace.max()) & (Syy > 0)
    if not excited.any():
        return {}
    f, Suu, Syu, Syy = f[excited], Suu[excited], Syu[excited], Syy[excited]
    inverse = np.linalg.inv(Suu)
    G = np.einsum("fj,fji->fi", Syu, inverse)
    coherence = np.clip(np.einsum("fi,fi->f", G, Syu.conj()).real / Syy, 0.0, 1.0)
    at = held_response(model.select(inputs=names), f, dt)[:, 0, :]
    notes = (
        "noise and nonlinear distortion are not separated: the record does not repeat",
        "biased where the input was computed from the output (closed loop)",
    )
    spare = averages - len(names)
    result: dict[str, BestLinearApproximation] = {}
    for j, name in enumerate(names):
        variance = (1.0 - coherence) * Syy * inverse[:, j, j].real / spare
        result[name] = _with_bands("Welch H1", f, G[:, j], variance, spare, coherence, at[:, j], notes)
    return result


def held_response(model: StateSpaceModel, f: Array, dt: float) -> ComplexArray:
    """Compute the response (n_f, n_y, n_u) at f in Hz of a model with zero-order-hold inputs and sampled outputs."""
    omega = 2.0 * np.pi * np.asarray(f, dtype=np.float64)
    if model.is_discrete or not model.n_states:
        return frequency_response(model, omega)
    phi, gamma, _ = transition(model, dt)
    held = StateSpaceModel(phi, gamma, model.C, model.D, dt=dt)
    return frequency_response(held, omega)


def _local_scatter(lines: NDArray[np.int_], response: ComplexArray, model: ComplexArray) -> Array | None:
    """Estimate the variance of the response about a parabola through the nearest lines; None if these are too few.

    The parabola is fitted to response / model, which is smoother than the response.
    """
    n = len(lines)
    if n < LOCAL_LINES:
        return None
    scale = np.where(np.abs(model) > 0, model, 1.0)
    ratio = response / scale
    first = np.clip(np.arange(n) - LOCAL_LINES // 2, 0, n - LOCAL_LINES)
    near = first[:, None] + np.arange(LOCAL_LINES)
    x = (lines[near] - lines[:, None]).astype(float)
    x /= np.abs(x).max(axis=1, keepdims=True)
    basis = np.stack([np.ones_like(x), x, x**2], axis=2)
    q, _ = np.linalg.qr(basis)
    values = ratio[near]
    left = values - np.einsum("kij,kj->ki", q, np.einsum("kij,ki->kj", q, values))
    scatter = (np.abs(left) ** 2).sum(axis=1) / (LOCAL_LINES - PARABOLA)
    return scatter * np.abs(scale) ** 2


def _with_bands(
    method: str, f: Array, response: ComplexArray, variance: Array, degrees: float, coherence: Array,
    model: ComplexArray, notes: tuple[str, ...], noise_std: Array | None = None, nonlinear_std: Array | None = None,
) -> BestLinearApproximation:  # fmt: skip
    """Add the model error per band to an estimate whose variance has so many complex degrees of freedom."""
    # |e|² / s² of a complex normal e exceeds x with the probability (1 + x / d)^-d.
    circle = degrees * (MISSED ** (-1.0 / degrees) - 1.0)
    bands = log_bands(f[0], f[-1])
    part = bin_index(f, bands)
    error = np.abs(model - response) ** 2
    size = np.abs(response) ** 2
    # Rounding is no disagreement.
    missed = error > circle * variance + 1e-18 * size
    relative: list[float | None] = []
    outside: list[float | None] = []
    for inside in (part == k for k in range(len(bands) - 1)):
        total = float(size[inside].sum())
        relative.append(float(np.sqrt(error[inside].sum() / total)) if total else None)
        outside.append(float(np.mean(missed[inside])) if inside.any() else None)
    return BestLinearApproximation(
        method, f, response, np.sqrt(variance), noise_std, nonlinear_std, coherence, model, bands,
        tuple(relative), tuple(outside), notes,
    )  # fmt: skip
