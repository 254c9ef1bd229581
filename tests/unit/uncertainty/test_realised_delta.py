"""A complex Delta at one frequency as stable systems: value, norm, sizes, edges, and its pole on the axis."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab.uncertainty import realise_delta

SHAPES = [(1, 1), (1, 3), (3, 1), (2, 2), (3, 3), (4, 2), (2, 5)]


def matrix(kind: str, rows: int, cols: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    value = rng.standard_normal((rows, cols)) + 1j * rng.standard_normal((rows, cols))
    if kind == "rank one":
        return np.outer(value[:, 0], value[0])
    if kind == "one phase":
        return value.real * np.exp(0.3j)
    if kind == "equal singular values":
        return np.eye(rows, cols) * (1 + 1j)
    return value


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("kind", ["full", "rank one", "one phase", "equal singular values"])
@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_value_and_singular_values(shape, kind, dt):
    value = matrix(kind, *shape)
    block = rl.FullBlock("d", *shape)
    for omega in (0.05, 3.0, 30.0):
        made = realise_delta([block], {"d": value}, omega, dt)["d"]
        assert made.is_stable()
        assert made.dt == dt
        size = np.linalg.norm(value, 2)
        assert np.abs(rl.frequency_response(made, [omega])[0] - value).max() <= 1e-11 * size
        # The singular values are the same at every frequency, hence the norm is that of the value.
        elsewhere = rl.frequency_response(made, [0.0, 0.4 * omega, 31.0])
        wanted = np.linalg.svd(value, compute_uv=False)
        assert np.abs(np.linalg.svd(elsewhere, compute_uv=False) - wanted).max() <= 1e-10 * size


@given(
    phase=st.floats(-np.pi, np.pi),
    size=st.floats(1e-6, 1e6),
    omega=st.floats(1e-4, 1e4),
)
@settings(max_examples=60)
def test_any_complex_number_at_any_frequency(phase, size, omega):
    value = size * np.exp(1j * phase)
    made = realise_delta([rl.ComplexScalar("d")], {"d": value}, omega)["d"]
    assert abs(rl.frequency_response(made, [omega])[0, 0, 0] - value) <= 1e-12 * size
    assert made.n_states <= 2
    # Poles stay near omega, so that neither the eigenvalues nor a simulation of the loop suffer.
    assert all(omega * 1e-3 <= -p.real <= omega * 1e3 for p in made.poles())
    assert abs(np.abs(rl.frequency_response(made, [0.0, omega / 3, np.inf])) - size).max() <= 1e-12 * size
