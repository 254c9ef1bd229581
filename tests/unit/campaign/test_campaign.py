"""Campaigns: samples are pure functions of their index, stores keep all rows, failures are isolated."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import beta, binom

import robustlab as rl
from robustlab.campaign import (
    TILE,
    CampaignSettings,
    Evaluator,
    WorkerOptions,
    read_campaign,
    resume_campaign,
    run_campaign,
    saved_samples,
)
from robustlab.errors import InputError, UsageError


@pytest.fixture(scope="module")
def motor():
    return rl.plant("dc-motor", Kf=(4.8e-5, 0.35), R=(2.07, 0.1)).uncertain(outputs=["omega"])


def settings_of(n, **more):
    return CampaignSettings("peak-deviation", n, **{"u": {"u": 42.0}, "t_end": 0.1, "points": 51, **more})


# --- a sample is a pure function of its index ---------------------------------------------------------------------


def ran(tmp_path, model, settings, workers=1, **more):
    return run_campaign(model, settings, tmp_path / f"{workers}.sqlite", workers=WorkerOptions(workers), **more)


def test_samples_equal_those_of_rl_sample(motor):
    drawn = Evaluator(motor, settings_of(100, seed=5)).rows(0, TILE).deltas
    assert drawn[:3].tolist() == [list(delta.values()) for delta in rl.sample(motor, 3, seed=5).deltas]


def test_values_are_peak_deviations_of_single_simulations(motor):
    rows = Evaluator(motor, settings_of(TILE)).rows(0, TILE)
    t, deltas = np.linspace(0, 0.1, 51), rl.sample(motor, TILE).deltas
    nominal = rl.simulate(motor.nominal, t, np.full(51, 42.0))["omega"]
    for i in (0, 1, 17, TILE - 1):
        peak = np.abs(rl.simulate(motor.evaluate(deltas[i]), t, np.full(51, 42.0))["omega"] - nominal).max()
        assert rows.values[i] == pytest.approx(peak, rel=1e-9)


def test_all_vertices_occur_once_and_include_the_worst_case(tmp_path, motor):
    found = ran(tmp_path, motor, settings_of(4, kind="vertices"))
    columns = found.table().columns
    assert set(zip(columns["Kf"], columns["R"], strict=True)) == {(a, b) for a in (-1.0, 1.0) for b in (-1.0, 1.0)}
    worst = rl.worst_case(motor, u={"u": 42.0}, t=np.linspace(0, 0.1, 51), n=16)
    assert found.worst == pytest.approx(worst.value, rel=1e-9)


def test_searches_find_what_worst_case_finds(tmp_path, motor):
    found = ran(tmp_path, motor, CampaignSettings("hinf", 2, kind="search", starts=2))
    best = rl.worst_case(motor, "hinf", n=4)
    assert found.table().columns["hinf"] == pytest.approx([best.value] * 2, rel=1e-6)
    assert found.delta == pytest.approx(best.delta)


def test_samples_do_not_depend_on_the_workers(tmp_path, motor):
    n = 5 * TILE + 7
    one, two = ran(tmp_path, motor, settings_of(n)), ran(tmp_path, motor, settings_of(n), 2)
    assert (one.digest, one.done, one.lost) == (two.digest, n, 0)
    evaluator = Evaluator(motor, settings_of(n))
    values = one.table().columns["peak-deviation"]
    assert np.concatenate([evaluator.rows(k, k + TILE).values for k in range(0, n, TILE)]).tolist() == values.tolist()
    assert Evaluator(motor, settings_of(n, seed=1)).rows(0, TILE).values[0] != values[0]


# --- failures ------------------------------------------------------------------------------------------------------


def test_an_exception_in_a_tile_loses_only_its_own_sample(motor, monkeypatch):
    evaluator = Evaluator(motor, settings_of(TILE))
    whole = evaluator.rows(0, TILE)
    bad = whole.deltas[9].tolist()

    def values(theta, original=evaluator._values):
        if bad in theta.tolist():
            raise ZeroDivisionError("no\x1b[31mgood")
        return original(theta)

    monkeypatch.setattr(evaluator, "_values", values)
    rows = evaluator.rows(0, TILE)
    assert rows.lost == {9: "ZeroDivisionError: no\\x1b[31mgood"}
    assert math.isnan(rows.values[9])
    np.testing.assert_allclose(np.delete(rows.values, 9), np.delete(whole.values, 9), rtol=1e-12)


def test_a_metric_that_is_not_a_number_is_a_lost_sample(motor, monkeypatch):
    evaluator = Evaluator(motor, settings_of(TILE))
    original = evaluator._values
    monkeypatch.setattr(evaluator, "_values", lambda deltas: np.where(original(deltas) > 30, np.nan, original(deltas)))
    rows = evaluator.rows(0, TILE)
    assert set(rows.lost.values()) == {"the metric is not a number"}
    assert sorted(rows.lost) == np.flatnonzero(np.isnan(rows.values)).tolist()


# --- rejected settings ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ({"kind": "sample"}, UsageError, "did you mean samples?"),
        ({"n": 0}, InputError, "n: 0"),
        ({"n": 2.5}, InputError, "n: 2.5"),
        ({"seed": -1}, InputError, "seed: -1"),
        ({"points": 1}, InputError, "points: 1"),
        ({"t_end": -1.0}, InputError, "t_end: -1.0"),
        ({"t_end": math.nan}, InputError, "t_end: nan"),
    ],
)
def test_invalid_settings_are_rejected(change, error, text):
    with pytest.raises(error, match="campaign") as caught:
        CampaignSettings(**{"metric": "hinf", "n": 10, **change})
    assert text in str(caught.value)


@pytest.mark.parametrize(
    ("settings", "error", "text"),
    [
        (CampaignSettings("hinff", 10), UsageError, "did you mean hinf?"),
        (settings_of(10, output="speed"), InputError, "no such signal"),
        (settings_of(10, u={"v": 1.0}), InputError, "no such input"),
    ],
)
def test_the_metric_is_checked_before_any_worker_starts(motor, settings, error, text, tmp_path):
    with pytest.raises(error) as caught:
        run_campaign(motor, settings, tmp_path / "s.sqlite")
    assert text in str(caught.value)
    assert not list(tmp_path.iterdir())


# --- from end to end, in real processes ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def finished(tmp_path_factory, motor):
    """A campaign of 2000 samples in a real worker process."""
    path = tmp_path_factory.mktemp("finished") / "motor.sqlite"
    seen = []
    result = run_campaign(motor, settings_of(2000), path, workers=WorkerOptions(1), limit=30.0, progress=seen.append)
    assert sum(seen) == 2000
    return path, result


def test_the_result_summarises_its_samples(finished):
    path, result = finished
    values = result.table().columns["peak-deviation"]
    assert (result.status, result.done, result.lost) == (rl.Status.CONVERGED, 2000, 0)
    assert result.worst == values.max() == values[result.worst_index]
    assert result.again == pytest.approx(result.worst, rel=1e-9)
    assert result.nominal == 0.0
    assert result.physical["R"][0] == pytest.approx(2.07 * (1 + 0.1 * result.delta["R"]))
    assert result.unseen == pytest.approx(1 - 0.05 ** (1 / 2000))
    count = int((values > 30.0).sum())
    found = result.violation
    assert (found.count, found.of) == (count, 2000)
    assert found.lower == pytest.approx(beta.ppf(0.05, count, 2001 - count))
    assert found.upper == pytest.approx(beta.ppf(0.95, count + 1, 2000 - count))
    assert [q.share for q in result.quantiles] == [0.5, 0.9, 0.99, 0.999]
    for q in result.quantiles:
        assert q.value == np.sort(values)[math.ceil(q.share * 2000) - 1]
        rank = int(binom.ppf(0.95, 2000, q.share)) + 1
        assert q.bound == (np.sort(values)[rank - 1] if rank <= 2000 else math.inf)
    assert [file.name for file in path.parent.iterdir() if "wal" in file.name or "shm" in file.name] == []


def test_a_metric_whose_smallest_value_is_the_worst(tmp_path, motor):
    found = ran(tmp_path, motor, CampaignSettings("damping", 64), limit=0.999)
    values = found.table().columns["damping"]
    assert found.worst == values.min()
    assert found.violation.count == (values < 0.999).sum()
    assert found.quantiles[0].value == np.sort(values)[32]


def test_a_finished_campaign_is_not_computed_again(finished, motor):
    path, result = finished
    seen = []
    again = run_campaign(motor, settings_of(2000), path, progress=seen.append)
    assert (again.digest, again.worst, seen) == (result.digest, result.worst, [2000])
    assert read_campaign(path).digest == result.digest
    assert resume_campaign(path).digest == result.digest
    assert saved_samples(path) == (2000, 2000)
