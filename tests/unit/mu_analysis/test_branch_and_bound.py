"""Branch and bound: bounds that D, G leave apart, brought together; what is proved stands up to attack."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import robustlab as rl
from robustlab.budget import Budget
from robustlab.mu_analysis.axis.axis_model import continuous
from robustlab.mu_analysis.axis.axis_problems import MarginProblem
from robustlab.mu_analysis.matrix.box import Box, block_entries, box_matrices, box_model, centre_matrix, gauge, root_box
from robustlab.mu_analysis.matrix.branch_and_bound import Region, tighten
from robustlab.uncertainty.blocks import delta_matrix


def model_with_a_gap(seed: int = 10, n: int = 6) -> rl.UncertainModel:
    """Random stable model, n states and n real parameters; seed 10 leaves D, G 3.5 % apart."""
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


def test_the_gap_that_scalings_leave_is_closed(margins):
    scalings, cut = margins
    assert scalings.gap > 0.02
    assert cut.gap <= 0.01 * (1 + 1e-9)
    assert scalings.lower <= cut.lower <= cut.upper <= scalings.upper * (1 + 1e-9)
    assert cut.status is rl.Status.CERTIFIED
    assert isinstance(cut.proof[0], Region)
    assert "branch and bound" in cut.notes[0]


def test_no_attack_inside_the_proved_margin(uncertain, margins):
    size = margins[1].lower
    names = [b.name for b in uncertain.blocks]
    rng = np.random.default_rng(0)
    corners = itertools.product([-size, size], repeat=len(names))
    inside = size * rng.uniform(-1, 1, (200, len(names)))
    for delta in itertools.chain(corners, inside):
        assert uncertain.evaluate(dict(zip(names, delta, strict=True))).spectral_abscissa() < 0


def test_the_leaves_fill_the_set_at_every_frequency(uncertain, margins):
    """A Delta of the proved set lies, at any frequency, in a proved leaf, or in a region its ancestors proved there."""
    problem = MarginProblem(continuous(uncertain.delta_channels), uncertain.blocks, None)
    proof = tighten(problem, 1 / margins[1].upper, np.inf, 0.01, Budget())
    assert proof.upper <= 1.02 / margins[1].upper
    rng = np.random.default_rng(1)
    for delta in rng.uniform(-1, 1, (50, 6)) / proof.upper:
        holding = [leaf for leaf in proof.leaves if (np.abs(delta - leaf.box.centre) <= leaf.box.half + 1e-12).all()]
        assert holding
        for omega in np.geomspace(0.01, 100, 25):
            M = rl.frequency_response(uncertain.delta_channels, [omega])[0]
            assert np.linalg.svd(np.eye(6) - M * delta, compute_uv=False)[-1] > 0


def test_what_two_boxes_have_in_common():
    one, other = Box(np.array([0.0, 1.0]), np.array([1.0, 1.0])), Box(np.array([1.5, 1.0]), np.array([1.0, 0.5]))
    common = one.within(other)
    assert common is not None
    np.testing.assert_allclose(common.centre, [0.75, 1.0])
    np.testing.assert_allclose(common.half, [0.25, 0.5])
    assert one.within(Box(np.array([2.0, 1.0]), np.array([1.0, 1.0]))) is None  # they share a face


def test_a_matrix_to_a_tolerance_against_a_dense_search():
    """Two real parameters: det(I - M Delta) = 0 is two real equations, solved on a fine grid of directions."""
    rng = np.random.default_rng(3)
    checked = 0
    for _ in range(12):
        M = rng.standard_normal((2, 2)) + 1j * rng.standard_normal((2, 2))
        bounds = rl.mu(M, [[-1, 0], [-1, 0]], tolerance=1e-3)
        # det = 1 - a d1 - b d2 + c d1 d2 = 0: imaginary part gives d2 in terms of d1, the real part an equation in d1.
        a, b, c = M[0, 0], M[1, 1], np.linalg.det(M)
        roots = np.roots(
            [
                a.real * c.imag - c.real * a.imag,
                b.real * a.imag - a.real * b.imag - c.imag,
                b.imag,
            ]
        )
        sizes = []
        for d1 in roots[np.abs(roots.imag) < 1e-12].real:
            d2 = a.imag * d1 / (c.imag * d1 - b.imag)
            if abs(1 - a * d1 - b * d2 + c * d1 * d2) < 1e-9:
                sizes.append(max(abs(d1), abs(d2)))
        truth = 1 / min(sizes) if sizes else 0.0
        assert bounds.lower <= truth * (1 + 1e-7) + 1e-12
        assert bounds.upper >= truth * (1 - 1e-9)
        if bounds.lower > 0:
            assert bounds.upper <= bounds.lower * 1.0011
            checked += 1
    assert checked >= 4


def test_the_scalings_still_prove_what_they_say():
    rng = np.random.default_rng(5)
    M = rng.standard_normal((4, 4)) + 1j * rng.standard_normal((4, 4))
    bounds = rl.mu(M, [[-1, 0]] * 4, tolerance=0.01)
    assert bounds.upper < bounds.scaled
    assert bounds.boxes > 0
    product = bounds.G @ M
    n = bounds.scaled**2 * bounds.D - M.conj().T @ bounds.D_z @ M - 1j * (product - product.conj().T)
    assert np.linalg.eigvalsh(n)[0] >= -1e-10 * np.abs(n).max()
    assert rl.mu(M, [[-1, 0]] * 4).boxes == 0


def test_no_time_leaves_the_bounds_of_the_scalings(uncertain):
    rng = np.random.default_rng(5)
    M = rng.standard_normal((4, 4)) + 1j * rng.standard_normal((4, 4))
    bounds = rl.mu(M, [[-1, 0]] * 4, tolerance=0.01, time_limit=0.0)
    assert bounds.upper == bounds.scaled


@pytest.mark.parametrize("options", [{"tolerance": 0.0}, {"tolerance": -1.0}, {"tolerance": 0.1, "time_limit": -1.0}])
def test_bad_options_are_named(options):
    with pytest.raises(rl.InputError, match=r"tolerance|time_limit"):
        rl.mu([[1.0]], [[-1, 0]], **options)
    with pytest.raises(rl.InputError, match=r"tolerance|time_limit"):
        rl.robust_stability(model_with_a_gap(), **options)


# --- boxes -----------------------------------------------------------------------------------------------------------


def test_a_box_is_the_same_set_seen_from_its_centre():
    uncertain = model_with_a_gap(3, 4)
    model, blocks = uncertain.delta_channels, uncertain.blocks
    rng = np.random.default_rng(2)
    box = Box(rng.uniform(-0.1, 0.1, 4), rng.uniform(0.05, 0.1, 4))
    inside = box_model(model, blocks, box)
    assert inside is not None
    M = rl.frequency_response(model, [0.7])[0]
    seen = rl.frequency_response(inside, [0.7])[0]
    assert box_matrices(M, blocks, [box])[0] == pytest.approx(seen, abs=1e-12)
    for delta in rng.uniform(-1, 1, (5, 4)):
        whole = centre_matrix(blocks, box.centre + box.half * delta)
        direct = np.linalg.det(np.eye(4) - M @ whole)
        from_box = np.linalg.det(np.eye(4) - seen * delta) * np.linalg.det(
            np.eye(4) - M @ centre_matrix(blocks, box.centre)
        )
        assert direct == pytest.approx(from_box, rel=1e-10)


def test_halves_fill_a_box_and_do_not_overlap():
    low, high = Box(np.array([0.5, 0.0]), np.array([0.5, 2.0])).halves(0)
    assert low.centre.tolist() == [0.25, 0.0]
    assert high.centre.tolist() == [0.75, 0.0]
    assert low.half.tolist() == high.half.tolist() == [0.25, 2.0]


def test_the_gauge_of_an_asymmetric_range():
    blocks = [rl.RealScalar("a", parameter=rl.ParameterRange(1.0, 0.5, below=0.25)), rl.FullBlock("f", 1, 2)]
    assert gauge(blocks, np.array([-0.5, 0.3])) == pytest.approx(1.0)
    assert gauge(blocks, np.array([0.25, 0.3])) == pytest.approx(0.3)
    box = root_box(blocks, 2.0)
    assert box.centre.tolist() == [0.5, 0.0]
    assert box.half.tolist() == [1.5, 2.0]
    entries = block_entries(blocks, delta_matrix(blocks, {"a": -1.0, "f": [[0.6, 0.8]]}))
    assert entries == pytest.approx([-0.5, 1.0])
