"""Reduction of models: closed forms, published Hankel values, modes kept apart, weights, bad requests, edge sizes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from slicot_examples import model_of_ab09ad

import robustlab as rl
from robustlab.result import Status


def stable_model(n: int, seed: int, dt: float = 0.0, m: int = 2, p: int = 3) -> rl.StateSpaceModel:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    poles = np.linalg.eigvals(A) if n else np.zeros(1)
    A = A / np.abs(poles).max() * 0.9 if dt else A - (poles.real.max() + 0.3) * np.eye(n)
    return rl.StateSpaceModel(A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), rng.normal(size=(p, m)), dt)


def difference_on_grid(one, two, omega):
    gap = rl.frequency_response(one, omega) - rl.frequency_response(two, omega)
    return np.linalg.norm(gap, 2, axis=(1, 2)).max()


def test_hankel_values_of_slicots_documented_example():
    # The example in the documentation of AB09AD (SLICOT 5.0): its Hankel singular values, printed to four digits.
    values = rl.reduce_model(model_of_ab09ad(), 5).hankel
    np.testing.assert_allclose(values, [2.5139, 2.0846, 1.9178, 0.7666, 0.5473, 0.0253, 0.0246], atol=6e-5)


def test_truncation_of_two_states_by_hand():
    # a balanced model: A_ij = -b_i b_j / (s_i + s_j) solves A S + S A^T + B B^T = 0 with S = diag(s), and C = B^T.
    sigma, b = np.array([2.0, 0.1]), np.array([1.0, 0.5])
    G = rl.StateSpaceModel(-np.outer(b, b) / np.add.outer(sigma, sigma), b[:, None], b[None], [[0.0]])
    found = rl.reduce_model(G, 1)
    np.testing.assert_allclose(found.hankel, sigma, rtol=1e-12)
    np.testing.assert_allclose(found.model.poles(), [-0.25], rtol=1e-10)  # -b1^2 / (2 s1)
    assert found.promised == pytest.approx(0.2, rel=1e-12)
    assert found.bound == max(found.promised, found.error.upper)
    assert found.error.upper == pytest.approx(0.2, rel=1e-5)  # the last value left out alone: the bound is attained


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_modes_that_are_not_stable_are_kept(dt):
    G = stable_model(6, 2, dt, 1, 1)
    unstable = np.array([[0.3, 2.0], [-2.0, 0.3]]) if not dt else np.array([[1.1]])
    integrator = np.array([[1.0 if dt else 0.0]])
    A = np.block([
        [G.A, np.ones((6, len(unstable))), np.zeros((6, 1))],
        [np.zeros((len(unstable), 6)), unstable, np.ones((len(unstable), 1))],
        [np.zeros((1, 6 + len(unstable))), integrator],
    ])  # fmt: skip
    n = len(A)
    full = rl.StateSpaceModel(A, np.ones((n, 1)), np.ones((1, n)), [[0.5]], dt)
    found = rl.reduce_model(full, n - 3)
    assert found.n_apart == len(unstable) + 1
    kept = np.concatenate([np.linalg.eigvals(unstable), integrator[0]])
    for pole in kept:
        assert np.abs(found.model.poles() - pole).min() < 1e-7
    omega = np.linspace(0.3, 9, 50)
    assert difference_on_grid(full, found.model, omega) <= found.error.upper * (1 + 1e-6)
    assert found.status is Status.CERTIFIED
    with pytest.raises(rl.InputError, match="not stable and are kept apart"):
        rl.reduce_model(full, found.n_apart - 1)


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_coprime_factors_reduce_unstable_modes_and_bound_the_gap(dt):
    from robustlab import nu_gap

    rng = np.random.default_rng(4)
    A = rng.normal(size=(7, 7))
    A = A / np.abs(np.linalg.eigvals(A)).max() * 1.2 if dt else A
    full = rl.StateSpaceModel(A, rng.normal(size=(7, 2)), rng.normal(size=(2, 7)), np.zeros((2, 2)), dt)
    assert not full.is_stable()
    found = rl.reduce_model(full, 5, method="coprime")
    assert found.order == 5
    assert found.status is Status.CERTIFIED
    assert found.error.upper <= found.bound * (1 + 1e-6)
    # Vinnicombe 2001: the nu-gap is at most the norm of a change of the normalised right factors.
    assert nu_gap(full, found.model).lower <= found.error.upper * (1 + 1e-6)
    unstable = [np.abs(m.poles()).max() > 1 if dt else m.poles().real.max() > 0 for m in (full, found.model)]
    assert unstable == [True, True]


def test_the_lowest_order_within_the_tolerance_is_chosen():
    G = stable_model(9, 11)
    errors = [rl.reduce_model(G, r).error.upper for r in range(9)]
    tolerance = 0.5 * (errors[4] + errors[3])
    found = rl.reduce_model(G, tolerance=tolerance)
    assert found.order == min(r for r in range(9) if errors[r] <= tolerance)
    assert found.error.upper <= tolerance


@pytest.mark.parametrize("n_u", [0, 1, 2])
@pytest.mark.parametrize("method", ["truncation", "residualisation"])
def test_sizes_at_the_edge(n_u, method):
    static = rl.StateSpaceModel(np.zeros((0, 0)), np.zeros((0, n_u)), np.zeros((1, 0)), np.ones((1, n_u)))
    assert rl.reduce_model(static, 0, method=method).order == 0
    deaf = rl.StateSpaceModel([[-1.0]], np.zeros((1, n_u)), [[1.0]], np.ones((1, n_u)))
    found = rl.reduce_model(deaf, 1, method=method)
    assert found.order == 0
    assert found.error.upper == pytest.approx(0.0, abs=1e-12)


# --- least order --------------------

COPIED = rl.StateSpaceModel(  # [1/(s-1); 1/((s-1)(s+2))] with the unstable pole twice
    [[1, 0, 0], [0, -1, 2], [0, 1, 0]], [[1], [1], [0]], [[1, 0, 0], [0, 0, 1]], [[0], [0]], states=["p", "q", "r"]
)


def test_a_minimal_model_is_exact_if_the_cancellation_is():
    found = rl.minimal(COPIED)
    assert (found.order, found.error.upper, found.status.value) == (2, 0.0, "certified")
    assert found.removed == ("unstable mode 1 rad/s in p, q, r: no input moves it",)
    assert_allclose(found.model(2j), COPIED(2j), rtol=1e-14)
    assert rl.minimal(found).order == 2
    static = rl.minimal(rl.ss([[2.0, 1.0]]))
    assert (static.order, static.error.upper) == (0, 0.0)
    assert (
        rl.minimal(rl.StateSpaceModel(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 0)))).order
        == 0
    )


@pytest.mark.parametrize("method", ["truncation", "coprime"])
def test_reduction_is_exact_where_an_exact_model_of_that_order_exists(method):
    found = rl.reduce_model(COPIED, 2, method=method)  # truncation kept both copies, and an error of 1/6
    assert found.order == 2
    assert found.error.upper < 1e-12
    assert found.removed == ("unstable mode 1 rad/s in p, q, r: no input moves it",)
    assert_allclose(found.model(2j), COPIED(2j), rtol=1e-12)


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(4))
def test_hidden_modes_in_mixed_states_are_found(seed, dt):
    rng = np.random.default_rng(seed)
    poles = [1.0, 1.0, 1.0, -1.0, 0.5, 2.0] if dt else [0.0, 0.0, 0.0, 1.0, -1.0, -3.0]
    A = np.diag(poles) + np.diag([1.0, 0, 0, 0, 0], 1)
    # One of two Jordan blocks of the first pole without input, the last pole without output.
    B, C = rng.normal(size=(6, 2)), rng.normal(size=(2, 6))
    B[2], C[:, 5] = 0.0, 0.0
    T, units = np.linalg.qr(rng.normal(size=(6, 6)))[0], 10.0 ** rng.integers(-6, 7, 6)
    T, back = units[:, None] * T, T.T / units
    G = rl.StateSpaceModel(T @ A @ back, T @ B, C @ back, np.eye(2), dt)
    found = rl.minimal(G)
    assert found.order == 4
    assert len(found.removed) == 2
    for s in np.exp([0.4j, 1j]) if dt else (2 + 1j, 0.5j):
        wanted = C @ np.linalg.solve(s * np.eye(6) - A, B) + np.eye(2)
        assert_allclose(found.model(s), wanted, rtol=1e-9)
