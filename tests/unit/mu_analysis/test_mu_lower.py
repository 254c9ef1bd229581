"""Lower bounds of mu and destabilising perturbations: closed forms, exhaustive truth, published numbers, edges."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import robustlab as rl
from robustlab.uncertainty import as_blocks, delta_matrix, delta_values, structure_size

STRUCTURES = {
    "real": [[-1, 0]] * 5,
    "complex": [[1, 0]] * 5,
    "mixed": [[-1, 0]] * 3 + [[1, 0]] * 2,
    "repeated": [[-2, 0], [2, 0], [-1, 0]],
    "full, not square": [[1, 3], [2, 1], [-1, 0], [1, 0]],
}


def random_matrix(seed: int, rows, real: bool = False) -> np.ndarray:
    rng = np.random.default_rng(seed)
    q, p = structure_size(as_blocks(rows))
    return rng.standard_normal((p, q)) + (0j if real else 1j * rng.standard_normal((p, q)))


@pytest.mark.parametrize("rows", STRUCTURES.values(), ids=STRUCTURES)
def test_delta_is_of_the_structure_and_singular(rows):
    blocks = as_blocks(rows)
    for seed in range(4):
        M = random_matrix(seed, rows)
        bounds = rl.mu(M, blocks)
        delta, values = bounds.delta, delta_values(blocks, bounds.delta)
        assert np.array_equal(delta, delta_matrix(blocks, values))
        size = max(np.linalg.norm(np.atleast_2d(value), 2) for value in values.values())
        assert bounds.lower * size == pytest.approx(1.0, rel=1e-12)
        assert np.linalg.svd(np.eye(len(M)) - M @ delta, compute_uv=False)[-1] <= 1e-11 * (1 + np.abs(M @ delta).max())


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
