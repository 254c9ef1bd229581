r"""A matrix P that proves an H-infinity norm, found in floating point; who checks it trusts nothing of it.

.. math:: -\begin{pmatrix} A^T P + P A + C^T C & P B + C^T D \\ B^T P + D^T C & D^T D - \gamma^2 I \end{pmatrix} > 0,
   \quad P > 0

holds strictly for the stabilising solution of the Riccati equation with :math:`C^T C + \varepsilon I` in the place of
:math:`C^T C`: the norm with :math:`\sqrt\varepsilon x` as further outputs is at most
:math:`\sqrt{\gamma_0^2 + \varepsilon h^2}`, h that from the inputs to the states. Discrete likewise.
"""

from __future__ import annotations

import numpy as np

from robustlab.arrays import Array
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.linear_analysis.magnitude import balancing_exponents
from robustlab.linear_analysis.matrix_equations import care, dare, judged_afterwards
from robustlab.norms.hinfinity import hinf_norm
from robustlab.statespace import StateSpaceModel

SHARE = 0.5  # of what lies between the level and the norm, squared, that the further outputs take up
LESS = (1.0, 1e-3, 1e-6)  # of it, one after the other, where the equation has no solution


def norm_matrix(model: StateSpaceModel, gamma: float, norm: float) -> Array | None:
    """P (n, n) for the level ``gamma`` above ``norm``, symmetric to the last bit; None where none was found."""
    n = model.n_states
    if not n or not model.n_inputs or not norm < gamma:
        return None
    t = np.exp2(balancing_exponents(model.A, model.B, model.C).astype(float))
    A, B, C, D = model.A / t[:, None] * t, model.B / t[:, None], model.C * t, model.D
    try:
        into = hinf_norm(StateSpaceModel(A, B, np.eye(n), np.zeros((n, model.n_inputs)), model.dt), 1e-2).upper
    except (InputError, NoTrustworthyNumber):
        return None
    if not 0 < into < np.inf:
        return None
    room = SHARE * (gamma - norm) * (gamma + norm) / into**2
    solve = dare if model.is_discrete else care
    for less in LESS:
        try:
            with judged_afterwards():
                X = solve(A, B, C.T @ C + less * room * np.eye(n), D.T @ D - gamma**2 * np.eye(len(D.T)), C.T @ D).X
        except (InputError, NoTrustworthyNumber):
            continue
        P = X / t[:, None] / t
        P = 0.5 * (P + P.T)
        return P if np.isfinite(P).all() else None
    return None
