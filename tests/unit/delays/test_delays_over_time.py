"""Responses of models with delays against closed forms: the method of steps by hand, superposition, and shifts."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from scipy.integrate import solve_ivp

import robustlab as rl
from robustlab.delays import DelayedModel
from robustlab.errors import InputError, NoTrustworthyNumber

LAG = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
INTEGRATOR = rl.StateSpaceModel([[0.0]], [[1.0]], [[1.0]], [[0.0]])


def test_delays_of_input_and_output_are_exact_for_any_sampling():
    t = np.sort(np.random.default_rng(1).uniform(0, 5, 60))
    t[0] = 0.0
    model = rl.with_delays(LAG, inputs={0: 0.31}, outputs={0: 0.47})
    y = rl.simulate(model, t, np.ones(60))["y1"]
    assert np.abs(y - np.where(t > 0.78, 1 - np.exp(-(t - 0.78)), 0.0)).max() < 1e-14


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_a_delay_of_whole_samples_is_a_shift(hold):
    t, rng = np.linspace(0, 4, 81), np.random.default_rng(2)
    u = rng.normal(size=81)
    u[0] = 0.0
    plain = rl.simulate(LAG, t, u, hold=hold)["y1"]
    model = rl.with_delays(LAG, inputs={0: 0.2}, outputs={0: 0.1})
    late = rl.simulate(model, t, u, hold=hold)["y1"]
    assert np.abs(late[6:] - plain[:-6]).max() < 1e-13
    assert np.abs(late[:6]).max() < 1e-13


def by_hand(k: float, tau: float, steps: int) -> list[Polynomial]:
    """x' = k (1 - x(t - tau)), x = 0 before 0: a polynomial on each interval of length tau, in the time since it."""
    pieces = [Polynomial([0.0, k])]  # x' = k on [0, tau]
    for _ in range(steps - 1):
        pieces.append(pieces[-1](tau) + (Polynomial([k]) - k * pieces[-1]).integ())
    return pieces


@pytest.mark.parametrize(("k", "tau"), [(1.0, 1.0), (2.0, 0.5), (1.2, 1.7)])
def test_the_method_of_steps_equals_the_solution_by_hand(k, tau):
    # from r to the error e = r - x(t - tau), with x' = k e
    loop = rl.with_delays(rl.StateSpaceModel([], [], [], [[1.0]])).feedback(rl.delay(tau) @ (k * INTEGRATOR))
    t = np.linspace(0, 6 * tau, 151)
    piece = np.minimum((t / tau + 1e-9).astype(int), 5)
    x = by_hand(k, tau, 6)
    late = [x[p - 1](s - p * tau) if p else 0.0 for p, s in zip(piece, t, strict=True)]
    assert np.abs(rl.simulate(loop, t, np.ones(151))["y1"] - (1.0 - np.array(late))).max() < 1e-10


def test_a_loop_of_a_lag_and_a_delay_against_its_series():
    # y = sum over reflections of (-1)^m (k e^(-s tau) / (s + 1))^(m+1) / s, each a delayed polynomial times e^-t
    from math import factorial

    k, tau, t = 2.5, 0.7, np.linspace(0, 5, 101)
    expected = np.zeros_like(t)
    for m in range(1, 9):
        s = np.maximum(t - m * tau, 0.0)
        step = 1.0 - np.exp(-s) * sum(s**i / factorial(i) for i in range(m))
        expected += (-1) ** (m - 1) * k**m * np.where(t > m * tau, step, 0.0)
    y = rl.simulate((k * LAG @ rl.delay(tau)).feedback(), t, np.ones(101))["y1"]
    assert np.abs(y - expected).max() < 1e-9


def test_a_neutral_loop_repeats_its_jumps():
    # y = e, e(t) = r - 0.5 e(t - 1): a staircase, jumps on every echo
    loop = rl.StateSpaceModel([], [], [], [[1.0]])
    model = rl.with_delays(loop).feedback(0.5 * rl.delay(1.0))
    t = np.linspace(
        0, 14.7, 50
    )  # few echoes coincide with samples, and there are more of them than orders of smoothness
    y = rl.simulate(model, t, np.ones(50))["y1"]
    steps = np.floor(t + 1e-9)
    assert np.abs(y - (1 - (-0.5) ** (steps + 1)) / 1.5).max() < 1e-12


