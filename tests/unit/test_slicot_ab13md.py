"""The wrapper of AB13MD: what it lets through, and what it refuses before SLICOT can hang on it."""

from __future__ import annotations

import numpy as np
import pytest

from robustlab.errors import InputError
from robustlab.slicot import ab13md


def test_bound_and_scalings_fit_together():
    rng = np.random.default_rng(0)
    Z = rng.standard_normal((4, 4)) + 1j * rng.standard_normal((4, 4))
    beta, d, g = ab13md(Z, [1, 1, 2], [True, False, False])
    D, G = np.diag(d), np.diag(g)
    lmi = Z.conj().T @ D @ Z + 1j * (G @ Z - Z.conj().T @ G) - beta**2 * D
    assert np.linalg.eigvalsh(lmi)[-1] <= 1e-5 * beta**2 * d.max()
    assert g[1:] == pytest.approx(0.0)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_not_finite_is_refused_before_the_call(bad):
    Z = np.eye(2, dtype=complex)
    Z[0, 1] = bad
    with pytest.raises(InputError, match="NaN or infinite"):
        ab13md(Z, [1, 1], [False, False])


@pytest.mark.parametrize(("sizes", "real"), [([1, 1], [False, False]), ([1, 3], [False, False])])
def test_sizes_have_to_fit(sizes, real):
    with pytest.raises(InputError, match="shape"):
        ab13md(np.eye(3), sizes, real)


def test_repeated_real_blocks_are_refused():
    with pytest.raises(InputError, match="larger than 1 x 1"):
        ab13md(np.eye(2), [2], [True])
