"""LQG by separation and with disturbances in its model: Doyle's closed forms, python-control, H2, and simulation."""

from __future__ import annotations

import control
import numpy as np
import pytest

import robustlab as rl
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.statespace import lower_lft
from robustlab.synthesis.h2.gaussian_regulator import _separation


def random_model(seed: int, dt=0.0, n=4, p=2, m=2) -> rl.StateSpaceModel:
    rng = np.random.default_rng(seed)
    g = rl.StateSpaceModel(
        rng.standard_normal((n, n)), rng.standard_normal((n, m)), rng.standard_normal((p, n)), np.zeros((p, m)),
        inputs=[f"u{k}" for k in range(m)], outputs=[f"y{k}" for k in range(p)],
    )  # fmt: skip
    return rl.discretise(g, dt, "zoh") if dt else g


ONES = np.eye(4), np.eye(2), np.eye(4), np.eye(2)


@pytest.mark.parametrize("q", [1.0, 100.0, 1e4])
def test_doyles_example_has_its_closed_form_and_no_margin(q):
    """Doyle 1978: gains f = d = 2 + sqrt(4 + q); the last two coefficients of the loop's polynomial with a gain m,
    d + f - 4 + 2 (m - 1) d f and 1 + (1 - m) d f, have to be positive."""
    g = rl.StateSpaceModel([[1, 1], [0, 1]], [[0], [1]], [[1, 0]], [[0]])
    ones = np.ones((2, 2))
    design = rl.lqg(g, q * ones, [[1.0]], q * ones, [[1.0]])
    f = d = 2 + np.sqrt(4 + q)
    assert design.status is rl.Status.CONVERGED, design.reason
    np.testing.assert_allclose(design.F, [[f, f]], rtol=1e-8)
    np.testing.assert_allclose(design.L, [[d], [d]], rtol=1e-8)
    low, high = design.classical_margins().channels["u1"].gain_margin
    assert high == pytest.approx(1 + 1 / (f * d), rel=1e-7)
    assert low >= 1 - (d + f - 4) / (2 * d * f) * (1 + 1e-9)  # the condition is necessary
    disk = design.disk_margins().simultaneous
    assert disk.gain_margin[1] <= high * (1 + 1e-9)  # a disk holds real gains too
    assert "disk margin, input u1" in design.summary()


@pytest.mark.parametrize("seed", range(3))
def test_gains_and_poles_are_those_of_python_control(seed):
    g = random_model(seed)
    design = rl.lqg(g, *ONES)
    F, _, regulator = control.lqr(g.A, g.B, np.eye(4), np.eye(2))
    L, _, estimator = control.lqe(g.A, np.eye(4), g.C, np.eye(4), np.eye(2))
    np.testing.assert_allclose(design.F, F, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(design.L, L, rtol=1e-6, atol=1e-9)
    loop = np.linalg.eigvals(lower_lft(g, design.K).A)
    # Separation: the polynomial of the loop is the product of the two.
    np.testing.assert_allclose(np.poly(loop), np.poly([*regulator, *estimator]), rtol=1e-6)
    assert design.separation < 1e-12


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(3))
def test_it_is_the_h2_optimum(seed, dt):
    """The H2 design of the same problem goes another way: scaled, two Riccati equations of the generalised plant."""
    g = random_model(seed, dt)
    design = rl.lqg(g, *ONES)
    other = rl.h2(design.plant)
    assert design.gamma == pytest.approx(other.gamma, rel=1e-6)
    rng = np.random.default_rng(seed)
    filtered = rl.StateSpaceModel([[0.5 if dt else -0.7]], [[1.0]], [[1.0]], [[0.0]], dt)
    known = rl.lqg(g, *ONES, disturbance=filtered, at="output", disturbance_noise=rng.uniform(0.5, 2, 2))
    assert known.gamma == pytest.approx(rl.h2(known.plant).gamma, rel=1e-6)
    assert known.status is rl.Status.CONVERGED


def test_a_direct_term_of_the_plant_is_taken_into_account():
    g = random_model(5)
    other = rl.StateSpaceModel(g.A, g.B, g.C, [[0.3, 0.0], [0.1, -0.2]])
    for disturbance in (None, "constant"):
        design = rl.lqg(other, *ONES, disturbance=disturbance)
        assert design.status is rl.Status.CONVERGED, design.reason
    assert rl.lqg(other, *ONES).gamma == pytest.approx(rl.lqg(g, *ONES).gamma, rel=1e-6)  # D u is known


def simulated(g, K, disturbance, at, steps):
    """Outputs of a discrete loop, step by step; d(k) adds to the controls or to the measurements."""
    x, k, y = np.zeros(g.n_states), np.zeros(K.n_states), np.zeros((steps, g.n_outputs))
    for i in range(steps):
        d = disturbance(i)
        y[i] = g.C @ x + (d if at == "output" else 0)
        u = K.C @ k + K.D @ y[i]
        k = K.A @ k + K.B @ y[i]
        x = g.A @ x + g.B @ (u + (d if at == "input" else 0))
    return y


