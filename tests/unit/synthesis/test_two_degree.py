"""Loop shaping with a reference model: the book's plant built by hand, another solver, and simulation."""

from __future__ import annotations

import control
import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_are

import robustlab as rl
from robustlab.errors import InputError
from robustlab.statespace import series
from robustlab.synthesis.hinf.two_degree import two_degree_plant

G = rl.StateSpaceModel([[0, 1], [0, -0.5]], [[0], [1]], [[1, 0]], [[0]], inputs=["u"], outputs=["y"])
W1 = rl.StateSpaceModel([[0.0]], [[1.0]], [[1.0]], [[1.0]])
SECOND = rl.StateSpaceModel([[0, 1], [-1, -1.6]], [[0], [1]], [[1, 0]], [[0]])


def shaped_with_direct_term():
    rng = np.random.default_rng(4)
    g = rl.StateSpaceModel(
        rng.standard_normal((3, 3)), rng.standard_normal((3, 2)), rng.standard_normal((2, 3)),
        rng.uniform(-0.3, 0.3, (2, 2)),
    )  # fmt: skip
    t = rl.StateSpaceModel(-2 * np.eye(2), np.eye(2), 2 * np.eye(2), np.zeros((2, 2)))
    return g, t


def test_the_plant_is_that_of_the_book_at_every_frequency():
    """From M^-1 as a transfer function: M^-1 M^-* = I + G G^*, the property that defines it, and the blocks around."""
    g, t = shaped_with_direct_term()
    rho, select = 1.7, np.array([[1.0, 0.0], [0.5, 1.0]])
    P = two_degree_plant(g, t, rho, select).model
    for omega in (0.0, 0.3, 2.0, 40.0):
        p, gs, tref = (rl.frequency_response(m, [omega])[0] for m in (P, g, t))
        inverse = p[2:4, 2:4]  # from phi to y
        np.testing.assert_allclose(inverse @ inverse.conj().T, np.eye(2) + gs @ gs.conj().T, atol=1e-9)
        o, one = np.zeros((2, 2)), np.eye(2)
        wanted = np.block([
            [o, o, one], [o, inverse, gs], [-(rho**2) * tref, rho * select @ inverse, rho * select @ gs],
            [rho * one, o, o], [o, inverse, gs],
        ])  # fmt: skip
        np.testing.assert_allclose(p, wanted, atol=1e-9)


def by_hand(rho):
    """Strictly proper G W1: the matrices of Skogestad, Postlethwaite, eq. 9.88, with scipy's Riccati solver."""
    s = series(W1.renamed(["r"], ["u"]), G)
    Z = solve_continuous_are(s.A.T, s.C.T, s.B @ s.B.T, np.eye(1))
    A = np.zeros((5, 5))
    A[:3, :3], A[3:, 3:] = s.A, SECOND.A
    B = np.zeros((5, 3))
    B[3:, 0], B[:3, 1], B[:3, 2] = SECOND.B[:, 0], (Z @ s.C.T)[:, 0], s.B[:, 0]
    C = np.zeros((5, 5))
    C[1, :3] = C[4, :3] = s.C
    C[2, :3], C[2, 3:] = rho * s.C, -(rho**2) * SECOND.C
    D = np.array([[0, 0, 1.0], [0, 1, 0], [0, rho, 0], [rho, 0, 0], [0, 1, 0]])
    return A, B, C, D


@pytest.mark.parametrize("rho", [1.0, 2.0])
def test_gamma_is_that_of_another_solver_for_the_plant_by_hand(rho):
    slycot = pytest.importorskip("slycot")
    assert slycot
    _, _, gamma, _ = control.hinfsyn(control.ss(*by_hand(rho)), 2, 1)
    design = rl.ncf(G, W1, reference_model=SECOND, rho=rho, factor=1.001)
    assert design.gamma == pytest.approx(gamma, rel=5e-3)
    calm = rl.ncf(G, W1, reference_model=SECOND, rho=rho)
    assert design.gamma_min < design.gamma <= calm.gamma <= 1.1 * gamma * 1.005


def test_the_step_response_is_near_the_models_and_ends_there():
    design = rl.ncf(G, W1, reference_model=SECOND, rho=2.0)
    loop = design.closed_loop.select(["y reference"], ["y"])
    t = np.arange(0, 20, 0.05)

    def step(m):
        whole = np.zeros((m.n_states + 1,) * 2)
        whole[:-1, :-1], whole[:-1, -1:] = m.A, m.B
        move, x, y = expm(whole * 0.05), np.eye(m.n_states + 1)[-1], []
        for _ in t:
            y.append(m.C[0] @ x[:-1])
            x = move @ x
        return np.array(y)

    reached, wanted = step(loop), step(SECOND)
    assert np.abs(reached - wanted).max() < 0.15
    assert reached[-1] == pytest.approx(1.0, abs=1e-4)
    # One degree of freedom, the references through K alone, is further away.
    plain = rl.ncf(G, W1)
    k = plain.K
    single = rl.StateSpaceModel(
        np.block([[G.A, G.B @ k.C], [k.B @ G.C, k.A]]), np.vstack([-G.B @ k.D, -k.B]),
        np.hstack([G.C, np.zeros((1, k.n_states))]), [[0.0]],
    )  # fmt: skip
    assert np.abs(step(single) - wanted).max() > 2 * np.abs(reached - wanted).max()


@pytest.mark.parametrize(
    ("options", "error", "text"),
    [
        ({"rho": 0.0}, InputError, "rho"),
        ({"reference_model": rl.StateSpaceModel([[1.0]], [[1]], [[1]], [[0]])}, InputError, "not stable"),
        ({"reference_model": rl.StateSpaceModel([[-1.0]], [[1]], [[-1]], [[1]])}, InputError, "zero in steady state"),
        ({"reference_model": np.ones((1, 2))}, InputError, "1 outputs and 2 inputs"),
        ({"outputs": ["z"]}, InputError, "no such signal"),
        ({"W2": W1}, InputError, "W2: a weight with states"),
    ],
)
def test_what_does_not_fit_is_named(options, error, text):
    given = {"reference_model": SECOND} | options
    with pytest.raises(error, match=text):
        rl.ncf(G, W1, **given)
