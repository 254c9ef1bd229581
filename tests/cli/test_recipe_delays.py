"""A recipe with delays, from the shell: a loop is proved stable with them; over a range that is too wide it is not."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

import robustlab as rl

RECIPE = """\
schema = "robustlab.recipe/1"
name = "late"

[step.plant]
do = "load"
path = "{folder}/plant.h5"

[step.late]
do = "delays"
of = "plant"
{delay}
order = 4

[step.controller]
do = "load"
path = "{folder}/controller.h5"

[step.loop]
do = "close-loop"
of = "late"
controller = "controller"

[step.margin]
do = "robust-stability"
of = "loop"

[[require]]
text = "Stable with its delay"
that = "margin.lower"
at_least = 1.0
"""


@pytest.mark.parametrize(
    ("delay", "code"),
    [
        ("inputs = { u = 0.7 }", 0),
        ("inputs = { u = [0.5, 0.8] }", 0),
        ("inputs = { u = [0.5, 1.2] }", 1),
        ("inputs = { u = 0.3 }\nneglected_delays = { u = 0.1 }\nneglected_lags = { u = 0.05 }", 0),
        ("neglected_delays = { v = 0.2 }", 3),
    ],
)
def test_a_loop_with_a_delay_in_a_recipe(delay, code, tmp_path):
    # u = 1.5 (r - y) around 1 / (s + 1) e^(-s tau): stable up to tau = (pi - atan w) / w at w = sqrt(1.25), 2.06 s
    rl.save(tmp_path / "plant.h5", rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=["y"]))
    gain = rl.StateSpaceModel([], [], [], [[1.5]], inputs=["e"], outputs=["u"])
    rl.save(tmp_path / "controller.h5", rl.Controller(gain, None, rl.Status.CERTIFIED, "by hand"))
    (tmp_path / "late.toml").write_text(RECIPE.format(folder=tmp_path, delay=delay))
    command = [
        sys.executable,
        "-m",
        "robustlab.cli.main",
        "run",
        str(tmp_path / "late.toml"),
        "--out",
        str(tmp_path / "out"),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stdout + done.stderr
    if code == 3:
        assert "one of u" in done.stderr
        return
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result is not None
    w = np.sqrt(1.25)
    assert (np.pi - np.arctan(w)) / w == pytest.approx(2.06, abs=0.01)
