"""Calls of SLICOT, in process through slycot; the results are checked by the callers.

Input is finite (SLICOT may not return from NaN), sizes fit, and every info code becomes `NoTrustworthyNumber`.
"""

from __future__ import annotations

import warnings
from functools import cache
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray, Array, ComplexArray
from robustlab.errors import NoTrustworthyNumber


def peak_gain(A: Array, B: Array, C: Array, D: Array, tolerance: float = 1e-6) -> tuple[float, float]:
    """Find the largest gain of a continuous model over the axis, and its frequency in rad/s (AB13DD)."""
    n, (p, m) = len(A), D.shape
    return _called("ab13dd", "C", "I", "S", "D", n, m, p, A, np.eye(n), B, C, D, tolerance)


def lyapunov_solution(A: Array, Q: Array, discrete: bool) -> Array:
    """Solve ``A X + X A^T + Q = 0``, or ``A X A^T - X + Q = 0``, for a symmetric Q (SB03MD, Bartels-Stewart)."""
    if not len(A):
        return np.zeros((0, 0))
    _, _, X, scale, *_ = _called("sb03md57", A.copy("F"), C=-Q, dico="D" if discrete else "C", trana="T")
    return X / scale


def gramian_factors(A: Array, B: Array, C: Array, discrete: bool) -> tuple[Array, Array]:
    """Return triangular L_c, L_o (n, n) of a stable model, ``P = L_c L_c^T``, ``Q = L_o L_o^T`` (SB03OD)."""
    dico, n = "D" if discrete else "C", len(A)
    into, out = np.zeros((n, n), order="F"), np.zeros((n, n), order="F")
    into[:, : B.shape[1]] = B if B.shape[1] <= n else np.asarray(np.linalg.qr(B.T, mode="r")).T
    out[: len(C)] = C if len(C) <= n else np.linalg.qr(C, mode="r")
    if not n:
        return into, out
    schur, turn = A.copy("F"), np.zeros((n, n), order="F")
    factored = "F" if into.any() else "N"  # SB03OD leaves the Schur form of A in them, but not at B = 0
    upper, scale, _ = _called("sb03od", n, n, schur, turn, into, dico, trans="T")
    lower, other, _ = _called("sb03od", n, n, schur, turn, out, dico, factored, "N")
    return upper[:n, :n] / scale, lower[:n, :n].T / other


def invariant_zeros(A: Array, B: Array, C: Array, D: Array) -> tuple[ComplexArray, int]:
    """Return the finite invariant zeros by rising modulus, and the normal rank (AB08ND, Emami-Naeini, Van Dooren)."""
    from scipy.linalg import eigvals

    if not len(A):
        return np.zeros(0, dtype=complex), int(np.linalg.matrix_rank(D)) if D.size else 0
    # AB08ND needs a row and a column: zeros are added where there is none, with the same result.
    into, out = int(not D.shape[1]), int(not len(D))
    B, C, D = np.pad(B, ((0, 0), (0, into))), np.pad(C, ((0, out), (0, 0))), np.pad(D, ((0, out), (0, into)))
    room = 8 * (len(A) + sum(D.shape))  # slycot's own size is too small for one state and three channels
    count, rank, *_, a, b = _called("ab08nd", len(A), *D.shape[::-1], A, B, C, D, equil="S", ldwork=room)
    found = np.asarray(eigvals(a[:count, :count], b[:count, :count])) if count else np.zeros(0)
    return found[np.argsort(np.abs(found), kind="stable")].astype(complex), int(rank)


@cache
def _slycot() -> Any:
    """Return the package with one BLAS thread: repeatable bits, and the quickest for small matrices."""
    import slycot
    from threadpoolctl import ThreadpoolController

    for library in ThreadpoolController().lib_controllers:
        if "slycot" in str(library.filepath):
            library.set_num_threads(1)
    return slycot


def _called(name: str, *arguments: Any, **options: Any) -> Any:
    slycot = _slycot()
    given: list[AnyArray] = [a.ravel() for a in (*arguments, *options.values()) if isinstance(a, np.ndarray)]
    if not np.isfinite(np.concatenate(given)).all():
        raise NoTrustworthyNumber(f"SLICOT {name.upper()}", "entries that are NaN or infinite", "finite numbers")
    wrong = slycot.exceptions.SlycotError, slycot.exceptions.SlycotWarning
    with warnings.catch_warnings():
        warnings.simplefilter("error", slycot.exceptions.SlycotWarning)
        try:
            return getattr(slycot, name)(*arguments, **options)
        except wrong as error:
            first = " ".join(str(error).split()).partition(" (")[0].partition(". ")[0]
            found = f"info {getattr(error, 'info', '?')}: {first}"
            raise NoTrustworthyNumber(f"SLICOT {name.upper()}", found) from None
