r"""The second voice of every design: what P and K, each evaluated on its own, say of the loop's norm and stability.

Stability is judged by Rouche's theorem. If the characteristic polynomial of the true loop (`separate_loop`) differs
from that of the rebuilt loop by less than the latter's modulus everywhere on the stability boundary, both have equally
many roots outside: none, where the rebuilt loop is proved stable (`stability`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis.frequency import response_within
from robustlab.linear_analysis.magnitude import times_power
from robustlab.norms import H2Norm, HinfNorm
from robustlab.norms.axis_integral import AxisTuning, axis_integral
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.problem.constants import MODES, QUICK
from robustlab.synthesis.problem.partition import GeneralizedPlant
from robustlab.synthesis.problem.separate_loop import ROUCHE, SeparateLoop, SeparateValues, frobenius

# Zooms into the highest local maxima: how often, how many maxima, points in each, least height of one.
ZOOMS = 2
ZOOM_PEAKS = 3
ZOOM_POINTS = 7
PEAK_SHARE = 0.9
# From so many states of the loop on the rebuilt loop's response is compared in its place.
MANY_STATES = 30
# Difference of the two rules in a panel (share of the whole) that ends it, most points.
PANEL_CHANGE = 1e-6
MOST_NODES = 20_000

# Relative disagreement, and relative error bound, from which on a norm counts as not verified.
AGREEMENT = 1e-3
# Share of the size of T's terms that counts as zero.
FLOOR = 6e-14
# Share of its terms above which what is left of a direct term is more than rounding: the H2 norm is infinite then.
CANCELLED = 1e-10

_Candidate = TypeVar("_Candidate")


@dataclass(frozen=True)
class SecondVoice:
    """What P(jw) and K(jw) say of a norm."""

    # lower, upper: of the largest gain at the frequencies evaluated (of the H2 norm: by residues or by quadrature): the
    # value less and plus the bound of its error
    lower: float
    upper: float
    value: float  # the largest gain itself
    error: float  # `upper - value` or `value - lower`, whichever is larger
    frequency: float  # where the gain is largest, in rad/s; NaN for the H2 norm
    # Largest relative difference of the characteristic polynomials of the true and of the rebuilt loop; below 0.1 the
    # true loop is as stable as the rebuilt one.
    rouche: float
    stable: bool  # whether that one is proved stable
    n_frequencies: int  # how many were evaluated
    floor: float = 0.0  # what rounding of the two terms of T alone makes of a loop without any gain

    def doubt(self, lower: float, upper: float) -> str:
        """Why a norm that is claimed to lie between the two is not verified; empty where the second voice agrees."""
        if not self.stable:
            return "stability rests on ill-conditioned eigenvalues and could not be proved"
        if not self.rouche <= ROUCHE:
            return (
                "the loop of P and K as given is not shown to be stable: evaluated separately, its characteristic "
                f"polynomial differs by {self.rouche:.2g} (relative) from that of the rebuilt loop"
            )
        return self.disagreement(lower, upper)

    def disagreement(self, lower: float, upper: float) -> str:
        """The same of the numbers alone."""
        if not self.error <= AGREEMENT * max(upper, self.value) + self.floor:
            return f"P and K evaluated separately leave an error bound of {self.error:.2g}: digits were lost"
        if self.upper > upper * (1 + AGREEMENT) + self.floor or self.lower < lower * (1 - AGREEMENT) - self.floor:
            at = f" at {self.frequency:.4g} rad/s" if np.isfinite(self.frequency) else ""
            return (
                f"P and K evaluated separately give {self.upper:.6g}{at}, the rebuilt loop gives {upper:.6g}: "
                "digits were lost"
            )
        return ""

    def larger(self, upper: float) -> float:
        """The larger one of a claimed norm and of what was found here (the value itself where its bound is useless)."""
        found = self.upper if self.error <= AGREEMENT * self.upper + self.floor else self.value
        return max(upper, found) if np.isfinite(found) else upper


def norm_doubt(
    plant: GeneralizedPlant, K: StateSpaceModel, loop: StateSpaceModel, norm: HinfNorm | H2Norm
) -> tuple[float, str]:
    """The larger one of a loop's norm and its second voice, and why it is not verified (empty: it is)."""
    if isinstance(norm, H2Norm):
        voice = h2_voice(plant, K, loop, norm.value)
        doubt = voice.doubt(norm.value, norm.value)
        return (voice.larger(norm.value) if doubt else norm.value), doubt
    voice = hinf_voice(plant, K, loop, [norm.frequency])
    return voice.larger(norm.upper), voice.doubt(norm.lower, norm.upper)


