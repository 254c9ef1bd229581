"""Proofs in ball arithmetic: they confirm what holds, refuse what does not, and say what is missing."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import robustlab as rl
from robustlab.mu_analysis.matrix.certificate import certified_in_balls, has_structure
from robustlab.uncertainty.blocks import as_blocks, structure_size

STRUCTURES = [
    [[-1, 0]] * 4,
    [[1, 0]] * 3,
    [[-2, 0], [-1, 0]],
    [[3, 0], [1, 0]],
    [[2, 3], [3, 1]],
    [[-2, 0], [2, 0], [1, 2], [-1, 0]],
]


def random_matrix(seed, rows):
    q, p = structure_size(as_blocks(rows))
    rng = np.random.default_rng(seed)
    return rng.standard_normal((p, q)) + 1j * rng.standard_normal((p, q))


@pytest.mark.parametrize("rows", STRUCTURES)
@pytest.mark.parametrize("size", [1e-200, 1.0, 1e12])
def test_every_returned_bound_is_confirmed(rows, size):
    M = size * np.stack([random_matrix(seed, rows) for seed in range(3)])
    bounds = rl.mu(M, rows, certify=True)
    assert (bounds.upper == rl.mu(M, rows).upper).all()


@pytest.mark.parametrize("rows", STRUCTURES)
def test_a_bound_that_is_too_small_is_not_confirmed(rows):
    M = random_matrix(7, rows)
    b = rl.mu(M, rows)
    assert certified_in_balls(M, b.D, b.G, b.upper, b.D_z)
    assert not certified_in_balls(M, b.D, b.G, b.upper * (1 - 1e-6), b.D_z)
    assert not certified_in_balls(M, -b.D, b.G, b.upper, -b.D_z)


def test_decides_where_doubles_cannot():
    # The largest singular value is 1 + eps / 2 to first order, between two neighbouring doubles.
    eps = 2.0**-52
    M = np.array([[1.0, eps], [0.0, 1.0]])
    assert not certified_in_balls(M, np.eye(2), np.zeros((2, 2)), 1.0)
    assert certified_in_balls(M, np.eye(2), np.zeros((2, 2)), 1.0 + eps)
    # beta = 1 exactly makes N zero, which is no strict proof.
    assert not certified_in_balls(np.eye(2), np.eye(2), np.zeros((2, 2)), 1.0)
    assert certified_in_balls(np.eye(2), np.eye(2), np.zeros((2, 2)), 1.0 + eps)


def test_zero_of_a_nilpotent_structure_and_empty_matrix():
    assert rl.mu([[0, 1], [0, 0]], [[1, 0]] * 2, certify=True).upper == 0.0
    assert rl.mu(np.zeros((2, 2)), [[1, 0]] * 2, certify=True).upper == 0.0
    assert rl.mu([[1j]], [[-1, 0]], certify=True).upper == 0.0
    assert rl.mu(np.zeros((0, 0)), [], certify=True).upper == 0.0


def test_structure_is_checked_to_the_last_bit():
    rows = [[-2, 0], [2, 1], [1, 0]]
    blocks = as_blocks(rows)
    b = rl.mu(random_matrix(3, rows), rows)
    assert has_structure(blocks, b.D, b.D_z, b.G)
    for name, row, col in (
        ("D", 0, 1),
        ("D", 2, 2),
        ("D", 0, 3),
        ("D_z", 2, 2),
        ("D_z", 3, 3),
        ("G", 0, 1),
        ("G", 4, 3),
    ):
        changed = {key: getattr(b, key).copy() for key in ("D", "D_z", "G")}
        changed[name][row, col] += 1e-12
        assert not has_structure(blocks, changed["D"], changed["D_z"], changed["G"]), (name, row, col)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"D": [[1, 1e-15], [0, 1]]}, "D: not Hermitian"),
        ({"D": np.eye(3)}, r"D: shape \(3, 3\)"),
        ({"G": np.zeros((1, 2))}, r"G: shape \(1, 2\)"),
        ({"M": [[np.nan, 0], [0, 1]]}, "M: NaN or infinity"),
        ({"beta": np.inf}, "beta: NaN or infinity"),
        ({"M": [1, 2]}, r"M: shape \(2,\)"),
    ],
)
def test_bad_input_is_named(change, words):
    good = {"M": np.eye(2), "D": np.eye(2), "G": np.zeros((2, 2)), "beta": 2.0}
    assert certified_in_balls(**good)
    with pytest.raises(rl.InputError, match=words):
        certified_in_balls(**(good | change))


def test_missing_flint_is_named(monkeypatch):
    from robustlab.errors import DependencyMissing

    monkeypatch.setitem(sys.modules, "flint", None)
    with pytest.raises(DependencyMissing, match=r"mu --certify needs python-flint: pip install python-flint"):
        rl.mu(np.eye(2), [[1, 0]] * 2, certify=True)
    assert DependencyMissing.exit_code == 5
