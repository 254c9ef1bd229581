r"""Compiled parts of the primal-dual method of `robustlab.mu_analysis.primal_dual`, one matrix at a time.

Importing this module imports numba. The matrices have order 2 to 100: too small for calls of LAPACK to pay, so the loops
are written out, the innermost ones over contiguous memory. No result of theirs is trusted: whatever x comes out, the
bound is that of `certificate.certified_level`.
"""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np

# Sums may be taken in any order; NaN and infinity keep their meaning, as the tests for them need it.
OPTIONS = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract", "reassoc", "nsz"}}


class Pattern(NamedTuple):
    """The entries of the sparse E(x) of `ScalingSpace`, and those of the compact D (one number for a full block)."""

    rows: np.ndarray
    cols: np.ndarray
    coefficients: np.ndarray
    in_w: np.ndarray  # 1.0 for the entries of D_w
    first: np.ndarray  # (size + 1,) where each parameter's entries begin
    d_rows: np.ndarray
    d_cols: np.ndarray
    d_coefficients: np.ndarray
    d_first: np.ndarray
    d_blocks: np.ndarray  # (blocks + 1,) where each block of the compact D begins
    owner: np.ndarray  # (size,) block that a parameter of D belongs to; -1 for those of G
    trace: np.ndarray  # (size,) gradient of the trace of the compact D


@nb.njit(**OPTIONS)
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


@nb.njit(**OPTIONS)
def adjoint_product(A, B):
    """``A^* B``."""
    C = np.zeros((A.shape[1], B.shape[1]), dtype=np.complex128)
    for k in range(A.shape[0]):
        for i in range(A.shape[1]):
            a = np.conj(A[k, i])
            for j in range(B.shape[1]):
                C[i, j] += a * B[k, j]
    return C


@nb.njit(**OPTIONS)
def symmetrise(X):
    """Replace X by its Hermitian part."""
    for i in range(len(X)):
        X[i, i] = X[i, i].real
        for j in range(i):
            value = 0.5 * (X[i, j] + np.conj(X[j, i]))
            X[i, j] = value
            X[j, i] = np.conj(value)
    return X


@nb.njit(**OPTIONS)
def inner(X, Y):
    """``tr(X Y)`` of Hermitian matrices."""
    total = 0.0
    for i in range(len(X)):
        for j in range(len(X)):
            total += X[i, j].real * Y[i, j].real + X[i, j].imag * Y[i, j].imag
    return total


@nb.njit(**OPTIONS)
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
                    L[i, j] = value / L[j, j].real
                elif value.real > 1e-15 * X[i, i].real and value.real < np.inf:
                    L[i, i] = np.sqrt(value.real)
                    log += np.log(value.real)
                else:
                    return np.nan
    return log


@nb.njit(**OPTIONS)
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
                R[i, j] /= L[i, i].real
        for k in range(low, high):
            for i in range(low, k + 1):
                a = np.conj(R[k, i])
                for j in range(low, i + 1):
                    P[i, j] += a * R[k, j]
        for i in range(low, high):
            for j in range(low, i):
                P[j, i] = np.conj(P[i, j])
    return P


@nb.njit(**OPTIONS)
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


@nb.njit(**OPTIONS)
def form(x, t, tall, pattern):
    """``U E(x) U^*``, the entries of D_w times t; ``tall`` is ``U^* = [I; M]``."""
    q = tall.shape[1]
    B = np.zeros((len(tall), q), dtype=np.complex128)
    for i in range(len(x)):
        for e in range(pattern.first[i], pattern.first[i + 1]):
            a = pattern.coefficients[e] * x[i]
            if pattern.in_w[e] > 0:
                B[pattern.rows[e], pattern.cols[e]] += a * t
            else:
                row, col = pattern.rows[e], pattern.cols[e]
                for j in range(q):
                    B[row, j] += a * tall[col, j]
    return symmetrise(B[:q] + adjoint_product(tall[q:], B[q:]))


@nb.njit(**OPTIONS)
def d_matrices(x, q, pattern):
    """The compact D, and D_w."""
    n = pattern.d_blocks[-1]
    S = np.zeros((n, n), dtype=np.complex128)
    W = np.zeros((q, q), dtype=np.complex128)
    for i in range(len(x)):
        for e in range(pattern.d_first[i], pattern.d_first[i + 1]):
            S[pattern.d_rows[e], pattern.d_cols[e]] += pattern.d_coefficients[e] * x[i]
        for e in range(pattern.first[i], pattern.first[i + 1]):
            if pattern.in_w[e] > 0:
                W[pattern.rows[e], pattern.cols[e]] += pattern.coefficients[e] * x[i]
    return S, W


