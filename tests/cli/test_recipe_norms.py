"""Steps that take norms of a damped mass, through the real command."""

from __future__ import annotations

import json

import numpy as np
import pytest

import robustlab as rl
from robustlab.cli.main import run

RECIPE = """\
schema = "robustlab.recipe/1"
name = "norms"
[step.chain]
do = "plant"
plant = "mass-spring-damper"
choices = { m = [1.0], c = [0.2], k = [1.0] }
[step.model]
do = "linearise"
of = "chain"
outputs = ["q"]
[step.noise]
do = "h2-norm"
of = "model"
[step.stable]
do = "hinf-norm"
of = "model"
[step.axis]
do = "linf-norm"
of = "model"
[step.passive]
do = "passivity"
of = "model"
[step.inside]
do = "linf-norm"
of = "model"
band = [2.0, 5.0]
[step.constant]
do = "reduce-model"
of = "model"
order = 1
method = "hankel"
[step.gap]
do = "reduce-model"
of = "model"
tolerance = 10.0
band = [2.0, 5.0]
[[require]]
that = "constant.error"
text = "Within what theory promises."
at_most = 4.0
"""


def test_norms_of_a_damped_mass(tmp_path, monkeypatch):
    """Force to position: H2 norm sqrt(1 / (2 c k)), peak 1 / (c sqrt(k - c^2 / 4)) for m = 1; not passive."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "r.toml").write_text(RECIPE)
    assert run(["run", "r.toml", "--out", "o"]) == 0
    steps = {s["name"]: s["numbers"] for s in json.loads((tmp_path / "o" / "result.json").read_text())["steps"]}
    assert steps["noise"]["value"] == pytest.approx(np.sqrt(2.5), rel=1e-9)
    assert steps["noise"]["integral"] == pytest.approx(np.sqrt(2.5), rel=1e-9)
    for name in ("stable", "axis"):
        assert steps[name]["value"] == pytest.approx(1 / (0.2 * np.sqrt(0.99)), rel=1e-6)
    assert steps["passive"]["passive"] is False
    assert steps["inside"]["value"] == pytest.approx(1 / np.hypot(3.0, 0.4), rel=1e-9)  # falls: largest at 2 rad/s
    # A resonance of damping 0.1: its Hankel values are (sqrt(1 + z^2) +- z) / (4 z) with z = 0.1.
    values = (np.sqrt(1.01) + np.array([0.1, -0.1])) / 0.4
    assert steps["constant"]["hankel"] == pytest.approx(values, rel=1e-9)
    assert values[1] * (1 - 1e-12) <= steps["constant"]["bound"] <= values[1] * (1 + 2e-9)  # attained, proved to 1e-9
    assert steps["constant"]["error"] == pytest.approx(values[1], rel=1e-5)
    assert steps["gap"]["order"] == 0
    assert "bound" not in steps["gap"]
    kept = rl.load(tmp_path / "o" / "evidence" / "constant.h5")
    assert kept.data["order"] == 1


def test_a_reduction_takes_an_order_or_a_tolerance(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "r.toml").write_text(RECIPE.replace("order = 1", "order = 1\ntolerance = 0.1"))
    with pytest.raises(rl.InputError, match=r"order=1, tolerance=0.1, expected one of the two"):
        run(["run", "r.toml", "--out", "o"])
