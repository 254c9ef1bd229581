"""Plants of the user's own on the command line and in recipes: file.py:name, plant show, plant new."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from patience import PATIENCE

import robustlab as rl
from robustlab.cli.ending import main_guard
from robustlab.cli.main import run

AXIS = """
from robustlab.dynamics import Descriptor, LinearPlant, Parameter, overridden
from robustlab.statespace import Signal

PARAMETERS = (
    Parameter("M", 95.0, "kg", 0.05, "weighed", "moving mass", "positive", role="inertia"),
    Parameter("Fv", 203.0, "N s/m", 0.1, "coasting", "viscous friction", "nonnegative", role="viscous-friction"),
    Parameter("gain", 35.0, "N/V", 0.0, "data sheet", "force per volt", "either", role="input-gain"),
)


def axis(**given):
    states = (Signal("q", "m"), Signal("v", "m/s"))
    return LinearPlant("axis", overridden(PARAMETERS, given, "axis"), (Signal("u", "V"),), states, states, equations)


def equations(p):
    return Descriptor(
        E=[[1, 0], [0, p["M"]]], F=[[0, 1], [0, -p["Fv"]]], G=[[0], [p["gain"]]], C=[[1, 0], [0, 1]]
    )
"""
# Prints by Python, by a child process and on the file itself, when it is run, when it makes the plant, and later.
NOISY = AXIS.replace("def axis", "import os\nprint('A')\nos.system('echo B')\nos.write(1, b'C')\n\ndef axis").replace(
    "    return Desc", "    print('D')\n    return Desc"
)


def record(path, seed=1, coulomb=0.0):
    """A simulated run of the axis, with noise on the position; as CSV."""
    plant = rl.plant("servo-axis", M=95.0, Fv=203.0, gain=35.0)
    if coulomb:
        plant = rl.with_effects(plant, {"coulomb-friction": {"Fc": coulomb}})
    t = np.arange(1500) * 2e-3
    u = 3.0 * np.sin(2 * np.pi * 1.3 * t) + 2.0 * np.sin(2 * np.pi * 0.4 * t + 1.0) + 1.0 * np.sign(np.sin(2.0 * t))
    q = rl.simulate(plant, t, u)["q"] + 2e-6 * np.random.default_rng(seed).standard_normal(len(t))
    rows = "\n".join(f"{a:.9g},{b:.9g},{c:.9g}" for a, b, c in zip(t, u, q, strict=True))
    path.write_text(f"t,u,q\n{rows}\n")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "axis.py").write_text(AXIS)
    (tmp_path / "noisy.py").write_text(NOISY)
    return tmp_path


def told(capsys, *words):
    """Exit code, stdout and stderr of a command."""
    code = main_guard(lambda: run(list(words)))
    out, err = capsys.readouterr()
    return code, out, err


def digest(path="axis.py"):
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


# --- everywhere a plant is taken -------------------------------------------------------------------------------------


def test_model_build_and_uncertain_build_keep_the_hash(folder, capsys):
    assert told(capsys, "model", "build", "axis.py:axis", "--set", "M=96", "--out", "m.h5")[0] == 0
    assert (
        told(capsys, "uncertain", "build", "--plant", "axis.py:axis", "--tolerance", "M=0.2", "--out", "u.h5")[0] == 0
    )
    model, uncertain = rl.load("m.h5"), rl.load("u.h5")
    assert model.B[1, 0] == 35.0 / 96.0
    assert [(b.name, b.parameter.radius) for b in uncertain.blocks] == [("M", 19.0), ("Fv", pytest.approx(20.3))]
    for thing in (model, uncertain):
        assert thing.provenance.inputs == {"axis.py": digest()}
        assert "axis.py:axis" in thing.provenance.note


def test_data_check_compare_validate_take_it(folder, capsys):
    record(folder / "run.csv")
    words = ("run.csv", "--inputs", "u", "--outputs", "q", "--json")
    code, out, _ = told(capsys, "data", "check", *words, "--model", "axis.py:axis")
    assert (code, json.loads(out)["command"]) == (0, "data check")
    code, out, _ = told(capsys, "data", "compare", "axis.py:axis", *words, "--out", "c.h5")
    assert code == 0
    assert rl.load("c.h5").provenance.inputs["axis.py"] == digest()
    own = told(capsys, "data", "compare", "servo-axis", *words, "--set", "M=95", "--set", "Fv=203", "--set", "gain=35")
    assert json.loads(out)["outputs"] == json.loads(own[1])["outputs"]
    words = ("run.csv", "--outputs", "q", "--noise", "q=2e-5", "--json", "--out", "v.h5")
    code, out, _ = told(capsys, "data", "validate", "axis.py:axis", *words)
    assert code == 0
    assert json.loads(out)["upper"] < 0.1
    assert rl.load("v.h5").provenance.inputs["axis.py"] == digest()


def test_data_discover_names_what_the_own_plant_lacks(folder, capsys):
    record(folder / "run.csv", coulomb=8.0)
    words = ("--inputs", "u", "--outputs", "q", "--json", "--out", "found")
    code, out, err = told(capsys, "data", "discover", "axis.py:axis", "run.csv", *words)
    assert code == 0, err
    found = json.loads(out)
    assert (found["verdict"], [e["name"] for e in found["effects"]]) == ("named", ["coulomb-friction"])
    assert json.loads(Path("found/result.json").read_text())["provenance"]["inputs"]["axis.py"] == digest()
    assert rl.load("found/updated-plant.h5").provenance.inputs["axis.py"] == digest()


RECIPE = """
schema = "robustlab.recipe/1"
name = "own"
title = "An axis of one's own"

