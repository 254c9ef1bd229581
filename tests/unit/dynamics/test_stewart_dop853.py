"""The coefficients that the platform's integrator takes from scipy: published values, and the order conditions."""

from __future__ import annotations

import importlib
import sys
from fractions import Fraction

import numpy as np
import pytest
from scipy.integrate._ivp import dop853_coefficients

from robustlab.dynamics.integrator import steps as dop853
from robustlab.dynamics.integrator.steps import E3, E5, A, B, C, D
from robustlab.errors import EnvironmentFault

# Hairer, Norsett, Wanner 1993, section II.10: nodes and weights with a closed form.
ROOT6 = np.sqrt(6.0)
PUBLISHED = {
    1: (12 - 2 * ROOT6) / 135,
    2: (6 - ROOT6) / 45,
    3: (6 - ROOT6) / 30,
    4: (6 + ROOT6) / 30,
    5: Fraction(1, 3),
    6: Fraction(1, 4),
    7: Fraction(4, 13),
    8: Fraction(127, 195),
    9: Fraction(3, 5),
    10: Fraction(6, 7),
    11: Fraction(1),
    13: Fraction(1, 10),
    14: Fraction(1, 5),
    15: Fraction(7, 9),
}


@pytest.mark.parametrize("stage", PUBLISHED)
def test_nodes_are_the_published_ones(stage):
    assert C[stage] == pytest.approx(float(PUBLISHED[stage]), rel=1e-15)


def test_the_first_stages_are_those_that_the_nodes_fix():
    assert A[1, 0] == C[1]
    assert A[2, :2] == pytest.approx([C[2] / 4, 3 * C[2] / 4], rel=1e-15)
    assert A[3, [0, 2]] == pytest.approx([C[3] / 4, 3 * C[3] / 4], rel=1e-15)
    assert A[5, 0] == pytest.approx(float(Fraction(1, 27)), rel=1e-15)


def test_every_stage_stands_at_its_node():
    assert A.sum(axis=1) == pytest.approx(C, abs=2e-14)
    assert np.array_equal(A[12, :12], B)


def test_quadrature_has_order_8():
    for k in range(1, 9):
        assert B @ C[:12] ** (k - 1) == pytest.approx(1 / k, abs=5e-15)


def test_the_further_conditions_up_to_order_5():
    a, c = A[:12, :12], C[:12]
    assert B @ a @ c == pytest.approx(1 / 6, abs=1e-14)
    assert B @ (c * (a @ c)) == pytest.approx(1 / 8, abs=1e-14)
    assert B @ a @ c**2 == pytest.approx(1 / 12, abs=1e-14)
    assert B @ a @ a @ c == pytest.approx(1 / 24, abs=1e-14)
    assert B @ a @ a @ a @ c == pytest.approx(1 / 120, abs=1e-14)


def test_the_error_estimates_are_blind_to_what_lower_orders_have():
    nodes = C[:13]
    assert [float(E5 @ nodes**k) for k in range(5)] == pytest.approx([0.0] * 5, abs=1e-13)
    assert [float(E3 @ nodes**k) for k in range(3)] == pytest.approx([0.0] * 3, abs=1e-13)


def test_the_dense_output_integrates_polynomials():
    # With y' = t^k the coefficients of `polynomial` in steps.py give t^(k + 1) / (k + 1) all the way.
    for k in range(7):
        rate, share = C**k, np.linspace(0.0, 1.0, 11)
        change = 1 / (k + 1)
        f = [change, rate[0] - change, 2 * change - (rate[12] + rate[0]), *(D @ rate)]
        value = np.zeros_like(share)
        for row in range(6, -1, -1):
            value = (value + f[row]) * (share if row % 2 == 0 else 1.0 - share)
        assert value == pytest.approx(share ** (k + 1) / (k + 1), abs=1e-12)


def test_a_scipy_with_other_tables_is_named(monkeypatch):
    monkeypatch.setattr(dop853_coefficients, "D", D[:3])
    with pytest.raises(EnvironmentFault, match="scipy's D has the shape"):
        importlib.reload(dop853)
    monkeypatch.setitem(sys.modules, "scipy.integrate._ivp.dop853_coefficients", None)
    with pytest.raises(EnvironmentFault, match="no longer has its coefficients"):
        importlib.reload(dop853)
    monkeypatch.undo()
    importlib.reload(dop853)
