"""Steps discretise and export in a small recipe: the numbers are those of the library, the files are all there."""

import json
import shutil
import subprocess

import numpy as np
import pytest
from patience import PATIENCE
from shell import robustlab

import robustlab as rl

RECIPE = """\
schema = "robustlab.recipe/1"
name = "digital"
[step.task]
do = "load"
path = "task.h5"
[step.k]
do = "load"
path = "k.h5"
[step.digital]
do = "discretise"
of = "k"
plant = "task"
dt = 1e-2
delay = 2e-3
[step.files]
do = "export"
of = "digital"
prefix = "speed"
saturation = { u = [-24.0, 24.0] }
[[require]]
that = "digital.loss"
text = "The digital controller loses little."
at_most = 0.1
[[require]]
that = "digital.dt"
text = "As asked for."
equals = 1e-2
"""


def put_files(folder):
    """x' = -(1 + 0.3 delta) x + d + u, z = (2 x, 0.1 u), y = x; a PI controller with a slow integrator."""
    B, C = [[-0.3, 1.0, 1.0]], [[1.0], [2.0], [0.0], [1.0]]
    D = [[0, 0, 0], [0, 0, 0], [0, 0, 0.1], [0, 0, 0]]
    M = rl.StateSpaceModel([[-1.0]], B, C, D, 0.0, ["w", "d", ("u", "V")], ["z", "e", "effort", ("omega", "rad/s")])
    rl.save(folder / "task.h5", rl.UncertainModel(M, [rl.RealScalar("pole")]))
    K = rl.StateSpaceModel([[-0.01]], [[1.0]], [[-2.0]], [[-3.0]], 0.0, [("omega", "rad/s")], [("u", "V")])
    rl.save(folder / "k.h5", rl.Controller(K))
    (folder / "r.toml").write_text(RECIPE)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    put_files(folder)
    code = robustlab("run", folder / "r.toml", "--out", folder / "out").code
    result = json.loads((folder / "out" / "result.json").read_text())
    return code, folder / "out", {s["name"]: s for s in result["steps"]}, result["files"]


def test_all_requirements_are_met_and_all_files_are_there(finished):
    code, folder, steps, files = finished
    assert code == 0
    for name in ("files.c", "files.mat", "files.h5", "evidence/digital.h5"):
        assert name in files
        assert (folder / name).is_file()
    assert steps["files"]["numbers"]["order"] == rl.load(folder / "files.h5").K.n_states


def test_all_formats_hold_the_same_controller(finished):
    _, folder, steps, _ = finished
    K = rl.load(folder / "files.h5")
    other = rl.load(folder / "files.mat")
    model = getattr(other, "K", other)
    assert all(np.array_equal(getattr(model, name), getattr(K.K, name)) for name in "ABCD")
    assert model.dt == K.K.dt == 1e-2
    assert K.gamma == pytest.approx(steps["digital"]["numbers"]["gamma"])
    source = (folder / "files.c").read_text()
    assert "void speed_step(" in source
    assert "y[0]: u [V], held in [-24.0, 24.0]" in source
    if shutil.which("gcc"):
        command = ["gcc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-c", "files.c", "-o", "files.o"]
        subprocess.run(command, cwd=folder, check=True, timeout=PATIENCE)


@pytest.mark.parametrize(
    ("old", "new", "code", "words"),
    [
        ("dt = 1e-2\n", "dt = 0.0\n", 3, "step.digital.dt"),
        ("dt = 1e-2\n", "dt = 100.0\nmethod = 'tustin'\n", 4, "step 'digital' gave no number"),
        ('of = "k"', 'of = "task"', 3, "n_con is 3"),
        ('prefix = "speed"', 'prefix = "a;b"', 3, "step.files.prefix"),
    ],
)
def test_faults_are_named(old, new, code, words, tmp_path):
    put_files(tmp_path)
    (tmp_path / "r.toml").write_text(RECIPE.replace(old, new, 1))
    ending = robustlab("run", tmp_path / "r.toml", "--out", tmp_path / "o", code=code)
    assert words in ending.err + ending.out


@pytest.mark.parametrize(
    ("dt", "limits", "words"),
    [(0.0, "", "a continuous controller"), (0.1, "saturation = { v = [-24.0, 24.0] }", "no output 'v'")],
)
def test_what_cannot_be_exported(dt, limits, words, tmp_path):
    K = rl.StateSpaceModel([], [], [], [[-3.0]], dt, [("omega", "rad/s")], [("u", "V")])
    rl.save(tmp_path / "k.h5", rl.Controller(K))
    head = RECIPE.split("[step.task]")[0]
    (tmp_path / "r.toml").write_text(
        f'{head}[step.k]\ndo = "load"\npath = "k.h5"\n[step.files]\ndo = "export"\nof = "k"\n{limits}\n'
    )
    assert words in robustlab("run", tmp_path / "r.toml", "--out", tmp_path / "o", code=3).err
    assert not (tmp_path / "o" / "files.json").exists()
