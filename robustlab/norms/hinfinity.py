r"""H-infinity and L-infinity norm as a proved bracket: AB13DD finds the peak, one Hamiltonian level test proves it.

``sigma_max(G(jw)) = g`` for some w if and only if the Hamiltonian H(g) has the eigenvalue jw. The imaginary part of
every eigenvalue counts as a candidate crossing, without a tolerance on its real part, and ``sigma_max`` is evaluated at
all of them and between each two: if none exceeds the level, it is an upper bound; else the largest is the next lower
bound, which also finds the peaks that AB13DD misses. The level is as far above the peak as rounding requires; if that
is too far, ball arithmetic decides. Boyd, Balakrishnan 1990; Bruinsma, Steinbuch 1990.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import AnyArray, Array
from robustlab.checks import number as checked_number
from robustlab.display import Facts, bracket, listed, number
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.linear_analysis import slicot
from robustlab.linear_analysis.frequency import modes_apart, solved_response
from robustlab.linear_analysis.matrices import balanced_eigenvalues, balancing_factors, lapack, refuse_extremes
from robustlab.linear_analysis.zeros import exactly_on_boundary, exactly_stable
from robustlab.norms.bilinear_map import bilinear_to_continuous
from robustlab.norms.claims import above, band_scalings, gain_in_balls, model_numbers, norm_matrix
from robustlab.result import Bracket, Status
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.verification.claim import Claim


@dataclass(frozen=True, eq=False)
class PeakGain(Bracket):
    """Bounds of the largest gain of a system; each kind of system has a class of its own with more evidence.

    ``lower`` is attained, at ``frequency`` or by a member; ``upper`` is proved, inf without proof. Both are inf where
    the system, or a member of it, is unstable.
    """

    conditions: tuple[str, ...] = field(default=(), kw_only=True)  #: Assumptions of the bounds
    notes: tuple[str, ...] = field(default=(), kw_only=True)  #: Remarks for the reader of a report

    quantities: ClassVar[Mapping[str, Any]] = {"lower": float, "upper": float}
    unstable: ClassVar[str] = "infinite: a member is unstable"  # text of infinite bounds

    def bounds(self) -> str:
        """Return both bounds in words."""
        if math.isinf(self.lower):
            return self.unstable
        if math.isinf(self.upper):
            return f"{number(self.lower)} (attained), no bound proved"
        return bracket(self.lower, self.upper, ("attained", "proved"))

    def place(self) -> str:
        """Return where ``lower`` is attained, in words; empty if unknown."""
        return number(self.frequency, "rad/s")

    def headline(self) -> str:
        if math.isinf(self.lower):
            return f"the gain is {self.unstable}" if self.unstable.startswith("infinite") else self.unstable
        proved = f"is at most {number(self.upper)}" if math.isfinite(self.upper) else "has no proved bound"
        return f"the gain {proved}; {number(self.lower)} is attained"

    def facts(self) -> Facts:
        return [
            ("largest gain", self.bounds()),
            ("attained at", self.place()),
            *self.evidence(),
            ("holds", listed(self.conditions)),
            *(("note", note) for note in self.notes),
        ]

    def evidence(self) -> Facts:
        """Return the facts of this kind of system."""
        return []


EPS = float(np.finfo(float).eps)
# Error of the eigenvalues of a Jordan block of four over that of a matrix with a basis of eigenvectors.
FAR = 1e12
# A pole within so many times the error of eigenvalues may lie on the boundary, for those of Jordan blocks.
NEXT_TO = 1e9
# Shares of the norm: rounding at the peak below the first is ignored, above the second the bracket is not certified.
QUIET, LOSSY = 1e-9, 1e-3
# Distance of a level to the peak over the rounding error of the gain.
MARGIN = 10.0
# Most levels, and frequencies next to poles at which rounding is computed besides the peak.
LEVELS, NEAR_POLES = 60, 3
# A doubtful bracket, or one wider than the first share, is proved in ball arithmetic up to so many states: 0.1 s.
WIDE, BALL_STATES = 1e-4, 40
SHARES = (1e-5, 1e-4, 5e-4, 1e-3)  # of the norm, by which levels in ball arithmetic exceed it
Band = tuple[float, float]
Infinite = Callable[[StateSpaceModel], "HinfNorm | None"]  # the bracket of an infinite norm, or None


@dataclass(frozen=True)
class HinfNorm(PeakGain):
    """H-infinity norm of a model, or its peak gain over the axis or a band, with its evidence.

    ``lower`` is ``sigma_max`` of the given model at ``frequency``; ``upper`` a level that no singular value crosses, by
    the Hamiltonian test or in ball arithmetic. Where rounding may move the gain at the peak by more than 1e-9 of it,
    both are that much further out; if the norm is zero up to rounding, ``lower`` is 0 and ``upper`` the rounding bound.
    The status is INACCURATE where rounding decides the sign of a pole or a level test.
    """

    #: Frequency in rad/s at which ``sigma_max`` attains ``lower``; ``inf`` where only the direct term does, NaN for an
    #: infinite norm without such a frequency
    frequency: float
    reason: str = ""  #: Why the norm is infinite or inaccurate; else empty
    system: StateSpaceModel | None = field(default=None, compare=False)  #: The model, for `robustlab.verify`
    #: The band in rad/s of a peak over the axis, of a model that may be unstable; None of a norm
    band: tuple[float, float] | None = field(default=None, compare=False)

    quantities: ClassVar[Mapping[str, Any]] = {"value": float, "frequency": "rad/s", "lower": float, "upper": float}
    unstable: ClassVar[str] = "infinite"
    unsaved: ClassVar[tuple[str, ...]] = ("system", "band")
    derived: ClassVar[tuple[str, ...]] = ("value",)

    @property
    def value(self) -> float:
        """The norm: ``lower``, or inf where there is no finite bound."""
        return np.inf if np.isinf(self.upper) else self.lower

    def evidence(self) -> Facts:
        return [("reason", self.reason)]


@error_context("hinf_norm")
def hinf_norm(model: Any, rtol: float = 1e-6) -> HinfNorm:
    """Compute `robustlab.peak_gain` of a model: the H-infinity norm, infinite if the model is not stable."""
    return _norm_of(as_model(model, "hinf_norm"), rtol, unstable_norm, None, "hinf_norm")


@error_context("linf_norm")
def linf_norm(model: Any, rtol: float = 1e-6, *, band: tuple[float, float] | None = None) -> HinfNorm:
    """Compute the peak gain over the frequency axis or a band of it, of a model that may be unstable."""
    given = as_model(model, "linf_norm")
    part = None if band is None else checked_band(band, given.dt, "linf_norm")
    found = _norm_of(given, rtol, partial(_on_the_boundary, part), part, "linf_norm")
    return replace(found, band=part or (0.0, np.inf))


def checked_band(band: tuple[float, float], dt: float, where: str) -> tuple[float, float]:
    """Check a band of frequencies in rad/s; its upper end may be infinite, or pi / dt of a discrete model."""
    last = np.pi / dt if dt else np.inf
    try:
        low, high = (float(omega) for omega in band)
    except (TypeError, ValueError):
        raise InputError(f"{where}: band", f"{band!r}", "two frequencies in rad/s, low and high") from None
    if not 0 <= low < high or high > last * (1 + 1e-12):
        limit = f" up to pi / dt = {last:.6g} rad/s" if dt else ""
        raise InputError(f"{where}: band", f"{low:g} to {high:g} rad/s", f"0 <= low < high{limit}")
    return low, min(high, last)


def _norm_of(m: StateSpaceModel, rtol: float, infinite: Infinite, band: Band | None, where: str) -> HinfNorm:
    checked_number(f"{where}: rtol", rtol, at_least=1e-12, below=1)
    refuse_extremes(m, where)
    found = infinite(m) if m.n_states else None
    if found is None and not (m.D.size and m.n_states):
        gain = float(np.linalg.norm(m.D, 2)) if m.D.size else 0.0
        found = HinfNorm(gain, gain, 0.0 if band is None else band[0], Status.CERTIFIED)
    if found is None:
        found = _bracket(m, rtol, band)
        # In these states 12 of 140 models with dampings down to 1e-7 in random bases are certified that else are not.
        if found.status is not Status.CERTIFIED and (apart := modes_apart(m)) is not m:
            again = _bracket(apart, rtol, band)
            if again.status is Status.CERTIFIED or again.upper - again.lower < found.upper - found.lower:
                found = again
        wide = found.status is not Status.CERTIFIED or 0 < found.lower < found.upper * (1 - max(2 * rtol, WIDE))
        if wide and infinite is unstable_norm:
            found = _in_balls(m, found, rtol)
    return replace(found, system=m)


def _bracket(m: StateSpaceModel, rtol: float, band: Band | None) -> HinfNorm:
    """Bound the norm by the level test."""
    try:
        s, rate = well_scaled(bilinear_to_continuous(m) if m.is_discrete else m)
        if band is not None:
            low, high = (_mapped(omega, m.dt) for omega in band)
            band = low / rate, high / rate
        lower, at, level, error, size, settled = _level_test(s, rtol, band)
    except (np.linalg.LinAlgError, NoTrustworthyNumber) as failed:
        return HinfNorm(0.0, np.inf, np.nan, Status.INACCURATE, f"frequency response failed: {failed}")
    # A peak is flat to rtol over sqrt(2 rtol) times its pole's distance: a floating-point number must lie in there.
    blind = np.isfinite(at) and np.sqrt(2 * rtol) * np.abs(1j * at - s.poles()).min() < EPS * at
    omega, attained = at * rate, lower
    reason = "" if settled else "the level test did not settle: digits were lost"
    if m.is_discrete:  # the bilinear map s = (2/dt) (z - 1)/(z + 1) bends the frequency axis; other scalings are exact
        omega = 2 / m.dt * float(np.arctan(omega * m.dt / 2)) if np.isfinite(omega) else np.pi / m.dt
        attained = float(largest_gains(m, np.array([omega]))[0])
        (size,), (at_peak,) = gain_rounding(m.A, m.B, m.C, m.D, np.exp(1j * np.array([omega]) * m.dt))
        size, error = float(size), max(error, float(at_peak))
        if abs(attained - lower) > 10 * rtol * lower + min(error, LOSSY * lower) and lower > level - lower:
            reason = f"the model and its continuous image differ at the peak: {attained:.9g} against {lower:.9g}"
    if blind:
        reason = f"the peak at {omega:.6g} rad/s is narrower than the spacing of floating-point numbers"
    upper = max(level, attained)
    if error > LOSSY * attained:
        upper += error
        if settled and attained <= error and upper <= QUIET * size and not blind:
            return HinfNorm(0.0, upper, omega, Status.CERTIFIED)  # rounding only
        share = error / attained if attained else np.inf
        reason = reason or f"rounding alone may move the gain at the peak by {share:.2g} of it: digits were lost"
    elif error > QUIET * attained:
        attained, upper = attained - error, upper + error
    return HinfNorm(attained, upper, omega, Status.INACCURATE if reason else Status.CERTIFIED, reason)


def _mapped(omega: float, dt: float) -> float:
    """Return the frequency of the bilinear map's continuous model."""
    return omega if not dt else 2 / dt * float(np.tan(omega * dt / 2)) if omega * dt < np.pi else np.inf