def first_confirmed(
    candidates: Iterable[_Candidate], hear: Callable[[_Candidate], tuple[float, str]]
) -> tuple[_Candidate, float, str]:
    """The first of at least one candidate that the second voice confirms, with its norm and no doubt; or else the
    first of all, with the larger number and the reason why it is not verified. ``hear`` is asked as `norm_doubt` is.
    """
    first: tuple[_Candidate, float, str] | None = None
    for candidate in candidates:
        gamma, doubt = hear(candidate)
        if not doubt:
            return candidate, gamma, ""
        first = first or (candidate, gamma, doubt)
    assert first is not None
    return first


def separate_responses(
    plant: GeneralizedPlant, K: StateSpaceModel, loop: StateSpaceModel, omega: AnyArray
) -> tuple[AnyArray, AnyArray, AnyArray]:
    """Frequencies, the loop's response (k, n_z, n_w) there, and bounds of the 2-norm of its error; frequencies on a
    pole have moved aside.
    """
    separate = SeparateLoop(plant, K, loop)
    found = separate.values(np.sort(times_power(omega, -separate.rate)), everywhere=True)
    T = times_power(np.ascontiguousarray(found.T, dtype=complex).view(float), -separate.gain).view(complex)
    return times_power(found.omega, separate.rate), T, times_power(found.error, -separate.gain)


def hinf_voice(
    plant: GeneralizedPlant,
    K: StateSpaceModel,
    loop: StateSpaceModel,
    peaks: Iterable[float] = (),
) -> SecondVoice:
    """The H-infinity norm of the loop of P and K at 0, at infinity, at ``peaks``, at the frequencies of the poles of P,
    K and the rebuilt loop, on a grid between them, and between the highest of these.

    ``plant``, ``K``: as given, and as returned: ``u = K y``.
    ``loop``: the realisation that was rebuilt from them, of which the poles and the characteristic polynomial are used.
    ``peaks``: frequencies in rad/s at which the norm is claimed to be attained.
    """
    separate = SeparateLoop(plant, K, loop)
    omega = separate.frequencies(times_power(np.asarray(list(peaks), dtype=float), -separate.rate))
    found = separate.values(omega, polynomial=True)
    rouche, stable = float(np.max(found.rouche, initial=0.0)), separate.proved_stable()
    for _ in range(ZOOMS):
        between = _between(found.omega, found.gain)
        if not len(between):
            break
        found = found.joined(separate.values(between, scale=float(found.gain.max())))
    best = int(np.argmax(found.gain)) if len(found.gain) else 0
    if not len(found.gain):
        return SecondVoice(0.0, 0.0, 0.0, 0.0, 0.0, rouche, stable, 0)
    low, high = float((found.gain - found.error).max()), float((found.gain + found.error).max())
    value, floor = float(found.gain[best]), FLOOR * float(found.size.max())
    sizes = times_power(np.array([low, high, value, max(high - value, value - low), floor]), -separate.gain)
    low, high, value, error, floor = (float(size) for size in sizes)
    frequency = float(times_power(found.omega[best], separate.rate))
    return SecondVoice(low, high, value, error, frequency, rouche, stable, len(found.omega), floor)


def _between(
    omega: AnyArray,
    gain: AnyArray,
) -> AnyArray:
    """Frequencies between the highest local maxima and their neighbours."""
    if len(omega) < 3 or not np.isfinite(gain).all():
        return np.zeros(0)
    left, right = np.append(-np.inf, gain[:-1]), np.append(gain[1:], -np.inf)
    high_enough = gain >= PEAK_SHARE * gain.max()
    peaks = np.flatnonzero((gain >= left) & (gain >= right) & high_enough & np.isfinite(omega))
    peaks = peaks[np.argsort(-gain[peaks], kind="stable")][:ZOOM_PEAKS]
    low, high = omega[np.maximum(peaks - 1, 0)], omega[np.minimum(peaks + 1, len(omega) - 1)]
    high = np.where(np.isfinite(high), high, 10 * omega[peaks] + 1)
    share = np.arange(1, ZOOM_POINTS + 1) / (ZOOM_POINTS + 1)
    return np.setdiff1d(low[:, None] + (high - low)[:, None] * share, omega)


# --- the H2 norm -----------------------------------------------------------------------------------------------------


def h2_voice(
    plant: GeneralizedPlant,
    K: StateSpaceModel,
    loop: StateSpaceModel,
    claimed: float,
) -> SecondVoice:
    r"""The H2 norm of the loop of P and K.

    .. math:: \|T\|_2^2 = \frac1\pi \int_0^\infty \|T(j\omega) - T(\infty)\|_F^2 d\omega, \qquad
       \frac{dt}\pi \int_0^{\pi/dt} \|T(e^{j\omega dt})\|_F^2 d\omega

    By the residues of the rebuilt loop's modes, which no Gramian enters, give or take their error and the H2 norm of
    the difference between that loop's response and T. Where a loop of few states leaves that wide, by quadrature of T,
    adaptive around the loop's poles (`axis_integral`); with many states the norm ``claimed`` is taken where there are
    no modes. Infinite where a direct term of continuous time is more than rounding. Squares are taken in units of
    ``claimed``.
    """
    separate = SeparateLoop(plant, K, loop)
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows in these units is no confirmation
        norm, blur, rouche, count = _h2_norm(separate, claimed)
    stable = separate.proved_stable()
    return SecondVoice(norm - blur, norm + blur, norm, blur, float("nan"), rouche, stable, count)


