"""Tracking problems: the weighted loop against loop algebra at single frequencies, sets of models, sizes, faults."""

import numpy as np
import pytest

import robustlab as rl
from robustlab import complementary_weight, control_weight, frequency_response
from robustlab.dynamics import actuator_cascade
from robustlab.errors import InputError
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis import error_weight, tracking_problem

OMEGA = np.geomspace(1e-2, 1e3, 60)
SIZES = {"reference": {"q": 2.0, "v": 0.5}, "disturbance": {"f": 3.0}, "noise": {"q_ref": 0.1, "v": 0.2}}


def plant() -> StateSpaceModel:
    rng = np.random.default_rng(11)
    A = rng.standard_normal((4, 4)) - 2.5 * np.eye(4)
    return StateSpaceModel(
        A, rng.standard_normal((4, 2)), rng.standard_normal((3, 4)), 0.3 * rng.standard_normal((3, 2)),
        inputs=[("f", "N"), ("u", "V")], outputs=[("q", "m"), ("v", "m/s"), ("x", "m")],
    )  # fmt: skip


def controller() -> StateSpaceModel:
    """A controller of four inputs and two outputs with small gains, for a stable loop with the stable plant."""
    rng = np.random.default_rng(12)
    A = rng.standard_normal((3, 3)) - 3 * np.eye(3)
    B, C, D = (0.2 * rng.standard_normal(s) for s in ((3, 4), (2, 3), (2, 4)))
    return StateSpaceModel(A, B, C, D)


def problem_of(G=None, **changes):
    weights = {"W1": error_weight(0.04, 1.0), "W2": control_weight(4.0, 50.0), "W3": complementary_weight(20.0)}
    return tracking_problem(
        G or plant(), ["q", "v"], ["v", "x"], **{**weights, **SIZES, "reference_bandwidth": 3.0, **changes}
    )


def expected_response(G, K, omega):
    """From (r, d, n) to (W1 e, W2 u, W3 y_c), from u = (I - K_y G)^-1 (K_r r + K_y (G d + n))."""
    g, k = frequency_response(G, [omega])[0], frequency_response(K, [omega])[0]

    def of(w):
        return frequency_response(w, [omega])[0, 0, 0]

    size, f = np.diag([2.0, 0.5]), of(StateSpaceModel([[-3.0]], [[1.0]], [[3.0]], [[0.0]]))
    pick = np.array([[0, 1, 0], [0, 0, 1.0]])  # v and x are measured
    k_r, k_y = k[:, :2], k[:, 2:]
    r = size * f
    d = np.array([[3.0], [0.0]])
    # columns: two references, one disturbance, noise on q_ref and on v
    loop = np.linalg.inv(np.eye(2) - k_y @ pick @ g)
    noise = k_r @ np.array([[0.1, 0], [0, 0]]) + k_y @ np.array([[0, 0.2], [0, 0]])
    u = loop @ np.hstack([k_r @ r, k_y @ pick @ g @ d, noise])
    y = g @ (u + np.hstack([np.zeros((2, 2)), d, np.zeros((2, 2))]))
    e = np.linalg.inv(size) @ (np.hstack([r, np.zeros((2, 3))]) - y[:2])
    w = problem_of().weights
    return np.vstack([of(w["W1"]) * e, of(w["W2"]) * u, of(w["W3"]) * np.linalg.inv(size) @ y[:2]])


def test_the_weighted_loop_equals_loop_algebra():
    loop = problem_of().close(controller()).nominal
    assert loop.is_stable()
    found = frequency_response(loop, OMEGA)
    for k, omega in enumerate(OMEGA):
        np.testing.assert_allclose(found[k], expected_response(plant(), controller(), omega), rtol=1e-9, atol=1e-12)


def test_members_of_the_set_are_those_of_the_plant():
    other = plant()
    signals = (other.inputs, other.outputs, other.states)
    faster = StateSpaceModel(1.2 * other.A, other.B, other.C, other.D, 0.0, *signals)
    set_ = rl.elementwise(other, faster, "single")
    problem = problem_of(set_)
    assert [b.name for b in problem.uncertain.blocks] == ["single"]
    member = problem.close(controller()).evaluate({"single": 0.6})
    again = problem_of(set_.evaluate({"single": 0.6})).close(controller()).nominal
    np.testing.assert_allclose(
        frequency_response(member, OMEGA), frequency_response(again, OMEGA), rtol=1e-8, atol=1e-12
    )
    on = problem_of().on(set_)
    np.testing.assert_array_equal(on.uncertain.M.A, problem.uncertain.M.A)
    np.testing.assert_array_equal(on.uncertain.M.D, problem.uncertain.M.D)


def test_the_thesis_cascade_has_the_thesis_error():
    """THESIS item 20: 5 mm |1 - (p / (j pi + p))^3| = 0.1996 mm; the torque loop is negligible."""
    actuator = rl.plant("linear-actuator")
    problem = tracking_problem(actuator, ["phi"], ["phi", "omega", "i"], W1=25.0, reference=73.603)
    share = problem.gains(actuator_cascade(actuator), [np.pi])["S"][0]
    assert 5 * share == pytest.approx(5 * abs(1 - (236 / (1j * np.pi + 236)) ** 3), rel=2e-3)


def test_error_weight_values():
    W = error_weight(0.04, 2.0, 1e-3)
    gain = np.abs(frequency_response(W, [0.0, 2.0, 1e6])[:, 0, 0])
    assert gain == pytest.approx([1000.0, 25 * np.sqrt(2) / np.sqrt(1 + 0.025**2), 25.0], rel=1e-6)


def test_a_load_reaches_the_error_through_its_own_input():
    """From a force of size 2 at the second input to the error of size 0.5: -G2 S 2 / 0.5, in closed form."""
    G = rl.StateSpaceModel([[-1.0]], [[1.0, 3.0]], [[1.0]], [[0.0, 0.0]], inputs=["u", "load f"], outputs=["q"])
    problem = tracking_problem(G, ["q"], ["q"], W1=1.0, reference=0.5, loads={"load f": 2.0})
    assert (problem.n_con, problem.n_meas) == (1, 2)
    k = 4.0
    closed = problem.close(rl.StateSpaceModel([], [], [], [[k, -k]])).nominal
    s = 0.7j
    expected = -(3 / (s + 1)) / (1 + k / (s + 1)) * 2.0 / 0.5
    assert rl.frequency_response(closed, [0.7])[0, 0, 1] == pytest.approx(expected)
    assert problem.on(G.select(["u"], ["q"])).loads == {}
    with pytest.raises(InputError, match="one that is left for control"):
        tracking_problem(G, ["q"], ["q"], W1=1.0, loads={"u": 1.0, "load f": 1.0})