[step.axis]
do = "plant"
plant = "machines/axis.py:axis"
parameters = { M = [96.0, 0.1] }

[step.set]
do = "uncertain"
of = "axis"
tolerances = { M = 0.1 }

[[require]]
text = "The mass is the one of the recipe"
that = "axis.parameters.M.value"
equals = 96.0
tolerance = 0.0
"""


def test_a_recipe_runs_a_file_beside_it(folder, capsys, tmp_path_factory, monkeypatch):
    (folder / "machines").mkdir()
    (folder / "axis.py").rename(folder / "machines" / "axis.py")
    (folder / "own.toml").write_text(RECIPE)
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    monkeypatch.chdir(elsewhere)
    code, out, _ = told(capsys, "run", f"{folder}/own.toml", "--json")
    assert code == 0
    result = json.loads(out)
    sha = digest(folder / "machines" / "axis.py")
    assert result["provenance"]["inputs"] == {"axis: axis.py": sha}
    assert result["steps"][0]["numbers"]["code"] == {"machines/axis.py": sha}
    report = (elsewhere / "out/own/report.html").read_text()
    assert sha in report
    assert str(folder) not in report.replace(str(elsewhere), "")


NONLINEAR = """
schema = "robustlab.recipe/1"
name = "slope"
title = "A carriage on an incline"

[step.axis]
do = "plant"
plant = "slope.py:axis"
parameters = { m = 10.0 }

[step.model]
do = "linearise"
of = "axis"
at = { F = 0.0 }

[step.kept]
do = "save"
of = "axis"
file = "axis.h5"

