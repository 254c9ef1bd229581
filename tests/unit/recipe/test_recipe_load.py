"""Loading recipes: accepted files, and every fault by its dotted key (fault rows 31-33)."""

import json
import os
from pathlib import Path

import pytest

from robustlab.errors import InputError, UsageError
from robustlab.recipe import MAX_BYTES, find_file, load_recipe, parse_recipe

HEAD = 'schema = "robustlab.recipe/1"\nname = "x"\n'
MOTOR = '[step.motor]\ndo = "plant"\nplant = "dc-motor"\n'
ROOT = Path(__file__).parents[3]


def faults(text: str, **overrides: str) -> str:
    with pytest.raises(InputError) as caught:
        parse_recipe(text, "r.toml", overrides)
    assert caught.value.exit_code == 3
    return str(caught.value)


def test_all_faults_are_listed_at_once_with_their_keys():
    text = faults(
        HEAD
        + '[step.m]\ndo = "plant"\nplnt = "dc-motor"\n[step.n]\ndo = "strutural"\n[step.k]\nx = 1\n'
        + '[[require]]\nthat = "m.x"\nat_last = 1\n'
    )
    assert text.splitlines()[0] == "r.toml: 6 faults"
    assert "step.m.plant: missing" in text
    assert "step.m.plnt: unknown key (did you mean plant?)" in text
    assert "step.n.do: no such kind of step 'strutural' (did you mean structural?)" in text
    assert "step.k.do: missing" in text
    assert "require.0.text: missing" in text
    assert "require.0.at_last: unknown key (did you mean at_least?)" in text


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[step.m\ndo", "at line 1, column 8"),
        ("a = 1\na = 2\n", "Cannot overwrite a value (at line 2"),
        ("x = " + "[" * 5000, "not readable as TOML"),
        ("x = " + "1" * 5000, "not readable as TOML"),
        ("", "schema: missing"),
        ("step = 3", "step: input should be a valid dictionary"),
        ('schema = "robustlab.recipe/2"\nname = "x"\n' + MOTOR, "schema: input should be 'robustlab.recipe/1'"),
        (HEAD + "[step]\n", "step: dictionary should have at least 1 item"),
        (HEAD.replace('"x"', '"../x"') + MOTOR, "name: '../x' has characters that are not allowed here"),
        (HEAD + MOTOR.replace("step.motor", 'step."a.b"'), "characters that are not allowed here"),
        (HEAD + "seed = -1\n" + MOTOR, "seed: input should be greater than or equal to 0"),
        (HEAD + 'seed = "1"\n' + MOTOR, "seed: input should be a valid integer"),
        (HEAD + "seed = 1.5\n" + MOTOR, "seed: input should be a valid integer"),
        (HEAD + MOTOR + "parameters = { R = nan }\n", "step.motor.parameters.R: expected a number"),
        (HEAD + MOTOR + "parameters = { R = [1.0, 2.0, 3.0] }\n", "step.motor.parameters.R: expected a number"),
        (HEAD + MOTOR + '[step.l]\ndo = "load"\n', "step.l: expected either path or saved"),
        (HEAD + MOTOR + '[step.s]\ndo = "save"\nof = "motor"\nfile = "../m.h5"\n', "step.s.file"),
    ],
)
def test_one_fault(text, expected):
    assert expected in faults(text)


@pytest.mark.parametrize(
    ("condition", "expected"),
    [
        ("", "expected at_least, at_most, within, equals or contains"),
        ("at_least = 1\nat_most = 2\n", "expected one condition"),
        ("within = [2, 1]\n", "low is above high"),
        ("within = [1, 2, 3]\n", "require.0.within"),
        ("equals = true\ntolerance = 0.1\n", "tolerance belongs to an equals with a number"),
        ("at_least = inf\n", "finite number"),
    ],
)
def test_faults_of_a_requirement(condition, expected):
    assert expected in faults(HEAD + MOTOR + f'[[require]]\ntext = "t"\nthat = "motor.status"\n{condition}')


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('[step.s]\ndo = "structural"\nof = "moter"\n', "no step 'moter' before this one (did you mean motor?)"),
        ('[step.s]\ndo = "structural"\nof = "t"\n[step.t]\ndo = "linearise"\nof = "motor"\n', "comes later"),
        ('[step.s]\ndo = "structural"\nof = "s"\n', "comes later"),
        ('[step.s]\ndo = "robust-stability"\nof = "motor"\n', "gives plant, expected a step that gives uncertain"),
        ('[step.s]\ndo = "load"\nsaved = "motor"\n', "gives plant, expected a step that gives saved"),
        ('[[require]]\ntext = "t"\nthat = "motr.x"\nat_least = 1\n', "no step 'motr' (did you mean motor?)"),
        ('[[require]]\ntext = "t"\nthat = "motor"\nat_least = 1\n', "names a step, expected one of its numbers"),
    ],
)
def test_references_are_checked_before_anything_runs(text, expected):
    assert expected in faults(HEAD + MOTOR + text)


