"""Ascent of modes to the axis: slopes by differences, members rebuilt from physics, valid bounds."""

import sys
from pathlib import Path

import numpy as np
import pytest

import robustlab as rl
from robustlab.statespace import StateSpaceModel

sys.path.insert(0, str(Path(__file__).parents[3] / "benchmarks"))
from mu_models import chain


def member(model: StateSpaceModel, values: np.ndarray, repeats: int) -> np.ndarray:
    """A + B Delta (I - D Delta)^-1 C, written out."""
    delta = np.diag(np.repeat(values, repeats))
    return model.A + model.B @ delta @ np.linalg.solve(np.eye(len(delta)) - model.D @ delta, model.C)


@pytest.mark.slow
def test_the_margin_of_a_chain_closes_and_holds_for_members_inside():
    model, blocks = chain(12, 3, 0)
    margin = rl.robust_stability(rl.UncertainModel(model, blocks), tolerance=0.05)
    assert margin.gap <= 0.0501
    assert margin.upper < 2.0
    rng = np.random.default_rng(1)
    for _ in range(300):
        values = 0.999 * margin.lower * rng.uniform(-1, 1, 4)
        values = np.sign(values) * 0.999 * margin.lower if rng.random() < 0.5 else values
        assert np.linalg.eigvals(member(model, values, 3)).real.max() < 0
