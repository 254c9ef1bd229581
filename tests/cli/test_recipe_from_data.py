"""``robustlab recipe new --from-data``: a recipe for a record of the user's, which runs as it is written."""

import json
import tomllib

import numpy as np
import pytest

from robustlab.cli.ending import main_guard
from robustlab.cli.main import run as command


@pytest.fixture
def robustlab(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)

    def call(*arguments, code=0):
        assert main_guard(lambda: command(arguments)) == code
        out, err = capsys.readouterr()
        return out if code == 0 else err

    return call


def write(path, header, *columns, delimiter=","):
    np.savetxt(path, np.column_stack(columns), delimiter=delimiter, header=header, comments="", fmt="%.9g")


@pytest.fixture
def motion(tmp_path):
    """A carriage under a square wave: M v' = gain u - Fv v by Euler in steps of 0.1 ms."""
    t = np.arange(0.0, 2.0, 1e-4)
    u = np.sign(np.sin(2 * np.pi * t + 0.1))
    v, q = np.zeros_like(t), np.zeros_like(t)
    for k in range(len(t) - 1):
        v[k + 1] = v[k] + 1e-4 * (35.15 * u[k] - 203.5 * v[k]) / 95.1
        q[k + 1] = q[k] + 1e-4 * v[k]
    return t[::20], u[::20], q[::20]


def test_a_recipe_with_a_plant_runs_as_it_is(robustlab, motion, tmp_path):
    t, u, q = motion
    write(tmp_path / "07 run.csv", "time [ms],U [V],position [mm]", 1e3 * t, u, 1e3 * q)
    found = json.loads(robustlab("recipe", "new", "--from-data", "07 run.csv", "--plant", "servo-axis", "--json"))
    assert found["file"] == "run.toml"
    assert found["inputs"] == ["u=U"]
    assert found["outputs"] == ["q=position"]
    assert found["units"] == {"q": "mm"}
    assert found["dt"] == pytest.approx(2e-3)
    recipe = tomllib.loads((tmp_path / "run.toml").read_text())
    assert recipe["step"]["record"]["path"] == "07 run.csv"
    robustlab("run", "run.toml")
    numbers = {s["name"]: s["numbers"] for s in json.loads((tmp_path / "out/run/result.json").read_text())["steps"]}
    assert numbers["record"]["duration"] == pytest.approx(t[-1])
    assert numbers["compare"]["outputs"]["q"]["fit"] > 95.0  # mm and ms were understood: else nothing would fit


def test_times_are_guessed_and_said_to_be(robustlab, motion, tmp_path):
    t, u, q = motion
    write(tmp_path / "a.csv", "elapsed_time;volt;pos", 5.0 + t, u, q, delimiter=";")
    text = robustlab("recipe", "new", "--from-data", "a.csv")
    assert "guessed: elapsed_time" in text
    written = (tmp_path / "a.toml").read_text()
    assert 'clock = "elapsed_time"' in written
    assert "DECIDE: elapsed_time rises" in written
    assert "states no unit of pos" in written
    robustlab("run", "a.toml")


def test_nothing_is_written_over_without_force(robustlab, motion, tmp_path):
    t, u, q = motion
    write(tmp_path / "a.csv", "t,u,q", t, u, q)
    (tmp_path / "mine.toml").write_text("mine")
    assert "exists already" in robustlab("recipe", "new", "mine", "--from-data", "a.csv", code=5)
    assert (tmp_path / "mine.toml").read_text() == "mine"
    robustlab("recipe", "new", "mine", "--from-data", "a.csv", "--force")
    assert tomllib.loads((tmp_path / "mine.toml").read_text())["step"]["record"]["inputs"] == ["u"]


def test_what_cannot_be_recognised_is_refused_by_name(robustlab, motion, tmp_path):
    t, u, q = motion
    write(tmp_path / "a.csv", "t,speed [rpm],q [m]", t, u, q)
    err = robustlab("recipe", "new", "--from-data", "a.csv", "--plant", "servo-axis", code=3)
    assert "no channel for u of servo-axis" in err
    write(tmp_path / "b.csv", "u,q", u, q)
    assert "--dt SECONDS" in robustlab("recipe", "new", "--from-data", "b.csv", code=3)
    robustlab("recipe", "new", "--from-data", "b.csv", "--dt", "0.002")
    robustlab("recipe", "check", "b.toml")
    assert "--from-data" in robustlab("recipe", "new", "x", "--plant", "servo-axis", code=2)
    assert not (tmp_path / "a.toml").exists()


def test_names_of_channels_stay_names(robustlab, motion, tmp_path):
    t, u, q = motion
    hostile = 'q" ]\\n[step.x]'
    write(tmp_path / "a.csv", f"t;u;{hostile};π\x7f", t, u, q, q, delimiter=";")
    robustlab("recipe", "new", "--from-data", "a.csv")
    recipe = tomllib.loads((tmp_path / "a.toml").read_text(encoding="utf-8"))
    assert list(recipe["step"]) == ["record"]
    assert len(recipe["step"]["record"]["outputs"]) == 2
    robustlab("recipe", "check", "a.toml")


def test_the_unit_to_decide_on_is_one_of_the_signal(robustlab, motion, tmp_path):
    """A voltage was asked about in degrees."""
    t, u, q = motion
    write(tmp_path / "a.csv", "time,U,Q", t, u, q)
    robustlab("recipe", "new", "--from-data", "a.csv", "--plant", "servo-axis")
    written = (tmp_path / "a.toml").read_text()
    assert 'taken as V. If they are not: units = { "u" = "mV" }' in written
    assert 'taken as m. If they are not: units = { "q" = "mm" }' in written
