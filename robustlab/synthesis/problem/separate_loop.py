r"""The loop of P and K, each evaluated on its own at given frequencies, with a bound of every error.

A closed-loop realisation that was rebuilt from P and K carries the rounding of its products; where K has large entries
it may be the realisation of another loop. Nothing here uses its response. With the matrices of P and of K as they are,

.. math:: P = C (j\omega I - A)^{-1} B + D, \qquad
   \begin{bmatrix} I & -P_{22} \\ -K & I \end{bmatrix} \begin{bmatrix} y \\ u \end{bmatrix} =
   \begin{bmatrix} P_{21} \\ 0 \end{bmatrix}, \qquad T = P_{11} + P_{12} u

and every step has a bound of its error. P and K come from their modes (`modal_response`), or from linear systems where
that leaves the bound too wide; where ordinary precision does, all is done again with about 30 digits. The
characteristic polynomial of the true loop, which has to be that of the rebuilt one, is

.. math:: \chi(s) = \det(sI - A_P) \det(sI - A_K) \det(I - P_{22} K) / \det(I - D_{22} D_K)

References
----------
Rump, "Verification methods: rigorous results using floating-point arithmetic", Acta Numerica 19 (2010); Higham (2002),
*Accuracy and Stability of Numerical Algorithms*, chapters 7, 12.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.linear_analysis.modal_response import ModalResponse
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.problem.constants import MODES, QUICK
from robustlab.synthesis.problem.double_double import DoubleDouble, inverse
from robustlab.synthesis.problem.partition import GeneralizedPlant
from robustlab.synthesis.problem.rebuilt_loop import balanced_states
from robustlab.synthesis.problem.scaling import in_ordinary_units
from robustlab.synthesis.problem.stability import proved_stable

QUICK_EVERYWHERE = 1e-5
QUICK_ROUCHE = 2e-2
# Frequencies per decade between the poles, and most of them.
PER_DECADE = 5
MOST_POINTS = 120
# Frequencies that hit a pole move by this share of the distance to the loop's poles, which T cannot feel.
ASIDE = 1e-6
# Work with many digits that one check may do, in points times states cubed.
CAREFUL_WORK = 2e6
# Numbers of a stack that is kept in memory.
CHUNK = 4_000_000

# Share of the modulus of the rebuilt loop's characteristic polynomial by which the true one may differ.
ROUCHE = 0.1
# Squares of entries that make a norm above this, or below its inverse, neither vanish nor overflow.
PLAIN = 1e-120
# Steps towards an enclosure of the error.
ENCLOSING = 12
EPS = float(np.finfo(float).eps)
# Ratio of a pole's distance from the axis to its frequency below which that frequency stands for its resonance, too.
LIGHT = 0.2


class SeparateValues(NamedTuple):
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

    def at(self, index: AnyArray) -> SeparateValues:
        """Those of some frequencies."""
        return SeparateValues(*(part[index] for part in self))

    def joined(self, other: SeparateValues) -> SeparateValues:
        """Both, frequencies increasing."""
        order = np.argsort(np.concatenate([self.omega, other.omega]), kind="stable")
        return SeparateValues(*(np.concatenate([a, b])[order] for a, b in zip(self, other, strict=True)))


class SeparateLoop:
    """P and K as they are given, never as one model.

    Where their entries are too large or too small to be multiplied, in other units: frequencies are ``2^rate`` and
    gains ``2^-gain`` times what is found here.
    """

    def __init__(
        self,
        plant: GeneralizedPlant,
        K: StateSpaceModel,
        loop: StateSpaceModel,
    ) -> None:
        plant, K, loop, self.rate, self.gain = in_ordinary_units(plant, K, loop)
        self.dt = plant.model.dt
        self.P, self.K, self.loop = (balanced_states(m) for m in (plant.model, K, loop))
        models = (self.loop, self.P, self.K)
        self.modes = [ModalResponse.of_model(m) for m in models]
        self.poles = [
            poles_in_s(m.poles() if modes is None else modes.poles, self.dt)
            for m, modes in zip(models, self.modes, strict=True)
        ]
        self.log_direct = complex(np.log(complex(np.linalg.det(np.eye(plant.n_con) - K.D @ plant.D22))))

    def proved_stable(self) -> bool:
        """Whether the rebuilt loop is proved stable: by its modes, or else by what `stability` has."""
        modes = self.modes[0]
        proved = modes is not None and modes.proves_stable(self.dt > 0)
        return proved or proved_stable(self.loop.A, self.dt > 0)

    # --- where -------------------------------------------------------------------------------------------------------

    def corners(self) -> AnyArray:
        """Frequencies of all poles and of their resonances, increasing."""
        poles = np.concatenate(self.poles)
        re, im = np.abs(np.real(poles)), np.abs(np.imag(poles))
        # Those of one pole lie within a tenth of its distance to the axis where it is damped lightly.
        apart = re > LIGHT * im
        resonance = np.sqrt(np.maximum(im - re, 0.0)) * np.sqrt(im + re)  # no squares
        own = np.unique(np.concatenate([im, np.abs(poles)[apart], resonance[apart]]))
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
    ) -> SeparateValues:
        """In ordinary precision, and with more digits where that is not enough; frequencies on a pole move aside.

        ``scale`` is the largest gain known so far: smaller ones need no digits, unless they are asked for everywhere.
        """
        quick = QUICK

        def wide(found: SeparateValues) -> AnyArray:
            if everywhere:
                return np.asarray(~(found.error <= QUICK_EVERYWHERE * found.gain))
            top = max(np.max(found.gain[np.isfinite(found.gain)], initial=0.0), scale)
            return np.asarray(~((found.error <= quick * top) | (found.gain + found.error < (1 - quick) * top)))

        with np.errstate(all="ignore"):
            found = self._evaluated(omega, _Modal, polynomial)
            for kind in (_Doubles, DoubleDouble):
                apart = ~(found.rouche <= QUICK_ROUCHE)
                doubtful = wide(found) | apart
                if not doubtful.any():
                    return found
                if kind is _Doubles:
                    found = found.at(~doubtful).joined(self._evaluated(found.omega[doubtful], kind, polynomial))
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

    def _affordable(self, found: SeparateValues, which: AnyArray, polynomial: bool) -> AnyArray:
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

    def _evaluated(
        self, omega: AnyArray, kind: type[_Doubles] | type[DoubleDouble], polynomial: bool
    ) -> SeparateValues:
        size = max(self.P.n_states, self.K.n_states, self.loop.n_states * polynomial, 1)
        step = max(1, int(CHUNK / size**2))
        parts = [self._chunk(omega[i : i + step], kind, polynomial) for i in range(0, len(omega), step)]
        return parts[0] if len(parts) == 1 else SeparateValues(*(np.concatenate(p) for p in zip(*parts, strict=True)))

    def _chunk(self, omega: AnyArray, kind: Any, polynomial: bool) -> SeparateValues:
        s = np.exp(1j * omega * self.dt) if self.dt else _on_axis(omega)
        models = zip((self.P, self.K), self.modes[1:], strict=True)
        P, K = (_response(m, s, kind, modes, polynomial) for m, modes in models)
        T, T_error, size, log_det, log_det_error = _closed(P, K, kind)
        rouche = np.zeros(len(omega))
        if polynomial:
            finite = np.isfinite(s)
            ours = self._rebuilt_polynomial(s, kind)
            total = P.log_det + K.log_det + log_det - self.log_direct - ours.log_det
            error = P.log_det_error + K.log_det_error + log_det_error + ours.log_det_error
            rouche = np.where(finite, np.abs(np.expm1(np.where(finite, total, 0))) + 1.5 * error, 0.0)
            rouche = np.where(np.isfinite(rouche) & ((error < 0.1) | ~finite), rouche, np.inf)
        if not T[0].size:
            none = np.zeros(len(omega))
            return SeparateValues(omega, T, T_error, none, none, rouche, none)
        gain = np.full(len(omega), np.nan)
        sound = np.isfinite(T).all(axis=(1, 2))
        gain[sound] = np.linalg.svd(T[sound], compute_uv=False)[:, 0]
        error = frobenius(T_error) + 16 * EPS * gain
        error = np.where(np.isnan(error), np.inf, error)
        return SeparateValues(omega, T, T_error, gain, error, rouche, frobenius(size))

    def _rebuilt_polynomial(self, s: AnyArray, kind: Any) -> _LogDet:
        """Log det(sI - A) of the rebuilt loop: from its modes where these are known well enough, else by elimination.

        An infinite s counts as zero.
        """
        s = np.where(np.isfinite(s), s, 0.0)
        value, error = np.zeros(len(s), complex), np.full(len(s), np.inf)
        if kind is not DoubleDouble and self.modes[0] is not None:
            value, error = self.modes[0].log_determinant(s)
        rest = ~(error <= MODES)
        if rest.any():
            shifted = _shifted(self.loop, s[rest], kind)
            value[rest], error[rest] = _solved(shifted, abs(shifted), kind)[2]
        return _LogDet(value, error)


class _Inverse(NamedTuple):
    """Approximate inverses X of a stack of matrices A."""

    matrix: Any
    inverse: Any
    residual: AnyArray  # bounds of the moduli of I - A X
    rounding: float  # of a product with A, relative to that of the moduli
    log_det: AnyArray
    log_det_error: AnyArray


class _LogDet(NamedTuple):
    log_det: AnyArray
    log_det_error: AnyArray


class _Response(NamedTuple):
    value: Any
    error: AnyArray
    log_det: AnyArray
    log_det_error: AnyArray


class _Through(NamedTuple):
    size: AnyArray  # bounds of the moduli of x
    value: Any
    error: AnyArray


# --- the evaluation and the bounds of its errors ---------------------------------------------------------------------


class _Doubles:
    """Ordinary complex matrices, with what `DoubleDouble` has."""

    unit = 2.0**-51

    @staticmethod
    def of(matrices: AnyArray) -> AnyArray:
        return np.asarray(matrices, dtype=complex)


class _Modal(_Doubles):
    """The same, responses from the modes."""


def _inverted(matrix: Any, kind: Any) -> _Inverse:
    of = abs(matrix)
    found, back, logarithm = _solved(matrix, of, kind)
    rounding = (of.shape[-1] + 4) * kind.unit
    one = kind.of(np.broadcast_to(np.eye(of.shape[-1]), of.shape))
    residual = abs(one - matrix @ found) + rounding * (of @ back)
    return _Inverse(matrix, found, residual, rounding, *logarithm)


def _solved(matrix: Any, of: AnyArray, kind: Any) -> tuple[Any, AnyArray, _LogDet]:
    """The inverses, their moduli and the logarithms of the determinants; ``of`` are the moduli of the matrices."""
    n = of.shape[-1]
    if kind is not DoubleDouble:
        sign, log = np.linalg.slogdet(matrix)
        sound = np.isfinite(log)
        found = np.full(matrix.shape, np.nan + 0j)
        try:
            found = np.linalg.inv(matrix) if sound.all() else found
            if not sound.all():
                found[sound] = np.linalg.inv(matrix[sound])
        except np.linalg.LinAlgError:  # a pivot underflows where the determinant does not
            found[:] = np.nan
        log_det = np.log(sign) + log
    else:
        found, log_det = inverse(matrix)
    rounding, back = (n + 4) * kind.unit, abs(found)
    # d log det A = tr(A^-1 dA), with the backward error of the elimination for dA.
    error = 8 * rounding * np.einsum("kij,kji->k", back, of) + 8 * EPS * (n + np.abs(log_det))
    return found, back, _LogDet(log_det, error)


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


def _shifted(m: StateSpaceModel, s: AnyArray, kind: Any) -> Any:
    """SI - A at every s; an infinite s counts as zero."""
    diagonal = np.where(np.isfinite(s), s, 0.0)[:, None, None] * np.eye(m.n_states)
    return kind.of(diagonal) - kind.of(np.broadcast_to(m.A, diagonal.shape))


def _response(m: StateSpaceModel, s: AnyArray, kind: Any, modes: ModalResponse | None, polynomial: bool) -> _Response:
    k, infinite = len(s), ~np.isfinite(s)
    d, unknown = np.broadcast_to(m.D, (k, *m.D.shape)), _LogDet(np.zeros(k), np.full(k, np.inf))
    if not m.n_states:
        return _Response(kind.of(d), np.zeros(d.shape), np.zeros(k, complex), np.zeros(k))
    if kind is not _Modal:
        b, c, d = (kind.of(np.broadcast_to(x, (k, *x.shape))) for x in (m.B, m.C, m.D))
        a = _inverted(_shifted(m, s, kind), kind)
        found = _through(c, a, b)
        value, error = found.value + d, found.error + a.rounding * (abs(found.value) + abs(d))
        logarithm = _LogDet(a.log_det, a.log_det_error)
    elif modes is None:
        value, error, logarithm = d, np.full(d.shape, np.inf), unknown
    else:
        finite = np.where(infinite, 0.0, s)
        value, error = modes.entries(finite)
        logarithm = _LogDet(*modes.log_determinant(finite)) if polynomial else unknown
    if infinite.any():
        value, error = _chosen(infinite, d, value), np.where(infinite[:, None, None], 0.0, error)
    return _Response(value, error, *logarithm)


def _chosen(where: AnyArray, one: Any, other: Any) -> Any:
    if isinstance(one, DoubleDouble):
        mask = where[None, :, None, None]
        return DoubleDouble(np.where(mask, one.high, other.high), np.where(mask, one.low, other.low))
    return np.where(where[:, None, None], one, other)


def _closed(P: _Response, K: _Response, kind: Any) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray, AnyArray]:
    """T with the bounds of its entries' errors and the sizes of its terms, and log det(I - P22 K) with its error."""
    k, n_u, n_y = K.error.shape
    n_z, n_w = P.error.shape[1] - n_y, P.error.shape[2] - n_u
    z, w, y, u = slice(0, n_z), slice(0, n_w), slice(n_z, None), slice(n_w, None)
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


def poles_in_s(poles: AnyArray, dt: float) -> AnyArray:
    """Poles in rad/s; of a discrete model ``log(z)/dt`` of those that are not at zero."""
    return np.log(poles[np.abs(poles) > 1e-12]) / dt if dt else poles


def frobenius(stack: AnyArray) -> AnyArray:
    """Norm of each matrix, without overflow or underflow of squares."""
    plain = np.sqrt((np.real(stack) ** 2 + np.imag(stack) ** 2).sum(axis=(1, 2)))
    if ((plain > PLAIN) & (plain < 1 / PLAIN)).all():
        return plain
    size = np.abs(stack).max(axis=(1, 2))
    scale = np.where(np.isfinite(size) & (size > 0), size, 1.0)
    return scale * np.linalg.norm(stack / scale[:, None, None], axis=(1, 2))


def _on_axis(omega: AnyArray) -> AnyArray:
    s = np.full(len(omega), np.inf + 0j)
    s[np.isfinite(omega)] = 1j * omega[np.isfinite(omega)]
    return s
