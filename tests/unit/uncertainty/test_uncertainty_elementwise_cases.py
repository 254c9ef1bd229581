"""Element-wise uncertainty: names, errors, the thesis' column form, noise, the generalised plant."""

import re

import numpy as np
import pytest

import robustlab as rl
from robustlab import elementwise, frequency_response, generalized_plant
from robustlab.cli import main
from robustlab.errors import InputError, UnitMismatch
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty import STRUCTURES, elementwise_cover, endpoint_residual

A = np.array([[-6.0, 7200.0], [-84.0, -3300.0]])
B, C, D = np.array([[0.0], [1600.0]]), np.eye(2), np.zeros((2, 1))
SIGNALS = {
    "inputs": [("u", "V")],
    "outputs": [("omega", "rad/s"), ("i", "A")],
    "states": [("omega", "rad/s"), ("i", "A")],
}


def motor(a=A, b=B, c=C, d=D, dt=0.0, **signals):
    return StateSpaceModel(a, b, c, d, dt, **{**SIGNALS, **signals})


def test_columns_are_the_thesis_form():
    """Equation 10.13: M12 = I (the changed columns of it), M21 = A_D, M11 = 0."""
    perturbed = motor(a=A * [[1.1], [0.9]] + [[0.0, 1.0], [2.0, 0.0]])
    model = elementwise(motor(), perturbed, "columns")
    np.testing.assert_array_equal(model.M.B[:, :2], perturbed.A - A)
    np.testing.assert_array_equal(model.M.C[:2], np.eye(2))
    assert not model.M.D.any()
    halfway = model.evaluate({"A[:,omega]": 0.5})
    np.testing.assert_allclose(halfway.A[:, 0], A[:, 0] + 0.5 * (perturbed.A - A)[:, 0])
    np.testing.assert_array_equal(halfway.A[:, 1], A[:, 1])


@pytest.mark.parametrize("structure", STRUCTURES)
def test_equal_models_give_no_uncertainty(structure):
    model = elementwise(motor(), motor(), structure)
    assert model.blocks == ()
    np.testing.assert_array_equal(model.evaluate({}).A, A)
    np.testing.assert_array_equal(model.response([1.0], {}), frequency_response(motor(), [1.0]))
    assert model.reduce().blocks == ()
    assert generalized_plant(model, measurements=["omega"], controls=["u"]).model.n_inputs == 1
    assert endpoint_residual(model, motor()) == 0.0


@pytest.mark.parametrize("structure", STRUCTURES)
def test_static_gains_and_empty_ports(structure):
    empty = np.zeros((0, 0))
    first = StateSpaceModel(empty, np.zeros((0, 2)), np.zeros((1, 0)), [[1.0, 2.0]])
    second = StateSpaceModel(empty, np.zeros((0, 2)), np.zeros((1, 0)), [[1.5, 1.0]])
    model = elementwise(first, second, structure)
    np.testing.assert_array_equal(model.evaluate({b.name: 1.0 for b in model.blocks}).D, [[1.5, 1.0]])
    nothing = StateSpaceModel(empty, np.zeros((0, 0)), empty, empty)
    assert elementwise(nothing, nothing, structure).blocks == ()


@pytest.mark.parametrize("structure", ["matrices", "single"])
def test_a_difference_of_one_rounding_is_not_lost(structure):
    other = A.copy()
    other[0, 1] = np.nextafter(A[0, 1], np.inf)
    model = elementwise(motor(), motor(a=other), structure)
    assert model.delta_shape == (1, 1)
    np.testing.assert_array_equal(model.evaluate({model.blocks[0].name: 1.0}).A, other)


