r"""Loops judged in ball arithmetic of at least 200 digits: stability, H-infinity and H2 norms of what floats stand for.

Nothing of robustlab is used here: the judge takes plain arrays. Every entry is the very number that the float is.

Stability
    Signs of the Routh array of the characteristic polynomial (of a discrete loop after ``z = (1 + s)/(1 - s)``).
H-infinity norm
    ``|G| < gamma`` iff G is stable, ``sigma_max(D) < gamma`` and the Hamiltonian of gamma has no eigenvalue on the
    axis: Sturm's theorem on its characteristic polynomial in ``omega^2``. A proof over all frequencies at once.
Gain at a frequency
    P(jw) and K(jw) are evaluated on their own, then joined: it shares nothing with the test above.
H2 norm
    The Gramian by doubling of the Cayley transform.

A test whose sign no precision decides answers None.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple, TypeVar

import numpy as np
from flint import acb, acb_mat, acb_poly, arb, arb_mat, arb_poly, ctx

__all__ = [
    "Model",
    "System",
    "closed",
    "coprime_plant",
    "exact",
    "four_parts",
    "gain",
    "h2_norm",
    "is_positive",
    "is_stable",
    "norm_is_below",
    "peak",
    "poles",
    "response",
    "sensitivity_plant",
    "upper_closed",
    "with_precision",
]

# Bits of the mantissa; the next one is taken where a sign is open.
PRECISIONS = (700, 2500, 10000)
T = TypeVar("T")
Matrix = Any  # arb_mat or acb_mat


class Model(NamedTuple):
    """A model as floats; dt > 0 is discrete."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    dt: float = 0.0


class System(NamedTuple):
    """A model in balls."""

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    discrete: bool


def with_precision(test: Callable[[], T | None]) -> T | None:
    """What the test answers in the lowest precision in which it does; None where none decides."""
    before = ctx.prec
    try:
        for bits in PRECISIONS:
            ctx.prec = bits
            try:
                answer = test()
            except ZeroDivisionError:  # a matrix that cannot be told from a singular one
                answer = None
            if answer is not None:
                return answer
        return None
    finally:
        ctx.prec = before


# --- matrices --------------------------------------------------------------------------------------------------------


def exact(a: Any) -> Matrix:
    """The matrix of the very numbers that the floats are."""
    array = np.asarray(a)
    rows, columns = array.shape
    if np.iscomplexobj(array):
        return acb_mat(rows, columns, [acb(float(v.real), float(v.imag)) for v in array.ravel()])
    return arb_mat(rows, columns, [arb(float(v)) for v in array.ravel()])


def joined(rows: Sequence[Sequence[Matrix]]) -> Matrix:
    """A matrix from its blocks."""
    kind = acb_mat if any(isinstance(m, acb_mat) for row in rows for m in row) else arb_mat
    height, width = sum(row[0].nrows() for row in rows), sum(m.ncols() for m in rows[0])
    entries: list[Any] = []
    for row in rows:
        tables = [m.tolist() if m.ncols() else [[]] * m.nrows() for m in row]
        for lines in zip(*tables, strict=True):
            for line in lines:
                entries += line
    return kind(height, width, entries)


def part(m: Matrix, rows: slice, columns: slice) -> Matrix:
    """A block of a matrix."""
    chosen = [line[columns] for line in m.tolist()[rows]] if m.ncols() else []
    height = len(range(*rows.indices(m.nrows())))
    width = len(range(*columns.indices(m.ncols())))
    return type(m)(height, width, [v for line in chosen for v in line])


def eye(n: int) -> arb_mat:
    """The unit matrix."""
    return arb_mat(n, n, [int(i == j) for i in range(n) for j in range(n)])


def zeros(rows: int, columns: int) -> arb_mat:
    """A matrix of zeros."""
    return arb_mat(rows, columns)


def adjoint(a: Matrix) -> Matrix:
    """Transposed and conjugate."""
    return a.transpose().conjugate() if isinstance(a, acb_mat) else a.transpose()


def inverse(a: Matrix) -> Matrix:
    """The inverse, also of a matrix without entries."""
    return a.inv() if a.nrows() else a


def solved(a: Matrix, b: Matrix) -> Matrix:
    """``a^-1 b``."""
    return a.solve(b) if a.nrows() and b.ncols() else b


