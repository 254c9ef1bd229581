"""Interconnections judged by the algebra of their frequency responses, and by python-control's own."""

from __future__ import annotations

import control
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from robustlab import frequency_response
from robustlab.statespace import StateSpaceModel, append, feedback, lower_lft

OMEGA = np.array([0.0, 0.3, 1.0, 7.0, 50.0])
SETTINGS = settings(max_examples=40)


def random_model(seed, n, n_u, n_y, dt=0.0):
    rng = np.random.default_rng(seed)
    a = rng.standard_normal((n, n))
    if n:
        a = (
            a / (1.2 * np.abs(np.linalg.eigvals(a)).max())
            if dt
            else a - (np.linalg.eigvals(a).real.max() + 0.3) * np.eye(n)
        )
    return StateSpaceModel(
        a, rng.standard_normal((n, n_u)), rng.standard_normal((n_y, n)), 0.3 * rng.standard_normal((n_y, n_u)), dt
    )


states, ports, seeds = st.integers(0, 4), st.integers(1, 3), st.integers(0, 10_000)
sample_times = st.sampled_from([0.0, 0.05])


@SETTINGS
@given(seeds, states, states, ports, ports, sample_times, st.sampled_from([-1, 1]))
def test_feedback_solves_the_loop_equation(seed, n1, n2, n_u, n_y, dt, sign):
    plant, controller = random_model(seed, n1, n_u, n_y, dt), random_model(seed + 1, n2, n_y, n_u, dt)
    if np.linalg.cond(np.eye(n_u) - sign * controller.D @ plant.D) > 1e6:
        return
    g, k = frequency_response(plant, OMEGA), frequency_response(controller, OMEGA)
    t = frequency_response(feedback(plant, controller, sign), OMEGA)
    # y = G (r + sign K y)
    np.testing.assert_allclose(t, g + sign * g @ k @ t, rtol=1e-7, atol=1e-7 * max(1.0, np.abs(t).max()))


@SETTINGS
@given(seeds, states, states, ports, ports)
def test_feedback_equals_control(seed, n1, n2, n_u, n_y):
    plant, controller = random_model(seed, n1, n_u, n_y), random_model(seed + 1, n2, n_y, n_u)
    if np.linalg.cond(np.eye(n_u) + controller.D @ plant.D) > 1e6:
        return
    ours = feedback(plant, controller)
    theirs = control.feedback(plant.to_control(), controller.to_control())
    size = max(1.0, np.abs(ours.A).max(initial=0.0))
    np.testing.assert_allclose(ours.A, theirs.A, atol=1e-9 * size)
    for s in (0.1j, 3j):
        np.testing.assert_allclose(
            frequency_response(ours, [s.imag])[0], theirs(s, squeeze=False), rtol=1e-6, atol=1e-6
        )


@SETTINGS
@given(seeds, states, states, ports, ports, ports, ports, sample_times)
def test_lower_lft_is_its_formula(seed, n1, n2, n_w, n_z, n_u, n_y, dt):
    plant, controller = random_model(seed, n1, n_w + n_u, n_z + n_y, dt), random_model(seed + 1, n2, n_y, n_u, dt)
    if np.linalg.cond(np.eye(n_u) - controller.D @ plant.D[n_z:, n_w:]) > 1e6:
        return
    p, k = frequency_response(plant, OMEGA), frequency_response(controller, OMEGA)
    p11, p12, p21, p22 = p[:, :n_z, :n_w], p[:, :n_z, n_w:], p[:, n_z:, :n_w], p[:, n_z:, n_w:]
    wanted = p11 + p12 @ k @ np.linalg.solve(np.eye(n_y) - p22 @ k, p21)
    found = lower_lft(plant, controller)
    np.testing.assert_allclose(
        frequency_response(found, OMEGA), wanted, rtol=1e-7, atol=1e-7 * max(1.0, np.abs(wanted).max())
    )
    assert found.input_names == plant.input_names[:n_w]
    assert found.output_names == plant.output_names[:n_z]


@SETTINGS
@given(seeds, states, states, st.integers(0, 3), ports, ports, st.integers(0, 3))
def test_append_is_block_diagonal(seed, n1, n2, u1, y1, u2, y2):
    first = random_model(seed, n1, u1, y1)
    second = random_model(seed + 1, n2, u2, y2).renamed([f"v{k}" for k in range(u2)], [f"z{k}" for k in range(y2)])
    g = frequency_response(append(first, second), OMEGA)
    assert g.shape == (len(OMEGA), y1 + y2, u1 + u2)
    np.testing.assert_allclose(g[:, :y1, :u1], frequency_response(first, OMEGA), atol=1e-12)
    np.testing.assert_allclose(g[:, y1:, u1:], frequency_response(second, OMEGA), atol=1e-12)
    assert not g[:, :y1, u1:].any()
    assert not g[:, y1:, :u1].any()
