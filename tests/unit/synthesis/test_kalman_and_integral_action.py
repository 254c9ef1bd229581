"""Kalman filters and integral action against recursions, python-control, closed forms and simulation."""

from __future__ import annotations

import control
import numpy as np
import pytest
from scipy.linalg import expm

import robustlab as rl
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.result import Status


def random_model(seed: int, n=4, p=2, m=2, dt=0.0) -> rl.StateSpaceModel:
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    return rl.StateSpaceModel(
        A / (1.5 if dt else 1), rng.standard_normal((n, m)), rng.standard_normal((p, n)), np.zeros((p, m)), dt,
        inputs=[f"u{k}" for k in range(m)], outputs=[f"y{k}" for k in range(p)],
    )  # fmt: skip


def random_noise(seed: int, n=4, p=2):
    F = np.random.default_rng(seed).standard_normal((n + p, n + p + 1))
    both = F @ F.T
    return both[:n, :n], both[n:, n:], both[:n, n:]


# --- Kalman filter ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_continuous_filter_equals_python_control(seed):
    g, (W, V, _) = random_model(seed), random_noise(seed)
    found = rl.kalman(g, W, V)
    L, P, poles = control.lqe(g.A, np.eye(4), g.C, W, V)
    np.testing.assert_allclose(found.L, L, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(found.P, P, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(np.sort_complex(found.poles), np.sort_complex(poles), rtol=1e-6)
    assert found.status is Status.CONVERGED


@pytest.mark.parametrize("seed", range(5))
def test_discrete_filter_is_where_the_recursion_of_the_covariance_ends(seed):
    g, (W, V, N) = random_model(seed, dt=0.1), random_noise(seed)
    P = np.eye(4)
    for _ in range(3000):
        L = (g.A @ P @ g.C.T + N) @ np.linalg.inv(g.C @ P @ g.C.T + V)
        P = g.A @ P @ g.A.T + W - L @ (g.C @ P @ g.A.T + N.T)
    found = rl.kalman(g, W, V, N)
    np.testing.assert_allclose(found.P, P, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(found.L, L, rtol=1e-7, atol=1e-9)
    assert found.status is Status.CONVERGED


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_no_other_gain_has_a_smaller_error(dt):
    """The covariance of any gain, from the Lyapunov equation of its error as a linear system in all entries."""
    g, (W, V, N) = random_model(7, dt=dt), random_noise(7)
    found = rl.kalman(g, W, V, N)
    one = np.eye(4)

    def covariance(L):
        F, noise = g.A - L @ g.C, W + L @ V @ L.T - N @ L.T - L @ N.T
        whole = np.kron(F, F) - np.eye(16) if dt else np.kron(one, F) + np.kron(F, one)
        return np.linalg.solve(whole, -noise.ravel(order="F")).reshape(4, 4, order="F")

    best = np.trace(covariance(found.L))
    assert best == pytest.approx(np.trace(found.P), rel=1e-9)
    rng = np.random.default_rng(0)
    for _ in range(20):
        assert np.trace(covariance(found.L + 1e-3 * rng.standard_normal(found.L.shape))) > best


def test_the_estimator_follows_the_states_of_its_model():
    g = random_model(3)
    found = rl.kalman(g, np.eye(4), np.eye(2))
    e = found.estimator
    assert e.input_names == (*g.input_names, *g.output_names)
    assert e.output_names == tuple(f"{x} estimated" for x in g.state_names)
    # Model and filter side by side, held inputs: the error obeys A - L C alone and vanishes.
    whole = np.block([[g.A, np.zeros((4, 4)), g.B], [e.B[:, 2:] @ g.C, e.A, e.B[:, :2]], [np.zeros((2, 10))]])
    x = np.concatenate([[1.0, -2.0, 0.5, 1.0], np.zeros(4), [1.0, -1.0]])
    slowest = -found.poles.real.max()
    for _ in range(10):
        x = expm(whole * (2.5 / slowest)) @ x
        x[:10] /= max(np.abs(x).max(), 1e-300) if np.abs(x).max() > 1e6 else 1.0
    assert np.abs(x[:4] - x[4:8]).max() < 1e-6 * max(1.0, np.abs(x[:4]).max())


def test_names_that_collide_are_told_apart():
    g = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["a"], outputs=["a"])
    assert rl.kalman(g, [[1.0]], [[1.0]]).estimator.input_names == ("a", "a measured")


def test_what_no_filter_can_do_is_named():
    hidden = rl.StateSpaceModel(np.diag([1.0, -2.0]), [[1.0], [1.0]], [[0.0, 1.0]], [[0.0]])
    with pytest.raises(NoTrustworthyNumber, match=r"^kalman: no filter with a stable error exists: .*x1"):
        rl.kalman(hidden, np.eye(2), [[1.0]])
    integrator = rl.StateSpaceModel([[0.0]], [[1.0]], [[1.0]], [[0.0]])
    with pytest.raises(NoTrustworthyNumber, match=r"^kalman: .*"):
        rl.kalman(integrator, [[0.0]], [[1.0]])
    with pytest.raises(InputError, match="measurement y1 has no noise"):
        rl.kalman(integrator, [[1.0]], [[0.0]])
    with pytest.raises(InputError, match=r"^kalman: N: shape \(2, 1\), expected \(1, 1\)"):
        rl.kalman(integrator, [[1.0]], [[1.0]], [[0.0], [1.0]])
    with pytest.raises(InputError, match=r"positive semidefinite"):
        rl.kalman(integrator, [[1.0]], [[1.0]], [[2.0]])


# --- integral action -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_integral_action_equals_python_control(seed):
    """There the integrators take +y: their gains have the other sign."""
    g = random_model(seed)
    F = np.random.default_rng(seed).standard_normal((6, 6))
    found = rl.lqi(g, F @ F.T, np.eye(2))
    flip = np.diag([1.0] * 4 + [-1.0] * 2)
    K, _, poles = control.lqr(g.to_control(), flip @ F @ F.T @ flip, np.eye(2), integral_action=g.C)
    np.testing.assert_allclose(np.hstack([found.K, -found.K_i]), K, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(np.sort_complex(found.poles), np.sort_complex(poles), rtol=1e-6)
    assert found.status is Status.CONVERGED


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_the_chosen_output_follows_under_a_constant_disturbance(dt):
    """Simulated step by step from gains and model alone."""
    g = random_model(11, dt=0.0)
    g = rl.discretise(g, dt, "zoh") if dt else g
    found = rl.lqi(g, np.eye(5), np.eye(2), outputs=["y1"])
    c, push = g.C[1:], np.array([0.3, -0.2, 0.1, 0.5])
    if dt:
        x, xi = np.zeros(4), np.zeros(1)
        for _ in range(20_000):
            u = -found.K @ x - found.K_i @ xi
            x, xi = g.A @ x + g.B @ u + push, xi + dt * (2.0 - c @ x)
    else:
        A = np.block([[g.A - g.B @ found.K, -g.B @ found.K_i], [-c, np.zeros((1, 1))]])
        x = np.linalg.solve(A, -np.append(push, 2.0))[:4]  # where it rests
        assert np.linalg.eigvals(A).real.max() < 0
    assert c @ x == pytest.approx(2.0, rel=1e-9)
    assert found.closed_loop.dc_gain() == pytest.approx(np.eye(1))
    assert found.closed_loop.is_stable()
    assert found.controller.K.input_names[:2] == ("y1 reference", "y1 measured")


def test_what_no_integral_action_can_do_is_named():
    blocked = rl.StateSpaceModel([[-1.0, 0.0], [0.0, -2.0]], [[1.0], [1.0]], [[1.0, -2.0]], [[0.0]])  # -s / ...
    assert blocked.dc_gain() == pytest.approx(0.0)
    with pytest.raises(InputError, match=r"^lqi: a zero at s = 0 from the controls to y1"):
        rl.lqi(blocked, np.eye(3), [[1.0]])
    sampled = rl.discretise(blocked, 0.1, "zoh")
    with pytest.raises(InputError, match=r"^lqi: a zero at z = 1 from the controls to y1"):
        rl.lqi(sampled, np.eye(3), [[1.0]])
    two = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0], [2.0]], [[0.0], [0.0]])
    with pytest.raises(InputError, match=r"^lqi: 2 outputs to hold by 1 controls"):
        rl.lqi(two, np.eye(3), [[1.0]])
    with pytest.raises(InputError, match=r"^lqi: output"):
        rl.lqi(two, np.eye(2), [[1.0]], outputs=["z"])
    unreachable = rl.StateSpaceModel(np.diag([1.0, -1.0]), [[0.0], [1.0]], [[1.0, 1.0]], [[0.0]])
    with pytest.raises(NoTrustworthyNumber, match=r"^lqi: no stabilising gain exists: .*x1"):
        rl.lqi(unreachable, np.eye(3), [[1.0]])
