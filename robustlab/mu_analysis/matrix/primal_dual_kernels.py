# pyright: reportMissingParameterType=false
r"""Compiled parts of the primal-dual method of `robustlab.mu_analysis.matrix.upper`, one matrix at a time.

Importing this module imports numba. The matrices have order 2 to 100: too small for LAPACK calls, so the loops are
written out, the innermost ones over contiguous memory. No result is trusted: for any x the bound is that of
`upper.certified_level`.

To keep numba's compilation short, nothing is allocated here, few types of arrays are passed, and kernels are called
from as few levels as possible. The arrays are

W
    ``(10, 2, q, q)``: pairs of Hermitian matrices: F with ``S = D_w``, and Z, the dual of F, with Y, that of S. Those
    of S are block diagonal, ``low[1]`` has the first row of the block of each row (``low[0]`` is zero).
J
    ``(3, n, n)``: products ``U^* X U`` with ``U^* = [I; M]``, ``n = q + p``.
H
    Newton matrix, then its Cholesky factor.
V
    Real vectors: an element for each parameter (in ACROSS and BACK for each row of E), then zeros.
M
    The matrix (p, q).
c
    Coefficients of the entries of the sparse E(x); in row 1 those of D_w times t.
entries
    For each entry of E, in the order of the parameters: row, column, parameter; for those of D_w the first entry in its
    block of S (-1 for all others).

Matrices of W and vectors of V are given by their index: ``product(W, A, P, DX)`` is ``A = P dX``.

Everything is in one file because numba's cache checks only the file of the called function for changes.
"""

from __future__ import annotations

import math
from typing import Any

import numba as nb
import numpy as np

