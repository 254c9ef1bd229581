"""Nonlinear plants under feedback: loop algebra, slopes by differences, friction in the loop."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics import SineTrajectory, controlled_nonlinear, follow_with_torques, torque_loop
from robustlab.errors import InputError
from robustlab.statespace import StateSpaceModel

ANGLES = [f"phi_{i}" for i in range(1, 7)]
RATES = [f"phidot_{i}" for i in range(1, 7)]


@pytest.fixture(scope="module")
def machine():
    return rl.plant("stewart-platform", preset="physical", platform_mass=10.0)


@pytest.fixture(scope="module")
def rough(machine):
    return rl.with_effects(machine, {"coulomb-friction@phidot_6": {"Fc": (0.05, 1e-3)}})


def triple_pole(machine, p):
    """I-PD that gives every nut angle (s + p)^3 phi = p^3 r, by hand from the linear model at home."""
    model, one, none = rl.linearise(machine), np.eye(6), np.zeros((6, 6))
    gains = np.linalg.solve(
        model.B[6:], np.hstack([3 * p**2 * one + model.A[6:, :6], 3 * p * one + model.A[6:, 6:], p**3 * one])
    )
    return StateSpaceModel(none, np.hstack([one, -one, none]), gains[:, 12:], np.hstack([none, -gains[:, :12]]))


def test_the_loop_has_the_poles_that_its_controller_places(machine):
    loop = torque_loop(machine, triple_pole(machine, 50.0), rl.trim(machine))
    poles = rl.linearise(loop).poles()
    np.testing.assert_allclose(np.poly(poles / 50.0), np.poly(-np.ones(18)), rtol=1e-6)
    np.testing.assert_allclose(rl.linearise(loop).dc_gain()[:6], np.eye(6), atol=1e-9)


def test_friction_costs_its_torque_and_holds_the_nut(machine, rough):
    """On a ramp of one nut's angle its motor gives Fc / ratio more than that of the free machine."""
    K, t = triple_pole(machine, 60.0), np.linspace(0.0, 1.2, 301)
    path = SineTrajectory(machine.geometry.home, lift=(0, 0, 2e-3, 0, 0, 0), amplitude=np.zeros(6), lift_time=1.0)
    free, held = (follow_with_torques(p, K, path, t, at=rl.trim(p)) for p in (machine, rough))
    middle = (t > 0.4) & (t < 0.6)
    more = (held.torque - free.torque)[middle].mean(axis=0)
    assert more[5] == pytest.approx(0.05 / machine.values["ratio"], rel=0.02)
    assert np.abs(more[:5]).max() < 0.05 * more[5]
    assert held.within_limits
    assert held.voltage.shape == (301, 0)
    begun = np.abs(held.torque - held.torque[0])[:, 5] > 0.7 * 0.05 / machine.values["ratio"]
    before = slice(0, int(np.argmax(begun)))
    assert np.abs(held.phi[before, 5]).max() < 1e-9  # it sticks
    assert np.abs(free.phi[before, 5]).max() > 1e-4


def test_bad_loops(machine, rough):
    K, at = triple_pole(machine, 60.0), rl.trim(machine)
    with pytest.raises(InputError, match="18 and 6"):
        controlled_nonlinear(machine, StateSpaceModel([], [], [], np.zeros((6, 3))), ANGLES, [*ANGLES, *RATES], at)
    late = rl.with_effects(machine, {"input-delay@torque_2": {"d": 1e-3}})
    with pytest.raises(InputError, match="forces at joints"):
        torque_loop(late, K, at)
    with pytest.raises(InputError, match="its rest"):
        torque_loop(machine, K, at).equilibrium(pose=machine.geometry.home)
