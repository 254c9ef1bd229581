"""A user's nonlinear plant is restored from its file without CasADi; files with false claims."""

import subprocess
import sys

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plant_files import NAMES, maker

import robustlab as rl
from robustlab.dynamics import tape_of
from robustlab.files import Tree
from robustlab.storage import Problems, decode_plant, encode_plant


def trees(name="cart_pole", **given):
    tree = Tree(file="x.h5")
    encode_plant(tree, maker(name)(**given))
    return tree


def decoded(tree):
    return decode_plant(tree, Problems("x.h5"))


@pytest.mark.parametrize("name", NAMES)
def test_a_plant_comes_back_whole(name, tmp_path):
    plant = maker(name)()
    first = next(iter(plant.parameters))
    plant = plant.with_parameters(**{first: (1.1 * plant.values[first], 0.07)})
    rl.save(tmp_path / "x.h5", plant)
    again = rl.load(tmp_path / "x.h5", isolate=False)
    assert again.name == plant.name
    assert again.parameters == plant.parameters
    assert list(again.parameters) == list(plant.parameters)
    assert (again.inputs, again.outputs, again.states) == (plant.inputs, plant.outputs, plant.states)
    assert again.port_places == plant.port_places
    rng = np.random.default_rng(0)
    x, u = rng.uniform(0.1, 1.0, (9, len(plant.states))), rng.uniform(0.1, 1.0, (9, len(plant.inputs)))
    values = {first: rng.uniform(0.5, 1.5, 9)}
    for found, truth in zip(
        vars(again.local_models(x, u, values)).values(), vars(plant.local_models(x, u, values)).values(), strict=True
    ):
        np.testing.assert_array_equal(found, truth)
    t = np.linspace(0.0, 0.3, 31)
    inputs = np.ones((31, len(plant.inputs)))
    one, two = (rl.simulate(p, t, inputs, x[0]) for p in (plant, again))
    for signal in plant.outputs:
        np.testing.assert_array_equal(one[signal.name], two[signal.name])
    rl.save(tmp_path / "y.h5", again)  # and once more
    assert rl.load(tmp_path / "y.h5", isolate=False).parameters == plant.parameters


def test_it_is_read_where_there_is_no_casadi(tmp_path):
    rl.save(tmp_path / "x.h5", maker("quadrotor_height")())
    code = (
        "import sys; sys.modules['casadi'] = None\nimport robustlab as rl\n"
        f"plant = rl.load({str(tmp_path / 'x.h5')!r}, isolate=False)\nprint(round(rl.trim(plant).u[0], 3))"
    )
    found = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert found.stdout.strip() == "639.336"


# --- forged files ---------------------------------------------------------------------------------------------------


def put(tree, path, values):
    group, _, name = path.rpartition("/")
    found = tree.find(group)
    assert name in found.datasets
    found.datasets[name].values = np.asarray(values)


def changed(path, at, value):
    def change(tree):
        group, _, name = path.rpartition("/")
        values = np.array(tree.find(group).datasets[name].values)
        if values.dtype.kind == "U":
            values = values.astype("U40")
        values[at] = value
        put(tree, path, values)

    return change


def replaced(path, values):
    return lambda tree: put(tree, path, values)


def dropped(path):
    def drop(tree):
        group, _, name = path.rpartition("/")
        found = tree.find(group)
        found.datasets.pop(name, None)
        found.groups.pop(name, None)

    return drop


