"""Bad effects, bad places, bad files of plants: named, with the closest right name; no file of a plant is half read."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics import Descriptor, LinearPlant, Parameter
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


def test_an_effect_without_any_place_is_refused():
    with pytest.raises(rl.InputError, match="has no place for it"):
        rl.with_effects(tank(), {"coulomb-friction": {"Fc": 1.0}})


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ({"coulomb-friction": {"Fc": 1.0}}, r"(?s)6 places where it may sit.*coulomb-friction@phidot_1"),
        ({"coulomb-friction@phidot_9": {"Fc": 1.0}}, "no such place"),
        ({"coulomb-friction@phidot_1": {"Fc": float("nan")}}, "Fc"),
        ({"coulomb-friction@phidot_1": {"Fc": -1.0}}, "no negative"),
        ({"brush-drop": {"U": 1.0}}, "brush-drop"),
    ],
)
def test_effects_that_the_nonlinear_platform_cannot_have_are_rejected(effects, message):
    with pytest.raises(rl.InputError, match=message):
        rl.with_effects(rl.plant("stewart-platform"), effects)


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
