"""The recipe step that makes the smallest uncertain model around a set of models."""

import pytest
from recipe_runs import entry, run_text

import robustlab as rl
from robustlab.errors import InputError

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
MODELS = 'models = ["va", "vb", "vc"]\n'
SPEEDS = "".join(f'[step.v{n}]\ndo = "linearise"\nof = "{n}"\noutputs = ["v"]\n' for n in "abc")
POSITIONS = SPEEDS.replace("[step.v", "[step.q").replace('["v"]', '["q"]')


def run(tmp_path, rest):
    return run_text(tmp_path, HEAD + rest)


def test_covers_of_three_units(tmp_path):
    result = run(
        tmp_path,
        f'{SPEEDS}[step.boxed]\ndo = "cover-models"\n{MODELS}'
        f'[step.full]\ndo = "cover-models"\nform = "output-multiplicative"\n{MODELS}conservatism = false\n'
        '[step.kept]\ndo = "save"\nof = "boxed"\nfile = "set.h5"\n'
        '[[require]]\ntext = "t"\nthat = "boxed.conservatism"\nat_most = 1.2\n'
        '[[require]]\ntext = "t"\nthat = "full.excess"\nat_most = 0.1\n',
    )
    assert result.exit_code == 0
    boxed, full = entry(result, "boxed"), entry(result, "full")
    assert boxed["numbers"]["count"] == len(rl.load(result.folder / "set.h5").blocks) == 2  # A[v,v] and B[v,u]
    assert boxed["numbers"]["members"] == 3
    assert boxed["numbers"]["size"] <= 1.0
    assert 1.0 <= boxed["numbers"]["conservatism_at_least"] <= boxed["numbers"]["conservatism"]
    assert 0 <= full["numbers"]["excess"] <= 0.1
    stems = [[f["stem"] for f in entry(result, name)["figures"]] for name in ("boxed", "full")]
    assert stems == [["boxed-set"], ["full-set"]]
    assert rl.load(result.folder / "evidence" / "full.h5").data["form"] == "output-multiplicative"


def test_a_loop_is_closed_before_the_gains_are_compared(tmp_path):
    """Positions drift in open loop: no gain to compare. Under u = K (r - q) there is one."""
    lead = rl.StateSpaceModel([[-400.0]], [[1.0]], [[-9.6e6]], [[2.5e4]])  # 1000 + 60 s / (s / 400 + 1)
    rl.save(tmp_path / "k.h5", rl.Controller(lead))
    result = run(
        tmp_path,
        f'{POSITIONS}[step.K]\ndo = "load"\npath = "k.h5"\n[step.tied]\ndo = "cover-models"\n'
        'models = ["qa", "qb", "qc"]\nform = "pca"\ntolerance = 1e-6\ncontroller = "K"\n',
    )
    tied = entry(result, "tied")
    assert 1.0 <= tied["numbers"]["conservatism"] <= 1.3, tied
    assert [f["stem"] for f in tied["figures"]] == ["tied-set"]


@pytest.mark.parametrize(
    ("rest", "words"),
    [
        ('models = ["a"]\n', "at least two models"),
        ("poses = [[0.0, 0.0, 0.1, 0.0, 0.0, 0.0], [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]]\n", "of and poses belong together"),
        ('models = ["a", "b"]\nform = "boxes"\n', "form"),
    ],
)
def test_a_model_that_is_no_set_is_rejected(tmp_path, rest, words):
    with pytest.raises(InputError, match=words):
        run(tmp_path, f'[step.set]\ndo = "cover-models"\n{rest}')
