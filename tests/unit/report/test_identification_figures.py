"""Figures of a comparison: what they draw, and that they stay small."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.report.comparison_figures import comparison_figures
from robustlab.report.figures import outline, save_figure
from robustlab.statespace import StateSpaceModel


@pytest.fixture(scope="module")
def comparison():
    n = 12_000
    t = np.arange(n) * 1e-3
    rng = np.random.default_rng(0)
    u = np.repeat(rng.standard_normal(n // 100), 100)
    truth = rl.simulate(rl.plant("servo-axis", Fv=300.0), t, u)
    noisy = truth["q"] + 1e-5 * rng.standard_normal(n)
    return rl.compare(rl.plant("servo-axis"), rl.Record(t, {"u": u}, {"q": noisy}, {"u": "V", "q": "m"}, "$run$ <3>"))


def test_outline_keeps_the_extremes_in_their_order():
    t = np.arange(50_000.0)
    y = np.random.default_rng(1).standard_normal(50_000)
    y[31_415], y[27_182] = 100.0, -100.0
    drawn_t, drawn = outline(t, y)
    assert len(drawn) <= 2000
    assert (drawn.max(), drawn.min()) == (100.0, -100.0)
    assert (np.diff(drawn_t) >= 0).all()
    assert drawn_t[drawn.argmax()] == 31_415
    np.testing.assert_array_equal(drawn, y[drawn_t.astype(int)])


def test_all_figures_are_drawn_and_small(comparison, tmp_path):
    figures = comparison_figures(comparison)
    assert list(figures) == ["where-q", "time-q", "speed-q", "spectrum-q", "response-q", "residual-q"]
    for name, figure in figures.items():
        svg, png = save_figure(figure, tmp_path, name)
        assert svg.stat().st_size < 400_000
        assert png.stat().st_size > 10_000
        text = [t.get_text() for axes in figure.axes for t in axes.get_xticklabels() + axes.get_yticklabels()]
        assert not any("$" in label for label in text)  # ticks are readable without mathematics


def test_harmonics_are_drawn_where_the_excitation_leaves_some_out(tmp_path):
    n, t = 400, np.arange(1600) * 0.01
    u = sum(np.cos(2 * np.pi * k * np.arange(1600) / n + k * k) for k in (1, 3, 7, 9))
    model = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=["y"])
    y = rl.simulate(model, t, u + 0.1 * u**2)["y"] + 1e-3 * np.random.default_rng(0).standard_normal(1600)
    found = rl.compare(model, rl.Record(t, {"u": u}, {"y": y}))
    figures = comparison_figures(found)
    assert list(figures)[-1] == "harmonics"
    assert "even" in figures["harmonics"].axes[0].get_title(loc="left")
    svg, _ = save_figure(figures["harmonics"], tmp_path, "harmonics")
    assert svg.stat().st_size < 400_000