def integrated(A, B, C, d, delays, t):
    """x' = A x + B [w, 1], z = C x + d, w_i = z_i(t - tau_i), by Runge-Kutta from one kink to the next."""
    n, ends = len(delays), {0.0, float(t[-1])}
    for counts in np.ndindex(*(40,) * n):
        ends.add(float(np.dot(counts, delays)))
    ends = sorted(e for e in ends if e <= t[-1])
    pieces: list = []

    def z(i, s):
        if s < 0:
            return 0.0
        k = min(max(int(np.searchsorted(ends, s, side="right")) - 1, 0), len(pieces) - 1)
        return float(C[i] @ pieces[k](s) + d[i])

    x = np.zeros(len(A))
    for a, b in pairwise(ends):
        middle = 0.5 * (a + b)

        def rate(s, x, middle=middle):
            inner = s + 1e-12 * (middle - s)  # the limit of a jump from inside this piece
            w = [z(i, inner - tau) for i, tau in enumerate(delays)]
            return A @ x + B @ np.array([*w, 1.0])

        found = solve_ivp(rate, (a, b), x, method="DOP853", rtol=1e-12, atol=1e-12, dense_output=True)
        pieces.append(found.sol)
        x = found.y[:, -1]
    return np.array([pieces[min(max(int(np.searchsorted(ends, s)) - 1, 0), len(pieces) - 1)](s) for s in t])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_two_delays_in_loops_against_runge_kutta(seed):
    rng = np.random.default_rng(seed)
    A, B, C = rng.normal(size=(3, 3)) - 2 * np.eye(3), rng.normal(size=(3, 3)), rng.normal(size=(2, 3))
    d, delays, t = rng.normal(size=2), np.array([0.31, 0.47]), np.linspace(0, 3, 31)
    D = np.zeros((5, 3))
    D[:2, 2] = d
    model = DelayedModel(rl.StateSpaceModel(A, B, np.vstack([C, np.eye(3)]), D), delays)
    record = rl.simulate(model, t, np.ones(31))
    y = np.column_stack(list(record.outputs.values()))
    expected = integrated(A, B, C, d, delays, t)
    assert np.abs(y - expected).max() < 1e-9 * max(1.0, np.abs(expected).max())


def test_invalid_simulations_are_rejected():
    t = np.linspace(0, 1, 11)
    with pytest.raises(InputError, match="x0 has 2 entries"):
        rl.simulate(rl.delay(0.1) @ LAG, t, np.ones(11), [0.0, 0.0])
    with pytest.raises(InputError, match="step for a model with delays"):
        rl.simulate(rl.delay(0.1), t, np.ones(11), step=0.1)
    with pytest.raises(InputError, match="rtol"):
        rl.simulate(rl.delay(0.1), t, np.ones(11), rtol=2.0)
    with pytest.raises(NoTrustworthyNumber, match="cells"):
        rl.simulate((LAG @ rl.delay(1e-6)).feedback(), t, np.ones(11))
    with pytest.raises(NoTrustworthyNumber, match="outgrows"):
        rl.simulate((-1e9 * LAG @ rl.delay(0.05)).feedback(), np.linspace(0, 10, 201), np.ones(201))


@pytest.mark.parametrize("late", [0.025, 0.001, 0.0999])
def test_a_delay_shorter_than_the_sample_time_is_exact(late):
    """Compare with the sum of exponentials by hand: such a delay refers to the current cell."""
    t = np.arange(6) * 0.1
    u = np.array([1.0, -0.5, 0.0, 2.0, 0.0, 1.0])
    late_lag = rl.with_delays(LAG, inputs={0: late})
    steps = np.diff(u, prepend=0.0)
    exact = sum(
        d * np.where(t > s, 1 - np.exp(-np.maximum(t - s, 0.0)), 0.0) for d, s in zip(steps, t + late, strict=True)
    )
    assert np.abs(rl.simulate(late_lag, t, u)["y1"] - exact).max() < 1e-14
