"""Bad effects, bad places, bad files of plants: named, with the closest right name; no file of a plant is half read."""

import casadi as ca
import numpy as np
import pytest
from plant_files import maker

import robustlab as rl
from robustlab.dynamics import Descriptor, LinearPlant, Parameter
from robustlab.errors import DependencyMissing, InputError, NoTrustworthyNumber
from robustlab.files import content_sha256, read_tree, write_tree

T = np.arange(100) * 1e-3


def motor():
    return rl.plant("dc-motor")


def rubbed():
    return rl.with_effects(motor(), {"coulomb-friction": {"Fc": (2e-3, 1e-4)}, "input-delay": {"d": 2e-3}})


def tank():
    area = Parameter("area", 2.0, "m2")
    return LinearPlant(
        "tank", {"area": area}, (("inflow", "m3/s"),), (("h", "m"),), (("h", "m"),),
        lambda p: Descriptor([[p["area"]]], [[0.0]], [[1.0]], [[1.0]]),
    )  # fmt: skip


def platform():
    return rl.plant("stewart-platform")


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ({"coulomb-frction": {"Fc": 1.0}}, "did you mean coulomb-friction"),
        ({"coulomb-friction": {"F_c": 1.0}}, "no such parameter"),
        ({"coulomb-friction": {}}, "no value for 'Fc'"),
        ({"coulomb-friction": {"Fc": -1.0}}, "no negative friction level"),
        ({"coulomb-friction": {"Fc": float("nan")}}, "NaN"),
        ({"coulomb-friction": {"Fc": "much"}}, "number"),
        ({"coulomb-friction": {"Fc": (1.0, -0.1)}}, "standard deviation"),
        ({"coulomb-friction": {"Fc": (1.0, 0.1, 0.2)}}, "3 entries"),
        ({"coulomb-friction": 5e-3}, "a table of its parameters"),
        ({"coulomb-friction@omgea": {"Fc": 1.0}}, "did you mean omega"),
        ({"coulomb-friction": {"Fc": 1.0}, "coulomb-friction@omega": {"Fc": 1.0}}, "given twice"),
        ({"sensor-gain": {"s": 1.1}}, "3 places where it may sit: phi, omega, i"),
        ({}, "no effect"),
        ([3.0], "attached effects"),
    ],
)
def test_bad_effects_are_named(effects, message):
    with pytest.raises(rl.InputError, match=message):
        rl.with_effects(motor(), effects)


@pytest.mark.parametrize(
    ("make", "effect", "message"),
    [
        (tank, "coulomb-friction", "has no place for it"),
        (platform, "coulomb-friction", r"(?s)6 places where it may sit.*coulomb-friction@phidot_1"),
        (platform, "coulomb-friction@phidot_9", "no such place"),
        (platform, "brush-drop", "brush-drop"),
    ],
)
def test_effects_that_a_plant_cannot_have_are_refused(make, effect, message):
    with pytest.raises(rl.InputError, match=message):
        rl.with_effects(make(), {effect: {"U" if effect == "brush-drop" else "Fc": 1.0}})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"t": np.append(T[:-1], 0.2)}, "equal steps"),
        ({"x0": [0.0, 1.0]}, "2 numbers for phi, omega, i"),
        ({"hold": "foh"}, "'zoh'"),
        ({"rtol": 1e-6}, "no error control"),
        ({"step": -1.0}, "between 0 and 1"),
        ({"u": np.full(100, np.nan)}, "NaN"),
    ],
)
def test_bad_simulations_are_named(options, message):
    arguments = {"t": T, "u": np.ones(100), **options}
    with pytest.raises(rl.InputError, match=message):
        rl.simulate(rubbed(), arguments.pop("t"), arguments.pop("u"), **arguments)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"amplitude": {"omgea": 1.0}}, "did you mean omega"),
        ({"amplitude": {"omega": 0.0}}, "positive number"),
        ({"pade": 9}, "from 0 to 8"),
        ({"pade": 1.5}, "from 0 to 8"),
        ({"at": "rest"}, "a trim or"),
        ({"at": ([0.0], [0.0])}, "1 numbers"),
    ],
)
def test_bad_linearisations_are_named(options, message):
    with pytest.raises(rl.InputError, match=message):
        rl.linearise(rubbed(), **options)


