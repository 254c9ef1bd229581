"""Wrong equations of a user: each an error of one line that names the fault."""

import casadi as ca
import numpy as np
import pytest
from plant_files import maker

import robustlab as rl
from robustlab.errors import DependencyMissing, InputError, NoTrustworthyNumber


def begun():
    p = rl.PlantEquations("bad")
    return p, p.parameter("m", 2.0, "kg"), p.input("F", "N"), *p.joint("x", "v", "m")


def moving():
    p, m, f, x, v = begun()
    p.motion(m, f)
    p.output("x", x, "m")
    return p, x, v


def made(write, p, *symbols):
    write(p, *symbols)
    return p.plant()


EQUATIONS = [
    (lambda p, m, F, x, v: None, r"'v': the velocity of a joint without a rate, .*p.motion"),
    (lambda p, m, F, x, v: p.motion([[m, 0], [0, m]], [F]), r"mass matrix: shape \(2, 2\)"),
    (lambda p, m, F, x, v: p.motion(m, [F, F]), r"forces: shape \(2, 1\)"),
    (lambda p, m, F, x, v: p.motion(-m, F), "eigenvalue of -2, expected a positive definite matrix"),
    (lambda p, m, F, x, v: p.motion(m, F - ca.SX.sym("a")), r"symbol 'a' is no part .*\nhint: .*algebraic loop"),
    (lambda p, m, F, x, v: p.motion(m, F - ca.SX.sym("vv")), r"symbol 'vv' is no part .*\nhint: did you mean v"),
    (lambda p, m, F, x, v: p.motion(m, F - float("nan") * x), "the rate of v: the number nan"),
    (lambda p, m, F, x, v: p.motion(m, F - float("inf") * x), "the rate of v: the number inf"),
    (lambda p, m, F, x, v: p.motion(m, F - ca.floor(x)), "the rate of v: operation floor, expected one of add, "),
    (lambda p, m, F, x, v: p.motion(m, "F"), "motion: forces: str"),
    (lambda p, m, F, x, v: p.motion(m, None), "motion: forces: NoneType"),
    (lambda p, m, F, x, v: p.motion(ca.MX.sym("m"), F), "an MX expression"),
    (lambda p, m, F, x, v: p.rate(v, F / m), r"no force can act there: .*p.force\(\"v\"\)"),
    (lambda p, m, F, x, v: p.rate(v, F / m + p.force("v") ** 2), "does not enter the rates linearly"),
    (lambda p, m, F, x, v: p.rate(v, F / m + 0 * p.force("v")), "'v': a force that moves nothing"),
    (lambda p, m, F, x, v: p.rate(v, F / m + p.force("x")), "'x': no velocity of a joint, expected one of 'v'"),
    (lambda p, m, F, x, v: p.rate("vv", F / m), "rate: 'vv' is no state"),
    (lambda p, m, F, x, v: p.rate(2 * x, F / m), "is no state"),
    (lambda p, m, F, x, v: p.rate(ca.vertcat(x, v), F / m), "is no state"),
    (lambda p, m, F, x, v: p.rate(3, F / m), "'3' is no state"),
    (lambda p, m, F, x, v: p.motion([[m], [m, m]], F), "mass matrix: list"),
    (lambda p, m, F, x, v: p.motion(m, F / 0), "the rate of v: the number inf"),
    (lambda p, m, F, x, v: p.rate(x, v), "none: it is 'v'"),
    (lambda p, m, F, x, v: (p.rate(v, F + p.force("v")), p.rate(v, F)), "'v' has two rates"),
    (lambda p, m, F, x, v: (p.motion(m, F), p.motion(m, F)), "motion: said twice"),
    (lambda p, m, F, x, v: (p.motion(m, F), p.rate(v, F / m)), "p.rate and p.motion for one joint"),
    (lambda p, m, F, x, v: (p.motion(m, F), p.joint("a", "b", "rad")), "of 1 joints, and 1 came later"),
    (lambda p, m, F, x, v: (p.motion(m, F), p.force("v")), "none: it acts by itself"),
]


@pytest.mark.parametrize("case", range(len(EQUATIONS)))
def test_equations_that_are_none(case):
    write, message = EQUATIONS[case]
    p, m, f, x, v = begun()
    p.output("x", x, "m")
    with pytest.raises(InputError, match=message) as caught:
        made(write, p, m, f, x, v)
    assert caught.value.line.startswith("bad: ")
    assert "\n" not in caught.value.line


