"""Proofs about a model in balls: stability, H-infinity and H2 norms, and definite forms on intervals of frequency.

The theorems with their proofs are in theorems.md, in the same symbols. An interval that fails is halved. High
frequencies, infinity included, are those of the reciprocal model around 0; a discrete model is mapped to a continuous
one first (`models`). Floating point proposes P, or the eigenvectors of the test of regularity.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from flint import acb, acb_mat, arb, arb_mat
from numpy.typing import NDArray

from robustlab.errors import InputError
from robustlab.verification.balls import (
    INDEFINITE,
    PRECISIONS,
    Definite,
    Matrix,
    adjoint,
    definite,
    exact,
    identity,
    inverse,
    magnitudes,
    midpoints,
    precision,
    radii,
    rounded_down,
    rounded_up,
    stack,
    zeros,
)
from robustlab.verification.claim import (
    PROVED,
    Blurred,
    Claim,
    Outcome,
    Verdict,
    Work,
    not_proved,
    real,
    refuted,
    scalar,
    symmetric,
)
from robustlab.verification.models import (
    Form,
    Model,
    Quadratic,
    balanced,
    exponents,
    gain_exceeds,
    gain_form,
    model_of,
    on_the_axis,
    reciprocal,
    shifted,
)

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
            return not_proved(f"at {at:.9g} rad/s the form is singular, or a pole is on the axis, or nearly", at)
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
    """Return ``j K`` of the theorem, shape (2n, 2n); None where F was not proved regular."""
    G = inverse(F)
    if G is None:
        return None
    XG, LR = X * G, adjoint(form.linear + form.square * X) * R  # the latter is -L^* R
    cross = XG * LR
    corner = adjoint(LR) * G * LR + adjoint(R) * form.square * R
    return stack([[-R - cross, -(XG * adjoint(X))], [corner, adjoint(R + cross)]]) * acb(0, 1)


def regular_within(H: Matrix, r: float) -> bool:
    """Prove ``I - d H`` regular for all real |d| <= r, by the diagonal of ``W V - d W H V``; H (n, n)."""
    hint = midpoints(H)
    return bool(np.isfinite(hint).all()) and any(_dominant(H, r, exact(W), exact(V)) for W, V in _bases(hint, r))


def _bases(hint: np.ndarray, r: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield W, V: row scalings where ``d H`` is small; those of its Schur form; eigenvectors, if none is real."""
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


DOUBLINGS = 60  # sums 2^60 terms of a Lyapunov equation's solution; eigenvalues decide slower decay


def lyapunov_form(G: Model, P: Matrix) -> Matrix:
    """``-(A' P + P A)``, discrete ``P - A' P A``, shape (n, n)."""
    if G.dt:
        return P - adjoint(G.A) * P * G.A
    product = P * G.A
    return -(adjoint(product) + product)


def stable(G: Model, work: Work) -> Verdict:
    """Prove that every matrix in the balls of A is stable, or refute it by an eigenvalue enclosed outside."""
    work.spend(G.n)
    hint = lyapunov_hint(G)
    if hint is not None:
        candidate = exact(hint)
        work.spend(G.n)
        if definite(candidate).proved and definite(lyapunov_form(G, candidate)).proved:
            return PROVED
    work.spend(2 * G.n)
    values = eigenvalues(G.A)
    for value in values:
        if outside(value, G.dt):
            return refuted(f"A has an eigenvalue near {complex(value):.6g}, enclosed beyond the stability boundary")
    if len(values) == G.n and all(_inside(value, G.dt) for value in values):
        return PROVED
    nearest = max((abs(v) - 1 if G.dt else v.real for v in map(complex, values)), default=np.nan)
    return not_proved(f"stability of A: no P that proves it, rightmost eigenvalue {nearest:.3g} from the boundary")


def eigenvalues(A: Matrix) -> list[acb]:
    """Enclose all eigenvalues, each ball holding one (flint); empty where that failed."""
    try:
        return acb_mat(A).eig(multiple=True)
    except ValueError:
        return []


def outside(value: acb, dt: float) -> bool:
    return bool(value.abs_lower() > 1 if dt else value.real > 0)


def _inside(value: acb, dt: float) -> bool:
    return bool(value.abs_upper() < 1 if dt else value.real < 0)


def lyapunov_hint(G: Model) -> NDArray[np.float64] | None:
    r"""Estimate P in floating point as :math:`\sum_k (F^k)^T F^k`, summed by doubling; None where it fails.

    F is A, or :math:`(I + hA)(I - hA)^{-1}` of a continuous model: then P solves
    :math:`A^T P + P A = -(I - hA)^T (I - hA) / (2h)`.
    """
    A = midpoints(G.A)
    if not G.n or not np.isfinite(A).all():
        return None
    d = np.exp2(exponents(np.abs(A), np.zeros((G.n, 0)), np.zeros((0, G.n))))
    A = d[:, None] * A / d
    if not 1e-100 < np.abs(A).max() < 1e100:
        return None
    F, one = A, np.eye(G.n)
    if not G.dt:
        h = 1 / np.linalg.norm(A)
        if abs(np.linalg.det(one - h * A)) == 0:
            return None
        F = np.linalg.solve(one - h * A, one + h * A)
    P = one
    for _ in range(DOUBLINGS):
        step = F.T @ P @ F
        if not np.isfinite(step).all():
            return None
        P, F = P + step, F @ F
        if np.abs(step).max() <= 1e-17 * np.abs(P).max():
            return (P + P.T) / 2 * d * d[:, None]
    return None


