"""Loops with effects of the catalogue: proved gains against simulations with the effects themselves."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.errors import InputError
from robustlab.result import Status

K = rl.StateSpaceModel([[-300.0]], [[1.0]], [[-90000.0]], [[320.0]])
AXIS = rl.plant("servo-axis")


def gain_of(effects, **options):
    return rl.peak_gain(rl.with_effects(AXIS, effects), K, outputs=["q"], **options)


def simulated(d, dt, u_max=np.inf, friction=None):
    """q for disturbances d (n, k) of the command: the axis and the controller by small steps, the laws themselves."""
    M, Fv, gain = (AXIS.parameters[name].value for name in ("M", "Fv", "gain"))
    q, v, x = np.zeros((3, d.shape[1]))
    found, largest = np.empty(d.shape), 0.0
    for i, value in enumerate(d):
        found[i] = q
        e = value - (K.C[0, 0] * x + K.D[0, 0] * q)
        largest = max(largest, np.abs(e).max())
        force = gain * np.clip(e, -u_max, u_max)
        if friction is not None:
            level, slow = friction
            force = force - level * np.clip(v / slow, -1, 1)
        x = x + dt * (K.A[0, 0] * x + q)
        v = v + dt * (force - Fv * v) / M
        q = q + dt * v
    return found, largest


def attacks(t):
    waves = np.array([np.sin(w * t) for w in (0.3, 1.0, 2.0, 4.0, 7.0, 10.0, 14.0, 20.0)]).T
    return np.hstack([waves, np.sign(waves)]) * (t < 0.7 * t[-1])[:, None]


@pytest.mark.slow
def test_no_input_of_a_saturated_axis_reaches_more():
    found = gain_of({"input-saturation": {"u_max": 10.0}}, amplitude={"u": 40.0})
    assert found.status is Status.CERTIFIED
    assert "odd nonlinearity, sector [0.25, 1], slope [0, 1]" in found.summary()
    assert found.conditions == ("input-saturation@u: while the signal stays within 40",)
    dt = 1e-3
    t = np.arange(0.0, 20.0, dt)
    worst = 0.0
    for size in (3.0, 9.0, 14.0, 25.0):
        d = size * attacks(t)
        q, largest = simulated(d, dt, u_max=10.0)
        if largest <= 40.0:  # the condition of the proof
            worst = max(worst, (np.linalg.norm(q, axis=0) / np.linalg.norm(d, axis=0)).max())
    assert 0.3 * found.upper <= worst <= found.upper


@pytest.mark.slow
def test_friction_with_a_stick_speed_is_a_monotone_law():
    found = gain_of({"coulomb-friction": {"Fc": 20.0}}, stick_speed={"v": 0.01})
    assert found.status is Status.CERTIFIED
    (text,) = found.nature.values()
    assert text == "odd nonlinearity, sector [0, 2000], slope [0, 2000]"
    assert found.conditions == ("coulomb-friction@v: sticking as creep below 0.01",)
    dt = 2e-4
    t = np.arange(0.0, 8.0, dt)
    for size in (0.5, 3.0, 30.0):
        d = size * attacks(t)
        q, _ = simulated(d, dt, friction=(20.0, 0.01))
        assert (np.linalg.norm(q, axis=0) / np.linalg.norm(d, axis=0)).max() <= found.upper


def test_friction_without_a_stick_speed_is_rejected_with_a_reason():
    with pytest.raises(InputError, match=r"sector \[0, inf\): no strict inequality holds"):
        gain_of({"coulomb-friction": {"Fc": 20.0}})
    with pytest.raises(InputError, match="no Coulomb friction there"):
        gain_of({"coulomb-friction": {"Fc": 20.0}}, stick_speed={"q": 0.01})
    with pytest.raises(InputError, match="controller: given for a model, expected it for a plant with effects"):
        rl.peak_gain(AXIS, K)


def test_any_other_sector_may_vary_arbitrarily_fast():
    found = gain_of({"quadratic-drag": {"c": 100.0}}, amplitude={"v": 1.0})
    assert list(found.nature.values()) == ["varies arbitrarily fast"]
    assert found.conditions == ("quadratic-drag@v: while its signal stays within 1",)
    assert found.status is Status.CERTIFIED


def test_an_integrating_loop_has_no_gain_where_the_input_may_vanish():
    found = gain_of({"input-dead-zone": {"d": 0.5}}, amplitude={"u": 40.0})
    assert found.status is Status.INFEASIBLE
    assert "a member is unstable" in found.summary()
