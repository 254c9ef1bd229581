"""Steps that take norms of a damped mass, through the real command."""

from __future__ import annotations

import json

import numpy as np
import pytest

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
