"""rl.d2c and rl.d2d: round trips, scipy's and python-control's discretisation, closed forms, and what has no answer."""

from __future__ import annotations

import json

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import logm
from scipy.signal import cont2discrete

import robustlab as rl
from robustlab.cli import model as model_app
from robustlab.cli.ending import main_guard
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.statespace import OperatingPoint

T = 0.1
SIGNALS = {"inputs": [("u", "V"), "d"], "outputs": ["y", ("omega", "rad/s")], "states": ["a", "b", "c"]}


def plant(seed=0, n=3):
    """Continuous, with poles well below the Nyquist frequency of 31 rad/s, one of them at 0."""
    rng = np.random.default_rng(seed)
    a = 4 * rng.standard_normal((n, n))
    a -= (np.linalg.eigvals(a).real.max() - 0.5) * np.eye(n)
    a[:, 0] = 0.0
    b, c, d = rng.standard_normal((n, 2)), rng.standard_normal((2, n)), rng.standard_normal((2, 2))
    names = SIGNALS if n == 3 else {}
    return rl.StateSpaceModel(a, b, c, d, **names)


def same(one, two, tolerance=1e-9):
    for name in "ABCD":
        np.testing.assert_allclose(getattr(one, name), getattr(two, name), atol=tolerance)


@pytest.mark.parametrize("method", ["zoh", "foh"])
def test_what_scipy_discretised_comes_back(method):
    truth = plant()
    a, b, c, d, _ = cont2discrete((truth.A, truth.B, truth.C, truth.D), T, method=method)
    found = rl.d2c(rl.StateSpaceModel(a, b, c, d, T, **SIGNALS), method)
    same(found.model, truth)
    assert found.error < 1e-11
    assert found.status is rl.Status.CONVERGED
    assert found.model.dt == 0.0
    assert (found.model.inputs, found.model.states) == (truth.inputs, truth.states)


def test_tustin_is_the_map_of_python_control():
    truth = plant()
    sampled = control.sample_system(truth.to_control(), T, method="bilinear")
    found = rl.d2c(sampled, "tustin")
    omega = [0.1, 3.0, 50.0]
    np.testing.assert_allclose(
        rl.frequency_response(found.model, omega), rl.frequency_response(truth, omega), rtol=1e-9
    )
    assert found.status is rl.Status.CONVERGED


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.integers(0, 100_000), st.integers(1, 6), st.sampled_from(["zoh", "foh", "tustin"]))
def test_round_trips(seed, n, method):
    truth = plant(seed, n)
    fast = rl.discretise(truth, 0.02, method)
    found = rl.d2c(fast, method)
    omega = np.array([0.1, 2.0, 40.0])
    ours, given_ = (rl.frequency_response(m, omega) for m in (found.model, truth))
    assert np.abs(ours - given_).max() <= 1e-6 * np.abs(given_).max()
    assert found.status is rl.Status.CONVERGED
    other = rl.d2d(fast, 0.033, method)
    direct = rl.discretise(truth, 0.033, method)
    ours, given_ = (rl.frequency_response(m, omega) for m in (other.model, direct))
    assert np.abs(ours - given_).max() <= 1e-6 * np.abs(given_).max()
    assert other.model.dt == 0.033


def test_a_whole_multiple_is_exact_and_needs_no_logarithm():
    truth = plant()
    found = rl.d2d(rl.discretise(truth, T, "zoh"), 5 * T)
    same(found.model, rl.discretise(truth, 5 * T, "zoh"), 1e-12)
    assert (found.steps, found.status) == (5, rl.Status.CONVERGED)
    assert found.error < 1e-13
    # a flip, an integrator and a delay of one sample: x_{k+1} = -x_k / 2 + u, i + u, u
    odd = rl.StateSpaceModel(np.diag([-0.5, 1.0, 0.0]), np.ones((3, 1)), np.eye(3), np.zeros((3, 1)), T)
    three = rl.d2d(odd, 0.3).model
    np.testing.assert_allclose(three.A, np.diag([-0.125, 1.0, 0.0]))
    np.testing.assert_allclose(three.B.ravel(), [1 - 0.5 + 0.25, 3.0, 1.0])
    assert rl.d2d(odd, T).model.A.tolist() == odd.A.tolist()


