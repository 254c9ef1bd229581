"""A machine read off its records: hidden numbers come back, its simulation is the closed form, and the trial counts."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import robustlab as rl
from robustlab.dynamics.extended.feed_forward import DryLevel, FeedForward, Wave
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.validation.machine_trial import ThereAndBack, try_machine
from robustlab.identification.validation.measured_machine import MeasuredMachine, measured_machine
from robustlab.signals import Signal

INERTIA, FRICTION, VISCOUS = 4e-3, 0.35, 2e-3
WAVES = (Wave(0.3, -0.8, 7.0), Wave(0.1, 0.25, 12.0))


def map_of(q):
    return 0.05 + sum(c * np.cos(k * q) + s * np.sin(k * q) for c, s, k in WAVES)


def spin_up(u, v0, n=900, h=1e-3):
    """Motion that never reverses, by DOP853: there dry friction is a constant."""
    way = math.copysign(1.0, v0)

    def rates(t, x):
        return [x[1], (u - map_of(x[0]) - FRICTION * way - VISCOUS * x[1]) / INERTIA]

    found = solve_ivp(rates, (0.0, (n - 1) * h), [0.0, v0], "DOP853", t_eval=np.arange(n) * h, rtol=1e-10, atol=1e-10)
    assert (np.sign(found.y[1]) == way).all()
    return rl.Record(found.t, {"i": np.full(n, u)}, {"phi": found.y[0]}, {"i": "A", "phi": "rad"}, f"at {u:g}")


@pytest.fixture(scope="module")
def machine():
    """Steps that start fast enough to pass the first crest, both ways."""
    records = [spin_up(u, v) for u, v in ((0.45, 30.0), (-0.3, -30.0), (0.6, 25.0), (-0.5, -25.0), (0.35, 35.0))]
    return measured_machine(records, "i", "phi", (2.0, 60.0))


def test_hidden_numbers_come_back(machine):
    assert machine.inertia == pytest.approx(INERTIA, rel=0.01)
    assert machine.friction == pytest.approx(FRICTION, rel=0.05)
    assert machine.viscous == pytest.approx(VISCOUS, rel=0.2)
    q = np.linspace(0.0, 4 * math.pi, 3000)
    assert np.sqrt(np.mean((machine.at(q) - map_of(q)) ** 2)) < 0.03
    first, second = machine.waves(2)
    assert (first.k, second.k) == (pytest.approx(7.0), pytest.approx(12.0))
    np.testing.assert_allclose(first[:2], WAVES[0][:2], atol=0.03)
    assert machine.left < 0.02


def test_what_is_fed_forward_is_map_and_friction(machine):
    ahead = machine.feed_forward(2)
    assert float(ahead(1.0, 3.0)) == pytest.approx(float(map_of(1.0)) + FRICTION, abs=0.05)
    assert float(ahead(1.0, 3.0) - ahead(1.0, -3.0)) == pytest.approx(2 * machine.friction)


def known(table, viscous=0.0, friction=FRICTION):
    signals = Signal("i", "A"), Signal("phi", "rad")
    return MeasuredMachine(*signals, INERTIA, viscous, friction, np.asarray(table), 2 * math.pi, 0.0, 0)


def controller(kp, kd=0.0, dt=2.5e-4):
    """kp (r - y) + kd times the difference of r - y over a sample."""
    d = kp + kd / dt
    names = [("phi_ref", "rad"), ("phi", "rad")]
    return rl.StateSpaceModel([[0.0]], [[1.0, -1.0]], [[-kd / dt]], [[d, -d]], dt, names, [("i", "A")])


def test_below_its_friction_it_stands_and_above_it_accelerates():
    still, n = known(np.zeros(144)), 400
    constant = FeedForward(still.input, still.position, (Wave(0.9 * FRICTION, 0.0, 0.0),))
    run = still.run(controller(1e-12), np.zeros(n), np.zeros(n), constant)
    assert not run.q.any()
    assert not run.v.any()
    more = FeedForward(still.input, still.position, (Wave(0.5 + FRICTION, 0.0, 0.0),))
    run = still.run(controller(1e-12), np.zeros(n), np.zeros(n), more)
    t = run.t
    np.testing.assert_allclose(run.v, 0.5 / INERTIA * t, atol=1e-6)
    np.testing.assert_allclose(run.q, 0.25 / INERTIA * t**2, atol=0.5 / INERTIA * 2e-5 * t[-1])


def test_without_friction_it_swings_as_the_differential_equation_says():
    """A map of one wave is a pendulum; held by a weak spring of the controller's, from an angle."""
    nodes = 2 * math.pi * np.arange(144) / 144
    pendulum, n = known(0.02 * np.sin(nodes), friction=0.0), 4000
    K = rl.StateSpaceModel(
        np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), [[0.0, -1e-9]], 2.5e-4,
        [("phi_ref", "rad"), ("phi", "rad")], [("i", "A")],
    )  # fmt: skip
    run = pendulum.run(K, np.full(n, 1.0), np.zeros(n))
    wanted = solve_ivp(
        lambda t, x: [x[1], -0.02 * math.sin(x[0]) / INERTIA], (0, run.t[-1]), [1.0, 0.0], "DOP853", t_eval=run.t,
        rtol=1e-10,
    )  # fmt: skip
    np.testing.assert_allclose(run.q, wanted.y[0], atol=2e-3)


