"""H-infinity norm as a proved bracket."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.exact_stability import exactly_stable
from robustlab.frequency import frequency_response
from robustlab.magnitude import Moderated, balancing_factors, moderated
from robustlab.norms.bilinear_map import bilinear_to_continuous
from robustlab.result import Status
from robustlab.shown import Facts, Shown, bracket, number
from robustlab.statespace import StateSpaceModel, as_model

__all__ = [
    "FAR",
    "QUIET",
    "HinfNorm",
    "NormTuning",
    "axis_grid",
    "axis_point",
    "balanced",
    "bracketed_norm",
    "eigenvalue_blur",
    "gain_rounding",
    "hinf_norm",
    "norm_as_given",
    "pole_text",
    "unstable_norm",
    "well_scaled",
]

EPS = float(np.finfo(float).eps)
# Eigenvalues of a Jordan block of four may be off by this many times those of a matrix with a basis of eigenvectors.
FAR = 1e12

# Shares of the norm: rounding at the peak below the first is not told, above the second the bracket is not certified,
# unless the norm with its rounding is below the first share of the terms that cancel in it: zero for every purpose.
QUIET, LOUD = 1e-9, 1e-3


@dataclass(frozen=True)
class NormTuning:
    """How hard the H-infinity norm is looked for; what is proved does not depend on it."""

    # Levels before the bracket is given up as INACCURATE: most models need two or three.
    levels: int = 60
    # First grid, per decade between the poles: more find the highest peak at once, fewer leave it to the level test.
    points_per_decade: int = 20
    # Peaks that a zoom looks at, its steps and the points of each: a bracket shrinks by a factor of 6 in a step.
    zoom_peaks: int = 6
    zoom_steps: int = 8
    zoom_points: int = 13
    # A bracket is left where the fall from its top to the points beside it, times the first, is below the second.
    zoom_rise: float = 4.0
    zoom_flat: float = 1e-9
    # Frequencies at which a model without any gain is looked at, besides those of its poles.
    nothing_points: int = 200


TUNING = NormTuning()


@dataclass(frozen=True)
class HinfNorm(Shown):
    """H-infinity norm of a model with its evidence.

    Attributes
    ----------
    value
        The norm; equal to ``lower``.
    frequency
        Frequency in rad/s at which ``sigma_max`` attains ``lower``; ``inf`` where only the direct term does, NaN for an
        infinite norm without such a frequency.
    lower
        ``sigma_max`` of the given model at ``frequency``, evaluated.
    upper
        Level that no singular value crosses, by the Hamiltonian test; ``lower <= norm <= upper``. Where rounding may
        move the gain at the peak by more than 1e-9 of it, both ends are that much further out. A norm that is zero but
        for rounding has zero and the bound of that rounding as its ends.
    status
        CERTIFIED, or INACCURATE where rounding leaves the sign of a pole or a level test open.
    reason
        Why the norm is infinite or inaccurate; else empty.
    """

    value: float
    frequency: float
    lower: float
    upper: float
    status: Status
    reason: str = ""

    def facts(self) -> Facts:
        """What a person wants to read, as (label, text)."""
        return [
            ("norm", bracket(self.lower, self.upper, ("attained", "proved"))),
            ("at", number(self.frequency, "rad/s")),
            ("reason", self.reason),
        ]

    def to_json(self) -> dict[str, object]:
        """All fields."""
        return vars(self).copy()


# --- H-infinity ------------------------------------------------------------------------------------------------------


@told_as("hinf_norm")
def hinf_norm(model: Any, rtol: float = 1e-6, *, tuning: NormTuning = TUNING) -> HinfNorm:
    r"""H-infinity norm as a bracket: a frequency attains ``lower``, no frequency exceeds ``upper``.

    .. math:: \|G\|_\infty = \sup_\omega \sigma_{max}(G(j\omega)) \qquad (G(e^{j\omega dt}) \text{ for } dt > 0)

    Level-set method on the Hamiltonian: ``sigma_max(G(jw)) = g`` for some w iff H(g) has the eigenvalue jw. The
    imaginary part of *every* eigenvalue of H(g) counts as a candidate crossing, without a tolerance on its real part,
    and ``sigma_max`` is evaluated at all of them and between each two; the level is an upper bound where none of these
    exceeds it. A zoom on the highest peaks looks for what rounding may have hidden.

    Parameters
    ----------
    model
        Model with any numbers of states, inputs and outputs, including zero; or a python-control object.
    rtol
        Relative width of the bracket.
    tuning
        How hard it is looked for.

    Returns
    -------
    HinfNorm
        Infinite for a model that is unstable or has poles on the stability boundary, reachable or not.

    Raises
    ------
    InputError
        No model, or an ``rtol`` that is not between 1e-12 and 1.
    NoTrustworthyNumber
        The norm is larger than the largest floating-point number.

    References
    ----------
    Boyd, Balakrishnan 1990; Bruinsma, Steinbuch 1990.

    Examples
    --------
    >>> lag = StateSpaceModel([[-2.0]], [[1.0]], [[6.0]], [[0.0]])
    >>> norm = hinf_norm(lag)
    >>> norm.value, norm.frequency, norm.status.value
    (3.0, 0.0, 'certified')
    """
    given = as_model(model, "hinf_norm")
    if not 1e-12 <= rtol < 1:
        raise InputError("hinf_norm", f"rtol is {rtol}", "between 1e-12 and 1")
    ordinary = moderated(given, "hinf_norm")
    return norm_as_given(bracketed_norm(ordinary, rtol, tuning, unstable_norm), ordinary)


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
    value = np.inf if np.isinf(norm.value) else lower
    return HinfNorm(value, ordinary.frequency(norm.frequency), lower, upper, norm.status, norm.reason)


def bracketed_norm(
    ordinary: Moderated,
    rtol: float,
    tuning: NormTuning,
    infinite: Callable[[StateSpaceModel, int], HinfNorm | None],
) -> HinfNorm:
    """The norm of the model with ordinary entries; only ``reason`` speaks in the units of the model as given.

    The level test needs no stability: ``infinite`` says which poles make the norm infinite.
    """
    m = ordinary.model
    if not m.n_inputs or not m.n_outputs:
        return (infinite(m, ordinary.rate) if m.n_states else None) or HinfNorm(0.0, 0.0, 0.0, 0.0, Status.CERTIFIED)
    if not m.n_states:
        gain = float(np.linalg.norm(m.D, 2))
        return HinfNorm(gain, 0.0, gain, gain, Status.CERTIFIED)
    without_bracket = infinite(m, ordinary.rate)
    if without_bracket is not None:
        return without_bracket
    try:
        scaled, rate = well_scaled(bilinear_to_continuous(m) if m.is_discrete else m)
        lower, omega, upper, trusted = _bracket(scaled, rtol, tuning)
    except (np.linalg.LinAlgError, NoTrustworthyNumber) as error:
        return HinfNorm(np.inf, np.nan, 0.0, np.inf, Status.INACCURATE, f"frequency response failed: {error}")
    # A peak is flat to rtol over sqrt(2 rtol) times its pole's distance: a representable frequency must lie in there.
    blind = np.isfinite(omega) and np.sqrt(2 * rtol) * np.abs(1j * omega - scaled.poles()).min() < EPS * omega
    omega *= rate
    if m.is_discrete:  # the bilinear map s = (2/dt) (z - 1)/(z + 1) bends the frequency axis
        omega = 2 / m.dt * float(np.arctan(omega * m.dt / 2)) if np.isfinite(omega) else np.pi / m.dt
    attained = float(_sigma(m, np.array([omega]))[0])
    reason = "" if trusted else "the level test and a direct search disagreed; digits were lost"
    if abs(attained - lower) > 10 * rtol * lower and lower > upper - lower:
        trusted = False
        reason = f"scaled and original realisation differ at the peak: {lower:.9g} against {attained:.9g}"
    if blind:
        at = f"{ordinary.frequency(omega):.6g} rad/s"
        trusted, reason = False, f"the peak at {at} is narrower than the spacing of floating-point numbers"
    lower, upper = attained, max(upper, attained)
    error = gain_rounding(m.A, m.B, m.C, m.D, axis_point(m, omega))
    if error > LOUD * attained:
        upper += error
        nothing = None if blind else _nothing(m, scaled, tuning.nothing_points)
        if nothing is not None:
            return nothing
        share = error / attained if attained else np.inf
        trusted, reason = False, f"rounding alone may move the gain at the peak by {share:.2g} of it: digits were lost"
    elif error > QUIET * attained:
        lower, upper = attained - error, upper + error
    return HinfNorm(lower, omega, lower, upper, Status.CERTIFIED if trusted else Status.INACCURATE, reason)


def axis_point(m: StateSpaceModel, omega: float) -> complex:
    """The point s or z of a frequency."""
    if m.is_discrete:
        return complex(np.exp(1j * omega * m.dt))
    return 1j * omega if np.isfinite(omega) else complex(np.inf)


def gain_rounding(A: AnyArray, B: AnyArray, C: AnyArray, D: AnyArray, s: complex) -> float:
    r"""Bound of the rounding error of ``sigma_max(C (sI - A)^{-1} B + D)``, to first order; s may be infinite.

    With ``F = sI - A`` and ``X = F^{-1} B`` a backward stable solution is off by no more than
    ``n eps |F^{-1}| (|F| |X| + |B|)``, entry by entry; no scaling of the states changes that.
    """
    return _terms(A, B, C, D, s)[1]


def _terms(A: AnyArray, B: AnyArray, C: AnyArray, D: AnyArray, s: complex) -> tuple[float, float]:
    """Size of what is added up to the gain at s, ``|C| |X| + |D|``, and `gain_rounding`."""
    n, size = len(A), np.abs(D)
    error = size
    if n and np.isfinite(s):
        inverse = np.linalg.inv(s * np.eye(n) - A)
        X, terms = np.abs(inverse @ B), np.abs(A) + abs(s) * np.eye(n)
        size = size + np.abs(C) @ X
        error = size + np.abs(C) @ np.abs(inverse) @ (terms @ X + np.abs(B))
    return float(np.linalg.norm(size)), max(n, 1) * EPS * float(np.linalg.norm(error))


def _nothing(m: StateSpaceModel, scaled: StateSpaceModel, points: int) -> HinfNorm | None:
    """The norm of a model without any gain but rounding; None where it is not shown to be one.

    Nowhere may the gain, its rounding included, be more than next to nothing of the terms that cancel in it. No level
    test is sharper than that, but at the bound of the rounding it must agree.
    """
    omega = axis_grid(m, points)
    try:
        sigma = _sigma(m, omega)
        size, error = np.array([_terms(m.A, m.B, m.C, m.D, axis_point(m, w)) for w in omega]).T
        upper = float((sigma + error).max())
        if not (sigma.max() <= error.max() and upper <= QUIET * size.max()):
            return None
        again = np.concatenate([axis_grid(scaled, points), _candidates(scaled, upper)])
        if not _sigma(scaled, again).max() <= upper:
            return None
    except (np.linalg.LinAlgError, NoTrustworthyNumber):
        return None
    return HinfNorm(0.0, float(omega[np.argmax(sigma)]), 0.0, upper, Status.CERTIFIED)


def unstable_norm(m: StateSpaceModel, rate: int = 0) -> HinfNorm | None:
    """The infinite norm of a model that is not stable, or None; poles are told times ``2^rate``."""
    abscissa = m.spectral_abscissa()
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
        return HinfNorm(np.inf, np.nan, 0.0, np.inf, Status.INACCURATE, text)
    word = "unstable" if abscissa > blur else "on the stability boundary"
    return HinfNorm(np.inf, np.nan, np.inf, np.inf, Status.CERTIFIED, f"pole {pole_text(worst)} is {word}")


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


def well_scaled(m: StateSpaceModel) -> tuple[StateSpaceModel, float]:
    """The same transfer function in the time unit 1/rate, with states balanced against inputs and outputs (Osborne)."""
    size = np.abs(m.poles())
    size = size[size > 1e-12 * size.max()]
    rate = float(2.0 ** np.round(np.log2(np.median(size))))
    a, b, c = m.A / rate, m.B / np.sqrt(rate), m.C / np.sqrt(rate)
    level = np.linalg.norm(b) / np.linalg.norm(c) if b.any() and c.any() else 1.0
    n, t = m.n_states, np.ones(m.n_states)
    c = c * level  # only for the balancing: B and C weigh the same
    for _ in range(20):
        row = np.sqrt((a**2).sum(1) - np.diag(a) ** 2 + (b**2).sum(1) + 1e-300)
        column = np.sqrt((a**2).sum(0) - np.diag(a) ** 2 + (c**2).sum(0) + 1e-300)
        factor = 2.0 ** np.clip(np.round(0.5 * np.log2(row / column)), -40, 40)
        if n == 0 or (factor == 1).all():
            break
        # One state at a time would be Osborne's order; damped simultaneous steps need no Python loop over states.
        factor = np.where(np.abs(np.log2(factor)) > 1, 2.0 ** np.round(0.5 * np.log2(factor)), factor)
        a, b, c, t = a / factor[:, None] * factor, b / factor[:, None], c * factor, t * factor
    return StateSpaceModel(a, b, c / level, m.D), rate


def _sigma(m: StateSpaceModel, omega: AnyArray) -> AnyArray:
    """``sigma_max`` at each frequency, shape (n_omega,)."""
    response = frequency_response(m, omega)
    if not np.isfinite(response).all():
        raise NoTrustworthyNumber("hinf_norm", "the frequency response overflows")
    if min(m.n_inputs, m.n_outputs) == 1:
        return np.sqrt((np.abs(response) ** 2).sum(axis=(1, 2)))
    return np.linalg.svd(response, compute_uv=False)[:, 0]


def axis_grid(m: StateSpaceModel, points: int) -> AnyArray:
    """Zero, infinity, the poles' frequencies and resonances, and a logarithmic grid around them."""
    poles = m.poles()
    if m.is_discrete:
        poles = np.log(poles[np.abs(poles) > 1e-12]) / m.dt
    size = np.abs(poles)
    size = size[size > 0]
    low, high = (size.min() / 10, size.max() * 10) if len(size) else (1e-1, 1e1)
    resonance = np.sqrt(np.maximum(poles.imag**2 - poles.real**2, 0.0))
    omega = np.concatenate([[0.0], np.abs(poles), np.abs(poles.imag), resonance, np.geomspace(low, high, points)])
    if m.is_discrete:
        return np.unique(np.append(omega[omega < np.pi / m.dt], np.pi / m.dt))
    return np.append(np.unique(omega), np.inf)


