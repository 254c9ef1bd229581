"""The coefficients that the platform's integrator takes from scipy: published values, and the order conditions."""

from __future__ import annotations

import importlib.util
import sys
from fractions import Fraction

import numpy as np
import pytest
from scipy.integrate._ivp import dop853_coefficients

from robustlab.dynamics.integrator import steps
from robustlab.dynamics.integrator.steps import B, C, D
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


def test_quadrature_has_order_8():
    for k in range(1, 9):
        assert B @ C[:12] ** (k - 1) == pytest.approx(1 / k, abs=5e-15)


def test_a_scipy_with_other_tables_is_named(monkeypatch):
    def imported_anew():  # beside the module in use: reloading that one would change the types its kernels know
        spec = importlib.util.spec_from_file_location("steps_anew", steps.__file__)
        spec.loader.exec_module(importlib.util.module_from_spec(spec))

    monkeypatch.setattr(dop853_coefficients, "D", D[:3])
    with pytest.raises(EnvironmentFault, match="scipy's D has the shape"):
        imported_anew()
    monkeypatch.setitem(sys.modules, "scipy.integrate._ivp.dop853_coefficients", None)
    with pytest.raises(EnvironmentFault, match="no longer has its coefficients"):
        imported_anew()
