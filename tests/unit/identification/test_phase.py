"""Phases of a ripple over time in records that begin at other times, against scipy's solution of the equations."""

from __future__ import annotations

import numpy as np
import pytest

from robustlab.dynamics import effect

N, DT, LATER = 600, 2e-3, 0.093
WAVE = {"Ac": 12.0, "As": -9.0, "f": 7.0}


def test_parameters_of_a_record_that_begins_later_make_the_same_ripple():
    def force(values, t):
        turn = 2 * np.pi * values["f"] * t
        return values["Ac"] * np.cos(turn) + values["As"] * np.sin(turn)

    t = np.linspace(0.0, 1.0, 50)
    for later in (0.0, 0.02, LATER, 3.0):
        there = effect("torque-ripple").begun(WAVE, later)
        assert force(there, t) == pytest.approx(force(WAVE, t + later), abs=1e-10)
