"""The sampled-data norm: closed forms, brute force over a finite horizon, sinusoids, delays, and its own bracket."""

import numpy as np
import pytest
from scipy.linalg import expm

import robustlab as rl
from robustlab.result import Status
from robustlab.statespace import lower_lft


def gain(k: float, dt: float) -> rl.StateSpaceModel:
    return rl.StateSpaceModel([], [], [], [[k]], dt)


@pytest.mark.parametrize("h", [0.1, 1.0, 5.0])
def test_sampler_and_hold_behind_a_lag_in_closed_form(h):
    # z = H S F w with F = 1/(s + 1): |z| = sqrt(h) |samples|, and the norm of S F is that of the aliased |F|^2
    # (Chen, Francis 1995, section 9.3): norm^2 = sup_w sum_k |F(j(w + 2 pi k / h))|^2 = (h/2) coth(h/2), at w = 0.
    P = rl.StateSpaceModel([[-1.0]], [[1.0, 0.0]], [[0.0], [1.0]], [[0.0, 1.0], [0.0, 0.0]])
    found = rl.sampled_data_norm(P, gain(1.0, h), n_meas=1, n_con=1, rtol=1e-3)
    exact = np.sqrt(h / 2 / np.tanh(h / 2))
    assert found.status is Status.CERTIFIED
    assert found.lower * (1 - 1e-9) <= exact <= found.upper
    assert found.upper <= found.lower * 1.001
    assert found.held == ()
    assert abs(found.frequency) < 1e-6


@pytest.mark.parametrize("delay", [0.0, 1.63])
def test_without_control_the_norm_is_the_continuous_one(delay):
    rng = np.random.default_rng(2)
    A = rng.normal(size=(4, 4)) - 2.5 * np.eye(4)
    D = np.zeros((3, 3))
    D[:2, :2] = 0.1 * rng.normal(size=(2, 2))
    P = rl.StateSpaceModel(A, rng.normal(size=(4, 3)), rng.normal(size=(3, 4)), D)
    exact = rl.peak_gain(rl.StateSpaceModel(A, P.B[:, :2], P.C[:2], D[:2, :2])).value
    found = rl.sampled_data_norm(P, gain(0.0, 0.5), delay=delay, n_meas=1, n_con=1, rtol=5e-3)
    assert found.status is Status.CERTIFIED
    assert found.lower <= exact * (1 + 1e-6)
    assert exact <= found.upper * (1 + 1e-6)


