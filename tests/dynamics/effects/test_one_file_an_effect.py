"""A file in the folder of the effects is all that a new effect needs: nothing else names it."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics import effects
from robustlab.dynamics.effects import catalogue as module

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
