"""Frequency responses against python-control, scipy and closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from robustlab import frequency_response
from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis import default_grid
from robustlab.statespace import StateSpaceModel

OMEGA = np.geomspace(0.01, 100.0, 40)


def random_model(seed, n, n_u, n_y, dt=0.0):
    rng = np.random.default_rng(seed)
    a = rng.standard_normal((n, n))
    a = (
        a / (1.3 * np.abs(np.linalg.eigvals(a)).max())
        if dt
        else a - (np.linalg.eigvals(a).real.max() + 0.2) * np.eye(n)
    )
    return StateSpaceModel(
        a, rng.standard_normal((n, n_u)), rng.standard_normal((n_y, n)), rng.standard_normal((n_y, n_u)), dt
    )


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
