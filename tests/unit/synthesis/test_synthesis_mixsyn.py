"""Mixed sensitivity: structure of the plant, sign of K, weights."""

import control
import numpy as np
import pytest
import scipy.linalg

from robustlab import complementary_weight, control_weight, frequency_response, makeweight, mixsyn, performance_weight
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis import mixed_sensitivity_plant

OMEGA = np.geomspace(1e-4, 1e5, 200)


def plant_2x2(direct: float = 0.0) -> StateSpaceModel:
    rng = np.random.default_rng(5)
    A = rng.standard_normal((4, 4)) - 2 * np.eye(4)
    return StateSpaceModel(
        A, rng.standard_normal((4, 3)), rng.standard_normal((2, 4)), direct * rng.standard_normal((2, 3)),
        inputs=[("u1", "V"), ("u2", "V"), ("u3", "N")], outputs=[("q", "m"), ("v", "m/s")],
    )  # fmt: skip


@pytest.mark.parametrize("direct", [0.0, 0.7])
def test_closed_loop_is_the_stack_of_weighted_s_ks_t_with_loop_gain_gk(direct):
    G = plant_2x2(direct)
    W1, W2, W3 = performance_weight(1.0), control_weight(10.0, 50.0), complementary_weight(20.0)
    design = mixsyn(G, W1, W2, W3)
    g, k = frequency_response(G, OMEGA), frequency_response(design.K, OMEGA)
    s = np.linalg.inv(np.eye(2) + g @ k)
    stack = [frequency_response(w, OMEGA) * f for w, f in ((W1, s), (W2, k @ s), (W3, g @ k @ s))]
    np.testing.assert_allclose(frequency_response(design.closed_loop, OMEGA), np.concatenate(stack, axis=1), atol=1e-8)
    assert np.linalg.norm(np.concatenate(stack, axis=1), 2, axis=(1, 2)).max() <= design.gamma * (1 + 1e-9)


def test_number_siso_model_matrix_and_python_control_weights():
    G = plant_2x2()
    lag = performance_weight(1.0)
    for weight in (lag, lag.to_control(), control.ss2tf(lag.to_control())):
        _, weights = mixed_sensitivity_plant(G, weight)
        assert weights["W1"].n_inputs == 2
        np.testing.assert_allclose(weights["W1"].dc_gain(), 1000 * np.eye(2), rtol=1e-9)
    _, weights = mixed_sensitivity_plant(G, None, [[1.0, 2.0, 3.0]])
    assert weights["W2"].D.shape == (1, 3)


def test_performance_weight_has_its_specified_values():
    for order in (1, 2, 3):
        W1 = performance_weight(10.0, error=1e-3, peak=2.0, order=order)
        assert W1.n_states == order
        assert W1.is_stable()
        low, high = np.abs(frequency_response(W1, [0.0, np.inf])[:, 0, 0])
        assert low == pytest.approx(1e3, rel=1e-9)
        assert high == pytest.approx(0.5, rel=1e-9)
    bandwidth = np.abs(frequency_response(performance_weight(10.0, 1e-3, 2.0), [10.0])[0, 0, 0])
    assert bandwidth == pytest.approx(abs((10j / 2 + 10) / (10j + 0.01)), rel=1e-12)


def test_control_and_complementary_weights_have_their_specified_values():
    constant = control_weight(25.0)
    assert (constant.n_states, constant.D[0, 0]) == (0, 0.04)
    s = 1j * np.array([0.0, 3.0, 1e9])
    W2 = frequency_response(control_weight(25.0, 100.0, 50.0), s.imag)[:, 0, 0]
    np.testing.assert_allclose(W2, (s / 100 + 1) / (s / 5000 + 1) / 25, rtol=1e-9)
    W3 = frequency_response(complementary_weight(7.0, 1.5, 1e-2), s.imag)[:, 0, 0]
    np.testing.assert_allclose(W3, (s + 7 / 1.5) / (1e-2 * s + 7), rtol=1e-9)


def test_the_report_gives_the_poles_of_the_loop_apart_from_those_of_the_weights():
    """The weight's pole at bandwidth times error = 0.15 1/s is fixed; the loop's are those of G and K alone."""
    G = StateSpaceModel([[0, 1], [-100, -20]], [[0], [200]], [[1, 0]], [[0]])
    design = mixsyn(G, performance_weight(15.0, error=0.01), control_weight(20.0, bandwidth=1000.0))
    K = design.K
    loop = np.block([[G.A - G.B @ K.D @ G.C, G.B @ K.C], [-K.B @ G.C, K.A]])
    assert design.closed_loop_abscissa == pytest.approx(np.linalg.eigvals(loop).real.max(), rel=1e-6)
    facts = dict(design.facts())
    assert facts["weights and filters, rightmost pole"] == "-0.15 1/s"
    assert float(facts["closed loop, rightmost pole"].split()[0]) == pytest.approx(
        design.closed_loop_abscissa, rel=1e-3
    )


# --- weights from specifications --------------------------------------------------------------------------------------


def gain(model, omega):
    return float(np.abs(frequency_response(model, [omega])[0, 0, 0]))


