"""What the search makes small: values and gradients of closed loops against independent ones."""

from __future__ import annotations

import numpy as np
import pytest

from robustlab.norms import h2_norm, hinf_norm
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.laws.controller_structures import FixedOrder
from robustlab.synthesis.nonsmooth.descent_methods import bfgs
from robustlab.synthesis.nonsmooth.design_limits import Bandwidth, Damping, Decay, RollOff, StableController
from robustlab.synthesis.nonsmooth.design_problem import DesignProblem
from robustlab.synthesis.nonsmooth.loop_family import LoopFamily
from robustlab.synthesis.problem.partition import GeneralizedPlant, PlantMatrices


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
        # The gradient of the norm is taken at the peak's frequency, which is found to about 1e-6.
        assert (G * direction).sum() == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("discrete", [False, True])
def test_the_entropy_has_the_gradients_of_differences(discrete):
    family, theta, direction = family_and_theta(2, discrete)
    gamma = 1.3 * family.norm(theta)[0]
    _, G, by_gamma = family.entropy(theta, gamma)
    assert (G * direction).sum() == pytest.approx(
        slope(lambda x: family.entropy(x, gamma)[0], theta, direction), rel=1e-6
    )
    assert by_gamma == pytest.approx(slope(lambda g: family.entropy(theta, g)[0], gamma, 1.0), rel=1e-6)
    assert family.entropy(theta, gamma / 1.301) is None


def test_the_entropy_is_its_integral():
    family, theta, _ = family_and_theta(1, False)
    gamma = 1.2 * family.norm(theta)[0]
    loop = family.loop(theta)
    # omega = tan(t): the weight 2 / (1 + omega^2) d omega / (2 pi) becomes dt / pi.
    t = (np.arange(4000) + 0.5) / 4000 * np.pi - np.pi / 2
    resolvent = 1j * np.tan(t)[:, None, None] * np.eye(len(loop.A)) - loop.A
    T = loop.C @ np.linalg.solve(resolvent, loop.B + 0j) + loop.D
    inner = np.eye(T.shape[2]) - T.conj().transpose(0, 2, 1) @ T / gamma**2
    expected = -np.mean(np.linalg.slogdet(inner)[1])
    assert family.entropy(theta, gamma)[0] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("discrete", [False, True])
def test_norms_are_the_certified_ones(discrete):
    for seed in range(6):
        family, theta, _ = family_and_theta(2, discrete, seed)
        loop = family.loop(theta)
        model = StateSpaceModel(*loop, 0.5 if discrete else 0.0)
        if not model.is_stable():
            assert family.norm(theta)[0] == np.inf
            continue
        assert family.norm(theta)[0] == pytest.approx(hinf_norm(model).lower, rel=1e-6)
        if not discrete:
            model = StateSpaceModel(loop.A, loop.B, loop.C, np.zeros_like(loop.D))
        assert family.h2_norm(theta)[0] == pytest.approx(h2_norm(model).value, rel=1e-8)


def test_a_narrow_peak_is_not_missed():
    """Damping 1e-5 between the points of any grid, beside a broad and lower hill."""
    A = np.array([[0, 1, 0], [-9.0, -6e-5, 0], [0, 0, -1.0]])
    plant = PlantMatrices(
        A, np.array([[0], [1e-3], [1.0]]), np.zeros((3, 1)), np.array([[1.0, 0, 1.0]]), np.zeros((1, 3)),
        np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1)),
    )  # fmt: skip
    family = LoopFamily(plant, np.zeros((1, 1)), 0, False)
    norm = hinf_norm(StateSpaceModel(A, plant.B1, plant.C1, [[0.0]]))
    assert norm.lower > 5
    assert family.norm(np.zeros((1, 1)))[0] == pytest.approx(norm.lower, rel=1e-6)


LIMITS = [Decay(0.5), Damping(0.6), Bandwidth(3.0), StableController(), RollOff(2.0, 0.3)]


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("limit", LIMITS, ids=lambda limit: type(limit).__name__)
def test_limits_and_their_gradients(limit, dt):
    """The gradient by differences; the value is that of the finished design in its own units."""
    rng = np.random.default_rng(4)
    A = np.array([[0.0, 1.0], [-4.0, -0.4]]) * (dt or 1) + (np.eye(2) if dt else 0)
    P = StateSpaceModel(A, [[0, 0], [1, 7]], [[1, 0], [0.02, 0]], np.zeros((2, 2)), dt)
    plant = GeneralizedPlant(P, 1, 1)
    law = FixedOrder(2).law(plant.measurements, plant.controls, dt)
    problem = DesignProblem([plant], law, "hinf", [limit])
    v = 0.3 * rng.standard_normal(len(law.parameters)) + problem.centre

    def value(x):
        return problem.limit_values(problem.theta(problem.parameters(x)[0]))[0][0]

    p, slopes = problem.parameters(v)
    c, G = problem.limit_values(problem.theta(p))[0]
    direction = rng.standard_normal(len(v))
    expected = slope(value, v, direction)
    assert (problem.by_parameters(p, G) * slopes) @ direction == pytest.approx(expected, rel=1e-5, abs=1e-8)
    k = law.sizes[0]
    theta = law.packed(p)
    K = StateSpaceModel(theta[:k, :k], theta[:k, k:], theta[k:, :k], theta[k:, k:], dt)
    own = limit.value(plant.close(K), K)
    unit = problem.scaling.rate if isinstance(limit, StableController) else 1.0
    assert c * unit == pytest.approx(own, rel=1e-6)


def test_bfgs_ends_at_the_kink_of_a_nonsmooth_function():
    """max(|x|, |y - 1|) + 0.1 (x + y)^2 has its minimum where both pieces meet or at the kink in x."""

    def function(x, _):
        pieces = [(abs(x[0]), np.array([np.sign(x[0]), 0.0])), (abs(x[1] - 1), np.array([0.0, np.sign(x[1] - 1)]))]
        value, gradient = max(pieces, key=lambda piece: piece[0])
        return value + 0.1 * (x[0] + x[1]) ** 2, gradient + 0.2 * (x[0] + x[1])

    grid = np.linspace(-1.5, 1.5, 601)
    expected = min(function(np.array([a, b]), 0)[0] for a in grid[::10] for b in grid)
    found = bfgs(function, np.array([2.0, -1.3]), max_steps=200)
    assert found.value == pytest.approx(expected, abs=2e-3)
    assert bfgs(lambda x, _: (np.inf, None), np.zeros(2)) is None