T = "plant/tapes"
FORGERIES = [
    (changed(f"{T}/rates/operations", 3, 99), "/plant/tapes/rates/operations: entry 3 is 99"),
    (changed(f"{T}/rates/left", 0, 10**6), "/plant/tapes/rates/left: entry 0 is 1000000"),
    (changed(f"{T}/models/right", 0, -7), "/plant/tapes/models/right: entry 0 is -7"),
    (changed(f"{T}/outputs/outputs", 0, 10**9), "/plant/tapes/outputs/outputs: entry 0"),
    (changed(f"{T}/models/constants", 0, np.nan), "/plant/tapes/models/constants: entry 0 is no finite number"),
    (replaced(f"{T}/rates/left", np.zeros(3, int)), "/plant/tapes/rates: 3 and .* arguments"),
    (replaced(f"{T}/rates/left", np.zeros((3, 3), int)), r"/plant/tapes/rates/left is of shape \(3, 3\)"),
    (replaced(f"{T}/rates/left", np.zeros(28)), "/plant/tapes/rates/left has dtype float64"),
    (replaced(f"{T}/rates/constants", ["a"]), "/plant/tapes/rates/constants has dtype .*, expected real numbers"),
    (replaced(f"{T}/rates/outputs", np.zeros(3, int)), "tape of rates: 12 inputs and 3 outputs, expected 12 and 4"),
    (dropped(f"{T}/rates"), "missing /plant/tapes/rates"),
    (dropped(f"{T}/places"), "missing /plant/tapes/places"),
    (changed(f"{T}/places/kind", 0, "wheel"), "/plant/tapes/places/kind: 'wheel', expected one of joint, current"),
    (changed(f"{T}/places/name", 0, "speed"), "place of a force: 'speed', expected a state"),
    (changed(f"{T}/places/name", 0, "omega"), "/plant/tapes/places/name: a place is there twice"),
    (replaced(f"{T}/places/unit", ["N"]), "unit has 1 entries, expected 2 as"),
    (replaced(f"{T}/places/unit", [1.0, 2.0]), "expected texts"),
    (changed("plant/parameters/role", 0, "intertia"), "/plant/parameters/role: 'intertia', expected one of inertia"),
    (changed("plant/parameters/sign", 0, "minus"), "/plant/parameters/sign: 'minus'"),
    (changed("plant/parameters/value", 0, -1.0), "a positive value"),
    (changed("plant/parameters/value", 0, np.nan), "finite"),
    (changed("plant/parameters/value", 0, 3.0), "A is not the linear model of cart-pole"),
    (changed("plant/parameters/name", 0, "m"), "a parameter is there twice"),
    (dropped("plant/parameters/role"), "missing /plant/parameters/role"),
    (dropped("plant/base"), "missing /plant/base"),
    (changed(f"{T}/models/operations", 0, 1), "is not the linear model of cart-pole|no trustworthy|is "),
]


@pytest.mark.parametrize("case", range(len(FORGERIES)))
def test_a_file_with_a_false_claim_is_rejected_by_name(case):
    forge, message = FORGERIES[case]
    tree = trees()
    forge(tree)
    with pytest.raises(rl.RobustlabError, match=message):
        decoded(tree)


ROWS = st.sampled_from(
    [(tape, row) for tape in ("rates", "outputs", "models") for row in ("operations", "left", "right")]
)


@settings(max_examples=60)
@given(place=ROWS, k=st.integers(0, 200), value=st.integers(-(2**63), 2**63 - 1) | st.integers(0, 60))
def test_no_number_in_a_tape_brings_it_down(place, k, value):
    """Refused, or another function of the same size: never a crash."""
    tree = trees("two_link_arm")
    tape, row = place
    group = tree.find(f"{T}/{tape}")
    values = np.array(group.datasets[row].values)
    if not len(values):
        return
    values[k % len(values)] = value
    group.datasets[row].values = values
    try:
        plant = decoded(tree)
        plant.derivative(np.full(4, 0.1), np.zeros(2))
    except rl.RobustlabError:
        pass


# --- whatever is written with elementary operations has, as a tape, the value and slopes that casadi give -------------


BINARY = (lambda a, b: a + b, lambda a, b: a - b, lambda a, b: a * b, lambda a, b: a / (2 + b**2), ca.atan2, ca.fmin)
UNARY = (
    ca.sin,
    ca.cos,
    ca.tanh,
    lambda a: a**2,
    lambda a: ca.sqrt(1 + a**2),
    ca.fabs,
    lambda a: -a,
    lambda a: ca.exp(-(a**2)),
)
STEP = st.tuples(st.integers(0, len(BINARY) + len(UNARY) - 1), st.integers(0, 60), st.integers(0, 60))


@settings(max_examples=60)
@given(steps=st.lists(STEP, min_size=1, max_size=60), still=st.integers(0, 3), seed=st.integers(0, 99))
def test_a_tape_is_the_expression(steps, still, seed):
    x = ca.SX.sym("x", 3)
    made = [x[0], x[1], x[2], ca.SX(1.5)]
    for op, i, j in steps:
        a, b = made[i % len(made)], made[j % len(made)]
        made.append(BINARY[op](a, b) if op < len(BINARY) else UNARY[op - len(BINARY)](a))
    y = ca.vertcat(*made[-3:])
    y = ca.vertcat(y, ca.vec(ca.jacobian(y, x)))
    points = np.random.default_rng(seed).normal(size=(4, 3))
    points[1, -1] = points[0, -1]
    truth = ca.Function("f", [x], [y])
    expected = np.array([truth(p).full().ravel() for p in points])
    np.testing.assert_allclose(tape_of(x, y, still, "test")(points), expected, rtol=1e-12, atol=1e-12)