def _level_test(s: StateSpaceModel, rtol: float, band: Band | None) -> tuple[float, float, float, float, float, bool]:
    """Return the peak gain of a well-scaled model, its frequency, a level not reached, and whether it settled.

    Before the last, the rounding of the gain at the peak and next to poles, where it is worst, and the size of the
    terms that add up to the gain at the peak.
    """
    poles = s.poles()
    try:
        peak = [slicot.peak_gain(s.A, s.B, s.C, s.D)[1]]
    except NoTrustworthyNumber:
        peak = []
    low, high = band or (0.0, np.inf)
    if band is None and peak:
        omega = np.array([*peak, 0.0, np.inf])
    else:
        omega = _within(np.abs(np.concatenate([poles, poles.imag, peak])), (low, high))
    gains = largest_gains(s, omega)
    damping = np.abs(poles.real) / np.maximum(np.abs(poles), EPS)
    near = np.clip(np.abs(poles.imag[np.argsort(damping)[: 2 * NEAR_POLES : 2]]), low, high)
    lower = error = level = size = at = 0.0
    for turn in range(LEVELS):
        top = int(np.argmax(gains))
        if turn and gains[top] <= level:
            return lower, at, level, error, size, True
        lower, at = float(gains[top]), float(omega[top])
        sizes, errors = gain_rounding(s.A, s.B, s.C, s.D, np.array([complex(0.0, w) for w in (at, *near)]))
        size, error, near = float(sizes[0]), max(error, float(errors.max())), near[:0]
        margin = MARGIN if lower > error else 2.0  # a gain of rounding size has no peak
        level = lower + max(rtol * lower, margin * error)
        if level == 0:
            return 0.0, at, 0.0, 0.0, size, True
        omega = crossings(s, level, band)
        gains = largest_gains(s, omega)
    return lower, at, level, error, size, False


