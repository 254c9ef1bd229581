"""``robustlab model plot`` and ``data plot``: figures from the shell."""

import json
import re
from xml.etree import ElementTree as ET

import numpy as np
import pytest

import robustlab as rl
from robustlab.cli.ending import main_guard
from robustlab.cli.main import run as command


@pytest.fixture
def robustlab(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)

    def call(*arguments, code=0):
        assert main_guard(lambda: command(arguments)) == code
        out, err = capsys.readouterr()
        return out if code == 0 else err

    return call


def curves(path):
    """Vertices of all curves of an SVG, as numbers (n, 2) each: a place, then steps from there."""
    paths = [e.get("d", "") for e in ET.parse(path).iter("{http://www.w3.org/2000/svg}path")]
    steps = [re.findall(r"-?\d*\.?\d+", p) for p in paths if re.fullmatch(r"M[-.\d ]+l[-.\d ]+", p)]
    return [np.cumsum(np.array(s, dtype=float).reshape(-1, 2), axis=0) for s in steps if len(s) >= 20]


def test_a_step_response_is_drawn_as_it_is(robustlab, tmp_path):
    """1 / (s + 1): the drawn curve is 1 - exp(-t), up to the scale of the axes."""
    rl.save("lag.h5", rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]]))
    found = json.loads(robustlab("model", "plot", "lag.h5", "--kind", "step", "--json"))
    assert found["files"] == ["out/lag-step.svg", "out/lag-step.png"]
    (curve,) = curves(tmp_path / "out/lag-step.svg")
    x, y = curve[:, 0] - curve[0, 0], curve[0, 1] - curve[:, 1]
    rise = y / y.max()
    tau = np.interp(1 - np.exp(-1), rise, x)
    np.testing.assert_allclose(rise, 1 - np.exp(-x / tau), atol=0.02)


@pytest.mark.parametrize("kind", ["bode", "sigma", "pzmap"])
def test_other_figures_of_a_set_are_drawn(robustlab, tmp_path, kind):
    pair = [rl.StateSpaceModel([[a]], [[1.0]], [[1.0]], [[0.0]]) for a in (-1.0, -1.2)]
    rl.save("set.h5", rl.elementwise(*pair))
    text = robustlab("model", "plot", "set.h5", "--kind", kind, "--figure", f"figures/{kind}.svg", "-n", "3")
    assert text.split() == [f"figures/{kind}.svg", f"figures/{kind}.png"]
    assert (tmp_path / f"figures/{kind}.png").read_bytes().startswith(b"\x89PNG")


def test_channels_and_kinds_that_are_not_there_are_named(robustlab):
    rl.save("m.h5", rl.StateSpaceModel([[-1.0]], [[1.0] * 5], [[1.0]], [[0.0] * 5]))
    assert "did you mean bode?" in robustlab("model", "plot", "m.h5", "--kind", "bod", code=2)
    assert "at most 4 of" in robustlab("model", "plot", "m.h5", "--inputs", "x", code=2)
    robustlab("model", "plot", "m.h5", "--inputs", "u5")


def test_a_record_is_drawn(robustlab, tmp_path):
    t = np.linspace(0.0, 1.0, 201)
    np.savetxt("a.csv", np.column_stack([t, np.sin(9 * t), t**2]), delimiter=",", header="t,u [V],q [m]", comments="")
    assert robustlab("data", "plot", "a.csv", "--inputs", "u").split() == ["out/a-record.svg", "out/a-record.png"]
    drawn = curves(tmp_path / "out/a-record.svg")
    assert len(drawn) == 2
    parabola = drawn[1][:, 1].max() - drawn[1][:, 1]
    x = drawn[1][:, 0] - drawn[1][0, 0]
    np.testing.assert_allclose(parabola / parabola.max(), (x / x.max()) ** 2, atol=0.01)
