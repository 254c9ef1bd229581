"""Polynomials in whole numbers against Leibniz' formula in fractions, and against roots that were put there."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustlab.errors import NoTrustworthyNumber
from robustlab.exact_arithmetic import determinant, normal_rank, product, roots, value


def leibniz(M, n, s):
    """``det(M - s E)`` as a fraction, by the sum over permutations."""
    P = [[Fraction(x) - (s if i == j and i < n else 0) for j, x in enumerate(row)] for i, row in enumerate(M.tolist())]
    total = Fraction(0)
    for order in itertools.permutations(range(len(P))):
        sign = (-1) ** sum(a > b for a, b in itertools.combinations(order, 2))
        total += sign * math.prod((P[i][j] for i, j in enumerate(order)), start=Fraction(1))
    return total


entry = st.one_of(st.just(0.0), st.integers(-3, 3).map(float), st.floats(-1e3, 1e3), st.floats(-1e-200, 1e-200),
                  st.sampled_from([1e300, -1e-300, 5e-324, 1e17]))  # fmt: skip


@settings(max_examples=80, deadline=None)
@given(st.data(), st.integers(0, 3), st.integers(0, 2))
def test_determinants_are_exact(data, n, m):
    k = n + m
    M = np.array(data.draw(st.lists(entry, min_size=k * k, max_size=k * k))).reshape(k, k)
    found = determinant(M, n)
    scale = Fraction(2) ** found.exponent
    for s in (Fraction(0), Fraction(1), Fraction(-7, 3), Fraction(10**20)):
        wanted = leibniz(M, n, s)
        assert scale * (value(found.coefficients, s) if found.coefficients else 0) == wanted
    assert normal_rank(M, n) == k or not found.coefficients


def test_ranks_of_pencils():
    rng = np.random.default_rng(0)
    tall = rng.integers(-3, 4, (5, 2)) @ rng.integers(-3, 4, (2, 4))
    assert normal_rank(tall.astype(float), 0) == 2
    assert normal_rank(tall.astype(float), 3) == 5 - 1  # -s in three rows, and one row of the rest
    assert normal_rank(np.zeros((2, 3)), 0) == 0


def from_roots(zeros):
    f = [1]
    for z in zeros:
        f = product(f, [-Fraction(z).numerator, Fraction(z).denominator])
    return f


def test_wilkinson_and_roots_of_all_sizes():
    """1 to 40, whose coefficients' last digits move the roots by more than they are; and 10^-20 to 10^20."""
    assert {r.value for r in roots(from_roots(range(1, 41)))} == {complex(k) for k in range(1, 41)}
    sizes = [Fraction(10) ** k for k in range(-20, 21, 4)]
    found = sorted(r.re for r in roots(from_roots(sizes)))
    assert all(abs(a / b - 1) < Fraction(1, 2**95) for a, b in zip(found, sizes, strict=True))


def test_multiple_roots_and_neighbours():
    f = product(from_roots([0, 0, -1, -1, -1, 2]), product([1, 0, 1], [1, 0, 1]))
    assert {(r.value, r.multiplicity) for r in roots(f)} == {(0j, 2), (-1 + 0j, 3), (2 + 0j, 1), (1j, 2), (-1j, 2)}
    near = Fraction(1) + Fraction(1, 10**20)
    one, two = sorted(r.re for r in roots(from_roots([1, near])))
    assert abs((two - one) * 10**20 - 1) < Fraction(1, 10**8)
    with pytest.raises(NoTrustworthyNumber, match="30 digits do not tell them apart"):
        roots(from_roots([1, 1 + Fraction(1, 10**40)]))


def test_real_parts_next_to_the_axis_are_right():
    """((s + d)^2 + 1) with d = 10^-20 and 0: the real part is 20 digits below the root."""
    d = Fraction(1, 10**20)
    damped = [(1 + d**2).numerator, (2 * d * 10**40).numerator, 10**40]
    assert sorted(float(r.re) for r in roots(damped)) == pytest.approx([-1e-20, -1e-20], rel=1e-8)
    assert [r.re for r in roots([1, 0, 1])] == [0, 0]
