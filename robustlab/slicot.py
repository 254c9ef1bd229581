"""The one door to SLICOT: one checked wrapper per routine of slycot.

SLICOT loops for ever on NaN and cannot be interrupted, so finiteness and shapes are checked before every call, and
what comes back is checked for finiteness after it. Slycot is licensed under GPL-2.0; nothing else in robustlab
imports it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.errors import InputError, NoTrustworthyNumber

__all__ = ["ab13md"]

Array = NDArray[np.float64]


def _finite(routine: str, **arrays: NDArray) -> None:
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise InputError(f"{routine}: {name}", "NaN or infinite entries", "finite numbers")


def ab13md(
    Z: NDArray[np.complexfloating[Any, Any]], sizes: Sequence[int], real: Sequence[bool]
) -> tuple[float, Array, Array]:
    r"""Upper bound on mu of a square complex matrix, with the scalings that belong to it (cold start).

    .. math:: Z^* D Z + j (G Z - Z^* G) - \beta^2 D \preceq 0, \qquad D, G \text{ diagonal}

    Parameters
    ----------
    Z
        Complex matrix, shape (n, n), balanced: the routine keeps D within about 12 decades.
    sizes, real
        Size and kind of each block. Real blocks are 1 x 1; a complex block is full, and no scalar is repeated.

    Returns
    -------
    beta : float
        The bound. It is the routine's own word; `robustlab.mu_analysis.certificate` re-evaluates it.
    D, G : (n,) arrays
        Diagonals of D and G.

    Raises
    ------
    InputError
        NaN or Inf, shapes that do not fit, a real block larger than 1 x 1.
    NoTrustworthyNumber
        SLICOT reports an error.

    References
    ----------
    Fan, Tits, Doyle, "Robustness in the presence of mixed parametric uncertainty and unmodeled dynamics", IEEE TAC 36
    (1991).
    """
    z = np.array(Z, dtype=np.complex128, order="F")
    n = sum(sizes)
    if z.shape != (n, n):
        raise InputError("ab13md: Z", f"shape {z.shape}", f"{(n, n)}")
    if any(is_real and size != 1 for size, is_real in zip(sizes, real, strict=True)):
        raise InputError("ab13md", "a real block larger than 1 x 1", "real blocks of size 1")
    _finite("ab13md", Z=z)
    import slycot
    from slycot.exceptions import SlycotError

    try:
        # Warm starts (argument x) have been seen to give bounds 2.6 times too large: always cold.
        beta, d, g, _ = slycot.ab13md(z, np.array(sizes), np.array([1 if r else 2 for r in real]))
    except (SlycotError, ArithmeticError) as error:
        raise NoTrustworthyNumber("ab13md", f"SLICOT reports: {error}") from None
    if not (np.isfinite(beta) and np.isfinite(d).all() and np.isfinite(g).all()):
        raise NoTrustworthyNumber("ab13md", "SLICOT returned NaN or infinite numbers")
    return float(beta), np.asarray(d, dtype=float) ** 2, np.asarray(g, dtype=float)
