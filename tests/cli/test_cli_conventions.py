"""The sign of feedback through the real commands: the certified loop is the intended one."""

import json

import numpy as np
import pytest
from shell import robustlab

import robustlab as rl


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    where = tmp_path_factory.mktemp("loops")
    ranges = {"k": (1, 0.2), "c": (0.2, 0.3)}
    oscillators = rl.parametric([[0, 1], ["-k", "-c"]], [[0], [1]], [[1, 0]], [[0]], ranges)
    rl.save(where / "osc.h5", oscillators)
    rl.save(where / "nominal.h5", oscillators.nominal)
    rl.save(where / "position.h5", rl.UncertainModel(oscillators.M.renamed(
        outputs=[*oscillators.M.output_names[:-1], "position"]), oscillators.blocks))  # fmt: skip
    for name, w1 in (("strong", rl.performance_weight(bandwidth=10, error=0.01)), ("weak", 0.4)):
        w2 = rl.control_weight(10) if name == "strong" else 0.5
        rl.save(where / f"{name}.h5", rl.mixsyn(oscillators.nominal, w1, w2).controller)
    rl.save(where / "ncf.h5", rl.ncf(oscillators.nominal, 4.0).controller)
    weak = rl.load(where / "weak.h5")
    rl.save(where / "plain.h5", weak.K.renamed(["error"]))
    rl.save(where / "unsaid.h5", rl.Controller(weak.K.renamed(["error"])))
    named = [("position", "m")]
    rl.save(where / "named.h5", rl.Controller(weak.K.renamed(named), takes="r - y"))
    return where


@pytest.fixture
def run(monkeypatch, folder):
    monkeypatch.chdir(folder)

    def call(*words, code=0):
        ending = robustlab(*words, code=code)
        return ending.out if code == 0 else ending.err

    return call


def test_mu_closes_the_loop_with_the_sign_in_the_file(run):
    text = run("mu", "osc.h5", "-k", "strong.h5")
    assert text.startswith("loop  u = K (r - y), as strong.h5 says\n")
    assert "robust stability margin  3.18" in text
    weak = json.loads(run("mu", "osc.h5", "-k", "weak.h5", "--json"))
    assert 3.4 < weak["lower"] <= weak["upper"] < 3.5  # 3.123 is proved of the other sign
    assert weak["loop"] == "u = K (r - y), as the controller says"
    assert run("mu", "osc.h5", "-k", "ncf.h5").startswith("loop  u = K y, as ncf.h5 says\n")


def test_a_sign_that_contradicts_the_file_is_noted_above_the_number(run):
    text = run("mu", "osc.h5", "-k", "weak.h5", "--feedback", "positive")
    first, second = text.splitlines()[:2]
    assert first == "note: weak.h5 says u = K (r - y); --feedback positive closes u = K y all the same"
    assert second == "loop  u = K y, as requested"
    message = run("mu", "osc.h5", "-k", "strong.h5", "--feedback", "positive", code=4)
    assert "the nominal loop u = K y, as requested is unstable" in message
    assert "designed for this plant? --feedback negative or --feedback positive" in message
    text = run("model", "margins", "nominal.h5", "-k", "weak.h5", "--feedback", "positive")
    assert text.startswith("note: weak.h5 says u = K (r - y); --feedback positive")


@pytest.mark.parametrize("file", ["plain.h5", "unsaid.h5"])
@pytest.mark.parametrize("command", ["mu osc.h5", "model margins nominal.h5"])
def test_a_controller_without_a_sign_is_rejected(run, command, file):
    message = run(*command.split(), "-k", file, code=3)
    assert "does not say its sign, and both signs leave the loop stable" in message
    assert "--feedback negative (u = -K y) or --feedback positive" in message
    assert "loop" in run(*command.split(), "-k", file, "--feedback", "negative")


def test_a_controller_of_another_signal_is_rejected(run):
    assert "it takes y1, this plant has position" in run("mu", "position.h5", "-k", "weak.h5", code=3)
    assert run("mu", "position.h5", "-k", "named.h5").startswith("loop  u = K (r - y), as named.h5 says")


def test_margins_report_the_loop(run):
    text = run("model", "margins", "nominal.h5", "-k", "weak.h5")
    assert "u = K (r - y), as weak.h5 says" in text
    assert text.rstrip().endswith("feedback  negative")
    data = json.loads(run("model", "margins", "nominal.h5", "-k", "ncf.h5", "--json"))
    assert (data["feedback"], data["loop"]) == ("positive", "u = K y, as the controller says")
    at = run("model", "margins", "nominal.h5", "-k", "ncf.h5", "--frequency", "1")
    assert "as requested" not in at  # the sign comes from the file
    classical = run("model", "classical-margins", "nominal.h5", "-k", "ncf.h5")
    assert "u = K y, as ncf.h5 says" in classical
    assert classical.rstrip().endswith("feedback  positive")


