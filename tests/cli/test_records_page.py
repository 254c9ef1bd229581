"""docs/records.md: its commands and its code run on files of other software, and print what it shows."""

import re
import shlex
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from shell import robustlab

import robustlab as rl

PAGE = (Path(__file__).parents[2] / "docs" / "records.md").read_text(encoding="utf-8")
N = 400


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """One run of the servo axis as a table, as another one in mm, and as a Simulink log."""
    folder = tmp_path_factory.mktemp("records")
    t = np.arange(N) * 0.005
    u = np.sign(np.sin(9 * t)) + np.sin(5 * t)
    q = rl.simulate(rl.plant("servo-axis"), t, u)["q"]
    for name, header, position in (("run", "t,u,q", q), ("log", "t,drive,position", 1e3 * q)):
        np.savetxt(folder / f"{name}.csv", np.c_[t, u, position], delimiter=",", header=header, comments="")
    signals = np.empty((1, 2), dtype=[("values", object), ("label", object)])
    signals[0, 0], signals[0, 1] = (u[:, None], "u"), (q[:, None], "q")
    scipy.io.savemat(folder / "run.mat", {"simout": {"time": t[:, None], "signals": signals}})
    return folder


@pytest.fixture
def call(monkeypatch, folder):
    monkeypatch.chdir(folder)
    return partial(robustlab, "data", code=0)


def test_the_commands_run(call):
    (block,) = re.findall(r"```sh\n(.*?)```", PAGE, flags=re.DOTALL)
    check, convert, compare, simulink = (shlex.split(line)[2:] for line in block.splitlines())
    assert "400 samples" in call(*check).out
    call(*convert)
    back = rl.load("run.h5")
    assert (back.unit("q"), back.n) == ("m", N)
    printed = call(*compare, "--json")
    assert printed.json["outputs"]["q"]["windowed_rms_percent"] < 1e-6
    assert "q: converted from mm to m" in printed.err
    assert "[u] -> [q]" not in call(*simulink).err


def test_a_group_by_its_place_in_the_name(call):
    printed = call("discover", "servo-axis", "run.mat#simin", "--outputs", "q", code=3)
    assert "missing group /simin" in printed.err


def test_the_code_runs(monkeypatch, tmp_path, capsys):
    (block,) = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(block, {})
    expected = [line.partition("  # ")[2].strip() for line in block.splitlines() if line.startswith("print")]
    expected = [text for text in expected if text]
    assert capsys.readouterr().out.splitlines() == expected
