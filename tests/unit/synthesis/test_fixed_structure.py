"""Fixed-structure design: closed forms, several plants, limits, discrete time, infeasible designs."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

import robustlab as rl
from robustlab.norms import hinf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.synthesis import (
    PID,
    Bandwidth,
    Damping,
    Decay,
    FixedOrder,
    LoopFamily,
    PlantMatrices,
    RollOff,
    StableController,
)

GAIN = "K[u2,y3]"


def lag(a, b):
    """x' = a x + w + b u, z = (x, u), y = x."""
    return StateSpaceModel([[a]], [[1.0, b]], [[1.0], [0.0], [1.0]], [[0, 0], [0, 1], [0, 0]])


def noisy_lag(a, b):
    """x' = a x + w1 + b u, z = (x, u), y = x + w2."""
    return StateSpaceModel([[a]], [[1.0, 0.0, b]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])


def double_integrator(dt=0.0):
    A, B = (np.array([[0, 1.0], [0, 0]]), np.array([[0.0], [1.0]]))
    if dt:
        A, B = np.array([[1, dt], [0, 1]]), np.array([[dt**2 / 2], [dt]])
    D = [[0, 0], [0, 0.1], [0, 0]]
    return StateSpaceModel(A, np.hstack([B, B]), [[1, 0], [0, 0], [-1, 0]], D, dt, outputs=["q", "fz", "e"])


def joint_norm(plants, k):
    gain = StateSpaceModel([], [], [], [[k]])
    return max(hinf_norm(lower_lft(P, gain)).upper for P in plants)


def test_h2_static_gain_of_a_lag_is_the_lqr_gain():
    """min (1 + k^2) / (2 (k - 1)) = k at k = 1 + sqrt(2)."""
    design = rl.fixed_structure(lag(1, 1), "static", n_meas=1, n_con=1, objective="h2", starts=0)
    assert design.values[GAIN] == pytest.approx(-1 - np.sqrt(2), rel=1e-4)
    assert design.gamma**2 == pytest.approx(1 + np.sqrt(2), rel=1e-7)
    assert design.status is Status.CONVERGED


def test_an_active_bound_is_reported():
    """sqrt(1 + k^2) / (k - 1) decreases with k: the optimal gain is the bound."""
    design = rl.fixed_structure(lag(1, 1), "static", n_meas=1, n_con=1, bounds={GAIN: (-3, 3)}, starts=0)
    assert design.gamma == pytest.approx(np.sqrt(10) / 2, rel=1e-4)
    assert -3 <= design.values[GAIN] < -2.99
    assert design.active == (f"{GAIN} at its bound",)
    assert design.status is Status.CERTIFIED


@pytest.mark.slow
def test_one_gain_for_several_plants_differs_from_their_own():
    plants = [noisy_lag(1, 1), noisy_lag(2, 0.5), noisy_lag(0.1, 2)]
    alone = [rl.fixed_structure(P, "static", n_meas=1, n_con=1, starts=0) for P in plants]
    own = [design.values["K[u3,y3]"] for design in alone]
    design = rl.fixed_structure(plants, "static", n_meas=1, n_con=1, starts=1)
    best = minimize_scalar(lambda k: joint_norm(plants, -k), bounds=(4.01, 40), method="bounded")
    assert design.gamma == pytest.approx(best.fun, rel=1e-4)
    assert design.gamma == max(design.gammas)
    assert len(design.gammas) == 3
    assert np.ptp(own) > 0.5
    # The optimal gain of the last plant does not stabilise the second one.
    assert joint_norm(plants, own[2]) == np.inf
    for P, gamma in zip(plants, design.gammas, strict=True):
        assert hinf_norm(lower_lft(P, design.K)).upper == pytest.approx(gamma, rel=1e-9)


def test_a_static_gain_reaches_the_full_order_optimum_where_that_is_static():
    """The optimum of the two Riccati equations is the limit of static gains where y is the state without noise."""
    A = [[0.0, 1.0], [2.0, -1.0]]
    C = [[1, 0], [0, 1], [0, 0], [1, 0], [0, 1]]
    P = StateSpaceModel(A, [[0, 0], [1, 1]], C, [[0, 0], [0, 0], [0, 1], [0, 0], [0, 0]])
    full = rl.hinf(P, 2, 1, gamma_rel=1.0)
    static = rl.fixed_structure(P, "static", n_meas=2, n_con=1, starts=0)
    assert static.gamma <= 1.002 * full.gamma


@pytest.mark.slow
@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_limits_hold_in_the_rebuilt_loop(dt):
    limits = [Damping(0.6), Bandwidth(8.0), Decay(0.3)]
    P = double_integrator(dt)
    design = rl.fixed_structure(P, PID(tau=(0.02, 1.0)), n_meas=1, n_con=1, limits=limits, starts=1)
    poles = design.closed_loop.poles()
    s = np.log(poles.astype(complex)) / dt if dt else poles
    assert (-s.real / np.abs(s)).min() >= 0.6 - 1e-9
    assert np.abs(s).max() <= 8 * (1 + 1e-9)
    assert s.real.max() <= -0.3 * (1 - 1e-9)
    assert design.active
    assert design.limits[0].text == "damping >= 0.6"
    assert design.K.dt == dt


