"""Commands on a file of a plant with effects: show, check, build, uncertain build."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import robustlab as rl
from robustlab.cli.ending import main_guard
from robustlab.cli.model import app as model_app
from robustlab.cli.uncertain import app as uncertain_app


@pytest.fixture
def file(tmp_path):
    motor = rl.plant("dc-motor", R=(2.1, 0.1))
    plant = rl.with_effects(
        motor, {"coulomb-friction": {"Fc": (2e-3, 1e-4)}, "inertia": {"s": (1.2, 0.03)}, "input-delay": {"d": 2e-3}}
    )
    rl.save(tmp_path / "motor.h5", plant)
    return str(tmp_path / "motor.h5")


def run(app, *arguments):
    return CliRunner().invoke(app, list(arguments))


def test_show_says_parameters_and_effects(file):
    shown = run(model_app, "show", file)
    assert shown.exit_code == 0
    for text in ("plant dc-motor", "Coulomb (dry) friction at omega", "Fc = 0.002 +- 0.0001", "+-10 %", "d = 0.002 s"):
        assert text in shown.stdout
    content = json.loads(run(model_app, "show", file, "--json").stdout)["content"]
    assert [e["id"] for e in content["effects"]] == ["coulomb-friction", "inertia", "input-delay"]


def test_check_looks_at_the_linear_model(file):
    shown = run(model_app, "check", file)
    assert "pole [1/s]" in shown.stdout


def test_build_linearises_where_it_is_asked_to(file, tmp_path):
    out = str(tmp_path / "linear.h5")
    built = run(model_app, "build", file, "--at", "u=0.02", "--at", "phi=0.5", "--pade", "2", "--out", out)
    assert built.exit_code == 0, built.output
    assert "not in it: Coulomb" in built.output
    model = rl.load(out)
    assert model.n_states == 5
    plant = rl.load(file)
    truth = rl.linearise(plant, at=rl.trim(plant, u=0.02, phi=0.5), pade=2)
    np.testing.assert_array_equal(model.A, truth.A)
    np.testing.assert_array_equal(model.operating_point.x, truth.operating_point.x)


def test_build_takes_an_amplitude_and_parameters(file, tmp_path):
    out = str(tmp_path / "linear.h5")
    assert run(model_app, "build", file, "--amplitude", "omega=10", "--set", "R=3.0", "--out", out).exit_code == 0
    model = rl.load(out)
    assert model.A[2, 2] == pytest.approx(-3.0 / 6.2e-4)
    assert model.A[1, 1] == pytest.approx(-(4.8e-5 + 2 * 2e-3 / (10 * np.pi)) / (1.2 * 7.2e-6))


@pytest.mark.parametrize("words", [["FILE"], ["--plant", "FILE"]])
def test_uncertain_build_has_the_tolerances_and_says_what_is_left_out(file, tmp_path, words):
    out = str(tmp_path / "uncertain.h5")
    built = run(uncertain_app, "build", *(file if w == "FILE" else w for w in words), "--out", out)
    assert built.exit_code == 0, built.output
    assert [b.name for b in rl.load(out).blocks] == ["R", "Kf", "J"]
    assert "not in it: Coulomb (dry) friction at omega" in built.output


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["build", "FILE", "--at", "u=5", "--out", "OUT"], 4),
        (["build", "FILE", "--at", "v=5", "--out", "OUT"], 3),
        (["build", "FILE", "--at", "u=0", "--pose", "0,0,0,0,0,0", "--out", "OUT"], 2),
        (["build", "dc-motor", "--at", "u=0", "--out", "OUT"], 2),
        (["build", "lost.h5", "--out", "OUT"], 3),
    ],
)
def test_what_cannot_be_built_is_said(file, tmp_path, words, code):
    out = tmp_path / "o.h5"
    arguments = [file if w == "FILE" else str(out) if w == "OUT" else w for w in words]
    assert main_guard(lambda: model_app(arguments, standalone_mode=False)) == code
    assert not out.exists()
