"""Plants of the user's own on the command line and in recipes: file.py:name, plant show, plant new."""

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
from shell import robustlab

import robustlab as rl

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


def digest(path="axis.py"):
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


# --- everywhere a plant is taken -------------------------------------------------------------------------------------


def test_model_build_and_uncertain_build_keep_the_hash(folder):
    robustlab("model", "build", "axis.py:axis", "--set", "M=96", "--out", "m.h5", code=0)
    robustlab("uncertain", "plant", "axis.py:axis", "--tolerance", "M=0.2", "--out", "u.h5", code=0)
    model, uncertain = rl.load("m.h5"), rl.load("u.h5")
    assert model.B[1, 0] == 35.0 / 96.0
    assert [(b.name, b.parameter.radius) for b in uncertain.blocks] == [("M", 19.0), ("Fv", pytest.approx(20.3))]
    for thing in (model, uncertain):
        assert thing.provenance.inputs == {"axis.py": digest()}
        assert "axis.py:axis" in thing.provenance.note


def test_data_check_compare_validate_take_it(folder):
    record(folder / "run.csv")
    words = ("run.csv", "--inputs", "u", "--outputs", "q", "--json")
    robustlab("data", "check", *words, "--model", "axis.py:axis", code=0)
    found = robustlab("data", "compare", "axis.py:axis", *words, "--out", "c.h5", code=0).json
    assert rl.load("c.h5").provenance.inputs["axis.py"] == digest()
    own = ("--set", "M=95", "--set", "Fv=203", "--set", "gain=35")
    assert robustlab("data", "compare", "servo-axis", *words, *own, code=0).json["outputs"] == found["outputs"]
    words = ("run.csv", "--outputs", "q", "--noise", "q=2e-5", "--json", "--out", "v.h5")
    assert robustlab("data", "validate", "axis.py:axis", *words, code=0).json["upper"] < 0.1
    assert rl.load("v.h5").provenance.inputs["axis.py"] == digest()


@pytest.mark.slow
def test_data_discover_identifies_the_missing_effect_of_a_users_plant(folder):
    record(folder / "run.csv", coulomb=8.0)
    words = ("--inputs", "u", "--outputs", "q", "--json", "--out", "found")
    found = robustlab("data", "discover", "axis.py:axis", "run.csv", *words, code=0).json
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


def test_a_recipe_runs_a_file_in_its_folder(folder, tmp_path_factory, monkeypatch):
    (folder / "machines").mkdir()
    (folder / "axis.py").rename(folder / "machines" / "axis.py")
    (folder / "own.toml").write_text(RECIPE)
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    monkeypatch.chdir(elsewhere)
    found = robustlab("run", f"{folder}/own.toml", "--json", code=0).json
    sha = digest(folder / "machines" / "axis.py")
    assert found["provenance"]["inputs"] == {"axis: axis.py": sha}
    assert found["steps"][0]["numbers"]["code"] == {"machines/axis.py": sha}
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


def test_a_recipe_takes_a_nonlinear_plant_and_its_equilibrium_by_name_and_saves_it(folder):
    robustlab("plant", "new", "slope", code=0)
    (folder / "slope.toml").write_text(NONLINEAR)
    found = robustlab("run", "slope.toml", "--json", "--out", "out", code=0).json
    assert ["Rest", "F = 0"] in [[fact["label"], fact["value"]] for fact in found["steps"][1]["facts"]]
    kept = rl.load("out/axis.h5")
    assert kept.parameters["m"].value == 10.0
    assert kept.provenance.inputs["axis: slope.py"] == digest("slope.py")
    x = rl.trim(kept, F=0.0).x[0]
    assert 800 * x + 2e5 * x**3 == pytest.approx(-10.0 * 9.81 * np.sin(0.35), rel=1e-9)
    for wrong, expected in (("{ G = 0.0 }", "'G': no state, input or output"), ("[0, 0, 0, 0, 0, 0]", "pose")):
        (folder / "slope.toml").write_text(NONLINEAR.replace("{ F = 0.0 }", wrong))
        assert expected in robustlab("run", "slope.toml", code=3).err


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
def test_a_recipe_with_a_faulty_plant_writes_a_report_of_the_fault(folder, plant, expected):
    (folder / "inner").mkdir()
    (folder.parent / "outside.py").write_text(AXIS)
    (folder / "inner" / "bad.py").write_text("1 / 0")
    (folder / "inner" / "axis.py").write_text(AXIS)
    (folder / "inner" / "own.toml").write_text(RECIPE.replace("machines/axis.py:axis", plant))
    code, out, err = robustlab("run", "inner/own.toml", "--json")
    assert (code, out) == (3, "")
    assert expected in err
    data = json.loads(Path("out/own/result.json").read_text(encoding="utf-8"))
    assert (data["exit_code"], data["ending"]["how"]) == (3, "bad input")
    assert not [step for step in data["steps"] if step["numbers"]]


def test_checking_a_recipe_runs_no_code(folder):
    (folder / "axis.py").write_text("from pathlib import Path\nPath('was-run').touch()\n" + AXIS)
    (folder / "own.toml").write_text(RECIPE.replace("machines/", ""))
    robustlab("recipe", "check", "own.toml", code=0)
    assert not Path("was-run").exists()


# --- nothing but the result on stdout --------------------------------------------------------------------------------


