r"""Proves a form F(M(jw)) > 0 on a frequency interval, by its value at one point and a matrix without real roots.

With :math:`X = (j\omega - A)^{-1} B` and M = D + C X the form is quadratic in X (`forms.Quadratic`):

.. math:: F(\omega) = T + S^* X + X^* S + X^* Q X .

Let :math:`R = (j\omega_0 - A)^{-1}`, X that of :math:`\omega_0`, :math:`F_0 = F(\omega_0)`, :math:`L = S + Q X`, and

.. math:: K = \begin{pmatrix} -R + X F_0^{-1} L^* R & -X F_0^{-1} X^* \\
          R^* (L F_0^{-1} L^* - Q) R & R^* - R^* L F_0^{-1} X^* \end{pmatrix} .

Theorem. If :math:`F_0 > 0`, and :math:`I + \delta j R` and :math:`I - \delta j K` are regular for all real
:math:`|\delta| \le r`, then A has no eigenvalue :math:`j\omega`, and :math:`F(\omega) > 0`, for all
:math:`|\omega - \omega_0| \le r`.

Proof. With :math:`\omega = \omega_0 + \delta`: :math:`j\omega - A = (j\omega_0 - A)(I + \delta j R)` is regular, so F
is continuous. If it is not positive definite throughout, it is singular somewhere: F u = 0, u and delta not zero. Put
:math:`x = (j\omega - A)^{-1} B u`, :math:`p = (j\omega - A)^{-*} (Q x + S u)`, so :math:`S^* x + B^* p + T u = 0`, and
:math:`\xi = j\delta x`, :math:`\eta = j\delta p`. From :math:`(j\omega_0 - A) x = B u - \xi` and
:math:`(j\omega_0 - A)^* p = Q x + S u + \eta` follow :math:`x = X u - R \xi`, :math:`p = R^* (L u - Q R \xi + \eta)`
and :math:`F_0 u = L^* R \xi - X^* \eta`. With it :math:`(x, p) = K (\xi, \eta)`: :math:`(I - \delta j K)(x, p) = 0`.
So x = p = 0, hence B u = S u = T u = 0 and :math:`F_0 u = 0`: a contradiction.

Regularity of a family :math:`I - \delta H` (`regular_within`): if :math:`W V - \delta W H V` is strictly diagonally
dominant for all :math:`|\delta| \le r`, it is regular, and so are its factors. W and V are arbitrary; floating point
chooses eigenvectors of H and their inverse, or diagonal matrices where these suffice.

An interval that fails is halved. High frequencies, infinity included, are those of the reciprocal model around 0; a
discrete model is mapped to a continuous one first (`models`).

References
----------
Boyd, Balakrishnan, Kabamba, "A bisection method for computing the H-infinity norm", MCSS 2 (1989), with its test made
about a point of the axis, and in balls.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from flint import acb, arb, arb_mat

from robustlab.errors import InputError
from robustlab.verification.balls import (
    INDEFINITE,
    Definite,
    Matrix,
    adjoint,
    definite,
    exact,
    inverse,
    magnitudes,
    midpoints,
    radii,
    rounded_down,
    rounded_up,
    stack,
)
from robustlab.verification.claim import PROVED, Blurred, Verdict, Work, not_proved
from robustlab.verification.forms import Form, Quadratic
from robustlab.verification.models import Model, balanced, exponents, on_the_axis, reciprocal, shifted

BLURRED = 1e-6  # radii of a row above this part of its diagonal: more bits are needed
UNDECIDED = Definite(False, math.nan)
ALIKE = 1e-14  # an imaginary part below this part of an eigenvalue is rounding


def axis(G: Model, intervals: Sequence[tuple[float, float, Form]], work: Work) -> Verdict:
    """Prove that each interval's form is positive definite at each of its frequencies, the ends included.

    ``G``: M(jw) is its response, discrete that at exp(jw dt). It need not be stable; a pole in an interval fails.
    ``intervals``: low, high in rad/s; high may be inf, and is cut at pi/dt.
    Raises InputError: an interval of a discrete model that starts beyond pi/dt.
    """
    mapped = on_the_axis(G) if G.dt else G
    if mapped is None:
        return not_proved("the discrete model was not proved to be free of a pole at -1")
    low, high = balanced(mapped), None
    for start, stop, form in intervals:
        a, b = _warped(start, G.dt, up=False), _warped(stop, G.dt, up=True)
        split = b
        if math.isinf(b):
            split = max(a, _fastest(mapped))
            high = high or reciprocal(mapped)
            if high is None:
                return not_proved("high frequencies: A was not proved regular")
            # in which w = inf is 0, and w is -1/w
            verdict = _boxes(balanced(high), lambda v: _unwarped(-1 / v if v else math.inf, G.dt),
                             -rounded_up(1 / arb(split)), 0.0, form, work)  # fmt: skip
            if not verdict.proved:
                return verdict
        verdict = _boxes(low, lambda t: _unwarped(t, G.dt), a, split, form, work)
        if not verdict.proved:
            return verdict
    return PROVED


def _warped(w: float, dt: float, *, up: bool) -> float:
    """Return a double above (else below) ``tan(w dt / 2)``, inf where w dt may be pi; w itself if continuous."""
    if not dt or math.isinf(w):
        return w
    half = arb(w) * arb(dt) / 2
    if half < arb.pi() / 2:
        return rounded_up(half.tan()) if up else max(rounded_down(half.tan()), 0.0)
    if not up:
        raise InputError("low", f"{w}", f"a frequency below pi/dt, {math.pi / dt:.6g} rad/s")
    return math.inf


def _unwarped(t: float, dt: float) -> float:
    return 2 * math.atan(t) / dt if dt else t


def _fastest(G: Model) -> float:
    """Estimate where high frequencies begin: the largest absolute eigenvalue, or 1."""
    A = midpoints(G.A)
    return float(np.abs(np.linalg.eigvals(A)).max(initial=0.0)) or 1.0 if np.isfinite(A).all() else 1.0


def _boxes(G: Model, frequency: Callable[[float], float], a: float, b: float, form: Form, work: Work) -> Verdict:
    """Prove the form positive definite on [a, b]; the ends are doubles that neighbouring boxes share.

    ``frequency``: the map from those of the continuous model G to those of the user's model, in rad/s.
    """
    todo, quadratic = [(a, b)], form.of_sum(G.D, G.C)
    while todo:
        a, b = todo.pop()
        w0 = min(max(a + (b - a) / 2, a), b)
        r = max(rounded_up(arb(b) - arb(w0)), rounded_up(arb(w0) - arb(a)))
        work.spend(max(2 * G.n, G.size))
        answer = _box(G, w0, r, quadratic)
        if answer.proved:
            continue
        at = frequency(w0)
        if answer.least < INDEFINITE:
            return not_proved(f"at {at:.9g} rad/s the form's smallest eigenvalue is {answer.least:.3g} of its size", at)
        if not a < w0 < b:
            return not_proved(f"at {at:.9g} rad/s the form is singular, or a pole lies on the axis, or nearly", at)
        todo += [(w0, b), (a, w0)]
    return PROVED


def _box(G: Model, w0: float, r: float, form: Quadratic) -> Definite:
    """Test whether the form is positive definite for ``|w - w0| <= r``, and A has no eigenvalue there."""
    R = inverse(shifted(G, w0))
    if R is None:
        return UNDECIDED
    X = R * G.B
    F = form.at(X)
    answer = definite(F)
    if not answer.proved or not G.n:
        return answer
    K = pencil(form, R, X, F) if regular_within(R * acb(0, -1), r) else None
    return answer if K is not None and regular_within(K, r) else UNDECIDED


def pencil(form: Quadratic, R: Matrix, X: Matrix, F: Matrix) -> Matrix | None:
    """Return ``j K`` of the module's text, shape (2n, 2n); None where F was not proved regular."""
    G = inverse(F)
    if G is None:
        return None
    XG, LR = X * G, adjoint(form.linear + form.square * X) * R  # the latter is -L^* R
    cross = XG * LR
    corner = adjoint(LR) * G * LR + adjoint(R) * form.square * R
    return stack([[-R - cross, -(XG * adjoint(X))], [corner, adjoint(R + cross)]]) * acb(0, 1)


