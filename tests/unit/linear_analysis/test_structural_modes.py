"""Controllability and observability of models whose hidden modes are known by construction."""

import re

import numpy as np
import pytest

import robustlab as rl
from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis import drop_unconnected


def model(a, b, c=None, dt=0.0, **names):
    a, b = np.atleast_2d(np.array(a, float)), np.array(b, float)
    n = len(a)
    b = b.reshape(n, -1) if n else np.zeros((0, 1))
    c = np.eye(n) if c is None else np.array(c, float).reshape(-1, n)
    return rl.StateSpaceModel(a if n else np.zeros((0, 0)), b, c, np.zeros((len(c), b.shape[1])), dt, **names)


def test_thesis_motor():
    """Thesis: rank 2 of 2, by its eqs 4.2 and 4.3; the angle adds an integrator observable from the angle only."""
    motor = rl.linearise(rl.plant("dc-motor"))
    pair = drop_unconnected(motor.select(outputs=["omega", "i"]))
    for test in (rl.controllability(pair), rl.observability(pair), rl.controllability(motor)):
        assert test.complete
        assert test.status is rl.Status.CONVERGED
    assert np.linalg.matrix_rank(np.hstack([pair.B, pair.A @ pair.B])) == 2
    assert np.linalg.matrix_rank(np.vstack([pair.C, pair.C @ pair.A])) == 2
    blind = rl.observability(motor.select(outputs=["omega", "i"]))
    assert (blind.rank, blind.n_states) == (2, 3)
    assert blind.modes[0].states == ("phi",)
    assert blind.modes[0].eigenvalue == 0
    assert blind.unstable_modes == blind.modes
    assert "no output shows it" in str(blind)


def test_twelve_states_with_the_thesis_scaling():
    """Six decoupled pairs (phi, phidot) driven through 1/J ~ 4e4, for which the controllability matrix fails."""
    stiffness = np.diag([2.6, 2.6, 1.0, 0.3, 0.3, 5.0]) + 0.1
    a = np.block([[np.zeros((6, 6)), np.eye(6)], [stiffness, np.zeros((6, 6))]])
    b = np.vstack([np.zeros((6, 6)), 4.4e4 * (np.eye(6) + 0.05)])
    platform = model(a, b)
    for test in (
        rl.controllability(platform),
        rl.observability(platform),
        rl.observability(model(a, b, np.eye(12)[:6])),
    ):
        assert (test.rank, test.status) == (12, rl.Status.CONVERGED)


def test_unstable_hidden_pair_and_its_text():
    a = np.zeros((4, 4))
    a[:2, :2] = [[0.5, 2.0], [-2.0, 0.5]]
    a[2:, 2:] = [[-1.0, 1.0], [0.0, -2.0]]
    a[:2, 2:] = 0.3
    q = np.linalg.qr(np.random.default_rng(0).normal(size=(4, 4)))[0]
    test = rl.observability(model(q @ a @ q.T, q @ np.ones(4), [0, 0, 1, 0.5] @ q.T))
    assert test.rank == 2
    assert sorted(m.eigenvalue.imag for m in test.modes) == pytest.approx([-2, 2])
    assert len(test.unstable_modes) == 2
    assert all("unstable mode 0.5" in m.meaning for m in test.modes)


@pytest.mark.parametrize(("value", "stable"), [(0.99, True), (-1.0, False), (1.5, False), (0.0, True)])
def test_discrete_modes(value, stable):
    test = rl.controllability(model([[0.5, 0], [0, value]], [1, 0], dt=0.1))
    assert test.modes[0].stable is stable
    assert "z = " in test.modes[0].meaning


def test_hidden_double_integrator_is_not_called_stable():
    """Its computed eigenvalues are +-1e-8: rounding must not make them "stable"."""
    a = np.array([[0, 1, 0.0], [0, 0, 0], [0, 0, -1]])
    for seed in range(10):
        q = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
        test = rl.controllability(model(q @ a @ q.T, q @ [0, 0, 1.0]))
        assert test.rank == 1
        assert len(test.unstable_modes) == 2