@pytest.mark.parametrize(
    ("other", "text"),
    [
        (StateSpaceModel(np.eye(3), np.ones((3, 1)), np.ones((2, 3)), D), r"A is \(3, 3\), expected \(2, 2\)"),
        (
            StateSpaceModel(A, np.ones((2, 2)), C, np.zeros((2, 2))),
            r"B is \(2, 2\), expected \(2, 1\) to match nominal B",
        ),
        (StateSpaceModel(A, B, np.ones((1, 2)), np.zeros((1, 1))), r"perturbed C is \(1, 2\), expected \(2, 2\)"),
        (motor(dt=0.1), "dt = 0.1 s, expected 0 s"),
        (motor(inputs=["volts"]), "perturbed inputs are volts, expected u"),
        (motor(outputs=["i", "omega"]), "select"),
        (motor(states=["omega", "j"]), "perturbed states"),
    ],
)
def test_models_that_do_not_match(other, text):
    with pytest.raises(InputError, match=text):
        elementwise(motor(), other)


def test_units_that_disagree():
    with pytest.raises(UnitMismatch, match="omega is in deg/s, expected rad/s"):
        elementwise(motor(), motor(outputs=[("omega", "deg/s"), ("i", "A")]))
    assert elementwise(motor(), motor(outputs=["omega", ("i", "A")])).blocks == ()


@pytest.mark.parametrize(("structure", "tolerance"), [("element", None), ("single", -0.1), ("single", 1.0)])
def test_invalid_options(structure, tolerance):
    with pytest.raises(InputError):
        elementwise(motor(), motor(), structure, tolerance)


def test_a_tolerance_reveals_the_rank_under_noise():
    rng = np.random.default_rng(2)
    n = 12
    nominal = rng.standard_normal((n, n))
    change = rng.standard_normal((n, 3)) @ rng.standard_normal((3, n))
    noisy = nominal + change + 1e-10 * rng.standard_normal((n, n))
    first, second = (StateSpaceModel(a, np.zeros((n, 1)), np.zeros((1, n)), [[0.0]]) for a in (nominal, noisy))
    assert elementwise(first, second, "single").delta_shape[0] == n
    coarse = elementwise(first, second, "single", tolerance=1e-8)
    assert coarse.delta_shape[0] == 3
    assert 1e-13 < endpoint_residual(coarse, second) < 1e-8


# --- generalised plant -----------------------------------------------------------------------------------------------


def test_generalised_plant_is_m_sorted():
    two = {"inputs": ["load", "u"], "outputs": ["omega", "i", "p"], "states": ["omega", "i"]}
    rng = np.random.default_rng(0)
    b, c, d = rng.standard_normal((2, 2)), rng.standard_normal((3, 2)), rng.standard_normal((3, 2))
    first, second = StateSpaceModel(A, b, c, d, **two), StateSpaceModel(1.1 * A, 1.2 * b, 0.9 * c, 1.3 * d, **two)
    model = elementwise(first, second, "matrices")
    plant = generalized_plant(model, controls=["u"], measurements=["p", "omega"], performance=["i"]).model
    q = model.delta_shape[0]
    assert plant.input_names[q:] == ("load", "u")
    assert plant.output_names[q:] == ("i", "p", "omega")
    assert plant.input_names[:q] == model.M.input_names[:q]
    # D-bar, the block that is missing in print, is there: the nominal direct term and the channels of D_D.
    np.testing.assert_array_equal(plant.D[q:, q:], d[[1, 2, 0]][:, [0, 1]])
    reached = rl.UncertainModel(plant, model.blocks).evaluate({b.name: 1.0 for b in model.blocks})
    wanted = frequency_response(second.select(["load", "u"], ["i", "p", "omega"]), [0.5, 30.0])
    np.testing.assert_allclose(frequency_response(reached, [0.5, 30.0]), wanted, rtol=1e-9)