@pytest.mark.parametrize("share", [0.999, 1.001])
def test_stability_is_decided_exactly(share):
    # x' = -x + w + u, u = -k x(kT): x_{k+1} = (q - k (1 - q)) x_k with q = e^-T.
    T = 0.3
    k = share * (1 + np.exp(-T)) / (1 - np.exp(-T))
    P = rl.StateSpaceModel([[-1.0]], [[1.0, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
    found = rl.sampled_data_norm(P, gain(-k, T), n_meas=1, n_con=1, rtol=0.05)
    assert np.isfinite(found.upper) == (share < 1)


def loop_of_two() -> tuple[rl.StateSpaceModel, rl.StateSpaceModel]:
    """A lightly damped plant, force disturbance, position and control as performance, and a first-order controller."""
    P = rl.StateSpaceModel([[0, 1], [-4, -0.8]], [[0, 0], [1, 1]], [[1, 0], [0, 0], [1, 0]], [[0, 0], [0, 0.3], [0, 0]])
    return P, rl.StateSpaceModel([[0.3]], [[1.0]], [[-0.6]], [[0.5]], 0.6)


def brute_force(P, K, delay, periods, fine):
    """Largest gain over a finite horizon: w held on fine steps, z in between by Simpson's rule; one column a step."""
    dt, n = K.dt, P.n_states
    h = dt / fine
    block = np.zeros((n + 2, n + 2))
    block[:n] = np.hstack([P.A, P.B]) * h / 2
    half = expm(block)[:n]
    switch = round(delay / h)
    columns = []
    for start in range(fine):
        x, k, u, pending, rows = np.zeros(n), np.zeros(K.n_states), 0.0, 0.0, []
        for step in range(periods * fine):
            inside = step % fine
            if inside == 0:
                y = (P.C[2:] @ x)[0]
                pending = (K.C @ k + K.D[:, 0] * y)[0]
                k = K.A @ k + K.B[:, 0] * y
            if inside == switch:
                u = pending
            v = np.array([1 / np.sqrt(h) if step == start else 0.0, u])
            states = [x, half @ np.concatenate([x, v])]
            states.append(half @ np.concatenate([states[1], v]))
            for state, weight in zip(states, (1 / 6, 4 / 6, 1 / 6), strict=True):
                rows.append(np.sqrt(weight * h) * (P.C[:2] @ state + P.D[:2] @ v))
            x = states[2]
        columns.append(np.concatenate(rows))
    first = np.array(columns).T  # responses to pulses in the first period; later ones are shifted copies
    m = len(first) // periods
    full = np.zeros((len(first), periods * fine))
    for j in range(periods):
        full[j * m :, j * fine : (j + 1) * fine] = first[: len(first) - j * m]
    return float(np.sqrt(np.linalg.eigvalsh(full.T @ full)[-1]))


@pytest.mark.parametrize("delay", [0.0, 0.2])
def test_brute_force_over_a_finite_horizon(delay):
    P, K = loop_of_two()
    found = rl.sampled_data_norm(P, K, delay=delay, n_meas=1, n_con=1, rtol=2e-3)
    assert found.status is Status.CERTIFIED
    short, long = (brute_force(P, K, delay, periods, 6) for periods in (45, 90))
    # A finite horizon T and a held w can only give less, by a share that falls like 1 / T^2.
    assert short < long <= found.upper * (1 + 1e-6)
    assert (4 * long - short) / 3 == pytest.approx(found.lower, rel=8e-3)


def test_the_loop_between_samples_counts():
    P, K = loop_of_two()
    found = rl.sampled_data_norm(P, K, n_meas=1, n_con=1, rtol=2e-3)
    # At the samples alone: the exact discrete loop for a w held over the period.
    assert rl.peak_gain(lower_lft(rl.discretise(P, K.dt, "zoh"), K)).value < found.lower


def test_a_delay_of_a_whole_period_is_a_shift_in_the_controller():
    P, K = loop_of_two()
    shifted = rl.StateSpaceModel([[0.3, 0.0], [-0.6, 0.0]], [[1.0], [0.5]], [[0.0, 1.0]], [[0.0]], K.dt)  # z^-1 K
    one = rl.sampled_data_norm(P, K, delay=K.dt, n_meas=1, n_con=1)
    two = rl.sampled_data_norm(P, shifted, n_meas=1, n_con=1)
    assert one.lower == pytest.approx(two.lower, rel=1e-6)
    assert one.upper == pytest.approx(two.upper, rel=1e-6)


def test_delays_next_to_a_whole_period_agree_with_it():
    P, K = loop_of_two()
    exact = rl.sampled_data_norm(P, K, delay=K.dt, n_meas=1, n_con=1)
    for delay in (K.dt * (1 - 1e-6), K.dt * (1 + 1e-6)):
        near = rl.sampled_data_norm(P, K, delay=delay, n_meas=1, n_con=1)
        assert near.lower == pytest.approx(exact.lower, rel=1e-4)


def test_the_bracket_shrinks_from_both_sides_to_the_continuous_norm():
    P, _ = loop_of_two()
    static = rl.StateSpaceModel([], [], [], [[-2.0]])
    continuous = rl.peak_gain(lower_lft(P, static)).value
    found = rl.sampled_data_norm(P, gain(-2.0, 1e-3), n_meas=1, n_con=1, rtol=1e-3)
    assert found.lower == pytest.approx(continuous, rel=0.02)
    history = rl.sampled_data_norm(P, gain(-0.2, 1.0), n_meas=1, n_con=1, rtol=1e-3).history
    lowers, uppers = [h[1] for h in history], [h[2] for h in history]
    assert lowers == sorted(lowers)
    assert uppers == sorted(uppers, reverse=True)
    widths = [u / lower - 1 for lower, u in zip(lowers, uppers, strict=True)]
    assert widths[-1] < 1.5 * widths[-2] / 4  # like 1 / N^2


def test_disturbances_that_reach_the_sampler_are_held_or_filtered():
    # y = w: z = u = H S w. For a w that changes at the samples only the norm is one; a filter F lets all w in.
    P = rl.StateSpaceModel(
        [[-1.0]], [[0.0, 0.0]], [[0.0], [0.0]], [[0.0, 1.0], [1.0, 0.0]], inputs=["r", "u"], outputs=["z", "y"]
    )
    held = rl.sampled_data_norm(P, gain(1.0, 0.5), n_meas=1, n_con=1)
    assert held.held == ("r",)
    assert held.status is Status.CERTIFIED
    assert held.lower == pytest.approx(1.0, rel=1e-5)
    assert held.upper == pytest.approx(1.0, rel=1e-3)
    corner = 3.0
    filtered = rl.sampled_data_norm(P, gain(1.0, 0.5), antialiasing=corner, n_meas=1, n_con=1, rtol=1e-3)
    x = corner * 0.5 / 2
    assert filtered.held == ()
    assert filtered.lower * (1 - 1e-9) <= np.sqrt(x / np.tanh(x)) <= filtered.upper
