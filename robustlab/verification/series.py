r"""The rest of a Neumann series, bounded entry by entry.

Let X >= 0 and N >= 0 bound the moduli of two matrices' entries, and let a matrix Y >= 0 satisfy :math:`Y > X + N Y`
strictly in every entry. Then :math:`Y \ge \sum_k N^k X`, and, as Y > N Y and Y > 0, the spectral radius of N is below
1. So for every matrix S with :math:`|S| \le N` entry by entry I - S is regular, and
:math:`|(I - S)^{-1} Z| \le Y` for every :math:`|Z| \le X`. Floating point proposes Y, balls check it.
"""

from __future__ import annotations

import numpy as np

from robustlab.verification.balls import Matrix, exact, midpoints

DEGREE = 3  # of a polynomial before its rest: beyond it a box gets wider by less than its work grows
REACH = 0.6  # half width of a box over the distance of the nearest pole, at most: the series converges with this ratio
MARGIN = 1e-4  # by which a proposed bound of a rest is wider than floating point says
TINY = 1e-300


def neumann(N: Matrix, X: Matrix) -> Matrix | None:
    """A nonnegative ``Y > X + N Y`` (n, m), which proves what the module's text says; None where none was found."""
    n, x = midpoints(N), midpoints(X)
    if not x.size:
        return X
    if not (np.isfinite(n).all() and np.isfinite(x).all()):
        return None
    try:
        y = np.linalg.solve(np.eye(len(n)) - n, x * (1 + MARGIN) + MARGIN * MARGIN * x.max() + TINY)
    except np.linalg.LinAlgError:
        return None
    if not (np.isfinite(y).all() and (y >= 0).all()):
        return None
    Y = exact(y)
    return Y if all(v > s for v, s in zip(Y.entries(), (X + N * Y).entries(), strict=True)) else None