def test_one_block_for_each_cause():
    rng = np.random.default_rng(3)
    base = rng.standard_normal((5, 5))
    low, high = (rng.standard_normal((5, r)) @ rng.standard_normal((r, 5)) for r in (1, 2))
    wholes = (base, base + low, base + high)
    nominal, one, two = (StateSpaceModel(x[:3, :3], x[:3, 3:], x[3:, :3], x[3:, 3:]) for x in wholes)
    both = rl.elementwise(nominal, {"mass": one, "pose": two, "nothing": nominal})
    assert [(b.name, b.repeats) for b in both.blocks] == [("mass", 1), ("pose", 2)]
    member = both.evaluate({"mass": 0.5, "pose": -1.0})
    found = np.block([[member.A, member.B], [member.C, member.D]])
    np.testing.assert_allclose(found, base + 0.5 * low - high, atol=1e-13)
    with pytest.raises(InputError, match="no cause"):
        rl.elementwise(nominal, {})
    with pytest.raises(InputError, match="perturbed A is"):
        rl.elementwise(nominal, {"mass": StateSpaceModel([[1.0]], [[1.0]], [[1.0]], [[0.0]])})


@pytest.mark.parametrize(
    ("pole", "gain", "remark"),
    [
        (0.5, 1.0, "the perturbed model is not stable, the nominal one is: pole 0.5"),
        (-1.0, 1.0, "no uncertainty: the two models are equal"),
        (-1.0, 1e30, r"an entry of 1e\+30"),
    ],
)
def test_a_doubtful_pair_gives_a_warning(pole, gain, remark, tmp_path, capsys):
    nominal, perturbed = (rl.StateSpaceModel([[a]], [[b]], [[1.0]], [[0.0]]) for a, b in ((-1.0, 1.0), (pole, gain)))
    with pytest.warns(UserWarning, match=remark):
        rl.elementwise(nominal, perturbed)
    files = [str(tmp_path / name) for name in ("nominal.h5", "perturbed.h5", "set.h5")]
    rl.save(files[0], nominal)
    rl.save(files[1], perturbed)
    assert main.run_command(["uncertain", "build", *files[:2], "--out", files[2]]) == 0
    assert re.search(f"warning: {remark}", capsys.readouterr().err)


# --- the cover: each member of the set is one of it, with a Delta of norm at most one ---------------------------------


def pair():
    rng = np.random.default_rng(3)
    shapes = ((4, 4), (4, 2), (3, 4), (3, 2))
    first = [rng.standard_normal(s) for s in shapes]
    change = [0.3 * rng.standard_normal(s) * (rng.random(s) < 0.6) for s in shapes]
    change[0][1], change[2][:, 0] = 0.0, 0.0
    return StateSpaceModel(*first), StateSpaceModel(*(a + b for a, b in zip(first, change, strict=True)))


def test_every_member_of_the_set_is_in_the_cover():
    nominal, perturbed = pair()
    entries, cover = rl.elementwise(nominal, perturbed, "elements"), elementwise_cover(nominal, perturbed)
    rng = np.random.default_rng(4)
    for _ in range(20):
        member = entries.evaluate({b.name: rng.choice([-1.0, 1.0, 0.3]) for b in entries.blocks})
        delta = {}
        for b in cover.blocks:
            kind = b.name
            size = np.abs(getattr(perturbed, kind) - getattr(nominal, kind))
            rows, columns = np.flatnonzero(size.any(axis=1)), np.flatnonzero(size.any(axis=0))
            change = (getattr(member, kind) - getattr(nominal, kind))[np.ix_(rows, columns)]
            delta[kind] = change / np.linalg.norm(size, 2)
            assert np.linalg.norm(delta[kind], 2) <= 1 + 1e-12
        again = cover.evaluate(delta)
        for kind in "ABCD":
            np.testing.assert_allclose(getattr(again, kind), getattr(member, kind), atol=1e-12)


def test_equal_models_have_no_block():
    nominal, _ = pair()
    assert elementwise_cover(nominal, nominal).blocks == ()


def test_mu_of_the_cover_is_above_that_of_the_set():
    A = [[-1.0, 0.5], [0.0, -2.0]]
    nominal = StateSpaceModel(A, [[1.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    perturbed = StateSpaceModel([[-0.8, 0.7], [0.1, -1.7]], [[1.0], [1.1]], [[1.0, 0.0]], [[0.0]])
    small = rl.robust_performance(rl.elementwise(nominal, perturbed, "elements"))
    large = rl.robust_performance(elementwise_cover(nominal, perturbed))
    assert large.lower <= small.upper
