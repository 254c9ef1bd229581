"""mu of constant matrices: closed forms, published numbers, edges, bad input."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab.mu_analysis import proves
from robustlab.uncertainty import as_blocks, structure_size


def random_complex(seed: int, *shape: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


SLICOT = np.array(
    [
        [-1 + 6j, 2 - 3j, 3 + 8j, 3 + 8j, -5 - 9j, -6 + 2j],
        [4 + 2j, -2 + 5j, -6 - 7j, -4 + 11j, 8 - 7j, 12 - 1j],
        [5 - 4j, -4 - 8j, 1 - 3j, -6 + 14j, 2 - 5j, 4 + 16j],
    ]
    * 2
)
SLICOT_BLOCKS = [[-1, 0], [-1, 0], [2, 2], [1, 0], [1, 0]]


def test_example_of_the_slicot_documentation():
    bounds = rl.mu(SLICOT, SLICOT_BLOCKS)
    assert bounds.upper == pytest.approx(41.74753408, rel=1e-8)
    assert bounds.lower == pytest.approx(41.74753408, rel=1e-7)
    assert bounds.status is rl.Status.CERTIFIED


@pytest.mark.parametrize("shape", [(1, 1), (3, 3), (2, 4), (4, 2), (1, 3)])
def test_one_full_block_is_the_largest_singular_value(shape):
    M = random_complex(1, *shape)
    bounds = rl.mu(M, [[shape[1], shape[0]]])
    expected = np.linalg.norm(M, 2)
    assert bounds.upper == pytest.approx(expected, rel=1e-9)
    assert bounds.lower == pytest.approx(expected, rel=1e-9)
    assert bounds.delta.shape == (shape[1], shape[0])


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_one_repeated_complex_scalar_is_the_spectral_radius(n):
    M = random_complex(2, n, n)
    bounds = rl.mu(M, [[n, 0]])
    expected = np.abs(np.linalg.eigvals(M)).max()
    assert bounds.lower == pytest.approx(expected, rel=1e-9)
    assert bounds.upper == pytest.approx(expected, rel=1e-6)


def test_one_repeated_real_scalar_is_the_largest_real_eigenvalue():
    M = np.diag([3.0 + 1j, -2.0, 1.0])
    T = random_complex(3, 3, 3)
    bounds = rl.mu(T @ M @ np.linalg.inv(T), [[-3, 0]])
    assert bounds.lower == pytest.approx(2.0, rel=1e-9)
    assert bounds.upper == pytest.approx(2.0, rel=1e-3)


@pytest.mark.parametrize("n", [2, 5, 12])
def test_rank_one_matrix_with_complex_scalars(n):
    # mu(u v^*) = sum |u_i| |v_i|
    u, v = random_complex(4, 2, n)
    expected = (np.abs(u) * np.abs(v)).sum()
    bounds = rl.mu(np.outer(u, v.conj()), [[1, 0]] * n)
    assert bounds.lower == pytest.approx(expected, rel=1e-9)
    assert bounds.upper == pytest.approx(expected, rel=1e-6)


def test_rank_one_matrix_with_real_scalars():
    # min max |d_i| with sum d_i a_i = 1 by brute force over the phase of the dual
    a = random_complex(5, 4)
    theta = np.linspace(0, np.pi, 400001)
    dual = np.cos(theta) / np.abs((np.exp(1j * theta)[:, None] * a).real).sum(axis=1)
    expected = 1 / np.abs(dual).max()
    bounds = rl.mu(np.outer(np.ones(4), a), [[-1, 0]] * 4)
    assert bounds.lower == pytest.approx(expected, rel=1e-6)
    assert bounds.upper == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(
    ("M", "blocks"),
    [
        (np.zeros((3, 3)), [[1, 0], [-2, 0]]),
        ([[0, 1], [0, 0]], [[1, 0], [1, 0]]),
        (np.triu(np.ones((6, 6)), 1), [[-1, 0]] * 6),
        (np.zeros((0, 0)), []),
        (1j * np.eye(2), [[-1, 0], [-1, 0]]),
        ([[1j, 2], [0, 1j]], [[-2, 0]]),
    ],
)
def test_nothing_destabilises(M, blocks):
    bounds = rl.mu(M, blocks)
    assert bounds.upper == 0.0
    assert bounds.lower == 0.0
    assert not bounds.delta.any()
    assert bounds.status is rl.Status.CERTIFIED


@pytest.mark.parametrize("kind", [-1, 1])
@pytest.mark.parametrize("decades", [12, 100, 150])
def test_a_small_coupling_is_no_zero(decades, kind):
    # mu([[0, a], [b, 0]]) = sqrt(a b); the square of b / a is below the smallest number
    bounds = rl.mu([[0, 10.0**decades], [10.0**-decades, 0]], [[kind, 0]] * 2)
    assert bounds.lower == pytest.approx(1.0, rel=1e-9)
    assert bounds.upper == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize("blocks", [[[1, 0]] * 2, [[-1, 0]] * 2, [[2, 2]], [[2, 0]]])
@pytest.mark.parametrize("factor", [1e-300, 1e-200, 1e200, 1e300])
def test_size_of_the_matrix_is_a_factor_of_mu(factor, blocks):
    M = np.array([[1.0, 2.0], [3.0, 4.0]])
    plain, scaled = rl.mu(M, blocks), rl.mu(factor * M, blocks)
    assert scaled.lower == pytest.approx(factor * plain.lower, rel=1e-9)
    assert scaled.upper == pytest.approx(factor * plain.upper, rel=1e-6)
    assert scaled.status is rl.Status.CERTIFIED


@pytest.mark.parametrize("real", [True, False])
@pytest.mark.parametrize("coupling", [1e3, 1e10, 1e13, 1e16])
def test_a_nearly_singular_loop_of_a_non_normal_matrix_is_no_lower_bound(coupling, real):
    # One repeated scalar: mu is the largest (real) eigenvalue, for any entries above the diagonal.
    block = [[-2 if real else 2, 0]]
    assert rl.mu([[0.5, coupling], [0.0, 0.5]], block).lower <= 0.5 * (1 + 1e-9)
    assert rl.mu([[0.0, coupling], [0.0, 0.0]], block).lower == 0.0
    if real:
        assert rl.mu([[0.5, coupling], [-1 / coupling, 0.5]], block).lower == 0.0


@pytest.mark.parametrize("imaginary", [1e-9, 2e-11, 5e-12, 1e-12, 1e-13])
def test_real_delta_needs_a_real_value(imaginary):
    assert rl.mu([[1 + 1j * imaginary]], [[-1, 0]]).lower == 0.0
    two = rl.mu(np.diag([1 + 1j * imaginary, 0.5]), [[-1, 0]] * 2)
    assert two.lower == pytest.approx(0.5, rel=1e-9)
    assert two.upper >= 0.5
    # det(I - M Delta) = 1 - j d1 d2
    assert rl.mu([[0, 1j], [1, 0]], [[-1, 0]] * 2).lower == 0.0


def test_a_bound_next_to_zero_is_proved_in_spite_of_couplings():
    M = [[0.83347462 - 1.7043919j, 0], [-0.12644912 - 0.0820067j, 0]]
    bounds = rl.mu(M, [[-1, 0], [-1, 0]])
    assert bounds.lower == 0.0
    assert bounds.upper <= 1e-5


def test_reducible_matrix_is_as_large_as_its_largest_component():
    M = np.zeros((6, 6), dtype=complex)
    parts = random_complex(7, 3, 2, 2)
    for i, part in enumerate(parts):
        M[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = part
    M[0:2, 2:6] = 1e3
    M[2:4, 4:6] = 1e6
    bounds = rl.mu(M, [[1, 0]] * 6)
    expected = max(rl.mu(part, [[1, 0]] * 2).upper for part in parts)
    assert bounds.upper == pytest.approx(expected, rel=1e-6)
    assert bounds.lower == pytest.approx(expected, rel=1e-5)
    assert proves(M, bounds.D, bounds.D_z, bounds.G, bounds.upper)


def test_stack_equals_single_matrices():
    M = random_complex(8, 3, 4, 4)
    blocks = [[-1, 0], [1, 0], [2, 2]]
    stacked = rl.mu(M, blocks)
    assert stacked.upper.shape == stacked.lower.shape == (3,)
    assert stacked.D.shape == stacked.G.shape == stacked.delta.shape == (3, 4, 4)
    for i in range(3):
        assert stacked.upper[i] == pytest.approx(rl.mu(M[i], blocks).upper, rel=1e-6)


def test_a_bound_that_is_too_small_is_not_proved():
    bounds = rl.mu(SLICOT, SLICOT_BLOCKS)
    assert proves(SLICOT, bounds.D, bounds.D_z, bounds.G, bounds.upper)
    assert not proves(SLICOT, bounds.D, bounds.D_z, bounds.G, bounds.upper * (1 - 1e-6))
    assert not proves(SLICOT, -bounds.D, -bounds.D_z, bounds.G, bounds.upper)


# --- lower bounds of mu -----------------------------------------------------------------------------------------------


def random_matrix(seed: int, rows, real: bool = False) -> np.ndarray:
    rng = np.random.default_rng(seed)
    q, p = structure_size(as_blocks(rows))
    return rng.standard_normal((p, q)) + (0j if real else 1j * rng.standard_normal((p, q)))


@pytest.mark.parametrize("n", [3, 6, 9])
def test_real_matrix_with_real_scalars_ends_at_the_best_vertex(n):
    # det(I - M Delta) is affine in each delta: the smallest zero is at a vertex
    M = random_matrix(n, [[-1, 0]] * n, real=True)
    best = 0.0
    for signs in itertools.product([1.0, -1.0], repeat=n):
        values = np.linalg.eigvals(M.real * np.array(signs))
        best = max(best, np.max(values.real[np.abs(values.imag) < 1e-12 * np.abs(values)], initial=0.0))
    assert rl.mu(M, [[-1, 0]] * n).lower == pytest.approx(best, rel=1e-9)


def test_two_real_scalars_have_a_closed_form():
    # 1 - m11 a - m22 b + det(M) a b = 0: its real and imaginary parts are two hyperbolas that cross in two points
    rng = np.random.default_rng(5)
    met = 0
    for _ in range(20):
        M = rng.standard_normal((2, 2)) + 1j * rng.standard_normal((2, 2))
        d = np.linalg.det(M)
        # b = (1 - m11 a) / (m22 - d a) is real where Im((1 - m11 a) conj(m22 - d a)) = 0, a quadratic in a
        top, bottom = np.array([-M[0, 0], 1.0]), np.array([-d, M[1, 1]])
        roots = np.roots(np.imag(np.convolve(top, np.conj(bottom))))
        real = roots.real[np.abs(roots.imag) < 1e-12]
        norms = [max(abs(a), abs((1 - M[0, 0] * a) / (M[1, 1] - d * a))) for a in real]
        bounds = rl.mu(M, [[-1, 0]] * 2, tolerance=1e-3)
        if norms and min(norms) < 20:
            met += 1
            assert bounds.lower == pytest.approx(1 / min(norms), rel=1e-9)
            assert bounds.lower * (1 - 1e-9) <= bounds.upper <= bounds.lower * 1.0011
        elif not norms:
            assert bounds.lower == 0.0
    assert met >= 5


@pytest.mark.parametrize("n", [4, 12])
def test_complex_scalars_come_close_to_the_upper_bound(n):
    M = np.stack([random_matrix(seed, [[1, 0]] * n) for seed in range(5)])
    bounds = rl.mu(M, [[1, 0]] * n)
    assert np.median(bounds.lower / bounds.upper) >= 0.98


# --- skewed mu --------------------------------------------------------------------------------------------------------


def gain_problem(seed: int, kind, n: int = 3):
    rng = np.random.default_rng(seed)
    M = rng.standard_normal((n + 2, n + 2)) + 1j * rng.standard_normal((n + 2, n + 2))
    M[:n, :n] *= 0.5 / np.linalg.norm(M[:n, :n], 2)
    return M, [*(kind(f"d{i}") for i in range(n)), rl.FullBlock("p", 2, 2)]


@settings(max_examples=12)
@given(st.integers(0, 10_000), st.sampled_from([rl.RealScalar, rl.ComplexScalar]))
def test_the_largest_gain_is_between_the_bounds(seed, kind):
    M, blocks = gain_problem(seed, kind)
    bounds = rl.mu(M, blocks, fixed=["d0", "d1", "d2"])
    assert 0 < bounds.lower <= bounds.upper
    rng = np.random.default_rng(seed + 1)
    for _ in range(60):
        d = rng.choice([-1.0, 1.0], 3) if kind is rl.RealScalar else np.exp(2j * np.pi * rng.random(3))
        inner = np.diag(d) @ np.linalg.solve(np.eye(3) - M[:3, :3] @ np.diag(d), M[:3, 3:])
        assert np.linalg.norm(M[3:, 3:] + M[3:, :3] @ inner, 2) <= bounds.upper * (1 + 1e-9)
    assert np.linalg.svd(np.eye(5) - M @ bounds.delta, compute_uv=False)[-1] < 1e-8
    assert np.abs(np.diag(bounds.delta)[:3]).max() <= 1 + 1e-12
    assert np.linalg.norm(bounds.delta[3:, 3:], 2) == pytest.approx(1 / bounds.lower, rel=1e-9)
    if kind is rl.ComplexScalar:
        assert bounds.upper <= 1.05 * bounds.lower


def test_fixed_blocks_that_can_be_singular_have_no_finite_level():
    bounds = rl.mu([[2.0, 1.0], [1.0, 0.0]], [[1, 0], [1, 0]], fixed=["delta1"])
    assert bounds.upper == np.inf
    assert bounds.status is rl.Status.INACCURATE


def test_a_stack_and_a_closed_form():
    """|d1| <= 1: gain of d / (1 - 0.5 d) is 2; of 0 without feedback is 0."""
    stack = np.array([[[0.5, 1.0], [1.0, 0.0]], [[0.5, 1.0], [0.0, 0.0]]])
    bounds = rl.mu(stack, [[1, 0], [1, 1]], fixed=["delta1"])
    assert bounds.upper == pytest.approx([2.0, 0.0], abs=1e-3)
    assert bounds.lower[0] == pytest.approx(2.0, rel=1e-6)
