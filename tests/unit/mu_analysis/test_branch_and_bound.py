"""Branch and bound: closes the gap of the D, G bounds; proofs hold for sampled members."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import robustlab as rl


def model_with_a_gap(seed: int = 10, n: int = 6) -> rl.UncertainModel:
    """Random stable model, n states and n real parameters; for seed 10 the gap of D, G is 3.5 %."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n)) / np.sqrt(n)
    A -= (np.linalg.eigvals(A).real.max() + 0.1 + 0.3 * rng.random()) * np.eye(n)
    B, C = rng.standard_normal((2, n, n)) / np.sqrt(n)
    D = 0.1 * rng.standard_normal((n, n))
    return rl.UncertainModel(rl.StateSpaceModel(A, B, C, D), [rl.RealScalar(f"d{i}") for i in range(n)])


@pytest.fixture(scope="module")
def uncertain() -> rl.UncertainModel:
    return model_with_a_gap()


@pytest.fixture(scope="module")
def margins(uncertain):
    return rl.robust_stability(uncertain, tolerance=np.inf), rl.robust_stability(uncertain, tolerance=0.01)


def test_branch_and_bound_closes_the_gap_of_the_scalings(margins):
    scalings, cut = margins
    assert scalings.gap > 0.02
    assert cut.gap <= 0.01 * (1 + 1e-9)
    assert scalings.lower <= cut.lower <= cut.upper <= scalings.upper * (1 + 1e-9)
    assert cut.status is rl.Status.CERTIFIED
    assert "branch and bound" in cut.notes[0]


def test_no_delta_inside_the_proved_margin_destabilises(uncertain, margins):
    size = margins[1].lower
    names = [b.name for b in uncertain.blocks]
    rng = np.random.default_rng(0)
    corners = itertools.product([-size, size], repeat=len(names))
    inside = size * rng.uniform(-1, 1, (200, len(names)))
    for delta in itertools.chain(corners, inside):
        assert uncertain.evaluate(dict(zip(names, delta, strict=True))).spectral_abscissa() < 0


def test_the_leaves_cover_the_set_at_every_frequency(uncertain, margins):
    """At each frequency a Delta of the proved set is in a leaf, or in a region proved for an ancestor."""
    rng = np.random.default_rng(1)
    for delta in rng.uniform(-1, 1, (50, 6)) * margins[1].lower:
        holding = [
            leaf for leaf in margins[1].proof if (np.abs(delta - leaf.box.centre) <= leaf.box.half + 1e-12).all()
        ]
        assert holding
        for omega in np.geomspace(0.01, 100, 25):
            M = rl.frequency_response(uncertain.delta_channels, [omega])[0]
            assert np.linalg.svd(np.eye(6) - M * delta, compute_uv=False)[-1] > 0
