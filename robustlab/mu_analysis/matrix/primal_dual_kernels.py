# pyright: reportMissingParameterType=false
r"""Compiled parts of the primal-dual method of `robustlab.mu_analysis.matrix.interior_point`, one matrix at a time.

Importing this module imports numba. The matrices have order 2 to 100: too small for calls of LAPACK to pay, so the
loops are written out, the innermost ones over contiguous memory. No result of theirs is trusted: whatever x comes out,
the bound is that of `certificate.certified_level`.

All of it is one file because numba's cache asks for changes in the file of the function that is called, no other.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba as nb
import numpy as np

FAST = {"contract", "reassoc", "nsz"}  # sums in any order; NaN and infinity keep their meaning: tests need it
ENTRY: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": FAST}
# The others are called from compiled code only: without entrances from Python they compile in half the time. For the
# same reason sums of arrays are written as loops; numba compiles a kernel of its own for each array expression.
INSIDE: dict[str, Any] = ENTRY | {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}

# Weight of |G|^2 beside the barrier: where mu = 0 without any doubt, G would grow without bound.
SHORT_G = 1e-4


class Point(NamedTuple):
    """F and ``S = D_w`` at one x and t, and their inverses P and T."""

    F: np.ndarray
    S: np.ndarray
    P: np.ndarray
    T: np.ndarray


class System(NamedTuple):
    """Newton system: factor H of the part of x, borders b and its solutions, and the 2 x 2 Schur complement."""

    H: np.ndarray
    scale: np.ndarray
    b: np.ndarray
    Hb: np.ndarray
    Hc: np.ndarray
    tt: float
    tc: float
    cc: float
    centring: np.ndarray
    centring_t: float


class Second(NamedTuple):
    """Products of two steps, which a Newton step leaves out and the corrector puts back."""

    bend: np.ndarray  # dt dD_w, in F
    twist: np.ndarray  # dF dZ
    twist_d: np.ndarray  # T dS dY
    push: np.ndarray  # dt <dZ, D_i>
    push_t: float  # <dZ, dD_w>


class Direction(NamedTuple):
    """Change of all unknowns, and of F to first order."""

    dx: np.ndarray
    dt: float
    dF: np.ndarray
    dS: np.ndarray
    dZ: np.ndarray
    dY: np.ndarray


@nb.njit(**INSIDE)
def product(A, B):
    """``A B``."""
    n, inner = A.shape
    C = np.zeros((n, B.shape[1]), dtype=np.complex128)
    for i in range(n):
        for k in range(inner):
            a = A[i, k]
            for j in range(B.shape[1]):
                C[i, j] += a * B[k, j]
    return C


@nb.njit(**INSIDE)
def along(X, a, Y):
    """``X + a Y``."""
    C = np.empty(X.shape, dtype=np.complex128)
    for i in range(X.shape[0]):
        for j in range(X.shape[1]):
            C[i, j] = X[i, j] + a * Y[i, j]
    return C


@nb.njit(**INSIDE)
def dot(x, y):
    """Scalar product."""
    total = 0.0
    for i in range(len(x)):
        total += x[i] * y[i]
    return total


@nb.njit(**INSIDE)
def shift(x, a, y):
    """``x += a y`` in place."""
    for i in range(len(x)):
        x[i] += a * y[i]


@nb.njit(**INSIDE)
def symmetrise(X):
    """Replace X by its Hermitian part."""
    for i in range(len(X)):
        X[i, i] = X[i, i].real
        for j in range(i):
            value = 0.5 * (X[i, j] + np.conj(X[j, i]))
            X[i, j] = value
            X[j, i] = np.conj(value)
    return X


@nb.njit(**INSIDE)
def inner(X, Y):
    """``tr(X Y)`` of Hermitian matrices."""
    total = 0.0
    for i in range(len(X)):
        for j in range(len(X)):
            total += X[i, j].real * Y[i, j].real + X[i, j].imag * Y[i, j].imag
    return total


@nb.njit(**INSIDE)
def factor(X, blocks, L):
    """Cholesky factor of each diagonal block into L; its log-determinant, or NaN where X is not positive definite."""
    log = 0.0
    for b in range(len(blocks) - 1):
        low, high = blocks[b], blocks[b + 1]
        for i in range(low, high):
            for j in range(low, i + 1):
                value = X[i, j]
                for k in range(low, j):
                    value -= L[i, k] * np.conj(L[j, k])
                if j < i:
                    L[i, j] = value * (1 / L[j, j].real)
                elif value.real > 1e-15 * X[i, i].real and value.real < np.inf:
                    L[i, i] = np.sqrt(value.real)
                    log += np.log(value.real)
                else:
                    return np.nan
    return log


@nb.njit(**INSIDE)
def inverse(L, blocks):
    """``(L L^*)^-1`` for a block-diagonal Cholesky factor."""
    n = len(L)
    R = np.zeros((n, n), dtype=np.complex128)
    P = np.zeros((n, n), dtype=np.complex128)
    for b in range(len(blocks) - 1):
        low, high = blocks[b], blocks[b + 1]
        for i in range(low, high):
            for k in range(low, i):
                a = L[i, k]
                for j in range(low, k + 1):
                    R[i, j] -= a * R[k, j]
            R[i, i] = 1.0
            for j in range(low, i + 1):
                R[i, j] *= 1 / L[i, i].real
        for k in range(low, high):
            for i in range(low, k + 1):
                a = np.conj(R[k, i])
                for j in range(low, i + 1):
                    P[i, j] += a * R[k, j]
        for i in range(low, high):
            for j in range(low, i):
                P[j, i] = np.conj(P[i, j])
    return P


@nb.njit(**INSIDE)
def block_product(A, B, blocks):
    """``A B`` of block-diagonal matrices."""
    C = np.zeros_like(A)
    for b in range(len(blocks) - 1):
        for i in range(blocks[b], blocks[b + 1]):
            for k in range(blocks[b], blocks[b + 1]):
                a = A[i, k]
                for j in range(blocks[b], blocks[b + 1]):
                    C[i, j] += a * B[k, j]
    return C


@nb.njit(**INSIDE)
def form(x, t, tall, pattern):
    """``U E(x) U^*``, the entries of D_w times t; ``tall`` is ``U^* = [I; M]``."""
    q = tall.shape[1]
    B = np.zeros((len(tall), q), dtype=np.complex128)
    for i in range(len(x)):
        for e in range(pattern.first[i], pattern.first[i + 1]):
            a = pattern.coefficients[e] * x[i]
            row, col = pattern.rows[e], pattern.cols[e]
            if row < q and col < q:
                B[row, col] += a * t
            else:
                for j in range(q):
                    B[row, j] += a * tall[col, j]
    lower = np.zeros((q, q), dtype=np.complex128)  # M^* times the rows of z
    for k in range(q, len(tall)):
        for i in range(q):
            a = np.conj(tall[k, i])
            for j in range(q):
                lower[i, j] += a * B[k, j]
    return symmetrise(along(B[:q], 1.0, lower))


@nb.njit(**INSIDE)
def d_form(x, pattern):
    """``D_w(x)``."""
    q = pattern.blocks[-1]
    W = np.zeros((q, q), dtype=np.complex128)
    for i in range(len(x)):
        for e in range(pattern.first[i], pattern.first[i + 1]):
            if pattern.rows[e] < q and pattern.cols[e] < q:
                W[pattern.rows[e], pattern.cols[e]] += pattern.coefficients[e] * x[i]
    return W


@nb.njit(**INSIDE)
def sandwich(X, tall):
    """``U^* X U``."""
    n, q = tall.shape
    W = np.empty((n, n), dtype=np.complex128)
    for i in range(q):
        for j in range(q):
            W[i, j] = X[i, j]
    J = product(tall[q:], X)
    for i in range(n - q):
        for j in range(q):
            W[q + i, j] = J[i, j]
            W[j, q + i] = np.conj(J[i, j])
    for i in range(n - q):
        for j in range(i + 1):
            value = 0j
            for k in range(q):
                value += J[i, k] * np.conj(tall[q + j, k])
            W[q + i, q + j] = value
            W[q + j, q + i] = np.conj(value)
    return W


@nb.njit(**INSIDE)
def traces(W, t, pattern):
    """``tr(F_i X)`` of each parameter, from ``W = U^* X U``; the entries of D_w times t."""
    q = pattern.blocks[-1]
    out = np.zeros(len(pattern.trace))
    for i in range(len(out)):
        for e in range(pattern.first[i], pattern.first[i + 1]):
            row, col = pattern.rows[e], pattern.cols[e]
            out[i] += (pattern.coefficients[e] * W[col, row]).real * (t if row < q and col < q else 1.0)
    return out


@nb.njit(**INSIDE)
def d_traces(X, pattern):
    """``tr(D_i X)`` of each parameter."""
    q = pattern.blocks[-1]
    out = np.zeros(len(pattern.trace))
    for i in range(len(out)):
        for e in range(pattern.first[i], pattern.first[i + 1]):
            if pattern.rows[e] < q and pattern.cols[e] < q:
                out[i] += (pattern.coefficients[e] * X[pattern.cols[e], pattern.rows[e]]).real
    return out


@nb.njit(**INSIDE)
def curvature(V, W, t, T, Y, pattern, short):
    """``Re tr(F_i P F_j Z) + Re tr(D_i T D_j Y)`` from ``V = U^* P U`` and ``W = U^* Z U``; lower half.

    With the curvature of ``short |G|^2 / 2``.
    """
    n, q = len(pattern.trace), pattern.blocks[-1]
    rows, cols, first, owner = pattern.rows, pattern.cols, pattern.first, pattern.owner
    c = np.empty(len(rows), dtype=np.complex128)
    for e in range(len(c)):
        c[e] = pattern.coefficients[e] * (t if rows[e] < q and cols[e] < q else 1.0)
    H = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for e in range(first[i], first[i + 1]):
                row, col, a = rows[e], cols[e], c[e]
                for f in range(first[j], first[j + 1]):
                    total += (a * V[col, rows[f]] * (c[f] * W[cols[f], row])).real
            if owner[i] >= 0 and owner[i] == owner[j]:
                for e in range(first[i], first[i + 1]):
                    for f in range(first[j], first[j + 1]):
                        if rows[e] < q and rows[f] < q:
                            a = pattern.coefficients[e] * T[cols[e], rows[f]]
                            total += (a * pattern.coefficients[f] * Y[cols[f], rows[e]]).real
            H[i, j] = total
        if owner[i] < 0:
            H[i, i] += short
    return H


@nb.njit(**INSIDE)
def g_part(x, pattern):
    """The parameters of G; zeros in place of those of D."""
    out = np.empty(len(x))
    for i in range(len(x)):
        out[i] = x[i] if pattern.owner[i] < 0 else 0.0
    return out


@nb.njit(**INSIDE)
def centring(x, t, V, T, pattern):
    """Downward slope of the barrier at x, from ``V = U^* P U`` and T."""
    down = traces(V, t, pattern)
    shift(down, 1.0, d_traces(T, pattern))
    shift(down, -SHORT_G, g_part(x, pattern))
    return down


@nb.njit(**INSIDE)
def newton_factor(H):
    """Cholesky factor of H in diagonal scaling, in place, and the scaling; directions without curvature stay put."""
    n = len(H)
    scale = np.empty(n)
    largest = 0.0
    for i in range(n):
        largest = max(largest, H[i, i])
    for i in range(n):
        flat = not H[i, i] > 1e-14 * largest
        scale[i] = 1 / np.sqrt(largest if flat else H[i, i])
        for j in range(i):
            H[i, j] *= scale[i] * scale[j]
        H[i, i] = H[i, i] * scale[i] ** 2 + 1e-13 + (1.0 if flat else 0.0)
    for i in range(n):
        for j in range(i + 1):
            value = H[i, j]
            for k in range(j):
                value -= H[i, k] * H[j, k]
            if j < i:
                H[i, j] = value / H[j, j]
            elif value > 0 and value < np.inf:
                H[i, i] = np.sqrt(value)
            else:
                return scale, False
    return scale, True


@nb.njit(**INSIDE)
def newton_solve(H, scale, right):
    """Solution for one right-hand side."""
    n = len(H)
    y = np.empty(n)
    for i in range(n):
        value = right[i] * scale[i]
        for k in range(i):
            value -= H[i, k] * y[k]
        y[i] = value / H[i, i]
    for i in range(n - 1, -1, -1):
        y[i] /= H[i, i]
        for k in range(i):
            y[k] -= H[i, k] * y[i]
    for i in range(n):
        y[i] *= scale[i]
    return y


@nb.njit(**INSIDE)
def longest(X, dX, bend, S, dS, blocks, top, halvings):
    """Largest step a up to ``top``, by bisection, with ``X + a dX + a^2 bend > 0`` and ``S + a dS > 0``."""
    L, whole = np.zeros_like(X), np.array([0, len(X)])
    low, high, a = 0.0, top, top
    for _ in range(3 * halvings):
        inside = np.isfinite(factor(along(S, a, dS), blocks, L))
        inside = inside and np.isfinite(factor(along(along(X, a, dX), a * a, bend), whole, L))
        low, high = (a, high) if inside else (low, a)
        # A step was found and is known to a part of 2^-halvings of the longest one thinkable.
        if low == top or (low > 0 and high - low <= top * 0.5**halvings):
            break
        a = 0.5 * (low + high)
    return low


@nb.njit(**INSIDE)
def evaluate(x, t, tall, pattern):
    """The point at x and t, and its barrier (NaN where F or D is not positive definite: no inverses then)."""
    q = tall.shape[1]
    S = d_form(x, pattern)
    F = form(x, t, tall, pattern)
    L, K, whole = np.zeros_like(F), np.zeros_like(S), np.array([0, q])
    barrier = -factor(F, whole, L) - factor(S, pattern.blocks, K)
    if np.isfinite(barrier):
        return Point(F, S, inverse(L, whole), inverse(K, pattern.blocks)), barrier
    return Point(F, S, L, K), barrier


@nb.njit(**INSIDE)
def descent(point, dF, dS, barrier, blocks, linear, square):
    """A step along dF, dS that lowers the barrier well: the longest, then shorter ones as long as they do better."""
    F, S = point.F, point.S
    L, K, whole = np.zeros_like(F), np.zeros_like(S), np.array([0, len(F)])
    a = 0.9 * longest(F, dF, L.copy(), S, dS, blocks, 4.0, 4)
    best, best_a = barrier, 0.0
    for _ in range(20):
        trial = -factor(along(F, a, dF), whole, L) - factor(along(S, a, dS), blocks, K)
        trial += a * linear + a * a * square
        if trial < best:
            best, best_a = trial, a
        elif best_a > 0:
            break
        a *= 0.6
    return best_a


@nb.njit(**INSIDE)
def centre(x, t, tall, pattern):
    """Newton steps of x, in place, to the analytic centre at t: their number, or -1, and feasible Z and Y there."""
    q, blocks = tall.shape[1], pattern.blocks
    none = np.zeros((q, q), dtype=np.complex128)
    for count in range(30):
        point, barrier = evaluate(x, t, tall, pattern)
        if not np.isfinite(barrier):
            break
        P, T = point.P, point.T
        V = sandwich(P, tall)
        H = curvature(V, V, t, T, T, pattern, SHORT_G)
        scale, good = newton_factor(H)
        if not good:
            break
        down = centring(x, t, V, T, pattern)
        dx, keep = newton_solve(H, scale, down), newton_solve(H, scale, pattern.trace)
        shift(dx, -dot(pattern.trace, dx) / dot(pattern.trace, keep), keep)
        dF = form(dx, t, tall, pattern)
        dS = d_form(dx, pattern)
        if dot(down, dx) < 0.8:
            whole = np.array([0, q])
            # Z = P - P dF P is positive definite for a decrement below one, and on the tangent of all constraints.
            pair = along(P, -1.0, product(product(P, dF), P))
            pair_d = along(T, -1.0, block_product(block_product(T, dS, blocks), T, blocks))
            size = inner(pair, point.S)
            if not (size > 0 and np.isfinite(factor(pair, whole, none.copy()))):
                break
            return count + 1, along(none, 1 / size, symmetrise(pair)), along(none, 1 / size, symmetrise(pair_d))
        G, dG = g_part(x, pattern), g_part(dx, pattern)
        a = descent(point, dF, dS, barrier, blocks, SHORT_G * dot(G, dG), 0.5 * SHORT_G * dot(dG, dG))
        if a == 0:
            break
        shift(x, a, dx)
    return -1, none, none


@nb.njit(**INSIDE)
def allowance(x, tall, point, pattern):
    """How far rounding can blur t, with D scaled to a unit diagonal (an estimate: it picks the best iterate)."""
    n, q = tall.shape
    scale = np.ones(n)
    for i in range(len(x)):
        for e in range(pattern.first[i], pattern.first[i + 1]):
            if pattern.rows[e] == pattern.cols[e]:
                scale[pattern.rows[e]] = 1 / np.sqrt(x[i])
    # Row sums of |M|^T |D_z| |M| + |G| |M| + |M|^T |G|^T: products with a vector of ones.
    through, inward, rows = np.zeros(n), np.zeros(n), np.zeros(q)
    for i in range(q, n):
        for j in range(q):
            through[i] += abs(tall[i, j]) * scale[j] / scale[i]
    for i in range(len(x)):
        for e in range(pattern.first[i], pattern.first[i + 1]):
            row, col = pattern.rows[e], pattern.cols[e]
            size = abs(pattern.coefficients[e] * x[i]) * scale[row] * scale[col]
            if row >= q:
                inward[row] += size * (through[col] if col >= q else 1.0)
            elif col >= q:
                rows[row] += size * through[col]
    largest, smallest = 0.0, 0.0
    for j in range(q):
        for i in range(q, n):
            rows[j] += abs(tall[i, j]) * scale[j] / scale[i] * inward[i]
        largest = max(largest, rows[j])
        smallest = max(smallest, point.S[j, j].real * point.T[j, j].real)
    return 4e-15 * n * smallest * largest


@nb.njit(**INSIDE)
def newton_system(x, t, tall, pattern, point, Z, Y, nu):
    """The factorised system in dx, and what is left of it for dt and the multiplier of the fixed trace."""
    V, W = sandwich(point.P, tall), sandwich(Z, tall)
    H = curvature(V, W, t, point.T, Y, pattern, nu * SHORT_G)
    scale, good = newton_factor(H)
    X = symmetrise(product(product(point.P, point.S), Z))
    b = traces(sandwich(X, tall), t, pattern)
    shift(b, -1.0, d_traces(Z, pattern))
    Hb, Hc = newton_solve(H, scale, b), newton_solve(H, scale, pattern.trace)
    tt, tc, cc = inner(X, point.S) - dot(b, Hb), -dot(b, Hc), -dot(pattern.trace, Hc)
    good = good and tt * cc - tc * tc != 0
    return System(H, scale, b, Hb, Hc, tt, tc, cc, centring(x, t, V, point.T, pattern), inner(point.P, point.S)), good


@nb.njit(**INSIDE)
def direction(tall, t, pattern, system, point, Z, Y, nu, second):
    """Newton direction to the point of the central path with ``F Z = nu I``; ``second`` holds terms of second order."""
    blocks, P, T = pattern.blocks, point.P, point.T
    C = symmetrise(product(P, along(product(second.bend, Z), 1.0, second.twist)))
    right = second.push.copy()
    shift(right, nu, system.centring)
    shift(right, -1.0, traces(sandwich(C, tall), t, pattern))
    shift(right, -1.0, d_traces(second.twist_d, pattern))
    right_t = nu * system.centring_t - 1.0 + second.push_t - inner(C, point.S)
    y = newton_solve(system.H, system.scale, right)
    r1, r2 = right_t - dot(system.b, y), -dot(pattern.trace, y)
    determinant = system.tt * system.cc - system.tc * system.tc
    dt = (r1 * system.cc - system.tc * r2) / determinant
    dx = y.copy()
    shift(dx, -dt, system.Hb)
    shift(dx, -(system.tt * r2 - system.tc * r1) / determinant, system.Hc)
    dS = d_form(dx, pattern)
    dF = along(form(dx, t, tall, pattern), dt, point.S)
    curved = along(product(along(dF, 1.0, second.bend), Z), 1.0, second.twist)
    dZ = along(along(Z, 1.0, symmetrise(product(P, curved))), -nu, P)
    dY = along(symmetrise(block_product(block_product(T, dS, blocks), Y, blocks)), 1.0, second.twist_d)
    dY = along(along(dY, 1.0, Y), -nu, T)
    zero = np.zeros_like(dZ)
    return Direction(dx, dt, dF, dS, along(zero, -1.0, dZ), along(zero, -1.0, dY))


@nb.njit(**INSIDE)
def advance(x, t, tall, pattern, point, Z, Y, gap):
    """One predictor-corrector step, of x in place: change of t, the shorter of both step lengths, and Z, Y after it."""
    blocks, F, S = pattern.blocks, point.F, point.S
    q, zero = len(F), np.zeros_like(F)
    system, good = newton_system(x, t, tall, pattern, point, Z, Y, gap / (2 * q))
    if not good:
        return np.nan, 0.0, Z, Y
    second = Second(zero, zero, zero, np.zeros(len(x)), 0.0)
    d = direction(tall, t, pattern, system, point, Z, Y, 0.0, second)
    ap = longest(F, d.dF, zero, S, d.dS, blocks, 1.0, 4)
    ad = longest(Z, d.dZ, zero, Y, d.dY, blocks, 1.0, 4)
    ahead = inner(along(F, ap, d.dF), along(Z, ad, d.dZ)) + inner(along(S, ap, d.dS), along(Y, ad, d.dY))
    ratio = min(max(ahead / gap, 0.0), 1.0)
    nu = min(max(ratio**2, 1e-3 if min(ap, ad) > 0.9 else 0.05), 0.9) * gap / (2 * q)
    twist_d = symmetrise(block_product(block_product(point.T, d.dS, blocks), d.dY, blocks))
    push = np.zeros(len(x))
    shift(push, d.dt, d_traces(d.dZ, pattern))
    second = Second(along(zero, d.dt, d.dS), product(d.dF, d.dZ), twist_d, push, inner(d.dZ, d.dS))
    d = direction(tall, t, pattern, system, point, Z, Y, nu, second)
    bend = along(zero, d.dt, d.dS)
    ap = min(1.0, 0.96 * longest(F, d.dF, bend, S, d.dS, blocks, 1.05, 5))
    ad = min(1.0, 0.96 * longest(Z, d.dZ, zero, Y, d.dY, blocks, 1.05, 5))
    shift(x, ap, d.dx)
    return ap * d.dt, min(ap, ad), along(Z, ad, d.dZ), along(Y, ad, d.dY)


@nb.njit(**ENTRY)
def descend(x, t, tall, pattern, tol, goal, max_steps):
    """The best x down the central path from x, t, and whether its t is the optimum within ``tol``.

    Or its goal was reached, or shown out of reach.
    """
    Z = Y = np.zeros((tall.shape[1], tall.shape[1]), dtype=np.complex128)
    best_x, best_t = x.copy(), np.inf
    steps, restarts, short, settled = 0, 0, True, False
    last, left = np.inf, np.inf
    while steps < max_steps:
        if short:
            restarts += 1
            if restarts > 4:
                break
            used, Z, Y = centre(x, t, tall, pattern)
            if used < 0:
                break
            steps += used
        point, barrier = evaluate(x, t, tall, pattern)
        if not np.isfinite(barrier):
            break
        reached = t + allowance(x, tall, point, pattern)
        if reached < best_t:
            best_t = reached
            best_x = x.copy()
        gap = inner(Z, point.F) + inner(Y, point.S)
        # A D far from I makes the gap lie: the steps of t have to die out too.
        settled = best_t <= max(goal, 0.0) or (gap <= tol * t and left <= 3 * tol * t)
        settled = settled or (goal > 0 and t - 2 * gap - left > goal)
        if settled:
            break
        move, length, Z, Y = advance(x, t, tall, pattern, point, Z, Y, gap)
        if not np.isfinite(move):
            break
        t += move
        ratio = min(abs(move / last), 0.95)
        left, last = abs(move) * ratio / (1 - ratio), move
        steps += 1
        short = length < 0.05
    return best_x, settled