[[require]]
text = "Half the damping over the mass"
that = "model.spectral_abscissa"
within = [-3.000001, -2.999999]
"""


def test_a_recipe_takes_a_nonlinear_plant_its_rest_by_name_and_keeps_it_whole(folder, capsys):
    assert told(capsys, "plant", "new", "slope")[0] == 0
    (folder / "slope.toml").write_text(NONLINEAR)
    code, out, err = told(capsys, "run", "slope.toml", "--json", "--out", "out")
    assert code == 0, err
    assert ["Rest", "F = 0"] in [[fact["label"], fact["value"]] for fact in json.loads(out)["steps"][1]["facts"]]
    kept = rl.load("out/axis.h5")
    assert kept.parameters["m"].value == 10.0
    assert kept.provenance.inputs["axis: slope.py"] == digest("slope.py")
    x = rl.trim(kept, F=0.0).x[0]
    assert 800 * x + 2e5 * x**3 == pytest.approx(-10.0 * 9.81 * np.sin(0.35), rel=1e-9)
    for wrong, expected in (("{ G = 0.0 }", "'G': no state, input or output"), ("[0, 0, 0, 0, 0, 0]", "pose")):
        (folder / "slope.toml").write_text(NONLINEAR.replace("{ F = 0.0 }", wrong))
        code, _, err = told(capsys, "run", "slope.toml")
        assert (code, expected in err) == (3, True), err


@pytest.mark.parametrize(
    ("plant", "expected"),
    [
        ("lost.py:axis", "own.toml: step.axis.plant: lost.py: no such file (looked in"),
        ("../../outside.py:axis", "leaves the recipe folder"),
        ("axis.py:axs", "own.toml: step.axis: axis.py: no plant 'axs' in it, expected one of axis.py:axis\nhint: did"),
        ("axis.py", "own.toml: step.axis: axis.py: which plant of it?, expected one of axis.py:axis"),
        ("x" * 400 + ".py:axis", "File name too long"),
        ("bad.py:axis", "own.toml: step.axis: bad.py, line 1: ZeroDivisionError"),
    ],
)
def test_a_recipe_with_a_faulty_plant_writes_a_report_that_says_so(folder, capsys, plant, expected):
    (folder / "inner").mkdir()
    (folder.parent / "outside.py").write_text(AXIS)
    (folder / "inner" / "bad.py").write_text("1 / 0")
    (folder / "inner" / "axis.py").write_text(AXIS)
    (folder / "inner" / "own.toml").write_text(RECIPE.replace("machines/axis.py:axis", plant))
    code, out, err = told(capsys, "run", "inner/own.toml", "--json")
    assert (code, out) == (3, "")
    assert expected in err
    data = json.loads(Path("out/own/result.json").read_text(encoding="utf-8"))
    assert (data["exit_code"], data["ending"]["how"]) == (3, "bad input")
    assert not [step for step in data["steps"] if step["numbers"]]


def test_checking_a_recipe_runs_no_code(folder, capsys):
    (folder / "axis.py").write_text("from pathlib import Path\nPath('was-run').touch()\n" + AXIS)
    (folder / "own.toml").write_text(RECIPE.replace("machines/", ""))
    assert told(capsys, "recipe", "check", "own.toml")[0] == 0
    assert not Path("was-run").exists()


# --- nothing but the result on stdout --------------------------------------------------------------------------------


def process(*words, **options):
    command = [sys.executable, "-m", "robustlab.cli.main", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False, **options)


def test_what_a_file_prints_does_not_stand_in_the_result(folder):
    done = process("plant", "show", "noisy.py:axis", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["name"] == "axis"
    assert all(letter in done.stderr for letter in "ABCD")
    (folder / "own.toml").write_text(RECIPE.replace("machines/axis", "noisy"))
    done = process("run", "own.toml", "--json")
    assert json.loads(done.stdout)["exit_code"] == 0


def test_in_this_process_too(folder, capsys):
    stdout = sys.stdout
    code, out, err = told(capsys, "model", "build", "noisy.py:axis", "--out", "m.h5", "--json")
    assert (code, json.loads(out)["inputs"]) == (0, [["u", "V"]])
    assert "A" in err
    assert sys.stdout is stdout


def test_ctrl_c_ends_an_endless_loop(folder):
    (folder / "loop.py").write_text("from pathlib import Path\nPath('began').touch()\nwhile True:\n    pass\n")
    words = [sys.executable, "-m", "robustlab.cli.main", "model", "build", "loop.py:axis", "--out", "m.h5"]
    heard = {"preexec_fn": lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)}  # what runs behind a shell ignores it
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True, **heard) as child:
        try:
            until = time.monotonic() + PATIENCE
            while not Path("began").exists() and time.monotonic() < until:
                time.sleep(0.1)
            os.kill(child.pid, signal.SIGINT)
            _, err = child.communicate(timeout=PATIENCE)
        finally:
            child.kill()
    assert (child.returncode, err.strip()) == (130, "interrupted")
    assert not Path("m.h5").exists()


# --- faults ----------------------------------------------------------------------------------------------------------

LATER = AXIS.replace("    return Descriptor(", "    if p['M'] == 96.0:\n        p['nothing']\n    return Descriptor(")
FAULTS = [
    ("x = 1 +\n", 3, "error: bad.py, line 1: is no Python: invalid syntax"),
    ("import casadi_of_mine\n", 3, "error: bad.py, line 1: ModuleNotFoundError"),
    ("import sys\nsys.exit(0)\n", 3, "error: bad.py, line 2: ends the program (sys.exit(0))"),
    ("raise KeyboardInterrupt\n", 130, "interrupted"),
    ("axis = 3\n", 3, "error: bad.py:axis: a int, expected a plant"),
    ("import robustlab as rl\nrl.plant('dc-mtor')\n", 3, "error: bad.py, line 2: plant 'dc-mtor': no such plant"),
    ("from robustlab.errors import UsageError\nraise UsageError('a', 'b')\n", 3, "error: bad.py, line 2: a: b"),
    ("from robustlab.errors import NoTrustworthyNumber as N\nraise N('a', 'b')\n", 4, "error: bad.py, line 2: a: b"),
    ("raise OSError(28, 'No space left on device')\n", 3, "error: bad.py, line 1: OSError: [Errno 28]"),
    (LATER, 3, "error: bad.py, line 19: KeyError: 'nothing'"),
]


@pytest.mark.parametrize(("content", "code", "expected"), FAULTS)
@pytest.mark.parametrize(
    "words",
    [
        ["model", "build", "bad.py:axis", "--set", "M=96", "--out", "new.h5"],
        ["plant", "show", "bad.py:axis", "--set", "M=96"],
        ["data", "compare", "bad.py:axis", "run.csv", "--set", "M=96", "--out", "new.h5"],
    ],
)
def test_faults_have_their_exit_code_and_leave_nothing_behind(folder, capsys, content, code, expected, words):
    (folder / "bad.py").write_text(content)
    before = set(folder.iterdir())
    found, out, err = told(capsys, *words)
    assert (found, out) == (code, "")
    assert err.startswith(expected), err
    assert len(err.splitlines()) <= 2  # the second is the hint
    assert set(folder.iterdir()) - before <= {folder / "__pycache__"}


def test_equations_that_raise_only_later_are_no_bug_of_ours(folder, capsys):
    """All is well while the plant is made; the command's own use of it then meets the error."""
    text = AXIS.replace("def equations(p):\n", "calls = iter(range(7))\n\n\ndef equations(p):\n    next(calls)\n")
    (folder / "bad.py").write_text(text)
    rl.plant("bad.py:axis")
    code, out, err = told(capsys, "model", "build", "bad.py:axis", "--out", "new.h5")
    assert (code, out) == (3, "")
    assert err.startswith("error: bad.py, line 21: StopIteration")


