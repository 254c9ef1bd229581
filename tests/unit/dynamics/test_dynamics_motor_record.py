"""The demo's record: simulated by code that is not robustlab's, says so, and can be made again."""

from __future__ import annotations

import ast
import importlib.util
from pathlib import Path

import numpy as np
import pytest

import robustlab as rl

FOLDER = Path(__file__).parents[3] / "recipes" / "data"


@pytest.fixture(scope="module")
def record():
    return np.loadtxt(FOLDER / "motor_record.csv", delimiter=",", skiprows=4)


def test_it_says_that_it_is_simulated():
    head = (FOLDER / "motor_record.csv").read_text(encoding="utf-8").splitlines()[:4]
    assert head[0].startswith("# SIMULATED")
    assert "not a measurement" in head[0]
    assert head[3] == "t [s],u [V],phi [rad],i [A]"
    assert (FOLDER / "motor_record.csv").stat().st_size < 400_000


def test_its_maker_is_independent():
    tree = ast.parse((FOLDER / "make_motor_record.py").read_text(encoding="utf-8"))
    imported = {
        name.split(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, (ast.Import, ast.ImportFrom))
        for name in ([a.name for a in node.names] if isinstance(node, ast.Import) else [node.module or ""])
    }
    assert imported <= {"__future__", "math", "pathlib", "numpy"}


def test_it_can_be_made_again(record):
    spec = importlib.util.spec_from_file_location("make_motor_record", FOLDER / "make_motor_record.py")
    maker = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(maker)
    again = maker.simulate(0.25)
    np.testing.assert_allclose(again, record[: len(again)], atol=5.1e-6)


def test_it_excites_and_disagrees(record):
    t, u, phi, i = record.T
    assert np.abs(u).max() == 12.0
    assert (np.diff(np.sign(u)) != 0).sum() > 8
    # the encoder counts, the current is noisy while the motor rests
    counts = phi / (2 * np.pi / 2000)
    np.testing.assert_allclose(counts, np.round(counts), atol=0.01)
    assert 0.01 < i[t < 0.1].std() < 0.03
    model = rl.simulate(rl.plant("dc-motor"), t, u)
    gap = np.abs(model["phi"] - phi).max() / np.ptp(phi)
    assert 0.05 < gap < 0.5  # the nominal model is visibly wrong, and visibly a model of this machine


@pytest.mark.slow  # 30 s
def test_what_is_hidden_in_it_is_named():
    """What its maker says: a driver that loses 0.6 V, and dry friction of 6 mN m with presliding, which remains."""
    record = rl.Record.read(FOLDER / "motor_record.csv", inputs=["u"], outputs=["phi", "i"])
    found = rl.discover(rl.plant("dc-motor"), record)
    assert (found.verdict, found.complete) == ("named", False)
    values = {e.name: {v.name: v.value for v in e.parameters} for e in found.effects}
    assert set(values) == {"input-dead-zone", "stribeck-friction"}
    assert values["input-dead-zone"]["d"] == pytest.approx(0.6, rel=0.02)
    assert values["stribeck-friction"]["Fc"] == pytest.approx(6.0e-3, rel=0.03)
    assert found.free_run["phi"].updated < 0.01 * found.free_run["phi"].refitted
