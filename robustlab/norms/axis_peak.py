"""L-infinity norm: the peak gain over the frequency axis, of models that may be unstable."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from robustlab.errors import InputError, told_as
from robustlab.linear_analysis.exact_stability import exactly_on_boundary
from robustlab.linear_analysis.magnitude import moderated
from robustlab.norms.hinfinity import (
    FAR,
    HinfNorm,
    bracketed_norm,
    eigenvalue_blur,
    norm_as_given,
    pole_text,
)
from robustlab.norms.level_set import TUNING, NormTuning
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, as_model

__all__ = ["checked_band", "linf_norm"]

# A pole within so many times what eigenvalues are known to may lie on the boundary: those of Jordan blocks are blurred.
BESIDE = 1e9


@told_as("linf_norm")
def linf_norm(
    model: Any, rtol: float = 1e-6, *, band: tuple[float, float] | None = None, tuning: NormTuning = TUNING
) -> HinfNorm:
    r"""L-infinity norm as a bracket: the peak gain of a model that may be unstable, over the frequency axis or a band.

    .. math:: \|G\|_{L_\infty} = \sup_\omega \sigma_{max}(G(j\omega)) \qquad (G(e^{j\omega dt}) \text{ for } dt > 0)

    The bracket of `robustlab.hinf_norm`, whose level test needs no pole on the axis but no stability either. For a
    stable model both norms are the same; an unstable one has no H-infinity norm, and this one bounds no signals.

    Parameters
    ----------
    model
        Model with any numbers of states, inputs and outputs, including zero; or a python-control object.
    rtol
        Relative width of the bracket.
    band
        ``(low, high)`` in rad/s, ends included: the peak there, proved for every frequency in it.
    tuning
        How hard it is looked for.

    Returns
    -------
    HinfNorm
        Infinite for a model with a pole on the stability boundary, reachable or not; with a band, for one in it.
        Whether a pole lies there is decided in exact arithmetic up to 12 states; beyond them a pole that rounding
        cannot tell from the boundary makes the norm infinite with status INACCURATE.

    Raises
    ------
    InputError
        No model, an ``rtol`` that is not between 1e-12 and 1, or a band without width or beyond pi / dt.
    NoTrustworthyNumber
        The norm is larger than the largest floating-point number.

    References
    ----------
    Boyd, Balakrishnan 1990; Bruinsma, Steinbuch 1990.

    Examples
    --------
    >>> runaway = StateSpaceModel([[2.0]], [[1.0]], [[6.0]], [[0.0]])
    >>> norm = linf_norm(runaway)
    >>> norm.value, norm.frequency, norm.status.value
    (3.0, 0.0, 'certified')
    """
    given = as_model(model, "linf_norm")
    if not 1e-12 <= rtol < 1:
        raise InputError("linf_norm", f"rtol is {rtol}", "between 1e-12 and 1")
    ordinary = moderated(given, "linf_norm")
    part = None if band is None else checked_band(band, given.dt, "linf_norm")
    infinite = _on_the_boundary if part is None else partial(_in_the_band, part)
    return norm_as_given(bracketed_norm(ordinary, rtol, tuning, infinite, part), ordinary)


def checked_band(band: tuple[float, float], dt: float, where: str) -> tuple[float, float]:
    """A band of frequencies in rad/s; its upper end may be infinite, or pi / dt of a discrete model.

    Raises
    ------
    InputError
        No two numbers in order, below zero, or beyond pi / dt.
    """
    last = np.pi / dt if dt else np.inf
    try:
        low, high = (float(omega) for omega in band)
    except (TypeError, ValueError):
        raise InputError(f"{where}: band", f"{band!r}", "two frequencies in rad/s, low and high") from None
    if not 0 <= low < high or high > last * (1 + 1e-12):
        limit = f" up to pi / dt = {last:.6g} rad/s" if dt else ""
        raise InputError(f"{where}: band", f"{low:g} to {high:g} rad/s", f"0 <= low < high{limit}")
    return low, min(high, last)


def _on_the_boundary(m: StateSpaceModel, rate: int) -> HinfNorm | None:
    """The infinite norm of a model with a pole on the stability boundary, or None; poles are told times ``2^rate``."""
    poles = m.poles()
    distance = np.abs(np.abs(poles) - 1 if m.is_discrete else poles.real)
    nearest, blur = int(distance.argmin()), eigenvalue_blur(m)
    # Eigenvalues of Jordan blocks are known to far fewer digits; well away there is no doubt.
    if distance[nearest] > FAR * blur:
        return None
    there = exactly_on_boundary(m.A, m.is_discrete)
    if not there and distance[nearest] > blur:
        return None
    return _infinite(complex(poles[nearest]), 0 if m.is_discrete else rate, bool(there))


def _in_the_band(band: tuple[float, float], m: StateSpaceModel, rate: int) -> HinfNorm | None:
    """The same of the poles in a band alone; those elsewhere make no gain in it infinite."""
    poles, blur = m.poles(), eigenvalue_blur(m)
    distance = np.abs(np.abs(poles) - 1 if m.is_discrete else poles.real)
    at = np.abs(np.angle(poles) if m.is_discrete else poles.imag)
    low, high = (omega * m.dt if m.is_discrete else omega for omega in np.ldexp(band, -rate))
    inside = (at >= low - blur) & (at <= high + blur)
    if not (inside & (distance <= FAR * blur)).any():
        return None
    nearest = int(np.where(inside, distance, np.inf).argmin())
    # Exact arithmetic tells whether a pole lies on the boundary, not which: none beside the band may be the one.
    beside = ~inside & (distance <= BESIDE * blur)
    there = bool(not beside.any() and exactly_on_boundary(m.A, m.is_discrete))
    if not there and distance[nearest] > blur:
        return None
    return _infinite(complex(poles[nearest]), 0 if m.is_discrete else rate, there)


def _infinite(pole: complex, rate: int, there: bool) -> HinfNorm:
    """What a pole that is on the boundary, or cannot be told from it, makes of the norm; told times ``2^rate``."""
    word = pole_text(complex(np.ldexp(pole.real, rate), np.ldexp(pole.imag, rate)))
    if there:
        return HinfNorm(np.inf, np.nan, np.inf, np.inf, Status.CERTIFIED, f"pole {word} is on the stability boundary")
    text = f"pole {word} cannot be told from the stability boundary"
    return HinfNorm(np.inf, np.nan, 0.0, np.inf, Status.INACCURATE, text)