def product(*factors: Matrix) -> Matrix:
    """The product, also over no states at all."""
    result = factors[0]
    for m in factors[1:]:
        result = result * m if result.ncols() else type(result)(result.nrows(), m.ncols())
    return result


def is_positive(n: Matrix) -> bool:
    """All leading minors of the Hermitian part are positive, radii of the balls included."""
    table = ((n + adjoint(n)) * arb(0.5)).tolist() if n.nrows() else []
    for k in range(len(table)):  # elimination without pivoting: the pivots are the ratios of the minors
        pivot = table[k][k].real if isinstance(table[k][k], acb) else table[k][k]
        if not pivot > 0:
            return False
        for i in range(k + 1, len(table)):
            factor = table[i][k] / pivot
            for j in range(k + 1, len(table)):
                table[i][j] -= factor * table[k][j]
    return True


def system(model: Model) -> System:
    """The model in balls."""
    return System(exact(model.A), exact(model.B), exact(model.C), exact(model.D), model.dt > 0)


# --- loops -----------------------------------------------------------------------------------------------------------


def four_parts(D: Matrix, n_meas: int, n_con: int) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """11, 12, 21 and 22 of a matrix whose last rows and columns are measurements and controls."""
    z, w = D.nrows() - n_meas, D.ncols() - n_con
    first, last = slice(0, z), slice(z, z + n_meas)
    return (
        part(D, first, slice(0, w)),
        part(D, first, slice(w, w + n_con)),
        part(D, last, slice(0, w)),
        part(D, last, slice(w, w + n_con)),
    )


def closed(P: System, K: System) -> System:
    """The lower LFT with ``u = K y``.

    Raises
    ------
    ZeroDivisionError
        ``I - D_K D22`` is not regular.
    """
    n, n_u, n_y = P.A.nrows(), K.D.nrows(), K.D.ncols()
    z, w = P.D.nrows() - n_y, P.D.ncols() - n_u
    every = slice(0, n)
    B1, B2 = part(P.B, every, slice(0, w)), part(P.B, every, slice(w, w + n_u))
    C1, C2 = part(P.C, slice(0, z), every), part(P.C, slice(z, z + n_y), every)
    D11, D12, D21, D22 = four_parts(P.D, n_y, n_u)
    E = inverse(eye(n_u) - product(K.D, D22))  # u = E (C_K x_K + D_K C2 x + D_K D21 w)
    u_x, u_k, u_w = product(E, K.D, C2), product(E, K.C), product(E, K.D, D21)
    y_x, y_k, y_w = C2 + product(D22, u_x), product(D22, u_k), D21 + product(D22, u_w)
    return System(
        joined([[P.A + product(B2, u_x), product(B2, u_k)], [product(K.B, y_x), K.A + product(K.B, y_k)]]),
        joined([[B1 + product(B2, u_w)], [product(K.B, y_w)]]),
        joined([[C1 + product(D12, u_x), product(D12, u_k)]]),
        D11 + product(D12, u_w),
        P.discrete,
    )


def upper_closed(M: System, delta: Matrix) -> System:
    """The upper LFT ``F_u(M, Delta)``.

    Raises
    ------
    ZeroDivisionError
        ``I - D11 Delta`` is not regular.
    """
    n, (q, p) = M.A.nrows(), (delta.nrows(), delta.ncols())
    n_u, n_y = M.D.ncols() - q, M.D.nrows() - p
    every = slice(0, n)
    B1, B2 = part(M.B, every, slice(0, q)), part(M.B, every, slice(q, q + n_u))
    C1, C2 = part(M.C, slice(0, p), every), part(M.C, slice(p, p + n_y), every)
    D11, D12, D21, D22 = four_parts(M.D, n_y, n_u)
    E = product(delta, inverse(eye(p) - product(D11, delta)))
    return System(
        M.A + product(B1, E, C1),
        B2 + product(B1, E, D12),
        C2 + product(D21, E, C1),
        D22 + product(D21, E, D12),
        M.discrete,
    )


