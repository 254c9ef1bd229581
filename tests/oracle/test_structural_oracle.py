"""Ranks against python-control's ctrb and obsv on small, well-scaled models with small whole numbers (exact there)."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components

import robustlab as rl
from robustlab.linear_analysis import strong_components


@pytest.mark.parametrize("seed", range(40))
def test_rank_of_ctrb_and_obsv(seed):
    import control

    rng = np.random.default_rng(seed)
    n, n_u, n_y = rng.integers(1, 6), rng.integers(1, 3), rng.integers(1, 3)
    a = rng.integers(-1, 2, (n, n)).astype(float)
    b, c = rng.integers(-1, 2, (n, n_u)).astype(float), rng.integers(-1, 2, (n_y, n)).astype(float)
    model = rl.StateSpaceModel(a, b, c, np.zeros((n_y, n_u)))
    # whole numbers of at most a few hundred: the rank is exact
    assert rl.controllability(model).rank == np.linalg.matrix_rank(control.ctrb(a, b))
    assert rl.observability(model).rank == np.linalg.matrix_rank(control.obsv(a, c))


@pytest.mark.parametrize("density", [0.05, 0.15, 0.4])
def test_strong_components_are_those_of_scipy(density):
    rng = np.random.default_rng(5)
    for n in (1, 2, 5, 30):
        acts = rng.random((n, n)) < density
        count, labels = connected_components(acts, directed=True, connection="strong")
        found = strong_components(acts)
        assert sorted(set(found)) == list(range(count))
        assert ((found[:, None] == found) == (labels[:, None] == labels)).all()


def test_a_long_cycle_is_one_component_and_a_chain_none():
    chain = np.eye(200, k=1, dtype=bool)
    assert (strong_components(chain) == np.arange(200)).all()
    chain[-1, 0] = True
    assert not strong_components(chain).any()