def test_the_reference_is_its_own_integral_and_comes_back():
    q, v, steady = ThereAndBack(6.0, 12.0, 0.3, 0.5).samples(1e-4, 2.0)
    np.testing.assert_allclose(np.diff(q), 0.5e-4 * (v[1:] + v[:-1]), atol=1e-8)
    assert (q[0], q[-1]) == (2.0, pytest.approx(2.0, abs=1e-9))
    assert (v.max(), v.min()) == (pytest.approx(6.0), pytest.approx(-6.0))
    assert set(np.round(v[steady], 9)) == {6.0, -6.0}
    # the way, half the ramp at the mean speed 3, and a quarter wave of the turn: 6 cos from 6 to 0 over 0.3 s
    assert q.max() == pytest.approx(2.0 + 12.0 + 3.0 * 0.3 + 6.0 * 0.3 * 2 / math.pi, abs=1e-3)


def test_the_perfect_feed_forward_wins_and_the_opposite_loses(machine):
    good = machine.feed_forward(6)
    bad = FeedForward(good.input, good.position, tuple(Wave(-c, -s, k) for c, s, k in good.waves))
    motion, K = ThereAndBack(6.0, 12.0, 0.3), controller(4.0, 0.15)
    rows = try_machine(
        machine, K, {"alone": None, "good": good, "bad": bad}, motion, lsb=2 * math.pi / 8192
    ).controllers
    assert rows["good"]["error_ratio"] > 3
    assert rows["good"]["ripple_ratio"] > 3
    assert rows["bad"]["error_ratio"] < 1
    assert rows["alone"]["error_ratio"] == rows["alone"]["ripple_ratio"] == 1.0
    assert rows["good"]["rms_counts"] == pytest.approx(rows["good"]["rms_error"] * 8192 / (2 * math.pi))


def test_what_cannot_be_told_is_refused(machine):
    record = spin_up(0.45, 30.0)
    with pytest.raises(InputError, match="no 'u'"):
        measured_machine([record], "u", "phi", (2.0, 60.0))
    with pytest.raises(NoTrustworthyNumber, match="samples between these speeds"):
        measured_machine([record], "i", "phi", (2.0, 3.0))
    slower = rl.Record(record.t**1.1, record.inputs, record.outputs, record.units, "warped")
    with pytest.raises(InputError, match="irregular"):
        measured_machine([slower], "i", "phi", (2.0, 60.0))
    with pytest.raises(InputError, match="discrete"):
        machine.run(rl.tf([1.0], [1.0, 1.0]), np.zeros(5), np.zeros(5))
    with pytest.raises(NoTrustworthyNumber, match="runs away"):
        machine.run(controller(-40.0), np.linspace(0.0, 50.0, 40000), np.full(40000, 5.0))
    with pytest.raises(InputError, match="speed"):
        try_machine(machine, controller(4.0), {"alone": None}, ThereAndBack(-1.0, 1.0, 0.1))


def test_dry_levels_are_friction():
    assert known(np.zeros(8)).feed_forward(1).dry == (DryLevel(FRICTION),)
