"""A small fixed part of the naming bench: blind cases whose name must be in the answer; the bench's own counting."""

import json
from functools import lru_cache

import pytest
from discover import CONDITIONS, Setup, Task, run_case, stored, tasks
from discover_figures import answer, first_name, report, wilson

RICH = Setup("mid", "rich", False)

CASES = {
    "friction": Task("robustlab", "rich-mid", RICH, ("coulomb-friction",), 1),
    "delay": Task("robustlab", "rich-mid", RICH, ("input-delay",), 1),
    "none": Task("robustlab", "none", RICH, ("none",), 1),
    "pair": Task("robustlab", "pairs-mid", RICH, ("coulomb-friction", "constant-load"), 1),
    "outside": Task("robustlab", "outside-mid", RICH, ("telegraph-load",), 1),
}


slow = pytest.mark.slow


@lru_cache
def line_of(name):
    return run_case(CASES[name])


@pytest.mark.parametrize("name", ["friction", pytest.param("delay", marks=slow), "none"])
def test_the_truth_is_in_the_answer(name):
    found = line_of(name)
    assert found.get("error") is None
    assert (found["truth"] or ["none"])[0] in answer(found)


@slow
def test_a_pair_is_named_without_a_third():
    assert set(line_of("pair")["names"]) == {"coulomb-friction", "constant-load"}


def test_what_is_outside_the_catalogue_is_not_called_explained():
    found = line_of("outside")
    assert found.get("error") is None
    assert found["verdict"] == "unknown" or not found["complete"]


@pytest.mark.parametrize("name", ["friction", pytest.param("delay", marks=slow), pytest.param("pair", marks=slow)])
def test_the_gap_shrinks_on_data_that_the_fit_never_saw(name):
    found = line_of(name)
    assert found["gap_refitted"] > 10 * found["gap_after"]
    assert found["gap_after"] > 0.9 * found["true_error"]  # or the yardstick is none: the truth can hardly be beaten


@slow
def test_the_proposed_experiment_with_one_more_sensor_leaves_one_name():
    """The first record has the encoder alone, the second one the current, too."""
    found = run_case(Task("robustlab", "square-mid", Setup("mid", "square", False), ("resistance",), 301))
    assert len(found["answer"]) > 1
    assert found["experiment"]["sensors"] == ["phi", "i"]
    assert found["after"]["answer"] == ["resistance"]


# --- the bench's own counting ----------------------------------------------------------------------------------------


def line(task, **said):
    base = {"verdict": "named", "complete": True, "gap_before": 1.0, "gap_refitted": 0.5, "gap_after": 0.1,
            "true_error": 0.1, "cpu_s": 1.0, "wall_s": 1.0, "status": "ok"}  # fmt: skip
    names = said.get("names", [])
    head = {"key": task.key, "who": task.who, "condition": task.condition, "kind": CONDITIONS[task.condition].kind,
            **task.setup._asdict(), "truth": [e for e in task.effects if e != "none"], "seed": task.seed}  # fmt: skip
    return head | base | {"names": names, "answer": names} | said


def figure(text, name):
    row = next(row for row in text.splitlines() if row.strip().startswith(name))
    return row.split(name)[1].split()


def test_a_case_that_was_lost_counts_as_wrong():
    right = line(CASES["friction"], names=["coulomb-friction"])
    lost = {k: v for k, v in line(CASES["delay"]).items() if k not in ("verdict", "names", "answer", "complete")}
    text = report([right, lost | {"status": "crashed", "error": "crashed"}])
    assert figure(text, "top-1")[:2] == ["0.500", "1/2"]
    assert figure(text, "true name in the answer set")[:2] == ["0.500", "1/2"]
    assert "MISS" in figure(text, "top-1")
    assert f"{CASES['delay'].key}: crashed" in text


def test_verdicts_are_names():
    task = CASES["friction"]
    assert first_name(line(task, verdict="no missing effect")) == "none"
    assert answer(line(task, verdict="no missing effect")) == ("none",)
    assert first_name(line(task, verdict="unknown", names=["coulomb-friction"])) == "unknown"
    assert first_name({"status": "refused"}) == "(refused)"


def test_an_effect_overlooked_is_one_wrong_name():
    text = report([line(CASES["friction"], verdict="no missing effect")])
    assert figure(text, "of these right")[:2] == ["0.000", "0/1"]


def test_a_third_name_spoils_a_pair():
    pair = ["coulomb-friction", "constant-load"]
    text = report([line(CASES["pair"], names=pair), line(CASES["pair"], names=[*pair, "cogging"])])
    assert figure(text, "both named and no third")[:2] == ["0.500", "1/2"]
    assert figure(text, "both named  ")[:2] == ["1.000", "2/2"]


def test_poor_excitation_is_judged_after_the_experiment():
    def task(seed):
        return Task("robustlab", "square-mid", Setup("mid", "square", False), ("coulomb-friction",), seed)

    rivals = {"verdict": "ambiguous", "names": ["cogging"], "answer": ["cogging", "coulomb-friction"]}
    experiment = {"name": "rich", "duration": 4.8, "sensors": ["phi"], "separation": 20.0}
    after = line(task(1), names=["coulomb-friction"])
    text = report(
        [
            line(task(1), **rivals, experiment=experiment, after=after),
            line(task(2), **rivals, experiment=experiment, after_error="ValueError: no"),
            line(task(3), **rivals),
            line(task(4), names=["coulomb-friction"]),
        ]
    )
    assert figure(text, "left open by the record")[:2] == ["0.750", "3/4"]
    assert figure(text, "of these an experiment was proposed")[:2] == ["0.667", "2/3"]
    assert figure(text, "of these named after it (the truth, nothing else)")[:2] == ["0.333", "1/3"]
    assert "ValueError: no" in text


def test_the_store_survives_a_cut(tmp_path):
    store = tmp_path / "cases.jsonl"
    first, second = line(CASES["friction"]), line(CASES["delay"])
    store.write_text(json.dumps(first) + "\n" + json.dumps(second)[:40])
    assert [x["key"] for x in stored(store)] == [first["key"]]
    with store.open("a") as stream:
        stream.write(json.dumps(second) + "\n")
    assert [x["key"] for x in stored(store)] == [first["key"], second["key"]]


def test_tasks_have_keys_of_their_own():
    wanted = list(tasks(list(CONDITIONS), [1, 2], None, peer=True))
    assert len({task.key for task in wanted}) == len(wanted)
    assert {task.who for task in wanted} == {"robustlab", "pysindy"}


def test_wilson():
    """Known values: 0 of 10 and 81 of 263 (Newcombe, Statistics in Medicine 17 (1998), table I)."""
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert wilson(0, 10)[1] == pytest.approx(0.2775, abs=5e-5)