@nb.njit(**OPTIONS)
def sandwich(X, tall):
    """``U^* X U``."""
    n, q = tall.shape
    W = np.empty((n, n), dtype=np.complex128)
    J = product(tall[q:], X)
    for i in range(q):
        for j in range(q):
            W[i, j] = X[i, j]
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


@nb.njit(**OPTIONS)
def traces(W, t, pattern):
    """``tr(F_i X)`` of each parameter, from ``W = U^* X U``; the entries of D_w times t."""
    out = np.zeros(len(pattern.trace))
    for i in range(len(out)):
        for e in range(pattern.first[i], pattern.first[i + 1]):
            value = pattern.coefficients[e] * W[pattern.cols[e], pattern.rows[e]]
            out[i] += value.real * (t if pattern.in_w[e] > 0 else 1.0)
    return out


@nb.njit(**OPTIONS)
def w_traces(X, pattern):
    """``tr(D_i X)`` of each parameter for X of the order of D_w."""
    out = np.zeros(len(pattern.trace))
    for i in range(len(out)):
        for e in range(pattern.first[i], pattern.first[i + 1]):
            if pattern.in_w[e] > 0:
                out[i] += (pattern.coefficients[e] * X[pattern.cols[e], pattern.rows[e]]).real
    return out


@nb.njit(**OPTIONS)
def d_traces(X, pattern):
    """``tr(D_i X)`` of each parameter for X of the order of the compact D."""
    out = np.zeros(len(pattern.trace))
    for i in range(len(out)):
        for e in range(pattern.d_first[i], pattern.d_first[i + 1]):
            out[i] += (pattern.d_coefficients[e] * X[pattern.d_cols[e], pattern.d_rows[e]]).real
    return out


@nb.njit(**OPTIONS)
def curvature(V, W, t, T, Y, pattern):
    """``Re tr(F_i P F_j Z) + Re tr(D_i S^-1 D_j Y)`` from ``V = U^* P U``, ``W = U^* Z U``, ``T = S^-1``; lower half."""
    n = len(pattern.trace)
    c = pattern.coefficients.copy()
    for e in range(len(c)):
        if pattern.in_w[e] > 0:
            c[e] *= t
    H = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for e in range(pattern.first[i], pattern.first[i + 1]):
                row, col, a = pattern.rows[e], pattern.cols[e], c[e]
                for f in range(pattern.first[j], pattern.first[j + 1]):
                    total += (a * V[col, pattern.rows[f]] * (c[f] * W[pattern.cols[f], row])).real
            if pattern.owner[i] >= 0 and pattern.owner[i] == pattern.owner[j]:
                for e in range(pattern.d_first[i], pattern.d_first[i + 1]):
                    row, col, a = pattern.d_rows[e], pattern.d_cols[e], pattern.d_coefficients[e]
                    for f in range(pattern.d_first[j], pattern.d_first[j + 1]):
                        other = pattern.d_coefficients[f] * Y[pattern.d_cols[f], row]
                        total += (a * T[col, pattern.d_rows[f]] * other).real
            H[i, j] = total
    return H


@nb.njit(**OPTIONS)
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


@nb.njit(**OPTIONS)
def newton_solve(H, scale, right):
    """Solution for one right-hand side."""
    n = len(H)
    y = right * scale
    for i in range(n):
        value = y[i]
        for k in range(i):
            value -= H[i, k] * y[k]
        y[i] = value / H[i, i]
    for i in range(n - 1, -1, -1):
        y[i] /= H[i, i]
        for k in range(i):
            y[k] -= H[i, k] * y[i]
    return y * scale


@nb.njit(**OPTIONS)
def longest(X, dX, bend, blocks, S, dS, d_blocks, top, halvings):
    """Largest step up to ``top`` (by bisection) that keeps ``X + a dX + a^2 bend`` and ``S + a dS`` positive definite."""
    L, K = np.zeros_like(X), np.zeros_like(S)
    low, high, a = 0.0, top, top
    for _ in range(3 * halvings):
        inside = np.isfinite(factor(S + a * dS, d_blocks, K))
        if inside:
            inside = np.isfinite(factor(X + a * dX + a * a * bend, blocks, L))
        if inside:
            low = a
        else:
            high = a
        # A step was found and is known to a part of 2^-halvings of the longest one thinkable.
        if low == top or (low > 0 and high - low <= top * 0.5**halvings):
            break
        a = 0.5 * (low + high)
    return low


