"""docs/fixed_structure.md: the code runs, and what is printed beside it is right."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov

import robustlab as rl
from robustlab.synthesis.fixed import goal_tuning
from robustlab.synthesis.laws import controller_structures
from robustlab.synthesis.nonsmooth import design_limits

PAGE = Path(__file__).parents[3] / "docs" / "fixed_structure.md"


def test_the_page_runs_and_its_numbers_are_right(capsys):
    names = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL):
        exec(block, names)
    printed = capsys.readouterr().out
    design, smooth = names["design"], names["smooth"]
    # From the force w to (q, 0.1 u): q = w / (s^2 + C), u = -C q, with C = Kp + Kd s / (tau s + 1).
    s = 1j * np.geomspace(1e-3, 1e3, 4001)
    kp, kd, tau = (design.values[name] for name in ("Kp[1]", "Kd[1]", "tau"))
    C = kp + kd * s / (tau * s + 1)
    peak = np.sqrt((1 + 0.01 * np.abs(C) ** 2) / np.abs(s**2 + C) ** 2).max()
    assert peak == pytest.approx(design.gamma, rel=1e-3)
    poles = np.roots([tau, 1, tau * kp + kd, kp])
    assert (-poles.real / np.abs(poles)).min() >= 0.6
    assert design.status is rl.Status.CERTIFIED
    # H2 norm by scipy.
    loop = smooth.closed_loop
    X = solve_continuous_lyapunov(loop.A, -loop.B @ loop.B.T)
    assert np.sqrt(np.trace(loop.C @ X @ loop.C.T)) == pytest.approx(smooth.gamma, rel=1e-4)
    assert not smooth.K.D.any()
    assert printed.splitlines()[1] == "('tau at its bound',)"
    # The infimum is that of state feedback: B1' X B1 with X of the LQR problem of q and 0.1 u.
    infimum = (2 * 0.1**3) ** 0.25
    assert infimum <= smooth.gamma <= 1.001 * infimum
    assert infimum <= float(printed.splitlines()[2].split()[-1]) <= 1.001 * infimum
    said = (
        f"{design.gamma:.4f}",
        f"Kp = {kp:.1f}",
        f"Kd = {kd:.1f}",
        f"tau = {tau:.2f}",
        f"of {infimum:.4f}",
    )
    tuned = names["tuned"]
    assert tuned.status is rl.Status.CERTIFIED
    servo, K = names["servos"][0], tuned.K
    grid = np.geomspace(1e-3, 1e3, 4001)
    S = 1 / (1 + (rl.frequency_response(servo, grid) * rl.frequency_response(K, grid))[:, 0, 0])
    assert 1.2 * np.abs(S - 0.5).max() == pytest.approx(tuned.goals[1].values[0], rel=1e-3)
    page = PAGE.read_text(encoding="utf-8")
    assert [text for text in said if text not in page] == []
    # A local search ends on another processor at another point of the same flat optimum.
    goals = re.search(r"# \[([\d., ]+)\]: tracking", page)
    assert goals is not None
    shown = [float(text) for text in goals[1].split(",")]
    np.testing.assert_allclose([goal.value for goal in tuned.goals], shown, rtol=1e-2)


def test_the_page_names_what_there_is():
    # Names of structures and limits begin with a capital.
    known = {
        **vars(controller_structures),
        **vars(design_limits),
        **vars(goal_tuning),
        "UncertainModel": rl.UncertainModel,
    }
    named = set(re.findall(r"`([A-Z]\w+)[(`]", PAGE.read_text(encoding="utf-8")))
    assert len(named) >= 8
    assert named <= set(known)
