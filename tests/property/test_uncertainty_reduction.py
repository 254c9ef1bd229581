"""n-dimensional reduction with its evidence."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robustlab import FullBlock, RealScalar, UncertainModel, elementwise, reduce_model
from robustlab.errors import InputError
from robustlab.result import plain
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty import STRUCTURES

SETTINGS = settings(max_examples=12)
seeds = st.integers(0, 100_000)


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


@SETTINGS
@given(seeds, st.integers(1, 4), st.sampled_from(STRUCTURES))
def test_elementwise_sets_are_rank_minimal(seed, rank, structure):
    """The rank of each structure's coefficient is the least number of repetitions; nothing is left to remove."""
    rng = np.random.default_rng(seed)
    n, n_u, n_y = 5, 2, 2
    change = rng.standard_normal((n + n_y, rank)) @ rng.standard_normal((rank, n + n_u))
    first = rng.standard_normal((n + n_y, n + n_u))
    models = [StateSpaceModel(x[:n, :n], x[:n, n:], x[n:, :n], x[n:, n:]) for x in (first, first + change)]
    found = reduce_model(elementwise(*models, structure))
    parts = {"A": change[:n, :n], "B": change[:n, n:], "C": change[n:, :n], "D": change[n:, n:]}
    ranks = {k: int(np.linalg.matrix_rank(v)) for k, v in parts.items()} if structure == "matrices" else {}
    expected = ranks or ({"single": rank} if structure == "single" else dict.fromkeys(found.before, 1))
    assert found.before == found.after == expected
