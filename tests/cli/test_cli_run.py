"""``robustlab run``, ``recipe`` and ``report`` as commands: exit codes, files, JSON, files of a failed run."""

import json
import signal
import subprocess
import sys
from xml.etree import ElementTree as ET

import pytest
from shell import robustlab

import robustlab as rl
from robustlab.recipe import KINDS, Outcome

RECIPE = """\
schema = "robustlab.recipe/1"
name = "small"
[step.motor]
do = "plant"
plant = "dc-motor"
[step.set]
do = "uncertain"
of = "motor"
tolerances = { Kf = 0.35 }
outputs = ["omega"]
[step.cover]
do = "sample"
of = "set"
n = 3
vertices = 2
input = { u = 42.0 }
t_end = 0.06
points = 61
reference = [{ output = "omega", value = 788.5, text = "data sheet" }]
[step.file]
do = "save"
of = "set"
file = "set.h5"
[[require]]
text = "covered"
that = "cover.outputs.omega.covers.0"
equals = true
"""

UNSTABLE = """\
schema = "robustlab.recipe/1"
name = "unstable"
[step.a]
do = "load"
path = "a.h5"
[step.b]
do = "load"
path = "b.h5"
[step.set]
do = "elementwise"
nominal = "a"
perturbed = "b"
[step.margin]
do = "robust-stability"
of = "set"
[[require]]
text = "robustly stable"
that = "margin.lower"
at_least = 1.0
[[require]]
text = "ends at the perturbed model"
that = "set.endpoint_residual"
at_most = 1e-12
"""


@pytest.fixture
def recipe(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.toml").write_text(RECIPE)
    return tmp_path


def result(folder):
    return json.loads((folder / "result.json").read_text(encoding="utf-8"))


def test_a_run_with_all_requirements_met(recipe):
    ending = robustlab("run", "small.toml", code=0)
    folder = recipe / "out/small"
    assert f"report: {folder / 'report.html'}" in ending.out
    assert ending.err.splitlines()[0] == "[1/4] motor (plant)"
    written = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    assert written == {"result.json", "report.html", "junit.xml", "set.h5", "figures/cover-omega.svg"}
    assert set(result(folder)["files"]) == written
    assert {p.name for p in recipe.joinpath("out").iterdir()} == {"small"}
    assert rl.load(folder / "set.h5").blocks[0].name == "Kf"
    (cover,) = [s for s in result(folder)["steps"] if s["name"] == "cover"]
    final = cover["numbers"]["outputs"]["omega"]["final"]
    # steady speed u Km / (R Kf + Km Kb) at both ends of Kf
    speeds = [42 * 0.052 / (2.07 * 4.8e-5 * share + 0.052**2) for share in (1.35, 1.0, 0.65)]
    assert [final["lower"], final["nominal"], final["upper"]] == pytest.approx(speeds, rel=1e-5)
    assert (folder / "report.html").read_text(encoding="utf-8").count('<details class="step">') == 4
    text = RECIPE.replace("cover.outputs.omega.covers.0", "set.spectral_abscissa").replace(
        "equals = true", "at_most = 0"
    )
    (recipe / "small.toml").write_text(text)
    robustlab("run", "small.toml", "--png", code=0)
    assert not (folder / "figures").is_dir() or not list((folder / "figures").iterdir())
    robustlab("run", "small.toml", "--png", "--figures", "all", code=0)
    assert {p.name for p in (folder / "figures").iterdir()} == {"cover-omega.svg", "cover-omega.png"}


def test_a_requirement_that_is_not_met_is_exit_code_1(recipe):
    ending = robustlab("run", "small.toml", "--set", "set.tolerances.Kf=0.3", "--out", "out/small", code=1)
    assert "NOT MET" in ending.out
    root = ET.parse(recipe / "out/small/junit.xml").getroot()
    assert root.get("failures") == "1"
    assert "✗ not met" in (recipe / "out/small/report.html").read_text(encoding="utf-8")
    assert result(recipe / "out/small")["recipe"]["overrides"] == {"set.tolerances.Kf": "0.3"}


def test_json_is_one_object_on_stdout(recipe):
    data = robustlab("run", "small.toml", "--json", "--out", "elsewhere", code=0).json
    assert (data["schema"], data["command"]) == ("robustlab.result/1", "run")
    assert data["folder"] == str(recipe / "elsewhere")


def test_the_same_seed_gives_the_same_numbers_and_figures(recipe):
    for out in ("a", "b"):
        robustlab("run", "small.toml", "--out", out)
    robustlab("run", "small.toml", "--out", "c", "--set", "seed=1")
    numbers = [[s["numbers"] for s in result(recipe / out)["steps"] if s["name"] == "cover"] for out in "abc"]
    figures = [(recipe / out / "figures/cover-omega.svg").read_bytes() for out in "abc"]
    assert numbers[0] == numbers[1]
    assert figures[0] == figures[1]
    assert figures[0] != figures[2]


def test_a_second_run_replaces_its_own_files_and_no_others(recipe):
    robustlab("run", "small.toml")
    folder = recipe / "out/small"
    (folder / "notes.txt").write_text("mine")
    short = RECIPE[: RECIPE.index("[step.file]")] + RECIPE[RECIPE.index("[[require]]") :]
    (recipe / "small.toml").write_text(short)
    assert robustlab("run", "small.toml").code == 0
    assert not (folder / "set.h5").exists()
    assert (folder / "notes.txt").read_text() == "mine"


# --- however a run ends, the report is that of this run --------------------------------------------------------------


def page_of(folder):
    return (folder / "report.html").read_text(encoding="utf-8")


def cases_of(folder):
    """Name of a test case -> what is in it."""
    root = ET.parse(folder / "junit.xml").getroot()
    return {case.get("name"): [(mark.tag, mark.get("message")) for mark in case] for case in root.iter("testcase")}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("Kf = 0.35", "Kg = 0.1"), "step.set.tolerances.Kg: 'Kg': motor has no such parameter, expected one of R, L"),
        (("u = 42.0", "v = 42.0"), "step.cover.input.v: 'v': set has no such input, expected one of u"),
        (("dc-motor", "dc-moter"), "did you mean dc-motor?"),
        (("omega.covers.0", "omega.cover"), "require.0.that: cover.outputs.omega has no 'cover'"),
    ],
)
def test_faults_before_the_first_step_are_in_the_report_too(recipe, change, message):
    robustlab("run", "small.toml")
    (recipe / "small.toml").write_text(RECIPE.replace(*change))
    err = robustlab("run", "small.toml", code=3).err
    assert message in err
    assert "[1/4]" not in err  # no step was begun
    folder = recipe / "out/small"
    assert f"report of what was run: {folder / 'report.html'}" in err
    data = result(folder)
    assert (data["exit_code"], data["ending"]["how"]) == (3, "bad input")
    assert message in data["ending"]["message"]
    assert {s["status"] for s in data["steps"]} == {"not run"}
    assert "This run did not finish: bad input before the first step" in page_of(folder)
    assert cases_of(folder)["the run finishes"][0][0] == "error"
    assert not (folder / "set.h5").exists()  # of the run before
    assert {p.name for p in (recipe / "out").iterdir()} == {"small"}


