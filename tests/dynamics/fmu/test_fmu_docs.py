"""docs/fmu.md: its code and its commands run."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import fmu_units as units
import numpy as np
from fmu_units import needs_compiler

from robustlab.provenance import BY_DIFFERENCES

TEXT = (Path(__file__).parents[3] / "docs" / "fmu.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", TEXT, flags=re.DOTALL)


@needs_compiler
def test_the_page_runs(unit, folder, tmp_path, monkeypatch, capsys):
    shutil.copy(unit(2, joint=True), tmp_path / "machine.fmu")
    shutil.copy(units.python_motor(folder), tmp_path / "motor.fmu")
    monkeypatch.chdir(tmp_path)
    names = {}
    for block in blocks("python"):
        exec(block, names)
    np.testing.assert_allclose(names["rest"].u, [0.8], rtol=1e-9)  # k q
    assert (names["axis"].port_places[0].unit, names["axis"].joints_source) == ("N", "stated by the user")
    assert "omega  rms 0, peak 0, fit 100 %" in capsys.readouterr().out
    assert BY_DIFFERENCES in TEXT
    command = [sys.executable, "-c", "from robustlab.cli.main import main; main()"]
    lines = [line for block in blocks("sh") for line in block.splitlines() if line.startswith("robustlab ")]
    assert len(lines) == 4
    for line in lines:
        done = subprocess.run([*command, *line.split()[1:]], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert "SHA-256" in done.stdout or "free run" in done.stdout
