"""Paths of a platform's pose as experiments: limits held, and the loop by an integrator of another kind."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import robustlab as rl
from robustlab.dynamics import stewart
from robustlab.identification.experiment import path_experiment
from robustlab.identification.experiment.path_menu import PathLimits, menu, paths

HOME = np.array([0.0, 0.0, 0.1262, 0.0, 0.0, 0.0])
DT = 2e-3


def machine():
    return rl.plant("stewart-platform", preset="physical", platform_mass=10.0)


def limits(plant, speed=40.0, acceleration=2000.0, reach=15.0):
    centre = stewart.nut_angles(plant.geometry, HOME[None])[0]
    return PathLimits(np.full(6, speed), np.full(6, acceleration), np.column_stack([centre - reach, centre + reach]))


@pytest.mark.parametrize("given", [{}, {"speed": 4.0}, {"acceleration": 100.0}, {"reach": 1.0}])
def test_every_path_keeps_to_the_limits_uses_them_and_rests_at_both_ends(given):
    plant = machine()
    asked = limits(plant, **given)
    found = paths(plant.geometry, HOME, asked, 3000, DT)
    found += paths(plant.geometry, HOME, asked, 3000, DT, [3])[len(found) :]
    assert [p.name for p in found] == [*menu(), "leg 4 usual", "leg 4 quick", "leg 4 shake"]
    for p in found[-3:]:  # the others wander
        assert np.abs(np.delete(p.angles - 0.4 * found[0].angles - 0.6 * p.angles[0], 3, axis=1)).max() < 0.01 * np.ptp(
            found[0].angles
        )
    for p in found:
        assert np.abs(stewart.nut_angles(plant.geometry, p.poses) - p.angles).max() < 1e-9
        speed = np.diff(p.angles, axis=0) / DT
        acceleration = np.diff(speed, axis=0) / DT
        shares = [
            (np.abs(speed) / asked.speed).max(),
            0.9 * np.abs(acceleration).max() / asked.acceleration[0],  # of another difference than its own
            0.9 * (np.abs(p.angles - asked.reach.mean(axis=1)) / (0.5 * np.ptp(asked.reach, axis=1))).max(),
        ]
        assert 0.5 < max(shares) < 1.0, p.name
        for end in (0, -1):
            assert np.abs(p.poses[end] - HOME).max() < 1e-9
            assert np.abs(speed[end]).max() < 1e-2 * np.abs(speed).max()


def test_the_machine_under_the_stated_controller_is_that_of_another_integrator():
    """The loop written out here, with the plant's equations, by an explicit method with error control."""
    plant = machine()
    path = paths(plant.geometry, HOME, limits(plant), 500, DT)[2]
    u, y = path_experiment._followed(plant, [], path, DT)
    at = rl.trim(plant, pose=path.poses[0])
    b, own = path_experiment._authority(plant, path.poses[0])
    assert np.abs(own).max() < 1e-9
    k, d = 1600.0 / b, 2 * 0.7 * 40.0 / b
    t = np.arange(500) * DT

    def torque(time, x):
        r = np.array([np.interp(time, t, c) for c in path.angles.T])
        error = r - x[:6]
        return at.u + k * error + 500.0 * d * (error - x[12:]), error

    def rates(time, x):
        asked, error = torque(time, x)
        return np.concatenate([plant.derivative(x[:12], asked), 500.0 * (error - x[12:])])

    run = solve_ivp(
        rates, (0.0, t[-1]), np.concatenate([at.x, np.zeros(6)]), t_eval=t, rtol=1e-7, atol=1e-8, max_step=DT
    )
    assert np.abs(run.y[:6].T - y[:, :6]).max() < 1e-4 * np.ptp(y[:, :6])
    again = np.array([torque(time, x)[0] for time, x in zip(t, run.y.T, strict=True)])
    assert np.abs(again - u)[1:-1].max() < 5e-3 * np.ptp(u)


def test_the_damping_of_a_nut_with_a_motor_is_its_back_emf():
    """At rest a voltage k_b w k drives the current away that k_m k makes torque of: k_m k_b k^2 / R per unit of b."""
    plant = rl.plant("stewart-platform", preset="physical", motors=True, platform_mass=10.0)
    b, own = path_experiment._authority(plant, HOME)
    v = plant.values
    gear = v["ratio"]
    torque = gear * v["Km"] / v["R"]  # N m at the nut per volt
    assert own / b == pytest.approx((gear**2 * (v["Km"] * v["Kb"] / v["R"] + v["Kf"])) / torque, rel=2e-3)
    path = paths(plant.geometry, HOME, limits(plant, acceleration=1000.0), 500, DT)[2]
    _, y = path_experiment._followed(plant, [], path, DT)
    assert np.abs(y[:, :6] - path.angles).max() < 0.1 * np.ptp(path.angles)
