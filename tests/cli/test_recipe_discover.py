"""The recipe step that identifies missing effects, and the steps that use the updated plant."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recipe_runs import entry

import robustlab as rl
from robustlab.dynamics import catalogue
from robustlab.errors import InputError
from robustlab.identification.data_checks import Finding
from robustlab.recipe import load_recipe, parse_recipe, run_recipe

PAGE = (Path(__file__).parents[2] / "docs" / "discover.md").read_text(encoding="utf-8")
HEAD = """schema = "robustlab.recipe/1"
name = "axis"
[step.axis]
do = "plant"
plant = "servo-axis"
[step.train]
do = "record"
path = "run7.h5"
inputs = ["u"]
"""
DISCOVER = """[step.naming]
do = "discover"
of = "axis"
records = ["train"]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the record of a servo axis with 20 N of dry friction."""
    t = np.arange(1200) * 2.5e-3
    rng = np.random.default_rng(7)
    u = np.repeat(rng.uniform(-3.0, 3.0, size=15), 80)
    machine = rl.with_effects(rl.plant("servo-axis"), {"coulomb-friction": {"Fc": 20.0}})
    q = rl.simulate(machine, t, u)["q"] + 1e-6 * rng.standard_normal(len(t))
    made = tmp_path_factory.mktemp("recipe")
    rl.save(made / "run7.h5", rl.Record(t, {"u": u}, {"q": q}, {"u": "V", "q": "m"}, "run7"))
    return made


@pytest.fixture(scope="module")
def real(folder):
    exclude = [name for name in catalogue() if name not in ("coulomb-friction", "constant-load")]
    found = rl.discover(rl.plant("servo-axis"), rl.load(folder / "run7.h5"), exclude=exclude)
    machine = rl.with_effects(rl.plant("servo-axis"), {"coulomb-friction": {"Fc": (20.0, 0.1)}})
    return replace(found, model=machine)


@pytest.fixture
def run(folder, tmp_path, monkeypatch, real):
    def call(rest, found=real):
        monkeypatch.setattr(
            "robustlab.identification.missing_effects.discovery.discover", lambda *_arguments, **_options: found
        )
        path = folder / "axis.toml"
        path.write_text(HEAD + rest, encoding="utf-8")
        return run_recipe(load_recipe(path), tmp_path / "out")

    return call


def require(that, condition):
    return f'[[require]]\ntext = "t"\nthat = "{that}"\n{condition}\n'


@pytest.mark.slow
def test_the_updated_plant_goes_on_through_the_recipe(run):
    later = (
        '[step.linear]\ndo = "linearise"\nof = "naming"\n'
        '[step.set]\ndo = "uncertain"\nof = "naming"\ntolerances = { M = 0.02 }\noutputs = ["v"]\n'
        '[step.kept]\ndo = "save"\nof = "naming"\nfile = "machine.h5"\n'
        '[step.back]\ndo = "load"\nsaved = "kept"\n'
    )
    conditions = (
        require("naming.verdict", 'equals = "named"')
        + require("naming.names", 'contains = "coulomb-friction"')
        + require("naming.effects.coulomb-friction.Fc", "within = [19.8, 20.2]")
        + require("naming.gap_ratio", "at_least = 100.0")
    )
    result = run(DISCOVER + later + conditions)
    assert [q["why_not"] or q["value"] for q in result.data["requirements"] if not q["met"]] == []
    assert result.exit_code == 0
    page = (result.folder / "report.html").read_text(encoding="utf-8")
    assert "servo-axis lacks Coulomb (dry) friction" in page
    assert [f["stem"] for f in entry(result, "naming")["figures"]] == [
        "naming-gap",
        "naming-force",
        "naming-run-q",
    ]
    for name in ("naming-plant.h5", "machine.h5"):
        assert [e.effect.id for e in rl.load(result.folder / name).effects] == ["coulomb-friction"]
    assert {"naming-plant.h5", "evidence/naming.h5"} <= set(result.data["files"])
    assert rl.load(result.folder / "evidence" / "naming.h5").data["verdict"] == "named"


@pytest.mark.slow
def test_a_requirement_that_is_not_met_ends_in_1(run):
    result = run(DISCOVER + require("naming.names", 'contains = "backlash"'))
    (judged,) = result.data["requirements"]
    assert (result.exit_code, judged["met"], judged["value"]) == (1, False, ["coulomb-friction"])
    assert judged["condition"] == "contains 'backlash'"
    assert "coulomb-friction" in (result.folder / "report.html").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("accept", "code", "status"), [("", 4, "inconclusive"), ('accept = ["ambiguous"]\n', 0, "converged")]
)
def test_an_open_verdict_is_accepted_only_where_the_recipe_does(run, real, accept, code, status):
    open_one = replace(real, status=rl.Status.INCONCLUSIVE, verdict="ambiguous")
    result = run(DISCOVER + accept + require("naming.verdict", 'equals = "ambiguous"'), open_one)
    assert (result.exit_code, entry(result, "naming")["status"]) == (code, status)
    assert result.data["requirements"][0]["met"]
    noted = any("is accepted by this recipe" in note for note in entry(result, "naming")["notes"])
    assert noted is (code == 0)
    kept = json.loads((result.folder / "result.json").read_text(encoding="utf-8"))
    assert kept["exit_code"] == code


def test_ctrl_c_in_the_search_ends_the_recipe(run, real):
    stopped = Finding("interrupted", "search", "stopped after 3 sets", "", "", False, {})
    with pytest.raises(KeyboardInterrupt):
        run(DISCOVER, replace(real, status=rl.Status.INCONCLUSIVE, findings=(stopped,)))


def test_requirements_may_ask_for_the_error_in_free_run(run):
    conditions = require("naming.free_run.after", "at_most = 1.0") + require("naming.free_run.before", "at_least = 5.0")
    conditions += require("naming.free_run.outputs.q.updated", "at_most = 1e-3")
    assert run(DISCOVER + conditions).exit_code == 0


def test_numbers_that_do_not_exist_are_refused(run):
    with pytest.raises(InputError, match="did you mean coulomb-friction"):
        run(DISCOVER + require("naming.effects.coulomb-fricton.Fc", "at_least = 0.0"))
    listed = run(DISCOVER + require("naming.count", 'contains = "coulomb-friction"'))
    assert listed.exit_code == 3  # a number is no list


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (DISCOVER.replace('"train"', '"trian"'), r"step.naming.records.0: no step 'trian' .*did you mean train"),
        (DISCOVER.replace('["train"]', "[]"), r"step.naming.records"),
        (DISCOVER.replace('["train"]', '["train", "axis"]'), r"records.1: step 'axis' gives plant, expected .*record"),
        (DISCOVER + 'accept = ["perhaps"]\n', r"step.naming.accept"),
        (DISCOVER + "tolerances = { M = -0.1 }\n", r"step.naming.tolerances.M"),
    ],
)
def test_faults_of_the_step_are_named(text, fault):
    with pytest.raises(InputError, match=fault):
        parse_recipe(HEAD + text, "r.toml")


def test_an_effect_that_does_not_exist_is_refused(run):
    with pytest.raises(InputError, match="did you mean backlash"):
        run(DISCOVER + 'exclude = ["backlsh"]\n')


def test_the_recipe_of_the_page_can_be_read():
    (block,) = re.findall(r"```toml\n(.*?)```", PAGE, flags=re.DOTALL)
    records = HEAD + HEAD[HEAD.index("[step.train]") :].replace("train", "test")
    recipe = parse_recipe(records + block)
    assert recipe.step["naming"].kind == "discover"
    assert len(recipe.require) == 3


def test_a_discovery_becomes_a_set_with_the_origin_of_every_block(run):
    """Dry friction without an amplitude is a bounded force; along the record it is a known signal that explains it."""
    later = (
        '[step.set]\ndo = "uncertain-from"\nof = "naming"\noutputs = ["q"]\n'
        '[step.damped]\ndo = "uncertain-from"\nof = "naming"\noutputs = ["q"]\namplitude = { v = [0.05, 0.5] }\n'
        '[step.driven]\ndo = "with-loads"\nof = "naming"\nrecord = "train"\n'
        '[step.covered]\ndo = "cover"\nof = "set"\nrecord = "driven"\nn = 2\nallowance = { q = 5e-6 }\n'
    )
    conditions = (
        require("set.inputs", "equals = 1.0")
        + require("set.left_out", "equals = 0.0")
        + require("set.bound.load v: coulomb-friction", "within = [20.1, 20.3]")
        + require("damped.count", "at_least = 1.0")
        + require("damped.range.coulomb-friction@v.low", "within = [50.0, 51.0]")  # 80 / (pi 0.5), less two std
        + require("driven.largest.load v: coulomb-friction", "within = [0.98, 1.0]")
        + require("covered.signals.q.gap", "at_most = 1e-5")
    )
    result = run(DISCOVER + later + conditions)
    assert [q["why_not"] or q["value"] for q in result.data["requirements"] if not q["met"]] == []
    printed = entry(result, "damped")["text"]
    assert "coulomb-friction@v  RealScalar  1 x 1  50.4203 .. 514.389 N/(m/s)" in printed
    assert "amplitudes 0.05 to 0.5 m/s" in printed
    assert "harmonic balance" in entry(result, "damped")["notes"][0]
    assert rl.load(result.folder / "evidence" / "set.h5").status is rl.Status.CONVERGED


def test_what_is_no_plant_has_no_blocks(run):
    with pytest.raises(InputError, match="step 'back': holds a Record, expected a discovery, or a plant"):
        run('[step.saved]\ndo = "save"\nof = "train"\nfile = "r.h5"\n[step.back]\ndo = "load"\nsaved = "saved"\n'
            '[step.set]\ndo = "uncertain-from"\nof = "back"\n')  # fmt: skip
