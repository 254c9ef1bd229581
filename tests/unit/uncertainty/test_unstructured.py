"""Unstructured uncertainty: members against the defining formulas, the thesis' M, weights, bad inputs."""

import numpy as np
import pytest

import robustlab as rl
from robustlab import unstructured
from robustlab.uncertainty import FORMS


def model(n: int, p: int, m: int, seed: int, dt: float = 0.0, shift: float = 0.5) -> rl.StateSpaceModel:
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    A -= (np.linalg.eigvals(A).real.max() + shift) * np.eye(n)
    if dt:
        A = np.linalg.solve(np.eye(n) - 0.2 * A, np.eye(n) + 0.2 * A)
    return rl.StateSpaceModel(
        A, rng.standard_normal((n, m)), rng.standard_normal((p, n)), rng.standard_normal((p, m)), dt
    )


def member(form: str, G: np.ndarray, E: np.ndarray) -> np.ndarray:
    """The defining formula, one frequency."""
    p, m = G.shape
    return {
        "additive": lambda: G + E,
        "input-multiplicative": lambda: G @ (np.eye(m) + E),
        "output-multiplicative": lambda: (np.eye(p) + E) @ G,
        "inverse-additive": lambda: (
            np.linalg.inv(np.linalg.inv(G) + E) if p == m else G @ np.linalg.inv(np.eye(m) + E @ G)
        ),
        "inverse-input-multiplicative": lambda: G @ np.linalg.inv(np.eye(m) + E),
        "inverse-output-multiplicative": lambda: np.linalg.inv(np.eye(p) + E) @ G,
    }[form]()


def sizes(form: str, p: int, m: int) -> tuple[int, int]:
    """Shape of E."""
    return {
        "additive": (p, m),
        "inverse-additive": (m, p),
        "input-multiplicative": (m, m),
        "inverse-input-multiplicative": (m, m),
        "output-multiplicative": (p, p),
        "inverse-output-multiplicative": (p, p),
    }[form]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(("p", "m"), [(1, 1), (2, 2), (3, 2), (2, 3)])
@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_members_match_the_formula(form, p, m, dt):
    G = model(4, p, m, 1, dt, shift=-0.3)  # not stable, which is allowed
    rows, cols = sizes(form, p, m)
    W1, W2 = model(2, rows, rows + 1, 2, dt), model(3, cols + 1, cols, 3, dt)
    uncertain = unstructured(G, W2, form, W1=W1, name="d")
    assert (uncertain.blocks[0].rows, uncertain.blocks[0].cols) == (rows + 1, cols + 1)
    assert uncertain.M.n_states == 4 + 2 + 3
    assert uncertain.inputs == G.inputs
    assert uncertain.outputs == G.outputs
    rng = np.random.default_rng(4)
    omega = np.array([0.0, 0.3, 2.0, 20.0])
    for _ in range(3):
        delta = rng.standard_normal((rows + 1, cols + 1))
        delta /= 2 * np.linalg.norm(delta, 2)
        for value, got in (
            (delta, rl.frequency_response(uncertain.evaluate({"d": delta}), omega)),
            (delta * np.exp(0.7j), uncertain.response(omega, {"d": delta * np.exp(0.7j)})),
        ):
            for k, w in enumerate(omega):
                g, w1, w2 = (rl.frequency_response(s, [w])[0] for s in (G, W1, W2))
                expected = member(form, g, w1 @ value @ w2)
                assert np.abs(got[k] - expected).max() <= 1e-11 * max(np.abs(expected).max(), 1)


def test_the_m_of_the_thesis_without_weights():
    """Sections 4.2.1, 4.2.3 for a square static G, the inverse multiplicative form put right."""
    G = np.array([[2.0, 1.0], [0.5, 3.0]])
    eye, zero = np.eye(2), np.zeros((2, 2))
    expected = {
        "additive": [[zero, eye], [eye, G]],
        "input-multiplicative": [[zero, eye], [G, G]],
        "output-multiplicative": [[zero, G], [eye, G]],
        "inverse-additive": [[-G, G], [-G, G]],
        "inverse-input-multiplicative": [[-eye, eye], [-G, G]],
        "inverse-output-multiplicative": [[-eye, G], [-eye, G]],
    }
    for form, blocks in expected.items():
        assert pytest.approx(np.block(blocks)) == unstructured(rl.StateSpaceModel([], [], [], G), 1.0, form).M.D


def test_scalar_and_diagonal_weights():
    G = model(3, 2, 3, 5)
    lag = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.5]])
    omega = [0.0, 1.0, 5.0]
    one = rl.frequency_response(lag, omega)[:, 0, 0]
    delta = np.random.default_rng(1).standard_normal((2, 3))
    g = rl.frequency_response(G, omega)
    alike = unstructured(G, lag, "additive")
    assert alike.response(omega, {"unmodelled": delta}) == pytest.approx(g + one[:, None, None] * delta)
    each = unstructured(G, [1.0, lag, 0.5], "additive", W1=2.0)
    scale = np.stack([np.ones(3), one, np.full(3, 0.5)], axis=1)[:, None, :]
    assert each.response(omega, {"unmodelled": delta}) == pytest.approx(g + 2 * delta * scale)
