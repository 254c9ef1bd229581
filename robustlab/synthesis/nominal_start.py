r"""A first controller for robust-performance synthesis: good nominal performance that does not rely on the model alone.

H-infinity synthesis for all channels of a perturbed plant weighs perturbations in the units they happen to have, and
its controller may be far from any good one. The nominal problem has the units of the specifications; but where nothing
in it disturbs the plant, its best controller is little more than a feedforward. A small disturbance on the controls
asks for feedback:

.. math:: u = K y + \eta \, \mathrm{diag}(\|T_{u_i w}\|_\infty) \, d
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.budget import Budget
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.frequency import default_grid, frequency_response
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.synthesis.hinf_synthesis import synthesize
from robustlab.synthesis.partition import GeneralizedPlant

__all__ = ["nominal_start"]

# eta: the disturbance's share of what the control does without it; and the factor above the smallest gamma that the
# calmer controllers of both designs may cost.
SHARE, GAMMA_REL = 0.03, 1.1
POINTS = 80


def nominal_start(plant: GeneralizedPlant, n_w: int, n_z: int, budget: Budget) -> StateSpaceModel | None:
    """H-infinity controller of the last ``n_w`` w and ``n_z`` z with a small disturbance on every control.

    None where no controller was verified, or where the control has nothing to do.
    """
    m, n_u, n_y = plant.model, plant.n_con, plant.n_meas
    into = np.arange(m.n_inputs - n_u - n_w, m.n_inputs)
    out = np.arange(m.n_outputs - n_y - n_z, m.n_outputs)
    B, C, D = m.B[:, into], m.C[out], m.D[out][:, into]
    try:
        bare = GeneralizedPlant(StateSpaceModel(m.A, B, C, D, m.dt), n_y, n_u)
        first = synthesize(bare, "hinf", GAMMA_REL, budget.share(0.5))
        size = SHARE * _effort(m.A, B, C[n_z:], D[n_z:], first.K)
        if not (np.isfinite(size).all() and size.any()):
            return None
        more_B, more_D = B[:, n_w:] * size, D[:, n_w:] * size
        disturbed = StateSpaceModel(m.A, np.hstack([more_B, B]), C, np.hstack([more_D, D]), m.dt)
        return synthesize(GeneralizedPlant(disturbed, n_y, n_u), "hinf", GAMMA_REL, budget).K
    except (InputError, NoTrustworthyNumber, np.linalg.LinAlgError):  # entries overflow, or nothing was verified
        return None


def _effort(A: NDArray[Any], B: NDArray[Any], C: NDArray[Any], D: NDArray[Any], K: StateSpaceModel) -> NDArray[Any]:
    """Largest gain from all w to each control on a grid, shape (n_u,); B, C, D from [w; u] to y."""
    n_u, n = K.n_outputs, len(A)
    n_w = B.shape[1] - n_u
    direct = np.hstack([np.zeros((n_u, n_w)), np.eye(n_u)])
    loop = lower_lft(StateSpaceModel(A, B, np.vstack([np.zeros((n_u, n)), C]), np.vstack([direct, D]), K.dt), _bare(K))
    return np.linalg.norm(frequency_response(loop, default_grid(loop, POINTS)), axis=2).max(axis=0)


def _bare(K: StateSpaceModel) -> StateSpaceModel:
    """Without names and units."""
    return StateSpaceModel(K.A, K.B, K.C, K.D, K.dt)