# --- plant show and plant new ----------------------------------------------------------------------------------------


def test_show_says_what_the_plant_is(folder, capsys):
    code, out, _ = told(capsys, "plant", "show", "axis.py:axis")
    assert code == 0
    for text in (f"made of axis.py, SHA-256 {digest()}", "inputs: u [V]", "v      N           q", "+-5 %", "inertia"):
        assert text in out
    assert "-2.13684    2.13684            1" in out  # -Fv / M
    shown = json.loads(told(capsys, "plant", "show", "axis.py:axis", "--json")[1])
    assert shown["joints"] == [{"name": "v", "kind": "joint", "unit": "N", "position": "q"}]
    assert [p["role"] for p in shown["parameters"]] == ["inertia", "viscous-friction", "input-gain"]
    assert sorted(p["re"] if isinstance(p, dict) else p[0] for p in shown["poles"]) == pytest.approx([-203 / 95, 0.0])
    assert shown["made_of"] == {"axis.py": digest()}


def test_show_lists_the_plants_of_a_file_and_takes_built_in_ones_and_files(folder, capsys):
    assert told(capsys, "plant", "show", "axis.py")[:2] == (0, "axis.py:axis\n")
    assert json.loads(told(capsys, "plant", "show", "axis.py", "--json")[1])["plants"] == ["axis"]
    (folder / "empty.py").write_text("")
    assert told(capsys, "plant", "show", "empty.py")[:2] == (0, "empty.py: no plant in it\n")
    rl.save("motor.h5", rl.with_effects(rl.plant("dc-motor"), {"coulomb-friction": {"Fc": 2e-3}}))
    code, out, _ = told(capsys, "plant", "show", "motor.h5")
    assert code == 0
    assert "Coulomb (dry) friction at omega" in out
    assert told(capsys, "plant", "show", "dc-motor", "--at", "u=1")[0] == 2
    assert told(capsys, "plant", "show", "dc-mtor")[0] == 3


