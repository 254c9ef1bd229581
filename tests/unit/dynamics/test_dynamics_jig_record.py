"""The stand-ins for the thesis' jig: simulated by code that is not robustlab's, and can be made again."""

from __future__ import annotations

import ast
import importlib.util
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).parents[3] / "recipes" / "data"
NAMES = ("jig_square", "jig_rich", "jig_rich_held_out", "jig_slow", "jig_slow_held_out")


@pytest.fixture(scope="module")
def maker():
    spec = importlib.util.spec_from_file_location("make_jig_record", FOLDER / "make_jig_record.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def records():
    return {name: np.loadtxt(FOLDER / f"{name}.csv", delimiter=",", skiprows=5) for name in NAMES}


@pytest.mark.parametrize("name", NAMES)
def test_it_says_that_it_is_simulated_and_is_small(name):
    head = (FOLDER / f"{name}.csv").read_text(encoding="utf-8").splitlines()[:5]
    assert head[0].startswith("# SIMULATED")
    assert "not a measurement" in head[0]
    assert head[4] == "t [s],u [V],phi [rad]" + (",i [A]" if name != "jig_square" else "")
    assert (FOLDER / f"{name}.csv").stat().st_size < 400_000


def test_its_maker_is_independent():
    tree = ast.parse((FOLDER / "make_jig_record.py").read_text(encoding="utf-8"))
    imported = {
        name.split(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, (ast.Import, ast.ImportFrom))
        for name in ([a.name for a in node.names] if isinstance(node, ast.Import) else [node.module or ""])
    }
    assert imported <= {"__future__", "math", "pathlib", "numpy"}


@pytest.mark.parametrize("name", NAMES)
def test_it_can_be_made_again(maker, records, name):
    again = maker.simulate(name, 0.4)
    file = records[name][: len(again)]
    assert len(records[name]) == 5000
    np.testing.assert_allclose(again[:, :3], file[:, :3], atol=5.1e-5)
    if name != "jig_square":
        np.testing.assert_allclose(again[:, 3], file[:, 3], atol=1e-9)


def test_parameters_are_within_the_tolerances_printed_and_assumed(maker):
    printed = {
        "Kf": (maker.KF / 4.8e-5, 0.35),
        "J_nut": (maker.J_NUT / 2.2071e-5, 0.10),
        "m_screw": (maker.SCREW / 0.112, 0.10),
    }
    assumed = {
        "R": (maker.R / 2.07, 0.10),
        "L": (maker.L / 0.62e-3, 0.10),
        "K": (maker.K / 0.052, 0.05),
        "J": (maker.J_ROTOR / 7.2e-6, 0.10),
    }
    for name, (ratio, tolerance) in (printed | assumed).items():
        assert 0 < abs(ratio - 1) <= tolerance, name
    said = " ".join(maker.__doc__.split())
    assert "one that we assume (R 10 %, L 10 %, motor constant 5 %, rotor 10 %)" in said
