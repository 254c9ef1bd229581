"""Campaigns: samples are pure functions of their index, stores give back what was put in, failures stay alone."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import beta, binom

import robustlab as rl
from robustlab.campaign import CampaignSettings, read_campaign, replay_sample, runs
from robustlab.campaign.campaign_result import (
    SHARES,
    exceedance_curve,
    quantiles,
    share_beyond,
)
from robustlab.campaign.dispatch import compute_missing
from robustlab.campaign.evaluation import (
    TILE,
    Evaluator,
    Rows,
    decode_delta,
    delta_width,
    encode_delta,
)
from robustlab.campaign.settings import Identity, model_to_bytes
from robustlab.campaign.store import Store
from robustlab.campaign.workers import Workers
from robustlab.errors import InputError, NoTrustworthyNumber, UsageError
from robustlab.worst_case_analysis import METRICS
from robustlab.worst_case_analysis.draws import delta_of_sample


@pytest.fixture(scope="module")
def motor():
    return rl.plant("dc-motor", Kf=(4.8e-5, 0.35), R=(2.07, 0.1)).uncertain(outputs=["omega"])


def settings_of(n, **more):
    return CampaignSettings("peak-deviation", n, **{"u": {"u": 42.0}, "t_end": 0.1, "points": 51, **more})


def new_store(path, model, asked):
    return Store.create(path, Identity.of(model, asked), model_to_bytes(model))


def filled(path, model, asked, count=2):
    """A store computed by threads of this process."""
    store, evaluator = new_store(path, model, asked), Evaluator(model, asked)
    with ThreadPoolExecutor(count) as pool:
        compute_missing(store, evaluator, Workers(pool, count, lambda: None), lambda _: None)
    return store


def kinds_of_blocks():
    return [rl.RealScalar("k", 2), rl.ComplexScalar("c", 3), rl.FullBlock("F", 2, 3)]


# --- a sample is a pure function of its index ---------------------------------------------------------------------


def test_a_sample_is_the_one_that_rl_sample_draws(motor):
    evaluator = Evaluator(motor, settings_of(100, seed=5))
    assert [evaluator.delta(i) for i in range(3)] == list(rl.sample(motor, 3, seed=5).deltas)
    assert delta_of_sample(motor.blocks, 5, 2) == rl.sample(motor, 3, seed=5).deltas[2]


def test_values_are_peak_deviations_of_single_simulations(motor):
    rows = Evaluator(motor, settings_of(TILE)).rows(0, TILE)
    t = np.linspace(0, 0.1, 51)
    nominal = rl.simulate(motor.nominal, t, np.full(51, 42.0))["omega"]
    for i in (0, 1, 17, TILE - 1):
        member = motor.evaluate(delta_of_sample(motor.blocks, 0, i))
        peak = np.abs(rl.simulate(member, t, np.full(51, 42.0))["omega"] - nominal).max()
        assert rows.values[i] == pytest.approx(peak, rel=1e-9)


def test_all_vertices_are_met_once_and_hold_the_worst_case(tmp_path, motor):
    store = filled(tmp_path / "v.sqlite", motor, settings_of(4, kind="vertices"))
    found = {tuple(decode_delta(motor.blocks, row.numbers).values()) for row in store.samples()}
    assert found == {(a, b) for a in (-1.0, 1.0) for b in (-1.0, 1.0)}
    worst = rl.worst_case(motor, u={"u": 42.0}, t=np.linspace(0, 0.1, 51), n=16)
    assert store.worst(1).value == pytest.approx(worst.value, rel=1e-9)
    store.close()


def test_searches_find_what_worst_case_finds(tmp_path, motor):
    asked = CampaignSettings("hinf", 2, kind="search", starts=2)
    store = filled(tmp_path / "s.sqlite", motor, asked)
    best = rl.worst_case(motor, "hinf", n=4)
    assert [row.value for row in store.samples()] == pytest.approx([best.value] * 2, rel=1e-6)
    assert decode_delta(motor.blocks, store.worst(1).numbers) == pytest.approx(best.delta)
    store.close()


@pytest.mark.parametrize("n", [1, TILE - 1, TILE, TILE + 1, 5 * TILE + 7])
def test_samples_depend_neither_on_the_workers_nor_on_their_number(tmp_path, motor, n):
    stores = [filled(tmp_path / f"{count}.sqlite", motor, settings_of(n), count) for count in (1, 3)]
    stores.append(filled(tmp_path / "seed.sqlite", motor, settings_of(n, seed=1)))
    more = filled(tmp_path / "more.sqlite", motor, settings_of(n + 70))
    digests = [store.digest() for store in stores]
    assert digests[0] == digests[1] != digests[2]
    assert stores[0].counts() == (n, 0)
    assert [row.value for row in more.samples()][:n] == [row.value for row in stores[0].samples()]
    for store in (*stores, more):
        store.close()


# --- failures ------------------------------------------------------------------------------------------------------


def test_an_exception_in_a_stack_costs_only_its_own_sample(motor, monkeypatch):
    evaluator = Evaluator(motor, settings_of(TILE))
    whole = evaluator.rows(0, TILE)
    bad = evaluator.delta(9)

    def values(deltas, original=evaluator._values):
        if bad in deltas:
            raise ZeroDivisionError("no\x1b[31mgood")
        return original(deltas)

    monkeypatch.setattr(evaluator, "_values", values)
    rows = evaluator.rows(0, TILE)
    assert rows.lost == {9: "ZeroDivisionError: no\\x1b[31mgood"}
    assert math.isnan(rows.values[9])
    np.testing.assert_allclose(np.delete(rows.values, 9), np.delete(whole.values, 9), rtol=1e-12)


def test_more_than_one_percent_lost_stops(tmp_path, motor, monkeypatch):
    monkeypatch.setattr(Evaluator, "_values", lambda _, deltas: np.full(len(deltas), np.nan))
    with pytest.raises(NoTrustworthyNumber, match="of 300 samples are lost") as caught:
        filled(tmp_path / "s.sqlite", motor, settings_of(300))
    assert "campaign replay" in str(caught.value)
    assert "the metric is not a number" in str(caught.value)


def test_a_metric_that_is_not_a_number_is_a_lost_sample(motor, monkeypatch):
    evaluator = Evaluator(motor, settings_of(TILE))
    original = evaluator._values
    monkeypatch.setattr(evaluator, "_values", lambda deltas: np.where(original(deltas) > 30, np.nan, original(deltas)))
    rows = evaluator.rows(0, TILE)
    assert set(rows.lost.values()) == {"the metric is not a number"}
    assert sorted(rows.lost) == np.flatnonzero(np.isnan(rows.values)).tolist()


# --- what is stored and sent ---------------------------------------------------------------------------------------


@settings(max_examples=20)
@given(st.integers(0, 2**40), st.integers(0, 2**40))
def test_deltas_of_every_kind_survive(seed, index):
    blocks = kinds_of_blocks()
    delta = delta_of_sample(blocks, seed, index)
    numbers = encode_delta(blocks, delta)
    assert len(numbers) == delta_width(blocks) == 1 + 2 + 12
    back = decode_delta(blocks, numbers)
    assert (back["k"], back["c"]) == (delta["k"], delta["c"])
    np.testing.assert_array_equal(back["F"], delta["F"])


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ({"kind": "sample"}, UsageError, "did you mean samples?"),
        ({"n": 0}, InputError, "n is 0"),
        ({"n": 2.5}, InputError, "n is 2.5"),
        ({"seed": -1}, InputError, "seed is -1"),
        ({"points": 1}, InputError, "points is 1"),
        ({"t_end": -1.0}, InputError, "t_end is -1.0"),
        ({"t_end": math.nan}, InputError, "t_end is nan"),
    ],
)
def test_settings_that_are_refused(change, error, text):
    with pytest.raises(error, match="campaign") as caught:
        CampaignSettings(**{"metric": "hinf", "n": 10, **change})
    assert text in str(caught.value)


@pytest.mark.parametrize(
    ("asked", "error", "text"),
    [
        (CampaignSettings("hinff", 10), UsageError, "did you mean hinf?"),
        (settings_of(10, output="speed"), InputError, "no such signal"),
        (settings_of(10, u={"v": 1.0}), InputError, "no such input"),
    ],
)
def test_what_the_metric_refuses_is_said_before_any_worker_starts(motor, asked, error, text, tmp_path):
    with pytest.raises(error) as caught:
        runs.run_campaign(motor, asked, tmp_path / "s.sqlite")
    assert text in str(caught.value)
    assert not list(tmp_path.iterdir())


# --- statistics ----------------------------------------------------------------------------------------------------


def store_of(path, model, values, lost=0):
    n = len(values) + lost
    store = new_store(path, model, settings_of(n))
    reasons = dict.fromkeys(range(len(values), n), "gone")
    everything = np.concatenate([values, np.full(lost, np.nan)])
    store.save(Rows(0, everything, np.zeros((n, 2)), np.ones(n), reasons))
    return store


def test_quantiles_are_order_statistics_with_binomial_bounds(tmp_path, motor):
    rng = np.random.default_rng(3)
    values = rng.standard_normal(2000)
    store = store_of(tmp_path / "s.sqlite", motor, values)
    for q in quantiles(store, 1, 2000, 0):
        assert q.value == np.sort(values)[math.ceil(q.share * 2000) - 1]
        rank = int(binom.ppf(0.95, 2000, q.share)) + 1
        assert q.bound == (np.sort(values)[rank - 1] if rank <= 2000 else math.inf)
    assert [q.share for q in quantiles(store, 1, 2000, 0)] == list(SHARES)
    store.close()


def test_lost_samples_count_as_the_worst(tmp_path, motor):
    store = store_of(tmp_path / "s.sqlite", motor, np.arange(97.0), lost=3)
    found = share_beyond(store, 1, 95.5, 97, 3)
    assert (found.count, found.of) == (4, 100)
    assert found.upper == pytest.approx(beta.ppf(0.95, 5, 96))
    assert found.lower == pytest.approx(beta.ppf(0.05, 1, 100))
    assert quantiles(store, 1, 97, 3)[-1].bound == math.inf
    store.close()


def test_where_the_smallest_is_the_worst_everything_is_mirrored(tmp_path, motor):
    values = np.random.default_rng(4).standard_normal(300)
    largest = store_of(tmp_path / "largest.sqlite", motor, values)
    smallest = store_of(tmp_path / "smallest.sqlite", motor, -values)
    assert smallest.worst(-1).value == -largest.worst(1).value
    for q, mirrored in zip(quantiles(largest, 1, 300, 0), quantiles(smallest, -1, 300, 0), strict=True):
        assert (q.value, q.bound) == (-mirrored.value, -mirrored.bound)
    assert share_beyond(smallest, -1, -1.5, 300, 0).count == share_beyond(largest, 1, 1.5, 300, 0).count > 0
    for ours, mirrored in zip(
        exceedance_curve(largest, 1, 300, 0), exceedance_curve(smallest, -1, 300, 0), strict=True
    ):
        np.testing.assert_array_equal(np.abs(ours), np.abs(mirrored))
    largest.close()
    smallest.close()


# --- from end to end, in real processes ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def finished(tmp_path_factory, motor):
    """A campaign of 300 samples in a real worker process."""
    path = tmp_path_factory.mktemp("finished") / "motor.sqlite"
    seen = []
    result = runs.run_campaign(motor, settings_of(300), path, crew=runs.Crew(1), limit=30.0, progress=seen.append)
    assert sum(seen) == 300
    return path, result


def test_the_result_is_that_of_this_process(finished, motor, tmp_path):
    path, result = finished
    store = filled(tmp_path / "inline.sqlite", motor, settings_of(300))
    assert result.digest == store.digest()
    assert (result.status, result.done, result.lost) == (rl.Status.CONVERGED, 300, 0)
    assert result.worst == max(row.value for row in store.samples())
    assert result.again == pytest.approx(result.worst, rel=1e-9)
    assert result.nominal == 0.0
    assert result.physical["R"][0] == pytest.approx(2.07 * (1 + 0.1 * result.delta["R"]))
    assert result.unseen == pytest.approx(1 - 0.05 ** (1 / 300))
    assert result.violation.count == sum(row.value > 30.0 for row in store.samples())
    store.close()
    assert [file.name for file in path.parent.iterdir() if "wal" in file.name or "shm" in file.name] == []


def test_a_finished_campaign_is_not_computed_again(finished, motor, monkeypatch):
    path, result = finished
    monkeypatch.setattr(runs, "hired", lambda *_: pytest.fail("workers were hired"))
    again = runs.run_campaign(motor, settings_of(300), path)
    assert (again.digest, again.worst) == (result.digest, result.worst)
    assert read_campaign(path).digest == result.digest
    assert runs.resume_campaign(path).digest == result.digest
    assert runs.saved_samples(path) == (300, 300)


def test_a_sample_is_replayed_with_the_same_bits(finished):
    path, result = finished
    replay = replay_sample(path, result.worst_index)
    assert replay.identical
    assert replay.status == rl.Status.CONVERGED
    assert replay.value == result.worst
    assert replay.delta == result.delta
    with pytest.raises(InputError, match=r"no sample 300, expected 0 .. 299"):
        replay_sample(path, 300)


@pytest.mark.parametrize("metric", sorted(METRICS))
def test_every_metric_of_the_search_is_one_of_campaigns(tmp_path, metric):
    chain = rl.plant("mass-spring-damper", m=(1.0, 0.2), c=(0.5, 0.3), k=(4.0, 0.2)).uncertain(outputs=["q"])
    needs_a_response = metric in ("peak-deviation", "peak", "rms", "overshoot", "settling-time")
    drive = {"t_end": 60.0, "u": {"f": 1.0}} if needs_a_response else {}
    asked = CampaignSettings(metric, 8, kind="vertices", output="q", **drive)
    store = filled(tmp_path / "s.sqlite", chain, asked)
    evaluator = Evaluator(chain, asked)
    worst = store.worst(evaluator.sense)
    again = evaluator.evaluate(decode_delta(chain.blocks, worst.numbers))
    assert store.counts() == (8, 0)
    assert evaluator.agrees(worst.value, again)
    values = [evaluator.sense * row.value for row in store.samples()]
    assert evaluator.sense * worst.value == max(values)
    store.close()
