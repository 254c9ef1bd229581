r"""Controllers near one that cannot take the plant's direct term D22 back in.

Synthesis leaves D22 out and gives the controller for the whole plant as :math:`K (I + D_{22} K)^{-1}`. Without a
penalty on the control the optimum often makes :math:`I + D_{22} D_K` singular: sensitivity at infinite frequency wants
to be zero. That controller is improper (of a discrete plant only the bilinear image is: K has a pole at z = -1); with
a direct term a little beside it, it is proper and its loop almost the same.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.synthesis.partition import Realisation

__all__ = ["well_posed_neighbours"]

Array = NDArray[Any]

# Smallest singular values of I + D22 D_K that are aimed at where it has smaller ones.
DISTANCES = (1e-4, 1e-3, 1e-2, 1e-1)


def well_posed_neighbours(K: Realisation, D22: Array) -> list[Realisation]:
    r"""K itself where ``I + D22 D_K`` is far from singular; else controllers with the smallest change of ``D_K``.

    With :math:`I + D_{22} D_K = U \Sigma V^T` the small singular values are raised to each of `DISTANCES`:

    .. math:: \Delta D_K = D_{22}^+ \, U \max(\delta - \Sigma, 0) V^T

    Parameters
    ----------
    K
        Controller for the plant without D22.
    D22
        The direct term, shape (n_y, n_u).
    """
    with np.errstate(all="ignore"):
        back = np.eye(len(D22)) + D22 @ K.D
    if not np.isfinite(back).all():  # K overflows
        return []
    U, s, Vt = np.linalg.svd(back)
    if s[-1] >= DISTANCES[0]:
        return [K]
    inverse = np.linalg.pinv(D22, rcond=1e-10)
    return [K._replace(D=K.D + inverse @ (U * np.maximum(delta - s, 0.0)) @ Vt) for delta in DISTANCES]
