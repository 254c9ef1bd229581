"""A gap at a leg of the platform, robustlab's law against the machine that knows nothing of it."""

from dataclasses import replace

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics import DAMPING, shares_behind

pytest.importorskip("pinocchio")

import platform_cases as pc
import platform_machine as pm

LEG, DT = 2, 2e-3
POSE = np.array([0.002, 0.001, 0.127, 0.01, -0.01, 0.02])


def machine(motors, gap):
    plant = pc.nominal_plant(motors)
    drives = pm.Drives(**{key: plant.values[key] for key in pc.MOTOR}) if motors else pm.Drives()
    of = pm.Machine(pm.bodies(plant.values), drives, motors)
    return plant, replace(of, drives=of.drives.at(LEG, gap=gap))


def flank(of, reduced, monkeypatch):
    """Frequency in Hz of the machine's flank with the reduced inertia of rotor and load; its damping made the law's.

    The machine's own is a quarter less: what a rebound gives back decides on all that follows.
    """
    numbers = pm._numbers(of)
    omega = float(np.sqrt(numbers[LEG, pm.FLANK] / reduced))
    assert numbers[LEG, pm.DAMP] == pytest.approx(2 * DAMPING * omega * reduced, rel=0.3)
    numbers[LEG, pm.DAMP] = 2 * DAMPING * omega * reduced
    monkeypatch.setattr(pm, "_numbers", lambda _: numbers)
    return omega / (2 * np.pi)


@pytest.mark.slow
@pytest.mark.parametrize(("motors", "size"), [(False, 0.06), (True, 16.0)])
def test_the_law_moves_as_the_machine(motors, size, monkeypatch):
    gap = 0.15
    plant, of = machine(motors, gap)
    n, start = 150, rl.trim(plant, pose=POSE)
    t = np.arange(n) * DT
    u = np.tile(start.u, (n, 1))
    u[:, LEG] += size * np.sin(2 * np.pi * 11 * t)
    (share,) = shares_behind(plant, "phidot_3")
    rotor = plant.values["rotor_J"] * pc.GEAR**2
    values = {"gap": gap, "share": share, "f": flank(of, share * rotor, monkeypatch)}
    found = pm.simulate(of, POSE, n, DT, lambda k, _: u[k], currents=start.x[12:] if motors else None, step=1e-5)
    assert 0.1 < found.flights[:, LEG].mean() < 0.9
    rough = rl.with_effects(plant, {"backlash@phidot_3": values})
    x, _ = rough.stepped(t, u, np.append(start.x, [0.0, 0.0]), 1e-4)
    stiff, _ = rl.with_effects(plant, {"viscous-friction@phidot_1": {"b": 0.0}}).stepped(t, u, start.x, 1e-3)
    without = np.abs(stiff[:, :6] - found.clean).max(axis=0)
    others = [k for k in range(6) if k != LEG]
    assert np.abs(x[:, LEG] - found.clean[:, LEG]).max() < 0.02 * without[LEG]
    assert np.abs(x[:, len(start.x)] - (found.clean - found.phi)[:, LEG]).max() < 0.02 * gap
    assert (np.abs(x[:, others] - found.phi[:, others]).max(axis=0) < 0.05 * without[others]).all()
