r"""The second voice of every design: the loop's gain from P(jw) and K(jw), each evaluated on its own.

A closed-loop realisation that was rebuilt from P and K carries the rounding of its products; where K has large entries
it may be the realisation of another loop. Nothing here uses it. With the matrices of P and of K as they are,

.. math:: P = C (j\omega I - A)^{-1} B + D, \qquad
   \begin{bmatrix} I & -P_{22} \\ -K & I \end{bmatrix} \begin{bmatrix} y \\ u \end{bmatrix} =
   \begin{bmatrix} P_{21} \\ 0 \end{bmatrix}, \qquad T = P_{11} + P_{12} u

and every step has a bound of its error. Where ordinary precision leaves the bound too wide, all is done again with
about 30 digits.

Stability is judged by Rouche's theorem. The characteristic polynomial of the true loop is

.. math:: \chi(s) = \det(sI - A_P) \det(sI - A_K) \det(I - P_{22} K) / \det(I - D_{22} D_K)

If it differs from that of the rebuilt loop by less than the latter's modulus everywhere on the stability boundary, both
have equally many roots outside: none, where the rebuilt loop is proved stable (`stability`).

Integrals over frequency of what spans many decades and has narrow peaks.

References
----------
Rump, "Verification methods: rigorous results using floating-point arithmetic", Acta Numerica 19 (2010); Higham (2002),
*Accuracy and Stability of Numerical Algorithms*, chapters 7, 12.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import NoTrustworthyNumber
from robustlab.frequency import frequency_response
from robustlab.magnitude import times_power
from robustlab.norms import H2Norm, HinfNorm
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.problem.double_double import DoubleDouble, inverse
from robustlab.synthesis.problem.partition import GeneralizedPlant
from robustlab.synthesis.problem.rebuilt_loop import balanced_states
from robustlab.synthesis.problem.scaling import in_ordinary_units
from robustlab.synthesis.problem.stability import proved_stable

__all__ = [
    "AGREEMENT",
    "SecondVoice",
    "h2_voice",
    "hinf_voice",
    "norm_doubt",
    "separate_responses",
    "integral_over_decades",
]


# Points of a panel, rounds of bisection, change of a panel (share of the whole) that ends it, most points.
NODES, ROUNDS, QUADRATURE, MOST_NODES = 8, 30, 1e-6, 20_000


def integral_over_decades(
    squares: Callable[[AnyArray], tuple[AnyArray, AnyArray]], edges: AnyArray
) -> tuple[float, float, float, int]:
    """Integrals over omega between the edges (logarithms) of both functions, what is open of the first, evaluations.

    Gauss-Legendre on panels of ln omega, each bisected until its halves change next to nothing.
    """
    nodes, weights = np.polynomial.legendre.leggauss(NODES)

    def panels(left: AnyArray, right: AnyArray) -> tuple[AnyArray, AnyArray]:
        half = 0.5 * (right - left)[:, None]
        omega = np.exp(left[:, None] + half * (1 + nodes))
        value, error = squares(omega.ravel())
        factor = half * weights * omega
        return (factor * value.reshape(omega.shape)).sum(axis=1), (factor * error.reshape(omega.shape)).sum(axis=1)

    left, right = edges[:-1], edges[1:]
    coarse, _ = panels(left, right)
    value, error, left_open, count = 0.0, 0.0, 0.0, NODES * len(left)
    for _ in range(ROUNDS):
        middle = 0.5 * (left + right)
        # Interleaved, so that frequencies go up.
        starts, stops = np.stack([left, middle], axis=1).ravel(), np.stack([middle, right], axis=1).ravel()
        fine, fine_error = panels(starts, stops)
        count += NODES * len(starts)
        both, both_error = fine.reshape(-1, 2).sum(axis=1), fine_error.reshape(-1, 2).sum(axis=1)
        if not (np.isfinite(both).all() and np.isfinite(coarse).all()):
            return float("nan"), float("inf"), float("inf"), count
        change = np.abs(both - coarse)
        done = change <= QUADRATURE * (value + both.sum())
        last = count > MOST_NODES
        done |= last
        value, error = value + float(both[done].sum()), error + float(both_error[done].sum())
        left_open += float(change[done].sum())
        again = np.repeat(~done, 2)
        left, right, coarse = starts[again], stops[again], fine[again]
        if not len(left):
            break
    return value + float(coarse.sum()), error, left_open + float(coarse.sum()), count


# Relative disagreement, and relative error bound, from which on a norm counts as not verified.
AGREEMENT = 1e-3
# Share of the size of T's terms that counts as zero.
FLOOR = 6e-14
# Share of its terms above which what is left of a direct term is more than rounding: the H2 norm is infinite then.
CANCELLED = 1e-10
# Share of the modulus of the rebuilt loop's characteristic polynomial by which the true one may differ.
ROUCHE = 0.1
# A value whose error bound exceeds this share of the largest gain, or of the polynomial, is computed with more digits.
QUICK, QUICK_EVERYWHERE, QUICK_ROUCHE = 1e-6, 1e-5, 2e-2
PER_DECADE, MOST_POINTS = 5, 120
# Frequencies that hit a pole move by this share of the distance to the loop's poles, which T cannot feel.
ASIDE = 1e-6
# Zooms into the highest local maxima of the frequencies evaluated.
ZOOMS, ZOOM_PEAKS, ZOOM_POINTS, PEAK_SHARE = 2, 3, 7, 0.9
# Work with many digits that one check may do, in points times states cubed; numbers of a stack that is kept in memory.
CAREFUL_WORK, CHUNK = 2e6, 4_000_000
# How far quadrature goes beyond the slowest and the fastest pole.
BEYOND = 1e4
# From so many states of the loop on the rebuilt loop's response is compared in place of quadrature.
MANY_STATES = 30
# Steps towards an enclosure of the error.
ENCLOSING = 12
EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class SecondVoice:
    """What P(jw) and K(jw) say of a norm.

    Attributes
    ----------
    lower, upper
        Of the largest gain at the frequencies evaluated (of the H2 norm: by quadrature): the value less and plus the
        bound of its error.
    value
        The largest gain itself.
    error
        ``upper - value`` or ``value - lower``, whichever is larger.
    frequency
        Where the gain is largest, in rad/s; NaN for the H2 norm.
    rouche
        Largest relative difference of the characteristic polynomials of the true and of the rebuilt loop; below 0.1
        the true loop is as stable as the rebuilt one.
    stable
        Whether that one is proved stable.
    n_frequencies
        How many were evaluated.
    floor
        What rounding of the two terms of T alone makes of a loop without any gain.
    """

    lower: float
    upper: float
    value: float
    error: float
    frequency: float
    rouche: float
    stable: bool
    n_frequencies: int
    floor: float = 0.0

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


def hinf_voice(
    plant: GeneralizedPlant, K: StateSpaceModel, loop: StateSpaceModel, peaks: Iterable[float] = ()
) -> SecondVoice:
    """The H-infinity norm of the loop of P and K at 0, at infinity, at ``peaks``, at the frequencies of the poles of P,
    K and the rebuilt loop, on a grid between them, and between the highest of these.

    Parameters
    ----------
    plant, K
        As given, and as returned: ``u = K y``.
    loop
        The realisation that was rebuilt from them, of which the poles and the characteristic polynomial are used.
    peaks
        Frequencies in rad/s at which the norm is claimed to be attained.
    """
    separate = _Separate(plant, K, loop)
    omega = separate.frequencies(times_power(np.asarray(list(peaks), dtype=float), -separate.rate))
    found = separate.values(omega, polynomial=True)
    rouche, stable = float(np.max(found.rouche, initial=0.0)), proved_stable(loop.A, loop.is_discrete)
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


def separate_responses(
    plant: GeneralizedPlant, K: StateSpaceModel, loop: StateSpaceModel, omega: AnyArray
) -> tuple[AnyArray, AnyArray, AnyArray]:
    """Frequencies, the loop's response (k, n_z, n_w) there, and bounds of the 2-norm of its error; frequencies on a
    pole have moved aside.
    """
    separate = _Separate(plant, K, loop)
    found = separate.values(np.sort(times_power(omega, -separate.rate)), everywhere=True)
    T = times_power(np.ascontiguousarray(found.T, dtype=complex).view(float), -separate.gain).view(complex)
    return times_power(found.omega, separate.rate), T, times_power(found.error, -separate.gain)


class _Values(NamedTuple):
    """At each frequency: T with the bounds of its entries, its largest singular value with a bound, Rouche's relative
    difference (0 where it was not asked for), and the size of the terms of T.
    """

    omega: AnyArray
    T: AnyArray
    T_error: AnyArray
    gain: AnyArray
    error: AnyArray
    rouche: AnyArray
    size: AnyArray

    def at(self, index: AnyArray) -> _Values:
        return _Values(*(part[index] for part in self))

    def joined(self, other: _Values) -> _Values:
        order = np.argsort(np.concatenate([self.omega, other.omega]), kind="stable")
        return _Values(*(np.concatenate([a, b])[order] for a, b in zip(self, other, strict=True)))


class _Separate:
    """P and K as they are given, never as one model.

    Where their entries are too large or too small to be multiplied, in other units: frequencies are ``2^rate`` and
    gains ``2^-gain`` times what is found here.
    """

    def __init__(self, plant: GeneralizedPlant, K: StateSpaceModel, loop: StateSpaceModel) -> None:
        plant, K, loop, self.rate, self.gain = in_ordinary_units(plant, K, loop)
        self.dt = plant.model.dt
        self.P, self.K, self.loop = (balanced_states(m) for m in (plant.model, K, loop))
        self.n_y, self.n_u = plant.n_meas, plant.n_con
        self.n_z, self.n_w = plant.model.n_outputs - self.n_y, plant.model.n_inputs - self.n_u
        self.poles = [_in_s(m.poles(), self.dt) for m in (self.loop, self.P, self.K)]
        self.log_direct = complex(np.log(complex(np.linalg.det(np.eye(self.n_u) - K.D @ plant.D22))))

    # --- where -------------------------------------------------------------------------------------------------------

    def corners(self) -> AnyArray:
        """Frequencies of all poles and of their resonances, increasing."""
        poles = np.concatenate(self.poles)
        re, im = np.abs(np.real(poles)), np.abs(np.imag(poles))
        resonance = np.sqrt(np.maximum(im - re, 0.0)) * np.sqrt(im + re)  # no squares
        own = np.unique(np.concatenate([np.abs(poles), im, resonance]))
        own = own[np.isfinite(own) & (own > 0)]
        return own[own > 1e-20 * own[-1]] if len(own) else np.ones(1)

    def frequencies(self, peaks: Iterable[float]) -> AnyArray:
        """Increasing; infinity last where time is continuous, else the Nyquist frequency."""
        own = self.corners()
        points = int(np.clip(PER_DECADE * np.log10(own[-1] / own[0] * 1e3), 8, MOST_POINTS))
        grid = np.geomspace(own[0] / 30, own[-1] * 30, points)
        # Corners that lie closer than eigenvalues are known tell nothing new.
        own = own[np.append(True, np.diff(own) > 1e-9 * own[1:])]
        omega = np.unique(np.concatenate([[0.0], own, grid, np.asarray(list(peaks), dtype=float)]))
        omega = omega[np.isfinite(omega)]
        if self.dt:
            return np.append(omega[omega < np.pi / self.dt], np.pi / self.dt)
        return np.append(omega, np.inf)

    # --- what --------------------------------------------------------------------------------------------------------

    def values(
        self, omega: AnyArray, polynomial: bool = False, everywhere: bool = False, scale: float = 0.0
    ) -> _Values:
        """In ordinary precision, and with more digits where that is not enough; frequencies on a pole move aside.

        ``scale`` is the largest gain known so far: smaller ones need no digits, unless they are asked for everywhere.
        """

        def wide(found: _Values) -> AnyArray:
            if everywhere:
                return np.asarray(~(found.error <= QUICK_EVERYWHERE * found.gain))
            top = max(np.max(found.gain[np.isfinite(found.gain)], initial=0.0), scale)
            return np.asarray(~((found.error <= QUICK * top) | (found.gain + found.error < (1 - QUICK) * top)))

        with np.errstate(all="ignore"):
            found = self._evaluated(omega, _Doubles, polynomial)
            apart = ~(found.rouche <= QUICK_ROUCHE)
            doubtful = wide(found) | apart
            if not doubtful.any():
                return found
            once_more = polynomial and bool(apart.any())
            kept = self._affordable(found, np.flatnonzero(doubtful), once_more)
            again = self._evaluated(found.omega[kept], DoubleDouble, once_more)
            if not once_more:
                again = again._replace(rouche=found.rouche[kept])
            rest = ~doubtful
            rest[doubtful] = everywhere  # those that are left out are kept with the few digits they have
            rest[kept] = False
            found = found.at(rest).joined(again)
            doubtful = (wide(found) | ~(found.rouche <= ROUCHE)) & np.isfinite(found.omega)
            if not doubtful.any():
                return found
            aside = self._evaluated(self._aside(found.omega[doubtful]), DoubleDouble, polynomial)
            return found.at(~doubtful).joined(aside)

    def _affordable(self, found: _Values, which: AnyArray, polynomial: bool) -> AnyArray:
        """All of them; of too many those at the ends and those of the largest gains, the others are left out."""
        n = self.loop.n_states if polynomial else max(self.P.n_states, self.K.n_states)
        most = int(max(CAREFUL_WORK / max(n, 1) ** 3, 12))
        if len(which) <= most:
            return which
        omega, gain = found.omega[which], np.nan_to_num(found.gain[which], nan=np.inf)
        order = np.lexsort((-gain, ~((omega == 0) | np.isinf(omega))))
        return np.sort(which[order[:most]])

    def _aside(self, omega: AnyArray) -> AnyArray:
        poles = self.poles[0]
        distance = np.abs(1j * omega[:, None] - poles).min(axis=1) if len(poles) else np.ones(len(omega))
        moved = np.maximum(omega + ASIDE * distance, omega * (1 + 1e-12))
        return np.where(moved < np.pi / self.dt, moved, omega * (1 - ASIDE)) if self.dt else moved

    def _evaluated(self, omega: AnyArray, kind: type[_Doubles] | type[DoubleDouble], polynomial: bool) -> _Values:
        size = max(self.P.n_states, self.K.n_states, self.loop.n_states * polynomial, 1)
        step = max(1, int(CHUNK / size**2))
        parts = [self._chunk(omega[i : i + step], kind, polynomial) for i in range(0, len(omega), step)]
        return parts[0] if len(parts) == 1 else _Values(*(np.concatenate(p) for p in zip(*parts, strict=True)))

    def _chunk(self, omega: AnyArray, kind: Any, polynomial: bool) -> _Values:
        s = np.exp(1j * omega * self.dt) if self.dt else _on_axis(omega)
        P, K = _response(self.P, s, kind), _response(self.K, s, kind)
        z, w, y, u = slice(0, self.n_z), slice(0, self.n_w), slice(self.n_z, None), slice(self.n_w, None)
        T, T_error, size, log_det, log_det_error = _closed(P, K, z, w, y, u, kind)
        rouche = np.zeros(len(omega))
        if polynomial:
            finite = np.isfinite(s)
            ours = _shifted(self.loop, s, kind)
            total = P.log_det + K.log_det + log_det - self.log_direct - ours.log_det
            error = P.log_det_error + K.log_det_error + log_det_error + ours.log_det_error
            rouche = np.where(finite, np.abs(np.expm1(np.where(finite, total, 0))) + 1.5 * error, 0.0)
            rouche = np.where(np.isfinite(rouche) & ((error < 0.1) | ~finite), rouche, np.inf)
        if not T[0].size:
            none = np.zeros(len(omega))
            return _Values(omega, T, T_error, none, none, rouche, none)
        gain = np.full(len(omega), np.nan)
        sound = np.isfinite(T).all(axis=(1, 2))
        gain[sound] = np.linalg.norm(T[sound], 2, axis=(1, 2))
        error = _frobenius(T_error) + 16 * EPS * gain
        error = np.where(np.isnan(error), np.inf, error)
        return _Values(omega, T, T_error, gain, error, rouche, _frobenius(size))


# --- the evaluation and the bounds of its errors ---------------------------------------------------------------------


class _Doubles:
    """Ordinary complex matrices, with what `DoubleDouble` has."""

    unit = 2.0**-51

    @staticmethod
    def of(matrices: AnyArray) -> AnyArray:
        return np.asarray(matrices, dtype=complex)


class _Inverse(NamedTuple):
    """Approximate inverses X of a stack of matrices A."""

    matrix: Any
    inverse: Any
    residual: AnyArray  # bounds of the moduli of I - A X
    rounding: float  # of a product with A, relative to that of the moduli
    log_det: AnyArray
    log_det_error: AnyArray


class _Response(NamedTuple):
    value: Any
    error: AnyArray
    log_det: AnyArray
    log_det_error: AnyArray


def _inverted(matrix: Any, kind: Any) -> _Inverse:
    of = abs(matrix)
    n = of.shape[-1]
    if kind is _Doubles:
        sign, log = np.linalg.slogdet(matrix)
        found = np.full(matrix.shape, np.nan + 0j)
        sound = np.isfinite(log)
        try:
            found[sound] = np.linalg.inv(matrix[sound])
        except np.linalg.LinAlgError:  # a pivot underflows where the determinant does not
            found[:] = np.nan
        log_det = np.log(sign) + log
    else:
        found, log_det = inverse(matrix)
    rounding, back = (n + 4) * kind.unit, abs(found)
    residual = abs(kind.of(np.broadcast_to(np.eye(n), of.shape)) - matrix @ found) + rounding * (of @ back)
    # d log det A = tr(A^-1 dA), with the backward error of the elimination for dA.
    error = 8 * rounding * (back * np.swapaxes(of, 1, 2)).sum(axis=(1, 2)) + 8 * EPS * (n + np.abs(log_det))
    return _Inverse(matrix, found, residual, rounding, log_det, error)


def _through(c: Any, a: _Inverse, b: Any, a_error: AnyArray | float = 0.0, b_error: AnyArray | float = 0.0) -> _Through:
    """``c A^-1 b`` with bounds of its entries' errors, those of A and b themselves included.

    ``c A^-1 b - c x = c A^-1 (b - A x)``, and ``c A^-1 = c X (I - (I - A X))^-1``: the error is judged by how far
    the residual is seen in the output, which no cancellation in ``c x`` spoils.
    """
    x = a.inverse @ b
    size = abs(x)
    left = abs(b - a.matrix @ x) + a.rounding * (abs(a.matrix) @ size + abs(b)) + b_error
    grows = a.residual
    if not isinstance(a_error, float):
        left, grows = left + a_error @ size, grows + a_error @ abs(a.inverse)
    left = _enclosed(grows, left)
    seen = abs(c @ a.inverse) + a.rounding * (abs(c) @ abs(a.inverse))
    return _Through(size + abs(a.inverse) @ left, c @ x, seen @ left + a.rounding * (abs(c) @ size))


class _Through(NamedTuple):
    size: AnyArray  # bounds of the moduli of x
    value: Any
    error: AnyArray


def _enclosed(G: AnyArray, v: AnyArray) -> AnyArray:
    """E with ``v + G E <= E`` up to rounding, which bounds every e with ``e <= v + G e``; inf where none is found."""
    e, found = v, np.full(v.shape, np.inf)
    for steps in (3, ENCLOSING):  # few are enough, unless exact zeros of v are reached by long chains only
        for _ in range(steps):
            e = v + G @ e
        holds = (v + 2 * (G @ e) <= 2 * (1 + 1e-9) * e).all(axis=(1, 2))
        if holds.all():
            break
    found[holds] = 2 * e[holds]
    return found


def _shifted(m: StateSpaceModel, s: AnyArray, kind: Any) -> _Inverse:
    """Of sI - A at every s; an infinite s counts as zero."""
    diagonal = np.where(np.isfinite(s), s, 0.0)[:, None, None] * np.eye(m.n_states)
    return _inverted(kind.of(diagonal) - kind.of(np.broadcast_to(m.A, diagonal.shape)), kind)


def _response(m: StateSpaceModel, s: AnyArray, kind: Any) -> _Response:
    k, infinite = len(s), ~np.isfinite(s)
    b, c, d = (kind.of(np.broadcast_to(x, (k, *x.shape))) for x in (m.B, m.C, m.D))
    if not m.n_states:
        return _Response(d, np.zeros((k, *m.D.shape)), np.zeros(k, complex), np.zeros(k))
    a = _shifted(m, s, kind)
    found = _through(c, a, b)
    value, error = found.value + d, found.error + a.rounding * (abs(found.value) + abs(d))
    if infinite.any():
        value, error = _chosen(infinite, d, value), np.where(infinite[:, None, None], 0.0, error)
    return _Response(value, error, a.log_det, a.log_det_error)


def _chosen(where: AnyArray, one: Any, other: Any) -> Any:
    if isinstance(one, DoubleDouble):
        mask = where[None, :, None, None]
        return DoubleDouble(np.where(mask, one.high, other.high), np.where(mask, one.low, other.low))
    return np.where(where[:, None, None], one, other)


def _closed(
    P: _Response, K: _Response, z: slice, w: slice, y: slice, u: slice, kind: Any
) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray, AnyArray]:
    """T with the bounds of its entries' errors and the sizes of its terms, and log det(I - P22 K) with its error."""
    (k, n_u, n_y), (n_z, n_w) = K.error.shape, P.error[0, z, w].shape
    n = n_y + n_u
    # Unknowns y, u; no products are formed.
    matrix, error = kind.of(np.broadcast_to(np.eye(n), (k, n, n)).copy()), np.zeros((k, n, n))
    into, into_error = kind.of(np.zeros((k, n, n_w))), np.zeros((k, n, n_w))
    out = kind.of(np.zeros((k, n_z, n)))
    _put(matrix, slice(0, n_y), slice(n_y, n), -P.value[:, y, u])
    _put(matrix, slice(n_y, n), slice(0, n_y), -K.value)
    _put(into, slice(0, n_y), slice(0, n_w), P.value[:, y, w])
    _put(out, slice(0, n_z), slice(n_y, n), P.value[:, z, u])
    error[:, :n_y, n_y:], error[:, n_y:, :n_y] = P.error[:, y, u], K.error
    into_error[:, :n_y] = P.error[:, y, w]
    inverted = _inverted(matrix, kind)
    found = _through(out, inverted, into, error, into_error)
    T = P.value[:, z, w] + found.value
    size = abs(P.value[:, z, w]) + abs(P.value[:, z, u]) @ found.size[:, n_y:]
    T_error = P.error[:, z, w] + P.error[:, z, u] @ found.size[:, n_y:] + found.error + inverted.rounding * size
    log_det_error = inverted.log_det_error + (abs(inverted.inverse) * np.swapaxes(error, 1, 2)).sum(axis=(1, 2))
    return (T.rounded() if isinstance(T, DoubleDouble) else T), T_error, size, inverted.log_det, log_det_error


