"""Upper LFTs: state space against the formula in the frequency domain, and the reduction of repeated blocks."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag

from robustlab import (
    ComplexScalar,
    FullBlock,
    RealScalar,
    UncertainModel,
    elementwise,
    frequency_response,
    reduce_model,
)
from robustlab.errors import InputError
from robustlab.result import plain
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty import delta_matrix, delta_values

SETTINGS = settings(max_examples=40)
OMEGA = np.array([0.0, 0.4, 2.0, 30.0])
seeds = st.integers(0, 100_000)


def random_m(seed, n, q, p, n_u=2, n_y=1, dt=0.0):
    rng = np.random.default_rng(seed)
    a = rng.standard_normal((n, n)) - 3 * np.eye(n)
    return StateSpaceModel(
        a,
        rng.standard_normal((n, q + n_u)),
        rng.standard_normal((p + n_y, n)),
        0.2 * rng.standard_normal((p + n_y, q + n_u)),
        dt,
    )


def formula(m, delta, omega):
    q, p = delta.shape
    g = frequency_response(m, omega)
    m11, m12, m21, m22 = g[:, :p, :q], g[:, :p, q:], g[:, p:, :q], g[:, p:, q:]
    return m22 + m21 @ delta @ np.linalg.inv(np.eye(p) - m11 @ delta) @ m12


@SETTINGS
@given(seeds, st.integers(0, 3))
def test_evaluate_and_response_agree_and_complex_deltas_respond(seed, n):
    rng = np.random.default_rng(seed)
    blocks = [RealScalar("r", 2), ComplexScalar("c"), FullBlock("f", 2, 1)]
    model = UncertainModel(random_m(seed, n, 5, 4), blocks)
    real = {"r": 0.7, "c": -0.3, "f": 0.4 * rng.standard_normal((2, 1))}
    np.testing.assert_allclose(
        model.response(OMEGA, real), frequency_response(model.evaluate(real), OMEGA), rtol=1e-7, atol=1e-8
    )
    values = {**real, "c": 0.5j}
    np.testing.assert_allclose(model.response(OMEGA, values), formula(model.M, delta_matrix(blocks, values), OMEGA))
    with pytest.raises(InputError, match="complex Delta"):
        model.evaluate(values)
    back = delta_values(blocks, delta_matrix(blocks, values))
    assert (back["r"], back["c"]) == (0.7, 0.5j)
    np.testing.assert_array_equal(back["f"], real["f"])


# --- reduction -------------------------------------------------------------------------------------------------------


def hidden(seed, kept, extra, n=3):
    """A model whose two scalar blocks need ``kept`` repetitions but carry ``extra`` more, mixed by a random basis."""
    rng = np.random.default_rng(seed)
    total = [k + e for k, e in zip(kept, extra, strict=True)]
    q = sum(total)
    d11, into = 0.2 * rng.standard_normal((q, q)), rng.standard_normal((q, n + 2))
    first = 0
    for k, size in zip(kept, total, strict=True):
        dead = np.arange(first + k, first + size)  # reached by nothing outside the dead part
        others = np.setdiff1d(np.arange(q), dead)
        into[dead] = 0.0
        d11[np.ix_(dead, others)] = 0.0
        first += size
    basis = block_diag(*(rng.standard_normal((s, s)) + 2 * np.eye(s) for s in total))
    d11, into = basis @ d11 @ np.linalg.inv(basis), basis @ into
    out = rng.standard_normal((n + 2, q)) @ np.linalg.inv(basis)
    m = StateSpaceModel(
        rng.standard_normal((n, n)) - 3 * np.eye(n),
        np.hstack([out[:n], rng.standard_normal((n, 2))]),
        np.vstack([into[:, :n], rng.standard_normal((2, n))]),
        np.block([[d11, into[:, n:]], [out[n:], np.zeros((2, 2))]]),
    )
    return UncertainModel(m, [RealScalar("a", total[0]), ComplexScalar("b", total[1])])


@SETTINGS
@given(seeds, st.tuples(st.integers(1, 3), st.integers(1, 3)), st.tuples(st.integers(0, 3), st.integers(0, 3)))
def test_unreachable_repetitions_go_and_nothing_changes(seed, kept, extra):
    model = hidden(seed, kept, extra)
    small = model.reduce()
    assert tuple(b.repeats for b in small.blocks) == kept
    for values in ({"a": 0.8, "b": 0.3 - 0.4j}, {"a": -1.0, "b": 0.0}):
        before, after = model.response(OMEGA, values), small.response(OMEGA, values)
        np.testing.assert_allclose(after, before, rtol=1e-8, atol=1e-8 * np.abs(before).max())


def test_thesis_repetition_shrinks_to_the_rank():
    """One parameter through M12 = I, M21 = A_D (12 repetitions) has the rank of A_D."""
    rng = np.random.default_rng(4)
    n = 12
    a = rng.standard_normal((n, n))
    change = rng.standard_normal((n, 2)) @ rng.standard_normal((2, n))
    m = StateSpaceModel(
        a, np.hstack([change, np.ones((n, 1))]), np.vstack([np.eye(n), np.ones((1, n))]), np.zeros((n + 1, n + 1))
    )
    small = UncertainModel(m, [RealScalar("k", n)]).reduce()
    assert small.blocks == (RealScalar("k", 2),)
    np.testing.assert_allclose(small.evaluate({"k": 1.0}).A, a + change, atol=1e-12)


def test_minimal_blocks_stay():
    rng = np.random.default_rng(5)
    first = StateSpaceModel(rng.standard_normal((4, 4)), np.ones((4, 1)), np.ones((1, 4)), [[0.0]])
    second = StateSpaceModel(rng.standard_normal((4, 4)), np.ones((4, 1)), np.ones((1, 4)), [[0.0]])
    model = elementwise(first, second, "single")
    assert model.reduce().blocks == model.blocks


def test_sets_without_blocks_states_or_signals():
    gain = UncertainModel(StateSpaceModel([], [], [], [[1.0]]), ())
    assert reduce_model(gain).after == {}
    dead = UncertainModel(StateSpaceModel([[-1.0]], [[0.0, 1.0]], [[1.0], [1.0]], np.zeros((2, 2))), [RealScalar("k")])
    assert reduce_model(dead).after == {}
    assert "k 1 -> 0" in str(reduce_model(dead))
    full = UncertainModel(StateSpaceModel([], [], [], np.ones((2, 2))), [FullBlock("f", 1, 1)])
    assert reduce_model(full).after == {"f": 1}
    assert plain(reduce_model(full).to_json())["status"] == "converged"
    with pytest.raises(InputError, match="tolerance"):
        reduce_model(gain, tolerance=2.0)
