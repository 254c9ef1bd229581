"""Refitted nominal parameters, and the candidate effects of plants and records."""

import math
from functools import cache

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics import (
    Descriptor,
    LinearPlant,
    Parameter,
    overridden,
)
from robustlab.errors import InputError
from robustlab.identification import (
    candidates,
    nuisance_parameters,
    ports_of,
    prepare,
    spatial_orders,
    stated_tolerances,
    timed_lines,
    window_length,
    with_absolute_tolerances,
)

# --- refitted nominal parameters -------------------------------------------------------------------------------------


def test_a_plant_without_tolerances_gets_default_ones():
    found = stated_tolerances(rl.plant("dc-motor"), None)
    assert found == {
        "R": (0.05, True), "L": (0.10, True), "Km": (0.03, True), "Kb": (0.03, True), "Kf": (0.35, False),
        "J": (0.05, True),
    }  # fmt: skip


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"Jx": 0.1}, r"'Jx'.*no such parameter of dc-motor.*R, L, Km.*J"),
        ({"J": -0.1}, r"tolerances: J.*-0.1.*0 or more"),
        ({"J": math.nan}, r"tolerances: J.*nan"),
        ({"J": math.inf}, r"tolerances: J.*inf"),
    ],
)
def test_wrong_tolerances_are_errors(wrong, message):
    with pytest.raises(InputError, match=message):
        stated_tolerances(rl.plant("dc-motor"), wrong)


def nuisances(plant, given=None):
    return {n.label: n for n in nuisance_parameters(plant, stated_tolerances(plant, given))}


def test_parameters_of_one_quantity_have_one_factor():
    assert nuisances(rl.plant("dc-motor"))["Km+Kb"].names == ("Km", "Kb")
    actuator = nuisances(rl.plant("linear-actuator"))["J+J_nut+m_screw+m_cart"]
    assert actuator.names == ("J", "J_nut", "m_screw", "m_cart")
    assert actuator.spread == pytest.approx(math.log(1.5) / math.sqrt(3))  # the widest: the cart's 50 %
    assert set(nuisances(rl.plant("two-mass"))) == {"J1", "J2", "c", "k"}


def test_a_parameter_with_tolerance_zero_is_fixed():
    assert set(nuisances(rl.plant("servo-axis"))) == {"M", "Fv"}  # the gain is what forces are measured in
    assert set(nuisances(rl.plant("servo-axis"), {"M": 0.0, "gain": 0.1})) == {"Fv", "gain"}
    held = nuisances(rl.plant("linear-actuator"), {"J": 0.0})["J+J_nut+m_screw+m_cart"]
    assert held.names == ("J_nut", "m_screw", "m_cart")


def own_motor(**given):
    """Return a user's motor: parameters without roles, one of them in no equation."""
    parameters = (
        Parameter("J", 1e-3, "kg m2", 0.1, sign="positive"),
        Parameter("c", 0.0, "N m s/rad", sign="nonnegative"),
        Parameter("b", 0.0, "N m s/rad", sign="any"),
        Parameter("ratio", 3.0, "", 0.5),
    )
    states = (rl.Signal("phi", "rad"), rl.Signal("omega", "rad/s"))
    return LinearPlant(
        "own motor", overridden(parameters, given, "own motor"), (rl.Signal("u", "N m"),), states, states,
        equations=lambda p: Descriptor([[1, 0], [0, p["J"]]], [[0, 1], [0, -p["c"] - p["b"]]], [[0], [1]], np.eye(2)),
    )  # fmt: skip


def test_the_value_zero_has_an_absolute_tolerance_and_a_friction_stays_nonnegative():
    found = nuisances(own_motor(c=(0.0, 0.2), b=(0.0, "+-0.1 N m s/rad")))
    c, b = found["c"], found["b"]
    assert c.factor(0.0) == b.factor(0.0) == 0.0
    assert b.factor(-2.0) == pytest.approx(-2.0 * 0.1 / math.sqrt(3))
    assert (c.factor(-2.0), c.factor(1.5)) == (0.0, pytest.approx(1.5 * 0.2 / math.sqrt(3)))
    draws = np.random.default_rng(3).uniform(-0.1, 0.1, 200_000)
    assert b.spread == pytest.approx(draws.std(), rel=0.01)


def test_a_relative_tolerance_of_the_value_zero_is_an_error():
    with pytest.raises(InputError, match=r"tolerances: c.*5% of the value 0.*an absolute tolerance: a number in N m s"):
        stated_tolerances(own_motor(), {"c": "5%"})
    with pytest.raises(InputError, match=r"c.*5% of the value 0"):
        own_motor(c=(0.0, "5%"))
    assert stated_tolerances(own_motor(), {"c": "0.3 N m s/rad"})["c"] == (0.3, False)
    assert with_absolute_tolerances(own_motor(), {"c": (0.3, False)}).parameters["c"].radius == 0.3


# --- spatial lines ---------------------------------------------------------------------------------------------------


def unequal_travel():
    """Return angle and speed of a motion over 20 rad with reversals, slow at first and fast later."""
    t = np.linspace(0.0, 1.0, 6000)
    q = 20.0 * (t**2 * (3 - 2 * t))
    q = np.concatenate([q, q[::-1] + 0.37])
    return q, np.gradient(q)


