"""The numbers that a figure's SVG carries: those that were drawn, and an honest word on what they leave out."""

from __future__ import annotations

import json

import numpy as np
import pytest

from robustlab.report.curves import curves_of, split
from robustlab.report.figures import new_figure, save_figure, zero_line


def panel_of(figure):
    told = curves_of(figure)
    assert told is not None
    return told["whole"], told["panels"][0]


def test_lines_marks_and_axes_are_told():
    figure, (axes,) = new_figure()
    axes.semilogx([1.0, 10.0, 100.0], [1.0, np.nan, 3.0], "--", color="#D55E00", label="gain")
    axes.plot([100.0, 1.0], [5.0, 6.0], "o", label="points")
    axes.set(xlabel="frequency [rad/s]", ylabel="gain [1]", xlim=(1, 100))
    zero_line(axes)
    whole, panel = panel_of(figure)
    assert whole
    assert panel["x"] == {"label": "frequency [rad/s]", "log": True, "range": [1.0, 100.0]}
    gain, points = panel["series"]
    assert (gain["x"], gain["y"]) == ([1.0, 10.0, 100.0], [1.0, None, 3.0])
    assert (gain["label"], gain["colour"], gain["dash"]) == ("gain", "#d55e00", [6, 3])
    assert (points["x"], points["y"], points["width"]) == ([1.0, 100.0], [6.0, 5.0], 0)


def test_a_long_curve_keeps_its_peaks():
    figure, (axes,) = new_figure()
    y = np.zeros(100_000)
    y[54_321], y[77_777] = 9.0, -4.0
    axes.plot(np.arange(100_000), y)
    (series,) = panel_of(figure)[1]["series"]
    assert len(series["x"]) <= 1000
    assert (max(series["y"]), min(series["y"])) == (9.0, -4.0)
    assert series["x"] == sorted(series["x"])


@pytest.mark.parametrize("draw", ["loop", "text", "lying bars"])
def test_what_cannot_be_told_leaves_the_picture_in_place(draw):
    figure, (axes,) = new_figure()
    axes.plot([0.0, 1.0], [0.0, 1.0])
    if draw == "loop":
        axes.plot(np.cos(np.linspace(0, 6, 50)), np.sin(np.linspace(0, 6, 50)))
    elif draw == "text":
        axes.annotate("here", (0.5, 0.5))
    else:
        axes.barh([0, 1], [1, 2])
    whole, panel = panel_of(figure)
    assert not whole
    assert len(panel["series"]) == 1


def test_the_svg_carries_them_and_gives_the_picture_back(tmp_path):
    figure, (axes,) = new_figure()
    axes.plot([0.0, 1.0], [2.0, 3.0], label="</metadata>&<svg>")
    svg = save_figure(figure, tmp_path, "a")[0].read_text(encoding="utf-8")
    picture, curves = split(svg)
    assert json.loads(curves)["panels"][0]["series"][0]["label"] == "</metadata>&<svg>"
    assert "curves" not in picture
    assert split(picture) == (picture, "")
