"""Positions far from zero are measured from within their strokes if the plant does not depend on them."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.identification.data_checks import counted_from, position_datum

T = np.arange(500) * 1e-3


def record(**outputs):
    return rl.Record(T, {"u": np.sin(9 * T)}, outputs)


def test_an_angle_is_shifted_by_whole_turns_and_its_speed_not_at_all():
    motor = rl.plant("dc-motor")
    far = [record(phi=3000.0 + k + np.sin(9 * T), omega=9 * np.cos(9 * T)) for k in (0, 4)]
    datum = position_datum(motor, far)
    assert set(datum) == {"phi"}
    assert datum["phi"] / (2 * np.pi) == pytest.approx(round(3002 / (2 * np.pi)))
    near = counted_from(far[0], datum)
    assert np.abs(near["phi"]).max() < 6
    assert (near["omega"] == far[0]["omega"]).all()
    assert np.cos(7 * near["phi"]) == pytest.approx(np.cos(7 * far[0]["phi"]), abs=1e-9)


def test_positions_near_zero_are_unchanged():
    assert position_datum(rl.plant("dc-motor"), [record(phi=1.0 + np.sin(9 * T))]) == {}


def test_a_spring_to_ground_has_its_own_zero():
    far = rl.Record(T, {"f": 0 * T}, {"q": 3000.0 + np.sin(T)})
    assert position_datum(rl.plant("mass-spring-damper"), [far]) == {}


def test_two_masses_are_shifted_together():
    far = rl.Record(T, {"torque": 0 * T}, {"phi1": 3000 + np.sin(T), "phi2": 3000 + np.cos(T)})
    datum = position_datum(rl.plant("two-mass"), [far])
    assert datum["phi1"] == pytest.approx(datum["phi2"]) == pytest.approx(3000, abs=4)


def test_an_unmeasured_position_is_ignored():
    assert position_datum(rl.plant("dc-motor"), [record(omega=np.cos(9 * T))]) == {}
