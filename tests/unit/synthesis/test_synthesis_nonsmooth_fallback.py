"""The last fallback of H-infinity synthesis: nonsmooth search where Riccati equations and LMIs give little."""

from __future__ import annotations

import numpy as np
import pytest

from robustlab.budget import MILLION, Budget
from robustlab.norms import hinf_norm
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.synthesis.hinf import hinf_synthesis
from robustlab.synthesis.hinf.hinf_synthesis import descend_from, hinf, is_poor, stabilise
from robustlab.synthesis.hinf.mixed_sensitivity import mixsyn
from robustlab.synthesis.hinf.search import Portfolio, Search
from robustlab.synthesis.problem.partition import GeneralizedPlant, Realisation
from robustlab.synthesis.problem.scaling import paths_first

# x' = -x + w1 + u, z = (x, u), y = x + w2: the optimum is sqrt(3) - 1.
PLANT = StateSpaceModel([[-1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
UNSTABLE = StateSpaceModel([[1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])


@pytest.fixture
def without_equations(monkeypatch):
    def nothing(matrices, scalings, deadline, floor=0.0, D22=None):
        return Portfolio(*(Search(matrices, s, deadline, floor, D22) for s in scalings), float("nan"))

    monkeypatch.setattr(hinf_synthesis, "STABILISING_STARTS", 0, raising=False)

    monkeypatch.setattr(hinf_synthesis, "portfolio", nothing)
    monkeypatch.setattr(hinf_synthesis, "lmi_controllers", lambda *_: ([], "no LMI"))
    monkeypatch.setattr(Search, "polish", lambda *_: None)


def search_of(model: StateSpaceModel) -> tuple[GeneralizedPlant, Search]:
    plant = GeneralizedPlant(model, 1, 1)
    matrices = plant.matrices()
    return plant, Search(matrices, paths_first(matrices), Budget(20 * MILLION))


@pytest.mark.parametrize(("model", "direct"), [(PLANT, 0.0), (UNSTABLE, 0.5)])
def test_it_reaches_the_optimum_alone(without_equations, model, direct):
    D = model.D.copy()
    D[2, 2] = direct
    plant = StateSpaceModel(model.A, model.B, model.C, D)
    a = model.A[0, 0]
    # Both Riccati equations are X^2 (1 - 1/gamma^2) - 2 a X - 1 = 0, and X Y < gamma^2 binds: X = gamma.
    gammas = np.roots([1.0, -2 * a, -2.0])
    best = float(gammas[gammas > 0].max())
    design = hinf(plant, 1, 1, gamma_rel=1.0)
    assert "no LMI; a nonsmooth search over controllers with" in design.reason
    assert best * (1 - 1e-6) <= design.gamma <= 1.002 * best
    assert hinf_norm(lower_lft(plant, design.K)).value <= design.gamma * (1 + 1e-9)


def test_a_poor_controller_is_descended_from_and_a_good_one_is_left():
    plant, search = search_of(PLANT)
    detuned = Realisation(np.array([[-3.0]]), np.array([[1.0]]), np.array([[1.0]]), np.array([[-1.0]]))
    start = search.adopt(detuned)
    assert start is not None
    better = descend_from(plant.matrices(), search, start, Budget(20 * MILLION))
    assert better is not None
    assert better in search.candidates
    assert np.sqrt(3) - 1 - 1e-6 <= better.gamma <= 1.01 * (np.sqrt(3) - 1) < start.gamma
    assert descend_from(plant.matrices(), search, better, Budget(0.0)) is None


def test_without_time_nothing_is_stabilised_and_it_says_so():
    plant, search = search_of(UNSTABLE)
    assert "no work" in stabilise(plant.matrices(), search, Budget(0.0), lambda _: None)
    assert not search.candidates


def test_what_counts_as_poor():
    nan = float("nan")
    assert is_poor(1.1, 1.0, 0.5, 0.0)
    assert not is_poor(1.01, 1.0, 0.5, 1.0)
    assert not is_poor(1.01, nan, 1.0, nan)
    assert is_poor(1.1, nan, 1.0, nan)
    assert is_poor(1.1, nan, 0.0, 0.1)
    assert not is_poor(1.1, nan, 0.0, 1e-4)
    assert is_poor(1e-3, 1e-5, 0.0, 0.0)
    assert not is_poor(1e-3, 1e-5, 0.0, 0.0, scale=0.01)


def test_progress_says_one_line_for_each_stage(without_equations):
    lines: list[str] = []
    design = hinf(PLANT, 1, 1, progress=lines.append)
    assert lines[:2] == ["two Riccati equations: none verified yet", "no LMI: none verified yet"]
    assert lines[-1].startswith(f"softened: gamma {design.gamma:.6g}")
    assert all("\n" not in line for line in lines)


def test_progress_of_mixed_sensitivity():
    lines: list[str] = []
    design = mixsyn(StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), 0.5, 0.1, progress=lines.append, gamma_rel=1)
    assert lines == [f"two Riccati equations: gamma {design.gamma:.6g}"]
