"""H2 synthesis: optimality by perturbing K, discrete time, direct terms, refusals."""

from __future__ import annotations

import numpy as np
import pytest

from robustlab import generalized_plant, h2
from robustlab.norms import h2_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, lower_lft


def regular_plant(seed=0, n=4, m1=3, m2=2, p1=3, p2=2, dt=0.0, D11=False, D22=False, unstable=True):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    size = np.abs(np.linalg.eigvals(A)).max()
    A = A / size * (1.2 if unstable else 0.8) if dt else A
    D = rng.standard_normal((p1 + p2, m1 + m2))
    D[:p1, :m1] *= bool(D11)
    D[p1:, m1:] *= 0.3 * bool(D22)
    return StateSpaceModel(A, rng.standard_normal((n, m1 + m2)), rng.standard_normal((p1 + p2, n)), D, dt)


def change_of_norm(P, K, step, rng):
    """Return the H2 norm of the loop with every entry of K changed at random (in continuous time all but D_K)."""
    moved = [m + step * rng.standard_normal(m.shape) for m in (K.A, K.B, K.C)]
    D = K.D + step * rng.standard_normal(K.D.shape) * K.is_discrete
    return h2_norm(lower_lft(P, StateSpaceModel(*moved, D, K.dt))).value


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("D22", [False, True])
def test_no_small_change_of_k_is_better(dt, D22):
    rng = np.random.default_rng(1)
    P = regular_plant(dt=dt, D11=bool(dt), D22=D22)
    design = h2(P, 2, 2)
    assert design.status is Status.CONVERGED
    assert design.regularisation == 0
    assert design.gamma == pytest.approx(h2_norm(lower_lft(P, design.K)).value, rel=1e-9)
    for _ in range(8):
        state = rng.bit_generator.state
        up = change_of_norm(P, design.K, 1e-4, rng)
        rng.bit_generator.state = state
        down = change_of_norm(P, design.K, -1e-4, rng)
        assert up >= design.gamma * (1 - 1e-12)
        assert down >= design.gamma * (1 - 1e-12)
        slope = abs(up - down) / 2e-4
        assert slope <= 1e-3 * (up + down - 2 * design.gamma) / 1e-8 * 1e-4 + 1e-5 * design.gamma


def test_textbook_scalar_by_hand():
    """x' = a x + w1 + u, z = (x, u), y = x + w2: X = Y = a + sqrt(1 + a^2), norm^2 = X + F^2 Y with F = -X."""
    a = 0.5
    P = StateSpaceModel([[a]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    x = a + np.sqrt(1 + a * a)
    design = h2(P, 1, 1)
    assert design.gamma == pytest.approx(np.sqrt(x + x**3), rel=1e-9)
    np.testing.assert_allclose(design.K.A, [[a - 2 * x]], rtol=1e-9)
    np.testing.assert_allclose(design.K.B @ design.K.C, [[-x * x]], rtol=1e-9)


def test_a_direct_term_that_k_can_cancel_is_cancelled():
    rng = np.random.default_rng(7)
    P = regular_plant(seed=7, m1=2, p1=2)  # D12 and D21 square
    D = np.array(P.D)
    D[:2, :2] = rng.standard_normal((2, 2))
    P = StateSpaceModel(P.A, P.B, P.C, D)
    design = h2(P, 2, 2)
    wanted = -np.linalg.solve(D[:2, 2:], D[:2, :2]) @ np.linalg.inv(D[2:, :2])
    np.testing.assert_allclose(design.K.D, wanted, rtol=1e-9)
    assert np.isfinite(design.gamma)
    assert not design.closed_loop.D.any()


def test_singular_plant_reports_its_regularisation():
    """Double integrator with neither control penalty nor measurement noise."""
    P = generalized_plant(
        StateSpaceModel([[0, 1], [0, 0]], [[0, 0], [1, 1]], [[1, 0]], [[0, 0]], inputs=["w", "u"], outputs=["q"]),
        ["q"],
        ["u"],
    )
    lines: list[str] = []
    design = h2(P, progress=lines.append)
    assert design.status is Status.CONVERGED
    assert design.regularisation > 0
    assert design.smallest_norm <= design.gamma
    assert "regularisation" in dict(design.facts())
    assert lines[0].startswith("regularisation 1e-01: H2 norm")
    assert design.to_json()["regularisation"] == design.regularisation
