"""docs/plants.md: the code in it runs, and the plant built in it is right."""

from __future__ import annotations

import re
import sys
import types
from pathlib import Path

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics import plant_names

TEXT = (Path(__file__).parents[3] / "docs" / "plants.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL)


def test_the_code_runs_and_the_tank_is_right(monkeypatch):
    module = types.ModuleType("water_tank")
    monkeypatch.setitem(sys.modules, "water_tank", module)
    names = {"rl": rl, "t": np.arange(10) * 0.1, "volts": np.ones(10)}
    for block in BLOCKS:
        exec(block, module.__dict__ if block.startswith("# water_tank.py") else names)
    tanks = names["tanks"]
    assert tanks.parameters["A1"].value == 0.6
    # by hand: A1 h1' = inflow - g1 h1, A2 h2' = g1 h1 - g2 h2
    model = rl.linearise(tanks)
    np.testing.assert_allclose(model.A, [[-0.02 / 0.6, 0], [0.02 / 0.8, -0.03 / 0.8]])
    np.testing.assert_allclose(model.dc_gain(), [[50.0], [100 / 3]])
    uncertain = tanks.uncertain()
    assert [(b.name, b.repeats) for b in uncertain.blocks] == [("g1", 1), ("g2", 1)]
    np.testing.assert_allclose(uncertain.evaluate({"g1": 1.0}).A, tanks.with_parameters(g1=0.023).state_space().A)
    assert names["pair"].physical({"J": 1.0})["J"] == (pytest.approx(7.92e-6), "kg m2")


def test_the_table_names_every_plant_and_its_signals():
    for name in plant_names():
        row = next(line for line in TEXT.splitlines() if line.startswith(f"| `{name}`"))
        plant = rl.plant(name)
        for word in (*plant.parameters, *(s.name for s in (*plant.inputs, *plant.outputs))):
            assert re.search(rf"[` ]{word}[` :]", row), (name, word)
