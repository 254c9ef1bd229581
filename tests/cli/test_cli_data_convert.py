"""``robustlab data check`` and ``convert``."""

import json
from pathlib import Path

import numpy as np
import pytest

import robustlab as rl
from robustlab.cli.data import app
from robustlab.cli.ending import main_guard


@pytest.fixture
def run(capfd, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)

    def call(*arguments, code=0):
        assert main_guard(lambda: app(list(arguments), standalone_mode=False)) == code
        out, err = capfd.readouterr()
        return out if code == 0 else err

    return call


@pytest.fixture
def csv(tmp_path):
    t = np.arange(50) * 0.02
    np.savetxt(
        tmp_path / "r.csv", np.column_stack([t, np.sin(t), np.cos(t)]), delimiter=";", header="t;u [V];q", comments=""
    )
    return "r.csv"


def test_convert_and_check(run, csv):
    run("convert", csv, "r.h5", "--inputs", "u", "--outputs", "q", "--unit", "q=rad")
    record = rl.load("r.h5")
    assert (record.units, list(record.inputs), record.n) == ({"u": "V", "q": "rad"}, ["u"], 50)
    np.testing.assert_allclose(record["q"], np.cos(record.t), rtol=1e-15)
    found = json.loads(run("check", "r.h5", "--json"))
    assert (found["n"], found["is_uniform"], found["remarks"]) == (50, True, [])
    assert [c["side"] for c in found["channels"]] == ["input", "output"]
    assert "remark  q: no unit stated" in run("check", csv)


def test_faults(run, csv):
    assert "missing p" in run("check", csv, "--inputs", "p", code=3)
    assert "NAME=UNIT" in run("check", csv, "--unit", "q", code=2)
    Path("comma.csv").write_text(Path(csv).read_text().replace(".", ","))
    assert "hint: --decimal ," in run("check", "comma.csv", code=3)
    assert "50 samples" in run("check", "comma.csv", "--decimal", ",")
    assert "no such folder" in run("convert", csv, "nowhere/r.h5", code=5)
