"""A recorded run judged from its record: a body of my own under a controller of my own, and the law of a leg."""

from __future__ import annotations

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics.extended.feed_forward import DryLevel, FeedForward, feed_forward
from robustlab.errors import InputError
from robustlab.identification.validation.recorded_run import Judgement, recorded_run
from robustlab.signals import Signal

DT, LSB, FRICTION = 1e-3, 1e-4, 0.3
NAMES = ["q_ref", "p_ref", "q", "p"]
LAW = FeedForward(Signal("f", "N"), Signal("q", "m"), (), (DryLevel(FRICTION),))


def pd(gain=400.0):
    """Proportional with a filtered difference, for two axes, in discrete time."""
    A, B = 0.8 * np.eye(2), np.hstack([np.eye(2), -np.eye(2)])
    slope = 0.2 * 40.0 / DT
    units = [(n, "m") for n in NAMES]
    return rl.StateSpaceModel(A, B, -0.2 * slope * np.eye(2), (gain + slope) * B, DT, units, [("f", "N"), ("g", "N")])


def made(K, ahead):
    """Two bodies of 1 kg, the first with dry friction in Moreau's steps and pushed by 2 N all the time."""
    t = np.arange(3000) * DT
    r = 0.02 * np.column_stack([np.sin(2 * t), np.cos(3 * t) - 1.0])
    rate = np.gradient(r[:, 0], DT)
    q, v, x = np.zeros(2), np.array([0.04, 0.0]), np.zeros(2)
    y, u = np.zeros((len(t), 2)), np.zeros((len(t), 2))
    for k in range(len(t)):
        y[k] = LSB * np.round(q / LSB)
        w = np.concatenate([r[k], y[k]])
        u[k] = K.C @ x + K.D @ w + [2.0 + ahead * FRICTION * np.sign(rate[k]), 0.0]
        x = K.A @ x + K.B @ w
        for _ in range(20):
            v = v + DT / 20 * (u[k] - [2.0, 0.0])
            v[0] = np.sign(v[0]) * max(abs(v[0]) - DT / 20 * FRICTION, 0.0)
            q = q + DT / 20 * v
    outputs = {"q": y[:, 0], "p": y[:, 1], "q_ref": r[:, 0], "p_ref": r[:, 1]}
    return rl.Record(t, {"f": u[:, 0], "g": u[:, 1]}, outputs, dict.fromkeys(NAMES, "m"), "run")


JUDGED = Judgement("q", 0.5, LSB, 5.0)


@pytest.fixture(scope="module")
def both():
    return made(pd(), 0.0), made(pd(), 1.0)


def test_errors_are_those_of_the_record_and_the_commands_are_the_controllers(both):
    before = recorded_run("before", both[0], pd(), [], JUDGED)
    found = recorded_run("after", both[1], pd(), [LAW], JUDGED, before)
    assert list(found.controllers) == ["before", "after"]
    assert list(found.errors) == ["before", "after"]
    for (name, row), record in zip(found.controllers.items(), both, strict=True):
        error = (record.outputs["q"] - record.outputs["q_ref"])[500:]
        other = (record.outputs["p"] - record.outputs["p_ref"])[500:]
        assert row["rms_error"] == pytest.approx(np.sqrt((error**2).mean()))
        assert row["worst_counts"] == pytest.approx(np.abs(error).max() / LSB)
        assert row["others"] == pytest.approx(np.sqrt((other**2).mean()))
        assert row["command_gap"] < 1e-9, name
        assert row["within_limits"] == (row["largest_input"] <= 5.0)
    rows = found.controllers
    assert rows["after"]["error_ratio"] == rows["before"]["rms_error"] / rows["after"]["rms_error"] > 1.5
    assert rows["before"]["error_ratio"] == 1.0


def test_another_controller_or_no_law_does_not_pass(both):
    for K, laws in ((pd(300.0), [LAW]), (pd(), []), (pd(), [LAW, LAW])):
        assert recorded_run("x", both[1], K, laws, JUDGED).controllers["x"]["command_gap"] > 0.01


def test_a_continuous_controller_ran_by_tustin():
    """1 / (s + 10) as z-transform by hand: (1 + 1/z) h / (2 + 10 h + (10 h - 2) / z)."""
    r = np.random.default_rng(1).standard_normal((500, 2)) * [1.0, 0.0]
    u, h = np.zeros(500), DT
    v = r[:, 0] - r[0, 0]
    for k in range(1, 500):
        u[k] = ((2 - 10 * h) * u[k - 1] + h * (v[k] + v[k - 1])) / (2 + 10 * h)
    record = rl.Record(np.arange(500) * h, {"f": u}, {"q": r[:, 1] + r[0, 0], "q_ref": r[:, 0]}, name="r")
    K = rl.StateSpaceModel([[-10.0]], [[1.0, 0.0]], [[1.0]], [[0.0, 0.0]], 0.0, [("q_ref", ""), ("q", "")], [("f", "")])
    assert recorded_run("x", record, K, [], Judgement("q")).controllers["x"]["command_gap"] < 1e-9


def test_what_does_not_belong_together_is_refused(both):
    K = pd()
    less = {n: y for n, y in both[0].outputs.items() if n != "p_ref"}
    less = rl.Record(both[0].t, both[0].inputs, less, name="r")
    with pytest.raises(InputError, match="no 'p_ref'"):
        recorded_run("x", less, K, [], JUDGED)
    with pytest.raises(InputError, match="clock"):
        recorded_run("x", rl.Record(2 * both[0].t, both[0].inputs, both[0].outputs, name="r"), K, [], JUDGED)
    shifted = {n: y + 0.01 * both[0].t for n, y in both[0].outputs.items()}
    other, first = rl.Record(both[0].t, both[0].inputs, shifted, name="r"), recorded_run("x", both[0], K, [], JUDGED)
    with pytest.raises(InputError, match="another motion"):
        recorded_run("y", other, K, [], JUDGED, first)
    turned = rl.StateSpaceModel(K.A, K.B, K.C, K.D, DT, [K.inputs[k] for k in (2, 3, 0, 1)], K.outputs)
    with pytest.raises(InputError, match="references, then their outputs"):
        recorded_run("x", both[0], turned, [], JUDGED)


def test_the_friction_of_a_leg_is_fed_forward_at_its_motor():
    """A torque at the nut is the ratio's share of it at the motor, in every pose, and so is its interval."""
    machine = rl.plant("stewart-platform", preset="physical")
    named = rl.with_effects(machine, {"coulomb-friction@phidot_4": {"Fc": (0.05, 1e-3)}})
    law, ratio = feed_forward(named), 4.8 * 41 / 21
    assert (law.input.name, law.position.name) == ("torque_4", "phi_4")
    assert float(law(0.3, 0.2)) == pytest.approx(0.05 / ratio)
    assert law.left == pytest.approx(2e-3 / ratio)
    assert feed_forward(named, 3.0).left == pytest.approx(3e-3 / ratio)
    assert dict(law.facts())["left within the fitted intervals"].endswith("N m")
