"""Balanced truncation beside SLICOT's AB09AD, and the Hankel norm of an optimal error by the same routine."""

from __future__ import annotations

import numpy as np
import pytest
import slycot

import robustlab as rl


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize(("n", "m", "p", "order"), [(5, 1, 1, 2), (8, 2, 3, 4), (14, 3, 1, 6)])
def test_balanced_truncation_is_slicots(dt, n, m, p, order):
    rng = np.random.default_rng(n)
    A = rng.normal(size=(n, n))
    poles = np.linalg.eigvals(A)
    A = A / np.abs(poles).max() * 0.95 if dt else A - (poles.real.max() + 0.2) * np.eye(n)
    G = rl.StateSpaceModel(A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), rng.normal(size=(p, m)), dt)
    found = rl.reduce_model(G, order)
    reduced, a, b, c, values = slycot.ab09ad("D" if dt else "C", "B", "N", n, m, p, A, G.B, G.C, order)[:5]
    assert reduced == order
    np.testing.assert_allclose(found.hankel, values, rtol=1e-9, atol=1e-13 * values[0])
    omega = np.linspace(0, 20, 30)
    theirs = rl.frequency_response(rl.StateSpaceModel(a, b, c, G.D, dt), omega)
    ours = rl.frequency_response(found.model, omega)
    np.testing.assert_allclose(ours, theirs, atol=1e-9 * np.abs(theirs).max())


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize(("n", "m", "p", "order"), [(5, 1, 1, 2), (8, 2, 3, 4), (11, 3, 1, 0)])
def test_slicot_finds_the_next_value_as_the_hankel_norm_of_an_optimal_error(dt, n, m, p, order):
    rng = np.random.default_rng(n)
    A = rng.normal(size=(n, n))
    poles = np.linalg.eigvals(A)
    A = A / np.abs(poles).max() * 0.95 if dt else A - (poles.real.max() + 0.2) * np.eye(n)
    G = rl.StateSpaceModel(A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), rng.normal(size=(p, m)), dt)
    found = rl.reduce_model(G, order, method="hankel")
    assert found.status is rl.Status.CERTIFIED
    gap = G - found.model
    values = slycot.ab09ad("D" if dt else "C", "B", "N", gap.n_states, m, p, gap.A, gap.B, gap.C, 1)[4]
    assert values[0] == pytest.approx(found.hankel[order], rel=1e-8)
