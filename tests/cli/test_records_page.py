"""docs/records.md: its commands and its code run on files of other software, and print what stands beside them."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import record_files as rf
import scipy.io

import robustlab as rl
from robustlab.cli.data import app
from robustlab.cli.ending import main_guard
from robustlab.dynamics.effects.catalogue import catalogue

PAGE = (Path(__file__).parents[2] / "docs" / "records.md").read_text(encoding="utf-8")
N, H = 400, 5_000_000  # samples, ns


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """One run of the servo axis as a table, a bag (position in mm, both topics logged 1 ms late) and a Simulink log."""
    folder = tmp_path_factory.mktemp("records")
    t = np.arange(N) * H / 1e9
    u = np.sign(np.sin(9 * t)) + np.sin(5 * t)
    run = rl.simulate(rl.plant("servo-axis"), t, u)
    pq.write_table(pa.table({"t": t, "u": u, "q": run["q"], "note": ["x"] * N}), folder / "run.parquet")
    events = []
    for k in range(N):
        stamp = rf.T0 + k * H
        events.append(("/drive", "number", stamp + 10**6, {"data": u[k]}))
        events.append(("/axis", "joints", stamp + 10**6, rf.joints(stamp, [1e3 * run["q"][k]], ["axis"])))
    rf.bag(folder / "bag.mcap", events)
    signals = np.empty((1, 2), dtype=[("values", object), ("label", object)])
    signals[0, 0], signals[0, 1] = (u[:, None], "u"), (run["q"][:, None], "q")
    scipy.io.savemat(folder / "run.mat", {"simout": {"time": t[:, None], "signals": signals}})
    return folder


@pytest.fixture
def call(capfd, monkeypatch, folder):
    monkeypatch.chdir(folder)

    def run(*arguments, code=0):
        assert main_guard(lambda: app(list(arguments), standalone_mode=False)) == code
        return capfd.readouterr()

    return run


def commands():
    (block,) = re.findall(r"```sh\n(.*?)```", PAGE, flags=re.DOTALL)
    return [shlex.split(line)[2:] for line in block.splitlines()]


def test_the_commands_run(call):
    parquet, bag, convert, compare, simulink = commands()
    assert "400 samples" in call(*parquet).out
    found = json.loads(call(*bag, "--json").out)
    assert [c["name"] for c in found["channels"]] == ["u", "q"]
    assert any("times are those of the log (/drive has no stamps)" in text for text in found["remarks"])
    assert any("/axis: stamps against log times: no drift" in text for text in found["remarks"])
    assert not any("interpolated" in text for text in found["remarks"])  # the two clocks are equal
    assert "bag.mcap: times are those of the log" in call(*convert).err
    back = rl.load("run.h5")
    assert (back.unit("q"), back.n) == ("m", N)
    assert "delay 0.001 s" in back.meaning["t"]
    told = call(*compare, "--json")
    assert json.loads(told.out)["outputs"]["q"]["windowed_rms_percent"] < 1e-6
    assert "q: converted from mm to m" in told.err
    assert "[u] -> [q]" not in call(*simulink).err


def test_the_commands_refuse_in_one_line(call):
    told = call(
        "discover", "servo-axis", "bag.mcap", "--inputs", "u=/drive.date", "--outputs", "q=/axis.position[0]", code=3
    )
    assert told.err.startswith("error: bag.mcap: missing /drive.date (did you mean /drive.data?), expected numeric")
    told = call("compare", "servo-axis", "run.parquet", "--outputs", "note", code=3)
    assert "note: dtype string, expected a column of real numbers" in told.err
    told = call("check", "bag.mcap", code=3)
    assert "/axis (200 Hz): position[0]; /drive (200 Hz): data" in told.err


def test_a_group_by_its_place_in_the_name(call):
    told = call("discover", "servo-axis", "run.mat#simin", "--outputs", "q", code=3)
    assert "missing group /simin" in told.err


def test_friction_is_named_from_a_bag_of_two_clocks_with_jitter(call, folder):
    """Position at 200 Hz, command at 1 kHz, both logged up to 0.2 ms late; the truth is Coulomb friction of 20 N."""
    rng = np.random.default_rng(0)
    t = np.arange(3000) * 1e-3
    u = np.repeat(rng.uniform(-3.0, 3.0, size=15), 200)
    machine = rl.with_effects(rl.plant("servo-axis"), {"coulomb-friction": {"Fc": 20.0}})
    q = rl.simulate(machine, t, u)["q"] + 1e-6 * rng.standard_normal(len(t))
    late = rng.integers(0, 200_000, (2, len(t)))
    events = [("/drive", "number", rf.T0 + k * 10**6 + late[0, k], {"data": u[k]}) for k in range(len(t))]
    events += [("/axis", "number", rf.T0 + k * 10**6 + late[1, k], {"data": q[k]}) for k in range(0, len(t), 5)]
    rf.bag(folder / "friction.mcap", sorted(events, key=lambda event: event[2]))
    tried = ("coulomb-friction", "constant-load", "viscous-friction")
    excluded = [word for name in catalogue() if name not in tried for word in ("--exclude", name)]
    signals = ("--inputs", "u=/drive.data", "--outputs", "q=/axis.data", "--unit", "u=V", "--unit", "q=m")
    told = call("discover", "servo-axis", "friction.mcap", *signals, *excluded, "--json")
    result = json.loads(told.out)
    assert (result["verdict"], result["names"]) == ("named", ["coulomb-friction"])
    assert result["effects"][0]["parameters"][0]["value"] == pytest.approx(20.0, rel=0.05)
    assert re.search(r"2 clocks brought on one of (199\.9|200)\S* Hz \(that of /axis\)", told.err)
    assert "outputs interpolated at 9" in told.err


def test_the_code_runs(monkeypatch, tmp_path, capsys):
    (block,) = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(block, {})
    said = [line.partition("  # ")[2].strip() for line in block.splitlines() if line.startswith("print")]
    said = [text for text in said if text]
    assert capsys.readouterr().out.splitlines() == said