def climb(attempt: Callable[[], Verdict]) -> Verdict:
    """Return the verdict in the lowest precision that decides; the last one where none does."""
    verdict = not_proved("")
    for bits in PRECISIONS:
        with precision(bits):
            try:
                verdict = attempt()
            except Blurred:
                verdict = not_proved(f"{bits} bits are not enough")
        if verdict.outcome is not Outcome.NOT_PROVED:
            break
    return verdict


def in_two_parts(claim: Claim, n: int) -> Matrix:
    """Return the claim's P, plus ``P_low``, its further digits, where given."""
    P = exact(symmetric(claim, "P", n))
    return P + exact(symmetric(claim, "P_low", n)) if "P_low" in claim.numbers else P


def prove_stable(claim: Claim, work: Work) -> Verdict:
    A = real(claim, "A", (None, None))
    n = len(real(claim, "A", (len(A), len(A))))
    dt = scalar(claim, "dt", zero=True)
    return climb(lambda: stable(Model(exact(A), zeros(n, 0), zeros(0, n), zeros(0, 0), dt), work))


def bounded_real_form(G: Model, P: Matrix, gamma: float) -> Matrix:
    PA, PB = P * G.A, P * G.B
    if G.dt:
        parts = adjoint(G.A) * PA - P, adjoint(G.A) * PB, adjoint(G.B) * PB
    else:
        parts = adjoint(PA) + PA, PB, zeros(G.m, G.m)
    corner = parts[0] + adjoint(G.C) * G.C
    side = parts[1] + adjoint(G.C) * G.D
    last = parts[2] + adjoint(G.D) * G.D - identity(G.m) * arb(gamma) ** 2
    return -stack([[corner, side], [adjoint(side), last]])


def prove_norm(claim: Claim, build: Callable[[Claim], Model], work: Work) -> Verdict:
    """Prove that the model of ``build`` is stable with H-infinity norm <= ``gamma``, by ``P`` where it is a proof."""
    gamma = scalar(claim, "gamma")

    def by_frequency() -> Verdict:
        G = build(claim)
        verdict = axis(G, [(0.0, math.inf, gain_form(G.m, G.p, gamma))], work)
        if verdict.at is not None and gain_exceeds(G, verdict.at, gamma):
            return refuted(f"the gain at {verdict.at:.9g} rad/s was proved to be larger")
        return verdict

    if "P" in claim.numbers:
        verdict = prove_bounded_real(claim, build, work)
        if verdict.proved:
            return verdict
    verdict = climb(lambda: stable(build(claim), work))
    return climb(by_frequency) if verdict.proved else verdict


def prove_bounded_real(claim: Claim, build: Callable[[Claim], Model], work: Work) -> Verdict:
    """Prove the same by ``P`` alone (`in_two_parts`)."""
    gamma = scalar(claim, "gamma")

    def attempt() -> Verdict:
        G = build(claim)
        P = in_two_parts(claim, G.n)
        work.spend(G.size)
        proved = definite(P).proved and definite(bounded_real_form(G, P, gamma)).proved
        return PROVED if proved else not_proved("P is no proof")

    return climb(attempt)


def prove_gramian(claim: Claim, work: Work) -> Verdict:
    r"""Prove that the model is stable with H2 norm <= ``value``, by ``P`` (n, n; `in_two_parts`).

    With P > 0 and :math:`-(A^T P + P A + C^T C) > 0` (discrete :math:`P - A^T P A - C^T C > 0`) P is above the
    observability Gramian, so the norm's square is at most :math:`\mathrm{tr}(B^T P B)`, discrete plus
    :math:`\mathrm{tr}(D^T D)`. A continuous model needs D = 0, to the last bit.
    """
    value = scalar(claim, "value", zero=True)

    def attempt() -> Verdict:
        G = model_of(claim)
        P = in_two_parts(claim, G.n)
        if not G.dt and any(x != 0 for x in G.D.entries()):
            return refuted("D is not zero, so the H2 norm is infinite")
        if not G.dt and not all(x == 0 for x in G.D.entries()):  # a loop's D may hide in a ball around zero
            return not_proved("D = 0 was not proved")
        work.spend(G.n)
        if not definite(P).proved:
            return not_proved("P > 0 was not proved")
        answer = definite(lyapunov_form(G, P) - adjoint(G.C) * G.C)
        if not answer.proved:
            return not_proved(
                f"Lyapunov's inequality was not proved: smallest eigenvalue {answer.least:.3g} of its size"
            )
        square: arb = sum((X[i, i] for X in (adjoint(G.B) * P * G.B, adjoint(G.D) * G.D) for i in range(G.m)), arb(0))
        if square <= arb(value) ** 2:
            return PROVED
        return not_proved(f"P proves {rounded_up(square.sqrt()):.17g}")

    return climb(attempt)