def test_digital_reduced_and_exported_controllers_keep_it(run, folder):
    rl.save("digital.h5", rl.Controller(rl.discretise(rl.load("weak.h5").K, 0.01)))
    small = rl.reduce_controller(rl.load("nominal.h5"), rl.load("weak.h5"), loss=0.5, measure="hinf", n_meas=1, n_con=1)
    rl.save("small.h5", small.controller)
    run("model", "convert", "digital.h5", "digital.c")
    assert "LOOP: u = K (r - y)" in (folder / "digital.c").read_text()
    text = run("mu", "osc.h5", "-k", "small.h5")
    assert text.startswith("loop  u = K (y - r), as small.h5 says")  # the plant of the reduction offers y
    assert "stability margin  3." in text


def test_frequencies_carry_units(run):
    in_hertz = json.loads(run("mu", "osc.h5", "-k", "weak.h5", "--frequency", "1Hz", "--json"))
    assert in_hertz["omega"] == pytest.approx([2 * np.pi])
    text = run("synth", "mixsyn", "nominal.h5", "--w1", "bandwidth=0.1Hz,error=0.1", "--w2", "0.1", "--json")
    by_hand = run(
        "synth", "mixsyn", "nominal.h5", "--w1", "bandwidth=0.6283185307179586,error=0.1", "--w2", "0.1", "--json"
    )
    assert json.loads(text)["gamma"] == json.loads(by_hand)["gamma"]


# --- recipes ----------------------------------------------------------------------------------------------------------

CLOSE = """
schema = "robustlab.recipe/1"
name = "close"
[step.plant]
do = "load"
path = "g.h5"
[step.k]
do = "load"
path = "k.h5"
[step.loop]
do = "close-loop"
of = "plant"
controller = "k"
"""


def closed(folder, G, K, *, sign=""):
    """How a recipe with a `close-loop` step around files ends."""
    rl.save(folder / "g.h5", G)
    rl.save(folder / "k.h5", K)
    (folder / "r.toml").write_text(CLOSE + sign)
    return robustlab("run", folder / "r.toml", "--out", folder / "out")


def left(folder):
    found = json.loads((folder / "out" / "result.json").read_text())
    return next(s for s in found["steps"] if s["name"] == "loop")


@pytest.mark.parametrize("gain", [2.0, -2.0])
def test_a_recipe_closes_a_loop_without_a_sign_so_that_it_is_stable(tmp_path, gain):
    """1 / (s - 1) with a gain of 2: by hand, the poles are -1 with the right sign, 3 with the other."""
    G = rl.StateSpaceModel([[1.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=["y"])
    K = rl.StateSpaceModel([], [], [], [[gain]], inputs=["y"], outputs=["u"])
    assert closed(tmp_path, G, K).code == 0
    step = left(tmp_path)
    assert step["numbers"]["spectral_abscissa"] == pytest.approx(-1.0)
    law = "u = K (r - y)" if gain > 0 else "u = K (y - r)"
    assert f"{law}: only this sign leaves the loop stable" in json.dumps(step)


def test_a_recipe_asks_where_both_signs_are_stable(tmp_path):
    """1 / (s + 3) with a gain of 2: poles -5 and -1."""
    G = rl.StateSpaceModel([[-3.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=["y"])
    K = rl.StateSpaceModel([], [], [], [[2.0]], inputs=["y"], outputs=["u"])
    code, _, message = closed(tmp_path, G, K)
    assert code == 3
    assert "both signs leave the loop stable" in message
    assert "hint: say it: sign = -1 (u = -K y) or sign = 1 (u = K y)" in message
    for sign, pole in ((-1, -5.0), (1, -1.0)):
        assert closed(tmp_path, G, K, sign=f"sign = {sign}\n").code == 0
        assert left(tmp_path)["numbers"]["spectral_abscissa"] == pytest.approx(pole)
    assert closed(tmp_path, G, rl.Controller(K, takes="r - y"), sign="sign = 1\n").code == 3
    assert closed(tmp_path, G, rl.Controller(K, takes="r - y")).code == 0
    assert left(tmp_path)["numbers"]["spectral_abscissa"] == pytest.approx(-5.0)