def _bracket(m: StateSpaceModel, rtol: float, tuning: NormTuning) -> tuple[float, float, float, bool]:
    """``(lower, frequency, upper, trusted)`` for a stable continuous model that is well scaled."""
    size = np.abs(m.poles())
    decades = 2 + np.log10(size.max() / max(size.min(), 1e-15 * size.max()))
    omega = axis_grid(m, int(tuning.points_per_decade * decades))
    sigma = _sigma(m, omega)
    peak = int(np.argmax(sigma))
    lower, at = float(sigma[peak]), float(omega[peak])
    # What rounding in C (jw I - A)^-1 B alone can produce: a norm below it cannot be told from zero.
    states = StateSpaceModel(m.A, m.B, np.eye(m.n_states), np.zeros((m.n_states, m.n_inputs)))
    floor = (
        4 * EPS * (float(np.linalg.norm(m.C, 2)) * float(_sigma(states, omega).max()) + float(np.linalg.norm(m.D, 2)))
    )
    if floor == 0:
        return 0.0, 0.0, 0.0, True
    trusted, upper = True, np.inf
    for _ in range(tuning.levels):
        upper = lower * (1 + rtol) + floor
        new_omega = _candidates(m, upper)
        new_sigma = _sigma(m, new_omega)
        omega, sigma = np.concatenate([omega, new_omega]), np.concatenate([sigma, new_sigma])
        peak = int(np.argmax(new_sigma))
        if new_sigma[peak] > upper:
            lower, at = float(new_sigma[peak]), float(new_omega[peak])
            continue
        zoomed, zoomed_at = _zoom(m, omega, sigma, tuning)
        if zoomed <= upper:
            if zoomed > lower:
                lower, at = zoomed, zoomed_at
            return lower, at, upper, trusted
        # The level was "proved", yet a frequency exceeds it: rounding moved an eigenvalue. Go on from there, but say
        # so.
        lower, at = zoomed, zoomed_at
        trusted = False
    return lower, at, upper, False


