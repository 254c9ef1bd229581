"""Operations common to all kinds of models: loops, values, poles and zeros, step responses, printing."""

import subprocess
import sys

import control as ct
import numpy as np
import pytest
from numpy.testing import assert_allclose

import robustlab as rl
from robustlab.errors import InputError, UnitMismatch

G = rl.StateSpaceModel(
    [[0.0, 1.0], [-2.0, -0.25]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], inputs=[("u", "V")], outputs=[("y", "m")]
)
LATE = rl.with_delays(G, inputs={"u": 0.3})
DATA = rl.frequency_data(G, [0.5, 1.0, 2.0])
LAGS = rl.LPVModel({"a": [1.0, 4.0]}, [rl.tf([1], [1, a]) for a in (1.0, 4.0)])
SET = rl.parametric([["-a"]], [[1]], [["a"]], [[0]], {"a": (2.0, 1.0, 4.0)})
KINDS = {"model": G, "delayed": LATE, "set": SET, "data": DATA, "scheduled": LAGS}


def control_of(model):
    return ct.ss(model.A, model.B, model.C, model.D)


def test_the_value_at_a_complex_number():
    for s in (1j, 0.3 - 2j, -4.0, 0):
        assert_allclose(G(s), [[control_of(G)(s)]], rtol=1e-13)
        assert_allclose(LATE(s), [[control_of(G)(s) * np.exp(-0.3 * s)]], rtol=1e-12)
        assert_allclose(SET(s), [[2.0 / (s + 2.0)]], rtol=1e-14)
    assert_allclose(G([1j, 2j]), rl.frequency_response(G, [1.0, 2.0]), rtol=1e-14)
    loop = (2.0 * LATE).feedback()
    s = 0.1 + 1.7j
    there = 2.0 * control_of(G)(s) * np.exp(-0.3 * s)
    assert_allclose(loop(s), [[there / (1 + there)]], rtol=1e-12)


@pytest.mark.parametrize("s", [np.nan, np.inf, "1j", None, [[1j]]])
def test_what_is_no_number_is_refused(s):
    with pytest.raises(InputError, match="finite complex number"):
        G(s)


def test_feedback_is_that_of_python_control():
    K = rl.tf([2, 1], [1, 10])
    for sign in (-1, 1):
        wanted = ct.feedback(control_of(G), control_of(K), sign)
        assert_allclose(G.feedback(K, sign)(0.4 + 1j), [[wanted(0.4 + 1j)]], rtol=1e-12)
    assert_allclose(G.feedback()(1j), [[ct.feedback(control_of(G), 1)(1j)]], rtol=1e-13)
    assert_allclose(G.feedback(3.0)(1j), [[ct.feedback(control_of(G), 3)(1j)]], rtol=1e-13)
    assert_allclose(G.feedback([[3.0]])(1j), G.feedback(3.0)(1j), rtol=1e-15)
    assert_allclose(G.feedback(ct.tf([2, 1], [1, 10]))(1j), G.feedback(K)(1j), rtol=1e-12)
    loop = G.feedback(K)
    assert (loop.inputs, loop.outputs) == (G.inputs, G.outputs)


def test_the_loop_is_of_the_kind_that_says_more():
    spring = rl.StateSpaceModel(G.A, G.B, G.C, G.D)
    closed = spring.feedback(SET)
    assert isinstance(closed, rl.UncertainModel)
    for a in (1.0, 4.0):
        delta = {"a": (a - 2.0) / (1.0 if a < 2 else 2.0)}
        wanted = ct.feedback(control_of(spring), ct.tf([a], [1, a]))
        assert_allclose(closed.evaluate(delta)(1.3j), [[wanted(1.3j)]], rtol=1e-10)
    assert isinstance(spring.feedback(LATE.select()), rl.DelayedModel)


def test_a_loop_that_does_not_fit_is_refused():
    with pytest.raises(UnitMismatch):
        G.feedback(rl.tf([1], [1, 1], inputs=[("y", "rad")]))
    two = rl.tf([[[1]], [[2]]], [1, 1])
    with pytest.raises(InputError, match="for a plant of 2 x 1"):
        two.feedback()
    with pytest.raises(InputError, match="expected 1 x 2"):
        two.feedback(G)
    with pytest.raises(InputError, match="sign: 2"):
        G.feedback(1.0, 2)
    with pytest.raises(InputError, match="well posed"):
        rl.tf([1, 1], [1, 2]).feedback(-1.0)