def in_series(first: System, second: System) -> System:
    """``second * first``."""
    n, m = first.A.nrows(), second.A.nrows()
    return System(
        joined([[first.A, zeros(n, m)], [product(second.B, first.C), second.A]]),
        joined([[first.B], [product(second.B, first.D)]]),
        joined([[product(second.D, first.C), second.C]]),
        product(second.D, first.D),
        first.discrete,
    )


def sensitivity_plant(G: System, W1: System | None, W2: System | None, W3: System | None) -> System:
    """From [r; u] to [W1 e; W2 u; W3 G u; e] with ``e = r - G u``."""
    n, n_y, n_u = G.A.nrows(), G.D.nrows(), G.D.ncols()
    sources = {  # what drives each weight, from (x, r, u)
        "e": (G.C * -1, eye(n_y), G.D * -1),
        "u": (zeros(n_u, n), zeros(n_u, n_y), eye(n_u)),
        "y": (G.C, zeros(n_y, n_y), G.D),
    }
    given = [(w, sources[k]) for w, k in ((W1, "e"), (W2, "u"), (W3, "y")) if w is not None]
    sizes = [n, *(w.A.nrows() for w, _ in given)]

    def line(diagonal: int, first: Matrix, own: Matrix) -> list[Matrix]:
        blocks = [first, *(zeros(first.nrows(), s) for s in sizes[1:])]
        blocks[diagonal] = own
        return blocks

    A = [line(0, G.A, G.A)]
    B = [[zeros(n, n_y), G.B]]
    C, D = [], []
    for k, (w, (x, r, u)) in enumerate(given, 1):
        A.append(line(k, product(w.B, x), w.A))
        B.append([product(w.B, r), product(w.B, u)])
        C.append(line(k, product(w.D, x), w.C))
        D.append([product(w.D, r), product(w.D, u)])
    x, r, u = sources["e"]
    C.append(line(0, x, x))
    D.append([r, u])
    return System(joined(A), joined(B), joined(C), joined(D), G.discrete)


def coprime_plant(G: System) -> System:
    """From [noise; disturbance; u] to [y; u + d; y + noise]: its loop is the four-block function of normalised coprime
    factors.
    """
    n, n_y, n_u = G.A.nrows(), G.D.nrows(), G.D.ncols()
    return System(
        G.A,
        joined([[zeros(n, n_y), G.B, G.B]]),
        joined([[G.C], [zeros(n_u, n)], [G.C]]),
        joined(
            [
                [zeros(n_y, n_y), G.D, G.D],
                [zeros(n_u, n_y), eye(n_u), eye(n_u)],
                [eye(n_y), G.D, G.D],
            ]
        ),
        G.discrete,
    )


# --- stability -------------------------------------------------------------------------------------------------------


def is_stable(A: Matrix, discrete: bool) -> bool | None:
    """Whether all eigenvalues lie in the open region of stability; None where this precision cannot tell."""
    if not A.nrows():
        return True
    polynomial = A.charpoly()
    if isinstance(A, acb_mat):  # with the conjugate roots the polynomial is real
        mirrored = acb_poly([c.conjugate() for c in polynomial.coeffs()])
        polynomial = arb_poly([c.real for c in (polynomial * mirrored).coeffs()])
    if discrete:
        plus, minus = arb_poly([1, 1]), arb_poly([1, -1])
        coefficients, n = polynomial.coeffs(), polynomial.degree()
        polynomial = sum((c * plus**k * minus ** (n - k) for k, c in enumerate(coefficients)), arb_poly([0]))
        coefficients = polynomial.coeffs()
        coefficients += [arb(0)] * (n + 1 - len(coefficients))
    else:
        coefficients = polynomial.coeffs()
    return _hurwitz(coefficients[::-1])


def _hurwitz(c: list[arb]) -> bool | None:
    """Routh's test of a polynomial, highest power first."""
    if c[0] < 0:
        c = [-v for v in c]
    if any(v < 0 or v == 0 for v in c):
        return False
    if not c[0] > 0:
        return None
    upper, lower = c[0::2], c[1::2]
    while lower:
        if lower[0] < 0 or lower[0] == 0:
            return False
        if not lower[0] > 0:
            return None
        factor = upper[0] / lower[0]
        below = [u - factor * v for u, v in zip(upper[1:], [*lower[1:], arb(0)], strict=False)]
        upper, lower = lower, below
    return True


