r"""Stability, H-infinity and H2 norms of loops in rationals, or in balls of at least 200 digits.

Nothing of robustlab is used here: the judge takes plain arrays. Every entry is the exact value of the float.
Rationals decide every test; balls cost less for large models.

Stability follows from the signs of the Routh array of the characteristic polynomial. ``|G| < gamma`` iff G is stable,
``sigma_max(D) < gamma`` and the Hamiltonian of gamma has no eigenvalue on the axis: Sturm's theorem on its
characteristic polynomial in ``omega^2``, a proof over all frequencies at once. For a gain at a frequency P(jw) and
K(jw) are evaluated separately, then joined, independently of that test. The H2 norm is that of the Gramian by
doubling of the Cayley transform.

A test in balls returns None if no precision decides its sign.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple, TypeVar

import numpy as np
from flint import acb, acb_mat, acb_poly, arb, arb_mat, arb_poly, ctx, fmpq, fmpq_mat, fmpq_poly

# Bits of the mantissa; the next entry is used if a sign is undecided.
PRECISIONS = (700, 2500, 10000)
T = TypeVar("T")
Matrix = Any  # fmpq_mat, arb_mat or acb_mat


class Model(NamedTuple):
    """A model as floats; dt > 0 is discrete."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    dt: float = 0.0


class System(NamedTuple):
    """A model in balls or rationals."""

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    discrete: bool


def with_precision(test: Callable[[], T | None]) -> T | None:
    """Return the result of the test in the lowest precision that decides it; None if none does."""
    before = ctx.prec
    try:
        for bits in PRECISIONS:
            ctx.prec = bits
            try:
                answer = test()
            except ZeroDivisionError:  # a matrix indistinguishable from a singular one
                answer = None
            if answer is not None:
                return answer
        return None
    finally:
        ctx.prec = before


def exact(a: Any) -> Matrix:
    """Return the matrix of the exact values of the floats."""
    array = np.asarray(a)
    rows, columns = array.shape
    if np.iscomplexobj(array):
        return acb_mat(rows, columns, [acb(float(v.real), float(v.imag)) for v in array.ravel()])
    return arb_mat(rows, columns, [arb(float(v)) for v in array.ravel()])


def rational(a: Any) -> fmpq_mat:
    """The same of real floats, as fractions; of fractions themselves."""
    if isinstance(a, fmpq_mat):
        return a
    array = np.asarray(a, dtype=float)
    return fmpq_mat(*array.shape, [fmpq(*v.as_integer_ratio()) for v in array.ravel().tolist()])


def joined(rows: Sequence[Sequence[Matrix]]) -> Matrix:
    """A matrix from its blocks."""
    kind = next((k for k in (acb_mat, arb_mat) if any(isinstance(m, k) for row in rows for m in row)), fmpq_mat)
    height, width = sum(row[0].nrows() for row in rows), sum(m.ncols() for m in rows[0])
    entries: list[Any] = []
    for row in rows:
        tables = [m.tolist() if m.ncols() else [[]] * m.nrows() for m in row]
        entries += [v for lines in zip(*tables, strict=True) for line in lines for v in line]
    return kind(height, width, entries)


def part(m: Matrix, rows: slice, columns: slice) -> Matrix:
    chosen = [line[columns] for line in m.tolist()[rows]] if m.ncols() else []
    height = len(range(*rows.indices(m.nrows())))
    width = len(range(*columns.indices(m.ncols())))
    return type(m)(height, width, [v for line in chosen for v in line])


def eye(n: int, of: Any = 1) -> Matrix:
    """The unit matrix times a number."""
    kind = arb_mat if isinstance(of, arb) else fmpq_mat
    return kind(n, n, [of if i == j else 0 for i in range(n) for j in range(n)])


def adjoint(a: Matrix) -> Matrix:
    return a.transpose().conjugate() if isinstance(a, acb_mat) else a.transpose()


def inverse(a: Matrix) -> Matrix:
    """The inverse, also of a matrix without entries."""
    return a.inv() if a.nrows() else a


def solved(a: Matrix, b: Matrix) -> Matrix:
    return a.solve(b) if a.nrows() and b.ncols() else b


def product(*factors: Matrix) -> Matrix:
    """The product, also over no states at all."""
    result = factors[0]
    for m in factors[1:]:
        result = result * m if result.ncols() else type(result)(result.nrows(), m.ncols())
    return result


def is_positive(n: Matrix) -> bool:
    """All leading minors of the Hermitian part are positive, radii of the balls included."""
    table = (n + adjoint(n)).tolist() if n.nrows() else []
    for k in range(len(table)):  # elimination without pivoting: the pivots are the ratios of the minors
        pivot = table[k][k].real if isinstance(table[k][k], acb) else table[k][k]
        if not pivot > 0:
            return False
        for i in range(k + 1, len(table)):
            factor = table[i][k] / pivot
            for j in range(k + 1, len(table)):
                table[i][j] -= factor * table[k][j]
    return True


