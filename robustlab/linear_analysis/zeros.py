r"""Zeros of models, their kinds; determinants of pencils in whole numbers and their roots; stability without rounding.

.. math:: P(s) = \begin{bmatrix} A - s I & B \\ C & D \end{bmatrix}, \qquad
   \text{zeros: } s \text{ where rank } P(s) \text{ falls below its rank at almost every } s

Those of a square model of full normal rank are the roots of :math:`\det P(s)`, which is computed in whole numbers,
without rounding: modulo as many primes as Hadamard's bound requires. FLINT gives its roots as balls that contain one
root each. The zeros of other models, and of large ones, come from SLICOT's AB08ND. Each zero is then checked in P(s).

The entries themselves carry rounding: where ``C B`` is zero but 1e-17 after a change of states, there is a zero near
1e17. Zeros beyond the fastest pole that entrywise changes of ROUNDING move away are left out (Demmel, "The
componentwise distance to the nearest singular matrix", SIAM J. Matrix Anal. Appl. 13, 1992).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from robustlab.arrays import AnyArray, Array, ComplexArray, Indices
from robustlab.display import Displayable, Facts, Part, listed, number
from robustlab.errors import NoTrustworthyNumber, error_context
from robustlab.linear_analysis import slicot
from robustlab.linear_analysis.matrices import equilibrating_exponents, refuse_extremes, system_matrix
from robustlab.result import Status, Typed
from robustlab.statespace import StateSpaceModel, as_model

if TYPE_CHECKING:
    from flint import acb, arb, fmpz_poly

# Largest size, and primes times cubed rows: above them the result takes more than about ten seconds.
MOST_STATES, MOST_WORK = 200, 4e9
# Most states for which stability is decided exactly.
MOST_DECIDED = 12
TOP = 2**62  # upper bound of the primes
FEW = 3  # primes that decide a rank: all are unlucky with a probability below 1e-40
BITS = 128  # of a root, relative to its modulus
POINT = 0x9E3779B97F4A7C15  # at which a pencil is singular by chance only
FAR = 10**6  # above every exponent

# A model, the indices of its input signals, those of the rows to which its outputs are added, and their sign.
Block = tuple[StateSpaceModel, Indices, Indices, int]


class Root(NamedTuple):
    """A root ``re + j im``, accurate to BITS, and its multiplicity; ``re`` is 0 where indistinguishable from 0."""

    re: Fraction
    im: Fraction
    multiplicity: int

    @property
    def value(self) -> complex:
        """The root in floating point; infinite if it overflows."""
        return complex(_float(self.re), _float(self.im))


def determinant(M: Array, n: int) -> tuple[fmpz_poly, int]:
    """Compute the polynomial c and the exponent e of ``det(M - s E)``; c is zero if the determinant is.

    Raises NoTrustworthyNumber: more work than MOST_WORK, from the number and the range of the entries.
    """
    from flint import fmpz_mat, fmpz_poly, nmod_mat, nmod_poly

    k = len(M)
    if not k:
        return fmpz_poly([1]), 0
    rows, weights, shift = _whole(M, n)
    sizes = ((abs(x) + (weights[i] if i == j < n else 0) for j, x in enumerate(row)) for i, row in enumerate(rows))
    bound = 2 * math.prod(math.isqrt(sum(x * x for x in row)) + 1 for row in sizes)
    if bound.bit_length() / TOP.bit_length() * k**3 > MOST_WORK:
        found = f"a pencil of {k} rows with {bound.bit_length()} binary digits"
        raise NoTrustworthyNumber("determinant", found, "at most 200 states, of entries less far apart")
    whole, E = fmpz_mat(k, k, [x for row in rows for x in row]), fmpz_mat(k, n)
    for i in range(n):
        E[i, i] = weights[i]
        whole[i, i] -= weights[i] * POINT
    # With t = s - POINT and W the first rows of whole^-1 E the determinant is det(whole) det(I - t W).
    c, modulus, tried = fmpz_poly([]), 1, 0
    while modulus <= bound:
        p, tried = _prime(tried), tried + 1
        G = nmod_mat(whole, p)
        size = G.det()
        if size == 0:
            if modulus == 1 and tried == FEW:
                return fmpz_poly([]), 0
            continue
        W = nmod_mat(n, n, G.solve(nmod_mat(E, p)).entries()[: n * n], p)
        found = nmod_poly(W.charpoly().coeffs()[::-1], p)(nmod_poly([-POINT, 1], p)) * size
        step = (found - nmod_poly(c, p)) * pow(modulus, -1, p)
        c, modulus = c + modulus * fmpz_poly([int(x) for x in step.coeffs()]), modulus * p
    return fmpz_poly([x - modulus if 2 * x > modulus else x for x in c.coeffs()]), -shift


def normal_rank(M: Array, n: int) -> int:
    """Find the rank of ``M - s E`` at almost every s; M of any shape, exact except for three unlucky primes."""
    from flint import fmpz_mat, nmod_mat

    if not M.size:
        return 0
    rows, weights, _ = _whole(M, n)
    p, q = M.shape
    whole = fmpz_mat(p, q, [x for row in rows for x in row])
    for i in range(n):
        whole[i, i] -= weights[i] * POINT
    return max(nmod_mat(whole, _prime(i)).rank() for i in range(FEW))


def wired(blocks: Iterable[Block], J: Array) -> tuple[Array, int]:
    """Return M and n, for `determinant`, of `Block` models wired by signals, with the part J in their own rows."""
    blocks = list(blocks)
    n, k = sum(model.n_states for model, *_ in blocks), len(J)
    M, first = np.zeros((n + k, n + k)), 0
    M[n:, n:] = J
    for model, into, onto, sign in blocks:
        states = slice(first, first + model.n_states)
        M[states, states] = model.A
        M[states, n + into] = model.B
        M[n + onto, states] = sign * model.C
        M[(n + onto)[:, None], n + into] += sign * model.D
        first += model.n_states
    return M, n


def _whole(M: Array, n: int) -> tuple[list[list[int]], list[int], int]:
    """Return M and E with rows and columns scaled to one size and to whole numbers, and the sum of exponents."""
    nonzero = M != 0
    share, high = np.frexp(M)
    mantissas = np.ldexp(share, 53).astype(np.int64)
    ends = np.frexp(np.where(nonzero, mantissas & -mantissas, 1).astype(float))[1] - 1  # trailing zeros
    mantissas, low = mantissas >> ends, high - 53 + ends
    row, column = equilibrating_exponents(M)
    lowest = np.where(nonzero, low + row[:, None] + column, FAR).min(axis=1, initial=FAR)
    lowest[:n] = np.minimum(lowest[:n], row[:n] + column[:n])
    row -= np.where(lowest < FAR, lowest, row)
    exponents = np.where(nonzero, low + row[:, None] + column, 0)
    rows = [[x << e for x, e in zip(*pair, strict=True)]
            for pair in zip(mantissas.tolist(), exponents.tolist(), strict=True)]  # fmt: skip
    return rows, [1 << e for e in (row[:n] + column[:n]).tolist()], int(row.sum() + column.sum())


@cache
def _prime(index: int) -> int:
    from flint import fmpz

    p = (_prime(index - 1) if index else TOP) - 1
    while not fmpz(p).is_prime():
        p -= 1
    return p


def from_the_circle(f: fmpz_poly, degree: int) -> fmpz_poly:
    """Return ``(1 - v)^degree f((1 + v) / (1 - v))``: the unit disk becomes the left half plane, -1 infinity."""
    from flint import fmpz_poly

    found, lower = fmpz_poly([]), fmpz_poly([1])  # Horner's rule, with the missing powers of 1 - v
    for k in reversed(range(degree + 1)):
        found = found * fmpz_poly([1, 1]) + lower * f[k]
        lower *= fmpz_poly([1, -1])
    return found


def roots(f: fmpz_poly) -> list[Root]:
    """Find all complex roots, in conjugate pairs; real ones have ``im == 0``."""
    return [
        Root(Fraction(0) if z.real.contains(0) else _middle(z.real), _middle(z.imag), multiplicity)
        for z, multiplicity in _balls(f, BITS)
    ]


def even_and_odd(f: fmpz_poly) -> tuple[fmpz_poly, fmpz_poly]:
    """Return e, o with ``f(j omega) = e(x) + j omega o(x)``, ``x = omega^2``."""
    from flint import fmpz_poly

    even, odd = (fmpz_poly([c * (-1) ** k for k, c in enumerate(part)]) for part in (f.coeffs()[::2], f.coeffs()[1::2]))
    return even, odd


def on_axis(f: fmpz_poly) -> bool:
    """Decide whether a root lies on the imaginary axis: a common root ``x >= 0`` of the even and the odd part."""
    even, odd = even_and_odd(f)
    return f[0] == 0 or any(z.imag == 0 and z.real > 0 for z, _ in _balls(even.gcd(odd), BITS))


def all_left(f: fmpz_poly) -> bool:
    """Decide whether all roots lie in the open left half plane."""
    if on_axis(f):
        return False
    bits, balls = BITS, _balls(f, BITS)
    while any(z.real.contains(0) for z, _ in balls):
        bits *= 2
        balls = _balls(f, bits)
    return all(z.real < 0 for z, _ in balls)


def exactly_stable(A: AnyArray, discrete: bool = False) -> bool | None:
    """Decide whether all eigenvalues of A lie in the open left half plane (unit disk); None for more than 12 states."""
    p = _characteristic(A, discrete)
    return None if p is None else p.degree() == len(A) and all_left(p)


def exactly_on_boundary(A: AnyArray, discrete: bool = False) -> bool | None:
    """Decide whether an eigenvalue of A lies on the imaginary axis (unit circle); None for more than 12 states."""
    p = _characteristic(A, discrete)
    return None if p is None else p.degree() < len(A) or on_axis(p)


def _characteristic(A: AnyArray, discrete: bool) -> fmpz_poly | None:
    """Return the characteristic polynomial (discrete: its image in v, of lower degree if -1 is an eigenvalue)."""
    if len(A) > MOST_DECIDED:
        return None
    p, _ = determinant(np.asarray(A, dtype=float), len(A))
    return from_the_circle(p, len(A)) if discrete else p


def _balls(f: fmpz_poly, bits: int) -> list[tuple[acb, int]]:
    """Return disjoint balls of all roots and their multiplicities; FLINT gives real roots no imaginary part."""
    from robustlab.verification.balls import precision

    with precision(bits):
        found: Any = f.complex_roots() if f.degree() > 0 else []
        return found


def _middle(ball: arb) -> Fraction:
    man, exp = (int(x) for x in ball.mid().man_exp())
    return Fraction(man << max(exp, 0), 1 << max(-exp, 0))


def _float(part: Fraction) -> float:
    try:
        return float(part)
    except OverflowError:
        return math.inf if part > 0 else -math.inf


# Relative rounding errors of the entries from earlier calculations.
ROUNDING = 1e-14
# A zero that such changes move by this share of itself is decided by rounding ...
DECIDED = 0.1
# ... unless it moves by less than this share of the fastest pole: then it lies at zero.
STILL = 1e-9
RESIDUAL = 1e-8  # smallest singular value of P(s) at a zero, relative to P, for working precision
NEARLY = 1e-13  # share of the largest singular value of P(s) below which one counts as zero for the rank
# A mode is hidden if [A - s I, B] or [A - s I; C], rows and columns of size one, is this near to losing rank.
HIDDEN = 1e-13


@dataclass(frozen=True, eq=False)
class Zeros(Typed, Displayable):
    """Finite invariant zeros of a model."""

    #: Shape (n_zeros,), with their multiplicities, by rising modulus; in rad/s, or in the z plane of a discrete model
    values: ComplexArray
    #: For each "transmission", "input-decoupling" (an uncontrollable mode), "output-decoupling" (an unobservable one)
    #: or "input-output-decoupling"
    kinds: tuple[str, ...]
    normal_rank: int  #: Rank of the transfer matrix at almost every s, to within rounding
    #: Singular value of P(z) that should vanish over the largest one, rows and columns of the given model's P(z)
    #: brought to size one, shape (n_zeros,)
    residuals: Array
    status: Status  #: CONVERGED: every value is accurate to rounding of the entries; else INACCURATE
    reason: str = ""  #: Why it is inaccurate; else empty
    dt: float = 0.0  #: Sample time of the model in s; 0 of a continuous one

    quantities: ClassVar[Mapping[str, Any]] = {
        "count": "1", "values": [{"re": float, "im": float}], "kinds": [str], "normal_rank": "1",
        "not_minimum_phase": "1",
    }  # fmt: skip

    def __len__(self) -> int:
        return len(self.values)

    @property
    def not_minimum_phase(self) -> int:
        """Number of zeros on the boundary of stability or beyond."""
        return int(np.count_nonzero(abs(self.values) >= 1 if self.dt else self.values.real >= 0))

    @property
    def count(self) -> int:
        return len(self)

    def headline(self) -> str:
        return f"{len(self)} finite invariant zero{'s' * (len(self) != 1)}"

    def details(self) -> list[Part]:
        found = zip(self.values.tolist(), self.kinds, self.residuals.tolist(), strict=True)
        rows = [(f"{complex(z):.6g}" if z.imag else f"{z.real:.6g}", kind, f"{r:.2g}") for z, kind, r in found]
        return [Part("zeros:", ("zero", "kind", "residual"), rows)]

    def facts(self) -> Facts:
        kinds = ", ".join(f"{count} {kind}" for kind, count in Counter(self.kinds).items())
        return [
            ("zeros", listed([number(complex(z)) for z in self.values]) or "none"),
            ("kinds", kinds),
            ("on the boundary or beyond", str(self.not_minimum_phase)),
            ("normal rank", str(self.normal_rank)),
            ("largest residual", number(float(self.residuals.max())) if len(self) else ""),
            ("reason", self.reason),
        ]


@error_context("zeros")
def zeros(model: Any) -> Zeros:
    r"""Compute all finite invariant zeros of a model: transmission zeros and hidden modes (Rosenbrock 1970).

    Parameters
    ----------
    model
        Model of any shape, or a python-control object.

    Returns
    -------
    Zeros
        Values, kinds, and the residuals in the given model's own pencil. INACCURATE if rounding of the
        entries decides the place of a zero.

    Raises
    ------
    InputError
        No model.

    Examples
    --------
    >>> allpass = StateSpaceModel([[-1.0]], [[1.0]], [[-2.0]], [[1.0]])  # (s - 1)/(s + 1)
    >>> found = zeros(allpass)
    >>> found.values, found.kinds
    (array([1.+0.j]), ('transmission',))
    """
    m = as_model(model, "zeros")
    values, rank, reason = _found(m)
    S, n = system_matrix(m), m.n_states
    tested = [_tested(S, z, n, rank) for z in values.tolist()]
    residuals = np.array([left for _, left in tested], dtype=float)
    reason = reason or _doubt(m, values, rank, residuals)
    status = Status.INACCURATE if reason else Status.CONVERGED
    return Zeros(values, tuple(kind for kind, _ in tested), rank, residuals, status, reason, m.dt)


def transmission_zeros(model: Any, *, complete: bool = False) -> ComplexArray:
    """Return the ``values`` of `zeros` alone, shape (n_zeros,)."""
    values, _, reason = _found(as_model(model, "zeros"))
    if complete and reason:
        raise NoTrustworthyNumber("zeros", reason)
    return values


def _found(m: StateSpaceModel) -> tuple[ComplexArray, int, str]:
    """Find the zeros by rising modulus, the normal rank, and a reason why there may be others."""
    refuse_extremes(m, "zeros")
    S, n, rank = system_matrix(m), m.n_states, _rank_within_rounding(m)
    exactly = normal_rank(S, n) - n if n <= MOST_STATES else rank
    rank = min(rank, exactly)
    reason = f"the normal rank is {exactly}, and {rank} to within rounding of the entries" if rank < exactly else ""
    if n and rank == m.n_inputs == m.n_outputs and n <= MOST_STATES:
        try:
            found = [root.value for root in roots(determinant(S, n)[0]) for _ in range(root.multiplicity)]
        except NoTrustworthyNumber as error:
            reason = error.found
        else:
            found.sort(key=lambda z: (abs(z), z.imag))
            fastest = float(np.abs(m.poles()).max(initial=0.0))
            while found and abs(found[-1]) > fastest and _decided_by_rounding(S, n, found[-1], 0.0):
                del found[-1]
            return np.array(found, dtype=complex), rank, reason
    return slicot.invariant_zeros(m.A, m.B, m.C, m.D)[0], rank, reason


def _pencil(S: Array, s: complex, n: int) -> ComplexArray:
    P = S.astype(complex)
    P[range(n), range(n)] -= s
    return P


def _times_power(values: ComplexArray, exponents: AnyArray) -> ComplexArray:
    return np.ldexp(values.real, exponents) + 1j * np.ldexp(values.imag, exponents)


def _singular_values(P: ComplexArray, size: Array) -> Array:
    """Return the singular values of P with rows and columns scaled by powers of two, from ``size``."""
    r, c = equilibrating_exponents(size)
    return np.linalg.svd(_times_power(P, r[:, None] + c), compute_uv=False)


def _rank_within_rounding(m: StateSpaceModel) -> int:
    """Return the largest rank of the transfer matrix, up to NEARLY, at points in the range of its dynamics."""
    S, n, best = system_matrix(m), m.n_states, 0
    size = np.append(np.abs(m.poles()), np.abs(m.A).max(initial=0.0))
    size = size[size > 0]
    low, high = (size.min(), size.max()) if len(size) else (1.0, 1.0)
    for s in np.geomspace(low, high, 5) * 1.37 * np.exp(1.1j):
        sigma = _singular_values(_pencil(S, s, n), _pencil(np.abs(S), -abs(s), n).real)
        best = max(best, int((sigma > NEARLY * sigma.max(initial=0.0)).sum()) - n)
        if best == min(m.n_inputs, m.n_outputs):
            break
    return best


def _tested(S: Array, z: complex, n: int, rank: int) -> tuple[str, float]:
    """Test a zero in P(z): return its kind and its residual."""
    P, size = _pencil(S, z, n), _pencil(np.abs(S), -abs(z), n).real
    sigma, rows, columns = (_singular_values(P[part], size[part]) for part in (..., np.s_[:n], np.s_[:, :n]))
    hidden = "input-" * bool(rows[-1] <= HIDDEN * rows[0]) + "output-" * bool(columns[-1] <= HIDDEN * columns[0])
    kind = f"{hidden}decoupling" if hidden else "transmission"
    return kind, float(sigma[n + rank - 1] / sigma[0]) if sigma[0] else 0.0


def _decided_by_rounding(S: Array, n: int, z: complex, least: float) -> bool:
    r"""Return whether entrywise changes by ROUNDING may move the zero by DECIDED of itself, and by ``least`` at least.

    They make :math:`P(s)` singular at no point s with :math:`\rho(|P(s)^{-1}| |S|)` below 1 / ROUNDING.
    """
    if not np.isfinite(z):
        return True
    for turn in (1, 3, 5, 7):
        P = _pencil(S, z + max(DECIDED * abs(z), least) * np.exp(1j * np.pi / 4 * turn), n)
        r, c = equilibrating_exponents(P)
        try:
            back = np.linalg.inv(_times_power(P, r[:, None] + c))
        except np.linalg.LinAlgError:
            return True
        reach = np.abs(back) @ np.ldexp(np.abs(S), r[:, None] + c)
        if np.abs(np.linalg.eigvals(reach)).max() * ROUNDING >= 1:
            return True
    return False


def _doubt(m: StateSpaceModel, values: ComplexArray, rank: int, residuals: Array) -> str:
    """Return why the zeros are not accurate; empty if they are."""
    if (residuals > RESIDUAL).any():
        return f"P(s) at a zero misses a lower rank by {residuals.max():.1e}"
    if rank < max(m.n_inputs, m.n_outputs):
        return ""
    S, n = system_matrix(m), m.n_states
    least = STILL * float(np.abs(np.concatenate([m.poles(), values])).max(initial=0.0))
    for z in values.tolist():
        if z.imag >= 0 and (least or z) and _decided_by_rounding(S, n, z, least):
            return f"rounding of the model's entries decides where the zero {z:.6g} is"
    return ""
