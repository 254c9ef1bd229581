"""The open benchmark of naming: its cases follow from the seed, and its scorer judges by hand-made answers."""

import h5py
import naming_benchmark
import numpy as np
import pytest
from naming.answers import read_answers
from naming.composition import composition, drawn
from naming.dataset import digest, make
from naming.scoring import is_right, score, table

import robustlab as rl


def test_a_data_set_is_the_same_files_twice_and_holds_what_was_measured(tmp_path):
    ids = {"0002", "0005"}
    first, second = (make(tmp_path / name, 3, ids) for name in ("a", "b"))
    assert first == second
    for a in (tmp_path / "a").rglob("*.*"):
        assert a.read_bytes() == (tmp_path / "b" / a.relative_to(tmp_path / "a")).read_bytes()
    case = drawn(next(e for e in composition(3) if e.id == "0002"))
    assert first["0002"] == digest(case)
    folder = tmp_path / "a" / "cases" / "0002"
    plant = rl.load(folder / "model.h5")
    assert {n: (p.value, p.tolerance) for n, p in plant.parameters.items()} == {
        n: (p.value, p.tolerance) for n, p in case.plant.parameters.items()
    }
    for name, record in (("record", case.record), ("held_out", case.held_out)):
        read = rl.Record.read(folder / "records.h5", name, [s.name for s in plant.inputs])
        assert read.units == record.units
        for signal in (*record.inputs, *record.outputs):
            np.testing.assert_array_equal(read[signal], record[signal])
    with h5py.File(folder / "records.h5") as file:  # nothing of what is hidden is in what a program reads
        assert sorted(file) == ["held_out", "record"]
    assert b"truth" not in (folder / "model.h5").read_bytes()


def reply(verdict, *kinds, possible=(), complete=True, **more):
    return {
        "verdict": verdict, "named": [{"kind": k} for k in kinds], "possible": list(possible), "complete": complete
    } | more  # fmt: skip


DRY = {"condition": "single", "family": "motor", "kinds": [["dry-friction"]], "effects": ["coulomb-friction"]}
PAIR = {"condition": "pair", "family": "motor", "kinds": [["dry-friction", "load"]], "effects": []}
NOTHING = {"condition": "nothing", "family": "motor", "kinds": [[]], "effects": []}
OUTSIDE = {"condition": "outside", "family": "motor", "kinds": [], "effects": ["telegraph-load"]}


@pytest.mark.parametrize(
    ("answer", "truth", "right"),
    [
        (reply("named", "dry-friction"), DRY, True),
        (reply("named", "resisting-force"), DRY, True),  # a level above, below the root
        (reply("named", "force"), DRY, False),  # too general
        (reply("named", "speed-friction"), DRY, False),
        (reply("named", "dry-friction", "load"), DRY, False),  # a third one
        (reply("open", possible=["dry-friction"]), DRY, False),
        (reply("named", "load", "dry-friction"), PAIR, True),
        (reply("named", "dry-friction", "dry-friction"), PAIR, False),
        (reply("named", "dry-friction"), PAIR, False),
        (reply("nothing"), NOTHING, True),
        (reply("named", "load"), NOTHING, False),
        (reply("unknown"), NOTHING, False),
        (reply("unknown"), OUTSIDE, True),
        (reply("named", "load", complete=False), OUTSIDE, True),
        (reply("named", "load"), OUTSIDE, False),
        (reply("nothing"), OUTSIDE, False),
    ],
)
def test_what_is_right(answer, truth, right):
    assert is_right(answer, truth) is right


def test_the_table_counts_what_it_says():
    truth = {"1": DRY, "2": DRY, "3": DRY, "4": PAIR, "5": NOTHING, "6": OUTSIDE}
    answers = {
        "1": {**reply("named", "dry-friction", seconds=2.0), "named": [{"kind": "dry-friction", "probability": 0.99}]},
        "2": reply("named", "load", seconds=4.0),
        "3": reply("open", possible=["load", "dry-friction"], seconds=6.0),
        "5": reply("named", "load"),
        "6": reply("named", "load"),
    }  # the pair has no answer
    rows = dict(score(truth, answers, {"2": 1.5, "3": 12.0}))
    assert rows["singles: right"] == "1/3"
    assert rows["singles that the records distinguish: right"] == "1/2"
    assert rows["singles: right, or open with the truth in the answer"] == "2/3"
    assert rows["singles: sure and wrong"] == "1/3"
    assert rows["pairs: both, and no third"] == "0/1"
    assert rows["nothing missing: reported"] == "0/1"
    assert rows["nothing missing: an effect named"] == "1/1"
    assert rows["outside the catalogue: unknown or incomplete"] == "0/1"
    assert rows["kinds stated at 0.95 to 1, on average: in the machine"] == "0.99: 1/1"
    assert rows["CPU s a case: median, at 95 %"] == "4, 5.8"
    assert "mine" in table(truth, {"mine": (answers, {})}).splitlines()[0]


@pytest.mark.slow
def test_the_commands_from_making_to_the_table(tmp_path, capsys, monkeypatch):
    folder, out = tmp_path / "set", tmp_path / "stepwise.json"
    naming_benchmark.main(["make", str(folder), "--case", "0001", "0003"])
    naming_benchmark.main(["answer", str(folder), "--program", "stepwise", "--out", str(out), "--workers", "1"])
    assert set(read_answers(out)[1]) == {"0001", "0003"}
    naming_benchmark.main(["score", str(folder), str(out)])
    printed = capsys.readouterr().out
    assert "2 cases in" in printed
    assert "singles: right" in printed
    assert "stepwise" in printed
