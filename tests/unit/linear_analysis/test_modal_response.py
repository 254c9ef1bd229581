"""Responses from modes: the bounds of their errors hold, and where modes do not span there is none."""

from fractions import Fraction

import numpy as np
import pytest

from robustlab.linear_analysis.modal_response import ModalResponse


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
