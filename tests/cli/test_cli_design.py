"""``synth`` and ``model reduce``: exit codes, keys, files; the loop of the stored controller has the printed number."""

import numpy as np
import pytest
from command_files import write_models
from shell import robustlab

import robustlab as rl
from robustlab import frequency_response
from robustlab.norms import h2_norm
from robustlab.statespace import lower_lft

CHANNELS = ("--measurements", "1", "--controls", "1")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_models(tmp_path)
    return tmp_path


@pytest.fixture
def uncertain():
    """An unstable-free lag with an input gain that is uncertain by 40 %."""
    B, C = [[1, 1, 0, 1]], [[0], [1], [0], [1]]
    D = [[0, 0, 0, 0.4], [0, 0, 0, 0], [0, 0, 0, 1], [0, 0, 1, 0]]
    M = rl.StateSpaceModel([[-1.0]], B, C, D, inputs=["w_gain", "w", "n", "u"], outputs=["z_gain", "z", "effort", "y"])
    rl.save("gain-set.h5", rl.UncertainModel(M, [rl.RealScalar("gain")]))
    return "gain-set.h5"


def loop_of(plant):
    """The loop of the stored controller around the stored plant."""
    return lower_lft(rl.load(plant), rl.load("k.h5").K)


def test_hinf_writes_a_controller_that_holds_its_gamma():
    words = ("synth", "hinf", "p.h5", *CHANNELS, "--gamma-rel", "1", "--out", "k.h5", "--json")
    found = robustlab(*words, code=0).json
    assert (found["schema"], found["status"]) == ("robustlab.result/1", "certified")
    assert found["gamma"] == pytest.approx(np.sqrt(3) - 1, rel=1e-3)
    assert rl.load("k.h5").gamma == pytest.approx(found["gamma"])
    assert rl.peak_gain(loop_of("p.h5")).lower <= found["gamma"]


def test_h2_writes_a_controller_with_its_norm():
    ending = robustlab("synth", "h2", "p.h5", *CHANNELS, "--out", "k.h5", "--json", "--verbose", code=0)
    assert h2_norm(loop_of("p.h5")).value == pytest.approx(ending.json["gamma"], rel=1e-6)
    assert ending.err.strip()  # --verbose: a line for each trial


def test_ncf_takes_the_weight_into_the_controller():
    """A gain of 4 before 1/s is taken into K, which is stored for u = K y."""
    rl.save("g.h5", rl.StateSpaceModel([[0.0]], [[1.0]], [[1.0]], [[0.0]]))
    found = robustlab("synth", "ncf", "g.h5", "--w1", "4", "--factor", "1.02", "--out", "k.h5", "--json", code=0).json
    assert found["gamma_min"] == pytest.approx(np.sqrt(2), rel=1e-6)
    assert 2 < -frequency_response(rl.load("k.h5").K, [0.0])[0, 0, 0].real < 8


@pytest.mark.slow
def test_dk_takes_the_blocks_of_the_uncertain_file_and_its_bound_holds(folder, uncertain):
    words = ("--effort", "0.1", "--figure", "d.svg", "--out", "k.h5", "--json")
    found = robustlab("synth", "dk", uncertain, *CHANNELS, *words, code=0).json
    assert found["blocks"] == ["gain", "performance"]
    # judged apart from the search: mu of the stored controller's loop, proved by another analysis
    model = rl.load(uncertain)
    loop = rl.UncertainModel(lower_lft(model.M, rl.load("k.h5").K), model.blocks)
    margin = rl.robust_performance(loop, accuracy=1e-3)
    assert 1 / margin.upper <= found["gamma"] * (1 + 1e-6)
    assert found["gamma"] == pytest.approx(1 / margin.lower, rel=0.05)
    for name in ("d.svg", "d.png", "d-functions.svg"):
        assert (folder / name).stat().st_size > 1000


def test_nominal_leaves_the_perturbation_out(uncertain):
    words = ("synth", "hinf", uncertain, *CHANNELS, "--gamma-rel", "1", "--json")
    nominal = robustlab(*words, "--nominal", code=0).json["gamma"]
    assert nominal == pytest.approx(np.sqrt(3) - 1, rel=1e-3)
    assert robustlab(*words, code=0).json["gamma"] > nominal


@pytest.mark.slow
def test_mixsyn_leaves_out_untouched_states_with_a_note_and_draws(folder):
    G = rl.StateSpaceModel([[0, 1], [0, -10]], [[0], [10]], np.eye(2), np.zeros((2, 1)), outputs=["phi", "omega"])
    rl.save("g.h5", G)
    weights = ("--w1", "bandwidth=20,error=0.01", "--w2", "0.1", "--w3", "bandwidth=500")
    ending = robustlab("synth", "mixsyn", "g.h5", "--outputs", "omega", *weights, "--json", "--figure", "m.png", code=0)
    assert ending.json["closed_loop_abscissa"] < 0
    assert "left out" in ending.err
    assert (folder / "m.svg").is_file()
    assert (folder / "m-functions.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize("command", ["hinf", "h2", "fixed"])
def test_a_time_limit_that_is_reached_is_reported(command):
    ending = robustlab("synth", command, "p.h5", *CHANNELS, "--time-limit", "1e-9", code=4)
    assert "not repeatable" in ending.out + ending.err


def test_a_reduced_model_and_its_error():
    found = robustlab("model", "reduce", "k.h5", "--order", "1", "--out", "small.h5", "--json", code=0).json
    assert (found["command"], found["status"]) == ("model reduce", "certified")
    gap = rl.load("k.h5").K.dc_gain() - rl.load("small.h5").dc_gain()
    assert abs(gap[0, 0]) <= found["error"]["upper"] <= found["bound"] * (1 + 1e-5)
    robustlab("model", "reduce", "k.h5", "--max-error", "0.01", code=0)


@pytest.mark.parametrize("options", ["--method hankel", "--method stochastic --floor 0.1", "--input-weight lag.h5"])
def test_the_other_ways_to_reduce(options):
    G = rl.linearise(rl.plant("mass-spring-damper", m=[1.0] * 3, c=[0.2] * 3, k=[1.0] * 3)).select(["f1"], ["q1"])
    rl.save("chain.h5", G)
    robustlab("model", "reduce", "chain.h5", "--order", "2", *options.split(), "--out", "small.h5", code=0)
    assert rl.load("small.h5").n_states == 2


def test_a_minimal_model():
    rl.save("hidden.h5", rl.StateSpaceModel([[0, 0], [0, -1]], [[0], [1]], [[1, 1]], [[0]]))
    found = robustlab("model", "minimal", "hidden.h5", "--out", "m.h5", "--json", code=0).json
    assert (found["order"], found["error"]["upper"], len(found["removed"])) == (1, 0, 1)
    assert rl.load("m.h5").poles().tolist() == [-1]