@pytest.mark.parametrize("order", [1, 2, 4])
def test_makeweight_goes_through_its_point(order):
    for low, high in ((100.0, 0.1), (0.02, 5.0)):
        W = makeweight(low, (3.0, 1.0), high, order=order)
        assert W.n_states == order
        assert W.is_stable()
        assert gain(W, 0.0) == pytest.approx(low)
        assert gain(W, 3.0) == pytest.approx(1.0)
        assert gain(W, np.inf) == pytest.approx(high)
        inverse = StateSpaceModel(W.A - W.B @ np.linalg.solve(W.D, W.C), W.B, W.C, W.D)
        assert inverse.is_stable()  # minimum phase


@pytest.mark.parametrize(
    ("arguments", "dt", "gains"),
    [
        ((100, 1, 0.5), 0.0, (100.0, 1.0, 0.5)),
        ((100, [1, 3], 0.5), 0.0, (100.0, 3.0, 0.5)),
        ((0.2, 2, 30, 0, 3), 0.0, (0.2, 1.0, 30.0)),
        ((100, 1, 0.5, 0.1), 0.1, (100.0, 1.0, 0.5)),
        ((100, (5, 2), 0.5, 0.1, 3), 0.1, (100.0, 2.0, 0.5)),
    ],
)
def test_makeweight_as_in_matlab(arguments, dt, gains):
    """Gains at zero frequency, at the given one, and at infinity or the Nyquist frequency."""
    W = makeweight(*arguments)
    assert W.dt == dt
    frequency = np.ravel(arguments[1])[0]
    z = (1, np.exp(1j * frequency * dt), -1) if dt else (0, 1j * frequency, 1e12)
    assert [abs(complex(W(s)[0, 0])) for s in z] == pytest.approx(gains, rel=1e-9)


# --- one weight alone, against optima in closed form ------------------------------------------------------------------


def random_discrete(seed: int) -> StateSpaceModel:
    rng = np.random.default_rng(seed)
    A, B, C = rng.standard_normal((4, 4)) / 1.3, rng.standard_normal((4, 2)), rng.standard_normal((2, 4))
    return StateSpaceModel(A, B, C, np.zeros((2, 2)), 0.2)


def smallest_sensitivity(G: StateSpaceModel) -> float:
    """Skogestad, Postlethwaite 2005, eq. 6.8, at s = (z - 1) / (z + 1); D = 0 and CB regular: zeros at infinity too."""
    n, m = G.B.shape
    poles, modes = np.linalg.eig(G.A)
    pencil = np.block([[G.A, G.B], [G.C, G.D]]), scipy.linalg.block_diag(np.eye(n), np.zeros((m, m)))
    zeros, left = scipy.linalg.eig(*pencil, left=True, right=False)
    outside = [k for k in range(n + m) if np.isfinite(zeros[k]) and 1 < abs(zeros[k]) < 1e6]
    z = np.append((zeros[outside] - 1) / (zeros[outside] + 1), np.ones(m))
    y_z = np.hstack([left[n:, outside], np.eye(m)])
    unstable = np.abs(poles) > 1
    if not unstable.any():
        return 1.0
    p, y_p = ((poles - 1) / (poles + 1))[unstable], G.C @ modes[:, unstable]
    q_z = y_z.conj().T @ y_z / (z[:, None] + z.conj())
    q_p = y_p.conj().T @ y_p / (p.conj()[:, None] + p)
    q_zp = y_z.conj().T @ y_p / (z[:, None] - p)
    x = np.linalg.solve(q_z, q_zp @ np.linalg.solve(q_p, q_zp.conj().T))
    return float(np.sqrt(1 + np.abs(np.linalg.eigvals(x)).max()))


@pytest.mark.parametrize("seed", [2, 3, 4, 9, 12])
def test_sensitivity_alone_of_discrete_plants_reaches_the_optimum_of_poles_and_zeros(seed):
    G = random_discrete(seed)
    best = smallest_sensitivity(G)
    design = mixsyn(G, 1.0, gamma_rel=1.0)
    assert design.status is Status.CERTIFIED
    assert best * (1 - 1e-6) <= design.gamma <= best * 1.002


@pytest.mark.parametrize("gamma_rel", [1.0, 1.05])
@pytest.mark.parametrize(
    ("zero", "pole", "best"), [(1.0, -1.0, 1.0), (3.0, 0.5, 3.5 / 2.5), (2.0, 1.0, 3.0), (0.5, -4.0, 1.0)]
)
def test_sensitivity_alone_with_one_zero_and_one_pole(zero, pole, best, gamma_rel):
    """G = (s - zero) / (s - pole): max(1, |zero + pole| / |zero - pole|)."""
    G = StateSpaceModel([[pole]], [[1.0]], [[pole - zero]], [[1.0]])
    design = mixsyn(G, 1.0, gamma_rel=gamma_rel)
    assert design.status is Status.CERTIFIED
    assert best * (1 - 1e-6) <= design.smallest_gamma <= best * 1.001
    assert design.gamma <= gamma_rel * design.smallest_gamma * (1 + 1e-9)


def test_a_biproper_plant_without_unstable_zeros_has_sensitivity_as_small_as_wanted():
    design = mixsyn(StateSpaceModel([[1.0]], [[2.0]], [[1.0]], [[1.0]]), 1.0)
    assert design.status is Status.CERTIFIED
    assert design.gamma <= 1.1e-3
