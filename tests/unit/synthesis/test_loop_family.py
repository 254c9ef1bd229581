"""Norms of closed loops and their gradients against independent ones."""

from __future__ import annotations

import numpy as np
import pytest

from robustlab.norms import hinf_norm
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis import LoopFamily, PlantMatrices


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


def test_a_narrow_peak_is_not_missed():
    """A resonance of damping 1e-5 and a lower, broad maximum."""
    A = np.array([[0, 1, 0], [-9.0, -6e-5, 0], [0, 0, -1.0]])
    plant = PlantMatrices(
        A, np.array([[0], [1e-3], [1.0]]), np.zeros((3, 1)), np.array([[1.0, 0, 1.0]]), np.zeros((1, 3)),
        np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1)),
    )  # fmt: skip
    family = LoopFamily(plant, np.zeros((1, 1)), 0, False)
    norm = hinf_norm(StateSpaceModel(A, plant.B1, plant.C1, [[0.0]]))
    assert norm.lower > 5
    assert family.norm(np.zeros((1, 1)))[0] == pytest.approx(norm.lower, rel=1e-6)
