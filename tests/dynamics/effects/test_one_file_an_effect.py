"""A file in the folder of the effects is all that a new effect needs: nothing else names it."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from hidden import make_case

import robustlab as rl
from robustlab.dynamics import effects
from robustlab.dynamics.effects import catalogue as module
from robustlab.dynamics.ports.port_model import port_model
from robustlab.identification.experiment.next_experiment import propose_experiment
from robustlab.identification.hypotheses.candidates import candidates, nuisance_parameters, stated_tolerances
from robustlab.identification.hypotheses.effect_fit import Hypothesis, Problem
from robustlab.identification.hypotheses.noise import first_noise, whitening
from robustlab.identification.hypotheses.prepared_record import prepare, window_length

FILE = """
from robustlab.dynamics.effects.signal_effects import SignalGain


class DisplayGain(SignalGain):
    id = "display-gain"
    title = "Gain of the display"
    equation = "y' = s y"
    independently = "read the display beside a second one"
    site_kind = "output"
    spread = 0.05
    meaning = "what is shown over what is there"
    output = SignalGain.scaled


EFFECT = DisplayGain()
"""


@pytest.fixture
def new_file(monkeypatch, tmp_path):
    (tmp_path / "display_gain.py").write_text(FILE, encoding="utf-8")
    monkeypatch.setattr(effects, "__path__", [*effects.__path__, str(tmp_path)])
    module._own.cache_clear()
    yield
    module._own.cache_clear()
    sys.modules.pop("robustlab.dynamics.effects.display_gain", None)


@pytest.mark.usefixtures("new_file")
def test_it_is_attached_simulated_and_a_block_of_the_set():
    assert "display-gain" in module.effect_names()
    motor, t = rl.plant("dc-motor"), np.arange(0.0, 0.1, 1e-3)
    shown = rl.with_effects(motor, {"display-gain@omega": {"s": (1.04, 0.01)}})
    plain, told = (rl.simulate(p, t, {"u": np.full(len(t), 6.0)}) for p in (motor, shown))
    assert told["omega"] == pytest.approx(1.04 * plain["omega"], rel=1e-9, abs=1e-9)
    assert told["phi"] == pytest.approx(plain["phi"], rel=1e-9, abs=1e-9)
    assert "display-gain@omega" in [b.name for b in shown.uncertain().blocks]
    assert "display-gain@omega" in [b.name for b in rl.uncertain_from(shown).model.blocks]
    assert shown.left_out() == ()


@pytest.mark.usefixtures("new_file")
def test_it_is_looked_for_and_advised_on():
    case = make_case("sensor-gain", 5, excitation="rich", plant="dc-motor", noise="mid")
    plant, model = case.plant, port_model(case.plant)
    prepared = prepare(plant, model, case.record, window_length(plant, [case.record]))
    problem = Problem(plant, [prepared], nuisance_parameters(plant, stated_tolerances(plant, None)))
    pool = [c for c in candidates(plant, model, problem.records) if c.site.name == "phi"]

    def fit(name, noise):
        bare = np.zeros(len(problem.nuisances))
        (c,) = (c for c in pool if c.effect.id == name)
        tries = [problem.fit(Hypothesis((c,)), noise, np.array([*bare, *c.standardised(s)])) for s in c.starts]
        return min(tries, key=lambda f: f.cost)

    noise = whitening(problem, fit("sensor-gain", first_noise(problem)))
    fits = [fit(name, noise) for name in ("display-gain", "sensor-gain")]
    found = propose_experiment(problem, fits[0], fits[1:])
    assert found.separation < 10  # only their priors tell them apart
    assert "display-gain: read the display beside a second one" in found.advice
    assert "sensor-gain: move the axis by a length or angle known from elsewhere" in found.advice
