"""D-K iteration where X spans many decades."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import robustlab as rl
from robustlab import control_weight
from robustlab.budget import Budget
from robustlab.synthesis import (
    BlockScaling,
    Factor,
    GeneralizedPlant,
    RobustProblem,
    error_weight,
    structure_with_performance,
    tracking_problem,
    unit_scalings,
)
from robustlab.uncertainty import Block


def actuator() -> tuple[GeneralizedPlant, tuple[Block, ...]]:
    """The thesis' linear actuator with six uncertain parameters, references and noise, without disturbances."""
    tolerances = {"R": 0.10, "L": 0.10, "Km": 0.05, "Kb": 0.05, "Kf": 0.35, "J": 0.10}
    actuator = rl.plant("linear-actuator")
    exact = {name: (p.value, 0.0) for name, p in actuator.parameters.items()}
    ranges = {name: (actuator.values[name], tolerance) for name, tolerance in tolerances.items()}
    task = tracking_problem(
        actuator.with_parameters(**exact | ranges).uncertain(None),
        ["phi"],
        ["phi", "omega", "i"],
        W1=error_weight(0.04, 1.0, 1e-3),
        W2=control_weight(42.0, 1000.0, 10.0),
        reference=73.603,
        reference_bandwidth=np.pi,
        noise={"phi_ref": 0.01, "phi": 0.01, "omega": 1.0, "i": 0.02},
    )
    return structure_with_performance(task.plant, None, None, None)


def test_a_level_found_over_ten_decades_of_poles_is_proved() -> None:
    # Scalings of D-K iteration for the linear actuator: poles from 1e-6 to 5e4 rad/s, X from 3e-9 to 1e10.
    # In arithmetic of 500 bits rho(X Y) = 1 at a level of 4.9931. Without Newton's steps on X the two numerical
    # scalings found 1817 and 34, and the best proved level of a controller up to there was 7.7.
    sections = {
        "R": (1.2, ((3.0, 2.7, 3.7, 4.6), (0.4, 3.7, -0.7, 3.6))),
        "L": (8.3, ((4.3, -5.0),)),
        "Km": (8.0, ()),
        "Kb": (0.0, ((7.2, 10.8),)),
        "Kf": (8.1, ((-3.4, -5.6),)),
        "J": (22.6, ((-0.1, 2.9, -8.3, 4.6), (-6.7, -9.4))),
    }
    plant, blocks = actuator()
    unit = unit_scalings([block.as_complex() for block in blocks])
    parts = (
        BlockScaling((Factor(*sections[block.name]),)) if block.name in sections else part
        for block, part in zip(blocks, unit.parts, strict=True)
    )
    scalings = replace(unit, parts=tuple(parts))
    problem = RobustProblem(plant, Budget())
    level = problem.search(scalings).smallest(scalings.parameters(), 1.5, 1e-5)
    found = problem.solve(scalings, 1.5)
    assert level is not None
    assert found is not None
    assert level.beta == pytest.approx(4.9931, rel=1e-4)
    assert found.level <= 1.001 * level.beta
