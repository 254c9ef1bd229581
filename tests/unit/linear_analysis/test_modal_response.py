"""Responses from modes: the bounds of their errors hold, and where modes do not span there is none."""

from fractions import Fraction

import numpy as np
import pytest

from robustlab.linear_analysis.modal_response import ModalResponse, largest_gain
from robustlab.norms import hinf_norm
from robustlab.statespace import StateSpaceModel


def model(seed, n, damping, spread):
    rng = np.random.default_rng(seed)
    A = np.diag(-(10.0 ** rng.uniform(-1, 1, n)))
    for k in range(0, n - 1, 2):
        w = 10 ** rng.uniform(-1, 2)
        A[k : k + 2, k : k + 2] = [[-damping * w, w], [-w, -damping * w]]
    T = rng.standard_normal((n, n)) * 10 ** rng.uniform(-spread, spread, n)
    return np.linalg.solve(T, A @ T), rng.standard_normal((n, 2)), rng.standard_normal((3, n)), np.zeros((3, 2))


def exact_response(A, B, C, D, s):
    """By Gauss-Jordan elimination in whole fractions, rounded once."""
    n, m = B.shape
    rows = [[(Fraction(-x), Fraction(0)) for x in row] for row in A.tolist()]
    for k in range(n):
        rows[k][k] = (Fraction(s.real) + rows[k][k][0], Fraction(s.imag))
    rows = [row + [(Fraction(x), Fraction(0)) for x in more] for row, more in zip(rows, B.tolist(), strict=True)]
    for k in range(n):
        p = max(range(k, n), key=lambda i: abs(rows[i][k][0]) + abs(rows[i][k][1]))
        rows[k], rows[p] = rows[p], rows[k]
        rows[k] = [over(x, rows[k][k]) for x in rows[k]]
        for i in range(n):
            if i != k:
                rows[i] = [minus(x, times(rows[i][k], y)) for x, y in zip(rows[i], rows[k], strict=True)]
    X = [row[n:] for row in rows]
    G = np.array(
        [
            [
                complex(*(float(sum(Fraction(c) * X[h][k][part] for h, c in enumerate(row))) for part in (0, 1)))
                for k in range(m)
            ]
            for row in C.tolist()
        ]
    )
    return G + D


def times(x, y):
    return x[0] * y[0] - x[1] * y[1], x[0] * y[1] + x[1] * y[0]


def minus(x, y):
    return x[0] - y[0], x[1] - y[1]


def over(x, y):
    size = y[0] ** 2 + y[1] ** 2
    real, imag = times(x, (y[0], -y[1]))
    return real / size, imag / size


@pytest.mark.parametrize("damping", [0.5, 1e-3, 1e-8])
@pytest.mark.parametrize("spread", [0, 3])
def test_the_error_is_within_its_bound(damping, spread):
    for seed in range(2):
        matrices = model(seed, 4, damping, spread)
        modes = ModalResponse.of(*matrices)
        if modes is None:
            continue
        points = 1j * np.concatenate([[0.0, 1.0, 300.0], np.abs(modes.poles.imag), np.abs(modes.poles)])
        (gain, error, reach), entries = modes.gains(points), modes.entries(points)
        for s, found, bound, states, each, each_bound in zip(points, gain, error, reach, *entries, strict=True):
            exact = exact_response(*matrices, s)
            assert abs(found - np.linalg.norm(exact, 2)) <= bound + 1e-14 * found
            assert np.isinf(each_bound).all() or (np.abs(each - exact) <= each_bound + 1e-15 * np.abs(exact)).all()
            A, B = matrices[:2]
            assert np.linalg.norm(np.linalg.solve(s * np.eye(4) - A, B)) <= 1.01 * states or bound == np.inf


@pytest.mark.parametrize("damping", [0.5, 1e-3, 1e-7])
@pytest.mark.parametrize("discrete", [False, True])
def test_the_mean_square_is_within_its_bound(damping, discrete):
    for seed in range(4):
        A, B, C, D = model(seed, 4, damping, 2 * (seed % 2))
        if discrete:  # Tustin's rule
            A, D = np.linalg.solve(np.eye(4) - 0.05 * A, np.eye(4) + 0.05 * A), np.ones((3, 2))
        square, error = ModalResponse.of(A, B, C, D).mean_square(discrete)
        exact = exact_mean_square(A, B, C, D, discrete)
        assert abs(Fraction(square) - exact) <= error
        assert error <= 1e-8 / damping * square