@pytest.mark.parametrize("at", ["input", "output"])
@pytest.mark.parametrize("omega", [0.0, 3.0])
def test_nothing_is_left_of_a_persistent_disturbance(omega, at):
    g = random_model(2, 0.05)
    design = rl.lqg(g, *ONES, disturbance=omega or "constant", at=at)
    assert design.status is rl.Status.CONVERGED, design.reason
    d = np.array([1.0, -0.5])
    steps = int(40 / -np.log(np.abs(lower_lft(g, design.K).poles()).max())) + 10
    y = simulated(g, design.K, lambda i: d * np.cos(omega * 0.05 * i + 0.3), at, steps)
    assert np.abs(y[-20:]).max() < 1e-8 * np.abs(y).max()
    # A plain LQG controller leaves something; that the figures see it.
    plain = simulated(g, rl.lqg(g, *ONES).K, lambda i: d * np.cos(omega * 0.05 * i + 0.3), at, steps)
    assert np.abs(plain[-20:]).max() > 1e-4 * np.abs(plain).max()


def test_with_a_model_for_each_output_nothing_is_left_for_plants_nearby_either():
    g = random_model(1)
    design = rl.lqg(g, *ONES, disturbance="constant", at="output")
    assert design.offsets[0].anywhere < 1e-9 * design.peak
    near = rl.StateSpaceModel(1.02 * g.A, 0.97 * g.B, 1.01 * g.C, g.D, inputs=g.inputs, outputs=g.outputs)
    assert lower_lft(near, design.K).is_stable()
    disturbed = rl.StateSpaceModel(near.A, np.hstack([near.B, near.B]), np.vstack([near.C, near.C]), np.zeros((4, 4)))
    gain = lower_lft(disturbed, design.K).dc_gain()
    assert np.abs(gain).max() < 1e-9
    one = rl.lqg(g, *ONES, disturbance="constant", channels=["u0"])
    assert one.offsets[0].modelled < 1e-9 * one.peak
    assert one.offsets[0].anywhere > 1e-3


def test_poles_that_are_moved_are_noticed():
    """Negative control of the separation."""
    A, B = np.diag([-1.0, -2.0]), np.array([[-3.0]])
    loop = np.diag([-1.0, -2.0, -3.0])
    assert _separation(loop, (A, B)) < 1e-14
    assert _separation(np.diag([-1.0, -2.001, -3.0]), (A, B)) > 1e-5
    assert _separation(np.diag([-1.0, -2.0, -2.0]), (A, B)) > 1e-2


@pytest.mark.parametrize(
    ("options", "error", "text"),
    [
        ({"disturbance": "constant", "at": "middle"}, InputError, "at: 'middle'"),
        ({"disturbance": "steps"}, InputError, "'steps'"),
        ({"disturbance": -1.0}, InputError, "frequency -1"),
        ({"disturbance": "constant", "channels": ["v"]}, InputError, "no such signal"),
        ({"disturbance": "constant", "disturbance_noise": 0.0}, InputError, "positive numbers"),
        ({"disturbance": "constant", "disturbance_noise": [1, 2, 3]}, InputError, "disturbance_noise"),
        ({"disturbance": rl.StateSpaceModel([[1.0]], [[1]], [[1]], [[0]])}, InputError, "grows"),
        ({"disturbance": rl.StateSpaceModel([[-1.0]], [[1]], [[1]], [[1]])}, InputError, "direct term"),
        ({"disturbance": rl.StateSpaceModel([[-1.0]], [[1]], [[1], [1], [1]], [[0]] * 3)}, InputError, "3 outputs"),
        ({"regulated": ["y7"]}, InputError, "y7"),
        ({"channels": []}, InputError, "without a disturbance"),
        ({"disturbance": "constant", "channels": []}, InputError, "at least one of"),
    ],
)  # fmt: skip
def test_what_no_disturbance_is_is_named(options, error, text):
    with pytest.raises(error, match=text):
        rl.lqg(random_model(0), *ONES, **options)


def test_a_disturbance_that_no_control_holds_is_named():
    """Two outputs, one control: both can be held against a force on that control, not against each its own offset."""
    g = random_model(3, m=1)
    weights = np.eye(4), np.eye(1), np.eye(4), np.eye(2)
    assert rl.lqg(g, *weights, disturbance="constant").status is rl.Status.CONVERGED
    with pytest.raises(NoTrustworthyNumber, match="no control holds y0, y1"):
        rl.lqg(g, *weights, disturbance="constant", at="output")
    held = rl.lqg(g, *weights, disturbance="constant", at="output", regulated=["y1"])
    assert held.status is rl.Status.CONVERGED
    zero = rl.StateSpaceModel([[-1, 0], [1, -2]], [[1], [0]], [[0, 1]], [[0]])
    blocked = rl.StateSpaceModel(zero.A, zero.B, [[1.0, -2.0]], zero.D)  # s / ((s + 1)(s + 2))
    with pytest.raises(NoTrustworthyNumber, match=r"zero at its frequency \(0 rad/s\)"):
        rl.lqg(blocked, np.eye(2), [[1]], np.eye(2), [[1]], disturbance="constant", at="output")
    with pytest.raises(NoTrustworthyNumber):  # it does not show
        rl.lqg(blocked, np.eye(2), [[1]], np.eye(2), [[1]], disturbance="constant", at="input")
