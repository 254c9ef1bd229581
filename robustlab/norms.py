"""System norms: H-infinity as a proved bracket, H2 by both Gramians."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.exact_stability import exactly_stable
from robustlab.level_set import TUNING, NormTuning, crossings, largest_gains, level_bracket, search_grid, well_scaled
from robustlab.magnitude import Moderated, balancing_factors, moderated, refuse_overflow
from robustlab.matrix_equations import gramians
from robustlab.result import Status
from robustlab.shown import Facts, Shown, bracket, number
from robustlab.statespace import StateSpaceModel, as_model

__all__ = [
    "QUIET",
    "H2Norm",
    "HinfNorm",
    "bilinear_to_continuous",
    "bilinear_to_discrete",
    "gain_rounding",
    "h2_norm",
    "hinf_norm",
    "norm_as_given",
]

EPS = float(np.finfo(float).eps)
# Eigenvalues of a Jordan block of four may be off by this many times those of a matrix with a basis of eigenvectors.
FAR = 1e12

# Poles in z beyond this all become s = 2/dt to the last digit.
OUTSIDE = 1e15
# Shares of the norm: rounding at the peak below the first is not told, above the second the bracket is not certified,
# unless the norm with its rounding is below the first share of the terms that cancel in it: zero for every purpose.
QUIET, LOUD = 1e-9, 1e-3


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


@dataclass(frozen=True)
class H2Norm(Shown):
    """H2 norm of a model: value, status, and why it is infinite or inaccurate."""

    value: float
    status: Status
    reason: str = ""

    def facts(self) -> Facts:
        """What a person wants to read, as (label, text)."""
        return [("norm", number(self.value, digits=6)), ("reason", self.reason)]

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
    exceeds it. A zoom on the highest peaks looks for what rounding may have hidden. Values come from the model's modes
    where a bound of their error shows that this is enough (`ModalResponse`); what is told is solved for with A.

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
    return norm_as_given(_bracketed(ordinary, rtol, tuning), ordinary)


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


def _bracketed(ordinary: Moderated, rtol: float, tuning: NormTuning) -> HinfNorm:
    """The norm of the model with ordinary entries; only ``reason`` speaks in the units of the model as given."""
    m = ordinary.model
    if not m.n_inputs or not m.n_outputs:
        return (_unstable(m) if m.n_states else None) or HinfNorm(0.0, 0.0, 0.0, 0.0, Status.CERTIFIED)
    if not m.n_states:
        gain = float(np.linalg.norm(m.D, 2))
        return HinfNorm(gain, 0.0, gain, gain, Status.CERTIFIED)
    unstable = _unstable(m, ordinary.rate)
    if unstable is not None:
        return unstable
    try:
        scaled, rate = well_scaled(bilinear_to_continuous(m) if m.is_discrete else m)
        lower, omega, upper, trusted = level_bracket(scaled, rtol, tuning)
    except (np.linalg.LinAlgError, NoTrustworthyNumber) as error:
        return HinfNorm(np.inf, np.nan, 0.0, np.inf, Status.INACCURATE, f"frequency response failed: {error}")
    # A peak is flat to rtol over sqrt(2 rtol) times its pole's distance: a representable frequency must lie in there.
    blind = np.isfinite(omega) and np.sqrt(2 * rtol) * np.abs(1j * omega - scaled.poles()).min() < EPS * omega
    omega *= rate
    if m.is_discrete:  # the bilinear map s = (2/dt) (z - 1)/(z + 1) bends the frequency axis
        omega = 2 / m.dt * float(np.arctan(omega * m.dt / 2)) if np.isfinite(omega) else np.pi / m.dt
    attained = float(largest_gains(m, np.array([omega]))[0])
    reason = "" if trusted else "the level test and a direct search disagreed; digits were lost"
    if abs(attained - lower) > 10 * rtol * lower and lower > upper - lower:
        trusted = False
        reason = f"scaled and original realisation differ at the peak: {lower:.9g} against {attained:.9g}"
    if blind:
        at = f"{ordinary.frequency(omega):.6g} rad/s"
        trusted, reason = False, f"the peak at {at} is narrower than the spacing of floating-point numbers"
    lower, upper = attained, max(upper, attained)
    error = gain_rounding(m.A, m.B, m.C, m.D, _point(m, omega))
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


def _point(m: StateSpaceModel, omega: float) -> complex:
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
    omega = search_grid(m, points)
    try:
        sigma = largest_gains(m, omega)
        size, error = np.array([_terms(m.A, m.B, m.C, m.D, _point(m, w)) for w in omega]).T
        upper = float((sigma + error).max())
        if not (sigma.max() <= error.max() and upper <= QUIET * size.max()):
            return None
        again = np.concatenate([search_grid(scaled, points), crossings(scaled, upper)])
        if not largest_gains(scaled, again).max() <= upper:
            return None
    except (np.linalg.LinAlgError, NoTrustworthyNumber):
        return None
    return HinfNorm(0.0, float(omega[np.argmax(sigma)]), 0.0, upper, Status.CERTIFIED)


def _unstable(m: StateSpaceModel, rate: int = 0) -> HinfNorm | None:
    """The infinite norm of a model that is not stable, or None; poles are told times ``2^rate``."""
    abscissa = m.spectral_abscissa()
    # Eigenvalues are known to about eps times the norm of the balanced A; a pole closer to the boundary has no sign.
    least = 1.0 if m.is_discrete else 0.0
    if abscissa < -10 * EPS * max(float(np.abs(m.A).sum()), least):  # balancing does not make the sum larger
        return None
    blur = 10 * EPS * max(float(np.linalg.norm(_balanced(m.A), 1)), least)
    if abscissa < -blur:
        return None
    poles = m.poles()
    worst = poles[np.argmax(np.abs(poles) if m.is_discrete else poles.real)]
    if not m.is_discrete:
        worst = complex(np.ldexp(worst.real, rate), np.ldexp(worst.imag, rate))
    # Eigenvalues of Jordan blocks are known to far fewer digits; well outside there is no doubt.
    stable = exactly_stable(m.A, m.is_discrete) if abscissa < FAR * blur else False
    if stable or (stable is None and abscissa < 0):
        text = f"pole {_text(worst)} cannot be told from the stability boundary"
        return HinfNorm(np.inf, np.nan, 0.0, np.inf, Status.INACCURATE, text)
    word = "unstable" if abscissa > blur else "on the stability boundary"
    return HinfNorm(np.inf, np.nan, np.inf, np.inf, Status.CERTIFIED, f"pole {_text(worst)} is {word}")


def _balanced(matrix: AnyArray) -> AnyArray:
    t = balancing_factors(matrix)
    return matrix / t[:, None] * t


def _text(pole: complex) -> str:
    return f"{pole.real:.6g}{pole.imag:+.6g}j"


# --- H2 --------------------------------------------------------------------------------------------------------------


@told_as("h2_norm")
def h2_norm(model: Any) -> H2Norm:
    r"""H2 norm from both Gramians, which must agree.

    .. math:: \|G\|_2^2 = \mathrm{tr}(C P C^T) = \mathrm{tr}(B^T Q B), \quad A P + P A^T + B B^T = 0, \quad A^T Q + Q A
    + C^T C = 0

    and, discrete, :math:`\|G\|_2^2 = \mathrm{tr}(C P C^T + D D^T)` with ``A P A^T - P + B B^T = 0``.
    Infinite for an unstable model, and for a continuous one with D != 0.
    INACCURATE where the two Gramians differ by more than 1e-6.
    """
    ordinary = moderated(as_model(model, "h2_norm"), "h2_norm")
    m = ordinary.model
    outside = _unstable(m, ordinary.rate) if m.n_states else None
    if outside is not None and (outside.status is Status.CERTIFIED or not m.is_stable()):
        return H2Norm(np.inf, outside.status, outside.reason)
    if not m.is_discrete and m.D.any():
        return H2Norm(np.inf, Status.CERTIFIED, "the model has a direct term")
    if not m.n_states:
        return H2Norm(ordinary.value(float(np.linalg.norm(m.D)), "h2_norm"), Status.CERTIFIED)
    # In the time unit 1/rate the impulse response keeps its square integral divided by rate.
    s, rate = (m, 1.0) if m.is_discrete else well_scaled(m)
    found = _by_gramians(ordinary, s, rate)
    if found.status is not Status.CONVERGED:
        # States that weigh inputs and outputs alike may make A lopsided, whose Schur form then loses small entries.
        t = balancing_factors(s.A)
        again = StateSpaceModel(s.A / t[:, None] * t, s.B / t[:, None], s.C * t, s.D, s.dt)
        other = _by_gramians(ordinary, again, rate) if (t != t[0]).any() else found
        found = other if other.status is Status.CONVERGED else found
    if outside is not None and exactly_stable(m.A, m.is_discrete) is None and found.status is Status.CONVERGED:
        return H2Norm(found.value, Status.INACCURATE, outside.reason)
    return found


def _by_gramians(ordinary: Moderated, s: StateSpaceModel, rate: float) -> H2Norm:
    """The H2 norm of the model as given from s, which is the ordinary one in other states and in the unit 1/rate."""
    try:
        reach, see = gramians(s.A, s.B, s.C, s.is_discrete)
    except NoTrustworthyNumber as error:
        return H2Norm(np.inf, Status.FAILED, error.line)
    traces = [float(np.trace(s.C @ reach @ s.C.T)), float(np.trace(s.B.T @ see @ s.B))]
    terms = [np.abs(s.C) @ np.abs(reach) @ np.abs(s.C.T), np.abs(s.B.T) @ np.abs(see) @ np.abs(s.B)]
    lost = any(x < -len(s.A) * EPS * np.trace(t) for x, t in zip(traces, terms, strict=True))
    squares = [max(x, 0.0) for x in traces]
    # A discrete sum has no time unit; a continuous integral has that of the ordinary model.
    power, direct = (0.0, float((s.D**2).sum())) if s.is_discrete else (0.5, 0.0)
    one, two = (ordinary.value(float(np.sqrt(rate * x + direct)), "h2_norm", power) for x in squares)
    agree = not lost and abs(one - two) <= 1e-6 * max(one, two)
    reason = "a Gramian came out indefinite" if lost else f"the two Gramians give {one:.9g} and {two:.9g}"
    reason = "" if agree else reason
    return H2Norm(float(max(one, two)), Status.CONVERGED if agree else Status.INACCURATE, reason)


# --- the bilinear map keeps stability and the H-infinity norm ---------------------------------------------------------


def bilinear_to_continuous(model: StateSpaceModel) -> StateSpaceModel:
    r"""Continuous model with ``G_c(s) = G(z)`` under ``s = (2/dt)(z - 1)/(z + 1)``; stability and H-infinity norm are
    the same.

    Raises
    ------
    NoTrustworthyNumber
        A pole at z = -1, which the map sends to infinity, or one so far outside that it comes from there.
    """
    a = 2 / model.dt
    t, m, b, c = _in_balanced_states(model)
    plus = np.eye(model.n_states) + m
    if model.n_states and float(np.abs(np.linalg.eigvals(m)).max()) > OUTSIDE:
        found = f"a pole of modulus above {OUTSIDE:g}: the map cannot tell it from infinity"
        raise NoTrustworthyNumber("bilinear map", found, None, "a shorter sample time")
    if _is_singular(plus, 1e12):
        raise NoTrustworthyNumber("bilinear map", "a pole at z = -1 has no place in continuous time")
    e, root = np.linalg.inv(plus), np.sqrt(2 * a)
    with np.errstate(over="ignore", invalid="ignore"):
        D = model.D - c @ e @ b
        # What cancels to rounding is zero: a direct path of 1e-17 would be taken for one by every later scaling.
        D[np.abs(D) <= 16 * EPS * (np.abs(model.D) + np.abs(c @ e) @ np.abs(b))] = 0.0
        return _mapped(model, 0.0, t, a * e @ (m - np.eye(model.n_states)), root * e @ b, root * c @ e, D)


def bilinear_to_discrete(model: StateSpaceModel, dt: float) -> StateSpaceModel:
    r"""Inverse of `bilinear_to_continuous` (Tustin's rule, with the input and output scaling that keeps Gramians).

    Raises
    ------
    NoTrustworthyNumber
        A pole at s = 2 / dt, which the map sends to infinity.
    """
    a = 2 / dt
    t, m, b, c = _in_balanced_states(model)
    minus = a * np.eye(model.n_states) - m
    if _is_singular(minus, 1e14):
        raise NoTrustworthyNumber("bilinear map", f"a pole at s = 2/dt = {a:g} has no place in discrete time")
    e, root = np.linalg.inv(minus), np.sqrt(2 * a)
    with np.errstate(over="ignore", invalid="ignore"):
        D = model.D + c @ e @ b
        return _mapped(model, dt, t, e @ (a * np.eye(model.n_states) + m), root * e @ b, root * c @ e, D)


def _mapped(
    model: StateSpaceModel, dt: float, t: AnyArray, A: AnyArray, B: AnyArray, C: AnyArray, D: AnyArray
) -> StateSpaceModel:
    """The mapped model, brought back from the balanced states ``x / t``."""
    A, B, C = t[:, None] * A / t, t[:, None] * B, C / t
    refuse_overflow("bilinear map", A, B, C, D)
    signals = model.inputs, model.outputs, model.states
    return StateSpaceModel(A, B, C, D, dt, *signals, where="bilinear map")


def _is_singular(matrix: AnyArray, limit: float) -> bool:
    """Whether the condition number stays above ``limit`` with every row as long: one fast pole is no singularity."""
    if not matrix.size or np.linalg.cond(matrix) <= limit:
        return False
    length = np.abs(matrix).max(axis=1, keepdims=True)
    return not length.all() or bool(np.linalg.cond(matrix / length) > limit)


def _in_balanced_states(model: StateSpaceModel) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
    """Factors t, and A, B, C in the states ``x / t``: a condition number says something about poles there only."""
    t = balancing_factors(model.A)
    return t, model.A / t[:, None] * t, model.B / t[:, None], model.C * t
