"""``robustlab data compare``: result on stdout, files where asked, exit codes."""

import json

import numpy as np
import pytest

import robustlab as rl
from robustlab.cli import main
from robustlab.cli.data import app
from robustlab.cli.ending import main_guard


@pytest.fixture
def run(capsys):
    def call(*arguments):
        code = main_guard(lambda: app([str(a) for a in arguments], standalone_mode=False))
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


@pytest.fixture
def record_file(tmp_path):
    t = np.arange(800) * 1e-2
    u = np.repeat(np.random.default_rng(0).standard_normal(16), 50)
    truth = rl.simulate(rl.plant("servo-axis", M=110.0), t, u)
    path = tmp_path / "run3.h5"
    rl.save(path, rl.Record(t, truth.inputs, {"q": truth["q"]}, {"u": "V", "q": "m"}, "run3"))
    return path


def test_plant_by_name_and_parameters(run, record_file):
    code, out, _ = run("compare", "servo-axis", record_file, "--window", "0.5", "--json")
    result = json.loads(out)
    assert (code, result["command"], result["status"]) == (0, "data compare", "converged")
    assert result["window"] == pytest.approx(0.5)
    assert "simulated" not in result
    assert result["outputs"]["q"]["rms_percent"] > 0.1
    code, out, _ = run("compare", "servo-axis", record_file, "--set", "M=110", "--json")
    assert json.loads(out)["outputs"]["q"]["rms_percent"] < 1e-6


def test_text_figures_and_result_file(run, record_file, tmp_path):
    out_file, folder = tmp_path / "gap.h5", tmp_path / "figures"
    code, out, err = run("compare", "servo-axis", record_file, "--figure", f"{folder}/", "--out", out_file)
    assert code == 0
    assert "free run" in out
    assert "percent of the record's range" in out
    assert sorted(p.name for p in folder.glob("*.svg")) == [
        "residual-q.svg",
        "response-q.svg",
        "spectrum-q.svg",
        "speed-q.svg",
        "time-q.svg",
        "where-q.svg",
    ]
    assert f"written: {out_file}" in out
    assert str(folder) in err
    stored = rl.load(out_file)
    assert stored.status is rl.Status.CONVERGED
    assert len(stored.data["simulated"]["q"]) == 800


def test_model_from_a_file(run, record_file, tmp_path):
    rl.save(tmp_path / "axis.h5", rl.linearise(rl.plant("servo-axis", M=110.0)))
    code, out, _ = run("compare", tmp_path / "axis.h5", record_file, "--json")
    assert code == 0
    assert json.loads(out)["outputs"]["q"]["fit"] > 99.99


def test_noise_floor_from_a_stated_period_and_from_a_repeated_file(run, tmp_path):
    t = np.arange(1200) * 1e-2
    u = np.tile(np.repeat(np.random.default_rng(0).standard_normal(8), 50), 3)
    clean = rl.simulate(rl.plant("servo-axis"), t, u)["q"]
    for k in range(2):
        q = clean + 1e-4 * np.random.default_rng(k).standard_normal(1200)
        rl.save(tmp_path / f"run{k}.h5", rl.Record(t, {"u": u}, {"q": q}, {"u": "V", "q": "m"}, f"run{k}"))
    first, second = tmp_path / "run0.h5", tmp_path / "run1.h5"
    for extra, source in ((("--period", "4"), "periods"), (("--repeat", second), "repeated records"), ((), "periods")):
        code, out, _ = run("compare", "servo-axis", first, "--json", *extra)
        noise = json.loads(out)["noise"]
        assert (code, noise["floor"]["source"]) == (0, source)
        assert noise["floor"]["std"]["q"] == pytest.approx(1e-4, rel=0.1)
    code, _, err = run("compare", "servo-axis", first, "--period", "3")
    assert (code, "does not repeat with a period of 3 s" in err) == (3, True)


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (("nothing.h5",), 3, "nothing.h5"),
        (("servo-axs", "--set", "M=1"), 2, "did you mean servo-axis"),
        (("servo-axis", "--set", "M"), 2, "NAME=VALUE"),
        (("servo-axis", "--set", "Mass=1"), 3, "Mass"),
        (("servo-axis", "--unit", "u=A"), 3, "the file states V, the unit given is A"),
        (("servo-axis", "--inputs", "q", "--outputs", "u"), 3, "no input 'u'"),
        (("servo-axis", "--window", "1000"), 3, "window"),
        (("dc-motor",), 3, "phi"),
    ],
)
def test_faults(run, record_file, arguments, code, says):
    found, out, err = run("compare", arguments[0], record_file, *arguments[1:])
    assert (found, out) == (code, "")
    assert says in err


def test_columns_of_other_names_come_with_the_command_that_maps_them(capsys, record_file, tmp_path):
    def run(*words):
        code = main_guard(lambda: main.run(["data", *map(str, words)]))
        return code, capsys.readouterr().err

    record = rl.load(record_file)
    columns = np.column_stack([record.t, record.inputs["u"], record["q"]])
    path = tmp_path / "a.csv"
    np.savetxt(path, columns, delimiter=",", header="time,drive [V],Q", comments="", fmt="%.12g")
    code, err = run("compare", "servo-axis", path)
    assert code == 3
    typed = err.strip().splitlines()[-1].removeprefix("hint: robustlab data ")
    assert typed == f"compare servo-axis {path} --inputs u=drive --outputs q=Q"
    assert run(*typed.split())[0] == 0
    np.savetxt(path, columns, delimiter=",", header="t,a,b", comments="", fmt="%.12g")
    code, err = run("compare", "servo-axis", path)
    assert (code, "columns left: a, b" in err, "--inputs u=COLUMN" in err) == (3, True, True)
