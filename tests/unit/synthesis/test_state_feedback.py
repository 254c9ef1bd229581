"""LQR, LQG and pole placement against python-control, closed forms and the equations themselves."""

from __future__ import annotations

import control
import numpy as np
import pytest

from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.norms import h2_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.synthesis.h2.gaussian_regulator import lqg
from robustlab.synthesis.h2.state_feedback import lqr, place

INTEGRATORS = StateSpaceModel([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], [[0]])


def random_model(seed, n=5, p=2, m=2, dt=0.0):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    return StateSpaceModel(
        A / (1.5 if dt else 1), rng.standard_normal((n, m)), rng.standard_normal((p, n)), np.zeros((p, m)), dt
    )


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_lqr_equals_python_control(dt):
    g = random_model(0, dt=dt)
    rng = np.random.default_rng(1)
    F = rng.standard_normal((7, 7))
    weight = F @ F.T
    Q, R, N = weight[:5, :5], weight[5:, 5:], weight[:5, 5:]
    found = lqr(g, Q, R, N)
    K, X, poles = (control.dlqr if dt else control.lqr)(g.A, g.B, Q, R, N)
    np.testing.assert_allclose(found.K, K, rtol=1e-8)
    assert found.X is not None
    np.testing.assert_allclose(found.X, X, rtol=1e-8)
    np.testing.assert_allclose(np.sort_complex(found.poles), np.sort_complex(poles), rtol=1e-7)
    assert found.status is Status.CONVERGED
    assert found.to_json()["type"] == "StateFeedback"


def test_discrete_lqr_with_free_control_is_deadbeat():
    found = lqr(StateSpaceModel([[1.2]], [[2.0]], [[1.0]], [[0.0]], 0.1), [[1.0]], [[0.0]])
    assert found.K[0, 0] == pytest.approx(0.6)
    assert found.poles[0] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_place_reaches_its_poles_with_one_and_several_inputs(dt):
    for m in (1, 2, 5):
        g = random_model(3, m=m, dt=dt)
        wanted = np.array([-1, -2, -1.5 + 2j, -1.5 - 2j, -6])
        wanted = np.exp(0.1 * wanted) if dt else wanted
        found = place(g, wanted)
        assert found.status is Status.CONVERGED
        reached = np.linalg.eigvals(g.A - g.B @ found.K)
        np.testing.assert_allclose(np.sort_complex(reached), np.sort_complex(wanted), rtol=1e-6)


def test_place_repeats_a_pole_as_often_as_inputs_allow():
    g = random_model(4, n=3, m=2)
    found = place(g, [-1, -1, -2])
    np.testing.assert_allclose(np.sort(found.poles.real), [-2, -1, -1], rtol=1e-5)
    with pytest.raises(InputError, match="wanted 3 times"):
        place(g, [-1, -1, -1])


def test_place_without_states():
    assert place(StateSpaceModel([], [], [], [[1.0]]), []).K.shape == (1, 0)


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_lqg_cost_is_that_of_the_simulated_covariance(dt):
    g = random_model(5, n=4, dt=dt)
    Q, W = np.diag([1.0, 2.0, 0.0, 3.0]), np.diag([0.5, 0.0, 1.0, 1.0])
    R, V = np.diag([1.0, 0.2]), np.array([[0.3, 0.1], [0.1, 0.4]])
    design = lqg(g, Q, R, W, V)
    K = design.K
    # Covariance of (x, x_K) by the Lyapunov equation, and the cost from it.
    A = np.block([[g.A + g.B @ K.D @ g.C, g.B @ K.C], [K.B @ g.C, K.A]])
    B = np.block([[np.eye(4), g.B @ K.D], [np.zeros((K.n_states, 4)), K.B]])
    noise = B @ np.block([[W, np.zeros((4, 2))], [np.zeros((2, 4)), V]]) @ B.T
    P = control.dlyap(A, noise) if dt else control.lyap(A, noise)
    u = np.hstack([K.D @ g.C, K.C])
    cost = np.trace(Q @ P[:4, :4]) + np.trace(R @ (u @ P @ u.T + K.D @ V @ K.D.T))
    assert design.gamma**2 == pytest.approx(cost, rel=1e-8)
    assert design.method == "lqg"


def test_lqg_separates_into_lqr_and_kalman_filter():
    g = random_model(6, n=3)
    design = lqg(g, np.eye(3), np.eye(2), np.eye(3), np.eye(2))
    F = lqr(g, np.eye(3), np.eye(2)).K
    L = control.lqe(g.A, np.eye(3), g.C, np.eye(3), np.eye(2))[0]
    wanted = StateSpaceModel(g.A - g.B @ F - L @ g.C, L, -F, np.zeros((2, 2)))
    difference = np.sort_complex(design.K.poles()) - np.sort_complex(wanted.poles())
    np.testing.assert_allclose(difference, 0, atol=1e-8)
    both = [h2_norm(lower_lft(design.plant.model, k)).value for k in (design.K, wanted)]
    assert both[0] == pytest.approx(both[1], rel=1e-9)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda g: lqr(g, np.eye(2), [[0.0]]), r"lqr: R: singular: control u1 costs nothing"),
        (lambda g: lqr(g, np.eye(2), [[-1.0]]), r"lqr: R: indefinite"),
        (lambda g: lqr(g, -np.eye(2), [[1.0]]), r"positive semidefinite"),
        (lambda g: lqr(g, [[1.0, 1.0], [0.0, 1.0]], [[1.0]]), r"lqr: Q: not symmetric"),
        (lambda g: lqr(g, np.eye(3), [[1.0]]), r"lqr: Q: shape \(3, 3\)"),
        (lambda g: lqr(g, np.eye(2), [[1.0]], [[1.0]]), r"lqr: N: shape"),
        (lambda g: lqr(g, [[np.nan, 0], [0, 1]], [[1.0]]), r"Q\[0,0\] is NaN"),
        (lambda g: lqg(g, np.eye(2), [[1.0]], np.eye(2), [[0.0]]), r"measurement y1 has no noise"),
        (lambda g: lqg(g, np.eye(2), [[0.0]], np.eye(2), [[1.0]]), r"control u1 costs nothing"),
        (lambda g: lqg(g, np.eye(2), [[1.0]], -np.eye(2), [[1.0]]), r"lqg: W: eigenvalue"),
        (lambda g: place(g, [-1]), "1 poles"),
        (lambda g: place(g, [-1, -1j]), "conjugate"),
        (lambda g: place(g, [-1, 0.5]), "not stable"),
        (lambda g: place(g, ["a", "b"]), "complex numbers"),
    ],
)
def test_bad_weights_are_named(call, text):
    with pytest.raises(InputError, match=text):
        call(INTEGRATORS)


def test_modes_out_of_reach_are_named():
    g = StateSpaceModel(np.diag([1.0, -1.0]), [[0.0], [1.0]], np.ones((1, 2)), [[0.0]], states=["load", "motor"])
    with pytest.raises(NoTrustworthyNumber, match=r"no stabilising gain exists.*load"):
        lqr(g, np.eye(2), [[1.0]])
    with pytest.raises(InputError, match="load"):
        place(g, [-1, -2])


def test_an_integrator_that_costs_nothing():
    with pytest.raises(NoTrustworthyNumber, match="cost nothing"):
        lqr(INTEGRATORS, np.zeros((2, 2)), [[1.0]])
