"""What is said after a search: a stage that fails, an interruption and what remains never lose or inflate the names."""

import numpy as np
import pytest
from naming_cases import AXIS, machine, noisy

import robustlab as rl
from robustlab.dynamics import catalogue
from robustlab.errors import NoTrustworthyNumber
from robustlab.identification.naming import answer as module
from robustlab.identification.naming.held_out import Gaps
from robustlab.identification.naming.named_effects import Gap
from robustlab.result import Status

FEW = tuple(set(catalogue()) - {"coulomb-friction", "constant-load", "sensor-delay", "input-delay"})


def discovered(record, **options):
    return rl.discover(AXIS, record, exclude=FEW, **options)


NO_NUMBER = NoTrustworthyNumber("the model", "u[552,1] is infinite", "a number")


@pytest.mark.parametrize(
    ("stage", "fault"),
    [
        ("left_over", NO_NUMBER),
        ("_missing_force", ValueError("0")),
        pytest.param("remaining_lines", ValueError("0"), marks=pytest.mark.slow),
        pytest.param("_floor_excess", NO_NUMBER, marks=pytest.mark.slow),
    ],
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
