"""``robustlab synth h2|ncf|dk|fixed``, figures, progress: through the real commands."""

from __future__ import annotations

import json

import numpy as np
import pytest

import robustlab as rl
from robustlab.cli.ending import main_guard
from robustlab.cli.synth import app
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.statespace import lower_lft


def run(*arguments: object) -> int:
    return main_guard(lambda: app([str(a) for a in arguments], standalone_mode=False))


@pytest.fixture
def lag(tmp_path):
    """An unstable state, penalised and driven, measured with noise: LQG in closed form."""
    P = rl.StateSpaceModel(
        [[1.0]], [[1, 0, 1]], [[1], [0], [1]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
        inputs=["w", "n", "u"], outputs=["z", "effort", "y"],
    )  # fmt: skip
    path = tmp_path / "p.h5"
    rl.save(path, P)
    return path


@pytest.fixture
def uncertain(tmp_path):
    """The same with an input gain that is uncertain by 40 %."""
    M = rl.StateSpaceModel(
        [[-1.0]],
        [[1, 1, 0, 1]],
        [[0], [1], [0], [1]],
        [[0, 0, 0, 0.4], [0, 0, 0, 0], [0, 0, 0, 1], [0, 0, 1, 0]],
        inputs=["w_gain", "w", "n", "u"],
        outputs=["z_gain", "z", "effort", "y"],
    )
    path = tmp_path / "uncertain.h5"
    rl.save(path, rl.UncertainModel(M, [rl.RealScalar("gain")]))
    return path


def loop_of(path, out):
    """The loop of the stored controller around the stored plant."""
    return lower_lft(rl.load(path), rl.load(out).K)


def test_h2_of_a_scalar_plant_is_the_lqg_value(lag, tmp_path, capsys):
    """X = Y = 1 + sqrt 2; the H2 norm squared is tr(B1' X B1) + tr(F Y F') with F = X."""
    out = tmp_path / "k.h5"
    named = ["--measurements", "y", "--controls", "u", "--performance-outputs", "z,effort"]
    assert run("h2", lag, *named, "--out", out, "--json", "--verbose") == 0
    captured = capsys.readouterr()
    found = json.loads(captured.out)
    x = 1 + np.sqrt(2)
    assert found["gamma"] == pytest.approx(np.sqrt(x + x * x * x), rel=1e-6)
    assert captured.err.strip()  # --verbose: a line for each trial
    from robustlab.norms import h2_norm

    assert h2_norm(loop_of(lag, out)).value == pytest.approx(found["gamma"], rel=1e-6)


def test_ncf_of_an_integrator_has_its_exact_gamma(tmp_path, capsys):
    """gamma_min of 1/s is sqrt 2; a gain of 4 before it is taken into K."""
    path, out = tmp_path / "g.h5", tmp_path / "k.h5"
    rl.save(path, rl.StateSpaceModel([[0.0]], [[1.0]], [[1.0]], [[0.0]]))
    assert run("ncf", path, "--w1", "4", "--factor", "1.02", "--out", out, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["gamma_min"] == pytest.approx(np.sqrt(2), rel=1e-6)
    K = rl.load(out).K
    loop_gain = -frequency_response(K, [0.0])[0, 0, 0]  # negative feedback gain at dc: of the order of W1
    assert 2 < loop_gain.real < 8


def test_fixed_static_gain_of_an_unstable_lag_is_the_lqr_gain(tmp_path, capsys):
    path = tmp_path / "p.h5"
    P = rl.StateSpaceModel([[1.0]], [[1.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0], [0, 1], [0, 0]])
    rl.save(path, P)
    code = run(
        "fixed", path, "--measurements", 1, "--controls", 1, "--structure", "static", "--objective", "h2", "--json"
    )
    assert code == 0
    found = json.loads(capsys.readouterr().out)
    assert found["order"] == 0
    assert found["gamma"] ** 2 == pytest.approx(1 + np.sqrt(2), rel=1e-4)
    assert found["K"]["D"][0][0] == pytest.approx(-(1 + np.sqrt(2)), rel=1e-3)


def test_dk_takes_the_blocks_of_the_uncertain_file_and_its_bound_holds(uncertain, tmp_path, capsys):
    out = tmp_path / "k.h5"
    arguments = [
        "--measurements",
        "y",
        "--controls",
        "u",
        "--performance-outputs",
        "z,effort",
        "--disturbance-inputs",
        "w,n",
    ]
    arguments += ["--effort", "0.1", "--figure", str(tmp_path / "d.svg")]
    assert run("dk", uncertain, *arguments, "--out", out, "--json") == 0
    captured = capsys.readouterr()
    found = json.loads(captured.out)
    assert found["blocks"] == ["gain", "performance"]
    # judged apart from the search: mu of the stored controller's loop, proved by another analysis
    model = rl.load(uncertain)
    loop = rl.UncertainModel(lower_lft(model.M, rl.load(out).K), model.blocks)
    margin = rl.robust_performance(loop, accuracy=1e-3)
    assert 1 / margin.upper <= found["gamma"] * (1 + 1e-6)
    assert found["gamma"] == pytest.approx(1 / margin.lower, rel=0.05)
    for name in ("d.svg", "d.png", "d-mu.svg", "d-history.svg", "d-functions.svg"):
        assert (tmp_path / name).stat().st_size > 1000
    assert captured.err.count("written: ") == 8


def test_blocks_of_a_state_space_file_by_rows(uncertain, tmp_path, capsys):
    plain = tmp_path / "plain.h5"
    rl.save(plain, rl.load(uncertain).M)
    arguments = [
        "--measurements",
        "1",
        "--controls",
        "1",
        "--blocks",
        "-1,0",
        "--effort",
        "0.08",
        "--no-direct",
        "--json",
    ]
    assert run("dk", plain, *arguments) == 0
    assert len(json.loads(capsys.readouterr().out)["blocks"]) == 2


def test_nominal_leaves_the_perturbation_out(uncertain, capsys):
    gammas = {}
    for extra in ([], ["--nominal"]):
        arguments = ["--measurements", "1", "--controls", "1", "--gamma-rel", "1", "--json"]
        assert run("hinf", uncertain, *arguments, *extra) == 0
        gammas[len(extra)] = json.loads(capsys.readouterr().out)["gamma"]
    assert gammas[1] == pytest.approx(np.sqrt(3) - 1, rel=1e-3)
    assert gammas[0] > gammas[1]


def test_figures_of_a_mixed_sensitivity_design(tmp_path, capsys):
    path = tmp_path / "g.h5"
    rl.save(path, rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]]))
    assert run("mixsyn", path, "--w1", "bandwidth=5", "--w2", "limit=20", "--figure", tmp_path / "m.png") == 0
    assert (tmp_path / "m.svg").is_file()
    text = (tmp_path / "m-functions.png").read_bytes()
    assert text[:4] == b"\x89PNG"
    assert "written" in capsys.readouterr().err