def poles(A: Matrix) -> list[complex]:
    """Eigenvalues to about the precision of floats, infinite ones left out."""
    if not A.nrows():
        return []
    complete = acb_mat(A) if not isinstance(A, acb_mat) else A
    try:
        found = complete.eig(algorithm="approx")
    except (ValueError, ArithmeticError):
        return []
    return [v for v in map(complex, found) if np.isfinite(v)]


# --- norms -----------------------------------------------------------------------------------------------------------


def norm_is_below(G: System, gamma: Any) -> bool | None:
    """Whether the H-infinity norm of a stable real system is below gamma, over all frequencies at once."""
    if not G.D.nrows() or not G.D.ncols():
        return True
    if G.discrete:
        G = _continuous(G)
    level = arb(gamma) ** 2
    D, n = G.D, G.A.nrows()
    R = eye(D.ncols()) * level - D.transpose() * D
    if not is_positive(R):
        return False if gain(D) > arb(gamma) else None
    if not n:
        return True
    inverse_R = R.inv()
    A = G.A + product(G.B, inverse_R, D.transpose(), G.C)
    S = eye(D.nrows()) + product(D, inverse_R, D.transpose())
    H = joined(
        [
            [A, product(G.B, inverse_R, G.B.transpose())],
            [product(G.C.transpose(), S, G.C) * -1, A.transpose() * -1],
        ]
    )
    even = H.charpoly().coeffs()[::2]
    roots = _positive_roots([c * (-1) ** k for k, c in enumerate(even)])
    return None if roots is None else roots == 0


def _continuous(G: System) -> System:
    """Under ``s = (z - 1)/(z + 1)``, which keeps stability and the H-infinity norm."""
    n = G.A.nrows()
    inside = inverse(G.A + eye(n))
    return System(
        product(inside, G.A - eye(n)),
        product(inside, G.B) * arb(2).sqrt(),
        product(G.C, inside) * arb(2).sqrt(),
        G.D - product(G.C, inside, G.B),
        False,
    )


def _positive_roots(c: list[arb]) -> int | None:
    """Number of positive roots of a polynomial without multiple ones, lowest power first, by Sturm's sequence."""
    chain = [c, [k * v for k, v in enumerate(c)][1:]]
    while len(chain[-1]) > 1:
        rest, divisor = list(chain[-2]), chain[-1]
        if not (divisor[-1] > 0 or divisor[-1] < 0):
            return None
        while len(rest) >= len(divisor):
            factor, shift = rest[-1] / divisor[-1], len(rest) - len(divisor)
            for k in range(len(divisor) - 1):
                rest[shift + k] -= factor * divisor[k]
            rest.pop()
        size = max((abs(v).mid() for v in rest), default=arb(0))
        if not size > 0:
            return None
        chain.append([-v / size for v in rest])
    counts = []
    for end in (0, -1):
        values = [p[end] for p in chain]
        if not all(v > 0 or v < 0 for v in values):
            return None
        signs = [bool(v > 0) for v in values]
        counts.append(sum(a != b for a, b in pairwise(signs)))
    return counts[0] - counts[1]


def h2_norm(G: System) -> arb | None:
    """H2 norm of a stable real system whose direct term counts in discrete time and is left out in continuous time."""
    n = G.A.nrows()
    direct = arb(0)
    if G.discrete:
        A, Q = G.A, product(G.B, G.B.transpose())
        direct = sum((v * v for v in G.D.entries()), arb(0))
    else:
        sizes = [abs(p) for p in poles(G.A) if p]
        a = arb(float(np.exp(np.mean(np.log(sizes))))) if sizes else arb(1)
        inside = inverse(eye(n) * a - G.A)
        A, B = product(inside, eye(n) * a + G.A), product(inside, G.B)
        Q = product(B, B.transpose()) * (2 * a)
    X = Q
    for _ in range(400):  # X = Q + A Q A^T + ..., twice as many terms in every step
        step = product(A, X, A.transpose()).mid()
        X, A = (X + step).mid(), product(A, A).mid()
        size = max((abs(v) for v in X.entries()), default=arb(0))
        if not size > 0 or max(abs(v) for v in step.entries()) <= size * arb("1e-60"):
            break
    else:
        return None
    return (product(G.C, X, G.C.transpose()).trace() + direct).mid().sqrt() if n else direct.sqrt()