def _in_balls(m: StateSpaceModel, found: HinfNorm, rtol: float) -> HinfNorm:
    """Return the norm if ball arithmetic proves a level just above the gain at the peak; else ``found``."""
    if m.n_states > BALL_STATES or not np.isfinite(found.upper) or not np.isfinite(found.frequency):
        return found
    gain = gain_in_balls(m, found.frequency)
    shares = [rtol, *(s for s in SHARES if s > rtol and (1 + s) * gain < found.upper)] if gain else []
    for share in shares if found.status is Status.CERTIFIED else shares[:1]:
        if norm_matrix(m, (1 + share) * gain, gain):
            return HinfNorm(gain, (1 + share) * gain, found.frequency, Status.CERTIFIED)
    return found


def gain_rounding(
    A: AnyArray, B: AnyArray, C: AnyArray, D: AnyArray, s: AnyArray, sums: Sequence[Array] | None = None
) -> tuple[AnyArray, AnyArray]:
    r"""Return ``|C| |X| + |D|``, ``X = F^{-1} B``, ``F = sI - A``, and the rounding error of ``sigma_max``, at each s.

    The error is of first order; s may be infinite. A backward stable solution is off by no more than
    ``n eps |F^{-1}| (|F| |X| + |B|)``, entry by entry; no scaling of the states changes that. ``sums``: sizes of the
    terms added up to A, B, C and D, if these cancelled; by default those of A, B, C and D.
    """
    in_a, in_b, in_c, in_d = [np.abs(m) for m in (A, B, C, D)] if sums is None else sums
    n, finite = len(A), np.isfinite(s)
    size, error = (np.repeat(x[None], len(s), axis=0) for x in (np.abs(D), in_d))
    if n and finite.any():
        point = s[finite, None, None]
        inverse = np.linalg.inv(point * np.eye(n) - A)
        X, out = np.abs(inverse @ B), np.abs(C)
        size[finite] += out @ X
        error[finite] += in_c @ X + out @ (np.abs(inverse) @ (in_a @ X + np.abs(point) * X + in_b))
    whole = (np.sqrt((x * x).sum(axis=(1, 2))) for x in (size, error))
    return next(whole), max(n, 1) * EPS * next(whole)


