r"""Matrices of balls, and the one test of definiteness that every proof here ends in.

A ball is a midpoint with a radius that holds the exact number; each operation returns a ball that holds the exact
result (python-flint: arb, acb). Floating point appears as a hint only: a preconditioner may be any matrix at all.

References
----------
Johansson, "Arb: efficient arbitrary-precision midpoint-radius interval arithmetic", IEEE Trans. Computers 66 (2017).
Rump, "Verification methods: rigorous results using floating-point arithmetic", Acta Numerica 19 (2010).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import flint
import numpy as np
from flint import acb_mat, arb, arb_mat
from numpy.typing import NDArray

PRECISIONS = (96, 192, 384)  # bits; each is tried where the one before left a claim undecided
REPEATS = 4  # preconditioners one after the other: each takes away twelve digits of ill conditioning
CLIPPED = 1e-13  # eigenvalues below this part of the largest are noise of floating point
INDEFINITE = -1e-9  # scaled so that the diagonal is 1, an eigenvalue below this is no noise

Matrix = Any  # arb_mat or acb_mat; their products mix


@contextmanager
def precision(bits: int) -> Iterator[None]:
    """Work in so many bits; the precision before is restored whatever happens."""
    before = flint.ctx.prec
    flint.ctx.prec = bits
    try:
        yield
    finally:
        flint.ctx.prec = before


def exact(X: NDArray[Any]) -> Matrix:
    """A matrix of doubles as balls of radius zero: the conversion from binary is exact in every precision."""
    kind: Any = acb_mat if np.iscomplexobj(X) else arb_mat
    return kind(*X.shape, X.ravel().tolist())


def identity(n: int) -> Matrix:
    """The identity."""
    return exact(np.eye(n))


def zeros(rows: int, cols: int) -> Matrix:
    """A matrix of zeros."""
    return arb_mat(rows, cols)


def diagonal(entries: Sequence[arb]) -> Matrix:
    """The diagonal matrix with these balls."""
    n = len(entries)
    return arb_mat(n, n, [entries[i] if i == j else 0 for i in range(n) for j in range(n)])


def adjoint(X: Matrix) -> Matrix:
    """The conjugate transpose."""
    return X.conjugate().transpose() if isinstance(X, acb_mat) else X.transpose()


def stack(grid: Sequence[Sequence[Matrix]]) -> Matrix:
    """One matrix out of blocks, given row by row of blocks."""
    kind = acb_mat if any(isinstance(X, acb_mat) for band in grid for X in band) else arb_mat
    rows, cols = sum(band[0].nrows() for band in grid), sum(X.ncols() for X in grid[0])
    lines = (line for band in grid for line in zip(*(X.tolist() for X in band), strict=True))
    return kind(rows, cols, [x for line in lines for cells in line for x in cells])


def part(X: Matrix, rows: slice, cols: slice) -> Matrix:
    """The block of ``X`` in these rows and columns."""
    r, c = range(*rows.indices(X.nrows())), range(*cols.indices(X.ncols()))
    return type(X)(len(r), len(c), [X[i, j] for i in r for j in c])


def magnitudes(X: Matrix) -> Matrix:
    """Upper bounds of the entries' absolute values, exact numbers."""
    return arb_mat(X.nrows(), X.ncols(), [x.abs_upper() for x in X.entries()])


def radii(X: Matrix) -> Matrix:
    """Upper bounds of how far the entries lie from their midpoints."""
    entries = X.entries()
    spread = [x.real.rad() + x.imag.rad() for x in entries] if isinstance(X, acb_mat) else [x.rad() for x in entries]
    return arb_mat(X.nrows(), X.ncols(), spread)


def midpoints(X: Matrix) -> NDArray[Any]:
    """The midpoints in floating point: a hint."""
    values = [complex(x) for x in X.entries()] if isinstance(X, acb_mat) else [float(x) for x in X.entries()]
    return np.array(values, dtype=complex if isinstance(X, acb_mat) else float).reshape(X.nrows(), X.ncols())