@pytest.mark.parametrize(
    ("error", "code", "how", "words"),
    [
        (
            rl.InputError("covers", "too wide", "a narrower one"),
            3,
            "bad input",
            "covers: too wide, expected a narrower",
        ),
        (KeyboardInterrupt(), 130, "interrupted", "the run was interrupted"),
        (ZeroDivisionError("division by zero"), 70, "internal error", "ZeroDivisionError: division by zero"),
        (OSError(28, "No space left on device"), 5, "environment", "No space left on device"),
    ],
)
def test_a_step_that_ends_the_run_is_in_the_report(recipe, monkeypatch, error, code, how, words):
    robustlab("run", "small.toml")

    def fails(*_):
        raise error

    monkeypatch.setattr(KINDS["sample"], "run", fails)
    assert robustlab("run", "small.toml").code == code
    folder = recipe / "out/small"
    data = result(folder)
    assert (data["exit_code"], data["ending"]["how"]) == (code, how)
    assert [s["status"] for s in data["steps"]] == ["done", "done", how, "not run"]
    assert words in data["steps"][2]["error"]
    (requirement,) = data["requirements"]
    assert (requirement["met"], requirement["value"]) == (False, None)
    assert requirement["why_not"] == f"step 'cover' gave no number ({how})"
    page = page_of(folder)
    assert f"This run did not finish: {how} in step cover" in page
    assert words in page
    assert "✗ cannot be judged" in page
    cases = cases_of(folder)
    assert cases["covered"][0] == ("error", requirement["why_not"])
    assert set(cases) == {"covered", "cover", "file", "the run finishes"}
    assert {p.name for p in folder.rglob("*") if p.is_file()} == {"result.json", "report.html", "junit.xml"}
    assert {p.name for p in (recipe / "out").iterdir()} == {"small"}
    monkeypatch.undo()
    monkeypatch.chdir(recipe)
    assert robustlab("run", "small.toml").code == 0
    assert "The requirement is met" in page_of(folder)


