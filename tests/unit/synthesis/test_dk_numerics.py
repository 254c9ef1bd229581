"""D-K iteration where X spans many decades, where its first controller is poor, and where the time is short."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import robustlab as rl
from robustlab import budget
from robustlab.budget import MILLION, Budget, dense
from robustlab.mu_analysis.axis import intervals
from robustlab.mu_analysis.matrix.upper import points_work
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.dk.dk_iteration import _Search, structure_with_performance
from robustlab.synthesis.dk.dynamic_scalings import BlockScaling, Factor, plant_at_level, unit_scalings
from robustlab.synthesis.dk.riccati_level import LevelSearch
from robustlab.synthesis.dk.robust_problem import RobustProblem, nominal_start
from robustlab.synthesis.dk.scalings_fit import CHUNK, as_complex, mu_curve
from robustlab.synthesis.problem.partition import GeneralizedPlant, PlantMatrices
from robustlab.synthesis.problem.scaling import Scaling
from robustlab.synthesis.specifications.tracking_problem import tracking_problem
from robustlab.synthesis.specifications.weight_design import control_weight, error_weight
from robustlab.uncertainty.blocks import Block, ComplexScalar, FullBlock


def three_modes() -> PlantMatrices:
    """x' = x + w1 + u, z = [x; u], y = x + w2, beside a mode with a huge X and one with a huge Y (gains of 0.1)."""
    A, B2, C2 = np.diag([1.0, -0.5, -0.5]), np.array([[1.0], [0], [0]]), np.array([[1.0, 0, 0]])
    B1, C1 = np.zeros((3, 4)), np.zeros((4, 3))
    B1[0, 0], B1[1, 1], B1[2, 2] = 1.0, 5e-7, 1e5
    C1[0, 0], C1[1, 1], C1[2, 2] = 1.0, 1e5, 5e-7
    D12, D21 = np.zeros((4, 1)), np.zeros((1, 4))
    D12[3], D21[0, 3] = 1.0, 1.0
    return PlantMatrices(A, B1, B2, C1, C2, np.zeros((4, 4)), D12, D21)


def actuator() -> tuple[GeneralizedPlant, tuple[Block, ...]]:
    """The thesis' linear actuator with six uncertain parameters; nothing disturbs it but references and noise."""
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


@pytest.mark.parametrize("start", [0.9, 50.0])
def test_a_negative_x_is_seen_beside_one_that_is_larger_by_ten_decades(start: float) -> None:
    # X = Y of the first mode solves 2 X + 1 = (1 - 1 / gamma^2) X^2 and X = gamma at the optimum: gamma = 1 + sqrt(3).
    # Between 1 / sqrt(2) and 1 both stabilising solutions exist, with X = Y < 0 there and 1e10 elsewhere.
    scalings = unit_scalings([FullBlock("all", 4, 4)])
    same = Scaling(1.0, np.ones(3), np.ones(1), np.ones(1))
    search = LevelSearch(lambda _, beta: plant_at_level(three_modes(), scalings, beta), same)
    level = search.smallest(scalings.parameters(), start)
    assert level is not None
    assert level.smooth
    assert level.beta == pytest.approx(1 + np.sqrt(3), rel=1e-6)
    assert search.controller(scalings.parameters(), 0.9) is None


def test_a_level_found_over_ten_decades_of_poles_is_proved() -> None:
    # Scalings as D-K iteration fits them for the linear actuator: poles from 1e-6 to 5e4 rad/s, X from 3e-9 to 1e10.
    # In arithmetic of 500 bits rho(X Y) = 1 at a level of 4.9931. Without Newton's steps on X one numerical scaling
    # found 1817, the other one 34, and the best that any controller up to there proved was 7.7.
    sections = {
        "R": (1.2, ((3.0, 2.7, 3.7, 4.6), (0.4, 3.7, -0.7, 3.6))),
        "L": (8.3, ((4.3, -5.0),)),
        "Km": (8.0, ()),
        "Kb": (0.0, ((7.2, 10.8),)),
        "Kf": (8.1, ((-3.4, -5.6),)),
        "J": (22.6, ((-0.1, 2.9, -8.3, 4.6), (-6.7, -9.4))),
    }
    plant, blocks = actuator()
    scalings = unit_scalings(as_complex(blocks))
    for i, block in enumerate(blocks):
        if block.name in sections:
            scalings = scalings.with_part(i, BlockScaling((Factor(*sections[block.name]),)))
    problem = RobustProblem(plant)
    level = problem.search(scalings).smallest(scalings.parameters(), 1.5, 1e-5)
    found = problem.solve(scalings, 1.5)
    assert level is not None
    assert found is not None
    assert level.beta == pytest.approx(4.9931, rel=1e-4)
    assert found.level <= 1.001 * level.beta


