"""Claims in files, as JSON, on the command line and in recipes."""

import json
import re
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

import robustlab as rl
from robustlab.cli import main_guard, run_command
from robustlab.files import content_sha256, read_tree, write_tree
from robustlab.recipe import load_recipe, run_recipe
from robustlab.verification import claims_in_file

OSCILLATOR = rl.tf([1.0], [1.0, 0.2, 1.0])


def call(*arguments: str) -> int:
    return main_guard(lambda: run_command(["verify", *arguments]))


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "norm.h5"
    rl.save(path, rl.peak_gain(OSCILLATOR))
    return path


def test_a_file_has_the_claims_of_its_result(saved):
    claims = claims_in_file(saved)
    assert [c.kind for c in claims] == ["norm"]
    assert (claims[0].numbers["A"] == OSCILLATOR.A).all()
    assert rl.verify(saved).proved
    assert rl.verify(str(saved)).claims[0].bound == pytest.approx(rl.peak_gain(OSCILLATOR).upper, rel=2e-6)


def test_exit_codes(saved, tmp_path, capsys):
    assert call(str(saved)) == 0
    assert "proved independently" in capsys.readouterr().out
    with h5py.File(saved, "r+") as file:
        gamma = file["claims/0/gamma"]
        gamma[...] = 0.99 * gamma[()]
        del file.attrs["content_sha256"]
    assert call(str(saved)) == 1  # a frequency with a larger gain refutes it
    assert "REFUTED" in capsys.readouterr().out
    with h5py.File(saved, "r+") as file:
        del file["claims/0/B"]
    assert call(str(saved)) == 4
    assert "missing" in capsys.readouterr().out
    rl.save(tmp_path / "zeros.h5", rl.zeros(OSCILLATOR))
    assert call(str(tmp_path / "zeros.h5")) == 3
    assert "no claims" in capsys.readouterr().err
    assert call(str(tmp_path / "nowhere.h5")) == 3


SAVED = {
    "norm": lambda: rl.peak_gain(OSCILLATOR),
    "margin": lambda: rl.robust_stability(rl.UncertainModel(LAG, [rl.RealScalar("pole")])),
    "design": lambda: DESIGN,
    "controller": lambda: DESIGN.controller,
}
LAG = rl.StateSpaceModel([[-1.0]], [[-0.2, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
DESIGN = rl.mixsyn(rl.tf([1.0], [1.0, 1.0]), rl.makeweight(100, (1, 1), 0.5), 0.1, None)


def scaled(name):
    def edit(file):
        file[name][...] = 1.1 * file[name][()]

    return edit


def turned(file):
    assert file["signals/input/takes"].asstr()[()].tolist() == ["r - y"]
    del file["signals/input/takes"]
    file["signals/input/takes"] = ["y"]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    files = {kind: rl.save(folder / f"{kind}.h5", make()) for kind, make in SAVED.items()}
    assert call(*map(str, files.values())) == 0
    return files


# The edit outside of the claims, and the message of the command about the number that is not proved.
EDITS = [
    ("norm", scaled("data/upper"), "data/upper is 5.527.*, the claim proves 5.025"),
    ("norm", scaled("data/lower"), "data/lower is 5.527"),
    ("norm", lambda file: file.attrs.modify("status", "failed"), "the file was changed"),
    ("norm", lambda file: file.pop("data/value"), "data/value is missing"),
    ("norm", lambda file: file.attrs.modify("type", "Margin"), "data/lower is"),
    ("norm", lambda file: file.attrs.modify("type", "Opinion"), "no claim covers .* 'Opinion'"),
    ("margin", scaled("data/lower"), "data/lower is 5.49.*, the claim proves 4.99"),
    ("margin", scaled("data/upper"), "data/upper is 5.5, the claim proves 5"),
    ("margin", lambda file: file.move("data/delta/pole", "data/delta/zero"), "the file was changed"),
    ("design", scaled("data/gamma"), "data/gamma is"),
    ("design", scaled("data/K/C"), "data/K is not the model"),
    ("controller", scaled("B"), "the controller is not the model"),
    ("controller", scaled("C"), "the controller is not the model"),
    ("controller", turned, "the file was changed"),
    ("controller", lambda file: file.attrs.modify("dt", 0.1), "the controller is not the model"),
    ("controller", lambda file: file.attrs.modify("gamma", 0.01), "gamma is 0.01, the claim proves"),
]


@pytest.mark.parametrize(("kind", "edit", "pattern"), EDITS)
def test_displayed_numbers_are_the_proved_ones(kind, edit, pattern, files, tmp_path, capsys):
    path = Path(shutil.copy(files[kind], tmp_path))
    with h5py.File(path, "r+") as file:
        edit(file)
    assert call(str(path)) == 3  # as rl.load
    assert "content_sha256" in capsys.readouterr().err
    tree = read_tree(path)
    for digest in (None, content_sha256(tree)):
        tree.attrs.pop("content_sha256", None)
        tree.attrs |= {"content_sha256": digest} if digest else {}
        write_tree(path, tree)
        assert call(str(path)) == 4
        output = capsys.readouterr().out
        assert re.search(pattern, output)
        assert "proved independently" not in output
        assert ("no content_sha256" in output) == (digest is None)


def test_a_file_of_an_earlier_version_reports_unbound_numbers(saved, capsys):
    tree = read_tree(saved)
    del tree.groups["claims"].attrs["content_sha256"]
    tree.attrs["content_sha256"] = content_sha256(tree)
    write_tree(saved, tree)
    assert rl.load(saved).upper == rl.peak_gain(OSCILLATOR).upper
    assert call(str(saved)) == 4
    output = capsys.readouterr().out
    assert "the claims carry no digest of the file" in output
    assert "proved: data/upper is" in output


def test_numbers_without_a_claim_are_listed(saved):
    assert rl.verify(saved).not_covered == ("frequency",)


RECIPE = """
schema = "robustlab.recipe/1"
name = "small"
verify = true

[step.lag]
do = "load"
path = "lag.h5"

[step.margin]
do = "robust-stability"
of = "lag"

[[require]]
that = "margin.verified"
equals = true
text = "The margin is proved independently"
"""


def test_a_recipe_verifies_its_files(tmp_path):
    M = rl.StateSpaceModel([[-1.0]], [[-0.2, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
    rl.save(tmp_path / "lag.h5", rl.UncertainModel(M, [rl.RealScalar("pole")]))
    (tmp_path / "small.toml").write_text(RECIPE)
    run_recipe(load_recipe(tmp_path / "small.toml"), tmp_path / "out")
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["exit_code"] == 0
    margin = next(s for s in result["steps"] if s["name"] == "margin")
    assert margin["numbers"]["verified"] is True
    assert any(f["label"] == "Proved independently" for f in margin["facts"])
    assert call(str(tmp_path / "out")) == 0
