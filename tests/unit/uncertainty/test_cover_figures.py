"""Figures of covers: weights over the errors, the effect of each block."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.report import cover_figures, weight_figure
from robustlab.uncertainty import error_sizes


def lags():
    return [rl.StateSpaceModel([[-1 / t]], [[g / t]], [[1.0]], [[0.0]]) for g, t in ((1, 1), (1.2, 1.3), (0.9, 0.8))]


def test_the_weight_is_above_every_drawn_error():
    found = rl.cover(lags(), "additive", gain=False)
    assert found.fit is not None
    errors = error_sizes(tuple(lags()), found.model.nominal, "additive", found.fit.omega)
    (above, below) = weight_figure(found, lags()).axes
    drawn = [line.get_ydata() for line in above.lines]
    np.testing.assert_allclose(drawn[0], errors[0], atol=1e-6 * errors.max())
    assert all((drawn[-1] >= y * (1 - 1e-9)).all() for y in drawn[:-1])
    assert below.lines[0].get_ydata().max() == pytest.approx(100 * found.fit.excess, rel=1e-6)
    assert set(cover_figures(found, lags())) == {"weight"}