def exact_mean_square(A, B, C, D, discrete):
    """From the controllability Gramian, solved for in whole fractions."""
    flint = pytest.importorskip("flint")

    def whole(matrix):
        pairs = [[Fraction(x).as_integer_ratio() for x in row] for row in matrix.tolist()]
        return flint.fmpq_mat([[flint.fmpq(*pair) for pair in row] for row in pairs])

    def kron(left, right):
        n = left.nrows()
        return flint.fmpq_mat(
            [[left[i // n, j // n] * right[i % n, j % n] for j in range(n * n)] for i in range(n * n)]
        )

    n, a, b, c, d = len(A), *(whole(x) for x in (A, B, C, D))
    eye = whole(np.eye(n))
    left = kron(a, a) - kron(eye, eye) if discrete else kron(a, eye) + kron(eye, a)
    square = b * b.transpose()
    P = left.solve(flint.fmpq_mat(n * n, 1, [-square[i, j] for i in range(n) for j in range(n)]))
    gain = c * flint.fmpq_mat(n, n, [P[k, 0] for k in range(n * n)]) * c.transpose()
    found = sum(gain[i, i] for i in range(len(C)))
    if discrete:
        found += sum((d * d.transpose())[i, i] for i in range(len(C)))
    return Fraction(int(found.p), int(found.q))


@pytest.mark.parametrize("n", [4, 7])
@pytest.mark.parametrize("damping", [0.5, 1e-6])
def test_the_determinant_is_within_its_bound(n, damping):
    A, B, C, D = model(3, n, damping, 1)
    modes = ModalResponse.of(A, B, C, D)
    p = characteristic([[Fraction(x) for x in row] for row in A.tolist()])
    for s in (0.0, 1.0, 50.0, *np.abs(modes.poles.imag)):
        (value,), (error,) = modes.log_determinant(np.array([1j * s]))
        turned = [c * Fraction(s) ** (n - k) * (1 if (n - k) % 4 < 2 else -1) for k, c in enumerate(p)]  # i^2 = -1
        real, imag = sum(turned[n % 2 :: 2]), sum(turned[1 - n % 2 :: 2])
        assert error < 1e-5
        assert abs(np.exp(value) / complex(float(real), float(imag)) - 1) <= 1.01 * error


def test_a_determinant_whose_factors_underflow_has_no_bound():
    modes = ModalResponse.of(np.diag([-1e-80, -2e-80, -3e-80, -4e-80]), np.eye(4), np.eye(4), np.zeros((4, 4)))
    assert np.isinf(modes.log_determinant(np.zeros(1, complex))[1]).all()


@pytest.mark.parametrize("off", [0.0, 1e-9, 1e-4])
def test_eigenvectors_from_elsewhere_have_bounds_that_hold(off):
    A, B, C, D = model(5, 4, 0.1, 1)
    poles, vectors = np.linalg.eig(A)
    known = poles * (1 + off), 7 * vectors + off * np.ones((4, 4))
    modes = ModalResponse.of(A, B, C, D, known)
    own = ModalResponse.of(A, B, C, D)
    for s in 1j * np.array([0.0, 1.0, *np.abs(poles)]):
        exact = exact_response(A, B, C, D, s)
        found, bound, _ = modes.response(np.array([s]))
        assert np.isinf(bound[0]) or np.linalg.norm(found[0] - exact) <= bound[0]
        assert off or bound[0] <= 10 * own.response(np.array([s]))[1][0]


def characteristic(A):
    """Coefficients of det(xI - A), the highest power first, by Faddeev and Leverrier."""
    n, M, c = len(A), [[Fraction(0)] * len(A) for _ in A], [Fraction(1)]
    for k in range(1, n + 1):
        M = [[sum(A[i][h] * M[h][j] for h in range(n)) + (c[-1] if i == j else 0) for j in range(n)] for i in range(n)]
        c.append(-sum(A[i][h] * M[h][i] for i in range(n) for h in range(n)) / k)
    return c


def test_an_ordinary_model_has_small_bounds():
    modes, points = ModalResponse.of(*model(0, 6, 0.1, 0)), 1j * np.geomspace(0.01, 100, 50)
    gain, error, _ = modes.gains(points)
    assert (error <= 1e-9 * gain.max()).all()
    assert (modes.entries(points)[1] <= 1e-9 * gain.max()).all()


def test_modes_that_do_not_span_are_told():
    A = -np.eye(4) + np.diag(np.ones(3), 1)
    modes = ModalResponse.of(A, np.eye(4), np.eye(4), np.zeros((4, 4)))
    if modes is not None:
        assert (modes.gains(1j * np.ones(1))[1] > 1e-3).all()
    G = StateSpaceModel(A, np.eye(4)[:, [3]], np.eye(4)[[0]], [[0.0]])  # 1 / (s + 1)^4
    assert hinf_norm(G).value == pytest.approx(1.0, rel=1e-12)


def test_a_point_on_a_pole_has_no_bound():
    modes = ModalResponse.of(np.array([[0.0, 1.0], [-1.0, 0.0]]), np.eye(2), np.eye(2), np.zeros((2, 2)))
    assert np.isinf(modes.gains(np.array([1j]))[1]).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 3), (3, 1), (2, 2), (2, 4), (4, 2), (3, 3)])
def test_largest_gain_is_the_largest_singular_value(shape):
    rng = np.random.default_rng(1)
    stack = rng.standard_normal((20, *shape)) + 1j * rng.standard_normal((20, *shape))
    stack[0] = 0
    stack[1] = np.outer(stack[1][:, 0], stack[1][0])  # of rank one
    assert largest_gain(stack) == pytest.approx(np.linalg.svd(stack, compute_uv=False)[:, 0], rel=1e-13)


@pytest.mark.parametrize("discrete", [False, True])
def test_modes_prove_what_is_stable_and_nothing_else(discrete):
    for seed in range(20):
        A, B, C, D = model(seed, 6, 10.0 ** -(seed % 5), seed % 3)
        A = np.linalg.solve(np.eye(6) - 0.05 * A, np.eye(6) + 0.05 * A) if discrete else A
        assert ModalResponse.of(A, B, C, D).proves_stable(discrete)
        poles = np.linalg.eigvals(A)
        # The mode nearest to the boundary moves onto it, and over it.
        for over in (0.0, 1e-9):
            moved = A / np.abs(poles).max() * (1 + over) if discrete else A - (poles.real.max() - over) * np.eye(6)
            modes = ModalResponse.of(moved, B, C, D)
            assert modes is None or not modes.proves_stable(discrete)