@pytest.mark.parametrize("k", [13.0, 2.5, 77.0])
def test_a_torque_ripple_is_found_at_unequal_speed(k):
    q, v = unequal_travel()
    d = 0.02 * np.cos(k * q + 0.4) + 0.3 * np.sign(v) - 5.0 * v + 0.05  # ripple and friction
    d = d + 0.005 * np.random.default_rng(5).normal(size=len(d))
    found = spatial_orders(q, d, v, np.abs(v) > 0.01 * np.abs(v).max())
    assert found[0] == pytest.approx(k, abs=0.25 * 2 * np.pi / np.ptp(q))  # a quarter of the width of a line


# --- lines over time -------------------------------------------------------------------------------------------------


def coloured(n, seed):
    """Return noise with a smooth spectrum that falls by a hundred, and a speed with reversals."""
    rng = np.random.default_rng(seed)
    noise = np.convolve(rng.normal(size=n + 20), np.exp(-np.arange(21) / 5.0), "valid")
    return noise, np.sin(np.linspace(0.0, 40.0, n))


@pytest.mark.parametrize("f", [23.7, 50.0, 101.3])
def test_a_line_over_time_is_found_in_coloured_noise_and_friction(f):
    noise, v = coloured(5000, 1)
    t = np.arange(5000) * 1e-3
    found = timed_lines(noise + np.sin(2 * np.pi * f * t + 0.3) + 5.0 * np.sign(v) - 2.0 * v, v, 1e-3, 4.0)
    assert found == pytest.approx((f,), abs=0.05)  # a quarter of the width of a line


def test_the_false_alarm_rate_of_lines_over_time_is_as_stated():
    alarms = sum(bool(timed_lines(*coloured(3000, seed), 1e-3, 4.0)) for seed in range(300))
    assert alarms <= 9  # 3 expected of 300 at 1 %; more than 9 has the probability 0.001


# --- candidates ------------------------------------------------------------------------------------------------------

T = np.arange(1000) * 2e-3
U = np.sin(2 * np.pi * 1.3 * T) + 0.5 * np.sign(np.sin(2 * np.pi * 3.1 * T + 0.5))


def tried_with(plant, record):
    """Return the candidate effects by key."""
    model = ports_of(plant, record)
    found: dict[str, list] = {}
    for c in candidates(plant, model, [prepare(plant, model, record, window_length(plant, [record]))]):
        found.setdefault(c.key, []).append(c)
    return found


@cache
def tried(name: str, outputs: tuple[str, ...] = ()) -> dict[str, list]:
    plant = rl.plant(name)
    run = rl.simulate(plant, T, U)
    rng = np.random.default_rng(2)
    noisy = {s: y + 1e-4 * np.ptp(y) * rng.normal(size=len(T)) for s, y in run.outputs.items()}
    return tried_with(plant, rl.Record(run.t, run.inputs, {k: noisy[k] for k in outputs or noisy}, name="run"))


ELECTRICAL = {"brush-drop", "resistance", "resistance-heating", "torque-constant"}
AT_A_POSITION = {"bouc-wen", "cogging", "cubic-stiffness", "end-stop", "one-sided-spring",
                 "position-dependent-friction"}  # fmt: skip
USUAL = {"coulomb-friction", "sensor-delay"}


@pytest.mark.parametrize(
    ("plant", "outputs", "there", "absent"),
    [
        # The resolution is known noise and not an effect.
        ("servo-axis", (), USUAL | AT_A_POSITION | {"inertia", "input-delay"}, ELECTRICAL | {"quantisation"}),
        ("dc-motor", (), USUAL | ELECTRICAL, set()),
    ],
)  # fmt: skip
def test_the_candidates_are_the_effects_that_the_plant_and_its_record_can_have(plant, outputs, there, absent):
    found = {key.split("@")[0] for key in tried(plant, outputs)}
    assert there <= found
    assert not found & absent


def test_an_unrecorded_sensor_has_no_candidates_and_each_line_has_one():
    assert {key for key in tried("servo-axis", ("q",)) if key.startswith("sensor-") and not key.endswith("@q")} == set()
    lines = [c.scales.orders for c in tried("servo-axis")["cogging@v"]]
    assert len(set(lines)) == len(lines)
    assert all(len(k) == 1 for k in lines)


def test_a_one_sided_contact_has_candidates_on_both_sides_within_the_record():
    upper, lower = (c for c in tried("servo-axis")["one-sided-spring@v"])
    assert (upper.scales.side, lower.scales.side) == (1, -1)
    (both,) = tried("servo-axis")["end-stop@v"]
    for candidate, limits in ((upper, ["q0"]), (lower, ["q0"]), (both, ["q_min", "q_max"])):
        seen = candidate.scales
        for z in (-8.0, 0.0, 8.0):  # the limits of a fit
            values = candidate.values(np.full(len(candidate.parameters), z))
            assert all(seen.lowest <= values[name] <= seen.highest for name in limits)
            assert candidate.effect.id == "end-stop" or np.sign(values["k"]) == seen.side


def test_a_ripple_over_time_starts_at_its_line():
    axis = rl.with_effects(rl.plant("servo-axis"), {"torque-ripple": {"Ac": 5.0, "As": 5.0, "f": 41.0}})
    run = rl.simulate(axis, T, U)
    (found, *_) = tried_with(axis.plant, rl.Record(run.t, run.inputs, {"q": run["q"]}, name="run"))["torque-ripple@v"]
    assert found.starts == ({"Ac": 0.0, "As": 0.0, "f": pytest.approx(41.0, abs=0.15)},)
    without = [c.starts for c in tried("servo-axis")["torque-ripple@v"]]
    assert [s["f"] for s in without[0]] == [50.0, 100.0, 60.0, 120.0]