# --- files -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["r.yaml", "r.yml", "r.pkl", "r.json", "r.py"])
def test_other_formats_are_refused_with_the_reason(tmp_path, name):
    (tmp_path / name).write_text(HEAD + MOTOR)
    with pytest.raises(InputError, match=r"expected a \.toml recipe"):
        load_recipe(tmp_path / name)


def test_a_folder_a_large_file_and_other_bytes_are_refused(tmp_path):
    with pytest.raises(InputError, match="is a folder"):
        load_recipe(tmp_path)
    large = tmp_path / "large.toml"
    large.write_bytes(b"#" * (MAX_BYTES + 1))
    with pytest.raises(InputError, match="at most 1048576 bytes"):
        load_recipe(large)
    other = tmp_path / "other.toml"
    other.write_bytes(b"name = '\xff'\n")
    with pytest.raises(InputError, match="byte 8 is not UTF-8"):
        load_recipe(other)


# --- overrides -------------------------------------------------------------------------------------------------------


def test_overrides_reach_top_level_keys_steps_and_requirements():
    text = HEAD + MOTOR + '[[require]]\ntext = "t"\nthat = "motor.status"\nequals = "done"\n'
    changes = {
        "seed": "7",
        "motor.plant": "two-mass",
        "step.motor.parameters.J1": "[1.0, 0.1]",
        "require.0.equals": '"x"',
    }
    recipe = parse_recipe(text, "r", changes)
    assert recipe.seed == 7
    assert recipe.step["motor"].plant == "two-mass"
    assert recipe.step["motor"].parameters == {"J1": [1.0, 0.1]}
    assert recipe.require[0].equals == "x"


@pytest.mark.parametrize("item", ["seed", "=3", ""])
def test_an_override_without_key_and_value_is_a_usage_error(tmp_path, item):
    path = tmp_path / "r.toml"
    path.write_text(HEAD + MOTOR)
    with pytest.raises(UsageError, match="--set key=value"):
        load_recipe(path, [item])


# --- allowed folders of files -----------------------------------------------------------------------------------------


@pytest.fixture
def project(tmp_path, monkeypatch):
    """project/recipes/r.toml with project/models and a file outside."""
    for name in ("project/recipes", "project/models", "elsewhere"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "project/models/m.h5").write_bytes(b"m")
    (tmp_path / "secret.h5").write_bytes(b"s")
    monkeypatch.chdir(tmp_path / "elsewhere")
    return tmp_path / "project/recipes/r.toml"


def found(recipe, path, kind="load", more="", changes=()):
    recipe.write_text(f'{HEAD}[step.m]\ndo = "{kind}"\npath = {json.dumps(path)}\n{more}')
    loaded = load_recipe(recipe, changes)
    return find_file(loaded, "m", loaded.recipe.step["m"])


def test_a_model_is_searched_in_the_folder_of_the_recipe_and_above(project):
    assert found(project, "models/m.h5") == project.parents[1] / "models/m.h5"
    (project.parent / "models").mkdir()
    (project.parent / "models/m.h5").write_bytes(b"nearer")
    assert found(project, "models/m.h5") == project.parent / "models/m.h5"


@pytest.mark.parametrize("path", ["../../secret.h5", "{tmp}/secret.h5"])
def test_a_model_outside_the_recipe_folder_is_refused(project, path):
    path = path.format(tmp=project.parents[2])
    with pytest.raises(InputError, match="leaves the recipe folder") as caught:
        found(project, path)
    assert str(caught.value).startswith(f'r.toml: step.m.path = "{path}" leaves the recipe folder')


def test_a_link_out_of_the_recipe_folder_is_refused(project):
    (project.parent / "m.h5").symlink_to(project.parents[2] / "secret.h5")
    with pytest.raises(InputError, match="leaves the recipe folder"):
        found(project, "m.h5")


def test_a_record_may_be_anywhere_and_a_missing_one_is_described(project):
    assert found(project, "../../secret.h5", kind="record") == project.parents[2] / "secret.h5"
    with pytest.raises(InputError) as caught:
        found(project, "gone.h5", kind="record", more='about = "Measured by A. Nonymous 2019."\n')
    text = str(caught.value)
    assert "gone.h5: no such file (looked in" in text
    assert str(project.parent) in text
    assert "Measured by A. Nonymous 2019." in text
    assert "--set m.path=FILE" in text


def test_device_files_are_refused(project):
    os.mkfifo(project.parent / "pipe.h5")
    for path in ("pipe.h5", "/dev/zero"):
        with pytest.raises(InputError, match="not a regular file"):
            found(project, path)
