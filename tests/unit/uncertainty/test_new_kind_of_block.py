"""A new kind of block is one class, without changes elsewhere in the library."""

from dataclasses import dataclass

import numpy as np
import pytest

import robustlab as rl
from robustlab.errors import InputError
from robustlab.uncertainty import Block


@dataclass(frozen=True)
class RealMatrix(Block):
    """A full real matrix with ``sigma_max <= 1``: constant parameters with one joint bound."""

    name: str
    rows: int
    cols: int

    is_real = True
    is_scalar = False

    def project(self, part):
        return part.real


BLOCKS = [RealMatrix("stiffness", 2, 2)]
MIXED = [rl.RealScalar("mass"), RealMatrix("stiffness", 2, 3), rl.ComplexScalar("motor")]


def is_member(block, value, size=1.0):
    fits = np.isrealobj(value) and value.shape == (block.rows, block.cols)
    return fits and np.linalg.norm(value, 2) <= size * (1 + 1e-12)


def random_member(block, rng):
    """Independent of the library: half of them on the boundary."""
    matrix = rng.standard_normal((block.rows, block.cols))
    return matrix / np.linalg.norm(matrix, 2) * (rng.random() if rng.random() < 0.5 else 1.0)


def matrix_for(blocks, seed, real=False):
    rng = np.random.default_rng(seed)
    q, p = sum(b.rows for b in blocks), sum(b.cols for b in blocks)
    return rng.standard_normal((p, q)) + (0 if real else 0.4j) * rng.standard_normal((p, q))


def model_for(blocks, seed=3, n=4):
    rng = np.random.default_rng(seed)
    q, p = sum(b.rows for b in blocks), sum(b.cols for b in blocks)
    A = rng.standard_normal((n, n))
    A -= (np.linalg.eigvals(A).real.max() + 1.0) * np.eye(n)
    B, C = 0.5 * rng.standard_normal((n, q + 1)), 0.5 * rng.standard_normal((p + 1, n))
    return rl.UncertainModel(rl.StateSpaceModel(A, B, C, np.zeros((p + 1, q + 1))), blocks)


def test_evaluate_and_samples():
    uncertain = model_for(BLOCKS)
    value = np.array([[0.3, -0.2], [0.1, 0.5]])
    B, C = uncertain.M.B, uncertain.M.C
    expected = uncertain.M.A + B[:, :2] @ value @ C[:2]
    assert np.allclose(uncertain.evaluate({"stiffness": value}).A, expected, atol=1e-12)
    drawn = [delta["stiffness"] for delta in rl.sample(uncertain, 50, seed=1, vertices=4).deltas]
    assert all(is_member(BLOCKS[0], value) for value in drawn)
    assert all(np.linalg.norm(value, 2) > 1 - 1e-12 for value in drawn[50:])
    with pytest.raises(InputError, match="complex"):
        uncertain.evaluate({"stiffness": 1j * value})
    with pytest.raises(InputError, match="shape"):
        uncertain.evaluate({"stiffness": value[:1]})
    assert uncertain.to_json()["blocks"][0]["kind"] == "RealMatrix"


def places(blocks):
    row = col = 0
    for block in blocks:
        yield block, slice(row, row + block.rows), slice(col, col + block.cols)
        row, col = row + block.rows, col + block.cols


def random_delta(blocks, rng):
    delta = np.zeros((sum(b.rows for b in blocks), sum(b.cols for b in blocks)), dtype=complex)
    for block, w, z in places(blocks):
        if isinstance(block, RealMatrix):
            delta[w, z] = random_member(block, rng)
        else:
            delta[w, z] = rng.uniform(-1, 1) if block.name == "mass" else np.exp(2j * np.pi * rng.random())
    return delta


@pytest.mark.parametrize("blocks", [BLOCKS, MIXED], ids=["alone", "mixed"])
@pytest.mark.parametrize("real", [True, False], ids=["real M", "complex M"])
@pytest.mark.parametrize("seed", range(3))
def test_mu(blocks, real, seed):
    M = matrix_for(blocks, seed, real)
    bounds = rl.mu(M, blocks)
    assert 0 < bounds.lower <= bounds.upper * (1 + 1e-9)
    inside = np.zeros(bounds.delta.shape, dtype=bool)
    for block, w, z in places(blocks):
        inside[w, z] = True
        assert block.name == "motor" or not bounds.delta[w, z].imag.any()
        assert np.linalg.norm(bounds.delta[w, z], 2) <= 1 / bounds.lower * (1 + 1e-9)
    assert not bounds.delta[~inside].any()
    loop = np.eye(len(M)) - M @ bounds.delta
    assert np.linalg.svd(loop, compute_uv=False)[-1] <= 1e-9 * np.linalg.norm(loop, 2)
    rng = np.random.default_rng(seed)
    for _ in range(400):  # where M Delta has the real eigenvalue v, Delta / v makes the loop singular
        values = np.linalg.eigvals(M @ random_delta(blocks, rng))
        attained = values[np.abs(values.imag) <= 1e-9 * np.abs(values)].real
        assert np.abs(attained).max(initial=0.0) <= bounds.upper * (1 + 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("blocks", [BLOCKS, MIXED], ids=["alone", "mixed"])
def test_robust_stability(blocks):
    uncertain = model_for(blocks)
    margin = rl.robust_stability(uncertain)
    assert 0 < margin.lower <= margin.upper * (1 + 1e-9)
    for delta in rl.sample(uncertain, 60, seed=5, vertices=20).deltas:
        smaller = {name: 0.999 * margin.lower * value for name, value in delta.items()}
        real = {name: value for name, value in smaller.items() if name != "motor"}  # a complex member is no real model
        assert uncertain.evaluate(real).is_stable()
    stiffness = next(b for b in blocks if b.name == "stiffness")
    assert is_member(stiffness, margin.delta["stiffness"], margin.upper)
    if blocks is BLOCKS:
        poles = uncertain.evaluate(margin.delta).poles()
        assert poles.real.max() >= -1e-6 * np.abs(poles).max()


def test_algebra():
    uncertain = model_for(BLOCKS)
    assert uncertain.reduce().blocks == tuple(BLOCKS) == uncertain.centred().blocks
    with pytest.raises(InputError, match="several operands"):
        uncertain + uncertain
