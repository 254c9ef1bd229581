"""What the figures of covers draw: weights over the errors, the effect of each block."""

from __future__ import annotations

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics import effect_blocks
from robustlab.report import blocks_figure, cloud_figure, cover_figures, weight_figure
from robustlab.uncertainty import error_sizes


def lags():
    return [rl.StateSpaceModel([[-1 / t]], [[g / t]], [[1.0]], [[0.0]]) for g, t in ((1, 1), (1.2, 1.3), (0.9, 0.8))]


def test_the_weight_lies_above_every_error_that_is_drawn():
    found = rl.cover(lags(), "additive", gain=False)
    assert found.fit is not None
    errors = error_sizes(tuple(lags()), found.model.nominal, "additive", found.fit.omega)
    (above, below) = weight_figure(found, lags()).axes
    drawn = [line.get_ydata() for line in above.lines]
    np.testing.assert_allclose(drawn[0], errors[0], atol=1e-6 * errors.max())
    assert all((drawn[-1] >= y * (1 - 1e-9)).all() for y in drawn[:-1])
    assert below.lines[0].get_ydata().max() == pytest.approx(100 * found.fit.excess, rel=1e-6)
    assert set(cover_figures(found, lags())) == {"weight"}


@pytest.mark.parametrize("form", ["elements", "pca"])
def test_every_model_is_drawn_inside_the_box(form):
    found = rl.cover(lags(), form, gain=False)
    for axes in cloud_figure(found).axes:
        points = [line for line in axes.lines if line.get_marker() == "o"]
        assert points
        assert all(np.abs(line.get_xdata()).max() <= 1 + 1e-12 for line in points)
    same = rl.cover([lags()[0], lags()[0]], "elements", gain=False)
    assert cover_figures(same, lags()[:1] * 2) == {}


def test_what_a_block_does_is_the_change_at_its_ends():
    """(M s + Fv) v = gain u: the mass of +10 % alone changes the response by 0.1 M s / (1.1 M s + Fv)."""
    made = effect_blocks(rl.plant("servo-axis", M=(95.0, 0.1), Fv=(200.0, 0.05)), ["v"])
    figure = blocks_figure(made)
    assert figure is not None
    lines = {line.get_label(): line for line in figure.axes[0].lines}
    s = 1j * np.asarray(lines["M"].get_xdata())
    wanted = np.max([np.abs(0.1 * 95 * s / ((1 + k) * 95 * s + 200)) for k in (-0.1, 0.1)], axis=0)
    np.testing.assert_allclose(lines["M"].get_ydata(), 100 * wanted, rtol=1e-6)
    assert set(lines) == {"M", "Fv"}
    with pytest.raises(rl.InputError, match="without blocks"):
        blocks_figure(effect_blocks(rl.plant("servo-axis")))
