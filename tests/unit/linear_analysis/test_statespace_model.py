"""StateSpaceModel: accepted and refused input, its parts, and its exchange with python-control."""

import control
import numpy as np
import pytest

from robustlab.errors import InputError
from robustlab.statespace import Signal, StateSpaceModel, append, as_model, feedback, lower_lft

GOOD = {"A": np.diag([-1.0, -2.0, -3.0]), "B": np.ones((3, 2)), "C": np.ones((4, 3)), "D": np.zeros((4, 2))}


def build(**changed):
    return StateSpaceModel(**{**GOOD, **changed})


def spoilt(name, value):
    matrix = GOOD[name].copy()
    matrix[1, 1] = value
    return matrix


NO_MATRICES = (np.zeros(3), np.zeros((3, 3, 1)), np.eye(3) * 1j, [["a"]], np.eye(3, dtype=bool), [[1.0], [1.0, 2.0]])
NOT_FINITE = ((np.nan, "NaN"), (np.inf, "infinite"), (-np.inf, "infinite"))


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"A": np.zeros((3, 4))}, "(3, 3)"),
        ({"A": np.zeros((4, 4))}, "B is (3, 2), expected (4, 2)"),
        ({"B": np.zeros((2, 2))}, "(3, 2)"),
        ({"B": np.zeros((3, 1))}, "(3, 2)"),
        ({"C": np.zeros((4, 2))}, "(4, 3)"),
        ({"C": np.zeros((5, 3))}, "(4, 3)"),
        ({"D": np.zeros((4, 3))}, "B is (3, 2), expected (3, 3)"),
        ({"D": np.zeros((3, 2))}, "C is (4, 3), expected (3, 3)"),
        *(({n: spoilt(n, v)}, f"{n}[1,1] is {word} (1 of {GOOD[n].size}") for n in "ABCD" for v, word in NOT_FINITE),
        *(({"A": bad}, "A") for bad in NO_MATRICES),
        *(({"dt": dt}, "dt") for dt in (-0.1, np.nan, np.inf, True)),
        ({"inputs": ["u", "u"]}, "used twice"),
        ({"inputs": ["u"]}, "expected 2"),
        ({"inputs": ["u", "v" * 201]}, "201 characters"),
    ],
)
def test_each_part_is_checked_by_itself(changed, expected):
    with pytest.raises(InputError) as caught:
        build(**changed)
    assert expected in str(caught.value)


def test_names():
    model = build(inputs=[("u", "V"), "v"], outputs=[Signal(f"o{k}") for k in range(4)])
    assert model.inputs == (Signal("u", "V"), Signal("v", ""))


def test_arrays_are_copies_that_cannot_be_written():
    a = np.diag([-1.0, -2.0, -3.0])
    model = build(A=a)
    a[0, 0] = 5.0
    assert model.A[0, 0] == -1.0
    with pytest.raises(ValueError, match="read-only"):
        model.A[0, 0] = 1.0
    with pytest.raises(AttributeError):
        model.A = a


def test_select_keeps_names_order_and_matrices():
    rng = np.random.default_rng(0)
    model = build(B=rng.standard_normal((3, 2)), C=rng.standard_normal((4, 3)), D=rng.standard_normal((4, 2)))
    part = model.select(inputs=["u2"], outputs=["y3", "y1"])
    assert part.output_names == ("y3", "y1")
    np.testing.assert_array_equal(part.D, model.D[[2, 0]][:, [1]])
    with pytest.raises(InputError, match="did you mean"):
        model.select(outputs=["y11"])


def test_static_gain_works_everywhere():
    gain = StateSpaceModel(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((3, 0)), np.arange(6.0).reshape(3, 2))
    assert gain.spectral_abscissa() == -np.inf
    assert gain.is_stable()
    np.testing.assert_array_equal(gain.dc_gain(), gain.D)
    np.testing.assert_array_equal(as_model(gain.to_control()).D, gain.D)
    np.testing.assert_array_equal(append(gain, gain.renamed(["a", "b"], ["c", "d", "e"])).D, np.kron(np.eye(2), gain.D))


def test_dc_gain_by_hand_and_of_an_integrator():
    lag = StateSpaceModel([[-2.0]], [[1.0]], [[6.0]], [[1.0]])
    np.testing.assert_allclose(lag.dc_gain(), [[4.0]])
    np.testing.assert_allclose(StateSpaceModel([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.1).dc_gain(), [[4.0]])
    with pytest.raises(InputError, match="pole at zero frequency"):
        StateSpaceModel([[0.0]], [[1.0]], [[1.0]], [[0.0]]).dc_gain()


# --- python-control --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dt", [0.0, 0.25])
def test_round_trip_through_control(dt):
    rng = np.random.default_rng(1)
    whole = rng.standard_normal((4, 5))
    matrices = (whole[:3, :3], whole[:3, 3:], whole[3:, :3], whole[3:, 3:])
    model = StateSpaceModel(*matrices, dt, ["volts", "load"], ["speed"], ["a", "b", "c"])
    back = StateSpaceModel.from_control(model.to_control())
    for name in "ABCD":
        np.testing.assert_array_equal(getattr(back, name), getattr(model, name))
    assert (back.dt, back.input_names, back.output_names, back.state_names) == (
        dt, ("volts", "load"), ("speed",), ("a", "b", "c"),
    )  # fmt: skip


@pytest.mark.parametrize("dt", [None, True])
def test_unspecified_time_bases_are_refused(dt):
    system = control.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]], dt)
    with pytest.raises(InputError, match=f"dt={dt}"):
        StateSpaceModel.from_control(system)


# --- interconnection -------------------------------------------------------------------------------------------------


def test_sizes_of_interconnections():
    two = StateSpaceModel([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]])
    one = two.select(inputs=["u1"])
    with pytest.raises(InputError, match="1 x 2"):
        feedback(one, two)
    with pytest.raises(InputError, match="no larger than P"):
        lower_lft(one, two)


def test_algebraic_loop_without_solution_is_refused():
    one = StateSpaceModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[1.0]])
    with pytest.raises(InputError, match="not well posed"):
        feedback(one, one, sign=+1)
    np.testing.assert_allclose(feedback(one, one).D, [[0.5]])
