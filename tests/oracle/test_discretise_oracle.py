"""Discretisation beside scipy and python-control."""

from __future__ import annotations

import control
import numpy as np
import pytest
from scipy.signal import cont2discrete

import robustlab as rl


def model(n, m, p):
    rng = np.random.default_rng(0)
    A = rng.normal(size=(n, n)) - 1.5 * np.eye(n)
    return rl.StateSpaceModel(A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), rng.normal(size=(p, m)))


@pytest.mark.parametrize(("n", "m", "p"), [(1, 1, 1), (4, 2, 3), (8, 3, 1)])
def test_scipy(n, m, p):
    G = model(n, m, p)
    a, b, c, d, _ = cont2discrete((G.A, G.B, G.C, G.D), 0.1, "bilinear")
    omega = np.linspace(0, 30, 20)
    expected = rl.frequency_response(rl.StateSpaceModel(a, b, c, d, 0.1), omega)
    np.testing.assert_allclose(rl.frequency_response(rl.discretise(G, 0.1, "tustin"), omega), expected, atol=1e-11)


def test_python_control_prewarp_and_matched():
    G = model(4, 1, 1)
    z = np.exp(0.1j * np.linspace(0.1, 30, 20))
    warped = control.sample_system(G.to_control(), 0.1, "bilinear", prewarp_frequency=3.0)
    found = rl.discretise(G, 0.1, "tustin-prewarp", prewarp=3.0).to_control()
    np.testing.assert_allclose(found(z), warped(z), rtol=1e-9)
    # With as many zeros as poles nothing is left to convention.
    matched = control.c2d(control.tf(G.to_control()), 0.1, "matched")
    np.testing.assert_allclose(rl.discretise(G, 0.1, "matched").to_control()(z), matched(z), rtol=1e-7)