def _put(matrix: Any, rows: slice, columns: slice, part: Any) -> None:
    if isinstance(matrix, DoubleDouble):
        matrix.high[:, :, rows, columns], matrix.low[:, :, rows, columns] = part.high, part.low
    else:
        matrix[:, rows, columns] = part


def _in_s(poles: AnyArray, dt: float) -> AnyArray:
    return np.log(poles[np.abs(poles) > 1e-12]) / dt if dt else poles


def _frobenius(stack: AnyArray) -> AnyArray:
    """Norm of each matrix, without overflow or underflow of squares."""
    size = np.abs(stack).max(axis=(1, 2))
    scale = np.where(np.isfinite(size) & (size > 0), size, 1.0)
    return scale * np.linalg.norm(stack / scale[:, None, None], axis=(1, 2))


def _on_axis(omega: AnyArray) -> AnyArray:
    s = np.full(len(omega), np.inf + 0j)
    s[np.isfinite(omega)] = 1j * omega[np.isfinite(omega)]
    return s


def _between(omega: AnyArray, gain: AnyArray) -> AnyArray:
    """Frequencies between the highest local maxima and their neighbours."""
    if len(omega) < 3 or not np.isfinite(gain).all():
        return np.zeros(0)
    left, right = np.append(-np.inf, gain[:-1]), np.append(gain[1:], -np.inf)
    peaks = np.flatnonzero((gain >= left) & (gain >= right) & (gain >= PEAK_SHARE * gain.max()) & np.isfinite(omega))
    peaks = peaks[np.argsort(-gain[peaks], kind="stable")][:ZOOM_PEAKS]
    low, high = omega[np.maximum(peaks - 1, 0)], omega[np.minimum(peaks + 1, len(omega) - 1)]
    high = np.where(np.isfinite(high), high, 10 * omega[peaks] + 1)
    share = np.arange(1, ZOOM_POINTS + 1) / (ZOOM_POINTS + 1)
    return np.setdiff1d(low[:, None] + (high - low)[:, None] * share, omega)


