"""``robustlab data discover``: the real search once, then its files, verdicts and faults."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from shell import robustlab

import robustlab as rl
from robustlab.identification import Rival, catalogue
from robustlab.identification.data_checks import Finding

TRIED = ("coulomb-friction", "constant-load", "viscous-friction")  # few, for the time of the test
EXCLUDED = [word for name in catalogue() if name not in TRIED for word in ("--exclude", name)]
FIGURES = ("force", "gap", "run-q")
FC = 20.0


def axis_record(seed, name):
    """The servo axis with dry friction, simulated; a micrometre of noise."""
    t = np.arange(1200) * 2.5e-3
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-3.0, 3.0, size=15), 80)
    machine = rl.with_effects(rl.plant("servo-axis"), {"coulomb-friction": {"Fc": FC}})
    q = rl.simulate(machine, t, u)["q"] + 1e-6 * rng.standard_normal(len(t))
    return rl.Record(t, {"u": u}, {"q": q}, {"u": "V", "q": "m"}, name)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("records")
    for seed, name in enumerate(("run7", "run8")):
        rl.save(folder / f"{name}.h5", axis_record(seed, name))
    return folder


@pytest.fixture(scope="module")
def real(files):
    """Return the result of the search on run7, judged on run8."""
    records = [rl.load(files / f"{name}.h5") for name in ("run7", "run8")]
    exclude = [name for name in catalogue() if name not in TRIED]
    return rl.discover(rl.plant("servo-axis"), *records, exclude=exclude)


run = partial(robustlab, "data")


@pytest.fixture
def answer(monkeypatch):
    """Replace the search by a given result, and record its arguments."""
    called = {}

    def put(found):
        def instead(plant, records, held_out=None, **options):
            called.update(plant=plant, records=records, held_out=held_out, **options)
            return found

        monkeypatch.setattr("robustlab.identification.missing_effects.discovery.discover", instead)
        return called

    return put


def test_friction_is_named_by_the_real_command(files, tmp_path):
    out = tmp_path / "out"
    words = ("servo-axis", files / "run7.h5", "--held-out", files / "run8.h5", *EXCLUDED)
    code, text, _ = run("discover", *words, "--out", out, "--json")
    result = json.loads(text)
    assert (code, result["command"], result["verdict"], result["names"]) == (
        0,
        "data discover",
        "named",
        ["coulomb-friction"],
    )
    (parameter,) = result["effects"][0]["parameters"]
    assert parameter["value"] == pytest.approx(FC, rel=1e-2)
    assert result["gap_after"] < 0.1 * result["gap_refitted"]
    assert result["held_out"] == "run8"
    assert json.loads((out / "result.json").read_text(encoding="utf-8"))["effects"] == result["effects"]
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "servo-axis lacks Coulomb (dry) friction" in page
    assert {p.stem for p in (out / "figures").glob("*.svg")} == set(FIGURES)
    assert str(out / "report.html") in result["files"]


def test_options_reach_the_search(files, answer, real):
    called = answer(real)
    code, text, _ = run(
        "discover", "servo-axis", files / "run7.h5", files / "run8.h5",
        "--set", "M=100", "--tolerance", "M=0.2", "--tolerance", "Fv=0.5", "--exclude", "backlash",
        "--window", "0.3", "--outputs", "q",
    )  # fmt: skip
    assert code == 0
    assert text.startswith("servo-axis lacks Coulomb (dry) friction")
    assert [r.name for r in called["records"]] == ["run7", "run8"]
    assert called["held_out"] is None
    assert called["plant"].values["M"] == 100.0
    assert called["tolerances"] == {"M": 0.2, "Fv": 0.5}
    assert list(called["exclude"]) == ["backlash"]
    assert called["window"] == 0.3


def test_a_group_of_a_file_is_taken_by_its_name(tmp_path, answer, real):
    import h5py

    record = axis_record(0, "x")
    path = tmp_path / "both.h5"
    with h5py.File(path, "w") as file:
        for group, scale in (("train", 1.0), ("test", 2.0)):
            for name, values in (("t", record.t), ("u", scale * record.inputs["u"]), ("q", record.outputs["q"])):
                file[f"{group}/{name}"] = values
    called = answer(real)
    code, _, err = run("discover", "servo-axis", f"{path}#train", "--held-out", f"{path}#test", "--outputs", "q")
    assert (code, err) == (0, "")
    (fitted,), (judged,) = called["records"], called["held_out"]
    assert judged["u"] == pytest.approx(2.0 * fitted["u"])
    code, _, err = run("discover", "servo-axis", f"{path}#tset", "--outputs", "q")
    assert code == 3
    assert "tset" in err


@pytest.mark.parametrize("verdict", ["ambiguous", "unknown"])
def test_an_open_verdict_is_reported_in_full_and_exits_with_4(files, answer, real, verdict):
    effect = real.effects[0]
    rival = Rival("presliding", "Presliding", "v", effect.parameters, 0.4, -0.3, effect.name, 1.2)
    rivals = (rival,) if verdict == "ambiguous" else ()
    answer(replace(real, status=rl.Status.INCONCLUSIVE, verdict=verdict, rivals=rivals, complete=False))
    code, text, err = run("discover", "servo-axis", files / "run7.h5", "--json")
    result = json.loads(text)
    assert (code, result["verdict"], result["status"]) == (4, verdict, "inconclusive")
    assert result["answer"] == [effect.name, *(r.name for r in rivals)]
    assert verdict in err


@pytest.mark.parametrize(
    ("changes", "code", "words"),
    [
        ({"status": rl.Status.INCONCLUSIVE, "complete": False}, 4, "incomplete"),
        ({"verdict": "no missing effect", "effects": ()}, 0, "lacks no effect that these records show"),
    ],
)
def test_other_endings_stand_in_the_first_line(files, answer, real, changes, code, words):
    answer(replace(real, **changes))
    found, text, _ = run("discover", "servo-axis", files / "run7.h5")
    assert (found, words in text.splitlines()[0]) == (code, True)


def backlash_record(seed):
    """Two masses on a shaft with 0.02 rad of backlash, by small explicit steps; white noise of 50 microradians."""
    rng = np.random.default_rng(seed)
    t = np.arange(1500) * 4e-3
    amplitudes = 0.06 * rng.choice([-1, 1], 6) * rng.uniform(0.6, 1.4, 6)
    u = np.cos(2 * np.pi * np.outer(t, [0.6, 1.1, 1.9, 3.1, 4.7, 7.3])) @ amplitudes
    h, angle1, angle2, speed1, speed2, angles = 2e-4, 0.0, 0.0, 0.0, 0.0, []
    for torque in u:
        angles.append((angle1, angle2))
        for _ in range(20):
            twist = angle1 - angle2
            stretch = twist - min(max(twist, -0.01), 0.01)
            shaft = 10.0 * stretch + 2e-3 * (speed1 - speed2) if stretch else 0.0
            speed1 += h * (torque - shaft) / 1e-3
            speed2 += h * shaft / 2e-3
            angle1 += h * speed1
            angle2 += h * speed2
    y = np.array(angles) + 5e-5 * rng.standard_normal((len(t), 2))
    units = {"torque": "N m", "phi1": "rad", "phi2": "rad"}
    return rl.Record(t, {"torque": u}, {"phi1": y[:, 0], "phi2": y[:, 1]}, units, f"backlash{seed}")


@pytest.mark.slow
def test_a_name_that_makes_the_free_run_worse_than_as_given_is_not_named(tmp_path):
    """No effect that is tried is the true one; a softer shaft lowers the error in windows only."""
    paths = [rl.save(tmp_path / f"b{seed}.h5", backlash_record(seed)) for seed in (1, 2)]
    excluded = [word for name in catalogue() if name != "stiffness" for word in ("--exclude", name)]
    code, text, _ = run("discover", "two-mass", paths[0], "--held-out", paths[1], *excluded, "--json")
    result = json.loads(text)
    assert (code, result["verdict"], result["names"]) == (4, "unknown", [])
    errors = {m: sum((g[m] / g["range"]) ** 2 for g in result["free_run"].values()) for m in ("nominal", "updated")}
    assert errors["updated"] > errors["nominal"]
    assert any("worse than as given" in f["found"] for f in result["findings"])


def test_details_are_printed_on_request(files, answer, real):
    answer(real)
    short = run("discover", "servo-axis", files / "run7.h5")[1]
    long = run("discover", "servo-axis", files / "run7.h5", "--details")[1]
    assert len(long.splitlines()) > len(short.splitlines())
    assert ("nominal parameters, refitted" in short, "nominal parameters, refitted" in long) == (False, True)


@pytest.mark.slow
def test_an_interrupted_search_reports_its_state_and_exits_with_130(files, tmp_path, answer, real):
    stopped = Finding("interrupted", "search", "stopped after 3 sets", "", "", False, {})
    answer(replace(real, status=rl.Status.INCONCLUSIVE, findings=(stopped,)))
    code, text, err = run("discover", "servo-axis", files / "run7.h5", "--out", tmp_path / "out", "--json")
    result = json.loads(text)
    assert (code, result["names"]) == (130, ["coulomb-friction"])
    assert result["findings"][0]["kind"] == "interrupted"
    assert "what was found until then" in err
    assert (tmp_path / "out" / "report.html").exists()


@pytest.mark.slow
def test_the_updated_plant_is_kept(files, tmp_path, answer, real):
    machine = rl.with_effects(rl.plant("servo-axis", M=96.0), {"coulomb-friction": {"Fc": (FC, 0.1)}})
    answer(replace(real, model=machine))
    out = tmp_path / "out"
    code, text, _ = run("discover", "servo-axis", files / "run7.h5", "--out", out, "--json")
    assert code == 0
    assert str(out / "updated-plant.h5") in json.loads(text)["files"]
    back = rl.load(out / "updated-plant.h5")
    assert back.values["M"] == 96.0
    assert [e.effect.id for e in back.effects] == ["coulomb-friction"]


def test_a_tolerance_of_no_parameter_is_named(files):
    code, _, err = run("discover", "servo-axis", files / "run7.h5", "--tolerance", "mass=0.1", *EXCLUDED)
    assert (code, "mass" in err) == (3, True)


def test_a_record_without_information_exits_with_4_and_a_wrong_one_with_3(tmp_path):
    good = axis_record(0, "still")
    noise = 1e-6 * np.random.default_rng(3).standard_normal(good.n)
    still = rl.Record(good.t, {"u": 0 * good.t}, {"q": noise}, good.units, "still")
    rl.save(tmp_path / "still.h5", still)
    turned = rl.Record(good.t, good.inputs, {"q": -good["q"]}, good.units, "turned")
    rl.save(tmp_path / "turned.h5", turned)
    code, text, err = run("discover", "servo-axis", tmp_path / "still.h5")
    assert (code, text) == (4, "")
    assert "error: still" in err
    code, text, err = run("discover", "servo-axis", tmp_path / "turned.h5")
    assert (code, text) == (3, "")
    assert "sign" in err