# --- infinite norms --------------------------------------------------------------------------------------------------


def unstable_norm(m: StateSpaceModel) -> HinfNorm | None:
    """Return the infinite norm of a model that is not stable, or None."""
    abscissa = m.spectral_abscissa()
    # Balancing does not increase the sum of all entries: with enough distance it is not needed.
    if abscissa < -10 * EPS * max(float(np.abs(m.A).sum()), 1.0 if m.is_discrete else 0.0):
        return None
    blur = eigenvalue_blur(m)
    if abscissa < -blur:
        return None
    poles = m.poles()
    worst = complex(poles[np.argmax(np.abs(poles) if m.is_discrete else poles.real)])
    # Eigenvalues of Jordan blocks have far fewer digits; well outside there is no doubt.
    stable = exactly_stable(m.A, m.is_discrete) if abscissa < FAR * blur else False
    if stable or (stable is None and abscissa < 0):
        return _infinite(worst, False)
    word = "unstable" if abscissa > blur else "on the stability boundary"
    return HinfNorm(np.inf, np.inf, np.nan, Status.CERTIFIED, f"pole {pole_text(worst)} is {word}")


def _on_the_boundary(band: Band | None, m: StateSpaceModel) -> HinfNorm | None:
    """Return the infinite norm of a model with a pole on the stability boundary (in the band if given), or None."""
    poles, blur = m.poles(), eigenvalue_blur(m)
    distance = np.abs(np.abs(poles) - 1 if m.is_discrete else poles.real)
    inside = np.ones(len(poles), dtype=bool)
    if band is not None:
        at = np.abs(np.angle(poles) if m.is_discrete else poles.imag)
        low, high = (omega * m.dt if m.is_discrete else omega for omega in band)
        inside = (at >= low - blur) & (at <= high + blur)
    # Eigenvalues of Jordan blocks have far fewer digits; well away there is no doubt.
    if not (inside & (distance <= FAR * blur)).any():
        return None
    nearest = int(np.where(inside, distance, np.inf).argmin())
    # Exact arithmetic decides whether a pole lies on the boundary, not which: it may be none outside the band.
    outside = ~inside & (distance <= NEXT_TO * blur)
    certain = bool(not outside.any() and exactly_on_boundary(m.A, m.is_discrete))
    return _infinite(complex(poles[nearest]), certain) if certain or distance[nearest] <= blur else None