@pytest.mark.slow
def test_a_stable_controller_that_rolls_off():
    limits = [StableController(), RollOff(50.0, 0.5)]
    structure = FixedOrder(2, strictly_proper=True)
    design = rl.fixed_structure(double_integrator(), structure, n_meas=1, n_con=1, limits=limits, starts=1)
    assert design.K.is_stable()
    omega = np.geomspace(50, 1e5, 2000)
    assert np.abs(rl.frequency_response(design.K, omega)).max() <= 0.5 * (1 + 1e-6)
    assert not design.K.D.any()


@pytest.mark.slow
def test_the_worst_member_of_an_uncertain_plant_is_bounded():
    """Stiffness within +-60 %."""
    A, B = [[0, 1], [-1, -0.1]], [[0, 0, 0], [0.6, 1, 1]]
    D = np.zeros((5, 3))
    D[2, 2] = 0.5
    M = StateSpaceModel(A, B, [[1, 0], [1, 0], [0, 0], [1, 0], [0, 1]], D)
    uncertain = rl.UncertainModel(M, [rl.RealScalar("k")])
    design = rl.fixed_structure(uncertain, "static", n_meas=2, n_con=1, starts=0)
    assert design.worst is not None
    assert design.gamma == design.worst.upper
    assert design.status is Status.CERTIFIED
    members = [lower_lft(uncertain.evaluate({"k": k}), design.K) for k in np.linspace(-1, 1, 41)]
    worst = max(hinf_norm(member).lower for member in members)
    assert worst <= design.gamma <= 1.05 * worst
    assert len(design.scenarios) == len(design.gammas) >= 2


def test_an_earlier_result_is_a_start():
    P = noisy_lag(1, 1)
    first = rl.fixed_structure(P, "static", n_meas=1, n_con=1, starts=0)
    again = rl.fixed_structure(P, "static", n_meas=1, n_con=1, starts=0, start=first)
    assert again.gamma <= first.gamma * (1 + 1e-9)
    assert {s.kind for s in again.starts} == {"given", "structure"}


def position_loop():
    """Two masses on a spring; the first is driven, and its position and velocity are measured with noise."""
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [np.array([[-1, 1], [1, -1]]), -0.05 * np.eye(2)]])
    B = np.array([[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1], [1, 0, 0, 0]], dtype=float)
    C = np.array([[0, 1, 0, 0], [0, 0, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0]], dtype=float)
    D = np.array([[0, 0, 0, 0], [0, 0, 0, 1], [0, 0.3, 0, 0], [0, 0, 0.3, 0]])
    return StateSpaceModel(A, B, C, D)


@pytest.mark.slow
def test_a_given_order_starts_from_the_reduced_full_order_design():
    P = position_loop()
    static = rl.fixed_structure(P, "static", n_meas=2, n_con=1, starts=0)
    second = rl.fixed_structure(P, 2, n_meas=2, n_con=1, starts=2)
    full = rl.hinf(P, 2, 1, gamma_rel=1.0)
    assert {s.kind for s in second.starts} == {"reduced", "structure", "random"}
    assert full.gamma * (1 - 1e-3) <= second.gamma
    assert second.gamma <= 0.95 * static.gamma


# --- gradients of norms of closed loops -------------------------------------------------------------------------------


def family_and_theta(order, discrete, seed=1):
    rng = np.random.default_rng(seed)
    n, n_w, n_u, n_z, n_y = 4, 3, 2, 3, 2
    draw = rng.standard_normal
    A = draw((n, n)) - 3 * np.eye(n)
    plant = PlantMatrices(
        0.1 * A if discrete else A, draw((n, n_w)), draw((n, n_u)), draw((n_z, n)), draw((n_y, n)),
        0.2 * draw((n_z, n_w)), 0.3 * draw((n_z, n_u)), 0.3 * draw((n_y, n_w)),
    )  # fmt: skip
    family = LoopFamily(plant, 0.1 * draw((n_y, n_u)), order, discrete)
    theta = 0.1 * draw((order + n_u, order + n_y))
    if not discrete:
        theta[:order, :order] -= np.eye(order)
    return family, theta, draw(theta.shape)


def slope(function, theta, direction, step=3e-5):
    """Fourth-order central difference."""
    at = [function(theta + k * step * direction) for k in (-2, -1, 1, 2)]
    return (at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * step)


@pytest.mark.parametrize("discrete", [False, True])
@pytest.mark.parametrize("order", [0, 2])
def test_gradients_are_those_of_differences(order, discrete):
    family, theta, direction = family_and_theta(order, discrete)
    for function in (family.abscissa, family.norm, family.h2_norm):
        _, G = function(theta)
        expected = slope(lambda x, f=function: f(x)[0], theta, direction)
        # The gradient of the norm is that at the peak's frequency, accurate to about 1e-6.
        assert (G * direction).sum() == pytest.approx(expected, rel=1e-5)
