"""H-infinity norms against SLICOT's AB13DD, which is right on well-scaled models."""

from __future__ import annotations

import control
import numpy as np
import pytest

from robustlab.norms import h2_norm, hinf_norm
from robustlab.statespace import StateSpaceModel


@pytest.mark.parametrize("seed", range(25))
@pytest.mark.parametrize("discrete", [False, True])
def test_same_norm_as_slicot(seed, discrete):
    rng = np.random.default_rng(seed)
    n, m, p = rng.integers(1, 10), rng.integers(1, 4), rng.integers(1, 4)
    A = rng.standard_normal((n, n))
    if discrete:
        A *= 0.95 / np.abs(np.linalg.eigvals(A)).max()
    else:
        A -= np.eye(n) * (np.linalg.eigvals(A).real.max() + 0.05)
    model = StateSpaceModel(
        A, rng.standard_normal((n, m)), rng.standard_normal((p, n)), rng.standard_normal((p, m)), 0.1 * discrete
    )
    value, _ = control.linfnorm(model.to_control(), 1e-10)
    assert hinf_norm(model).value == pytest.approx(value, rel=1e-6)


@pytest.mark.parametrize("seed", range(10))
def test_same_h2_norm_as_python_control(seed):
    rng = np.random.default_rng(100 + seed)
    n = rng.integers(1, 8)
    A = rng.standard_normal((n, n))
    A -= np.eye(n) * (np.linalg.eigvals(A).real.max() + 0.3)
    model = StateSpaceModel(A, rng.standard_normal((n, 2)), rng.standard_normal((2, n)), np.zeros((2, 2)))
    assert h2_norm(model).value == pytest.approx(control.norm(model.to_control(), 2), rel=1e-7)
