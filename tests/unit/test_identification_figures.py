"""Figures of a comparison: what they draw, and that they stay small."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.report.comparison_figures import comparison_figures, outline
from robustlab.report.figures import save_figure
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
    short = np.arange(5.0)
    assert outline(short, short)[0] is short


def test_all_figures_are_drawn_and_small(comparison, tmp_path):
    figures = comparison_figures(comparison)
    assert list(figures) == ["time-q", "speed-q", "spectrum-q", "residual-q"]
    for name, figure in figures.items():
        svg, png = save_figure(figure, tmp_path, name)
        assert svg.stat().st_size < 400_000
        assert png.stat().st_size > 10_000
        text = [t.get_text() for axes in figure.axes for t in axes.get_xticklabels() + axes.get_yticklabels()]
        assert not any("$" in label for label in text)  # ticks are readable without mathematics


def test_figures_say_what_they_show(comparison):
    figures = comparison_figures(comparison)
    assert figures["time-q"].axes[0].get_ylabel() == "q [m]"
    assert figures["time-q"].axes[0].get_title(loc="left") == "servo-axis against $run$ <3>"
    assert figures["speed-q"].axes[1].get_ylabel() == "addition to u [V]"
    assert figures["speed-q"].axes[0].get_xlabel() == "speed [m/s]"
    band = figures["time-q"].axes[2].patches[0].get_extents()
    assert band.width > 0


def test_without_speed_and_with_a_hostile_name():
    t = np.arange(300) * 0.01
    model = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=["../q"])
    u = np.sign(np.sin(t))
    found = rl.compare(model, rl.Record(t, {"u": u}, {"../q": rl.simulate(model, t, 2 * u)["../q"]}))
    assert list(comparison_figures(found)) == ["time-output1", "spectrum-output1", "residual-output1"]