def test_bad_trims_are_named():
    with pytest.raises(rl.InputError, match="'v'"):
        rl.trim(rubbed(), v=1.0)
    with pytest.raises(rl.InputError, match="NaN"):
        rl.trim(rubbed(), u=float("nan"))
    with pytest.raises(rl.NoTrustworthyNumber, match="no rest with u = 5"):
        rl.trim(rubbed(), u=5.0)


# --- files -----------------------------------------------------------------------------------------------------------


def spoilt(path, change):
    """A file of a plant that was changed and stamped again, as another program might write it."""
    rl.save(path, rubbed())
    tree = read_tree(path, None, None, False)
    change(tree)
    tree.attrs["content_sha256"] = content_sha256(tree)
    write_tree(path, tree)
    return path


def set_attr(place, name, value):
    return lambda tree: tree.find(place).attrs.update({name: value})


def put(place, name, value):
    return lambda tree: tree.find(place).put(name, value)


def drop(place, name):
    def change(tree):
        node = tree.find(place)
        (node.groups if name in node.groups else node.datasets).pop(name)

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (set_attr("effects/0", "id", "coulomb-frction"), "did you mean coulomb-friction"),
        (set_attr("effects/0", "site", "omgea"), "did you mean omega"),
        (set_attr("effects/0", "site_kind", "elbow"), "no such place"),
        (lambda tree: tree.find("effects/0").attrs.pop("id"), "attribute id is missing"),
        (put("effects/0", "value", np.array([np.nan])), "NaN"),
        (put("effects/0", "value", np.array([-1.0])), "no negative friction level"),
        (put("effects/0", "value", np.array(["much"])), "expected real numbers"),
        (put("effects/0", "value", np.array([1.0, 2.0])), "2 entries, expected 1"),
        (put("effects/0", "std", np.array([-1.0])), "standard deviation"),
        (put("effects/0", "name", np.array(["F_c"])), "no such parameter"),
        (drop("effects", "0"), "numbered from 0"),
        (set_attr("plant", "name", "dc-motr"), "did you mean dc-motor"),
        (lambda tree: tree.find("plant").attrs.pop("name"), "attribute name is missing"),
        (drop("plant", "parameters"), "missing /plant/parameters"),
        (drop("plant/parameters", "value"), "missing /plant/parameters/value"),
        (drop("", "plant"), "missing /plant"),
        (drop("", "A"), "missing /A"),
        (put("plant/parameters", "value", np.ones(2)), "2 entries, expected 6"),
        (put("plant/parameters", "name", np.array(["R", "L", "Km", "Kb", "Kf", "Jm"])), "did you mean"),
        (put("plant/parameters", "value", np.array([2.07, 6.2e-4, 0.052, 0.052, 4.8e-5, -1.0])), "positive"),
        (put("", "A", np.eye(3)), "/A is not the linear model of dc-motor"),
        (put("plant/parameters", "value", np.array([3.0, 6.2e-4, 0.052, 0.052, 4.8e-5, 7.2e-6])), "is not the linear"),
    ],
)
def test_damaged_files_of_plants_are_rejected_with_the_reason(tmp_path, change, message):
    path = spoilt(tmp_path / "p.h5", change)
    with pytest.raises(rl.InputError, match=message) as caught:
        rl.load(path, isolate=False)
    assert str(path) in str(caught.value)


@pytest.mark.slow
def test_a_motion_that_no_step_resolves_is_no_number():
    """A load that beats a thousand times within the shortest step."""
    plant = rl.with_effects(
        rl.plant("stewart-platform"),
        {f"coulomb-friction@phidot_{i}": {"Fc": 1.0} for i in range(1, 7)} | {"backlash@phidot_1": CLATTER},
    )
    u = np.zeros((40, 6))
    u[:, 0] = 0.3 * np.sign(np.sin(np.arange(40)))
    with pytest.raises(rl.NoTrustworthyNumber, match=r"steps of .* us still change the motion"):
        rl.simulate(plant, 1e-3 * np.arange(40), u)


CLATTER = {"gap": 1e-3, "share": 0.5, "f": 4e4}


# --- wrong equations of a user ----------------------------------------------------------------------------------------


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
    (lambda p, m, F, x, v: (p.motion(m, F), p.motion(m, F)), "motion: given twice"),
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
    (lambda p, x, v: p.output("x", x), "output 'x': given twice"),
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