def test_an_operating_point_stays_where_the_states_do():
    point = OperatingPoint(np.arange(3.0), np.zeros(2), np.ones(2))
    m = plant()
    held = rl.discretise(rl.StateSpaceModel(m.A, m.B, m.C, m.D, operating_point=point), T, "zoh")
    assert rl.d2c(held).model.operating_point is not None
    assert rl.d2d(held, 0.2).model.operating_point is not None
    assert rl.d2d(held, 0.15).model.operating_point is not None
    assert rl.d2c(held, "tustin").model.operating_point is None


def test_a_gain_has_no_states_and_stays():
    one = rl.StateSpaceModel([], [], [], [[2.0]], T)
    for found in (rl.d2c(one), rl.d2c(one, "foh"), rl.d2d(one, 0.37), rl.d2d(one, 0.3)):
        assert found.model.D.tolist() == [[2.0]]
        assert found.status is rl.Status.CONVERGED


@pytest.mark.parametrize("a", [[[-0.5]], [[0.5, 1.0], [0.0, -0.2]]])
def test_a_pole_on_the_negative_real_axis_is_refused_with_the_reason(a):
    assert np.abs(np.imag(logm(a))).max() > 1  # scipy's logarithm of it is complex
    n = len(a)
    m = rl.StateSpaceModel(a, np.ones((n, 1)), np.ones((1, n)), [[0.0]], T)
    for convert in (rl.d2c, lambda m: rl.d2d(m, 0.15)):
        with pytest.raises(
            NoTrustworthyNumber, match=r"a pole at z = -0\.[25]: a mode that changes its sign"
        ) as caught:
            convert(m)
        assert "whole multiple" in str(caught.value.hint)
    assert rl.d2c(m, "tustin").status is rl.Status.CONVERGED


def test_other_refusals():
    delay = rl.StateSpaceModel([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], T)
    with pytest.raises(NoTrustworthyNumber, match=r"d2c \(zoh\): a pole at z = 0 .*: a mode that is gone"):
        rl.d2c(delay)
    with pytest.raises(NoTrustworthyNumber, match="d2c: a pole at z = -1"):
        rl.d2c(rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], T), "tustin")
    with pytest.raises(InputError, match=r"d2c: the model is continuous"):
        rl.d2c(plant())
    with pytest.raises(InputError, match=r"(?s)d2d: method 'zho', expected one of zoh, foh, tustin.*did you mean zoh"):
        rl.d2d(delay, 0.2, "zho")  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="d2d: dt is -1, expected a positive sample time"):
        rl.d2d(delay, -1)
    with pytest.raises(NoTrustworthyNumber, match=r"d2d: A\^100000 overflows: a pole of modulus 2"):
        rl.d2d(rl.StateSpaceModel([[2.0]], [[1.0]], [[1.0]], [[0.0]], T), 1e4)


def test_lost_digits_are_told(tmp_path):
    """A chain of three nearly dead modes: its logarithm has entries that cancel."""
    a = 1e-4 * np.eye(3) + np.eye(3, k=1)
    m = rl.StateSpaceModel(a, np.ones((3, 1)), np.ones((1, 3)), [[0.0]], T)
    found = rl.d2c(m)
    again = cont2discrete((found.model.A, found.model.B, m.C, m.D), T)
    assert max(np.abs(again[0] - a).max(), np.abs(again[1] - m.B).max()) > 1e-9
    assert found.status is rl.Status.INACCURATE
    assert found.error > 1e-8
    rl.save(tmp_path / "m.h5", m)
    assert main_guard(lambda: model_app.app(["d2c", str(tmp_path / "m.h5")], standalone_mode=False)) == 4


def test_the_commands(tmp_path, capsys):
    def run(*words):
        return main_guard(lambda: model_app.app(list(words), standalone_mode=False))

    fast, slow, back = (str(tmp_path / name) for name in ("fast.h5", "slow.h5", "back.h5"))
    truth = plant()
    rl.save(fast, rl.discretise(truth, T, "zoh"))
    assert run("d2d", fast, "--dt", "0.2", "--out", slow, "--json") == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["command"], said["steps"], said["status"]) == ("model d2d", 2, "converged")
    assert run("d2c", slow, "--out", back) == 0
    same(rl.load(back), truth)
    rl.save(fast, rl.StateSpaceModel([[-0.5]], [[1.0]], [[1.0]], [[0.0]], T))
    assert run("d2c", fast) == 4
    assert "changes its sign" in capsys.readouterr().err