KILLED = """
import os, signal, sys
from robustlab.cli import main_guard, run_command
from robustlab.recipe import KINDS
import robustlab.recipe.steps
KINDS["sample"].run = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
main_guard(lambda: run_command(["run", "small.toml"]))
"""


def test_a_killed_run_has_the_report_of_an_unfinished_run(recipe):
    robustlab("run", "small.toml")
    robustlab("run", "small.toml", "--set", "seed=3")
    done = subprocess.run([sys.executable, "-c", KILLED], capture_output=True, cwd=recipe, check=False)
    assert done.returncode == -signal.SIGKILL
    folder = recipe / "out/small"
    data = result(folder)
    assert (data["exit_code"], data["ending"]["how"]) == (None, "running")
    assert "This run has not finished" in page_of(folder)
    assert "met</td>" not in page_of(folder)
    assert cases_of(folder)["covered"] == [("error", "step 'cover' gave no number (not run)")]
    assert robustlab("report", str(folder)).code == 0  # written again, it says the same
    assert "This run has not finished" in page_of(folder)
    assert robustlab("report", "compare", "out/small-seed-3", "out/small").code == 1
    assert robustlab("run", "small.toml").code == 0
    assert set(result(folder)["files"]) == {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}


# --- requirements that cannot be judged ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("numbers", "code", "words"),
    [
        ({"outputs": {"omega": {}}}, 3, "cover.outputs.omega has no 'covers', expected nothing below"),
        ({"outputs": {"omega": {"covers": [0.5]}}}, 1, ""),
        ({"outputs": {"omega": {"covers": [None]}}}, 1, ""),
    ],
)
def test_a_number_that_is_not_there_after_all_is_a_fault_in_the_report(recipe, monkeypatch, numbers, code, words):
    monkeypatch.setattr(KINDS["sample"], "run", lambda *_: Outcome(None, "done", numbers))
    out = robustlab("run", "small.toml", code=code).out
    data = result(recipe / "out/small")
    (requirement,) = data["requirements"]
    assert not requirement["met"]
    assert words in requirement["why_not"]
    assert ("CANNOT BE JUDGED" in out) == bool(words)
    assert data["steps"][3]["status"] == "done"
    if words:
        assert "1 requirement cannot be judged" in page_of(recipe / "out/small")
        assert cases_of(recipe / "out/small")["covered"][0][0] == "error"


def lags(*poles):
    for name, pole in zip("ab", poles, strict=True):
        rl.save(f"{name}.h5", rl.StateSpaceModel([[pole]], [[1.0]], [[1.0]], [[0.0]]))


def test_no_trustworthy_number_is_exit_code_4_and_the_rest_is_reported(recipe):
    lags(1.0, 2.0)
    (recipe / "unstable.toml").write_text(UNSTABLE)
    assert "no trustworthy number: step margin" in robustlab("run", "unstable.toml", code=4).out
    folder = recipe / "out/unstable"
    assert [(q["met"], bool(q["why_not"])) for q in result(folder)["requirements"]] == [(False, True), (True, False)]
    assert "No trustworthy number" in page_of(folder)
    root = ET.parse(folder / "junit.xml").getroot()
    assert (root.get("failures"), root.get("errors")) == ("0", "2")  # a requirement that nobody can judge, and its step


def test_a_status_that_is_not_trustworthy_is_exit_code_4(recipe, monkeypatch):
    numbers = {"outputs": {"omega": {"covers": [True]}}}
    outcome = Outcome(None, "done", numbers, status=rl.Status.INACCURATE)
    monkeypatch.setattr(KINDS["sample"], "run", lambda *_: outcome)
    assert robustlab("run", "small.toml").code == 4
    assert result(recipe / "out/small")["requirements"][0]["met"]


