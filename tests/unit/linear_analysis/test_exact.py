"""Polynomials in whole numbers against Leibniz' formula in fractions, and against given roots."""

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from flint import fmpq, fmpz_poly
from hypothesis import given, settings
from hypothesis import strategies as st

from robustlab.linear_analysis import (
    all_left,
    determinant,
    equilibrating_exponents,
    from_the_circle,
    on_axis,
    roots,
)


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


@settings(max_examples=80)
@given(st.data(), st.integers(0, 3), st.integers(0, 2))
def test_determinants_are_exact(data, n, m):
    k = n + m
    M = np.array(data.draw(st.lists(entry, min_size=k * k, max_size=k * k))).reshape(k, k)
    found, exponent = determinant(M, n)
    for s in (Fraction(0), Fraction(1), Fraction(-7, 3), Fraction(10**20)):
        value = found(fmpq(s.numerator, s.denominator))
        assert Fraction(2) ** exponent * Fraction(int(value.p), int(value.q)) == leibniz(M, n, s)


def from_roots(zeros):
    return math.prod(
        (fmpz_poly([-Fraction(z).numerator, Fraction(z).denominator]) for z in zeros), start=fmpz_poly([1])
    )


def test_wilkinson_and_roots_of_all_sizes():
    """Roots 1 to 40, which the last digits of the coefficients move by more than their size; and 10^-20 to 10^20."""
    assert {r.value for r in roots(from_roots(range(1, 41)))} == {complex(k) for k in range(1, 41)}
    sizes = [Fraction(10) ** k for k in range(-20, 21, 4)]
    found = sorted(r.re for r in roots(from_roots(sizes)))
    assert all(abs(a / b - 1) < Fraction(1, 2**95) for a, b in zip(found, sizes, strict=True))


def test_multiple_roots_and_neighbours():
    f = from_roots([0, 0, -1, -1, -1, 2]) * fmpz_poly([1, 0, 1]) ** 2
    assert {(r.value, r.multiplicity) for r in roots(f)} == {(0j, 2), (-1 + 0j, 3), (2 + 0j, 1), (1j, 2), (-1j, 2)}
    for digits in (20, 60):
        one, two = sorted(r.re for r in roots(from_roots([1, 1 + Fraction(1, 10**digits)])))
        assert abs((two - one) * 10**digits - 1) < Fraction(1, 10**8)


def test_real_parts_next_to_the_axis_are_accurate():
    """((s + d)^2 + 1) with d = 10^-20 and 0: the real part is 20 digits below the root."""
    d = Fraction(1, 10**20)
    damped = fmpz_poly([(1 + d**2).numerator, (2 * d * 10**40).numerator, 10**40])
    assert sorted(float(r.re) for r in roots(damped)) == pytest.approx([-1e-20, -1e-20], rel=1e-8)
    assert [r.re for r in roots(fmpz_poly([1, 0, 1]))] == [0, 0]


@pytest.mark.parametrize(("damping", "left", "on"), [(1, True, False), (0, False, True), (-1, False, False)])
def test_roots_next_to_the_axis_are_decided(damping, left, on):
    """(s + 1)^2 (s^2 + 2 d s + 1) with d of 10^-100, far below the first precision of the roots."""
    f = from_roots([-1, -1]) * fmpz_poly([10**100, 2 * damping, 10**100])
    assert (all_left(f), on_axis(f)) == (left, on)


def test_symmetric_roots_off_the_axis_are_not_on_it():
    """(s^2 - 1) (s^4 + 1): even and odd part have all roots in common, none of them on the axis."""
    f = from_roots([1, -1]) * fmpz_poly([1, 0, 0, 0, 1])
    assert (all_left(f), on_axis(f), on_axis(f * fmpz_poly([0, 1]))) == (False, False, True)


def test_the_disk_becomes_the_half_plane():
    mapped = from_the_circle(from_roots([Fraction(1, 2), -1]), 2)  # z = 1/2 goes to v = -1/3, -1 to infinity
    assert (mapped(fmpq(-1, 3)), mapped.degree()) == (0, 1)


def test_equilibrated_rows_and_columns():
    rng = np.random.default_rng(1)
    M = rng.normal(size=(4, 6)) * 10.0 ** rng.integers(-150, 150, (4, 1)) * 10.0 ** rng.integers(-100, 100, 6)
    M[:, 2] = 0
    r, c = equilibrating_exponents(M)
    scaled = np.abs(np.ldexp(M, r[:, None] + c))
    assert 0.2 < scaled.max(axis=1).min() <= scaled.max(axis=1).max() < 4
    assert np.delete(scaled, 2, axis=1).max(axis=0).min() > 0.2