def test_poles_and_zeros():
    lead = rl.tf([1, 3, 2], [1, 7, 12])
    assert_allclose(np.sort(lead.zeros().real), [-2, -1], rtol=1e-10)
    assert_allclose(np.sort(lead.poles().real), [-4, -3], rtol=1e-12)
    assert SET.poles().tolist() == [-2.0]  # of the nominal model
    assert len(SET.zeros()) == 0


def test_a_step_response_is_the_closed_form():
    t_end = 3.0
    for model, slow in ((rl.tf([2], [1, 2]), 2.0), (SET, 2.0)):
        record = model.step(t_end)
        assert (record.n, record.t[-1]) == (401, t_end)
        assert_allclose(next(iter(record.outputs.values())), 1 - np.exp(-slow * record.t), atol=1e-12)
        assert set(next(iter(record.inputs.values())).tolist()) == {1.0}
    late = rl.with_delays(rl.tf([2], [1, 2]), inputs={0: 0.75}).step(t_end)
    assert_allclose(late["y1"], np.where(late.t > 0.75, 1 - np.exp(-2 * (late.t - 0.75)), 0.0), atol=1e-12)
    assert rl.tf([2], [1, 2]).step().t[-1] == pytest.approx(4.0)  # eight time constants
    sampled = rl.tf([0.5], [1, -0.5], 0.1).step(1.0)
    assert_allclose(sampled["y1"], 1 - 0.5 ** np.arange(11), atol=1e-14)


def test_a_step_needs_one_input_and_an_end():
    two = rl.tf([[[1], [3]]], [1, 1], inputs=["a", "b"])
    with pytest.raises(InputError, match="inputs a, b") as error:
        two.step()
    assert error.value.hint == 'G.step(input="a")'
    found = two.step(8.0, input="b")
    assert found["y1"][-1] == pytest.approx(3.0, rel=1e-3)
    assert (found["a"].max(), found["b"].min()) == (0.0, 1.0)
    with pytest.raises(InputError, match="no such input"):
        two.step(input="c")
    with pytest.raises(InputError, match="unstable") as error:
        rl.tf([1], [1, -1]).step()
    assert "t_end" in (error.value.hint or "")
    assert rl.tf([1], [1, -1]).step(1.0)["y1"][-1] == pytest.approx(np.e - 1)
    with pytest.raises(InputError, match="positive time"):
        G.step(-1.0)


# Kind -> questions that it refuses, and words of the way that it names.
REFUSED = {
    "delayed": ({"poles": (), "zeros": ()}, ".pade(order)"),
    "data": ({"poles": (), "zeros": (), "step": (), "__call__": (1j,)}, "rl.robust_stability"),
    "scheduled": ({"poles": (), "zeros": (), "step": (), "__call__": (1j,), "feedback": ()}, ".at(...)"),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("question", "given"), [("poles", ()), ("zeros", ()), ("step", (1.0,)), ("__call__", (1j,)), ("feedback", ())]
)
def test_every_kind_answers_or_names_the_way(kind, question, given):
    ask = getattr(KINDS[kind], question)
    refused, way = REFUSED.get(kind, ({}, ""))
    if question not in refused:
        assert ask(*given) is not None
        return
    with pytest.raises(InputError) as error:
        ask(*given)
    assert way in (error.value.hint or "")


@pytest.mark.slow
def test_an_editor_knows_the_methods_of_plants_and_models(tmp_path):
    expected = {
        'rl.plant("dc-motor")': "LinearPlant",
        'rl.plant("dc-motor").uncertain()': "UncertainModel",
        'rl.plant("stewart-platform")': "StewartPlatform",
        'rl.plant("mine.py:axis")': "Plant",
        "rl.tf([1], [1, 1])": "StateSpaceModel",
        "rl.tf([1], [1, 1]).feedback()": "StateSpaceModel",
        "rl.tf([1], [1, 1]).step()": "Record",
        "rl.tf([1], [1, 1])(1j)": "ndarray[tuple[Any, ...], dtype[complex128]]",
    }
    lines = ["import robustlab as rl", *(f"reveal_type({text})" for text in expected)]
    (tmp_path / "user.py").write_text("\n".join(lines))
    command = [sys.executable, "-m", "pyright", "--pythonpath", sys.executable, "user.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=300)
    revealed = [
        line.rpartition(" is ")[2].strip('"') for line in done.stdout.splitlines() if "information: Type of" in line
    ]
    assert revealed == list(expected.values()), done.stdout
