"""``data convert|check|compare``: exit codes, keys, files; faults of a record are reported with their place."""

from __future__ import annotations

import numpy as np
import pytest
from command_files import write_models
from shell import robustlab

import robustlab as rl

T = 1e-3 * np.arange(2000)
U = np.repeat(np.random.default_rng(0).uniform(-1, 1, 20), 100)
RUN = rl.simulate(rl.plant("servo-axis"), T, U)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_models(tmp_path)
    return tmp_path


def test_convert_and_check():
    robustlab("data", "convert", "run.csv", "r.h5", "--inputs", "u=drive", "--outputs", "q=Q", code=0)
    record, known = rl.load("r.h5"), rl.load("run.h5")
    assert (record.units["u"], list(record.inputs), record.n) == ("V", ["u"], 800)
    np.testing.assert_allclose(record["q"], known["q"], rtol=1e-9, atol=1e-15)
    found = robustlab("data", "check", "run.h5", "--json", code=0).json
    assert (found["n"], found["is_uniform"]) == (800, True)
    assert [c["side"] for c in found["channels"]] == ["input", "output"]
    assert "Q: no unit stated" in robustlab("data", "check", "run.csv", code=0).out
    assert "800 samples" in robustlab("data", "check", "comma.csv", "--decimal", ",", code=0).out


# --- check --model ---------------------------------------------------------------------------------------------------


def check(q, v, *options, t=T, code=0):
    columns = np.column_stack([t, U, q, v])
    np.savetxt("r.csv", columns, delimiter=",", header="t,u [V],q [m],v [m/s]", comments="")
    return robustlab("data", "check", "r.csv", "--model", "servo-axis", *options, code=code)


def test_a_good_record():
    _, out, err = check(RUN["q"], RUN["v"])
    assert ("fit for naming" in out, err) == (True, "")


def test_a_turned_sign_is_printed_and_ends_with_3():
    _, out, err = check(RUN["q"], -RUN["v"], code=3)
    assert "FATAL: v: v seems to be measured with the other sign" in out
    assert err.startswith("error: r: v: v seems to be measured with the other sign")
    assert "hint:" in err


def test_json_carries_the_findings_also_when_they_are_fatal():
    found = check(1e3 * RUN["q"], RUN["v"], "--json", code=3).json["suitability"]
    (finding,) = [f for f in found["findings"] if f["fatal"]]
    assert not found["fit"]
    assert (finding["kind"], finding["channel"], finding["evidence"]["unit"]) == ("unit", "q", "mm")


def test_too_poor_a_record_ends_with_4():
    noise = np.random.default_rng(1).standard_normal((2, 2000))
    assert "does not leave its noise" in check(1e-6 * noise[0], 1e-4 * noise[1], code=4).err


def test_a_clock_that_runs_backwards_never_gets_so_far():
    t = T.copy()
    t[700] = t[698]
    err = check(RUN["q"], RUN["v"], t=t, code=3).err
    assert "t[700] = 0.698 s runs backwards" in err
    assert "expected strictly increasing times" in err


def test_the_plants_parameters_can_be_set():
    out = check(RUN["q"], RUN["v"], "--set", "Fv=1.0").out  # M / Fv = 95 s: reported, no error
    assert "less than the model's slowest time constant of 95.1" in out


# --- compare ---------------------------------------------------------------------------------------------------------


def test_plant_by_name_and_parameters_and_a_model_from_a_file():
    words = ("run.h5", "--json")
    found = robustlab("data", "compare", "servo-axis", *words, "--window", "0.5", code=0).json
    assert (found["command"], found["status"]) == ("data compare", "converged")
    assert found["window"] == pytest.approx(0.5)
    assert "simulated" not in found
    assert found["outputs"]["q"]["rms_percent"] > 0.1
    found = robustlab("data", "compare", "servo-axis", *words, "--set", "M=110", code=0).json
    assert found["outputs"]["q"]["rms_percent"] < 1e-6
    rl.save("axis.h5", rl.linearise(rl.plant("servo-axis", M=110.0)))
    assert robustlab("data", "compare", "axis.h5", *words, code=0).json["outputs"]["q"]["fit"] > 99.99


@pytest.mark.slow
def test_figures_and_result_file(folder):
    robustlab("data", "compare", "servo-axis", "run.h5", "--figure", "f/", "--out", "gap.h5", code=0)
    drawn = {p.stem.removesuffix("-q") for p in (folder / "f").glob("*.svg")}
    assert drawn == {"speed", "time", "where"}
    stored = rl.load("gap.h5")
    assert (stored.status, len(stored.data["simulated"]["q"])) == (rl.Status.CONVERGED, 800)


def test_columns_of_other_names_have_to_be_named():
    words = ("data", "compare", "servo-axis", "run.csv")
    assert "expected one of time, drive, Q\nhint: name the columns" in robustlab(*words, code=3).err
    robustlab(*words, "--inputs", "u=drive", "--outputs", "q=Q", code=0)
