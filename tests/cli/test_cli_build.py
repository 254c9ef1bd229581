"""``model build|show|check|diff|convert`` and ``uncertain``: exit codes, keys, content of the files."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from command_files import write_models
from shell import robustlab

import robustlab as rl


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_models(tmp_path)
    return tmp_path


# --- model -----------------------------------------------------------------------------------------------------------


def test_build_show_diff_convert():
    """A[i, i] = -R / L: twice the resistance doubles it, and nothing else."""
    for name, value in (("m.h5", "2"), ("n.h5", "4")):
        robustlab("model", "build", "dc-motor", "--set", f"R={value}", "--out", name, code=0)
    shown = robustlab("model", "show", "m.h5", "--json", code=0).json
    assert (shown["schema"], shown["kind"], shown["verified"]) == ("robustlab.result/1", "state-space", True)
    assert np.array(shown["content"]["A"]).shape == (3, 3)
    assert shown["provenance"]["created_by"] == "model build"
    (change,) = robustlab("model", "diff", "m.h5", "n.h5", "--json", code=0).json["changes"]
    assert change["second"] == pytest.approx(2 * change["first"], rel=1e-12)
    robustlab("model", "convert", "m.h5", "m.mat", code=0)
    robustlab("model", "convert", "m.mat", "back.h5", code=0)
    assert robustlab("model", "diff", "m.h5", "back.h5", "--json", code=0).json["changes"] == []


def test_check_tells_unstable_and_hidden_modes():
    rl.save("hidden.h5", rl.StateSpaceModel(np.diag([1.0, -2.0]), [[0.0], [1.0]], [[1.0, 1.0]], [[0.0]]))
    found = robustlab("model", "check", "hidden.h5", "--json", code=0).json
    assert (found["stable"], found["spectral_abscissa"], found["controllability"]["rank"]) == (False, 1.0, 1)


def test_pair_files():
    with h5py.File("pair.h5", "w") as file:
        for group, pole in (("nominal", -1.0), ("perturbed", -2.0)):
            for name, value in zip("ABCD", (pole, 1.0, 1.0, 0.0), strict=True):
                file[f"{group}/{name}"] = [[value]]
    assert "perturbed: StateSpaceModel" in robustlab("model", "show", "pair.h5", code=0).out
    assert "1 of 4 entries" in robustlab("model", "diff", "pair.h5", code=0).out
    for words in (("convert", "pair.h5", "q.h5"), ("check", "pair.h5")):
        assert "--group nominal" in robustlab("model", *words, code=2).err
    robustlab("model", "convert", "pair.h5", "q.h5", "--group", "perturbed", code=0)
    assert rl.load("q.h5").A[0, 0] == -2.0


def test_build_a_platform_at_a_pose():
    """Gravity pulls harder on a nut where the legs lean more: the unstable poles grow as the platform goes down."""
    words = ("model", "build", "stewart-platform", "--set", "preset=physical", "--out")
    robustlab(*words, "home.h5", code=0)
    robustlab(*words, "low.h5", "--pose", "0,0,0.1062,0,0,0", code=0)
    assert rl.load("low.h5").spectral_abscissa() > rl.load("home.h5").spectral_abscissa() > 0


def test_a_plant_with_effects_is_shown_and_linearised_at_the_given_point():
    content = robustlab("model", "show", "machine.h5", "--json", code=0).json["content"]
    assert [e["id"] for e in content["effects"]] == ["coulomb-friction", "inertia", "input-delay"]
    words = ("model", "build", "machine.h5", "--at", "u=0.02", "--at", "phi=0.5", "--pade", "2", "--out", "rest.h5")
    robustlab(*words, code=0)
    plant, model = rl.load("machine.h5"), rl.load("rest.h5")
    truth = rl.linearise(plant, at=rl.trim(plant, u=0.02, phi=0.5), pade=2)
    np.testing.assert_array_equal(model.A, truth.A)
    np.testing.assert_array_equal(model.operating_point.x, truth.operating_point.x)
    robustlab("model", "build", "machine.h5", "--amplitude", "omega=10", "--set", "R=3.0", "--out", "a.h5", code=0)
    model = rl.load("a.h5")
    assert model.A[2, 2] == pytest.approx(-3.0 / 6.2e-4)
    assert model.A[1, 1] == pytest.approx(-(4.8e-5 + 2 * 2e-3 / (10 * np.pi)) / (1.2 * 7.2e-6))


def test_a_controller_as_c_json_and_mat(folder):
    K = rl.StateSpaceModel([[1.0]], [[0.01]], [[4.0]], [[2.0]], 0.01, [("e q", "m")], [("u", "V")])
    rl.save("k.h5", rl.Controller(K.renamed([("q", "m")]), takes="r - y"))
    limits = ("--saturation", "u=-12:12", "--anti-windup", "0.05")
    robustlab("model", "convert", "k.h5", "k.c", *limits, code=0)
    source = (folder / "k.c").read_text()
    for words in ("(q wanted) - (q measured)", "[m]", "held in [-12.0, 12.0]", "exp(-t / 0.05 s)", "sha256"):
        assert words in source
    robustlab("model", "convert", "k.h5", "k.mat", code=0)
    assert rl.load("k.mat").D.tolist() == [[2.0]]
    rl.save("k.h5", rl.Controller(rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])))
    assert "discretise" in robustlab("model", "convert", "k.h5", "k.c", code=3).err
    assert (folder / "k.c").read_text() == source  # the previous file is kept


# --- uncertain -------------------------------------------------------------------------------------------------------


def test_a_set_of_two_files():
    words = ("uncertain", "build", "lag.h5", "fast.h5", "--structure", "elements", "--out", "u.h5", "--json")
    found = robustlab(*words, code=0).json
    assert (found["schema"], found["command"], found["delta_shape"]) == (
        "robustlab.result/1", "uncertain build", [1, 1],
    )  # fmt: skip
    assert found["residual"] <= 1e-12
    made = rl.load("u.h5")
    assert made.nominal.A[0, 0] == -1.0
    assert made.evaluate({made.blocks[0].name: 1.0}).A[0, 0] == pytest.approx(-1.2, rel=1e-15)


def test_equal_models_are_noted_and_the_set_can_be_used():
    err = robustlab("uncertain", "build", "lag.h5", "lag.h5", "--out", "u.h5", code=0).err
    assert err.endswith("warning: no uncertainty: the two models are equal\n")
    robustlab("uncertain", "show", "u.h5", code=0)
    robustlab("uncertain", "sample", "u.h5", "-n", "2", code=0)


def test_a_range_that_is_not_symmetric():
    robustlab("uncertain", "plant", "dc-motor", "--range", "Kf=4e-5:9e-5", "--out", "u.h5", code=0)
    assert rl.load("u.h5").physical({"Kf": -1.0})["Kf"][0] == pytest.approx(4e-5)
    parameter = robustlab("uncertain", "show", "u.h5", "--json", code=0).json["blocks"][0]["parameter"]
    assert parameter["nominal"] - parameter["below"] == pytest.approx(4e-5)
    assert parameter["nominal"] + parameter["radius"] == pytest.approx(9e-5)


def test_expressions():
    found = robustlab("uncertain", "expressions", "spring.toml", "--out", "u.h5", "--json", code=0).json
    assert (found["structure"], found["delta_shape"]) == ("parameters", [3, 3])
    model = rl.load("u.h5")
    assert [(b.name, b.repeats) for b in model.blocks] == [("m", 1), ("k", 1), ("c", 1)]
    np.testing.assert_allclose(model.evaluate({"m": -1.0, "c": 1.0}).A, [[0, 1], [-2 / 1.8, -1.5 / 1.8]])


def test_samples_of_the_motor(folder):
    robustlab("uncertain", "plant", "dc-motor", "--tolerance", "Kf=0.35", "--out", "u.h5", code=0)
    drive = ("--input-value", "u=42", "--t-end", "0.1", "--json")
    words = ("uncertain", "sample", "u.h5", "-n", "20", "--seed", "1", "--vertices", "all", *drive)
    first = robustlab(*words, "--figure", "figures/", code=0)
    assert (first.json["status"], len(first.json["deltas"]), first.json["vertices"]) == ("converged", 22, 2)
    assert (folder / "figures" / "step-omega.svg").read_text(encoding="utf-8").startswith("<?xml")
    assert robustlab(*words, code=0).out == robustlab(*words, code=0).out


def test_unstable_samples_are_noted():
    robustlab("uncertain", "build", "lag.h5", "unstable.h5", "-o", "u.h5", code=0)
    words = ("uncertain", "sample", "u.h5", "-n", "0", "--vertices", "all", "--t-end")
    assert "unstable           1 members" in robustlab(*words, "1", code=0).out
    robustlab(*words, "1e6", code=4)


def test_outputs_of_a_plant_drop_the_states_they_do_not_show():
    """With the angle the motor integrates and has no margin; with the speed alone it is stable and has one."""
    robustlab("uncertain", "plant", "dc-motor", "--outputs", "omega", "--out", "u.h5", code=0)
    nominal = rl.load("u.h5").nominal
    assert (nominal.state_names, nominal.is_stable()) == (("omega", "i"), True)


def test_a_platform_at_a_pose_reports_its_exact_and_its_covered_parts():
    words = ("--set", "motors=true", "--tolerance", "platform_mass=0.1", "--tolerance", "r_b=0.2%")
    words = (*words, "--tolerance", "L_max=1%", "--pose", "0,0,0.13,0.02,0,0", "--out", "u.h5", "--json")
    ending = robustlab("uncertain", "plant", "stewart-platform", *words, code=0)
    assert ending.json["sampled"] == ["r_b", "remainder"]
    assert "without effect on the linear model: L_max" in ending.err
    assert rl.load("u.h5").provenance.note.startswith("stewart-platform, tolerance platform_mass=0.1")


def test_a_plant_file_at_an_equilibrium_with_constant_signals():
    pytest.importorskip("casadi")
    file = f"{Path(__file__).parents[2] / 'models' / 'plants' / 'quadrotor_height.py'}:quadrotor_height"
    found = robustlab("uncertain", "plant", file, "--at", "z=1", "--json", code=0).json
    assert found["sampled"] == ["m", "k_t", "remainder"]
    assert found["blocks"][0]["origin"].endswith("held: z, v; what follows: rotor, u")
    assert "no rest with what is held" in robustlab("uncertain", "plant", file, "--hold", "z,rotor", code=4).err


def test_a_plant_with_effects_is_referred_to_the_command_that_takes_it():
    assert "uncertain discovery" in robustlab("uncertain", "plant", "machine.h5", "--out", "u.h5", code=2).err


@pytest.fixture
def lags():
    files = []
    for i, (gain, time) in enumerate([(1.0, 1.0), (1.2, 1.3), (0.9, 0.8)]):
        files.append(f"unit{i}.h5")
        rl.save(files[-1], rl.StateSpaceModel([[-1 / time]], [[gain / time]], [[1.0]], [[0.0]]))
    return files


def test_covers(lags):
    robustlab("uncertain", "cover", *lags, "--form", "pca", "--out", "c.h5", code=0)
    assert [b.name for b in rl.load("c.h5").blocks] == ["direction1", "direction2"]
    rl.save("k.h5", rl.Controller(rl.StateSpaceModel([], [], [], [[-2.0]])))
    words = ("uncertain", "cover", *lags, "--form")
    found = robustlab(*words, "additive", "--controller", "k.h5", "--json", code=0).json
    assert found["status"] == "certified"
    assert max(found["sizes"]) <= 1
    assert 1 <= found["conservatism"]["ratio"] < 1.5
    text = robustlab(*words, "additive", "--controller", "silent.h5", "--feedback", "negative", code=0).out
    assert text.splitlines()[0] == "loop  u = -K y, as requested"
    assert "still grows" in robustlab(*words, "inverse-additive", code=4).err


def test_an_updated_plant_becomes_blocks(folder):
    (folder / "found").mkdir()
    effects = {"coulomb-friction": {"Fc": (20.0, 1.0)}, "quantisation@q": {"lsb": 1e-4}}
    rl.save("found/updated-plant.h5", rl.with_effects(rl.plant("servo-axis", M=(95.0, 0.1)), effects))
    words = ("uncertain", "discovery", "found")
    text = robustlab(*words, "--amplitude", "v=0.05", "--out", "u.h5", code=0).out
    assert "coulomb-friction@v: Coulomb (dry) friction at v as a sector" in text
    assert "at most 5e-05 m" in next(line for line in text.splitlines() if "input noise q: quantisation" in line)
    assert "--amplitude" in robustlab(*words, "--dry", "gain", code=2).err
