"""The linear plants against equations derived by hand and published numbers."""

import math
import pickle

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics import NonlinearPlant, plant_names
from robustlab.linear_analysis import drop_unconnected

# Březina 2010, Maxon RE 35
R, L, KM, KB, KF, J = 2.07, 0.62e-3, 0.052, 0.052, 4.8e-5, 7.2e-6


def two_state_motor(**parameters):
    return drop_unconnected(rl.linearise(rl.plant("dc-motor", **parameters)).select(outputs=["omega", "i"]))


def test_motor_is_eq_7_5():
    model = two_state_motor()
    assert model.state_names == model.output_names == ("omega", "i")
    np.testing.assert_allclose(model.A, [[-KF / J, KM / J], [-KB / L, -R / L]], rtol=1e-15)
    np.testing.assert_allclose(model.B, [[0], [1 / L]], rtol=1e-15)
    np.testing.assert_array_equal(model.C, np.eye(2))
    np.testing.assert_array_equal(model.D, np.zeros((2, 1)))


def test_no_load_speed_of_the_thesis():
    """Published 779.1 rad/s at 42 V against the maker's 788.5; the gap is 1.2 %."""
    by_hand = 42 * KM / (KB * KM + R * KF)
    speed = 42 * two_state_motor().dc_gain()[0, 0]
    assert speed == pytest.approx(by_hand, rel=1e-12)
    assert speed == pytest.approx(779.07, abs=0.05)
    maker = 7530 * 2 * math.pi / 60
    assert maker == pytest.approx(788.54, abs=0.05)
    assert 100 * (maker - speed) / speed == pytest.approx(1.21, abs=0.02)


def test_friction_tolerance_covers_the_data_sheet():
    """Kf +-35 % gives 769.52 .. 788.85 rad/s, which holds the data sheet's 788.54; the exact need is -33.8 %.

    That is for the rounded 788.5 rad/s; the 7530 rpm themselves ask for -33.9 %.
    """
    uncertain = rl.plant("dc-motor").uncertain(outputs=["omega"])
    assert [b.name for b in uncertain.blocks] == ["Kf"]
    speed = {d: 42 * uncertain.evaluate({"Kf": d}).dc_gain()[0, 0] for d in (-1, 1)}
    assert speed[1] == pytest.approx(769.52, abs=0.05)
    assert speed[-1] == pytest.approx(788.85, abs=0.05)
    maker = 7530 * 2 * math.pi / 60

    def kf_for(omega):  # from omega = 42 Km / (Kb Km + R Kf), relative to the nominal Kf
        return (42 * KM / omega - KB * KM) / R / KF - 1

    assert 100 * kf_for(788.5) == pytest.approx(-33.8, abs=0.05)
    need = kf_for(maker)
    assert 100 * need == pytest.approx(-33.9, abs=0.05)
    assert 42 * uncertain.evaluate({"Kf": need / 0.35}).dc_gain()[0, 0] == pytest.approx(maker, rel=1e-12)


def test_servo_axis_is_the_published_linear_model():
    model = rl.linearise(rl.plant("servo-axis"))
    np.testing.assert_allclose(model.A, [[0, 1], [0, -203.5034 / 95.1089]], rtol=1e-15)
    np.testing.assert_allclose(model.B, [[0], [35.15065 / 95.1089]], rtol=1e-15)
    assert [tuple(s) for s in model.outputs] == [("q", "m"), ("v", "m/s")]


def test_two_mass_by_hand():
    j1, j2, c, k = 0.5, 2.0, 0.3, 7.0
    model = rl.linearise(rl.plant("two-mass", J1=j1, J2=j2, c=c, k=k))
    s = 1j * 1.7
    # eliminated by hand: (J1 s^2 + c s + k)(J2 s^2 + c s + k) - (c s + k)^2
    spring = c * s + k
    det = (j1 * s**2 + spring) * (j2 * s**2 + spring) - spring**2
    expected = np.array([[(j2 * s**2 + spring) / det], [spring / det]])
    np.testing.assert_allclose(rl.frequency_response(model, [1.7])[0], expected, rtol=1e-12)


@pytest.mark.parametrize("n", [1, 2, 5])
def test_chain_modes_have_a_closed_form(n):
    """Equal masses and springs, one end fixed: omega_j = 2 sqrt(k/m) sin((2 j - 1) pi / (4 n + 2))."""
    k, m = 30.0, 0.7
    model = rl.linearise(rl.plant("mass-spring-damper", m=[m] * n, c=0.0, k=k))
    omega = 2 * np.sqrt(k / m) * np.sin((2 * np.arange(1, n + 1) - 1) * np.pi / (4 * n + 2))
    poles = model.poles()
    np.testing.assert_allclose(np.sort(poles.imag[poles.imag > 0]), np.sort(omega), rtol=1e-10)
    assert model.input_names == (("f",) if n == 1 else tuple(f"f{j + 1}" for j in range(n)))


@pytest.mark.parametrize("name", plant_names())
def test_every_plant_meets_the_interface(name):
    plant = rl.plant(name)
    assert plant.name == name
    for key, p in plant.parameters.items():
        assert (key, bool(p.unit), bool(p.source), bool(p.meaning)) == (p.name, True, True, True)
    assert all(s.unit for s in (*plant.inputs, *plant.outputs, *plant.states))
    model, rng = rl.linearise(plant), np.random.default_rng(1)
    x, u = rng.normal(size=len(plant.states)), rng.normal(size=len(plant.inputs))
    if isinstance(plant, NonlinearPlant):
        trim = rl.trim(plant)
        size = 1e-6  # A, B to first order about the trim, where f vanishes
        rates = plant.derivative(trim.x + size * x, trim.u + size * u) / size
        np.testing.assert_allclose(rates, model.A @ x + model.B @ u, rtol=1e-4)
        np.testing.assert_allclose(plant.output(trim.x + x, trim.u + u) - trim.y, model.C @ x + model.D @ u)
    else:
        np.testing.assert_allclose(plant.derivative(x, u), model.A @ x + model.B @ u)
        np.testing.assert_allclose(plant.output(x, u), model.C @ x + model.D @ u)
    again = pickle.loads(pickle.dumps(plant))
    np.testing.assert_array_equal(rl.linearise(again).A, model.A)


def test_linearise_keeps_the_operating_point():
    plant = rl.plant("dc-motor")
    model = rl.linearise(plant, at=([1.0, 2.0, 3.0], [4.0]))
    np.testing.assert_array_equal(model.operating_point.x, [1, 2, 3])
    np.testing.assert_array_equal(model.operating_point.y, [1, 2, 3])
    np.testing.assert_array_equal(model.A, rl.linearise(plant).A)
