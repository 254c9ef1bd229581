"""Every block of code of these pages runs, in its order, and so does every command of the tutorials."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

import robustlab as rl
from robustlab.cli import main_guard
from robustlab.cli import run_command as run

ROOT = Path(__file__).parents[3]
DOCS = ROOT / "docs"
# Tutorials whose header names a kernel are executed where the site is built.
TUTORIALS = sorted(
    page.stem for page in (DOCS / "tutorials").glob("*.md") if not page.read_text(encoding="utf-8").startswith("---")
)
QUICK = ["conventions", "from_data_to_controller", "models", "objects"]
LONG = ["cover", "delays", "fixed_structure", "gain-scheduling", "iqc", "synthesis", "watch"]


def blocks_of(page: str) -> list[tuple[str, str]]:
    found = re.findall(r"```(python|sh)\n(.*?)```", (DOCS / f"{page}.md").read_text(encoding="utf-8"), flags=re.DOTALL)
    assert found
    return found


@pytest.mark.parametrize("page", [*QUICK, *(pytest.param(page, marks=pytest.mark.slow) for page in LONG)])
def test_the_code_of_a_page_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for kind, block in blocks_of(page):
        if kind == "python":
            exec(block, names)


def test_the_code_of_the_platform_runs():
    torque = rl.trim(rl.plant("stewart-platform", platform_mass=3.3), pose=[0.0, 0.0, 0.13, 0.02, 0.0, 0.0]).u
    home = rl.plant("stewart-platform").geometry.home
    names = {
        "t": np.linspace(0, 0.05, 11),
        "u": np.tile(torque, (11, 1)),
        "poses": np.tile(home, (2, 1)),
        "masses": [0.4, 0.5],
    }
    for kind, block in blocks_of("stewart"):
        if kind == "python":
            exec(block, names)
    assert names["found"].proved.all()
    np.testing.assert_allclose(names["found"].pose, names["pose"], atol=1e-12)
    assert abs(names["record"]["phi_1"] - names["trim"].x[0]).max() < 1e-6


@pytest.mark.parametrize(
    "page",
    [
        *(
            # The quadrotor's campaign takes two minutes.
            pytest.param(f"tutorials/{page}", marks=[pytest.mark.slow] if page == "quadrotor-height" else [])
            for page in TUTORIALS
        ),
        pytest.param("your-own-machine", marks=pytest.mark.slow),  # it searches for the name of an effect
    ],
)
def test_the_code_and_the_commands_of_a_page_run(page, tmp_path, monkeypatch, capsys):
    shutil.copytree(ROOT / "models" / "plants", tmp_path / "models" / "plants")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for kind, block in blocks_of(page):
        first = block.partition("\n")[0]
        if kind == "sh":
            for command in block.splitlines():
                program, *words = shlex.split(command)
                assert program == "robustlab"
                code = main_guard(lambda words=words: run(words))
                assert code == 0, (command, capsys.readouterr().err)
        elif first == "# stage.py":
            Path("stage.py").write_text(block)
        elif first != "# mymachine.py":  # the beginning of what a command has written
            exec(block, names)


def test_there_is_a_tutorial_for_each_plant():
    assert sorted(path.stem.replace("_", "-") for path in (ROOT / "models" / "plants").glob("*.py")) == TUTORIALS