def inverse(X: Matrix) -> Matrix | None:
    """A ball matrix around the inverse of every matrix in ``X``; None where none could be proved regular."""
    try:
        return X.solve(identity(X.nrows()) if isinstance(X, arb_mat) else acb_mat(identity(X.nrows())))
    except ZeroDivisionError:
        return None


def rounded_up(x: arb) -> float:
    """A double that is not below any number in the ball."""
    return math.nextafter(float(x.upper()), math.inf)


def rounded_down(x: arb) -> float:
    """A double that is not above any number in the ball."""
    return math.nextafter(float(x.lower()), -math.inf)


@dataclass(frozen=True)
class Definite:
    """The answer of `definite`."""

    proved: bool
    least: float  # about the smallest eigenvalue in the middle, with a diagonal scaled to 1; a hint


def definite(F: Matrix, higher: Callable[[Matrix], Sequence[Matrix]] | None = None) -> Definite:
    r"""Whether F is positive definite; with ``higher`` :math:`F + \sum_{k \ge 1} e^k F_k` for every real |e| <= 1.

    ``F``: ball matrix (n, n) around a Hermitian one, as each F_k is.
    ``higher``: gives ball matrices around :math:`S^* F_k S`, k = 1, 2, ..., for the S that it is called with.

    Proof: for any square S, with :math:`Y_k = S^* F_k S`, if

    .. math:: \inf Y_{0,ii} > \sum_{(k, j) \ne (0, i)} \sup |Y_{k,ij}| \quad\text{for each } i ,

    then :math:`Y(e) = S^* F(e) S` is Hermitian, strictly diagonally dominant with a positive diagonal, so Y(e) > 0
    (Gershgorin). Then S is regular (S v = 0 would give v^* Y v = 0), and F(e) > 0. Nothing is asked of S, so floating
    point may choose it: a root of the inverse of F's midpoint, repeated where one is not accurate enough.
    """
    n = F.nrows()
    if n == 0:
        return Definite(True, math.inf)
    scale = [root for i in range(n) if (root := _root_scale(F[i, i])) is not None]
    if len(scale) < n:
        return Definite(False, -math.inf)
    scaled = type(F)(n, n, [F[i, j] * scale[i] * scale[j] for i in range(n) for j in range(n)])
    S, Y, least = diagonal(scale), scaled, 1.0
    for _ in range(REPEATS):
        if _dominant([Y]):
            return Definite(higher is None or _dominant([Y, *higher(S)]), least)
        hint = midpoints(Y)
        if not np.isfinite(hint).all():
            return Definite(False, -math.inf)
        hint = (hint + hint.conj().T) / 2
        try:
            S = S * exact(np.linalg.inv(np.linalg.cholesky(hint)).conj().T)
            least = min(least, float(np.linalg.eigvalsh(hint)[0]))
        except np.linalg.LinAlgError:
            values, vectors = np.linalg.eigh(hint)
            least = float(values[0])
            if least < INDEFINITE * abs(values[-1]):
                return Definite(False, least)
            S = S * exact(vectors / np.sqrt(np.maximum(values, CLIPPED * values[-1])))
        Y = adjoint(S) * F * S
    return Definite(False, least)


def _root_scale(x: Any) -> arb | None:
    """A power of two near ``x^(-1/2)``; None where x is not positive."""
    x = x.real.mid()
    if not x > 0 or not x.is_finite():
        return None
    mantissa, exponent = x.man_exp()
    return arb(2) ** (-(int(mantissa).bit_length() + int(exponent)) // 2)


def _dominant(Y: Sequence[Matrix]) -> bool:
    """Whether each diagonal entry of ``Y[0]`` outweighs all the other entries of its row in all the matrices."""
    rows = range(Y[0].nrows())
    for i in rows:
        rest = sum((X[i, j].abs_upper() for k, X in enumerate(Y) for j in rows if k or i != j), arb(0))
        if not Y[0][i, i].real > rest:
            return False
    return True
