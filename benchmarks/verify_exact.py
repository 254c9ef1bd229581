"""Exact and 60-digit arithmetic of the judge of `verify_attack`: rationals, polynomials, mpmath. Nothing of robustlab.

Stability, H-infinity and H2 norms are decided in rationals: a double is a dyadic number, so the characteristic
polynomial of A, and the determinant of gamma^2 - G^* G as a polynomial in the square of the frequency, have integers
as coefficients. Routh's array tells stability, Sturm's sequence whether that determinant has a root.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise, permutations
from typing import Any

import numpy as np
from mpmath import mp

mp.dps = 60

Exact = np.ndarray  # of objects: Fraction or int
Poly = list[int]  # coefficients, the lowest first
Quad = tuple[Exact, Exact, Exact, Exact]


def rational(X: Any) -> Exact:
    """The exact numbers that doubles are, as fractions, in the array's shape."""
    X = np.asarray(X, dtype=float)
    result = np.empty(X.shape, dtype=object)
    result.ravel()[:] = [Fraction(x) for x in X.ravel().tolist()]
    return result


def eye(n: int) -> Exact:
    """The identity of fractions."""
    return rational(np.eye(n))


def whole(X: Exact) -> tuple[Exact, int]:
    """Integers N and a common denominator d > 0 with X = N/d."""
    d = math.lcm(*(x.denominator for x in X.ravel())) if X.size else 1
    N = np.empty(X.shape, dtype=object)
    N.ravel()[:] = [x.numerator * (d // x.denominator) for x in X.ravel()]
    return N, d


def solve(A: Any, B: Any) -> Any:
    """``A^-1 B`` by elimination over any field (fractions, mpmath); ZeroDivisionError where A is singular."""
    A, B = np.array(A, dtype=object), np.array(B, dtype=object)
    n = len(A)
    for i in range(n):
        k = max(range(i, n), key=lambda r: abs(A[r, i]))
        if A[k, i] == 0:
            raise ZeroDivisionError("singular")
        A[[i, k]], B[[i, k]] = A[[k, i]], B[[k, i]]
        for r in range(i + 1, n):
            if A[r, i] != 0:
                f = A[r, i] / A[i, i]
                A[r, i:] = A[r, i:] - f * A[i, i:]
                B[r] = B[r] - f * B[i]
    for i in reversed(range(n)):
        if i + 1 < n:
            B[i] = B[i] - A[i, i + 1 :].dot(B[i + 1 :])
        B[i] = B[i] / A[i, i]
    return B


def positive(X: Any) -> bool:
    """Whether a Hermitian matrix (fractions, or mpmath) is positive definite, by its pivots."""
    X = np.array(X, dtype=object)
    for i in range(len(X)):
        pivot = mp.re(X[i, i]) if isinstance(X[i, i], (mp.mpf, mp.mpc)) else X[i, i]
        if not pivot > 0:
            return False
        for r in range(i + 1, len(X)):
            if X[r, i] != 0:
                X[r, i + 1 :] = X[r, i + 1 :] - (X[r, i] / pivot) * X[i, i + 1 :]
    return True


def embedded(X: Any) -> Exact:
    """The real matrix ``[[Re, -Im], [Im, Re]]`` of fractions: products and definiteness go over to it."""
    X = np.asarray(X, dtype=complex)
    R, J = rational(X.real), rational(X.imag)
    return np.vstack([np.hstack([R, -J]), np.hstack([J, R])])


# --- polynomials -----------------------------------------------------------------------------------------------------


def times(a: Poly, b: Poly) -> Poly:
    """The product."""
    result = [0] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        if x:
            for k, y in enumerate(b):
                result[i + k] += x * y
    return result


def plus(a: Poly, b: Poly, sign: int = 1) -> Poly:
    """``a + sign b``."""
    n = max(len(a), len(b))
    a, b = a + [0] * (n - len(a)), b + [0] * (n - len(b))
    return [x + sign * y for x, y in zip(a, b, strict=True)]


def resolvent(N: Exact) -> tuple[Poly, list[Exact]]:
    """Characteristic polynomial of integers N, and the coefficients of adj(s - N), the highest first (Faddeev)."""
    n = len(N)
    one = np.array([[int(i == j) for j in range(n)] for i in range(n)], dtype=object).reshape(n, n)
    chi, M, adjugates = [1], one, []
    for k in range(1, n + 1):
        adjugates.append(M)
        NM = N.dot(M)
        c = -sum(NM[i, i] for i in range(n)) // k
        chi.append(c)
        M = NM + c * one
    return chi[::-1], adjugates


def on_the_left(a: Poly, n: int) -> Poly:
    """``(1 - s)^n a((1 + s)/(1 - s))``: the unit disk goes to the left half plane."""
    result: Poly = [0] * (n + 1)
    for k, c in enumerate(a):
        term = [c]
        for i in range(n):
            term = times(term, [1, 1] if i < k else [1, -1])
        result = plus(result, term)
    return result


def hurwitz(chi: Poly) -> bool:
    """Whether all roots lie in the open left half plane (Routh, with integers)."""
    if chi[-1] == 0:
        return False
    rows = chi[::-1] if chi[-1] > 0 else [-x for x in chi[::-1]]
    if any(x <= 0 for x in rows):
        return False
    a, b = rows[0::2], rows[1::2]
    while b:
        if b[0] <= 0:
            return False
        b_long = b + [0] * (len(a) - len(b))
        c = [b[0] * a[i + 1] - a[0] * b_long[i + 1] for i in range(len(a) - 1)]
        a, b = b, c
    return True


def is_stable(A: Exact, dt: float) -> bool:
    """Whether every eigenvalue of A lies inside the boundary, exactly."""
    N, d = whole(A)
    chi, _ = resolvent(N)
    if dt:
        chi = on_the_left([c * d**k for k, c in enumerate(chi)], len(A))
        return chi[-1] != 0 and hurwitz(chi)
    return hurwitz(chi)


def positive_roots(f: Poly) -> int:
    """Distinct roots of f in x > 0, with f(0) not zero (Sturm)."""
    f = trimmed(f)
    chain = [f, trimmed([k * c for k, c in enumerate(f)][1:] or [0])]
    while any(chain[-1]):
        a, b = list(chain[-2]), chain[-1]
        size, sign = abs(b[-1]), 1 if b[-1] > 0 else -1
        while len(a) >= len(b) and any(a):
            lead, shift = a[-1] * sign, len(a) - len(b)
            a = [size * x for x in a]
            for k, y in enumerate(b):
                a[shift + k] -= lead * y
            a = trimmed(a)
        divisor = math.gcd(*a) or 1
        chain.append([-x // divisor for x in a])
    chain.pop()

    def changes(signs: Sequence[int]) -> int:
        kept = [s for s in signs if s]
        return sum((x > 0) != (y > 0) for x, y in pairwise(kept))

    return changes([p[0] for p in chain]) - changes([p[-1] for p in chain])


def trimmed(a: Poly) -> Poly:
    """Without zeros at the top."""
    a = list(a)
    while len(a) > 1 and a[-1] == 0:
        a.pop()
    return a


# --- norms -----------------------------------------------------------------------------------------------------------


def norm_below(G: Quad, dt: float, gamma: Fraction) -> bool:
    """Whether a stable model (A, B, C, D of fractions) has a gain strictly below gamma > 0 at all frequencies."""
    A, B, C, D = G
    p, m = D.shape
    if not p or not m:
        return True
    (N, d), (Nb, b), (Nc, c), (Nd, e) = (whole(X) for X in (A, B, C, D))
    n = len(A)
    chi, adjugates = resolvent(N)
    K = b * c * e
    coefficients = [*[e * d * Nc.dot(M).dot(Nb) for M in adjugates][::-1], np.full((p, m), 0, dtype=object)]
    coefficients = [X + b * c * chi[k] * Nd for k, X in enumerate(coefficients)]
    entries = [[[X[i, j] for X in coefficients] for j in range(m)] for i in range(p)]
    if dt:
        chi = on_the_left([x * d**k for k, x in enumerate(chi)], n)
        entries = [[on_the_left([x * d**k for k, x in enumerate(f)], n) for f in row] for row in entries]
    axis = [[_on_axis(f) for f in row] for row in entries]
    if m > p:
        axis = [[axis[i][j] for i in range(p)] for j in range(m)]  # N N^* in place of N^* N, conjugated
    square = _absolute(_on_axis(chi))
    level = [gamma.numerator**2 * K**2 * x for x in square]
    size, h2 = min(m, p), gamma.denominator**2
    Q = [[_inner(axis, i, j, h2, level) for j in range(size)] for i in range(size)]
    f = _determinant(Q)[0::2]
    f += [0] * (n * size + 1 - len(f))
    start = [[Q[i][j][0][0] for j in range(size)] for i in range(size)]
    exact = np.array([[Fraction(x) for x in row] for row in start], dtype=object)
    return f[n * size] > 0 and positive(exact) and positive_roots(f) == 0


def _on_axis(f: Poly) -> tuple[Poly, Poly]:
    """Real and imaginary part of f(jw), polynomials in w."""
    real = [(x if k % 4 == 0 else -x) if k % 2 == 0 else 0 for k, x in enumerate(f)]
    imag = [(x if k % 4 == 1 else -x) if k % 2 == 1 else 0 for k, x in enumerate(f)]
    return real, imag


def _absolute(x: tuple[Poly, Poly]) -> Poly:
    return plus(times(x[0], x[0]), times(x[1], x[1]))


def _inner(X: list[list[tuple[Poly, Poly]]], i: int, j: int, scale: int, level: Poly) -> tuple[Poly, Poly]:
    """Entry of ``level I - scale X^* X``."""
    real: Poly = level if i == j else [0]
    imag: Poly = [0]
    for row in X:
        (a, b), (c, d) = row[i], row[j]
        real = plus(real, [scale * x for x in plus(times(a, c), times(b, d))], -1)
        imag = plus(imag, [scale * x for x in plus(times(a, d), times(b, c), -1)], -1)
    return real, imag


def _determinant(Q: list[list[tuple[Poly, Poly]]]) -> Poly:
    """The determinant of a Hermitian matrix of polynomials: real."""
    total: Poly = [0]
    for order in permutations(range(len(Q))):
        sign = (-1) ** sum(order[i] > order[j] for i in range(len(order)) for j in range(i + 1, len(order)))
        real, imag = [1], [0]
        for i, j in enumerate(order):
            a, b = Q[i][j]
            real, imag = plus(times(real, a), times(imag, b), -1), plus(times(real, b), times(imag, a))
        total = plus(total, real, sign)
    return total


def h2_square(G: Quad, dt: float) -> Fraction:
    """Square of the H2 norm of a stable model; D counts where it is discrete."""
    A, B, C, D = G
    n = len(A)
    pairs = [(i, j) for i in range(n) for j in range(i, n)]
    place = {pair: k for k, pair in enumerate(pairs)} | {(j, i): k for k, (i, j) in enumerate(pairs)}
    system = np.full((len(pairs), len(pairs)), Fraction(0), dtype=object)
    for row, (i, j) in enumerate(pairs):
        if dt:
            system[row, place[i, j]] += 1
            for a in range(n):
                for b in range(n):
                    system[row, place[a, b]] -= A[a, i] * A[b, j]
        else:
            for a in range(n):
                system[row, place[a, j]] -= A[a, i]
                system[row, place[i, a]] -= A[a, j]
    W = C.T.dot(C) if n else np.zeros((0, 0), dtype=object)
    x = solve(system, np.array([[W[pair]] for pair in pairs], dtype=object).reshape(-1, 1)) if n else None
    total = sum((d * d for d in D.ravel()), Fraction(0))
    if n:
        X = np.array([[x[place[i, j], 0] for j in range(n)] for i in range(n)], dtype=object)
        BXB = B.T.dot(X).dot(B)
        total += sum((BXB[i, i] for i in range(len(BXB))), Fraction(0))
    return total


# --- 60 digits -------------------------------------------------------------------------------------------------------


def long(X: Any) -> Any:
    """Doubles, or fractions, as numbers of 60 digits."""
    X = np.asarray(X)
    result = np.empty(X.shape, dtype=object)
    result.ravel()[:] = [
        mp.mpf(x.numerator) / x.denominator if isinstance(x, Fraction) else mp.mpmathify(x) for x in X.ravel().tolist()
    ]
    return result


def star(X: Any) -> Any:
    """The conjugate transpose."""
    X = X.T.copy()
    X.ravel()[:] = [mp.conj(x) for x in X.ravel()]
    return X


def response(G: tuple[Any, ...], dt: float, w: Any) -> Any:
    """The response of A, B, C, D (60 digits) at w rad/s; inf: D."""
    A, B, C, D = G
    if not len(A) or (not dt and mp.isinf(w)):
        return D
    s = mp.expjpi(mp.mpf(w) * mp.mpf(dt) / mp.pi) if dt else mp.mpc(0, w)
    return D + C.dot(solve(long(np.eye(len(A))) * s - A, B))


def gain_above(M: Any, gamma: Any) -> bool:
    """Whether the largest singular value is above gamma."""
    side = M if M.shape[1] <= M.shape[0] else star(M)
    n = side.shape[1]
    return bool(n) and not positive(long(np.eye(n)) * mp.mpf(gamma) ** 2 - star(side).dot(side))


def spectral_norm(X: Any) -> Any:
    """The largest singular value."""
    if X.shape == (1, 1):
        return abs(X[0, 0])
    return max(mp.svd_c(mp.matrix(X.tolist()), compute_uv=False))


def eigenvalues(A: Any) -> list[Any]:
    """Those of A, in 60 digits."""
    return list(mp.eig(mp.matrix(A.tolist()), left=False, right=False)) if len(A) else []