def test_show_without_a_point_of_rest_prints_the_rest_and_ends_with_4(folder, capsys):
    """x' = 1 + x^2 stands nowhere."""
    (folder / "runaway.py").write_text(
        "import robustlab as rl\np = rl.PlantEquations('runaway')\nx, u = p.state('x', 'm'), p.input('u', 'N')\n"
        "p.rate(x, 1 + x**2 + u**2)\np.output('x', x, 'm')\nrunaway = p.plant()\n"
    )
    code, out, err = told(capsys, "plant", "show", "runaway.py:runaway")
    assert code == 4
    assert "operating point: none found" in out
    assert "no operating point: runaway: no rest was found" in err
    shown = json.loads(told(capsys, "plant", "show", "runaway.py:runaway", "--json")[1])
    assert (shown["operating_point"], shown["poles"], shown["outputs"]) == (None, None, [{"name": "x", "unit": "m"}])
    code, out, err = told(capsys, "plant", "show", "runaway.py:runaway", "--at", "y=0")
    assert (code, out) == (3, "")
    assert "'y': no state, input or output" in err


def test_new_writes_a_plant_and_never_over_a_file(folder, capsys):
    code, out, _ = told(capsys, "plant", "new", "mymachine")
    assert (code, out) == (0, "mymachine.py\nlook at it with: robustlab plant show mymachine.py:axis\n")
    text = (folder / "mymachine.py").read_text()
    compile(text, "mymachine.py", "exec")
    assert "{" not in text.replace("{file}", "")
    (folder / "mymachine.py").write_text("kept")
    assert told(capsys, "plant", "new", "mymachine.py")[0] == 5
    assert (folder / "mymachine.py").read_text() == "kept"
    (folder / "gone.py").symlink_to("nowhere.py")
    assert told(capsys, "plant", "new", "gone")[0] == 5
    (folder / "below").mkdir()
    code, out, _ = told(capsys, "plant", "new", "below/other")
    assert (code, out.splitlines()[0]) == (0, "below/other.py")
    before = set(folder.iterdir())
    for name in ("class", "numpy", "a-b", "..", "below/", "", "3d", "a" * 80, "a b"):
        assert told(capsys, "plant", "new", name)[0] == 2, name
    assert set(folder.iterdir()) == before