THINGS = [
    (lambda p, x, v: p.state("z"), "'z': a state without a rate"),
    (lambda p, x, v: p.state("i", "mA", current=True), "a current in 'mA'"),
    (lambda p, x, v: p.rate(p.state("i", "A", current=True), -x), "no voltage can act there"),
    (lambda p, x, v: p.voltage("v"), "'v': no current, expected one of none"),
    (lambda p, x, v: p.joint("a", "b", "deg"), "joint 'a': unit 'deg'"),
    (lambda p, x, v: p.parameter("k", 1, tolerance=0.1), "a tolerance, but no role, .*'inertia', .*'none'"),
    (lambda p, x, v: p.parameter("k", 1, role="intertia"), r"role 'intertia', .*\nhint: did you mean inertia"),
    (lambda p, x, v: p.parameter("k", 1, sign="negative"), "sign 'negative'"),
    (lambda p, x, v: p.parameter("k", -1.0, role="inertia"), "a positive value"),
    (lambda p, x, v: p.parameter("k", float("nan")), "k: nan"),
    (lambda p, x, v: p.parameter("x", 1), "'x': a name that is used already"),
    (lambda p, x, v: p.output("x", x), "output 'x': said twice"),
    (lambda p, x, v: p.output("y", [x, v]), r"output y: shape \(2, 1\), expected one expression"),
    (lambda p, x, v: p.output("", x), "output ''"),
    (lambda p, x, v: p.input(3), "input 3"),
    (lambda p, x, v: p.input("u", None), "input 'u': unit None, expected a text"),
    (lambda p, x, v: p.state("s", 3), "state 's': unit 3, expected a text"),
    (lambda p, x, v: p.output("y", x, None), "output 'y': unit None, expected a text"),
    (lambda p, x, v: p.parameter("k", 1, 3), "parameter 'k': unit 3, expected a text"),
    (lambda p, x, v: p.joint("k", "k", "m"), "'k': a name that is used already"),
    (lambda p, x, v: p.input("u" * 300), "1 to 200 characters"),
    (lambda p, x, v: p.plant(M=1.0), r"'M': no such parameter, expected one of m"),
    (lambda p, x, v: p.plant(m="1 V"), "m: '1 V', expected a number in kg"),
]


@pytest.mark.parametrize("case", range(len(THINGS)))
def test_things_that_are_none(case):
    write, message = THINGS[case]
    p, x, v = moving()
    with pytest.raises(InputError, match=message):
        made(write, p, x, v)


def test_a_plant_without_a_name_states_or_outputs():
    with pytest.raises(InputError, match="name of the plant ''"):
        rl.PlantEquations("")
    p = rl.PlantEquations("empty")
    with pytest.raises(InputError, match="no joint"):
        p.motion(1.0, 1.0)
    with pytest.raises(InputError, match="no state"):
        p.plant()
    p.rate(p.state("z"), 1.0)
    with pytest.raises(InputError, match="no output"):
        p.plant()


def test_without_casadi_the_extra_is_named(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(DependencyMissing, match=r"robustlab\[casadi\]"):
        rl.PlantEquations("tank")


# --- the plant -------------------------------------------------------------------------------------------------------


def test_a_trim_that_cannot_be():
    plant = moving()[0].plant()
    with pytest.raises(InputError, match=r"'vv': no state, input or output, .*\nhint: did you mean v\?"):
        rl.trim(plant, vv=1)
    with pytest.raises(InputError, match="real numbers"):
        rl.trim(plant, x="a")
    with pytest.raises(InputError, match="finite"):
        rl.trim(plant, x=np.nan)
    with pytest.raises(NoTrustworthyNumber, match="no rest was found with v = 1: the rate of x stays off"):
        rl.trim(plant, v=1.0)
    with pytest.raises(NoTrustworthyNumber, match="the rate of v stays off"):
        rl.trim(plant, F=1.0)


def test_points_and_values_of_other_shapes():
    plant, x, u = moving()[0].plant(), np.zeros((3, 2)), np.zeros((3, 1))
    with pytest.raises(InputError, match="n: no such parameter"):
        plant.local_models(x, u, {"n": 1.0})
    with pytest.raises(InputError, match=r"u: shape \(2, 1\), expected \(3, 1\)"):
        plant.local_models(x, u[:2])
    with pytest.raises(InputError, match=r"m: shape \(2,\), expected one value, or 3"):
        plant.local_models(x, u, {"m": [1.0, 2.0]})
    with pytest.raises(NoTrustworthyNumber, match="the rate of v is nan at point 1 of 3"):
        plant.local_models(x, u, {"m": [1.0, 0.0, 2.0]})


def test_where_an_equation_has_no_value_it_is_named():
    tank = maker("water_tank")()
    with pytest.raises(NoTrustworthyNumber, match=r"the slope of the rate of h_1 by h_1 is .* at point 1 of 2"):
        tank.local_models(np.array([[0.1, 0.1], [0.0, 0.1]]), np.zeros((2, 1)))
    p = rl.PlantEquations("root")
    x = p.state("x")
    p.rate(x, -ca.sqrt(x) - 1)
    p.output("y", ca.log(x))
    plant = p.plant()
    with pytest.raises(NoTrustworthyNumber, match=r"root: output y is -inf at x = 0"):
        plant.output([0.0], [])
    with pytest.raises(NoTrustworthyNumber, match=r"beyond t = 0\.\d+ s: the rate of x has no finite value there"):
        plant.trajectory(_signal(1.0, 0), np.array([0.25]), 1e-8)


def test_an_escape_in_finite_time_is_an_error():
    p = rl.PlantEquations("escape")
    x = p.state("x")
    p.rate(x, x**2)
    p.output("x", x)
    with pytest.raises(NoTrustworthyNumber, match=r"no solution beyond t = (0\.99999|1) ?"):
        p.plant().trajectory(_signal(2.0, 0), np.array([1.0]), 1e-8)


def _signal(end, n_u):
    from robustlab.dynamics import input_signal

    t = np.linspace(0.0, end, 11)
    return input_signal(t, np.zeros((11, n_u)), "zoh")
