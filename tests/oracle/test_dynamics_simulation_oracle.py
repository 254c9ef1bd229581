"""Linear models in time and frequency against scipy and python-control."""

import control
import numpy as np
import pytest
from scipy import signal
from scipy.signal import cont2discrete
from scipy.sparse.csgraph import connected_components

import robustlab as rl
from robustlab import frequency_response
from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis import default_grid, strong_components
from robustlab.statespace import StateSpaceModel


def random_model(seed: int, n: int, n_u: int, n_y: int, dt: float = 0.0) -> rl.StateSpaceModel:
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(n, n))
    poles = np.linalg.eigvals(a)
    a = a / (1.2 * np.abs(poles).max()) if dt else a - (poles.real.max() + 0.3) * np.eye(n)
    return rl.StateSpaceModel(a, rng.normal(size=(n, n_u)), rng.normal(size=(n_y, n)), rng.normal(size=(n_y, n_u)), dt)


@pytest.mark.parametrize(("n", "n_u", "n_y"), [(1, 1, 1), (3, 2, 1), (6, 1, 4)])
@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_lsim(n, n_u, n_y, hold):
    model = random_model(n, n, n_u, n_y)
    rng = np.random.default_rng(9)
    t, u, x0 = np.arange(120) * 0.05, rng.normal(size=(120, n_u)), rng.normal(size=n)
    _, expected, _ = signal.lsim((model.A, model.B, model.C, model.D), u, t, x0, interp=hold == "foh")
    record = rl.simulate(model, t, u, x0, hold=hold)
    found = np.column_stack([record[name] for name in model.output_names])
    np.testing.assert_allclose(found, expected.reshape(120, n_y), rtol=1e-10, atol=1e-11)


def test_dlsim():
    model = random_model(7, 3, 2, 2, dt=0.1)
    u = np.random.default_rng(2).normal(size=(50, 2))
    _, expected, _ = signal.dlsim((model.A, model.B, model.C, model.D, 0.1), u)
    record = rl.simulate(model.to_control(), np.arange(50) * 0.1, u)  # a control.StateSpace is welcome too
    np.testing.assert_allclose(np.column_stack([record["y1"], record["y2"]]), expected, rtol=1e-11, atol=1e-12)


def test_motor_against_an_integrator():
    """Same equations, written out and integrated by an adaptive Runge-Kutta method under a sine voltage."""
    from scipy.integrate import solve_ivp

    r, ind, k, kf, j = 2.07, 0.62e-3, 0.052, 4.8e-5, 7.2e-6

    def rates(t, x):
        u = 10 * np.sin(20 * t)
        return [x[1], (k * x[2] - kf * x[1]) / j, (u - r * x[2] - k * x[1]) / ind]

    t = np.arange(1001) * 1e-4
    truth = solve_ivp(rates, (0, 0.1), [0, 0, 0], "DOP853", t, rtol=1e-10, atol=1e-12).y
    record = rl.simulate(rl.plant("dc-motor"), t, 10 * np.sin(20 * t), hold="foh")
    for row, name in zip(truth, ("phi", "omega", "i"), strict=True):
        np.testing.assert_allclose(record[name], row, rtol=2e-5, atol=2e-5 * np.abs(row).max())


# --- discretisation ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("n", "m", "p"), [(1, 1, 1), (4, 2, 3), (8, 3, 1)])
def test_scipy(n, m, p):
    G = random_model(0, n, m, p)
    a, b, c, d, _ = cont2discrete((G.A, G.B, G.C, G.D), 0.1, "bilinear")
    omega = np.linspace(0, 30, 20)
    expected = rl.frequency_response(rl.StateSpaceModel(a, b, c, d, 0.1), omega)
    np.testing.assert_allclose(rl.frequency_response(rl.discretise(G, 0.1, "tustin"), omega), expected, atol=1e-11)


def test_python_control_prewarp():
    G = random_model(0, 4, 1, 1)
    z = np.exp(0.1j * np.linspace(0.1, 30, 20))
    warped = control.sample_system(G.to_control(), 0.1, "bilinear", prewarp_frequency=3.0)
    found = rl.discretise(G, 0.1, "tustin-prewarp", prewarp=3.0).to_control()
    np.testing.assert_allclose(found(z), warped(z), rtol=1e-9)


# --- frequency responses ----------------------------------------------------------------------------------------------


OMEGA = np.geomspace(0.01, 100.0, 40)


@pytest.mark.parametrize("dt", [0.0, 0.02])
@pytest.mark.parametrize(("n", "n_u", "n_y"), [(1, 1, 1), (5, 2, 3), (12, 3, 1)])
def test_against_control(n, n_u, n_y, dt):
    model = random_model(n, n, n_u, n_y, dt)
    nyquist = np.pi / 0.02
    omega = OMEGA.compress(np.less(OMEGA, nyquist))
    theirs = np.moveaxis(model.to_control()(np.exp(1j * omega * dt) if dt else 1j * omega, squeeze=False), -1, 0)
    np.testing.assert_allclose(frequency_response(model, omega), theirs, rtol=1e-9, atol=1e-11)


def test_closed_form_and_limits():
    lag = StateSpaceModel([[-2.0]], [[3.0]], [[1.0]], [[0.5]])
    w = np.array([0.0, 2.0, np.inf])
    np.testing.assert_allclose(frequency_response(lag, w)[:, 0, 0], [2.0, 0.5 + 3.0 / (2 + 2j), 0.5])
    assert frequency_response(lag, 1.0).shape == (1, 1, 1)
    assert frequency_response(lag, []).shape == (0, 1, 1)


def test_chunks_do_not_change_the_answer(monkeypatch):
    model = random_model(7, 6, 2, 2)
    whole = frequency_response(model, OMEGA)
    monkeypatch.setattr("robustlab.linear_analysis.frequency.CHUNK", 36 * 7)
    np.testing.assert_array_equal(frequency_response(model, OMEGA), whole)


def test_a_frequency_on_a_pole_is_refused():
    oscillator = StateSpaceModel([[0.0, 1.0], [-1.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    with pytest.raises(NoTrustworthyNumber, match="hits a pole"):
        frequency_response(oscillator, [0.5, 1.0])


def test_default_grid_holds_resonances_and_ends_at_nyquist():
    oscillator = StateSpaceModel([[0.0, 1.0], [-25.0, -0.1]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    grid = default_grid(oscillator)
    assert np.abs(grid - np.sqrt(25.0 - 0.05**2)).min() < 1e-12
    assert grid[0] <= 0.05
    assert grid[-1] >= 499.0
    assert (np.diff(grid) > 0).all()
    discrete = default_grid(StateSpaceModel([[0.9]], [[1.0]], [[1.0]], [[0.0]], 0.1))
    assert discrete[-1] == pytest.approx(np.pi / 0.1)
    assert len(default_grid(StateSpaceModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[1.0]]))) > 10


# --- ranks of models of small whole numbers, exact there --------------------------------------------------------------


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
