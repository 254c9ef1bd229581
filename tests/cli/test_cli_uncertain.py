"""``robustlab uncertain``: what it prints, writes and returns."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from robustlab.cli.ending import main_guard
from robustlab.cli.uncertain import app
from robustlab.statespace import StateSpaceModel
from robustlab.storage import load, save
from robustlab.uncertainty.blocks import ParameterRange, RealScalar
from robustlab.uncertainty.lft import UncertainModel

RE35 = {"R": 2.07, "L": 0.62e-3, "Km": 0.052, "Kb": 0.052, "Kf": 4.8e-5, "J": 7.2e-6}


def call(capsys, *arguments):
    code = main_guard(lambda: app(args=list(arguments), standalone_mode=False))
    done = capsys.readouterr()
    return code, done.out, done.err


def model(pole=-1.0, units=("rad", "rad")):
    return StateSpaceModel([[pole, 1.0], [0.0, -2.0]], [[0.0], [1.0]], np.eye(2), np.zeros((2, 1)), inputs=["u"],
                           outputs=[("a", units[0]), ("b", units[1])], states=["a", "b"])  # fmt: skip


@pytest.fixture
def files(tmp_path):
    first, second = str(tmp_path / "nominal.h5"), str(tmp_path / "perturbed.h5")
    save(first, model())
    save(second, model(-1.4))
    return first, second, str(tmp_path / "uncertain.h5")


@pytest.fixture
def motor(tmp_path, capsys):
    path = str(tmp_path / "motor.h5")
    assert call(capsys, "build", "--plant", "dc-motor", "--tolerance", "Kf=0.35", "--out", path)[0] == 0
    return path


def test_build_from_two_files(files, capsys):
    first, second, out = files
    code, text, _ = call(capsys, "build", first, second, "--structure", "elements", "--out", out)
    assert code == 0
    assert "A[a,a]" in text
    made = load(out)
    assert made.evaluate({"A[a,a]": 1.0}).A[0, 0] == pytest.approx(-1.4, rel=1e-15)
    assert made.nominal.A[0, 0] == -1.0


def test_build_says_json(files, capsys):
    code, text, _ = call(capsys, "build", *files[:2], "--structure", "single", "--json")
    data = json.loads(text)
    assert code == 0
    assert (data["schema"], data["command"], data["delta_shape"]) == ("robustlab.result/1", "uncertain build", [1, 1])
    assert data["residual"]["largest"] <= 1e-12


def test_equal_models_are_noted(files, capsys):
    code, text, err = call(capsys, "build", files[0], files[0], "--out", files[2])
    assert code == 0
    assert err.endswith("warning: no uncertainty: the two models are equal\n")
    assert "no uncertainty" in text
    assert call(capsys, "show", files[2])[0] == 0
    assert call(capsys, "sample", files[2], "-n", "2")[0] == 0


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        ((), 2, "no NOMINAL"),
        (("a.h5", "--plant", "dc-motor"), 2, "NOMINAL with --plant"),
        (("--plant", "dc-motor", "--tolerance", "Kg=0.1"), 2, "no such parameter of dc-motor"),
        (("--plant", "dc-motor", "--tolerance", "Kf"), 2, "NAME=VALUE"),
        (("missing.h5", "gone.h5"), 3, "no such file"),
    ],
)
def test_build_refuses(arguments, code, text, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found, out, err = call(capsys, "build", *arguments)
    assert (found, out) == (code, "")
    assert text in err


def test_models_that_do_not_fit(files, tmp_path, capsys):
    other = str(tmp_path / "deg.h5")
    save(other, model(units=("deg", "rad")))
    code, out, err = call(capsys, "build", files[0], other)
    assert (code, out) == (3, "")
    assert "deg" in err
    code, _, err = call(capsys, "build", *files[:2], "--structure", "columms")
    assert code == 2
    assert "did you mean columns?" in err


def test_show(motor, capsys):
    code, text, _ = call(capsys, "show", motor)
    assert code == 0
    assert "3.12e-05 .. 6.48e-05" in text
    data = json.loads(call(capsys, "show", motor, "--json")[1])
    assert data["blocks"][0]["name"] == "Kf"
    assert data["blocks"][0]["parameter"]["radius"] == pytest.approx(0.35 * RE35["Kf"])


def test_show_prints_the_true_ends_of_a_range_that_is_not_symmetric(tmp_path, capsys):
    m = StateSpaceModel([[-1.0]], [[-0.5, 1.0]], [[-1.0], [1.0]], [[-0.5, 1.0], [0.0, 0.0]])
    path = str(tmp_path / "lag.h5")
    save(path, UncertainModel(m, [RealScalar("tau", 1, ParameterRange(1.0, 0.5, "s", below=0.25))]))
    code, text, _ = call(capsys, "show", path)
    assert code == 0
    assert "0.75 .. 1.5 s around 1" in text
    data = json.loads(call(capsys, "show", path, "--json")[1])
    assert data["blocks"][0]["parameter"] == {"nominal": 1.0, "radius": 0.5, "unit": "s", "below": 0.25}


def test_build_a_plant_with_a_range_that_is_not_symmetric(tmp_path, capsys):
    out = str(tmp_path / "motor.h5")
    code, text, err = call(capsys, "build", "--plant", "dc-motor", "--range", "Kf=4e-5:9e-5", "--out", out)
    assert (code, err) == (0, "")
    assert "4e-05 .. 9e-05 N m s/rad around 4.8e-05" in text
    assert load(out).physical({"Kf": -1.0})["Kf"][0] == pytest.approx(4e-5)
    for bad in ("Kf=4e-5", "Kf=a:b", "=1:2"):
        assert call(capsys, "build", "--plant", "dc-motor", "--range", bad)[0] == 2
    assert call(capsys, "build", "--plant", "dc-motor", "--range", "Kf=9e-5:4e-5")[0] == 3
    assert call(capsys, "build", "a.h5", "b.h5", "--range", "Kf=1:2")[0] == 2


EXPRESSIONS = """
A = [[0, 1], ["-k/m", "-c/m"]]
B = [[0], ["1/m"]]
C = [[1, 0]]
D = [[0]]
inputs = [["F", "N"]]
outputs = ["x"]
[parameters]
m = [3.0, 0.4]
k = [2.0, 1.4, 3.0]
c = {nominal = 1.0, low = 0.8, high = 1.5, unit = "N s/m"}
"""


def test_build_from_expressions(tmp_path, capsys):
    file, out = tmp_path / "spring.toml", str(tmp_path / "spring.h5")
    file.write_text(EXPRESSIONS, encoding="utf-8")
    code, text, err = call(capsys, "build", "--expressions", str(file), "--out", out)
    assert (code, err) == (0, "")
    assert "0.8 .. 1.5 N s/m around 1" in text
    model = load(out)
    assert [(b.name, b.repeats) for b in model.blocks] == [("m", 1), ("k", 1), ("c", 1)]
    assert model.blocks[2].parameter == ParameterRange(1.0, 0.5, "N s/m", below=1.0 - 0.8)
    assert model.inputs == (("F", "N"),)
    np.testing.assert_allclose(model.evaluate({"m": -1.0, "c": 1.0}).A, [[0, 1], [-2 / 1.8, -1.5 / 1.8]])
    data = json.loads(call(capsys, "build", "--expressions", str(file), "--json")[1])
    assert (data["structure"], data["delta_shape"]) == ("parameters", [3, 3])


@pytest.mark.parametrize(
    ("old", "new", "code", "words"),
    [
        ('"-k/m"', '"-q/m"', 3, "no parameter 'q'"),
        ("[3.0, 0.4]", "[3.0, 1.4]", 4, "vanishes at m = 0"),
        ("[parameters]", "[paramters]", 3, "did you mean parameters?"),
        ("D = [[0]]", "", 3, "no D"),
        ("D = [[0]]", "D = [[", 3, "not valid TOML"),
        ("low = 0.8", "low = 1.8", 3, "low < nominal < high"),
        ("low = 0.8", "lwo = 0.8", 3, "did you mean low?"),
        ("low = 0.8, ", "", 3, "low and high"),
        ("low = 0.8", 'low = "a"', 3, "numbers for low"),
        ('unit = "N s/m"', "unit = 3", 3, "unit 3"),
        ('["F", "N"]', "[3, 4]", 3, "a list of names"),
        ('outputs = ["x"]', 'outputs = "x"', 3, "a list of names"),
        ('outputs = ["x"]', 'outputs = ["x", "y"]', 3, "2 signal names"),
    ],
)
def test_expressions_that_cannot_be_used(tmp_path, capsys, old, new, code, words):
    file = tmp_path / "spring.toml"
    file.write_text(EXPRESSIONS.replace(old, new), encoding="utf-8")
    found, out, err = call(capsys, "build", "--expressions", str(file))
    assert (found, out) == (code, "")
    assert words in err
    assert code == 4 or str(file) in err


def test_expressions_and_other_sources(tmp_path, files, capsys):
    assert call(capsys, "build", "--expressions", str(tmp_path / "none.toml"))[0] == 3
    assert call(capsys, "build", files[0], "--expressions", "a.toml")[0] == 2
    assert call(capsys, "build", "--expressions", "a.toml", "--tolerance", "m=0.1")[0] == 2
    (tmp_path / "bad.toml").write_bytes(b"\xff\xfe")
    assert call(capsys, "build", "--expressions", str(tmp_path / "bad.toml"))[0] == 3
    (tmp_path / "big.toml").write_bytes(b"#" * (1 << 20) + b"##")
    assert "at most" in call(capsys, "build", "--expressions", str(tmp_path / "big.toml"))[2]


def test_show_of_another_kind(files, capsys):
    code, out, err = call(capsys, "show", files[0])
    assert (code, out) == (3, "")
    assert "holds a StateSpaceModel" in err


def test_sample_the_motor(motor, capsys, tmp_path):
    arguments = [
        "sample",
        motor,
        "-n",
        "20",
        "--seed",
        "1",
        "--vertices",
        "all",
        "--input-value",
        "u=42",
        "--t-end",
        "0.1",
    ]
    code, text, err = call(capsys, *arguments)
    assert (code, err) == (0, "")
    row = next(line for line in text.splitlines() if line.startswith("omega")).split()
    assert [float(v) for v in row[2:5]] == pytest.approx([779.065, 769.519, 788.851], abs=1e-3)
    code, text, _ = call(capsys, *arguments, "--json", "--figure", f"{tmp_path}/figures/")
    data = json.loads(text)
    assert (data["status"], len(data["deltas"]), data["vertices"]) == ("converged", 22, 2)
    assert "sampled" in data["label"]
    assert (tmp_path / "figures" / "envelope.svg").read_text(encoding="utf-8").startswith("<?xml")
    assert call(capsys, *arguments)[1] == call(capsys, *arguments)[1]


def test_unstable_samples_are_noted(tmp_path, capsys):
    first, second, out = (str(tmp_path / name) for name in ("a.h5", "b.h5", "u.h5"))
    save(first, model())
    save(second, model(0.5))
    assert call(capsys, "build", first, second, "-o", out)[0] == 0
    code, _, err = call(capsys, "sample", out, "-n", "0", "--vertices", "all", "--t-end", "1")
    assert code == 0
    assert "1 of 2 samples are unstable: 1" in err
    code, text, _ = call(capsys, "sample", out, "-n", "0", "--vertices", "all", "--t-end", "1e6")
    assert code == 4
    assert "inaccurate" in text


@pytest.mark.parametrize(
    ("options", "code"),
    [(("--vertices", "some"), 2), (("-n", "0"), 3), (("--t-end", "-1"), 2), (("--input-value", "v=1"), 3)],
)
def test_sample_refuses(motor, options, code, capsys):
    found, out, err = call(capsys, "sample", motor, *options)
    assert (found, out) == (code, "")
    assert err.startswith("error: ")


def test_outputs_of_a_plant_drop_the_states_they_do_not_show(tmp_path, capsys):
    """With the angle the motor integrates and has no margin; with the speed alone it is stable and has one."""
    file = str(tmp_path / "speed.h5")
    assert call(capsys, "build", "--plant", "dc-motor", "--outputs", "omega", "--out", file)[0] == 0
    nominal = load(file).nominal
    assert (nominal.state_names, nominal.is_stable()) == (("omega", "i"), True)
    assert call(capsys, "build", "a.h5", "b.h5", "--outputs", "omega")[0] == 2


def test_a_platform_at_a_pose_says_what_is_exact_and_what_is_covered(tmp_path, capsys):
    out = str(tmp_path / "platform.h5")
    code, text, err = call(
        capsys, "build", "--plant", "stewart-platform", "--set", "motors=true", "--tolerance", "platform_mass=0.1",
        "--tolerance", "platform_x=0.1", "--tolerance", "r_b=0.2%", "--tolerance", "L_max=1%",
        "--pose", "0,0,0.13,0.02,0,0", "--out", out,
    )  # fmt: skip
    assert code == 0
    assert "platform_mass, platform_x, Kf: exact: the descriptor form is affine in it" in text
    assert "r_b: sampled: its first-order effect, the rest stands in remainder; the pose is held" in text
    assert "remainder: sampled: proved on the hull of" in text
    assert "without effect on the linear model: L_max" in err
    model = load(out)
    assert model.M.n_states == 18
    note = model.provenance.note
    assert note.startswith("plant stewart-platform, tolerance platform_mass=0.1, tolerance platform_x=0.1")
    assert note.endswith("pose 0,0,0.13,0.02,0,0, set motors=true")
    code, text, _ = call(capsys, "show", out, "--json")
    assert json.loads(text)["blocks"][0]["origin"].startswith("sampled: ")


def test_json_of_a_build_names_the_sampled_blocks(capsys):
    code, text, _ = call(
        capsys, "build", "--plant", "stewart-platform", "--range", "platform_mass=3:4", "--range", "c=9.9e-3:10.1e-3",
        "--json",
    )  # fmt: skip
    assert code == 0
    assert json.loads(text)["sampled"] == ["c", "remainder"]


@pytest.mark.parametrize(
    ("args", "code", "words"),
    [
        (("--plant", "dc-motor", "--pose", "0,0,0,0,0,0"), 2, "it for a nonlinear plant only"),
        (("--plant", "stewart-platform", "--pose", "0,0"), 2, "6 numbers"),
        (("--plant", "stewart-platform", "--pose", "0,0,0.13,0,0,0", "--at", "phi=0"), 2, "one of them"),
        (("--plant", "stewart-platform", "--hold", "phi_1", "--tolerance", "platform_mass=0.1"), 3, "the pose is held"),
        (("--plant", "stewart-platform", "--at", "z=1", "--tolerance", "platform_mass=0.1"), 3, "pose or phi"),
        (("--plant", "stewart-platform", "--pose", "0,0,0.5,0,0,0"), 3, "mm"),
        (("--plant", "stewart-platform", "--tolerance", "platform_mas=0.1"), 2, "no such parameter"),
    ],
)
def test_what_a_nonlinear_plant_refuses(capsys, args, code, words):
    found, _, err = call(capsys, "build", *args)
    assert found == code
    assert words in err
    assert "Traceback" not in err


def test_a_plant_file_at_a_rest_with_what_is_held(capsys):
    pytest.importorskip("casadi")
    file = str(Path(__file__).parents[2] / "models" / "plants" / "quadrotor_height.py") + ":quadrotor_height"
    code, text, _ = call(capsys, "build", "--plant", file, "--at", "z=1", "--json")
    assert code == 0
    found = json.loads(text)
    assert found["sampled"] == ["m", "k_t", "remainder"]
    assert found["blocks"][0]["origin"].endswith("held: z, v; what follows: rotor, u")
    code, _, err = call(capsys, "build", "--plant", file, "--hold", "z,rotor")
    assert code == 4
    assert "no rest with what is held" in err
