"""Recipe steps of margins and sets, on models whose answers are closed forms."""

import re
from pathlib import Path

import numpy as np
import pytest
from recipe_runs import run_text

import robustlab as rl
from robustlab.recipe import KINDS

ROOT = Path(__file__).parents[2]
FILES = ("g", "h", "p", "k", "set", "r")
STEPS = """
[step.classical]
do = "classical-margins"
of = "p"
controller = "k"
sign = -1
[step.disk]
do = "disk-margin"
of = "p"
controller = "k"
sign = -1
[step.entries]
do = "difference"
of = "g"
beside = "h"
[step.worst]
do = "worst-gain"
of = "set"
[step.both]
do = "performance-margin"
of = "set"
[step.odd]
do = "check-record"
of = "r"
model = "g"
"""


def model(A, B, C, D, inputs=("u",), outputs=("y",)):
    return rl.StateSpaceModel(A, B, C, D, inputs=[(n, "1") for n in inputs], outputs=[(n, "1") for n in outputs])


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """G = 1 / (s + 1), H = 1 / (s + 2), P = 1 / (s + 1)^3, K = 2, the set 1 / (s + a) with a = 1 +- 20 %, a record."""
    folder = tmp_path_factory.mktemp("analysis")
    t = np.arange(1000) * 0.01
    u = np.sign(np.sin(3 * t))
    y = np.convolve(u, 0.01 * np.exp(-t))[:1000]
    made = {
        "g": model([[-1.0]], [[1.0]], [[1.0]], [[0.0]]),
        "h": model([[-2.0]], [[1.0]], [[1.0]], [[0.0]]),
        "p": model([[-1.0, 1, 0], [0, -1, 1], [0, 0, -1]], [[0], [0], [1]], [[1, 0, 0]], [[0]]),
        "k": model([], [], [], [[2.0]], ("y",), ("u",)),
        "set": rl.parametric([["-a"]], [[1]], [[1]], [[0]], {"a": (1.0, 0.2)}),
        "r": rl.Record(t, {"u": u}, {"y": y}, {"u": "1", "y": "1"}, "r"),
    }
    for name, thing in made.items():
        rl.save(folder / f"{name}.h5", thing)
    loads = "".join(f'[step.{name}]\ndo = "load"\npath = "{name}.h5"\n' for name in FILES)
    result = run_text(folder, f'schema = "robustlab.recipe/1"\nname = "a"\n{loads}{STEPS}')
    return {step["name"]: step for step in result.data["steps"]}


def test_margins_of_three_lags(ran):
    """L = 2 / (s + 1)^3 has gain 1/4 at sqrt 3, where its phase is -180 degrees; the disk's by a dense grid."""
    assert ran["classical"]["numbers"]["gain_high"] == pytest.approx(4.0)
    L = 2 / (1j * np.geomspace(0.1, 10, 200001) + 1) ** 3
    alpha = (1 / np.abs((1 - L) / (1 + L) / 2)).min()
    disk = ran["disk"]["numbers"]
    assert disk["lower"] <= alpha * (1 + 1e-9)
    assert disk["upper"] == pytest.approx(alpha, rel=1e-6)


def test_the_entries_in_which_two_lags_differ(ran):
    assert (ran["entries"]["numbers"]["count"], ran["entries"]["numbers"]["largest"]) == (1, 1.0)


def test_a_set_whose_gain_is_known(ran):
    """sup |1 / (jw + a)| = 1 / a, so 1 / (1 - 0.2 k), at most 1 / k up to k = 1 / 1.2."""
    for name, expected in (("worst", 1.25), ("both", 1 / 1.2)):
        found = ran[name]["numbers"]
        assert found["lower"] <= expected * (1 + 1e-9)
        assert found["upper"] >= expected * (1 - 1e-9)
        assert found["upper"] - found["lower"] < 1e-3


def test_a_record_without_oddities(ran):
    assert ran["odd"]["numbers"]["record"]["n"] == 1000
    assert ran["odd"]["numbers"]["remarks"] == []


def test_every_kind_of_step_is_run_by_a_recipe():
    """Of those shipped, or of the tests: what nothing runs nothing keeps right."""
    texts = [p.read_text(encoding="utf-8") for p in (*ROOT.glob("recipes/*.toml"), *ROOT.glob("tests/**/*.py"))]
    ran = {word for text in texts for word in re.findall(r"(?:\b|\\n)do\"?\s*[=:]\s*[\"'\\]+([a-z0-9-]+)", text)}
    # The first two are commands first, and tried there.
    assert set(KINDS) - ran == {"minimal", "reduce-model"}
