"""``robustlab run``, ``recipe`` and ``report`` from outside: exit codes, files, JSON, what a failed run leaves."""

from __future__ import annotations

import json
from xml.etree import ElementTree as ET

import pytest

import robustlab as rl
from robustlab.cli.ending import main_guard
from robustlab.cli.main import run
from robustlab.recipe.steps.contract import KINDS, Outcome

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


def robustlab(*arguments: str) -> int:
    return main_guard(lambda: run(arguments))


@pytest.fixture
def recipe(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.toml").write_text(RECIPE)
    return tmp_path


def result(folder):
    return json.loads((folder / "result.json").read_text(encoding="utf-8"))


def test_a_run_with_all_requirements_met(recipe, capsys):
    assert robustlab("run", "small.toml") == 0
    out, err = capsys.readouterr()
    folder = recipe / "out/small"
    assert "covered" in out
    assert f"report: {folder / 'report.html'}" in out
    assert err.splitlines()[0] == "[1/4] motor (plant)"
    written = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    assert written == {
        "result.json",
        "report.html",
        "junit.xml",
        "set.h5",
        "figures/cover-omega.svg",
        "figures/cover-omega.png",
    }
    assert set(result(folder)["files"]) == written
    assert {p.name for p in recipe.joinpath("out").iterdir()} == {"small", "latest"}
    assert (recipe / "out/latest").resolve() == folder
    assert rl.load(folder / "set.h5").blocks[0].name == "Kf"


def test_the_numbers_are_those_of_the_library(recipe):
    robustlab("run", "small.toml")
    (cover,) = [s for s in result(recipe / "out/small")["steps"] if s["name"] == "cover"]
    final = cover["numbers"]["outputs"]["omega"]["final"]
    # steady speed u Km / (R Kf + Km Kb) at both ends of Kf
    speeds = [42 * 0.052 / (2.07 * 4.8e-5 * share + 0.052**2) for share in (1.35, 1.0, 0.65)]
    assert [final["lower"], final["nominal"], final["upper"]] == pytest.approx(speeds, rel=1e-5)


def test_a_requirement_that_is_not_met_is_exit_code_1(recipe, capsys):
    assert robustlab("run", "small.toml", "--set", "set.tolerances.Kf=0.3") == 1
    assert "NOT MET" in capsys.readouterr().out
    root = ET.parse(recipe / "out/small/junit.xml").getroot()
    assert root.get("failures") == "1"
    assert "✗ not met" in (recipe / "out/small/report.html").read_text(encoding="utf-8")
    assert result(recipe / "out/small")["recipe"]["overrides"] == {"set.tolerances.Kf": "0.3"}


def test_json_is_one_object_on_stdout(recipe, capsys):
    assert robustlab("run", "small.toml", "--json", "--out", "elsewhere") == 0
    data = json.loads(capsys.readouterr().out)
    assert data["schema"] == "robustlab.result/1"
    assert data["command"] == "run"
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
    assert robustlab("run", "small.toml") == 0
    assert not (folder / "set.h5").exists()
    assert (folder / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize(
    ("change", "code", "message"),
    [
        ("set.tolerances.Kg=0.1", 3, "step.set: dc-motor: 'Kg': no such parameter"),
        ("cover.input.v=1.0", 3, "input 'v': no such signal"),
        ("motor.plant=dc-moter", 3, "did you mean dc-motor?"),
        ("require.0.that=cover.outputs.omega.cover", 3, "has no 'cover'"),
        ("cover.n=-1", 3, "step.cover.n"),
        ("covr.n=1", 2, "did you mean cover?"),
    ],
)
def test_a_run_that_cannot_be_done_keeps_the_previous_one(recipe, capsys, change, code, message):
    robustlab("run", "small.toml")
    before = {p: p.read_bytes() for p in (recipe / "out/small").rglob("*") if p.is_file()}
    assert robustlab("run", "small.toml", "--set", change) == code
    assert message in capsys.readouterr().err
    assert {p: p.read_bytes() for p in (recipe / "out/small").rglob("*") if p.is_file()} == before
    assert {p.name for p in (recipe / "out").iterdir()} == {"small", "latest"}


def test_ctrl_c_is_130_and_keeps_the_previous_run(recipe, capsys, monkeypatch):
    robustlab("run", "small.toml")
    before = (recipe / "out/small/result.json").read_bytes()

    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(KINDS["sample"], "run", interrupt)
    assert robustlab("run", "small.toml") == 130
    assert "interrupted" in capsys.readouterr().err
    assert (recipe / "out/small/result.json").read_bytes() == before
    assert {p.name for p in (recipe / "out").iterdir()} == {"small", "latest"}


def test_no_trustworthy_number_is_exit_code_4_and_the_rest_is_reported(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name, pole in (("a", 1.0), ("b", 2.0)):
        rl.save(tmp_path / f"{name}.h5", rl.StateSpaceModel([[pole]], [[1.0]], [[1.0]], [[0.0]]))
    (tmp_path / "unstable.toml").write_text(UNSTABLE)
    assert robustlab("run", "unstable.toml") == 4
    out = capsys.readouterr().out
    assert "no trustworthy number: step margin" in out
    assert "unstable" in out
    data = result(tmp_path / "out/unstable")
    assert [(q["met"], bool(q["why_not"])) for q in data["requirements"]] == [(False, True), (True, False)]
    page = (tmp_path / "out/unstable/report.html").read_text(encoding="utf-8")
    assert "No trustworthy number" in page
    root = ET.parse(tmp_path / "out/unstable/junit.xml").getroot()
    assert (root.get("failures"), root.get("errors")) == ("1", "1")


def test_a_status_that_is_not_trustworthy_is_exit_code_4(recipe, monkeypatch):
    numbers = {"outputs": {"omega": {"covers": [True]}}}
    outcome = Outcome(None, "done", numbers, status=rl.Status.INACCURATE)
    monkeypatch.setattr(KINDS["sample"], "run", lambda *_: outcome)
    assert robustlab("run", "small.toml") == 4
    assert result(recipe / "out/small")["requirements"][0]["met"]


def test_names_from_a_file_stay_text(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    evil = '"><script>alert(1)</script>\x1b[31m\u202e/../x'
    for name, pole in (("a", -1.0), ("b", -2.0)):
        model = rl.StateSpaceModel([[pole]], [[1.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=[evil], states=[evil])
        rl.save(tmp_path / f"{name}.h5", model)
    sample = '[step.margin]\ndo = "sample"\nof = "set"\nn = 2\ninput = { u = 1.0 }\nt_end = 1.0\npoints = 11\n'
    head, _, _ = UNSTABLE.partition("[step.margin]")
    (tmp_path / "r.toml").write_text(head + sample)
    assert robustlab("run", "r.toml") == 0
    page = (tmp_path / "out/unstable/report.html").read_text(encoding="utf-8")
    assert "<script>" not in page
    assert not set("\x1b\u202e") & set(page + capsys.readouterr().out)
    assert all(p.parent.name in ("unstable", "figures") for p in (tmp_path / "out").rglob("*") if p.is_file())


def test_an_output_that_is_a_file_is_exit_code_5(recipe, capsys):
    (recipe / "taken").write_text("x")
    assert robustlab("run", "small.toml", "--out", "taken") == 5
    assert "is a file" in capsys.readouterr().err


def test_a_folder_that_cannot_be_made_is_exit_code_5(recipe, capsys):
    (recipe / "taken").write_text("x")
    assert robustlab("run", "small.toml", "--out", "taken/below") == 5
    assert "taken/below: cannot be made" in capsys.readouterr().err


def test_an_unknown_shipped_recipe_names_the_nearest(recipe, capsys):
    assert robustlab("run", "first-ligth") == 3
    assert "did you mean first-light?" in capsys.readouterr().err


# --- recipe check, schema, new; report -------------------------------------------------------------------------------


def test_a_new_recipe_checks_and_runs(recipe, capsys):
    assert robustlab("recipe", "new", "mine") == 0
    assert robustlab("recipe", "check", "mine.toml") == 0
    assert robustlab("run", "mine.toml") == 0
    capsys.readouterr()
    assert robustlab("recipe", "new", "mine") == 5
    assert "exists already" in capsys.readouterr().err
    (recipe / "below").mkdir()
    assert robustlab("recipe", "new", "below/mine") == 0
    assert robustlab("recipe", "check", "below/mine.toml") == 0
    capsys.readouterr()
    assert robustlab("recipe", "new", "nowhere/mine") == 5
    assert "no such folder" in capsys.readouterr().err
    for name in ("below/", "..", "below/a b"):
        assert robustlab("recipe", "new", name) == 2, name


def test_check_names_steps_and_files(recipe, capsys):
    assert robustlab("recipe", "check", "small.toml", "--json") == 0
    assert json.loads(capsys.readouterr().out)["steps"][1] == ["set", "uncertain", ""]
    (recipe / "bad.toml").write_text(RECIPE + "x = 1\ny = 2\n")
    assert robustlab("recipe", "check", "bad.toml") == 3
    assert capsys.readouterr().err.splitlines()[:3] == [
        "error: bad.toml: 2 faults",
        "  require.0.x: unknown key",
        "  require.0.y: unknown key",
    ]


def test_check_finds_an_absent_record_before_anything_runs(recipe, capsys):
    (recipe / "gone1.h5").write_bytes(b"")  # a file of nearly that name must not hide how to point to a copy
    assert robustlab("recipe", "check", "emps", "--set", "record.path=gone.h5") == 3
    err = capsys.readouterr().err
    assert "Janot" in err
    assert "--set record.path=FILE" in err


def test_the_schema_is_json(capsys):
    assert robustlab("recipe", "schema") == 0
    assert json.loads(capsys.readouterr().out)["title"] == "Recipe"


def test_report_writes_the_same_page_again(recipe, capsys):
    robustlab("run", "small.toml")
    page = recipe / "out/small/report.html"
    before = page.read_bytes()
    page.unlink()
    assert robustlab("report", "out/small") == 0
    assert page.read_bytes() == before
    assert robustlab("report", "nowhere") == 3


# --- steps that are given something else than they need ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("step", "message"),
    [
        ('do = "robust-stability"\nof = "a"', "step 'a': gave a StateSpaceModel, expected an UncertainModel"),
        ('do = "sample"\nof = "a"\nn = 1\ninput = { u1 = 1.0 }\nt_end = 1.0', "expected an UncertainModel"),
        ('do = "compare"\nof = "a"\nrecord = "a"', "expected a Record"),
        (
            'do = "worst-case"\nof = "set"\nmetric = "peak-deviation"\ninput = { u9 = 1.0 }\nt_end = 1.0',
            "no such signal",
        ),
        ('do = "worst-case"\nof = "set"\noutput = "y9"\ninput = { u1 = 1.0 }\nt_end = 1.0', "y9"),
        ('do = "close-loop"\nof = "set"\ncontroller = "wide"', "controller: 2 inputs and 1 outputs, expected 1 and 1"),
        ('do = "steady-state"\nof = "a"\ninputs = { u9 = 1.0 }', "no such input"),
        ('do = "hinf"\nof = "a"\nmeasurements = 5\ncontrols = 1', "n_meas is 5"),
    ],
)
def test_a_step_that_does_not_fit_is_bad_input(tmp_path, monkeypatch, capsys, step, message):
    monkeypatch.chdir(tmp_path)
    for name, pole in (("a", -1.0), ("b", -2.0)):
        rl.save(tmp_path / f"{name}.h5", rl.StateSpaceModel([[pole]], [[1.0]], [[1.0]], [[0.0]]))
    rl.save(tmp_path / "wide.h5", rl.StateSpaceModel([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]]))
    head, _, _ = UNSTABLE.partition("[step.margin]")
    (tmp_path / "r.toml").write_text(f'{head}[step.wide]\ndo = "load"\npath = "wide.h5"\n[step.last]\n{step}\n')
    assert robustlab("run", "r.toml") == 3
    err = capsys.readouterr().err
    assert "r.toml: step.last" in err
    assert message in err


def test_responses_that_outgrow_every_number_are_no_trustworthy_number(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name, pole in (("a", 1.0), ("b", 2.0)):
        rl.save(tmp_path / f"{name}.h5", rl.StateSpaceModel([[pole]], [[1.0]], [[1.0]], [[0.0]]))
    head, _, _ = UNSTABLE.partition("[step.margin]")
    sample = '[step.s]\ndo = "sample"\nof = "set"\nn = 2\ninput = { u1 = 1.0 }\nt_end = 2000.0\npoints = 11\n'
    (tmp_path / "r.toml").write_text(head + sample)
    assert robustlab("run", "r.toml") == 4
    assert "responses outgrow every number" in capsys.readouterr().out
