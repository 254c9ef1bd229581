"""Hidden modes stay hidden, and visible ones visible, whatever coordinates and units the model comes in."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab.linear_analysis import drop_unconnected

QUICK = settings(max_examples=50)
SEEDS = st.integers(0, 2**32 - 1)


def hidden_system(rng, n, hidden, n_u):
    """(A, B) with ``hidden`` uncontrollable modes of known eigenvalues, in random orthogonal coordinates."""
    a, b = rng.normal(size=(n, n)), rng.normal(size=(n, n_u))
    a[n - hidden :, : n - hidden] = 0
    b[n - hidden :] = 0
    poles = np.linalg.eigvals(a[n - hidden :, n - hidden :])
    q = np.linalg.qr(rng.normal(size=(n, n)))[0]
    return q @ a @ q.T, q @ b, poles


def matched(found, expected, tol):
    found = list(found)
    for value in expected:
        k = int(np.argmin(np.abs(np.array(found) - value)))
        assert abs(found.pop(k) - value) < tol


@QUICK
@given(seed=SEEDS, n=st.integers(1, 9), data=st.data())
def test_rank_and_modes_of_constructed_systems(seed, n, data):
    rng = np.random.default_rng(seed)
    hidden = data.draw(st.integers(0, n))
    a, b, poles = hidden_system(rng, n, hidden, data.draw(st.integers(1, 3)))
    scale = 10 ** rng.uniform(-6, 6, n)  # units of the states
    volts = 10 ** rng.uniform(-6, 6, b.shape[1])  # units of the inputs
    a, b = a * scale[:, None] / scale, b * scale[:, None] * volts
    one = rl.controllability(rl.StateSpaceModel(a, b, np.eye(n), np.zeros_like(b)))
    assert one.rank == n - hidden
    matched([m.eigenvalue for m in one.modes], poles, 1e-6)
    dual = rl.observability(rl.StateSpaceModel(a.T, np.eye(n), b.T, np.zeros_like(b.T)))
    assert dual.rank == one.rank
    assert dual.margin == one.margin


@QUICK
@given(seed=SEEDS, n=st.integers(0, 8))
def test_drop_unconnected_changes_no_response(seed, n):
    rng = np.random.default_rng(seed)
    sparse = rng.normal(size=(n, n)) * (rng.random((n, n)) < 0.3) - 3 * np.eye(n)
    b, c = rng.normal(size=(n, 2)) * (rng.random((n, 2)) < 0.4), rng.normal(size=(2, n)) * (rng.random((2, n)) < 0.4)
    full = rl.StateSpaceModel(sparse, b, c, rng.normal(size=(2, 2)))
    part = drop_unconnected(full)
    omega = np.geomspace(0.01, 100, 9)
    np.testing.assert_allclose(
        rl.frequency_response(part, omega), rl.frequency_response(full, omega), rtol=1e-9, atol=1e-12
    )
    # what is left is connected: dropping again drops nothing
    assert drop_unconnected(part).n_states == part.n_states