def test_half_controllable_jordan_chain():
    """A Jordan chain driven in its middle: the other part is hidden, at an eigenvalue accurate to 1e-5 only."""
    a = -np.eye(4) + np.eye(4, k=1)
    for seed in range(10):
        q = np.linalg.qr(np.random.default_rng(seed).normal(size=(4, 4)))[0]
        test = rl.controllability(model(q @ a @ q.T, q @ [0.3, 0, 1.0, 0]))
        assert test.rank == 3
        assert test.modes[0].eigenvalue == pytest.approx(-1, abs=1e-3)


def test_symmetric_chain_pushed_in_the_middle():
    """Three masses between walls, force on the middle one: the mode q = (1, 0, -1) is hidden."""
    k = np.array([[2.0, -1, 0], [-1, 2, -1], [0, -1, 2]])
    a = np.block([[np.zeros((3, 3)), np.eye(3)], [-k, np.zeros((3, 3))]])
    names = ["q1", "q2", "q3", "v1", "v2", "v3"]
    test = rl.controllability(model(a, [0, 0, 0, 0, 1, 0], states=names))
    assert test.rank == 4
    np.testing.assert_allclose(sorted(m.eigenvalue.imag for m in test.modes), [-np.sqrt(2), np.sqrt(2)], rtol=1e-12)
    assert {name for m in test.modes for name in m.states} == {"q1", "q3", "v1", "v3"}


def test_sizes_at_the_edge():
    for kind in (rl.controllability, rl.observability):
        empty = kind(rl.StateSpaceModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[1.0]]))
        assert (empty.rank, empty.n_states, empty.complete, empty.status) == (0, 0, True, rl.Status.CONVERGED)
        nothing = rl.StateSpaceModel([[-1.0, 1.0], [0, -2]], np.zeros((2, 0)), np.zeros((0, 2)), np.zeros((0, 0)))
        assert (kind(nothing).rank, len(kind(nothing).modes)) == (0, 2)
    integrators = model(np.eye(3, k=1), [0, 0, 1e-9])
    assert rl.controllability(integrators).complete


def test_drop_unconnected_keeps_signals_and_operating_point():
    motor = rl.linearise(rl.plant("dc-motor"), at=([1, 2, 3], [4])).select(outputs=["i"])
    part = drop_unconnected(motor)
    assert part.state_names == ("omega", "i")
    np.testing.assert_array_equal(part.operating_point.x, [2, 3])
    omega = np.geomspace(0.1, 1e5, 20)
    np.testing.assert_allclose(rl.frequency_response(part, omega), rl.frequency_response(motor, omega), rtol=1e-12)


def test_the_hidden_mode_of_an_unstable_loop_is_named():
    G = rl.StateSpaceModel(
        [[0, 0, 0], [0, -1, 0], [0, 1, 0]], [[1], [1], [0]], [[1, 0, 0], [0, 0, 1]], [[0], [0]],
        states=["p", "q", "r"], inputs=["u"], outputs=["a", "b"],
    )  # fmt: skip
    K, named = rl.ss([[2.0, 1.0]]), r"unstable mode 0 rad/s in p, q, r: no input moves it"
    loop = G.feedback(K)
    assert re.search(named, rl.peak_gain(loop).reason)
    assert re.search(named, rl.h2_norm(loop).reason)
    assert re.search(named, rl.classical_margins(G, K, at="input").channels["u"].reason)
    for refused in (
        lambda: rl.disk_margin(G, K, at="input"),
        lambda: rl.disk_margin(G, K, at="output"),
        lambda: rl.ncf(G),
        lambda: rl.coprime_margin(G, K),
        lambda: rl.robust_stability(rl.unstructured(G, 0.1, "additive").close(K)),
    ):
        with pytest.raises(NoTrustworthyNumber, match=r"0 rad/s in .*no input moves it"):
            refused()
    with pytest.raises(NoTrustworthyNumber, match=r"mode s = .*cannot be moved by the controls"):
        rl.mixsyn(G, W1=rl.tf([1], [1, 1]), W2=1.0)
