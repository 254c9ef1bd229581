"""H-infinity and L-infinity norm as a proved bracket: one level test, which needs no stability.

The H-infinity norm is infinite where the model is unstable. The L-infinity norm, the peak over the frequency axis or a
band of it, is infinite where a pole lies on it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import AnyArray, Array
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.linear_analysis.exact import exactly_on_boundary, exactly_stable
from robustlab.linear_analysis.magnitude import Moderated, balancing_factors, moderated
from robustlab.linear_analysis.narrow_peaks import modes_apart
from robustlab.norms.bilinear_map import bilinear_to_continuous
from robustlab.norms.level_set import (
    TUNING,
    Band,
    NormTuning,
    crossings,
    largest_gains,
    level_bracket,
    search_grid,
    well_scaled,
)
from robustlab.norms.peak_gain import PeakGain
from robustlab.result import Status
from robustlab.shown import Facts
from robustlab.statespace import StateSpaceModel, as_model

EPS = float(np.finfo(float).eps)
# Eigenvalues of a Jordan block of four may be off by this many times those of a matrix with a basis of eigenvectors.
FAR = 1e12

# Shares of the norm: rounding at the peak below the first is not told, above the second the bracket is not certified,
# unless the norm with its rounding is below the first share of the terms that cancel in it: zero for every purpose.
QUIET, LOUD = 1e-9, 1e-3
# A pole within so many times what eigenvalues are known to may lie on the boundary: those of Jordan blocks are blurred.
BESIDE = 1e9
# Share of the norm that rounding is at the worst frequencies before it may be all of the norm.
MOST = 0.1


@dataclass(frozen=True)
class HinfNorm(PeakGain):
    """H-infinity norm of a model, or its peak gain over the axis or a band, with its evidence.

    Attributes
    ----------
    lower
        ``sigma_max`` of the given model at ``frequency``, evaluated.
    upper
        Level that no singular value crosses, by the Hamiltonian test; ``lower <= norm <= upper``. Where rounding may
        move the gain at the peak by more than 1e-9 of it, both ends are that much further out. A norm that is zero but
        for rounding has zero and the bound of that rounding as its ends.
    frequency
        Frequency in rad/s at which ``sigma_max`` attains ``lower``; ``inf`` where only the direct term does, NaN for an
        infinite norm without such a frequency.
    status
        CERTIFIED, or INACCURATE where rounding leaves the sign of a pole or a level test open.
    reason
        Why the norm is infinite or inaccurate; else empty.
    system
        The model that it is the norm of, for `robustlab.verify`.
    band
        The band in rad/s of a peak over the axis, which asks for no stability; None of a norm.
    """

    frequency: float
    reason: str = ""
    system: StateSpaceModel | None = field(default=None, compare=False)
    band: tuple[float, float] | None = field(default=None, compare=False)

    quantities: ClassVar[Mapping[str, Any]] = {"value": float, "frequency": "rad/s", "lower": float, "upper": float}
    unstable: ClassVar[str] = "infinite"
    unsaved: ClassVar[tuple[str, ...]] = ("system", "band")

    @property
    def value(self) -> float:
        """The norm: ``lower``, or inf where there is no finite bound."""
        return np.inf if np.isinf(self.upper) else self.lower

    def evidence(self) -> Facts:
        """Why the norm is infinite or inaccurate."""
        return [("reason", self.reason)]

    def to_json(self) -> dict[str, Any]:
        return {**super().to_json(), "value": self.value}


# Which poles make the norm infinite: its bracket, or None; told times ``2^rate``.
Infinite = Callable[[StateSpaceModel, int], HinfNorm | None]


@told_as("hinf_norm")
def hinf_norm(model: Any, rtol: float = 1e-6, *, tuning: NormTuning = TUNING) -> HinfNorm:
    """`robustlab.peak_gain` of a model: the H-infinity norm, infinite where the model is not stable.

    Level-set method on the Hamiltonian: ``sigma_max(G(jw)) = g`` for some w iff H(g) has the eigenvalue jw. The
    imaginary part of *every* eigenvalue of H(g) counts as a candidate crossing, without a tolerance on its real part,
    and ``sigma_max`` is evaluated at all of them and between each two; the level is an upper bound where none of these
    exceeds it. With many states, or where large terms cancel, the level is proved interval by interval instead, by
    expansions of the response with bounds of their remainders and of rounding (`ModalResponse.above`). A zoom on the
    highest peaks looks for what rounding may have hidden. Values come from the model's modes where a bound of their
    error shows that this is enough; what is told is solved for with A.
    """
    given = as_model(model, "hinf_norm")
    return _norm_of(given, rtol, tuning, unstable_norm, None, "hinf_norm")


@told_as("linf_norm")
def linf_norm(
    model: Any, rtol: float = 1e-6, *, band: tuple[float, float] | None = None, tuning: NormTuning = TUNING
) -> HinfNorm:
    """The same over the frequency axis or a band of it, of a model that may be unstable.

    Whether a pole lies on the stability boundary is decided in exact arithmetic up to 12 states; beyond them a pole
    that rounding cannot tell from the boundary makes the norm infinite with status INACCURATE.
    """
    given = as_model(model, "linf_norm")
    part = None if band is None else checked_band(band, given.dt, "linf_norm")
    infinite = _on_the_boundary if part is None else partial(_in_the_band, part)
    return _norm_of(given, rtol, tuning, infinite, part, "linf_norm")


def _norm_of(
    given: StateSpaceModel, rtol: float, tuning: NormTuning, infinite: Infinite, band: Band | None, where: str
) -> HinfNorm:
    if not 1e-12 <= rtol < 1:
        raise InputError(where, f"rtol is {rtol}", "between 1e-12 and 1")
    ordinary = moderated(given, where)
    found = norm_as_given(bracketed_norm(ordinary, rtol, tuning, infinite, band), ordinary)
    asked = None if infinite is unstable_norm else (0.0, np.inf) if band is None else (float(band[0]), float(band[1]))
    return replace(found, system=given, band=asked)


def checked_band(band: tuple[float, float], dt: float, where: str) -> tuple[float, float]:
    """A band of frequencies in rad/s; its upper end may be infinite, or pi / dt of a discrete model."""
    last = np.pi / dt if dt else np.inf
    try:
        low, high = (float(omega) for omega in band)
    except (TypeError, ValueError):
        raise InputError(f"{where}: band", f"{band!r}", "two frequencies in rad/s, low and high") from None
    if not 0 <= low < high or high > last * (1 + 1e-12):
        limit = f" up to pi / dt = {last:.6g} rad/s" if dt else ""
        raise InputError(f"{where}: band", f"{low:g} to {high:g} rad/s", f"0 <= low < high{limit}")
    return low, min(high, last)


def norm_as_given(norm: HinfNorm, ordinary: Moderated) -> HinfNorm:
    """The norm in the units of the model as given; the bracket keeps holding where it is rounded."""
    if not (ordinary.rate or ordinary.gain):
        return norm
    lower, upper = (ordinary.value(x, "hinf_norm") for x in (norm.lower, norm.upper))
    with np.errstate(over="ignore", under="ignore"):
        if np.ldexp(lower, ordinary.gain) > norm.lower:
            lower = float(np.nextafter(lower, 0))
        if np.ldexp(upper, ordinary.gain) < norm.upper:
            upper = float(np.nextafter(upper, np.inf))
    return HinfNorm(lower, upper, ordinary.frequency(norm.frequency), norm.status, norm.reason)


def bracketed_norm(
    ordinary: Moderated,
    rtol: float,
    tuning: NormTuning,
    infinite: Infinite,
    band: Band | None = None,
) -> HinfNorm:
    """The norm of the model with ordinary entries; only ``reason`` speaks in the units of the model as given.

    The level test needs no stability: ``infinite`` says which poles make the norm infinite. A band is one of the model
    as given.
    """
    m = ordinary.model
    if not m.n_inputs or not m.n_outputs:
        return (infinite(m, ordinary.rate) if m.n_states else None) or HinfNorm(0.0, 0.0, 0.0, Status.CERTIFIED)
    if not m.n_states:
        gain = float(np.linalg.norm(m.D, 2))
        return HinfNorm(gain, gain, 0.0 if band is None else band[0], Status.CERTIFIED)
    without_bracket = infinite(m, ordinary.rate)
    if without_bracket is not None:
        return without_bracket
    found = _bracket(m, ordinary, rtol, tuning, band)
    if found.status is Status.CERTIFIED or (apart := modes_apart(m)) is m:
        return found
    again = _bracket(apart, ordinary, rtol, tuning, band)
    return again if again.status is Status.CERTIFIED or again.upper - again.lower < found.upper - found.lower else found


def _bracket(m: StateSpaceModel, ordinary: Moderated, rtol: float, tuning: NormTuning, band: Band | None) -> HinfNorm:
    """The norm from these states of the ordinary model."""
    try:
        scaled, rate = well_scaled(bilinear_to_continuous(m) if m.is_discrete else m)
        part = None if band is None else _band_of(ordinary, band, rate)
        lower, omega, upper, trusted, doubtful = level_bracket(scaled, rtol, tuning, part)
    except (np.linalg.LinAlgError, NoTrustworthyNumber) as error:
        return HinfNorm(0.0, np.inf, np.nan, Status.INACCURATE, f"frequency response failed: {error}")
    # A peak is flat to rtol over sqrt(2 rtol) times its pole's distance: a representable frequency must lie in there.
    blind = np.isfinite(omega) and np.sqrt(2 * rtol) * np.abs(1j * omega - scaled.poles()).min() < EPS * omega
    omega *= rate
    if m.is_discrete:  # the bilinear map s = (2/dt) (z - 1)/(z + 1) bends the frequency axis
        omega = 2 / m.dt * float(np.arctan(omega * m.dt / 2)) if np.isfinite(omega) else np.pi / m.dt
        doubtful = 2 / m.dt * np.arctan(rate * doubtful * m.dt / 2) / rate
    attained = float(largest_gains(m, np.array([omega]))[0])
    reason = "" if trusted else "the level test and a direct search disagreed; digits were lost"
    error = worst = gain_rounding(m.A, m.B, m.C, m.D, axis_point(m, omega))
    if abs(attained - lower) > 10 * rtol * lower + min(error, LOUD * lower) and lower > upper - lower:
        trusted = False
        reason = f"scaled and original realisation differ at the peak: {lower:.9g} against {attained:.9g}"
    if blind:
        at = f"{ordinary.frequency(omega):.6g} rad/s"
        trusted, reason = False, f"the peak at {at} is narrower than the spacing of floating-point numbers"
    lower, upper = attained, max(upper, attained)
    for at, gain in zip(rate * doubtful, largest_gains(m, rate * doubtful) if len(doubtful) else [], strict=True):
        beside = gain_rounding(m.A, m.B, m.C, m.D, axis_point(m, float(at)))
        worst, upper = max(worst, beside), max(upper, float(gain) + beside)
    if error > LOUD * attained:
        upper += error
        given = None if band is None else _moderated(ordinary, band)
        sure = blind or worst < MOST * attained
        nothing = None if sure else _nothing((m, given), (scaled, part), tuning.nothing_points)
        if nothing is not None:
            return nothing
        share = error / attained if attained else np.inf
        trusted, reason = False, f"rounding alone may move the gain at the peak by {share:.2g} of it: digits were lost"
    elif error > QUIET * attained:
        lower, upper = attained - error, upper + error
    return HinfNorm(lower, upper, omega, Status.CERTIFIED if trusted else Status.INACCURATE, reason)


def _band_of(ordinary: Moderated, band: Band, rate: float) -> Band:
    """The band of the scaled continuous model that stands for one of the model as given."""
    low, high = _moderated(ordinary, band)
    dt = ordinary.model.dt
    if dt:
        low, high = (2 / dt * float(np.tan(omega * dt / 2)) if omega * dt < np.pi else np.inf for omega in (low, high))
    return low / rate, high / rate


def _moderated(ordinary: Moderated, band: Band) -> Band:
    """The band of the model with ordinary entries."""
    return float(np.ldexp(band[0], -ordinary.rate)), float(np.ldexp(band[1], -ordinary.rate))


def axis_point(m: StateSpaceModel, omega: float) -> complex:
    """The point s or z of a frequency."""
    if m.is_discrete:
        return complex(np.exp(1j * omega * m.dt))
    return 1j * omega if np.isfinite(omega) else complex(np.inf)


def gain_rounding(
    A: AnyArray, B: AnyArray, C: AnyArray, D: AnyArray, s: complex, sums: Sequence[Array] | None = None
) -> float:
    r"""Bound of the rounding error of ``sigma_max(C (sI - A)^{-1} B + D)``, to first order; s may be infinite.

    ``sums``: sizes of what was added up to A, B, C and D, where terms cancelled in them; their own where left out.

    With ``F = sI - A`` and ``X = F^{-1} B`` a backward stable solution is off by no more than
    ``n eps |F^{-1}| (|F| |X| + |B|)``, entry by entry; no scaling of the states changes that.
    """
    return _terms(A, B, C, D, s, sums)[1]


def _terms(
    A: AnyArray, B: AnyArray, C: AnyArray, D: AnyArray, s: complex, sums: Sequence[Array] | None = None
) -> tuple[float, float]:
    """Size of what is added up to the gain at s, ``|C| |X| + |D|``, and `gain_rounding`."""
    in_a, in_b, in_c, in_d = [np.abs(m) for m in (A, B, C, D)] if sums is None else sums
    n, size, error = len(A), np.abs(D), in_d
    if n and np.isfinite(s):
        inverse = np.linalg.inv(s * np.eye(n) - A)
        X, terms = np.abs(inverse @ B), in_a + abs(s) * np.eye(n)
        size = size + np.abs(C) @ X
        error = error + in_c @ X + np.abs(C) @ np.abs(inverse) @ (terms @ X + in_b)
    return float(np.linalg.norm(size)), max(n, 1) * EPS * float(np.linalg.norm(error))


def _nothing(
    one: tuple[StateSpaceModel, Band | None], other: tuple[StateSpaceModel, Band | None], points: int
) -> HinfNorm | None:
    """The norm of a model without any gain but rounding, all over or in a band; None where it is not shown to be one.

    Given twice, as it is and scaled, each with the band in its units.

    Nowhere may the gain, its rounding included, be more than next to nothing of the terms that cancel in it. No level
    test is sharper than that, but at the bound of the rounding it must agree.
    """
    (m, band), (scaled, part) = one, other
    omega = search_grid(m, points, band)
    try:
        sigma = largest_gains(m, omega)
        size, error = np.array([_terms(m.A, m.B, m.C, m.D, axis_point(m, w)) for w in omega]).T
        upper = float((sigma + error).max())
        if not (sigma.max() <= error.max() and upper <= QUIET * size.max()):
            return None
        again = np.concatenate([search_grid(scaled, points, part), crossings(scaled, upper, part)])
        if not largest_gains(scaled, again).max() <= upper:
            return None
    except (np.linalg.LinAlgError, NoTrustworthyNumber):
        return None
    return HinfNorm(0.0, upper, float(omega[np.argmax(sigma)]), Status.CERTIFIED)


def unstable_norm(m: StateSpaceModel, rate: int = 0) -> HinfNorm | None:
    """The infinite norm of a model that is not stable, or None; poles are told times ``2^rate``."""
    abscissa = m.spectral_abscissa()
    # Balancing does not make the sum of all entries larger: where that is enough it need not be done.
    if abscissa < -10 * EPS * max(float(np.abs(m.A).sum()), 1.0 if m.is_discrete else 0.0):
        return None
    blur = eigenvalue_blur(m)
    if abscissa < -blur:
        return None
    poles = m.poles()
    worst = poles[np.argmax(np.abs(poles) if m.is_discrete else poles.real)]
    if not m.is_discrete:
        worst = complex(np.ldexp(worst.real, rate), np.ldexp(worst.imag, rate))
    # Eigenvalues of Jordan blocks are known to far fewer digits; well outside there is no doubt.
    stable = exactly_stable(m.A, m.is_discrete) if abscissa < FAR * blur else False
    if stable or (stable is None and abscissa < 0):
        text = f"pole {pole_text(worst)} cannot be told from the stability boundary"
        return HinfNorm(0.0, np.inf, np.nan, Status.INACCURATE, text)
    word = "unstable" if abscissa > blur else "on the stability boundary"
    return HinfNorm(np.inf, np.inf, np.nan, Status.CERTIFIED, f"pole {pole_text(worst)} is {word}")


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
        return HinfNorm(np.inf, np.inf, np.nan, Status.CERTIFIED, f"pole {word} is on the stability boundary")
    text = f"pole {word} cannot be told from the stability boundary"
    return HinfNorm(0.0, np.inf, np.nan, Status.INACCURATE, text)


def eigenvalue_blur(m: StateSpaceModel) -> float:
    """Eigenvalues are known to about eps times the norm of the balanced A: a nearer pole has no sign."""
    return 10 * EPS * max(float(np.linalg.norm(balanced(m.A), 1)), 1.0 if m.is_discrete else 0.0)


def balanced(matrix: AnyArray) -> AnyArray:
    """The matrix in the states in which its rows and columns are alike in size."""
    t = balancing_factors(matrix)
    return matrix / t[:, None] * t


def pole_text(pole: complex) -> str:
    """A pole as error messages show it."""
    return f"{pole.real:.6g}{pole.imag:+.6g}j"