def _h2_norm(separate: SeparateLoop, claimed: float) -> tuple[float, float, float, int]:
    """The H2 norm, the bound of its error, Rouche's relative difference, and the number of frequencies."""
    grid = separate.values(separate.frequencies(()), polynomial=True, everywhere=True)
    rouche = float(np.max(grid.rouche, initial=0.0))
    direct = np.zeros(grid.T.shape[1:])
    if not separate.dt:
        direct = grid.T[-1]
        if frobenius(grid.T[-1:])[0] - frobenius(grid.T_error[-1:])[0] > CANCELLED * grid.size[-1]:
            return np.inf, np.inf, rouche, len(grid.omega)  # next to an ill-posed loop no K of floats cancels D11
    scale = separate.dt / np.pi if separate.dt else 1 / np.pi
    # A discrete sum has no unit of time.
    power = 0.0 if separate.dt else 0.5 * separate.rate
    exponent = np.frexp(claimed)[1] if 0 < claimed < np.inf else 0
    # Of T as it is evaluated, a power of two near the claimed norm.
    unit = int(exponent + separate.gain - np.floor(power))
    blur = float(np.sqrt(scale * _difference(grid, direct, separate, unit)))
    blur = _in_units_given(blur, unit, separate.gain, power)
    norm, error = _by_residues(separate)
    norm, error = (_in_units_given(x, 0, separate.gain, power) for x in (norm, error))
    sure = error <= MODES * norm
    norm, blur = (norm, blur + error) if sure else (claimed, blur)
    if separate.loop.n_states > MANY_STATES or (sure and blur <= MODES * norm):
        return norm, blur, rouche, len(grid.omega)

    def squares(omega: AnyArray) -> AnyArray:
        found = separate.values(omega, everywhere=True)
        sizes = np.stack([frobenius(found.T - direct), frobenius(found.T_error)], axis=1)
        return times_power(sizes, -unit) ** 2

    poles = separate.poles[0] if len(separate.poles[0]) else -np.ones(1)
    found = axis_integral(squares, poles, separate.dt, AxisTuning(rtol=PANEL_CHANGE, points=MOST_NODES))
    value, error = (float(x) for x in found.values)
    norm = float(np.sqrt(scale * value))
    blur = float(np.sqrt(scale * error)) + (0.5 * found.open / value * norm if value > 0 else 0.0)
    norm, blur = (_in_units_given(x, unit, separate.gain, power) for x in (norm, blur))
    return norm, blur, rouche, len(grid.omega) + found.points


def _by_residues(separate: SeparateLoop) -> tuple[float, float]:
    """The H2 norm of the rebuilt loop from its modes, and the bound of its error, infinite where there is none."""
    modes, loop = separate.modes[0], separate.loop
    if modes is None or (not loop.is_discrete and loop.D.any()):
        return 0.0, np.inf
    square, error = modes.mean_square(loop.is_discrete)
    norm = float(np.sqrt(max(square, 0.0)))
    return norm, error / norm if norm else np.inf


def _in_units_given(size: float, unit: int, gain: int, power: float) -> float:
    """``size * 2^(unit - gain + power)``; half a power is left where the unit of time is an odd one."""
    whole = int(np.floor(power))
    return float(times_power(size * 2.0 ** (power - whole), unit - gain + whole))


def _difference(grid: SeparateValues, direct: AnyArray, separate: SeparateLoop, unit: int) -> float:
    """Integral over omega of the squared difference between the true and the rebuilt loop's response, over 4^unit."""
    finite = np.isfinite(grid.omega) & (grid.omega > 0)
    omega, loop = grid.omega[finite], separate.loop
    try:
        rebuilt, error = response_within(loop, separate.modes[0], omega, QUICK)
    except NoTrustworthyNumber:
        return float("inf")
    difference = frobenius(grid.T[finite] - direct - rebuilt + (0.0 if loop.is_discrete else loop.D)) + error
    squares = times_power(difference + frobenius(grid.T_error[finite]), -unit) ** 2
    width = np.gradient(omega) if len(omega) > 1 else omega
    # A resonance is as wide as its pole is far from the axis: a Lorentz curve has pi times that under its peak.
    poles = separate.poles[0]
    near = np.abs(1j * omega[:, None] - poles).min(axis=1) if len(poles) else omega
    ends = omega[0] * squares[0] + (0.0 if loop.is_discrete else omega[-1] * squares[-1])
    return float((squares * np.minimum(width, 4 * near)).sum() + ends)
