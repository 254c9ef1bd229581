"""One weight alone: singular problems whose best controller is improper, against optima known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from robustlab import mixsyn
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel


def random_discrete(seed: int) -> StateSpaceModel:
    rng = np.random.default_rng(seed)
    A, B, C = rng.standard_normal((4, 4)) / 1.3, rng.standard_normal((4, 2)), rng.standard_normal((2, 4))
    return StateSpaceModel(A, B, C, np.zeros((2, 2)), 0.2)


def smallest_sensitivity(G: StateSpaceModel) -> float:
    """Skogestad, Postlethwaite 2005, eq. 6.8, at s = (z - 1) / (z + 1); D = 0 and CB regular: zeros at infinity too."""
    n, m = G.B.shape
    poles, modes = np.linalg.eig(G.A)
    pencil = np.block([[G.A, G.B], [G.C, G.D]]), scipy.linalg.block_diag(np.eye(n), np.zeros((m, m)))
    zeros, left = scipy.linalg.eig(*pencil, left=True, right=False)
    outside = [k for k in range(n + m) if np.isfinite(zeros[k]) and 1 < abs(zeros[k]) < 1e6]
    z = np.append((zeros[outside] - 1) / (zeros[outside] + 1), np.ones(m))
    y_z = np.hstack([left[n:, outside], np.eye(m)])
    unstable = np.abs(poles) > 1
    if not unstable.any():
        return 1.0
    p, y_p = ((poles - 1) / (poles + 1))[unstable], G.C @ modes[:, unstable]
    q_z = y_z.conj().T @ y_z / (z[:, None] + z.conj())
    q_p = y_p.conj().T @ y_p / (p.conj()[:, None] + p)
    q_zp = y_z.conj().T @ y_p / (z[:, None] - p)
    x = np.linalg.solve(q_z, q_zp @ np.linalg.solve(q_p, q_zp.conj().T))
    return float(np.sqrt(1 + np.abs(np.linalg.eigvals(x)).max()))


@pytest.mark.parametrize("seed", [2, 3, 4, 9, 12])
def test_sensitivity_alone_of_discrete_plants_reaches_the_optimum_of_poles_and_zeros(seed):
    G = random_discrete(seed)
    best = smallest_sensitivity(G)
    design = mixsyn(G, 1.0, gamma_rel=1.0)
    assert design.status is Status.CERTIFIED
    assert best * (1 - 1e-6) <= design.gamma <= best * 1.002


@pytest.mark.parametrize("gamma_rel", [1.0, 1.05])
@pytest.mark.parametrize(
    ("zero", "pole", "best"), [(1.0, -1.0, 1.0), (3.0, 0.5, 3.5 / 2.5), (2.0, 1.0, 3.0), (0.5, -4.0, 1.0)]
)
def test_sensitivity_alone_with_one_zero_and_one_pole(zero, pole, best, gamma_rel):
    """G = (s - zero) / (s - pole): max(1, |zero + pole| / |zero - pole|)."""
    G = StateSpaceModel([[pole]], [[1.0]], [[pole - zero]], [[1.0]])
    design = mixsyn(G, 1.0, gamma_rel=gamma_rel)
    assert design.status is Status.CERTIFIED
    assert best * (1 - 1e-6) <= design.smallest_gamma <= best * 1.001
    assert design.gamma <= gamma_rel * design.smallest_gamma * (1 + 1e-9)


def test_a_biproper_plant_without_unstable_zeros_has_sensitivity_as_small_as_wanted():
    design = mixsyn(StateSpaceModel([[1.0]], [[2.0]], [[1.0]], [[1.0]]), 1.0)
    assert design.status is Status.CERTIFIED
    assert design.gamma <= 1.1e-3
