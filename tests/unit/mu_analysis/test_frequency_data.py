"""Uncertain frequency-response data: closed forms, members against models."""

import numpy as np
import pytest

import robustlab as rl

OMEGA = np.geomspace(0.1, 10.0, 12)
LAG = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
MOTORS = rl.parametric([["-1/T"]], [["k/T"]], [[1]], [[0]], {"k": (2.0, 0.1), "T": (1.0, 0.2)})


def two_by_two():
    rng = np.random.default_rng(3)
    return rng.standard_normal((len(OMEGA), 2, 2)) + 1j * rng.standard_normal((len(OMEGA), 2, 2))


def test_a_loop_of_data_sets_and_delays_has_the_members_of_its_parts():
    g = rl.frequency_response(LAG, OMEGA)[:, 0, 0]
    data = rl.frequency_data(g, OMEGA, radius=0.1 * abs(g))
    loop = data.feedback(MOTORS @ rl.delay(0.3).pade(3))
    delta = {"measured y1 from u1": 0.3 - 0.4j, "k": 0.5, "T": -0.7}
    through = g * (1 + 0.1 * (0.3 - 0.4j) * abs(g) / g)
    member = rl.frequency_response(MOTORS.evaluate({"k": 0.5, "T": -0.7}), OMEGA)[:, 0, 0]
    late = rl.frequency_response(rl.delay(0.3).pade(3), OMEGA)[:, 0, 0]
    expected = through / (1 + through * member * late)
    assert abs(loop.response(delta)[:, 0, 0] - expected).max() < 1e-13
    # a model with exact delays is evaluated at the frequencies
    again = data.feedback(rl.delay(0.3)).response({"measured y1 from u1": 0.3 - 0.4j})[:, 0, 0]
    assert abs(again - through / (1 + through * np.exp(-0.3j * OMEGA))).max() < 1e-13


def test_margin_and_gain_have_their_closed_forms():
    g = rl.frequency_response(LAG, OMEGA)[:, 0, 0]
    k, r = 3.0, 0.2 * abs(g)
    data = rl.frequency_data(g, OMEGA, radius=r)
    margin = rl.robust_stability(data.feedback(k))
    expected = abs(1 + k * g) / (k * r)
    assert np.allclose(margin.lower_at, expected, rtol=1e-6)
    assert np.allclose(margin.upper_at, expected, rtol=1e-6)
    assert margin.lower == margin.lower_at.min()
    assert margin.frequency == OMEGA[margin.lower_at.argmin()]
    assert margin.status is rl.Status.CERTIFIED
    for w, delta, size in zip(range(len(OMEGA)), margin.delta_at, margin.upper_at, strict=True):
        d = delta["measured y1 from u1"]
        assert abs(d) == pytest.approx(size)
        assert abs(1 + k * (g[w] + r[w] * d)) < 1e-9  # the loop is singular there
    # |g + d r| / |1 + k (g + d r)| over the disc: its image is a disc again
    gain = rl.peak_gain(data.feedback(k))
    angles = np.exp(2j * np.pi * np.arange(20000) / 20000)
    p = g[:, None] + r[:, None] * angles
    truth = abs(p / (1 + k * p)).max(axis=1)
    assert np.allclose(gain.lower_at, truth, rtol=1e-4)
    assert (gain.upper_at >= truth).all()
    assert (gain.upper_at <= truth * 1.001).all()
    k = int(gain.upper_at.argmax())
    assert (gain.lower, gain.upper, gain.frequency) == (gain.lower_at[k], gain.upper_at[k], OMEGA[k])


def test_the_result_holds_at_the_given_frequencies_only():
    resonance = rl.StateSpaceModel([[0, 1], [-1, -0.02]], [[0], [1]], [[1, 0]], [[0]])
    omega = np.array([0.5, 1.5])  # the peak at 1 rad/s is between
    set_ = rl.unstructured(resonance, 1.0, "inverse-additive")
    found = rl.robust_stability(set_, frequency=omega)
    truth = rl.robust_stability(set_)
    assert found.lower > 30 * truth.upper
    assert "nothing is claimed between them" in found.summary()
    assert "taken for granted" in found.summary()


def test_disk_margins_at_a_frequency():
    late = 2.0 * LAG @ rl.delay(0.5)
    margin = rl.disk_margin(late)
    at = rl.disk_margin(late, frequency=[margin.frequency])
    assert at.lower == pytest.approx(margin.upper, rel=1e-6)
    A, B = -np.diag([1.0, 2.0]), np.array([[1.0, 0.3], [-0.4, 1.0]])
    plant = rl.StateSpaceModel(A, B, np.eye(2), np.zeros((2, 2)))
    K = rl.StateSpaceModel([], [], [], 3 * np.eye(2))
    for place in ("input", "output", "both"):
        axis = rl.disk_margin(plant, K, at=place)
        points = rl.disk_margin(plant, 3 * np.eye(2), frequency=[axis.frequency, 2.0], at=place)
        assert points.upper == pytest.approx(axis.upper, rel=1e-3)
        for name, channel in points.channels.items():
            assert (channel.lower_at >= axis.channels[name].lower * (1 - 1e-6)).all()
    data = rl.frequency_data(plant, OMEGA)
    same = rl.disk_margin(data, 3 * np.eye(2)).simultaneous
    at_points = rl.disk_margin(plant, 3 * np.eye(2), frequency=OMEGA).simultaneous
    assert np.allclose(same.lower_at, at_points.lower_at)


def test_data_survive_saving_and_loading(tmp_path):
    G = two_by_two()
    data = rl.frequency_data(G, OMEGA, radius=abs(G), inputs=[("a", "V"), "b"], outputs=["c", ("d", "m")]).feedback(0.5)
    rl.save(tmp_path / "x.h5", data)
    back = rl.load(tmp_path / "x.h5")
    assert isinstance(back, rl.UncertainFrequencyData)
    assert (back.M == data.M).all()
    assert (back.blocks, back.inputs, back.outputs) == (data.blocks, data.inputs, data.outputs)