# --- gains at frequencies --------------------------------------------------------------------------------------------


def response(model: Model, omega: Any) -> Matrix:
    """The model at ``s = j omega``, or ``z = exp(j omega dt)``; omega may be a ball or infinite."""
    A, B, C, D = (acb_mat(exact(m)) for m in model[:4])
    n = A.nrows()
    if not n or (not isinstance(omega, arb) and omega == np.inf):
        return D
    s = acb(0, omega) if not model.dt else acb(0, arb(omega) * arb(float(model.dt))).exp()
    return D + product(C, solved(acb_mat(eye(n)) * s - A, B))


def gain(M: Matrix) -> arb:
    """A lower bound of the largest singular value that is exact to 1e-20 or so."""
    if not M.nrows() or not M.ncols():
        return arb(0)
    if not all(v.is_finite() for v in M.entries()):
        raise ZeroDivisionError("no response at this frequency, or too few digits")
    size = max(abs(v).mid() for v in M.entries())
    if not size > 0:
        return arb(0)
    table = np.array([[complex((v / size).mid()) for v in row] for row in M.tolist()])
    u, _, vh = np.linalg.svd(table)
    left, right = exact(u[:, :1].conj().T), exact(vh[:1].conj().T)
    lengths = sum((abs(v) ** 2 for v in left.entries()), arb(0)) * sum((abs(v) ** 2 for v in right.entries()), arb(0))
    value = abs((left * M * right)[0, 0]) / lengths.sqrt()
    if value.rel_accuracy_bits() < 60:
        raise ZeroDivisionError("digits were lost")
    return value


def peak(
    at: Callable[[Any], arb],
    found: Sequence[complex],
    dt: float,
    points: int = 24,
    rounds: int = 30,
    beside: int = 6,
) -> tuple[arb, float]:
    """Largest gain met at 0, infinity, at and beside all given poles, on a grid between them, at the tops refined."""
    if dt:
        found = [complex(np.log(p)) / dt for p in found if p and np.isfinite(np.log(p))]
    sizes = [abs(p) for p in found if 1e-280 < abs(p) < 1e280]
    low, high = (min(sizes) / 10, max(sizes) * 10) if sizes else (1e-2, 1e2)
    end = np.pi / dt if dt else np.inf
    omega = {0.0, end, *np.geomspace(low, high, points).tolist()}
    for p in found:
        omega |= {abs(p), abs(p.imag)} | {abs(p.imag) + k * abs(p.real) for k in (-1, 1, -0.3, 0.3, -3, 3)[:beside]}
    grid = sorted(w for w in omega if 0 <= w <= end)
    values = [_safe(at, w) for w in grid]
    best = max(range(len(grid)), key=lambda k: float_or_inf(values[k]))
    top, where = values[best], grid[best]
    inner = [k for k in range(1, len(grid) - 1) if values[k] >= values[k - 1] and values[k] >= values[k + 1]]
    for k in sorted(inner, key=lambda k: -float_or_inf(values[k]))[:3]:
        a, b = grid[k - 1], grid[k + 1] if np.isfinite(grid[k + 1]) else 10 * grid[k]
        for _ in range(rounds):  # thirds of the bracket, in the logarithm where it is wide
            wide = a > 0 and b > 4 * a
            x, y = (a * (b / a) ** (1 / 3), a * (b / a) ** (2 / 3)) if wide else (a + (b - a) / 3, b - (b - a) / 3)
            f, g = _safe(at, x), _safe(at, y)
            if f > top:
                top, where = f, x
            if g > top:
                top, where = g, y
            a, b = (a, y) if f > g else (x, b)
            if b - a <= 1e-14 * b:
                break
    return top, float(where)


def _safe(at: Callable[[Any], arb], omega: float) -> arb:
    """The gain in enough digits, or zero at a pole on the axis (a loop that is stable has none)."""
    value = with_precision(lambda: at(omega))
    return arb(0) if value is None else value.mid()


def float_or_inf(value: arb) -> float:
    """As a float; what floats cannot hold is infinite."""
    number = float(value.mid())
    return number if not np.isnan(number) else np.inf
