"""Figures of a comparison: what they draw, and that they stay small."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.report import pictures_of, save_figure


@pytest.fixture(scope="module")
def comparison():
    n = 12_000
    t = np.arange(n) * 1e-3
    rng = np.random.default_rng(0)
    u = np.repeat(rng.standard_normal(n // 100), 100)
    truth = rl.simulate(rl.plant("servo-axis", Fv=300.0), t, u)
    noisy = truth["q"] + 1e-5 * rng.standard_normal(n)
    return rl.compare(rl.plant("servo-axis"), rl.Record(t, {"u": u}, {"q": noisy}, {"u": "V", "q": "m"}, "$run$ <3>"))


@pytest.mark.slow
def test_all_figures_are_drawn_and_small(comparison, tmp_path):
    figures = {name: picture.figure for name, picture in pictures_of(comparison)}
    assert list(figures) == ["where-q", "time-q", "speed-q", "spectrum-q", "residual-q"]
    for name, figure in figures.items():
        svg, png = save_figure(figure, tmp_path, name)
        assert svg.stat().st_size < 400_000
        assert png.stat().st_size > 10_000
        text = [t.get_text() for axes in figure.axes for t in axes.get_xticklabels() + axes.get_yticklabels()]
        assert not any("$" in label for label in text)  # ticks are readable without mathematics