def test_what_a_file_prints_does_not_stand_in_the_result(folder):
    """By a process of its own: what is written on the file itself cannot be seen in this one."""
    command = [sys.executable, "-m", "robustlab.cli.main", "plant", "show", "noisy.py:axis", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=True)
    assert json.loads(done.stdout)["name"] == "axis"
    assert all(letter in done.stderr for letter in "ABCD")


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
    ("x = 1 +\n", 3, "error: bad.py, line 1: not valid Python: invalid syntax"),
    ("import sys\nsys.exit(0)\n", 3, "error: bad.py, line 2: ends the program (sys.exit(0))"),
    ("raise KeyboardInterrupt\n", 130, "interrupted"),
    ("axis = 3\n", 3, "error: bad.py:axis: a int, expected a plant"),
    ("from robustlab.errors import NoTrustworthyNumber as N\nraise N('a', 'b')\n", 4, "error: bad.py, line 2: a: b"),
    ("raise OSError(28, 'No space left on device')\n", 3, "error: bad.py, line 1: OSError: [Errno 28]"),
    (LATER, 3, "error: bad.py, line 19: KeyError: 'nothing'"),
]


@pytest.mark.parametrize(("content", "code", "expected"), FAULTS)
@pytest.mark.parametrize("words", ["model build bad.py:axis --out new.h5", "data compare bad.py:axis r.csv --out n.h5"])
def test_faults_have_their_exit_code_and_leave_nothing_behind(folder, content, code, expected, words):
    """The message for each faulty file is tested in tests/unit/dynamics/test_plant_file."""
    (folder / "bad.py").write_text(content)
    before = set(folder.iterdir())
    found, out, err = robustlab(*words.split(), "--set", "M=96")
    assert (found, out) == (code, "")
    assert err.startswith(expected), err
    assert len(err.splitlines()) <= 2  # the second is the hint
    assert set(folder.iterdir()) - before <= {folder / "__pycache__"}


def test_equations_that_raise_only_later_are_no_bug_of_ours(folder):
    """All is well while the plant is made; the command's own use of it then meets the error."""
    text = AXIS.replace("def equations(p):\n", "calls = iter(range(7))\n\n\ndef equations(p):\n    next(calls)\n")
    (folder / "bad.py").write_text(text)
    rl.plant("bad.py:axis")
    code, out, err = robustlab("model", "build", "bad.py:axis", "--out", "new.h5")
    assert (code, out) == (3, "")
    assert err.startswith("error: bad.py, line 21: StopIteration")


# --- plant show and plant new ----------------------------------------------------------------------------------------


def test_show_describes_the_plant(folder):
    assert f"made of axis.py, SHA-256 {digest()}" in robustlab("plant", "show", "axis.py:axis", code=0).out
    shown = robustlab("plant", "show", "axis.py:axis", "--json", code=0).json
    assert shown["joints"] == [{"name": "v", "kind": "joint", "unit": "N", "position": "q"}]
    assert [p["role"] for p in shown["parameters"]] == ["inertia", "viscous-friction", "input-gain"]
    assert sorted(p["re"] if isinstance(p, dict) else p[0] for p in shown["poles"]) == pytest.approx([-203 / 95, 0.0])
    assert shown["made_of"] == {"axis.py": digest()}


def test_show_lists_the_plants_of_a_file_and_takes_files_of_ours(folder):
    assert robustlab("plant", "show", "axis.py", code=0).out == "axis.py:axis\n"
    (folder / "empty.py").write_text("")
    assert robustlab("plant", "show", "empty.py", code=0).out == "empty.py: no plant in it\n"
    rl.save("motor.h5", rl.with_effects(rl.plant("dc-motor"), {"coulomb-friction": {"Fc": 2e-3}}))
    assert "Coulomb (dry) friction at omega" in robustlab("plant", "show", "motor.h5", code=0).out


def test_show_without_a_point_of_rest_prints_the_rest_and_ends_with_4(folder):
    """x' = 1 + x^2 has no equilibrium."""
    (folder / "runaway.py").write_text(
        "import robustlab as rl\np = rl.PlantEquations('runaway')\nx, u = p.state('x', 'm'), p.input('u', 'N')\n"
        "p.rate(x, 1 + x**2 + u**2)\np.output('x', x, 'm')\nrunaway = p.plant()\n"
    )
    ending = robustlab("plant", "show", "runaway.py:runaway", "--json", code=4)
    assert "no operating point: runaway: no rest was found" in ending.err
    shown = ending.json
    assert (shown["operating_point"], shown["poles"], shown["outputs"]) == (None, None, [{"name": "x", "unit": "m"}])
    err = robustlab("plant", "show", "runaway.py:runaway", "--at", "y=0", code=3).err
    assert "'y': no state, input or output" in err


def test_new_writes_a_plant_and_never_over_a_file(folder):
    out = robustlab("plant", "new", "mymachine", code=0).out
    assert out == "mymachine.py\nlook at it with: robustlab plant show mymachine.py:axis\n"
    compile((folder / "mymachine.py").read_text(), "mymachine.py", "exec")
    (folder / "mymachine.py").write_text("kept")
    robustlab("plant", "new", "mymachine.py", code=5)
    assert (folder / "mymachine.py").read_text() == "kept"
    (folder / "gone.py").symlink_to("nowhere.py")
    robustlab("plant", "new", "gone", code=5)
    before = set(folder.iterdir())
    for name in ("class", "numpy", "a-b", "..", "below/", "", "3d", "a" * 80, "a b"):
        robustlab("plant", "new", name, code=2)
    assert set(folder.iterdir()) == before
