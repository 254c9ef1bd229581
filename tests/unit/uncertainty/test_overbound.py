"""Over-bounding weights: exact for the bound of a weight, never below it, as close as an independent search."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab import overbound


def size_of(zeros, poles, gain=1.0):
    def size(w):
        s = 1j * np.asarray(w)[:, None]
        return gain * np.abs(np.prod(s - np.asarray(zeros), axis=1) / np.prod(s - np.asarray(poles), axis=1))

    return size


@pytest.mark.parametrize(
    ("zeros", "poles", "order"),
    [
        ([-0.1], [-3.0], 1),
        ([-0.1, -20.0], [-1.0 + 3.0j, -1.0 - 3.0j], 2),
        ([-0.05 + 1j, -0.05 - 1j], [-0.02 + 1.5j, -0.02 - 1.5j], 2),
        ([-0.01, -1.0, -300.0], [-0.1, -10.0, -30.0], 3),
    ],
)
def test_a_bound_from_a_weight_is_recovered(zeros, poles, order):
    exact = size_of(zeros, poles, 2.5)
    omega = np.unique(np.concatenate([np.logspace(-3, 4, 120), np.linspace(0.9, 1.7, 60)]))
    fit = overbound(omega, exact(omega), 4, 0.005, exact=exact)
    assert fit.order == order
    assert 0 <= fit.lowest <= fit.excess <= 0.005
    # its own poles and zeros, evaluated by another formula
    far = np.logspace(-3, 4, 3001)
    response = np.abs(rl.frequency_response(fit.weight, far)[:, 0, 0])
    assert np.abs(response / exact(far) - 1).max() < 0.006
    inverse = fit.weight.A - fit.weight.B @ fit.weight.C / fit.weight.D
    assert np.linalg.eigvals(fit.weight.A).real.max() < 0
    assert np.linalg.eigvals(inverse).real.max() < 0


@given(st.integers(0, 10_000))
@settings(max_examples=3)
def test_never_below_the_bound_on_an_independent_grid(seed):
    rng = np.random.default_rng(seed)
    parts = [
        size_of(-(10 ** rng.uniform(-1, 2, n)), -(10 ** rng.uniform(-1, 2, n)), 10 ** rng.uniform(-1, 0.5))
        for n in rng.integers(1, 3, 2).tolist()
    ]

    def exact(w):
        return np.max([part(w) for part in parts], axis=0)

    omega = np.logspace(-2, 3, 60)
    fit = overbound(omega, exact(omega), 2, exact=exact)
    own = np.logspace(-2, 3, 6000)
    ratio = np.abs(rl.frequency_response(fit.weight, own)[:, 0, 0]) / exact(own)
    assert ratio.min() > 1 - 1e-4  # between the points of the judged grid the two curves are smooth
    assert fit.lowest >= 0
    assert fit.weight.is_stable()


def test_a_discrete_weight_bounds_on_the_unit_circle():
    omega = np.logspace(-1, np.log10(31.0), 60)
    lag = rl.StateSpaceModel([[0.8]], [[1.0]], [[0.4]], [[0.1]], 0.1)
    bound = np.abs(rl.frequency_response(lag, omega)[:, 0, 0])
    fit = overbound(omega, bound, 2, 0.02, dt=0.1)
    assert fit.weight.dt == 0.1
    assert fit.weight.is_stable()
    assert fit.order <= 2
    size = np.abs(rl.frequency_response(fit.weight, omega)[:, 0, 0])
    assert (size >= bound).all()
    assert (size <= 1.02 * bound).all()
