"""docs/synthesis.md: the code runs, and what is printed beside it is right."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import robustlab as rl

PAGE = Path(__file__).parents[3] / "docs" / "synthesis.md"


def test_the_page_runs_and_its_numbers_are_right(capsys):
    names = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL):
        exec(block, names)
    s = 1j * np.geomspace(1e-3, 1e3, 4001)
    omega = s.imag
    G = 1 / (3 * s**2 + s + 2)

    design, weights = names["design"], names["weights"]
    K = rl.frequency_response(design.K, omega)[:, 0, 0]
    S = 1 / (1 + G * K)
    parts = [rl.frequency_response(w, omega)[:, 0, 0] * f for w, f in
             ((weights.W1, S), (weights.W2, K * S), (weights.W3, G * K * S)) if w is not None]  # fmt: skip
    peak = np.sqrt(sum(np.abs(part) ** 2 for part in parts)).max()
    assert design.status is rl.Status.CERTIFIED
    assert design.gamma * (1 - 1e-3) < peak <= design.gamma * (1 + 1e-9)
    assert design.lower_bound.value <= design.smallest_gamma <= design.gamma <= 1.05 * design.smallest_gamma

    # Glover-McFarlane's formula by another solver of the two Riccati equations.
    from scipy.linalg import solve_continuous_are

    A, B, C = np.array([[0, 1], [-2 / 3, -1 / 3]]), np.array([[0], [10 / 3]]), np.array([[1.0, 0.0]])
    X, Z = solve_continuous_are(A, B, C.T @ C, np.eye(1)), solve_continuous_are(A.T, C.T, B @ B.T, np.eye(1))
    exact = np.sqrt(1 + np.abs(np.linalg.eigvals(X @ Z)).max())
    assert names["shaped"].gamma_min == pytest.approx(exact, rel=1e-6)
    assert names["shaped"].gamma <= 1.1 * exact * 1.001

    text = PAGE.read_text(encoding="utf-8")
    two, held = names["two"], names["held"]
    assert f"# {two.margin.lower:.4f} {two.matching.upper:.4f}," in text
    answered = rl.frequency_response(two.closed_loop.select(["y1 reference"], ["y1"]), omega)[:, 0, 0]
    assert np.abs(answered - 4 / (s**2 + 3.2 * s + 4)).max() == pytest.approx(two.matching.upper, rel=1e-3)
    force = rl.StateSpaceModel([], [], [], -np.eye(1)) @ held.K
    assert abs((G / (1 + G * rl.frequency_response(force, omega)[:, 0, 0]))[0]) < 1e-2
    for K, shown in ((names["plain"].K, 1.034), (held.K, 0.715)):
        L = -G * rl.frequency_response(K, omega)[:, 0, 0]
        assert 1 / np.abs(1 / (1 + L) - 0.5).max() == pytest.approx(shown, abs=6e-4)
    static = names["static"]
    assert (f"{static.gamma:.4f}", round(static.parameters["K[u4,y5]"], 2)) == ("0.8801", -6.53)

    robust = names["robust"]
    assert robust.status is rl.Status.CERTIFIED
    assert robust.proved_again() == pytest.approx(robust.scaled_level, rel=1e-5)
    loop = robust.closed_loop
    stack = rl.mu(rl.frequency_response(loop, omega[::80]), robust.blocks)
    assert stack.lower.max() <= robust.gamma * (1 + 1e-6)
    assert names["small"].K.n_states <= robust.K.n_states
    assert names["small"].loss <= 0.05
    assert names["digital"].K.dt == 0.02
    sampled = names["sampled"]
    assert sampled.status is rl.Status.CERTIFIED
    worst = names["spring"].evaluate({name: 0.99 * value for name, value in sampled.member.items()})
    member = names["tracking_problem"](
        worst, ["y1"], ["y1"], W1=rl.performance_weight(0.5, 0.02), W2=rl.control_weight(20.0), reference=1.0,
        reference_bandwidth=1.0, noise=0.001, disturbance=0.1,
    )  # fmt: skip
    assert 0.97 * sampled.mu_lower < rl.sampled_data_norm(member.nominal, names["digital"]).lower < sampled.mu_upper
    assert np.array_equal(names["again"].K.A, names["digital"].K.A)
    printed = capsys.readouterr().out
    for number in ("2.0983", "2.28", "0.437", "0.778", "0.4135", "0.4143", "2.413"):
        assert number in printed
