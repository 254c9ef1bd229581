"""The recipe step that makes the smallest uncertain model around a set of models."""

from __future__ import annotations

import pytest

import robustlab as rl
from robustlab.errors import InputError
from robustlab.recipe.load import load_recipe, parse_recipe
from robustlab.recipe.run import run_recipe

HEAD = """schema = "robustlab.recipe/1"
name = "units"
[step.a]
do = "plant"
plant = "servo-axis"
[step.b]
do = "plant"
plant = "servo-axis"
parameters = { M = 105.0, Fv = 180.0 }
[step.c]
do = "plant"
plant = "servo-axis"
parameters = { M = 90.0, Fv = 230.0 }
"""
MODELS = 'models = ["a", "b", "c"]\noutputs = ["v"]\n'


def run(tmp_path, rest):
    path = tmp_path / "units.toml"
    path.write_text(HEAD + rest, encoding="utf-8")
    return run_recipe(load_recipe(path), tmp_path / "out")


def entry(result, name):
    return next(s for s in result.data["steps"] if s["name"] == name)


def test_covers_of_three_units_with_their_conservatism(tmp_path):
    result = run(
        tmp_path,
        f'[step.boxed]\ndo = "cover-models"\n{MODELS}'
        f'[step.round]\ndo = "cover-models"\nform = "ellipsoid"\ntolerance = 1e-6\n{MODELS}'
        f'[step.full]\ndo = "cover-models"\nform = "output-multiplicative"\n{MODELS}'
        '[step.kept]\ndo = "save"\nof = "boxed"\nfile = "set.h5"\n'
        '[[require]]\ntext = "t"\nthat = "boxed.conservatism"\nat_most = 1.2\n'
        '[[require]]\ntext = "t"\nthat = "full.least_excess"\nat_most = 0.1\n',
    )
    assert result.exit_code == 0
    boxed, full = entry(result, "boxed"), entry(result, "full")
    assert boxed["numbers"]["count"] == len(rl.load(result.folder / "set.h5").blocks) == 2  # A[v,v] and B[v,u]
    assert boxed["numbers"]["members"] == 3
    assert boxed["numbers"]["size"] <= 1.0
    assert 1.0 <= boxed["numbers"]["conservatism_at_least"] <= boxed["numbers"]["conservatism"] <= 1.2
    assert full["numbers"]["least_excess"] <= full["numbers"]["excess"]
    stems = [[f["stem"] for f in entry(result, name)["figures"]] for name in ("boxed", "round", "full")]
    assert stems == [["boxed-cloud"], ["round-cloud"], ["full-weight"]]
    assert rl.load(result.folder / "evidence" / "full.h5").data["form"] == "output-multiplicative"


def test_a_loop_is_closed_before_the_gains_are_compared(tmp_path):
    """Positions drift in open loop: no gain to compare; with a controller there is."""
    models = 'models = ["a", "b", "c"]\noutputs = ["q"]\nform = "pca"\ntolerance = 1e-6\n'
    result = run(
        tmp_path,
        f'[step.loose]\ndo = "cover-models"\n{models}'
        '[step.K]\ndo = "mixsyn"\nof = "q"\nW1 = { bandwidth = 20.0 }\nW2 = { limit = 3000.0 }\n'
        f'[step.tied]\ndo = "cover-models"\n{models}controller = "K"\n'.replace('of = "q"', 'of = "loose"'),
    )
    assert "close a loop" in entry(result, "loose")["notes"][0]
    assert "conservatism" not in entry(result, "loose")["numbers"]
    assert 1.0 <= entry(result, "tied")["numbers"]["conservatism"] <= 1.3


@pytest.mark.parametrize(
    ("rest", "words"),
    [
        ('models = ["a"]\n', "at least two models"),
        ("poses = [[0.0, 0.0, 0.1, 0.0, 0.0, 0.0], [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]]\n", "of and poses belong together"),
        ('models = ["a", "b"]\nform = "boxes"\n', "form"),
        ('models = ["a", "nobody"]\n', "no step 'nobody'"),
    ],
)
def test_what_is_no_set_is_refused(rest, words):
    with pytest.raises(InputError, match=words):
        parse_recipe(f'{HEAD}[step.set]\ndo = "cover-models"\n{rest}')