def regular_within(H: Matrix, r: float) -> bool:
    """Prove ``I - d H`` regular for all real |d| <= r, by the module's text; H (n, n)."""
    hint = midpoints(H)
    return bool(np.isfinite(hint).all()) and any(_dominant(H, r, exact(W), exact(V)) for W, V in _bases(hint, r))


def _bases(hint: np.ndarray, r: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield candidates W, V, cheapest first; none if a real eigenvalue excludes a proof.

    Row scalings where ``d H`` is small; those of its Schur form, for a small spectral radius; eigenvectors.
    """
    try:
        if (units := _units(hint, r)) is not None:
            yield np.diag(1 / units), np.diag(units)
            return
        values, vectors = np.linalg.eig(hint)
        if np.abs(values).max() * r < 1:
            sizes = np.abs(hint)
            np.fill_diagonal(sizes, 0.0)
            level = np.exp2(exponents(sizes, sizes[:, :0], sizes[:0]))
            even = level[:, None] * hint / level
            Q = _triangularising(even)
            if (units := _units(np.triu(Q.conj().T @ even @ Q), r)) is not None:
                yield Q.conj().T / units[:, None] * level, Q * units / level[:, None]
        if not ((np.abs(values) * r >= 1) & (np.abs(np.imag(values)) <= ALIKE * np.abs(values))).any():
            yield np.linalg.inv(vectors), vectors
    except np.linalg.LinAlgError:
        return


def _units(H: np.ndarray, r: float) -> np.ndarray | None:
    """Return u > 0 (n,) with ``u - r |H| u = 1``; None where the spectral radius of ``r |H|`` is one or more."""
    units = np.linalg.solve(np.eye(len(H)) - r * np.abs(H), np.ones(len(H)))
    return units if (units > 0).all() else None


def _triangularising(H: np.ndarray) -> np.ndarray:
    """Return a unitary Q with ``Q^* H Q`` upper triangular up to rounding, by repeated deflation."""
    n = len(H)
    Q, T = np.eye(n, dtype=complex), H.astype(complex)
    for k in range(n - 1):
        values, vectors = np.linalg.eig(T[k:, k:])
        x = vectors[:, [int(np.argmax(np.abs(values)))]]
        turn = np.linalg.qr(np.hstack([x, np.eye(n - k)]))[0]
        T[k:] = turn.conj().T @ T[k:]
        T[:, k:] = T[:, k:] @ turn
        Q[:, k:] = Q[:, k:] @ turn
    return Q


def _dominant(H: Matrix, r: float, W: Matrix, V: Matrix) -> bool:
    """Test ``W V - d W H V`` for strict diagonal dominance for all real |d| <= r; Blurred if bits are missing."""
    unit, moved, rows = W * V, W * (H * V), range(H.nrows())
    sizes, steps, ones = magnitudes(unit), magnitudes(moved), arb_mat(len(rows), 1, [1] * len(rows))
    sums = (sizes + steps * arb(r)) * ones
    if all(_apart(unit[i, i], moved[i, i], r) > sums[i, 0] - sizes[i, i] - steps[i, i] * arb(r) for i in rows):
        return True
    noise = (radii(unit) + radii(moved) * arb(r)) * ones
    if any(noise[i, 0] > BLURRED for i in rows):
        raise Blurred
    return False


def _apart(a: acb, b: acb, r: float) -> arb:
    """Bound ``|a - d b|`` from below for all real |d| <= r, by the distance from 0 or from a line."""
    near = a.abs_lower() - b.abs_upper() * arb(r)
    if near > 0 or not b.abs_lower() > 0:
        return near
    return b.abs_lower() * abs((a / b).imag).abs_lower()
