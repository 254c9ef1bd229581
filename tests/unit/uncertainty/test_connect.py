"""rl.connect: against python-control's interconnect, closed forms, and errors in one line."""

import control
import numpy as np
import pytest

import robustlab as rl
from robustlab.errors import InputError

OMEGA = np.array([0.0, 0.3, 2.0, 40.0])


def lag(pole, inp, out, gain=1.0, direct=0.0, dt=0.0):
    return rl.StateSpaceModel([[pole]], [[gain]], [[1.0]], [[direct]], dt, [inp], [out])


def gain(value, inp, out):
    return rl.StateSpaceModel([], [], [], [[value]], inputs=[inp], outputs=[out])


def stiffness(name="k"):
    """k / (s + 2) with k in [1 - 0.5, 1 + 0.5]."""
    m = rl.StateSpaceModel([[-2.0]], [[0.5, 1.0]], [[0.0], [1.0]], [[0.0, 1.0], [0.0, 0.0]])
    return rl.UncertainModel(m.renamed(["w", "u"], ["z", "y"]), [rl.RealScalar(name)])


def test_a_loop_is_that_of_python_control():  # which solves no algebraic loop: no direct path from u
    rng = np.random.default_rng(3)
    plant = rl.StateSpaceModel(
        rng.standard_normal((3, 3)) - 2 * np.eye(3), rng.standard_normal((3, 2)), rng.standard_normal((2, 3)),
        rng.standard_normal((2, 2)) * [0.0, 1.0], inputs=["u", "d"], outputs=["y", "z"],
    )  # fmt: skip
    controller, sensor = lag(-0.3, "e", "u", 0.7, 0.4), lag(-50.0, "y", "m", 50.0)
    ours = rl.connect(
        plant, controller, sensor, inputs=["d", "r"], outputs=["z", "e", "y"], sums=["e = r - m - f", "f = -z"]
    )
    theirs = control.interconnect(
        [plant.to_control(), controller.to_control(), sensor.to_control(),
         control.summing_junction(["r", "-m", "-f"], "e"), control.summing_junction(["-z"], "f")],
        inputs=["d", "r"], outputs=["z", "e", "y"],
    )  # fmt: skip
    truth = np.moveaxis(np.asarray(theirs(1j * OMEGA)), -1, 0)
    assert np.abs(rl.frequency_response(ours, OMEGA) - truth).max() < 1e-12
    assert (ours.input_names, ours.output_names, ours.n_states) == (("d", "r"), ("z", "e", "y"), 5)


def test_an_external_input_can_be_an_output_and_feeds_several_inputs():
    two = rl.connect(gain(2.0, "r", "a"), gain(3.0, "r", "b"), inputs="r", outputs=["b", "r", "a", "s"], sums="s=a- b")
    assert two.D.ravel().tolist() == [3.0, 1.0, 2.0, -1.0]


def test_an_algebraic_loop_is_solved_exactly():
    loop = rl.connect(gain(4.0, "e", "y"), inputs=["r"], outputs=["y", "e"], sums=["e = r - y"])
    assert loop.D.ravel() == pytest.approx([0.8, 0.2])


def test_sets_keep_their_blocks_and_equal_names_are_merged():
    plant = stiffness()
    model = plant.M.renamed(["w", "r"], ["z", "v"])
    twin = rl.UncertainModel(model, plant.blocks)
    loop = rl.connect(plant, gain(3.0, "e", "u"), twin, inputs=["r"], outputs=["y", "gap"],
                      sums=["e = r - y", "gap = y - v"])  # fmt: skip
    assert isinstance(loop, rl.UncertainModel)
    assert [b.name for b in loop.blocks] == ["k"]
    s = 1j * OMEGA
    for delta in (-1.0, 0.0, 0.6):
        g = (1 + 0.5 * delta) / (s + 2)
        y = 3 * g / (1 + 3 * g)
        assert loop.response(OMEGA, {"k": delta})[:, :, 0] == pytest.approx(np.stack([y, y - g], axis=1))
    apart = rl.connect(plant, rl.UncertainModel(model, [rl.RealScalar("k2")]), inputs=["u", "r"], outputs=["y", "v"])
    assert [b.name for b in apart.blocks] == ["k", "k2"]
    with pytest.raises(InputError, match="connect: block 'k': is a RealScalar"):
        rl.connect(plant, rl.UncertainModel(model, [rl.ComplexScalar("k")]), inputs=["u", "r"], outputs=["y"])


PLANT, OTHER = lag(-1.0, "u", "y"), lag(-1.0, "v", "y")


@pytest.mark.parametrize(
    ("parts", "inputs", "outputs", "sums", "message"),
    [
        ([PLANT, OTHER], ["u", "v"], ["y"], [], "signal 'y': part 1 and part 2 both make it"),
        ([PLANT], ["u", "v"], ["y"], ["y = v"], "signal 'y': part 1 and sum 'y = v' both make it"),
        ([PLANT], [], ["y"], [], "part 1: input 'u': nobody feeds it"),
        ([PLANT, lag(-1, "speeed", "w")], ["u"], ["w"], ["speed = y"], "did you mean speed?"),
        ([PLANT], ["u"], ["yy"], [], r"output 'yy': no such signal, expected one of y, u\nhint: did you mean y\?"),
        ([lag(-1, "force", "y")], ["forse"], ["y"], [], r"takes it, expected one of force\nhint: did you mean force\?"),
        ([PLANT], ["u", "u"], ["y"], [], "input 'u': is given twice"),
        ([PLANT], ["u"], ["y", "y"], [], "output 'y': is given twice"),
        ([PLANT, lag(-1, "y", "w")], ["u", "y"], ["w"], [], "input 'y': part 1 makes this signal"),
        ([PLANT], ["u"], ["y"], ["e = "], "sum 'e = ': no sum"),
        ([PLANT], ["u"], ["y"], ["e - y"], "sum 'e - y': no sum"),
        ([PLANT], ["u"], ["y"], ["e = u y"], "sum 'e = u y': no sum"),
        ([PLANT], ["u"], ["y"], ["e = u - u"], "'u' occurs twice"),
        ([PLANT], ["u"], ["y"], ["e = u +"], r"sum 'e = u \+': no sum"),
        ([[[2.0]]], ["u"], ["y"], [], "part 1: a number or a matrix: its signals have no names"),
        ([lag(-0.5, "u", "y", dt=0.1), lag(-0.5, "y", "z", dt=0.2)], ["u"], ["z"], [],
         "part 2: sample time 0.2 s, expected 0.1 s as in part 1"),
        ([], ["u"], ["y"], [], "connect: no part"),
    ],
)  # fmt: skip
def test_errors_name_the_place(parts, inputs, outputs, sums, message):
    with pytest.raises(InputError, match=message) as caught:
        rl.connect(*parts, inputs=inputs, outputs=outputs, sums=sums)
    assert "\n" not in caught.value.line
    assert caught.value.line.startswith("connect: ")