# --- the H2 norm -----------------------------------------------------------------------------------------------------


def h2_voice(plant: GeneralizedPlant, K: StateSpaceModel, loop: StateSpaceModel, claimed: float) -> SecondVoice:
    r"""The H2 norm of the loop of P and K by quadrature, adaptive around the loop's poles.

    .. math:: \|T\|_2^2 = \frac1\pi \int_0^\infty \|T(j\omega) - T(\infty)\|_F^2 d\omega, \qquad
       \frac{dt}\pi \int_0^{\pi/dt} \|T(e^{j\omega dt})\|_F^2 d\omega

    Infinite where a direct term of continuous time is more than rounding. Of a loop of many states
    the norm ``claimed`` is taken, give or take the H2 norm of the difference to the rebuilt loop's response. Squares
    are taken in units of ``claimed``.
    """
    separate = _Separate(plant, K, loop)
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows in these units is no confirmation
        norm, blur, rouche, count = _by_quadrature(separate, claimed)
    stable = proved_stable(loop.A, loop.is_discrete)
    return SecondVoice(norm - blur, norm + blur, norm, blur, float("nan"), rouche, stable, count)


def _by_quadrature(separate: _Separate, claimed: float) -> tuple[float, float, float, int]:
    """The H2 norm, the bound of its error, Rouche's relative difference, and the number of frequencies."""
    grid = separate.values(separate.frequencies(()), polynomial=True, everywhere=True)
    rouche = float(np.max(grid.rouche, initial=0.0))
    corners = separate.corners()
    low, high = corners[0] / BEYOND, corners[-1] * BEYOND
    if separate.dt:
        high = np.pi / separate.dt
        corners = corners[corners < high]
        direct = np.zeros(grid.T.shape[1:])
    else:
        direct = grid.T[-1]
        if _frobenius(grid.T[-1:])[0] - _frobenius(grid.T_error[-1:])[0] > CANCELLED * grid.size[-1]:
            return np.inf, np.inf, rouche, len(grid.omega)  # next to an ill-posed loop no K of floats cancels D11
    scale = separate.dt / np.pi if separate.dt else 1 / np.pi
    # A discrete sum has no unit of time.
    power = 0.0 if separate.dt else 0.5 * separate.rate
    exponent = np.frexp(claimed)[1] if 0 < claimed < np.inf else 0
    # Of T as it is evaluated, a power of two near the claimed norm.
    unit = int(exponent + separate.gain - np.floor(power))
    if separate.loop.n_states > MANY_STATES:
        blur = float(np.sqrt(scale * _difference(grid, direct, separate.loop, unit)))
        return claimed, _in_units_given(blur, unit, separate.gain, power), rouche, len(grid.omega)

    def squares(omega: AnyArray) -> tuple[AnyArray, AnyArray]:
        found = separate.values(omega, everywhere=True)
        T, error = _frobenius(found.T - direct), _frobenius(found.T_error)
        return times_power(T, -unit) ** 2, times_power(error, -unit) ** 2

    edges = np.unique(np.concatenate([[np.log(low)], np.log(corners), [np.log(high)]]))
    value, error, open_, count = integral_over_decades(squares, edges)
    ends, ends_error = squares(np.array([low, high]))
    value += low * ends[0] + (0.0 if separate.dt else high * ends[1])
    error += low * ends_error[0] + (0.0 if separate.dt else high * ends_error[1])
    norm = float(np.sqrt(scale * value))
    blur = float(np.sqrt(scale * error)) + (0.5 * open_ / value * norm if value > 0 else 0.0)
    norm, blur = (_in_units_given(x, unit, separate.gain, power) for x in (norm, blur))
    return norm, blur, rouche, count


