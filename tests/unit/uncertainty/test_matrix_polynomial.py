"""LFTs of numeric matrix polynomials reproduce the polynomial, with no more repetitions than its ranks require."""

from __future__ import annotations

import numpy as np
import pytest

from robustlab.uncertainty import MatrixPolynomial, polynomial_lft


def closed(lft, values: dict[str, float]) -> np.ndarray:
    delta = np.diag([values[name] for name in lft.names])
    inner = np.linalg.solve(np.eye(len(lft.names)) - delta @ lft.d11, delta @ lft.d12)
    return lft.d22 + lft.d21 @ inner


def of_rank(rng, r: int, m: int = 5, n: int = 7) -> np.ndarray:
    return rng.normal(size=(m, r)) @ rng.normal(size=(r, n))


@pytest.mark.parametrize("seed", range(4))
def test_any_polynomial_is_reproduced(seed):
    rng = np.random.default_rng(seed)
    exponents = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (1, 1, 0), (2, 1, 0), (0, 0, 3), (1, 0, 1)]
    poly = MatrixPolynomial(("a", "b", "c"), {e: of_rank(rng, 2) for e in exponents})
    # units of rows and columns that are far apart
    scale = np.outer(2.0 ** rng.integers(-20, 20, 5), 2.0 ** rng.integers(-20, 20, 7))
    scaled = MatrixPolynomial(poly.names, {e: part * scale for e, part in poly.terms.items()})
    lft = polynomial_lft(scaled, scale, 1e-12)
    for t in rng.uniform(-2, 2, (5, 3)):
        by_hand = sum(t[0] ** i * t[1] ** j * t[2] ** k * part for (i, j, k), part in poly.terms.items())
        np.testing.assert_allclose(closed(lft, dict(zip("abc", t, strict=True))) / scale, by_hand, atol=1e-10)
        np.testing.assert_allclose(poly(t), by_hand, atol=1e-12)


def test_an_affine_polynomial_has_the_repetitions_of_its_ranks():
    rng = np.random.default_rng(1)
    ranks = {"a": 1, "b": 3, "c": 5}
    terms = {(0, 0, 0): rng.normal(size=(5, 7))}
    terms |= {tuple(np.eye(3, dtype=int)[k].tolist()): of_rank(rng, r) for k, r in enumerate(ranks.values())}
    lft = polynomial_lft(MatrixPolynomial(tuple(ranks), terms), np.ones((5, 7)), 1e-12)
    assert {name: lft.names.count(name) for name in ranks} == ranks
    assert not lft.d11.any()
