"""The uncertain model of a plant equals the plant rebuilt with those parameter values, for any deltas."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab.dynamics import Descriptor, LinearPlant, Parameter
from robustlab.statespace import Signal

QUICK = settings(max_examples=40)
PLANTS = {
    "dc-motor": {"R": 0.1, "L": 0.2, "Km": 0.1, "Kb": 0.15, "Kf": 0.35, "J": 0.25},
    "servo-axis": {"M": 0.2, "Fv": 0.3, "gain": 0.1},
    "two-mass": {"J1": 0.1, "J2": 0.3, "c": 0.5, "k": 0.2},
    "mass-spring-damper": {"m1": 0.3, "m2": 0.2, "c1": 0.4, "c2": 0.4, "c3": 0.4, "k1": 0.3, "k3": 0.2},
}
CHAIN = {"m": [1.0, 2.0, 3.0], "c": 0.5, "k": [10.0, 20.0, 5.0]}


def toleranced(name: str):
    nominal = rl.plant(name, **CHAIN if name == "mass-spring-damper" else {})
    return nominal.with_parameters(**{k: (nominal.values[k], tol) for k, tol in PLANTS[name].items()})


def assert_same(left, right, rtol=1e-12):
    """Entry by entry, relative to what was added up in that entry: to the largest in its row."""
    for name in "ABCD":
        a, b = getattr(left, name), getattr(right, name)
        scale = np.abs(b).max(axis=1, initial=0.0, keepdims=True)
        assert (np.abs(a - b) <= rtol * scale).all(), (name, a, b)


def check(plant, deltas):
    uncertain = plant.uncertain()
    values = {k: v for k, (v, _) in uncertain.physical(deltas).items()}
    assert_same(uncertain.evaluate(deltas), plant.with_parameters(**values).state_space())


@pytest.mark.parametrize("name", list(PLANTS))
@QUICK
@given(data=st.data())
def test_evaluated_lft_is_the_rebuilt_plant(name, data):
    plant = toleranced(name)
    blocks = plant.uncertain().blocks
    assert [(b.name, b.repeats) for b in blocks] == [(k, 1) for k in PLANTS[name]]
    # up to 1.9 times the range: beyond it, but still positive masses and resistances
    deltas = {b.name: data.draw(st.floats(-1.9, 1.9, allow_subnormal=False)) for b in blocks}
    check(plant, deltas)


def test_thesis_equations_10_1_to_10_4():
    """With absolute deltas: the current's row -(dR i + dKb w + dL di/dt) / L; the speed's (dKm i - dKf w - dJ w') / J.

    The printed coefficients -1, +1 are right only for deltas that are divided by L and J beforehand.
    """
    plant = toleranced("dc-motor")
    model = plant.uncertain(outputs=["omega", "i"])
    value, radius = plant.values, {k: p.radius for k, p in plant.parameters.items()}
    assert model.M.state_names == ("omega", "i")
    by_name = dict(zip([b.name for b in model.blocks], range(6), strict=True))
    b, c = model.M.B, model.M.C
    for k in ("R", "L", "Kb"):
        np.testing.assert_allclose(b[:, by_name[k]], [0, -1 / value["L"]], rtol=1e-14)
    for k, sign in (("Km", 1), ("Kf", -1), ("J", -1)):
        np.testing.assert_allclose(b[:, by_name[k]], [sign / value["J"], 0], rtol=1e-14)
    np.testing.assert_allclose(c[by_name["R"]], [0, radius["R"]], rtol=1e-14)
    np.testing.assert_allclose(c[by_name["Km"]], [0, radius["Km"]], rtol=1e-14)
    np.testing.assert_allclose(c[by_name["Kf"]], [radius["Kf"], 0], rtol=1e-14)
    np.testing.assert_allclose(
        c[by_name["L"]], radius["L"] / value["L"] * np.array([-value["Kb"], -value["R"]]), rtol=1e-14
    )


def test_parameter_in_outputs_and_of_higher_rank():
    """Not only E, F, G: a sensor gain, a feed-through, and a parameter that occurs in two independent equations."""

    def equations(p):
        return Descriptor(
            E=[[p["m"], 0], [0, p["m"]]],
            F=[[-1, p["a"]], [-p["a"], -2]],
            G=[[1], [p["s"]]],
            C=[[p["s"], 0], [0, 1]],
            D=[[p["s"]], [0]],
        )

    parameters = {k: Parameter(k, v, tolerance=0.2) for k, v in {"m": 2.0, "a": 3.0, "s": 0.5}.items()}
    plant = LinearPlant(
        "box",
        parameters,
        (Signal("u"),),
        (Signal("y1"), Signal("y2")),
        (Signal("x1"), Signal("x2")),
        equations=equations,
    )
    assert [(b.name, b.repeats) for b in plant.uncertain().blocks] == [("m", 2), ("a", 2), ("s", 2)]
    check(plant, {"m": -0.7, "a": 1.3, "s": -2.0})


def test_coupled_left_hand_side():
    """A full mass matrix: E is not diagonal, and the shared inertia acts in two equations with rank one."""

    def equations(p):
        return Descriptor(
            E=[[p["J1"] + p["J12"], p["J12"]], [p["J12"], p["J2"] + p["J12"]]],
            F=[[-1, 0], [0, -1]],
            G=[[1], [0]],
            C=[[1, 0], [0, 1]],
        )

    parameters = {
        k: Parameter(k, v, tolerance=0.3, sign="positive") for k, v in {"J1": 1.0, "J2": 2.0, "J12": 0.4}.items()
    }
    names = (Signal("w1"), Signal("w2"))
    plant = LinearPlant("pair", parameters, (Signal("T"),), names, names, equations=equations)
    assert [b.repeats for b in plant.uncertain().blocks] == [1, 1, 1]
    check(plant, {"J1": 1.0, "J2": -1.0, "J12": 2.0})


@pytest.mark.parametrize("name", list(PLANTS))
def test_ranges_that_are_not_symmetric(name):
    plant = toleranced(name)
    key = next(iter(PLANTS[name]))
    value = plant.values[key]
    model = plant.uncertain(ranges={key: (0.7 * value, 1.1 * value)})
    assert model.blocks[0].parameter.ratio == pytest.approx(3.0)
    others = list(PLANTS[name])[1:]
    for delta, factor in ((1.0, 1.1), (-1.0, 0.7), (-0.5, 0.85), (0.5, 1.05)):
        deltas = {key: delta, **dict.fromkeys(others, 0.3)}
        values = {k: v for k, (v, _) in model.physical(deltas).items()}
        assert values[key] == pytest.approx(factor * value, rel=1e-14)
        assert_same(model.evaluate(deltas), plant.with_parameters(**values).state_space())
