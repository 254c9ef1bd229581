"""The judge of claims about multipliers and about moving parameters: in rationals and 60 digits, as in `verify_judge`.

The checker looks at one matrix inequality in the state space; here members are closed in rationals, and the inequality
of integral quadratic constraints is evaluated from transfer functions, without P. The checker looks at Bernstein
coefficients; here the dissipation inequality is evaluated at places in the cells, plant and controller interpolated.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import numpy as np
from mpmath import mp
from verify_exact import Exact, Quad, eye, is_stable, long, norm_below, positive, rational, response, solve, star

Numbers = dict[str, Any]
CONSTANT, VARYING, SECTOR, SLOPE = range(4)
REAL, COMPLEX, FULL = range(3)
MEMBERS = 8  # constant members that are closed
PLACES = 6  # within each cell
CELLS = 6


# --- integral quadratic constraints ----------------------------------------------------------------------------------


def of_multipliers(kind: str, numbers: Numbers, G: Quad, proved: bool, rng: np.random.Generator) -> str:
    """A claim about blocks with natures: the middle, linear members, classes, and the inequality over frequency."""
    table = np.asarray(numbers["blocks"]).tolist()
    size = Fraction(float(numbers["size"])) if kind == "iqc-size" else Fraction(1)
    try:
        middle = member(G, table, centre(numbers, table))
    except ZeroDivisionError:
        return "false: the middle is not well posed" if proved else ""
    if not is_stable(middle[0], 0.0):
        return "false: the middle is not stable" if proved else ""
    if not proved:
        return "unconfirmed: the middle is stable"
    gamma = Fraction(float(numbers["gamma"])) if kind == "iqc-gain" else None
    for _ in range(MEMBERS):
        try:
            one = member(G, table, drawn(numbers, table, size, rng))
        except ZeroDivisionError:
            return "false: a member is not well posed"
        if not is_stable(one[0], 0.0):
            return "false: a linear member is not stable"
        if gamma is not None and len(one[0]) <= 4 and not norm_below(one, 0.0, gamma):
            return "false: a linear member has a larger gain"
    return classes(numbers, table) or over_frequency(numbers, table, G, size, gamma)


def halves(numbers: Numbers, i: int) -> tuple[Fraction, Fraction]:
    """Middle and half width of a range."""
    a, b = (Fraction(float(x)) for x in numbers["ranges"][i])
    return (a + b) / 2, (b - a) / 2


def blockwise(table: Any) -> Iterator[tuple[int, int, slice, slice]]:
    """Index, kind, rows in w and in z of each block."""
    row = col = 0
    for i, (kind, rows, cols) in enumerate(table):
        yield i, kind, slice(row, row + rows), slice(col, col + cols)
        row, col = row + rows, col + cols


def centre(numbers: Numbers, table: Any) -> Exact:
    """The Delta of all middles."""
    delta = rational(np.zeros((sum(t[1] for t in table), sum(t[2] for t in table))))
    for i, kind, w, z in blockwise(table):
        if kind == REAL:
            delta[w, z] = halves(numbers, i)[0] * eye(w.stop - w.start)
    return delta


def drawn(numbers: Numbers, table: Any, size: Fraction, rng: np.random.Generator) -> Exact:
    """A constant member: real blocks at an end, or within; a gain of one elsewhere."""
    delta = centre(numbers, table)
    for i, kind, w, z in blockwise(table):
        share = Fraction(int(rng.choice([-8, -8, 8, 8, int(rng.integers(-8, 9))])), 8) * size
        if kind == REAL:
            delta[w, z] = delta[w, z] + share * halves(numbers, i)[1] * eye(w.stop - w.start)
        elif kind == COMPLEX:
            delta[w, z] = share * eye(w.stop - w.start)
        else:
            delta[int(rng.integers(w.start, w.stop)), int(rng.integers(z.start, z.stop))] = share
    return delta


def member(G: Quad, table: Any, delta: Exact) -> Quad:
    """The performance channel with this Delta; ZeroDivisionError: not well posed."""
    A, B, C, D = G
    q, p = delta.shape
    inner = solve(eye(p) - D[:p, :q].dot(delta), np.hstack([C[:p], D[:p, q:]])) if p else np.hstack([C[:0], D[:0, q:]])
    n = len(A)
    whole = np.block([[A, B[:, q:]], [C[p:], D[p:, q:]]]) + np.vstack([B[:, :q], D[p:, :q]]).dot(delta).dot(inner)
    return whole[:n, :n], whole[:n, n:], whole[n:, :n], whole[n:, n:]


def classes(numbers: Numbers, table: Any) -> str:
    """Whether each nature is one of a block of this kind."""
    for i, (kind, rows, cols) in enumerate(table):
        what, odd, steady = (int(x) for x in numbers["nature"][i])
        a, b = (float(x) for x in numbers["ranges"][i])
        m, k = (float(x) for x in numbers["slope"][i])
        rate = float(numbers["rate"][i])
        law = what in (SECTOR, SLOPE)
        if (kind != FULL and rows != cols) or what not in range(4) or odd not in (0, 1) or steady not in (0, 1):
            return f"unjustified: block {i} is none"
        if (law and (kind != REAL or rows != 1)) or (what == SLOPE and not m <= a < b <= k):
            return f"unjustified: block {i} is no law of its slope"
        if not (a < b if kind == REAL else (a, b) == (-1, 1)) or not rate > 0:
            return f"unjustified: the range or rate of block {i}"
        if math.isfinite(rate) and (what != VARYING or kind != REAL):
            return f"unjustified: a rate of block {i}"
    return "" if float(numbers["pole"]) > 0 and 0 <= int(numbers["order"]) <= 8 else "unjustified: pole or order"


class Wrong(Exception):
    """A multiplier that is none of its class."""


class Reader:
    """The numbers of multipliers, one after the other, as fractions."""

    def __init__(self, values: Any) -> None:
        self.values, self.at = rational(values).tolist(), 0

    def take(self, count: int) -> list[Fraction]:
        if self.at + count > len(self.values):
            raise Wrong("too few numbers")
        self.at += count
        return self.values[self.at - count : self.at]

    def symmetric(self, n: int) -> Exact:
        """From an upper triangle; positive definite."""
        X, entries = rational(np.zeros((n, n))), iter(self.take(n * (n + 1) // 2))
        for i in range(n):
            for j in range(i, n):
                X[i, j] = X[j, i] = next(entries)
        if not positive(X):
            raise Wrong("a matrix that is not positive definite")
        return X

    def skew(self, n: int) -> Exact:
        X, entries = rational(np.zeros((n, n))), iter(self.take(n * (n - 1) // 2))
        for i in range(n):
            for j in range(i + 1, n):
                X[i, j] = next(entries)
                X[j, i] = -X[i, j]
        return X


def over_frequency(numbers: Numbers, table: Any, G: Quad, size: Fraction, gamma: Fraction | None) -> str:
    """The inequality from transfer functions, in 60 digits, at frequencies on a grid and next to poles."""
    poles = np.abs(np.linalg.eigvals(G[0].astype(float))) if len(G[0]) else np.ones(1)
    scale = max(float(poles.max()), float(numbers["pole"]), 1e-3)
    points = [0.0, 1e9 * scale, float(numbers["pole"]), *poles.tolist(), *np.geomspace(1e-2, 1e2, 7).tolist()]
    model = tuple(map(long, G))
    for w in points:
        try:
            F = inequality(numbers, table, model, size, gamma, mp.mpf(w))
        except Wrong as wrong:
            return f"unjustified: {wrong}"
        if not positive(F):
            return f"unjustified: the inequality does not hold at {w} rad/s"
    return ""


def inequality(numbers: Numbers, table: Any, G: Any, size: Fraction, gamma: Fraction | None, w: Any) -> Any:
    """gamma^2 |u|^2 - |y|^2 - all constraints as a Hermitian matrix of (w, u, r)."""
    q, p = sum(t[1] for t in table), sum(t[2] for t in table)
    m = G[3].shape[1]
    extra = sum(
        int(numbers["order"]) * t[2] for t, nature, rate in zip(table, numbers["nature"], numbers["rate"], strict=True)
        if nature[0] == VARYING and math.isfinite(rate)
    )  # fmt: skip
    one = long(np.eye(m + extra))
    half = long(np.eye(q))
    for i, kind, ws, _ in blockwise(table):
        reach = size * (halves(numbers, i)[1] if kind == REAL else 1)
        half[ws, ws] = half[ws, ws] * (mp.mpf(reach.numerator) / reach.denominator)
    M, C = response(G, 0.0, w), long(centre(numbers, table))
    into = half.dot(one[:q])  # w - C z
    z = solve(long(np.eye(p)) - M[:p, :q].dot(C), M[:p, :q].dot(into) + M[:p, q:].dot(one[q:m])) if p else one[:0]
    y = M[p:, :q].dot(C.dot(z) + into) + M[p:, q:].dot(one[q:m])
    F = -star(y).dot(y)
    if gamma is not None:
        F = F + (mp.mpf(gamma.numerator) / gamma.denominator) ** 2 * star(one[q:m]).dot(one[q:m])
    reader, s = Reader(numbers["multipliers"]), mp.mpc(0, w)
    rows = [any(x != 0 for x in line[:q]) for line in G[3][:p]], [any(x != 0 for x in line) for line in G[3][:p]]
    left = m
    for i, kind, ws, zs in blockwise(table):
        what, odd, steady = (int(x) for x in numbers["nature"][i])
        if what in (SECTOR, SLOPE):
            direct = bool(rows[0][zs.start]), bool(rows[1][zs.start])
            F = F - law(reader, numbers, i, z[zs], one[ws], s, bool(odd), bool(steady), direct)
            continue
        rate = float(numbers["rate"][i])
        order = 0 if what == VARYING and math.isinf(rate) else int(numbers["order"])
        count = order * (zs.stop - zs.start) if what == VARYING and order else 0
        rho = None
        if count:
            exact = Fraction(rate) / halves(numbers, i)[1] / size
            rho = mp.mpf(exact.numerator) / exact.denominator
        F = F - linear(reader, numbers, kind, order, z[zs], one[ws], s, rho, one[left : left + count])
        left += count
    if reader.at != len(reader.values):
        raise Wrong("more numbers than multipliers")
    return F


def form(left: Any, X: Any, right: Any) -> Any:
    return star(left).dot(X).dot(right)


def linear(reader: Reader, numbers: Numbers, kind: int, order: int, z: Any, w: Any, s: Any, rho: Any, r: Any) -> Any:
    a, k = mp.mpf(float(numbers["pole"])), len(z)
    low = a / (s + a)
    above, below, last = [z], [w], w
    for j in range(1, order + 1):
        above.append(low**j * z)
        last = low * last + (rho / (s + a) * r[(j - 1) * k : j * k] if rho is not None else 0 * last)
        below.append(last)
    n = (order + 1) * (1 if kind == FULL else k)
    X = long(reader.symmetric(n))
    over, under = (np.kron(X, np.eye(len(v), dtype=int)) if kind == FULL else X for v in (z, w))
    above, below = np.vstack(above), np.vstack(below)
    S = form(above, over, above) - form(below, under, below)
    if kind == REAL:
        cross = form(above, long(reader.skew(n)), below)
        S = S + cross + star(cross)
    if rho is not None:
        slow, n = above[k:], order * k
        X, Y = long(reader.symmetric(n)), long(reader.skew(n))
        cross = form(slow, Y, r)
        S = S + form(slow, X, slow) - form(r, X, r) + cross + star(cross)
    return S


def law(
    reader: Reader, numbers: Numbers, i: int, z: Any, w: Any, s: Any, odd: bool, steady: bool, direct: tuple[bool, bool]
) -> Any:
    """The constraints of a law; ``direct``: whether z depends at once on a block, on any input."""
    slope = int(numbers["nature"][i][0]) == SLOPE
    S = 0 * star(z).dot(z)
    if direct[0] and not slope:
        raise Wrong("an algebraic loop around a law without a slope")
    if not direct[0]:
        S = S + long(reader.symmetric(1))[0, 0] * (star(z).dot(z) - star(w).dot(w))
    if not direct[1] and steady:
        pair = long(np.array(reader.take(1)))[0] * star(s * z).dot(w)
        S = S + pair + star(pair)
    if not slope:
        return S
    middle, half = halves(numbers, i)
    m, k = (long(np.array([(Fraction(float(x)) - middle) / half]))[0] for x in numbers["slope"][i])
    p, q = k * z - w, w - m * z
    order = int(numbers["order"]) if steady else 0
    (direct_part,) = reader.take(1)
    low, mass = mp.mpf(float(numbers["pole"])) / (s + mp.mpf(float(numbers["pole"]))), Fraction(0)
    responses = []
    for _ in range(2 if order else 0):
        h = mp.mpc(0)
        for sign in (1, -1) if odd else (1,):
            for shift in range(min(order, 2)):
                Q = reader.symmetric((order - 1 - shift) // 2 + 1)
                for a, b in np.ndindex(*Q.shape):
                    # a e^-at (at)^l / (i! j!) has the transform l! / (i! j!) low^(l + 1) and the integral l! / (i! j!)
                    power = a + b + shift
                    c = Q[a, b] * Fraction(math.factorial(power), math.factorial(a) * math.factorial(b))
                    mass += c
                    h += sign * mp.mpf(c.numerator) / c.denominator * low ** (power + 1)
        responses.append(h)
    if not direct_part > mass:
        raise Wrong("a kernel above its norm")
    total = long(np.array([direct_part]))[0] - (responses[0] + mp.conj(responses[1]) if responses else 0)
    pair = total * star(p).dot(q)
    return S + pair + star(pair)


# --- moving parameters -----------------------------------------------------------------------------------------------


def of_parameters(numbers: Numbers, rng: np.random.Generator) -> str:
    """A claim that was proved: frozen models and the dissipation inequality at places of the box, in rationals."""
    rates = np.asarray(numbers["rate"])
    k, P, gamma = len(rates), rational(numbers["P"]), Fraction(float(numbers["gamma"]))
    points = [[Fraction(float(x)) for x in numbers[f"points{i}"]] for i in range(k)]
    if any(not a < b for line in points for a, b in itertools.pairwise(line)) or (rates < 0).any():
        return "unjustified: points that do not ascend, or a negative rate"
    varies = [size > 1 for size in P.shape[:k]]
    if any(v and math.isinf(rate) for v, rate in zip(varies, rates, strict=True)):
        return "unjustified: P varies with a parameter that may jump"
    cells = list(np.ndindex(*(len(line) - 1 for line in points)))
    for index in rng.permutation(len(cells))[:CELLS]:
        cell = cells[int(index)]
        for place in range(PLACES):
            shares = [
                Fraction(int(rng.integers(0, 9)), 8) if place else Fraction(int(rng.integers(0, 2))) for _ in cell
            ]
            word = _at_a_place(numbers, P, points, varies, cell, shares, gamma, rng)
            if word:
                return word
    return ""


def interpolated(stack: Any, cell: Any, shares: Any) -> Any:
    """A multi-linear stack at a place of a cell."""
    total = 0
    for corner in itertools.product((0, 1), repeat=len(cell)):
        weight = math.prod((x if c else 1 - x for c, x in zip(corner, shares, strict=True)), start=Fraction(1))
        if weight:
            total = total + weight * stack[tuple(a + c for a, c in zip(cell, corner, strict=True))]
    return total


def _at_a_place(
    numbers: Numbers, P: Exact, points: Any, varies: Any, cell: Any, shares: Any, gamma: Fraction,
    rng: np.random.Generator,
) -> str:  # fmt: skip
    n, M = int(numbers["n"]), interpolated(rational(numbers["M"]), cell, shares)
    if "deviation" in numbers:
        bound = rational(numbers["deviation"][cell])
        signs = rng.choice([-1, 1, 1 if rng.random() < 0.5 else -1], size=bound.shape)
        M = M + bound * np.vectorize(Fraction, otypes=[object])(signs)
    A, B, C, D = M[:n, :n], M[:n, n:], M[n:, :n], M[n:, n:]
    if "K" in numbers:
        A, B, C, D = _closed(A, B, C, D, interpolated(rational(numbers["K"]), cell, shares), numbers)
    if not is_stable(A, 0.0):
        return "false: a frozen model is not stable"
    if len(A) <= 4 and not norm_below((A, B, C, D), 0.0, gamma):
        return "false: a frozen model has a larger gain"
    at = [c if v else 0 for c, v in zip(cell, varies, strict=True)]
    along = [x if v else Fraction(0) for x, v in zip(shares, varies, strict=True)]
    X = interpolated(P, at, along)
    if not (X == X.T).all() or not positive(X):
        return "unjustified: P is not positive definite"
    motion = 0 * X
    for i, v in enumerate(varies):
        if v:
            ends = [interpolated(P, at, [*along[:i], Fraction(end), *along[i + 1 :]]) for end in (0, 1)]
            rate = Fraction(float(numbers["rate"][i])) * int(rng.choice([-1, 1]))
            motion = motion + (ends[1] - ends[0]) * (rate / (points[i][cell[i] + 1] - points[i][cell[i]]))
    XA, XB, level = X.dot(A), X.dot(B), gamma * eye(D.shape[1])
    L = -np.block([[XA + XA.T + motion, XB, C.T], [XB.T, -level, D.T], [C, D, -gamma * eye(len(D))]])
    return "" if positive(L) else f"unjustified: the inequality does not hold within cell {cell}"


def _closed(A: Any, B: Any, C: Any, D: Any, K: Any, numbers: Numbers) -> Quad:
    """u = K y with D22 as it is, by solving for y."""
    y, u, k = int(numbers["n_meas"]), int(numbers["n_con"]), int(numbers["n_K"])
    m, p, n = D.shape[1] - u, len(D) - y, len(A)
    F, L, H, E = K[:k, :k], K[:k, k:], K[k:, :k], K[k:, k:]
    right = np.hstack([C[p:], D[p:, m:].dot(H), D[p:, :m]])
    Y = solve(eye(y) - D[p:, m:].dot(E), right) if y else right
    U = E.dot(Y)
    U[:, n : n + k] = U[:, n : n + k] + H
    wide = np.hstack([A, rational(np.zeros((n, k))), B[:, :m]]) + B[:, m:].dot(U)
    inner = np.hstack([rational(np.zeros((k, n))), F, rational(np.zeros((k, m)))]) + L.dot(Y)
    out = np.hstack([C[:p], rational(np.zeros((p, k))), D[:p, :m]]) + D[:p, m:].dot(U)
    state = np.vstack([wide, inner])
    return state[:, : n + k], state[:, n + k :], out[:, : n + k], out[:, n + k :]


__all__ = ["of_multipliers", "of_parameters"]