def test_text_says_why_it_stopped_and_what_limits(lag, capsys):
    assert run("fixed", lag, "--measurements", 1, "--controls", 1, "--structure", "order:1", "--starts", "1") == 0
    text = capsys.readouterr().out
    for word in ("gamma", "FixedSynthesis (certified)", "What limits any controller", "how"):
        assert word in text


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (["h2", "P"], 2, "channels"),
        (["dk", "P", "--measurements", "1", "--controls", "1", "--blocks", "-1"], 2, "--blocks"),
        (["dk", "P", "--measurements", "1", "--controls", "1", "--blocks", "a,b"], 2, "--blocks"),
        (["dk", "P", "--measurements", "1", "--controls", "1"], 3, "block"),
        (["dk", "P", "--measurements", "1", "--controls", "1", "--blocks", "5,5"], 3, "block"),
        (["h2", "P", "--measurements", "1", "--controls", "1", "--nominal"], 3, "an uncertain model"),
        (["fixed", "P", "--measurements", "1", "--controls", "1", "--structure", "pidd"], 3, "did you mean pid"),
        (["fixed", "P", "--measurements", "1", "--controls", "1", "--structure", "order:x"], 3, "order:3"),
        (["fixed", "P", "--measurements", "1", "--controls", "1", "--structure", "poles:a"], 3, "poles:-1"),
        (
            ["fixed", "P", "--measurements", "1", "--controls", "1", "--structure", "ipd:fat"],
            3,
            "full, diagonal, scalar",
        ),
        (["fixed", "P", "--measurements", "1", "--controls", "1", "--structure", "static:2"], 3, "nothing"),
        (["fixed", "P", "--measurements", "1", "--controls", "1", "--objective", "h3"], 2, "h2"),
        (["ncf", "P", "--factor", "1"], 3, "above 1"),
        (["ncf", "P", "--w1", "nowhere.h5"], 3, "nowhere.h5"),
        (["ncf", "P", "--outputs", "yy"], 3, "did you mean"),
        (["h2", "P", "--measurements", "1", "--controls", "1", "--out", "nowhere/k.h5"], 5, "no such folder"),
        (["h2", "P", "--measurements", "1", "--controls", "1", "--performance-outputs", "z"], 2, "by name, too"),
        (["h2", "P", "--measurements", "y", "--controls", "u", "--performance-outputs", "zz"], 3, "did you mean z"),
    ],
)
def test_wrong_calls(lag, capsys, arguments, code, text):
    assert run(*(lag if a == "P" else a for a in arguments)) == code
    captured = capsys.readouterr()
    assert captured.out == ""
    assert text in captured.err


def test_a_mode_that_no_controller_reaches_is_exit_code_4(tmp_path, capsys):
    path = tmp_path / "bad.h5"
    rl.save(path, rl.StateSpaceModel([[1.0]], [[1, 0]], [[1], [1]], np.eye(2)))
    for command in ("h2", "fixed"):
        assert run(command, path, "--measurements", "1", "--controls", "1") == 4
        assert capsys.readouterr().out == ""