@nb.njit(**OPTIONS)
def centre(x, t, tall, pattern, dual, dual_d):
    """Newton steps for the analytic centre at t; the dual pair Z, Y of the last one is feasible. Steps, or -1."""
    q = tall.shape[1]
    whole = np.array([0, q])
    for count in range(30):
        S, _ = d_matrices(x, q, pattern)
        F = form(x, t, tall, pattern)
        L, K = np.zeros_like(F), np.zeros_like(S)
        value = -factor(F, whole, L) - factor(S, pattern.d_blocks, K)
        if not np.isfinite(value):
            return -1
        P, T = inverse(L, whole), inverse(K, pattern.d_blocks)
        V = sandwich(P, tall)
        H = curvature(V, V, t, T, T, pattern)
        scale, good = newton_factor(H)
        if not good:
            return -1
        down = traces(V, t, pattern) + d_traces(T, pattern)
        dx, keep = newton_solve(H, scale, down), newton_solve(H, scale, pattern.trace)
        dx -= (pattern.trace @ dx) / (pattern.trace @ keep) * keep
        dF = form(dx, t, tall, pattern)
        dS, _ = d_matrices(dx, q, pattern)
        if down @ dx < 0.8:
            dual[:] = symmetrise(P - product(product(P, dF), P))
            dual_d[:] = symmetrise(
                T - block_product(block_product(T, dS, pattern.d_blocks), T, pattern.d_blocks)
            )
            return count + 1
        # The longest step, then shorter ones as long as they lead further down.
        a = 0.9 * longest(F, dF, np.zeros_like(F), whole, S, dS, pattern.d_blocks, 4.0, 4)
        best, best_a = value, 0.0
        for _ in range(20):
            trial = -factor(F + a * dF, whole, L) - factor(S + a * dS, pattern.d_blocks, K)
            if trial < best:
                best, best_a = trial, a
            elif best_a > 0:
                break
            a *= 0.6
        if best_a == 0:
            return -1
        x += best_a * dx
    return -1


@nb.njit(**OPTIONS)
def allowance(x, t, tall, S, T, pattern):
    """How much rounding can blur t, with D scaled to a unit diagonal (an estimate that picks the best iterate)."""
    q = tall.shape[1]
    n = len(tall)
    scale = np.ones(n)
    for i in range(len(x)):
        for e in range(pattern.first[i], pattern.first[i + 1]):
            if pattern.rows[e] == pattern.cols[e] and pattern.owner[i] >= 0:
                scale[pattern.rows[e]] = 1 / np.sqrt(x[i])
    plant, supply = 0.0, 0.0
    for i in range(n - q):
        for j in range(q):
            plant += abs(tall[q + i, j]) ** 2 * (scale[j] / scale[q + i]) ** 2
    for i in range(len(x)):
        if pattern.owner[i] < 0:
            for e in range(pattern.first[i], pattern.first[i + 1]):
                supply += abs(x[i] * scale[pattern.rows[e]] * scale[pattern.cols[e]]) ** 2
    smallest = 0.0
    for i in range(len(S)):
        smallest = max(smallest, S[i, i].real * T[i, i].real)
    return 1e-14 * q * smallest * (plant + np.sqrt(supply * plant))


