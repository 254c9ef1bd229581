"""Element-wise uncertainty: end points to 1e-12, minimal sizes, zeros kept, over random models and zero patterns."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from robustlab import elementwise
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty import STRUCTURES, endpoint_residual

SETTINGS = settings(max_examples=50)

sizes = st.tuples(st.integers(0, 6), st.integers(0, 3), st.integers(0, 3))
seeds = st.integers(0, 100_000)
patterns = st.sampled_from(["dense", "sparse", "no D", "A only", "A and B", "C and D", "D only", "one column", "none"])


def as_matrices(whole, n, dt=0.0):
    return StateSpaceModel(whole[:n, :n], whole[:n, n:], whole[n:, :n], whole[n:, n:], dt)


def mask(pattern, n, shape, rng):
    allowed = np.zeros(shape, dtype=bool)
    if pattern == "dense":
        allowed[:] = True
    elif pattern == "sparse":
        allowed = rng.random(shape) < 0.3
    elif pattern == "no D":
        allowed[:] = True
        allowed[n:, n:] = False
    elif pattern == "one column" and shape[1]:
        allowed[:, rng.integers(shape[1])] = True
    else:
        for name, rows, cols in (
            ("A", slice(0, n), slice(0, n)),
            ("B", slice(0, n), slice(n, None)),
            ("C", slice(n, None), slice(0, n)),
            ("D", slice(n, None), slice(n, None)),
        ):
            allowed[rows, cols] = name in pattern.split()
    return allowed


def pair(seed, size, pattern, spread=20, rank=None):
    """Nominal and perturbed models in units that differ by up to ``2^spread``; dense differences of the given rank."""
    rng = np.random.default_rng(seed)
    n, n_u, n_y = size
    shape = (n + n_y, n + n_u)
    units = np.exp2(rng.integers(-spread, spread + 1, (shape[0], 1)) + rng.integers(-spread, spread + 1, (1, shape[1])))
    nominal = rng.standard_normal(shape) * units
    change = rng.standard_normal(shape)
    if rank is not None:
        change = rng.standard_normal((shape[0], rank)) @ rng.standard_normal((rank, shape[1]))
    change = 0.3 * change * units * mask(pattern, n, shape, rng)
    return nominal, nominal + change


def assert_close(found, wanted, other):
    """To 1e-12 of the largest entry of each matrix."""
    for name in "ABCD":
        f, w, o = getattr(found, name), wanted[name], other[name]
        size = max(np.abs(w).max(initial=0.0), np.abs(o).max(initial=0.0))
        assert np.abs(f - w).max(initial=0.0) <= 1e-12 * size, name


def parts(whole, n):
    return {"A": whole[:n, :n], "B": whole[:n, n:], "C": whole[n:, :n], "D": whole[n:, n:]}


@SETTINGS
@given(seeds, sizes, patterns, st.sampled_from(STRUCTURES))
def test_end_points_and_mirror(seed, size, pattern, structure):
    n = size[0]
    nominal, perturbed = pair(seed, size, pattern)
    model = elementwise(as_matrices(nominal, n), as_matrices(perturbed, n), structure)
    names = [b.name for b in model.blocks]
    assert_close(model.evaluate(dict.fromkeys(names, 1.0)), parts(perturbed, n), parts(nominal, n))
    assert_close(model.evaluate(dict.fromkeys(names, -1.0)), parts(2 * nominal - perturbed, n), parts(perturbed, n))
    for name, matrix in parts(nominal, n).items():
        np.testing.assert_array_equal(getattr(model.evaluate({}), name), matrix)
        np.testing.assert_array_equal(getattr(model.nominal, name), matrix)
    assert endpoint_residual(model, as_matrices(perturbed, n)) <= 1e-12


@SETTINGS
@given(seeds, sizes, patterns)
def test_number_of_channels_is_minimal(seed, size, pattern):
    n = size[0]
    nominal, perturbed = pair(seed, size, pattern, spread=0)
    first, second = as_matrices(nominal, n), as_matrices(perturbed, n)
    change = parts(perturbed - nominal, n)
    rank = {k: np.linalg.matrix_rank(m) if m.size else 0 for k, m in change.items()}
    joint = np.linalg.matrix_rank(perturbed - nominal) if nominal.size else 0
    wanted = {
        "elements": sum(int((m != 0).sum()) for m in change.values()),
        "columns": sum(int(m.any(axis=0).sum()) for m in change.values()),
        "rows": sum(int(m.any(axis=1).sum()) for m in change.values()),
        "matrices": sum(rank.values()),
        "single": joint,
    }
    for structure, count in wanted.items():
        model = elementwise(first, second, structure)
        assert model.delta_shape == (count, count), structure
    assert [b.repeats for b in elementwise(first, second, "matrices").blocks] == [r for r in rank.values() if r]


@SETTINGS
@given(seeds, st.tuples(st.integers(2, 8), st.integers(1, 3), st.integers(1, 3)), st.integers(1, 3), st.integers(0, 25))
def test_low_rank_is_found_in_any_units(seed, size, rank, spread):
    nominal, perturbed = pair(seed, size, "dense", spread, rank)
    model = elementwise(as_matrices(nominal, size[0]), as_matrices(perturbed, size[0]), "single")
    assert model.delta_shape[0] == min(rank, *nominal.shape)


@SETTINGS
@given(seeds, st.tuples(st.integers(1, 8), st.integers(1, 3), st.integers(1, 3)), st.integers(1, 2), st.integers(1, 2))
def test_a_strictly_proper_family_stays_strictly_proper(seed, size, rank_b, rank_c):
    rng = np.random.default_rng(seed)
    n, n_u, n_y = size
    change = rng.standard_normal((n + n_y, n + n_u))
    change[:n, n:] = rng.standard_normal((n, rank_b)) @ rng.standard_normal((rank_b, n_u))
    change[n:, :n] = rng.standard_normal((n_y, rank_c)) @ rng.standard_normal((rank_c, n))
    change[n:, n:] = 0.0
    nominal = rng.standard_normal(change.shape)
    nominal[n:, n:] = 0.0
    model = elementwise(as_matrices(nominal, n), as_matrices(nominal + change, n), "single")
    assert model.delta_shape[0] == np.linalg.matrix_rank(change)
    for delta in (-1.0, 0.37, 1.0):
        assert not model.evaluate({"single": delta}).D.any()
    assert endpoint_residual(model, as_matrices(nominal + change, n)) <= 1e-12


@SETTINGS
@given(seeds, sizes)
def test_one_delta_moves_one_entry_and_nothing_else(seed, size):
    n = size[0]
    nominal, perturbed = pair(seed, size, "sparse")
    model = elementwise(as_matrices(nominal, n), as_matrices(perturbed, n))
    for block in model.blocks[:5]:
        moved = model.evaluate({block.name: 1.0})
        changed = [
            (name, i, j)
            for name, matrix in parts(nominal, n).items()
            for i, j in np.argwhere(getattr(moved, name) != matrix)
        ]
        assert len(changed) == 1
        name, i, j = changed[0]
        target = parts(perturbed, n)[name][i, j]
        assert abs(getattr(moved, name)[i, j] - target) <= 1e-12 * max(abs(target), abs(parts(nominal, n)[name][i, j]))
