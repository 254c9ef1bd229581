"""A small fixed part of the naming bench: blind cases whose name must be in the answer; the bench's own counting."""

import json
from functools import lru_cache

import pytest
from discover import CONDITIONS, USUAL, Setup, Task, main, run_case, stored, tasks
from discover_figures import answer, best_set, is_right, report, wilson
from discover_truth import main_parameter
from hidden import FAMILIES, make_case

from robustlab.dynamics.effects.catalogue import catalogue

RICH, SQUARE = Setup("mid", "rich"), Setup("mid", "square")


def task(condition, *effects, seed=1, setup=RICH, family="motor"):
    return Task("robustlab", condition, family, setup, effects, seed)


CASES = {
    "friction": task("single", "coulomb-friction"),
    "delay": task("single", "input-delay"),
    "none": task("none", "none"),
    "pair": task("pairs", "coulomb-friction", "constant-load"),
    "outside": task("outside", "telegraph-load"),
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
    found = run_case(task("square", "resistance", seed=301, setup=SQUARE))
    assert len(found["answer"]) > 1
    assert found["experiment"]["sensors"] == ["phi", "i"]
    assert found["experiment"]["foreign"] == []
    assert found["after"]["answer"] == ["resistance"]


# --- the bench's own counting ----------------------------------------------------------------------------------------


def line(task, *names, verdict="named", p=0.99, **said):
    base = {"verdict": verdict, "complete": True, "gap_before": 1.0, "gap_refitted": 0.5, "gap_after": 0.1,
            "true_error": 0.1, "cpu_s": 1.0, "wall_s": 1.0, "status": "ok", "intervals": []}  # fmt: skip
    head = {"key": task.key, "who": task.who, "condition": task.condition, "kind": CONDITIONS[task.condition].kind,
            "family": task.family, **task.setup._asdict(), "truth": [e for e in task.effects if e != "none"],
            "seed": task.seed}  # fmt: skip
    return head | base | {"names": list(names), "answer": list(names), "posterior": [[list(names), p, ""]]} | said


def figure(text, name):
    row = next(row for row in text.splitlines() if row.strip().startswith(name))
    return row.split(name)[1].split()


def test_a_case_that_was_lost_counts_as_wrong():
    right = line(CASES["friction"], "coulomb-friction")
    lost = {k: v for k, v in line(CASES["delay"]).items() if k not in ("verdict", "names", "answer", "complete")}
    text = report([right, lost | {"status": "crashed", "error": "crashed"}])
    assert figure(text, "top-1, single effect, rich, mid noise")[:2] == ["0.500", "1/2"]
    assert "MISS" in figure(text, "top-1, single effect, rich, mid noise")
    assert f"{CASES['delay'].key}: crashed" in text
    assert "failing cases: 1 of 2" in text


def test_verdicts_are_answers():
    friction = CASES["friction"]
    nothing = line(friction, verdict="no missing effect", posterior=[[[], 0.99, ""]])
    assert (best_set(nothing), answer(nothing)) == (frozenset(), {"none"})
    unknown = line(friction, "coulomb-friction", verdict="unknown")
    assert best_set(unknown) is None
    assert answer({"status": "refused"}) == frozenset()
    doubtful = line(friction, "coulomb-friction", verdict="ambiguous",
                    posterior=[[["coulomb-friction"], 0.6, ""], [[], 0.38, ""], [["cogging"], 0.02, ""]])  # fmt: skip
    assert answer(doubtful) == {"none", "coulomb-friction"}
    assert not is_right(doubtful)


def test_an_exact_twin_is_the_best_set_but_no_right_name():
    """One encoder cannot tell the two delays apart: either may come first, neither may be named alone."""
    delay = CASES["delay"]
    twin, true = line(delay, "sensor-delay"), line(delay, "input-delay")
    text = report([twin, true])
    assert figure(text, "top-1, single effect, rich, mid noise")[:2] == ["1.000", "2/2"]
    assert figure(text, "one name given -> right")[:2] == ["0.500", "1/2"]
    assert figure(text, "stated 0.9 to 1.0, on average 0.990: right in")[:2] == ["0.500", "1/2"]


def test_uneven_friction_is_an_even_one_with_a_load():
    assert is_right(line(CASES["pair"], "asymmetric-coulomb-friction"))
    assert is_right(line(task("single", "asymmetric-coulomb-friction"), "constant-load", "coulomb-friction"))
    assert not is_right(line(CASES["pair"], "coulomb-friction"))


def test_where_the_form_is_open_the_kind_has_to_be_right():
    friction = CASES["friction"]
    open_form = ["dry-friction", "omega", 0.99, ""]
    assert is_right(line(friction, "presliding", kinds=[open_form]))
    assert not is_right(line(friction, "presliding", kinds=[open_form], verdict="ambiguous"))
    assert not is_right(line(friction, "presliding", kinds=[["dry-friction", "omega", 0.99, "presliding"]]))
    assert not is_right(line(friction, "stiffness", kinds=[["spring", "omega", 0.99, ""]]))
    assert not is_right(line(friction, "presliding", kinds=[open_form, ["spring", "omega", 0.99, ""]]))
    assert not is_right(line(CASES["pair"], "presliding", kinds=[open_form]))
    assert not is_right(line(CASES["outside"], "presliding", kinds=[open_form]))
    assert not is_right(line(CASES["none"], "presliding", kinds=[]))


def test_a_third_name_spoils_a_pair():
    pair = ["coulomb-friction", "constant-load"]
    text = report([line(CASES["pair"], *pair), line(CASES["pair"], *pair, "cogging")])
    assert figure(text, "pairs: both and no third")[:2] == ["0.500", "1/2"]


def test_a_force_that_is_not_there_and_one_that_is_called_complete():
    none, outside = CASES["none"], CASES["outside"]
    text = report(
        [
            line(none, verdict="no missing effect"),
            line(none, "cogging"),
            line(outside, "cogging"),
            line(outside, "cogging", complete=False),
            line(outside, verdict="unknown"),
        ]
    )
    assert figure(text, "nothing missing -> a name")[:2] == ["0.500", "1/2"]
    assert figure(text, "outside the catalogue -> unknown or incomplete")[:2] == ["0.667", "2/3"]


def test_poor_excitation_is_judged_before_and_after_the_experiment():
    def square(seed):
        return task("square", "coulomb-friction", seed=seed, setup=SQUARE)

    rivals = {"verdict": "ambiguous", "answer": ["cogging", "coulomb-friction"]}
    experiment = {"name": "rich", "duration": 4.8, "sensors": ["phi"], "foreign": [], "separation": 20.0}
    after = line(square(1), "coulomb-friction")
    text = report(
        [
            line(square(1), "cogging", **rivals, experiment=experiment, after=after),
            line(square(2), "cogging", **rivals, experiment=experiment, after_error="ValueError: no"),
            line(square(3), "cogging", **rivals),
            line(square(4), "coulomb-friction"),
            line(square(5), "cogging"),
        ]
    )
    assert figure(text, "poor excitation: a sure wrong name")[:2] == ["0.200", "1/5"]
    assert figure(text, "poor excitation: truth in the answer")[:2] == ["0.800", "4/5"]
    assert figure(text, "poor excitation: left open, named after the proposed experiment")[:2] == ["0.333", "1/3"]
    assert "ValueError: no" in text


def test_calibration_compares_what_was_stated_with_how_often_it_was_so():
    def case(seed, name, p):
        return line(task("single", "coulomb-friction", seed=seed), name, p=p)

    fair = [case(k, "coulomb-friction" if k < 21 else "cogging", 0.72) for k in range(30)]
    sure = [case(100 + k, "coulomb-friction" if k < 16 else "cogging", 0.98) for k in range(20)]
    few = [case(200, "cogging", 0.31)]
    text = report([*fair, *sure, *few])
    assert figure(text, "stated 0.7 to 0.8, on average 0.720: right in")[-1] == "pass"
    assert figure(text, "stated 0.9 to 1.0, on average 0.980: right in")[-1] == "MISS"
    assert figure(text, "stated 0.3 to 0.4, on average 0.310: right in")[-2:] == ["no", "case"]


def test_intervals_count_where_the_hidden_set_was_named():
    value = {"effect": "coulomb-friction", "parameter": "Fc", "truth": 1.0, "value": 1.1}
    lines = [
        line(CASES["friction"], "coulomb-friction", intervals=[value | {"lower": low, "upper": 1.2}])
        for low in (0.9, 0.9, 1.05)
    ]
    lines.append(line(CASES["friction"], "coulomb-friction", "cogging",
                      intervals=[value | {"lower": 1.05, "upper": 1.2}]))  # fmt: skip
    assert figure(report(lines), "95 % intervals hold the truth")[:2] == ["0.667", "2/3"]


@pytest.mark.parametrize("family", FAMILIES)
def test_the_main_parameters_are_those_of_the_catalogue(family):
    """Every entry names a parameter that the catalogue's effect has; a factor is near the one that was drawn."""
    from robustlab.dynamics.effects.contract import Scales

    known = catalogue()
    scales = Scales(dt=1e-3, duration=1.0, force=1.0, speed=1.0, position=1.0, lowest=-1.0, highest=1.0, inertia=1.0)
    for effect in FAMILIES[family].classes:
        if effect not in known:
            continue
        case = make_case(effect, 1, plant=FAMILIES[family].plant, duration=0.1, current=FAMILIES[family].current)
        found = main_parameter(effect, "q", case)
        if found is None:
            continue
        name, truth = found
        if name not in ("s", "k", "b"):  # these depend on the site
            assert name in {p.name for p in known[effect].parameters(scales)}, effect
        if "factor" in case.true_parameters[effect]:
            assert abs(truth / case.true_parameters[effect]["factor"] - 1) < 0.5


def test_the_store_survives_a_cut(tmp_path):
    store = tmp_path / "cases.jsonl"
    first, second = line(CASES["friction"]), line(CASES["delay"])
    store.write_text(json.dumps(first) + "\n" + json.dumps(second)[:40])
    assert [x["key"] for x in stored(store)] == [first["key"]]
    with store.open("a") as stream:
        stream.write(json.dumps(second) + "\n")
    assert [x["key"] for x in stored(store)] == [first["key"], second["key"]]


def test_tasks_have_keys_of_their_own():
    wanted = list(tasks(list(CONDITIONS), [1, 2], peer=True))
    assert len({task.key for task in wanted}) == len(wanted)
    assert {task.who for task in wanted} == {"robustlab", "pysindy"}


def test_a_run_that_is_cut_short_is_a_fair_sample():
    """Seed by seed; within a seed every condition and family has its share of the first fifth."""
    wanted = list(tasks(USUAL, [5, 6]))
    assert [t.seed for t in wanted] == sorted(t.seed for t in wanted)
    of_seed = [t for t in wanted if t.seed == 5]
    first = of_seed[: len(of_seed) // 5]
    for part in (lambda t: t.condition, lambda t: t.family):
        shares = {x: sum(part(t) == x for t in of_seed) / len(of_seed) for x in map(part, of_seed)}
        for x, share in shares.items():
            spread = (share / len(first)) ** 0.5
            assert abs(sum(part(t) == x for t in first) / len(first) - share) < 4 * spread
    assert list(tasks(["pairs"], [5])) == [t for t in of_seed if t.condition == "pairs"]


def test_the_last_seeds_are_not_run_by_accident(capsys):
    with pytest.raises(SystemExit):
        main(["--seeds", "5,77001-77003"])
    assert "--last" in capsys.readouterr().err


def test_wilson():
    """Known values: 0 of 10 and 81 of 263 (Newcombe, Statistics in Medicine 17 (1998), table I)."""
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert wilson(0, 10)[1] == pytest.approx(0.2775, abs=5e-5)
