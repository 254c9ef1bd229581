"""rl.d2c against scipy's and python-control's discretisation, and its refusals."""

from __future__ import annotations

import control
import numpy as np
import pytest
from scipy.signal import cont2discrete

import robustlab as rl

T = 0.1
FLIP = rl.StateSpaceModel([[-0.5]], [[1.0]], [[1.0]], [[0.0]], T)
DELAY = rl.StateSpaceModel([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], T)


def plant(seed=0):
    """Continuous, with poles well below the Nyquist frequency of 31 rad/s, one of them at 0."""
    rng = np.random.default_rng(seed)
    a = 4 * rng.standard_normal((3, 3))
    a -= (np.linalg.eigvals(a).real.max() - 0.5) * np.eye(3)
    a[:, 0] = 0.0
    b, c, d = rng.standard_normal((3, 2)), rng.standard_normal((2, 3)), rng.standard_normal((2, 2))
    return rl.StateSpaceModel(a, b, c, d, inputs=[("u", "V"), "d"], outputs=["y", ("omega", "rad/s")])


@pytest.mark.parametrize("seed", range(5))
def test_models_discretised_by_scipy_are_recovered(seed):
    truth = plant(seed)
    given = rl.StateSpaceModel(
        *cont2discrete((truth.A, truth.B, truth.C, truth.D), T)[:4], T, truth.inputs, truth.outputs
    )
    back = rl.d2c(given)
    np.testing.assert_allclose(np.hstack([back.A, back.B]), np.hstack([truth.A, truth.B]), atol=1e-9)
    assert (back.dt, back.inputs, back.outputs) == (0.0, truth.inputs, truth.outputs)


def test_tustin_is_the_map_of_python_control():
    truth = plant()
    found = rl.d2c(control.sample_system(truth.to_control(), T, method="bilinear"), "tustin")
    one, two = (rl.frequency_response(m, [0.1, 3.0, 50.0]) for m in (found, truth))
    np.testing.assert_allclose(one, two, rtol=1e-9)
