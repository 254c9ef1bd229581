# pyright: reportMissingParameterType=false
r"""Compiled arithmetic modulo primes below :math:`2^{27}`, in double precision: products of residues are exact there.

A residue is the one next to zero, of either sign, so its size is at most p / 2 and a product plus a residue below
:math:`2^{53}`. Rows are reduced by multiplying with 1/p and rounding, which compilers turn into vector instructions.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def _residue(t, p, per):
    return t - np.rint(t * per) * p


@njit(cache=True, error_model="numpy")
def _inverse(a, p):
    """``1 / a`` modulo p, by Euclid."""
    above, below = np.int64(p), np.int64(a) % np.int64(p)
    last, found = np.int64(0), np.int64(1)
    while below:
        q = above // below
        above, below = below, above - q * below
        last, found = found, last - q * found
    return _residue(float(last), p, 1.0 / p)


@njit(cache=True, error_model="numpy")
def _subtract(y, f, x, p, per, first):
    """``y -= f x`` from index ``first`` on."""
    for j in range(first, len(y)):
        t = y[j] - f * x[j]
        y[j] = t - np.rint(t * per) * p


@njit(cache=True, error_model="numpy")
def _residues(mantissas, exponents, p):
    """``mantissas * 2^exponents`` modulo p; exponents are not negative."""
    whole, per = np.int64(p), 1.0 / p
    power = np.ones(exponents.max() + 1, dtype=np.int64)
    for i in range(1, len(power)):
        power[i] = 2 * power[i - 1] % whole
    found = np.zeros(mantissas.shape)
    for i in range(mantissas.shape[0]):
        for j in range(mantissas.shape[1]):
            if mantissas[i, j]:
                found[i, j] = _residue(float((mantissas[i, j] % whole) * power[exponents[i, j]] % whole), p, per)
    return found


@njit(cache=True, error_model="numpy")
def _masses(weights, p):
    """``2^weights`` modulo p."""
    found, per = np.ones(len(weights)), 1.0 / p
    for i in range(len(weights)):
        for _ in range(weights[i]):
            found[i] = _residue(2.0 * found[i], p, per)
    return found


@njit(cache=True, error_model="numpy")
def _row_reduced(G, columns, p):
    """Gauss and Jordan's elimination of the first columns, in place: the rank, and the product of the pivots."""
    per, product, rank = 1.0 / p, 1.0, 0
    for c in range(columns):
        r = rank
        while r < len(G) and G[r, c] == 0.0:
            r += 1
        if r == len(G):
            continue
        if r != rank:
            for j in range(c, G.shape[1]):
                G[r, j], G[rank, j] = G[rank, j], G[r, j]
            product = -product
        product = _residue(product * G[rank, c], p, per)
        scale = _inverse(G[rank, c], p)
        for j in range(c, G.shape[1]):
            G[rank, j] = _residue(G[rank, j] * scale, p, per)
        for r in range(len(G)):
            if r != rank and G[r, c] != 0.0:
                _subtract(G[r], G[r, c], G[rank], p, per, c)
        rank += 1
    return rank, product


@njit(cache=True, error_model="numpy")
def _to_hessenberg(H, p):
    """A similar matrix with zeros below its first subdiagonal, in place."""
    n, per = len(H), 1.0 / p
    for c in range(n - 2):
        r = c + 1
        while r < n and H[r, c] == 0.0:
            r += 1
        if r == n:
            continue
        if r != c + 1:
            for j in range(n):
                H[r, j], H[c + 1, j] = H[c + 1, j], H[r, j]
            for j in range(n):
                H[j, r], H[j, c + 1] = H[j, c + 1], H[j, r]
        scale = _inverse(H[c + 1, c], p)
        for i in range(c + 2, n):
            if H[i, c] != 0.0:
                f = _residue(H[i, c] * scale, p, per)
                _subtract(H[i], f, H[c + 1], p, per, c)
                for j in range(n):
                    H[j, c + 1] = _residue(H[j, c + 1] + f * H[j, i], p, per)