def _infinite(pole: complex, certain: bool) -> HinfNorm:
    """Return the norm of a model with a pole on the boundary, or one indistinguishable from it."""
    word, lower = ("is on", np.inf) if certain else ("cannot be distinguished from", 0.0)
    status = Status.CERTIFIED if certain else Status.INACCURATE
    return HinfNorm(lower, np.inf, np.nan, status, f"pole {pole_text(pole)} {word} the stability boundary")


def eigenvalue_blur(m: StateSpaceModel) -> float:
    """Return the error of eigenvalues, about eps times the norm of the balanced A: a nearer pole has no sign."""
    t = balancing_factors(m.A)
    return 10 * EPS * max(float(np.linalg.norm(m.A / t[:, None] * t, 1)), 1.0 if m.is_discrete else 0.0)


def pole_text(pole: complex) -> str:
    return f"{pole.real:.6g}{pole.imag:+.6g}j"


# --- gains and crossings ---------------------------------------------------------------------------------------------


def well_scaled(m: StateSpaceModel) -> tuple[StateSpaceModel, float]:
    """Return the model in the time unit 1/rate, with states balanced against inputs and outputs (Osborne), exactly."""
    t, rate = balancing_units(m)
    root = 2.0 ** (np.frexp(rate)[1] // 2)
    a, b, c = m.A / (rate * t[:, None]) * t, m.B / ((rate / root) * t[:, None]), m.C * (t / root)
    return m._in_states(a, b, c, rate=rate), rate


def balancing_units(m: StateSpaceModel) -> tuple[Array, float]:
    """Return ``t`` (n,) and ``rate`` of `well_scaled`, powers of two: its states are ``sqrt(rate) x / t``."""
    size = np.sort(np.abs(m._poles))
    size = size[size > 1e-12 * size[-1]]
    rate = float(2.0 ** np.round(np.log2(size[len(size) // 2]))) if size.size else 1.0  # nothing but integrators
    rows, columns = (np.sqrt(np.einsum("ij,ij->i", x, x) / rate) for x in (m.B, m.C.T))
    level = np.sqrt((rows @ rows) / (columns @ columns)) if rows.any() and columns.any() else 1.0
    n = m.n_states
    bordered = np.zeros((n + 1, n + 1), order="F")  # B and C, of one weight, as column and row of one more state
    bordered[:n, :n], bordered[:n, n], bordered[n, :n] = m.A / rate, rows, level * columns
    scale = lapack().dgebal(bordered, scale=1, overwrite_a=1)[3]
    return scale[:n] / scale[n], rate


def largest_gains(m: StateSpaceModel, omega: AnyArray) -> AnyArray:
    """Compute ``sigma_max`` at each frequency, shape (n_omega,)."""
    response = solved_response(m, omega)
    if not np.isfinite(response).all():
        raise NoTrustworthyNumber("hinf_norm", "the frequency response overflows")
    if min(m.n_inputs, m.n_outputs) == 1:
        return np.sqrt((np.abs(response) ** 2).sum(axis=(1, 2)))
    return np.linalg.svd(response, compute_uv=False)[:, 0]


def crossings(m: StateSpaceModel, level: float, band: Band | None = None) -> AnyArray:
    """Return imaginary parts of all eigenvalues of the Hamiltonian at this level, and points between and beyond them.

    Of a band, those inside, its ends, and points between them. The gain crosses the level at such points only.
    """
    n, root = m.n_states, np.sqrt(level)
    b, c, d = m.B / root, m.C / root, m.D / level
    hamiltonian = np.empty((2 * n, 2 * n))
    if d.any():
        r, s = np.eye(m.n_inputs) - d.T @ d, np.eye(m.n_outputs) - d @ d.T
        solved = np.linalg.solve(r, np.hstack([d.T @ c, b.T]))
        a, into, out = m.A + b @ solved[:, :n], b @ solved[:, n:], c.T @ np.linalg.solve(s, c)
    else:
        a, into, out = m.A, b @ b.T, c.T @ c
    hamiltonian[:n, :n], hamiltonian[:n, n:], hamiltonian[n:, :n], hamiltonian[n:, n:] = a, into, -out, -a.T
    eigenvalues = balanced_eigenvalues(hamiltonian)
    if eigenvalues is None:
        raise NoTrustworthyNumber("hinf_norm", "the Hamiltonian overflows")
    crossing = np.unique(np.append(np.abs(np.imag(eigenvalues)), 0.0))
    if band is not None:
        crossing = _within(crossing, band)
    crossing = crossing[np.isfinite(crossing)]
    beyond = crossing[-1] * np.array([2.0, 10.0] if band is None or np.isinf(band[1]) else [])
    return np.concatenate([crossing, 0.5 * (crossing[:-1] + crossing[1:]), beyond])


def _within(omega: AnyArray, band: Band) -> AnyArray:
    """Return the frequencies inside a band, and its ends, in order."""
    return np.unique(np.append(omega[(omega > band[0]) & (omega < band[1])], band))


def norm_claims(found: HinfNorm) -> list[Claim]:
    model = found.system
    if model is None or not np.isfinite(found.upper) or found.status is not Status.CERTIFIED:
        return []
    level, numbers = above(found.upper), model_numbers(model)
    if found.band is None:
        return [Claim("norm", {**numbers, "gamma": np.array(level), **norm_matrix(model, level, found.upper)})]
    scalings = band_scalings(model.n_inputs, model.n_outputs, found.band)
    return [Claim("mu-axis", {**numbers, "level": np.array(level), **scalings})]
