"""Sets with one full block: the six M by their closed formulas, and the worst Delta."""

from __future__ import annotations

import numpy as np
import pytest

import robustlab as rl
from robustlab import unstructured
from robustlab.uncertainty import FORMS, realise_delta

LAG = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.2]])


def plant(p: int, m: int, dt: float = 0.0, seed: int = 0) -> rl.StateSpaceModel:
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((3, 3)) - 2.5 * np.eye(3)
    if dt:
        A = np.linalg.solve(np.eye(3) - 0.5 * dt * A, np.eye(3) + 0.5 * dt * A)
    B = rng.standard_normal((3, m)) * (dt or 1.0)
    return rl.StateSpaceModel(A, B, rng.standard_normal((p, 3)), np.zeros((p, m)), dt)


def closed_form(form: str, G: np.ndarray, K: np.ndarray) -> np.ndarray:
    """M at the channels of Delta up to sign, negative feedback, by textbook formulas."""
    p, m = G.shape
    So, Si = np.linalg.inv(np.eye(p) + G @ K), np.linalg.inv(np.eye(m) + K @ G)
    return {
        "additive": K @ So,
        "input-multiplicative": K @ So @ G,
        "output-multiplicative": G @ K @ So,
        "inverse-additive": So @ G,
        "inverse-input-multiplicative": Si,
        "inverse-output-multiplicative": So,
    }[form]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(("p", "m"), [(1, 1), (2, 3)])
@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_m_norm_and_worst_delta(form, p, m, dt):
    G, K = plant(p, m, dt), rl.StateSpaceModel([], [], [], 0.3 * np.random.default_rng(5).standard_normal((m, p)))
    weight = rl.StateSpaceModel(LAG.A * 0 + 0.9, 0.1 * LAG.B, LAG.C, LAG.D, dt) if dt else LAG
    uncertain = unstructured(G, weight, form, name="d")
    loop = uncertain.feedback(K)
    test = rl.robust_stability(loop)
    assert test.status is rl.Status.CERTIFIED
    omega = np.geomspace(1e-2, 30, 40)
    g, k, w = (rl.frequency_response(s, omega) for s in (G, K, weight))
    expected = np.array([np.linalg.norm(w[i] * closed_form(form, g[i], k[i]), 2) for i in range(len(omega))])
    sigma = np.linalg.svd(rl.frequency_response(loop.delta_channels, omega), compute_uv=False)[:, 0]
    assert sigma == pytest.approx(expected, rel=1e-9)
    assert expected.max() <= 1 / test.lower
    # The worst Delta: of the norm of the margin, and on the stability boundary as a system; less of it is stable.
    assert np.linalg.norm(test.delta["d"], 2) == pytest.approx(test.upper, rel=1e-12)
    assert test.lower <= test.upper <= test.lower * (1 + 1e-8)
    if test.frequency < np.inf:
        made = realise_delta(loop.blocks, test.delta, test.frequency, dt)
        at = np.exp(1j * test.frequency * dt) if dt else 1j * test.frequency
        assert abs(test.pole - at) <= 1e-6
        assert rl.peak_gain(made["d"]).upper <= test.upper * (1 + 2e-6)
        less = realise_delta(loop.blocks, {"d": 0.99 * test.delta["d"]}, test.frequency, dt)
        assert loop.evaluate(less).is_stable()


def test_a_peak_in_the_direct_term_is_an_ill_posed_loop():
    lead = rl.StateSpaceModel([[-1.0]], [[1.0]], [[-1.0]], [[2.0]])  # (2 s + 1)/(s + 1)
    uncertain = unstructured(rl.StateSpaceModel([], [], [], [[1.0]]), lead)
    assert rl.robust_stability(uncertain).upper == np.inf
    closed = rl.robust_stability(uncertain.feedback())
    assert closed.frequency == np.inf
    assert closed.upper == pytest.approx(1.0)
