"""``robustlab iqc`` and its recipe steps, through the real command."""

from __future__ import annotations

import json

import pytest

import robustlab as rl
from robustlab.cli.ending import main_guard
from robustlab.cli.main import run as run_words

RECIPE = """\
schema = "robustlab.recipe/1"
name = "iqc"
[step.loop]
do = "load"
path = "spring.h5"
[step.slow]
do = "iqc-gain"
of = "loop"
nature = { k = "varying:0.2" }
[step.fast]
do = "iqc-stability"
of = "loop"
nature = { k = "varying" }
[step.axis]
do = "load"
path = "axis.h5"
[step.gain]
do = "load"
path = "gain.h5"
[step.effects]
do = "effect-gain"
of = "axis"
controller = "gain"
outputs = ["q"]
amplitude = { u = 12.0 }
order = 1
"""


def run(words):
    return main_guard(lambda: run_words(words))


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ranges = {"k": (2.0, 0.1), "c": (0.3, 0.1)}
    rl.save("spring.h5", rl.parametric([[0, 1], ["-k", "-c"]], [[0], [1]], [[1, 0]], [[0]], ranges))
    loop = rl.StateSpaceModel([[-1.0]], [[-1.0, 1.0]], [[1.0]], [[0.0, 0.0]], 0, ["v", "d"], ["y"])
    rl.save("loop.h5", loop)
    rl.save("gain.h5", rl.StateSpaceModel([], [], [], [[30.0]]))
    rl.save("axis.h5", rl.with_effects(rl.plant("servo-axis"), {"input-saturation": {"u_max": 10.0}}))
    return tmp_path


def test_gain_and_stability(files, capfd):
    assert run(["iqc", "gain", "loop.h5", "--nature", "y:v=saturation", "--json", "--out", "g.h5"]) == 0
    found = json.loads(capfd.readouterr().out)
    assert found["command"] == "iqc gain"
    assert found["upper"] == pytest.approx(1.0, rel=1e-3)  # 1 / (s + 1), less what the saturation takes
    assert rl.load("g.h5").type == "IqcGain"
    assert run(["iqc", "gain", "spring.h5", "--nature", "k=varying", "--stability"]) == 0
    text = capfd.readouterr().out
    assert "stable as given  proved" in text
    assert "1.744 (proved)" in text


def test_an_uncertain_model_is_closed_as_the_controllers_file_says(files, capfd):
    """It was said to be none with options of effects."""
    gain = rl.StateSpaceModel([], [], [], [[3.0]], inputs=["y1"], outputs=["u1"])
    rl.save("k.h5", rl.Controller(gain, takes="r - y"))
    assert run(["iqc", "gain", "spring.h5", "--nature", "k=varying", "--controller", "k.h5"]) == 0
    text = capfd.readouterr().out
    assert text.startswith("loop  u = K (r - y), as k.h5 says\n")
    expected = rl.peak_gain(rl.load("spring.h5").feedback(gain, -1), natures={"k": rl.Varying()})
    assert f"{expected.upper:.4g}" in text


def test_a_plant_with_effects(files, capfd):
    options = ["--controller", "gain.h5", "--outputs", "q", "--amplitude", "u=12", "--order", "1"]
    assert run(["iqc", "gain", "axis.h5", *options]) == 0
    text = capfd.readouterr().out
    assert "input-saturation@u: odd nonlinearity" in text
    assert "as constant gains" in text
    assert run(["iqc", "gain", "axis.h5"]) == 2
    assert "without --controller" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (["gain", "loop.h5", "--nature", "y:v=satturation"], 3, "did you mean saturation?"),
        (["gain", "loop.h5", "--nature", "y:v=friction:1"], 3, "friction with level:stick speed"),
        (["gain", "loop.h5", "--nature", "saturation"], 2, "NAME=WORD:NUMBERS"),
        (["gain", "loop.h5", "--amplitude", "u=1"], 2, "a plant with effects"),
        (["gain", "loop.h5", "--feedback", "sideways"], 2, "negative or positive"),
        (["gain", "loop.h5", "--feedback", "negative"], 2, "without --controller"),
        (["gain", "loop.h5", "--nature", "y:v=saturation", "--nature", "y:v=dead-zone"], 2, "'y:v' is given twice"),
        (["gain", "loop.h5"], 3, "no block at all"),
        (["gain", "loop.h5", "--nature", "y:v=slope:-9:0"], 4, "unstable with all blocks at their middles"),
    ],
)
def test_what_is_refused(files, capfd, words, code, text):
    assert run(["iqc", *words]) == code
    assert text in capfd.readouterr().err


def test_the_steps_of_a_recipe(files):
    (files / "r.toml").write_text(RECIPE)
    assert run(["run", "r.toml", "--out", "o"]) == 0
    steps = {s["name"]: s["numbers"] for s in json.loads((files / "o" / "result.json").read_text())["steps"]}
    assert steps["slow"]["upper"] == pytest.approx(3.4019, rel=1e-3)
    assert steps["fast"]["stable"] is True
    assert steps["fast"]["margin"] == pytest.approx(1.744, rel=2e-3)
    assert steps["effects"]["lower"] <= steps["effects"]["upper"]
