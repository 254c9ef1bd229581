"""compare never judges a plant with effects by its linear part alone."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.errors import InputError


def test_a_plant_with_effects_is_refused_by_name():
    axis = rl.with_effects(rl.plant("servo-axis"), {"coulomb-friction": {"Fc": 20.0}})
    t = np.arange(0.0, 1.0, 1e-3)
    record = rl.simulate(axis, t, {"u": np.sign(np.sin(6.0 * t))})
    with pytest.raises(InputError, match="nonlinear plant"):
        rl.compare(axis, record)
