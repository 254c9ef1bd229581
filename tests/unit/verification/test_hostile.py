"""Models at the limits of floating point: the checker proves true claims, or returns not proved."""

import numpy as np
import pytest
import verify_cases as cases

from robustlab.verification import Outcome, check


def norm(A, B, C, D, gamma, dt=0.0, **more):
    numbers = {"A": A, "B": B, "C": C, "D": D} | {k: np.asarray(v) for k, v in more.items()}
    return check(cases.claimed("norm", numbers, gamma=float(gamma), dt=dt))


def lags(rates, gains, scales=None):
    """Sum of g a / (s + a): if all gains are positive the peak is at zero frequency, their sum."""
    a, g = np.asarray(rates, float), np.asarray(gains, float)
    d = np.ones(len(a)) if scales is None else np.asarray(scales, float)
    return np.diag(-a), (d * a)[:, None], (g / d)[None], np.zeros((1, 1))


@pytest.mark.slow
def test_rates_over_three_hundred_decades():
    rates = 2.0 ** np.arange(-500, 501, 125)
    model = lags(rates, np.ones(9))
    assert norm(*model, 9 * (1 + 1e-9)).outcome is Outcome.PROVED
    assert norm(*model, 9 * (1 - 1e-9)).outcome is Outcome.REFUTED


def test_denormal_numbers():
    tiny = 5e-324
    A, B, C, D = lags([1.0, 1.0], [1.0, 1.0])
    B[1, 0] = tiny
    assert norm(A, B, C, D, 1 + 1e-9).outcome is Outcome.PROVED
    assert norm(A, B, C, D, 1 - 1e-9).outcome is Outcome.REFUTED
    A[0, 1] = tiny
    assert norm(A, B, C, D, 1 + 1e-9).outcome is Outcome.PROVED
    A[1, 1] = -tiny  # a rate of 5e-324 rad/s, and a gain of one at rest
    assert norm(A, B, C, D, 1 + 1e-9).outcome is not Outcome.PROVED


@pytest.mark.parametrize("n", [2, 5, 8])
def test_defective_eigenvalues(n):
    """(1/(s + 1))^n, one Jordan block: the peak is 1, at zero frequency."""
    A = -np.eye(n) + np.diag(np.ones(n - 1), 1)
    B, C = np.eye(n)[:, -1:], np.eye(n)[:1]
    D = np.zeros((1, 1))
    assert norm(A, B, C, D, 1 + 1e-9).outcome is Outcome.PROVED
    assert norm(A, B, C, D, 1 - 1e-9).outcome is Outcome.REFUTED


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_poles_on_the_boundary(dt):
    turn = np.array([[0.0, 1.0], [-1.0, 0.0]])  # eigenvalues at +-j: on the axis, and on the circle
    answer = norm(turn, np.eye(2), np.eye(2), np.zeros((2, 2)), 1e12, dt)
    assert answer.outcome is not Outcome.PROVED
    hidden = norm(turn, np.zeros((2, 1)), np.eye(2), np.zeros((2, 1)), 1.0, dt)
    assert hidden.outcome is not Outcome.PROVED
    nearly = norm(turn - 2.0**-40 * np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)), 2.0**40 * (1 + 1e-9))
    assert nearly.outcome is Outcome.PROVED


@pytest.mark.slow
def test_forty_states_by_frequency_alone():
    """Twenty resonances of equal damping, without P: proved by the boxes of the form."""
    omega, zeta = np.geomspace(0.1, 1000, 20), 1e-3
    A = np.zeros((40, 40))
    B, C = np.zeros((40, 1)), np.zeros((1, 40))
    for i, w in enumerate(omega):
        A[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[0, w], [-w, -2 * zeta * w]]
        B[2 * i + 1], C[0, 2 * i] = w, 1e-3
    peak = max(
        abs(sum(1e-3 * w**2 / (w**2 - x**2 + 2j * zeta * w * x) for w in omega))
        for x in np.concatenate([o * np.linspace(0.998, 1.002, 4001) for o in omega])
    )
    answer = norm(A, B, C, np.zeros((1, 1)), peak * (1 + 1e-6))
    assert answer.outcome is Outcome.PROVED
    assert answer.boxes < 40
    assert norm(A, B, C, np.zeros((1, 1)), peak * (1 - 1e-6)).outcome is Outcome.REFUTED