@nb.njit(**OPTIONS)
def advance(x, t, tall, pattern, state, gap):
    """One predictor-corrector step of x, Z and Y in place: success, change of t, primal and dual step length."""
    F, S, Dw, P, T, Z, Y = state
    q, blocks = tall.shape[1], pattern.d_blocks
    whole = np.array([0, q])
    V, W = sandwich(P, tall), sandwich(Z, tall)
    H = curvature(V, W, t, T, Y, pattern)
    scale, good = newton_factor(H)
    if not good:
        return False, 0.0, 0.0, 0.0
    X = symmetrise(product(product(P, Dw), Z))
    b = traces(sandwich(X, tall), t, pattern) - w_traces(Z, pattern)
    Hb, Hc = newton_solve(H, scale, b), newton_solve(H, scale, pattern.trace)
    # Schur complement of the two remaining unknowns: dt, and the multiplier of the fixed trace.
    tt = inner(X, Dw) - b @ Hb
    tc, cc = -(b @ Hc), -(pattern.trace @ Hc)
    determinant = tt * cc - tc * tc
    if not determinant != 0:
        return False, 0.0, 0.0, 0.0
    centring = traces(V, t, pattern) + d_traces(T, pattern)
    centring_t = inner(P, Dw)
    zero, zero_d = np.zeros_like(F), np.zeros_like(S)
    bend, twist, twist_d = zero, zero, zero_d
    dx, dt, dS, dDw, dZ, dY, line = x, 0.0, zero_d, zero, zero, zero_d, zero
    nu = 0.0
    for attempt in range(2):
        right, right_t = nu * centring, nu * centring_t - 1.0
        if attempt == 1:
            C = symmetrise(product(P, product(bend, Z) + twist))
            right -= traces(sandwich(C, tall), t, pattern) + d_traces(twist_d, pattern)
            right_t -= inner(C, Dw)
            right += dt * w_traces(dZ, pattern)
            right_t += inner(dZ, dDw)
        y = newton_solve(H, scale, right)
        r1, r2 = right_t - b @ y, -(pattern.trace @ y)
        dt = (r1 * cc - tc * r2) / determinant
        dx = y - Hb * dt - Hc * ((tt * r2 - tc * r1) / determinant)
        dS, dDw = d_matrices(dx, q, pattern)
        line = form(dx, t, tall, pattern) + dt * Dw
        dF = line + bend
        dZ = nu * P - Z - symmetrise(product(P, product(dF, Z) + twist))
        dY = nu * T - Y - symmetrise(block_product(block_product(T, dS, blocks), Y, blocks)) - twist_d
        if attempt == 0:
            ap = longest(F, line, zero, whole, S, dS, blocks, 1.0, 4)
            ad = longest(Z, dZ, zero, whole, Y, dY, blocks, 1.0, 4)
            ahead = inner(F + ap * line, Z + ad * dZ) + inner(S + ap * dS, Y + ad * dY)
            ratio = min(max(ahead / gap, 0.0), 1.0)
            sigma = min(max(ratio**2, 1e-3 if min(ap, ad) > 0.9 else 0.05), 0.9)
            nu = sigma * gap / (q + blocks[-1])
            bend = dt * dDw
            twist = product(dF, dZ)
            twist_d = symmetrise(block_product(block_product(T, dS, blocks), dY, blocks))
    bend = dt * dDw
    ap = min(1.0, 0.96 * longest(F, line, bend, whole, S, dS, blocks, 1.05, 5))
    ad = min(1.0, 0.96 * longest(Z, dZ, zero, whole, Y, dY, blocks, 1.05, 5))
    x += ap * dx
    Z += ad * dZ
    Y += ad * dY
    return True, ap * dt, ap, ad


@nb.njit(**OPTIONS)
def descend(x, t, tall, pattern, tol, goal, max_steps):
    """Follow the central path down from x, t; the best x, its t, and the number of Newton systems."""
    q, nd = tall.shape[1], pattern.d_blocks[-1]
    whole = np.array([0, q])
    Z = np.zeros((q, q), dtype=np.complex128)
    Y = np.zeros((nd, nd), dtype=np.complex128)
    best_x, best_t = x.copy(), np.inf
    steps, restarts, short = 0, 0, True
    while steps < max_steps:
        if short:
            restarts += 1
            used = centre(x, t, tall, pattern, Z, Y)
            if used < 0 or restarts > 4:
                break
            steps += used
            S, Dw = d_matrices(x, q, pattern)
            size = inner(Z, Dw)
            Z /= size
            Y /= size
        S, Dw = d_matrices(x, q, pattern)
        F = form(x, t, tall, pattern)
        L, K = np.zeros_like(F), np.zeros_like(S)
        if not np.isfinite(factor(F, whole, L) + factor(S, pattern.d_blocks, K)):
            break
        P, T = inverse(L, whole), inverse(K, pattern.d_blocks)
        level = t + allowance(x, t, tall, S, T, pattern)
        if level < best_t:
            best_t = level
            best_x[:] = x
        gap = inner(Z, F) + inner(Y, S)
        if best_t <= max(goal, 0.0) or gap <= tol * abs(t) or t < -1.0:
            break
        ok, move, ap, ad = advance(x, t, tall, pattern, (F, S, Dw, P, T, Z, Y), gap)
        steps += 1
        if not ok:
            break
        t += move
        short = min(ap, ad) < 0.05
        if not short and t - 2 * gap > goal and goal > 0:
            break
    return best_x, best_t, steps
