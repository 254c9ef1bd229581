"""rl.d2c and rl.d2d: scipy's and python-control's discretisation, closed forms, and what has no answer."""

from __future__ import annotations

import control
import numpy as np
import pytest
from scipy.signal import cont2discrete

import robustlab as rl

T = 0.1
FLIP = rl.StateSpaceModel([[-0.5]], [[1.0]], [[1.0]], [[0.0]], T)
DELAY = rl.StateSpaceModel([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], T)
CONTINUOUS = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])


def plant(seed=0):
    """Continuous, with poles well below the Nyquist frequency of 31 rad/s, one of them at 0."""
    rng = np.random.default_rng(seed)
    a = 4 * rng.standard_normal((3, 3))
    a -= (np.linalg.eigvals(a).real.max() - 0.5) * np.eye(3)
    a[:, 0] = 0.0
    b, c, d = rng.standard_normal((3, 2)), rng.standard_normal((2, 3)), rng.standard_normal((2, 2))
    return rl.StateSpaceModel(a, b, c, d, inputs=[("u", "V"), "d"], outputs=["y", ("omega", "rad/s")])


@pytest.mark.parametrize("seed", range(5))
def test_what_scipy_discretised_comes_back_at_any_sample_time(seed):
    truth = plant(seed)
    at = {dt: cont2discrete((truth.A, truth.B, truth.C, truth.D), dt)[:4] for dt in (0.033, T, 0.5)}
    given = rl.StateSpaceModel(*at[T], T, truth.inputs, truth.outputs)
    found = {0.033: rl.d2d(given, 0.033), T: rl.d2d(given, T), 0.5: rl.d2d(given, 0.5)}
    for dt, model in found.items():
        assert model.dt == dt
        for ours, theirs in zip((model.A, model.B, model.C, model.D), at[dt], strict=True):
            np.testing.assert_allclose(ours, theirs, atol=1e-9)
    back = rl.d2c(given)
    np.testing.assert_allclose(np.hstack([back.A, back.B]), np.hstack([truth.A, truth.B]), atol=1e-9)
    assert (back.dt, back.inputs, back.outputs) == (0.0, truth.inputs, truth.outputs)


def test_tustin_is_the_map_of_python_control():
    truth = plant()
    found = rl.d2c(control.sample_system(truth.to_control(), T, method="bilinear"), "tustin")
    again = rl.d2d(control.sample_system(truth.to_control(), T, method="bilinear"), 0.02, "tustin")
    fast = control.sample_system(truth.to_control(), 0.02, method="bilinear")
    for ours, theirs in ((found, truth), (again, fast)):
        one, two = (rl.frequency_response(m, [0.1, 3.0, 50.0]) for m in (ours, theirs))
        np.testing.assert_allclose(one, two, rtol=1e-9)


def test_a_whole_multiple_needs_no_logarithm():
    """A flip, an integrator and a delay of one sample: x_{k+1} = -x_k / 2 + u, x_k + u, u."""
    odd = rl.StateSpaceModel(np.diag([-0.5, 1.0, 0.0]), np.ones((3, 1)), np.eye(3), np.zeros((3, 1)), T)
    three = rl.d2d(odd, 0.3)
    np.testing.assert_allclose(three.A, np.diag([-0.125, 1.0, 0.0]))
    np.testing.assert_allclose(three.B.ravel(), [1 - 0.5 + 0.25, 3.0, 1.0])
    assert rl.d2c(rl.StateSpaceModel([], [], [], [[2.0]], T)).D.tolist() == [[2.0]]


@pytest.mark.parametrize(
    ("convert", "error", "text"),
    [
        (lambda: rl.d2c(FLIP), rl.NoTrustworthyNumber, r"d2c \(zoh\): a pole at z = -0\.5: no continuous model"),
        (lambda: rl.d2d(FLIP, 0.15), rl.NoTrustworthyNumber, "(?s)a pole at z = -0.5.*whole multiple"),
        (lambda: rl.d2c(DELAY), rl.NoTrustworthyNumber, r"d2c \(zoh\): a pole at z = 0: no continuous model"),
        (lambda: rl.d2c(rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], T), "tustin"),
         rl.NoTrustworthyNumber, "a pole at z = -1"),
        (lambda: rl.d2c(rl.StateSpaceModel(1e-4 * np.eye(3) + np.eye(3, k=1), np.ones((3, 1)), np.ones((1, 3)),
                                           [[0.0]], T)), rl.NoTrustworthyNumber, "gives A back to"),
        (lambda: rl.d2d(rl.StateSpaceModel([[2.0]], [[1.0]], [[1.0]], [[0.0]], T), 1e4),
         rl.NoTrustworthyNumber, r"d2d: A\^100000 overflows: a pole of modulus 2"),
        (lambda: rl.d2c(CONTINUOUS), rl.InputError, "d2c: the model is continuous"),
        (lambda: rl.d2d(DELAY, 0.2, "zho"), rl.InputError, "(?s)method 'zho', expected one of zoh, tustin.*mean zoh"),
        (lambda: rl.d2d(DELAY, -1), rl.InputError, "d2d: dt is -1, expected a positive sample time"),
    ],
)  # fmt: skip
def test_what_has_no_answer(convert, error, text):
    with pytest.raises(error, match=text):
        convert()
