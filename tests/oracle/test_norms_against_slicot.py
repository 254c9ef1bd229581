"""Norms against SLICOT's AB13DD, which is right on well-scaled models, and reductions against AB09AD."""

import os
import subprocess
import sys

import control
import numpy as np
import pytest
import slycot
from threadpoolctl import threadpool_info

import robustlab as rl
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


# --- balanced truncation, and the Hankel norm of an optimal error -----------------------------------------------------


def stable_model(n, m, p, dt):
    rng = np.random.default_rng(n)
    A = rng.normal(size=(n, n))
    poles = np.linalg.eigvals(A)
    A = A / np.abs(poles).max() * 0.95 if dt else A - (poles.real.max() + 0.2) * np.eye(n)
    return rl.StateSpaceModel(A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), rng.normal(size=(p, m)), dt)


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize(("n", "m", "p", "order"), [(5, 1, 1, 2), (8, 2, 3, 4), (14, 3, 1, 6)])
def test_balanced_truncation_is_slicots(dt, n, m, p, order):
    G = stable_model(n, m, p, dt)
    found = rl.reduce_model(G, order)
    reduced, a, b, c, values = slycot.ab09ad("D" if dt else "C", "B", "N", n, m, p, G.A, G.B, G.C, order)[:5]
    assert reduced == order
    np.testing.assert_allclose(found.hankel, values, rtol=1e-9, atol=1e-13 * values[0])
    omega = np.linspace(0, 20, 30)
    theirs = rl.frequency_response(rl.StateSpaceModel(a, b, c, G.D, dt), omega)
    ours = rl.frequency_response(found.model, omega)
    np.testing.assert_allclose(ours, theirs, atol=1e-9 * np.abs(theirs).max())


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize(("n", "m", "p", "order"), [(5, 1, 1, 2), (8, 2, 3, 4), (11, 3, 1, 0)])
def test_slicot_finds_the_next_value_as_the_hankel_norm_of_an_optimal_error(dt, n, m, p, order):
    G = stable_model(n, m, p, dt)
    found = rl.reduce_model(G, order, method="hankel")
    assert found.status is rl.Status.CERTIFIED
    gap = G - found.model
    values = slycot.ab09ad("D" if dt else "C", "B", "N", gap.n_states, m, p, gap.A, gap.B, gap.C, 1)[4]
    assert values[0] == pytest.approx(found.hankel[order], rel=1e-8)
