"""What is said after a search: a stage that fails, an interruption and what remains never lose or inflate the names."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from naming_cases import AXIS, T, U, machine, noisy, usual

import robustlab as rl
from robustlab.dynamics.effects.catalogue import catalogue
from robustlab.errors import NoTrustworthyNumber
from robustlab.identification.hypotheses.effect_fit import FitPlan, Hypothesis
from robustlab.identification.hypotheses.noise import first_noise
from robustlab.identification.hypotheses.unnamed_force import fitted_windows
from robustlab.identification.naming import answer as module
from robustlab.identification.naming.discovery import _spread
from robustlab.identification.naming.held_out_gaps import Gaps
from robustlab.identification.naming.named_effects import Gap
from robustlab.result import Status

FEW = tuple(set(catalogue()) - {"coulomb-friction", "constant-load", "sensor-delay", "input-delay"})


def discovered(record, **options):
    return rl.discover(AXIS, record, exclude=FEW, **options)


@pytest.mark.parametrize("stage", ["left_over", "remaining_lines", "_floor_excess", "_missing_force"])
@pytest.mark.parametrize(
    "fault", [NoTrustworthyNumber("the model", "u[552,1] is infinite", "a number"), ValueError("0")]
)
def test_a_stage_that_fails_after_the_naming_does_not_lose_it(monkeypatch, stage, fault):
    def fails(*_):
        raise fault

    monkeypatch.setattr(module, stage, fails)
    found = discovered(machine(friction=20.0, seed=3))
    assert found.names == ("coulomb-friction",)
    (value,) = found.effects[0].parameters
    assert value.lower < 20.0 < value.upper
    told = [f for f in found.findings if f.kind == "stage"]
    assert told
    assert all("not computed" in f.found for f in told)
    assert found.complete == (stage != "left_over")  # what was not looked at is not known to be nothing
    assert str(fault) in told[0].found


def test_a_next_experiment_that_fails_does_not_lose_the_twins(monkeypatch):
    run = rl.simulate(AXIS, T, np.concatenate([np.zeros(2), U[:-2]]))
    record = rl.Record(T, {"u": U}, noisy({"q": run["q"]}, 0), name="late")

    def fails(*_):
        raise NoTrustworthyNumber("the experiment", "no answer", "one")

    monkeypatch.setattr(module, "_next_experiment", fails)
    found = discovered(record)
    assert found.verdict == "named"  # late, be it the input or the sensor
    assert [(k.kind, k.settled) for k in found.kinds] == [("lateness", False)]
    assert {*found.names, *(r.name for r in found.rivals)} == {"input-delay", "sensor-delay"}
    assert found.next_experiment is None
    assert "next experiment" in [f.channel for f in found.findings if f.kind == "stage"]


class StopAfter:
    """A listener that stops the search at the given number of reports."""

    def __init__(self, count):
        self.left = count

    def __call__(self, text):
        """Not asked: it counts."""

    def part(self, done, expected, text):
        self.left -= 1
        if not self.left:
            raise KeyboardInterrupt


@pytest.mark.parametrize("after", [1, 25])
def test_an_interrupted_search_says_so_and_is_not_sure(after):
    found = discovered(machine(friction=20.0, seed=3), progress=StopAfter(after))
    assert "interrupted" in [f.kind for f in found.findings]
    assert found.verdict != "named"
    assert found.status is Status.INCONCLUSIVE


def test_a_plain_listener_hears_each_part_of_the_search_once():
    texts = []
    discovered(machine(friction=20.0, seed=3), progress=texts.append)
    assert texts[-1] == "what remains"
    assert all(a != b for a, b in pairwise(texts))


def test_probabilities_of_a_result_sum_to_one():
    found = discovered(machine(friction=20.0, seed=3))
    assert sum(s.probability for s in found.posterior) == pytest.approx(1.0)
    assert found.posterior[0].names == ("coulomb-friction",)
    assert found.effects[0].confidence == pytest.approx(
        sum(s.probability for s in found.posterior if "coulomb-friction" in s.names)
    )
    assert found.search
    assert [c.hold for c in found.clocks] == ["held"]


def test_a_ripple_over_time_forbids_that_all_is_well():
    """50 Hz in the force, one per cent of what the motor gives, and no effect that could have it."""
    t = np.arange(4000) * 1e-3
    u = 1.5 * np.sin(2 * np.pi * 1.3 * t) + np.repeat(np.random.default_rng(1).choice([-1.0, 1.0], 40), 100)
    hum = 0.05 * np.sin(2 * np.pi * 50.0 * (t + 5e-4))
    run = rl.simulate(AXIS, t, u + hum)
    record = rl.Record(t, {"u": u}, noisy({"v": run["v"]}, 0, 1e-4), name="hum")
    found = discovered(record)
    assert found.verdict == "unknown"
    assert not found.complete
    line = found.remaining_lines[0]
    assert line["over"] == "time"
    assert line["period"] == pytest.approx(0.02, rel=0.01)


def test_a_record_of_which_no_window_is_searched_is_no_part_of_the_search():
    problem = usual(friction=20.0).problem
    many = problem.on([problem.records[0]] * 30, [np.arange(2)] * 30)
    few = _spread(many, 12)
    assert [len(c) for c in few.chosen] == [1] * 12
    assert few.records[0] is many.records[0]
    fit = few.fit(Hypothesis(()), first_noise(few), np.zeros(len(few.nuisances)), plan=FitPlan(1))
    assert np.isfinite(fitted_windows(few, fit)[0][0].log_likelihood)


def test_what_the_names_explain_is_measured_against_the_noise_that_they_were_judged_by():
    found = usual(friction=20.0)
    fit = found.best.fit
    # Twice the noise, told as an excess: V falls to a quarter, and so does what noise alone makes of it.
    noise = replace(fit.noise, std=2.0 * fit.noise.std, excess=4.0)
    points = fit.cost / 4.0
    wider = replace(fit, noise=noise, cost=2.0 * points)
    bare = replace(found.empty, fit=replace(found.empty.fit, noise=noise, cost=3.0 * points))
    share = module._explained(replace(found, empty=bare), wider)
    assert share == pytest.approx(0.5, abs=0.05)


def test_names_that_explain_less_than_what_remains_are_not_conclusive():
    cases = {(True, 0.1): Status.CONVERGED, (False, 0.6): Status.CONVERGED, (False, 0.48): Status.INCONCLUSIVE}
    assert {key: module._Judgement("named", key[0]).status(key[1]) for key in cases} == cases


def test_names_that_worsen_the_free_run_are_refuted():
    gaps = Gaps({"q": Gap("q", "m", 1.0, 5.0, 1.0, 0.5)}, {"q": Gap("q", "m", 1.0, 2.0, 3.0, 2.1)}, "test", False, {})
    assert module._on_held_out(module._Judgement("named", True), gaps, True, 0.05) == ("unknown", False)


@pytest.mark.parametrize(
    ("updated", "worse", "strained", "verdict"),
    [
        (1.0, False, False, "named"),
        (1.004, False, False, "named"),
        (1.08, False, False, "ambiguous"),
        (1.08, True, False, "unknown"),
        (1.03, True, True, "named"),  # the refitted model has left its tolerances, and is no nearer than that
        (1.08, True, True, "unknown"),
    ],
)
def test_names_do_not_stand_against_held_out_data(updated, worse, strained, verdict):
    judged = module._Judgement("named", True)
    gaps = Gaps({"q": Gap("q", "m", 1.0, 5.0, 1.0, updated)}, {}, "test", worse, {})
    said = module._on_held_out(judged, gaps, strained, 0.05)
    assert said.verdict == verdict
    assert said.complete == (verdict != "unknown")