@njit(cache=True, error_model="numpy")
def _characteristic(H, p):
    """Coefficients of ``det(x I - H)`` of a Hessenberg matrix, the constant first."""
    n, per = len(H), 1.0 / p
    P = np.zeros((n + 1, n + 1))
    P[0, 0] = 1.0
    for m in range(1, n + 1):
        P[m, 1 : m + 1] = P[m - 1, :m]
        _subtract(P[m], H[m - 1, m - 1], P[m - 1], p, per, 0)
        t = 1.0
        for i in range(m - 1, 0, -1):
            t = _residue(t * H[i, i - 1], p, per)
            if t == 0.0:
                break
            _subtract(P[m], _residue(t * H[i - 1, m - 1], p, per), P[i - 1], p, per, 0)
    return P[n]


@njit(cache=True, error_model="numpy")
def determinants(mantissas, exponents, weights, primes):
    r"""Coefficients of ``det(M - s E)`` modulo each prime, shape (n_primes, n + 1), the constant first.

    ``M = mantissas * 2^exponents`` (k, k), ``E`` diagonal with ``2^weights`` (n,) and then zeros. With t = s - s0,

    .. math:: \det(M - s E) = \det(M - s_0 E) \det(I - t W), \qquad W = (M - s_0 E)^{-1} E,

    of which the leading n rows and columns count. A row is NaN where ``M - s0 E`` is singular.
    """
    k, n = len(mantissas), len(weights)
    found = np.zeros((len(primes), n + 1))
    for q in range(len(primes)):
        p = primes[q]
        per = 1.0 / p
        G = np.zeros((k, k + n))
        G[:, :k] = _residues(mantissas, exponents, p)
        mass = _masses(weights, p)
        s0 = _residue(np.rint(0.6180339887 * p) + 7919.0 * q, p, per)
        for i in range(n):
            G[i, i] = _residue(G[i, i] - _residue(s0 * mass[i], p, per), p, per)
            G[i, k + i] = mass[i]
        rank, scale = _row_reduced(G, k, p)
        if rank < k:
            found[q] = np.nan
            continue
        W = G[:n, k:].copy()
        _to_hessenberg(W, p)
        c = _characteristic(W, p)
        for j in range(n + 1):
            found[q, n - j] = _residue(c[j] * scale, p, per)
        for i in range(n):  # from powers of t to powers of s
            for j in range(n - 1, i - 1, -1):
                found[q, j] = _residue(found[q, j] - s0 * found[q, j + 1], p, per)
    return found


@njit(cache=True, error_model="numpy")
def ranks(mantissas, exponents, weights, primes):
    """Rank of ``M - s E`` modulo each prime at one s; M may have any shape."""
    found = np.zeros(len(primes), dtype=np.int64)
    for q in range(len(primes)):
        p = primes[q]
        per = 1.0 / p
        G = _residues(mantissas, exponents, p)
        columns = mantissas.shape[1]
        s0 = _residue(np.rint(0.3819660113 * p) + 104729.0 * q, p, per)
        mass = _masses(weights, p)
        for i in range(len(weights)):
            G[i, i] = _residue(G[i, i] - _residue(s0 * mass[i], p, per), p, per)
        found[q] = _row_reduced(G, columns, p)[0]
    return found


@njit(cache=True, error_model="numpy")
def common_factors(f, g, primes):
    """Monic greatest common divisors modulo each prime of ``f, g`` (n_primes, .), the constant first, zeros above."""
    found = np.zeros((len(primes), max(f.shape[1], g.shape[1])))
    for q in range(len(primes)):
        p = primes[q]
        per = 1.0 / p
        a, b = f[q].copy(), g[q].copy()
        n, m = len(a) - 1, len(b) - 1
        while n >= 0 and a[n] == 0.0:
            n -= 1
        while m >= 0 and b[m] == 0.0:
            m -= 1
        while m >= 0:
            scale = _inverse(b[m], p)
            while n >= m:
                factor = _residue(a[n] * scale, p, per)
                for j in range(m + 1):
                    a[n - m + j] = _residue(a[n - m + j] - factor * b[j], p, per)
                while n >= 0 and a[n] == 0.0:
                    n -= 1
            a, b, n, m = b, a, m, n
        if n >= 0:
            scale = _inverse(a[n], p)
            for j in range(n + 1):
                found[q, j] = _residue(a[j] * scale, p, per)
    return found
