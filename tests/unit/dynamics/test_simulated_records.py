"""Records in recipes/data: labelled as simulated, reproducible, made without robustlab."""

import ast
import importlib.util
from pathlib import Path

import numpy as np
import pytest

import robustlab as rl

FOLDER = Path(__file__).parents[3] / "recipes" / "data"
JIGS = ("jig_square", "jig_rich", "jig_rich_held_out", "jig_slow", "jig_slow_held_out")
RECORDS = (*JIGS, "motor_record")


def maker(name):
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def rows(name):
    return np.loadtxt(FOLDER / f"{name}.csv", delimiter=",", skiprows=4 if name == "motor_record" else 5)


@pytest.mark.parametrize("name", RECORDS)
def test_it_is_labelled_as_simulated_and_is_small(name):
    head = (FOLDER / f"{name}.csv").read_text(encoding="utf-8").splitlines()[:5]
    assert head[0].startswith("# SIMULATED")
    assert "not a measurement" in head[0]
    columns = head[3 if name == "motor_record" else 4]
    assert columns == "t [s],u [V],phi [rad]" + (",i [A]" if name != "jig_square" else "")
    assert (FOLDER / f"{name}.csv").stat().st_size < 400_000


@pytest.mark.parametrize("name", ["make_jig_record", "make_motor_record"])
def test_its_maker_is_independent(name):
    imported = set()
    for node in ast.walk(ast.parse((FOLDER / f"{name}.py").read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            imported |= {a.name.split(".")[0] for a in node.names}
        elif isinstance(node, ast.ImportFrom):
            imported.add((node.module or "").split(".")[0])
    assert imported <= {"__future__", "math", "pathlib", "numpy"}


@pytest.mark.parametrize("name", RECORDS)
def test_it_is_reproducible(name):
    file = rows(name)
    again = (
        maker("make_motor_record").simulate(0.25) if name not in JIGS else maker("make_jig_record").simulate(name, 0.4)
    )
    rounding = np.array([5.1e-5, 5.1e-5, 5.1e-5, 1e-9]) if name in JIGS else np.full(4, 5.1e-6)
    columns = file.shape[1]
    assert (
        np.abs(again[:, :columns] - file[: len(again)]) <= rounding[:columns] + 1e-7 * np.abs(again[:, :columns])
    ).all()


def test_parameters_are_within_the_tolerances_printed_and_assumed():
    of = maker("make_jig_record")
    printed = {
        "Kf": (of.KF / 4.8e-5, 0.35),
        "J_nut": (of.J_NUT / 2.2071e-5, 0.10),
        "m_screw": (of.SCREW / 0.112, 0.10),
    }
    assumed = {
        "R": (of.R / 2.07, 0.10),
        "L": (of.L / 0.62e-3, 0.10),
        "K": (of.K / 0.052, 0.05),
        "J": (of.J_ROTOR / 7.2e-6, 0.10),
    }
    for name, (ratio, tolerance) in (printed | assumed).items():
        assert 0 < abs(ratio - 1) <= tolerance, name
    text = " ".join(of.__doc__.split())
    assert "assumed ones (R 10 %, L 10 %, motor constant 5 %, rotor 10 %)" in text


@pytest.mark.slow  # 30 s
def test_its_hidden_effects_are_named():
    """Parameters of its script: a driver drop of 0.6 V, and dry friction of 6 mN m with presliding."""
    record = rl.Record.read(FOLDER / "motor_record.csv", inputs=["u"], outputs=["phi", "i"])
    found = rl.discover(rl.plant("dc-motor"), record)
    assert (found.verdict, found.complete) == ("named", False)
    values = {e.name: {v.name: v.value for v in e.parameters} for e in found.effects}
    assert set(values) == {"input-dead-zone", "stribeck-friction"}
    assert values["input-dead-zone"]["d"] == pytest.approx(0.6, rel=0.02)
    assert values["stribeck-friction"]["Fc"] == pytest.approx(6.0e-3, rel=0.03)
    assert found.free_run["phi"].updated < 0.01 * found.free_run["phi"].refitted