def system(model: Model, as_matrix: Callable[[Any], Matrix] = exact) -> System:
    """The model in balls, or with `rational` in fractions."""
    return System(*map(as_matrix, model[:4]), model.dt > 0)


def four_parts(D: Matrix, n_meas: int, n_con: int) -> tuple[Matrix, ...]:
    """11, 12, 21 and 22 of a matrix whose last rows and columns are measurements and controls."""
    z, w = D.nrows() - n_meas, D.ncols() - n_con
    rows, columns = (slice(0, z), slice(z, None)), (slice(0, w), slice(w, None))
    return tuple(part(D, r, c) for r in rows for c in columns)


def closed(P: System, K: System) -> System:
    """The lower LFT with ``u = K y``. ZeroDivisionError: ``I - D_K D22`` is not regular."""
    n_u, n_y, every = K.D.nrows(), K.D.ncols(), slice(None)
    z, w = P.D.nrows() - n_y, P.D.ncols() - n_u
    B1, B2 = part(P.B, every, slice(0, w)), part(P.B, every, slice(w, None))
    C1, C2 = part(P.C, slice(0, z), every), part(P.C, slice(z, None), every)
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
    """The upper LFT ``F_u(M, Delta)``. ZeroDivisionError: ``I - D11 Delta`` is not regular."""
    q, p, every = delta.nrows(), delta.ncols(), slice(None)
    B = joined([[part(M.B, every, slice(q, None)), part(M.B, every, slice(0, q))]])
    C = joined([[part(M.C, slice(p, None), every)], [part(M.C, slice(0, p), every)]])
    D11, D12, D21, D22 = four_parts(M.D, M.D.nrows() - p, M.D.ncols() - q)
    K = System(fmpq_mat(0, 0), fmpq_mat(0, p), fmpq_mat(q, 0), delta, M.discrete)
    return closed(System(M.A, B, C, joined([[D22, D21], [D12, D11]]), M.discrete), K)


def in_series(first: System, second: System) -> System:
    n, m = first.A.nrows(), second.A.nrows()
    return System(
        joined([[first.A, fmpq_mat(n, m)], [product(second.B, first.C), second.A]]),
        joined([[first.B], [product(second.B, first.D)]]),
        joined([[product(second.D, first.C), second.C]]),
        product(second.D, first.D),
        first.discrete,
    )


def side_by_side(systems: Sequence[System]) -> System:
    """Each with inputs and outputs of its own."""

    def diagonal(own: Sequence[Matrix]) -> Matrix:
        return joined([[m if i == j else fmpq_mat(m.nrows(), other.ncols()) for j, other in enumerate(own)]
                       for i, m in enumerate(own)])  # fmt: skip

    return System(*map(diagonal, list(zip(*systems, strict=True))[:4]), systems[0].discrete)


def sensitivity_plant(G: System, *weights: System | None) -> System:
    """From [r; u] to [W1 e; W2 u; W3 G u; e] with ``e = r - G u``."""
    n, n_y, n_u = G.A.nrows(), G.D.nrows(), G.D.ncols()
    e = G.C * -1, eye(n_y), G.D * -1  # from x, r and u
    signals = e, (fmpq_mat(n_u, n), fmpq_mat(n_u, n_y), eye(n_u)), (G.C, fmpq_mat(n_y, n_y), G.D)
    plain = System(fmpq_mat(0, 0), fmpq_mat(0, n_y), fmpq_mat(n_y, 0), eye(n_y), G.discrete)
    kept = [*((w, s) for w, s in zip(weights, signals, strict=True) if w is not None), (plain, e)]
    C, D = joined([[x] for _, (x, _, _) in kept]), joined([[r, u] for _, (_, r, u) in kept])
    around = System(G.A, joined([[fmpq_mat(n, n_y), G.B]]), C, D, G.discrete)
    return in_series(around, side_by_side([w for w, _ in kept]))


def coprime_plant(G: System) -> System:
    """From [noise; disturbance; u] to [y; u + d; y + noise]: its loop is the four-block function of normalised coprime
    factors.
    """
    n, n_y, n_u = G.A.nrows(), G.D.nrows(), G.D.ncols()
    return System(
        G.A,
        joined([[fmpq_mat(n, n_y), G.B, G.B]]),
        joined([[G.C], [fmpq_mat(n_u, n)], [G.C]]),
        joined([[fmpq_mat(n_y, n_y), G.D, G.D], [fmpq_mat(n_u, n_y), eye(n_u), eye(n_u)], [eye(n_y), G.D, G.D]]),
        G.discrete,
    )