def test_names_from_a_file_stay_text(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    evil = '"><script>alert(1)</script>\x1b[31m\u202e/../x'
    for name, pole in (("a", -1.0), ("b", -2.0)):
        model = rl.StateSpaceModel([[pole]], [[1.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=[evil], states=[evil])
        rl.save(tmp_path / f"{name}.h5", model)
    sample = '[step.margin]\ndo = "sample"\nof = "set"\nn = 2\ninput = { u = 1.0 }\nt_end = 1.0\npoints = 11\n'
    head, _, _ = UNSTABLE.partition("[step.margin]")
    (tmp_path / "r.toml").write_text(head + sample)
    out = robustlab("run", "r.toml", code=0).out
    page = page_of(tmp_path / "out/unstable")
    assert "<script>" not in page
    assert not set("\x1b\u202e") & set(page + out)
    assert all(
        p.parent.name in ("unstable", "figures", "evidence") for p in (tmp_path / "out").rglob("*") if p.is_file()
    )


@pytest.mark.parametrize(("out", "words"), [("taken", "is a file"), ("taken/below", "taken/below: cannot be made")])
def test_a_folder_that_cannot_be_is_exit_code_5(recipe, out, words):
    (recipe / "taken").write_text("x")
    assert words in robustlab("run", "small.toml", "--out", out, code=5).err


# --- recipe check, schema, new; report -------------------------------------------------------------------------------


def test_a_new_recipe_checks_and_runs(recipe):
    (recipe / "below").mkdir()
    for name in ("mine", "below/mine"):
        robustlab("recipe", "new", name, code=0)
        robustlab("recipe", "check", f"{name}.toml", code=0)
    robustlab("run", "mine.toml", code=0)
    assert "exists already" in robustlab("recipe", "new", "mine", code=5).err


def test_check_names_steps_and_faults(recipe):
    assert robustlab("recipe", "check", "small.toml", "--json", code=0).json["steps"][1] == ["set", "uncertain", ""]
    (recipe / "bad.toml").write_text(RECIPE + "x = 1\ny = 2\n")
    lines = robustlab("recipe", "check", "bad.toml", code=3).err.splitlines()
    assert lines[0] == "error: bad.toml: 2 faults"
    assert [line.partition("; ")[0] for line in lines[1:3]] == [f"  require.0.{key}: unknown key" for key in "xy"]


def test_check_finds_an_absent_record_before_anything_runs(recipe):
    (recipe / "gone1.h5").write_bytes(b"")  # a file of nearly that name must not hide how to point to a copy
    err = robustlab("recipe", "check", "emps", "--set", "record.path=gone.h5", code=3).err
    assert "Janot" in err
    assert "--set record.path=FILE" in err


def test_report_writes_the_same_page_again(recipe):
    robustlab("run", "small.toml")
    page = recipe / "out/small/report.html"
    before = page.read_bytes()
    page.unlink()
    robustlab("report", "out/small", code=0)
    assert page.read_bytes() == before


# --- steps that are given something else than they need ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("step", "message"),
    [
        ('do = "sample"\nof = "a"\nn = 1\ninput = { u1 = 1.0 }\nt_end = 1.0', "expected an UncertainModel"),
        ('do = "compare"\nof = "a"\nrecord = "a"', "expected a Record"),
        ('do = "worst-case"\nof = "set"\noutput = "y9"\ninput = { u1 = 1.0 }\nt_end = 1.0', "y9"),
        ('do = "close-loop"\nof = "set"\ncontroller = "wide"', "controller: 2 inputs and 1 outputs, expected 1 and 1"),
        ('do = "hinf"\nof = "a"\nmeasurements = 5\ncontrols = 1', "n_meas is 5"),
    ],
)
def test_a_step_that_does_not_fit_is_bad_input(recipe, step, message):
    lags(-1.0, -2.0)
    rl.save("wide.h5", rl.StateSpaceModel([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]]))
    head, _, _ = UNSTABLE.partition("[step.margin]")
    (recipe / "r.toml").write_text(f'{head}[step.wide]\ndo = "load"\npath = "wide.h5"\n[step.last]\n{step}\n')
    err = robustlab("run", "r.toml", code=3).err
    assert "r.toml: step.last" in err
    assert message in err


def test_responses_that_outgrow_every_number_are_no_trustworthy_number(recipe):
    lags(1.0, 2.0)
    head, _, _ = UNSTABLE.partition("[step.margin]")
    sample = '[step.s]\ndo = "sample"\nof = "set"\nn = 2\ninput = { u1 = 1.0 }\nt_end = 2000.0\npoints = 11\n'
    (recipe / "r.toml").write_text(head + sample)
    assert "responses outgrow every number" in robustlab("run", "r.toml", code=4).out
