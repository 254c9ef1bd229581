"""H-infinity norms against SLICOT's AB13DD, which is right on well-scaled models."""

from __future__ import annotations

import os
import subprocess
import sys

import control
import numpy as np
import pytest
from threadpoolctl import threadpool_info

from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis import slicot
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


BITS = """
import numpy as np
from robustlab.linear_analysis import slicot
rng = np.random.default_rng(4)
A = rng.standard_normal((150, 150)) - 20 * np.eye(150)
B, C = rng.standard_normal((150, 3)), rng.standard_normal((2, 150))
found = slicot.peak_gain(A, B, C, np.zeros((2, 3))), slicot.gramian_factors(A, B, C, False)
print([np.asarray(x).tobytes().hex() for part in found for x in part])
"""


def test_the_same_bits_whatever_the_number_of_threads():
    """slycot brings a BLAS of its own, which is loaded at the first call."""
    runs = [
        subprocess.run([sys.executable, "-c", BITS], env={**os.environ, "OPENBLAS_NUM_THREADS": threads},
                       capture_output=True, text=True, check=True, timeout=120).stdout
        for threads in ("1", "4")
    ]  # fmt: skip
    assert runs[0] == runs[1]
    assert len(runs[0]) > 1000
    slicot.peak_gain(-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)))
    assert [x["num_threads"] for x in threadpool_info() if "slycot" in x["filepath"]] == [1]


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_slicot_is_never_called_with_what_it_does_not_return_from(wrong):
    for call in (slicot.peak_gain, slicot.invariant_zeros):
        with pytest.raises(NoTrustworthyNumber, match="NaN or infinite"):
            call(-np.eye(2), np.full((2, 1), wrong), np.ones((1, 2)), np.zeros((1, 1)))
    with pytest.raises(NoTrustworthyNumber, match="SB03MD57: info 3"):
        slicot.lyapunov_solution(np.diag([1.0, -1.0]), np.eye(2), False)
