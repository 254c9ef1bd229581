"""Joints at which a record could show no backlash, against a hanging mass worked out by hand."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest

import robustlab as rl
from robustlab.identification.experiment.shut_gaps import shut_gaps

ROTOR, LOAD, WEIGHT = 6e-4, 3e-5, 0.012  # kg m2, kg m2, N m
FOLLOWS = WEIGHT / LOAD  # rad/s2, as fast as the load falls


class Prepared(NamedTuple):
    motion: np.ndarray
    u: np.ndarray
    record: rl.Record


def hoist(roles=True):
    p = rl.PlantEquations("hoist")
    rotor = p.parameter("rotor", ROTOR, "kg m2", role="inertia" if roles else None)
    load = p.parameter("load", LOAD, "kg m2")
    weight = p.parameter("weight", WEIGHT, "N m")
    torque = p.input("torque", "N m")
    q, _ = p.joint("q", "w", "rad")
    p.motion([[rotor + load]], [torque - weight])
    p.output("q", q, "rad")
    return p.plant()


def swung(acceleration, frequency=6.0, n=2000, dt=1e-3):
    """A sine about zero with this peak acceleration, driven by whatever torque."""
    t, rate = dt * np.arange(n), 2 * math.pi * frequency
    q = acceleration / rate**2 * np.sin(rate * t)
    motion = np.column_stack([q, acceleration / rate * np.cos(rate * t)])
    u = ((ROTOR + LOAD) * -acceleration * np.sin(rate * t) + WEIGHT)[:, None]
    return Prepared(motion, u, rl.Record(t, {"torque": u[:, 0]}, {"q": q}))


@pytest.mark.parametrize("share", [0.2, 0.97])
def test_a_load_that_always_follows_is_told_with_its_force_and_with_the_motion_that_it_would_not_follow(share):
    peak = share * FOLLOWS
    (finding,) = shut_gaps(hoist(), [swung(peak)])
    assert (finding.kind, finding.channel, finding.fatal) == ("shut-gap", "w", False)
    low, high = finding.evidence["force"]
    assert (low, high) == pytest.approx(
        (WEIGHT - LOAD * peak, WEIGHT + LOAD * peak), abs=5e-6
    )  # differences of samples
    e = finding.evidence
    assert e["follows"] == pytest.approx(FOLLOWS, rel=1e-9)
    assert e["acceleration"] == pytest.approx(e["amplitude"] * (2 * math.pi * e["frequency"]) ** 2)
    assert e["acceleration"] > FOLLOWS
    # a sine of twice the acceleration that is needed is beyond it for a third of its period
    assert e["open"] == pytest.approx(1 / 3, abs=0.02)
    assert shut_gaps(hoist(), [swung(e["acceleration"], e["frequency"])]) == ()  # which then shows a gap
    assert "the gap opens for" in finding.hint
    assert "a backlash here would not show" in finding.message


def test_nothing_is_said_where_some_record_takes_the_load_off():
    assert shut_gaps(hoist(), [swung(0.5 * FOLLOWS), swung(1.05 * FOLLOWS)]) == ()
