r"""Matrices of balls, and the test of definiteness that every proof here uses.

A ball is a midpoint with a radius that holds the exact number; each operation returns a ball that holds the exact
result (python-flint: arb, acb). Floating point only provides hints, as a preconditioner may be any matrix.

References
----------
Johansson, "Arb: efficient arbitrary-precision midpoint-radius interval arithmetic", IEEE Trans. Computers 66 (2017).
Rump, "Verification methods: rigorous results using floating-point arithmetic", Acta Numerica 19 (2010).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import flint
import numpy as np
from flint import acb_mat, arb, arb_mat
from numpy.typing import NDArray

PRECISIONS = (96, 192, 384)  # bits; each is tried where the one before did not decide
REPEATS = 4  # preconditioners in sequence: each removes twelve digits of ill conditioning
CLIPPED = 1e-13  # eigenvalues below this part of the largest are rounding
INDEFINITE = -1e-9  # with the diagonal scaled to 1, an eigenvalue below this is not rounding

Matrix = Any  # arb_mat or acb_mat; their products mix


@contextmanager
def precision(bits: int) -> Iterator[None]:
    """Set the precision in bits, and restore it afterwards."""
    before = flint.ctx.prec
    flint.ctx.prec = bits
    try:
        yield
    finally:
        flint.ctx.prec = before


def exact(X: NDArray[Any]) -> Matrix:
    """Convert a matrix of doubles to balls of radius zero; exact in every precision."""
    kind: Any = acb_mat if np.iscomplexobj(X) else arb_mat
    return kind(*X.shape, X.ravel().tolist())


def identity(n: int) -> Matrix:
    return exact(np.eye(n))


def zeros(rows: int, cols: int) -> Matrix:
    return arb_mat(rows, cols)


def diagonal(entries: Sequence[arb]) -> Matrix:
    n = len(entries)
    return arb_mat(n, n, [entries[i] if i == j else 0 for i in range(n) for j in range(n)])


def adjoint(X: Matrix) -> Matrix:
    return X.conjugate().transpose() if isinstance(X, acb_mat) else X.transpose()


def stack(grid: Sequence[Sequence[Matrix]]) -> Matrix:
    """Join blocks, given row by row, to one matrix."""
    kind = acb_mat if any(isinstance(X, acb_mat) for band in grid for X in band) else arb_mat
    rows, cols = sum(band[0].nrows() for band in grid), sum(X.ncols() for X in grid[0])
    lines = (line for band in grid for line in zip(*(X.tolist() for X in band), strict=True))
    return kind(rows, cols, [x for line in lines for cells in line for x in cells])


def part(X: Matrix, rows: slice, cols: slice) -> Matrix:
    r, c = range(*rows.indices(X.nrows())), range(*cols.indices(X.ncols()))
    return type(X)(len(r), len(c), [X[i, j] for i in r for j in c])


def magnitudes(X: Matrix) -> Matrix:
    """Return exact upper bounds of the entries' absolute values."""
    return arb_mat(X.nrows(), X.ncols(), [x.abs_upper() for x in X.entries()])


def radii(X: Matrix) -> Matrix:
    """Return upper bounds of the entries' radii."""
    entries = X.entries()
    spread = [x.real.rad() + x.imag.rad() for x in entries] if isinstance(X, acb_mat) else [x.rad() for x in entries]
    return arb_mat(X.nrows(), X.ncols(), spread)


def midpoints(X: Matrix) -> NDArray[Any]:
    """Return the midpoints in floating point, as a hint."""
    values = [complex(x) for x in X.entries()] if isinstance(X, acb_mat) else [float(x) for x in X.entries()]
    return np.array(values, dtype=complex if isinstance(X, acb_mat) else float).reshape(X.nrows(), X.ncols())


def inverse(X: Matrix) -> Matrix | None:
    """Return a ball matrix that holds the inverse of every matrix in ``X``; None where regularity was not proved."""
    try:
        return X.solve(identity(X.nrows()) if isinstance(X, arb_mat) else acb_mat(identity(X.nrows())))
    except ZeroDivisionError:
        return None


def rounded_up(x: arb) -> float:
    """Return a double that is not below any number in the ball."""
    return math.nextafter(float(x.upper()), math.inf)


def rounded_down(x: arb) -> float:
    """Return a double that is not above any number in the ball."""
    return math.nextafter(float(x.lower()), -math.inf)


@dataclass(frozen=True)
class Definite:
    """The result of `definite`."""

    proved: bool
    least: float  # estimate of the midpoint's smallest eigenvalue, with a diagonal scaled to 1


def definite(F: Matrix) -> Definite:
    r"""Test F > 0 for a ball matrix (n, n) around a Hermitian one.

    For any square S, if :math:`Y = S^* F S` is strictly diagonally dominant with a positive diagonal, F > 0
    (theorems.md). Floating point chooses S: a root of the inverse of F's midpoint, repeated where needed.
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
        if _dominant(Y):
            return Definite(True, least)
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
    """Return a power of two near ``x^(-1/2)``; None where x is not positive."""
    x = x.real.mid()
    if not x > 0 or not x.is_finite():
        return None
    mantissa, exponent = x.man_exp()
    return arb(2) ** (-(int(mantissa).bit_length() + int(exponent)) // 2)


def _dominant(Y: Matrix) -> bool:
    """Test whether each diagonal entry exceeds the sum of its row's other entries."""
    rows = range(Y.nrows())
    return all(Y[i, i].real > sum((Y[i, j].abs_upper() for j in rows if i != j), arb(0)) for i in rows)