def test_the_nominal_start_replaces_a_poor_one_and_loses_nothing() -> None:
    # Without a disturbance the H-infinity start has a mu of 2.7; a small disturbance on the control asks for feedback.
    plant, blocks = actuator()
    search = _Search(plant, blocks, Budget(120 * MILLION), 30, True, None)
    search.start(None)
    first, second = search.iterates
    assert [step.stage for step in search.history] == ["start", "nominal start"]
    peaks = [mu_curve(i.loop, search.blocks, Budget()).peak for i in (first, second)]
    assert peaks[1] < 0.4 * peaks[0]
    assert search.best is min(search.iterates, key=lambda i: i.level)


def test_no_nominal_start_where_control_has_nothing_to_do_or_the_plant_cannot_be_stabilised() -> None:
    D = np.array([[0.0, 0, 1], [0, 0.5, 1], [1, 0, 0]])
    idle = GeneralizedPlant(StateSpaceModel([[-1.0]], [[1.0, 0, 1]], [[1.0], [0], [1]], D), 1, 1)  # y knows no w
    assert nominal_start(idle, 1, 1, Budget(10 * MILLION)) is None
    lost = GeneralizedPlant(StateSpaceModel([[1.0]], [[1.0, 1, 0]], [[1.0], [1], [1]], D), 1, 1)
    assert nominal_start(lost, 1, 1, Budget(10 * MILLION)) is None


class Clock:
    """A clock that stands still between the calls that are said to take time."""

    def __init__(self) -> None:
        self.now = 0.0

    def monotonic(self) -> float:
        return self.now


def test_the_proof_by_intervals_asks_the_clock_before_each_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, extend = Clock(), intervals.extend

    def slow(*arguments: Any) -> Any:
        clock.now += 2.0
        return extend(*arguments)

    monkeypatch.setattr(budget, "time", clock)
    monkeypatch.setattr(intervals, "extend", slow)
    modes = np.kron(np.diag([1.0, 10.0, 100.0]), [[0.0, 1.0], [-1.0, -0.01]])
    model = StateSpaceModel(modes, np.ones((6, 2)), np.ones((2, 6)), np.zeros((2, 2)))
    blocks = [ComplexScalar("a"), ComplexScalar("b")]
    places = np.geomspace(0.01, 1e3, 30)
    limit = budget.Budget(time_limit=9.0)
    cover = intervals.cover_axis(model, blocks, 0.0, first=places, budget=limit, accuracy=1e-6)
    assert cover.open
    assert limit.struck
    assert clock.now == 10.0  # the fifth interval ends it


def test_the_curve_of_mu_asks_the_budget_between_chunks() -> None:
    model = StateSpaceModel([[-0.01, 1.0], [-1.0, -0.01]], np.eye(2), np.eye(2), np.zeros((2, 2)))
    blocks = [ComplexScalar("a"), ComplexScalar("b")]
    whole = mu_curve(model, blocks, Budget())
    chunk = points_work(blocks, CHUNK) + dense(2)
    for looks in (0, 1, 3, 6, 7):
        part = mu_curve(model, blocks, Budget((looks + 0.5) * chunk))
        assert len(part.omega) <= min(CHUNK * (looks + 1), len(whole.omega))
        assert (np.diff(part.omega) > 0).all()
        assert len(part.bounds) == len(part.response) == len(part.omega)