def _in_units_given(size: float, unit: int, gain: int, power: float) -> float:
    """``size * 2^(unit - gain + power)``; half a power is left where the unit of time is an odd one."""
    whole = int(np.floor(power))
    return float(times_power(size * 2.0 ** (power - whole), unit - gain + whole))


def _difference(grid: _Values, direct: AnyArray, loop: StateSpaceModel, unit: int) -> float:
    """Integral over omega of the squared difference between the true and the rebuilt loop's response, over 4^unit."""
    finite = np.isfinite(grid.omega) & (grid.omega > 0)
    omega = grid.omega[finite]
    try:
        rebuilt = frequency_response(loop, omega)
    except NoTrustworthyNumber:
        return float("inf")
    difference = _frobenius(grid.T[finite] - direct - rebuilt + (0.0 if loop.is_discrete else loop.D))
    squares = times_power(difference + _frobenius(grid.T_error[finite]), -unit) ** 2
    width = np.gradient(omega) if len(omega) > 1 else omega
    # A resonance is as wide as its pole is far from the axis: a Lorentz curve has pi times that under its peak.
    poles = _in_s(loop.poles(), loop.dt)
    near = np.abs(1j * omega[:, None] - poles).min(axis=1) if len(poles) else omega
    ends = omega[0] * squares[0] + (0.0 if loop.is_discrete else omega[-1] * squares[-1])
    return float((squares * np.minimum(width, 4 * near)).sum() + ends)