def _candidates(m: StateSpaceModel, level: float) -> AnyArray:
    """Imaginary parts of all eigenvalues of the Hamiltonian at this level, and points between and beyond them."""
    root = np.sqrt(level)
    b, c, d = m.B / root, m.C / root, m.D / level
    r = np.eye(m.n_inputs) - d.T @ d
    s = np.eye(m.n_outputs) - d @ d.T
    a1 = m.A + b @ np.linalg.solve(r, d.T @ c)
    hamiltonian = np.block([[a1, b @ np.linalg.solve(r, b.T)], [-c.T @ np.linalg.solve(s, c), -a1.T]])
    if not np.isfinite(hamiltonian).all():
        raise NoTrustworthyNumber("hinf_norm", "the Hamiltonian overflows")
    crossing = np.unique(np.concatenate([[0.0], np.abs(np.linalg.eigvals(balanced(hamiltonian)).imag)]))
    between = 0.5 * (crossing[:-1] + crossing[1:])
    beyond = [2 * crossing[-1], 10 * crossing[-1]]
    return np.concatenate([crossing, between, beyond])


def _zoom(m: StateSpaceModel, omega: AnyArray, sigma: AnyArray, tuning: NormTuning) -> tuple[float, float]:
    """Highest value near the highest local maxima of the points known so far, and its frequency."""
    order = np.argsort(omega, kind="stable")
    omega, sigma = omega[order], sigma[order]
    omega, first = np.unique(omega, return_index=True)
    sigma = sigma[first]
    best, at = float(sigma.max()), float(omega[np.argmax(sigma)])
    left, right = np.append(-np.inf, sigma[:-1]), np.append(sigma[1:], -np.inf)
    peaks = np.flatnonzero((sigma >= left) & (sigma >= right) & np.isfinite(omega) & (sigma >= 0.9 * best))
    peaks = peaks[np.argsort(-sigma[peaks])][: tuning.zoom_peaks]
    if not len(peaks):
        return best, at
    low, high = omega[np.maximum(peaks - 1, 0)], omega[np.minimum(peaks + 1, len(omega) - 1)]
    high = np.where(np.isfinite(high), high, 10 * omega[peaks] + 1)
    share = np.linspace(0, 1, tuning.zoom_points)
    for _ in range(tuning.zoom_steps):
        points = low[:, None] + (high - low)[:, None] * share
        values = _sigma(m, points.ravel()).reshape(points.shape)
        top = values.argmax(axis=1)
        rows = np.arange(len(points))
        k = int(values[rows, top].argmax())
        if values[k, top[k]] > best:
            best, at = float(values[k, top[k]]), float(points[k, top[k]])
        before, after = np.maximum(top - 1, 0), np.minimum(top + 1, tuning.zoom_points - 1)
        low, high = points[rows, before], points[rows, after]
        # Between the points next to the top of a smooth peak nothing rises by more than it fell towards them.
        rise = values[rows, top] - np.minimum(values[rows, before], values[rows, after])
        open_ = values[rows, top] + tuning.zoom_rise * rise > best * (1 + tuning.zoom_flat)
        if not open_.any():
            break
        low, high = low[open_], high[open_]
    return best, at
