"""Modes driven to the axis: slopes by differences, members rebuilt from the physics, and bounds that keep holding."""

import sys
from pathlib import Path

import numpy as np
import pytest

import robustlab as rl
from robustlab.budget import Budget
from robustlab.mu_analysis.axis.axis_problems import MarginProblem
from robustlab.mu_analysis.axis.mode_ascent import mode_next_to, smaller_destabilising
from robustlab.mu_analysis.axis.pole_migration import first_crossing, smallest_destabilising
from robustlab.mu_analysis.matrix.box import block_entries, centre_matrix, gauge
from robustlab.mu_analysis.matrix.branch_and_bound import tighten
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import ParameterRange, RealScalar

sys.path.insert(0, str(Path(__file__).parents[3] / "benchmarks"))
from mu_models import chain


def member(model: StateSpaceModel, values: np.ndarray, repeats: int) -> np.ndarray:
    """A + B Delta (I - D Delta)^-1 C, written out."""
    delta = np.diag(np.repeat(values, repeats))
    return model.A + model.B @ delta @ np.linalg.solve(np.eye(len(delta)) - model.D @ delta, model.C)


def test_slopes_are_those_of_differences():
    rng = np.random.default_rng(3)
    model, blocks = chain(6, 2, 1)
    model = StateSpaceModel(model.A, model.B, model.C, 0.1 * rng.standard_normal((6, 6)))
    values = np.array([0.3, -0.5, 0.2])
    poles = np.linalg.eigvals(member(model, values, 2))
    aim = poles[np.argsort(poles.imag)[-2]]
    mode = mode_next_to(model, blocks, values, aim)
    assert mode is not None
    assert mode.pole == pytest.approx(aim, abs=1e-9)
    for i, step in enumerate(1e-6 * np.eye(3)):
        ends = []
        for sign in (1, -1):
            near = np.linalg.eigvals(member(model, values + sign * step, 2))
            ends.append(near[np.abs(near - aim).argmin()].real)
        assert mode.slopes[i] == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-4, abs=1e-8)


def test_a_loop_that_is_ill_posed_has_no_mode():
    model = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[1.0]])
    assert mode_next_to(model, [RealScalar("d")], np.array([1.0]), -1.0) is None


def test_modes_that_meet_inside_the_set_are_found():
    """Paths from the nominal poles end at 2.078; the proof by D, G, b&b says nothing destabilises below 1.81."""
    model, blocks = chain(12, 2, 0)
    nominal = np.abs(model.poles().imag)
    before = smallest_destabilising(model, blocks, np.unique(nominal[nominal > 0]))
    assert before is not None
    assert before.norm > 2.0
    found = smaller_destabilising(model, blocks, before, Budget(4e6))
    assert 1.81 < found.norm < 1.95
    values = block_entries(blocks, found.delta)
    assert np.abs(values).max() == pytest.approx(found.norm)
    beyond = np.linalg.eigvals(member(model, (1 + 1e-6) * values, 2)).real.max()
    short = np.linalg.eigvals(member(model, (1 - 1e-3) * values, 2)).real.max()
    assert beyond > 0 > short


def test_regions_that_cannot_be_proved_lead_to_smaller_members():
    """Branch and bound alone, told of the paths' 2.349 only: the margin is below 1.97."""
    model, blocks = chain(12, 3, 0)
    nominal = np.abs(model.poles().imag)
    before = smallest_destabilising(model, blocks, np.unique(nominal[nominal > 0]))
    assert before is not None
    assert before.norm > 2.3
    proof = tighten(MarginProblem(model, blocks, None), 1 / before.norm, np.inf, 0.05, Budget(30e6))
    assert proof.values is not None
    assert np.abs(proof.values).max() == pytest.approx(1 / proof.lower)
    assert 1 / proof.lower < 2.0
    assert np.linalg.eigvals(member(model, (1 + 1e-6) * proof.values, 3)).real.max() > 0
    assert proof.upper <= proof.lower * 1.0501


def test_where_the_work_will_not_do_a_smaller_set_is_proved():
    """Cut back to a larger level: its leaves fill the smaller set, none lies outside, and no attack inside succeeds."""
    model, blocks = chain(12, 2, 0)
    proof = tighten(MarginProblem(model, blocks, None), 1 / 2.0783, 1 / 1.37, 0.05, Budget(1.2e6))
    assert proof.lower * 1.05 < proof.upper < 1 / 1.37
    for leaf in proof.leaves:
        assert (np.abs(leaf.box.centre) + leaf.box.half <= (1 + 1e-12) / proof.upper).all()
    rng = np.random.default_rng(2)
    for turn in range(200):
        share = rng.uniform(-1, 1, 6)
        values = (np.sign(share) if turn % 2 else share) / proof.upper
        assert any((np.abs(values - leaf.box.centre) <= leaf.box.half + 1e-12).all() for leaf in proof.leaves)
        assert np.linalg.eigvals(member(model, values, 2)).real.max() < 0


def test_ranges_that_are_wider_on_one_side_are_measured_by_their_share():
    model, _ = chain(8, 2, 0)
    blocks = [RealScalar(f"k{i}", 2, parameter=ParameterRange(1.0, 0.3, "N/m", below=0.15)) for i in range(4)]
    corner = centre_matrix(blocks, 20.0 * np.array([0.5, -0.5, 0.5, -0.5])).astype(complex)
    before = first_crossing(model, blocks, corner)
    assert before is not None
    found, again = (smaller_destabilising(model, blocks, before, Budget(3e5)) for _ in range(2))
    np.testing.assert_array_equal(again.delta, found.delta)
    sizes = [gauge(blocks, block_entries(blocks, one.delta)) for one in (before, found)]
    assert sizes[1] <= sizes[0]
    assert np.linalg.eigvals(member(model, (1 + 1e-6) * block_entries(blocks, found.delta), 2)).real.max() > -1e-12


def test_the_margin_of_a_chain_closes_and_attacks_inside_fail():
    model, blocks = chain(12, 3, 0)
    margin = rl.robust_stability(rl.UncertainModel(model, blocks), tolerance=0.05)
    assert margin.gap <= 0.0501
    assert margin.upper < 2.0
    rng = np.random.default_rng(1)
    for _ in range(300):
        values = 0.999 * margin.lower * rng.uniform(-1, 1, 4)
        values = np.sign(values) * 0.999 * margin.lower if rng.random() < 0.5 else values
        assert np.linalg.eigvals(member(model, values, 3)).real.max() < 0


def test_no_work_left_changes_nothing():
    model, blocks = chain(6, 2, 0)
    before = first_crossing(model, blocks, centre_matrix(blocks, np.array([30.0, -30.0, 30.0])).astype(complex))
    assert before is not None
    assert smaller_destabilising(model, blocks, before, Budget(0.0)).norm <= before.norm
