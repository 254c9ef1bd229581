"""Input that plants and simulation reject, and its message."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics import Descriptor, LinearPlant, Parameter
from robustlab.statespace import Signal

T = np.arange(5) * 0.1
ONES = np.ones(5)


@pytest.mark.parametrize(
    ("name", "parameters", "words"),
    [
        ("dc-motr", {}, "did you mean dc-motor"),
        ("dc-motor", {"Rr": 1.0}, "did you mean R"),
        ("dc-motor", {"R": 0.0}, "'R': 0 ohm, expected a positive"),
        ("dc-motor", {"J": -1e-6}, "rotor inertia"),
        ("dc-motor", {"Kf": -1e-6}, "no negative value"),
        ("dc-motor", {"L": float("nan")}, "L: nan, expected a finite"),
        ("dc-motor", {"L": "small"}, "'small', expected a number in H"),
        ("dc-motor", {"L": [1.0, 0.1, 3.0]}, "3 entries"),
        ("dc-motor", {"L": np.array([1.0, 2.0])}, "a real number"),
        ("dc-motor", {"R": (2.07, 10)}, "did you mean 10% = 0.1?"),
        ("dc-motor", {"Km": (0.052, 5.0)}, "from -0.208 to 0.312 N m/A.*did you mean 5% = 0.05?"),
        ("dc-motor", {"Kb": (-0.052, 1.0)}, "must not change its sign"),
        ("servo-axis", {"gain": (35.0, 5)}, "did you mean 5% = 0.05?"),
        ("dc-motor", {"Km": (0.052, "5 V")}, "'5 V', expected a share of the value"),
        ("dc-motor", {"Km": "5%"}, "Km: '5%', expected a number in N m/A"),
        ("dc-motor", {"R": "2.1 V"}, "R: '2.1 V', expected a number in ohm"),
        ("dc-motor", {"R": (2.07, -0.1)}, "relative tolerance -0.1"),
        ("dc-motor", {"Km": (0.0, 0.1)}, "tolerance of the value 0"),
        ("two-mass", {"J2": -1.0}, "load's side"),
        ("mass-spring-damper", {"m": [1.0, 2.0], "k": [1.0]}, "equally many"),
        ("mass-spring-damper", {"m": []}, "at least one"),
        ("mass-spring-damper", {"m": [1.0, 0.0]}, "'m2'"),
        ("mass-spring-damper", {"mass": 1.0}, "no such parameter"),
        (["dc-motor"], {}, "no such plant"),
    ],
)
def test_bad_parameters(name, parameters, words):
    with pytest.raises(rl.InputError, match="(?s)" + words.replace("(", r"\(")) as caught:
        rl.plant(name, **parameters)
    assert caught.value.exit_code == 3


@pytest.mark.parametrize(
    ("given", "value", "tolerance"),
    [
        ({"R": "2.1 ohm"}, 2.1, 0.0),
        ({"R": "2.1Ω"}, 2.1, 0.0),
        ({"R": "2.1"}, 2.1, 0.0),
        ({"L": "0.62 mH"}, 0.62e-3, 0.0),
        ({"J": ("72 g cm2", "10 %")}, 7.2e-6, 0.1),
        ({"J": ("7.2e-6 kg m^2", "0.1")}, 7.2e-6, 0.1),
        ({"Km": ("0.05 N*m/A", "5%")}, 0.05, 0.05),
        ({"Km": ("52mN m/A", 0.05)}, 0.052, 0.05),
        ({"Km": (-0.052, 0.05)}, -0.052, 0.05),
        ({"Km": 0.0}, 0.0, 0.0),
    ],
)
def test_a_parameter_may_carry_its_unit_and_a_tolerance_a_percent_sign(given, value, tolerance):
    (name,) = given
    found = rl.plant("dc-motor", **given).parameters[name]
    assert (found.value, found.tolerance) == pytest.approx((value, tolerance), rel=1e-15)


@pytest.mark.parametrize(
    ("name", "ends", "words"),
    [
        *(("Km", ends, "does not hold 0") for ends in ((-0.2, 0.3), (0.0, 0.1), ("-0.2 N m/A", "0.3 N m/A"))),
        ("Q", (1.0, 2.0), "no such parameter"),
        ("R", (5.0, 6.0), "low < nominal < high"),
        ("R", (-1.0, 6.0), "a positive value"),
        ("R", (np.nan, 6.0), "finite"),
        ("R", (1.0, 2.0, 3.0), r"\(low, high\)"),
    ],
)
def test_bad_ranges(name, ends, words):
    with pytest.raises(rl.InputError, match=words):
        rl.plant("dc-motor").uncertain(ranges={name: ends})


def tank(equations, **values):
    parameters = {k: Parameter(k, v) for k, v in (values or {"p": 2.0}).items()}
    level = (Signal("h", "m"),)
    return LinearPlant("tank", parameters, (Signal("w"),), level, level, equations=equations)


@pytest.mark.parametrize(
    ("equations", "words"),
    [
        (lambda p: Descriptor([[1]], [[-1 / p["p"]]], [[1]], [[1]]), "division by a parameter"),
        (lambda p: Descriptor([[1]], [[-(p["p"] ** 2)]], [[1]], [[1]]), "F is not affine"),
        (lambda p: Descriptor([[1]], [[-1]], [[abs(p["p"] - 1)]], [[1]]), "G is not affine"),
        (lambda p: Descriptor([[p["p"] - 2.0]], [[-1]], [[1]], [[1]]), "E is singular"),
        (lambda p: Descriptor([[1, 0]], [[-1]], [[1]], [[1]]), r"E is \(1, 2\)"),
        (lambda p: Descriptor([[1]], [[np.nan]], [[1]], [[1]]), "NaN"),
    ],
)
def test_bad_equations(equations, words):
    with pytest.raises(rl.InputError, match=words):
        tank(equations)


MOTOR_INPUT_FAULTS = [
    ({"u": ONES, "v": ONES}, "no such input"),
    ({"U": ONES}, "did you mean u|one of u"),
    ({}, "no samples for input u"),
    ({"u": np.ones(4)}, "u: 4 samples, expected 5"),
    ({"u": 12.0}, "1 dimensions"),
    ({"u": [1, 1, np.nan, 1, 1]}, r"u\[2\] is NaN"),
    (np.ones(4), r"\(4, 1\)"),
    (np.ones((5, 2)), r"\(5, 2\)"),
    ([[1, 2], [3]], "ragged"),
]


@pytest.mark.parametrize(("u", "words"), MOTOR_INPUT_FAULTS)
def test_bad_inputs(u, words):
    with pytest.raises(rl.InputError, match=words):
        rl.simulate(rl.plant("dc-motor"), T, u)


MOTOR = rl.plant("dc-motor")


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: rl.simulate(MOTOR, [0, 1, 0.5], np.ones(3)), "runs backwards"),
        (lambda: rl.simulate(MOTOR, [0, 1, 1], np.ones(3)), "repeats the stamp"),
        (lambda: rl.simulate(MOTOR, [0, np.nan], np.ones(2)), r"t\[1\] is NaN"),
        (lambda: rl.simulate(MOTOR, T, ONES, [0, 0]), "x0 has 2 entries, expected 3"),
        (lambda: rl.simulate(MOTOR, T, ONES, hold="spline"), "zoh"),
        (lambda: rl.simulate("dc-motor", T, ONES), "StateSpaceModel"),
        (lambda: rl.linearise("dc-motor"), "a linear plant"),
        (lambda: rl.linearise(MOTOR, at=([0, 0], [0])), "2 numbers for phi, omega, i, expected 3"),
        (lambda: rl.linearise(MOTOR, at=3.0), "or None"),
    ],
)
def test_bad_clock_start_hold_and_point(call, words):
    with pytest.raises(rl.InputError, match=words):
        call()


def test_overflow_names_the_time():
    explosive = rl.StateSpaceModel([[100.0]], [[1.0]], [[1.0]], [[0.0]])
    with pytest.raises(rl.NoTrustworthyNumber, match=r"at t = 7.2 s") as caught:
        # e^(100 t) / 100 passes 1.8e308 between t = 7.1 and 7.2
        rl.simulate(explosive, np.arange(101) * 0.1, np.ones(101))
    assert caught.value.exit_code == 4