def is_stable(A: Matrix, discrete: bool) -> bool | None:
    """Return whether all eigenvalues are in the open stability region; None if this precision does not decide."""
    if not A.nrows():
        return True
    c = A.charpoly().coeffs()
    if isinstance(A, acb_mat):  # with the conjugate roots the polynomial is real
        c = [v.real for v in (acb_poly(c) * acb_poly([v.conjugate() for v in c])).coeffs()]
    if discrete:
        n, c = len(c) - 1, on_the_left(c, fmpq_poly if isinstance(A, fmpq_mat) else arb_poly).coeffs()
        c += [0 * A[0, 0]] * (n + 1 - len(c))
    return _hurwitz(c[::-1])


def on_the_left(c: list[Any], kind: Any, degree: int = 0) -> Any:
    """``(1 - s)^n c((1 + s)/(1 - s))``, c lowest power first: the unit disk goes to the left half plane."""
    n = degree or len(c) - 1
    return sum((v * kind([1, 1]) ** k * kind([1, -1]) ** (n - k) for k, v in enumerate(c)), kind([0]))


def _hurwitz(c: list[Any]) -> bool | None:
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
        below = [u - factor * v for u, v in zip(upper[1:], [*lower[1:], 0], strict=False)]
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


def norm_is_below(G: System, gamma: Any) -> bool | None:
    """Whether the H-infinity norm of a stable real system is below gamma > 0, over all frequencies at once."""
    if not G.D.nrows() or not G.D.ncols():
        return True
    if G.discrete:  # s = (z - 1)/(z + 1) keeps stability and the norm
        inside = inverse(G.A + eye(G.A.nrows()))
        A, B, C = product(inside, G.A - eye(G.A.nrows())), product(inside, G.B) * 2, product(G.C, inside)
        G = System(A, B, C, G.D - product(C, G.B), False)
    D, sure = G.D, isinstance(gamma, fmpq)
    R = eye(D.ncols(), gamma * gamma) - D.transpose() * D
    if not is_positive(R):
        return False if sure or gain(D) > gamma else None
    if not G.A.nrows():
        return True
    inverse_R = R.inv()
    A = G.A + product(G.B, inverse_R, D.transpose(), G.C)
    S = eye(D.nrows()) + product(D, inverse_R, D.transpose())
    H = joined(
        [[A, product(G.B, inverse_R, G.B.transpose())], [product(G.C.transpose(), S, G.C) * -1, A.transpose() * -1]]
    )
    even = [c * (-1) ** k for k, c in enumerate(H.charpoly().coeffs()[::2])]
    if sure:
        return bool(even[0] != 0) and _exact_positive_roots(fmpq_poly(even)) == 0
    roots = _positive_roots(even)
    return None if roots is None else roots == 0


def _exact_positive_roots(f: fmpq_poly) -> int:
    """Number of distinct positive roots of a polynomial with ``f(0) != 0``, by Sturm's sequence."""
    chain = [f, f.derivative()]
    while chain[-1] != 0:
        chain.append(-(chain[-2] % chain[-1]))
    ends = [p(0) for p in chain if p(0) != 0], [p.leading_coefficient() for p in chain[:-1]]
    low, high = (sum((a > 0) != (b > 0) for a, b in pairwise(values)) for values in ends)
    return low - high


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
        inside = inverse(eye(n, a) - G.A)
        A, B = product(inside, eye(n, a) + G.A), product(inside, G.B)
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


def response(model: Model, omega: Any) -> Matrix:
    """The model at ``s = j omega`` or ``exp(j omega dt)``; floats or rationals; omega may be a ball, or infinite."""
    A, B, C, D = (acb_mat(m if isinstance(m, (fmpq_mat, acb_mat)) else exact(m)) for m in model[:4])
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
    at: Callable[[Any], arb], found: Sequence[complex], dt: float, points: int = 24, rounds: int = 30, near: int = 6
) -> tuple[arb, float]:
    """Return the largest gain at 0, infinity, at and near all given poles, on a grid, refined at its peaks."""
    if dt:
        found = [complex(np.log(p)) / dt for p in found if p and np.isfinite(np.log(p))]
    sizes = [abs(p) for p in found if 1e-280 < abs(p) < 1e280]
    low, high = (min(sizes) / 10, max(sizes) * 10) if sizes else (1e-2, 1e2)
    end = np.pi / dt if dt else np.inf
    omega = {0.0, end, *np.geomspace(low, high, points).tolist()}
    for p in found:
        omega |= {abs(p), abs(p.imag)} | {abs(p.imag) + k * abs(p.real) for k in (-1, 1, -0.3, 0.3, -3, 3)[:near]}
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
    """Return the gain in enough digits, or zero at a pole on the axis (a stable loop has none)."""
    value = with_precision(lambda: at(omega))
    return arb(0) if value is None else value.mid()


def float_or_inf(value: arb) -> float:
    """As a float; what floats cannot hold is infinite."""
    number = float(value.mid())
    return number if not np.isnan(number) else np.inf
