"""n-dimensional reduction with its evidence, and well-posedness: proofs against grids, refutations by their Delta."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag

from robustlab.errors import InputError
from robustlab.result import Status, plain
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.algebra import reduction
from robustlab.uncertainty.blocks import ComplexScalar, FullBlock, ParameterRange, RealScalar, delta_matrix
from robustlab.uncertainty.elementwise import STRUCTURES, elementwise
from robustlab.uncertainty.lft import UncertainModel
from robustlab.uncertainty.well_posedness import well_posedness

SETTINGS = settings(max_examples=12, deadline=None, derandomize=True)
seeds = st.integers(0, 100_000)


def test_sets_without_blocks_states_or_signals():
    gain = UncertainModel(StateSpaceModel([], [], [], [[1.0]]), ())
    assert reduction(gain).after == {}
    dead = UncertainModel(StateSpaceModel([[-1.0]], [[0.0, 1.0]], [[1.0], [1.0]], np.zeros((2, 2))), [RealScalar("k")])
    assert reduction(dead).after == {}
    assert "k 1 -> 0" in str(reduction(dead))
    full = UncertainModel(StateSpaceModel([], [], [], np.ones((2, 2))), [FullBlock("f", 1, 1)])
    assert reduction(full).after == {"f": 1}
    assert plain(reduction(full).to_json())["status"] == "converged"
    with pytest.raises(InputError, match="tolerance"):
        reduction(gain, 2.0)


@SETTINGS
@given(seeds, st.integers(1, 4), st.sampled_from(STRUCTURES))
def test_elementwise_sets_are_rank_minimal(seed, rank, structure):
    """The rank of each structure's coefficient is the least number of repetitions; nothing is left to remove."""
    rng = np.random.default_rng(seed)
    n, n_u, n_y = 5, 2, 2
    change = rng.standard_normal((n + n_y, rank)) @ rng.standard_normal((rank, n + n_u))
    first = rng.standard_normal((n + n_y, n + n_u))
    models = [StateSpaceModel(x[:n, :n], x[:n, n:], x[n:, :n], x[n:, n:]) for x in (first, first + change)]
    found = reduction(elementwise(*models, structure))
    parts = {"A": change[:n, :n], "B": change[:n, n:], "C": change[n:, :n], "D": change[n:, n:]}
    ranks = {k: int(np.linalg.matrix_rank(v)) for k, v in parts.items()} if structure == "matrices" else {}
    expected = ranks or ({"single": rank} if structure == "single" else dict.fromkeys(found.before, 1))
    assert found.before == found.after == expected


# --- well-posedness ---------------------------------------------------------------------------------------------------


def static(d11, blocks):
    p, q = np.shape(d11)
    whole = np.block([[np.asarray(d11), np.ones((p, 1))], [np.ones((1, q)), np.zeros((1, 1))]])
    return UncertainModel(StateSpaceModel([], [], [], whole), blocks)


def determinant(model, values):
    q, p = model.delta_shape
    return np.linalg.det(np.eye(p) - model.M.D[:p, :q] @ delta_matrix(model.blocks, values))


@SETTINGS
@given(seeds, st.floats(0.2, 2.0), st.booleans())
def test_real_sets_against_a_grid(seed, size, repeated):
    rng = np.random.default_rng(seed)
    span = ParameterRange(1.0, 1.0, below=float(rng.uniform(0.3, 2.0)))
    blocks = [RealScalar("a", 2 if repeated else 1, span), RealScalar("b")]
    q = sum(b.rows for b in blocks)
    model = static(size * rng.standard_normal((q, q)) / np.sqrt(q), blocks)
    answer = well_posedness(model)
    grid = np.linspace(-1, 1, 41)
    signs = [determinant(model, {"a": a, "b": b}) for a in grid for b in grid]
    if answer.well_posed is False:
        assert abs(determinant(model, answer.delta)) < 1e-8
        assert max(abs(v) for v in answer.delta.values()) <= 1 + 1e-9
        assert answer.residual < 1e-9
        assert "ill-posed at Delta: a = " in str(answer)
    elif answer.well_posed:
        assert min(signs) > 0
    if min(signs) < 0:
        assert answer.well_posed is False


def test_repeated_real_parameters_need_boxes_and_complex_ones_are_ill_posed():
    turn = [[0.0, 1.0], [-1.0, 0.0]]  # det(I - turn delta) = 1 + delta^2
    real = well_posedness(static(turn, [RealScalar("k", 2)]), 5.0)
    assert (real.well_posed, real.status) == (True, Status.CONVERGED)
    assert real.boxes > 1
    assert real.bound < 1
    complex_ = well_posedness(static(turn, [ComplexScalar("k", 2)]), 1.5)
    assert complex_.well_posed is False
    assert abs(determinant(static(turn, [ComplexScalar("k", 2)]), complex_.delta)) < 1e-9
    assert abs(complex_.delta["k"]) == pytest.approx(1.0)


@SETTINGS
@given(seeds)
def test_full_blocks_are_singular_at_their_norm(seed):
    rng = np.random.default_rng(seed)
    d11 = rng.standard_normal((2, 3))
    d11 *= 1.25 / np.linalg.norm(d11, 2)
    blocks = [FullBlock("f", 3, 2)]
    assert well_posedness(static(d11, blocks), 0.79).well_posed is True
    answer = well_posedness(static(d11, blocks))
    assert answer.well_posed is False
    assert np.linalg.norm(answer.delta["f"], 2) <= 1 + 1e-12
    assert abs(determinant(static(d11, blocks), answer.delta)) < 1e-9


def test_mixed_sets_and_open_questions():
    model = static([[0.0, 0.9], [0.9, 0.0]], [RealScalar("k"), ComplexScalar("c")])
    assert well_posedness(model).well_posed is True
    answer = well_posedness(model, 1.5)
    assert answer.well_posed is False
    assert abs(determinant(model, answer.delta)) < 1e-9
    turn = np.kron(np.eye(1), [[0.0, 1.0], [-1.0, 0.0]])
    open_ = well_posedness(static(block_diag(turn, 0.1), [RealScalar("k", 2), ComplexScalar("c")]), 1.5)
    assert (open_.well_posed, open_.status) == (None, Status.INCONCLUSIVE)  # no boxes with complex blocks
    assert str(open_).startswith("open")