# No fast mathematics: contraction and order of sums would depend on inlining, so freshly compiled code (which calls the
# kernels separately) and the same code from the cache would differ in their last bits.
ENTRY: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
# The others are called from compiled code only: without Python wrappers they compile in half the time. The cache holds
# `descend` including all of them.
INSIDE: dict[str, Any] = ENTRY | {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
# Parts of `descend` with one caller: as separate kernels their callees would be optimised again.
PART: dict[str, Any] = INSIDE | {"inline": "always"}

# Indices are numpy integers: for a Python integer numba makes a separate type and kernel.
MATRICES, VECTORS = 10, 13
# (F, S), its inverse (P, T), the duals (Z, Y); the steps of the first and the third; D_w at the position of F, and its
# step there times that of t; terms of second order in the dual; workspace for products.
X, P, Z, DX, DZ, D, BEND, SECOND, A, B = np.arange(MATRICES)
# x, its step, the best x; gradient of the trace of D_w; weight of |x|^2 added to the barrier; downward slope of the
# barrier; border of H, and the solutions for it and for the trace; terms of second order; scaling of H; two of sums.
AT, STEP, BEST, TRACE, SHORT, DOWN, BORDER, BY_BORDER, BY_TRACE, BENT, SCALE, ACROSS, BACK = np.arange(VECTORS)
ROW, COL, OF, BEGIN = np.arange(4)  # in entries
AT_P, AT_Z, ROOM = np.arange(3)  # in J: of P, and of Z or a product; workspace for their rows

SHORT_G = 1e-4  # weight of |G|^2 added to the barrier: where mu = 0, G would grow without bound
# For `sure` the dual must exclude a t smaller by this many tolerances, or the gap must be this much finer, since
# degenerate duals exclude nothing even at the optimum.
SURE, FINER = 10.0, 0.01
# Longest step along the tangent in gaps: the gap is an estimate, and longer steps lose digits.
LONG = 8.0


@nb.njit(**INSIDE)
def combine(W, out, a, x, b, y):
    """``a X + b Y``."""
    for h in range(2):
        for i in range(W.shape[2]):
            for j in range(W.shape[2]):
                W[out, h, i, j] = a * W[x, h, i, j] + b * W[y, h, i, j]


@nb.njit(**INSIDE)
def product(W, out, x, y):
    """``X Y``."""
    n = W.shape[2]
    for h in range(2):
        for i in range(n):
            for j in range(n):
                W[out, h, i, j] = 0.0
            for k in range(n):
                a = W[x, h, i, k]
                if a != 0.0:
                    for j in range(n):
                        W[out, h, i, j] += a * W[y, h, k, j]


@nb.njit(**INSIDE)
def symmetrise(W, x):
    """Replace X by its Hermitian part."""
    for h in range(2):
        for i in range(W.shape[2]):
            for j in range(i + 1):
                value = 0.5 * (W[x, h, i, j] + W[x, h, j, i].conjugate())
                W[x, h, i, j] = value
                W[x, h, j, i] = value.conjugate()


@nb.njit(**INSIDE)
def inner(W, x, y):
    """``tr(X Y)`` of Hermitian matrices."""
    total = 0.0
    for h in range(2):
        for i in range(W.shape[2]):
            for j in range(W.shape[2]):
                total += W[x, h, i, j].real * W[y, h, i, j].real + W[x, h, i, j].imag * W[y, h, i, j].imag
    return total


@nb.njit(**INSIDE)
def raise_small(W, out, a, x):
    """Put the second matrix of X, times a, into the place of the first."""
    for i in range(W.shape[2]):
        for j in range(W.shape[2]):
            W[out, 0, i, j] = a * W[x, 1, i, j]


@nb.njit(**INSIDE)
def lower_large(W, out, a, x, low):
    """Add to the blocks of the second matrix their positions in the first one of X, times a."""
    for i in range(W.shape[2]):
        for j in range(low[1, i], i + 1):
            W[out, 1, i, j] += a * W[x, 0, i, j]
            W[out, 1, j, i] = W[out, 1, i, j].conjugate()


@nb.njit(**INSIDE)
def factor(W, x, low):
    """Cholesky factor of X in its place; False where X is not positive definite."""
    for h in range(2):
        for i in range(W.shape[2]):
            for j in range(low[h, i], i + 1):
                value = W[x, h, i, j]
                for k in range(low[h, i], j):
                    value -= W[x, h, i, k] * W[x, h, j, k].conjugate()
                if j < i:
                    W[x, h, i, j] = value * (1 / W[x, h, j, j].real)
                elif value.real > 1e-15 * W[x, h, i, i].real and value.real < np.inf:
                    W[x, h, i, i] = math.sqrt(value.real)
                else:
                    return False
    return True


@nb.njit(**INSIDE)
def inverse(W, out, x, room, low):
    """``(L L^*)^-1`` for the Cholesky factor L in X; room receives the inverse of L."""
    for h in range(2):
        for i in range(W.shape[2]):
            for j in range(W.shape[2]):
                W[room, h, i, j] = W[out, h, i, j] = 0.0
            for k in range(low[h, i], i):
                a = W[x, h, i, k]
                for j in range(low[h, i], k + 1):
                    W[room, h, i, j] -= a * W[room, h, k, j]
            W[room, h, i, i] = 1.0
            for j in range(low[h, i], i + 1):
                W[room, h, i, j] *= 1 / W[x, h, i, i].real
        for k in range(W.shape[2]):
            for i in range(low[h, k], k + 1):
                a = W[room, h, k, i].conjugate()
                for j in range(low[h, k], i + 1):
                    W[out, h, i, j] += a * W[room, h, k, j]
        for i in range(W.shape[2]):
            for j in range(low[h, i], i):
                W[out, h, j, i] = W[out, h, i, j].conjugate()


@nb.njit(**INSIDE)
def form(W, out, J, V, x, M, c, entries):
    """``U E(x) U^*``, and ``D_w(x)``."""
    p, q = M.shape
    for i in range(q):
        for j in range(q):
            W[out, 1, i, j] = 0.0
    for i in range(q + p):
        for j in range(q):
            J[1, i, j] = 0.0
    for e in range(c.shape[1]):
        row, col, value = entries[ROW, e], entries[COL, e], V[x, entries[OF, e]]
        if col < q:
            J[1, row, col] += value * c[1, e]
        else:
            for j in range(q):
                J[1, row, j] += value * c[1, e] * M[col - q, j]
        if entries[BEGIN, e] >= 0:
            W[out, 1, row, col] += value * c[0, e]
    for i in range(q):
        for j in range(q):
            W[out, 0, i, j] = J[1, i, j]
    for k in range(p):
        for i in range(q):
            a = M[k, i].conjugate()
            for j in range(q):
                W[out, 0, i, j] += a * J[1, q + k, j]


@nb.njit(**INSIDE)
def sandwich(W, x, J, out, M):
    """``U^* X U`` of the first matrix of X."""
    p, q = M.shape
    for i in range(q):
        for j in range(q):
            J[out, i, j] = W[x, 0, i, j]
    for i in range(q, q + p):
        for j in range(q):
            J[out, i, j] = 0.0
        for k in range(q):
            for j in range(q):
                J[out, i, j] += M[i - q, k] * W[x, 0, k, j]
        for j in range(q):
            J[out, j, i] = J[out, i, j].conjugate()
        for j in range(q, i + 1):
            value = 0j
            for k in range(q):
                value += J[out, i, k] * M[j - q, k].conjugate()
            J[out, i, j] = value
            J[out, j, i] = value.conjugate()


@nb.njit(**INSIDE)
def traces(W, x, J, at, V, out, c, entries):
    """``tr(F_i X) + tr(D_i Y)`` of each parameter, from ``U^* X U`` in J and Y, the second matrix of X."""
    for i in range(V.shape[1]):
        V[out, i] = 0.0
    for e in range(c.shape[1]):
        row, col = entries[ROW, e], entries[COL, e]
        value = c[1, e] * J[at, col, row]
        if entries[BEGIN, e] >= 0:
            value += c[0, e] * W[x, 1, col, row]
        V[out, entries[OF, e]] += value.real


@nb.njit(**INSIDE)
def curvature(W, J, H, c, entries):
    """``Re tr(F_i P F_j Z) + Re tr(D_i T D_j Y)`` from ``U^* P U`` and ``U^* Z U`` in J; lower half."""
    end = 0
    for i in range(len(H)):
        for j in range(i + 1):
            H[i, j] = 0.0
    for e in range(c.shape[1]):
        row, col, i, begin = entries[ROW, e], entries[COL, e], entries[OF, e], entries[BEGIN, e]
        while end < c.shape[1] and entries[OF, end] == i:
            end += 1
        for k in range(J.shape[1]):
            J[ROOM, 0, k] = c[1, e] * J[AT_P, col, k]
            J[ROOM, 1, k] = J[AT_Z, row, k].conjugate()
        for f in range(end):
            value = J[ROOM, 0, entries[ROW, f]] * J[ROOM, 1, entries[COL, f]]
            H[i, entries[OF, f]] += c[1, f].real * value.real - c[1, f].imag * value.imag
        if begin >= 0:
            for f in range(begin, end):
                if entries[BEGIN, f] == begin:
                    value = c[0, e] * W[P, 1, col, entries[ROW, f]]
                    value *= c[0, f] * W[Z, 1, row, entries[COL, f]].conjugate()
                    H[i, entries[OF, f]] += value.real


@nb.njit(**INSIDE)
def dot(V, x, y):
    total = 0.0
    for i in range(V.shape[1]):
        total += V[x, i] * V[y, i]
    return total


@nb.njit(**INSIDE)
def shift(V, x, a, y):
    """``x += a y`` in place."""
    for i in range(V.shape[1]):
        V[x, i] += a * V[y, i]


@nb.njit(**INSIDE)
def newton_factor(H, V, short):
    """Factor H by Cholesky in diagonal scaling, in place; directions without curvature are fixed."""
    n, largest = len(H), 0.0
    for i in range(n):
        H[i, i] += short * V[SHORT, i]
        largest = max(largest, H[i, i])
    for i in range(n):
        flat = not H[i, i] > 1e-14 * largest
        V[SCALE, i] = 1 / math.sqrt(largest if flat else H[i, i])
        for j in range(i):
            H[i, j] *= V[SCALE, i] * V[SCALE, j]
        H[i, i] = 1e-13 + (1.0 if flat else 0.0) + H[i, i] * V[SCALE, i] * V[SCALE, i]
    # H = L' L from the last row up: the remainder changes along rows, from their beginnings, which compiles to the
    # widest operations; the sums of products of the usual order do not, as they may not be reordered.
    for k in range(n - 1, -1, -1):
        if not (H[k, k] > 0 and H[k, k] < np.inf):
            return False
        H[k, k] = math.sqrt(H[k, k])
        for j in range(k):
            H[k, j] /= H[k, k]
        for i in range(k):
            a = H[k, i]
            for j in range(i + 1):
                H[i, j] -= a * H[k, j]
    return True


@nb.njit(**INSIDE)
def newton_solve(H, V, out, right):
    """Solution for one right-hand side."""
    n = len(H)
    for i in range(n):
        V[out, i] = V[right, i] * V[SCALE, i]
    for k in range(n - 1, -1, -1):
        V[out, k] /= H[k, k]
        for i in range(k):
            V[out, i] -= H[k, i] * V[out, k]
    for i in range(n):
        value = V[out, i]
        for k in range(i):
            value -= H[i, k] * V[out, k]
        V[out, i] = value / H[i, i]
    for i in range(n):
        V[out, i] *= V[SCALE, i]


@nb.njit(**INSIDE)
def longest(W, x, dx, bend, low, top, close):
    """Largest step a up to ``top``, by bisection, with ``X + a dX + a^2 bend BEND > 0``."""
    good, bad, a = 0.0, top, top
    for _ in range(15):
        combine(W, A, 1.0, x, a, dx)
        combine(W, A, 1.0, A, a * a * bend, BEND)
        if factor(W, A, low):
            good = a
        else:
            bad = a
        # The step is known to a small part of the longest possible one.
        if good == top or (good > 0 and bad - good <= close * top):
            break
        a = 0.5 * (good + bad)
    return good


@nb.njit(**PART)
def evaluate(W, J, V, M, c, entries, low, t):
    """F, S and their inverses at x and t; False where they are not positive definite."""
    for e in range(c.shape[1]):
        c[1, e] = c[0, e] * (t if entries[BEGIN, e] >= 0 else 1.0)
    form(W, X, J, V, AT, M, c, entries)
    symmetrise(W, X)
    raise_small(W, D, 1.0, X)
    combine(W, A, 1.0, X, 0.0, X)
    good = factor(W, A, low)
    if good:
        inverse(W, P, A, B, low)
    return good


@nb.njit(**INSIDE)
def allowance(W, V, M, c, entries):
    """Estimate the rounding error of t, with D scaled to a unit diagonal (to select the best iterate)."""
    p, q = M.shape
    widest, largest = 0.0, 0.0
    for i in range(q):
        size = W[X, 1, i, i].real
        V[ACROSS, i] = 1 / math.sqrt(size)
        widest = max(widest, size * W[P, 1, i, i].real)
    # Row sums of |U| |E(x)| |U^*|: products with a vector of ones.
    for k in range(p):
        V[ACROSS, q + k] = 0.0
        for j in range(q):
            V[ACROSS, q + k] += (abs(M[k, j].real) + abs(M[k, j].imag)) * V[ACROSS, j]
    for i in range(q + p):
        V[BACK, i] = 0.0
    for e in range(c.shape[1]):
        size = (abs(c[1, e].real) + abs(c[1, e].imag)) * abs(V[AT, entries[OF, e]])
        V[BACK, entries[ROW, e]] += size * V[ACROSS, entries[COL, e]]
    for j in range(q):
        for k in range(p):
            V[BACK, j] += (abs(M[k, j].real) + abs(M[k, j].imag)) * V[BACK, q + k]
        largest = max(largest, V[BACK, j] * V[ACROSS, j])
    return 4e-15 * (q + p) * widest * largest


@nb.njit(**PART)
def newton_system(W, J, H, V, M, c, entries, low, nu):
    """The factorised system in dx, bordered by dt and the multiplier of the fixed trace."""
    sandwich(W, P, J, AT_P, M)
    sandwich(W, Z, J, AT_Z, M)
    curvature(W, J, H, c, entries)
    good = newton_factor(H, V, nu)
    traces(W, P, J, AT_P, V, DOWN, c, entries)
    for i in range(V.shape[1]):
        V[DOWN, i] -= V[SHORT, i] * V[AT, i]
        V[BENT, i] = 0.0
    combine(W, SECOND, 0.0, P, 0.0, P)
    product(W, A, P, D)
    product(W, B, A, Z)
    symmetrise(W, B)
    tt = inner(W, B, D)
    lower_large(W, B, -1.0, Z, low)
    sandwich(W, B, J, AT_Z, M)
    traces(W, B, J, AT_Z, V, BORDER, c, entries)
    newton_solve(H, V, BY_BORDER, BORDER)
    newton_solve(H, V, BY_TRACE, TRACE)
    return tt if good else np.nan


@nb.njit(**PART)
def direction(W, J, H, V, M, c, entries, low, nu, tt, bent):
    """Newton direction to the point of the central path with ``F Z = nu I``, and its change of t."""
    for i in range(V.shape[1]):
        V[STEP, i] = nu * V[DOWN, i] + V[BENT, i]
    newton_solve(H, V, STEP, STEP)
    tt -= dot(V, BORDER, BY_BORDER)
    tc, cc = -dot(V, BORDER, BY_TRACE), -dot(V, TRACE, BY_TRACE)
    r1 = nu * inner(W, P, D) - 1.0 + bent - dot(V, BORDER, STEP)
    r2 = -dot(V, TRACE, STEP)
    dt = (r1 - tc / cc * r2) / (tt - tc / cc * tc)
    shift(V, STEP, -dt, BY_BORDER)
    shift(V, STEP, -(r2 - tc * dt) / cc, BY_TRACE)
    form(W, DX, J, V, STEP, M, c, entries)
    combine(W, DX, 1.0, DX, dt, D)
    product(W, A, DX, Z)
    product(W, B, P, A)
    symmetrise(W, B)
    combine(W, DZ, nu, P, -1.0, Z)
    combine(W, DZ, 1.0, DZ, -1.0, B)
    combine(W, DZ, 1.0, DZ, -1.0, SECOND)
    return dt


@nb.njit(**PART)
def second_order(W, J, V, M, c, entries, low, dt):
    """Compute the products of two steps for the corrector; return that in t."""
    raise_small(W, BEND, 1.0, DX)
    bent = inner(W, DZ, BEND)
    product(W, A, BEND, Z)
    product(W, B, DX, DZ)
    combine(W, A, dt, A, 1.0, B)
    product(W, SECOND, P, A)
    symmetrise(W, SECOND)
    combine(W, A, -1.0, SECOND, 0.0, SECOND)
    lower_large(W, A, dt, DZ, low)
    sandwich(W, A, J, AT_Z, M)
    traces(W, A, J, AT_Z, V, BENT, c, entries)
    return bent - inner(W, SECOND, D)


@nb.njit(**PART)
def tangent(W, J, V, M, c, entries, down):
    """Step along the path of centres to a t smaller by ``down``, from a centre and the factorised system there."""
    share = down * dot(V, BORDER, BY_TRACE) / dot(V, TRACE, BY_TRACE)
    for i in range(V.shape[1]):
        V[STEP, i] = down * V[BY_BORDER, i] - share * V[BY_TRACE, i]
    form(W, DX, J, V, STEP, M, c, entries)
    combine(W, DX, 1.0, DX, -down, D)


@nb.njit(**INSIDE)
def beyond(W, down, gap, low):
    """Return whether Z and Y exclude a t smaller by ``down``."""
    combine(W, A, 1.0, Z, 0.0, Z)
    lower_large(W, A, down, Z, low)
    for i in range(W.shape[2]):
        W[A, 1, i, i] -= gap / W.shape[2]
    return factor(W, A, low)


@nb.njit(**INSIDE)
def ended(W, t, best_t, gap, left, blur, tol, goal, careful, sure, low):
    """Return whether the descent ends: goal reached or excluded, optimum, or no digits left."""
    if best_t <= goal or best_t <= 0 or (careful and blur > gap):
        return True
    if goal > 0 and t - 2 * gap - left > goal and (not sure or beyond(W, t - goal, gap, low)):
        return True
    # With D far from I the gap is unreliable: the steps of t must also converge.
    if gap > tol * t or left > 3 * tol * t:
        return False
    return not sure or (careful and gap <= FINER * tol * t) or beyond(W, SURE * tol * t, gap, low)


@nb.njit(**PART)
def follow(W, J, V, M, c, entries, low, t, gap):
    """Step along the tangent of the path of centres as far as x stays feasible, nearly; returns its change of t."""
    down = min(t, LONG * gap)
    tangent(W, J, V, M, c, entries, down)
    raise_small(W, BEND, -down, DX)
    a, far = 1.0, np.inf
    while a < far:  # along a curved path points before a feasible step need not be feasible
        far = longest(W, X, DX, 1.0, low, a, 0.1 / LONG)
        a = far if far == a and a < 1.0 else 0.9 * far
    shift(V, AT, a, STEP)
    return -a * down


@nb.njit(cache=True, **ENTRY)
def descend(W, J, H, V, M, c, entries, low, t, tol, goal, max_steps, sure):
    """Follow the central path from x, t, with the best x in V; return whether its t is optimal within ``tol``."""
    best_t, last, left, gap = np.inf, np.inf, np.inf, 0.0
    dt = ap = ad = 0.0
    steps, careful, centred, settled = 0, False, False, False
    shift(V, BEST, 1.0, AT)
    while steps < max_steps and evaluate(W, J, V, M, c, entries, low, t):
        steps += 1
        if centred:
            gap, blur = inner(W, Z, X), allowance(W, V, M, c, entries)
            if t + blur < best_t:
                best_t = t + blur
                shift(V, BEST, -1.0, BEST)
                shift(V, BEST, 1.0, AT)
            settled = ended(W, t, best_t, gap, left, blur, tol, goal, careful, sure, low)
            if settled:
                break
            if gap <= tol * t and left <= 3 * tol * t and not careful:
                careful, centred, left = True, False, np.inf
        if centred:
            mean, nu, far = gap / (2 * W.shape[2]), 0.0, 1.05
        else:
            # With Z = P and t fixed, the Newton step is that of the barrier, and Z + dZ meets all constraints.
            combine(W, Z, 1.0, P, 0.0, P)
            mean, nu, far = 1.0, 1.0, 4.0
        tt, bent = newton_system(W, J, H, V, M, c, entries, low, mean), 0.0
        if centred and careful:
            dt = follow(W, J, V, M, c, entries, low, t, gap)
            if not 0 < abs(dt) < np.inf:
                break
            t, left, centred = t + dt, -dt, False
            continue
        if not centred:
            tt += np.inf
        for corrected in range(2):
            dt = direction(W, J, H, V, M, c, entries, low, nu, tt, bent)
            raise_small(W, BEND, dt, DX)
            close = 0.032 if corrected else 0.063
            ap, ad = longest(W, X, DX, 1.0, low, far, close), longest(W, Z, DZ, 0.0, low, far, close)
            if corrected or not centred:
                break
            ahead = inner(W, DX, Z) / gap * ap + inner(W, X, DZ) / gap * ad + inner(W, DX, DZ) / gap * ap * ad + 1
            least = 1e-3 if min(ap, ad) > 0.9 else 0.05
            ahead = max(ahead, 0.0)
            nu = mean * min(max(ahead * ahead, least), 0.9)
            bent = second_order(W, J, V, M, c, entries, low, dt)
        if not abs(dt) < np.inf:
            break
        if centred:
            ap, ad = min(0.96 * ap, 1.0), min(0.96 * ad, 1.0)
            shift(V, AT, ap, STEP)
            combine(W, Z, 1.0, Z, ad, DZ)
            t += ap * dt
            ratio = min(abs(ap * dt / last), 0.95)
            left, last = abs(ap * dt) * ratio / (1 - ratio), ap * dt
            if min(ap, ad) < 0.05:
                careful, centred = True, False
        elif dot(V, DOWN, STEP) < 0.8:
            # Z + dZ is positive definite for a decrement below one.
            size = 1 / (inner(W, P, D) + inner(W, DZ, D))
            combine(W, Z, size, P, size, DZ)
            centred = True
        else:
            shift(V, AT, max(min(0.7 * ap, 1.0), 0.5 * ap), STEP)
    return settled
