"""``robustlab data check --model``: fit for naming or not, with the exit code that says why."""

import json

import numpy as np
import pytest

import robustlab as rl
from robustlab.cli.data import app
from robustlab.cli.ending import main_guard

T = 1e-3 * np.arange(2000)
U = np.repeat(np.random.default_rng(0).uniform(-1, 1, 20), 100)
RUN = rl.simulate(rl.plant("servo-axis"), T, U)


@pytest.fixture
def check(capfd, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)

    def call(q, v, *options, t=T, code=0):
        np.savetxt("r.csv", np.column_stack([t, U, q, v]), delimiter=",", header="t,u [V],q [m],v [m/s]", comments="")
        arguments = ["check", "r.csv", "--model", "servo-axis", *options]
        assert main_guard(lambda: app(arguments, standalone_mode=False)) == code
        return capfd.readouterr()

    return call


def test_a_good_record(check):
    out, err = check(RUN["q"], RUN["v"])
    assert "fit for naming" in out
    assert err == ""


def test_a_turned_sign_is_printed_and_ends_with_3(check):
    out, err = check(RUN["q"], -RUN["v"], code=3)
    assert "FATAL: v: v seems to be measured with the other sign" in out
    assert err.startswith("error: r: v: v seems to be measured with the other sign")
    assert "hint:" in err


def test_json_carries_the_findings_also_when_they_are_fatal(check):
    found = json.loads(check(1e3 * RUN["q"], RUN["v"], "--json", code=3).out)["suitability"]
    assert found["fit"] is False
    (finding,) = [f for f in found["findings"] if f["fatal"]]
    assert (finding["kind"], finding["channel"], finding["evidence"]["unit"]) == ("unit", "q", "mm")


def test_too_poor_a_record_ends_with_4(check):
    noise = np.random.default_rng(1).standard_normal((2, 2000))
    _, err = check(1e-6 * noise[0], 1e-4 * noise[1], code=4)
    assert "does not leave its noise" in err


def test_a_clock_that_runs_backwards_never_gets_so_far(check):
    t = T.copy()
    t[700] = t[698]
    _, err = check(RUN["q"], RUN["v"], t=t, code=3)
    assert "t[700] = 0.698 s runs backwards" in err
    assert "expected strictly increasing times" in err


def test_the_plants_parameters_can_be_set(check):
    out, _ = check(RUN["q"], RUN["v"], "--set", "Fv=1.0")  # M / Fv = 95 s: told, and no reason to refuse
    assert "less than the model's slowest time constant of 95.1" in out


def test_settings_need_a_model(capfd):
    assert main_guard(lambda: app(["check", "r.csv", "--set", "Fv=1.0"], standalone_mode=False)) == 2
    assert "no --model" in capfd.readouterr().err
