r"""The D-G inequality proved in ball arithmetic: no rounding error is estimated, every one is enclosed.

References
----------
Johansson, "Arb: efficient arbitrary-precision midpoint-radius interval arithmetic", IEEE Trans. Computers 66 (2017).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.errors import DependencyMissing, InputError

__all__ = ["certified_in_balls"]

PRECISIONS = (128, 512, 2048)  # bits; the next where the one before cannot decide


def certified_in_balls(M: ArrayLike, D: ArrayLike, G: ArrayLike, beta: float, D_z: ArrayLike | None = None) -> bool:
    r"""Whether D > 0 and the D-G inequality hold strictly, with all numbers taken as the exact doubles they are.

    .. math:: \beta^2 D - M^* D_z M - j (G M - M^* G^*) \succ 0

    Proved by the pivots of an LDL factorisation in ball arithmetic, all of whose balls lie right of zero. Together with
    the structure of D and G (`certificate.has_structure`) this proves ``mu(M) <= beta``.

    Parameters
    ----------
    M
        Matrix (p, q), finite.
    D, D_z
        Hermitian scalings (q, q) and (p, p); ``D_z = D`` where it is left out.
    G
        Scaling (q, p).
    beta
        The bound.

    Raises
    ------
    InputError
        Shapes that do not fit, D not Hermitian to the last bit, NaN or Inf.
    DependencyMissing
        python-flint is not installed.

    Examples
    --------
    >>> from robustlab.mu_analysis.matrix.ball_proof import certified_in_balls
    >>> certified_in_balls([[0, 4], [1, 0]], [[1, 0], [0, 4]], [[0, 0], [0, 0]], 2.0000001)
    True
    >>> certified_in_balls([[0, 4], [1, 0]], [[1, 0], [0, 4]], [[0, 0], [0, 0]], 1.9999999)
    False
    """
    try:
        import flint
    except ImportError:
        raise DependencyMissing("mu --certify needs python-flint", "pip install 'robustlab[certify]'") from None

    plant, d_w, g = (np.asarray(part, dtype=np.complex128) for part in (M, D, G))
    d_z = d_w if D_z is None else np.asarray(D_z, dtype=np.complex128)
    _check(plant, d_w, d_z, g, beta)
    before = flint.ctx.prec
    try:
        for bits in PRECISIONS:
            flint.ctx.prec = bits
            if _proved(flint, plant, d_w, d_z, g, float(beta)):
                return True
    finally:
        flint.ctx.prec = before
    return False


def _check(M: NDArray, D: NDArray, D_z: NDArray, G: NDArray, beta: float) -> None:
    if M.ndim != 2:
        raise InputError("certified_in_balls: M", f"shape {M.shape}", "one matrix")
    p, q = M.shape
    for name, part, shape in (("D", D, (q, q)), ("D_z", D_z, (p, p)), ("G", G, (q, p))):
        if part.shape != shape:
            raise InputError(f"certified_in_balls: {name}", f"shape {part.shape}", f"{shape}")
    for name, part in (("M", M), ("D", D), ("D_z", D_z), ("G", G), ("beta", np.asarray(beta))):
        if not np.isfinite(part).all():
            raise InputError(f"certified_in_balls: {name}", "NaN or infinity", "finite numbers")
    for name, part in (("D", D), ("D_z", D_z)):
        if not (part == part.conj().T).all():
            raise InputError(f"certified_in_balls: {name}", "not Hermitian to the last bit", "a Hermitian matrix")


def _proved(flint: Any, M: NDArray, D: NDArray, D_z: NDArray, G: NDArray, beta: float) -> bool:
    """One attempt in the current precision."""
    if not M.size:
        return True
    plant, d_w, d_z, g = (_balls(flint, part) for part in (M, D, D_z, G))
    square = flint.arb(beta) ** 2
    product = g * plant
    value = square * d_w - plant.conjugate().transpose() * d_z * plant
    value -= flint.acb(0, 1) * (product - product.conjugate().transpose())
    return _positive_definite(d_w) and _positive_definite(value)


def _balls(flint: Any, X: NDArray) -> Any:
    return flint.acb_mat([[flint.acb(float(v.real), float(v.imag)) for v in row] for row in X])


def _positive_definite(X: Any) -> bool:
    """Whether all pivots of an enclosed Hermitian matrix are positive for certain."""
    n = X.nrows()
    rows = [[X[i, j] for j in range(i + 1)] for i in range(n)]
    for k in range(n):
        # The matrix is Hermitian, so its pivots are real: the imaginary part of the ball is rounding.
        pivot = rows[k][k].real
        if not pivot > 0:
            return False
        column = [rows[i][k] for i in range(k + 1, n)]
        for i in range(k + 1, n):
            share = rows[i][k] / pivot
            for j in range(k + 1, i + 1):
                rows[i][j] -= share * column[j - k - 1].conjugate()
    return True
