"""The last fallback of H-infinity synthesis: nonsmooth search where Riccati equations and LMIs give little."""

from __future__ import annotations

import numpy as np
import pytest

from robustlab.norms import hinf_norm
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.synthesis.hinf import hinf_synthesis
from robustlab.synthesis.hinf.hinf_synthesis import hinf
from robustlab.synthesis.hinf.search import Portfolio, Search

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
